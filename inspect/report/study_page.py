"""Pages and pictures of studies: curves, maps and tables of any study, on one page that opens offline."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import UsageError
from anisoscope.report.figures import BLUE, GREEN, MUTED, ORANGE, RED, page_style, svg_uri
from anisoscope.report.page import write_page

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure


COLOURS = (BLUE, ORANGE, GREEN, RED)
SUFFIXES = (".png", ".svg")
_PANEL = (4.2, 3.2)  # inches


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve of a chart; ``low`` and ``high`` are a band about it, ``colour`` is its own (#rrggbb)."""

    label: str
    x: FloatArray
    y: FloatArray
    low: FloatArray | None = None
    high: FloatArray | None = None
    dashed: bool = False
    colour: str | None = None


def _colour(number: int, count: int) -> str:
    """Distinct colours for a few curves, an ordered scale for many."""
    if count <= len(COLOURS):
        return COLOURS[number]
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return to_hex(colormaps["viridis"](0.92 * number / (count - 1)))


def _round_ticks(axis: "Axis", values: FloatArray) -> None:
    """Plain numbers along a logarithmic axis of less than two decades."""
    ticks = [float(f"{value:.1g}") for value in np.geomspace(values[0], values[-1], 5)]
    image = sorted({tick for tick in ticks if values[0] * 0.999 <= tick <= values[-1] * 1.001})
    axis.set_ticks(image, [f"{tick:g}" for tick in image])
    axis.set_ticks([], minor=True)


@dataclass(frozen=True, eq=False)
class Chart:
    """Curves over one axis.

    Attributes:
        title: what is shown.
        x_label: with its unit.
        y_label: with its unit.
        curves: the curves.
        log: both axes logarithmic.
        log_x: the x axis logarithmic.
        mark_x: position of an upright line.
        points: mark the points.
        to_scale: both axes have one scale, as in a drawing.
    """

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    log: bool = False
    log_x: bool = False
    mark_x: float | None = None
    points: bool = True
    to_scale: bool = False

    def draw(self, axes: "Axes") -> None:
        """Draw into axes."""
        # Dashed curves are references: muted, and not counted in the colour scale.
        solid = [curve for curve in self.curves if not curve.dashed]
        for curve in self.curves:
            plain = MUTED if curve.dashed else _colour(solid.index(curve), len(solid))
            colour = curve.colour or plain
            style = "--" if curve.dashed else "-"
            marker = "o" if self.points and not curve.dashed else ""
            axes.plot(
                curve.x,
                curve.y,
                style,
                color=colour,
                marker=marker,
                markersize=3.5,
                linewidth=1.3,
                label=curve.label,
            )
            if curve.low is not None and curve.high is not None:
                axes.fill_between(curve.x, curve.low, curve.high, color=colour, alpha=0.18, linewidth=0)
        if self.log or self.log_x:
            axes.set_xscale("log")
        if self.log:
            axes.set_yscale("log")
            axes.xaxis.set_ticks([], minor=True)
        if self.mark_x is not None:
            axes.axvline(self.mark_x, color=MUTED, linewidth=0.9, linestyle=":")
        if len(self.curves) > 1:
            axes.legend(frameon=False, fontsize=7.5)
        if self.to_scale:
            axes.set_aspect("equal")
            axes.locator_params(axis="y", nbins=1)
        axes.grid()
        axes.set_xlabel(self.x_label)
        axes.set_ylabel(self.y_label)


