"""Render good and defective ridged parts with Mitsuba 3, and write them as frames that ``inspect --frames`` takes.

    python -Im pip install 'anisoscope[benchmark]'
    python tools/render_mitsuba_parts.py tests/data/mitsuba/parts.tar.xz [--parts NAME ...] [--work FOLDER]

What Mitsuba sees is written here from the description of a part, and shares nothing with the prediction: a triangle
mesh of the ridges with an arc of sixteen chords at every crest, a resolved texture, and a rough plastic whose light is
reflected up to five times. Every frame is traced from rays that fill its own pixels. Poses: 0, 90 and 180° at tilts
of 0, −10 and 10°; the light stands 10° from the camera. A frame has shot noise and rounds to 10 bits; markers stand
beside the part.

Good parts scatter (1 σ): ridge angle 0.1°, roughness of the lobe 5 %, both roughnesses of the texture 5 %, albedo 3 %,
seating 0.1° about both axes. Defective parts scatter alike, and have one defect more. All is drawn from one seed a
part, so that parts can be rendered one by one. What was traced is stored in the work folder, and not traced again.

The archive holds, for every part, a folder with ``frames.csv``, its frames, and ``map.png``: the height of a piece of
the mesh, 2 µm a pixel, `NM_PER_COUNT` nm a count; and once ``rig.toml``, ``white-reference.tif`` and ``parts.json``
with the true values and the standard error of the mean radiance of every pose.

Mitsuba's compiler needs LLVM 16 or later; the environment variable DRJIT_LIBLLVM_PATH names another libLLVM.so.
All parts take half an hour of processor time.
"""

import argparse
import csv
import io
import json
import lzma
import sys
import tarfile
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomli_w

from anisoscope.calibration.white_reference import make_reference, write_reference
from anisoscope.imaging.linearisation import stack
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.defect_injection import inject_defect
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.rig.fixture import Fixture
from anisoscope.rig.frame import Frame
from anisoscope.sim.bench.benchfile import OpticsPart, SensorPart
from anisoscope.sim.bench.optics import image_of_fixture, pixel_from_mm
from anisoscope.sim.light.geometry import directions, pose_grid, seating_rotation

VARIANT = "llvm_ad_mono"
SEED = 20
PITCH_UM, RIDGE_ANGLE_DEG = 100.0, 10.0
ALPHA, ALBEDO, INDEX = 0.08, 0.1, 1.5
RESOLVED_ALPHA, CORRELATION_UM = 0.03, 8.0
EDGE_UM, CHORDS = 0.5, 16
DEPTH = 6  # Mitsuba's: five reflections
NODE_UM = 4.0  # of the mesh, along the ridges and on the facets
PITCHES, LENGTH_UM = 30, 1200.0  # of the mesh; the camera sees less
PART_MM = (2.6, 0.8)
SENSOR = SensorPart(rows=216, cols=216, bit_depth=10, black_level=16.0, gain_e_per_dn=30.0)
OPTICS = OpticsPart(pixel_um=12.5, axis_px=(0.0, 0.0))
MAP_UM, MAP_SHAPE, NM_PER_COUNT = 2.0, (251, 401), 10.0
LIGHT_DEG = 10.0
POSES = pose_grid((0.0, 90.0, 180.0), (0.0, -10.0, 10.0))
EXPOSURE_S = 0.001
ELECTRONS_PER_RADIANCE = 6.0e4  # in one frame; the brightest pixels of all parts stay below full scale
TILE = 0.99
FIXTURE = {
    "marker_mm": 0.5,
    "markers": [
        {"id": 0, "x_mm": 0.87, "y_mm": 0.87},
        {"id": 1, "x_mm": -0.87, "y_mm": 0.87},
        {"id": 2, "x_mm": -0.87, "y_mm": -0.87},
        {"id": 3, "x_mm": 0.87, "y_mm": -0.87},
    ],
}


