"""Firmware of a Zaber stage with its own controller, byte by byte (ASCII protocol, firmware 7).

Commands end with CR, LF or both; one with a wrong checksum is ignored. A reply has number and checksum only if its
command did. Motions are answered at once; their end is found by polling the state. Before the reference search the
device counts from its position at power-up, reports WR, and rejects absolute moves. Several devices on a line answer a
broadcast one after the other. The simulated stages have motor encoders: an obstacle is reported as FS. Sources: Zaber
ASCII protocol manual; queries and replies of the maker's client `zaber-motion`. Not simulated: settings that need a
restart, streams, triggers, lockstep, parking, ``tools``, ``io``; they are BADCOMMAND. Assumed: ``move rel`` and ``move
vel`` work without a reference, and every fault and NI persist until ``warnings clear``.

Models and settings are in the device's own units. Sources: names, scopes and units of the settings from the Zaber
ASCII protocol manual and the setting names of the maker's client `zaber-motion`. Microsteps per turn of the X-RSW60
(384 000) and its top speed (115°/s) are as published by users of that stage; those of the others follow from their
gears (180:1 and 3:1, 200 steps of 64 microsteps). The X-LSM025A has the travel of 25.4 mm and the microsteps of
0.047625 µm of its data sheet, and no ``limit.cycle.dist``; its 20 mm/s are made up. These and all accelerations are
unverified. The device ids are placeholders that belong to no known product, because the maker's table was not
available.
"""

import re
from abc import abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Self

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, Simulated
from anisoscope.sim.bench.firmware.device import Bus, Firmware, SimulatedDevice
from anisoscope.sim.bench.firmware.faults import Fault, FaultKind
from anisoscope.sim.bench.firmware.motor import Motion, Motor

SPEED_FACTOR = 1.6384
ACCELERATION_FACTOR = SPEED_FACTOR / 1e4
FARTHEST = 1_000_000_000
HIGHEST_SPEED = 64 * 16384
MAX_ADDRESS = 99
DEVICE, AXIS = 0, 1


@dataclass(frozen=True)
class ZaberModel:
    """Model of a stage: id, microsteps per turn, top speed in degrees per second, acceleration setting.

    Attributes:
        counts_per_mm: of a linear stage, in place of those per turn; then the speed is in mm/s.
        travel_mm: travel of a linear stage.
    """

    device_id: int
    counts_per_turn: int
    velocity_deg_s: float
    accel: int
    serial: int = 68101
    version: str = "7.33"
    build: int = 12045
    counts_per_mm: float = 0.0
    travel_mm: float = 0.0

    @property
    def counts_per_deg(self) -> float:
        """Microsteps for one degree, or for 1 mm."""
        return self.counts_per_mm or self.counts_per_turn / 360.0

    @property
    def limits(self) -> tuple[int, int]:
        """Settings ``limit.min`` and ``limit.max`` as delivered."""
        return (0, round(self.travel_mm * self.counts_per_mm)) if self.travel_mm else (-FARTHEST, FARTHEST)

    @property
    def maxspeed(self) -> int:
        """The top speed as data of a setting."""
        return round(self.velocity_deg_s * self.counts_per_deg * SPEED_FACTOR)


X_RSW60A = ZaberModel(59060, 384_000, 115.0, 205)
X_RST120AK = ZaberModel(59120, 2_304_000, 24.0, 205)
X_RSB060AD = ZaberModel(59061, 38_400, 450.0, 20)
X_LSM025A = ZaberModel(59125, 0, 20.0, 205, counts_per_mm=1000.0 / 0.047625, travel_mm=25.4)
X_LSM050A = ZaberModel(59126, 0, 20.0, 205, counts_per_mm=1000.0 / 0.047625, travel_mm=50.8)
LINEAR = {"X-LSM025A": X_LSM025A, "X-LSM050A": X_LSM050A}
MODELS = {"X-RSW60A": X_RSW60A, "X-RST120AK": X_RST120AK, "X-RSB060AD": X_RSB060AD, **LINEAR}


