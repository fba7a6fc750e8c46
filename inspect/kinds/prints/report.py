"""Report sections and figures of a print: colours, lobe, maps, judged quantities, and the rule."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.language import translated
from anisoscope.base.notation import percent_text, ratio_text
from anisoscope.kinds.prints.decision import PrintDecision
from anisoscope.kinds.prints.expectation import PrintExpectation
from anisoscope.kinds.prints.measurement import MeasuredPrint
from anisoscope.kinds.prints.record import (
    LENGTHS,
    MOST_SPOTS,
    RELATIVE,
    ColourRecord,
    GoldenPrintsRecord,
    PrintDetails,
    QuantityRecord,
    SpotRecord,
    print_of,
)
from anisoscope.record.schema import Record
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
    limit_picture,
    new_figure,
    new_map_figure,
    png_uri,
    svg_uri,
)
from anisoscope.report.inspection_page import Pictures, Sections
from anisoscope.report.peers import among
from anisoscope.report.rule import EXCLUDED_RULE, OPEN_RULE
from anisoscope.sim.light.colour.spaces import hexadecimal

UNSURE = 0.01
DARKEST = 1e-7
"""Radiance in 1/sr below which a channel is noise."""
USUAL_DELTA_E = 3.0


@dataclass(frozen=True, eq=False)
class PrintPictures:
    """Pictures of a print that the record does not hold.

    Attributes:
        cell_colours: one picture a pose, (cell rows, cell cols, 3) encoded sRGB, first row at the top.
        differences: (P, cell rows, cell cols) CIEDE2000 of the cells against the predicted colour.
        measured, predicted: (P, 3) encoded sRGB of the region.
        size_mm: (height, width) of the region.
        center_mm: its middle.
        local, total: (cell rows, cell cols) CIEDE2000 against the region and against the prediction, or None.
        lean_deg: (2, cell rows, cell cols) lean of the flakes toward +x and +y, or None.
        deviating: (cell rows, cell cols) cells that deviate, or None.
    """

    cell_colours: tuple[FloatArray, ...]
    differences: FloatArray
    measured: FloatArray
    predicted: FloatArray
    size_mm: tuple[float, float]
    center_mm: tuple[float, float]
    local: FloatArray | None
    total: FloatArray | None
    lean_deg: FloatArray | None
    deviating: npt.NDArray[np.bool_] | None


def print_pictures(
    expected: PrintExpectation, measured: MeasuredPrint, decision: PrintDecision
) -> PrintPictures:
    """Pictures for the report of a print: cells in the colours of the eye, and the maps."""
    eye, found = expected.eye, decision.map
    cells = np.moveaxis(measured.cells, 1, -1)
    wanted = np.stack([one.wanted for one in decision.colours])
    visible = np.maximum(cells, DARKEST)
    return PrintPictures(
        cell_colours=tuple(eye.srgb(one) for one in cells),
        differences=eye.difference(visible, np.broadcast_to(wanted[:, None, None], cells.shape)),
        measured=eye.srgb(measured.channels),
        predicted=eye.srgb(wanted),
        size_mm=measured.grid.size_mm,
        center_mm=measured.grid.center_mm,
        local=None if found is None else found.local,
        total=None if found is None else found.total,
        lean_deg=None if found is None else found.lean_deg,
        deviating=None if found is None else found.deviating,
    )


@dataclass(frozen=True)
class Patch:
    """One pose: its cells in colour and their difference as data URIs, and the two colours as hexadecimal."""

    colour: ColourRecord
    cells: str
    measured: str
    predicted: str
    difference: str


@dataclass(frozen=True)
class QuantityRow:
    """A quantity in the words of the report."""

    title: str
    value: str
    nominal: str
    deviation: str
    u: str
    limit: str
    guard: str
    ratio: str
    conforms: str
    verdict: str


@dataclass(frozen=True)
class SourceRow:
    """One source of uncertainty: its contributions as shares of the limits."""

    source: str
    kind: str
    shares: tuple[float, ...]


def print_sections(record: Record, pictures: Pictures) -> Sections:
    """The sections of the report of a print."""
    found = pictures.of_kind if isinstance(pictures.of_kind, PrintPictures) else None
    first, before = (
        (files("anisoscope.kinds.prints") / "templates" / name).read_text(encoding="utf-8")
        for name in ("inspection_print_colours.html", "inspection_print.html")
    )
    return Sections(
        rule=translated(print_rule(record)), first=first, before=before, content=print_parts(record, found)
    )


def print_parts(record: Record, pictures: PrintPictures | None) -> Mapping[str, Any]:
    """Template context of a print; empty for one that could not be judged."""
    found = print_of(record)
    if found is None:
        return {"found": None}
    fitted = [one for one in found.quantities if one.name not in ("delta_e", "curl")]
    content: dict[str, Any] = {
        "found": found,
        "patches": () if pictures is None else _patches(found.colours, pictures, _pale(found)),
        "pale_delta_e": _pale(found),
        "tilts": sorted({one.tilt_deg for one in found.colours}),
        "quantity_rows": tuple(map(quantity_row, found.quantities)),
        "sources": _sources(record, fitted),
        "print_labels": [one.title for one in fitted],
        "lobe_chart": lobe_chart(found.colours),
        "quantity_chart": quantity_chart(found.quantities),
        "print_maps": ()
        if pictures is None
        else _maps(pictures, () if found.map is None else found.map.spots),
        "most_spots": MOST_SPOTS,
        "golden_strip": None if found.golden is None else _golden_strip(found.golden),
    }
    return content


def _golden_strip(golden: GoldenPrintsRecord) -> str:
    """Strip chart of the fitted parameters among those of the reference prints, in their standard deviations."""
    names = [one.title for one in golden.fitted]
    known = np.array([np.subtract(one.golden, one.mean) / (one.s or 1.0) for one in golden.fitted]).T
    mine = [(one.measured - one.mean) / (one.s or 1.0) for one in golden.fitted]
    return among(names, known, mine, golden.words, "in their standard deviations").strip


def _pale(found: PrintDetails) -> float:
    """CIEDE2000 up to which differences are drawn pale: the limit of a cell, or that of the region."""
    if found.map is not None:
        return found.map.threshold
    return next((one.limit for one in found.quantities if one.name == "delta_e"), USUAL_DELTA_E)


def _patches(colours: tuple[ColourRecord, ...], pictures: PrintPictures, pale: float) -> tuple[Patch, ...]:
    return tuple(
        Patch(
            colours[k],
            cells_picture(pictures.cell_colours[k]),
            hexadecimal(pictures.measured[k]),
            hexadecimal(pictures.predicted[k]),
            limit_picture(pictures.differences[k] / pale),
        )
        for k in range(len(colours))
    )


def _maps(pictures: PrintPictures, spots: tuple[SpotRecord, ...]) -> tuple[tuple[str, str, str], ...]:
    """Pictures of the maps with caption and alternative text."""
    if pictures.local is None or pictures.total is None or pictures.lean_deg is None:
        return ()
    size, center = pictures.size_mm, pictures.center_mm
    return (
        (
            difference_map(pictures.local, pictures.deviating, size, center, spots),
            "Against the rest of the region: ΔE2000 of the worst pose; outlined what deviates, numbers as in the table",
            "Map of colour differences of cells against the whole region",
        ),
        (
            difference_map(pictures.total, None, size, center),
            "Against the prediction: ΔE2000 of the worst pose",
            "Map of colour differences of cells against the prediction",
        ),
        (
            lean_map(pictures.lean_deg, size, center),
            "How the flakes lean, against the whole region; an arrow that reaches the next one: the end of the scale",
            "Map of the tilt of the flakes",
        ),
    )


def quantity_row(one: QuantityRecord) -> QuantityRow:
    """A quantity as people read it: relative deviations in per cent."""
    share = one.name in RELATIVE
    signed = share or one.name in ("ratio", "skew")
    digits = {"chromaticity": 4, "ratio": 4, "skew": 4}.get(one.name, 2)

    def number(value: float) -> str:
        places = 3 if share else digits
        text = f"{round(value, places) + 0.0:.{places}f}{one.unit}"
        return text.replace("-", "−")

    def off(value: float, *, sign: bool = False) -> str:
        plus = "+" if sign and signed else ""
        rounded = round(100 * value if share else value, 2 if share else digits) + 0.0
        text = f"{rounded:{plus}.2f} %" if share else f"{rounded:{plus}.{digits}f}{one.unit}"
        return text.replace("-", "−")

    limit = f"±{100 * one.limit:g} %" if share else f"{'±' if signed else '≤ '}{one.limit:g}{one.unit}"
    ratio = "–" if one.u == 0.0 else ratio_text(one.limit / (2.0 * one.u))
    return QuantityRow(
        one.title.replace("-", "−") if one.name == "delta_e" else one.title,
        number(one.value),
        number(one.nominal),
        off(one.deviation, sign=True),
        off(one.u),
        limit,
        off(one.guard),
        ratio,
        percent_text(one.conformance_probability),
        one.verdict,
    )


def _sources(record: Record, fitted: list[QuantityRecord]) -> tuple[SourceRow, ...]:
    """The budget in shares of the limits; what is below a hundredth everywhere is left to the record."""
    limits = [one.limit for one in fitted]
    rows = (
        SourceRow(
            row.source,
            row.kind,
            tuple(u / limit for u, limit in zip(row.contributions, limits, strict=True)),
        )
        for row in record.budget
    )
    return tuple(row for row in rows if max(row.shares) >= UNSURE)


WITHIN_RULE = "every quantity lies within its limit by more than its guard band (ISO 14253-1)"


def print_rule(record: Record) -> str:
    """The rule that decided, in one sentence."""
    found = print_of(record)
    if record.verdict == "INVALID" or found is None:
        return "what makes a measurement unfit goes before all that was measured, and never fails a print"
    criteria = [one.title for one in found.quantities if one.verdict == record.verdict]
    if found.map is not None and found.map.verdict == record.verdict:
        criteria.append("the deviating area")
    rule = record.recipe["decision"]
    if record.verdict == "FAIL":
        if found.lobe is None:
            return "no lobe is left, and what the pictures show is explained by ink that is missing"
        if rule["deviation"] == "fail" and (record.p_value or 0.0) < rule["alpha"]:
            criteria.append("all channels together")
        return f"outside the limit by more than the guard band (ISO 14253-1): {', '.join(criteria)}"
    if record.verdict == "INCONCLUSIVE":
        if not criteria:
            return OPEN_RULE
        return f"no limit is broken for certain, but within a guard band of it (ISO 14253-1): {', '.join(criteria)}"
    excluded = found.exclusions and all(one.excluded for one in found.exclusions)
    return EXCLUDED_RULE if excluded else WITHIN_RULE


SHADES = (BLUE, ORANGE, GREEN, RED, MUTED, INK)
LEGEND_ROWS = 6
MARKS = ("o", "s", "^", "D", "v", "P")
SMALLEST_MARK = 3
SMALL_LEAN_DEG = 0.2
SHORTEST = 0.02
"""Half width of the bar of a quantity without uncertainty, so that it is visible."""


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
        image = axes.imshow(delta_e, cmap="cividis", vmin=0.0, vmax=top, extent=extent)
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
        figure.colorbar(image, cax=bar, label="ΔE2000")
        return svg_uri(figure)


def _extent(
    size_mm: tuple[float, float], center_mm: tuple[float, float]
) -> tuple[float, float, float, float]:
    (height, width), (x, y) = size_mm, center_mm
    return (x - width / 2, x + width / 2, y - height / 2, y + height / 2)


def lean_map(
    lean_deg: FloatArray, size_mm: tuple[float, float], center_mm: tuple[float, float] = (0.0, 0.0)
) -> str:
    """Lean of the flakes in every cell against the whole region: size in colour, direction and size as arrows.

    An arrow that reaches to the next one leans as far as the scale goes, so that noise does not look like a lean.
    """
    rows, cols = lean_deg.shape[1:]
    with new_map_figure(size_mm) as (figure, axes, bar):
        extent = left, right, bottom, top = _extent(size_mm, center_mm)
        size = np.hypot(*lean_deg)
        most = max(float(size.max()), SMALL_LEAN_DEG)
        image = axes.imshow(size, cmap="cividis", vmin=0.0, vmax=most, extent=extent)
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
        figure.colorbar(image, cax=bar, label="lean against the region [°]")
        return svg_uri(figure)
