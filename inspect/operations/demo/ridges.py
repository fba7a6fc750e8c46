"""The files of the demo with ridges: reference height map, recipe, one bench and rig file a part, and a flat."""

from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.progress import Advance
from anisoscope.operations.demo.folder import FIXTURE, TILE, Files, Scene, flat_of, rig_table, tile_sample
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import add_facet_roughness, ridges

PARTS = {"good": "PASS", "burrs": "FAIL", "angle": "FAIL"}
PITCH_UM = 100.0
RIDGE_ANGLE_DEG = 10.0
LOBE = {"alpha_along": 0.055, "alpha_across": 0.095, "albedo": 0.2, "index": 1.5}
TAIL = 0.5  # of Student's distribution with γ = 3, which the bench's path tracer has
U_TAIL = 0.0  # as of a plastic whose lobe is calibrated: both give the same numbers
RESOLVED_ALPHA = 0.03
EXPOSURE_S = 0.006


def _write_reference(path: Path, rng: np.random.Generator) -> None:
    """A part measured by a profilometer: 1 mm × 1 mm, 1 µm pixels, 5 nm noise, seated askew."""
    design = RidgeDesign(pitch_um=PITCH_UM, ridge_angle_deg=RIDGE_ANGLE_DEG)
    surface = ridges(design, (1001, 1001), (1.0, 1.0))
    surface = add_facet_roughness(
        surface, alpha_along=RESOLVED_ALPHA, alpha_across=RESOLVED_ALPHA, correlation_um=8.0, rng=rng
    )
    rows, cols = np.indices(surface.shape)
    height = surface.height_um + 0.005 * rng.standard_normal(surface.shape) + 0.002 * cols - 0.001 * rows
    height[rng.random(surface.shape) < 0.0005] = np.nan
    write_height_map(surface.with_height(height), path)


def _recipe(folder: Path, rng: np.random.Generator, advance: Advance) -> dict[str, Any]:
    advance("reference height map", 0, 1)
    _write_reference(folder / "reference.x3p", rng)
    return {
        "schema": 1,
        "kind": "ridges",
        "product": "ridged demo plate, pitch 100 µm, ridge angle 10°",
        "surface": {"height_map": "reference.x3p", "pitch_um": PITCH_UM},
        "material": {
            **LOBE,
            "tail": TAIL,
            "u_tail": U_TAIL,
            "u_alpha_share": 0.03,
            "u_albedo": 0.006,
            "u_index": 0.005,
        },
        "poses": {"angles_deg": [0.0, 90.0, 180.0]},
        "acquisition": {"exposure_s": EXPOSURE_S, "frames_per_pose": 4, "dark_frames": 8, "settle_s": 0.0},
        "region": {"size_mm": [2.0, 2.0]},
        "decision": {
            "contrast": "log_ratio",
            "tolerance": 0.4,
            "alpha": 0.001,
            "deviation": "fail",
            "unexcluded": "inconclusive",
        },
        "area": {"max_share": 0.02},
        "uncertainty": {"seating_tilt_deg": 0.05},
    }


def _sample(name: str, rng: np.random.Generator) -> dict[str, Any]:
    if name == TILE:
        return tile_sample()

    def spread(value: float, share: float) -> float:
        return float(value * (1.0 + share * rng.standard_normal()))

    off = float(rng.choice([-2.0, 2.0])) if name == "angle" else 0.0
    return {
        "kind": "ridges",
        "pitch_um": PITCH_UM,
        "ridge_angle_deg": RIDGE_ANGLE_DEG + float(0.1 * rng.standard_normal()) + off,
        "resolved_alpha": RESOLVED_ALPHA,
        "burr_coverage": 0.10 if name == "burrs" else float(rng.uniform(0.0, 0.002)),
        "seating_tilt_deg": [float(t) for t in 0.05 * rng.standard_normal(2)],
        "material": {
            "alpha_along": spread(LOBE["alpha_along"], 0.03),
            "alpha_across": spread(LOBE["alpha_across"], 0.03),
            "albedo": spread(LOBE["albedo"], 0.03),
            "index": LOBE["index"],
            "lobe": "student",
        },
    }


def _files(name: str, rng: np.random.Generator) -> Files:
    sample = _sample(name, rng)
    bench = {"schema": 1, "seed": int(rng.integers(2**31)), "sample": sample, "fixture": FIXTURE}
    return bench, rig_table("virtual rig", {"pixel_um": 4.0}, {"angle_deg": 10.0}, flat=flat_of(name))


SCENE = Scene(PARTS, 90, _recipe, _files, EXPOSURE_S)
