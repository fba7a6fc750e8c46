"""The HTML report of one inspection: one self-contained file that opens offline and prints to A4."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.calibration.record import CalibrationRecord, Kind
from anisoscope.kinds.prints.report_sections import PrintPictures, print_parts, print_rule
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.record.schema import BudgetRecord, CauseRecord, Record
from anisoscope.report import figures
from anisoscope.report.page import ready_template, write_page
from anisoscope.report.peers import Lot, Peers, among
from anisoscope.report.provenance import calibrations_of, files_of, groups_of
from anisoscope.report.rule import NAMES, PRECEDENCE, UNITS, deviation_decides, level_of, rule_of
from anisoscope.report.surface_view import Picture3D, SurfacePictures, SurfaceView, flat_drawings, viewer_of
from anisoscope.report.tilt_sections import tilt_parts
from anisoscope.report.wording import cause_range, cause_text, contrast_name, filters, labels_of

Image = npt.NDArray[np.float32]

REPORT_NAME = "report.html"
TEMPLATE = "inspection.html"
MAX_REGIONS = 12
WANTED_RATIO = 4.0
SMALL_SHARE = 0.01
SURFACES = {"design": "ideal design", "height_map": "height map"}
MEANING = {
    "PASS": "The part is as predicted, within the tolerance.",
    "FAIL": "The part deviates too much from what it should be.",
    "INCONCLUSIVE": "The deviation is too close to a limit to decide.",
    "INVALID": "The measurement is unfit to judge the part.",
}


@dataclass(frozen=True, eq=False)
class Pictures:
    """What the report shows beside the record; all may be missing in an INVALID inspection.

    Attributes:
        aligned: one picture a pose on the sample's raster, radiance in 1/sr.
        size_mm: (height, width) of the region.
        ratios: (pairs, cell rows, cell cols) ln ratio of the contrast map.
        deviating: (cell rows, cell cols) cells that deviate.
        deviation: (cell rows, cell cols) ln ratio by which a cell is off.
        surface: the height map of the prediction, levelled.
        raw: pictures as photographed, where they could not be judged.
        calibrations: records of the rig's calibrations, by kind.
        lot: parts of the same lot that were inspected before, or None.
        print: the colours of a print, or None.
    """

    aligned: tuple[Image, ...] = ()
    size_mm: tuple[float, float] = (1.0, 1.0)
    ratios: FloatArray | None = None
    deviating: npt.NDArray[np.bool_] | None = None
    surface: HeightMap | None = None
    deviation: FloatArray | None = None
    raw: tuple[tuple[str, Image], ...] = field(default=())
    calibrations: Mapping[Kind, CalibrationRecord] = field(default_factory=dict)
    lot: Lot | None = None
    print: PrintPictures | None = None


def start_renderer(surface: HeightMap | None) -> SurfaceView | None:
    """Begin drawing a height map; the report collects the pictures at the end.

    The template is made ready beside it, so that little is left to do after the verdict.
    """
    if surface is None:
        return None
    return SurfaceView(surface, lambda: ready_template(TEMPLATE, filters()))


def write_report(record: Record, pictures: Pictures, folder: Path, view: Picture3D | None = None) -> Path:
    """Write ``report.html`` into an inspection folder, all or nothing.

    Args:
        record: the inspection.
        pictures: what to show.
        folder: the inspection folder.
        view: the height map in 3-D, or None.

    Raises:
        RecordError: the folder cannot be written.
    """
    path = folder / REPORT_NAME
    write_page(path, TEMPLATE, _content(record, pictures, folder, view), filters())
    return path


def _content(record: Record, pictures: Pictures, folder: Path, view: Picture3D | None) -> dict[str, Any]:
    large, small = _budget(record)
    return {
        "record": record,
        "meaning": MEANING[record.verdict],
        "rule_text": rule_of(record) if record.print is None else print_rule(record),
        "precedence": PRECEDENCE,
        "rule": record.recipe["decision"],
        "deviation_decides": deviation_decides(record),
        "level": level_of(record),
        "kind": NAMES.get(record.contrasts[0].kind, "") if record.contrasts else "",
        "unit": UNITS.get(record.contrasts[0].kind, "1") if record.contrasts else "1",
        "surfaces": SURFACES,
        "regions": record.regions[:MAX_REGIONS],
        "causes": _causes(record),
        "cause_range": cause_range,
        "cause_text": "; or, not to be told apart: ".join(cause_text(c) for c in _causes(record) if c.tie),
        "narrow": [c for c in record.contrasts if c.tolerance_ratio and c.tolerance_ratio < WANTED_RATIO],
        "budget": large,
        "small_budget": small,
        "budget_top": max((max(row.contributions, default=0.0) for row in record.budget), default=0.0),
        "golden": _golden(record),
        "lot": pictures.lot,
        "lot_peers": _lot_peers(record, pictures.lot),
        "groups": groups_of(record),
        "calibrations": calibrations_of(record, pictures.calibrations),
        "files": files_of(record, folder),
        "folder": folder.name,
        **_photographs(record, pictures),
        **_maps(record, pictures),
        **tilt_parts(record),
        **print_parts(record, pictures.print),
        **_surface(pictures.surface, view),
    }


def _photographs(record: Record, pictures: Pictures) -> dict[str, Any]:
    white = max((float(np.nanpercentile(p, 99.0)) for p in pictures.aligned), default=1.0)
    return {
        "white": white,
        "size_mm": pictures.size_mm,
        "photographs": [
            (pose, figures.photograph(picture, white))
            for pose, picture in zip(record.poses, pictures.aligned, strict=False)
        ],
        "raw": [(name, figures.photograph(image, _top(image))) for name, image in pictures.raw],
    }


def _maps(record: Record, pictures: Pictures) -> dict[str, Any]:
    labels = labels_of(record)
    found: dict[str, Any] = {"labels": labels, "maps": [], "chart": None, "deviation_map": None}
    if pictures.deviation is not None:
        places = [_on_map(record, (region.x, region.y)) for region in record.regions[:MAX_REGIONS]]
        found["deviation_map"] = figures.deviation_map(
            pictures.deviation, pictures.deviating, places, pictures.size_mm, _frame(record)
        )
    if pictures.ratios is not None:
        found["maps"] = [
            (label, figures.contrast_map(ratio, pictures.deviating, pictures.size_mm, _frame(record)))
            for label, ratio in zip(labels, pictures.ratios, strict=True)
        ]
    if record.contrasts:
        found["chart"] = figures.contrast_chart(
            labels,
            [c.measured - c.predicted for c in record.contrasts],
            [c.u for c in record.contrasts],
            [c.tolerance for c in record.contrasts],
            NAMES[record.contrasts[0].kind],
        )
    return found


def _budget(record: Record) -> tuple[list[BudgetRecord], list[BudgetRecord]]:
    """Sources that make up a hundredth of some variance, and the others; a print has a table of its own."""
    if record.print is not None:
        return [], []
    variance = np.array([contrast.u**2 for contrast in record.contrasts])
    large: list[BudgetRecord] = []
    small: list[BudgetRecord] = []
    for row in record.budget:
        counts = bool(np.any(np.square(row.contributions) >= SMALL_SHARE * variance))
        (large if counts else small).append(row)
    return large, small


def _golden(record: Record) -> Peers | None:
    if record.golden is None:
        return None
    first = record.poses[0].stage_deg
    labels = [contrast_name(p.stage_deg, first, p.tilt_deg) for p in record.poses[1:]]
    known = np.array(record.golden.contrasts)
    return among(labels, known, record.golden.measured, "golden parts", "ln ratio [1]")


def _lot_peers(record: Record, lot: Lot | None) -> Peers | None:
    """The part among its lot, as far as parts were measured alike."""
    count = len(record.contrasts)
    known = [part.contrasts for part in lot.parts if len(part.contrasts) == count] if lot else []
    if not known or not count:
        return None
    kind, mine = record.contrasts[0].kind, [c.measured for c in record.contrasts]
    return among(
        labels_of(record), np.array(known), mine, "parts of the lot", f"{NAMES[kind]} [{UNITS[kind]}]"
    )


def _on_map(record: Record, place_mm: tuple[float, float]) -> tuple[float, float]:
    """A place of the part at 0° along the axes of the map, whose ridges stand upright; both from the rotation axis."""
    (x, y), turn = place_mm, np.radians(record.recipe["poses"]["facet_azimuth_deg"])
    return float(np.cos(turn) * x + np.sin(turn) * y), float(np.cos(turn) * y - np.sin(turn) * x)


def _frame(record: Record) -> figures.MapFrame:
    """Where the maps lie, and what their axes are."""
    middle = _on_map(record, record.recipe["region"]["center_mm"])
    if record.recipe["poses"]["facet_azimuth_deg"] == 0.0:
        return figures.MapFrame(middle)
    return figures.MapFrame(middle, "across the ridges", "along the ridges")


def _causes(record: Record) -> tuple[CauseRecord, ...]:
    """Causes worth a row: the ties, and what else has some weight."""
    found = () if record.diagnosis is None else record.diagnosis.causes
    return tuple(one for one in found if one.tie or one.weight >= 0.01)


def _top(image: Image) -> float:
    return max(float(np.nanpercentile(image, 99.5)), 1e-9)


def _surface(surface: HeightMap | None, view: Picture3D | None) -> dict[str, Any]:
    viewer = viewer_of(view.scene) if view and view.png and view.scene else None
    above, profile = None, None
    if surface is not None:
        drawn = (view.above, view.profile) if isinstance(view, SurfacePictures) and view.above else None
        above, profile = drawn or flat_drawings(surface)
    return {
        "surface_picture": above,
        "surface_profile": profile,
        "surface_3d": figures.png_uri(view.png) if view and view.png else None,
        "surface_note": view.note if view else "none was asked for",
        "viewer": viewer,
        "script_sources": viewer.script_sources if viewer else (),
    }
