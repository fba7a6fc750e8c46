"""What the report of an inspection shows of a print: colours, lobe, maps, what was judged, and by which rule."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.kinds.prints import report_figures
from anisoscope.kinds.prints.decision import PrintDecision
from anisoscope.kinds.prints.expectation import PrintExpectation
from anisoscope.kinds.prints.measurement import MeasuredPrint
from anisoscope.kinds.prints.record import (
    MOST_SPOTS,
    RELATIVE,
    ColourRecord,
    GoldenPrintsRecord,
    QuantityRecord,
    SpotRecord,
    print_of,
)
from anisoscope.record.schema import Record
from anisoscope.report.inspection_page import Pictures, Sections
from anisoscope.report.peers import among
from anisoscope.sim.light.colour.spaces import hexadecimal

UNSURE = 0.01


@dataclass(frozen=True, eq=False)
class PrintPictures:
    """Pictures of a print beside its record.

    Attributes:
        seen: one picture a pose, (cell rows, cell cols, 3) encoded sRGB, first row at the top.
        measured, predicted: (P, 3) encoded sRGB of the region.
        size_mm: (height, width) of the region.
        center_mm: its middle.
        local, total: (cell rows, cell cols) CIEDE2000 against the region and against the prediction, or None.
        lean_deg: (2, cell rows, cell cols) lean of the flakes toward +x and +y, or None.
        deviating: (cell rows, cell cols) cells that deviate, or None.
    """

    seen: tuple[FloatArray, ...]
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
    """What the report shows of a print: cells in the colours of the eye, and the maps."""
    eye, found = expected.eye, decision.map
    cells = np.moveaxis(measured.cells, 1, -1)
    return PrintPictures(
        seen=tuple(eye.srgb(one) for one in cells),
        measured=eye.srgb(measured.channels),
        predicted=eye.srgb(np.stack([one.wanted for one in decision.colours])),
        size_mm=measured.grid.size_mm,
        center_mm=measured.grid.center_mm,
        local=None if found is None else found.local,
        total=None if found is None else found.total,
        lean_deg=None if found is None else found.lean_deg,
        deviating=None if found is None else found.deviating,
    )


@dataclass(frozen=True)
class Patch:
    """One pose in colour: its cells, and the two colours as hexadecimal."""

    colour: ColourRecord
    cells: str
    measured: str
    predicted: str


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
    shown = pictures.of_kind if isinstance(pictures.of_kind, PrintPictures) else None
    source = (files("anisoscope.kinds.prints") / "templates" / "inspection_print.html").read_text(
        encoding="utf-8"
    )
    return Sections(rule=print_rule(record), before=source, content=print_parts(record, shown))


def print_parts(record: Record, pictures: PrintPictures | None) -> Mapping[str, Any]:
    """What the template shows of a print; nothing of one that could not be judged."""
    found = print_of(record)
    if found is None:
        return {"found": None}
    told = [one for one in found.quantities if one.name not in ("delta_e", "curl")]
    content: dict[str, Any] = {
        "found": found,
        "patches": () if pictures is None else _patches(found.colours, pictures),
        "tilts": sorted({one.tilt_deg for one in found.colours}),
        "quantity_rows": tuple(map(quantity_row, found.quantities)),
        "sources": _sources(record, told),
        "print_labels": [one.title for one in told],
        "lobe_chart": report_figures.lobe_chart(found.colours),
        "quantity_chart": report_figures.quantity_chart(found.quantities),
        "print_maps": ()
        if pictures is None
        else _maps(pictures, () if found.map is None else found.map.spots),
        "most_spots": MOST_SPOTS,
        "golden_strip": None if found.golden is None else _golden_strip(found.golden),
    }
    return content


def _golden_strip(golden: GoldenPrintsRecord) -> str:
    """The fitted parameters beside those of the golden prints, each in their standard deviations."""
    names = [one.title for one in golden.fitted]
    known = np.array([np.subtract(one.golden, one.mean) / (one.s or 1.0) for one in golden.fitted]).T
    mine = [(one.measured - one.mean) / (one.s or 1.0) for one in golden.fitted]
    return among(names, known, mine, "golden prints", "in their standard deviations").strip


def _patches(colours: tuple[ColourRecord, ...], pictures: PrintPictures) -> tuple[Patch, ...]:
    rows = zip(colours, pictures.seen, pictures.measured, pictures.predicted, strict=True)
    return tuple(
        Patch(one, report_figures.cells_picture(cells), hexadecimal(seen), hexadecimal(wanted))
        for one, cells, seen, wanted in rows
    )


def _maps(pictures: PrintPictures, spots: tuple[SpotRecord, ...]) -> tuple[tuple[str, str, str], ...]:
    """Pictures of the maps with caption and alternative text."""
    if pictures.local is None or pictures.total is None or pictures.lean_deg is None:
        return ()
    size, center = pictures.size_mm, pictures.center_mm
    return (
        (
            report_figures.difference_map(pictures.local, pictures.deviating, size, center, spots),
            "Against the rest of the region: ΔE2000 of the worst pose; outlined what deviates, numbers as in the table",
            "Map of colour differences of cells against the whole region",
        ),
        (
            report_figures.difference_map(pictures.total, None, size, center),
            "Against the prediction: ΔE2000 of the worst pose",
            "Map of colour differences of cells against the prediction",
        ),
        (
            report_figures.lean_map(pictures.lean_deg, size, center),
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
    ratio = "–" if one.u == 0.0 else f"{one.limit / (2.0 * one.u):.1f}"
    return QuantityRow(
        one.title.replace("-", "−") if one.name == "delta_e" else one.title,
        number(one.value),
        number(one.nominal),
        off(one.deviation, sign=True),
        off(one.u),
        limit,
        off(one.guard),
        ratio,
        f"{100 * one.conformance_probability:.1f} %",
        one.verdict,
    )


def _sources(record: Record, told: list[QuantityRecord]) -> tuple[SourceRow, ...]:
    """The budget in shares of the limits; what is below a hundredth everywhere is left to the record."""
    limits = [one.limit for one in told]
    rows = (
        SourceRow(
            row.source,
            row.kind,
            tuple(u / limit for u, limit in zip(row.contributions, limits, strict=True)),
        )
        for row in record.budget
    )
    return tuple(row for row in rows if max(row.shares) >= UNSURE)


def print_rule(record: Record) -> str:
    """The rule that decided, in one sentence."""
    found = print_of(record)
    if record.verdict == "INVALID" or found is None:
        return "what makes a measurement unfit goes before all that was measured, and never fails a print"
    saying = [one.title for one in found.quantities if one.verdict == record.verdict]
    if found.map is not None and found.map.verdict == record.verdict:
        saying.append("the deviating area")
    rule = record.recipe["decision"]
    if record.verdict == "FAIL":
        if found.lobe is None:
            return "no lobe is left, and what the pictures show is explained by ink that is missing"
        if rule["deviation"] == "fail" and (record.p_value or 0.0) < rule["alpha"]:
            saying.append("all channels together")
        return f"outside the limit by more than the guard band (ISO 14253-1): {', '.join(saying)}"
    if record.verdict == "INCONCLUSIVE":
        return f"no limit is broken for certain, but within a guard band of it (ISO 14253-1): {', '.join(saying)}"
    return "every quantity lies within its limit by more than its guard band (ISO 14253-1)"
