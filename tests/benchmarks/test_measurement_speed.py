"""How long it takes from frames in memory to a verdict, without the report, at the size of a 5-megapixel camera.

Three poses of 2448 × 2048 pixels, 12 bit: one frame a pose, or two with the first pose once more at the end; and two
dark frames. The plain version does the same sums with numpy in double precision, pose after pose: whole pictures, one
operation after the other, markers searched at full size. The two agree. Memory is that of a process of its own, from
its start on, with the frames in it.
"""

import json
import subprocess
import sys
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from anisoscope.decision.decision import decide
from anisoscope.imaging.frames import AcquiredFrames, Shot
from anisoscope.imaging.linearisation import HOT_PIXEL_SIGMA, SATURATION_SHARE, WhiteReference
from anisoscope.imaging.pose_radiance import region_grid
from anisoscope.imaging.registration.placement import locate, resample
from anisoscope.inspection.job import Job
from anisoscope.inspection.manifest import Manifest
from anisoscope.inspection.pipeline import measure_frames
from anisoscope.kinds.ridges.kind import RIDGES
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.operations.demo.folder import FIXTURE
from anisoscope.prediction.expectation import expectation
from anisoscope.rig.acquisition.plan import Pose
from anisoscope.rig.fixture import Fixture
from anisoscope.rig.frame import Frame
from anisoscope.rig.rigfile import RigFile
from anisoscope.sim.bench.benchfile import OpticsPart, SensorPart
from anisoscope.sim.bench.optics import image_of_fixture, pixel_from_mm

pytestmark = pytest.mark.benchmark

ROWS, COLS, BITS, PIXEL_UM = 2048, 2448, 12, 2.0
ANGLES = (0.0, 90.0, 180.0)
EXPOSURE_S = 0.01
MAX_MB = 600
MARKERS = Fixture.model_validate(FIXTURE)
RECIPE = {
    "schema": 1,
    "product": "ridged test plate",
    "surface": {"pitch_um": 100.0, "design": {"ridge_angle_deg": 10.0}},
    "material": {"alpha_along": 0.06, "alpha_across": 0.10, "albedo": 0.2, "u_tail": 0.0},
    "acquisition": {"exposure_s": EXPOSURE_S, "frames_per_pose": 2, "dark_frames": 2},
    "region": {"size_mm": [2.2, 2.2]},
    "decision": {"tolerance": 0.25},
}
RIG = {
    "schema": 1,
    "name": "benchmark",
    "stage": {"driver": "manual"},
    "camera": {"driver": "folder", "pixel_um": PIXEL_UM},
    "light": {"angle_deg": 10.0},
    "fixture": FIXTURE,
}


def frames(expected, rng):
    """Shots of a ridged part on its fixture, and the flat."""
    optics, sensor = OpticsPart(pixel_um=PIXEL_UM, blur_um=2.0), SensorPart(rows=ROWS, cols=COLS)
    y, x = np.meshgrid(np.linspace(-1, 1, ROWS), np.linspace(-1, 1, COLS), indexing="ij")
    shade = (1.0 - 0.15 * (x**2 + y**2) / 2).astype(np.float32)
    white, shots = 0.31, []
    per_radiance = 6000.0 * shade
    for angle, level, again in (
        *((a, v, False) for a, v in zip(ANGLES, expected.radiance, strict=True)),
        (0.0, expected.radiance[0], True),
    ):
        to_mm = np.linalg.inv(np.vstack([pixel_from_mm(optics, sensor, angle), [0, 0, 1]]))
        place = np.tensordot(to_mm[:2], np.stack([*np.indices((ROWS, COLS))[::-1], np.ones((ROWS, COLS))]), 1)
        ridges = level * (1.0 + 0.4 * np.cos(2 * np.pi * place[0] / 0.1))
        plate = image_of_fixture(MARKERS, optics, sensor, angle) / np.pi
        scene = np.where(np.abs(place).max(axis=0) < 1.15, ridges, plate).astype(np.float32) * per_radiance
        shots += [shot(scene, rng, "sample", angle, again) for _ in range(2)]
    shots += [shot(np.zeros_like(shade), rng, "dark", 0.0, False) for _ in range(2)]
    flat = WhiteReference((white * per_radiance / EXPOSURE_S).astype(np.float32), white, "X", "", 0.99, "0")
    return AcquiredFrames(tuple(shots), "X", "benchmark"), flat


