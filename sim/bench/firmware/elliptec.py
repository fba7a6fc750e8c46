"""Firmware of a Thorlabs Elliptec rotation stage, byte by byte.

Commands have no terminator: a packet ends by the length that its two letters fix. Stray CR and LF between
packets are swallowed, as some clients send them; a packet whose bytes lie more than 2 s apart is dropped. A
motion is answered once, when it is over; meanwhile everything but a stop is answered with GS09. Before the
reference search the device counts from where it stood at power-up. Source: Thorlabs ELLx protocol manual, and
recorded answers.
"""

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.faults import Fault, FaultKind

ADDRESSES = b"0123456789ABCDEF"
ARGUMENT_LENGTHS: Mapping[bytes, int] = {
    **dict.fromkeys((b"in", b"gs", b"gp", b"gj", b"go", b"gv", b"fw", b"bw", b"st", b"us"), 0),
    **dict.fromkeys((b"i1", b"i2", b"i3", b"s1", b"s2"), 0),
    **dict.fromkeys((b"ho", b"ca"), 1),
    **dict.fromkeys((b"sv", b"is"), 2),
    **dict.fromkeys((b"f1", b"b1", b"f2", b"b2"), 4),
    **dict.fromkeys((b"ma", b"mr", b"sj", b"so"), 8),
}
PACKET_GAP_S = 2.0
OK, MECHANICAL_TIMEOUT, COMMAND_ERROR, OUT_OF_RANGE, BUSY = 0, 2, 3, 4, 9
STALL_TIMEOUT_S = 2.0
NOISE = b"\x00\x00\xfe\x7f~!\r\n"
BABBLE = b"\x00\xc3?\r\n"


@dataclass(frozen=True)
class ElliptecModel:
    """What the device says about itself in answer to ``in``; travel in degrees, pulses over the travel."""

    number: int = 14
    serial: str = "11400517"
    year: str = "2023"
    firmware: str = "17"
    hardware: str = "01"
    travel_deg: int = 360
    pulses: int = 143360


ELL14 = ElliptecModel()
ELL18 = replace(ELL14, number=18, serial="11800042")
ELL8 = replace(ELL14, number=8, serial="10800007", pulses=262144)


