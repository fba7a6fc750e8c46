"""The bytes of the Thorlabs APT protocol as a controller sees them: what a host may send, and how answers look."""

import struct
from dataclasses import dataclass

HOST, LONG, HEADER = 0x01, 0x80, 6
# Bytes of data of what a host may send, by id; 0 is a short message, None may be either (see `LONG_FORMS`).
HOST_MESSAGES = {
    **dict.fromkeys((0x0002, 0x0005, 0x0011, 0x0012, 0x0018, 0x0210, 0x0211, 0x0223, 0x0429), 0),
    **dict.fromkeys((0x040A, 0x0411, 0x0414, 0x0417, 0x043B, 0x0441, 0x0443, 0x0465), 0),
    **dict.fromkeys((0x0480, 0x0490, 0x0492), 0),
    **dict.fromkeys((0x0448, 0x0453, 0x043A, 0x0445, 0x0450), 6),
    **dict.fromkeys((0x0413, 0x0440), 14),
    0x0416: 22,
}
# A move without data goes where the parameters say that were set before.
EITHER_FORM = frozenset({0x0448, 0x0453})


@dataclass(frozen=True)
class Packet:
    """One message of a host: id, the two parameters of the short form, the data of the long one."""

    id: int
    destination: int
    parameters: tuple[int, int]
    data: bytes


def take_packet(inbox: bytearray) -> Packet | None:
    """Take the first whole packet; bytes that cannot begin one are dropped."""
    while len(inbox) >= HEADER:
        number, length, destination, source = struct.unpack_from("<HHBB", inbox)
        is_long = bool(destination & LONG)
        size = HOST_MESSAGES.get(number, -1)
        known = size == (length if is_long else 0) or (not is_long and number in EITHER_FORM)
        if source != HOST or not known:
            del inbox[0]
            continue
        end = HEADER + (length if is_long else 0)
        if len(inbox) < end:
            return None
        data = bytes(inbox[HEADER:end])
        del inbox[:end]
        parameters = (0, 0) if is_long else (length & 0xFF, length >> 8)
        return Packet(number, destination & ~LONG, parameters, data)
    return None


def short(number: int, first: int, second: int, source: int) -> bytes:
    """A message without data to the host."""
    return struct.pack("<HBBBB", number, first, second, HOST, source)


def long(number: int, data: bytes, source: int) -> bytes:
    """A message with data to the host."""
    return struct.pack("<HHBB", number, len(data), HOST | LONG, source) + data


def information(model: str, serial: int, kind: int) -> bytes:
    """The 84 bytes of hardware information: firmware 1.0.3, hardware 1, one channel."""
    return struct.pack("<I8sHBBBB60sHHH", serial, model.encode("ascii"), kind, 3, 0, 1, 0, bytes(60), 1, 0, 1)


def rich_response(about: int, code: int, notes: str) -> bytes:
    """The 68 bytes of a complaint."""
    return struct.pack("<HH64s", about, code, notes.encode("ascii"))
