"""Defect regions: connected deviating cells of the contrast map, with place, area, kind and chance probability.

The chance is an upper bound: on a good part every cell deviates independently with probability q, so that fewer than
 N·A(n)·qⁿ groups of n touching cells are expected among N cells, A(n) being the number of shapes that n cells can
have (fixed polyplets; OEIS A006770). q is the tail of the map's own scatter, or the share found on good parts.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.imaging.deviation_map import CellMap
from anisoscope.imaging.mark_classes import CELLS, UNKNOWN, kinds_of_groups
from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH
from anisoscope.imaging.registration.placement import Grid
from anisoscope.record.schema import RegionRecord

Cells = npt.NDArray[np.bool_]
SPOT = "spot"
"""Kind of a single cell, which has no form."""

SHAPES = (1, 4, 20, 110, 638, 3832, 23592, 147941)
GROWTH = 6.5  # A(n + 1)/A(n) beyond the table
LEAST_WEIGHT = 0.02
"""Weight from which on a kind of a region is recorded."""


def deviation_map(cells: CellMap) -> FloatArray:
    """(cell rows, cell cols) deviation of every cell in ln ratio, for the pair of angles where it shows most."""
    most = (np.abs(cells.off) / cells.thresholds[:, None, None]).argmax(axis=0)
    return np.asarray(np.take_along_axis(cells.off, most[None], axis=0)[0])


def signed_scores(cells: CellMap) -> FloatArray:
    """(cell rows, cell cols) score of every cell over its limit, with the sign of the ln ratio that is off most."""
    return np.asarray(np.sign(deviation_map(cells)) * cells.score / cells.limit)


def chance_of_a_cell(deviation: FloatArray, threshold: float) -> float:
    """Probability that a cell of a good part deviates, from the map itself.

    Beyond the 99th percentile the tail is extrapolated exponentially from its fall since the 90th: heavier than a
    normal tail, as rough facets show it.
    """
    size = np.abs(deviation - np.median(deviation))
    at_90, at_99 = np.quantile(size, [0.9, 0.99])
    if threshold <= at_99:
        return float(np.mean(size > threshold))
    return float(0.01 * 10.0 ** (-(threshold - at_99) / (at_99 - at_90))) if at_99 > at_90 else 0.0


def chance_of_a_group(cells: int, among: int, chance: float) -> float:
    """Probability that a group of at least this many touching cells deviates by chance anywhere in the map.

    Args:
        cells: size of the group.
        among: cells of the map.
        chance: probability of one cell.
    """
    if chance <= 0.0:
        return 0.0
    beyond = max(cells - len(SHAPES), 0)
    log_shapes = np.log(SHAPES[min(cells, len(SHAPES)) - 1]) + beyond * np.log(GROWTH)
    log_expected = np.log(among) + log_shapes + cells * np.log(chance)
    return float(-np.expm1(-np.exp(min(log_expected, 5.0))))


def find_regions(cells: CellMap, grid: Grid, chance: float | None = None) -> tuple[RegionRecord, ...]:
    """Groups of deviating cells, sorted by chance probability, then by size, largest first.

    Args:
        cells: how the cells deviate; the first row lies farthest along the ridges.
        grid: raster of the aligned pictures, for places.
        chance: probability that a cell of a good part deviates, where it is known from good parts.
    """
    over = cells.deviating()
    if not over.any():
        return ()
    middle = float(np.median(cells.score))
    q = chance_of_a_cell(cells.score, cells.limit - middle) if chance is None else chance
    if cells.signs is None:
        count, labels = cv2.connectedComponents(over.astype(np.uint8), connectivity=8)
        weights: list[dict[str, float]] = [{} for _ in range(1, count)]
    else:
        labels, weights = kinds_of_groups(over, cells.score, cells.limit, cells.signs)
    deviation = deviation_map(cells)
    regions = [_region(labels == k, deviation, grid, q, one) for k, one in enumerate(weights, start=1)]
    return tuple(sorted(regions, key=lambda region: (region.p_value, -region.cells)))


def _region(
    inside: Cells, deviation: FloatArray, grid: Grid, chance: float, weights: Mapping[str, float]
) -> RegionRecord:
    rows, cols = np.nonzero(inside)
    along, across = grid.size_mm
    step_y, step_x = along / inside.shape[0], across / inside.shape[1]
    x, y = grid.of_cell(rows.mean(), cols.mean(), inside.shape)
    return RegionRecord(
        x=x,
        y=y,
        width=(np.ptp(cols) + 1) * step_x,
        length=(np.ptp(rows) + 1) * step_y,
        area_share=inside.mean(),
        cells=len(rows),
        kind=next(iter(weights), SPOT if len(rows) < CELLS else UNKNOWN),
        weights={name: round(one, 3) for name, one in weights.items() if one >= LEAST_WEIGHT},
        deviation=deviation[inside].mean(),
        p_value=chance_of_a_group(len(rows), inside.size, chance),
    )


@dataclass(frozen=True)
class MarkForm:
    """Form of all deviating cells of a map together, which separates marks of one total area.

    Attributes:
        groups: number of groups of touching cells.
        in_line: share of the cells in those two neighbouring columns of a pitch that hold most: scratches and burrs
            are at the crests, dust is anywhere.
        along: share of the cells with a deviating neighbour along the ridge: burrs extend along it.
        aligned: share of the groups, of at most a pitch along the ridge, that have one on each neighbouring ridge in
            a straight line with them, at most 45° from straight across, less the share by chance of so many groups;
            ridges at the ends do not count. A scratch crosses ridges as a row of nicks, whatever its width and depth;
            burrs and grains do not.
    """

    groups: int
    in_line: float
    along: float
    aligned: float


def form_of(over: Cells) -> MarkForm | None:
    """Form of the (cell rows, cell cols) deviating cells of a map; None where none deviates."""
    cells = int(np.count_nonzero(over))
    if not cells:
        return None
    columns = np.bincount(np.arange(over.shape[1]) % CELLS_PER_PITCH, over.sum(axis=0), CELLS_PER_PITCH)
    neighbour = np.zeros_like(over)
    neighbour[1:] |= over[:-1]
    neighbour[:-1] |= over[1:]
    count, _, stats, centres = cv2.connectedComponentsWithStats(over.astype(np.uint8), connectivity=8)
    short = stats[1:, cv2.CC_STAT_HEIGHT] <= CELLS_PER_PITCH
    in_line = float((columns + np.roll(columns, -1)).max()) / cells
    along = np.count_nonzero(over & neighbour) / cells
    nicks = np.asarray(centres[1:][short], dtype=np.float64)
    return MarkForm(count - 1, in_line, along, _aligned(nicks, over.shape))


def _aligned(centres: FloatArray, shape: tuple[int, ...]) -> float:
    """`MarkForm.aligned` of (n, 2) centres (column, row) of groups; a cell to every side is near enough.

    How many are in line by chance follows from the same groups with every ridge turned by another number of rows.
    """
    dots = np.zeros(shape, dtype=np.uint8)
    dots[tuple(np.rint(centres).astype(int).T[::-1])] = 1
    step = CELLS_PER_PITCH
    columns = dots.sum(axis=0, dtype=np.intp)
    columns = np.bincount(np.arange(len(columns)) % step, columns, step)
    ridge = (np.arange(shape[1]) + 1 - int(np.argmax(columns + np.roll(columns, -1)))) // step
    rows = np.arange(shape[0])[:, None]
    turned = (
        np.take_along_axis(dots, (rows + np.rint(part * ridge**2 * shape[0]).astype(int)) % shape[0], axis=0)
        for part in _TURNS
    )
    return max(_in_line(dots) - float(np.mean([_in_line(one) for one in turned])), 0.0)


_TURNS = (0.6180339887, 0.4142135624, 0.7320508076)  # irrational: no two ridges of a map are turned alike


def _in_line(dots: npt.NDArray[np.uint8]) -> float:
    """Share of the dots with one a pitch to the left and one to the right in a straight line with them."""
    step = CELLS_PER_PITCH
    rows, cols = dots.shape
    wide = np.asarray(cv2.dilate(dots, np.ones((3, 3), dtype=np.uint8)), dtype=np.uint8)
    near = np.pad(wide, step)
    left, right = near[:, :cols], near[:, 2 * step :]
    lines = np.zeros(dots.shape, dtype=np.uint8)
    for rise in range(-step, step + 1):
        lines |= left[step - rise :][:rows] & right[step + rise :][:rows]
    inner = slice(step, max(cols - step, step))
    among = np.count_nonzero(dots[:, inner])
    return np.count_nonzero((dots & lines)[:, inner]) / among if among else 0.0
