"""A simulated SMC100 controller without its line: states, parameters, motion."""

import re
from collections.abc import Iterable

from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.device import SimulatedDevice
from anisoscope.sim.bench.firmware.faults import Fault, FaultKind
from anisoscope.sim.bench.firmware.motor import Motion, Motor
from anisoscope.sim.bench.firmware.smc100_tables import (
    BAD_PARAMETER,
    CONFIGURATION,
    DISABLE_FROM_MOVING,
    DISABLE_FROM_READY,
    FOLLOWING_ERROR,
    FROM_CONFIGURATION,
    FROM_HOMING,
    FROM_RESET,
    HOMING,
    HOMING_TIME_OUT,
    LIVE,
    MODE_OF_CODE,
    MOVING,
    OUT_OF_LIMITS,
    READY_FROM_DISABLE,
    READY_FROM_HOMING,
    READY_FROM_MOVING,
    URS100CC,
    Mode,
    SmcModel,
)

RESTART_S = 3.0


class Smc100States(SimulatedDevice):
    """A controller, as far as it moves.

    Args:
        axis: the axis it turns; by default one that stands at 0° and moves in real time.
        address: 1 … 31.
        model: stage and configuration.
        faults: what is wrong with it; as text, ``name`` or ``name:number``.

    Raises:
        UsageError: there is no fault of this name.
    """

    def __init__(
        self,
        axis: RotaryAxis | None = None,
        *,
        address: int = 1,
        model: SmcModel = URS100CC,
        faults: Iterable[Fault | str] = (),
    ) -> None:
        self.axis = axis or RotaryAxis()
        super().__init__(faults, self.axis.clock)
        self.model = model
        self.address = address
        self.stage = model.stage
        self.stored = {**model.parameters, "SA": float(address)}
        self.motor = Motor(self.axis, 1.0 / model.step_deg, self.faults)
        self._faults_seen = 0
        self._busy_answers = int(self.faults.get(FaultKind.BUSY, 0))
        self._power_up()
        code = int(self.faults.get(FaultKind.LATCHED_ERROR, 0))
        self._error = chr(ord("@") + code)

    @property
    def counts(self) -> int:
        """Position in encoder increments, as the controller believes it to be."""
        return self.motor.counts

    @property
    def mode(self) -> Mode:
        """State, without where it came from."""
        return MODE_OF_CODE[self._code]

    def _fail(self, letter: str) -> None:
        """Keep an error until somebody asks for it."""
        self._error = letter

    def _power_up(self) -> None:
        self.motor.power_up()
        self.parameters = dict(self.stored)
        self._code = FROM_RESET
        self._faults_seen = 0
        self._target = 0
        self._error = "@"
        self._restarted_at = self._clock()

    def _repair(self) -> None:
        self.motor.repair()
        self._busy_answers = 0
        if self.motor.motion is None and self.mode in {Mode.MOVING, Mode.HOMING}:
            self._code = READY_FROM_MOVING

    def _restart(self) -> None:
        self.axis.stop()
        self._power_up()
        self._restarted_at = self._clock() + RESTART_S * self.axis.time_scale

    def _enable(self, value: str) -> None:
        if value not in {"0", "1"}:
            self._fail(BAD_PARAMETER)
        elif value == "0":
            self._code = DISABLE_FROM_READY
        elif self.mode is Mode.DISABLED:
            self._code = READY_FROM_DISABLE

    def _enter_configuration(self, value: str) -> None:
        if value not in {"0", "1"}:
            self._fail(BAD_PARAMETER)
        elif value == "1":
            self._code = CONFIGURATION
        elif self.mode is Mode.CONFIGURATION:
            self.stored = dict(self.parameters)
            self.address = int(self.parameters["SA"])
            self._code = FROM_CONFIGURATION

    def _configure(self, letters: str, value: str) -> None:
        usable = {Mode.READY, Mode.DISABLED} if letters in LIVE else set()
        if self.mode not in usable | {Mode.CONFIGURATION}:
            self._fail(self.mode.value)
        elif letters == "ID":
            self.stage = value or self.stage
        elif not re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)(E[-+]?\d+)?", value) or not self._plausible(
            letters, float(value)
        ):
            self._fail(BAD_PARAMETER)
        else:
            self.parameters[letters] = float(value)

    def _plausible(self, letters: str, value: float) -> bool:
        ranges = {"SL": (-1e12, 0.0), "SR": (0.0, 1e12), "HT": (0.0, 4.0), "SA": (2.0, 31.0)}
        low, high = ranges.get(letters, (0.0 if letters in {"BA", "BH"} else 1e-9, 1e12))
        return low <= value <= high

    # Motion.

    def _move(self, value: str, start_counts: int) -> None:
        try:
            away = round(float(value) / self.model.step_deg)
        except ValueError:
            self._fail(BAD_PARAMETER)
            return
        target = start_counts + away
        low, high = (self.parameters[name] / self.model.step_deg for name in ("SL", "SR"))
        if not low - 0.5 <= target <= high + 0.5:
            self._fail(OUT_OF_LIMITS)
        else:
            self._start(target)

    def _start(self, target_counts: int | None) -> None:
        """Start a move to a position in counts, or (None) the reference search."""
        if self.motor.count_motion():
            self._dead = True
        elif self._busy_answers > 0:
            self._busy_answers -= 1
            self._fail(Mode.MOVING.value)
        elif FaultKind.MOTION_ERROR in self.faults:
            self._fail(chr(ord("@") + int(self.faults[FaultKind.MOTION_ERROR])))
        else:
            self._target = target_counts or 0
            self._faults_seen = 0
            speed = self.parameters["OH" if target_counts is None else "VA"]
            self.axis.velocity_deg_s, self.axis.acceleration_deg_s2 = speed, self.parameters["AC"]
            self._code = HOMING if target_counts is None else MOVING
            if target_counts is None:
                self.motor.home()
            else:
                self.motor.move(target_counts)

    def _attend(self) -> None:
        ended = self.motor.ended()
        if ended is None or self.mode not in {Mode.HOMING, Mode.MOVING}:
            return
        homing = self.mode is Mode.HOMING
        if ended is Motion.STALL:
            self._faults_seen |= HOMING_TIME_OUT if homing else FOLLOWING_ERROR
            self._code = FROM_HOMING if homing else DISABLE_FROM_MOVING
        elif FaultKind.LOST_REPLY not in self.faults:
            self._code = READY_FROM_HOMING if homing else READY_FROM_MOVING

    def _stop(self) -> None:
        self.stops += 1
        self.motor.stop()
        if self.mode is Mode.HOMING:
            self._code = FROM_HOMING
        elif self.mode is Mode.MOVING:
            self._code = READY_FROM_MOVING
