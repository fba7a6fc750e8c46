"""The page of control charts: overview, charts, patterns, capability; it opens offline."""

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.quality.control import ControlStudy, Ewma, Line
from anisoscope.quality.limits import BoolArray
from anisoscope.quality.nelson import flagged
from anisoscope.report.figures import BLUE, GREEN, INK, MUTED, ORANGE, RED, ZONE, new_figure, svg_uri

if TYPE_CHECKING:
    from matplotlib.axes import Axes
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from anisoscope.quality.capability import Capability, Index
from anisoscope.quality.distributions import FittedCapability
from anisoscope.quality.drift import Drift
from anisoscope.quality.nelson import MEANING
from anisoscope.quality.readings import Readings
from anisoscope.record.schema import REPORT_NAME
from anisoscope.report.drift_sections import drift_picture, parameter_table
from anisoscope.report.page import write_page
from anisoscope.report.past_pages import report_link
from anisoscope.report.statistics_sections import Grid, Mark, Picture, chance, number

IntArray = npt.NDArray[np.int64]
BUCKETS = 1200
LEVELS = 500


def outline(values: FloatArray, buckets: int = BUCKETS) -> IntArray:
    """Places of the lowest and the highest value of every stretch of a series, in order; all if they are few.

    A gap of missing values that fills a stretch stays a gap: its first place is kept.

    Args:
        values: (N,), NaN is missing.
        buckets: stretches.
    """
    count = len(values)
    if count <= 2 * buckets:
        return np.arange(count)
    edges = np.linspace(0, count, buckets + 1).astype(np.int64)[:-1]
    low = np.fmin.reduceat(values, edges)
    high = np.fmax.reduceat(values, edges)
    bucket = np.searchsorted(edges, np.arange(count), side="right") - 1
    places = np.flatnonzero((values == low[bucket]) | (values == high[bucket]))
    # of ties, which rounded values have by the thousand, the first of each stretch is enough
    _, first = np.unique(
        np.stack([bucket[places], values[places] == high[bucket[places]]]), axis=1, return_index=True
    )
    empty = edges[np.isnan(low)]
    return np.sort(np.concatenate([places[first], empty]))


def distinct_on_paper(values: FloatArray, marked: BoolArray, levels: int = LEVELS) -> IntArray:
    """Places of marked values, less those that would be drawn on top of another one.

    Args:
        values: (N,).
        marked: (N,).
        levels: distinct heights on the paper; along the series there are ``BUCKETS`` distinct places.
    """
    places = np.flatnonzero(marked & ~np.isnan(values))
    if len(places) <= BUCKETS:
        return places
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    along = places * BUCKETS // len(values)
    up = np.round((values[places] - low) / max(high - low, 1e-300) * levels).astype(np.int64)
    _, first = np.unique(along * (levels + 1) + up, return_index=True)
    return np.sort(places[first])


SINGLE = 400  # values up to which each of them gets its own dot
NAMED = 30  # flags up to which the chart names their rules
MANY = 2500  # marks beyond which they are drawn as pixels
BINS = 60
TICKS = 7
TICK_LETTERS = 16


@dataclass(frozen=True, eq=False)
class Points:
    """The readings of a series; their times, and addresses of their reports relative to a page.

    Attributes:
        readings: of the series, in its order.
        page: file that links to the reports.
    """

    readings: Readings
    page: Path

    @property
    def linked(self) -> bool:
        """Whether the readings name folders of inspections."""
        return any(self.readings.texts.get("folder", ()))

    def time(self, place: int) -> datetime | None:
        """Local time of a reading."""
        return self.readings.moment(place)

    def link(self, place: int) -> str | None:
        """Address of the report of a reading; None where there is none."""
        folder = self.readings.folder(place)
        return report_link(folder, self.page) if folder and (Path(folder) / REPORT_NAME).is_file() else None


WIDTH, HEIGHT = 9.4, 7.4


