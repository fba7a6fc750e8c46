"""Chart and table of a test for drift: the values, the evidence, and the machine's parameters over the same parts."""

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from anisoscope.quality.drift import FALSE_ALARMS, NONE, Drift
from anisoscope.report.figures import BLUE, INK, MUTED, ORANGE, RED, new_figure, svg_uri
from anisoscope.report.statistics_sections import Grid, Picture, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DRAWN = 4
"""Parameters on the chart, the most likely ones."""


def parameter_table(drift: Drift) -> Grid:
    """Parameters against the number, the most likely one first; the last row is the weight of none of them."""
    rows = tuple(
        (
            one.name,
            "–" if not drift.seen else _weight(one.weight),
            f"{number(one.correlation, 2)} ({number(one.low, 2)} to {number(one.high, 2)})",
            number(one.slope, 3),
            str(one.lag),
            number(one.change, 3),
            str(one.count),
        )
        for one in drift.parameters
    )
    if drift.seen:
        rows += ((NONE, _weight(drift.none_of_them), "–", "–", "–", "–", "–"),)
    columns = (
        "parameter",
        "weight",
        "correlation (95 %)",
        "slope",
        "lag in parts",
        "change at the onset",
        "parts",
    )
    note = "A correlation is no cause: a parameter that was not recorded may move with one that was."
    return Grid(
        "Parameters", f"{drift.name} against parameters of the machine", columns, rows, "parameters", (), note
    )


def _weight(value: float) -> str:
    return "below 0.001" if value < 0.001 else f"{value:.3f}"


def drift_picture(drift: Drift) -> Picture:
    """The values, the evidence and the first parameters over the parts, and the values over each parameter."""
    shown = drift.parameters[:DRAWN]
    rows = 2 + len(shown)
    width, height = 9.4, 1.5 + 1.5 * rows
    place = np.arange(1, len(drift.values) + 1)
    with new_figure(width, height) as (figure, whole):
        whole.remove()
        panels = figure.subplots(
            rows, 2, width_ratios=(3.2, 1.0), sharex="col" if not shown else False, squeeze=False
        )
        _curve(panels[0, 0], drift, place, drift.values, drift.name, BLUE)
        evidence = np.where(np.isfinite(drift.log_evidence), drift.log_evidence, np.nan) / np.log(10.0)
        _curve(panels[1, 0], drift, place, evidence, "evidence, log10", INK)
        panels[1, 0].axhline(-np.log10(FALSE_ALARMS), color=RED, linewidth=1.0, linestyle="--")
        for row in (0, 1):
            panels[row, 1].remove()
        for row, one in enumerate(shown, start=2):
            column = drift.covariates[one.name]
            _curve(panels[row, 0], drift, place, column, one.name, MUTED)
            moved = np.full(len(column), np.nan)
            moved[one.lag :] = column[: len(column) - one.lag]
            after = place - 1 >= (len(place) if drift.onset_at is None else drift.onset_at)
            for chosen, color in ((~after, BLUE), (after, ORANGE)):
                panels[row, 1].plot(
                    moved[chosen], drift.values[chosen], linestyle="", marker=".", markersize=3, color=color,
                    rasterized=len(place) > 2000,
                )  # fmt: skip
            panels[row, 1].set_xlabel(one.name + (f", {one.lag} before" if one.lag else ""), fontsize=8)
        for row in range(rows - 1):
            panels[row, 0].tick_params(labelbottom=False)
        panels[rows - 1, 0].set_xlabel("parts")
        uri = svg_uri(figure)
    names = ", ".join(one.name for one in shown)
    alt = (
        f"Values of {drift.name}, the evidence for a drift{', and ' + names if shown else ''} over the parts"
    )
    caption = "Red dashes: evidence of 100."
    if drift.onset_at is not None:
        caption = "Orange line: most likely onset; red line: alarm; red dashes: evidence of 100."
    if shown:
        from_onset = "" if drift.onset_at is None else ", orange from the onset on"
        caption += f" On the right the values over each parameter{from_onset}."
    return Picture(uri, alt, caption)


def _curve(
    axes: "Axes", drift: Drift, place: npt.ArrayLike, values: npt.ArrayLike, name: str, color: str
) -> None:
    axes.plot(place, values, color=color, linewidth=0.8)
    axes.set_ylabel(name, fontsize=8)
    axes.set_xlim(0.3, len(drift.values) + 0.7)
    for at, line in ((drift.onset_at, ORANGE), (drift.alarm_at, RED)):
        if at is not None:
            axes.axvline(at + 1, color=line, linewidth=1.0)
