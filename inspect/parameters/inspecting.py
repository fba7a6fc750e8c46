"""Parts that are inspected, one by one or many (`anisoscope.operations.inspecting`, `anisoscope.operations.series`)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from anisoscope.base.errors import UsageError

CodeKind = Literal["any", "datamatrix", "code128", "qr"]


@dataclass(frozen=True)
class PartLabels:
    """Labels of a part, for the record.

    Attributes:
        serial: serial number of the part.
        operator: operator, for the record.
        lot: lot of the part.
        cavity: cavity of the mould.
        station: station where the rig stands.
        at_mm: place (x, y) of the part on the plate for the axes x and y: mm right and up of the stage's axis, at
            sample angle 0.
    """

    serial: str | None = None
    operator: str | None = None
    lot: str | None = None
    cavity: str | None = None
    station: str | None = None
    at_mm: tuple[float, float] | None = None


@dataclass(frozen=True)
class PartFrames:
    """Frames that another program took.

    Attributes:
        frames: judge the frames of this folder (frames.csv) instead of taking any.
        reflectance: with --frames: reflectance of the white tile in its flat frames.
    """

    frames: Path | None = None
    reflectance: float = 0.99


@dataclass(frozen=True)
class ForeignFrames(PartFrames):
    """Frames by which a part is judged.

    Attributes:
        reuse: with --frames: reason for judging frames that are known as those of another part.
    """

    reuse: str = ""


@dataclass(frozen=True)
class CodeReading:
    """Reading of the code on every part.

    Attributes:
        read_code: read the code on every part with the camera before inspecting it, or from its first frame.
        code_kind: kind of code to look for, where several are in the picture.
    """

    read_code: bool = False
    code_kind: CodeKind = "any"


@dataclass(frozen=True)
class TrayRun(CodeReading):
    """Inspection of a tray, slot by slot.

    Attributes:
        resume: continue an interrupted batch; finished parts are kept.
        code_exposure_s: exposure in seconds for the picture of the code; by default the recipe's.
        operator: operator, for the records.
        station: station where the rig stands.
    """

    resume: bool = False
    code_exposure_s: float | None = None
    operator: str | None = None
    station: str | None = None


@dataclass(frozen=True)
class FramesWatch(CodeReading):
    """Inspection of folders of frames as another program writes them.

    Attributes:
        once: inspect the complete folders that exist, then end.
        stable_s: seconds without a change after which a folder is complete.
        poll_s: seconds between checks of the folder.
        reflectance: reflectance of the white tile in flat frames.
        reuse: reason for judging frames that are known as those of another part; it is kept in the records.

    Raises:
        UsageError: times that make no sense.
    """

    once: bool = False
    stable_s: float = 2.0
    poll_s: float = 1.0
    reflectance: float = 0.99
    reuse: str = ""

    def __post_init__(self) -> None:
        if not (self.stable_s >= 0.0 and self.poll_s > 0.0):
            raise UsageError(
                f"--stable-for must be 0 s or more and --poll above 0 s, not {self.stable_s:g} and {self.poll_s:g}"
            )


@dataclass(frozen=True)
class Teaching:
    """Good part, golden parts or file of limits by which a recipe is taught.

    Attributes:
        serial: serial number of the good part.
        golden: by golden parts, and nothing is photographed: tolerances of a print, [scatter] of ridges.
        golden_of: with --golden: another recipe, for the same plastic and rig, whose golden parts teach.
        limits: AQDEF file (.dfq, .dfd) whose limits become the tolerances; nothing is photographed.
        share: with --golden: share of good prints that should pass all limits.

    Raises:
        UsageError: none or several of part, golden parts and limits.
    """

    serial: str | None = None
    golden: bool = False
    golden_of: Path | None = None
    limits: Path | None = None
    share: float = 0.95

    def __post_init__(self) -> None:
        if self.golden + (self.serial is not None) + (self.limits is not None) != 1:
            raise UsageError(
                "name a good part with --serial, or --golden for the golden parts of a recipe, or a file with --limits"
            )
        if self.golden_of is not None and not self.golden:
            raise UsageError("--golden-of names the recipe whose golden parts teach: it needs --golden")