def control_picture(study: ControlStudy, points: Points | None = None) -> tuple[str, tuple[Mark, ...]]:
    """Points, spread and EWMA over each other, with their limits, as a data URI; and marks on the points."""
    lines, limits = study.lines, study.basis
    with new_figure(WIDTH, HEIGHT) as (figure, whole):
        whole.remove()
        heights = (3.0, 1.6, 2.0) if study.spread is not None else (3.0, 2.0)
        every = figure.subplots(len(lines), 1, sharex=True, height_ratios=heights)
        figure.set_dpi(150)
        values = every[0]
        for axes, line in zip(every, lines, strict=True):
            _line(
                axes, line.values, flagged(study.flags, len(line.values)) if axes is values else line.outside
            )
            _levels(axes, line)
            axes.set_ylabel(line.name)
        reach = (study.line.upper - study.line.center) / 3.0
        for side in (-2.0, -1.0, 1.0, 2.0) if np.ptp(reach) == 0.0 else ():
            values.axhline(limits.center + side * reach[0], color=MUTED, linewidth=0.5, linestyle=":")
        if 0 < limits.baseline < study.count:
            _reference(values, limits.first + 0.5, limits.last + 1.5, len(study.values))
        _name_rules(values, study)
        every[-1].set_xlim(0.3, len(study.values) + 0.7)
        _name_places(every[-1], study, points)
        uri = svg_uri(figure)
        return uri, _marks(study, points, values)


def _reference(axes: "Axes", begin: float, end: float, count: int) -> None:
    """Shade the reference period and name it where there is room."""
    axes.axvspan(begin, end, color=ZONE, linewidth=0.0, zorder=0.5)
    right = begin > 0.6 * count
    axes.annotate("reference period", (end if right else begin, 1.0), xycoords=("data", "axes fraction"),
                  xytext=(-3 if right else 3, 3), textcoords="offset points", ha="right" if right else "left",
                  va="bottom", fontsize=8, color=INK)  # fmt: skip


def _name_places(axes: "Axes", study: ControlStudy, points: Points | None) -> None:
    """Serial number and time of a few values below the chart."""
    count = len(study.values)
    places = np.unique(np.linspace(0, count - 1, min(count, TICKS)).round().astype(np.int64))
    axes.set_xticks(places + 1, [_tick(study, points, place) for place in places.tolist()], fontsize=8)
    timed = points is not None and points.time(0) is not None
    axes.set_xlabel(
        f"{count} {'measurements' if study.unit == 'values' else study.unit} in their order; "
        f"{'serial number' if study.unit == 'values' else 'name'}{' and local time' if timed else ''} of some"
    )


def _tick(study: ControlStudy, points: Points | None, place: int) -> str:
    label = study.labels[place]
    short = label if len(label) <= TICK_LETTERS else f"{label[: TICK_LETTERS - 1]}…"
    time = None if points is None else points.time(place)
    return short if time is None else f"{short}\n{time:%Y-%m-%d}\n{time:%H:%M}"


def _marks(study: ControlStudy, points: Points | None, axes: "Axes") -> tuple[Mark, ...]:
    """Marks on the values, or on the flagged ones of many; the figure must have been drawn."""
    places = np.flatnonzero(~np.isnan(study.values))
    if len(places) > SINGLE:
        places = places[flagged(study.flags, len(study.values))[places]][:SINGLE]
    if not len(places):
        return ()
    at = axes.transData.transform(np.stack([places + 1.0, study.values[places]], axis=1))
    size = axes.figure.bbox.size
    rules: dict[int, list[str]] = {}
    for flag in study.flags:
        for place in range(flag.first, flag.last + 1):
            rules.setdefault(place, []).append(str(flag.rule))
    found = []
    for place, (x, y) in zip(places.tolist(), at / size, strict=True):
        time = None if points is None else points.time(place)
        words = [study.labels[place], number(float(study.values[place]))]
        words += [] if study.unit == "values" else [f"n = {study.points.sizes[place]:.0f}"]
        words += [f"{time:%Y-%m-%d %H:%M %Z}"] if time is not None else []
        words += [f"rule {', '.join(dict.fromkeys(rules[place]))}"] if place in rules else []
        found.append(
            Mark(float(x), 1.0 - float(y), " · ".join(words), None if points is None else points.link(place))
        )
    return tuple(found)


