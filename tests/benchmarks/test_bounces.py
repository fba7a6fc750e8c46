"""Reflections between ridges against direct light, in one run: `make benchmark` prints times and ratios."""

import numpy as np
import pytest

from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light.corrected import radiance
from anisoscope.sim.light.geometry import directions, pose_grid

pytestmark = pytest.mark.benchmark


def test_bounces_against_direct_light(bench):
    poses = pose_grid((0.0, 90.0, 180.0), (-20.0, -10.0, 0.0, 10.0, 20.0))
    to_light, to_camera = directions(poses, Convention())
    design, material = RidgeDesign(100.0, 20.0), Material(0.05, 0.05, 0.5)

    def of(bounces):
        return lambda: radiance(to_light, to_camera, design, material, bounces=bounces)

    found = bench.compare(
        f"{len(poses)} poses of a design", {"all reflections": of(None), "two": of(2), "direct light": of(1)}
    )
    assert np.all(found["direct light"].result <= found["two"].result)
    assert np.all(found["two"].result <= found["all reflections"].result)
