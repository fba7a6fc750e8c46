"""Contrasts between tilts against numbers by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from anisoscope.decision.decision import between_tilts, deviating_between_tilts
from anisoscope.prediction.expectation import Component
from anisoscope.sim.light.geometry import pose_grid

POSES = pose_grid((0.0, 90.0), (0.0, 3.0))


def parts(off, poses=POSES):
    own = Component("own", "measurement", np.full(len(poses), 0.01), shared=False)
    alike = Component("alike", "prediction", np.full(len(poses), 0.3), shared=True)
    expected = SimpleNamespace(poses=poses, radiance=np.full(len(poses), 2.0), components=(alike,))
    return expected, SimpleNamespace(radiance=2.0 * np.exp(off), components=(own,))


def test_a_spike_is_named_between_tilts_with_its_uncertainty():
    spike = np.array([0.1 if pose.tilt_deg == 0.0 and pose.stage_deg == 90.0 else 0.0 for pose in POSES])
    (found,) = deviating_between_tilts(*parts(spike), 0.001)
    assert found == "90° between tilt 0° and 3° (ln ratio off by +0.100, u 0.014)"  # what all share cancels


def test_chance_is_not_named_nor_what_all_poses_share():
    assert deviating_between_tilts(*parts(np.array([0.02, -0.01, 0.01, 0.0])), 0.001) == ()
    assert deviating_between_tilts(*parts(np.full(4, 0.5)), 0.001) == ()


def test_one_tilt_has_nothing_between():
    poses = pose_grid((0.0, 90.0, 180.0), (0.0,))
    assert deviating_between_tilts(*parts(np.array([0.5, 0.0, 0.0]), poses), 0.001) == ()


@pytest.mark.parametrize("kind", ["log_ratio", "michelson", "difference"])
def test_every_angle_is_compared_between_the_first_tilt_and_each_other_one(kind):
    poses = pose_grid((0.0, 90.0), (0.0, 3.0, 5.0))
    rng = np.random.default_rng(4)
    radiance, seen = rng.uniform(0.5, 4.0, (2, len(poses)))
    slope, own = rng.uniform(-0.1, 0.1, len(poses)), rng.uniform(0.01, 0.05, len(poses))
    model = Component("of the model", "prediction", slope, shared=True)
    noise = Component("own", "measurement", own, shared=False)
    expected = SimpleNamespace(poses=poses, radiance=radiance, components=(model,))
    found = between_tilts(expected, SimpleNamespace(radiance=seen, components=(noise,)), kind)
    assert [(one.stage_deg, one.from_tilt_deg, one.to_tilt_deg) for one in found] == [
        (0.0, 0.0, 3.0),
        (90.0, 0.0, 3.0),
        (0.0, 0.0, 5.0),
        (90.0, 0.0, 5.0),
    ]
    value = {
        "log_ratio": lambda a, b: np.log(a / b),
        "michelson": lambda a, b: (a - b) / (a + b),
        "difference": lambda a, b: a - b,
    }[kind]
    small = 1e-4
    for one, (i, j) in zip(found, [(0, 2), (1, 3), (0, 4), (1, 5)], strict=True):
        assert one.measured == pytest.approx(value(seen[i], seen[j]))
        assert one.predicted == pytest.approx(value(radiance[i], radiance[j]))
        moved = [value(*(radiance * np.exp(step * slope))[[i, j]]) for step in (-small, small)]
        assert one.u_predicted == pytest.approx(abs(moved[1] - moved[0]) / (2.0 * small), rel=1e-5)
        each = [
            [value(*(seen * np.exp(step * own * (np.arange(6) == k)))[[i, j]]) for step in (-small, small)]
            for k in (i, j)
        ]
        apart = [(high - low) / (2.0 * small) for low, high in each]
        assert one.u_measured == pytest.approx(np.hypot(*apart), rel=1e-5)
        assert one.u == pytest.approx(np.hypot(one.u_measured, one.u_predicted))


def test_the_table_names_what_the_reason_names():
    spike = np.array([0.1 if pose.tilt_deg == 0.0 and pose.stage_deg == 90.0 else 0.0 for pose in POSES])
    found = between_tilts(*parts(spike), "log_ratio")
    assert [one.p_value < 0.001 for one in found] == [False, True]
    assert found[1].measured - found[1].predicted == pytest.approx(0.1)
    one_tilt = pose_grid((0.0, 90.0, 180.0), (0.0,))
    assert between_tilts(*parts(np.zeros(3), one_tilt), "log_ratio") == ()