@dataclass
class Setting:
    """A setting: its value, whether it belongs to the device or to the axis, and what may be written to it.

    Attributes:
        value: the value, or a function that measures it.
        scope: `DEVICE` or `AXIS`.
        lowest, highest: what may be written; nothing may be if they are the same.
    """

    value: int | str | Callable[[], int]
    scope: int
    lowest: int = 0
    highest: int = 0

    @property
    def text(self) -> str:
        """The value in the format of the device."""
        return str(self.value() if callable(self.value) else self.value)

    def takes(self, number: int) -> bool:
        """Whether the setting takes a number."""
        return self.lowest <= number <= self.highest

    @property
    def writable(self) -> bool:
        """Whether the setting can be written."""
        return self.lowest < self.highest


class Settings:
    """The settings of one stage.

    Args:
        model: what they are made from.
        address: address of the device.
        measured: settings of the axis that are measured when asked for.
    """

    def __init__(self, model: ZaberModel, address: int, measured: dict[str, Callable[[], int]]) -> None:
        self._by_name = {
            "deviceid": Setting(model.device_id, DEVICE),
            "device.id": Setting(model.device_id, DEVICE),
            "system.serial": Setting(model.serial, DEVICE),
            "system.axiscount": Setting(1, DEVICE),
            "system.access": Setting(1, DEVICE, 1, 2),
            "system.led.enable": Setting(1, DEVICE, 0, 1),
            "system.voltage": Setting("48.1", DEVICE),
            "system.temperature": Setting("31.5", DEVICE),
            "version": Setting(model.version, DEVICE),
            "version.build": Setting(model.build, DEVICE),
            "comm.address": Setting(address, DEVICE, 1, MAX_ADDRESS),
            "comm.alert": Setting(0, DEVICE, 0, 1),
            "comm.checksum": Setting(0, DEVICE, 0, 1),
            "comm.protocol": Setting(2, DEVICE),
            "comm.rs232.baud": Setting(115200, DEVICE),
            "comm.rs232.protocol": Setting(2, DEVICE),
            "limit.cycle.dist": Setting(model.counts_per_turn, AXIS, 0, FARTHEST),
            "limit.min": Setting(model.limits[0], AXIS, -FARTHEST, FARTHEST),
            "limit.max": Setting(model.limits[1], AXIS, -FARTHEST, FARTHEST),
            "limit.approach.maxspeed": Setting(model.maxspeed, AXIS, 1, HIGHEST_SPEED),
            "maxspeed": Setting(model.maxspeed, AXIS, 1, HIGHEST_SPEED),
            "accel": Setting(model.accel, AXIS, 0, 32767),
            "resolution": Setting(64, AXIS),
            "driver.temperature": Setting("33.0", AXIS),
            **{name: Setting(measure, AXIS) for name, measure in measured.items()},
        }

    def __getitem__(self, name: str) -> int:
        """The value of a setting that is a whole number."""
        return int(self._by_name[name].text)

    def __setitem__(self, name: str, value: int) -> None:
        self._by_name[name].value = value

    def get(self, name: str, axis: int) -> tuple[bool, str]:
        """Answer a query: whether it succeeds, and the answer or the reason of the failure."""
        setting = self._by_name.get(name)
        if setting is None:
            return False, "BADCOMMAND"
        if setting.scope < axis:
            return False, "DEVICEONLY"
        return True, setting.text

    def set(self, name: str, value: str, axis: int) -> tuple[bool, str]:
        """Write a setting: whether that was possible, and ``0`` or the reason why not."""
        setting = self._by_name.get(name)
        if setting is None or not setting.writable:
            return False, "BADCOMMAND"
        if setting.scope < axis:
            return False, "DEVICEONLY"
        try:
            number = int(value)
        except ValueError:
            return False, "BADDATA"
        if not setting.takes(number):
            return False, "BADDATA"
        setting.value = number
        return True, "0"


