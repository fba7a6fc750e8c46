"""One part that is inspected (`anisoscope.operations.inspecting`)."""

from dataclasses import dataclass
from pathlib import Path


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
class ForeignFrames:
    """Frames that another program took.

    Attributes:
        frames: judge the frames of this folder (frames.csv) instead of taking any.
        reflectance: with --frames: reflectance of the white tile in its flat frames.
        reuse: with --frames: reason for judging frames that are known as those of another part.
    """

    frames: Path | None = None
    reflectance: float = 0.99
    reuse: str = ""
