"""Where the fields of a plate lie: borders between fields that differ, against the raster of the markers.

A border is where a step from the brightness of one field to that of its neighbour has the area that the picture shows
between their middles; the ridges average out over the width of a field. What all borders have in common is the place
of the plate: shift, turn and scale along both axes. What is left is the place of single fields.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray

Image = npt.NDArray[np.float32]

LEAST_STEP = 0.3
"""Least difference of two fields, over the brighter one, whose border is measured."""
MIDDLE = 0.7
LEAST_BORDERS = 6


@dataclass(frozen=True, eq=False)
class Borders:
    """Borders along one axis.

    Attributes:
        row, col: (N,) places of the borders in fields, from the middle of the plate; rows count downward.
        off: (N,) by how much each lies off, toward larger columns or rows, in fields.
        fields: (N, 2, 2) row and column of the two fields about each.
    """

    row: FloatArray
    col: FloatArray
    off: FloatArray
    fields: npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class FieldPlaces:
    """Places of the fields of one picture, in fields.

    Attributes:
        across: borders between neighbours in a row.
        down: borders between neighbours in a column.
        shape: (rows, cols) of fields.
    """

    across: Borders
    down: Borders
    shape: tuple[int, int]

    @cached_property
    def _fit(self) -> tuple[FloatArray, FloatArray]:
        """(3,) constant and slopes along rows and columns, of both axes."""
        found = []
        for one in (self.across, self.down):
            design = np.stack([np.ones_like(one.row), one.row, one.col], axis=1)
            found.append(np.asarray(np.linalg.lstsq(design, one.off, rcond=None)[0], dtype=np.float64))
        return found[0], found[1]

    @property
    def shift(self) -> tuple[float, float]:
        """Shift (x, y) of the plate in fields, y up."""
        return float(self._fit[0][0]), -float(self._fit[1][0])

    @property
    def turn_deg(self) -> float:
        """Turn of the plate against the fixture, counter-clockwise."""
        across, down = self._fit
        return float(np.degrees(np.arctan(0.5 * (across[1] - down[2]))))

    @property
    def axial(self) -> float:
        """Axial non-uniformity: difference of the spacings along both axes over their mean (ISO/IEC 15415)."""
        x, y = 1.0 + self._fit[0][2], 1.0 + self._fit[1][1]
        return float(abs(x - y) / (0.5 * (x + y)))

    @property
    def grid(self) -> float:
        """Grid non-uniformity: largest distance of a field from an even grid, in fields (ISO/IEC 15415)."""
        moved = np.zeros((2, *self.shape))
        for number, (one, fit) in enumerate(zip((self.across, self.down), self._fit, strict=True)):
            left = one.off - (fit[0] + fit[1] * one.row + fit[2] * one.col)
            total, count = np.zeros(self.shape), np.zeros(self.shape)
            for side in (0, 1):
                np.add.at(total, tuple(one.fields[:, side].T), left)
                np.add.at(count, tuple(one.fields[:, side].T), 1.0)
            moved[number] = total / np.maximum(count, 1.0)
        return float(np.hypot(*moved).max())


def field_places(picture: Image, points: int) -> FieldPlaces | None:
    """Measure the places of the fields; None where too few borders show.

    Args:
        picture: (rows · points, cols · points) first row at the top.
        points: of a field along its side.
    """
    across, down = _borders(picture, points), _borders(picture.T, points)
    if min(len(across.off), len(down.off)) < LEAST_BORDERS:
        return None
    down = Borders(down.col, down.row, down.off, down.fields[:, :, ::-1])
    return FieldPlaces(across, down, (picture.shape[0] // points, picture.shape[1] // points))


def _borders(picture: Image, points: int) -> Borders:
    """Borders between neighbours in a row."""
    rows, cols = picture.shape[0] // points, picture.shape[1] // points
    width = max(2, round(MIDDLE * points))
    first = (points - width) // 2
    blocks = picture.reshape(rows, points, cols * points)[:, first : first + width]
    profile = blocks.mean(axis=1, dtype=np.float64)  # (rows, cols · points)
    middle = profile.reshape(rows, cols, points)[:, :, first : first + width].mean(axis=2)
    left, right = middle[:, :-1], middle[:, 1:]
    step = left - right
    row, col = np.nonzero(np.abs(step) > LEAST_STEP * np.maximum(left, right))
    half = points // 2
    start = (col + 1) * points - half
    window = profile[row[:, None], start[:, None] + np.arange(2 * half)]
    share = (window - right[row, col][:, None]) / step[row, col][:, None]
    known = np.isfinite(share).all(axis=1) & (np.abs(share.sum(axis=1) - half) < half)
    row, col, share = row[known], col[known], share[known]
    off = (share.sum(axis=1) - half) / points
    fields = np.stack([np.stack([row, col], axis=1), np.stack([row, col + 1], axis=1)], axis=1)
    return Borders(row - 0.5 * (rows - 1), col + 1.0 - 0.5 * cols, off, fields)
