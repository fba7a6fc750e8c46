"""Rendered pictures as PNG files: panels pixel by pixel, with titles, scale bars, legends and captions."""

import io
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.report.figures import BLUE, GRID, INK, MUTED, ORANGE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Rgb = npt.NDArray[np.uint8]

MISSING_RGB = (214, 33, 156)
BEYOND_RGB = (238, 241, 244)

_DPI = 100
_MARGIN, _GAP, _TITLE, _LINE = 16, 16, 26, 16
_LEAST_WIDTH = 480
_TEXT_POINTS = 8.0
_LETTER_PX = 5.9


@dataclass(frozen=True)
class Panel:
    """One picture with its title above and its lines below.

    Attributes:
        pixels: (rows, cols, 3) sRGB levels, shown pixel for pixel.
        title: above it.
        lines: below it.
    """

    pixels: Rgb
    title: str
    lines: tuple[str, ...] = ()


@dataclass(frozen=True)
class ScaleBar:
    """A bar of ``length_px`` pixels, labelled."""

    length_px: float
    label: str


@dataclass(frozen=True)
class Heights:
    """The colours of a height map, for its colour bar, and a profile across both pictures.

    Attributes:
        low_um: height at the lower end of the colours.
        high_um: height at their upper end.
        cut_row: picture row of the profile, or None.
        cut_x_um: (cols,) places along it.
        cut_height_um: (cols,) heights.
        cut_radiance: (cols,) radiances in 1/sr.
    """

    low_um: float
    high_um: float
    cut_row: int | None = None
    cut_x_um: FloatArray | None = None
    cut_height_um: FloatArray | None = None
    cut_radiance: FloatArray | None = None


def grey(levels: npt.NDArray[np.uint8]) -> Rgb:
    """(rows, cols, 3) of grey levels."""
    return np.repeat(levels[:, :, None], 3, axis=2)


def height_colours(height_um: FloatArray, low_um: float, high_um: float) -> Rgb:
    """Heights in the colours of the reports; missing points black, to be marked."""
    import matplotlib as mpl

    share = np.clip((np.nan_to_num(height_um) - low_um) / max(high_um - low_um, 1e-12), 0.0, 1.0)
    return np.asarray(mpl.colormaps["viridis"](share, bytes=True)[:, :, :3])


def scale_bar(pixel_um: float, width_px: int) -> ScaleBar:
    """A bar of 1, 2 or 5 times a power of ten, at most a quarter of the picture wide."""
    longest = 0.25 * width_px * pixel_um
    power = 10.0 ** np.floor(np.log10(longest))
    length = float(max(step * power for step in (1, 2, 5) if step * power <= longest))
    label = f"{length / 1000:g} mm" if length >= 1000 else f"{length:g} µm"
    return ScaleBar(length / pixel_um, label)


def _style() -> dict[str, object]:
    return {
        "font.family": "DejaVu Sans",
        "font.size": _TEXT_POINTS,
        "text.color": INK,
        "axes.edgecolor": MUTED,
        "axes.labelcolor": INK,
        "xtick.color": INK,
        "ytick.color": INK,
        "axes.spines.top": False,
        "grid.color": GRID,
        "grid.linewidth": 0.7,
    }


class _Sheet:
    """A figure measured in pixels from the top left."""

    def __init__(self, figure: "Figure", width: int, height: int) -> None:
        self.figure, self.width, self.height = figure, width, height

    def text(self, x: float, y: float, text: str, **style: object) -> None:
        """Text with its top left corner at (x, y)."""
        place = x / self.width, 1.0 - y / self.height
        self.figure.text(*place, text, va="top", **style)  # type: ignore[arg-type]

    def axes(self, x: float, y: float, width: float, height: float) -> "Axes":
        """Axes with their top left corner at (x, y)."""
        bottom = 1.0 - (y + height) / self.height
        return self.figure.add_axes((x / self.width, bottom, width / self.width, height / self.height))

    def picture(self, x: int, y: int, pixels: Rgb) -> "Axes":
        """A picture pixel for pixel, and axes in its pixels over it."""
        from matplotlib.patches import Rectangle

        rows, cols = pixels.shape[:2]
        self.figure.figimage(pixels, x, self.height - y - rows, origin="upper", resize=False)
        axes = self.axes(x, y, cols, rows)
        axes.set_axis_off()
        axes.set_zorder(2)  # over the picture
        axes.set_xlim(-0.5, cols - 0.5)
        axes.set_ylim(rows - 0.5, -0.5)
        axes.add_patch(
            Rectangle(
                (-1.5, -1.5), cols + 2, rows + 2, fill=False, edgecolor=GRID, linewidth=0.72, clip_on=False
            )
        )
        return axes


@contextmanager
def _sheet(width: int, height: int, stream: io.BytesIO) -> Iterator[_Sheet]:
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(_style()):  # type: ignore[arg-type]
        figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor="white")
        FigureCanvasAgg(figure)
        yield _Sheet(figure, width, height)
        figure.savefig(stream, format="png", dpi=_DPI, metadata={"Software": "anisoscope"})


def _wrapped(caption: Sequence[str], width: int) -> list[str]:
    letters = int((width - 2 * _MARGIN) / _LETTER_PX)
    return [line for sentence in caption for line in textwrap.wrap(sentence, letters)]


