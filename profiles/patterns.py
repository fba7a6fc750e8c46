"""Ideal surfaces other than ridges along y: turned ridges, V-grooves, checkerboards, planes.

A pattern is sampled at points, heights in µm above its lowest level. Directions of lines count counter-clockwise
from +y as seen from +z; turned ridges lean toward +x turned by the same angle.
"""

from dataclasses import asdict, dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import RidgeDesign

Pixel = float | tuple[float, float]


@dataclass(frozen=True)
class GrooveDesign:
    """Parallel symmetric V-grooves between flat lands.

    Attributes:
        pitch_um: distance of neighbouring grooves in µm.
        flank_angle_deg: slope of both flanks, above 0 and below 80°.
        land_um: width of the flat land between two grooves in µm, below the pitch.

    Raises:
        HeightMapError: a parameter outside its range.
    """

    pitch_um: float
    flank_angle_deg: float
    land_um: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.pitch_um) and self.pitch_um > 0):
            raise HeightMapError(f"the pitch must be a positive number of µm, not {self.pitch_um}")
        if not 0.0 < self.flank_angle_deg < 80.0:
            raise HeightMapError(f"the flank angle must be within 0° and 80°, not {self.flank_angle_deg}°")
        if not 0.0 <= self.land_um < self.pitch_um:
            raise HeightMapError(
                f"the land must be narrower than the pitch of {self.pitch_um:g} µm, not {self.land_um:g} µm"
            )

    @property
    def depth_um(self) -> float:
        """Depth of the grooves in µm."""
        flank = 0.5 * (self.pitch_um - self.land_um)
        return float(flank * np.tan(np.radians(self.flank_angle_deg)))

    def profile(self, x_um: FloatArray) -> FloatArray:
        """Height in µm above the bottom at positions x in µm; a bottom lies at x = 0."""
        position = np.mod(x_um, self.pitch_um)
        distance = np.minimum(position, self.pitch_um - position)
        height: FloatArray = np.minimum(distance * np.tan(np.radians(self.flank_angle_deg)), self.depth_um)
        return height


def pixels(pixel_um: Pixel) -> tuple[float, float]:
    """Pixel (y, x) in µm."""
    if isinstance(pixel_um, tuple):
        return pixel_um
    return float(pixel_um), float(pixel_um)


def across_lines(shape: tuple[int, int], pixel_um: Pixel, direction_deg: float) -> FloatArray:
    """(rows, cols) distance in µm of every point across lines of a direction through the first point."""
    pixel_y, pixel_x = pixels(pixel_um)
    sine, cosine = _sine_cosine(direction_deg)
    y, x = np.arange(shape[0]) * pixel_y, np.arange(shape[1]) * pixel_x
    across: FloatArray = np.add.outer(y * sine, x * cosine)
    return across


def _sine_cosine(angle_deg: float) -> tuple[float, float]:
    """Sine and cosine, exact at quarter turns: there, rounding would move edges by a pixel."""
    angle = np.radians(angle_deg)
    return round(float(np.sin(angle)), 15), round(float(np.cos(angle)), 15)


def pattern_map(height_um: FloatArray, pixel_um: Pixel, **origin: object) -> HeightMap:
    """A map of heights in µm with its origin."""
    pixel_y, pixel_x = pixels(pixel_um)
    return HeightMap(height_um, float(pixel_x), float(pixel_y), dict(origin))


def turned_ridges(
    design: RidgeDesign,
    shape: tuple[int, int],
    pixel_um: Pixel,
    *,
    direction_deg: float = 0.0,
    phase: float = 0.0,
) -> HeightMap:
    """Ridges of any direction.

    Args:
        design: the shape of the ridges.
        shape: (rows, cols).
        pixel_um: pixel size in µm, one number or (y, x).
        direction_deg: direction of the ridges.
        phase: position of the first (uncut) crest as a share of the pitch, across the ridges.

    Raises:
        HeightMapError: a pixel size or shape that is none.
    """
    across = across_lines(shape, pixel_um, direction_deg) - phase * design.pitch_um
    height = design.profile(across)
    return pattern_map(height, pixel_um, ideal="ridges", **asdict(design), direction_deg=direction_deg)


def v_grooves(
    design: GrooveDesign,
    shape: tuple[int, int],
    pixel_um: Pixel,
    *,
    direction_deg: float = 0.0,
    phase: float = 0.0,
) -> HeightMap:
    """Symmetric V-grooves of any direction; arguments as for :func:`turned_ridges`.

    Raises:
        HeightMapError: a pixel size or shape that is none.
    """
    across = across_lines(shape, pixel_um, direction_deg) - phase * design.pitch_um
    height = design.profile(across)
    return pattern_map(height, pixel_um, ideal="v-grooves", **asdict(design), direction_deg=direction_deg)


def checkerboard(
    design: RidgeDesign,
    shape: tuple[int, int],
    pixel_um: Pixel,
    field_um: float,
    *,
    directions_deg: tuple[float, float] = (0.0, -90.0),
) -> HeightMap:
    """Square fields of ridges with two directions in turn; the field at the first point has the first.

    Ridges start anew in every field: a crest passes through its corner with the least x and y.

    Args:
        design: the shape of the ridges.
        shape: (rows, cols).
        pixel_um: pixel size in µm, one number or (y, x).
        field_um: side of a field in µm.
        directions_deg: the two directions.

    Raises:
        HeightMapError: a field that is not larger than a pixel, a pixel size or shape that is none.
    """
    pixel_y, pixel_x = pixels(pixel_um)
    if not field_um > max(pixel_y, pixel_x):
        raise HeightMapError(f"a field must be larger than a pixel, not {field_um:g} µm")
    x, y = np.arange(shape[1]) * pixel_x, np.arange(shape[0]) * pixel_y
    second = np.add.outer(np.floor(y / field_um), np.floor(x / field_um)) % 2 == 1
    turns = [_sine_cosine(direction) for direction in directions_deg]
    profiles = [
        design.profile(np.add.outer((y % field_um) * sine, (x % field_um) * cosine)) for sine, cosine in turns
    ]
    return pattern_map(
        np.where(second, profiles[1], profiles[0]),
        pixel_um,
        ideal="checkerboard",
        **asdict(design),
        field_um=field_um,
        directions_deg=list(directions_deg),
    )


def flat(shape: tuple[int, int], pixel_um: Pixel) -> HeightMap:
    """A plane at height 0.

    Raises:
        HeightMapError: a pixel size or shape that is none.
    """
    return pattern_map(np.zeros(shape), pixel_um, ideal="flat")
