"""Firmware of a Newport SMC100 or CONEX controller with its stage, byte by byte.

A query is answered with address, letters and value; a command is not answered. An error is stored as a letter
until it is read by TE or TB. A home search is accepted only without a reference: for a second one the
controller must be restarted, and does not answer meanwhile. A stage with encoder (CC) detects an obstacle: the
motor is disabled with a following error. A stepper (PP) loses steps and notices nothing. The controller with
the RS-232 socket answers to address 1, whatever its RS-485 address (SA) is. Tables hold the models, the error
texts, and the commands allowed in each state. Sources: Newport SMC100CC/PP user's manual; order of the lines of
ZT, the set of a PP, and address 1 beside SA as the published client hvl_ccb reads them.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, Simulated
from anisoscope.sim.bench.firmware.device import Bus, Firmware, SimulatedDevice
from anisoscope.sim.bench.firmware.faults import Fault, FaultKind
from anisoscope.sim.bench.firmware.motor import Motion, Motor


class Mode(StrEnum):
    """The states in groups; the value is the letter of the error with which a command is refused in it."""

    NOT_REFERENCED = "H"
    CONFIGURATION = "I"
    DISABLED = "J"
    READY = "K"
    HOMING = "L"
    MOVING = "M"


CODES: Mapping[Mode, tuple[int, ...]] = {
    Mode.NOT_REFERENCED: tuple(range(0x0A, 0x12)),
    Mode.CONFIGURATION: (0x14,),
    Mode.HOMING: (0x1E, 0x1F),
    Mode.MOVING: (0x28,),
    Mode.READY: (0x32, 0x33, 0x34, 0x35),
    Mode.DISABLED: (0x3C, 0x3D, 0x3E),
}
MODE_OF_CODE = {code: mode for mode, codes in CODES.items() for code in codes}
FROM_RESET, FROM_HOMING, FROM_CONFIGURATION = 0x0A, 0x0B, 0x0C
CONFIGURATION, HOMING, MOVING = 0x14, 0x1E, 0x28
READY_FROM_HOMING, READY_FROM_MOVING, READY_FROM_DISABLE = 0x32, 0x33, 0x34
DISABLE_FROM_READY, DISABLE_FROM_MOVING = 0x3C, 0x3D
FOLLOWING_ERROR, HOMING_TIME_OUT = 1 << 5, 1 << 6
UNKNOWN, BAD_ADDRESS, BAD_PARAMETER, NOT_ALLOWED, OUT_OF_LIMITS = "A", "B", "C", "D", "G"
ERROR_TEXTS = {
    "@": "No error",
    "A": "Unknown message code or floating point controller address",
    "B": "Controller address not correct",
    "C": "Parameter missing or out of range",
    "D": "Command not allowed",
    "E": "Home sequence already started",
    "F": "ESP stage name unknown",
    "G": "Displacement out of limits",
    "H": "Command not allowed in NOT REFERENCED state",
    "I": "Command not allowed in CONFIGURATION state",
    "J": "Command not allowed in DISABLE state",
    "K": "Command not allowed in READY state",
    "L": "Command not allowed in HOMING state",
    "M": "Command not allowed in MOVING state",
    "N": "Current position out of software limit",
    "S": "Communication time out",
    "U": "Error during EEPROM access",
    "V": "Error during command execution",
    "W": "Command not allowed for PP version",
    "X": "Command not allowed for CC version",
}
# In which states a command is carried out; a parameter with a question mark may be asked for in every state.
ALLOWED: Mapping[str, frozenset[Mode]] = {
    "MM": frozenset({Mode.READY, Mode.DISABLED}),
    "OR": frozenset({Mode.NOT_REFERENCED}),
    "PA": frozenset({Mode.READY}),
    "PR": frozenset({Mode.READY}),
    "PW": frozenset({Mode.NOT_REFERENCED, Mode.CONFIGURATION}),
    "RS": frozenset({Mode.NOT_REFERENCED, Mode.CONFIGURATION, Mode.READY, Mode.DISABLED}),
    "ST": frozenset(Mode) - {Mode.CONFIGURATION, Mode.DISABLED},
}
ANSWERED = frozenset({"ID", "MM", "PA", "PR", "PT", "PW", "TB", "TE", "TH", "TP", "TS", "VE", "ZT"})
# Parameters that may be changed while the stage is in use as well, though only until the next restart.
LIVE = frozenset({"AC", "JR", "SL", "SR", "VA"})


@dataclass(frozen=True)
class SmcModel:
    """A controller with its stage.

    Attributes:
        stage: name of the stage, the answer to ID.
        version: the answer to VE.
        parameters: configuration, by letters. SU (CC) is the encoder increment in degrees; FRS and FRM (PP) are degrees
            a full step and microsteps in it. Of a linear stage all are in mm.
    """

    stage: str
    version: str
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def step_deg(self) -> float:
        """Encoder increment, or microstep, in degrees."""
        if self.stepper:
            return self.parameters["FRS"] / self.parameters["FRM"]
        return self.parameters["SU"]

    @property
    def stepper(self) -> bool:
        """Whether the motor is a stepper (PP) instead of a servo with an encoder (CC)."""
        return "FRM" in self.parameters


_COMMON = {
    "BA": 0.0,
    "BH": 0.0,
    "HT": 2.0,
    "JR": 0.04,
    "OT": 30.0,
    "SL": 0.0,
    "SR": 360.0,
    "ZX": 3.0,
}
_SERVO = {**_COMMON, "FE": 1.0}
_STEPPER = {**_COMMON, "FRM": 100.0, "FRS": 0.02, "QIL": 1.0, "VB": 0.0}
URS100CC = SmcModel("URS100CC", "SMC_CC_1.0.0", {**_SERVO, "AC": 160.0, "OH": 20.0, "SU": 0.0005, "VA": 40.0})
PR50CC = SmcModel("PR50CC", "SMC_CC_1.0.0", {**_SERVO, "AC": 80.0, "OH": 10.0, "SU": 0.001, "VA": 20.0})
URS75PP = SmcModel("URS75PP", "SMC_PP_1.0.0", {**_STEPPER, "AC": 80.0, "OH": 10.0, "VA": 20.0})
AG_PR100P = SmcModel(
    "AG-PR100P", "Conex-AGP 1.0.0", {**_SERVO, "AC": 8.0, "OH": 1.0, "SU": 0.0005, "SR": 340.0, "VA": 2.0}
)
# 25 mm from their middle, where the home is.
MFA_CC = SmcModel(
    "MFA-CC",
    "SMC_CC_1.0.0",
    {**_SERVO, "AC": 1.6, "OH": 0.2, "SL": -12.5, "SR": 12.5, "SU": 0.00005, "VA": 0.3},
)
MFA_PP = SmcModel(
    "MFA-PP",
    "SMC_PP_1.0.0",
    {**_STEPPER, "AC": 1.2, "FRS": 0.01, "OH": 0.15, "SL": -12.5, "SR": 12.5, "VA": 0.3},
)
LINEAR = {"mfa-cc": MFA_CC, "mfa-pp": MFA_PP}
MODELS = {"urs100cc": URS100CC, "pr50cc": PR50CC, "urs75pp": URS75PP, "conex-agp": AG_PR100P, **LINEAR}
# Parameters of the other kind of motor, which are refused with a letter of their own.
SERVO_ONLY = frozenset({"FD", "FE", "FF", "KD", "KI", "KP", "KV", "SC", "SU"})
STEPPER_ONLY = frozenset({"FRM", "FRS", "VB"})
NOT_FOR_STEPPERS, NOT_FOR_SERVOS = "W", "X"
FIRST, FIRST_RS485 = 1, 2


RESTART_S = 3.0


class Smc100States(SimulatedDevice):
    """States of a controller.

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
        self.stored = {**model.parameters, "SA": float(max(address, FIRST_RS485))}
        self.motor = Motor(self.axis, 1.0 / model.step_deg, self.faults)
        self._faults_seen = 0
        self._busy_answers = int(self.faults.get(FaultKind.BUSY, 0))
        self._power_up()
        code = int(self.faults.get(FaultKind.LATCHED_ERROR, 0))
        self._error = chr(ord("@") + code)

    @property
    def counts(self) -> int:
        """Position in encoder increments or microsteps, as the controller believes it to be."""
        return self.motor.counts + self._slipped

    @property
    def mode(self) -> Mode:
        """State, without where it came from."""
        return MODE_OF_CODE[self._code]

    def _fail(self, letter: str) -> None:
        """Store an error until it is queried."""
        self._error = letter

    def _power_up(self) -> None:
        self.motor.power_up()
        self.parameters = dict(self.stored)
        self._code = FROM_RESET
        self._faults_seen = 0
        self._target = self._slipped = 0
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
            if self.address != FIRST:
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
        ranges = {
            "SL": (-1e12, 0.0),
            "SR": (0.0, 1e12),
            "HT": (0.0, 4.0),
            "SA": (2.0, 31.0),
            "ZX": (1.0, 3.0),
        }
        low, high = ranges.get(letters, (0.0 if letters in {"BA", "BH", "VB"} else 1e-9, 1e12))
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
                self.motor.move(target_counts - self._slipped)

    def _attend(self) -> None:
        ended = self.motor.ended()
        if ended is None or self.mode not in {Mode.HOMING, Mode.MOVING}:
            return
        homing = self.mode is Mode.HOMING
        if ended is Motion.STALL and (homing or not self.model.stepper):
            self._faults_seen |= HOMING_TIME_OUT if homing else FOLLOWING_ERROR
            self._code = FROM_HOMING if homing else DISABLE_FROM_MOVING
            return
        if homing:
            self._slipped = 0
        elif ended is Motion.STALL:
            self._slipped = self._target - self.motor.counts
        if FaultKind.LOST_REPLY not in self.faults:
            self._code = READY_FROM_HOMING if homing else READY_FROM_MOVING

    def _stop(self) -> None:
        self.stops += 1
        self.motor.stop()
        if self.mode is Mode.HOMING:
            self._code = FROM_HOMING
        elif self.mode is Mode.MOVING:
            self._code = READY_FROM_MOVING


