"""Angle map of an inspected part: from its frames to a map, a file, a form in micrometres, or a page."""

import io
from dataclasses import asdict
from pathlib import Path

import numpy as np

from anisoscope.base.atomic_write import write_bytes, write_text
from anisoscope.base.csv_style import csv_text, number_text
from anisoscope.base.errors import MeasurementError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.imaging.angle_map import CELL_UM, AngleMap
from anisoscope.imaging.angle_map import angle_map as map_of
from anisoscope.inspection.frames import read_frames
from anisoscope.inspection.manifest import reopen
from anisoscope.inspection.pipeline import measure_frames
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.record.schema import Record
from anisoscope.report.page import write_page
from anisoscope.report.surface_sections import facet_parts

SUFFIXES = (".csv", ".npz", ".x3p")
HEAD = ("x [mm]", "y [mm]", "ridge", "across [deg]", "u [deg]", "along [deg]", "u along [deg]", "seen")


def angle_map(folder: Path | str, *, cell_um: float = CELL_UM, on_progress: Advance = silent) -> AngleMap:
    """Lean of the facets of a ridged part, cell by cell, from the frames of its inspection; nothing is written.

    Args:
        folder: the inspection folder.
        cell_um: side of the cells.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        UsageError: the part has no ridges.
        RecordError: the inspection is not finished, or a file is missing.
        MeasurementError: the pictures do not show the facets.
    """
    folder = Path(folder).resolve()
    manifest, job = reopen(folder)
    if job.kind.name != "ridges" or not isinstance(job.recipe, SurfaceRecipe):
        raise UsageError(f"{folder}: the part is {job.kind.one}: only ridges have facets to measure")
    on_progress("prediction", 0, 3)
    expected = job.kind.predict(job.recipe, job.rig, cached=True)
    on_progress("measurement", 1, 3)
    _, measured, _ = measure_frames(manifest.began, job, expected, read_frames(folder, manifest))
    on_progress("angles of the facets", 2, 3)
    return map_of(job.recipe, expected, measured, cell_um)


def form_of(found: AngleMap) -> HeightMap:
    """Form of the part in µm, from the leans of its facets about their mean: sink marks, weld lines and waves.

    Heights whose slopes are the leans in the sense of least squares (Frankot and Chellappa, IEEE Trans. Pattern Anal.
    10, 1988), by a cosine transform; what the ridges share is taken off, and unseen cells lean as their mean.

    Raises:
        MeasurementError: no pose tells the lean along the ridges.
    """
    from scipy.fft import dctn, idctn

    if found.along_deg is None:
        raise MeasurementError(
            "heights need the lean along the ridges, which none of the poses tells: add 90° at a tilt of minus the "
            "ridge angle (recipe suggest)"
        )
    slopes = []
    for lean, sign in ((found.angle_deg, -1.0), (found.along_deg, -1.0)):
        slope = sign * np.tan(np.radians(lean))
        slopes.append(np.nan_to_num(slope - np.nanmean(slope)))
    step_x = 1000.0 * float(np.ptp(found.across_mm)) / (len(found.across_mm) - 1)
    step_y = 1000.0 * float(np.ptp(found.along_mm)) / (len(found.along_mm) - 1)
    # rows fall along y, so that along is downwards with the sign of the lean turned
    right, down = slopes[0] * step_x, slopes[1] * step_y
    divergence = np.zeros_like(right)
    between_x, between_y = 0.5 * (right[:, 1:] + right[:, :-1]), 0.5 * (down[1:] + down[:-1])
    divergence[:, :-1] += between_x
    divergence[:, 1:] -= between_x
    divergence[:-1] += between_y
    divergence[1:] -= between_y
    rows, cols = divergence.shape
    waves = (
        2.0 * np.cos(np.pi * np.arange(rows) / rows)[:, None]
        + 2.0 * np.cos(np.pi * np.arange(cols) / cols)
        - 4.0
    )
    waves[0, 0] = 1.0
    spectrum = dctn(divergence, type=2, norm="ortho") / waves
    spectrum[0, 0] = 0.0
    height = np.asarray(idctn(spectrum, type=2, norm="ortho"))
    # first row of a height map lies at the smallest y
    return HeightMap(
        height[::-1], step_x, step_y, {"form": "from the leans of the facets", "mean_deg": found.mean_deg}
    )


def check_angle_file(path: Path) -> None:
    """Refuse an ending in which no angle map is written; errors as for `write_angle_map`."""
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"{path}: an angle map is written as {', '.join(SUFFIXES)}")


def write_angle_map(found: AngleMap, path: Path) -> None:
    """Write the cells as a table (.csv) or arrays (.npz), or the form as a height map (.x3p).

    Raises:
        UsageError: another ending.
        MeasurementError: a height map without the lean along the ridges.
        RecordError: the file cannot be written.
    """
    check_angle_file(path)
    suffix = path.suffix.lower()
    if suffix == ".x3p":
        write_height_map(form_of(found), path)
    elif suffix == ".npz":
        stream = io.BytesIO()
        np.savez_compressed(stream, **{k: v for k, v in asdict(found).items() if v is not None})
        write_bytes(path, stream.getvalue())
    else:
        write_text(path, csv_text(_rows(found)))


def _rows(found: AngleMap) -> list[tuple[str, ...]]:
    empty = np.full(found.angle_deg.shape, np.nan)
    along, u_along = (empty if one is None else one for one in (found.along_deg, found.u_along_deg))
    ridge = np.broadcast_to(found.ridge, found.angle_deg.shape)
    rows: list[tuple[str, ...]] = [HEAD]
    for at in np.ndindex(found.angle_deg.shape):
        if not np.isfinite(found.x_mm[at]):
            continue
        place = (f"{found.x_mm[at]:.4f}", f"{found.y_mm[at]:.4f}", f"{ridge[at]}")
        leans = (
            "" if np.isnan(one[at]) else number_text(f"{one[at]:.4f}")
            for one in (found.angle_deg, found.u_deg, along, u_along)
        )
        seen = "no facet" if found.unseen[at] else "" if np.isnan(found.angle_deg[at]) else "facet"
        rows.append((*map(number_text, place[:2]), place[2], *leans, seen))
    return rows


def write_angle_page(found: AngleMap, record: Record, path: Path) -> None:
    """Write a page: maps of the leans, their histogram, and the ridges that lean most from the others.

    Args:
        found: the leans.
        record: of the inspection.
        path: of the page.

    Raises:
        RecordError: it cannot be written.
    """
    title = f"{record.serial}: {record.product}"
    write_page(path, "angles.html", {"title": title, "facets": facet_parts(found, record), "lacking": None})
