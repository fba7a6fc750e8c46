"""The equations of a response curve, and their solution; see `anisoscope.rig.cameras.response`."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError

Mask = npt.NDArray[np.bool_]

KNOTS = 33
LEAST_LEVEL = 0.03
MOST_CLIPPED = 0.98
_MOST_PIXELS = 200_000
_SMOOTHNESS = 3e-4
_SUM_WEIGHT = 1e3
_ROUNDS = 5
_LEAST_EQUATIONS = 50
_ANCHOR = 0.9
_GROUPS = 300
_MOSTLY = 0.99


@dataclass(frozen=True, eq=False)
class Series:
    """An exposure series.

    Attributes:
        levels: (exposures, pixels) counts as a share of the range: 0 is black, 1 is white.
        times_s: (exposures,) ascending.
        step: share of the range that is one count.
    """

    levels: FloatArray
    times_s: FloatArray
    step: float

    @cached_property
    def usable(self) -> Mask:
        """(exposures, pixels) neither nearly black nor clipped."""
        return np.asarray((self.levels > LEAST_LEVEL) & (self.levels < MOST_CLIPPED))


@dataclass(frozen=True, eq=False)
class Solution:
    """A curve: `light` of levels, 0 at 0 and 1 at 1; and how well the pixels agree on it."""

    light: Callable[[FloatArray], FloatArray]
    residual: float


@dataclass(frozen=True, eq=False)
class _Groups:
    """(groups, exposures) mean levels and whether they can be used; (groups, exposures, ramps) mean ramps."""

    levels: FloatArray
    ramps: FloatArray
    usable: Mask
    times_s: FloatArray


def solve(series: Series) -> Solution:
    """Solve for the curve.

    Raises:
        CalibrationError: hardly any place is neither black nor clipped in two neighbouring exposures.
    """
    groups = _grouped(series)
    usable = np.stack([series.usable[:, group].mean(axis=1) > _MOSTLY for group in groups])
    levels = np.stack([series.levels[:, group].mean(axis=1) for group in groups])
    ramps = np.stack([[_ramps(line).mean(axis=0) for line in series.levels[:, group]] for group in groups])
    if np.sum(usable[:, :-1] & usable[:, 1:]) < _LEAST_EQUATIONS:
        raise CalibrationError(
            "hardly any place is neither black nor clipped in two neighbouring exposures: choose exposures that "
            "lie closer together, and a scene with dark and bright places"
        )
    coefficients = np.full(KNOTS - 1, 1.0 / (KNOTS - 1))
    for _ in range(_ROUNDS):
        coefficients = _least_squares(_Groups(levels, ramps, usable, series.times_s), coefficients)
    return Solution(_curve(coefficients), _residual(ramps @ coefficients, usable, series.times_s))


def _grouped(series: Series) -> list[npt.NDArray[np.intp]]:
    """Pixels in groups of like brightness.

    One equation a group instead of one a pixel: the noise of single counts would bend the curve, since it
    stands in what multiplies the unknowns.
    """
    seen = np.flatnonzero(series.usable.sum(axis=0) > 1)
    ordered = seen[np.argsort(series.levels[:, seen].mean(axis=0), kind="stable")]
    if len(ordered) > _MOST_PIXELS:
        ordered = ordered[np.linspace(0, len(ordered) - 1, _MOST_PIXELS).astype(int)]
    return np.array_split(ordered, min(_GROUPS, len(ordered)))


def _ramps(levels: FloatArray) -> FloatArray:
    """(N, KNOTS − 1) ramps from 0 to 1, each over one piece between knots."""
    return np.clip(levels[:, None] * (KNOTS - 1) - np.arange(KNOTS - 1)[None, :], 0.0, 1.0)


def _least_squares(groups: _Groups, before: FloatArray) -> FloatArray:
    from scipy.optimize import nnls  # noqa: PLC0415 - slow to import

    normal = np.zeros((KNOTS - 1, KNOTS - 1))
    slope = np.maximum(before, 0.1 / (KNOTS - 1)) * (KNOTS - 1)
    piece = np.clip((groups.levels * (KNOTS - 1)).astype(int), 0, KNOTS - 2)
    rows = groups.ramps / groups.times_s[None, :, None]
    sigma = slope[piece] / groups.times_s
    for short in range(len(groups.times_s) - 1):
        both = groups.usable[:, short] & groups.usable[:, short + 1]
        weight = 1.0 / np.hypot(sigma[both, short], sigma[both, short + 1])
        weighted = (rows[both, short] - rows[both, short + 1]) * weight[:, None]
        normal += weighted.T @ weighted
    scale = np.trace(normal) / len(normal)
    bend = np.diff(np.eye(KNOTS - 1), n=2, axis=0)
    normal += _SMOOTHNESS * scale * bend.T @ bend
    root = np.linalg.cholesky(normal + 1e-12 * scale * np.eye(len(normal))).T
    # The equations leave the scale free. It is fixed where there are counts: fixed at white, which no usable
    # count reaches, the sum of squares would be least with all the light beyond the last count.
    top = np.quantile(groups.levels[groups.usable], _ANCHOR)
    anchor = _SUM_WEIGHT * np.sqrt(scale) * _ramps(np.array([top]))
    found, _ = nnls(np.vstack([root, anchor]), np.append(np.zeros(KNOTS - 1), _SUM_WEIGHT * np.sqrt(scale)))
    return np.asarray(found / found.sum())


def _curve(coefficients: FloatArray) -> Callable[[FloatArray], FloatArray]:
    from scipy.interpolate import PchipInterpolator  # noqa: PLC0415 - slow to import

    inside = PchipInterpolator(np.linspace(0.0, 1.0, KNOTS), np.append(0.0, np.cumsum(coefficients)))
    first_slope = float(coefficients[0]) * (KNOTS - 1)

    def light(levels: FloatArray) -> FloatArray:
        """Below black the curve goes on as it begins, so that noise about black stays even."""
        within = np.asarray(inside(np.clip(levels, 0.0, 1.0)))
        return np.where(levels < 0.0, first_slope * levels, within)

    return light


def _residual(light: FloatArray, usable: Mask, times_s: FloatArray) -> float:
    """How far the exposures disagree about the (groups, exposures) light of like pixels, relative, rms."""
    exposed_s = np.where(usable, times_s, 0.0).sum(axis=1)
    several = usable.sum(axis=1) > 1
    rate = np.where(usable, light, 0.0)[several].sum(axis=1) / exposed_s[several]
    deviation = light[several] / (rate[:, None] * times_s) - 1.0
    return float(np.sqrt(np.mean(deviation[usable[several]] ** 2)))
