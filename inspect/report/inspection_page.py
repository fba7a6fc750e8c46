"""The HTML report of one inspection: one self-contained file that opens offline and prints to A4."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.profiles.heightmap import HeightMap
from anisoscope.record import CauseRecord, Record, RegionRecord
from anisoscope.report import figures
from anisoscope.report.page import Filters, write_page
from anisoscope.report.relief3d import Picture3D, Renderer

FloatArray = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

REPORT_NAME = "report.html"
MAX_REGIONS = 12
WANTED_RATIO = 4.0
SURFACES = {"design": "ideal design", "height_map": "height map"}
KIND_NAMES = {
    "log_ratio": "ln ratio",
    "michelson": "Michelson contrast",
    "difference": "difference of radiance",
}
UNITS = {"log_ratio": "1", "michelson": "1", "difference": "1/sr"}
MEANING = {
    "PASS": "The part is as predicted, within the tolerance.",
    "FAIL": "The part deviates too much from what it should be.",
    "INCONCLUSIVE": "The deviation is too close to a limit to decide.",
    "INVALID": "The measurement is unfit to judge the part.",
}


@dataclass(frozen=True, eq=False)
class Pictures:
    """Arrays that the report shows; all may be missing in an INVALID inspection.

    Attributes:
        aligned: one picture a pose on the sample's raster, radiance in 1/sr.
        size_mm: (height, width) of the region.
        ratios: (pairs, cell rows, cell cols) ln ratio of the contrast map.
        deviating: (cell rows, cell cols) cells that deviate.
        deviation: (cell rows, cell cols) ln ratio by which a cell is off.
        surface: the height map of the prediction, levelled.
    """

    aligned: tuple[Image, ...] = ()
    size_mm: tuple[float, float] = (1.0, 1.0)
    ratios: FloatArray | None = None
    deviating: npt.NDArray[np.bool_] | None = None
    surface: HeightMap | None = None
    deviation: FloatArray | None = None
    raw: tuple[tuple[str, Image], ...] = field(default=())


def start_renderer(surface: HeightMap | None) -> Renderer | None:
    """Begin drawing the height map in 3-D; the report collects the picture at the end."""
    if surface is None:
        return None
    return Renderer(surface.height_um, (surface.pixel_y_um, surface.pixel_x_um))


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
    content = {
        "record": record,
        "meaning": MEANING[record.verdict],
        "kind": KIND_NAMES.get(record.contrasts[0].kind, "") if record.contrasts else "",
        "unit": UNITS.get(record.contrasts[0].kind, "1") if record.contrasts else "1",
        "rule": record.recipe["decision"],
        "surfaces": SURFACES,
        "regions": record.regions[:MAX_REGIONS],
        "causes": _causes(record),
        "narrow": [c for c in record.contrasts if c.tolerance_ratio and c.tolerance_ratio < WANTED_RATIO],
        **_figures(record, pictures, view),
    }
    filters: Filters = {
        "angle": _angle,
        "short": lambda value: f"{value:.4f}" if value >= 5e-5 else "< 0.0001",
        "signed": lambda value, digits=3: f"{value:+.{digits}f}".replace("-", "−"),
    }
    path = folder / REPORT_NAME
    write_page(path, "inspection.html", content, filters)
    return path


def _angle(value: float) -> str:
    """A small turn in degrees, signed, without a negative zero."""
    turn = round((value + 180.0) % 360.0 - 180.0, 2) + 0.0
    return f"{turn:+.2f}°".replace("-", "−")


def _figures(record: Record, pictures: Pictures, view: Picture3D | None) -> dict[str, Any]:
    labels = [_label(c.from_deg, c.to_deg, c.tilt_deg) for c in record.contrasts]
    white = max((float(np.nanpercentile(p, 99.0)) for p in pictures.aligned), default=1.0)
    found: dict[str, Any] = {
        "white": white,
        "labels": labels,
        "photographs": [
            (pose, figures.photograph(picture, white))
            for pose, picture in zip(record.poses, pictures.aligned, strict=False)
        ],
        "raw": [(name, figures.photograph(image, _top(image))) for name, image in pictures.raw],
        "maps": [],
        "chart": None,
        "budget_chart": None,
        "surface_picture": None,
        "surface_profile": None,
        "surface_3d": None,
        "surface_note": "",
        "size_mm": pictures.size_mm,
        "deviation_map": None,
        "golden_strip": None,
    }
    if pictures.deviation is not None:
        places = [_local(record, region) for region in record.regions[:MAX_REGIONS]]
        found["deviation_map"] = figures.deviation_map(
            pictures.deviation, pictures.deviating, places, pictures.size_mm
        )
    if record.golden is not None:
        found["golden_strip"] = figures.golden_strip(
            [_label(p.stage_deg, record.poses[0].stage_deg, p.tilt_deg) for p in record.poses[1:]],
            np.array(record.golden.contrasts),
            record.golden.measured,
        )
    if pictures.ratios is not None:
        found["maps"] = [
            (label, figures.contrast_map(ratio, pictures.deviating, pictures.size_mm))
            for label, ratio in zip(labels, pictures.ratios, strict=True)
        ]
    if record.contrasts:
        found["chart"] = figures.contrast_chart(
            labels,
            [c.measured - c.predicted for c in record.contrasts],
            [c.u for c in record.contrasts],
            [c.tolerance for c in record.contrasts],
            KIND_NAMES[record.contrasts[0].kind],
        )
        found["budget_chart"] = figures.budget_chart(
            [row.source for row in record.budget],
            np.array([row.contributions for row in record.budget]),
            labels,
            [row.kind for row in record.budget],
        )
    if pictures.surface is not None:
        found |= _surface(pictures.surface, view)
    return found


def _local(record: Record, region: RegionRecord) -> tuple[float, float]:
    """Middle of a region, from the middle of the map: x across the ridges, y along them."""
    x, y = np.subtract((region.x, region.y), record.recipe["region"]["center_mm"])
    turn = np.radians(record.recipe["poses"]["facet_azimuth_deg"])
    return float(np.cos(turn) * x + np.sin(turn) * y), float(np.cos(turn) * y - np.sin(turn) * x)


def _causes(record: Record) -> tuple[CauseRecord, ...]:
    """Causes worth a row: the ties, and what else has some weight."""
    found = () if record.diagnosis is None else record.diagnosis.causes
    return tuple(one for one in found if one.tie or one.weight >= 0.01)


def _top(image: Image) -> float:
    return max(float(np.nanpercentile(image, 99.5)), 1e-9)


def _surface(surface: HeightMap, view: Picture3D | None) -> dict[str, Any]:
    line = surface.height_um[surface.shape[0] // 2]
    shown = min(line.size, round(600.0 / surface.pixel_x_um))
    return {
        "surface_picture": figures.height_picture(
            surface.height_um, (surface.pixel_y_um, surface.pixel_x_um)
        ),
        "surface_profile": figures.profile_chart(np.arange(shown) * surface.pixel_x_um, line[:shown]),
        "surface_3d": figures.png_uri(view.png) if view and view.png else None,
        "surface_note": view.note if view else "",
    }


def _label(from_deg: float, to_deg: float, tilt_deg: float) -> str:
    tilt = f", tilt {tilt_deg:g}°" if tilt_deg else ""
    return f"{from_deg:g}° / {to_deg:g}°{tilt}".replace("-", "−")
