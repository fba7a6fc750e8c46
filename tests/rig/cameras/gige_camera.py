"""A GigE Vision camera as a process: it answers on a loop-back address of its own and sends frames with packed counts
and chunk data. ``python gige_camera.py [--faults 2=lose:3,5=old]`` prints its address when it listens, and ends with
its standard input.

Written from the layout of the GigE Vision messages (GVCP, GVSP) and of GenICam's register files as their readers
(Aravis, Wireshark's dissector) have them; it shares nothing with the driver. The pixel (row, column) of the n-th frame
is 7 column + 13 row + 29 n, modulo the full scale + 1.
"""

import argparse
import os
import selectors
import socket
import struct
import sys
import time

GVCP_PORT = 3956
FORMATS = {
    "Mono8": (0x01080001, 8, ""),
    "Mono10": (0x01100003, 10, ""),
    "Mono12": (0x01100005, 12, ""),
    "Mono10Packed": (0x010C0004, 10, "Packed"),
    "Mono12Packed": (0x010C0006, 12, "Packed"),
    "Mono10p": (0x010A0046, 10, "p"),
    "Mono12p": (0x010C0047, 12, "p"),
    "BayerRG12p": (0x010C0059, 12, "p"),
}
REGISTERS = {  # name: (address, bytes, first value)
    "Width": (0x1000, 4, 32),
    "Height": (0x1004, 4, 24),
    "PixelFormat": (0x1008, 4, FORMATS["Mono8"][0]),
    "AcquisitionMode": (0x100C, 4, 0),
    "Acquisition": (0x1010, 4, 0),
    "TriggerMode": (0x1014, 4, 0),
    "TriggerSource": (0x1018, 4, 1),
    "TriggerSoftware": (0x101C, 4, 0),
    "GainAuto": (0x1020, 4, 1),
    "ReverseX": (0x1024, 4, 0),
    "ChunkModeActive": (0x1028, 4, 0),
    "ChunkSelector": (0x102C, 4, 0),
    "ChunkEnable": (0x1030, 4, 0),
    "PayloadSize": (0x1034, 4, 0),
    "Decimation": (0x1038, 4, 1),
    "ExposureTime": (0x1040, 8, 5000.0),
    "Gain": (0x1048, 8, 0.0),
}
CONTROL, STREAM_PORT, PACKET_SIZE, STREAM_ADDRESS = 0xA00, 0xD00, 0xD04, 0xD18
IMAGE_ID, CHUNK_TIME, CHUNK_EXPOSURE = 1, 2, 3
BY_ADDRESS = {address: (name, size) for name, (address, size, _) in REGISTERS.items()}


def xml():
    guid = "00000000-0000-0000-0000-00000000000"
    head = (
        '<RegisterDescription ModelName="Loop" VendorName="anisoscope" StandardNameSpace="GEV" ToolTip="" '
        'SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0" '
        'MajorVersion="1" MinorVersion="0" SubMinorVersion="0" '
        f'ProductGuid="{guid}1" VersionGuid="{guid}2" '
        'xmlns="http://www.genicam.org/GenApi/Version_1_1"><Port Name="Device"/>'
    )
    selector = (
        '<Enumeration Name="TriggerSelector"><EnumEntry Name="FrameStart"><Value>0</Value></EnumEntry>'
        "<Value>0</Value></Enumeration>"
    )

    def register(kind, name, rest="<Sign>Unsigned</Sign>", mode="RW"):
        address, size, _ = REGISTERS[name]
        return (
            f'<{kind} Name="{name}Reg"><Address>{address}</Address><Length>{size}</Length>'
            f"<AccessMode>{mode}</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable>{rest}<Endianess>BigEndian</Endianess></{kind}>"
        )

    def integer(name, low, high, step=1):
        return (
            f'<Integer Name="{name}"><pValue>{name}Reg</pValue><Min>{low}</Min><Max>{high}</Max><Inc>{step}</Inc>'
            f"</Integer>{register('IntReg', name)}"
        )

    def real(name, low, high):
        return (
            f'<Float Name="{name}"><pValue>{name}Reg</pValue><Min>{low}</Min><Max>{high}</Max></Float>'
            f"{register('FloatReg', name, '')}"
        )

    def enumeration(name, entries):
        rows = "".join(
            f'<EnumEntry Name="{entry}"><Value>{value}</Value></EnumEntry>'
            for entry, value in entries.items()
        )
        return f'<Enumeration Name="{name}">{rows}<pValue>{name}Reg</pValue></Enumeration>{register("IntReg", name)}'

    def boolean(name):
        return f'<Boolean Name="{name}"><pValue>{name}Reg</pValue></Boolean>{register("IntReg", name)}'

    def command(name, register_name, value):
        return (
            f'<Command Name="{name}"><pValue>{register_name}Reg</pValue>'
            f"<CommandValue>{value}</CommandValue></Command>"
        )

    def chunk(kind, name, number):
        sign = "<Sign>Unsigned</Sign>" if kind == "IntReg" else ""
        return (
            f'<{kind} Name="{name}"><Address>0</Address><Length>8</Length><AccessMode>RO</AccessMode><pPort>{name}Port'
            f"</pPort><Cachable>NoCache</Cachable>{sign}<Endianess>BigEndian</Endianess></{kind}>"
            f'<Port Name="{name}Port"><ChunkID>{number:08x}</ChunkID></Port>'
        )

    parts = [
        head,
        integer("Width", 8, 32, 4),
        integer("Height", 1, 24),
        integer("Decimation", 1, 4),
        enumeration("PixelFormat", {name: code for name, (code, _, _) in FORMATS.items()}),
        enumeration("AcquisitionMode", {"Continuous": 0, "SingleFrame": 1}),
        register("IntReg", "Acquisition"),
        command("AcquisitionStart", "Acquisition", 1),
        command("AcquisitionStop", "Acquisition", 0),
        selector,
        enumeration("TriggerMode", {"Off": 0, "On": 1}),
        enumeration("TriggerSource", {"Software": 0, "Line1": 1}),
        register("IntReg", "TriggerSoftware"),
        command("TriggerSoftware", "TriggerSoftware", 1),
        enumeration("GainAuto", {"Off": 0, "Continuous": 1}),
        boolean("ReverseX"),
        real("ExposureTime", 10, 1e6),
        real("Gain", 0, 24),
        register("IntReg", "PayloadSize", mode="RO"),
        '<Integer Name="PayloadSize"><pValue>PayloadSizeReg</pValue></Integer>',
        '<Integer Name="TLParamsLocked"><Value>0</Value></Integer>',
        boolean("ChunkModeActive"),
        enumeration("ChunkSelector", {"Timestamp": CHUNK_TIME, "ExposureTime": CHUNK_EXPOSURE}),
        boolean("ChunkEnable"),
        chunk("IntReg", "ChunkTimestamp", CHUNK_TIME),
        chunk("FloatReg", "ChunkExposureTime", CHUNK_EXPOSURE),
        "</RegisterDescription>",
    ]
    return "".join(parts).encode()


