"""Pictures of control charts: drawn from fewer points where there are many, flagged ones never left out."""

from typing import TYPE_CHECKING

import numpy as np

from anisoscope.quality.control import ControlStudy
from anisoscope.quality.individuals import BoolArray, FloatArray
from anisoscope.quality.nelson import flagged
from anisoscope.quality.thinning import distinct_on_paper, outline
from anisoscope.report.figures import BLUE, GREEN, INK, MUTED, ORANGE, RED, new_figure, svg_uri

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SINGLE = 400  # values up to which each of them gets its own dot
NAMED = 30  # flags up to which the chart names their rules
MANY = 2500  # marks beyond which they are drawn as pixels
BINS = 60


def control_picture(study: ControlStudy) -> str:
    """Values, moving range and EWMA over each other, with their limits, as a data URI."""
    with new_figure(9.4, 7.2) as (figure, whole):
        whole.remove()
        values, ranges, average = figure.subplots(3, 1, sharex=True, height_ratios=(3.0, 1.6, 2.0))
        figure.set_dpi(150)
        limits = study.limits
        _line(values, study.values, flagged(study.flags, len(study.values)))
        _levels(values, limits.center, limits.lower, limits.upper)
        for side in (-2.0, -1.0, 1.0, 2.0):
            values.axhline(limits.center + side * limits.sigma, color=MUTED, linewidth=0.5, linestyle=":")
        if 0 < limits.baseline < study.count:
            end = float(np.flatnonzero(~np.isnan(study.values))[limits.baseline - 1]) + 1.5
            values.axvline(end, color=MUTED, linewidth=1.0, linestyle="--")
            values.annotate("baseline ", (end, 1.0), xycoords=("data", "axes fraction"), ha="right", va="top",
                            fontsize=8, color=INK)  # fmt: skip
        _name_rules(values, study)
        _line(ranges, study.ranges, study.wide)
        _levels(ranges, limits.range_center, None, limits.range_upper)
        _line(average, study.average.average, study.average.outside)
        shown = outline(study.average.upper)
        for edge in (study.average.lower, study.average.upper):
            average.plot(shown + 1, edge[shown], color=RED, linewidth=1.0, linestyle="--")
        average.axhline(limits.center, color=GREEN, linewidth=1.0, zorder=2.5)
        for axes, name in zip((values, ranges, average), ("value", "moving range", "EWMA"), strict=True):
            axes.set_ylabel(name)
        average.set_xlabel("measurement")
        average.set_xlim(0.3, len(study.values) + 0.7)
        return svg_uri(figure)


def _line(axes: "Axes", values: FloatArray, marked: BoolArray) -> None:
    shown = outline(values)
    single = len(values) <= SINGLE
    axes.plot(shown + 1, values[shown], color=BLUE, linewidth=0.9 if single else 0.6,
              marker="o" if single else "", markersize=3)  # fmt: skip
    places = distinct_on_paper(values, marked)
    crowded = len(places) > MANY
    size = 5.0 if single else 2.0 if crowded else 3.5
    axes.plot(places + 1, values[places], linestyle="", marker="s", markersize=size, color=RED, markeredgecolor=INK,
              markeredgewidth=0.0 if crowded else 0.5, rasterized=crowded, zorder=3)  # fmt: skip


def _levels(axes: "Axes", center: float, lower: float | None, upper: float) -> None:
    axes.axhline(center, color=GREEN, linewidth=1.0, zorder=2.5)
    for level in (lower, upper):
        if level is not None:
            axes.axhline(level, color=RED, linewidth=1.0, linestyle="--", zorder=2.5)


def _name_rules(axes: "Axes", study: ControlStudy) -> None:
    """The number of each rule beside the value at which it was seen, unless there are too many to read."""
    if len(study.flags) > NAMED:
        return
    rules: dict[int, list[str]] = {}
    for flag in study.flags:
        rules.setdefault(flag.seen_at, []).append(str(flag.rule))
    for place, numbers in rules.items():
        above = study.values[place] >= study.limits.center
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
    """How the values are spread, beside a normal distribution and the limits of good parts, as a data URI."""
    measured = study.values[~np.isnan(study.values)]
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
                    axes.annotate(f" {name}", (level, 0.98), xycoords=("data", "axes fraction"), va="top",
                                  rotation=90, fontsize=8, color=INK)  # fmt: skip
        axes.set_ylim(0.0, 1.12 * float(np.max(heights)))
        axes.set_xlabel(study.name)
        axes.set_ylabel("parts")
        axes.legend(frameon=False, fontsize=8)
        return svg_uri(figure)
