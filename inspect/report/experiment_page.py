"""Pages of the published experiment: predicted and measured charts, and the map of its findings."""

import base64
from collections.abc import Sequence
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from anisoscope.experiment.experiment import Experiment, Mean, combinations
from anisoscope.experiment.findings_map import FindingsMap
from anisoscope.parameters.geometry import Convention
from anisoscope.report.figures import BLUE, GREEN, GRID, INK, MUTED, ORANGE, RED, new_figure, svg_uri
from anisoscope.report.page import Filters, write_page

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AXIS_NAMES = {"tilt": "tilt", "ridge_angle": "ridge angle", "pair": "pair of stage angles"}
LACKING = (
    ("all three hold, falling on both sides", GREEN),
    ("all three hold", "#9ccbab"),
    ("maximum not at zero tilt", ORANGE),
    ("90° / 180° not below 0° / 90°", RED),
    ("5° not the best ridge angle", BLUE),
    ("more than one fails", GRID),
)


def level_text(level_deg: Sequence[float]) -> str:
    """Level as text: "-20°", or "0° / 90°" for a pair."""
    return " / ".join(f"{value:g}°" for value in level_deg).replace("-", "−")


def convention_text(convention: Convention) -> str:
    """The convention in one line."""
    plane = "in" if convention.tilt_plane == "in-plane" else "perpendicular to"
    return (
        f"light {convention.light_angle_deg:g}° from the camera, tilt {plane} the light's plane, "
        f"facets toward {convention.facet_azimuth_deg:g}°, stage turns {convention.rotation_sense}"
    )


def bar_chart(
    labels: Sequence[str], series: Sequence[tuple[str, str, Sequence[float | None]]], axis: str, unit: str
) -> str:
    """Groups of upright bars as a data URI; a missing bar is a value of None.

    Args:
        labels: names of the groups.
        series: (name, colour, one value a group) of every series.
        axis: what the groups are.
        unit: unit of the values.
    """
    width = 0.8 / len(series)
    with new_figure(3.5, 2.7) as (figure, axes):
        for number, (name, colour, values) in enumerate(series):
            at = np.arange(len(labels)) - 0.4 + width * (number + 0.5)
            heights = [np.nan if value is None else value for value in values]
            axes.bar(at, heights, width=0.92 * width, color=colour, label=name)
        axes.set_xticks(range(len(labels)), labels)
        axes.set_xlim(-0.6, len(labels) - 0.4)
        axes.set_xlabel(axis)
        axes.set_ylabel(f"mean contrast [{unit}]")
        axes.set_ylim(bottom=0.0)
        axes.grid(axis="y")
        if len(series) > 1:
            figure.legend(loc="outside upper center", ncols=2, frameon=False, fontsize=8)
        return svg_uri(figure)


def _series(means: Sequence[Mean], result: Experiment) -> list[tuple[str, str, list[float | None]]]:
    found: list[tuple[str, str, list[float | None]]] = [("predicted", BLUE, [m.predicted for m in means])]
    if result.measured is not None and not result.complete:
        found.append(("predicted, measured rows only", "#9cc4e4", [m.predicted_same_rows for m in means]))
    if result.measured is not None:
        found.append(("measured", RED, [m.measured for m in means]))
    return found


def _chart_text(name: str, means: Sequence[Mean]) -> str:
    values = [
        f"{level_text(m.level_deg)} predicted {m.predicted:.4g}"
        + (f" measured {m.measured:.4g}" if m.measured is not None else "")
        for m in means
    ]
    return f"Mean contrast by {AXIS_NAMES[name]}: {', '.join(values)}"


def findings_chart(maps: Sequence[FindingsMap]) -> str:
    """Map of the findings over roughness, one panel per convention, as a data URI."""
    from matplotlib.patches import Patch

    with new_figure(3.6 * len(maps) + 0.4, 4.3) as (figure, axes):
        axes.remove()
        panels = figure.subplots(1, len(maps), squeeze=False)[0]
        for panel, found in zip(panels, maps, strict=True):
            _draw_findings(panel, found)
        used = {int(kind) for found in maps for kind in np.unique(_lacking(found))}
        figure.legend(
            handles=[Patch(color=LACKING[kind][1], label=LACKING[kind][0]) for kind in sorted(used)],
            loc="outside lower center",
            ncols=2,
            frameon=False,
        )
        return svg_uri(figure)


