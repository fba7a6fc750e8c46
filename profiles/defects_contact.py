"""Defects by contact: worn edges, scratches, dust."""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.level import level

CREST_QUANTILE = 0.99
TAPER_SHARE = 0.2
SIZE_SPREAD = 0.4
MAX_BALL_PIXELS = 60
STRIP_POINTS = 20_000


def _ball(radius_um: float, surface: HeightMap) -> list[tuple[int, list[tuple[int, float]]]]:
    """Quarter of a ball: for every row i ≥ 0 its offsets j ≥ 0, and the height there above its rim plane in µm."""
    reach_i = int(radius_um / surface.pixel_y_um)
    reach_j = int(radius_um / surface.pixel_x_um)
    if max(reach_i, reach_j) > MAX_BALL_PIXELS:
        raise HeightMapError(
            f"a radius of {radius_um:g} µm is more than {MAX_BALL_PIXELS} pixels; take a smaller one, or larger pixels"
        )
    ball = []
    for i in range(reach_i + 1):
        rest = [
            radius_um**2 - (i * surface.pixel_y_um) ** 2 - (j * surface.pixel_x_um) ** 2
            for j in range(reach_j + 1)
        ]
        ball.append((i, [(j, float(np.sqrt(one))) for j, one in enumerate(rest) if one >= 0.0]))
    return ball


