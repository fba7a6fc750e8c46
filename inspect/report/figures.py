"""Figures of a report, each as a data URI, so that the page is self-contained."""

import base64
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from threading import RLock
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.language import decimal, message, translated

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch

Image = npt.NDArray[np.float32]

INK, MUTED, GRID = "#1c2733", "#5b6b7b", "#d7dee5"
BLUE, ORANGE, RED, GREEN = "#1f6fb2", "#e07b00", "#c62f2f", "#2b8a4b"
MARK = "#c62f30"  # on maps, whose colours stay in the dark
PAPER, ZONE, ZONE_EDGE = "#ffffff", "#dcefe2", "#9ccbab"

IN_THE_DARK = {
    INK: "#dfe6ec",
    MUTED: "#9db0c0",
    GRID: "#37444f",
    BLUE: "#62b0ee",
    RED: "#ff8a80",
    GREEN: "#6fcf92",
    PAPER: "#182129",
    ZONE: "#1e3b2b",
    ZONE_EDGE: "#3f7a57",
}
"""What the colours of a drawing turn into where the reader's screen is dark."""


def png_uri(data: bytes) -> str:
    """A PNG as a data URI."""
    return "data:image/png;base64," + base64.b64encode(data).decode("ascii")


def page_style() -> Any:  # noqa: ANN401 - keys of matplotlib's own closed type
    """Settings of matplotlib that all drawings of a page share."""
    return {
        "font.family": "DejaVu Sans",
        "font.size": 9,
        "axes.edgecolor": MUTED,
        "axes.labelcolor": INK,
        "xtick.color": INK,
        "ytick.color": INK,
        "text.color": INK,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.axisbelow": True,
        "grid.color": GRID,
        "grid.linewidth": 0.7,
        "svg.fonttype": "path",
        "svg.hashsalt": "anisoscope",
        "path.simplify": True,
    }


_DRAWING = RLock()  # the style is one for the whole process: several threads draw one after the other


@contextmanager
def new_figure(width: float, height: float) -> Iterator[tuple["Figure", "Axes"]]:
    """A figure of a page, (width, height) in inches, with one pair of axes, in the style that all pages share."""
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with _DRAWING, mpl.rc_context(page_style()):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasSVG(figure)
        yield figure, figure.subplots()


@contextmanager
def new_map_figure(size: tuple[float, float]) -> Iterator[tuple["Figure", "Axes", "Axes"]]:
    """Axes for a map of ``size`` (height, width) and for its colour bar, alike in every map of a report."""
    width = 4.6
    side = 0.64 * width
    high = side * size[0] / size[1]
    height = high + 0.62
    with new_figure(width, height) as (figure, axes):
        figure.set_layout_engine("none")
        bottom, top = 0.48 / height, high / height
        axes.set_position((0.13, bottom, side / width, top))
        axes.spines[:].set_visible(True)
        axes.set_xlabel("x [mm]")
        axes.set_ylabel("y [mm]")
        axes.locator_params(nbins=5)
        yield figure, axes, figure.add_axes((0.80, bottom, 0.035, top))


def svg_uri(figure: "Figure") -> str:
    """The drawing as a data URI, in the colours of the reader's screen."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    stream = io.BytesIO()
    # savefig draws everything twice
    canvas = FigureCanvasSVG(figure)
    canvas.print_svg(stream, metadata={"Date": None, "Creator": "anisoscope"})  # type: ignore[no-untyped-call]
    drawing = _for_both_lights(stream.getvalue().decode())
    return "data:image/svg+xml;base64," + base64.b64encode(drawing.encode()).decode("ascii")


def _for_both_lights(svg: str) -> str:
    """Drawing whose colours follow the reader's colour scheme; without a style sheet they are as drawn."""
    names = {colour: f"--c{number}" for number, colour in enumerate(IN_THE_DARK)}
    for colour, name in names.items():
        svg = svg.replace(f": {colour}", f": var({name}, {colour})")
    dark = "".join(f"{names[colour]}:{other};" for colour, other in IN_THE_DARK.items())
    style = f"<style>@media screen and (prefers-color-scheme: dark) {{ svg {{ {dark} }} }}</style>"
    return svg.replace("<defs>", f"<defs>{style}", 1)