@dataclass(frozen=True)
class Part:
    """True values of a part; ``local`` is a defect of `profiles.defect_injection` with its values."""

    name: str
    ridge_angle_deg: float = RIDGE_ANGLE_DEG
    alpha: float = ALPHA
    texture: tuple[float, float] = (RESOLVED_ALPHA, RESOLVED_ALPHA)
    albedo: float = ALBEDO
    seating_deg: tuple[float, float] = (0.0, 0.0)
    edge_um: float = EDGE_UM
    height_loss: float = 0.0
    local: str = ""
    values: dict[str, float] | None = None
    seed: int = 0


DEFECTS: dict[str, dict[str, Any]] = {
    "angle-0.5": {"angle": -0.5},
    "angle+0.5": {"angle": 0.5},
    "angle-1": {"angle": -1.0},
    "angle+1": {"angle": 1.0},
    "rough+20": {"rough": 1.2},
    "rough+60": {"rough": 1.6},
    "height-loss": {"height_loss": 0.1},
    "wear-5": {"edge_um": 5.0},
    "wear-10": {"edge_um": 10.0},
    "burrs-2": {"local": "burrs", "values": {"coverage": 0.02}},
    "burrs-10": {"local": "burrs", "values": {"coverage": 0.1}},
    "scratches": {"local": "scratches", "values": {"density_per_mm2": 40.0}},
}
GOOD = [f"good-{n:02d}" for n in range(1, 16)]


def parts() -> list[Part]:
    """All parts: fifteen good ones, and one of every defect."""
    return [_drawn(name, number) for number, name in enumerate((*GOOD, *DEFECTS))]


def _drawn(name: str, number: int) -> Part:
    rng = np.random.default_rng([SEED, number])
    z = rng.standard_normal(7)
    defect = DEFECTS.get(name, {})
    rough = defect.get("rough", 1.0)
    along, across = (RESOLVED_ALPHA * rough * float(np.exp(0.05 * one)) for one in z[2:4])
    part = Part(
        name,
        RIDGE_ANGLE_DEG + defect.get("angle", 0.0) + 0.1 * float(z[0]),
        ALPHA * rough * float(np.exp(0.05 * z[1])),
        (along, across),
        ALBEDO * (1.0 + 0.03 * float(z[4])),
        (0.1 * float(z[5]), 0.1 * float(z[6])),
        seed=number,
    )
    own = {key: value for key, value in defect.items() if key not in ("angle", "rough")}
    return replace(part, **own)


