"""Ideal surfaces other than ridges along y: turned ridges, V-grooves, checkerboards, planes.

A pattern is sampled at points, heights in µm above its lowest level. Directions of lines count counter-clockwise
from +y as seen from +z; turned ridges lean toward +x turned by the same angle.

Wave optics has staircases of a few levels (Levin et al. 2013), regular or of random rectangles.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap

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

    All fields are the same square of ridges along y, a crest on its side of least x, turned about its middle. So the
    board looks the same when it is turned by the difference of its directions, also where fields end within a ridge.

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
    second = second_fields(shape, pixel_um, field_um)
    turns = [_sine_cosine(direction) for direction in directions_deg]
    half = 0.5 * field_um
    profiles = [
        design.profile(np.add.outer((y % field_um - half) * sine, (x % field_um - half) * cosine) + half)
        for sine, cosine in turns
    ]
    return pattern_map(
        np.where(second, profiles[1], profiles[0]),
        pixel_um,
        ideal="checkerboard",
        **asdict(design),
        field_um=field_um,
        directions_deg=list(directions_deg),
    )


def second_fields(shape: tuple[int, int], pixel_um: Pixel, field_um: float) -> npt.NDArray[np.bool_]:
    """(rows, cols) where a checkerboard has its second direction."""
    pixel_y, pixel_x = pixels(pixel_um)
    x, y = np.arange(shape[1]) * pixel_x, np.arange(shape[0]) * pixel_y
    return np.asarray(np.add.outer(np.floor(y / field_um), np.floor(x / field_um)) % 2 == 1)


def flat(shape: tuple[int, int], pixel_um: Pixel) -> HeightMap:
    """A plane at height 0.

    Raises:
        HeightMapError: a pixel size or shape that is none.
    """
    return pattern_map(np.zeros(shape), pixel_um, ideal="flat")


def even_levels(count: int, step_um: float) -> tuple[float, ...]:
    """``count`` levels from 0, each a step above the last, in µm.

    Raises:
        HeightMapError: fewer than two levels, or a step that is not positive.
    """
    if count < 2 or not step_um > 0.0:
        raise HeightMapError(
            f"a staircase needs two levels or more with a positive step, not {count} × {step_um} µm"
        )
    return tuple(step_um * number for number in range(count))


def etched_levels(passes_um: Sequence[float]) -> tuple[float, ...]:
    """The 2ⁿ levels in µm that n etch passes leave, each masked or not: all sums of the depths, rising.

    Source: Levin et al. 2013, section 5 (log₂ K passes for K levels).

    Raises:
        HeightMapError: no pass, more than ten, or a depth that is not positive.
    """
    if not 1 <= len(passes_um) <= 10 or not min(passes_um) > 0.0:
        raise HeightMapError(f"one to ten etch passes of positive depth are needed, not {list(passes_um)} µm")
    levels = np.zeros(1)
    for depth in passes_um:
        levels = np.concatenate([levels, levels + depth])
    return tuple(np.sort(levels).tolist())


def staircase(
    levels_um: Sequence[float],
    shape: tuple[int, int],
    pixel_um: Pixel,
    width_um: float,
    *,
    direction_deg: float = 0.0,
) -> HeightMap:
    """Steps of equal width that climb through the levels in order, and start again.

    Args:
        levels_um: heights of the K levels in µm.
        shape: (rows, cols).
        pixel_um: pixel size in µm, one number or (y, x).
        width_um: width of a step in µm, at least a pixel.
        direction_deg: direction of the edges of the steps.

    Raises:
        HeightMapError: a width below a pixel, fewer than two levels, a pixel size or shape that is none.
    """
    levels = _levels(levels_um, width_um, pixel_um)
    # the edge of a step belongs to the step above it, also where the product is rounded down
    number = np.floor(across_lines(shape, pixel_um, direction_deg) / width_um + 1e-9).astype(np.int64)
    height = levels[number % levels.size] - levels.min()
    return pattern_map(
        height,
        pixel_um,
        ideal="staircase",
        levels_um=levels.tolist(),
        width_um=width_um,
        direction_deg=direction_deg,
    )


def random_steps(
    levels_um: Sequence[float],
    shape: tuple[int, int],
    pixel_um: Pixel,
    width_um: tuple[float, float],
    rng: np.random.Generator,
    *,
    spread: float = 0.0,
) -> HeightMap:
    """Rectangles of random levels: widths along both axes are drawn, then a level for every rectangle.

    Source: Levin et al. 2013, sampling process 1, with widths even between ``width_um`` and
    (1 + spread)·width_um, and all levels equally likely.

    Args:
        levels_um: heights of the K levels in µm.
        shape: (rows, cols).
        pixel_um: pixel size in µm, one number or (y, x).
        width_um: least width (along y, along x) in µm; infinity for lines along that axis.
        rng: source of randomness.
        spread: the largest width exceeds the least by this share.

    Raises:
        HeightMapError: a width below a pixel, a negative spread, fewer than two levels, a pixel size or shape that
            is none.
    """
    levels = _levels(levels_um, min(width_um), pixel_um)
    if not spread >= 0.0:
        raise HeightMapError(f"the spread of the widths must not be negative, not {spread}")
    cells = []
    for count, pixel, width in zip(shape, pixels(pixel_um), width_um, strict=True):
        if np.isinf(width):
            cells.append(np.zeros(count, dtype=np.int64))
            continue
        edges = np.cumsum(width * (1.0 + spread * rng.random(int(count * pixel / width) + 1)))
        cells.append(np.searchsorted(edges, np.arange(count) * pixel, side="right"))
    chosen = rng.integers(0, levels.size, (cells[0][-1] + 1, cells[1][-1] + 1))
    height = (levels - levels.min())[chosen[np.ix_(cells[0], cells[1])]]
    width_note = [None if np.isinf(width) else width for width in width_um]
    return pattern_map(
        height, pixel_um, ideal="random steps", levels_um=levels.tolist(), width_um=width_note, spread=spread
    )


def _levels(levels_um: Sequence[float], width_um: float, pixel_um: Pixel) -> FloatArray:
    levels = np.asarray(levels_um, dtype=np.float64)
    if levels.size < 2 or not np.isfinite(levels).all():
        raise HeightMapError("a staircase needs at least two levels of finite height")
    if not width_um >= max(pixels(pixel_um)):
        raise HeightMapError(
            f"steps of {width_um:g} µm are narrower than a pixel; take wider steps or smaller pixels"
        )
    return levels
