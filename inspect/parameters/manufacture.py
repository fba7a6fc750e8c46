"""Plates of ridges: their fields and modules, and how the mould insert is made."""

from dataclasses import dataclass
from typing import Literal

from anisoscope.base.errors import UsageError


@dataclass(frozen=True)
class Manufacture:
    """What is written for the making of an insert.

    Attributes:
        stl: write part and insert as closed STL bodies in mm, too.
        base_mm: thickness of these bodies below their surface in mm.
        npz: write the height maps as npz, too.
        path: write the finishing cuts of the insert: two tables in mm, and G-code.
        tool_half_angle_deg: half angle of the engraving cone in degrees, at most the draft.
        feed: feed of a cut in mm/min.

    Raises:
        UsageError: a base without thickness, or a tool that does not move.
    """

    stl: bool = False
    base_mm: float = 1.0
    npz: bool = False
    path: bool = False
    tool_half_angle_deg: float = 10.0
    feed: float = 100.0

    def __post_init__(self) -> None:
        if self.stl and not self.base_mm > 0.0:
            raise UsageError(f"--base-mm must be a positive number of mm, not {self.base_mm:g}")
        if self.path and not self.feed > 0.0:
            raise UsageError(f"--feed must be a positive number of mm/min, not {self.feed:g}")

    def names(self) -> list[str]:
        """Files that are written."""
        found = ["part.x3p", "insert.x3p"]
        found += ["part.npz", "insert.npz"] if self.npz else []
        found += ["part.stl", "insert.stl"] if self.stl else []
        return found + (["insert-passes.csv", "insert-fields.csv", "insert.nc"] if self.path else [])


@dataclass(frozen=True)
class PlateFiles:
    """Height maps and trial of a plate.

    Attributes:
        pixel_um: pixel size of the height maps in µm.
        trial: trial on the virtual rig: photograph the plate, and compare.
        overwrite: replace files that exist.
    """

    pixel_um: float = 5.0
    trial: bool = False
    overwrite: bool = False


@dataclass(frozen=True)
class PlateDesign(PlateFiles):
    """Plate whose fields show pictures.

    Attributes:
        stages_deg: stage angles at which the pictures are seen.
        field_um: side of a field in µm, two ridges or more, whole ones.
        light_angle_deg: angle between light and camera in degrees.
        class_count: most classes of fields: directions and ridge angles that differ.
    """

    stages_deg: tuple[float, ...] = (0.0, 90.0)
    field_um: float = 100.0
    light_angle_deg: float = 10.0
    class_count: int = 64


@dataclass(frozen=True)
class CodeDesign(PlateFiles):
    """Code whose modules are fields of ridges in two directions.

    Attributes:
        symbology: kind of code; the smallest symbol that holds the text.
        module_mm: side of a module in mm, two ridges or more.
        facet_azimuths_deg: azimuths toward which the facets of light and dark modules fall at stage angle 0.
        plate_mm: side of the plate in mm, which the code must fit; any if not given.
    """

    symbology: Literal["datamatrix", "qr"] = "datamatrix"
    module_mm: float = 0.2
    facet_azimuths_deg: tuple[float, ...] = (0.0, -90.0)
    plate_mm: float | None = None
    pixel_um: float = 2.0

    def __post_init__(self) -> None:
        if len(self.facet_azimuths_deg) != 2:
            azimuths = ",".join(f"{one:g}" for one in self.facet_azimuths_deg)
            raise UsageError(
                f"--facet-azimuths takes two azimuths, of light and of dark modules, not {azimuths}"
            )


@dataclass(frozen=True)
class GreyPictures:
    """Pictures that become fields of a plate.

    Attributes:
        field_count: field count along the longer side; one a pixel of the picture if not given.
        tone: greys of the pictures: proportional to radiance, as a camera sees them, or sRGB, for the eye.
    """

    field_count: int | None = None
    tone: Literal["linear", "srgb"] = "linear"