def profile(part: Part) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (x, z) of one pitch in µm, from a crest to the last before the next one; the crest is an arc."""
    design = RidgeDesign(PITCH_UM, part.ridge_angle_deg, height_loss=part.height_loss)
    angle = np.radians(part.ridge_angle_deg)
    full, foot = design.full_height_um, design.facet_width_um
    x = np.arange(0.0, PITCH_UM, NODE_UM)
    corners = np.array([foot])
    if part.height_loss > 0.0:
        cut = part.height_loss * full
        corners = np.array([foot, cut / np.tan(angle), PITCH_UM - cut * np.tan(angle)])
        x = np.unique(np.concatenate([x[x < PITCH_UM - 0.01], corners]))
        return x, design.profile(x)
    # the facet falls from the crest at (0, full), the wall rises to it: both meet at a right angle
    radius = part.edge_um
    centre = np.array([0.0, full]) + radius * np.array(
        [np.cos(angle) - np.sin(angle), -np.sin(angle) - np.cos(angle)]
    )
    turn = np.linspace(
        angle - np.pi / 2.0, angle, CHORDS + 1
    )  # of the normal, from the wall's to the facet's
    arc = centre + radius * np.stack([np.sin(turn), np.cos(turn)], axis=-1)
    first, last = arc[0, 0] + PITCH_UM, arc[-1, 0]
    inner = np.unique(np.concatenate([x[(x > last + 0.2) & (x < min(first - 0.2, foot))], corners]))
    points = np.concatenate(
        [np.stack([inner, design.profile(inner)], axis=-1), arc + np.array([PITCH_UM, 0.0])]
    )
    points[:, 0] -= PITCH_UM * (points[:, 0] >= PITCH_UM)
    points = points[np.argsort(points[:, 0])]
    return points[:, 0], points[:, 1]


def mesh(part: Part) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes x (N,), y (M,) in µm about the axis, and heights (M, N) in µm above the foot."""
    x, z = profile(part)
    whole_x = np.concatenate([x + n * PITCH_UM for n in range(PITCHES)]) - PITCHES * PITCH_UM / 2.0
    y = np.arange(0.0, LENGTH_UM + 1e-9, NODE_UM) - LENGTH_UM / 2.0
    height = np.broadcast_to(np.tile(z, PITCHES), (len(y), len(whole_x))).copy()
    rng = np.random.default_rng([SEED, part.seed, 1])
    cells = round(PITCHES * PITCH_UM / NODE_UM) + 1
    flat = HeightMap(np.zeros((len(y), cells)), NODE_UM, NODE_UM, {})
    along, across = part.texture
    added = add_facet_roughness(flat, along, across, CORRELATION_UM, rng).height_um
    if part.local:
        design = RidgeDesign(PITCH_UM, RIDGE_ANGLE_DEG)
        fine = ridges(design, (len(y), 4 * cells - 3), (NODE_UM, NODE_UM / 4.0))
        spoiled = inject_defect(fine, part.local, rng, values=part.values or {}).height_um - fine.height_um
        height += _sampled(spoiled, NODE_UM / 4.0, whole_x)
    return whole_x, y, height + _sampled(added, NODE_UM, whole_x)


def _sampled(field: np.ndarray, step_um: float, x: np.ndarray) -> np.ndarray:
    """(M, N) rows of a field, linear between its columns, at positions about the axis."""
    position = (x + PITCHES * PITCH_UM / 2.0) / step_um
    left = np.clip(position.astype(int), 0, field.shape[1] - 2)
    share = position - left
    return (1.0 - share) * field[:, left] + share * field[:, left + 1]


def height_map(part: Part) -> np.ndarray:
    """(rows, cols) heights in µm of the middle of the mesh, 2 µm a pixel, row index rising with y."""
    x, y, height = mesh(part)
    rows, cols = MAP_SHAPE
    to_x = (np.arange(cols) - (cols - 1) / 2.0) * MAP_UM
    to_y = (np.arange(rows) - (rows - 1) / 2.0) * MAP_UM
    across = np.array([np.interp(to_x, x, line) for line in height])
    position = (to_y - y[0]) / NODE_UM
    low = np.clip(position.astype(int), 0, len(y) - 2)
    share = (position - low)[:, None]
    return (1.0 - share) * across[low] + share * across[low + 1]


