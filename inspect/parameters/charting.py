"""Control charts of measured series (`anisoscope.quality.control`)."""

from dataclasses import dataclass
from pathlib import Path

from anisoscope.base.errors import UsageError


@dataclass(frozen=True)
class Charting:
    """Chart type, limits and rules for a series.

    Attributes:
        chart: i-mr: single values; xbar-r, xbar-s: means of subgroups and their range or standard deviation; p: share
            of parts that FAIL; u: deviations of a part; p-laney, u-laney: where lots differ. By default i-mr, with
            --subgroup xbar-s.
        subgroup: what a subgroup is: lot, day, cavities (one part of each), or how many readings in a row, such as 5.
        of: number that says how many parts a count of --number is of, in p and u charts.
        by: a chart for each product, recipe, lot, cavity, station or operator.
        baseline: limits from this many measured values at the start; else from all.
        period: limits from the values of this reference period, such as 2026-11-01..2026-11-07 or 14d..7d.
        limits_from: limits of earlier data from this file, for later data.
        weight: weight of the newest value in the EWMA.
        width: limits of the EWMA, in its sigma (L).
        center: known mean, in place of a baseline; with --known-sigma.
        sigma: known short-term standard deviation; with --known-mean.
        lower: lower limit of good parts.
        upper: upper limit of good parts.
        rules: Nelson's rules that count, such as 1,2,5,6; all eight by default (on average a false alarm in 73 values),
            of p and u charts 1 to 4.
        distribution: capability by the quantiles of a distribution too: best, lognormal, weibull, rayleigh,
            folded-normal, logistic or normal.
        drift: test for a drift, with false alarms of 1 % in total, and name the cycle data that it came with.
        against: with --drift: the cycle data, or other numbers, to compare with, separated by commas.

    Raises:
        UsageError: ``against`` without ``drift``.
    """

    chart: str | None = None
    subgroup: str | None = None
    of: str | None = None
    by: str | None = None
    baseline: int | None = None
    period: str | None = None
    limits_from: Path | None = None
    weight: float = 0.2
    width: float = 3.0
    center: float | None = None
    sigma: float | None = None
    lower: float | None = None
    upper: float | None = None
    rules: tuple[int, ...] | None = None
    distribution: str | None = None
    drift: bool = False
    against: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if self.against is not None and not self.drift:
            raise UsageError("--against goes with --drift")