@dataclass(frozen=True, eq=False)
class Map:
    """A value over two axes, its best place marked.

    Attributes:
        title: what is shown.
        x_label: with its unit.
        y_label: with its unit.
        bar_label: with the unit of the values.
        x: (X,) positions.
        y: (Y,) positions.
        values: (Y, X).
        mark: (x, y) of the optimum.
        log_x: the x axis logarithmic.
        log_y: the y axis logarithmic.
    """

    title: str
    x_label: str
    y_label: str
    bar_label: str
    x: FloatArray
    y: FloatArray
    values: FloatArray
    mark: tuple[float, float]
    log_x: bool = False
    log_y: bool = False

    def draw(self, axes: "Axes") -> None:
        """Draw into axes."""
        image = axes.pcolormesh(
            self.x, self.y, self.values, cmap="cividis", shading="gouraud", rasterized=True
        )
        if self.log_x:
            axes.set_xscale("log")
            _round_ticks(axes.xaxis, self.x)
        if self.log_y:
            axes.set_yscale("log")
            _round_ticks(axes.yaxis, self.y)
        axes.plot(*self.mark, "o", color=RED, markerfacecolor="white", markersize=7, clip_on=False, zorder=5)
        axes.set_xlabel(self.x_label)
        axes.set_ylabel(self.y_label)
        axes.figure.colorbar(image, ax=axes, label=self.bar_label)


@dataclass(frozen=True)
class Table:
    """A table of texts."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


@dataclass(frozen=True, eq=False)
class StudyPage:
    """Results of a study: tables, subtitle, notes and answer in the terminal, in HTML with the charts.

    The answer is one sentence, where the study has one.
    """

    title: str
    subtitle: str
    charts: Sequence[Chart | Map]
    tables: Sequence[Table]
    notes: Sequence[str]
    answer: str = ""

    def write(self, path: Path | str) -> None:
        """Write the page, atomically.

        Raises:
            RecordError: the file cannot be written.
        """
        wide = len(self.charts) == 1
        pictures = [(chart_uri(chart, wide=wide), chart.title) for chart in self.charts]
        write_page(Path(path), "study.html", {**vars(self), "pictures": pictures})

    def write_picture(self, path: Path | str) -> None:
        """Write all charts as one PNG or SVG picture, atomically.

        Raises:
            RecordError: the file cannot be written.
            UsageError: the file name says no kind of picture.
        """
        write_picture(Path(path), self.charts)


def chart_uri(chart: Chart | Map, *, wide: bool = False) -> str:
    """A chart as a data URI; ``wide`` is for one that fills the width of a page."""
    import matplotlib as mpl

    with mpl.rc_context(page_style()):
        figure = chart_figure(1, 1)
        if isinstance(chart, Chart) and chart.to_scale:
            figure.set_size_inches(_PANEL[0], 0.4 * _PANEL[1])
        elif wide:
            figure.set_size_inches(2.0 * _PANEL[0], 1.2 * _PANEL[1])
        chart.draw(figure.subplots())
        return svg_uri(figure)


def chart_figure(rows: int, columns: int) -> "Figure":
    """An empty figure with room for so many panels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_PANEL[0] * columns, _PANEL[1] * rows), layout="constrained", dpi=90)
    FigureCanvasAgg(figure)
    return figure


def check_picture(path: Path | None) -> None:
    """Refuse a file name without a known picture format, before anything is computed.

    Raises:
        UsageError: another suffix than those of ``SUFFIXES``.
    """
    if path is not None and path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"--plot {path}: a picture is named *.png or *.svg")


def write_picture(path: Path, charts: Sequence[Chart | Map], columns: int = 3) -> None:
    """Write all charts as one PNG or SVG picture, atomically.

    Raises:
        RecordError: the file cannot be written.
        UsageError: the file name says no kind of picture.
    """
    import matplotlib as mpl

    check_picture(path)
    across = min(columns, len(charts))
    with mpl.rc_context(page_style()):
        figure = chart_figure(-(-len(charts) // across), across)
        for number, chart in enumerate(charts):
            axes = figure.add_subplot(-(-len(charts) // across), across, number + 1)
            chart.draw(axes)
            axes.set_title(chart.title, fontsize=9)
        buffer = io.BytesIO()
        kind = path.suffix.lower()[1:]
        figure.savefig(buffer, format=kind, metadata={"Date": None} if kind == "svg" else {"Software": None})
    write_bytes(path, buffer.getvalue())