class ElliptecFirmware:
    """One stage on the bus. `write` takes what the host sends, `read` gives what is ready to be sent back.

    Args:
        axis: the motor; by default one that stands at 0° and moves in real time.
        address: bus address, ``0`` … ``F``.
        model: type, serial number and scale.
        faults: what is wrong with it; as text, ``name`` or ``name:number``.

    Raises:
        UsageError: there is no fault of this name.
    """

    def __init__(
        self,
        axis: RotaryAxis | None = None,
        *,
        address: str = "0",
        model: ElliptecModel = ELL14,
        faults: Iterable[Fault | str] = (),
    ) -> None:
        self.axis = axis or RotaryAxis()
        self.model = model
        self.address = address.encode("ascii")
        parsed = (Fault.parse(fault) if isinstance(fault, str) else fault for fault in faults)
        self.faults = {fault.kind: fault.value for fault in parsed}
        self.commands: list[bytes] = []
        self._lock = threading.RLock()
        self._inbox = bytearray()
        self._outbox = bytearray()
        self._last_byte = -1e9
        self._dead = False
        self._motions = 0
        self._busy_answers = int(self.faults.get(FaultKind.BUSY, 0))
        self._counts_per_deg = model.pulses / model.travel_deg
        self._home_offset = 0
        self._jog = round(self._counts_per_deg)
        self._power_up()
        self._status = int(self.faults.get(FaultKind.LATCHED_ERROR, OK))
        self.axis.stall_at_deg = self.faults.get(FaultKind.STALL, self.axis.stall_at_deg)

    @property
    def counts(self) -> int:
        """Position in encoder counts, as the device believes it to be."""
        return round((self.axis.position() - self._zero_deg) * self._counts_per_deg)

    def connect(self) -> None:
        """A host opened the line: what was under way on it is forgotten, and a dead line works again."""
        with self._lock:
            if self._dead:
                self._dead = False
                self.faults.pop(FaultKind.HANGUP, None)
            self._inbox.clear()
            self._outbox.clear()

    def clear_faults(self) -> None:
        """Repair everything."""
        with self._lock:
            self.faults.clear()
            self.axis.stall_at_deg = None
            self._busy_answers = 0
            self._dead = False

    def write(self, data: bytes) -> None:
        """Take bytes from the host.

        Raises:
            ConnectionError: the line is dead.
        """
        with self._lock:
            self._check_line()
            now = self.axis.clock()
            if now - self._last_byte > PACKET_GAP_S:
                self._inbox.clear()
            self._last_byte = now
            self._inbox += data
            while self._take_packet():
                pass

    def read(self) -> bytes:
        """Return the bytes that are ready to be sent to the host.

        Raises:
            ConnectionError: the line is dead.
        """
        with self._lock:
            self._check_line()
            self._finish_motion()
            count = 1 if FaultKind.SPLIT in self.faults else len(self._outbox)
            ready = bytes(self._outbox[:count])
            del self._outbox[:count]
            return ready

    # Packets.

    def _check_line(self) -> None:
        if self._dead:
            raise ConnectionError("the simulated line is dead")

    def _take_packet(self) -> bool:
        """Carry out the first packet of the inbox; False if there is none that is whole."""
        inbox = self._inbox
        while inbox and inbox[0] not in ADDRESSES:
            del inbox[0]
        if len(inbox) < 3:
            return False
        address, letters = bytes(inbox[:1]), bytes(inbox[1:3])
        length = 3 + ARGUMENT_LENGTHS.get(letters, 0)
        if len(inbox) < length:
            return False
        arguments = bytes(inbox[3:length])
        del inbox[:length]
        if address == self.address:
            self.commands.append(letters + arguments)
            self._obey(letters, arguments)
        return True

    def _obey(self, letters: bytes, arguments: bytes) -> None:
        self._finish_motion()
        if letters == b"st":
            self._stop()
        elif self._moving is not None:
            self._say_status(BUSY)
        elif letters not in ARGUMENT_LENGTHS or not all(digit in ADDRESSES for digit in arguments):
            self._fail(COMMAND_ERROR)
        else:
            value = int(arguments, 16) if arguments else 0
            signed = value - (1 << 32) if len(arguments) == 8 and value >= 1 << 31 else value
            self._handlers()[letters](signed)

    def _handlers(self) -> dict[bytes, Callable[[int], None]]:
        ok = self._accept
        return {
            b"in": lambda _: self._say(b"IN", self._information()),
            b"gs": lambda _: self._tell_status(),
            b"gp": lambda _: self._tell_position(),
            b"ho": lambda _: self._start(None),
            b"ma": self._start,
            b"mr": lambda delta: self._start(self.counts + delta),
            b"fw": lambda _: self._start(self.counts + self._jog),
            b"bw": lambda _: self._start(self.counts - self._jog),
            b"sj": lambda jog: self._set("_jog", jog, jog >= 0),
            b"gj": lambda _: self._say(b"GJ", _hex32(self._jog)),
            b"so": lambda offset: self._set("_home_offset", offset, abs(offset) <= self.model.pulses),
            b"go": lambda _: self._say(b"HO", _hex32(self._home_offset)),
            b"sv": lambda percent: self._set("_velocity", percent, 1 <= percent <= 100),
            b"gv": lambda _: self._say(b"GV", b"%02X" % self._velocity),
            b"ca": self._change_address,
            **dict.fromkeys((b"f1", b"b1", b"f2", b"b2", b"s1", b"s2", b"is", b"us"), ok),
            **{b"i%d" % motor: self._motor_information(motor) for motor in (1, 2, 3)},
        }

    # Answers.

    def _information(self) -> bytes:
        model = self.model
        text = f"{model.number:02X}{model.serial}{model.year}{model.firmware}{model.hardware}"
        return f"{text}{model.travel_deg:04X}{model.pulses:08X}".encode("ascii")

    def _motor_information(self, motor: int) -> Callable[[int], None]:
        # Loop on, motor on, current, ramp up, ramp down, forward and backward period.
        return lambda _: self._say(b"I%d" % motor, b"1005CFFFFFFFFF00A400AF")

    def _say(self, letters: bytes, data: bytes) -> None:
        faults = self.faults
        if FaultKind.SILENT in faults and len(self.commands) > faults[FaultKind.SILENT]:
            return
        if FaultKind.BABBLE in faults:
            self._outbox += BABBLE
            return
        speaker = (
            b"%X" % ((int(self.address, 16) + 1) % 16) if FaultKind.WRONG_ADDRESS in faults else self.address
        )
        if FaultKind.UNSOLICITED in faults:
            self._outbox += self.address + b"BS00\r\n" + self.address + b"BO00000400\r\n"
        if FaultKind.GARBAGE in faults:
            self._outbox += NOISE + b"\x00?\xb5"
        self._outbox += speaker + letters + data + b"\r\n"

    def _say_position(self) -> None:
        self._say(b"PO", _hex32(self.counts))

    def _tell_position(self) -> None:
        self._say_position()
        if self._doomed:
            self._power_up()

    def _say_status(self, status: int) -> None:
        self._say(b"GS", b"%02X" % status)

    def _fail(self, status: int) -> None:
        self._status = status
        self._say_status(status)

    def _tell_status(self) -> None:
        if self._busy_answers > 0 and self._motions > 0:
            self._busy_answers -= 1
            self._say_status(BUSY)
            return
        self._say_status(self._status)
        self._status = OK

    def _accept(self, _: int) -> None:
        self._say_status(OK)

    def _set(self, name: str, value: int, valid: bool) -> None:
        if valid:
            setattr(self, name, value)
            self._say_status(OK)
        else:
            self._fail(OUT_OF_RANGE)

    def _change_address(self, address: int) -> None:
        self.address = b"%X" % address
        self._say_status(OK)

    # Motion.

    def _power_up(self) -> None:
        self._zero_deg = self.axis.position()
        self._velocity = 100
        self._status = OK
        self._doomed = False
        self._moving: str | None = None
        self._stalled_since: float | None = None

    def _start(self, target_counts: int | None) -> None:
        """Start a move to a position in counts, or (None) the reference search."""
        self._motions += 1
        if FaultKind.HANGUP in self.faults and self._motions > self.faults[FaultKind.HANGUP]:
            self._dead = True
        elif self._busy_answers > 0:
            self._busy_answers -= 1
            self._say_status(BUSY)
        elif FaultKind.MOTION_ERROR in self.faults:
            self._fail(int(self.faults[FaultKind.MOTION_ERROR]))
        elif target_counts is not None and not -1 <= target_counts <= self.model.pulses + 1:
            self._fail(OUT_OF_RANGE)
        else:
            self._go(target_counts)

    def _go(self, target_counts: int | None) -> None:
        if FaultKind.UNSOLICITED in self.faults:
            self._say_position()
        if target_counts is None:
            self._moving = "home"
            target_deg = self._home_offset / self._counts_per_deg
        else:
            self._moving = "move"
            beyond = self.faults.get(FaultKind.OVERSHOOT, 0.0)
            target_deg = self._zero_deg + (target_counts + beyond) / self._counts_per_deg
        self.axis.start_move(target_deg, self._velocity / 100.0 / self.faults.get(FaultKind.SLOW, 1.0))

    def _finish_motion(self) -> None:
        if self._moving is None or self.axis.busy():
            return
        if self.axis.stalled():
            now = self.axis.clock()
            self._stalled_since = now if self._stalled_since is None else self._stalled_since
            if now - self._stalled_since < STALL_TIMEOUT_S * self.axis.time_scale:
                return
            self._stalled_since = self._moving = None
            self.axis.stop()
            self._fail(MECHANICAL_TIMEOUT)
            return
        finished, self._moving = self._moving, None
        if finished == "home":
            self._zero_deg = self._home_offset / self._counts_per_deg
        if FaultKind.LOST_REPLY not in self.faults:
            self._say_position()
        self._doomed = finished == "move" and FaultKind.LOST_HOMING in self.faults

    def _stop(self) -> None:
        was_moving, self._moving = self._moving, None
        self.axis.stop()
        if was_moving is None:
            self._say_status(OK)
        else:
            self._say_position()


class ElliptecBus:
    """Several stages on one line; each hears everything and answers to its own address."""

    def __init__(self, *stages: ElliptecFirmware) -> None:
        self.stages = stages

    def connect(self) -> None:
        """A host opened the line."""
        for stage in self.stages:
            stage.connect()

    def write(self, data: bytes) -> None:
        """Take bytes from the host."""
        for stage in self.stages:
            stage.write(data)

    def read(self) -> bytes:
        """Return the bytes that are ready to be sent to the host."""
        return b"".join(stage.read() for stage in self.stages)


def _hex32(counts: int) -> bytes:
    return b"%08X" % (counts & 0xFFFFFFFF)