def _line(axes: "Axes", values: FloatArray, marked: BoolArray) -> None:
    points = outline(values)
    single = len(values) <= SINGLE
    axes.plot(points + 1, values[points], color=BLUE, linewidth=0.9 if single else 0.6,
              marker="o" if single else "", markersize=3)  # fmt: skip
    places = distinct_on_paper(values, marked)
    crowded = len(places) > MANY
    size = 5.0 if single else 2.0 if crowded else 3.5
    axes.plot(places + 1, values[places], linestyle="", marker="s", markersize=size, color=RED, markeredgecolor=INK,
              markeredgewidth=0.0 if crowded else 0.5, rasterized=crowded, zorder=3)  # fmt: skip


def _levels(axes: "Axes", line: Line) -> None:
    """Centre and limits: straight lines where all points have the same, else steps."""
    places = outline(line.upper)
    for level, style in ((line.center, "-"), (line.lower, "--"), (line.upper, "--")):
        colour = GREEN if style == "-" else RED
        look: dict[str, Any] = {"color": colour, "linestyle": style, "linewidth": 1.0, "zorder": 2.5}
        known = level[~np.isnan(level)]
        if np.ptp(known) == 0.0:
            if style == "-" or known[0] != 0.0 or line.values[np.isfinite(line.values)].min() < 0.0:
                axes.axhline(known[0], **look)
        else:
            axes.plot(
                places + 1,
                level[places],
                drawstyle="default" if isinstance(line, Ewma) else "steps-mid",
                **look,
            )


def _name_rules(axes: "Axes", study: ControlStudy) -> None:
    """Number of each violated rule at its value, unless they are too many to read."""
    if len(study.flags) > NAMED:
        return
    rules: dict[int, list[str]] = {}
    for flag in study.flags:
        rules.setdefault(flag.seen_at, []).append(str(flag.rule))
    for place, numbers in rules.items():
        above = study.values[place] >= study.basis.center
        axes.annotate(
            ",".join(numbers),
            (place + 1, study.values[place]),
            xytext=(0, 6 if above else -6),
            textcoords="offset points",
            ha="center",
            va="bottom" if above else "top",
            fontsize=8,
            fontweight="bold",
            color=INK,
        )


def spread_picture(study: ControlStudy) -> str:
    """Histogram of the values with a normal distribution and the specification limits, as a data URI."""
    measured = study.points.single[~np.isnan(study.points.single)]
    mean, sigma = float(measured.mean()), float(measured.std(ddof=1))
    with new_figure(9.4, 3.0) as (figure, axes):
        heights, edges, _ = axes.hist(
            measured, bins=min(BINS, max(6, int(2.0 * len(measured) ** 0.4))), color=BLUE, alpha=0.45
        )
        area = len(measured) * float(edges[1] - edges[0])
        if sigma > 0.0:
            x = np.linspace(mean - 4.0 * sigma, mean + 4.0 * sigma, 201)
            bell = np.exp(-0.5 * ((x - mean) / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi))
            axes.plot(x, area * bell, color=ORANGE, linewidth=1.4, label="normal, same mean and spread")
        if study.capability is not None:
            limits = study.capability.specification
            for level, name in ((limits.lower, "lower limit"), (limits.upper, "upper limit")):
                if level is not None:
                    axes.axvline(level, color=RED, linewidth=1.4, linestyle="--")
                    axes.annotate(name, (level, 0.98), xycoords=("data", "axes fraction"), va="top",
                                  xytext=(3, 0), textcoords="offset points", rotation=90, fontsize=8,
                                  color=INK)  # fmt: skip
        axes.set_ylim(0.0, 1.12 * float(np.max(heights)))
        axes.set_xlabel(study.name)
        axes.set_ylabel("parts")
        axes.legend(frameon=False, fontsize=8)
        return svg_uri(figure)


LISTED = 200
DETAILED = 12
NAMED_POINTS = 4


