"""The HTML report of one inspection: one self-contained file that opens offline and prints to A4."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.language import message
from anisoscope.calibration.record import CalibrationRecord, Kind
from anisoscope.decision.certificate import certificate_of
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.record.schema import CauseRecord, PoseRecord, Record
from anisoscope.report import figures
from anisoscope.report.page import page_text, ready_template
from anisoscope.report.peers import Lot, Peers
from anisoscope.report.provenance import calibrations_of, files_of, groups_of, rig_section
from anisoscope.report.rule import PRECEDENCE
from anisoscope.report.surface_view import Picture3D, SurfacePictures, SurfaceView, flat_drawings, viewer_of
from anisoscope.report.wording import cause_range, cause_text, filters, severity_text, weight_text

if TYPE_CHECKING:
    from anisoscope.imaging.angle_map import AngleMap

Image = npt.NDArray[np.float32]

TEMPLATE = "inspection.html"
MOST_POSES = 6
"""Poses on page 1; further ones are folded."""
DIFFERENCE_SCALE = 0.5
"""Relative difference from the predicted mean at which the colours of a difference picture end."""
INVALID_RULE = "what makes a measurement unfit goes before all that was measured, and never fails a part"
MEANING = {
    "PASS": "The part is as predicted, within the tolerance.",
    "FAIL": "The part deviates too much from what it should be.",
    "INCONCLUSIVE": "The deviation is too close to a limit to decide.",
    "INVALID": "The measurement is unfit to judge the part.",
}


@dataclass(frozen=True, eq=False)
class Pictures:
    """Pictures of the report that the record does not hold; all may be missing in an INVALID inspection.

    Attributes:
        aligned: one picture a pose on the sample's raster, radiance in 1/sr.
        size_mm: (height, width) of the region.
        predicted: (P, cell rows, cell cols) predicted mean radiance of the cells in 1/sr.
        predicted_text: what the predicted pictures are, in words.
        differences: (P, rows, cols) measured over predicted radiance, less 1, or None where there is none to show.
        difference_text: of what the differences are, in words.
        ratios: (pairs, cell rows, cell cols) ln ratio of the contrast map.
        deviating: (cell rows, cell cols) cells that deviate.
        deviation: (cell rows, cell cols) score of the cells over its limit, with a sign.
        surface: the height map of the prediction, levelled.
        raw: pictures as photographed, where they could not be judged.
        logo: of the shop, as a data URI, or None.
        calibrations: records of the rig's calibrations, by kind.
        lot: parts of the same lot that were inspected before, or None.
        facets: lean of the facets, or None.
        of_kind: what the kind of part shows besides, or None.
    """

    aligned: tuple[Image, ...] = ()
    size_mm: tuple[float, float] = (1.0, 1.0)
    predicted: FloatArray | None = None
    predicted_text: str = ""
    differences: FloatArray | None = None
    difference_text: str = ""
    ratios: FloatArray | None = None
    deviating: npt.NDArray[np.bool_] | None = None
    surface: HeightMap | None = None
    deviation: FloatArray | None = None
    raw: tuple[tuple[str, Image], ...] = field(default=())
    logo: str | None = None
    calibrations: Mapping[Kind, CalibrationRecord] = field(default_factory=dict)
    lot: Lot | None = None
    facets: "AngleMap | None" = None
    of_kind: object = None


@dataclass(frozen=True, eq=False)
class Sections:
    """Sections of the report for one kind of part; sources are Jinja templates, which may use ``content``.

    Attributes:
        rule: the rule that decided, in one sentence; without one the page names none, except of an INVALID part.
        reasons: further lines below the verdict: name and text.
        first: source of what follows the photographs on page 1.
        before, after: sources of the sections before and after the diagnosis.
        budget: source of the uncertainty budget.
        fitted_too: what causes are fitted to beside the poses, such as " and to the share of the area that deviates".
        lot_peers: the part among its lot, or None.
        unit: of what is compared with the lot.
        content: what the sources name.
    """

    rule: str = ""
    reasons: tuple[tuple[str, str], ...] = ()
    first: str = ""
    before: str = ""
    after: str = ""
    budget: str = ""
    fitted_too: str = ""
    lot_peers: Peers | None = None
    unit: str = "1"
    content: Mapping[str, Any] = field(default_factory=dict)


def start_renderer(surface: HeightMap | None) -> SurfaceView | None:
    """Begin drawing a height map; the report collects the pictures at the end.

    The template is made ready beside it, so that little is left to do after the verdict.
    """
    if surface is None:
        return None
    return SurfaceView(surface, lambda: ready_template(TEMPLATE, filters()))


def report_page(
    record: Record,
    pictures: Pictures,
    folder: Path,
    view: Picture3D | None = None,
    sections: Sections | None = None,
) -> str:
    """The report of an inspection, as the text of a page.

    Args:
        record: the inspection.
        pictures: what to show.
        folder: the inspection folder.
        view: the height map in 3-D, or None.
        sections: what the kind of part shows of it.
    """
    sections = sections or Sections()
    parts = {
        "first": sections.first,
        "before": sections.before,
        "after": sections.after,
        "budget": sections.budget,
    }
    return page_text(TEMPLATE, _content(record, pictures, folder, view, sections), filters(), parts)


def _content(
    record: Record, pictures: Pictures, folder: Path, view: Picture3D | None, sections: Sections
) -> dict[str, Any]:
    causes = _causes(record)
    return {
        "record": record,
        "logo": pictures.logo,
        "meaning": MEANING[record.verdict],
        "rule_text": sections.rule or (message(INVALID_RULE) if record.verdict == "INVALID" else ""),
        "certificate": certificate_of([one.name for one in record.inputs], folder),
        "reasons": sections.reasons,
        "precedence": PRECEDENCE,
        "rule": record.recipe["decision"],
        "causes": causes,
        "cause_range": cause_range,
        "severity_text": severity_text,
        "weight_text": weight_text,
        "cause_text": message("; cannot be distinguished from: ").join(
            cause_text(c) for c in causes if c.tie
        ),
        "fitted_too": sections.fitted_too,
        "unit": sections.unit,
        "rig_section": rig_section(record),
        "lot": pictures.lot,
        "lot_peers": sections.lot_peers,
        "groups": groups_of(record),
        "calibrations": calibrations_of(record, pictures.calibrations),
        "files": files_of(record, folder),
        "folder": folder.name,
        **_photographs(record, pictures),
        **_surface(pictures.surface, view),
        **sections.content,
    }


def _photographs(record: Record, pictures: Pictures) -> dict[str, Any]:
    shown = tuple(
        _photographed(pose, k, pictures)
        for k, (pose, _) in enumerate(zip(record.poses, pictures.aligned, strict=False))
    )
    return {
        "size_mm": pictures.size_mm,
        "photographs": shown[:MOST_POSES],
        "more_photographs": shown[MOST_POSES:],
        "predicted_text": pictures.predicted_text,
        "difference_text": pictures.difference_text,
        "difference_scale": DIFFERENCE_SCALE,
        "outline": None if pictures.deviating is None else figures.outline_path(pictures.deviating),
        "outline_size": (1, 1) if pictures.deviating is None else pictures.deviating.shape,
        "raw": [(name, figures.photograph(image, _top(image))) for name, image in pictures.raw],
    }


@dataclass(frozen=True)
class Photographed:
    """One pose in pictures, as data URIs; without a prediction the measured one alone."""

    pose: PoseRecord
    white: float
    measured: str
    predicted: str | None
    difference: str | None


def _photographed(pose: PoseRecord, number: int, pictures: Pictures) -> Photographed:
    """Pictures of a pose; measured and predicted have one scale, which is that of this pose."""
    aligned = pictures.aligned[number]
    white = float(np.nanpercentile(aligned, 99.0))
    predicted = difference = None
    if pictures.differences is not None and pictures.predicted is not None:
        wanted = pictures.predicted[number]
        white = max(white, 1.05 * float(wanted.max()))
        predicted = figures.photograph(figures.enlarged(wanted).astype(np.float32), white)
        difference = figures.difference_picture(pictures.differences[number], DIFFERENCE_SCALE)
    return Photographed(pose, white, figures.photograph(aligned, white), predicted, difference)


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
        "surface_3d": figures.still_picture(view.png) if view and view.png else None,
        "surface_note": view.note if view else "none was asked for",
        "viewer": viewer,
        "script_sources": viewer.script_sources if viewer else (),
    }