def window(pose: Pose) -> tuple[slice, slice]:
    """Rows and columns of the sensor that see the part at 0, 90 or 180°."""
    along, across = (round(1000.0 * size / OPTICS.pixel_um) for size in reversed(PART_MM))
    rows, cols = (across, along) if round(pose.stage_deg / 90.0) % 2 else (along, across)
    rows -= rows - 2 * int(rows * np.cos(np.radians(pose.tilt_deg)) / 2.0)
    return tuple(  # type: ignore[return-value]
        slice((size - own) // 2, (size + own) // 2)
        for size, own in ((SENSOR.rows, rows), (SENSOR.cols, cols))
    )


@dataclass(frozen=True)
class Eye:
    """Lens and sensor that look at what is traced."""

    optics: OpticsPart
    sensor: SensorPart


EYE = Eye(OPTICS, SENSOR)


class Tracer:
    """Mitsuba's path tracer on a height field of rough plastic.

    Args:
        x, y: (N,) and (M,) places of the nodes in µm about the axis.
        height: (M, N) in µm.
        alpha, albedo: of the plastic.
    """

    def __init__(self, x: np.ndarray, y: np.ndarray, height: np.ndarray, alpha: float, albedo: float) -> None:
        import drjit  # noqa: PLC0415 - the optional extra
        import mitsuba  # noqa: PLC0415

        mitsuba.set_variant(VARIANT)
        self.mi, self.dr = mitsuba, drjit
        self.mean_um, self.top_um = float(height.mean()), float(height.max()) + 1.0
        rows, cols = height.shape
        points = np.stack([*np.meshgrid(x, y), height], axis=-1)
        corner = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).ravel()
        faces = np.concatenate(
            [
                np.stack([corner, corner + 1, corner + cols + 1], axis=-1),
                np.stack([corner, corner + cols + 1, corner + cols], axis=-1),
            ]
        )
        properties = mitsuba.Properties()
        properties["bsdf"] = mitsuba.load_dict(
            {
                "type": "roughplastic", "distribution": "beckmann", "alpha": alpha, "int_ior": INDEX,
                "ext_ior": 1.0, "nonlinear": True, "diffuse_reflectance": albedo,
            }
        )  # fmt: skip
        properties["face_normals"] = True
        shape = mitsuba.Mesh("part", points.shape[0] * points.shape[1], len(faces), props=properties)
        parameters = mitsuba.traverse(shape)
        parameters["vertex_positions"] = mitsuba.Float(points.astype(np.float32).ravel())
        parameters["faces"] = mitsuba.UInt32(faces.astype(np.uint32).ravel())
        parameters.update()
        self.shape = shape

    def radiance(
        self,
        pose: Pose,
        seating_deg: tuple[float, float],
        samples: int,
        seeds: tuple[int, int],
        inside: tuple[slice, slice],
        eye: Eye = EYE,
    ) -> np.ndarray:
        """(rows, cols) radiance in 1/sr of a window of the sensor under unit irradiance; ``samples`` rays a pixel."""
        mi, dr = self.mi, self.dr
        seat = seating_rotation(*seating_deg)
        to_light, to_camera = (
            side[0] @ seat for side in directions((pose,), Convention(light_angle_deg=LIGHT_DEG))
        )
        scene = mi.load_dict(
            {
                "type": "scene",
                "part": self.shape,
                "lamp": {"type": "directional", "direction": (-to_light).tolist(), "irradiance": 1.0},
            }
        )
        integrator = mi.load_dict({"type": "path", "max_depth": DEPTH, "rr_depth": DEPTH + 1})
        rows, cols = inside
        grid = np.stack(
            np.meshgrid(np.arange(cols.start, cols.stop), np.arange(rows.start, rows.stop)), axis=-1
        )
        shape = grid.shape[:2]
        pixels = np.repeat(grid.reshape(-1, 2), samples, axis=0).astype(np.float64)
        rng = np.random.default_rng([SEED, seeds[0], 2, seeds[1]])
        pixels += rng.random(pixels.shape) - 0.5
        affine = pixel_from_mm(eye.optics, eye.sensor, pose.stage_deg, pose.tilt_deg)
        um = 1000.0 * (pixels - affine[:, 2]) @ np.linalg.inv(affine[:, :2]).T
        # parallel rays that meet the plane of the mean height there
        lift = (self.top_um - self.mean_um) / to_camera[2]
        origin = np.column_stack([um + lift * to_camera[:2], np.full(len(um), self.top_um)])
        ray = mi.RayDifferential3f(
            mi.Point3f(*(mi.Float(one.astype(np.float32)) for one in origin.T)),
            mi.Vector3f(*(-to_camera).tolist()),
        )
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(1000 * seeds[0] + seeds[1], len(um))
        found = integrator.sample(scene, sampler, ray)[0]
        dr.eval(found)
        values = np.array(found).ravel().reshape(-1, samples).mean(axis=1)
        return values.reshape(shape)


