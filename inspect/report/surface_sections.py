"""What the report shows of a surface that reflects: contrasts, maps, comparisons, golden parts, and the budget."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from anisoscope.base.cause_words import CauseWords
from anisoscope.base.notation import contrast_name, true_minus
from anisoscope.record.schema import BudgetRecord, Record, RegionRecord
from anisoscope.record.surface_details import SurfaceDetails, surface_of
from anisoscope.report import figures
from anisoscope.report.conclusion import named_regions
from anisoscope.report.inspection_page import Pictures, Sections
from anisoscope.report.page import template_text
from anisoscope.report.peers import Lot, Peers, among
from anisoscope.report.rule import NAMES, UNITS, deviation_decides, level_of, rule_of
from anisoscope.report.tilt_sections import tilt_parts
from anisoscope.report.wording import labels_of

if TYPE_CHECKING:
    from anisoscope.imaging.angle_map import AngleMap

MAX_REGIONS = 12
TARGET_RATIO = 4.0
SMALL_SHARE = 0.01
SURFACES = {"design": "ideal design", "height_map": "height map"}


def surface_sections(record: Record, pictures: Pictures, words: Mapping[str, CauseWords]) -> Sections:
    """The sections of the report of a part whose contrasts were judged; ``words`` of its causes name regions."""
    found = surface_of(record)
    unit = UNITS.get(found.contrasts[0].kind, "1") if found.contrasts else "1"
    large, small = _budget(record, found)
    regions = named_regions(record, words)[:MAX_REGIONS]
    content = {
        "found": found,
        "deviation_decides": deviation_decides(record),
        "level": level_of(record),
        "kind": NAMES.get(found.contrasts[0].kind, "") if found.contrasts else "",
        "surfaces": SURFACES,
        "regions": regions,
        "unlisted": len(found.regions) - len(regions),
        "narrow": [c for c in found.contrasts if c.tolerance_ratio and c.tolerance_ratio < TARGET_RATIO],
        "budget_rows": large,
        "small_budget": small,
        "budget_top": max((max(row.contributions, default=0.0) for row in record.budget), default=0.0),
        "golden": _golden(record, found),
        "excluded_by": _excluded_by(found),
        **_maps(record, found, pictures, [one for one, _ in regions]),
        "facets": facet_parts(pictures.facets, record),
        "lacking": found.angles_lacking,
        **tilt_parts(record),
    }
    return Sections(
        rule=rule_of(record),
        reasons=(("Design and height map", found.reading),) if found.reading else (),
        first=template_text("inspection_surface_map.html"),
        before=template_text("inspection_surface.html"),
        after=template_text("inspection_surface_causes.html"),
        budget=template_text("inspection_surface_budget.html"),
        fitted_too=" and to the share of the area that deviates" if found.area else "",
        lot_peers=_lot_peers(record, found, pictures.lot),
        unit=unit,
        content=content,
    )


def _excluded_by(found: SurfaceDetails) -> str:
    """Reference of the limits of the named defects, in a sentence."""
    if found.golden is not None and found.golden.test == "predictive":
        size = 1.0 if found.golden.size is None else found.golden.size
        return (
            f"Against the {found.golden.words}: their scatter is {size:.2g} times the stated one (variance)."
        )
    return "Against the prediction; further poses exclude smaller sizes, and so do golden parts of ridges."


def _maps(
    record: Record, found: SurfaceDetails, pictures: Pictures, regions: Sequence[RegionRecord]
) -> dict[str, Any]:
    labels = labels_of(record)
    maps: dict[str, Any] = {"labels": labels, "maps": [], "chart": None, "deviation_map": None}
    if pictures.deviation is not None:
        places = [_on_map(record, (region.x, region.y)) for region in regions]
        maps["deviation_map"] = figures.deviation_map(
            pictures.deviation, pictures.deviating, places, pictures.size_mm, _frame(record)
        )
    if pictures.ratios is not None:
        maps["maps"] = [
            (label, figures.contrast_map(ratio, pictures.deviating, pictures.size_mm, _frame(record)))
            for label, ratio in zip(labels, pictures.ratios, strict=True)
        ]
    if found.contrasts:
        maps["chart"] = figures.contrast_chart(
            labels,
            [c.measured - c.predicted for c in found.contrasts],
            [c.u for c in found.contrasts],
            [c.tolerance for c in found.contrasts],
            NAMES[found.contrasts[0].kind],
        )
    return maps


MAX_RIDGES = 6


def facet_parts(facets: "AngleMap | None", record: Record) -> dict[str, Any] | None:
    """The lean of the facets as `angle_map.html` shows it: pictures, the ridges farthest off, and the numbers."""
    if facets is None:
        return None
    frame, nominal_deg = _frame(record), _design_angle(record)
    place = (facets.across_mm, facets.along_mm)
    maps = [
        (
            "Lean of the facets across the ridges",
            figures.lean_map(facets.angle_deg, *place, "across [°]", facets.unseen, frame),
        )
    ]
    if facets.along_deg is not None:
        maps.append(
            (
                "Lean of the facets along the ridges",
                figures.lean_map(facets.along_deg, *place, "along [°]", facets.unseen, frame),
            )
        )
    maps.append(
        ("Lean across the ridges, cell by cell", figures.lean_histogram(facets.angle_deg, nominal_deg))
    )
    ridges = facets.farthest
    return {
        "found": facets.record(),
        "nominal": nominal_deg,
        "maps": maps,
        "ridges": ridges[:MAX_RIDGES],
        "unlisted": max(len(ridges) - MAX_RIDGES, 0),
        "form": surface_of(record).form,
    }


def _design_angle(record: Record) -> float | None:
    design = record.recipe.get("surface", {}).get("design")
    return None if design is None else float(design["ridge_angle_deg"])


def _budget(record: Record, found: SurfaceDetails) -> tuple[list[BudgetRecord], list[BudgetRecord]]:
    """Sources that make up a hundredth of some variance, and the others."""
    variance = np.array([contrast.u**2 for contrast in found.contrasts])
    large: list[BudgetRecord] = []
    small: list[BudgetRecord] = []
    for row in record.budget:
        counts = bool(np.any(np.square(row.contributions) >= SMALL_SHARE * variance))
        (large if counts else small).append(row)
    return large, small


def _golden(record: Record, found: SurfaceDetails) -> Peers | None:
    if found.golden is None:
        return None
    first = record.poses[0].stage_deg
    labels = [true_minus(contrast_name(p.stage_deg, first, p.tilt_deg)) for p in record.poses[1:]]
    known = np.array(found.golden.contrasts)
    return among(labels, known, found.golden.measured, found.golden.words, "ln ratio [1]")


def _lot_peers(record: Record, found: SurfaceDetails, lot: Lot | None) -> Peers | None:
    """The part among the parts of its lot that were measured alike."""
    count = len(found.contrasts)
    known = [part.contrasts for part in lot.parts if len(part.contrasts) == count] if lot else []
    if not known or not count:
        return None
    kind, mine = found.contrasts[0].kind, [c.measured for c in found.contrasts]
    return among(
        labels_of(record), np.array(known), mine, "parts of the lot", f"{NAMES[kind]} [{UNITS[kind]}]"
    )


def _on_map(record: Record, place_mm: tuple[float, float]) -> tuple[float, float]:
    """Place of the part at 0° along the axes of the map, whose ridges are upright; both from the rotation axis."""
    (x, y), turn = place_mm, np.radians(record.recipe["poses"]["facet_azimuth_deg"])
    return float(np.cos(turn) * x + np.sin(turn) * y), float(np.cos(turn) * y - np.sin(turn) * x)


def _frame(record: Record) -> figures.MapFrame:
    """Position and axes of the maps."""
    middle = _on_map(record, record.recipe["region"]["center_mm"])
    if record.recipe["poses"]["facet_azimuth_deg"] == 0.0:
        return figures.MapFrame(middle)
    return figures.MapFrame(middle, "across the ridges", "along the ridges")
