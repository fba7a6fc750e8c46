"""Page of two registered height maps: both maps, their difference, its uncertainty, wear, ridges, a line.

Of a tool and its part the degree of replication besides: place by place in colours, ridge by ridge as a table; and
where a recipe says under which light, what all that does to the predicted contrasts.
"""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_bytes
from anisoscope.profiles.comparison import Comparison
from anisoscope.profiles.editing.interpolation import Interpolated
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.level import level
from anisoscope.profiles.metrology.quantity import Quantity, as_text
from anisoscope.report.figures import BLUE, GREEN, INK, MARK, ORANGE, new_figure, new_map_figure, svg_uri
from anisoscope.report.page import write_page
from anisoscope.report.profile_page import map_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from anisoscope.prediction.contrast_change import ContrastCauses

PICTURE_POINTS = 900
LINE_POINTS = 2000
WEAR_COLUMNS = (
    ("height A [µm]", "height_a_um"),
    ("height B [µm]", "height_b_um"),
    ("crest, change [µm]", "crest_change_um"),
    ("height, change [µm]", "height_change_um"),
    ("edge radius A [µm]", "radius_a_um"),
    ("edge radius B [µm]", "radius_b_um"),
    ("edge radius, change [µm]", "radius_change_um"),
    ("section lost [µm²]", "lost_area_um2"),
)
REPLICATION_COLUMNS = (
    ("relief B/A", "relief"),
    ("height A [µm]", "height_a_um"),
    ("height B [µm]", "height_b_um"),
    ("ridge angle A [°]", "angle_a_deg"),
    ("ridge angle B [°]", "angle_b_deg"),
    ("ridge angle, change [°]", "angle_change_deg"),
    ("edge radius A [µm]", "radius_a_um"),
    ("edge radius B [µm]", "radius_b_um"),
)
Line = tuple[float, float, float, float]


