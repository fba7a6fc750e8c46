"""Acquisition settings of calibrations (`anisoscope.calibration`)."""

from dataclasses import dataclass

from anisoscope.base.errors import UsageError
from anisoscope.base.printable import check_printable

MIN_FRAMES, MAX_FRAMES = 2, 1024


@dataclass(frozen=True)
class Taking:
    """Acquisition settings of a calibration, and entries for its record.

    Attributes:
        exposure_s: exposure in seconds.
        gain: gain of the camera, as a factor.
        frames: frames to average.
        valid_days: days of validity; else the usual number for its kind.
        operator: operator, for the record.
        temperature_c: temperature in °C, for the record.
        light_channel: light channel of the rig file; its light.channel by default.

    Raises:
        UsageError: too few or too many frames, no exposure or gain, or an operator that cannot be printed.
    """

    exposure_s: float
    gain: float = 1.0
    frames: int = 16
    valid_days: float | None = None
    operator: str | None = None
    temperature_c: float | None = None
    light_channel: str | None = None

    def __post_init__(self) -> None:
        if not MIN_FRAMES <= self.frames <= MAX_FRAMES:
            raise UsageError(
                f"a calibration needs at least {MIN_FRAMES} frames and at most {MAX_FRAMES}, not {self.frames}"
            )
        if not (self.exposure_s > 0.0 and self.gain > 0.0):
            raise UsageError("exposure and gain must be more than 0")
        check_printable({"operator": self.operator})
