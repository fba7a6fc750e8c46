import numpy as np
import pytest

from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.sim.light.corrected import radiance
from anisoscope.sim.light.geometry import Convention, Pose, directions, pose_grid
from anisoscope.sim.light.material import Material, facet_brdf
from anisoscope.sim.light.ridge_profile import ridge_polyline, visible_shares

X, Y, Z = np.eye(3)
TANGENTS = np.concatenate([-np.geomspace(8, 0.01, 25), np.geomspace(0.01, 8, 25)])


@pytest.mark.parametrize("angle", [5.0, 10.0, 20.0, 40.0])
def test_visibility_of_perpendicular_ridges_is_the_closed_form(angle):
    theta = np.radians(angle)
    x, z = ridge_polyline(RidgeDesign(100.0, angle))
    for t in TANGENTS:
        facet, wall = visible_shares(x, z, t)
        one_sided = 1.0 if t <= np.tan(theta) else 1.0 / ((1 + t * np.tan(theta)) * np.cos(theta) ** 2)
        assert facet == pytest.approx(one_sided if t > -1 / np.tan(theta) else 0.0, abs=1e-12)
        beyond = 1.0 / (np.sin(theta) ** 2 + np.sin(theta) * np.cos(theta) * abs(t))
        assert wall == pytest.approx(0.0 if t >= np.tan(theta) else min(1.0, beyond), abs=1e-12)


@pytest.mark.parametrize("angle", [5.0, 20.0])
def test_visibility_of_vertical_walls_is_the_closed_form(angle):
    tangent = np.tan(np.radians(angle))
    x, z = ridge_polyline(RidgeDesign(100.0, angle, wall="vertical"))
    for t in TANGENTS:
        facet, wall = visible_shares(x, z, t)
        assert facet == pytest.approx(
            1.0 / (1 + t * tangent) if t > 0 else float(t * tangent > -1), abs=1e-12
        )
        assert wall == pytest.approx(0.0 if t >= 0 else min(1.0, 1 / (tangent * abs(t))), abs=1e-12)


@pytest.mark.parametrize("height_loss", [0.0, 0.1, 0.4])
@pytest.mark.parametrize("wall", ["perpendicular", "vertical"])
@pytest.mark.parametrize("t", [-4.0, -0.7, -0.1, 0.0, 0.1, 0.9, 5.0])
def test_every_ray_meets_the_surface_once(height_loss, wall, t):
    """Identity: the visible parts, projected along the ray, tile the period without gap or overlap."""
    x, z = ridge_polyline(RidgeDesign(80.0, 15.0, wall=wall, height_loss=height_loss))
    projected = np.maximum(np.diff(x - t * z), 0.0) * visible_shares(x, z, t)
    assert projected.sum() == pytest.approx(80.0, rel=1e-12)


@pytest.mark.parametrize("height_loss", [0.0, 0.2])
@pytest.mark.parametrize("wall", ["perpendicular", "vertical"])
def test_radiance_is_reciprocal(wall, height_loss):
    rng = np.random.default_rng(5)
    raw = rng.normal(size=(2, 100, 3))
    raw[..., 2] = np.abs(raw[..., 2]) + 0.3
    first, second = raw / np.linalg.norm(raw, axis=-1, keepdims=True)
    design, material = RidgeDesign(100.0, 18.0, wall=wall, height_loss=height_loss), Material(0.2, 0.3, 0.5)
    there = radiance(first, second, design, material) / first[:, 2]
    back = radiance(second, first, design, material) / second[:, 2]
    np.testing.assert_allclose(there, back, rtol=1e-10)


@pytest.mark.parametrize("angle", [5.0, 10.0, 20.0])
@pytest.mark.parametrize("tilt", [0.0, 40.0, 60.0])
def test_white_furnace_stays_below_one(angle, tilt, hemisphere):
    directions_out, solid_angle = hemisphere(48, 96)
    for azimuth in (0.0, 90.0, 180.0):
        light = np.radians([tilt, azimuth])
        vector = [np.sin(light[0]) * np.cos(light[1]), np.sin(light[0]) * np.sin(light[1]), np.cos(light[0])]
        incoming = np.broadcast_to(vector, directions_out.shape)
        shown = radiance(incoming, directions_out, RidgeDesign(100.0, angle), Material(0.2, 0.2, albedo=1.0))
        assert 0.5 < np.sum(shown * directions_out[:, 2] * solid_angle) / vector[2] <= 1.0 + 2e-3


@pytest.mark.parametrize("tilt", [-20.0, -5.0, 10.0])
def test_mirror_symmetry(tilt):
    to_light, to_camera = directions((Pose(90.0, tilt), Pose(270.0, -tilt)), Convention())
    left, right = radiance(to_light, to_camera, RidgeDesign(100.0, 12.0), Material())
    assert left == pytest.approx(right, rel=1e-12)


@pytest.mark.parametrize("wall", ["perpendicular", "vertical"])
def test_flat_limit_is_the_plain_microfacet_brdf(wall):
    poses = pose_grid((0, 45, 90), (-20, 0, 20))
    to_light, to_camera = directions(poses, Convention())
    expected = facet_brdf(to_light, to_camera, Y, -X, Z, Material()) * to_light[:, 2]
    nearly_flat = radiance(to_light, to_camera, RidgeDesign(100.0, 1e-6, wall=wall), Material())
    np.testing.assert_allclose(nearly_flat, expected, rtol=1e-5)
    np.testing.assert_allclose(
        radiance(to_light, to_camera, RidgeDesign(100.0, 0.0), Material()), expected, rtol=1e-12
    )


def test_radiance_does_not_depend_on_the_pitch():
    to_light, to_camera = directions(pose_grid((0, 90, 180)), Convention())
    small, large = (radiance(to_light, to_camera, RidgeDesign(p, 10.0), Material()) for p in (50.0, 150.0))
    np.testing.assert_allclose(small, large, rtol=1e-12)