def shot(scene, rng, kind, angle, again):
    noise = rng.standard_normal(scene.shape, dtype=np.float32) * np.sqrt(scene / 7.5 + 1.0)
    counts = np.clip(np.rint(64.0 + scene + noise), 0, 2**BITS - 1).astype(np.uint16)
    frame = Frame(counts, kind, BITS, 64.0, EXPOSURE_S, 1.0, angle, angle, 0.0, "2025-01-01T00:00:00Z", "X")
    return Shot(f"{kind}-{angle:g}.tif", "0" * 64, frame, Pose(angle, 0.0), again, 1, check=False)


def plain_stack(group):
    cube = np.stack([one.frame.counts for one in group]).astype(np.float64)
    return cube.mean(axis=0), cube.std(axis=0, ddof=1), (cube >= SATURATION_SHARE * (2**BITS - 1)).any(axis=0)


def plain_location(value):
    """The corners of the markers at full size, refined by OpenCV, and a similarity through them."""
    shown = (255 * np.sqrt(np.clip(np.nan_to_num(value) / np.nanpercentile(value, 99.5), 0, 1))).astype(
        np.uint8
    )
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.adaptiveThreshWinSizeMax = 53
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(shown)
    return corners, ids


def plain(acquired, flat, recipe, places):
    """Mean radiance of every pose, as simply as numpy can: whole pictures, double precision, pose after pose."""
    dark = plain_stack([one for one in acquired.shots if one.frame.kind == "dark"])
    spread = 1.4826 * np.median(np.abs(dark[0] - np.median(dark[0]))) + 0.5
    hot = np.abs(dark[0] - np.median(dark[0])) > HOT_PIXEL_SIGMA * spread
    grid, _ = region_grid(recipe, PIXEL_UM)
    radiance, noises = [], []
    for again in (False, True):
        for angle in ANGLES[: 1 if again else 3]:
            group = [
                s
                for s in acquired.shots
                if s.frame.kind == "sample" and (s.pose.stage_deg, s.again) == (angle, again)
            ]
            mean, noise, saturated = plain_stack(group)
            signal = flat.signal.astype(np.float64)
            unlit = signal < 0.05 * np.median(signal)
            scale = flat.radiance / signal / EXPOSURE_S
            value = np.where(hot | saturated | unlit, np.nan, (mean - dark[0]) * scale)
            error = scale * np.sqrt(noise**2 / 2 + dark[1] ** 2 / 2)
            plain_location(value)
            aligned = resample(value.astype(np.float32), places[angle], grid)
            covered = resample(saturated.astype(np.float32), places[angle], grid)
            assert np.isfinite(covered).all()
            radiance.append(np.nanmean(aligned, dtype=np.float64))
            noises.append(np.sqrt(np.nanmean(resample(error.astype(np.float32), places[angle], grid) ** 2)))
    return radiance, noises


class Peak:
    """The largest resident memory of the process while it lasts, in MB."""

    def __enter__(self):
        self._done, self.mb = threading.Event(), 0.0
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        return self

    def _watch(self):
        while not self._done.wait(0.003):
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            self.mb = max(self.mb, pages * 4096 / 1e6)

    def __exit__(self, *_):
        self._done.set()
        self._thread.join()


MADE = Manifest(
    software="x",
    created_at="2025-01-01T00:00:00+00:00",
    serial="B",
    origin="frames",
    plan=None,
    frames=10,
    rig_folder=".",
    inputs=(),
)


def judged(acquired, flat, expected):
    """What is measured and decided, as for the first part after the program was started."""
    recipe = RidgeRecipe.model_validate(RECIPE)
    for name in ("unlit", "radiance_per_signal"):
        flat.__dict__.pop(name, None)  # every inspection starts with a flat just read
    job = Job("B", RIDGES, recipe, RigFile.model_validate(RIG), MARKERS, flat, ())
    _, measured, _ = measure_frames(MADE.began, job, expected, acquired)
    return measured, decide(expected, measured, recipe)


def timed(acquired, flat, expected, rounds=5):
    """Wall seconds and processor seconds of every round."""
    found = []
    for _ in range(rounds):
        start, worked = time.perf_counter(), time.process_time()
        judged(acquired, flat, expected)
        found.append((time.perf_counter() - start, time.process_time() - worked))
    return np.array(found).T