def photograph(radiance: Image, white: float, *, jpeg: bool = False) -> str:
    """A radiance picture as the eye would see it: sRGB encoded, ``white`` is full brightness.

    Args:
        radiance: (rows, cols), first row at the top, or (rows, cols, 3) of blue, green, red.
        white: radiance shown as white.
        jpeg: compress, where nothing is read off the picture.
    """
    linear = np.clip(np.nan_to_num(radiance) / white, 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    shown = np.asarray(255.0 * encoded + 0.5, dtype=np.uint8)
    done, data = cv2.imencode(".jpg" if jpeg else ".png", shown)
    assert done
    if jpeg:
        return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")
    return png_uri(data.tobytes())


def still_picture(png: bytes) -> str:
    """A rendering as a data URI, with a loss that the eye does not see: a quarter of the PNG."""
    picture = cv2.imdecode(np.frombuffer(png, dtype=np.uint8), cv2.IMREAD_COLOR)
    done, data = cv2.imencode(".jpg", np.asarray(picture), [cv2.IMWRITE_JPEG_QUALITY, 92])
    assert done
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")


def enlarged(cells: FloatArray, side: int = 240) -> FloatArray:
    """Cells as squares of several pixels, so that browsers do not blur them."""
    factor = max(1, -(-side // max(cells.shape)))
    return np.asarray(np.repeat(np.repeat(cells, factor, axis=0), factor, axis=1))


def difference_picture(relative: FloatArray, reach: float) -> str:
    """Cells brighter (orange) and darker (violet) than predicted; the colours end at ± ``reach``."""
    from matplotlib import colormaps

    colours = colormaps["PuOr_r"](np.clip(0.5 + 0.5 * enlarged(relative) / reach, 0.0, 1.0))
    lossless = [cv2.IMWRITE_WEBP_QUALITY, 101]  # a fifth of a PNG, of squares of one colour
    done, data = cv2.imencode(
        ".webp", np.asarray(255.0 * colours[..., 2::-1] + 0.5, dtype=np.uint8), lossless
    )
    assert done
    return "data:image/webp;base64," + base64.b64encode(data.tobytes()).decode("ascii")


def limit_picture(over_limit: FloatArray) -> str:
    """Differences over their limit, one pixel a cell: pale up to 1, full colour at 2; as a data URI."""
    colours = _calm()(np.clip(0.5 + 0.25 * over_limit, 0.0, 1.0))
    done, data = cv2.imencode(".png", np.asarray(255.0 * colours[..., 2::-1] + 0.5, dtype=np.uint8))
    assert done
    return png_uri(data.tobytes())


def outline_path(mask: npt.NDArray[np.bool_]) -> str:
    """SVG path around groups of two or more touching cells, in units of cells; single cells are left out."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    large = np.array([False, *(stats[k, cv2.CC_STAT_AREA] > 1 for k in range(1, count))])[labels]
    padded = np.pad(large, 1)
    upright = np.argwhere(padded[1:-1, 1:] != padded[1:-1, :-1])
    level = np.argwhere(padded[1:, 1:-1] != padded[:-1, 1:-1])
    return "".join([f"M{col} {row}v1" for row, col in upright] + [f"M{col} {row}h1" for row, col in level])


@dataclass(frozen=True)
class MapFrame:
    """Frame of a map: its centre from the rotation axis, in mm along its own axes, and the names of these."""

    middle_mm: tuple[float, float] = (0.0, 0.0)
    across: str = "x"
    along: str = "y"

    def label(self, axes: "Axes", size_mm: tuple[float, float]) -> tuple[float, float, float, float]:
        """Name the axes of a map of (height, width), and return its (left, right, lower, upper) ends in mm."""
        axes.set_xlabel(message("{direction} from the rotation axis [mm]", direction=self.across))
        axes.set_ylabel(f"{translated(self.along)} [mm]")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(lambda value, _: decimal(f"{value:g}").replace("-", "−"))
        (x, y), (height, width) = self.middle_mm, size_mm
        return x - width / 2, x + width / 2, y - height / 2, y + height / 2


def contrast_map(
    ratio: FloatArray,
    deviating: npt.NDArray[np.bool_] | None,
    size_mm: tuple[float, float],
    frame: MapFrame = MapFrame(),
) -> str:
    """Cells of the contrast map; where cells deviate, their patches are outlined.

    Args:
        ratio: (cell rows, cell cols) ln ratio, first row at the top.
        deviating: same shape, or None.
        size_mm: (height, width) of the region.
        frame: where it lies.
    """
    low, high = np.percentile(ratio, [1, 99])
    with new_map_figure(size_mm) as (figure, axes, bar):
        extent = frame.label(axes, size_mm)
        shown = axes.imshow(ratio, cmap="cividis", vmin=low, vmax=max(high, low + 0.05), extent=extent)
        if deviating is not None:
            axes.add_artist(_outline(deviating, size_mm, frame.middle_mm))
        figure.colorbar(shown, cax=bar, label="ln ratio")
        return svg_uri(figure)


def lean_map(
    lean: FloatArray,
    across_mm: FloatArray,
    along_mm: FloatArray,
    label: str,
    unknown: npt.NDArray[np.bool_] | None = None,
    frame: MapFrame = MapFrame(),
) -> str:
    """Lean of facets in cells, about their median; grey where none is seen.

    Args:
        lean: (A, C) degrees, NaN where unknown, the first row at the top.
        across_mm: (C,) middles of the columns from the middle of the region.
        along_mm: (A,) middles of the rows, falling.
        label: of the colour bar.
        unknown: (A, C) True where light is, but no facet.
        frame: where the region lies.
    """
    middle = float(np.nanmedian(lean))
    reach = max(float(np.nanpercentile(np.abs(lean - middle), 99.0)), 0.1)
    size = (float(np.ptp(along_mm)), float(np.ptp(across_mm)))
    with new_map_figure(size) as (figure, axes, bar):
        frame.label(axes, size)
        axes.set_facecolor(MUTED)
        x, y = (axis + shift for axis, shift in zip((across_mm, along_mm), frame.middle_mm, strict=True))
        shown = axes.pcolormesh(
            x,
            y,
            lean,
            cmap=_calm(),
            vmin=middle - reach,
            vmax=middle + reach,
            shading="nearest",
            rasterized=True,
        )
        if unknown is not None and unknown.any():
            rows, cols = np.nonzero(unknown)
            axes.plot(x[cols], y[rows], linestyle="none", marker="s", markersize=2.0, color=MARK)
        figure.colorbar(shown, cax=bar, label=label)
        bar.yaxis.set_major_formatter(lambda value, _: decimal(f"{value:.4g}").replace("-", "−"))
        return svg_uri(figure)


def lean_histogram(lean: FloatArray, nominal: float | None) -> str:
    """How often cells lean by how much.

    Args:
        lean: degrees, NaN where unknown.
        nominal: of the design, marked; None marks nothing.
    """
    known = lean[np.isfinite(lean)]
    with new_figure(4.6, 2.4) as (figure, axes):
        axes.hist(known, bins=min(60, max(10, round(np.sqrt(known.size)))), color=BLUE)
        if nominal is not None:
            axes.axvline(nominal, color=ORANGE, label=f"design {nominal:g}°")
            axes.legend(frameon=False)
        axes.set_xlabel("lean across the ridges [°]")
        axes.set_ylabel("cells")
        return svg_uri(figure)


def deviation_map(
    deviation: FloatArray,
    deviating: npt.NDArray[np.bool_] | None,
    places: Sequence[tuple[float, float]],
    size_mm: tuple[float, float],
    frame: MapFrame = MapFrame(),
) -> str:
    """By how much every cell is off, with the regions outlined and numbered from 1; pale within the limit.

    Args:
        deviation: (cell rows, cell cols) score over its limit, with a sign, first row at the top.
        deviating: same shape, or None.
        places: (x, y) of the middle of every numbered region in mm from the rotation axis, along the map's axes.
        size_mm: (height, width) of the region.
        frame: where it lies.
    """
    from matplotlib.patheffects import withStroke

    with new_map_figure(size_mm) as (figure, axes, bar):
        extent = frame.label(axes, size_mm)
        shown = axes.imshow(deviation, cmap=_calm(), vmin=-2.0, vmax=2.0, extent=extent)
        if deviating is not None:
            axes.add_artist(_outline(deviating, size_mm, frame.middle_mm))
        points = [
            (MAP_POINTS * (x - extent[0]) / size_mm[1], MAP_POINTS * (y - extent[2]) / size_mm[1])
            for x, y in places
        ]
        offsets = label_offsets(points, (MAP_POINTS, MAP_POINTS * size_mm[0] / size_mm[1]))
        for number, ((x, y), offset) in enumerate(zip(places, offsets, strict=True), start=1):
            label = axes.annotate(
                str(number),
                (x, y),
                xytext=offset,
                ha="center",
                va="center",
                textcoords="offset points",
                fontsize=9,
                fontweight="bold",
                annotation_clip=False,
                arrowprops={"arrowstyle": "-", "color": INK, "linewidth": 0.7},
            )
            label.set_path_effects([withStroke(linewidth=2.5, foreground="white")])
        scale = message("score over its limit; pale: below it")
        figure.colorbar(shown, cax=bar, label=scale, ticks=[-2.0, -1.0, 0.0, 1.0, 2.0])
        bar.yaxis.set_major_formatter(lambda value, _: decimal(f"{value:.3g}").replace("-", "−"))
        return svg_uri(figure)


MAP_POINTS = 0.64 * 4.6 * 72.0
"""Width of a map in points."""


def label_offsets(
    points: Sequence[tuple[float, float]], size: tuple[float, float]
) -> tuple[tuple[float, float], ...]:
    """Offsets in points from places to their labels, such that labels neither overlap nor leave the map.

    Args:
        points: places in points from the lower left corner.
        size: (width, height) of the map in points.
    """
    taken: list[tuple[float, float]] = []
    found = []
    tries = [
        (radius * np.cos(turn), radius * np.sin(turn))
        for radius in (12.0, 20.0, 30.0, 42.0, 56.0)
        for turn in np.radians(np.arange(45.0, 405.0, 30.0))
    ]
    for x, y in points:
        free = (
            (dx, dy)
            for dx, dy in tries
            if 7.0 <= x + dx <= size[0] - 7.0
            and 6.0 <= y + dy <= size[1] - 6.0
            and all(abs(x + dx - a) > 15.0 or abs(y + dy - b) > 11.0 for a, b in taken)
        )
        offset = next(free, tries[0])
        taken.append((x + offset[0], y + offset[1]))
        found.append(offset)
    return tuple(found)


def _calm() -> "ListedColormap":
    """Colours from violet to orange, pale in the middle half."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    place = np.linspace(-1.0, 1.0, 256)
    strength = np.where(np.abs(place) < 0.5, 0.36 * np.abs(place), 0.4 + 1.2 * (np.abs(place) - 0.5))
    return ListedColormap(colormaps["PuOr_r"](0.5 + 0.5 * np.sign(place) * strength))


def _outline(
    mask: npt.NDArray[np.bool_], size_mm: tuple[float, float], middle_mm: tuple[float, float] = (0.0, 0.0)
) -> "PathPatch":
    """The edges between cells that deviate and cells that do not, as one path: thousands of lines take seconds."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    padded = np.pad(mask, 1)
    rows, cols = mask.shape
    upright = np.argwhere(padded[1:-1, 1:] != padded[1:-1, :-1])[:, ::-1]
    level = np.argwhere(padded[1:, 1:-1] != padded[:-1, 1:-1])[:, ::-1]
    ends = np.concatenate([np.add(upright, (0, 1)), np.add(level, (1, 0))])
    lines = np.stack([np.concatenate([upright, level]), ends], axis=1)
    scale = np.array([size_mm[1] / cols, -size_mm[0] / rows])
    corner = np.array([middle_mm[0] - size_mm[1] / 2, middle_mm[1] + size_mm[0] / 2])
    codes = np.tile(np.array([Path.MOVETO, Path.LINETO], dtype=np.uint8), len(lines))
    path = Path((lines * scale + corner).reshape(-1, 2), codes)
    return PathPatch(path, fill=False, edgecolor=MARK, linewidth=0.6)


def contrast_chart(
    labels: Sequence[str],
    deviation: Sequence[float],
    u: Sequence[float],
    tolerance: Sequence[float | None],
    unit: str,
) -> str:
    """Deviation of every contrast from its prediction with 95 % intervals, in front of the tolerance zone."""
    with new_figure(9.0, 0.75 + 0.5 * len(labels)) as (figure, axes):
        for k in range(len(labels)):
            limit = tolerance[k]
            if limit is not None:
                axes.barh(
                    k,
                    2 * limit,
                    left=-limit,
                    height=0.62,
                    color=ZONE,
                    edgecolor=ZONE_EDGE,
                    linewidth=0.8,
                )
            axes.errorbar(
                deviation[k],
                k,
                xerr=1.96 * u[k],
                fmt="o",
                color=BLUE,
                capsize=4,
                markersize=6,
                linewidth=1.6,
            )
        axes.axvline(0.0, color=MUTED, linewidth=0.9)
        axes.set_yticks(range(len(labels)), labels)
        axes.set_ylim(len(labels) - 0.45, -0.55)
        axes.grid(axis="x")
        zone = ", green: tolerance" if any(one is not None for one in tolerance) else ""
        axes.set_xlabel(f"measured − predicted [{unit}];  bar: 95 % interval{zone}")
        reach = max(abs(d) + max(1.96 * s, t or 0.0) for d, s, t in zip(deviation, u, tolerance, strict=True))
        axes.set_xlim(-1.12 * reach, 1.12 * reach)
        return svg_uri(figure)


def height_picture(height_um: FloatArray, pixel_um: tuple[float, float]) -> str:
    """A height map from above, in false colours.

    Args:
        height_um: (rows, cols), row index rising with +y.
        pixel_um: (y, x).
    """
    step = max(1, max(height_um.shape) // 500)
    shown = height_um[::step, ::step]
    extent_mm = (0.0, height_um.shape[1] * pixel_um[1] / 1000, 0.0, height_um.shape[0] * pixel_um[0] / 1000)
    with new_map_figure((extent_mm[3], extent_mm[1])) as (figure, axes, bar):
        low, high = np.nanpercentile(shown, [0.5, 99.5])
        image = axes.imshow(shown, origin="lower", cmap="viridis", extent=extent_mm, vmin=low, vmax=high)
        figure.colorbar(image, cax=bar, label="height [µm]")
        return svg_uri(figure)


def profile_chart(x_um: FloatArray, z_um: FloatArray) -> str:
    """Profile of the height map across the ridges."""
    with new_figure(9.0, 2.1) as (figure, axes):
        axes.plot(x_um, z_um, color=BLUE, linewidth=1.1)
        axes.grid()
        axes.set_xlabel("x [µm]")
        axes.set_ylabel("height [µm]")
        axes.set_xlim(float(x_um[0]), float(x_um[-1]))
        return svg_uri(figure)
