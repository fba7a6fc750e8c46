"""Pictures of a report, each as a data URI: nothing outside the page is needed to show them."""

import base64
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

FloatArray = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

INK, MUTED, GRID = "#1c2733", "#5b6b7b", "#d7dee5"
BLUE, ORANGE, RED, GREEN = "#1f6fb2", "#e07b00", "#c62f2f", "#2b8a4b"


def png_uri(data: bytes) -> str:
    """A PNG as a data URI."""
    return "data:image/png;base64," + base64.b64encode(data).decode("ascii")


def _style() -> dict[str, object]:
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


@contextmanager
def _figure(width: float, height: float) -> Iterator[tuple["Figure", "Axes"]]:
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with mpl.rc_context(_style()):  # type: ignore[arg-type]
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasSVG(figure)
        yield figure, figure.subplots()


@contextmanager
def _map_figure(size: tuple[float, float]) -> Iterator[tuple["Figure", "Axes", "Axes"]]:
    """Axes for a map of ``size`` (height, width) and for its colour bar, alike in every map of a report."""
    width = 4.6
    side = 0.64 * width
    high = side * size[0] / size[1]
    height = high + 0.62
    with _figure(width, height) as (figure, axes):
        figure.set_layout_engine("none")
        bottom, top = 0.48 / height, high / height
        axes.set_position((0.13, bottom, side / width, top))
        axes.spines[:].set_visible(True)
        axes.set_xlabel("x [mm]")
        axes.set_ylabel("y [mm]")
        axes.locator_params(nbins=5)
        yield figure, axes, figure.add_axes((0.80, bottom, 0.035, top))