LINE_LENGTH = 80
_COMMAND = re.compile(r"(\d*)(FRM|FRS|QIL|[A-Z]{2})(.*)$")


class Smc100Firmware(Smc100States):
    """One controller on the line; arguments and errors are those of `Smc100States`."""

    def _take_packet(self) -> bool:
        end = self._inbox.find(b"\r\n")
        if end < 0:
            del self._inbox[:-LINE_LENGTH]
            return False
        raw = bytes(self._inbox[:end])
        del self._inbox[: end + 2]
        line = raw.decode("latin-1").replace(" ", "").upper()
        match = _COMMAND.search(line)
        self._attend()
        if match is None or self._dead or self._clock() < self._restarted_at:
            return True
        address, letters, value = match.groups()
        if not address and letters == "ST":  # the general stop, of every controller on the line
            self._obey(letters, value)
        elif not address:
            self._fail(BAD_ADDRESS)
        elif int(address) == self.address:
            self._take(letters.encode("ascii") + value.encode("latin-1"))
            self._obey(letters, value)
        return True

    def _obey(self, letters: str, value: str) -> None:
        question = value == "?" or (letters in {"TB", "TE", "TH", "TP", "TS", "VE", "ZT"})
        if question and letters in ANSWERED:
            self._answers()[letters](value.removesuffix("?"))
        elif question and letters in self.parameters:
            self._answer(letters, self._number(self.parameters[letters]))
        elif letters in self.parameters or letters == "ID":
            self._configure(letters, value)
        elif letters in SERVO_ONLY and self.model.stepper:
            self._fail(NOT_FOR_STEPPERS)
        elif letters in STEPPER_ONLY and not self.model.stepper:
            self._fail(NOT_FOR_SERVOS)
        elif letters not in ALLOWED:
            self._fail(UNKNOWN)
        elif self.mode not in ALLOWED[letters]:
            if letters == "ST":
                self.stops += 1
            self._fail(self.mode.value)
        else:
            self._handlers()[letters](value)

    def _answers(self) -> dict[str, Callable[[str], None]]:
        answer = self._answer
        enabled = int(self.mode in {Mode.READY, Mode.MOVING})
        return {
            "ID": lambda _: answer("ID", self.stage),
            "MM": lambda _: answer("MM", str(enabled)),
            "PA": lambda _: answer("PA", self._degrees(self._target)),
            "PR": lambda _: answer("PR", self._degrees(self._target)),
            "PT": lambda _: answer("PT", f"{0.0:.3f}"),
            "PW": lambda _: answer("PW", str(int(self.mode is Mode.CONFIGURATION))),
            "TB": self._report_text,
            "TE": lambda _: self._report_error(),
            "TH": lambda _: answer("TH", self._degrees(self.counts)),
            "TP": lambda _: self._report_position(),
            "TS": lambda _: self._report_state(),
            "VE": lambda _: answer("VE", self.model.version),
            "ZT": lambda _: self._report_all(),
        }

    def _handlers(self) -> dict[str, Callable[[str], None]]:
        return {
            "MM": self._enable,
            "OR": lambda _: self._start(None),
            "PA": lambda value: self._move(value, 0),
            "PR": lambda value: self._move(value, self.counts),
            "PW": self._enter_configuration,
            "RS": lambda _: self._restart(),
            "ST": lambda _: self._stop(),
        }

    # Answers.

    def _answer(self, letters: str, value: str) -> None:
        speaker = self.address % 31 + 1 if FaultKind.WRONG_ADDRESS in self.faults else self.address
        self._send(f"{speaker}{letters}{value}\r\n".encode("ascii"))

    def _unsolicited(self) -> bytes:
        # What another controller on the line answered to another host's question.
        return f"{(self.address + 11) % 31 + 1}TP12.34500\r\n".encode("ascii")

    def _number(self, value: float) -> str:
        return f"{value:.6f}".rstrip("0").rstrip(".")

    def _degrees(self, counts: int) -> str:
        return f"{counts * self.model.step_deg:.5f}"

    def _report_error(self) -> None:
        self._answer("TE", self._error)
        self._error = "@"

    def _report_text(self, letter: str) -> None:
        code = letter or self._error
        if not letter:
            self._error = "@"
        self._answer("TB", f"{code} {ERROR_TEXTS.get(code, 'Unknown')}")

    def _report_position(self) -> None:
        self._answer("TP", self._degrees(self.counts))
        if self.motor.loses_power():
            self._power_up()

    def _report_state(self) -> None:
        self._answer("TS", f"{self._faults_seen:04X}{self._code:02X}")
        if self.mode in {Mode.READY, Mode.DISABLED}:
            self._faults_seen = 0

    def _report_all(self) -> None:
        """The configuration as the lines that would set it, between PW1 and PW0: the stage first, then by letters."""
        self._answer("PW", "1")
        self._answer("ID", self.stage)
        for letters, value in sorted(self.parameters.items()):
            self._answer(letters, self._number(value))
        self._answer("PW", "0")


def build(mounts: Sequence[Mount], model: str, faults: Sequence[str]) -> Firmware:
    """One controller an axis, at the addresses of the mounts."""
    controllers = []
    for number, mount in enumerate(mounts, start=1):
        address = mount.address or str(number)
        if not address.isdecimal() or not 1 <= int(address) <= 31:
            raise UsageError(f"'{address}' is no address of an SMC100 controller; use one of 1…31")
        wrong = faults if number == 1 else ()
        controllers.append(
            Smc100Firmware(
                mount.axis, address=int(address), model=MODELS[SIMULATED.model_of(mount, model)], faults=wrong
            )
        )
    return controllers[0] if len(controllers) == 1 else Bus(*controllers)


SIMULATED = Simulated("Newport SMC100 or CONEX controller", tuple(MODELS), build, tuple(LINEAR))
