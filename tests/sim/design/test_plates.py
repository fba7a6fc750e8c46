"""Pictures of ridges: what the fields show is what was asked for, at each stage angle."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.sim.design.plates import design_pictures
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import Convention, Pose, directions
from anisoscope.sim.light.material import Material

PLASTIC = Material(0.06, 0.10, 0.2)
ACROSS, DOWN = np.meshgrid(np.linspace(0.0, 1.0, 24), np.linspace(0.0, 1.0, 24))
RINGS = 0.5 + 0.5 * np.cos(12.0 * np.hypot(ACROSS - 0.5, DOWN - 0.5))


def test_one_picture_is_shown_nearly_exactly():
    found = design_pictures(RINGS[None], (0.0,), PLASTIC, 10.0)
    assert found.similarity[0] > 0.98
    assert found.cross_talk == (0.0,)
    np.testing.assert_allclose(found.shown, found.wanted, atol=0.03 * np.ptp(found.wanted))


def test_two_pictures_are_shown_with_little_of_each_other():
    found = design_pictures(np.stack([ACROSS, RINGS]), (0.0, 90.0), PLASTIC, 10.0)
    assert min(found.similarity) > 0.9
    assert max(found.cross_talk) < 0.01
    for stage, shown in zip((0.0, 90.0), found.shown, strict=True):
        row, col = 5, 17
        azimuth, angle = found.azimuth_deg[row, col], found.ridge_angle_deg[row, col]
        sides = directions((Pose(stage),), Convention(facet_azimuth_deg=azimuth))
        light = corrected.radiance(*sides, RidgeDesign(100.0, angle), PLASTIC)
        assert shown[row, col] == pytest.approx(float(light[0]), rel=1e-9)


def test_what_no_plate_can_show_is_refused():
    with pytest.raises(UsageError, match="a plate looks the same"):
        design_pictures(np.stack([ACROSS, RINGS]), (0.0, 3.0), PLASTIC, 10.0)
    with pytest.raises(UsageError, match="one picture or two"):
        design_pictures(np.stack([ACROSS] * 3), (0.0, 90.0, 180.0), PLASTIC, 10.0)
    with pytest.raises(UsageError, match="at most 512 × 512"):
        design_pictures(np.zeros((1, 600, 4)), (0.0,), PLASTIC, 10.0)
