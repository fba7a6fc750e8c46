"""Process capability Cp, Cpk (short term), Pp, Ppk (long term) with confidence intervals, and specification limits.

Sources: NIST/SEMATECH e-Handbook 6.1.6; the interval of Cp and Pp is that of a variance (chi-square), the one of Cpk
and Ppk the approximation of A. F. Bissell, Applied Statistics 39 (1990) 331. Both presume normal values.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import json_field
from anisoscope.history.rows import CAUSE, PRECISION
from anisoscope.quality.limits import Limits
from anisoscope.quality.readings import Readings
from anisoscope.record.surface_details import contrast_label
from anisoscope.sim.light.contrasts import consecutive_pairs

if TYPE_CHECKING:
    from anisoscope.recipe.surface import SurfaceRecipe

CONFIDENCE = 0.95
GOOD, POOR = 1.33, 1.0


@dataclass(frozen=True)
class Specification:
    """Specification limits; None for a one-sided specification.

    Raises:
        UsageError: none at all, or the lower not below the upper.
    """

    lower: float | None
    upper: float | None

    def __post_init__(self) -> None:
        if self.lower is None and self.upper is None:
            raise UsageError("a specification needs a lower or an upper limit")
        if self.lower is not None and self.upper is not None and not self.lower < self.upper:
            raise UsageError(
                f"the lower limit ({self.lower:g}) must lie below the upper one ({self.upper:g})"
            )


@dataclass(frozen=True)
class Index:
    """An index and its confidence interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Capability:
    """Capability of a process against its specification.

    Attributes:
        specification: the limits.
        count: measured values.
        mean: of all measured values.
        sigma_short: from moving ranges, or within subgroups.
        sigma_long: standard deviation of all values.
        cp, pp: width of the limits over 6 sigma; None for a limit on one side.
        cpk, ppk: distance of the nearer limit from the mean over 3 sigma.
        outside: measured values beyond a limit.
        outside_expected: share beyond a limit that a normal distribution of the long term would have.
        confidence: of the intervals.
    """

    specification: Specification = field(metadata=json_field(merged=True))
    count: int
    mean: float
    sigma_short: float
    sigma_long: float
    cp: Index | None
    cpk: Index
    pp: Index | None
    ppk: Index
    outside: int
    outside_expected: float
    confidence: float


def spread_index(width: float, sigma: float, freedom: float, confidence: float = CONFIDENCE) -> Index:
    """Cp: the width of the limits over 6 sigma; the interval is exact where sigma² is a chi-square.

    Args:
        width: upper minus lower limit.
        sigma: estimated standard deviation.
        freedom: degrees of freedom of that estimate.
        confidence: of the two-sided interval.
    """
    from scipy.special import chdtri  # noqa: PLC0415 - heavy

    value, tail = width / (6.0 * sigma), (1.0 - confidence) / 2.0
    low, high = (math.sqrt(float(chdtri(freedom, above)) / freedom) for above in (1.0 - tail, tail))
    return Index(value, value * low, value * high)


def nearer_index(value: float, count: int, freedom: float, confidence: float = CONFIDENCE) -> Index:
    """Cpk with the interval of Bissell (1990).

    Args:
        value: the index.
        count: values of the mean.
        freedom: degrees of freedom of sigma.
        confidence: of the two-sided interval.
    """
    from scipy.special import ndtri  # noqa: PLC0415 - heavy

    reach = float(ndtri(0.5 + confidence / 2.0)) * math.sqrt(1.0 / (9.0 * count) + value**2 / (2.0 * freedom))
    return Index(value, value - reach, value + reach)