NO_REPLY = "--"
# What a warning flag can be, the gravest first; a fault with a number as its parameter counts in this list from 1.
FLAGS = ("FF", "FS", "FE", "FQ", "FI", "FA", "FT", "FP", "FO", "FD", "FM", "FV", "FR", "FH", "FC")
MILD_FLAGS = ("WL", "WV", "WT", "WS", "WM", "WR", "NC", "NI")
# These cut the motor off until the driver is enabled again.
CUTTING = frozenset({"FF", "FO", "FD", "FM", "FV", "FR", "FH", "FC"})
# Reasons of rejection; a fault with a number from 101 counts in this list from 101.
REASONS = (
    "BADDATA",
    "BADCOMMAND",
    "PARKED",
    "NOACCESS",
    "REMOTE",
    "LOCKSTEP",
    "INACTIVE",
    "FULL",
    "DRIVERDISABLED",
)
FIRST_REASON = 101
_LINE = re.compile(rb"/(?P<body>[^:]*)(?::(?P<lrc>[0-9A-Fa-f]{2}))?")


def lrc(body: bytes) -> int:
    """The checksum of a message: what makes the sum of its bytes zero, modulo 256."""
    return (0x100 - sum(body) % 0x100) % 0x100


@dataclass(frozen=True)
class Command:
    """One command; device 0 is everybody, axis 0 the device as a whole, and number "" is none."""

    device: int
    axis: int
    number: str
    words: tuple[str, ...]
    checked: bool

    @classmethod
    def parse(cls, line: bytes) -> Self | None:
        """Read a line without its end; None if it is no command, or its checksum is wrong."""
        start = line.rfind(b"/")
        match = _LINE.fullmatch(line[start:]) if start >= 0 else None
        if match is None:
            return None
        body = match["body"]
        if match["lrc"] is not None and int(match["lrc"], 16) != lrc(body):
            return None
        words = body.decode("ascii", errors="replace").split()
        device, axis = (int(words.pop(0)) if words and words[0].isdecimal() else 0 for _ in range(2))
        number = words.pop(0) if words and (words[0].isdecimal() or words[0] == NO_REPLY) else ""
        return cls(device, axis, number, tuple(words), match["lrc"] is not None)


def frame(kind: str, body: str, *, checked: bool) -> bytes:
    """A whole message to the host: ``@`` reply, ``#`` information, ``!`` alert."""
    data = body.encode("ascii", errors="replace")
    return kind.encode("ascii") + data + (b":%02X" % lrc(data) if checked else b"") + b"\r\n"


def flag_of_number(number: float) -> str:
    """Flag of a number, the parameter of a fault.

    Raises:
        UsageError: there is none.
    """
    if not 1 <= number <= len(FLAGS):
        raise UsageError(f"a Zaber stage has no fault {number:g}; choose 1…{len(FLAGS)}: {', '.join(FLAGS)}")
    return FLAGS[int(number) - 1]


def error_of_number(number: float) -> tuple[str, str]:
    """The flag that a motion ends with, and the reason why it is rejected; both empty for 0.

    Raises:
        UsageError: a number that stands for neither.
    """
    place = int(number) - FIRST_REASON
    if place >= len(REASONS):
        raise UsageError(
            f"a Zaber stage has no reason {number:g} to reject a motion; choose {FIRST_REASON}…"
            f"{FIRST_REASON + len(REASONS) - 1}: {', '.join(REASONS)}"
        )
    if place >= 0:
        return "", REASONS[place]
    return (flag_of_number(number), "") if number else ("", "")


STAGGER_S = 0.005
NUMBERS = 100
Answer = tuple[bool, str]
OK: Answer = (True, "0")
UNKNOWN: Answer = (False, "BADCOMMAND")
Handler = Callable[[Command], Answer]