def _draw_bar(axes: "Axes", bar: ScaleBar, rows: int) -> None:
    import matplotlib.patheffects as effects

    start, y = 14.0, rows - 16.0
    outline = [effects.withStroke(linewidth=5.0, foreground="black")]
    axes.plot(
        [start, start + bar.length_px],
        [y, y],
        color="white",
        linewidth=2.6,
        solid_capstyle="butt",
        path_effects=outline,
    )
    axes.text(
        start + 0.5 * bar.length_px,
        y - 7,
        bar.label,
        color="white",
        ha="center",
        va="bottom",
        path_effects=[effects.withStroke(linewidth=2.6, foreground="black")],
    )


def _draw_legend(sheet: _Sheet, y: float, marks: Sequence[tuple[tuple[int, int, int], str]]) -> None:
    from matplotlib.patches import Rectangle

    x = float(_MARGIN)
    for colour, label in marks:
        place = (x / sheet.width, 1.0 - (y + 12) / sheet.height)
        size = 12 / sheet.width, 12 / sheet.height
        face = "#{:02x}{:02x}{:02x}".format(*colour)
        sheet.figure.add_artist(Rectangle(place, *size, facecolor=face, edgecolor=MUTED, linewidth=0.6))
        sheet.text(x + 18, y, label)
        x += 18 + _LETTER_PX * len(label) + 24


def panels_png(
    panels: Sequence[Panel],
    caption: Sequence[str],
    bar: ScaleBar | None = None,
    marks: Sequence[tuple[tuple[int, int, int], str]] = (),
    heights: Heights | None = None,
) -> bytes:
    """Panels side by side as a PNG.

    Args:
        panels: pictures of equal size.
        caption: sentences below, wrapped.
        bar: scale bar of all panels.
        marks: colours with a meaning, and what they mean.
        heights: if given, the first panel is a height map in colours; its colour bar, and a profile if there is
            one, are drawn.
    """
    rows, cols = panels[0].pixels.shape[:2]
    # Text has a fixed size: narrow pictures are spaced so that the page keeps a least width.
    step = max(cols, _LEAST_WIDTH // max(len(panels), 1)) + _GAP
    side = 74 if heights is not None else 0
    width = 2 * _MARGIN + step * len(panels) - _GAP + side
    lines = max(len(panel.lines) for panel in panels)
    has_cut = heights is not None and heights.cut_row is not None
    below = _TITLE + rows + 8 + _LINE * lines
    cut_height = 190 if has_cut else 0
    text = _wrapped(caption, width)
    height = _MARGIN + below + cut_height + (28 if marks else 10) + _LINE * len(text) + _MARGIN
    stream = io.BytesIO()
    with _sheet(width, height, stream) as sheet:
        for number, panel in enumerate(panels):
            x = _MARGIN + number * step + (side if number > 0 else 0)
            sheet.text(x, _MARGIN, panel.title, fontsize=9.5, fontweight="bold")
            axes = sheet.picture(x, _MARGIN + _TITLE, panel.pixels)
            if bar is not None:
                _draw_bar(axes, bar, rows)
            if has_cut:
                assert heights is not None
                axes.axhline(heights.cut_row or 0, color="white", linewidth=1.0, linestyle=(0, (4, 3)))
            for line, words in enumerate(panel.lines):
                sheet.text(x, _MARGIN + _TITLE + rows + 8 + _LINE * line, words)
        if heights is not None:
            _draw_colours(sheet, _MARGIN + cols + 8, rows, heights)
        if has_cut:
            assert heights is not None
            _draw_cut(sheet, _MARGIN + below + 8, heights)
        y = _MARGIN + below + cut_height + 6
        if marks:
            _draw_legend(sheet, y, marks)
            y += 22
        for number, words in enumerate(text):
            sheet.text(_MARGIN, y + _LINE * number, words, color=MUTED)
    return stream.getvalue()


def _draw_colours(sheet: _Sheet, x: float, rows: int, heights: Heights) -> None:
    import matplotlib as mpl
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    axes = sheet.axes(x, _MARGIN + _TITLE, 14, rows)
    colours = ScalarMappable(Normalize(heights.low_um, heights.high_um), mpl.colormaps["viridis"])
    sheet.figure.colorbar(colours, cax=axes, label="height [µm]")


def _draw_cut(sheet: _Sheet, y: float, heights: Heights) -> None:
    assert heights.cut_x_um is not None
    assert heights.cut_height_um is not None
    assert heights.cut_radiance is not None
    axes = sheet.axes(_MARGIN + 44, y, sheet.width - 2 * _MARGIN - 100, 130)
    axes.plot(heights.cut_x_um, heights.cut_height_um, color=BLUE, linewidth=1.1)
    axes.set_xlim(float(heights.cut_x_um[0]), float(heights.cut_x_um[-1]))
    axes.set_xlabel("along the dashed line [µm]")
    axes.set_ylabel("height [µm]", color=BLUE)
    axes.grid()
    twin = axes.twinx()
    twin.plot(heights.cut_x_um, heights.cut_radiance, color=ORANGE, linewidth=1.1)
    twin.set_ylabel("radiance [1/sr]", color=ORANGE)
    twin.set_ylim(bottom=0.0)
