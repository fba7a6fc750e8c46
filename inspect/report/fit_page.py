"""The page of a fit: measured against fitted, residuals, parameters and their correlation."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from anisoscope.base.notation import true_minus
from anisoscope.fit.fitting import Fit
from anisoscope.fit.parameters import PARAMETERS
from anisoscope.fit.text import fixed, notes, number, quality, setup_text, unit_text, value_texts
from anisoscope.report.figures import BLUE, GRID, RED, new_figure, svg_uri
from anisoscope.report.page import write_page

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NAMED = 48  # rows up to which a chart names them
LISTED = 400  # rows up to which the page lists all
FAR = 3.0


def measured_chart(fit: Fit) -> str:
    """Measured values with bars of two standard uncertainties, and the model's, as a data URI."""
    readings = fit.problem.readings
    at = np.arange(len(readings.value))
    with new_figure(8.6, 3.6) as (figure, axes):
        axes.errorbar(
            at,
            readings.value,
            2.0 * fit.u_value,
            fmt="o",
            color=BLUE,
            markersize=3,
            capsize=2,
            label="measured",
        )
        axes.plot(
            at, fit.fitted, "o", color=RED, markersize=7, fillstyle="none",
            label="fitted" if fit.estimates else "predicted",
        )  # fmt: skip
        if readings.kind in ("exposure", "brdf") and np.ptp(np.log(np.maximum(readings.value, 1e-300))) > 3.0:
            axes.set_yscale("log", nonpositive="mask")
        axes.set_ylabel(f"{readings.kind.replace('_', ' ')} [{unit_text(fit)}]")
        _name_rows(axes, readings.labels)
        figure.legend(loc="outside upper center", ncols=2, frameon=False, fontsize=8)
        return svg_uri(figure)


def residual_chart(fit: Fit) -> str:
    """Residuals in units of their uncertainty, as a data URI."""
    at = np.arange(len(fit.z))
    with new_figure(8.6, 2.8) as (figure, axes):
        axes.axhspan(-2.0, 2.0, color=GRID, alpha=0.5, linewidth=0)
        axes.axhline(0.0, color=RED, linewidth=0.8)
        axes.vlines(at, 0.0, fit.z, color=BLUE, linewidth=1.0)
        axes.plot(at, fit.z, "o", color=BLUE, markersize=3)
        axes.set_ylabel("residual / u [1]")
        _name_rows(axes, fit.problem.readings.labels)
        return svg_uri(figure)


def _name_rows(axes: "Axes", labels: tuple[str, ...]) -> None:
    axes.set_xlim(-0.7, len(labels) - 0.3)
    axes.grid(axis="y")
    if len(labels) > NAMED:
        axes.set_xlabel("row")
        return
    axes.set_xticks(range(len(labels)), [true_minus(label) for label in labels], rotation=90, fontsize=7)


def write_fit_page(fit: Fit, title: str, path: Path, extra_notes: tuple[str, ...] = ()) -> None:
    """Write the page of a fit or of a comparison, atomically.

    Args:
        fit: the fit; without free parameters the page is a comparison.
        title: heading.
        path: file to write.
        extra_notes: sentences to add to those of the fit.

    Raises:
        RecordError: the file cannot be written.
    """
    content = {
        "title": title,
        "setup": setup_text(fit),
        "unit": unit_text(fit),
        "quality": quality(fit),
        "notes": [*notes(fit), *extra_notes],
        "charts": (measured_chart(fit), residual_chart(fit)),
        "chart_text": f"Measured and fitted values of {len(fit.z)} rows; {quality(fit)}",
        "residual_text": f"Residuals of {len(fit.z)} rows; the largest is {np.max(np.abs(fit.z)):.2g} u",
        "parameters": _parameters(fit),
        "correlation": [
            ["–" if np.isnan(x) else f"{x:+.3f}".replace("-", "−") for x in row] for row in fit.correlation
        ],
        "rows": _rows(fit),
        "left_out": max(len(fit.z) - LISTED, 0),
        "fixed": [(PARAMETERS[name].words, number(value)) for name, value in fixed(fit).items()],
    }
    write_page(path, "fit.html", content, {"typeset": true_minus})


def _parameters(fit: Fit) -> list[tuple[str, str, str, str, str, bool]]:
    found = []
    for one in fit.estimates:
        value, u, interval = value_texts(one)
        what = PARAMETERS[one.name]
        found.append((what.words, what.unit or "1", value, u, interval, one.value is not None))
    return found


def _rows(fit: Fit) -> list[tuple[str, str, str, str, str, bool]]:
    readings = fit.problem.readings
    order = np.arange(len(fit.z))
    if len(order) > LISTED:
        order = np.sort(np.argsort(-np.abs(fit.z), kind="stable")[:LISTED])
    return [
        (
            true_minus(readings.labels[n]),
            number(readings.value[n]),
            f"{fit.u_value[n]:.2g}",
            number(fit.fitted[n]),
            f"{fit.z[n]:+.2f}".replace("-", "−"),
            bool(abs(fit.z[n]) > FAR),
        )
        for n in order
    ]
