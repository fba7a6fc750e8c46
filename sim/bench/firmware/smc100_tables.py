"""What a simulated SMC100 controller knows by heart: its models, its error texts, and what is allowed in which state.

Source: Newport SMC100CC/PP user's manual.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum


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
    "ZX": frozenset({Mode.CONFIGURATION}),
}
ANSWERED = frozenset({"ID", "MM", "PA", "PR", "PT", "PW", "TB", "TE", "TH", "TP", "TS", "VE", "ZT", "ZX"})
# Parameters that may be changed while the stage is in use as well, though only until the next restart.
LIVE = frozenset({"AC", "JR", "SL", "SR", "VA"})


@dataclass(frozen=True)
class SmcModel:
    """A controller with its stage.

    Attributes:
        stage: name of the stage, as ID tells it.
        version: as VE tells it.
        parameters: configuration, by letters; SU is the encoder increment in degrees.
    """

    stage: str
    version: str
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def step_deg(self) -> float:
        """Encoder increment."""
        return self.parameters["SU"]


_COMMON = {
    "BA": 0.0,
    "BH": 0.0,
    "FE": 1.0,
    "HT": 2.0,
    "JR": 0.04,
    "OT": 30.0,
    "SA": 1.0,
    "SL": 0.0,
    "SR": 360.0,
}
URS100CC = SmcModel(
    "URS100CC", "SMC_CC_1.0.0", {**_COMMON, "AC": 160.0, "OH": 20.0, "SU": 0.0005, "VA": 40.0}
)
PR50CC = SmcModel("PR50CC", "SMC_CC_1.0.0", {**_COMMON, "AC": 80.0, "OH": 10.0, "SU": 0.001, "VA": 20.0})
AG_PR100P = SmcModel(
    "AG-PR100P", "Conex-AGP 1.0.0", {**_COMMON, "AC": 8.0, "OH": 1.0, "SU": 0.0005, "SR": 340.0, "VA": 2.0}
)
MODELS = {"urs100cc": URS100CC, "pr50cc": PR50CC, "conex-agp": AG_PR100P}