def traced(part: Part, passes: int, samples: int) -> dict[str, np.ndarray]:
    """Radiance of every pose, ``pose0`` …, and (P,) relative standard errors of their means."""
    tracer = Tracer(*mesh(part), part.alpha, part.albedo)
    found, errors = {}, []
    for number, pose in enumerate(POSES):
        runs = np.array(
            [
                tracer.radiance(
                    pose, part.seating_deg, samples, (part.seed, number * passes + one), window(pose)
                )
                for one in range(passes)
            ]
        )
        found[f"pose{number}"] = runs.mean(axis=0).astype(np.float32)
        means = runs.mean(axis=(1, 2))
        scatter = np.std(runs - runs.mean(axis=0), axis=0, ddof=1)  # of every pixel
        errors.append(np.sqrt(np.mean(scatter**2) / (passes * scatter.size)) / means.mean())
    return {**found, "error": np.array(errors)}


def frame(
    radiance: np.ndarray | None,
    pose: Pose,
    rng: np.random.Generator,
    inside: tuple[slice, slice],
    fixture: dict[str, Any] = FIXTURE,
    eye: Eye = EYE,
) -> np.ndarray:
    """(rows, cols) counts of one frame; without a part its dark frame."""
    sensor = eye.sensor
    black = np.full((sensor.rows, sensor.cols), sensor.black_level)
    if radiance is None:
        return black.astype(np.uint16)
    cosine = float(directions((pose,), Convention(light_angle_deg=LIGHT_DEG))[0][0, 2])
    around = image_of_fixture(
        Fixture.model_validate(fixture), eye.optics, sensor, pose.stage_deg, pose.tilt_deg
    )
    electrons = around.astype(np.float64) / np.pi * cosine * ELECTRONS_PER_RADIANCE
    signal = radiance * ELECTRONS_PER_RADIANCE
    electrons[inside] = signal + np.sqrt(np.maximum(signal, 0.0)) * rng.standard_normal(signal.shape)
    counts = np.rint(black + electrons / sensor.gain_e_per_dn)
    return np.clip(counts, 0, 2**sensor.bit_depth - 1).astype(np.uint16)


Shot = tuple[str, str, Pose, np.ndarray | None, int]
"""Kind and file of a frame, its pose, what was traced, and whether it repeats the first pose."""


def write_frames(
    folder: Path,
    shots: Sequence[Shot],
    rng: np.random.Generator,
    window_of: Callable[[Pose], tuple[slice, slice]],
    fixture: dict[str, Any] = FIXTURE,
    eye: Eye = EYE,
) -> None:
    """Frames and their table, ``frames.csv``."""
    columns = "file,kind,stage_deg,tilt_deg,exposure_s,gain,bit_depth,black_level,again"
    with (folder / "frames.csv").open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(columns.split(","))
        for kind, name, pose, radiance, again in shots:
            _write_png(folder / name, frame(radiance, pose, rng, window_of(pose), fixture, eye))
            table.writerow(
                [
                    name, kind, f"{pose.stage_deg:g}", f"{pose.tilt_deg:g}", EXPOSURE_S, 1.0, eye.sensor.bit_depth,
                    eye.sensor.black_level, again,
                ]
            )  # fmt: skip


