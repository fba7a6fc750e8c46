"""Form of a part: where its facets lean otherwise than around, over several ridges: sink marks, bulges, waves.

The angle map without the plane through it, which a curved or tilted part has, averaged over `WINDOW_UM` by the median,
so that marks of single cells do not count. The form itself is the integral of the lean across the ridges.
"""

from dataclasses import astuple, dataclass
from weakref import WeakKeyDictionary

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError
from anisoscope.imaging.angle_map import AngleMap
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.record.schema import FormRecord
from anisoscope.record.verdict import Verdict

WINDOW_UM = 300.0
LEAST_SEEN = 0.5
"""Share of the cells of a window that must be known."""
FORM = "form"
MEDIAN_U = 1.2533
"""Standard uncertainty of a median of normal values over that of their mean."""
OPPOSITE = 0.3
"""Lean of the other flank of a hollow or bulge, over that of the steeper one, at the least."""
NEAR_ROWS = 1
"""Rows of cells on either side that the depth is averaged over."""
_ROUNDS, _USUAL = 10, 1.5


@dataclass(frozen=True)
class FormDeviation:
    """Largest departure of the lean of the facets from a plane.

    Attributes:
        lean_deg: by how much the facets lean otherwise there, degrees, above 0.
        u_deg: its standard uncertainty.
        x_mm: place on the sample from the rotation axis.
        y_mm: likewise.
        depth_um: of the form about it, from the lean across the ridges; negative where it stands out,
            0 where the other flank is not seen.
        windows: number of windows that the part holds side by side.
    """

    lean_deg: float
    u_deg: float
    x_mm: float
    y_mm: float
    depth_um: float
    windows: float

    @property
    def by_chance_deg(self) -> float:
        """Largest lean that noise alone makes anywhere on a plane part, about."""
        return self.u_deg * float(np.sqrt(2.0 * np.log(max(self.windows, 2.0))))

    def record(self, limit_deg: float, coverage: float) -> FormRecord | None:
        """What a record holds of it, judged by a limit with a guard band of ``coverage`` · u; None if hidden.

        Noise hides the form where it alone reaches into the guard band.
        """
        guard = coverage * self.u_deg
        if self.by_chance_deg > limit_deg - guard:
            return None
        verdict = Verdict.INCONCLUSIVE
        if self.lean_deg <= limit_deg - guard:
            verdict = Verdict.PASS
        elif self.lean_deg >= limit_deg + guard:
            verdict = Verdict.FAIL
        return FormRecord(
            lean_deg=self.lean_deg,
            u_deg=self.u_deg,
            max_lean_deg=limit_deg,
            x=self.x_mm,
            y=self.y_mm,
            depth_um=self.depth_um,
            verdict=verdict,
        )


_KNOWN: WeakKeyDictionary[Measured, FormDeviation] = WeakKeyDictionary()


def form_known(measured: Measured) -> FormDeviation | None:
    """The form of a measurement that was found before, or stored."""
    return _KNOWN.get(measured)


def remember_form(measured: Measured, form: FormDeviation) -> None:
    """Store the form of a measurement."""
    _KNOWN[measured] = form


def form_arrays(measured: Measured) -> dict[str, FloatArray]:
    """The form of a measurement as it is stored: one array, or none."""
    form = form_known(measured)
    return {} if form is None else {FORM: np.array(astuple(form))}


def form_deviation(found: AngleMap) -> FormDeviation:
    """Where the facets of a part lean most otherwise than a plane says, over several ridges.

    Args:
        found: the leans of the cells.

    Raises:
        MeasurementError: the map is too small or too empty.
    """
    step_x, step_y = (
        1000.0 * float(np.ptp(place)) / max(len(place) - 1, 1) for place in (found.across_mm, found.along_mm)
    )
    half_x, half_y = (max(1, round(0.5 * (WINDOW_UM / max(step, 1e-9) - 1.0))) for step in (step_x, step_y))
    off = _without_plane(found)
    smooth, known = _medians(off, half_y, half_x)
    if not np.isfinite(smooth).any():
        raise MeasurementError("too few cells of the angle map are known to tell the form of the part")
    smooth -= np.nanmedian(smooth)
    i, j = map(int, np.unravel_index(int(np.nanargmax(np.abs(smooth))), smooth.shape))
    calm = off - smooth
    scatter = 1.4826 * float(np.nanmedian(np.abs(calm - np.nanmedian(calm))))
    near = off[max(i - NEAR_ROWS, 0) : i + NEAR_ROWS + 1]
    column, depth = _bottom(np.nan_to_num(smooth[i]), _filled(near), j, step_x)
    return FormDeviation(
        float(abs(smooth[i, j])),
        MEDIAN_U * scatter / float(np.sqrt(known[i, j])),
        *_place(found, i, column),
        depth,
        float(np.isfinite(off).sum()) / ((2 * half_y + 1) * (2 * half_x + 1)),
    )


