"""Render plates with Mitsuba 3, and write them as frames that ``inspect --frames`` takes.

    python -Im pip install 'anisoscope[benchmark]'
    python tools/render_mitsuba_plates.py tests/data/mitsuba/plates.tar.xz [--rays 32]

A plate is a triangle mesh of its height map, 2 µm a node: a Data Matrix of ridges whose fields differ in ridge angle
(0.1°), of a rough plastic that reflects light up to five times; light goes from field to field, as on a real plate.
Plates differ in roughness (5 %), albedo (3 %) and seat (0.05°). Frames have shot noise and round to 10 bits. The
archive holds a folder with ``frames.csv`` and frames for every plate, and once ``recipe.toml``, ``rig.toml``,
``white-reference.tif`` and ``plates.json`` with the true values.

Mitsuba's compiler needs LLVM 16 or later, that of 3.9 LLVM 19; the environment variable DRJIT_LIBLLVM_PATH names
another libLLVM.so.
"""

import argparse
import json
import sys
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

sys.path.insert(0, str(Path(__file__).resolve().parent))
from render_mitsuba_parts import EXPOSURE_S, Eye, Shot, Tracer, pack, write_frames, write_rig

from anisoscope.operations.demo import plates as demo
from anisoscope.operations.demo.folder import FIXTURE
from anisoscope.parameters.geometry import Pose
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.plates import Plan, height_of_field
from anisoscope.sim.bench.benchfile import OpticsPart, SensorPart

SEED = 21
NODE_UM = 2.0
ALPHA, ALBEDO = 0.1, 0.15
EYE = Eye(
    OpticsPart(pixel_um=12.5, axis_px=(0.0, 0.0)),
    SensorPart(rows=304, cols=304, bit_depth=10, black_level=16.0, gain_e_per_dn=30.0),
)
POSES = tuple(Pose(angle, 0.0) for angle in (0.0, 90.0, 180.0))


@dataclass(frozen=True)
class Plate:
    """True values of a plate; ``defects`` by name with the (row, column) of their fields, and radius of worn crests."""

    name: str
    alpha: float
    albedo: float
    seating_deg: tuple[float, float]
    defects: dict[str, list[tuple[int, int]]]
    seed: int
    worn_um: float = 0.2 * demo.PITCH_UM


def plates() -> tuple[Plate, ...]:
    """Two good plates, one with dead fields, one with a worn field, one with a field turned, two worn all over."""
    every = [(row, col) for row in range(len(plan().rows)) for col in range(len(plan().rows))]
    defects: dict[str, dict[str, list[tuple[int, int]]]] = {
        "good-1": {},
        "good-2": {},
        "dead": {"missing": [(3, 4), (6, 8), (9, 2)]},
        "one-worn": {"worn": [(4, 5)]},
        "turned-field": {"direction": [(7, 3)]},
        "all-worn-10": {"worn": every},
        "all-worn-15": {"worn": every},
    }
    found = []
    for number, (name, own) in enumerate(defects.items()):
        rng = np.random.default_rng([SEED, number])
        alpha, albedo = (
            ALPHA * (1.0 + 0.05 * rng.standard_normal()),
            ALBEDO * (1.0 + 0.03 * rng.standard_normal()),
        )
        x, y = 0.05 * rng.standard_normal(2)
        worn_um = {"worn_um": 15.0} if name == "all-worn-15" else {}
        seat = float(x), float(y)
        found.append(Plate(name, float(alpha), float(albedo), seat, own, number, **worn_um))
    return tuple(found)


def plan() -> Plan:
    """The plan of the demo."""
    return Plan(demo.plan_rows(), demo.AZIMUTHS_DEG, demo.MODULE_MM)


