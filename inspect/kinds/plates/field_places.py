"""Where the fields of a plate lie: borders between fields that differ, against the raster of the markers.

A border is where a step from the brightness of one field to that of its neighbour has the area that the picture shows
between their middles; the ridges average out over the width of a field. What all borders have in common is the place
of the plate: shift, turn and scale along both axes. What is left is the place of single fields. A large shift, by which
the middles of neighbours would mix, is found first: where fields of one class are most alike, weighed by how unlikely a
shift from the place that the markers give is. What lies around the plate does not count.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray

Image = npt.NDArray[np.float32]

LEAST_STEP = 0.3
"""Least difference of two fields, over the brighter one, whose border is measured."""
MIDDLE = 0.7
LEAST_BORDERS = 6
COARSE = 20
"""Steps along a field in which a large shift is searched."""
LIKELY_SHIFT = 0.25
"""Standard deviation of the shift of a plate in its seat, in fields."""


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


def field_places(picture: Image, points: int, classes: npt.NDArray[np.integer]) -> FieldPlaces | None:
    """Measure the places of the fields; None where too few borders show.

    Args:
        picture: (rows · points, cols · points) first row at the top.
        points: of a field along its side.
        classes: (rows, cols) class of every field, first row at the top.
    """
    x, y = _coarse_shift(picture, points, classes)
    rows, cols = picture.shape
    wide = np.pad(picture, points, mode="edge")
    near = wide[points + y : points + y + rows, points + x : points + x + cols]
    across, down = _borders(near, points), _borders(near.T, points)
    if min(len(across.off), len(down.off)) < LEAST_BORDERS:
        return None
    across = replace(across, off=across.off + x / points)
    down = Borders(down.col, down.row, down.off + y / points, down.fields[:, :, ::-1])
    return FieldPlaces(across, down, (rows // points, cols // points))


def _coarse_shift(picture: Image, points: int, classes: npt.NDArray[np.integer]) -> tuple[int, int]:
    """(x, y) in points, y down, up to half a field, at which fields of a class differ least, in likelihood.

    The fields along the edge are left out: a shift would bring what lies around the plate into them.
    """
    known = np.nan_to_num(picture, nan=float(np.nanmedian(picture)))
    means = cv2.blur(np.pad(known, points, mode="edge"), (points, points))
    rows, cols = classes.shape
    inner = slice(1, -1) if min(rows, cols) > LEAST_BORDERS else slice(None)
    kinds = classes[inner, inner].ravel()
    middle, half, step = points + points // 2, points // 2, max(1, points // COARSE)

    def unlikely(x: int, y: int) -> float:
        shown = means[middle + y :: points, middle + x :: points][:rows, :cols][inner, inner].ravel()
        rest = sum(
            float(np.var(shown[kinds == kind], dtype=np.float64) * np.sum(kinds == kind))
            for kind in set(kinds.tolist())
        )
        return kinds.size * float(np.log(max(rest, 1e-300))) + (x * x + y * y) / (LIKELY_SHIFT * points) ** 2

    shifts = range(-half, half + 1, step)
    return min(((x, y) for y in shifts for x in shifts), key=lambda place: unlikely(*place))


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
