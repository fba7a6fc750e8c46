"""Levels of the cells of a predicted contrast map: the share that deviates follows for the thresholds of any part.

Thresholds are those of the part, and its good cells scatter more than those of a smooth predicted surface. Signatures
therefore state by how much their cells deviate, in levels.

A camera smears a picture: its lens, its pixels, and what resamples them put some of the light of a cell into its
neighbours, and a grain that is much smaller than a cell is hidden by it. Levels are stated for several smears.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.imaging.defect_regions import MarkForm, form_of
from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH

STEP = 0.025
"""Ln ratio between two levels; thresholds are rounded to it."""
HIGHEST = 80
"""A ln ratio of 2: what deviates by more counts as this."""
SMEARS = (0.0, 0.08, 0.16)
"""Standard deviations in pitches of what smears the pictures for which levels are stated."""
SMEAR_PX = 0.64
"""Standard deviation in pixels of a usual picture: its pixels (0.29), a focused lens (0.4), and resampling (0.41)."""
USUAL_SMEAR = 0.08
"""In pitches: that of a camera of 8 pixels a pitch."""
U_SMEAR = 0.2
"""Relative standard uncertainty of the smear: the lens is not measured."""

NEIGHBOURS = 6  # ridges to each side with which a line of cells is compared
MIN_NEIGHBOURS = 3
SCATTERS = 5.0  # robust standard deviations by which a cell may be off its flank
LEAST_DEVIATION = 0.05  # what registration and the edges of cells leave


def cell_thresholds(ratios: FloatArray) -> FloatArray:
    """(pairs,) ln ratios that the texture of a predicted surface sets: `SCATTERS` times its scatter about the flanks.

    Args:
        ratios: (pairs, cell rows, cell cols) ln ratios.
    """
    off = np.abs(ratios - np.median(ratios, axis=1, keepdims=True)).reshape(len(ratios), -1)
    scatter = 1.4826 * np.median(off, axis=1)  # of normal values: their standard deviation
    return np.asarray(np.maximum(SCATTERS * scatter, LEAST_DEVIATION))


def cell_deviations(ratios: FloatArray, thresholds: FloatArray | float) -> FloatArray:
    """Deviation of every cell from the value expected at its place.

    Each line of cells (a column) runs along one flank of one ridge, so its median is the value of that flank, and
    marks stand out against it. A whole line that differs by more than its threshold from the same flank of the
    neighbouring ridges belongs to a missing or deformed ridge: all of it deviates. Smaller differences between lines
    come from where the raster cuts the flanks, and are ignored.

    Args:
        ratios: (pairs, cell rows, cell cols) ln ratios, `CELLS_PER_PITCH` columns a pitch.
        thresholds: (pairs,), or one of all.

    Returns:
        The same shape.
    """
    lines = np.median(ratios, axis=1)
    off_lines = lines - _same_flank(lines)
    whole = np.where(np.abs(off_lines) > np.reshape(thresholds, (-1, 1)), off_lines, 0.0)
    return np.asarray(ratios - lines[:, None, :] + whole[:, None, :])


def _same_flank(lines: FloatArray) -> FloatArray:
    """(pairs, cols) median of the same flank on the neighbouring ridges; the line itself where these are too few."""
    pairs, cols = lines.shape
    steps = CELLS_PER_PITCH * np.array([j for j in range(-NEIGHBOURS, NEIGHBOURS + 1) if j])
    at = np.arange(cols)[:, None] + steps
    inside = (at >= 0) & (at < cols)
    neighbours = np.where(inside, lines[:, np.clip(at, 0, cols - 1)], np.nan)
    countable = inside.sum(axis=1) >= MIN_NEIGHBOURS
    found = lines.copy()
    if countable.any():
        found[:, countable] = _median_of_known(neighbours[:, countable])
    assert found.shape == (pairs, cols)
    return found


def _median_of_known(values: FloatArray) -> FloatArray:
    """Median along the last axis without NaN; three times faster than nanmedian where that axis is short."""
    rising = np.sort(values, axis=-1)  # NaN last
    count = np.count_nonzero(~np.isnan(values), axis=-1)[..., None]
    low, high = (
        np.take_along_axis(rising, np.maximum(place, 0), axis=-1) for place in ((count - 1) // 2, count // 2)
    )
    return np.asarray(0.5 * (low + high)[..., 0])


@dataclass(frozen=True, eq=False)
class CellLevels:
    """To which levels the cells of a contrast map deviate.

    Attributes:
        levels: (U, 3, pairs) of cells that are alike: deviation of the cell from its line, of the line from the same
            flank of other ridges, and of the cell from these; in `STEP`, rounded down, at most `HIGHEST`.
        places: (cell rows, cell cols) which of them every cell is.
    """

    levels: npt.NDArray[np.uint8]
    places: npt.NDArray[np.uint16]

    @classmethod
    def of(cls, ratios: FloatArray) -> "CellLevels":
        """Levels of a contrast map: (pairs, cell rows, cell cols) ln ratios."""
        alone, whole = cell_deviations(ratios, np.inf), cell_deviations(ratios, 0.0)
        each = np.stack([alone, np.broadcast_to(whole - alone, alone.shape), whole])
        levels = np.minimum(np.abs(each) / STEP, HIGHEST).astype(np.uint8)
        pairs = len(ratios)
        found, places = np.unique(levels.reshape(3 * pairs, -1).T, axis=0, return_inverse=True)
        return cls(found.reshape(-1, 3, pairs), places.reshape(ratios.shape[1:]).astype(np.uint16))

    def deviating(self, thresholds: Sequence[float] | FloatArray) -> npt.NDArray[np.bool_]:
        """(cell rows, cell cols) True where a cell deviates in some pair, by (pairs,) thresholds."""
        least = np.clip(np.rint(np.asarray(thresholds) / STEP), 1, HIGHEST)
        alone, line, whole = (self.levels[:, k] >= least for k in range(3))
        return np.asarray(np.any(np.where(line, whole, alone), axis=1)[self.places])

    def share(self, thresholds: Sequence[float] | FloatArray) -> float:
        """Share of the cells that deviate in some pair, by (pairs,) thresholds."""
        return float(self.deviating(thresholds).mean())


@dataclass(frozen=True)
class Deviating:
    """Cells of a predicted map that deviate by the thresholds of a part.

    Attributes:
        share: of all cells.
        variance: of the share by the number of marks: groups of s cells among N are counted, Σ s²/N² (a compound
            Poisson process).
        form: of them; None where none deviates.
    """

    share: float
    variance: float
    form: MarkForm | None

    @classmethod
    def of(cls, over: npt.NDArray[np.bool_]) -> "Deviating":
        """Levels of (cell rows, cell cols), True where a cell deviates."""
        _, _, stats, _ = cv2.connectedComponentsWithStats(over.astype(np.uint8), connectivity=8)
        sizes = stats[1:, cv2.CC_STAT_AREA].astype(np.float64)
        return cls(float(over.mean()), float(np.sum(sizes**2)) / over.size**2, form_of(over))


@dataclass(frozen=True, eq=False)
class SmearedLevels:
    """Levels of the cells of one predicted map.

    Attributes:
        each: one of every `SMEARS`.
    """

    each: tuple[CellLevels, ...]

    @classmethod
    def of(cls, fine: FloatArray, per_cell: int, pairs: Sequence[tuple[int, int]]) -> "SmearedLevels":
        """Levels of a map of contrasts.

        Args:
            fine: (P, rows, cols) radiances of parts of cells.
            per_cell: parts a side of a cell.
            pairs: of poses.
        """
        return cls(tuple(CellLevels.of(contrasts(fine, per_cell, pairs, one)) for one in SMEARS))

    @property
    def cells(self) -> int:
        """Number of cells."""
        return int(self.each[0].places.size)

    def deviating(self, thresholds: Sequence[float] | FloatArray, smear: float) -> Deviating:
        """Cells that deviate by (pairs,) thresholds in a picture that is smeared by a share of the pitch.

        Shares follow the square of the smear nearly linearly; between `SMEARS` they are interpolated.
        """
        squares = np.square(SMEARS)
        place = float(np.interp(smear**2, squares, np.arange(len(SMEARS))))
        low = min(int(place), len(SMEARS) - 2)
        weight = place - low
        less, more = (Deviating.of(one.deviating(thresholds)) for one in self.each[low : low + 2])
        return Deviating(
            (1.0 - weight) * less.share + weight * more.share,
            (1.0 - weight) * less.variance + weight * more.variance,
            (less if weight < 0.5 and less.form is not None else more).form or less.form,
        )


def contrasts(
    fine: FloatArray, per_cell: int, pairs: Sequence[tuple[int, int]], smear: float = 0.0
) -> FloatArray:
    """(pairs, cell rows, cell cols) ln ratios of whole cells; arguments as for `SmearedLevels.of`."""
    sigma = smear * CELLS_PER_PITCH * per_cell
    seen = fine
    if sigma > 0.0:
        seen = np.stack(
            [cv2.GaussianBlur(one, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE) for one in fine]
        )
    rows, cols = (size // per_cell for size in fine.shape[1:])
    whole = seen[:, : rows * per_cell, : cols * per_cell]
    means = whole.reshape(-1, rows, per_cell, cols, per_cell).mean(axis=(2, 4))
    safe = np.maximum(means, 1e-6)
    return np.stack([np.log(safe[i] / safe[j]) for i, j in pairs])
