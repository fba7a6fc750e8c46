"""What a file of a height map does not state (`anisoscope.profiles.files.load`)."""

from dataclasses import dataclass
from typing import Literal

Unit = Literal["um", "nm", "mm", "m"]
Layout = Literal["auto", "matrix", "xyz"]
Role = Literal["part", "tool"]
Rows = Literal["auto", "up", "down"]
Trust = Literal["checksum", "pixel-size", "heights"]


@dataclass(frozen=True)
class FileScales:
    """Scales and role of a height map whose file does not state them.

    Attributes:
        pixel_um: pixel size in µm of a file without one: SIZE or Y,X.
        z_unit: unit of the heights of a file that states none; µm if not given.
        height_per_count: height of one count of an integer picture, in --z-unit (µm).
        xy_unit: unit of x and y of a list of points; that of the heights if not given.
        layout: what a text file with three columns holds.
        missing: number that stands for missing points in a text file, such as -9999; may be given several times.
        channel: channel of heights in a file with several, by name or number; else the first length.
        grid_um: step in µm of a grid onto which scattered points of a text or a mesh are interpolated; without it they
            must lie on a grid.
        rows: whether y goes up or down with the rows of the file; auto: see docs/height-maps.md.
        trust: check that must not refuse the file: checksum (of main.xml of an x3p), pixel-size, heights; may be given
            several times, and is noted in the origin.
        mask_regions: regions of the mask.png of an x3p file that become missing points: names or colours separated by
            commas, or all.
        role: map of the part, or of the tool (mould), whose negative the part is.
    """

    pixel_um: tuple[float, float] | None = None
    z_unit: Unit | None = None
    height_per_count: float | None = None
    xy_unit: Unit | None = None
    layout: Layout = "auto"
    missing: tuple[float, ...] = ()
    channel: str | None = None
    grid_um: float | None = None
    rows: Rows = "auto"
    trust: tuple[Trust, ...] = ()
    mask_regions: tuple[str, ...] = ()
    role: Role = "part"
