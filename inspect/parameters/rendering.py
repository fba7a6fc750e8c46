"""Pictures of a plate and of a height map (`anisoscope.operations.render`)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from anisoscope.base.errors import UsageError


@dataclass(frozen=True)
class PlateView:
    """View of a plate of fields.

    Attributes:
        angles_deg: stage angles in degrees, one panel each.
        ridge_directions_deg: directions of the ridges in the two kinds of fields, from +y, in degrees.
        tilt_deg: tilt of camera and light in degrees (--tilt=-10).
        near_light_mm: distance of the light in mm; default: parallel light.
        bounces: reflections followed: 1 is direct light, or 'all'. All by default, under a near light 1.
    """

    angles_deg: tuple[float, ...] = (0.0, 90.0)
    ridge_directions_deg: tuple[float, ...] = (0.0, -90.0)
    tilt_deg: float = 0.0
    near_light_mm: float | None = None
    bounces: int | Literal["all"] | None = None


@dataclass(frozen=True)
class PlateFields:
    """Fields of a plate.

    Attributes:
        fields: fields along a side, 2 to 64.
        field_size_mm: side of a field in mm.
        pattern: image of two levels in place of the checkerboard: dark is the second.
        plate_width_mm: width of the plate with --pattern in mm.

    Raises:
        UsageError: a size or count out of its range.
    """

    fields: int = 7
    field_size_mm: float = 5.0
    pattern: Path | None = None
    plate_width_mm: float = 40.0

    def __post_init__(self) -> None:
        for name, value in (("--plate-width", self.plate_width_mm), ("--field-size", self.field_size_mm)):
            if not 0.0 < value <= 10_000.0:
                raise UsageError(f"{name} takes a length above 0 and up to 10000 mm, not {value:g}")
        if self.pattern is None and not 2 <= self.fields <= 64:
            raise UsageError(f"--fields takes 2 to 64, not {self.fields}")


@dataclass(frozen=True)
class MapView:
    """View of a height map.

    Attributes:
        angles_deg: stage angles in degrees, one panel each.
        tilt_deg: tilt of camera and light in degrees (--tilt=-10).
        bounces: reflections between facet and wall that are counted: 1 is direct light, or 'all'; spread evenly.
    """

    angles_deg: tuple[float, ...] = (0.0, 90.0, 180.0)
    tilt_deg: float = 0.0
    bounces: int | Literal["all"] = "all"


@dataclass(frozen=True)
class MapSample:
    """What is taken of a height map.

    Attributes:
        pitch_um: of a map, where it is not to be found in it.
        levelling: of a map, as in `prepare_relief`.
        region_um: (x0, y0, x1, y1) from the map's first point; all, or the middle of a large map, where it is left out.
        name: what the surface is called.
    """

    pitch_um: float | None = None
    levelling: Literal["auto", "plane", "none"] = "auto"
    region_um: tuple[float, float, float, float] | None = None
    name: str = ""
