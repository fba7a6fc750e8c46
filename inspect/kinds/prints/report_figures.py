"""Pictures of a print: its cells in colour, the lobe over the tilts, quantities against their limits, and maps."""

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.kinds.prints.record import LENGTHS, ColourRecord, QuantityRecord, SpotRecord
from anisoscope.report.figures import (
    BLUE,
    GREEN,
    INK,
    MUTED,
    ORANGE,
    RED,
    ZONE,
    ZONE_EDGE,
    _outline,
    new_figure,
    new_map_figure,
    png_uri,
    svg_uri,
)

SHADES = (BLUE, ORANGE, GREEN, RED, MUTED, INK)
LEGEND_ROWS = 6
MARKS = ("o", "s", "^", "D", "v", "P")
SMALLEST_MARK = 3
SMALL_LEAN_DEG = 0.2
SHORTEST = 0.02
"""Half height of the zone of a quantity without uncertainty, so that it is seen."""


def cells_picture(srgb: FloatArray) -> str:
    """(rows, cols, 3) encoded sRGB as a PNG, one pixel a cell."""
    done, data = cv2.imencode(".png", np.asarray(np.rint(255.0 * srgb[..., ::-1]), dtype=np.uint8))
    assert done
    return png_uri(data.tobytes())


def lobe_chart(colours: Sequence[ColourRecord]) -> str:
    """Radiance of the green channel over the tilt, one line a stage angle: measured marks, predicted lines."""
    with new_figure(9.0, 3.4) as (figure, axes):
        angles = sorted({one.stage_deg for one in colours})
        for number, angle in enumerate(angles):
            line = sorted((one for one in colours if one.stage_deg == angle), key=lambda one: one.tilt_deg)
            tilts = np.array([one.tilt_deg for one in line])
            shade, mark = SHADES[number % len(SHADES)], MARKS[number % len(MARKS)]
            axes.plot(tilts, [one.predicted[1] for one in line], color=shade, linewidth=1.1, alpha=0.8)
            axes.errorbar(
                tilts,
                [one.measured[1] for one in line],
                yerr=[1.96 * one.u[1] * one.measured[1] for one in line],
                fmt=mark,
                color=shade,
                markersize=max(6 - number, SMALLEST_MARK),
                capsize=2,
                label=f"{angle:g}°",
            )
        axes.set_yscale("log")
        axes.grid(which="both")
        axes.set_xlabel(
            "tilt of camera and light [°];  marks: measured, with 95 % interval; lines join the predicted poses"
        )
        axes.set_ylabel("green channel [1/sr]")
        columns = 1 + (len(angles) - 1) // LEGEND_ROWS
        axes.legend(frameon=False, fontsize=8, title="stage angle", title_fontsize=8, ncols=columns)
        return svg_uri(figure)


def quantity_chart(quantities: Sequence[QuantityRecord]) -> str:
    """Deviation of every quantity over its limit, with 95 % intervals, in front of the zone of good prints."""
    count = len(quantities)
    with new_figure(9.0, 0.75 + 0.36 * count) as (figure, axes):
        axes.axvspan(-1.0, 1.0, color=ZONE, ec=ZONE_EDGE, linewidth=0.8)
        for row, one in enumerate(quantities):
            at, reach = one.deviation / one.limit, 1.96 * one.u / one.limit
            reach = max(reach, SHORTEST)
            axes.errorbar(
                at,
                row,
                xerr=[[min(reach, at) if one.name in LENGTHS else reach], [reach]],
                fmt="o",
                color=BLUE,
                capsize=4,
                markersize=6,
                linewidth=1.6,
            )
        axes.axvline(0.0, color=MUTED, linewidth=0.9)
        axes.set_yticks(range(count), [one.title.replace("-", "−") for one in quantities])
        axes.set_ylim(count - 0.45, -0.55)
        axes.grid(axis="x")
        axes.set_xlabel("deviation over its limit;  bar: 95 % interval, green: good prints")
        reach = max((abs(one.deviation) + 1.96 * one.u) / one.limit for one in quantities)
        axes.set_xlim(-1.1 * max(reach, 1.2), 1.1 * max(reach, 1.2))
        return svg_uri(figure)


def difference_map(
    delta_e: FloatArray,
    deviating: npt.NDArray[np.bool_] | None,
    size_mm: tuple[float, float],
    center_mm: tuple[float, float] = (0.0, 0.0),
    spots: Sequence[SpotRecord] = (),
) -> str:
    """Colour differences of the cells, first row at the top; where cells deviate, their patches are outlined.

    Args:
        delta_e: (rows, cols) CIEDE2000.
        deviating: (rows, cols) which cells deviate, or None.
        size_mm: (height, width) of the region.
        center_mm: (x, y) of its middle.
        spots: places that deviate, to be numbered from 1.
    """
    from matplotlib.patheffects import withStroke  # noqa: PLC0415 - heavy
    from matplotlib.transforms import Affine2D  # noqa: PLC0415 - heavy

    with new_map_figure(size_mm) as (figure, axes, bar):
        extent = _extent(size_mm, center_mm)
        top = max(float(np.percentile(delta_e, 99.5)), 0.5)
        shown = axes.imshow(delta_e, cmap="cividis", vmin=0.0, vmax=top, extent=extent)
        if deviating is not None and deviating.any():
            edges = _outline(deviating, size_mm)
            edges.set_transform(Affine2D().translate(*center_mm) + axes.transData)
            axes.add_artist(edges)
        for number, spot in enumerate(spots, start=1):
            at = (spot.x + 0.5 * spot.width, spot.y + 0.5 * spot.length)
            label = axes.annotate(
                str(number),
                at,
                xytext=(2, 2),
                textcoords="offset points",
                fontsize=9,
                fontweight="bold",
                annotation_clip=False,
            )
            label.set_path_effects([withStroke(linewidth=2.5, foreground="white")])
        figure.colorbar(shown, cax=bar, label="ΔE2000")
        return svg_uri(figure)


def _extent(
    size_mm: tuple[float, float], center_mm: tuple[float, float]
) -> tuple[float, float, float, float]:
    (height, width), (x, y) = size_mm, center_mm
    return (x - width / 2, x + width / 2, y - height / 2, y + height / 2)


def lean_map(
    lean_deg: FloatArray, size_mm: tuple[float, float], center_mm: tuple[float, float] = (0.0, 0.0)
) -> str:
    """How the flakes lean in every cell against the whole region: size in colour, direction and size as arrows.

    An arrow that reaches to the next one leans as far as the scale goes, so that noise does not look like a lean.
    """
    rows, cols = lean_deg.shape[1:]
    with new_map_figure(size_mm) as (figure, axes, bar):
        extent = left, right, bottom, top = _extent(size_mm, center_mm)
        size = np.hypot(*lean_deg)
        most = max(float(size.max()), SMALL_LEAN_DEG)
        shown = axes.imshow(size, cmap="cividis", vmin=0.0, vmax=most, extent=extent)
        step = max(1, max(rows, cols) // 10)
        x = left + (np.arange(cols) + 0.5) / cols * (right - left)
        y = top - (np.arange(rows) + 0.5) / rows * (top - bottom)
        part = np.s_[step // 2 :: step]
        axes.quiver(
            x[part],
            y[part],
            lean_deg[0][part, part],
            lean_deg[1][part, part],
            color="#ffffff",
            angles="xy",
            scale_units="xy",
            scale=most / (step * (right - left) / cols),
            pivot="middle",
            width=0.006,
        )
        figure.colorbar(shown, cax=bar, label="lean against the region [°]")
        return svg_uri(figure)
