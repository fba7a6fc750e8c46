"""Firmware of a Zaber rotary stage with its own controller, byte by byte (ASCII protocol, firmware 7).

Commands end with CR, LF or both; one with a wrong checksum is ignored. A reply bears number and checksum only if
its command did. Motions are answered at once and followed by asking for the state. Before the reference search the
device counts from where it stood at power-up, shows WR, and rejects absolute moves. Several on a line answer a
command to everybody one after the other. The simulated stages have motor encoders: an obstacle shows as FS.
Sources: Zaber ASCII protocol manual, and what the maker's client `zaber-motion` asks and understands. Not simulated:
settings that need a restart, streams, triggers, lockstep, parking, ``tools``, ``io``; they are BADCOMMAND. Assumed:
``move rel`` and ``move vel`` work without a reference, and every fault and NI stand until ``warnings clear``.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, Simulated
from anisoscope.sim.bench.firmware.device import Bus, Firmware
from anisoscope.sim.bench.firmware.faults import Fault, FaultKind
from anisoscope.sim.bench.firmware.motor import Motion, Motor
from anisoscope.sim.bench.firmware.zaber_controller import OK, UNKNOWN, Answer, Handler, ZaberController
from anisoscope.sim.bench.firmware.zaber_settings import (
    ACCELERATION_FACTOR,
    HIGHEST_SPEED,
    MAX_ADDRESS,
    MODELS,
    SPEED_FACTOR,
    X_RSW60A,
    ZaberModel,
)
from anisoscope.sim.bench.firmware.zaber_wire import (
    CUTTING,
    FLAGS,
    MILD_FLAGS,
    Command,
    error_of_number,
    flag_of_number,
)

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
        """The warning flags that stand, the gravest first."""
        standing = self._flags if self.motor.referenced else self._flags | {"WR"}
        return tuple(flag for flag in FLAGS + MILD_FLAGS if flag in standing)

    @property
    def busy(self) -> bool:
        """Whether it says that it moves."""
        return self.motor.motion is not None or self._never_idle

    def _measured(self) -> dict[str, Callable[[], int]]:
        return {
            "pos": lambda: self.motor.counts,
            "encoder.pos": lambda: self.motor.counts,
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
        """``min``, ``max``, or ``abs``, ``rel``, ``vel`` with a number; then, if wanted, speed and acceleration."""
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
        self._say_what_waited()
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
        made = replace(MODELS[model], serial=MODELS[model].serial + place)
        stages.append(ZaberFirmware(mount.axis, address=int(address), model=made, faults=wrong, place=place))
    return stages[0] if len(stages) == 1 else Bus(*stages)


SIMULATED = Simulated("Zaber rotary stage (ASCII)", tuple(MODELS), build)
