"""Firmware of Thorlabs APT stages, byte by byte: K10CR1, KDC101 with a PRM1-Z8 or an MTS25-Z8, and LTS150.

Questions are answered at any time, also during a motion; a motion is answered once, when it is over. At power-up the
channel is switched on: published clients (pylablib, thorlabs-apt-device) search the reference of real stages without
switching it on. A motion of a channel that the host switched off is refused by a message 0081; the protocol has this
message, that it comes here is assumed. A channel may have current only some time after it was switched on. A K10CR1 is
a stepper without encoder: at an obstacle it loses steps and notices nothing. A KDC101 reads an encoder and reports a
motion error; it falls silent if it sends updates and the host does not acknowledge them. Backlash, jog and limit switch
parameters are kept, and have no effect. A stop is instant, on a ramp or not. Source: Thorlabs APT communications
protocol.
"""

import math
import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, Simulated
from anisoscope.sim.bench.firmware.device import Firmware, SimulatedDevice
from anisoscope.sim.bench.firmware.faults import Fault, FaultKind
from anisoscope.sim.bench.firmware.motor import Motion, Motor

HOST, LONG, HEADER = 0x01, 0x80, 6
# Bytes of data of what a host may send, by id; 0 is a short message, None may be either (see `LONG_FORMS`).
HOST_MESSAGES = {
    **dict.fromkeys((0x0002, 0x0005, 0x0011, 0x0012, 0x0018, 0x0210, 0x0211, 0x0223, 0x0429), 0),
    **dict.fromkeys((0x040A, 0x0411, 0x0414, 0x0417, 0x043B, 0x0441, 0x0443, 0x0465), 0),
    **dict.fromkeys((0x0424, 0x0480, 0x0490, 0x0492), 0),
    **dict.fromkeys((0x0448, 0x0453, 0x043A, 0x0445, 0x0450), 6),
    **dict.fromkeys((0x0413, 0x0440), 14),
    0x0416: 22,
    0x0423: 16,
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


CHANNEL = 1
NO_SWITCH = 1
SWITCHED_OFF = 1


@dataclass(frozen=True)
class AptModel:
    """A controller with its motor; velocity and acceleration in the units of the protocol for 1°/s and 1°/s², or mm."""

    name: str
    serial: int
    counts_per_deg: float
    velocity_unit: float
    acceleration_unit: float
    velocity_deg_s: float
    acceleration_deg_s2: float
    servo: bool

    def settings(self) -> dict[int, bytes]:
        """Parameters at power-up, by the id that sets them; the next id queries them."""
        velocity = round(self.velocity_deg_s * self.velocity_unit)
        acceleration = round(self.acceleration_deg_s2 * self.acceleration_unit)
        step = round(5.0 * self.counts_per_deg)
        return {
            0x0413: struct.pack("<Hiii", CHANNEL, 0, acceleration, velocity),
            0x0416: struct.pack("<HHiiiiH", CHANNEL, 2, step, 0, acceleration, velocity, 2),
            0x0423: struct.pack("<HHHiiH", CHANNEL, NO_SWITCH, NO_SWITCH, 0, 0, NO_SWITCH),
            0x043A: struct.pack("<Hi", CHANNEL, 0),
            0x0440: struct.pack("<HHHii", CHANNEL, 2, 1, velocity, 0),
            0x0445: struct.pack("<Hi", CHANNEL, 0),
            0x0450: struct.pack("<Hi", CHANNEL, 0),
        }


_PRM1_COUNTS = 1919.6418578623391
_MTS_COUNTS = 34554.96
_SERVO_CLOCK_S = 2048.0 / 6e6
LINEAR = {
    "MTS25-Z8": AptModel(
        "KDC101",
        27000456,
        _MTS_COUNTS,
        _MTS_COUNTS * _SERVO_CLOCK_S * 65536.0,
        _MTS_COUNTS * _SERVO_CLOCK_S**2 * 65536.0,
        2.4,
        4.5,
        servo=True,
    ),
    "LTS150": AptModel("LTS150", 45000123, 409600.0, 21987328.0, 4506.0, 20.0, 20.0, servo=False),
}
MODELS = {
    "K10CR1": AptModel("K10CR1", 55000123, 409600.0 / 3.0, 7329109.0, 1502.0, 10.0, 10.0, servo=False),
    "KDC101": AptModel(
        "KDC101",
        27000123,
        _PRM1_COUNTS,
        _PRM1_COUNTS * _SERVO_CLOCK_S * 65536.0,
        _PRM1_COUNTS * _SERVO_CLOCK_S**2 * 65536.0,
        25.0,
        25.0,
        servo=True,
    ),
    **LINEAR,
}


ADDRESSES = ("50", "11", *(f"{bay:02X}" for bay in range(0x21, 0x2B)))
UPDATE_S = 0.1
UPDATES_WITHOUT_HOST = 50
MOTION_ERROR_BIT = 14
LIMIT_BITS = range(4)
ERROR_BITS = (14, 15, 16, 17, 18, 24, 25, 26)
STRANGE_BAY = 0x29
MOST_SLIP_DEG = 3600.0


class AptFirmware(SimulatedDevice):
    """One controller with one channel.

    Args:
        axis: the axis it turns; by default one that stands at 0° and moves in real time.
        address: destination to which it listens.
        model: controller and motor.
        enabled: whether the channel is switched on at power-up.
        enabling_s: time in seconds from the command that switches the channel on until the motor has current.
        faults: what is wrong with it; as text, ``name`` or ``name:number``. The number of a latched error is the bit
            of the status; that of a motion error too, if there is such an error bit, or else the code of a complaint.

    Raises:
        UsageError: there is no fault of this name, or a controller of this kind cannot have it.
    """

    IMPOSSIBLE: ClassVar[frozenset[FaultKind]] = frozenset({FaultKind.BUSY})

    def __init__(
        self,
        axis: RotaryAxis | None = None,
        *,
        address: int = 0x50,
        model: AptModel = MODELS["K10CR1"],
        enabled: bool = True,
        enabling_s: float = 0.0,
        faults: Iterable[Fault | str] = (),
    ) -> None:
        self.axis = axis or RotaryAxis()
        super().__init__(faults, self.axis.clock)
        self.model = model
        self.address = address
        self.enabling_s = enabling_s
        self._enabled_at_first = enabled
        self.identified = 0
        self.motor = Motor(self.axis, model.counts_per_deg, self.faults)
        self._handlers = self._all_handlers()
        self._power_up()
        if FaultKind.LATCHED_ERROR in self.faults:
            self._errors = 1 << int(self.faults[FaultKind.LATCHED_ERROR])

    @property
    def counts(self) -> int:
        """Position in counts, as the controller believes it to be."""
        return self.motor.counts + self._slipped + self._slipping()

    def _slipping(self) -> int:
        """Counts of a stepper that searches its reference behind an obstacle: without feedback it counts on."""
        held = self.axis.stalled() or self.motor.motion is None
        if self._doing is not Motion.HOME or self.model.servo or not held:
            return 0
        began, from_deg, speed = self._search
        scale = self.axis.time_scale
        passed_s = (self._clock() - began) / scale if scale > 0.0 else math.inf
        ramp_deg = 0.5 * speed**2 / self.axis.acceleration_deg_s2
        way_deg = min(max(abs(speed) * passed_s - ramp_deg, 0.0), MOST_SLIP_DEG)
        believed = from_deg + math.copysign(way_deg, speed)
        return round((believed - self.axis.position()) * self.model.counts_per_deg)

    @property
    def _enabled(self) -> bool:
        """Whether the motor has current."""
        return self._clock() >= self._enabled_at

    def _power_up(self) -> None:
        self.motor.power_up()
        self._updates = self._forward = False
        self._enabled_at = -math.inf if self._enabled_at_first else math.inf
        self._errors = self._slipped = self._target = 0
        self._doing: Motion | None = None
        self._search = (0.0, 0.0, 0.0)  # since when, from where, and how fast the reference is searched
        self._next_update, self._unacknowledged = 0.0, 0
        self._settings = self.model.settings()

    # Packets.

    def connect(self) -> None:
        """A host opened the line; updates are off until requested."""
        with self._lock:
            super().connect()
            self._updates = False

    def _take_packet(self) -> bool:
        packet = take_packet(self._inbox)
        if packet is None:
            return False
        if packet.destination == self.address:
            self._take(struct.pack("<HBB", packet.id, *packet.parameters) + packet.data)
            self._attend()
            self._obey(packet)
        return True

    def _obey(self, packet: Packet) -> None:
        if packet.id in self._settings and packet.data:
            self._settings[packet.id] = packet.data
        elif packet.id - 1 in self._settings:
            self._answer(packet.id + 1, self._settings[packet.id - 1])
        elif packet.id in self._handlers:
            self._handlers[packet.id](packet)

    def _all_handlers(self) -> dict[int, Callable[[Packet], None]]:
        kind = 16
        count = self._count_data
        return {
            0x0002: lambda _: self._set_updates(False),
            0x0005: lambda _: self._answer(0x0006, information(self.model.name, self.model.serial, kind)),
            0x0011: lambda _: self._set_updates(True),
            0x0012: lambda _: self._set_updates(False),
            0x0210: self._set_enabled,
            0x0211: lambda _: self._send(short(0x0212, CHANNEL, 1 if self._enabled else 2, self._speaker)),
            0x0223: lambda _: self._identify(),
            0x040A: lambda _: self._answer(0x040B, count(self.counts if self.model.servo else 0)),
            0x0411: lambda _: self._answer(0x0412, count(self.counts)),
            0x0429: lambda _: self._answer(0x042A, struct.pack("<HI", CHANNEL, self._status_bits())),
            0x0443: lambda _: self._start(None),
            0x0448: lambda packet: self._start(self.counts + self._number(packet, 0x0445)),
            0x0453: lambda packet: self._start(self._number(packet, 0x0450)),
            0x0465: lambda _: self._stop(),
            0x0480: lambda _: self._report_status(0x0481, servo=False),
            0x0490: lambda _: self._report_status(0x0491, servo=True),
            0x0492: lambda _: self._acknowledged(),
        }

    def _number(self, packet: Packet, setting: int) -> int:
        return int(struct.unpack("<Hi", packet.data or self._settings[setting])[1])

    # Answers.

    @property
    def _speaker(self) -> int:
        return STRANGE_BAY if FaultKind.WRONG_ADDRESS in self.faults else self.address

    def _answer(self, number: int, data: bytes) -> None:
        self._send(long(number, data, self._speaker))

    def _send(self, frame: bytes) -> None:
        if self._unacknowledged <= UPDATES_WITHOUT_HOST:
            super()._send(frame)

    @staticmethod
    def _count_data(counts: int) -> bytes:
        return struct.pack("<Hi", CHANNEL, counts)

    def _status_bits(self) -> int:
        bits = self._errors | 1 << 8 | self.motor.referenced << 10 | self._enabled << 31
        if self._doing is Motion.HOME:
            return bits | 1 << 9 | 1 << 5
        if self._doing is Motion.MOVE:
            return bits | (1 << 4 if self._forward else 1 << 5)
        return bits | 1 << 13

    def _status(self, *, servo: bool) -> bytes:
        if servo:
            velocity = 0 if self._doing is None else (1 if self._forward else -1)
            return struct.pack("<HihHI", CHANNEL, self.counts, velocity, 0, self._status_bits())
        return struct.pack("<HiiI", CHANNEL, self.counts, 0, self._status_bits())

    def _report_status(self, number: int, *, servo: bool) -> None:
        if servo != self.model.servo:
            return
        self._answer(number, self._status(servo=servo))
        if self.motor.loses_power():
            self._power_up()

    def _report_end(self, number: int) -> None:
        self._answer(number, self._status(servo=self.model.servo))

    def _unsolicited(self) -> bytes:
        """An unsolicited status update, and a message about the bay of a hub."""
        update = long(
            0x0491 if self.model.servo else 0x0481, self._status(servo=self.model.servo), self._speaker
        )
        return update + short(0x0066, 1, 0, self._speaker)

    def _set_updates(self, on: bool) -> None:
        self._updates, self._next_update, self._unacknowledged = on, self._clock() + UPDATE_S, 0

    def _acknowledged(self) -> None:
        self._unacknowledged = 0

    def _identify(self) -> None:
        self.identified += 1

    def _send_update(self) -> None:
        if self._updates and self._clock() >= self._next_update:
            self._next_update = self._clock() + UPDATE_S
            self._unacknowledged += self.model.servo
            self._report_status(0x0491 if self.model.servo else 0x0481, servo=self.model.servo)

    # Motion.

    def _repair(self) -> None:
        self.motor.repair()
        self._errors = 0

    def _set_enabled(self, packet: Packet) -> None:
        if packet.parameters[1] == 1:
            self._enabled_at = min(self._enabled_at, self._clock() + self.enabling_s)
        else:
            self._enabled_at = math.inf
            self._errors = 0
            self._halt()

    def _start(self, target: int | None) -> None:
        """Start a move to a position in counts, or (None) the reference search."""
        if self.motor.count_motion():
            self._dead = True
        elif FaultKind.MOTION_ERROR in self.faults:
            self._refuse(int(self.faults[FaultKind.MOTION_ERROR]))
        elif not self._enabled:
            about = 0x0443 if target is None else 0x0453
            self._answer(0x0081, rich_response(about, SWITCHED_OFF, "channel 1 is switched off"))
        elif not self._errors & 1 << MOTION_ERROR_BIT:
            self._go(target)

    def _refuse(self, code: int) -> None:
        if code in ERROR_BITS:
            self._errors |= 1 << code
        elif code in LIMIT_BITS:
            self._errors |= 1 << code
            self._report_end(0x0464)
        else:
            self._answer(0x0081, rich_response(0x0453, code, "simulated failure"))

    def _go(self, target: int | None) -> None:
        model = self.model
        _, _, acceleration, velocity = struct.unpack("<Hiii", self._settings[0x0413])
        _, _, _, home_velocity, home_offset = struct.unpack("<HHHii", self._settings[0x0440])
        speed = (home_velocity if target is None else velocity) / model.velocity_unit
        if speed <= 0.0 or acceleration <= 0:
            return
        self.axis.acceleration_deg_s2 = acceleration / model.acceleration_unit
        self._doing = Motion.HOME if target is None else Motion.MOVE
        if target is None:
            here_deg = self.axis.position()
            way_deg = home_offset / model.counts_per_deg - here_deg
            self._search = (self._clock(), here_deg, math.copysign(speed, way_deg))
            self.motor.home(home_offset, speed / self.axis.velocity_deg_s)
        else:
            self._target, self._forward = target, target > self.counts
            self.motor.move(target - self._slipped, speed / self.axis.velocity_deg_s)

    def _attend(self) -> None:
        ended = self.motor.ended()
        if ended is Motion.STALL:
            self._end_at_obstacle()
        elif ended is not None:
            if ended is Motion.HOME:
                self._slipped = 0
            self._end()
        self._send_update()

    def _end(self) -> None:
        doing, self._doing = self._doing, None
        if FaultKind.LOST_REPLY in self.faults:
            return
        if doing is Motion.HOME:
            self._send(short(0x0444, CHANNEL, 0, self._speaker))
        else:
            self._report_end(0x0464)

    def _end_at_obstacle(self) -> None:
        if self.model.servo:
            self._errors |= 1 << MOTION_ERROR_BIT
            self._doing = None
        elif self._doing is Motion.MOVE:
            self._slipped = self._target - self.motor.counts
            self._end()
        # A stepper that searches its reference goes on slipping until it is stopped.

    def _halt(self) -> None:
        self._slipped += self._slipping()
        self._doing = None
        self.motor.stop()

    def _stop(self) -> None:
        self.stops += 1
        self._halt()
        self._report_end(0x0466)


def build(mounts: Sequence[Mount], model: str, faults: Sequence[str]) -> Firmware:
    """One controller; it drives one axis, and has a USB port of its own."""
    if len(mounts) != 1:
        raise UsageError(
            "a Thorlabs APT controller drives one axis and has a port of its own; put the other on another line"
        )
    address = mounts[0].address or ADDRESSES[0]
    if address not in ADDRESSES:
        raise UsageError(f"'{address}' is not an APT address; use one of: {', '.join(ADDRESSES)}")
    return AptFirmware(
        mounts[0].axis,
        address=int(address, 16),
        model=MODELS[SIMULATED.model_of(mounts[0], model)],
        faults=faults,
    )


SIMULATED = Simulated("Thorlabs APT stage", tuple(MODELS), build, tuple(LINEAR))