def write_spc_page(
    path: Path,
    title: str,
    source: str,
    studies: Sequence[ControlStudy],
    detailed: Sequence[tuple[ControlStudy, Points | None, Drift | None]],
    notes: Sequence[str] = (),
) -> None:
    """Write the page, atomically.

    Args:
        path: file to write.
        title: heading.
        source: where the values come from.
        studies: all, for the overview.
        detailed: those that get charts, with their values and tests for drift; the first 12 do.
        notes: what else the reader should know.

    Raises:
        RecordError: the file cannot be written.
    """
    left = len(detailed) - DETAILED
    more = [f"{left} more have no charts on this page: choose fewer, or one of them"] if left > 0 else []
    content = {
        "title": title,
        "source": source,
        "answer": _answer(studies, [drift for _, _, drift in detailed if drift is not None]),
        "overview": overview(studies),
        "studies": [study_content(*one) for one in detailed[:DETAILED]],
        "notes": [*notes, *more],
    }
    write_page(path, "spc.html", content)


def _answer(studies: Sequence[ControlStudy], drifts: Sequence[Drift]) -> tuple[str, bool] | None:
    """First sentence of a page on several series or on drift, and whether all is well; one series has its own."""
    odd = [one.name for one in studies if not one.stable]
    are = f"{len(odd)} of {len(studies)} series {'is' if len(odd) == 1 else 'are'} not stable: "
    several = (
        are + ", ".join(odd[:5]) + f" and {len(odd) - 5} more" * (len(odd) > 5)
        if odd
        else f"all {len(studies)} series are stable"
    )
    seen = [f"{one.name}: {one.verdict}" for one in drifts if one.seen]
    words = [several] * (len(studies) > 1) + (seen or ["no drift"] * bool(drifts))
    return ("; ".join(words), not odd and not seen) if words else None


def overview(studies: Sequence[ControlStudy]) -> Grid:
    """Overview of the series, one row each."""
    rows = tuple(
        (
            one.name,
            str(one.count),
            number(one.basis.center),
            number(one.basis.sigma, 3),
            str(len(one.flags)),
            "–" if one.capability is None else interval(one.capability.ppk),
            "stable" if one.stable else "not stable",
        )
        for one in studies
    )
    columns = ("number", "measured", "center", "sigma", "patterns", "Ppk (95 %)", "state")
    return Grid("Overview", "All series at a glance", columns, rows, "overview")


def study_content(
    study: ControlStudy, points: Points | None = None, drift: Drift | None = None
) -> dict[str, Any]:
    """Content of the template for one series."""
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
        "pictures": [_chart(study, points), *([] if study.points.counted else [_spread(study)])],
        "tables": tables(study),
        "notes": [*words, *study.notes],
        "drift": None if drift is None else _drift(drift),
    }


def _drift(drift: Drift) -> dict[str, Any]:
    return {
        "verdict": drift.verdict,
        "good": not drift.seen,
        "picture": drift_picture(drift),
        "table": parameter_table(drift) if drift.parameters else None,
        "notes": drift.notes,
    }


def tables(study: ControlStudy, listed: int = LISTED) -> list[Grid]:
    """Limits, capability, and the first patterns of a series."""
    able = [] if study.capability is None else [_capability(study.capability)]
    able += [] if study.fitted is None else [_fitted(study.fitted)]
    return [_limits(study), *able, *([_flags(study, listed)] if study.flags else [])]


def interval(index: Index) -> str:
    """An index with its interval."""
    return f"{index.value:.2f} ({index.low:.2f} to {index.high:.2f})".replace("-", "−")


