"""Apertures and near light: closed forms, limits, and what a bundle must be."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.optics import Optics
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.optics import bundle, through

POSES = pose_grid((0.0, 90.0, 180.0), (-10.0, 0.0, 15.0))


def ridges(to_light, to_camera, material):
    return corrected.radiance(to_light, to_camera, RidgeDesign(100.0, 10.0), material)


def mean_over(model, poses, optics):
    return through(model, optics)(*directions(poses, Convention()), Material(0.1, 0.1))


def bundle_of(poses, optics):
    return bundle(*directions(poses, Convention()), optics)


def test_without_size_nothing_changes():
    to_light, to_camera = directions(POSES, Convention())
    expected = ridges(to_light, to_camera, Material(0.1, 0.1))
    np.testing.assert_array_equal(mean_over(ridges, POSES, Optics()), expected)
    tiny = Optics(1e-4, 1e-4, 1e7, (1.0, 1.0))
    np.testing.assert_allclose(mean_over(ridges, POSES, tiny), expected, rtol=1e-6)


@pytest.mark.parametrize("rings", [1, 2, 3])
def test_mean_of_a_polynomial_over_the_camera_disc(rings):
    """⟨x²⟩ over a uniform disc of radius s is s²/4, ⟨x⁴⟩ is s⁴/8."""
    size = np.sin(np.radians(8.0))
    optics = Optics(aperture_half_angle_deg=8.0, disc_rings=rings)
    pose = (Pose(0.0),)
    square = mean_over(lambda _i, o, _m: o[:, 0] ** 2, pose, optics)
    fourth = mean_over(lambda _i, o, _m: o[:, 1] ** 4, pose, optics)
    assert square[0] == pytest.approx(size**2 / 4.0, rel=1e-12)
    assert fourth[0] == pytest.approx(size**4 / 8.0, rel=1e-12)


def test_a_white_plate_under_a_wide_lamp_shines_by_the_cosine_of_its_axis():
    """A Lambertian plane sees irradiance E·cos of the axis, whatever the size of the lamp above its horizon."""
    optics = Optics(lamp_half_angle_deg=20.0)
    shown = mean_over(lambda i, _o, _m: i[:, 2] / np.pi, POSES, optics)
    to_light, _ = directions(POSES, Convention())
    np.testing.assert_allclose(shown, to_light[:, 2] / np.pi, rtol=1e-12)


@pytest.mark.parametrize("which", ["lamp_half_angle_deg", "aperture_half_angle_deg"])
def test_more_rings_change_nothing_where_lobes_are_wide(which):
    coarse = mean_over(ridges, POSES, Optics(**{which: 3.0}))
    fine = mean_over(ridges, POSES, Optics(**{which: 3.0}, disc_rings=4))
    np.testing.assert_allclose(coarse, fine, rtol=2e-3)
    point = mean_over(ridges, POSES, Optics())
    assert np.max(np.abs(fine / point - 1.0)) > 0.005


def test_directions_of_a_disc_are_as_far_from_the_axis_as_they_should_be():
    found = bundle_of(POSES, Optics(5.0, 5.0, disc_rings=3))
    to_light, to_camera = directions(POSES, Convention())
    for rays, axis in ((found.to_light, to_light), (found.to_camera, to_camera)):
        np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1.0)
        apart = np.degrees(np.arccos(np.clip(np.einsum("pqc,pc->pq", rays, axis), -1.0, 1.0)))
        assert 4.5 < apart.max() < 5.0


def test_near_light_stands_where_geometry_says():
    """Seen from 5 mm toward the lamp (x), a lamp 100 mm away at 10° stands at atan((100 sin 10° − 5)/(100 cos 10°))."""
    node = np.sqrt(0.6)
    found = bundle_of((Pose(0.0),), Optics(lamp_distance_mm=100.0, field_mm=(10.0 / node, 0.0)))
    angle = np.degrees(np.arctan2(found.to_light[0, :, 0], found.to_light[0, :, 2]))
    a = np.radians(10.0)
    expected = np.degrees(np.arctan2(100.0 * np.sin(a) - np.array([-5.0, 0.0, 5.0]), 100.0 * np.cos(a)))
    np.testing.assert_allclose(np.sort(np.unique(angle.round(9))), np.sort(expected), rtol=1e-8)


def test_the_field_stands_still_while_the_sample_turns():
    """A plate without direction looks the same at all stage angles, under a near light too."""
    optics = Optics(lamp_distance_mm=60.0, field_mm=(30.0, 10.0))

    def flat(to_light, to_camera, _):
        return corrected.radiance(to_light, to_camera, RidgeDesign(100.0, 0.0), Material(0.1, 0.1))

    shown = mean_over(flat, pose_grid((0.0, 37.0, 90.0, 200.0)), optics)
    np.testing.assert_allclose(shown, shown[0], rtol=1e-9)


@pytest.mark.parametrize(
    "wrong",
    [
        {"lamp_half_angle_deg": -1.0},
        {"aperture_half_angle_deg": 70.0},
        {"lamp_distance_mm": 5.0, "field_mm": (10.0, 10.0)},
        {"field_mm": (-1.0, 1.0)},
        {"disc_rings": 0},
    ],
)
def test_optics_that_no_rig_has_are_refused(wrong):
    with pytest.raises(ModelError):
        Optics(**wrong)


def test_a_lens_that_dips_below_the_horizon_is_refused():
    with pytest.raises(ModelError, match="horizon"):
        bundle_of((Pose(0.0, 75.0),), Optics(aperture_half_angle_deg=20.0))
