"""What a simulated Grbl board keeps when it is switched off: its settings, and the models that differ in them.

Source: the interface description of Grbl 1.1 (settings, error codes).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

AXES = "XYZ"
NEGATIVE_VALUE, HOMING_DISABLED, SHORT_PULSE, SOFT_LIMIT_NEEDS_HOMING, INVALID_STATEMENT = 4, 5, 6, 10, 3
STEPS, RATE, ACCELERATION, TRAVEL = 100, 110, 120, 130
STEP_PULSE, REPORT, INCHES, SOFT_LIMITS, HARD_LIMITS, HOMING = 0, 10, 13, 20, 21, 22
HOMING_DIRECTION, HOMING_FEED, HOMING_SEEK, PULL_OFF = 23, 24, 25, 27
_WHOLE = frozenset({0, 1, 2, 3, 4, 5, 6, 10, 13, 20, 21, 22, 23, 26, 30, 31, 32})
_SWITCHES = frozenset({4, 5, 6, 13, 20, 21, 22, 32})
_COMMON: Mapping[int, float] = {
    **dict.fromkeys((2, 3, 4, 5, 6, 13, 20, 21, 22, 31, 32), 0.0),
    0: 10.0,
    1: 255.0,
    10: 1.0,
    11: 0.010,
    12: 0.002,
    23: 3.0,
    24: 200.0,
    25: 3600.0,
    26: 250.0,
    27: 1.0,
    30: 1000.0,
    102: 250.0,
    112: 500.0,
    122: 10.0,
    132: 200.0,
}


@dataclass(frozen=True)
class GrblModel:
    """A board with what hangs on it; X turns, Y tilts.

    Attributes:
        settings: its settings as delivered, by number.
        version: firmware release.
        build: date of the firmware.
        options: letters of the compiled options, as in the answer to ``$I``; H homes axes one by one.
        resets_on_connect: whether opening the port resets the board (the DTR line of an Arduino).
    """

    settings: Mapping[int, float]
    version: str = "1.1h"
    build: str = "20190830"
    options: str = "V"
    resets_on_connect: bool = True


def _axis(axis: int, steps: float, rate: float, acceleration: float, travel: float) -> dict[int, float]:
    return {STEPS + axis: steps, RATE + axis: rate, ACCELERATION + axis: acceleration, TRAVEL + axis: travel}


_SWITCHED = {**_COMMON, SOFT_LIMITS: 1.0, HARD_LIMITS: 1.0, HOMING: 1.0}
# 200 steps, 16 microsteps, gear 10:1; the pull-off angle is outside of the 0°…360° that can be used.
UNO = GrblModel(
    {**_SWITCHED, **_axis(0, 88.889, 18000.0, 2000.0, 361.0), **_axis(1, 88.889, 6000.0, 500.0, 121.0)}
)
# 200 steps, 16 microsteps, belt 3:1; no switch at all.
BELT = GrblModel(
    {**_COMMON, **_axis(0, 26.667, 21600.0, 1500.0, 360.0), **_axis(1, 53.333, 6000.0, 500.0, 120.0)}
)
# 32-bit board with its own USB: worm gear 90:1, no reset line, axes home one by one.
NATIVE_USB = GrblModel(
    {**_SWITCHED, **_axis(0, 800.0, 3600.0, 500.0, 361.0), **_axis(1, 800.0, 1800.0, 200.0, 121.0)},
    options="VH",
    resets_on_connect=False,
)
MODELS = {"uno": UNO, "a4988-belt": BELT, "native-usb": NATIVE_USB}


@dataclass
class Memory:
    """Memory that survives a power cycle.

    Attributes:
        settings: by number.
        offsets: origins of G54 … G59 and the places of G28 and G30, (x, y, z), by number.
        startup: the two start-up lines.
        note: the user's text in ``$I``.
    """

    settings: dict[int, float]
    offsets: dict[int, tuple[float, float, float]] = field(
        default_factory=lambda: dict.fromkeys((*range(54, 60), 28, 30), (0.0, 0.0, 0.0))
    )
    startup: list[str] = field(default_factory=lambda: ["", ""])
    note: str = ""

    def whole(self, number: int) -> int:
        """A setting that is a whole number."""
        return int(self.settings[number])

    def store(self, number: int, value: float) -> int:
        """Change a setting; returns the error code, 0 if accepted."""
        if number not in self.settings:
            return INVALID_STATEMENT
        if value < 0.0:
            return NEGATIVE_VALUE
        if number == STEP_PULSE and value < 3.0:
            return SHORT_PULSE
        if number == SOFT_LIMITS and value and not self.settings[HOMING]:
            return SOFT_LIMIT_NEEDS_HOMING
        if number in _SWITCHES:
            value = float(bool(value))
        self.settings[number] = float(int(value)) if number in _WHOLE else value
        if number == HOMING and not value:
            self.settings[SOFT_LIMITS] = 0.0
        return 0

    def lines(self) -> list[str]:
        """The settings as ``$$`` lists them."""
        return [
            f"${number}={int(value)}" if number in _WHOLE else f"${number}={value:.3f}"
            for number, value in sorted(self.settings.items())
        ]