def _svg_uri(figure: "Figure") -> str:
    stream = io.BytesIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": "anisoscope"})
    return "data:image/svg+xml;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def photograph(radiance: Image, white: float) -> str:
    """A radiance picture as the eye would see it: sRGB encoded, ``white`` is full brightness.

    Args:
        radiance: (rows, cols), first row at the top.
        white: radiance shown as white.
    """
    linear = np.clip(np.nan_to_num(radiance) / white, 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    done, data = cv2.imencode(".png", np.asarray(255.0 * encoded + 0.5, dtype=np.uint8))
    assert done
    return png_uri(data.tobytes())


def contrast_map(
    ratio: FloatArray, deviating: npt.NDArray[np.bool_] | None, size_mm: tuple[float, float]
) -> str:
    """Cells of the contrast map; where cells deviate, their patches are outlined.

    Args:
        ratio: (cell rows, cell cols) ln ratio, first row at the top.
        deviating: same shape, or None.
        size_mm: (height, width) of the region.
    """
    height, width = size_mm
    low, high = np.percentile(ratio, [1, 99])
    with _map_figure(size_mm) as (figure, axes, bar):
        extent = (-width / 2, width / 2, -height / 2, height / 2)
        shown = axes.imshow(ratio, cmap="cividis", vmin=low, vmax=max(high, low + 0.05), extent=extent)
        if deviating is not None:
            axes.add_collection(_outline(deviating, size_mm))
        figure.colorbar(shown, cax=bar, label="ln ratio")
        return _svg_uri(figure)


def deviation_map(
    deviation: FloatArray,
    deviating: npt.NDArray[np.bool_] | None,
    places: Sequence[tuple[float, float]],
    size_mm: tuple[float, float],
) -> str:
    """By how much every cell is off, with the regions outlined and numbered from 1.

    Args:
        deviation: (cell rows, cell cols) ln ratio, first row at the top.
        deviating: same shape, or None.
        places: (x, y) of the middle of every numbered region in mm from the middle of the map.
        size_mm: (height, width) of the region.
    """
    from matplotlib.patheffects import withStroke

    height, width = size_mm
    reach = max(float(np.percentile(np.abs(deviation), 99.5)), 0.05)
    with _map_figure(size_mm) as (figure, axes, bar):
        extent = (-width / 2, width / 2, -height / 2, height / 2)
        shown = axes.imshow(deviation, cmap="PuOr", vmin=-reach, vmax=reach, extent=extent)
        if deviating is not None:
            axes.add_collection(_outline(deviating, size_mm))
        for number, (x, y) in enumerate(places, start=1):
            label = axes.annotate(
                str(number),
                (x, y),
                xytext=(7, 7),
                textcoords="offset points",
                fontsize=9,
                fontweight="bold",
                annotation_clip=False,
                arrowprops={"arrowstyle": "-", "color": INK, "linewidth": 0.7},
            )
            label.set_path_effects([withStroke(linewidth=2.5, foreground="white")])
        figure.colorbar(shown, cax=bar, label="ln ratio off")
        return _svg_uri(figure)


def golden_strip(labels: Sequence[str], golden: FloatArray, measured: Sequence[float]) -> str:
    """Every golden part as a dot and this part as a diamond, one strip a contrast, all from the golden mean.

    Args:
        labels: names of the contrasts.
        golden: (n, contrasts).
        measured: of this part.
    """
    off = golden - golden.mean(axis=0)
    with _figure(9.0, 0.95 + 0.42 * len(labels)) as (figure, axes):
        strip = np.arange(len(labels), dtype=np.float64)
        spread = 0.12 * (np.arange(len(off)) % 5 - 2)
        rows = (strip[None, :] + spread[:, None]).ravel()
        known = axes.scatter(off.ravel(), rows, s=20, color=BLUE, alpha=0.6, linewidths=0)
        here = np.asarray(measured) - golden.mean(axis=0)
        mine = axes.scatter(
            here, strip, s=70, marker="D", color=ORANGE, edgecolor=INK, linewidths=0.8, zorder=3
        )
        axes.axvline(0.0, color=MUTED, linewidth=0.9)
        axes.set_yticks(range(len(labels)), labels)
        axes.set_ylim(len(labels) - 0.45, -0.55)
        axes.grid(axis="x")
        axes.set_xlabel("ln ratio, from the mean of the golden parts")
        axes.legend([known, mine], ["golden parts", "this part"], loc="best", frameon=False)
        return _svg_uri(figure)


def _outline(mask: npt.NDArray[np.bool_], size_mm: tuple[float, float]) -> "LineCollection":
    """The edges between cells that deviate and cells that do not."""
    from matplotlib.collections import LineCollection

    padded = np.pad(mask, 1)
    rows, cols = mask.shape
    upright = [((c, r), (c, r + 1)) for r, c in np.argwhere(padded[1:-1, 1:] != padded[1:-1, :-1])]
    level = [((c, r), (c + 1, r)) for r, c in np.argwhere(padded[1:, 1:-1] != padded[:-1, 1:-1])]
    scale = np.array([size_mm[1] / cols, -size_mm[0] / rows])
    corner = np.array([-size_mm[1] / 2, size_mm[0] / 2])
    lines = np.array(upright + level, dtype=np.float64).reshape(-1, 2, 2) * scale + corner
    return LineCollection(list(lines), colors=RED, linewidths=0.6)


def contrast_chart(
    labels: Sequence[str],
    deviation: Sequence[float],
    u: Sequence[float],
    tolerance: Sequence[float | None],
    unit: str,
) -> str:
    """Deviation of every contrast from its prediction with 95 % intervals, in front of the tolerance zone."""
    with _figure(9.0, 0.75 + 0.5 * len(labels)) as (figure, axes):
        for k in range(len(labels)):
            limit = tolerance[k]
            if limit is not None:
                axes.barh(
                    k,
                    2 * limit,
                    left=-limit,
                    height=0.62,
                    color="#dcefe2",
                    edgecolor="#9ccbab",
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
        axes.set_xlabel(f"measured − predicted [{unit}];  bar: 95 % interval, green: tolerance")
        reach = max(abs(d) + max(1.96 * s, t or 0.0) for d, s, t in zip(deviation, u, tolerance, strict=True))
        axes.set_xlim(-1.12 * reach, 1.12 * reach)
        return _svg_uri(figure)


def budget_chart(
    sources: Sequence[str], contributions: FloatArray, labels: Sequence[str], kinds: Sequence[str]
) -> str:
    """Bars of every source's contribution to every contrast, largest source first.

    Args:
        sources: S names.
        contributions: (S, pairs).
        labels: names of the contrasts.
        kinds: "prediction" or "measurement" for every source.
    """
    pairs = contributions.shape[1]
    shades = [BLUE, ORANGE, GREEN, MUTED, RED]
    with _figure(5.4, 0.8 + 0.15 * len(sources) * (1 + 0.35 * pairs)) as (figure, axes):
        height = 0.8 / pairs
        for p in range(pairs):
            positions = np.arange(len(sources)) - 0.4 + height * (p + 0.5)
            axes.barh(
                positions, contributions[:, p], height=height, color=shades[p % len(shades)], label=labels[p]
            )
        axes.set_yticks(
            range(len(sources)), [f"{s}  ({k[0].upper()})" for s, k in zip(sources, kinds, strict=True)]
        )
        axes.set_ylim(len(sources) - 0.5, -0.6)
        axes.grid(axis="x")
        axes.set_xlabel("standard uncertainty of the contrast")
        axes.legend(loc="lower right", frameon=False)
        return _svg_uri(figure)


def height_picture(height_um: FloatArray, pixel_um: tuple[float, float]) -> str:
    """A height map seen from above, in false colours.

    Args:
        height_um: (rows, cols), row index rising with +y.
        pixel_um: (y, x).
    """
    step = max(1, max(height_um.shape) // 500)
    shown = height_um[::step, ::step]
    extent_mm = (0.0, height_um.shape[1] * pixel_um[1] / 1000, 0.0, height_um.shape[0] * pixel_um[0] / 1000)
    with _map_figure((extent_mm[3], extent_mm[1])) as (figure, axes, bar):
        low, high = np.nanpercentile(shown, [0.5, 99.5])
        image = axes.imshow(shown, origin="lower", cmap="viridis", extent=extent_mm, vmin=low, vmax=high)
        figure.colorbar(image, cax=bar, label="height [µm]")
        return _svg_uri(figure)


def profile_chart(x_um: FloatArray, z_um: FloatArray) -> str:
    """One line of the height map across the ridges."""
    with _figure(9.0, 2.1) as (figure, axes):
        axes.plot(x_um, z_um, color=BLUE, linewidth=1.1)
        axes.grid()
        axes.set_xlabel("x [µm]")
        axes.set_ylabel("height [µm]")
        axes.set_xlim(float(x_um[0]), float(x_um[-1]))
        return _svg_uri(figure)