def _lacking(found: FindingsMap) -> npt.NDArray[np.intp]:
    """Index into LACKING for every cell."""
    failed = ~np.stack([found.max_at_zero_tilt, found.first_pair_larger, found.best_at_five])
    count = failed.sum(axis=0)
    none = np.where(found.falls_on_both_sides, 0, 1)
    return np.where(count > 1, len(LACKING) - 1, np.where(count == 1, failed.argmax(axis=0) + 2, none))


def _draw_findings(axes: "Axes", found: FindingsMap) -> None:
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Rectangle

    along, across = _edges(found.alpha_along), _edges(found.alpha_across)
    boxes, colours = [], []
    for j, column in enumerate(_lacking(found).T):
        for kind, run in groupby(enumerate(column), key=itemgetter(1)):
            cells = [i for i, _ in run]
            low, high = along[cells[0]], along[cells[-1] + 1]
            boxes.append(Rectangle((across[j], low), across[j + 1] - across[j], high - low))
            colours.append(LACKING[kind][1])
    axes.add_collection(PatchCollection(boxes, facecolors=colours, edgecolors=colours, linewidths=0.3))
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(across[0], across[-1])
    axes.set_ylim(along[0], along[-1])
    ticks = [0.03, 0.05, 0.1, 0.2, 0.3]
    for scale in (axes.xaxis, axes.yaxis):
        scale.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
        scale.set_ticks([], minor=True)
    axes.plot([1e-3, 1.0], [1e-3, 1.0], color=INK, linewidth=0.8, linestyle="--", scalex=False, scaley=False)
    material = found.setup.material
    axes.plot(
        material.alpha_across, material.alpha_along, "o", color=INK, markersize=5, markerfacecolor="white"
    )
    axes.set_xlabel(r"roughness across the ridges $\alpha_v$")
    axes.set_ylabel(r"roughness along the ridges $\alpha_u$")
    axes.set_title(
        f"tilt {found.setup.convention.tilt_plane}: {100.0 * found.share:.1f} %", fontsize=9, color=MUTED
    )


def _edges(centres: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    logs = np.log(centres)
    middle = 0.5 * (logs[1:] + logs[:-1])
    edges = np.exp(np.concatenate([[2 * logs[0] - middle[0]], middle, [2 * logs[-1] - middle[-1]]]))
    return np.asarray(edges, dtype=np.float64)


def findings_svg(maps: Sequence[FindingsMap]) -> str:
    """The picture of ``findings_chart`` as the text of an SVG file."""
    return base64.b64decode(findings_chart(maps).partition(",")[2]).decode("utf-8")


def write_experiment_page(result: Experiment, path: Path | str) -> None:
    """Write the page of one experiment, atomically.

    Args:
        result: the experiment.
        path: file to write.

    Raises:
        RecordError: the file cannot be written.
    """
    charts = []
    for name, axis in AXIS_NAMES.items():
        means = result.means[name]
        uri = bar_chart([level_text(m.level_deg) for m in means], _series(means, result), axis, result.unit)
        charts.append((uri, _chart_text(name, means), f"by {axis}"))
    rows = [
        (
            row,
            float(result.predicted[index]),
            None if result.measured is None else float(result.measured[index]),
        )
        for index, row in combinations()
    ]
    content = {"result": result, "unit": result.unit, "charts": charts, "rows": rows}
    _write(Path(path), "Ridge experiment", [result.setup.convention], content)


def write_findings_page(maps: Sequence[FindingsMap], path: Path | str) -> None:
    """Write the page of the map of findings, atomically.

    Raises:
        RecordError: the file cannot be written.
    """
    text = "; ".join(
        f"tilt {m.setup.convention.tilt_plane}: all three on {m.share:.1%} of the grid" for m in maps
    )
    _write(
        Path(path),
        "Where the findings of the ridge experiment hold",
        [m.setup.convention for m in maps],
        {
            "maps": maps,
            "chart": findings_chart(maps),
            "chart_text": f"Map of the findings over the two roughnesses; {text}",
        },
    )


def _write(path: Path, title: str, conventions: list[Convention], content: dict[str, object]) -> None:
    filters: Filters = {
        "level": level_text,
        "convention": convention_text,
        "percent": lambda share: f"{100.0 * share:.1f} %",
    }
    context = {"title": title, "conventions": conventions, "result": None, **content}
    write_page(path, "experiment.html", context, filters)