def heights(plate: Plate) -> np.ndarray:
    """(rows, cols) heights of the nodes in µm, row index rising with +y."""
    of, module_um = plan(), 1000.0 * demo.MODULE_MM
    steps, rng = round(module_um / NODE_UM), np.random.default_rng([SEED, plate.seed, 1])
    rows, cols = of.shape
    found = np.empty((rows * steps, cols * steps))
    for row in range(rows):
        for col in range(cols):
            azimuth = of.azimuths_deg[of.rows[row][col]]
            design = RidgeDesign(demo.PITCH_UM, demo.RIDGE_ANGLE_DEG + 0.1 * float(rng.standard_normal()))
            if (row, col) in plate.defects.get("worn", []):
                design = replace(design, edge_radius_um=plate.worn_um)
            if (row, col) in plate.defects.get("direction", []):
                azimuth = next(one for one in of.azimuths_deg.values() if one != azimuth)
            tile = height_of_field(design, module_um, azimuth, steps)
            if (row, col) in plate.defects.get("missing", []):
                tile = np.full((steps, steps), 0.5 * design.height_um)
            low = (rows - 1 - row) * steps
            found[low : low + steps, col * steps : (col + 1) * steps] = tile
    return found


def recipe() -> dict[str, Any]:
    """The recipe of these plates."""
    table = demo.recipe()
    table["product"] = "plate rendered by Mitsuba"
    table["plan"] = table["plan"] | {"file": "plan.csv"}
    table["material"] = table["material"] | {
        "alpha_along": ALPHA,
        "alpha_across": ALPHA,
        "albedo": ALBEDO,
        "u_alpha_share": 0.05,
        "u_albedo": 0.005,
    }
    table["acquisition"] = {"exposure_s": EXPOSURE_S, "frames_per_pose": 2, "dark_frames": 2}
    return table


def write_plate(plate: Plate, folder: Path, rays: int) -> list[float]:
    """Frames of a plate; returns the mean radiance of every pose."""
    folder.mkdir(parents=True)
    height = heights(plate)
    y, x = ((np.arange(count) - (count - 1) / 2.0) * NODE_UM for count in height.shape)
    tracer = Tracer(x, y, height, plate.alpha, plate.albedo)
    half = round(500.0 * demo.MODULE_MM * len(plan().rows) / EYE.optics.pixel_um)
    rows, cols = (slice(size // 2 - half, size // 2 + half) for size in (EYE.sensor.rows, EYE.sensor.cols))
    shots: list[Shot] = [("dark", "dark.png", POSES[0], None, 0)]
    means = []
    for number, pose in enumerate(POSES):
        seeds = (100 + plate.seed, number)
        shown = tracer.radiance(pose, plate.seating_deg, rays, seeds, (rows, cols), EYE)
        means.append(float(shown.mean()))
        shots.append(("sample", f"{number}_{pose.stage_deg:03.0f}.png", pose, shown, 0))
    shots.append(("sample", "again.png", POSES[0], shots[1][3], 1))
    rng = np.random.default_rng([SEED, plate.seed, 3])
    write_frames(folder, shots, rng, lambda _pose: (rows, cols), FIXTURE, EYE)
    return means


def main() -> None:
    """Render all plates and pack them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("archive", type=Path, help="archive to write, .tar.xz")
    parser.add_argument("--rays", type=int, default=32, help="rays a pixel")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder, table = Path(scratch), {}
        for plate in plates():
            means = write_plate(plate, folder / plate.name, given.rays)
            table[plate.name] = asdict(plate) | {"mean": [round(one, 5) for one in means]}
            sys.stderr.write(f"{plate.name}: {table[plate.name]['mean']}\n")
        write_rig(folder, FIXTURE, EYE)
        (folder / "recipe.toml").write_text(tomli_w.dumps(recipe()), encoding="utf-8")
        rows = "\n".join(",".join(row) for row in plan().rows)
        (folder / "plan.csv").write_text(rows + "\n", encoding="utf-8")
        (folder / "plates.json").write_text(json.dumps(table, indent=1), encoding="utf-8")
        pack(folder, given.archive)


if __name__ == "__main__":
    main()
