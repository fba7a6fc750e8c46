"""The plate of ``anisoscope render checkerboard``: its cells, its numbers, its picture."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from anisoscope.cli.render_options import PictureOptions, degrees, painted, signed
from anisoscope.errors import UsageError

if TYPE_CHECKING:
    from anisoscope.sim.light.geometry import Convention, Pose
    from anisoscope.sim.light.picture import Plate, PlatePicture, View

MAX_PATTERN = 4096
FIELD_COLUMNS = ["stage [°]", "first [1/sr]", "second [1/sr]", "difference [1/sr]", "Michelson", "ln ratio"]


def plate_views(
    plate: "Plate", poses: "tuple[Pose, ...]", convention: "Convention", panel: int
) -> "list[View]":
    """Views of equal shape and scale in which every pose has room."""
    from anisoscope.sim.light.picture import view_of

    reach = np.max(
        [view_of(pose, convention, (1, 1), 1.0).extent_um(plate.size_um) for pose in poses], axis=0
    )
    pixel_um = float(reach.max()) / panel
    rows, cols = (max(1, int(np.ceil(side / pixel_um - 1e-6))) for side in reach)
    return [view_of(pose, convention, (rows, cols), pixel_um) for pose in poses]


def two_directions(text: str) -> tuple[float, float]:
    """Directions of the ridges of both kinds of fields.

    Raises:
        UsageError: not two numbers.
    """
    from anisoscope.cli.console import parse_numbers

    found = parse_numbers(text, "--ridge-directions")
    if len(found) != 2:
        raise UsageError(f"--ridge-directions takes two angles in degrees, such as 0,-90, not {text!r}")
    return found[0], found[1]


def plate_cells(
    pattern: Path | None, size_mm: float, fields: int, field_mm: float
) -> tuple[npt.NDArray[np.bool_], float]:
    """Which cells have the second direction, and the side of a cell in mm."""
    from anisoscope.sim.light.picture import checkerboard as board

    for name, value in (("--size", size_mm), ("--field-size", field_mm)):
        if not 0.0 < value <= 10_000.0:
            raise UsageError(f"{name} takes a length above 0 and up to 10000 mm, not {value:g}")
    if pattern is None:
        if not 2 <= fields <= 64:
            raise UsageError(f"--fields takes 2 to 64, not {fields}")
        return board(fields), field_mm
    second = _read_pattern(pattern)
    return second, size_mm / second.shape[1]


def _read_pattern(path: Path) -> npt.NDArray[np.bool_]:
    """Dark pixels of an image: below the middle between its darkest and its brightest."""
    import cv2

    try:
        data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    except OSError as error:
        raise UsageError(f"--pattern {path}: cannot be read ({error.strerror}); check the path") from None
    try:
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    except cv2.error:
        image = None
    if image is None:
        raise UsageError(f"--pattern {path}: not an image that can be read; take a PNG of two levels")
    if max(image.shape[:2]) > MAX_PATTERN:
        raise UsageError(
            f"--pattern {path}: {image.shape[1]} × {image.shape[0]} pixels; at most {MAX_PATTERN} a side"
        )
    level = np.asarray(image, dtype=np.float64)
    if level.ndim == 3:
        full = 65535.0 if image.dtype == np.uint16 else 255.0
        cover = level[:, :, 3] / full if level.shape[2] == 4 else 1.0
        level = level[:, :, :3].mean(axis=2) * cover + full * (1.0 - cover)
    low, high = float(level.min()), float(level.max())
    if high <= low:
        raise UsageError(f"--pattern {path}: has one level only; dark and light pixels are needed")
    return np.asarray(level < 0.5 * (low + high))


def _log_ratio(first: float, second: float) -> float | None:
    return float(np.log(first / second)) if first > 0 and second > 0 else None


def fields_as_json(pose: "Pose", picture: "PlatePicture") -> dict[str, Any]:
    """Radiances and contrasts of the two kinds of fields in one pose."""
    first, second = picture.fields
    if not (np.isfinite(first) and np.isfinite(second)):
        raise UsageError(
            "the picture shows cells of one direction only: the other is too small, or not there"
        )
    total = first + second
    return {
        "stage_deg": pose.stage_deg,
        "tilt_deg": pose.tilt_deg,
        "first": first,
        "second": second,
        "difference": first - second,
        "michelson": (first - second) / total if total > 0 else None,
        "log_ratio": _log_ratio(first, second),
        "darkest": float(np.nanmin(picture.radiance)),
        "brightest": float(np.nanmax(picture.radiance)),
    }


def field_row(panel: dict[str, Any]) -> list[str]:
    """The same, for the table."""
    return [
        f"{panel['stage_deg']:g}",
        f"{panel['first']:.5f}",
        f"{panel['second']:.5f}",
        f"{panel['difference']:+.5f}",
        signed(panel["michelson"]),
        signed(panel["log_ratio"]),
    ]


def write_plate(
    picture: PictureOptions,
    plate: "Plate",
    poses: "tuple[Pose, ...]",
    view: "View",
    shown: "list[PlatePicture]",
    words: list[str],
    white: float,
) -> None:
    """Draw and write the panels."""
    from anisoscope.report.renderings import Panel, panels_png, scale_bar

    panels = []
    for pose, found in zip(poses, shown, strict=True):
        values = fields_as_json(pose, found)
        pixels = painted(found.radiance, white, picture.transfer, ~np.isfinite(found.radiance))
        lines = (
            f"ridges at {degrees(plate.ridge_deg[0])} on the plate: {values['first']:.4f} 1/sr",
            f"ridges at {degrees(plate.ridge_deg[1])} on the plate: {values['second']:.4f} 1/sr",
            f"Michelson {signed(values['michelson'])}, ln ratio {signed(values['log_ratio'])}",
        )
        panels.append(Panel(pixels, f"stage {degrees(pose.stage_deg)}", lines))
    pictures = [found.radiance for found in shown]
    bar = scale_bar(view.pixel_um, view.shape[1])
    caption = [*words, picture.exposure_sentence(pictures, white)]
    picture.write(panels_png(panels, caption, bar), pictures)
