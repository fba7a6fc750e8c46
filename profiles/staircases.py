"""Staircases of a few levels, as wave optics wants them (Levin et al. 2013): regular, or random rectangles.

Heights are in µm above the lowest level.
"""

from collections.abc import Sequence

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.patterns import Pixel, across_lines, pattern_map, pixels


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
