"""Mixtures for any wanted reflectance: what is in reach is found, what is not is stated."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.design.models import LobeModel
from anisoscope.sim.design.targets import TargetTask, density, design_target, radial_target

H = np.linspace(-0.2, 0.2, 41)
X, Y = np.meshgrid(H, H)


def task(wanted):
    return TargetTask(wanted, max_width_um=8.0, grid_um=2.0)


@pytest.fixture(scope="module")
def two_parts():
    """A target made of two members of the family: shares 3 to 1."""
    plain = task(np.ones((41, 41)))
    parts = [
        LobeModel(widths_x_um=(x,), p_a_x=(1.0,), widths_y_um=(y,), p_a_y=(1.0,))
        for x, y in ((2.0, 2.0), (8.0, 2.0))
    ]
    wanted = 0.75 * density(plain, parts[0], H) + 0.25 * density(plain, parts[1], H)
    return design_target(task(7.0 * wanted))


def test_a_mixture_is_found_again(two_parts):
    """By its density: narrow lobes are mixtures of anti-mirrors and wide lobes too, so that shares are not unique."""
    assert two_parts.rel_l2 < 1e-6
    assert two_parts.unreachable_share < 1e-6
    assert sum(two_parts.shares) == pytest.approx(1.0)
    two_parts.check()


def test_a_spot_on_one_side_is_half_out_of_reach_whatever_is_mixed():
    """Mixtures are symmetric: of a spot at +h at least the half that they put at −h is missing."""
    found = design_target(task(np.exp(-0.5 * ((X - 0.08) ** 2 + Y**2) / 0.03**2)))
    assert found.asymmetric > 0.65
    assert found.unreachable_share > 0.5
    np.testing.assert_allclose(found.achieved, found.achieved[:, ::-1], rtol=1e-9)
    with pytest.raises(
        ModelError, match=r"% of the wanted light is out of reach.*not mirror-symmetric.*--nearest"
    ):
        found.check()


def test_radial_profile():
    found = radial_target(np.array([0.0, 0.1]), np.array([1.0, 0.0]), 41, 0.2)
    np.testing.assert_allclose(found, np.clip(1.0 - np.hypot(X, Y) / 0.1, 0.0, 1.0), atol=1e-12)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: task(np.zeros((41, 41))), "some above 0"),
        (lambda: task(-np.ones((41, 41))), "no negative"),
        (lambda: task(np.ones((3, 41))), "square"),
        (lambda: radial_target(np.array([0.1, 0.0]), np.ones(2), 41, 0.2), "rising"),
    ],
)
def test_targets_that_are_none_are_refused(wrong, words):
    with pytest.raises(ModelError, match=words):
        wrong()