class ZaberController(SimulatedDevice):
    """A device on the line, without its motor.

    Args:
        axis: the axis that it turns.
        address: address of the device, 1…99.
        model: id, serial number, scale and speed.
        faults: what is wrong with it.
        place: how many devices stand before it on the line.

    Attributes:
        settings: what ``get`` reads and ``set`` writes.
    """

    def __init__(
        self, axis: RotaryAxis, address: int, model: ZaberModel, faults: Iterable[Fault | str], place: int
    ) -> None:
        super().__init__(faults, axis.clock)
        self.axis = axis
        self.model = model
        self.settings = Settings(model, address, self._measured())
        self._place = place
        self._waiting: list[tuple[float, bytes]] = []

    @property
    @abstractmethod
    def flags(self) -> tuple[str, ...]:
        """Active warning flags, the gravest first."""

    @property
    @abstractmethod
    def busy(self) -> bool:
        """Whether it reports motion."""

    @abstractmethod
    def _measured(self) -> dict[str, Callable[[], int]]:
        """Settings of the axis that are measured when queried."""

    @abstractmethod
    def _motion_handlers(self) -> dict[str, Handler]:
        """Commands that this half does not know, by their first word."""

    @abstractmethod
    def _after(self, command: Command) -> None:
        """Something to do once a command has been answered."""

    @property
    def address(self) -> int:
        """Address of the device."""
        return self.settings["comm.address"]

    def connect(self) -> None:
        """A host opened the line: what was under way on it is forgotten."""
        with self._lock:
            super().connect()
            self._waiting.clear()

    # Packets.

    def _take_packet(self) -> bool:
        ends = [end for end in (self._inbox.find(b"\n"), self._inbox.find(b"\r")) if end >= 0]
        if not ends:
            return False
        line = bytes(self._inbox[: min(ends)])
        del self._inbox[: min(ends) + 1]
        command = Command.parse(line)
        if command is not None and command.device in {0, self.address}:
            self._take(line)
            self._obey(command)
        return True

    def _obey(self, command: Command) -> None:
        self._attend()
        speaker = self.address  # a command that changes the address is still answered from the old one
        accepted, data = self._answer_to(command)
        if command.number == NO_REPLY or self._dead:
            return
        verdict = f"{'OK' if accepted else 'RJ'} {self._state()} {data}"
        self._reply("@", command, speaker, verdict)
        if command.words[:1] == ("help",):
            for word in sorted(self._handlers()):
                self._reply("#", command, speaker, word)
        self._after(command)

    def _answer_to(self, command: Command) -> Answer:
        if command.number.isdecimal() and int(command.number) >= NUMBERS:
            return False, "BADMESSAGEID"
        if command.axis > 1:
            return False, "BADAXIS"
        if not command.words:
            return OK
        handler = self._handlers().get(command.words[0])
        return handler(command) if handler else UNKNOWN

    def _handlers(self) -> dict[str, Handler]:
        return {
            "get": self._get,
            "set": self._set,
            "renumber": self._renumber,
            "help": lambda _: OK,
            **self._motion_handlers(),
        }

    # Messages.

    def _state(self) -> str:
        return f"{'BUSY' if self.busy else 'IDLE'} {next(iter(self.flags), '--')}"

    def _reply(self, kind: str, command: Command, speaker: int, text: str) -> None:
        number = f"{int(command.number):02d} " if command.number else ""
        shown = speaker % MAX_ADDRESS + 1 if FaultKind.WRONG_ADDRESS in self.faults else speaker
        checked = command.checked or self.settings["comm.checksum"] == 1
        message = frame(kind, f"{shown:02d} {command.axis} {number}{text}", checked=checked)
        if command.device == 0 and self._place:  # to everybody is answered in the order of the line
            self._waiting.append((self._clock() + self._place * STAGGER_S, message))
        else:
            self._send(message)

    def _send_queued(self) -> None:
        while self._waiting and self._waiting[0][0] <= self._clock():
            self._send(self._waiting.pop(0)[1])

    def _alert(self) -> None:
        if self.settings["comm.alert"] == 1:
            text = f"{self.address:02d} 1 {self._state()}"
            self._send(frame("!", text, checked=self.settings["comm.checksum"] == 1))

    def _unsolicited(self) -> bytes:
        return f"!{self.address:02d} 1 IDLE --\r\n#{self.address:02d} 0 nobody asked\r\n".encode("ascii")

    # Settings.

    def _get(self, command: Command) -> Answer:
        names: Sequence[str] = command.words[1:]
        return self.settings.get(names[0], command.axis) if len(names) == 1 else UNKNOWN

    def _set(self, command: Command) -> Answer:
        match command.words[1:]:
            case (name, value):
                return self.settings.set(name, value, command.axis)
            case _:
                return UNKNOWN

    def _renumber(self, command: Command) -> Answer:
        first = command.words[1] if command.words[1:] else "1"
        if command.axis:
            return False, "DEVICEONLY"
        if not first.isdecimal():
            return False, "BADDATA"
        later = self._place if command.device == 0 else 0
        return self.settings.set("comm.address", str(int(first) + later), 0)


