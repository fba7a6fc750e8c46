"""The uncertainty stated for coarse pixels covers the bias that they make."""

import numpy as np
import pytest

from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.predict import predict_height_map
from anisoscope.prediction.relief_preparation import MIN_PIXELS_A_PITCH
from anisoscope.profiles.ideal import ridges
from anisoscope.sim.light.geometry import pose_grid

POSES = pose_grid((0.0, 90.0, 180.0), (-10.0, 0.0, 10.0))


@pytest.fixture(scope="module")
def find_pixel_bias(pixel_bias_script):
    return pixel_bias_script.find_pixel_bias


@pytest.mark.parametrize(
    ("angle_deg", "pitch_um"),
    [
        (5.0, 50.0),
        (20.0, 100.0),
        *(
            pytest.param(*one, marks=pytest.mark.soak)
            for one in ((5.0, 100.0), (10.0, 50.0), (10.0, 100.0), (20.0, 50.0))
        ),
    ],
)
def test_the_uncertainty_covers_the_bias(find_pixel_bias, pitch_um, angle_deg):
    pixels = np.array([0.3, 1.0, 2.0, 3.0, 4.0])
    found = find_pixel_bias(RidgeDesign(pitch_um, angle_deg), pixels, Material(), POSES, Convention())
    assert pixels.max() <= pitch_um / MIN_PIXELS_A_PITCH
    assert np.all(found.rms < 1.02 * found.u)
    assert np.all(found.within >= 0.96)
    of_one_pose = np.sqrt(np.mean(found.bias**2, axis=1))
    assert np.all(of_one_pose < 1.9 * found.u[:, None])
    walls = found.design.wall_width_um / pixels
    assert np.all(found.rms[walls > 3.0] < 0.3 * found.u[walls > 3.0])  # resolved walls need none of it


def test_below_twelve_pixels_a_pitch_it_does_not_and_the_prediction_says_so(find_pixel_bias):
    design = RidgeDesign(50.0, 10.0)
    found = find_pixel_bias(design, np.array([5.0]), Material(), POSES, Convention(), places=41)
    assert found.rms[0] > 1.3 * found.u[0]
    for pixel, warned in ((5.0, True), (4.0, False)):
        surface = ridges(design, (5, 161), (1.0, pixel))
        notes = predict_height_map(surface, Material(), POSES, Convention(), pitch_um=50.0).notes
        assert ("pixel_warning" in notes) == warned


def test_the_bias_of_one_map_has_one_sign_in_all_poses(find_pixel_bias):
    level = pose_grid((0.0, 90.0, 180.0))
    found = find_pixel_bias(RidgeDesign(50.0, 10.0), np.array([1.0]), Material(), level, Convention())
    assert np.corrcoef(found.bias[0].T).min() > 0.9


def test_at_one_micrometre_the_uncertainty_is_no_waste_for_narrow_walls(find_pixel_bias):
    found = find_pixel_bias(RidgeDesign(50.0, 5.0), np.array([1.0]), Material(), POSES, Convention())
    assert 0.5 * found.u[0] < found.rms[0] < found.u[0]
    np.testing.assert_allclose(found.u, 1.0 / 50.0 / np.sqrt(3.0))
