"""The files of the demo with plates: a Data Matrix of ridges, good, with three dead fields, and worn."""

from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from anisoscope.base.progress import Advance
from anisoscope.calibration.pictures import take_flat
from anisoscope.cli.demo.folder import FIXTURE, begin, write_bench

PARTS = {"good": "PASS", "dead-fields": "FAIL", "worn": "FAIL"}
MEGABYTES = 150
"""Size of the folder of one demo."""

TEXT = "A17"
PITCH_UM, RIDGE_ANGLE_DEG = 50.0, 10.0
MODULE_MM = 0.2
AZIMUTHS_DEG = {"A": 0.0, "B": -90.0}
LOBE = {"alpha_along": 0.055, "alpha_across": 0.095, "albedo": 0.2, "index": 1.5}
RESOLVED_ALPHA = 0.03
DEAD = ((3, 4), (6, 8), (9, 2))
WORN_UM = 20.0
"""Radius of the crests of the worn plate."""
READ_AT_DEG = [0.0, 90.0]
ANGLES_DEG = [*READ_AT_DEG, 180.0]
"""At 180° worn and filled ridges shine, which face away otherwise."""


def lay_out(out: Path, seed: int, advance: Advance) -> Path:
    """Write all files of the demo below ``out`` and take the flat on the virtual rig.

    Args:
        out: folder, made if it is missing.
        seed: seed of everything random.
        advance: progress.

    Returns:
        The folder, absolute.

    Raises:
        UsageError: a negative seed.
        RecordError: the folder cannot be made.
    """
    folder, rng = begin(out, seed)
    rows = plan_rows()
    (folder / "plan.csv").write_text("\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8")
    (folder / "recipe.toml").write_text(tomli_w.dumps(recipe()), encoding="utf-8")
    for name in (*PARTS, "white-tile"):
        write_bench(folder, name, bench(sample(name, rows, rng), int(rng.integers(2**31))), rig(name))
    advance("flat of the white tile", 0, 1)
    take_flat(
        folder / "bench" / "white-tile" / "rig.toml",
        folder / "flat.tif",
        exposure_s=0.006,
        frames=16,
        reflectance=0.99,
    )
    return folder


def plan_rows() -> tuple[str, ...]:
    """Plan of the code: light modules A, dark ones B, with its quiet zone."""
    from anisoscope.sim.design.plates import modules_of_code

    return tuple("".join("B" if dark else "A" for dark in row) for row in modules_of_code(TEXT, "datamatrix"))


def recipe() -> dict[str, Any]:
    """The recipe of the plate."""
    return {
        "schema": 1,
        "kind": "plates",
        "product": f"demo plate, Data Matrix {TEXT} of ridges",
        "surface": {
            "pitch_um": PITCH_UM,
            "design": {"ridge_angle_deg": RIDGE_ANGLE_DEG, "u_ridge_angle_deg": 0.1, "edge_radius_um": 0.0},
        },
        "material": {
            "alpha_along": float(np.hypot(LOBE["alpha_along"], RESOLVED_ALPHA)),
            "alpha_across": float(np.hypot(LOBE["alpha_across"], RESOLVED_ALPHA)),
            "albedo": LOBE["albedo"],
            "index": LOBE["index"],
            "u_tail": 0.0,
            "u_alpha_share": 0.03,
            "u_albedo": 0.006,
            "u_index": 0.005,
        },
        "plan": {"file": "plan.csv", "module_mm": MODULE_MM, "facet_azimuths_deg": AZIMUTHS_DEG},
        "code": {"text": TEXT, "symbology": "datamatrix", "read_at_deg": READ_AT_DEG},
        "poses": {"angles_deg": ANGLES_DEG},
        "acquisition": {"exposure_s": 0.006, "frames_per_pose": 4, "dark_frames": 8, "settle_s": 0.0},
        "region": {"size_mm": [2.4, 2.4]},
        "decision": {"tolerance": 0.2, "alpha": 0.001},
        "uncertainty": {"seating_tilt_deg": 0.05},
    }


def sample(name: str, rows: tuple[str, ...], rng: np.random.Generator) -> dict[str, Any]:
    """The sample table of a part."""
    if name == "white-tile":
        return {"kind": "white-tile", "reflectance": 0.99}

    def spread(value: float, share: float) -> float:
        return float(value * (1.0 + share * rng.standard_normal()))

    defects = [{"row": row, "col": col, "defect": "missing"} for row, col in DEAD]
    return {
        "kind": "plate",
        "size_mm": 2.4,
        "seating_tilt_deg": [float(tilt) for tilt in 0.05 * rng.standard_normal(2)],
        "plate": {
            "plan": list(rows),
            "facet_azimuths_deg": AZIMUTHS_DEG,
            "module_mm": MODULE_MM,
            "pitch_um": PITCH_UM,
            "ridge_angle_deg": RIDGE_ANGLE_DEG + float(0.1 * rng.standard_normal()),
            "resolved_alpha": RESOLVED_ALPHA,
            "edge_radius_um": WORN_UM if name == "worn" else 0.0,
            "defects": defects if name == "dead-fields" else [],
        },
        "material": {
            "alpha_along": spread(LOBE["alpha_along"], 0.03),
            "alpha_across": spread(LOBE["alpha_across"], 0.03),
            "albedo": spread(LOBE["albedo"], 0.03),
            "index": LOBE["index"],
        },
    }


def bench(sample: dict[str, Any], seed: int) -> dict[str, Any]:
    """The bench file about a sample."""
    return {
        "schema": 1,
        "seed": seed,
        "sample": sample,
        "sensor": {"rows": 800, "cols": 800},
        "optics": {"pixel_um": 5.0, "blur_um": 4.0},
        "fixture": FIXTURE,
    }


def rig(name: str) -> dict[str, Any]:
    """The rig file of a part; the white tile's has no flat yet."""
    found: dict[str, Any] = {
        "schema": 1,
        "name": "virtual rig",
        "stage": {
            "driver": "elliptec",
            "port": "sim://elliptec?bench=${here}/bench.toml",
            "zero_deg": 10.0,
            "options": {"address": "0"},
        },
        "camera": {"driver": "simulated", "pixel_um": 5.0, "options": {"bench": "${here}/bench.toml"}},
        "light": {"driver": "simulated", "angle_deg": 10.0, "options": {"bench": "${here}/bench.toml"}},
        "fixture": FIXTURE,
    }
    if name != "white-tile":
        found["calibration"] = {"flat": "../../flat.tif"}
    return found