def _chart(study: ControlStudy, points: Points | None) -> Picture:
    lines = study.lines
    details = [
        f"{line.name}, {int(line.outside.sum())} beyond {_span(line.lower)} and {_span(line.upper)}"
        for line in lines
    ]
    alt = (
        f"Control charts of {study.name}: {study.count} {study.unit} about {number(study.basis.center)}; "
        f"{len(study.flags)} patterns; {'; '.join(details)}"
    )
    names = ", ".join(line.name for line in lines[:-1])
    caption = (
        f"{names[0].upper()}{names[1:]} and exponentially weighted moving average (EWMA) in the order of measurement. "
        "Green: centre. Red dashes: limits. Red squares: points that belong to a pattern, with the number of the rule "
        "where they are few. Point at one for its name and time"
    )
    linked = points is not None and points.linked
    caption += "; click it for the report of the part." if linked else "."
    if len(study.values) > 2400:
        caption += " Of this many values the outline is drawn, and every flagged one."
    uri, marks = control_picture(study, points)
    return Picture(uri, alt, caption, marks, WIDTH / HEIGHT)


def _span(values: FloatArray) -> str:
    """A number that all points have, or the range of those that they have."""
    low, high = number(float(np.nanmin(values))), number(float(np.nanmax(values)))
    return low if low == high else f"{low} to {high}"


def _spread(study: ControlStudy) -> Picture:
    measured = study.points.single[~np.isnan(study.points.single)]
    alt = (
        f"Histogram of {study.name}: {len(measured)} values from {number(float(measured.min()))} to "
        f"{number(float(measured.max()))}, mean {number(float(measured.mean()))}"
    )
    return Picture(
        spread_picture(study),
        alt,
        "Distribution of the values; line: normal distribution with the same mean and spread.",
    )


def _limits(study: ControlStudy) -> Grid:
    rows = []
    for line in study.lines:
        name, shown = line.name, slice(None)
        if isinstance(line, Ewma):
            name, shown = f"EWMA at the end (λ {line.weight:g}, L {line.width:g})", slice(-1, None)
        rows.append((name, *(_span(one[shown]) for one in (line.lower, line.center, line.upper))))
    of = " of z" if study.points.counted else ""
    sigma = "" if study.points.chart in ("p", "u") else f"; sigma{of} {number(study.basis.sigma)}"
    title = f"Limits {_origin(study)}{sigma}"
    sizes = "" if study.unit == "values" else f"Subgroups of {_span(study.points.sizes)}"
    return Grid("Limits", title, ("chart", "lower", "center", "upper"), tuple(rows), "limits", note=sizes)


def _origin(study: ControlStudy) -> str:
    """The points that the limits rest on, in words."""
    limits = study.basis
    if limits.baseline == 0:
        return f"of {limits.source}" if limits.source else "as given"
    ends = f"{study.labels[limits.first]} to {study.labels[limits.last]}"
    if limits.source:
        return f"from the {limits.source}: {limits.baseline} {study.unit}, {ends}"
    if limits.baseline == study.count:
        return f"from all {study.count} measured {study.unit}"
    return f"from the first {limits.baseline} measured {study.unit}, {ends}"


def _fitted(found: FittedCapability) -> Grid:
    names = (("Pp", found.pp), ("Ppk", found.ppk))
    rows = tuple((name, interval(index)) for name, index in names if index is not None)
    ends = f"{number(found.low)}, {number(found.median)}, {number(found.high)}"
    rows += (
        ("quantiles of 0.135, 50 and 99.865 %", ends),
        ("outside, by the distribution", _in_a_million(found.outside_expected)),
        ("model over time", found.time_model or "too few values"),
    )
    title = f"By a {found.fitted.family} distribution (ISO 22514-2)"
    columns = ("what", f"value ({found.confidence:.0%} interval)")
    return Grid("Capability by quantiles", title, columns, rows, "fitted")


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
    unit = "measurements" if study.unit == "values" else study.unit
    columns = ("rule", "what was seen", "where", unit, "often means")
    return Grid("Patterns", "Patterns after Nelson (1984)", columns, rows, "flags", (1, 2, 4), note)


def _points(labels: Sequence[str]) -> str:
    if len(labels) <= NAMED_POINTS:
        return ", ".join(labels)
    return f"{labels[0]} … {labels[-1]} ({len(labels)} in a row)"


def _in_a_million(share: float) -> str:
    count = share * 1e6
    return f"{count:,.0f} in a million" if count >= 100.0 else f"{count:.2g} in a million"
