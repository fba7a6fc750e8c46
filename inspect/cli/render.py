"""``anisoscope render``: pictures of ridged plates and of height maps under the rig's light."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from cyclopts import App, Parameter

from anisoscope.cli.console import progress
from anisoscope.cli.render_options import (
    PictureOptions,
    PlasticOptions,
    RigOptions,
    answer,
    degrees,
    painted,
    parse_angles,
)
from anisoscope.cli.render_plate import (
    FIELD_COLUMNS,
    field_row,
    fields_as_json,
    plate_cells,
    plate_views,
    two_directions,
    write_plate,
)
from anisoscope.cli.render_scene import SurfaceOptions
from anisoscope.cli.render_shot import MicroscopeOptions, Shot, cut_line, height_pixels, heights_in_view
from anisoscope.errors import UsageError

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
