"""Plates on the virtual rig: the demo (a Data Matrix of ridges, good, with three dead fields, and worn), and trials."""

import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tomli_w

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT
from anisoscope.base.progress import Advance
from anisoscope.base.regular_file import bounded_text
from anisoscope.operations.demo.folder import (
    FIXTURE,
    TILE,
    Files,
    Scene,
    flat_of,
    rig_table,
    tile_sample,
    write_benches,
)
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.plates import Plan

if TYPE_CHECKING:
    from anisoscope.kinds.kind import AnyKind
    from anisoscope.record.schema import Record
    from anisoscope.report.inspection_page import Pictures, Sections

PARTS = {"good": "PASS", "dead-fields": "FAIL", "worn": "FAIL"}
TEXT = "A17"
PITCH_UM, RIDGE_ANGLE_DEG = 50.0, 10.0
MODULE_MM = 0.2
AZIMUTHS_DEG = {"A": 0.0, "B": -90.0}
LOBE = {"alpha_along": 0.055, "alpha_across": 0.095, "albedo": 0.2, "index": 1.5}
KNOWN_PLASTIC = {"u_tail": 0.0, "u_alpha_share": 0.03, "u_albedo": 0.006, "u_index": 0.005}
RESOLVED_ALPHA = 0.03
DEAD = ((3, 4), (6, 8), (9, 2))
WORN_UM = 20.0
"""Radius of the crests of the worn plate."""
EXPOSURE_S = 0.006
READ_AT_DEG = [0.0, 90.0]
ANGLES_DEG = [*READ_AT_DEG, 180.0]
"""At 180° worn and filled ridges shine, which face away otherwise."""


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
            **KNOWN_PLASTIC,
        },
        "plan": {"file": "plan.csv", "module_mm": MODULE_MM, "facet_azimuths_deg": AZIMUTHS_DEG},
        "code": {"text": TEXT, "symbology": "datamatrix", "read_at_deg": READ_AT_DEG},
        "poses": {"angles_deg": ANGLES_DEG},
        "acquisition": {"exposure_s": EXPOSURE_S, "frames_per_pose": 4, "dark_frames": 8, "settle_s": 0.0},
        "region": {"size_mm": [2.4, 2.4]},
        "decision": {"tolerance": 0.3, "alpha": 0.001, "unexcluded": "inconclusive"},
        "uncertainty": {"seating_tilt_deg": 0.05},
    }


def sample(name: str, rows: tuple[str, ...], rng: np.random.Generator) -> dict[str, Any]:
    """The sample table of a part."""
    if name == TILE:
        return tile_sample()

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
    return rig_table("virtual rig", {"pixel_um": 5.0}, {"angle_deg": 10.0}, flat=flat_of(name))


def _recipe(folder: Path, _rng: np.random.Generator, _advance: Advance) -> dict[str, Any]:
    plan = "\n".join(",".join(row) for row in plan_rows()) + "\n"
    (folder / "plan.csv").write_text(plan, encoding="utf-8")
    return recipe()


def _files(name: str, rng: np.random.Generator) -> Files:
    return bench(sample(name, plan_rows(), rng), int(rng.integers(2**31))), rig(name)


SCENE = Scene(PARTS, 150, _recipe, _files, EXPOSURE_S)


MOST_TRIAL_MM, TRIAL_PIXELS, TRIAL_STATES = 8.0, 10, 20
"""Largest plate of a trial, pixels of the camera along a field, and states of the ridges of all classes together."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A designed plate as the virtual rig sees it.

    Attributes:
        radiance: (K, rows, cols) mean radiance of the middle of every field in 1/sr.
        verdict: of its inspection.
        report: page of the inspection.
    """

    radiance: FloatArray = field(metadata=LEFT_OUT)
    verdict: str
    report: Path


def check_trial(plan: Plan) -> None:
    """Check that the virtual rig takes a plate.

    Raises:
        UsageError: it is too large.
    """
    if max(plan.size_mm) > MOST_TRIAL_MM * (1.0 + 1e-9):
        raise UsageError(
            f"a plate of {plan.size_mm[0]:g} mm × {plan.size_mm[1]:g} mm is too large for --trial (at most "
            f"{MOST_TRIAL_MM:g} mm): take a smaller --field-count"
        )


