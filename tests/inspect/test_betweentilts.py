"""Contrasts between tilts against numbers by hand."""

from types import SimpleNamespace

import numpy as np

from anisoscope.betweentilts import deviating
from anisoscope.expectation import Component
from anisoscope.sim.light.geometry import pose_grid

POSES = pose_grid((0.0, 90.0), (0.0, 3.0))


def parts(off, poses=POSES):
    own = Component("own", "measurement", np.full(len(poses), 0.01), shared=False)
    alike = Component("alike", "prediction", np.full(len(poses), 0.3), shared=True)
    expected = SimpleNamespace(poses=poses, radiance=np.full(len(poses), 2.0), components=(alike,))
    return expected, SimpleNamespace(radiance=2.0 * np.exp(off), components=(own,))


def test_a_spike_is_named_between_tilts_with_its_uncertainty():
    spike = np.array([0.1 if pose.tilt_deg == 0.0 and pose.stage_deg == 90.0 else 0.0 for pose in POSES])
    (found,) = deviating(*parts(spike), 0.001)
    assert found == "90° between tilt 0° and 3° (ln ratio off by +0.100, u 0.014)"  # what all share cancels


def test_chance_is_not_named_nor_what_all_poses_share():
    assert deviating(*parts(np.array([0.02, -0.01, 0.01, 0.0])), 0.001) == ()
    assert deviating(*parts(np.full(4, 0.5)), 0.001) == ()


def test_one_tilt_has_nothing_between():
    poses = pose_grid((0.0, 90.0, 180.0), (0.0,))
    assert deviating(*parts(np.array([0.5, 0.0, 0.0]), poses), 0.001) == ()
