"""A crossed gauge study: its measurements, and what is found in them."""

import math
from dataclasses import dataclass
from typing import Any

from anisoscope.base.arrays import FloatArray
from anisoscope.quality.gauge_share import CATEGORIES, categories_of
from anisoscope.quality.mean_squares import Component, MeanSquare

GOOD_SHARE, POOR_SHARE = 0.10, 0.30
ENOUGH_CATEGORIES = 5


@dataclass(frozen=True, eq=False)
class GaugeData:
    """Measurements of a crossed study.

    Attributes:
        parts: P names.
        appraisers: O names.
        values: (P, O, R); R repeated measurements of every part by every appraiser.
    """

    parts: tuple[str, ...]
    appraisers: tuple[str, ...]
    values: FloatArray


@dataclass(frozen=True, eq=False)
class GaugeStudy:
    """What the study finds.

    Attributes:
        data: the measurements.
        table: the ANOVA table, with the interaction as long as there are two appraisers.
        pooled: the interaction was counted as repeatability, for it is not significant at 0.25.
        repeatability, reproducibility, gauge, part, total: variances; gauge is repeatability and reproducibility.
        appraiser, interaction: the two of reproducibility; None where not estimated.
        tolerance: width between the limits, or None.
        notes: what the reader should know.
        confidence: of the intervals.
        share: interval of the gauge's share of the study variation (%GRR as a share).
    """

    data: GaugeData
    table: tuple[MeanSquare, ...]
    pooled: bool
    repeatability: Component
    reproducibility: Component | None
    appraiser: Component | None
    interaction: Component | None
    gauge: Component
    part: Component
    total: Component
    tolerance: float | None
    notes: tuple[str, ...]
    confidence: float
    share: tuple[float, float]

    @property
    def components(self) -> tuple[Component, ...]:
        """All that were estimated, the gauge first."""
        some = (
            self.gauge, self.repeatability, self.reproducibility, self.appraiser, self.interaction, self.part,
            self.total,
        )  # fmt: skip
        return tuple(one for one in some if one is not None)

    def share_of_study(self, one: Component) -> float:
        """Standard deviation over that of everything (%GRR as a share)."""
        return one.sigma / self.total.sigma

    def share_of_tolerance(self, one: Component) -> float | None:
        """Six standard deviations over the tolerance; None without one."""
        return None if self.tolerance is None else 6.0 * one.sigma / self.tolerance

    @property
    def categories(self) -> int | None:
        """Number of distinct categories (ndc): 1.41 part over gauge, cut to a whole number; None without noise."""
        return None if self.gauge.sigma == 0.0 else int(CATEGORIES * self.part.sigma / self.gauge.sigma)

    @property
    def categories_interval(self) -> tuple[int | None, int | None]:
        """The interval of ndc; None at an end where there may be no noise."""
        low, high = self.share
        return categories_of(high), categories_of(low)

    @property
    def tolerance_interval(self) -> tuple[float, float] | None:
        """The interval of the gauge's share of the tolerance, from that of its variance; None without a tolerance."""
        if self.tolerance is None:
            return None
        return 6.0 * math.sqrt(self.gauge.low) / self.tolerance, 6.0 * math.sqrt(
            self.gauge.high
        ) / self.tolerance

    @property
    def verdict(self) -> str:
        """The outcome in plain words, by the rules of the AIAG manual."""
        share, of = self.share_of_study(self.gauge), "of the study variation"
        tolerance_share = self.share_of_tolerance(self.gauge)
        if tolerance_share is not None:
            share, of = max((share, of), (tolerance_share, "of the tolerance"))
        if share < GOOD_SHARE:
            word = "good"
        elif share <= POOR_SHARE:
            word = "usable for some purposes"
        else:
            word = "not good enough"
        text = f"{word}: measuring makes up {share:.1%} {of}"
        few = self.categories is not None and self.categories < ENOUGH_CATEGORIES
        return text + (
            f"; it tells only {self.categories} classes of parts apart ({ENOUGH_CATEGORIES} wanted)"
            if few
            else ""
        )

    def to_json(self) -> dict[str, Any]:
        """All of it but the measurements, for JSON."""
        return {
            "parts": len(self.data.parts),
            "appraisers": len(self.data.appraisers),
            "trials": self.data.values.shape[2],
            "anova": [vars(line) | {"mean_square": line.value} for line in self.table],
            "pooled": self.pooled,
            "components": {
                one.name: vars(one)
                | {
                    "variance": one.variance,
                    "sigma": one.sigma,
                    "of_study": self.share_of_study(one),
                    "of_tolerance": self.share_of_tolerance(one),
                }
                for one in self.components
            },
            "of_study_interval": list(self.share),
            "of_tolerance_interval": self.tolerance_interval and list(self.tolerance_interval),
            "ndc": self.categories,
            "ndc_interval": list(self.categories_interval),
            "tolerance": self.tolerance,
            "confidence": self.confidence,
            "verdict": self.verdict,
            "notes": list(self.notes),
        }