def photograph(
    folder: Path, plan: Plan, design: RidgeDesign, lobe: dict[str, float], advance: Advance
) -> Trial:
    """Make a toleranced plate, and inspect it on a virtual rig below ``trial/``.

    The recipe is that of the folder, but that the plastic is known as well as that of the demo.

    Args:
        folder: holds recipe and plan.
        plan: fields of the plate.
        design: their ridges.
        lobe: ``alpha_along``, ``alpha_across`` and ``albedo`` of the plastic.
        advance: progress.

    Raises:
        UsageError: the plate is too large, or cannot be measured.
    """
    from anisoscope.inspection.run import USUAL, inspect_part
    from anisoscope.kinds.plates.measurement import field_means

    check_trial(plan)
    scale = max(plan.size_mm) / 2.4
    pixel_um = 1000.0 * plan.module_mm / TRIAL_PIXELS
    place, seen = folder / "trial", list[Any]()
    usual: Any = FIXTURE
    markers = [{**one, "x_mm": scale * one["x_mm"], "y_mm": scale * one["y_mm"]} for one in usual["markers"]]
    fixture = {"marker_mm": scale * usual["marker_mm"], "markers": markers}
    resolved = (
        RESOLVED_ALPHA if min(lobe["alpha_along"], lobe["alpha_across"]) > 1.5 * RESOLVED_ALPHA else 0.0
    )
    material = lobe | {
        name: float(np.sqrt(lobe[name] ** 2 - resolved**2)) for name in ("alpha_along", "alpha_across")
    }
    table = {
        "kind": "plate",
        "size_mm": max(plan.size_mm),
        "material": material,
        "plate": {
            "plan": list(plan.rows),
            "facet_azimuths_deg": dict(plan.azimuths_deg),
            "ridge_angles_deg": dict(plan.ridge_angles_deg),
            "module_mm": plan.module_mm,
            "pitch_um": design.pitch_um,
            "draft_deg": float(np.degrees(design.draft_rad)),
            "edge_radius_um": design.edge_radius_um,
            "foot_radius_um": design.foot_radius_um,
            "resolved_alpha": resolved,
            # of two alone the mean of a class would scatter as single fields do
            "states": max(2, TRIAL_STATES // len(plan.letters)),
        },
    }
    pixels = int(np.ceil(4000.0 * scale / pixel_um))

    def files(name: str) -> Files:
        changed_bench = bench(tile_sample() if name == TILE else table, 1) | {
            "sensor": {"rows": pixels, "cols": pixels},
            "optics": {"pixel_um": pixel_um, "blur_um": 0.8 * pixel_um},
            "fixture": fixture,
        }
        changed_rig = rig(name) | {"fixture": fixture}
        changed_rig["camera"]["pixel_um"] = pixel_um
        return changed_bench, changed_rig

    write_benches(place, ("plate",), files, EXPOSURE_S, advance)
    recipe_table = tomllib.loads(bounded_text(folder / "recipe.toml"))
    recipe_table["material"] |= KNOWN_PLASTIC
    recipe_table["plan"]["file"] = "../plan.csv"
    (place / "recipe.toml").write_text(tomli_w.dumps(recipe_table), encoding="utf-8")

    def note(kind: "AnyKind", record: "Record", pictures: "Pictures") -> "Sections":
        seen.extend(pictures.aligned)
        return USUAL.sections(kind, record, pictures)

    found = inspect_part(
        place / "recipe.toml",
        place / "bench" / "plate" / "rig.toml",
        "TRIAL",
        place / "inspections",
        on_progress=advance,
        methods=replace(USUAL, sections=note),
    )
    if not seen:
        raise UsageError(f"the trial is INVALID: {'; '.join(found.record.reasons)}")
    radiance = [field_means(one, one.shape[0] // plan.shape[0], 0.7) for one in seen]
    return Trial(np.array(radiance), str(found.record.verdict), found.report)