@pytest.fixture(scope="module")
def scene():
    """Expectation, frames, and flat."""
    expected = expectation(RidgeRecipe.model_validate(RECIPE), 10.0)
    return expected, *frames(expected, np.random.default_rng(1))


def test_from_frames_to_a_verdict(bench, scene):
    expected, acquired, flat = scene
    first = {s.pose.stage_deg: s.frame.counts for s in acquired.shots if s.frame.kind == "sample"}
    places = {angle: locate((counts - 64.0).astype(np.float32), MARKERS) for angle, counts in first.items()}
    recipe = RidgeRecipe.model_validate(RECIPE)
    with Peak() as theirs:
        plain(acquired, flat, recipe, places)
    found = bench.compare(
        f"10 frames of {COLS} × {ROWS} in memory to the verdict",
        {
            "measure and decide": lambda: judged(acquired, flat, expected),
            "plain numpy": lambda: plain(acquired, flat, recipe, places),
        },
    )
    measured, decision = found["measure and decide"].result
    radiance, _ = found["plain numpy"].result
    bench.note(f"peak of plain numpy {theirs.mb:.0f} MB")
    assert decision.verdict.value in {"PASS", "FAIL"}
    assert measured.radiance == pytest.approx(radiance[:3], rel=1e-4)


@pytest.mark.parametrize("shots", [1, 2])
def test_memory_from_frames_to_a_verdict(bench, scene, tmp_path, shots):
    _, acquired, flat = scene
    np.save(tmp_path / "flat.npy", flat.signal)
    for number, one in enumerate(some(acquired, shots)):
        np.save(tmp_path / f"{number}.npy", one.frame.counts)
        told = [one.frame.kind, one.pose.stage_deg, one.again, flat.radiance]
        (tmp_path / f"{number}.json").write_text(json.dumps(told))
    done = subprocess.run(
        [sys.executable, "-I", __file__, str(tmp_path)], capture_output=True, text=True, check=True
    )
    found = json.loads(done.stdout)
    bench.note(
        f"{shots} a pose, {found['frames']} frames: {found['wall_s']:.2f} s, {found['busy_s']:.2f} s of processor; "
        f"peak {found['peak_mb']:.0f} MB, of which {found['before_mb']:.0f} MB program and frames"
    )
    assert found["verdict"] in {"PASS", "FAIL"}
    assert found["peak_mb"] <= MAX_MB


def some(acquired, shots):
    """So many frames a pose; of one, without the end."""
    seen = {}
    for one in acquired.shots:
        key = one.frame.kind, one.pose, one.again
        seen[key] = seen.get(key, 0) + 1
        if one.frame.kind == "dark" or (seen[key] <= shots and not (one.again and shots == 1)):
            yield one


def memory_mb(name):
    """A line of what the system tells of this process; unlike getrusage it leaves out who started it."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name)) * 1024 / 1e6


def alone(folder):
    """One verdict from the frames of a folder, and what it took."""
    shots = []
    for number in range(len(list(folder.glob("*.json")))):
        kind, angle, again, radiance = json.loads((folder / f"{number}.json").read_text())
        counts = np.load(folder / f"{number}.npy")
        frame = Frame(
            counts, kind, BITS, 64.0, EXPOSURE_S, 1.0, angle, angle, 0.0, "2025-01-01T00:00:00Z", "X"
        )
        shots.append(Shot(str(number), "0" * 64, frame, Pose(angle, 0.0), again, 1, check=False))
    flat = WhiteReference(np.load(folder / "flat.npy"), radiance, "X", "", 0.99, "0")
    acquired, expected = (
        AcquiredFrames(tuple(shots), "X", "benchmark"),
        expectation(RidgeRecipe.model_validate(RECIPE), 10.0),
    )
    before_mb = memory_mb("VmRSS")
    _, decision = judged(acquired, flat, expected)
    peak_mb = memory_mb("VmHWM")
    times, busy = timed(acquired, flat, expected, 3)
    told = {
        "frames": len(shots),
        "verdict": decision.verdict.value,
        "before_mb": before_mb,
        "peak_mb": peak_mb,
    }
    print(json.dumps(told | {"wall_s": times.min(), "busy_s": busy.min()}))


if __name__ == "__main__":
    alone(Path(sys.argv[1]))
