"""The page of control charts: overview, charts, patterns, capability; it opens offline."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.quality.capability import Capability, Index
from anisoscope.quality.control import ControlStudy
from anisoscope.quality.nelson import MEANING
from anisoscope.report.page import write_page
from anisoscope.report.spc_figures import control_picture, spread_picture
from anisoscope.report.statistics_parts import Grid, Picture, chance, number

LISTED = 200
DETAILED = 12
NAMED_POINTS = 4


def write_spc_page(
    path: Path,
    title: str,
    source: str,
    studies: Sequence[ControlStudy],
    detailed: Sequence[ControlStudy],
    notes: Sequence[str] = (),
) -> None:
    """Write the page, all or nothing.

    Args:
        path: file to write.
        title: heading.
        source: where the values come from.
        studies: all, for the overview.
        detailed: those that get charts; the first 12 do.
        notes: what else the reader should know.

    Raises:
        RecordError: the file cannot be written.
    """
    left = len(detailed) - DETAILED
    more = [f"{left} more have no charts on this page: choose fewer, or one of them"] if left > 0 else []
    content = {
        "title": title,
        "source": source,
        "overview": overview(studies),
        "studies": [study_content(one) for one in detailed[:DETAILED]],
        "notes": [*notes, *more],
    }
    write_page(path, "spc.html", content)


def overview(studies: Sequence[ControlStudy]) -> Grid:
    """One line a series."""
    rows = tuple(
        (
            one.name,
            str(one.count),
            number(one.limits.center),
            number(one.limits.sigma, 3),
            str(len(one.flags)),
            "–" if one.capability is None else interval(one.capability.ppk),
            "stable" if one.stable else "not stable",
        )
        for one in studies
    )
    columns = ("number", "measured", "center", "sigma", "patterns", "Ppk (95 %)", "state")
    return Grid("Overview", "All series at a glance", columns, rows, "overview")


def study_content(study: ControlStudy) -> dict[str, Any]:
    """All that the template shows of one series."""
    normality = study.normality
    words = (
        []
        if normality is None
        else [f"Anderson-Darling A² {normality.adjusted:.3f} (p {chance(normality.p)}): {normality.hint}"]
    )
    return {
        "name": study.name,
        "verdict": study.verdict,
        "good": study.stable and (study.capability is None or study.capability.ppk.value >= 1.0),
        "pictures": [_chart(study), _spread(study)],
        "tables": tables(study),
        "notes": [*words, *study.notes],
    }


def tables(study: ControlStudy, listed: int = LISTED) -> list[Grid]:
    """Limits, capability, and the first patterns of a series."""
    able = [] if study.capability is None else [_capability(study.capability)]
    return [_limits(study), *able, *([_flags(study, listed)] if study.flags else [])]


def interval(index: Index) -> str:
    """An index with its interval."""
    return f"{index.value:.2f} ({index.low:.2f} to {index.high:.2f})".replace("-", "−")


def _chart(study: ControlStudy) -> Picture:
    limits = study.limits
    alt = (
        f"Control charts of {study.name}: {study.count} values about {number(limits.center)} with limits "
        f"{number(limits.lower)} and {number(limits.upper)}; {len(study.flags)} patterns; moving range, mean "
        f"{number(limits.range_center)}, limit {number(limits.range_upper)}, {int(study.wide.sum())} above; moving "
        f"average, {int(study.average.outside.sum())} beyond its limits"
    )
    caption = (
        "Values, moving range and exponentially weighted moving average (EWMA) in the order of measurement. Green: "
        "centre. Red dashes: limits. Red squares: values that belong to a pattern, with the number of the rule where "
        "they are few."
    )
    if len(study.values) > 2400:
        caption += " Of this many values the outline is drawn, and every flagged one."
    return Picture(control_picture(study), alt, caption)


def _spread(study: ControlStudy) -> Picture:
    measured = study.values[~np.isnan(study.values)]
    alt = (
        f"Histogram of {study.name}: {len(measured)} values from {number(float(measured.min()))} to "
        f"{number(float(measured.max()))}, mean {number(float(measured.mean()))}"
    )
    return Picture(spread_picture(study), alt, "How often which value occurs, beside a normal distribution.")


def _limits(study: ControlStudy) -> Grid:
    limits, average = study.limits, study.average
    reach = average.width * limits.sigma * (average.weight / (2.0 - average.weight)) ** 0.5
    rows = (
        ("value", number(limits.lower), number(limits.center), number(limits.upper)),
        ("moving range", number(0.0), number(limits.range_center), number(limits.range_upper)),
        (
            f"EWMA in the long run (λ {average.weight:g}, L {average.width:g})",
            number(limits.center - reach),
            number(limits.center),
            number(limits.center + reach),
        ),
    )
    origin = "given" if limits.baseline == 0 else f"from the first {limits.baseline} measured values"
    title = f"Limits, {origin}; sigma {number(limits.sigma)}"
    return Grid("Limits", title, ("chart", "lower", "center", "upper"), rows, "limits")


def _capability(found: Capability) -> Grid:
    spec = found.specification
    names = (
        ("Cp (short term)", found.cp),
        ("Cpk (short term)", found.cpk),
        ("Pp (long term)", found.pp),
        ("Ppk (long term)", found.ppk),
    )
    rows = tuple((name, interval(index)) for name, index in names if index is not None)
    rows += (
        ("outside, counted", f"{found.outside} of {found.count}"),
        ("outside, as a normal distribution would have", _in_a_million(found.outside_expected)),
    )
    title = f"Good parts lie between {number(spec.lower)} and {number(spec.upper)}"
    return Grid("Capability", title, ("what", f"value ({found.confidence:.0%} interval)"), rows, "capability")


def _flags(study: ControlStudy, listed: int) -> Grid:
    rows = tuple(
        (
            str(flag.rule),
            flag.text,
            _points(study.labels[flag.first : flag.last + 1]),
            f"{flag.first + 1}–{flag.last + 1}" if flag.last > flag.first else str(flag.first + 1),
            MEANING[flag.rule],
        )
        for flag in study.flags[:listed]
    )
    more = len(study.flags) - listed
    note = f"{more} more are marked in the chart and listed by --json." if more > 0 else ""
    columns = ("rule", "what was seen", "where", "measurements", "often means")
    return Grid("Patterns", "Patterns after Nelson (1984)", columns, rows, "flags", (1, 2, 4), note)


def _points(labels: Sequence[str]) -> str:
    if len(labels) <= NAMED_POINTS:
        return ", ".join(labels)
    return f"{labels[0]} … {labels[-1]} ({len(labels)} values)"


def _in_a_million(share: float) -> str:
    count = share * 1e6
    return f"{count:,.0f} in a million" if count >= 100.0 else f"{count:.2g} in a million"