def capability(
    values: FloatArray, limits: Limits, specification: Specification, confidence: float = CONFIDENCE
) -> Capability:
    """Short- and long-term capability of a series.

    Args:
        values: (N,), NaN is missing.
        limits: of its chart; its sigma is the short-term one.
        specification: limits of good parts.
        confidence: of the intervals.

    Raises:
        UsageError: all values are the same.
    """
    from scipy.special import ndtr  # noqa: PLC0415 - heavy

    measured = values[~np.isnan(values)]
    count, mean, sigma = len(measured), float(measured.mean()), float(measured.std(ddof=1))
    if sigma == 0.0:
        raise UsageError("all values are the same: a capability needs values that vary")
    lower, upper = specification.lower, specification.upper
    rooms = [mean - lower] if lower is not None else []
    rooms += [upper - mean] if upper is not None else []
    width = None if lower is None or upper is None else upper - lower
    low, high = -math.inf if lower is None else lower, math.inf if upper is None else upper

    def both(sd: float, freedom: float) -> tuple[Index | None, Index]:
        freedom = min(freedom, 1e9)
        spread = None if width is None else spread_index(width, sd, freedom, confidence)
        return spread, nearer_index(min(rooms) / (3.0 * sd), count, freedom, confidence)

    cp, cpk = both(limits.sigma, limits.freedom)
    pp, ppk = both(sigma, count - 1.0)
    expected = float(ndtr((low - mean) / sigma) + ndtr((mean - high) / sigma))
    outside = int(np.count_nonzero((measured < low) | (measured > high)))
    return Capability(
        specification, count, mean, limits.sigma, sigma, cp, cpk, pp, ppk, outside, expected, confidence
    )


DEVIATION, TOLERANCE, DOUBT = "deviation ", "tolerance ", "u "
SAME = 4.0 * PRECISION  # two predictions of one recipe differ by rounding only


def recipe_tolerances(recipe: "SurfaceRecipe") -> dict[str, float]:
    """The tolerance of every contrast of a recipe, by its label.

    Raises:
        UsageError: the recipe gives none.
    """
    tolerances = recipe.tolerances()
    if tolerances is None:
        raise UsageError(
            f"the recipe of {recipe.product} has no decision.tolerance: give --lower and --upper"
        )
    poses = recipe.poses.poses()
    names = [
        contrast_label(recipe.decision.contrast, poses[i].stage_deg, poses[j].stage_deg, poses[i].tilt_deg)
        for i, j in consecutive_pairs(poses)
    ]
    return dict(zip(names, tolerances, strict=True))


def specification(
    readings: Readings, number: str, tolerances: Mapping[str, float] | None = None
) -> Specification | None:
    """Specification limits of a number from a recipe or from the readings' own tolerances.

    A deviation lies within ± its tolerance, a contrast within its prediction ± its tolerance.

    Args:
        readings: the number and, where they come from a history, their ``deviation …`` and ``tolerance …``.
        number: which number.
        tolerances: of a recipe, by contrast; None for those of the history.

    Returns:
        None where neither states them.

    Raises:
        UsageError: the parts were predicted or tolerated differently, so that no one pair of limits holds.
    """
    if number in readings.limits and tolerances is None:
        return Specification(*readings.limits[number])
    contrast = number.removeprefix(DEVIATION)
    width = tolerances.get(contrast) if tolerances is not None else _one(readings, TOLERANCE + contrast)
    if width is None:
        return None
    if number != contrast:
        return Specification(-width, width)
    if DEVIATION + contrast not in readings.numbers:
        return None
    predicted = readings.numbers[contrast] - readings.numbers[DEVIATION + contrast]
    known = predicted[~np.isnan(predicted)]
    if len(known) == 0:
        return None
    if float(np.ptp(known)) > SAME * float(np.nanmax(np.abs(readings.numbers[contrast]))):
        raise UsageError(
            f"{readings.source}: {contrast} was predicted as {known.min():.4g} to {known.max():.4g}: chart "
            f"--number {DEVIATION + contrast!r}, or choose one recipe"
        )
    return Specification(float(known[0]) - width, float(known[0]) + width)


def _one(readings: Readings, name: str) -> float | None:
    """The value of a number that is the same everywhere."""
    found = readings.numbers.get(name)
    known = np.array([]) if found is None else found[~np.isnan(found)]
    if len(known) == 0:
        return None
    if float(np.ptp(known)) > SAME * float(known.max()):
        raise UsageError(
            f"{readings.source}: {name} is {known.min():.4g} for some parts and {known.max():.4g} for others: "
            "choose one recipe, or give --lower and --upper"
        )
    return float(known[0])


def charted(readings: Readings) -> tuple[str, ...]:
    """Names of the numbers that are worth a chart: all but uncertainties, tolerances and weights of causes."""
    return tuple(name for name in readings.numbers if not name.startswith((TOLERANCE, DOUBT, CAUSE)))