def write_part(part: Part, found: dict[str, np.ndarray], folder: Path) -> None:
    """The folder of a part: frames, their table, and the height map."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng([SEED, part.seed, 3])
    shots: list[Shot] = [("dark", "dark.png", POSES[0], None, 0)]
    for number, pose in enumerate(POSES):
        name = f"{number}_{pose.stage_deg:03.0f}_{pose.tilt_deg:+03.0f}.png"
        shots.append(("sample", name, pose, found[f"pose{number}"], 0))
    shots.append(("sample", "again.png", POSES[0], found["pose0"], 1))
    write_frames(folder, shots, rng, window)
    counts = np.rint(height_map(part) * 1000.0 / NM_PER_COUNT)
    _write_png(folder / "map.png", np.clip(counts + 1000.0, 0, 65535).astype(np.uint16))


def _write_png(path: Path, counts: np.ndarray) -> None:
    path.write_bytes(cv2.imencode(".png", counts, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes())


def write_rig(folder: Path, fixture: dict[str, Any] = FIXTURE, eye: Eye = EYE) -> None:
    """Rig file, and the white reference of an even tile on the same camera."""
    electrons = TILE / np.pi * np.cos(np.radians(LIGHT_DEG)) * ELECTRONS_PER_RADIANCE
    level = round(eye.sensor.black_level + electrons / eye.sensor.gain_e_per_dn)

    def even(kind: str, counts: float) -> Frame:
        image = np.full((eye.sensor.rows, eye.sensor.cols), counts, dtype=np.uint16)
        return Frame(
            image,
            kind,
            eye.sensor.bit_depth,
            eye.sensor.black_level,
            EXPOSURE_S,
            1.0,
            0.0,
            0.0,
            0.0,
            "",
            "mitsuba",
        )  # type: ignore[arg-type]

    white = make_reference(
        stack(even("flat", level) for _ in range(2)),
        stack(even("dark", eye.sensor.black_level) for _ in range(2)),
        reflectance=TILE,
        light_cosine=float(np.cos(np.radians(LIGHT_DEG))),
        camera="mitsuba",
        full_scale=2**eye.sensor.bit_depth - 1,
    )
    write_reference(folder / "white-reference.tif", white)
    rig = {
        "schema": 1,
        "name": "Mitsuba 3",
        "camera": {"pixel_um": eye.optics.pixel_um},
        "light": {"angle_deg": LIGHT_DEG},
        "fixture": fixture,
        "calibration": {"flat": "white-reference.tif"},
    }
    (folder / "rig.toml").write_text(tomli_w.dumps(rig), encoding="utf-8")


def pack(folder: Path, archive: Path) -> None:
    """Archive a folder; equal folders make equal archives."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as tar:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                entry = tarfile.TarInfo(path.relative_to(folder).as_posix())
                entry.size = path.stat().st_size
                tar.addfile(entry, io.BytesIO(path.read_bytes()))
    archive.parent.mkdir(parents=True, exist_ok=True)
    archive.write_bytes(lzma.compress(stream.getvalue(), preset=9))


def main() -> None:
    """Render what is missing and pack all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("archive", type=Path, help="archive to write, .tar.xz")
    parser.add_argument("--parts", nargs="*", help="names of the parts; all by default")
    parser.add_argument("--work", type=Path, help="folder of what was traced; a temporary one by default")
    parser.add_argument("--passes", type=int, default=4)
    parser.add_argument("--samples", type=int, default=24, help="rays a pixel in every pass")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        work = given.work or Path(scratch) / "traced"
        work.mkdir(parents=True, exist_ok=True)
        folder = Path(scratch) / "parts"
        folder.mkdir()
        table = {}
        for part in parts():
            if given.parts and part.name not in given.parts:
                continue
            stored = work / f"{part.name}.npz"
            if not stored.is_file():
                np.savez_compressed(stored, **traced(part, given.passes, given.samples))
            with np.load(stored) as found:
                radiance = dict(found)
            write_part(part, radiance, folder / part.name)
            table[part.name] = asdict(part) | {"error": [round(float(e), 6) for e in radiance["error"]]}
            errors = " ".join(f"{100.0 * error:.2f}" for error in radiance["error"])
            sys.stderr.write(f"{part.name}: {errors} % standard error\n")
        write_rig(folder)
        (folder / "parts.json").write_text(json.dumps(table, indent=1), encoding="utf-8")
        pack(folder, given.archive)


if __name__ == "__main__":
    main()
