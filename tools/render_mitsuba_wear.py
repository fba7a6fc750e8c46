"""Render worn ridges with Mitsuba 3: reference radiances of poses by radius of the crests.

    python -Im pip install 'anisoscope[benchmark]'
    python tools/render_mitsuba_wear.py tests/data/mitsuba/wear.json [--rays MILLIONS]

Smooth ridges of a 10° facet and a perpendicular wall, pitch 100 µm, whose crests are arcs of so many chords that each
turns by less than a degree: prisms of plane faces, written here from the description. The plastic is Mitsuba's rough
plastic (Beckmann, index 1.5); light reflects once (``direct``) or up to eight times (``all``). Parallel rays meet one
pitch in the middle evenly. Every value comes with the standard error of its rays, from `BATCHES` equal parts.

Mitsuba's compiler needs LLVM 16 or later; the environment variable DRJIT_LIBLLVM_PATH names another libLLVM.so.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light.geometry import directions, pose_grid

VARIANT = "llvm_ad_mono"
SEED, BATCHES = 21, 16
PITCH_UM, RIDGE_ANGLE_DEG, LIGHT_DEG, INDEX = 100.0, 10.0, 10.0, 1.5
RADII_UM = (0.0, 2.5, 5.0, 10.0, 20.0)
PLASTICS = {"smooth, dark": (0.08, 0.1), "rough, bright": (0.15, 0.4)}
"""Roughness and albedo."""
POSES = pose_grid((0.0, 90.0, 180.0), (0.0, -10.0, 10.0))
CHORDS, PITCHES, LENGTH_UM = 96, 40, 6000.0
DEPTHS = {"direct": 2, "all": 9}  # Mitsuba counts the lamp as one


def profile(radius_um: float) -> np.ndarray:
    """(N, 2) nodes x, z in µm of one pitch, from its crest to the foot of the wall."""
    design, angle = RidgeDesign(PITCH_UM, RIDGE_ANGLE_DEG), np.radians(RIDGE_ANGLE_DEG)
    foot, top = [design.facet_width_um, 0.0], np.array([0.0, design.full_height_um])
    if radius_um == 0.0:
        return np.array([top, foot])
    # facet and wall meet at a right angle: the centre lies one radius below both
    centre = top + radius_um * np.array([np.cos(angle) - np.sin(angle), -np.sin(angle) - np.cos(angle)])
    turn = np.linspace(angle - np.pi / 2.0, angle, CHORDS + 1)
    return np.vstack([centre + radius_um * np.stack([np.sin(turn), np.cos(turn)], axis=-1), foot])


def mesh(radius_um: float, alpha: float, albedo: float) -> Any:  # noqa: ANN401 - of the optional extra
    """Prisms of all pitches."""
    import mitsuba as mi  # noqa: PLC0415 - the optional extra

    one = profile(radius_um)
    line = np.concatenate([one + np.array([PITCH_UM * n, 0.0]) for n in range(-PITCHES // 2, PITCHES // 2)])
    count, half = len(line), LENGTH_UM / 2.0
    points = np.concatenate([np.insert(line, 1, end, axis=1) for end in (-half, half)])
    near = np.arange(count - 1)
    far = near + count
    faces = np.concatenate([np.stack([near, near + 1, far + 1], -1), np.stack([near, far + 1, far], -1)])
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(
        {
            "type": "roughplastic", "distribution": "beckmann", "alpha": alpha, "int_ior": INDEX, "ext_ior": 1.0,
            "nonlinear": True, "diffuse_reflectance": albedo,
        }
    )  # fmt: skip
    properties["face_normals"] = True
    shape = mi.Mesh("ridges", len(points), len(faces), props=properties)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mi.Float(points.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    parameters.update()
    return shape


def radiance(
    shape: Any,  # noqa: ANN401 - of the optional extra
    sides: tuple[np.ndarray, np.ndarray],
    depth: int,
    rays: int,
) -> tuple[float, float]:
    """Mean radiance in 1/sr under unit irradiance, and its standard error."""
    import mitsuba as mi  # noqa: PLC0415 - the optional extra

    to_light, to_camera = sides
    lamp = {"type": "directional", "direction": (-to_light).tolist(), "irradiance": 1.0}
    scene = mi.load_dict({"type": "scene", "ridges": shape, "lamp": lamp})
    integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": depth + 1})
    top = RidgeDesign(PITCH_UM, RIDGE_ANGLE_DEG).full_height_um + 1.0
    means = []
    for batch in range(BATCHES):
        rng = np.random.default_rng([SEED, batch])
        count = rays // BATCHES
        x = PITCH_UM * (np.arange(count) + rng.random(count)) / count
        start = np.zeros((count, 3))
        start[:, 0] = x
        start += to_camera * (top / to_camera[2])  # they meet z = 0 evenly over the pitch
        origin = mi.Point3f(*(mi.Float(one.astype(np.float32)) for one in start.T))
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(1000 * SEED + batch, count)
        ray = mi.RayDifferential3f(origin, mi.Vector3f(*(-to_camera).tolist()))
        means.append(float(np.array(integrator.sample(scene, sampler, ray)[0]).mean(dtype=np.float64)))
    return float(np.mean(means)), float(np.std(means, ddof=1) / np.sqrt(BATCHES))


def rendered(rays: int) -> dict[str, Any]:
    """The whole table."""
    import mitsuba  # noqa: PLC0415 - the optional extra

    mitsuba.set_variant(VARIANT)
    to_light, to_camera = directions(POSES, Convention(LIGHT_DEG))
    rows = []
    for plastic, (alpha, albedo) in PLASTICS.items():
        for radius in RADII_UM:
            shape = mesh(radius, alpha, albedo)
            row: dict[str, Any] = {"plastic": plastic, "radius_um": radius}
            for name, depth in DEPTHS.items():
                pairs = [radiance(shape, side, depth, rays) for side in zip(to_light, to_camera, strict=True)]
                row[name] = [float(f"{value:.6g}") for value, _ in pairs]
                row[f"{name}_error"] = [float(f"{error:.2g}") for _, error in pairs]
            worst = 100.0 * max(e / v for e, v in zip(row["all_error"], row["all"], strict=True))
            sys.stderr.write(f"{plastic}, {radius:g} µm: standard error at most {worst:.2f} %\n")
            rows.append(row)
    return {
        "mitsuba": mitsuba.__version__,
        "seed": SEED,
        "rays": rays,
        "reflections": {name: depth - 1 for name, depth in DEPTHS.items()},
        "pitch_um": PITCH_UM,
        "ridge_angle_deg": RIDGE_ANGLE_DEG,
        "light_angle_deg": LIGHT_DEG,
        "index": INDEX,
        "chords": CHORDS,
        "plastics": {name: {"alpha": alpha, "albedo": albedo} for name, (alpha, albedo) in PLASTICS.items()},
        "poses": [[pose.stage_deg, pose.tilt_deg] for pose in POSES],
        "rows": rows,
    }


def main() -> None:
    """Render the table and write it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("table", type=Path, help="table to write, .json")
    parser.add_argument("--rays", type=float, default=8.0, help="millions of rays for every value")
    given = parser.parse_args()
    found = rendered(int(1e6 * given.rays))
    given.table.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
