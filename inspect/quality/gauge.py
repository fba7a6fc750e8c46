"""Crossed gauge R&R: how much of what is seen comes from measuring, and how much from the parts.

Two-way analysis of variance with random parts and appraisers: AIAG, Measurement Systems Analysis, 4th edition
(2010), chapter III-B; D. C. Montgomery and G. C. Runger, Quality Engineering 6 (1993) 115 and 289. With one appraiser,
such as a machine that needs none, it is a one-way analysis.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from anisoscope.errors import UsageError
from anisoscope.quality.individuals import FloatArray
from anisoscope.quality.meansquares import CONFIDENCE, Component, MeanSquare, component

POOLING_ALPHA = 0.25
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
        return None if self.gauge.sigma == 0.0 else int(1.41 * self.part.sigma / self.gauge.sigma)

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
            "ndc": self.categories,
            "tolerance": self.tolerance,
            "confidence": self.confidence,
            "verdict": self.verdict,
            "notes": list(self.notes),
        }


def gauge_study(
    data: GaugeData, tolerance: float | None = None, confidence: float = CONFIDENCE
) -> GaugeStudy:
    """Analyse a crossed study.

    Args:
        data: at least 2 parts and 2 trials; no value may be missing.
        tolerance: width between the limits of good parts.
        confidence: of the intervals of the variances.

    Raises:
        UsageError: too little, unbalanced or constant data.
    """
    parts, appraisers, trials = data.values.shape
    if parts < 2 or trials < 2:
        raise UsageError(
            f"a gauge study needs 2 parts and 2 trials or more, not {parts} parts and {trials} trials"
        )
    if np.isnan(data.values).any():
        raise UsageError(
            "a gauge study needs every part measured by every appraiser equally often: a value is missing"
        )
    if float(np.ptp(data.values)) == 0.0:
        raise UsageError("all values of the gauge study are the same: nothing varies")
    if tolerance is not None and not 0.0 < tolerance < math.inf:
        raise UsageError(f"the tolerance must be a finite width above 0, not {tolerance:g}")
    if appraisers == 1:
        return _one_way(data, tolerance, confidence)
    return _two_way(data, tolerance, confidence)


def _two_way(data: GaugeData, tolerance: float | None, confidence: float) -> GaugeStudy:
    p, o, r = data.values.shape
    part, appraiser, interaction, repeat = _squares(data)
    interaction = interaction.against(repeat)
    pooled = interaction.p is None or interaction.p > POOLING_ALPHA
    error = _joined(interaction, repeat) if pooled else interaction
    noise = error if pooled else repeat
    part, appraiser = part.against(error), appraiser.against(error)
    by_whom, by_pair = 1.0 / (p * r), 0.0 if pooled else (p - 1.0) / (p * r)

    def of(name: str, *terms: tuple[float, MeanSquare]) -> Component:
        return component(name, terms, confidence)

    own = of("repeatability", (1.0, noise))
    who = of("appraiser", (by_whom, appraiser), (-by_whom, error))
    pair = None if pooled else of("interaction", (1.0 / r, interaction), (-1.0 / r, repeat))
    share = 1.0 - by_whom - by_pair
    gauge = of("gauge R&R", (by_whom, appraiser), (by_pair, interaction), (share, noise))
    both = of("reproducibility", (by_whom, appraiser), (by_pair, interaction), (share - 1.0, noise))
    parts = of("part", (1.0 / (o * r), part), (-1.0 / (o * r), error))
    between = 1.0 / (o * r)
    total = of("total", (between, part), (by_whom, appraiser), (by_pair - between, interaction), (share, noise)) \
        if not pooled else of("total", (between, part), (by_whom, appraiser), (share - between, noise))  # fmt: skip
    found = _kept([own, who, *([pair] if pair else [])], parts, (gauge, both, total))
    table = (part, appraiser, interaction, repeat, *((error,) if pooled else ()))
    notes = _notes(data, (own, who, pair, parts), pooled=pooled)
    return GaugeStudy(
        data, table, pooled, own, found[1], who, pair, found[0], parts, found[2], tolerance, notes, confidence
    )


def _one_way(data: GaugeData, tolerance: float | None, confidence: float) -> GaugeStudy:
    r = data.values.shape[2]
    part, _, _, repeat = _squares(data)
    part = part.against(repeat)
    own = component("repeatability", [(1.0, repeat)], confidence)
    parts = component("part", [(1.0 / r, part), (-1.0 / r, repeat)], confidence)
    gauge = component("gauge R&R", [(1.0, repeat)], confidence)
    total = component("total", [(1.0 / r, part), (1.0 - 1.0 / r, repeat)], confidence)
    (gauge, _, total) = _kept([own], parts, (gauge, gauge, total))
    notes = _notes(data, (own, None, None, parts), pooled=False)
    return GaugeStudy(
        data, (part, repeat), False, own, None, None, None, gauge, parts, total, tolerance, notes, confidence
    )


def _kept(
    measuring: list[Component], part: Component, sums: tuple[Component, Component, Component]
) -> tuple[Component, Component, Component]:
    """Gauge, reproducibility and total as sums of what is counted: what came out negative is counted as 0."""
    gauge, both, total = sums
    noise = sum(one.variance for one in measuring)
    return (
        replace(gauge, raw=noise),
        replace(both, raw=noise - measuring[0].variance),
        replace(total, raw=noise + part.variance),
    )


def _squares(data: GaugeData) -> tuple[MeanSquare, MeanSquare, MeanSquare, MeanSquare]:
    """Parts, appraisers, their interaction, and repetition."""
    values = data.values
    p, o, r = values.shape
    mean, cells = values.mean(), values.mean(axis=2)
    by_part, by_whom = cells.mean(axis=1) - mean, cells.mean(axis=0) - mean
    left = cells - mean - by_part[:, None] - by_whom[None, :]
    return (
        MeanSquare("part", p - 1, float(o * r * np.sum(by_part**2))),
        MeanSquare("appraiser", max(o - 1, 1), float(p * r * np.sum(by_whom**2))),
        MeanSquare("part x appraiser", max((p - 1) * (o - 1), 1), float(r * np.sum(left**2))),
        MeanSquare("repeatability", p * o * (r - 1), float(np.sum((values - cells[:, :, None]) ** 2))),
    )


def _joined(one: MeanSquare, other: MeanSquare) -> MeanSquare:
    return MeanSquare(
        "repeatability, pooled", one.freedom + other.freedom, one.sum_squares + other.sum_squares
    )


def _notes(data: GaugeData, found: tuple[Component | None, ...], *, pooled: bool) -> tuple[str, ...]:
    p, o, _ = data.values.shape
    notes = [
        f"the variance of {one.name} came out negative ({one.raw:.3g}) and counts as 0: it drowns in the noise"
        for one in found
        if one is not None and one.negative
    ]
    if pooled:
        notes.append(
            f"part and appraiser do not interact (p above {POOLING_ALPHA:g}): their interaction is pooled with the "
            "repeatability"
        )
    if o == 1:
        notes.append("one appraiser: reproducibility was not studied")
    elif o < 3:
        notes.append(f"{o} appraisers tell little about appraisers: its interval is wide")
    if p < 10:
        notes.append(f"{p} parts; 10 that span the process are usual")
    return tuple(notes)
