"""Reflections between ridges against direct light, in one run: `make benchmark` prints times and ratios."""

import time

import numpy as np
import pytest

from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.sim.light.corrected import radiance
from anisoscope.sim.light.geometry import Convention, directions, pose_grid
from anisoscope.sim.light.material import Material

pytestmark = pytest.mark.benchmark
REPEATS = 5


def test_bounces_against_direct_light():
    poses = pose_grid((0.0, 90.0, 180.0), (-20.0, -10.0, 0.0, 10.0, 20.0))
    to_light, to_camera = directions(poses, Convention())
    design, material = RidgeDesign(100.0, 20.0), Material(0.05, 0.05, 0.5)
    times, totals = {}, {}
    for bounces in (1, 2, None):
        radiance(to_light, to_camera, design, material, bounces=bounces)  # compile, tabulate
        spans = []
        for _ in range(REPEATS):
            start = time.perf_counter()
            totals[bounces] = radiance(to_light, to_camera, design, material, bounces=bounces)
            spans.append(time.perf_counter() - start)
        times[bounces] = min(spans) / len(poses)
    assert np.all(totals[1] <= totals[2])
    assert np.all(totals[2] <= totals[None])
    print()
    for bounces, seconds in times.items():
        name = "all reflections" if bounces is None else f"{bounces} reflection(s)"
        print(f"{name}: {1e3 * seconds:.2f} ms a pose, {seconds / times[1]:.0f} times direct light")