def _filled(rows: FloatArray) -> FloatArray:
    """(C,) means of the known values of some rows; between known ones where a column has none."""
    known = np.isfinite(rows).any(axis=0)
    values = np.zeros(rows.shape[1])
    values[known] = np.nanmean(rows[:, known], axis=0)
    columns = np.arange(len(values))
    return np.asarray(np.interp(columns, columns[known], values[known])) if known.any() else values


def _place(found: AngleMap, row: int, column: int) -> tuple[float, float]:
    """Sample millimetres of a cell; of a row's and column's mean where the cell has none."""
    x, y = found.x_mm[row, column], found.y_mm[row, column]
    if np.isfinite(x) and np.isfinite(y):
        return float(x), float(y)
    near = np.abs(found.along_mm[:, None] - found.along_mm[row]) + np.abs(
        found.across_mm - found.across_mm[column]
    )
    best = np.unravel_index(int(np.argmin(np.where(np.isfinite(found.x_mm), near, np.inf))), near.shape)
    return float(found.x_mm[best]), float(found.y_mm[best])


def _without_plane(found: AngleMap) -> FloatArray:
    """(A, C) lean without the plane through most of the cells (Huber's weights)."""
    x, y = np.meshgrid(found.across_mm, found.along_mm)
    known = np.isfinite(found.angle_deg)
    terms = np.stack([np.ones(known.sum()), x[known], y[known]], axis=1)
    values, weight = found.angle_deg[known], np.ones(known.sum())
    plane = np.zeros(3)
    for _ in range(_ROUNDS):
        plane = np.linalg.lstsq(terms * weight[:, None], values * weight, rcond=None)[0]
        left = np.abs(values - terms @ plane)
        usual = _USUAL * max(1.4826 * float(np.median(left)), 1e-6)
        weight = np.sqrt(1.0 / np.maximum(1.0, left / usual))
    return np.asarray(found.angle_deg - (plane[0] + plane[1] * x + plane[2] * y))


def _medians(values: FloatArray, half_rows: int, half_cols: int) -> tuple[FloatArray, FloatArray]:
    """(A, C) medians of a window about every cell, NaN where too few are known, and how many are."""
    padded = np.pad(values, ((half_rows, half_rows), (half_cols, half_cols)), constant_values=np.nan)
    window = (2 * half_rows + 1, 2 * half_cols + 1)
    cells = np.lib.stride_tricks.sliding_window_view(padded, window).reshape(*values.shape, -1)
    inside = np.pad(np.ones(values.shape), ((half_rows, half_rows), (half_cols, half_cols)))
    size = np.lib.stride_tricks.sliding_window_view(inside, window).sum(axis=(2, 3))
    known = np.isfinite(cells).sum(axis=2)
    enough = known >= np.maximum(LEAST_SEEN * size, 1.0)
    medians = np.full(values.shape, np.nan)
    medians[enough] = np.nanmedian(cells[enough], axis=1)
    return medians, known.astype(np.float64)


def _bottom(smooth: FloatArray, leans_deg: FloatArray, at: int, step_um: float) -> tuple[int, float]:
    """Column of the bottom of a form with a flank at column ``at`` of a row, and its depth (below 0: height).

    The lean across is −dz/dx: left of the bottom of a hollow it is above 0, right of it below. The form is the integral
    over the flank, whose end towards the stronger opposite lean is the bottom.

    Args:
        smooth: (C,) averaged leans of the row in degrees.
        leans_deg: (C,) the leans themselves.
        at: column of the steepest place.
        step_um: distance of the columns.
    """
    sign = float(np.sign(smooth[at]))
    same = sign * smooth > 0.0
    first = last = at
    while first > 0 and same[first - 1]:
        first -= 1
    while last + 1 < len(same) and same[last + 1]:
        last += 1
    change = float(np.sum(np.tan(np.radians(leans_deg[first : last + 1])))) * step_um
    before, after = (
        float(np.max(-sign * part, initial=0.0)) for part in (smooth[:first], smooth[last + 1 :])
    )
    if max(before, after) < OPPOSITE * abs(smooth[at]):
        return at, 0.0
    return (last, change) if after >= before else (first, -change)
