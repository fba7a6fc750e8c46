"""Pictures of measurement systems analysis."""

from typing import TYPE_CHECKING

import numpy as np

from anisoscope.quality.gaugestudy import GaugeStudy
from anisoscope.quality.individuals import FloatArray
from anisoscope.quality.linearity import GaugeLinearity
from anisoscope.report.figures import BLUE, GREEN, INK, MUTED, ORANGE, PAPER, RED, new_figure, svg_uri

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHADES = (BLUE, ORANGE, GREEN, RED, MUTED)
MARKS = ("o", "s", "^", "D", "v")
NAMED = 40  # parts up to which the axis names them


def share_picture(study: GaugeStudy) -> str:
    """Every component as a share of the study variation and of the tolerance, as a data URI."""
    shown = [one for one in study.components if one.name != "total"]
    with new_figure(9.4, 0.9 + 0.55 * len(shown)) as (figure, axes):
        rows = np.arange(len(shown), dtype=np.float64)
        kinds = [("of the study variation", BLUE, "", [study.share_of_study(one) for one in shown])]
        if study.tolerance is not None:
            kinds.append(
                ("of the tolerance", ORANGE, "//", [study.share_of_tolerance(one) or 0.0 for one in shown])
            )
        height = 0.8 / len(kinds)
        for k, (name, colour, hatch, shares) in enumerate(kinds):
            at = rows - 0.4 + height * (k + 0.5)
            bars = axes.barh(
                at, 100.0 * np.array(shares), height, color=colour, hatch=hatch, edgecolor=PAPER, label=name
            )
            axes.bar_label(bars, fmt="%.1f %%", padding=3, fontsize=8, color=INK)
        for level in (10.0, 30.0):
            axes.axvline(level, color=RED, linewidth=0.9, linestyle="--")
        axes.set_yticks(rows, [one.name for one in shown])
        axes.invert_yaxis()
        axes.margins(x=0.12)
        axes.set_xlabel("standard deviation [%];  dashes: 10 % and 30 %, the limits for the gauge")
        axes.legend(frameon=False, fontsize=8)
        return svg_uri(figure)


def crossing_picture(study: GaugeStudy) -> str:
    """Every measurement over its part, and the means of every appraiser, as a data URI."""
    data = study.data
    with new_figure(9.4, 3.6) as (figure, axes):
        at = np.arange(len(data.parts), dtype=np.float64)
        count = len(data.appraisers)
        for k, name in enumerate(data.appraisers):
            colour, mark = SHADES[k % len(SHADES)], MARKS[k % len(MARKS)]
            shift = 0.0 if count == 1 else 0.3 * (k / (count - 1) - 0.5)
            cells = data.values[:, k, :]
            axes.plot(
                np.repeat(at + shift, cells.shape[1]),
                cells.ravel(),
                mark,
                color=colour,
                markersize=3.5,
                alpha=0.55,
            )
            axes.plot(
                at + shift,
                cells.mean(axis=1),
                marker=mark,
                color=colour,
                linewidth=1.2,
                markersize=5,
                label=name,
            )
        _name_parts(axes, data.parts)
        axes.grid(axis="y")
        axes.set_xlabel("part")
        axes.set_ylabel("measured")
        axes.legend(frameon=False, fontsize=8, title="appraiser", title_fontsize=8)
        return svg_uri(figure)


def _name_parts(axes: "Axes", parts: tuple[str, ...]) -> None:
    if len(parts) <= NAMED:
        long = sum(map(len, parts)) > 80
        axes.set_xticks(range(len(parts)), parts, rotation=90 if long else 0, fontsize=8)


def bias_picture(values: FloatArray, reference: float, interval: tuple[float, float]) -> str:
    """Measurements in order, the reference, and the interval of their mean, as a data URI.

    Args:
        values: (N,), NaN is missing.
        reference: the known value.
        interval: of the bias.
    """
    with new_figure(9.4, 3.0) as (figure, axes):
        axes.plot(
            np.arange(1, len(values) + 1),
            values,
            "o-",
            color=BLUE,
            linewidth=0.8,
            markersize=4,
            label="measured",
        )
        axes.axhspan(
            reference + interval[0],
            reference + interval[1],
            color=ORANGE,
            alpha=0.3,
            linewidth=0,
            label="interval of the mean",
        )
        axes.axhline(reference, color=GREEN, linewidth=1.6, label="reference")
        axes.set_xlabel("measurement")
        axes.set_ylabel("value")
        axes.legend(frameon=False, fontsize=8)
        return svg_uri(figure)


def linearity_picture(study: GaugeLinearity) -> str:
    """Biases over the reference values, the line through them and its band, as a data URI."""
    x = np.linspace(study.references.min(), study.references.max(), 201)
    line, low, high = study.band(x)
    with new_figure(9.4, 3.8) as (figure, axes):
        axes.plot(study.references, study.biases, "o", color=BLUE, markersize=3.5, alpha=0.6, label="bias")
        axes.plot(
            [level.reference for level in study.levels],
            [level.bias for level in study.levels],
            "D",
            color=ORANGE,
            markersize=6,
            markeredgecolor=INK,
            label="mean at each reference",
        )
        axes.plot(x, line, color=RED, linewidth=1.4, label="line")
        axes.fill_between(
            x, low, high, color=RED, alpha=0.18, linewidth=0, label=f"{1 - study.alpha:.0%} band"
        )
        axes.axhline(0.0, color=GREEN, linewidth=1.4, label="no bias")
        axes.set_xlabel("reference value")
        axes.set_ylabel("measured − reference")
        axes.legend(frameon=False, fontsize=8)
        return svg_uri(figure)
