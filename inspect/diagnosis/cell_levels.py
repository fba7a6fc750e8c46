"""Levels of the cells of a predicted map: the share that deviates follows for the scatter of the cells of any part.

Cells of a part deviate by D² in the scatter of its good ones, which is more than that of a smooth predicted surface.
Signatures therefore state by how much the ln L of their cells deviates in every pose, in levels.

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
from anisoscope.imaging.deviation_map import MOST_LOG, CellScatter
from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH

STEP = 0.0125
"""Deviation of ln L between two levels."""
HIGHEST = 127
"""What deviates by more counts as this."""
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


def _same_flank(lines: FloatArray) -> FloatArray:
    """(P, cols) median of the same flank on the neighbouring ridges; the line itself where these are too few."""
    poses, cols = lines.shape
    steps = CELLS_PER_PITCH * np.array([j for j in range(-NEIGHBOURS, NEIGHBOURS + 1) if j])
    at = np.arange(cols)[:, None] + steps
    inside = (at >= 0) & (at < cols)
    neighbours = np.where(inside, lines[:, np.clip(at, 0, cols - 1)], np.nan)
    countable = inside.sum(axis=1) >= MIN_NEIGHBOURS
    found = lines.copy()
    if countable.any():
        found[:, countable] = _median_of_known(neighbours[:, countable])
    assert found.shape == (poses, cols)
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
    """To which levels the cells of a map deviate.

    Each line of cells (a column) runs along one flank of one ridge, so its median is the value of that flank, and
    marks stand out against it. A whole line that deviates from the same flank of the neighbouring ridges belongs to a
    missing or deformed ridge: all of it deviates. Smaller differences between lines come from where the raster cuts the
    flanks, and are ignored.

    Attributes:
        alone: (P, cell rows, cell cols) deviation of the cell from its line, in `STEP`, at most `HIGHEST`.
        lines: (P, cell cols) of the line from the same flank of other ridges.
    """

    alone: npt.NDArray[np.int8]
    lines: npt.NDArray[np.int8]

    @classmethod
    def of(cls, logs: FloatArray, per_cell: int) -> "CellLevels":
        """Levels of a map: (P, rows, cols) ln L, ``per_cell`` rows and columns a cell."""
        along = np.median(logs, axis=1)
        off = np.clip(logs - along[:, None, :], -MOST_LOG, MOST_LOG)
        lines = along.reshape(len(along), -1, per_cell).mean(axis=2)
        rows, cols = (size // per_cell for size in logs.shape[1:])
        alone = off.reshape(-1, rows, per_cell, cols, per_cell).mean(axis=(2, 4))
        return cls(_levels(alone), _levels(lines - _same_flank(lines)))

    def of_poses(self, poses: Sequence[int]) -> "CellLevels":
        """Restrict to selected poses."""
        return CellLevels(self.alone[list(poses)], self.lines[list(poses)])

    def deviating(self, scatter: CellScatter) -> npt.NDArray[np.bool_]:
        """(cell rows, cell cols) True where a cell deviates, by the scatter of good cells."""
        lines = STEP * self.lines[:, None, :].astype(np.float64)
        return scatter.deviating(self.off + np.where(scatter.deviating(lines), lines, 0.0))

    @property
    def off(self) -> FloatArray:
        """(P, cell rows, cell cols) deviation of the cells from their lines, in ln L."""
        return np.asarray(STEP * self.alone.astype(np.float64))


def _levels(off: FloatArray) -> npt.NDArray[np.int8]:
    return np.clip(np.rint(off / STEP), -HIGHEST, HIGHEST).astype(np.int8)


@dataclass(frozen=True)
class Deviating:
    """Cells of a predicted map that deviate by the scatter of those of a part.

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
    def of(cls, fine: FloatArray, per_cell: int) -> "SmearedLevels":
        """Levels of a map: (P, rows, cols) radiances of parts of cells, of which a cell has ``per_cell`` a side."""
        return cls(tuple(CellLevels.of(_logs(fine, per_cell, one), per_cell) for one in SMEARS))

    def of_poses(self, poses: Sequence[int]) -> "SmearedLevels":
        """Restrict to selected poses."""
        return SmearedLevels(tuple(one.of_poses(poses) for one in self.each))

    @property
    def cells(self) -> int:
        """Number of cells."""
        return int(self.each[0].alone[0].size)

    def deviating(self, scatter: CellScatter, smear: float) -> Deviating:
        """Cells that deviate by the scatter of those of a part in a picture that is smeared by a share of the pitch.

        Shares follow the square of the smear nearly linearly; between `SMEARS` they are interpolated.
        """
        squares = np.square(SMEARS)
        place = float(np.interp(smear**2, squares, np.arange(len(SMEARS))))
        low = min(int(place), len(SMEARS) - 2)
        weight = place - low
        less, more = (Deviating.of(one.deviating(scatter)) for one in self.each[low : low + 2])
        return Deviating(
            (1.0 - weight) * less.share + weight * more.share,
            (1.0 - weight) * less.variance + weight * more.variance,
            (less if weight < 0.5 and less.form is not None else more).form or less.form,
        )


def _logs(fine: FloatArray, per_cell: int, smear: float) -> FloatArray:
    """(P, rows, cols) ln L of the whole cells of a map that is smeared by a share of the pitch."""
    sigma = smear * CELLS_PER_PITCH * per_cell
    seen = fine
    if sigma > 0.0:
        seen = np.stack(
            [cv2.GaussianBlur(one, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE) for one in fine]
        )
    rows, cols = (size // per_cell * per_cell for size in fine.shape[1:])
    return np.asarray(np.log(np.maximum(seen[:, :rows, :cols], 1e-6)))
