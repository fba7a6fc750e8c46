"""Crossed gauge R&R: how much of what is seen comes from measuring, and how much from the parts.

Two-way analysis of variance with random parts and appraisers: AIAG, Measurement Systems Analysis, 4th edition
(2010), chapter III-B; D. C. Montgomery and G. C. Runger, Quality Engineering 6 (1993) 115 and 289. With one appraiser,
such as a machine that needs none, it is a one-way analysis.
"""

import math
from dataclasses import replace

import numpy as np

from anisoscope.base.errors import UsageError
from anisoscope.quality.gauge_share import share_interval
from anisoscope.quality.gauge_study import POOR_SHARE, GaugeData, GaugeStudy
from anisoscope.quality.mean_squares import (
    CONFIDENCE,
    Component,
    MeanSquare,
    component,
    crossed_squares,
    joined,
)
from anisoscope.quality.readings import Readings

POOLING_ALPHA = 0.25


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
    part, appraiser, interaction, repeat = crossed_squares(data.values)
    interaction = interaction.against(repeat)
    pooled = interaction.p is None or interaction.p > POOLING_ALPHA
    error = joined(interaction, repeat) if pooled else interaction
    noise = error if pooled else repeat
    part, appraiser = part.against(error), appraiser.against(error)
    by_whom, by_pair = 1.0 / (p * r), 0.0 if pooled else (p - 1.0) / (p * r)

    def of(name: str, *terms: tuple[float, MeanSquare]) -> Component:
        return component(name, terms, confidence)

    own = of("repeatability", (1.0, noise))
    who = of("appraiser", (by_whom, appraiser), (-by_whom, error))
    pair = None if pooled else of("interaction", (1.0 / r, interaction), (-1.0 / r, repeat))
    share = 1.0 - by_whom - by_pair
    measuring = ((by_whom, appraiser), (by_pair, interaction), (share, noise))
    gauge = of("gauge R&R", *measuring)
    both = of("reproducibility", (by_whom, appraiser), (by_pair, interaction), (share - 1.0, noise))
    between = 1.0 / (o * r)
    among = ((between, part), (-between, error))
    parts = of("part", *among)
    total = of("total", (between, part), (by_whom, appraiser), (by_pair - between, interaction), (share, noise)) \
        if not pooled else of("total", (between, part), (by_whom, appraiser), (share - between, noise))  # fmt: skip
    found = _kept([own, who, *([pair] if pair else [])], parts, (gauge, both, total))
    table = (part, appraiser, interaction, repeat, *((error,) if pooled else ()))
    reach = share_interval(measuring, among, confidence)
    notes = (*_notes(data, (own, who, pair, parts), pooled=pooled), *_undecided(reach, confidence))
    return GaugeStudy(
        data,
        table,
        pooled,
        own,
        found[1],
        who,
        pair,
        found[0],
        parts,
        found[2],
        tolerance,
        notes,
        confidence,
        reach,
    )


def _one_way(data: GaugeData, tolerance: float | None, confidence: float) -> GaugeStudy:
    r = data.values.shape[2]
    part, _, _, repeat = crossed_squares(data.values)
    part = part.against(repeat)
    own = component("repeatability", [(1.0, repeat)], confidence)
    among = ((1.0 / r, part), (-1.0 / r, repeat))
    parts = component("part", among, confidence)
    gauge = component("gauge R&R", [(1.0, repeat)], confidence)
    total = component("total", [(1.0 / r, part), (1.0 - 1.0 / r, repeat)], confidence)
    (gauge, _, total) = _kept([own], parts, (gauge, gauge, total))
    reach = share_interval([(1.0, repeat)], among, confidence)
    notes = (*_notes(data, (own, None, None, parts), pooled=False), *_undecided(reach, confidence))
    return GaugeStudy(
        data,
        (part, repeat),
        False,
        own,
        None,
        None,
        None,
        gauge,
        parts,
        total,
        tolerance,
        notes,
        confidence,
        reach,
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


def _undecided(reach: tuple[float, float], confidence: float) -> tuple[str, ...]:
    """A study that is too small to tell a good gauge from a poor one says so."""
    low, high = reach
    if not low <= POOR_SHARE < high:
        return ()
    said = (
        f"the share of the study variation lies between {low:.1%} and {high:.1%} ({confidence:.0%} interval), on both "
        f"sides of {POOR_SHARE:.0%}: more appraisers or parts would tell"
    )
    return (said,)


ALONE = "(one)"


def gauge_data(readings: Readings, number: str | None = None) -> GaugeData:
    """Sort readings by part and appraiser.

    Args:
        readings: the part stands in the column ``part`` or ``serial``, the appraiser in ``appraiser`` or ``operator``;
            where there is neither, one appraiser did all.
        number: which number; the first one for None.

    Raises:
        UsageError: no column of parts, a missing value, or a part that was not measured as often as the others.
    """
    _, values = readings.number(number)
    part = readings.column("part" if "part" in readings.texts else "serial")
    whom = next((readings.texts[name] for name in ("appraiser", "operator") if name in readings.texts), ())
    whom = tuple(name or ALONE for name in whom) or (ALONE,) * len(part)
    cells: dict[tuple[str, str], list[float]] = {}
    for key, value in zip(zip(part, whom, strict=True), values.tolist(), strict=True):
        if np.isnan(value):
            raise UsageError(
                f"{readings.source}: part {key[0]} by {key[1]} has a missing value: measure it again"
            )
        cells.setdefault(key, []).append(value)
    parts, appraisers = tuple(dict.fromkeys(part)), tuple(dict.fromkeys(whom))
    trials = max(len(cell) for cell in cells.values())
    for one in parts:
        for by in appraisers:
            found = len(cells.get((one, by), ()))
            if found != trials:
                raise UsageError(
                    f"{readings.source}: part {one} was measured {found} times by {by}, others {trials} times: a gauge "
                    "study needs every part equally often"
                )
    table = [[cells[one, by] for by in appraisers] for one in parts]
    return GaugeData(parts, appraisers, np.array(table, dtype=np.float64))
