"""Page of a plate: one self-contained file that shows its fields in WebGL, under light from any side.

Radiances are computed by the page, class by class, as `anisoscope.sim.light.corrected` does for direct light: the page
holds the outline of the ridges, the lobe, and the table of the transmittance. Light and eye are far away, so that all
fields of a class are alike.
"""

from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.errors import UsageError
from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.profiles.plates import Plan, inner_share
from anisoscope.report.page import packed, scripted, write_page
from anisoscope.sim.light.corrected import outline_for
from anisoscope.sim.light.geometry import Convention, Pose, directions
from anisoscope.sim.light.material import Material, diffuse_scale, transmittance_table

FLAT_CLASS = 0xFFFF


def write_plate_page(
    path: Path,
    title: str,
    plan: Plan,
    design: RidgeDesign,
    material: Material,
    light_angle_deg: float,
    stages_deg: tuple[float, ...],
    ends: tuple[float, float],
) -> None:
    """Write the page, atomically.

    Args:
        path: file to write.
        title: what the plate shows.
        plan: its fields.
        design: their ridges.
        material: the plastic, with Beckmann's lobe.
        light_angle_deg: between light and camera on the rig.
        stages_deg: stage angles that are offered.
        ends: radiances of black and white in 1/sr.

    Raises:
        UsageError: a lobe that the page does not know.
        RecordError: the file cannot be written.
    """
    if not material.is_beckmann:
        raise UsageError("the page of a plate knows Beckmann's lobe only: leave out tail and second lobe")
    rows, cols = plan.shape
    size = f"{plan.size_mm[0]:g} mm × {plan.size_mm[1]:g} mm"
    content = {
        "title": f"{title}, made of ridges",
        "subtitle": f"{cols} × {rows} fields, {size}, as predicted under light from any side",
        "rows": rows,
        "cols": cols,
        "stages": [f"{one:g}" for one in stages_deg],
        "facts": (
            ("ridges", f"pitch {design.pitch_um:g} µm, {len(plan.letters)} classes of direction and ridge angle"),
            ("roughness", f"α {material.alpha_along:g} along and {material.alpha_across:g} across the ridges"),
            ("plastic", f"albedo {material.albedo:g}, index {material.index:g}"),
            ("black and white", f"{ends[0]:.4g} and {ends[1]:.4g} 1/sr"),
            ("model", "direct light, rays, light and eye far away; rims of the fields are dark"),
        ),
        **scripted(_data(plan, design, material, light_angle_deg, stages_deg, ends), "webgl.js", "plate.js"),
    }  # fmt: skip
    write_page(path, "plate.html", content)


def _data(
    plan: Plan,
    design: RidgeDesign,
    material: Material,
    light_angle_deg: float,
    stages_deg: tuple[float, ...],
    ends: tuple[float, float],
) -> dict[str, Any]:
    classes = []
    for letter in plan.letters:
        ridges = plan.design_of(letter, design)
        outline = outline_for(ridges, material)
        classes.append(
            {
                "name": letter,
                "azimuth": plan.azimuths_deg[letter],
                "angle": ridges.ridge_angle_deg,
                "share": inner_share(ridges, 1000.0 * plan.module_mm),
                "x": outline.x_um.tolist(),
                "z": outline.z_um.tolist(),
                "segment": outline.segment.tolist(),
                "normal": outline.normal.ravel().tolist(),
                "length": outline.length_um.tolist(),
            }
        )
    numbers = plan.classes()
    ((to_light, _),) = zip(*directions((Pose(0.0),), Convention(light_angle_deg)), strict=True)
    elevation = float(np.degrees(np.arcsin(to_light[2])))
    start = {
        "stage": stages_deg[0],
        "tilt": 0,
        "azimuth": 0 if light_angle_deg >= 0.0 else 180,
        "elevation": elevation,
    }
    return {
        "rows": plan.shape[0],
        "cols": plan.shape[1],
        "fields": packed(np.where(numbers < 0, FLAT_CLASS, numbers).astype(np.uint16)),
        "classes": classes,
        "along": material.alpha_along,
        "across": material.alpha_across,
        "index": material.index,
        "base": diffuse_scale(material),
        "transmittance": packed(transmittance_table(material).astype(np.float64)),
        "black": ends[0],
        "white": ends[1],
        "start": {**start, "zoom": 1, "exposure": 0, "shown": "picture", "row": 1, "col": 1},
        "selftest": selftest_cases(stages_deg, elevation),
        "selftest_size": 256,
    }


def selftest_cases(stages_deg: tuple[float, ...], elevation_deg: float) -> list[dict[str, float]]:
    """States of ``#selftest``: the stage angles on the rig, and light from other sides on a tilted part."""
    found: list[dict[str, float]] = [
        {"stage": stage, "tilt": 0.0, "azimuth": 0.0, "elevation": elevation_deg} for stage in stages_deg
    ]
    found.append({"stage": 30.0, "tilt": 25.0, "azimuth": 140.0, "elevation": 50.0})
    found.append({"stage": -75.0, "tilt": -40.0, "azimuth": -100.0, "elevation": 20.0})
    return found