def _draw_map(
    axes: "Axes", bar: "Axes", heights: FloatArray, found: Comparison, label: str, line: Line, *, signed: bool
) -> None:
    """A map in false colours, missing points grey, and the line; where signed 0 in the middle, and outlines."""
    surface = found.first
    height, width = (n * 1e-3 for n in surface.extent_um)
    step = max(1, -(-max(surface.shape) // PICTURE_POINTS))
    shown = heights[::step, ::step]
    axes.set_facecolor("#9aa5ae")
    reach = max(float(np.nanpercentile(np.abs(shown), 99.5)), 1e-6)
    image = axes.imshow(
        np.ma.masked_invalid(shown), origin="lower", cmap="PuOr" if signed else "viridis",
        extent=(0.0, width, 0.0, height), vmin=-reach if signed else 0.0, vmax=reach, interpolation="nearest",
    )  # fmt: skip
    for sign, colour in ((-1, MARK), (1, GREEN)) if signed else ():
        there = found.changed[::step, ::step] == sign
        if there.any():
            x, y = (np.arange(n) * step * pixel * 1e-3 for n, pixel in zip(
                there.shape[::-1], (surface.pixel_x_um, surface.pixel_y_um), strict=True
            ))  # fmt: skip
            axes.contour(x, y, there.astype(np.float64), levels=[0.5], colors=[colour], linewidths=0.6)
    axes.plot([1e-3 * line[0], 1e-3 * line[2]], [1e-3 * line[1], 1e-3 * line[3]], color=INK, linewidth=1.0)
    axes.set_xlim(0.0, width)
    axes.set_ylim(0.0, height)
    axes.figure.colorbar(image, cax=bar, label=label)


def difference_picture(
    heights: FloatArray, found: Comparison, label: str, line: Line, *, signed: bool
) -> str:
    """The difference (signed) or its uncertainty, with the line and what was lost and gained; as a data URI."""
    height, width = (n * 1e-3 for n in found.first.extent_um)
    with new_map_figure((height, width)) as (figure, axes, bar):
        _draw_map(axes, bar, heights, found, label, line, signed=signed)
        return svg_uri(figure)


def ridge_table(
    found: Comparison, contrasts: "Sequence[ContrastCauses]" = ()
) -> tuple[list[str], list[list[str]]]:
    """Columns and rows of the table of ridges: wear, or replication of a tool; changes of ln ratios last."""
    columns = REPLICATION_COLUMNS if found.mirrored else WEAR_COLUMNS
    pairs = [one for one in contrasts if one.ridges]
    heads = [f"ln {one.from_deg:g}°/{one.to_deg:g}°, tilt {one.tilt_deg:g}°, change" for one in pairs]
    rows = []
    for ridge in found.ridges:
        cells = [
            " ± ".join(cell for cell in as_text(getattr(ridge, key)) if cell != "–") or "–" for _, key in columns
        ]  # fmt: skip
        changes = [f"{one.ridges[ridge.number]:+.4f}" for one in pairs]
        rows.append([str(ridge.number), f"{ridge.position_um:.1f}", *cells, *changes])
    return ["ridge", "position [µm]", *(text for text, _ in columns), *heads], rows


def contrast_table(contrasts: "Sequence[ContrastCauses]") -> tuple[list[str], list[list[str]]]:
    """Columns and rows of the table of contrasts and what changes them."""
    causes = list(contrasts[0].causes) if contrasts else []
    rows = []
    for one in contrasts:
        cells = [f"{one.from_deg:g}°/{one.to_deg:g}°", f"{one.tilt_deg:g}"]
        cells += [f"{value:+.4f}" for value in (one.first, one.second, one.second - one.first)]
        for name in causes:
            value, u = as_text(one.causes[name])
            cells.append(value if u == "–" else f"{value} ± {u}")
        rows.append([*cells, "–" if one.rest is None else f"{one.rest:+.4f}"])
    heads = ["ln L/L", "tilt [°]", "A", "B", "change", *(f"by {name}" for name in causes), "by the rest"]
    return heads, rows


def relief_picture(found: Comparison) -> str:
    """Factor of the heights of B on those of A, place by place, as a data URI; grey where it is not known."""
    height, width = (n * 1e-3 for n in found.first.extent_um)
    step = max(1, -(-max(found.relief.shape) // PICTURE_POINTS))
    shown = found.relief[::step, ::step]
    far = np.abs(shown[np.isfinite(shown)] - 1.0)
    reach = max(0.01, float(np.percentile(far, 98.0)) if far.size else 0.0)
    with new_map_figure((height, width)) as (figure, axes, bar):
        axes.set_facecolor("#9aa5ae")
        image = axes.imshow(
            np.ma.masked_invalid(shown), origin="lower", cmap="PuOr", extent=(0.0, width, 0.0, height),
            vmin=1.0 - reach, vmax=1.0 + reach, interpolation="nearest",
        )  # fmt: skip
        figure.colorbar(image, cax=bar, label="relief B/A")
        return svg_uri(figure)


def default_line(surface: HeightMap) -> Line:
    """A line along x through the middle of the field."""
    rows, cols = surface.shape
    middle = 0.5 * (rows - 1) * surface.pixel_y_um
    return 0.0, middle, (cols - 1) * surface.pixel_x_um, middle


def _along(surface: HeightMap, line: Line) -> tuple[FloatArray, FloatArray]:
    length = float(np.hypot(line[2] - line[0], line[3] - line[1]))
    pixel = min(surface.pixel_x_um, surface.pixel_y_um)
    share = np.linspace(0.0, 1.0, min(LINE_POINTS, max(2, int(length / pixel) + 1)))
    heights = Interpolated(surface).at(
        line[1] + share * (line[3] - line[1]), line[0] + share * (line[2] - line[0])
    )
    return share * length, heights


def _draw_line(upper: "Axes", lower: "Axes", found: Comparison, line: Line) -> None:
    """Both maps along a line and, below, their difference with the interval of 95 %."""
    tilt = found.first.with_height(found.first.height_um - level(found.first).map.height_um)
    for surface, colour, name in ((found.first, BLUE, "A"), (found.second, ORANGE, "B, registered")):
        x, z = _along(surface.with_height(surface.height_um - tilt.height_um), line)
        upper.plot(x, z, color=colour, linewidth=1.1, label=name)
    x, z = _along(found.difference, line)
    _, u = _along(found.difference.with_height(found.u_um), line)
    lower.fill_between(x, z - 1.96 * u, z + 1.96 * u, color=BLUE, alpha=0.25, linewidth=0)
    lower.plot(x, z, color=BLUE, linewidth=1.0)
    upper.set_ylabel("height [µm]")
    upper.legend(frameon=False, fontsize=8)
    lower.set_ylabel("B − A [µm]")
    lower.set_xlabel(
        f"along the line from ({line[0]:.4g}, {line[1]:.4g}) to ({line[2]:.4g}, {line[3]:.4g}) µm [µm]"
    )
    for one in (upper, lower):
        one.grid()
        one.set_xlim(0.0, float(x[-1]))


def line_chart(found: Comparison, line: Line) -> str:
    """Both maps and, below, their difference with the interval of 95 %, along a line; as a data URI."""
    with new_figure(9.0, 4.4) as (figure, axes):
        axes.remove()
        grid = figure.add_gridspec(2, 1, height_ratios=(3, 2))
        upper = figure.add_subplot(grid[0])
        _draw_line(upper, figure.add_subplot(grid[1], sharex=upper), found, line)
        return svg_uri(figure)


def write_comparison_picture(found: Comparison, path: Path, line: Line | None = None) -> None:
    """Write difference map and line as one picture, atomically.

    Args:
        found: the comparison.
        path: *.png or *.svg.
        line: as for :func:`write_comparison_page`.

    Raises:
        RecordError: the file cannot be written.
    """
    chosen = default_line(found.first) if line is None else line
    high, wide = found.first.extent_um
    side = 9.0 * min(1.0, max(0.25, high / wide))
    with new_figure(9.0, side + 3.4) as (figure, axes):
        axes.remove()
        grid = figure.add_gridspec(3, 2, height_ratios=(side, 2.0, 1.4), width_ratios=(30, 1))
        heights = found.difference.height_um
        main = figure.add_subplot(grid[0, 0])
        _draw_map(main, figure.add_subplot(grid[0, 1]), heights, found, "B − A [µm]", chosen, signed=True)
        main.set(xlabel="x [mm]", ylabel="y [mm]")
        upper = figure.add_subplot(grid[1, :])
        _draw_line(upper, figure.add_subplot(grid[2, :], sharex=upper), found, chosen)
        kind, buffer = path.suffix.lower()[1:], io.BytesIO()
        figure.savefig(
            buffer, format=kind, dpi=100, metadata={"Date": None} if kind == "svg" else {"Software": None}
        )
    write_bytes(path, buffer.getvalue())


def comparison_numbers(found: Comparison) -> list[tuple[str, str, str, str]]:
    """Name, value, standard uncertainty and unit of everything that is measured once."""

    def row(name: str, quantity: Quantity, unit: str) -> tuple[str, str, str, str]:
        value, u = as_text(quantity)
        return name, value, u, unit

    placed, lost, gained = found.placed, found.lost, found.gained
    return [
        row("shift along x", Quantity(placed.x_um, placed.u_x_um), "µm"),
        row("shift along y", Quantity(placed.y_um, placed.u_y_um), "µm"),
        row("turned counter-clockwise", Quantity(placed.angle_deg, placed.u_angle_deg), "°"),
        row("scale B/A (check)", Quantity(placed.scale, placed.u_scale), "1"),
        ("overlap", f"{100.0 * placed.overlap:.3g}", "–", "%"),
        ("residual of the registration", f"{placed.residual_um:.3g}", "–", "µm"),
        row("volume lost", lost.volume_um3, "µm³"),
        ("area of the loss", f"{lost.area_um2:.5g}", "–", "µm²"),
        ("greatest loss", f"{lost.depth_um:.4g}", "–", "µm"),
        row("volume gained", gained.volume_um3, "µm³"),
        row("sum of all differences", found.net_um3, "µm³"),
        row("relief of A that B has", found.replication.relief, "1"),
        row("ridge height B/A", found.replication.height, "1"),
        *(
            [row("shrinkage of B", found.replication.shrinkage, "1")]
            if found.replication.shrinkage.known
            else []
        ),
    ]


def comparison_answer(found: Comparison) -> str:
    """The result in one sentence, ± with a coverage factor of 2: relief, volumes lost and gained."""

    def volume(quantity: Quantity, word: str) -> str:
        value, reach = quantity.value or 0.0, 2.0 * (quantity.u or 0.0)
        if abs(value) <= reach or value == 0.0:
            return f"no volume {word}" + (f" (± {reach:.2g} µm³)" if reach else "")
        digits = 1 - int(np.floor(np.log10(reach or abs(value))))
        shown = (f"{round(number, digits):,.{max(digits, 0)}f}" for number in (value, reach))
        return f"{' ± '.join(shown).replace(',', chr(0x2009))} µm³ {word}"

    height, said = found.replication.height, "B against A"
    if height.value is not None and height.u is not None:
        change, reach = 100.0 * (height.value - 1.0), 200.0 * height.u
        lower = f"{abs(change):.1f} ± {reach:.1f} % {'lower' if change < 0.0 else 'higher'}"
        said += f": ridges {lower}" if abs(change) > reach else f": ridges as high (± {reach:.1f} %)"
    else:
        said += ": no ridges in common"
    volumes = f"{volume(found.lost.volume_um3, 'lost')}, {volume(found.gained.volume_um3, 'gained')}"
    return f"{said}; {volumes} (k = 2)."


def comparison_notes(found: Comparison) -> list[str]:
    """Notes on the registration."""
    placed, notes = found.placed, []
    if found.mirrored:
        notes.append("A, the tool, was negated and mirrored along x first; what is lost was not filled")
    if found.replication.shrinkage.value is not None:
        short = 100.0 * found.replication.shrinkage.value
        size = "smaller" if short > 0.0 else "larger"
        notes.append(f"B is {size} by {abs(short):.3g} %, and was stretched to the size of A")
    if placed.u_x_um is None or placed.u_y_um is None:
        notes.append("the shift along the ridges is not determined: they carry nothing to tell it by")
    if placed.ambiguity > 0.9:
        notes.append(
            "the maps agree almost as well at another place, such as whole pitches away; the largest overlap was taken"
        )
    elif not placed.scale_agrees:
        notes.append(
            f"the scales differ by {100.0 * (placed.scale - 1.0):.3g} %: check the pixel sizes; B was not stretched"
        )
    for name, volume in (("lost", found.lost), ("gained", found.gained)):
        if volume.filled_share > 0.01:
            notes.append(
                f"{100.0 * volume.filled_share:.2g} % of the volume {name} lies in gaps filled from around"
            )
    return notes


def write_comparison_page(
    found: Comparison,
    names: tuple[str, str],
    path: Path,
    line: Line | None = None,
    contrasts: "Sequence[ContrastCauses]" = (),
) -> None:
    """Write the page, atomically.

    Args:
        found: the comparison.
        names: how the page calls the maps A and B.
        path: file to write.
        line: x0, y0, x1, y1 in µm from the first point of A; a row through the middle where it is not given.
        contrasts: predicted contrasts of both and what changes them.

    Raises:
        RecordError: the file cannot be written.
    """
    chosen = default_line(found.first) if line is None else line
    tilt = found.first.height_um - level(found.first).map.height_um
    content: dict[str, Any] = {
        "names": names,
        "found": found,
        "pictures": [
            (map_picture(one.with_height(one.height_um - tilt)), text)
            for one, text in (
                (found.first, f"A: {names[0]}, levelled"),
                (found.second, f"B: {names[1]}, registered"),
            )
        ],
        "difference": difference_picture(
            found.difference.height_um, found, "B − A [µm]", chosen, signed=True
        ),
        "uncertainty": difference_picture(
            found.u_um, found, "standard uncertainty [µm]", chosen, signed=False
        ),
        "line_chart": line_chart(found, chosen),
        "numbers": comparison_numbers(found),
        "notes": comparison_notes(found),
        "answer": comparison_answer(found),
        "ridges": ridge_table(found, contrasts),
        "contrasts": contrast_table(contrasts) if contrasts else None,
        "relief": relief_picture(found) if found.mirrored else None,
    }
    write_page(path, "comparison.html", content)
