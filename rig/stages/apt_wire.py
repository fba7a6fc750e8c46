"""The bytes of the Thorlabs APT protocol: messages, device information, status.

A message is six bytes, ``id (2) parameter (1) parameter (1) destination (1) source (1)``, or six bytes
``id (2) length (2) destination | 0x80 (1) source (1)`` and so many bytes of data; all little-endian. Nothing marks
the begin of a message: after noise it is found by what cannot be one. Source: Thorlabs APT communications protocol.
"""

import struct
from dataclasses import dataclass
from typing import Self

from anisoscope.base.errors import LimitExceeded, ProtocolError, RigError

HEADER = 6
HOST = 0x01
USB_UNIT = 0x50
LONG = 0x80
# The unit on USB, the controller of a rack, and its bays.
ADDRESSES = (USB_UNIT, 0x11, *range(0x21, 0x2B))
CHANNEL = 1
ENABLE, DISABLE = 1, 2
STOP_IMMEDIATE, STOP_PROFILED = 1, 2

HW_DISCONNECT = 0x0002
HW_REQ_INFO, HW_GET_INFO = 0x0005, 0x0006
HW_STOP_UPDATES = 0x0012
HW_RESPONSE, HW_RICH_RESPONSE = 0x0080, 0x0081
SET_ENABLED = 0x0210
IDENTIFY = 0x0223
REQ_VELOCITY, GET_VELOCITY = 0x0414, 0x0415
REQ_HOMING, GET_HOMING = 0x0441, 0x0442
HOME, HOMED = 0x0443, 0x0444
MOVE_ABSOLUTE, MOVE_COMPLETED = 0x0453, 0x0464
STOP, STOPPED = 0x0465, 0x0466
REQ_STATUS, GET_STATUS = 0x0480, 0x0481
REQ_DC_STATUS, GET_DC_STATUS, ACK_DC_STATUS = 0x0490, 0x0491, 0x0492

# What a controller may send: bytes of data by id; 0 is a short message.
REPLIES = {
    HW_RESPONSE: 0,
    0x0212: 0,
    HOMED: 0,
    HW_GET_INFO: 84,
    HW_RICH_RESPONSE: 68,
    0x040B: 6,
    0x0412: 6,
    GET_VELOCITY: 14,
    0x0418: 22,
    0x042A: 6,
    0x043C: 6,
    GET_HOMING: 14,
    MOVE_COMPLETED: 14,
    STOPPED: 14,
    GET_STATUS: 14,
    GET_DC_STATUS: 14,
}


@dataclass(frozen=True)
class Message:
    """One message; `parameters` are of the short form, `data` of the long one."""

    id: int
    parameters: tuple[int, int] = (0, 0)
    data: bytes = b""
    source: int = HOST

    def to_bytes(self, destination: int) -> bytes:
        """The bytes as they go over the wire."""
        if self.data:
            return struct.pack("<HHBB", self.id, len(self.data), destination | LONG, self.source) + self.data
        return struct.pack("<HBBBB", self.id, *self.parameters, destination, self.source)


def take_message(received: bytearray) -> tuple[Message | None, int]:
    """Take the first whole message of a controller to the host; the bytes before it are dropped.

    Args:
        received: what came; shortened by what was taken and dropped.

    Returns:
        The message, or None if there is none yet; and how many bytes were dropped.
    """
    dropped = 0
    while len(received) >= HEADER:
        number, length, destination, source = struct.unpack_from("<HHBB", received)
        size = REPLIES.get(number)
        fits = size is not None and destination == (HOST | LONG if size else HOST)
        if size is None or not fits or source not in ADDRESSES or (size and size != length):
            del received[0]
            dropped += 1
            continue
        if len(received) < HEADER + size:
            break
        message = Message(
            number,
            (length & 0xFF, length >> 8) if not size else (0, 0),
            bytes(received[HEADER : HEADER + size]),
            source,
        )
        del received[: HEADER + size]
        return message, dropped
    return None, dropped


@dataclass(frozen=True)
class DeviceInfo:
    """Identification of a controller: model name, serial number, firmware release."""

    model: str
    serial: str
    firmware: str

    @classmethod
    def parse(cls, data: bytes) -> Self:
        """Read the 84 bytes of a hardware information message.

        Raises:
            ProtocolError: the model name is not text.
        """
        serial, name, _, minor, interim, major, _ = struct.unpack_from("<I8sHBBBB", data)
        model = name.rstrip(b"\0 ").decode("ascii", errors="replace")
        if not (model.isascii() and model.isprintable() and model):
            raise ProtocolError(f"the controller calls itself {name!r}; is it a Thorlabs APT controller?")
        return cls(model, f"{serial:08d}", f"{major}.{interim}.{minor}")


@dataclass(frozen=True)
class Status:
    """Position of the motor in counts, and the 32 status bits; the same for steppers and servos."""

    counts: int
    bits: int

    @classmethod
    def parse(cls, data: bytes) -> Self:
        """Read the 14 bytes of a status message."""
        _, counts, _, bits = struct.unpack("<HiiI", data)
        return cls(counts, bits)

    def has(self, bit: int) -> bool:
        """Whether a bit is set."""
        return bool(self.bits >> bit & 1)

    @property
    def moving(self) -> bool:
        """Whether the motor moves, jogs or searches its reference."""
        return any(self.has(bit) for bit in (4, 5, 6, 7, 9))

    @property
    def homing(self) -> bool:
        """Whether the motor searches its reference."""
        return self.has(9)

    @property
    def homed(self) -> bool:
        """Whether the reference was found since power-up."""
        return self.has(10)

    @property
    def at_limit_switch(self) -> bool:
        """Whether a limit switch is touched."""
        return self.has(0) or self.has(1)

    @property
    def enabled(self) -> bool:
        """Whether the motor has current."""
        return self.has(31)


def position_data(counts: int) -> bytes:
    """The data of an absolute move.

    Raises:
        LimitExceeded: the number does not fit into 32 bits.
    """
    if not -(1 << 31) <= counts < 1 << 31:
        raise LimitExceeded(f"{counts} counts do not fit into the 32 bits of the APT protocol")
    return struct.pack("<Hi", CHANNEL, counts)


def velocity_counts(data: bytes) -> tuple[int, int]:
    """Top velocity and acceleration, in the units of the controller, from velocity parameters."""
    _, _, acceleration, velocity = struct.unpack("<Hiii", data)
    return velocity, acceleration


def homing_velocity_counts(data: bytes) -> int:
    """Velocity of the reference search, in the units of the controller, from homing parameters."""
    return int(struct.unpack("<HHHii", data)[3])


def error_text(message: Message) -> str:
    """Text of an unsolicited error response."""
    if message.id == HW_RESPONSE:
        return "an error without further information"
    about, code, notes = struct.unpack("<HH64s", message.data)
    text = notes.split(b"\0")[0].decode("ascii", errors="replace").strip() or "no explanation"
    return f"{text} (code {code}, about message {about:04X})"


def address_of(text: str) -> int:
    """Read an address written in hex.

    Raises:
        RigError: no controller has it.
    """
    try:
        address = int(text, 16)
    except ValueError:
        address = -1
    if address not in ADDRESSES:
        raise RigError(f"'{text}' is not an APT address; use 50 for a unit on USB, 21…2A for a bay of a rack")
    return address
