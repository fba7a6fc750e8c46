import numpy as np
import pytest

from anisoscope.sim.light.contrasts import contrasts, fit_scale
from anisoscope.sim.light.geometry import pose_grid


def test_contrasts_are_signed_and_between_consecutive_stage_angles_of_one_tilt():
    poses = pose_grid((0, 90, 180), (0, 10))
    found = contrasts(poses, np.array([4.0, 1.0, 2.0, 8.0, 8.0, 2.0]))
    assert [(c.from_deg, c.to_deg, c.tilt_deg) for c in found] == [
        (0, 90, 0),
        (90, 180, 0),
        (0, 90, 10),
        (90, 180, 10),
    ]
    assert [c.difference for c in found] == [3.0, -1.0, 0.0, 6.0]
    assert found[0].michelson == pytest.approx(3 / 5)
    assert found[1].log_ratio == pytest.approx(np.log(1 / 2))


def test_a_dark_pose_gives_an_infinite_ratio_and_no_warning():
    (found,) = contrasts(pose_grid((0, 90)), np.array([1.0, 0.0]))
    assert (found.michelson, found.log_ratio) == (1.0, np.inf)


def test_scale_is_the_least_squares_one():
    rng = np.random.default_rng(1)
    predicted = rng.random(20)
    assert fit_scale(predicted, 3.7 * predicted) == pytest.approx(3.7)
