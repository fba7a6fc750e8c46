"""Firmware of a Thorlabs Elliptec rotation stage, byte by byte.

Commands have no terminator: a packet ends by the length that its two letters fix. Stray CR and LF between
packets are swallowed, as some clients send them; a packet whose bytes lie more than 2 s apart is dropped. A
motion is answered once, when it is over; meanwhile everything but a stop is answered with GS09. Before the
reference search the device counts from where it stood at power-up. Source: Thorlabs ELLx protocol manual, and
recorded answers.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, Simulated
from anisoscope.sim.bench.firmware.device import Bus, Firmware, SimulatedDevice
from anisoscope.sim.bench.firmware.faults import Fault, FaultKind
from anisoscope.sim.bench.firmware.motor import Motion, Motor

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


@dataclass(frozen=True)
class ElliptecModel:
    """Identification in answer to ``in``; travel in degrees and pulses over it, or travel in mm and pulses for 1 mm."""

    number: int = 14
    serial: str = "11400517"
    year: str = "2023"
    firmware: str = "17"
    hardware: str = "01"
    travel_deg: int = 360
    pulses: int = 143360
    linear: bool = False

    @property
    def counts_per_deg(self) -> float:
        """Encoder counts for one degree, or for 1 mm."""
        return float(self.pulses) if self.linear else self.pulses / self.travel_deg

    @property
    def counts(self) -> int:
        """Encoder counts over the travel."""
        return self.pulses * self.travel_deg if self.linear else self.pulses


ELL14 = ElliptecModel()
ELL18 = replace(ELL14, number=18, serial="11800042")
ELL8 = replace(ELL14, number=8, serial="10800007", pulses=262144)
ELL17 = replace(ELL14, number=17, serial="11700023", travel_deg=28, pulses=1024, linear=True)
ELL20 = replace(ELL17, number=20, serial="12000011", travel_deg=60)
LINEAR = {"ELL17": ELL17, "ELL20": ELL20}
MODELS = {"ELL14": ELL14, "ELL18": ELL18, "ELL8": ELL8, **LINEAR}


class ElliptecFirmware(SimulatedDevice):
    """One stage on the bus.

    Args:
        axis: the axis it turns; by default one that stands at 0° and moves in real time.
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
        super().__init__(faults, self.axis.clock)
        self.model = model
        self.address = address.encode("ascii")
        self.motor = Motor(self.axis, model.counts_per_deg, self.faults)
        self._last_byte = -1e9
        self._busy_answers = int(self.faults.get(FaultKind.BUSY, 0))
        self._home_offset = 0
        self._jog = round(self.motor.counts_per_deg)
        self._velocity = 100
        self._status = int(self.faults.get(FaultKind.LATCHED_ERROR, OK))

    @property
    def counts(self) -> int:
        """Position in encoder counts, as the device believes it to be."""
        return self.motor.counts

    def write(self, data: bytes) -> None:
        """Take bytes from the host.

        Raises:
            ConnectionError: the line is dead.
        """
        with self._lock:
            now = self._clock()
            if now - self._last_byte > PACKET_GAP_S:
                self._inbox.clear()
            self._last_byte = now
            super().write(data)

    # Packets.

    def _take_packet(self) -> bool:
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
            self._take(letters + arguments)
            self._obey(letters, arguments)
        return True

    def _obey(self, letters: bytes, arguments: bytes) -> None:
        self._attend()
        if letters == b"st":
            self._stop()
        elif self.motor.motion is not None:
            self._send_status(BUSY)
        elif letters not in ARGUMENT_LENGTHS or not all(digit in ADDRESSES for digit in arguments):
            self._fail(COMMAND_ERROR)
        else:
            value = int(arguments, 16) if arguments else 0
            signed = value - (1 << 32) if len(arguments) == 8 and value >= 1 << 31 else value
            self._handlers()[letters](signed)

    def _handlers(self) -> dict[bytes, Callable[[int], None]]:
        ok = self._accept
        return {
            b"in": lambda _: self._answer(b"IN", self._information()),
            b"gs": lambda _: self._report_status(),
            b"gp": lambda _: self._report_position(),
            b"ho": lambda _: self._start(None),
            b"ma": self._start,
            b"mr": lambda delta: self._start(self.counts + delta),
            b"fw": lambda _: self._start(self.counts + self._jog),
            b"bw": lambda _: self._start(self.counts - self._jog),
            b"sj": lambda jog: self._set("_jog", jog, jog >= 0),
            b"gj": lambda _: self._answer(b"GJ", _hex32(self._jog)),
            b"so": lambda offset: self._set("_home_offset", offset, abs(offset) <= self.model.counts),
            b"go": lambda _: self._answer(b"HO", _hex32(self._home_offset)),
            b"sv": lambda percent: self._set("_velocity", percent, 1 <= percent <= 100),
            b"gv": lambda _: self._answer(b"GV", b"%02X" % self._velocity),
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
        return lambda _: self._answer(b"I%d" % motor, b"1005CFFFFFFFFF00A400AF")

    def _answer(self, letters: bytes, data: bytes) -> None:
        speaker = self.address
        if FaultKind.WRONG_ADDRESS in self.faults:
            speaker = b"%X" % ((int(self.address, 16) + 1) % 16)
        self._send(speaker + letters + data + b"\r\n")

    def _unsolicited(self) -> bytes:
        return self.address + b"BS00\r\n" + self.address + b"BO00000400\r\n"

    def _send_position(self) -> None:
        self._answer(b"PO", _hex32(self.counts))

    def _report_position(self) -> None:
        self._send_position()
        if self.motor.loses_power():
            self._power_up()

    def _send_status(self, status: int) -> None:
        self._answer(b"GS", b"%02X" % status)

    def _fail(self, status: int) -> None:
        self._status = status
        self._send_status(status)

    def _report_status(self) -> None:
        if self._busy_answers > 0 and self.motor.motions > 0:
            self._busy_answers -= 1
            self._send_status(BUSY)
            return
        self._send_status(self._status)
        self._status = OK

    def _accept(self, _: int) -> None:
        self._send_status(OK)

    def _set(self, name: str, value: int, valid: bool) -> None:
        if valid:
            setattr(self, name, value)
            self._send_status(OK)
        else:
            self._fail(OUT_OF_RANGE)

    def _change_address(self, address: int) -> None:
        self.address = b"%X" % address
        self._send_status(OK)

    # Motion.

    def _power_up(self) -> None:
        self.motor.power_up()
        self._velocity = 100
        self._status = OK

    def _repair(self) -> None:
        self.motor.repair()
        self._busy_answers = 0

    def _start(self, target_counts: int | None) -> None:
        """Start a move to a position in counts, or (None) the reference search."""
        if self.motor.count_motion():
            self._dead = True
        elif self._busy_answers > 0:
            self._busy_answers -= 1
            self._send_status(BUSY)
        elif FaultKind.MOTION_ERROR in self.faults:
            self._fail(int(self.faults[FaultKind.MOTION_ERROR]))
        elif target_counts is not None and not -1 <= target_counts <= self.model.counts + 1:
            self._fail(OUT_OF_RANGE)
        else:
            self._go(target_counts)

    def _go(self, target_counts: int | None) -> None:
        if FaultKind.UNSOLICITED in self.faults:
            self._send_position()
        speed = self._velocity / 100.0
        if target_counts is None:
            self.motor.home(self._home_offset, speed)
        else:
            self.motor.move(target_counts, speed)

    def _attend(self) -> None:
        ended = self.motor.ended()
        if ended is Motion.STALL:
            self._fail(MECHANICAL_TIMEOUT)
        elif ended is not None and FaultKind.LOST_REPLY not in self.faults:
            self._send_position()

    def _stop(self) -> None:
        self.stops += 1
        if self.motor.stop() is None:
            self._send_status(OK)
        else:
            self._send_position()


def _hex32(counts: int) -> bytes:
    return b"%08X" % (counts & 0xFFFFFFFF)


def build(mounts: Sequence[Mount], model: str, faults: Sequence[str]) -> Firmware:
    """One stage an axis, at the addresses of the mounts; serial numbers count on from that of the model."""
    stages = []
    for number, mount in enumerate(mounts):
        address = mount.address or f"{number:X}"
        if len(address) != 1 or address.encode() not in ADDRESSES:
            raise UsageError(f"'{address}' is not an Elliptec address; use one of 0…9, A…F")
        wrong = faults if number == 0 else ()
        description = MODELS[SIMULATED.model_of(mount, model)]
        serial = f"{int(description.serial) + number:0{len(description.serial)}d}"
        stages.append(
            ElliptecFirmware(
                mount.axis, address=address, model=replace(description, serial=serial), faults=wrong
            )
        )
    return stages[0] if len(stages) == 1 else Bus(*stages)


SIMULATED = Simulated("Thorlabs Elliptec stage", tuple(MODELS), build, tuple(LINEAR))
