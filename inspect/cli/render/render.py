"""``anisoscope render``: pictures of ridged plates and of height maps under the rig's light."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import UsageError
from anisoscope.cli.render.options import PictureOptions, degrees, painted, signed

if TYPE_CHECKING:
    from anisoscope.sim.light.geometry import Convention, Pose
    from anisoscope.sim.light.picture import Plate, PlatePicture, View
from dataclasses import asdict
from typing import Annotated, Literal

from cyclopts import App, Parameter

from anisoscope.cli.console import progress
from anisoscope.cli.render.options import (
    PlasticOptions,
    RigOptions,
    answer,
    parse_angles,
)
from anisoscope.cli.render.scene import SurfaceOptions
from anisoscope.cli.render.shot import MicroscopeOptions, Shot, cut_line, height_pixels, heights_in_view

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


app = App(name="render", help="Pictures of ridged plates and of height maps under the rig's light.")


@app.command
def checkerboard(
    *,
    picture: PictureOptions,
    ridge_angle: Annotated[float, Parameter(help="Ridge angle in degrees.")] = 10.0,
    wall: Annotated[
        Literal["perpendicular", "vertical"], Parameter(help="Wall of a ridge.")
    ] = "perpendicular",
    height_loss: Annotated[float, Parameter(help="Share of the ridge height missing at the crest.")] = 0.0,
    angles: Annotated[str, Parameter(help="Stage angles in degrees, one panel each.")] = "0,90",
    ridge_directions: Annotated[
        str, Parameter(help="Directions of the ridges in the two kinds of fields, from +y, in degrees.")
    ] = "0,-90",
    fields: Annotated[int, Parameter(help="Fields along a side, 2 to 64.")] = 7,
    field_size: Annotated[float, Parameter(help="Side of a field in mm.")] = 5.0,
    pattern: Annotated[
        Path | None, Parameter(help="Image of two levels in place of the checkerboard: dark is the second.")
    ] = None,
    size: Annotated[float, Parameter(help="Width of the plate with --pattern in mm.")] = 40.0,
    near_light: Annotated[
        float | None, Parameter(help="Distance of the light in mm; default: parallel light.")
    ] = None,
    bounces: Annotated[
        int | Literal["all"], Parameter(help="Reflections followed: 1 is direct light, or 'all'.")
    ] = 1,
    plastic: PlasticOptions | None = None,
    rig: RigOptions | None = None,
) -> int:
    """Render a plate of fields with two directions of ridges, turned on the stage."""
    from anisoscope.profiles.ideal import RidgeDesign
    from anisoscope.sim.light.geometry import Pose
    from anisoscope.sim.light.picture import Plate, plate_picture

    plastic, rig = plastic or PlasticOptions(), rig or RigOptions()
    picture.check(pattern)
    turns = parse_angles(angles, "--angles")
    second, cell_mm = plate_cells(pattern, size, fields, field_size)
    design = RidgeDesign(100.0, ridge_angle, wall=wall, height_loss=height_loss)
    plate = Plate(second, 1000.0 * cell_mm, design, plastic.material(), two_directions(ridge_directions))
    if near_light is not None and not 0.0 < near_light < float("inf"):
        raise UsageError(f"--near-light takes a positive distance in mm, not {near_light:g}")
    if bounces != "all" and bounces < 1:
        raise UsageError(f"--bounces must be 1 or more, or all, not {bounces}")
    convention = rig.convention()
    poses = tuple(Pose(angle, rig.tilt) for angle in turns)
    views = plate_views(plate, poses, convention, picture.panel)
    distance = None if near_light is None else 1000.0 * near_light
    shown = []
    with progress("render", quiet=picture.json_) as advance:
        for number, (pose, view) in enumerate(zip(poses, views, strict=True)):
            advance(f"stage {degrees(pose.stage_deg)}", number, len(poses))
            depth = None if bounces == "all" else bounces
            shown.append(plate_picture(plate, pose, convention, view, distance, depth))
    light = (
        "parallel light"
        if near_light is None
        else f"a point of light at {near_light:g} mm, irradiance at the axis = 1"
    )
    count = (
        "all reflections"
        if bounces == "all"
        else "direct light"
        if bounces == 1
        else f"{bounces} reflections"
    )
    words = (
        f"Corrected model, {count}, {light}; ridge angle {ridge_angle:g}°, roughness {plastic.alpha_along:g} along and "
        f"{plastic.alpha_across:g} across the ridges, albedo {plastic.albedo:g}."
    )
    white = picture.brightest([p.radiance for p in shown], 100.0)
    write_plate(picture, plate, poses, views[0], shown, [words, rig.sentence()], white)
    values = [fields_as_json(pose, p) for pose, p in zip(poses, shown, strict=True)]
    found = {
        "model": "corrected",
        "bounces": bounces,
        "convention": asdict(convention),
        "near_light_mm": near_light,
        "material": asdict(plate.material),
        "plate_mm": [side / 1000 for side in plate.size_um],
        "pixel_um": views[0].pixel_um,
        "ridge_directions_deg": list(plate.ridge_deg),
        "exposure": picture.as_json([p.radiance for p in shown], white),
        "panels": values,
    }
    answer(picture, found, "Fields of the plate", FIELD_COLUMNS, [field_row(panel) for panel in values])
    return 0


@app.command
def frame(
    height_map: Path | None = None,
    /,
    *,
    picture: PictureOptions,
    stage: Annotated[str, Parameter(help="Stage angles in degrees, one panel each.")] = "0,90,180",
    surface: SurfaceOptions | None = None,
    microscope: MicroscopeOptions | None = None,
    plastic: PlasticOptions | None = None,
    rig: RigOptions | None = None,
) -> int:
    """Render what a microscope camera sees of a height map or of ideal ridges, one panel for each stage angle.

    Args:
        height_map: File with a measured height map; leave it out and give --ridge-angle for ideal ridges.
    """
    from anisoscope.report.renderings import BEYOND_RGB, MISSING_RGB, Panel, panels_png, scale_bar

    shot = Shot(height_map, picture, stage, surface, microscope, plastic, rig)
    panels = [
        Panel(
            painted(p.radiance, shot.white, picture.transfer, ~p.covered, p.missing),
            f"stage {degrees(pose.stage_deg)}",
            (f"mean of the surface {mean:.4f} 1/sr",),
        )
        for pose, p, mean in zip(shot.poses, shot.frames, shot.means, strict=True)
    ]
    marks = []
    if any(p.missing.any() for p in shot.frames):
        marks.append((MISSING_RGB, "not measured"))
    if not all(p.covered.all() for p in shot.frames):
        marks.append((BEYOND_RGB, "beyond the map"))
    bar = scale_bar(shot.views[0].pixel_um, shot.views[0].shape[1])
    picture.write(panels_png(panels, shot.caption(), bar, marks), shot.pictures)
    shot.answer()
    return 0


@app.command
def beside(
    height_map: Path | None = None,
    /,
    *,
    picture: PictureOptions,
    stage: Annotated[float, Parameter(help="Stage angle in degrees.")] = 0.0,
    cut: Annotated[
        float | None,
        Parameter(help="Also draw height and radiance along the line this far above the middle, in µm."),
    ] = None,
    surface: SurfaceOptions | None = None,
    microscope: MicroscopeOptions | None = None,
    plastic: PlasticOptions | None = None,
    rig: RigOptions | None = None,
) -> int:
    """Render a height map in colours beside its microscope picture, in the same orientation and scale.

    Args:
        height_map: File with a measured height map; leave it out and give --ridge-angle for ideal ridges.
    """
    from anisoscope.report.renderings import BEYOND_RGB, MISSING_RGB, Panel, panels_png, scale_bar

    shot = Shot(height_map, picture, f"{stage:g}", surface, microscope, plastic, rig)
    view, found = shot.views[0], shot.frames[0]
    heights = heights_in_view(shot.scene, view)
    known = heights[np.isfinite(heights)]
    if known.size == 0:
        raise UsageError("no measured point lies in the picture: take another --region")
    low, high = (float(end) for end in np.percentile(known, [0.5, 99.5]))
    colours = height_pixels(heights, low, high, found)
    line = cut_line(cut, view, heights, found, (low, high))
    panels = [
        Panel(colours, "height map", (f"colours from {low:.2f} to {high:.2f} µm, 99 % of the points",)),
        Panel(
            painted(found.radiance, shot.white, picture.transfer, ~found.covered, found.missing),
            f"microscope picture, stage {degrees(stage)}",
            (f"mean of the surface {shot.means[0]:.4f} 1/sr",),
        ),
    ]
    marks = [(MISSING_RGB, "not measured")] if found.missing.any() else []
    marks += [(BEYOND_RGB, "beyond the map")] if not found.covered.all() else []
    bar = scale_bar(view.pixel_um, view.shape[1])
    picture.write(panels_png(panels, shot.caption(), bar, marks, line), shot.pictures)
    shot.answer()
    return 0