STALL_S = 0.2
NO_RAMP_DEG_S2 = 1e6


class ZaberFirmware(ZaberController):
    """One stage on the line.

    Args:
        axis: the axis it turns; its speed and acceleration become what the settings of the device say.
        address: address of the device, 1…99.
        model: id, serial number, scale and speed.
        faults: what is wrong with it; as text, ``name`` or ``name:number``.
        place: how many devices stand before it on the line.

    Raises:
        UsageError: there is no fault of this name or number.
    """

    def __init__(
        self,
        axis: RotaryAxis | None = None,
        *,
        address: int = 1,
        model: ZaberModel = X_RSW60A,
        faults: Iterable[Fault | str] = (),
        place: int = 0,
    ) -> None:
        super().__init__(axis or RotaryAxis(), address, model, faults, place)
        self.motor = Motor(self.axis, model.counts_per_deg, self.faults, stall_s=STALL_S)
        self._flags: set[str] = set()
        self._never_idle = False
        self._busy_answers = int(self.faults.get(FaultKind.BUSY, 0))
        if FaultKind.LATCHED_ERROR in self.faults:
            self._flags.add(flag_of_number(self.faults[FaultKind.LATCHED_ERROR]))
        error_of_number(self.faults.get(FaultKind.MOTION_ERROR, 0.0))

    @property
    def flags(self) -> tuple[str, ...]:
        """Active warning flags, the gravest first."""
        standing = self._flags if self.motor.referenced else self._flags | {"WR"}
        return tuple(flag for flag in FLAGS + MILD_FLAGS if flag in standing)

    @property
    def busy(self) -> bool:
        """Whether it reports motion."""
        return self.motor.motion is not None or self._never_idle

    def _measured(self) -> dict[str, Callable[[], int]]:
        return {
            "pos": lambda: self.motor.counts,
            "encoder.pos": lambda: self.motor.counts,
            "limit.home.triggered": lambda: int(self.motor.referenced),
            "driver.enabled": lambda: int(self._flags.isdisjoint(CUTTING)),
        }

    def _motion_handlers(self) -> dict[str, Handler]:
        return {
            "home": lambda _: self._begin(self._home),
            "move": self._move,
            "stop": lambda _: self._stop(),
            "estop": lambda _: self._stop(),
            "warnings": self._warnings,
            "driver": self._driver,
            "system": self._system,
        }

    def _after(self, command: Command) -> None:
        if command.words == ("get", "pos") and self.motor.loses_power():
            self._power_up()

    # State.

    def _warnings(self, command: Command) -> Answer:
        flags = self.flags
        if command.words[1:] == ("clear",):
            self._flags &= CUTTING
        elif command.words[1:]:
            return UNKNOWN
        return True, " ".join((f"{len(flags):02d}", *flags))

    def _driver(self, command: Command) -> Answer:
        match command.words[1:]:
            case ("enable",):
                self._flags -= CUTTING
            case ("disable",):
                self._end_with("FO")
            case _:
                return UNKNOWN
        return OK

    def _system(self, command: Command) -> Answer:
        if command.words[1:] != ("reset",):
            return UNKNOWN
        self._power_up()
        return OK

    def _power_up(self) -> None:
        self.axis.stop()
        self.motor.power_up()
        self._flags.clear()
        self._never_idle = False

    def _repair(self) -> None:
        self.motor.repair()
        self._flags.clear()
        self._never_idle = False
        self._busy_answers = 0

    # Motion.

    def _move(self, command: Command) -> Answer:
        """``min``, ``max``, or ``abs``, ``rel``, ``vel`` with a number; then optionally speed and acceleration."""
        kind, texts = (command.words[1], command.words[2:]) if command.words[1:] else ("", ())
        named = kind in {"min", "max"}
        if not (named or (kind in {"abs", "rel", "vel"} and texts)):
            return UNKNOWN
        try:
            numbers = [int(text) for text in texts]
        except ValueError:
            return False, "BADDATA"
        target = self.settings[f"limit.{kind}"] if named else numbers.pop(0)
        if kind == "vel":
            numbers.insert(0, abs(target))
            target = self._end_toward(target)
        elif kind == "rel":
            target += self.motor.counts
        elif not self.motor.referenced:
            return False, "BADDATA"
        speed, accel = (*numbers, *(self.settings["maxspeed"], self.settings["accel"])[len(numbers) :])[:2]
        reachable = self.settings["limit.min"] <= target <= self.settings["limit.max"]
        if not reachable or not 0 <= speed <= HIGHEST_SPEED or accel < 0:
            return False, "BADDATA"
        return self._begin(lambda: self._go(target, speed, accel))

    def _end_toward(self, speed: int) -> int:
        if speed == 0:
            return self.motor.counts
        return self.settings["limit.max" if speed > 0 else "limit.min"]

    def _begin(self, begin: Callable[[], None]) -> Answer:
        """Start a motion, unless something is wrong that forbids it."""
        flag, reason = error_of_number(self.faults.get(FaultKind.MOTION_ERROR, 0.0))
        if self.motor.count_motion():
            self._dead = True
            return OK
        if not self._flags.isdisjoint(CUTTING):
            return False, "DRIVERDISABLED"
        if self._busy_answers > 0:
            self._busy_answers -= 1
            return False, "STATUSBUSY"
        if reason:
            return False, reason
        if self.motor.motion is not None:
            self._flags.add("NI")
        self._never_idle = False
        begin()
        if flag:
            self._end_with(flag)
        return OK

    def _end_with(self, flag: str) -> None:
        self.motor.stop()
        self._flags.add(flag)

    def _home(self) -> None:
        self._set_pace(self.settings["maxspeed"], self.settings["accel"])
        self.motor.home()

    def _go(self, target_counts: int, speed: int, accel: int) -> None:
        self._set_pace(speed, accel)
        self.motor.move(target_counts)

    def _set_pace(self, speed: int, accel: int) -> None:
        self.axis.stop()
        per_deg = self.model.counts_per_deg
        self.axis.velocity_deg_s = max(speed, 1) / SPEED_FACTOR / per_deg
        self.axis.acceleration_deg_s2 = accel / ACCELERATION_FACTOR / per_deg if accel else NO_RAMP_DEG_S2

    def _attend(self) -> None:
        self._send_queued()
        ended = self.motor.ended()
        if ended is None:
            return
        if ended is Motion.STALL:
            self._flags.add("FS")
        if FaultKind.LOST_REPLY in self.faults:
            self._never_idle = True
        else:
            self._alert()

    def _stop(self) -> Answer:
        self.stops += 1
        self._never_idle = False
        if self.motor.stop() is not None:
            self._flags.add("NI")
            self._alert()
        return OK


def build(mounts: Sequence[Mount], model: str, faults: Sequence[str]) -> Firmware:
    """One stage an axis, at the addresses of the mounts; serial numbers count on from that of the model."""
    stages = []
    for place, mount in enumerate(mounts):
        address = mount.address or str(place + 1)
        if not address.isdecimal() or not 1 <= int(address) <= MAX_ADDRESS:
            raise UsageError(f"'{address}' is not a Zaber address; use one of 1…{MAX_ADDRESS}")
        wrong = faults if place == 0 else ()
        own = MODELS[SIMULATED.model_of(mount, model)]
        description = replace(own, serial=own.serial + place)
        stages.append(
            ZaberFirmware(mount.axis, address=int(address), model=description, faults=wrong, place=place)
        )
    return stages[0] if len(stages) == 1 else Bus(*stages)


SIMULATED = Simulated("Zaber stage (ASCII)", tuple(MODELS), build, tuple(LINEAR))
