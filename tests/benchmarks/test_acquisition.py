"""How long an acquisition takes beyond its camera: turning, settling, writing and hashing are to cost nothing.

The camera's time is the sum of its grabs, measured around it. The stage is simulated at time scale 0: its moves end
at once, what remains is the conversation with it, the driver's pauses, and everything of ours.
"""

import os
import time
from dataclasses import replace
from pathlib import Path

import pytest

from anisoscope.rig.acquisition.plan import Plan, Pose
from anisoscope.rig.acquisition.runner import open_rig, run_plan
from anisoscope.rig.frame import write_frame
from anisoscope.rig.rigfile import read_rig

pytestmark = pytest.mark.benchmark

ANGLES = (0.0, 45.0, 90.0, 135.0, 180.0)
BENCH = """
schema = 1
[sample]
kind = "white-tile"
[sensor]
rows = 1024
cols = 1024
[stage]
time_scale = 0.0
"""
RIG = """
schema = 1
name = "virtual rig"
[stage]
driver = "elliptec"
port = "sim://elliptec?bench=${here}/bench.toml"
zero_deg = 10.0
[camera]
driver = "simulated"
pixel_um = 4.0
options = { bench = "${here}/bench.toml" }
[light]
driver = "simulated"
options = { bench = "${here}/bench.toml" }
"""


class Timed:
    """A camera that remembers how long it took."""

    def __init__(self, camera):
        self._camera, self.info, self.configure, self.close = (
            camera,
            camera.info,
            camera.configure,
            camera.close,
        )
        self.busy_s = 0.0

    def grab(self):
        start = time.perf_counter()
        try:
            return self._camera.grab()
        finally:
            self.busy_s += time.perf_counter() - start


def test_five_angles_take_little_more_than_their_exposures(bench, tmp_path):
    (tmp_path / "bench.toml").write_text(BENCH)
    (tmp_path / "rig.toml").write_text(RIG)
    plan = Plan(tuple(Pose(angle) for angle in ANGLES), exposure_s=0.006, frames_per_pose=4, dark_frames=8)
    rests = []
    with open_rig(read_rig(tmp_path / "rig.toml")) as rig:
        for number in range(3):
            camera = Timed(rig.camera)
            start = time.perf_counter()
            records = run_plan(plan, replace(rig, camera=camera), tmp_path / str(number))
            rests.append(time.perf_counter() - start - camera.busy_s)
    in_a_row = bench.compare(
        f"{len(records)} frames of 1024 × 1024, written and hashed one after the other",
        {"in a row": lambda: written_in_a_row(records, tmp_path)},
        rounds=2,
        warm=False,
    )
    bench.note(
        f"acquisition at {len(ANGLES)} angles: {min(rests):.2f} s beyond its camera ({camera.busy_s:.2f} s); "
        f"written in a row {min(in_a_row['in a row'].wall_s):.2f} s"
    )
    assert len(records) == plan.frame_count
    assert min(rests) < 1.0


def written_in_a_row(records, folder: Path) -> None:
    """What the writer's thread hides."""
    for record in records:
        write_frame(record.frame, folder / record.path.name)
        descriptor = os.open(folder, os.O_RDONLY)
        os.fsync(descriptor)
        os.close(descriptor)