def packed(pixels, bits, packing):
    """Bytes of a list of counts, by whole numbers without limit."""
    if packing == "p":
        stream = sum(count << bits * place for place, count in enumerate(pixels))
        return stream.to_bytes(len(pixels) * bits // 8, "little")
    if packing == "Packed":
        out = bytearray()
        short = bits - 8
        for first, second in zip(pixels[::2], pixels[1::2], strict=True):
            low = (second & (1 << short) - 1) << 4 | first & (1 << short) - 1
            out += bytes((first >> short, low, second >> short))
        return bytes(out)
    return b"".join(count.to_bytes(1 if bits == 8 else 2, "little") for count in pixels)


class Camera:
    def __init__(self, faults):
        self.faults, self.frames, self.owner = faults, 0, None
        self.values = {name: first for name, (_, _, first) in REGISTERS.items()}
        self.enabled = set()
        self.memory = bytearray(0x20000)
        self.control, self.address = self._bind()
        self.stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.stream.bind((self.address, 0))
        description = xml()
        self._put(0x10000, description)
        self._put(0x200, f"Local:loop.xml;10000;{len(description):x}\0".encode())
        for place, number in (
            (0x0, 0x00010002),
            (0x4, 0x80000001),
            (0x600, 1),
            (0x904, 1),
            (0x934, 2),
            (0x938, 3000),
            (0x940, 1_000_000_000),
            (PACKET_SIZE, 576),
        ):
            self._put(place, struct.pack(">I", number))
        for place, text in ((0x48, b"anisoscope"), (0x68, b"Loop"), (0x88, b"1"), (0xD8, b"LB01")):
            self._put(place, text)

    @staticmethod
    def _bind():
        """A control socket on a loop-back address that nobody else has: binding is the test."""
        for number in range(os.getpid(), os.getpid() + 1000):
            address = f"127.{1 + (number >> 16) % 250}.{(number >> 8) % 256}.{1 + number % 254}"
            control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            try:
                control.bind((address, GVCP_PORT))
            except OSError:
                control.close()
                continue
            return control, address
        raise SystemExit("no loop-back address is free")

    def _put(self, place, content):
        self.memory[place : place + len(content)] = content

    def number(self, place):
        return struct.unpack_from(">I", self.memory, place)[0]

    # -- control channel -------------------------------------------------------------------------------------------

    def answer(self, message, sender):
        key, _, command, size, request = struct.unpack_from(">BBHHH", message)
        if key != 0x42:
            return
        body = message[8 : 8 + size]
        reply, status = b"", 0
        if command == 0x0002:
            reply = bytes(self.memory[:0xF8])
        elif command == 0x0080:
            reply = self.read(struct.unpack_from(">I", body)[0], 4)
        elif command == 0x0084:
            place, count = struct.unpack(">I2xH", body)
            reply = body[:4] + self.read(place, count)
        elif command in {0x0082, 0x0086}:
            place = struct.unpack_from(">I", body)[0]
            if self.owner not in {None, sender}:
                status = 0x8006  # access denied
            else:
                reply = struct.pack(">HH", 0, 1)
        else:
            status = 0x8001
        self.control.sendto(struct.pack(">HHHH", status, command + 1, len(reply), request) + reply, sender)
        if command in {0x0082, 0x0086} and not status:
            self.write(place, body[4:], sender)

    def read(self, place, count):
        if place in BY_ADDRESS:
            name, size = BY_ADDRESS[place]
            value = self.values[name]
            if name == "ChunkEnable":
                value = int(self.values["ChunkSelector"] in self.enabled)
            if name == "PayloadSize":
                value = len(self.payload(0))
            return struct.pack(">d" if size == 8 else ">I", value)[:count]
        return bytes(self.memory[place : place + count])

    def write(self, place, content, sender):
        if place == CONTROL:
            self.owner = sender if struct.unpack(">I", content)[0] else None
            self._put(place, content)
        elif place in BY_ADDRESS:
            name, size = BY_ADDRESS[place]
            self.values[name] = struct.unpack(">d" if size == 8 else ">I", content)[0]
            if name == "ChunkEnable":
                change = self.enabled.add if self.values[name] else self.enabled.discard
                change(self.values["ChunkSelector"])
            elif name == "TriggerSoftware" and self.values["Acquisition"] and self.values["TriggerMode"]:
                self.send_frame()
        else:
            self._put(place, content)

    # -- stream channel --------------------------------------------------------------------------------------------

    def counts(self, number):
        bits = next(bits for code, bits, _ in FORMATS.values() if code == self.values["PixelFormat"])
        rows, cols = self.values["Height"], self.values["Width"]
        places = range(cols - 1, -1, -1) if self.values["ReverseX"] else range(cols)
        return [(7 * col + 13 * row + 29 * number) % (1 << bits) for row in range(rows) for col in places]

    def payload(self, number, time_ns=0, exposure_us=0.0):
        bits, packing = next(
            (bits, packing) for code, bits, packing in FORMATS.values() if code == self.values["PixelFormat"]
        )
        data = packed(self.counts(number), bits, packing)
        if not self.values["ChunkModeActive"]:
            return data
        data += struct.pack(">II", IMAGE_ID, len(data))
        for chunk, content in (
            (CHUNK_TIME, struct.pack(">Q", time_ns)),
            (CHUNK_EXPOSURE, struct.pack(">d", exposure_us)),
        ):
            if chunk in self.enabled:
                data += content + struct.pack(">II", chunk, len(content))
        return data

    def send_frame(self):
        self.frames += 1
        number = self.frames
        fault, _, detail = self.faults.get(number, "").partition(":")
        if fault == "silent":
            return
        time_ns = 1 if fault == "old" else time.monotonic_ns()
        exposure_us = self.values["ExposureTime"] * (3.0 if fault == "exposure" else 1.0)
        data = self.payload(number, time_ns, exposure_us)
        rows, cols = self.values["Height"], self.values["Width"]
        code = FORMATS["Mono8"][0] if fault == "format" else self.values["PixelFormat"]
        rows -= fault == "size"
        if fault == "short":
            data = data[: len(data) // 2]
        kind = 0x4001 if self.values["ChunkModeActive"] else 0x0001
        leader = struct.pack(">HHQIIIIIHH", 0, kind, time_ns, code, cols, rows, 0, 0, 0, 0)
        step = (self.number(PACKET_SIZE) & 0xFFFF) - 36
        packets = [(1, leader)]
        packets += [(3, data[start : start + step]) for start in range(0, len(data), step)]
        packets += [(2, struct.pack(">HHI", 0, kind, rows))]
        lost = {int(place) % len(packets) for place in detail.split("+")} if fault == "lose" else set()
        target = socket.inet_ntoa(bytes(self.memory[STREAM_ADDRESS : STREAM_ADDRESS + 4]))
        port = self.number(STREAM_PORT) & 0xFFFF
        for place, (content, body) in enumerate(packets):
            if place not in lost:
                header = struct.pack(">HHI", 0, number & 0xFFFF, content << 24 | place)
                self.stream.sendto(header + body, (target, port))

    def run(self):
        watch = selectors.DefaultSelector()
        watch.register(self.control, selectors.EVENT_READ)
        watch.register(sys.stdin, selectors.EVENT_READ)
        print(self.address, flush=True)  # noqa: T201 - its only word
        while True:
            for key, _ in watch.select():
                if key.fileobj is sys.stdin:
                    return
                self.answer(*self.control.recvfrom(2048))


if __name__ == "__main__":
    options = argparse.ArgumentParser()
    options.add_argument("--faults", default="")
    pairs = [part.partition("=") for part in options.parse_args().faults.split(",") if part]
    Camera({int(number): fault for number, _, fault in pairs}).run()
