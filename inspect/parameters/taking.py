"""Settings of pictures, searches and scans of a rig."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from anisoscope.base.errors import UsageError
from anisoscope.base.printable import check_printable
from anisoscope.parameters.inspecting import PartFrames
from anisoscope.parameters.ridges import LIKELY_PITCH

FocusMeasure = Literal["tenengrad", "laplacian"]
LightState = Literal["on", "off", "as-is"]
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


@dataclass(frozen=True)
class Shot:
    """Exposure and light of a picture.

    Attributes:
        exposure_s: exposure in seconds.
        gain: gain as a factor.
        light: light while the picture is taken; as-is leaves it alone, and asks nobody to switch it.
        channel: light channel of the rig file; its light.channel by default.
    """

    exposure_s: float
    gain: float = 1.0
    light: LightState = "on"
    channel: str | None = None


@dataclass(frozen=True)
class Sweep:
    """Search for the focus.

    Attributes:
        low: reading of z in mm at which the search begins.
        high: reading of z in mm at which it ends.
        steps: number of readings in a sweep.
        repeats: fine sweeps; two or more tell the repeatability.
        measure: focus measure.
        average: frames averaged at each reading.

    Raises:
        UsageError: ends in the wrong order, or a number below 1.
    """

    low: float
    high: float
    steps: int = 15
    repeats: int = 3
    measure: FocusMeasure = "tenengrad"
    average: int = 1

    def __post_init__(self) -> None:
        if not (self.low < self.high and self.steps >= 1 and self.repeats >= 1 and self.average >= 1):
            raise UsageError("--from must be below --to, and --steps, --repeat and --average 1 or more")


@dataclass(frozen=True)
class Watching:
    """Pictures that are watched.

    Attributes:
        focus: focus measure.
        frames: end after so many frames.
        fps: frames per second at most.

    Raises:
        UsageError: a number outside its range.
    """

    focus: FocusMeasure = "tenengrad"
    frames: int | None = None
    fps: float = 10.0

    def __post_init__(self) -> None:
        if self.frames is not None and self.frames < 1:
            raise UsageError(f"--count must be 1 or more, not {self.frames}")
        if not 0.0 < self.fps <= 1000.0:
            raise UsageError(f"--fps must lie above 0 and up to 1000, not {self.fps:g}")


@dataclass(frozen=True)
class ScanExtent:
    """Extent of a scan over stage and tilt.

    Attributes:
        tilt_deg: largest tilt of the scan in degrees.
        stages: number of stage angles.
        tilts: number of tilts.
        exposure_s: shortest exposure in seconds; that of the recipe by default.

    Raises:
        UsageError: an exposure that is none.
    """

    tilt_deg: float = 20.0
    stages: int = 24
    tilts: int = 13
    exposure_s: float | None = None

    def __post_init__(self) -> None:
        if self.exposure_s is not None and not 0.0 < self.exposure_s < float("inf"):
            raise UsageError(f"--exposure takes a positive number of seconds, not {self.exposure_s:g}")


@dataclass(frozen=True)
class Entry:
    """Entries of a measured file.

    Attributes:
        valid_days: days of validity; else the usual number for its kind.
        operator: operator, for the record.

    Raises:
        UsageError: an operator that cannot be printed.
    """

    valid_days: float | None = None
    operator: str | None = None

    def __post_init__(self) -> None:
        check_printable({"--operator": self.operator})


@dataclass(frozen=True)
class MaterialEntry(Entry):
    """Entries of a material file, and the lobe that is fitted.

    Attributes:
        name: name of the plastic; else that of the file.
        lobe: family of lobes; auto: the one that fits better.
    """

    name: str | None = None
    lobe: Literal["auto", "tail", "second-lobe"] = "auto"


@dataclass(frozen=True)
class MaterialScan(PartFrames):
    """Readings of a specimen of plastic, or how it is scanned.

    Attributes:
        readings: instead of a scan: CSV stage_deg,tilt_deg,value[,u].
        max_tilt_deg: largest tilt of the scan in degrees.
        step_deg: step of the tilt in degrees; 2.5 for a coupon, 10 for a part.
    """

    readings: Path | None = None
    max_tilt_deg: float = 20.0
    step_deg: float | None = None


@dataclass(frozen=True)
class Turning:
    """Pictures of a known part over a full turn, for the commissioning of a rig.

    Attributes:
        exposure_s: exposure in seconds; else the recipe's.
        gain: gain of the camera, as a factor.
        channel: light channel; else the recipe's, else light.channel of the rig file.
        step_deg: step of the stage over one turn, degrees.
        tilts_deg: tilts from the present zero of the tilt axis, degrees.
        frames: frames per pose.
        settle_s: seconds to wait after every move.
        bounces: reflections that the model counts: 1 is direct light, or 'all'.

    Raises:
        UsageError: no reflections.
    """

    exposure_s: float | None = None
    gain: float = 1.0
    channel: str | None = None
    step_deg: float = 15.0
    tilts_deg: tuple[float, ...] = (-20.0, -10.0, 10.0, 20.0)
    frames: int = 2
    settle_s: float = 0.1
    bounces: int | Literal["all"] = "all"

    def __post_init__(self) -> None:
        if self.bounces != "all" and self.bounces < 1:
            raise UsageError(f"--bounces must be 1 or more, or all, not {self.bounces}")


@dataclass(frozen=True)
class KnownPart:
    """Part on the stage of a commissioning; what is not stated is the recipe's.

    Attributes:
        recipe: recipe of the part on the stage.
        ridge_angle_deg: ridge angle of the part in degrees.
        pitch_um: pitch of the ridges in µm.
        alpha: roughness along and across the ridges, such as 0.06,0.1.
        spot_mm: diameter of the spot on the part; else the recipe's region.
        u_ridge_angle_deg: standard uncertainty of the ridge angle, degrees.
        u_alpha: relative standard uncertainty of the roughness.

    Raises:
        UsageError: neither a recipe nor angle, pitch and spot; or a roughness that is none.
    """

    recipe: Path | None = None
    ridge_angle_deg: float | None = None
    pitch_um: Annotated[float | None, LIKELY_PITCH] = None
    alpha: tuple[float, ...] | None = None
    spot_mm: float | None = None
    u_ridge_angle_deg: float = 0.1
    u_alpha: float | None = None

    def __post_init__(self) -> None:
        if self.recipe is None and None in (self.ridge_angle_deg, self.pitch_um, self.spot_mm):
            raise UsageError(
                "name the part on the stage: --recipe FILE, or --ridge-angle, --pitch and --spot-mm"
            )
        if self.alpha is not None and (len(self.alpha) not in (1, 2) or min(self.alpha) <= 0.0):
            stated = ",".join(f"{one:g}" for one in self.alpha)
            raise UsageError(f"--alpha takes one or two numbers above 0, such as 0.06,0.1, not {stated}")