def _least(field: FloatArray, ball: list[tuple[int, list[tuple[int, float]]]]) -> FloatArray:
    """Least of the heights of a field under a ball, less those of the ball; as far as the whole ball is on the field.

    The ball is the same to all four sides, so that one subtraction serves four points.
    """
    reach_i, reach_j = len(ball) - 1, max(j for _, row in ball for j, _ in row)
    rows, cols = field.shape[0] - 2 * reach_i, field.shape[1] - 2 * reach_j
    found = np.full((rows, cols), np.inf)
    height = max(1, STRIP_POINTS // field.shape[1])
    for top in range(0, rows, height):  # a strip stays in the processor's cache while the ball passes
        strip = found[top : top + height]
        part = np.empty_like(strip)
        for i, row in ball:
            above, below = (field[top + at :][: len(strip)] for at in (reach_i + i, reach_i - i))
            nearer = np.minimum(above, below) if i else above
            for j, rise in row:
                right, left = (nearer[:, at : at + cols] for at in (reach_j + j, reach_j - j))
                np.subtract(np.minimum(right, left, out=part), rise, out=part)
                np.minimum(strip, part, out=strip)
    return found


def edge_wear(surface: HeightMap, radius_um: float) -> HeightMap:
    """Convex edges rounded to a radius: the surface that a ball reaches when it rolls beneath it.

    In use: abrasion of the crests by handling, cleaning or stacking; in moulding: crests that stuck to the tool and
    tore. Rounding is a morphological opening with a ball (ISO 16610-85): it takes material at edges sharper than the
    ball, adds none, and leaves facets and valleys alone. An edge of the *tool* that wears rounds the valleys of the
    part: spoil the map of the tool. A radius below a pixel has no effect.

    Args:
        surface: the map; missing points and what lies beyond the field do not stop the ball.
        radius_um: radius of the edges in µm, up to 60 pixels.

    Raises:
        HeightMapError: a radius that is negative or too large for the pixels, or nothing was measured.
    """
    check_heights("height map", surface.height_um)
    if not radius_um >= 0.0:
        raise HeightMapError(f"the radius of worn edges must not be negative, not {radius_um} µm")
    ball = _ball(radius_um, surface)
    reach_i, reach_j = len(ball) - 1, max(j for _, row in ball for j, _ in row)
    if reach_i == reach_j == 0:
        return surface
    known = np.isfinite(surface.height_um)
    free: FloatArray = np.pad(
        np.where(known, surface.height_um, np.inf),
        ((2 * reach_i, 2 * reach_i), (2 * reach_j, 2 * reach_j)),
        constant_values=np.inf,
    )
    centre = _least(free, ball)  # of the ball, up to a radius beyond the field
    centre[np.isinf(centre)] = -np.inf
    opened = -_least(-centre, ball)  # the greatest, with heights added
    # the ball touches most points; rounding must not lift them
    worn = np.where(known, np.minimum(opened, surface.height_um), np.nan)
    return surface.with_height(worn)


def scratches(
    surface: HeightMap,
    density_per_mm2: float,
    *,
    depth_um: float = 4.0,
    width_um: float = 12.0,
    length_um: float = 400.0,
    rng: np.random.Generator,
) -> HeightMap:
    """Straight scratches of random place and direction, cut to a depth below the crests.

    In handling: parts that rub in a box, a robot's gripper, grit in a cleaning cloth; in moulding: drag marks of
    ejection. A hard point at a fixed level cuts what stands in its way, so that a scratch crosses ridges as a row of
    nicks in the crests. Its cross section is a parabola, its ends run out.

    Args:
        surface: the map; missing points stay missing.
        density_per_mm2: number of scratches per mm², rounded to a whole number on the map.
        depth_um: greatest depth below the crests (99 % quantile of the levelled heights) in µm.
        width_um: width at the level of the crests in µm.
        length_um: mean length in µm; single ones are 0.5 to 1.5 times as long.
        rng: source of randomness.

    Raises:
        HeightMapError: a negative density, a dimension that is not positive, or nothing was measured.
    """
    _check_positive("scratches", density_per_mm2, depth_um, width_um, length_um)
    levelled = level(surface).map.height_um
    top = float(np.nanquantile(levelled, CREST_QUANTILE))
    cut = np.zeros(surface.shape)
    x, y = _axes(surface)
    for _ in range(_count(surface, density_per_mm2)):
        place_x, place_y, angle, size = rng.random(4)
        angle, half = np.pi * angle, 0.5 * length_um * (0.5 + size)
        x0, y0 = place_x * x[-1], place_y * y[-1]
        rows, cols = _window(surface, (y0, x0), half + width_um)
        dx, dy = x[cols][None, :] - x0, y[rows][:, None] - y0
        along, across = dx * np.cos(angle) + dy * np.sin(angle), dy * np.cos(angle) - dx * np.sin(angle)
        end = np.clip((half - np.abs(along)) / (TAPER_SHARE * half), 0.0, 1.0)
        deep = depth_um * end * np.maximum(0.0, 1.0 - (2.0 * across / width_um) ** 2)
        removed = np.where(deep > 0.0, levelled[rows, cols] - (top - deep), 0.0)
        cut[rows, cols] = np.fmax(cut[rows, cols], removed)
    return surface.with_height(surface.height_um - np.maximum(cut, 0.0))


def dust(
    surface: HeightMap,
    density_per_mm2: float,
    *,
    diameter_um: float = 10.0,
    rng: np.random.Generator,
) -> HeightMap:
    """Round grains that lie on the surface, seen from above.

    In moulding and handling: dust, fibres of packaging, abrasion, residue of release agent. Each grain is a ball of
    log-normal diameter (standard deviation 0.4 of the logarithm) that rests where it touches the surface first.

    Args:
        surface: the map; missing points stay missing.
        density_per_mm2: number of grains per mm², rounded to a whole number on the map.
        diameter_um: median diameter in µm.
        rng: source of randomness.

    Raises:
        HeightMapError: a negative density, a diameter that is not positive, or nothing was measured.
    """
    _check_positive("dust", density_per_mm2, diameter_um)
    check_heights("height map", surface.height_um)
    known = np.isfinite(surface.height_um)
    below: FloatArray = np.where(known, surface.height_um, -np.inf)
    height = surface.height_um.copy()
    x, y = _axes(surface)
    for _ in range(_count(surface, density_per_mm2)):
        place_x, place_y = rng.random(2)
        radius = 0.5 * diameter_um * float(np.exp(SIZE_SPREAD * rng.standard_normal()))
        x0, y0 = place_x * x[-1], place_y * y[-1]
        rows, cols = _window(surface, (y0, x0), radius)
        rest = radius**2 - np.add.outer((y[rows] - y0) ** 2, (x[cols] - x0) ** 2)
        upper = np.sqrt(np.maximum(rest, 0.0))
        centre = float(np.max(np.where(rest > 0.0, below[rows, cols] + upper, -np.inf), initial=-np.inf))
        if np.isfinite(centre):
            grain = np.where(rest > 0.0, centre + upper, -np.inf)
            height[rows, cols] = np.maximum(height[rows, cols], grain)
    return surface.with_height(np.where(known, height, np.nan))


def _check_positive(what: str, density: float, *sizes: float) -> None:
    if not (np.isfinite(density) and density >= 0.0):
        raise HeightMapError(f"the density of {what} must be a number per mm², not {density}")
    if not min(sizes) > 0.0:
        raise HeightMapError(f"the dimensions of {what} must be positive, not {min(sizes)} µm")


def _count(surface: HeightMap, density_per_mm2: float) -> int:
    height, width = surface.extent_um
    return round(density_per_mm2 * height * width * 1e-6)


def _axes(surface: HeightMap) -> tuple[FloatArray, FloatArray]:
    """Positions of columns (x) and rows (y) in µm."""
    rows, cols = surface.shape
    x, y = np.arange(cols, dtype=np.float64), np.arange(rows, dtype=np.float64)
    return x * surface.pixel_x_um, y * surface.pixel_y_um


def _window(surface: HeightMap, centre_um: tuple[float, float], reach_um: float) -> tuple[slice, slice]:
    """Rows and columns within a reach of a place (y, x)."""
    spans = []
    for place, pixel, count in zip(
        centre_um, (surface.pixel_y_um, surface.pixel_x_um), surface.shape, strict=True
    ):
        first = max(0, int(np.floor((place - reach_um) / pixel)))
        spans.append(slice(first, min(count, int(np.ceil((place + reach_um) / pixel)) + 1)))
    return spans[0], spans[1]
