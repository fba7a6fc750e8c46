import numpy as np
import pytest

from anisoscope.decision.decision import contrast_gradient as gradient_of_logs
from anisoscope.prediction.contrast_uncertainty import (
    KINDS,
    contrast_covariance,
    contrast_gradient,
    contrast_values,
)
from anisoscope.sim.light.contrasts import contrasts
from anisoscope.sim.light.geometry import pose_grid

POSES = pose_grid((0.0, 90.0, 180.0), (0.0, 10.0))
RADIANCE = np.array([0.3, 0.05, 0.04, 0.2, 0.1, 0.02])


@pytest.mark.parametrize("kind", KINDS)
def test_the_gradient_is_that_of_the_contrasts(kind):
    gradient, defined = contrast_gradient(POSES, RADIANCE, kind)
    assert defined.all()
    for pose in range(6):
        step = np.zeros(6)
        step[pose] = 1e-6
        ends = [contrast_values(POSES, RADIANCE + side * step, kind) for side in (1.0, -1.0)]
        np.testing.assert_allclose(gradient[:, pose], (ends[0] - ends[1]) / 2e-6, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(gradient * RADIANCE, gradient_of_logs(POSES, RADIANCE, kind), atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_values_are_those_of_the_contrasts(kind):
    expected = [getattr(contrast, kind) for contrast in contrasts(POSES, RADIANCE)]
    np.testing.assert_allclose(contrast_values(POSES, RADIANCE, kind), expected)


@pytest.mark.parametrize("kind", KINDS)
def test_the_covariance_is_that_of_drawn_radiances(kind, rng):
    root = 1e-3 * rng.normal(size=(6, 6))
    drawn = RADIANCE + rng.standard_normal((20000, 6)) @ root.T
    found = contrast_covariance(POSES, RADIANCE, root @ root.T, kind)
    stated = np.sqrt(np.diag(found))
    off = (np.cov(contrast_values(POSES, drawn, kind).T) - found) / np.outer(stated, stated)
    assert np.abs(off).max() < 0.06


def test_a_gain_common_to_all_poses_leaves_ratios_certain():
    shared = 0.05 * RADIANCE
    for kind in ("michelson", "log_ratio"):
        np.testing.assert_allclose(
            contrast_covariance(POSES, RADIANCE, np.outer(shared, shared), kind), 0.0, atol=1e-15
        )


def test_what_a_dark_pose_leaves_undefined_is_known_with_no_certainty():
    dark = RADIANCE.copy()
    dark[[1, 4, 5]] = 0.0
    u = np.diag(np.full(6, 1e-6))
    log = contrast_covariance(POSES, dark, u, "log_ratio")
    assert np.isinf(np.diag(log)).tolist() == [True, True, True, True]
    michelson = contrast_covariance(POSES, dark, u, "michelson")
    assert np.isinf(np.diag(michelson)).tolist() == [False, False, False, True]
    assert not np.isnan(log).any()
    assert not np.isnan(michelson).any()
    assert np.isfinite(contrast_covariance(POSES, dark, u, "difference")).all()
