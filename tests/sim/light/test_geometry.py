import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from anisoscope.base.errors import ModelError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.sim.light.geometry import directions, pose_grid, seating_rotation


def test_directions_are_as_stated_at_stage_zero():
    tilt, light = np.radians(20.0), np.radians(10.0)
    to_light, to_camera = directions((Pose(0.0, 20.0),), Convention())
    np.testing.assert_allclose(to_camera[0], [0, -np.sin(tilt), np.cos(tilt)], atol=1e-15)
    expected = [np.sin(light), -np.cos(light) * np.sin(tilt), np.cos(light) * np.cos(tilt)]
    np.testing.assert_allclose(to_light[0], expected, atol=1e-15)


@pytest.mark.parametrize("tilt_plane", ["perpendicular", "in-plane"])
def test_light_and_camera_keep_their_angle_in_every_pose(tilt_plane):
    poses = pose_grid((0, 37, 90, 180, 270), (-20, 0, 20))
    to_light, to_camera = directions(poses, Convention(tilt_plane=tilt_plane, facet_azimuth_deg=12.0))
    np.testing.assert_allclose(np.linalg.norm(to_light, axis=1), 1.0)
    angle = np.degrees(np.arccos(np.sum(to_light * to_camera, axis=1)))
    np.testing.assert_allclose(angle, 10.0, atol=1e-9)


def test_sample_turned_counter_clockwise_sees_the_light_turn_clockwise():
    to_light, _ = directions((Pose(90.0),), Convention())
    np.testing.assert_allclose(to_light[0, :2], [0.0, -np.sin(np.radians(10.0))], atol=1e-15)
    other, _ = directions((Pose(90.0),), Convention(rotation_sense="cw"))
    np.testing.assert_allclose(other[0, :2], [0.0, np.sin(np.radians(10.0))], atol=1e-15)


@pytest.mark.parametrize("tilt", [85.0, 90.0, 120.0])
def test_grazing_poses_are_refused(tilt):
    with pytest.raises(ModelError, match="horizon"):
        directions((Pose(0.0, tilt),), Convention(tilt_plane="in-plane"))


@pytest.mark.parametrize(
    "field", [{"light_angle_deg": 90.0}, {"tilt_plane": "sideways"}, {"rotation_sense": "left"}]
)
def test_impossible_conventions_are_refused(field):
    with pytest.raises(ModelError):
        Convention(**field)


def test_seating_about_y_moves_the_normal_toward_x():
    seat = seating_rotation(0.0, 5.0)
    np.testing.assert_allclose(
        np.array([0, 0, 1.0]) @ seat.T, [np.sin(np.radians(5)), 0, np.cos(np.radians(5))], atol=1e-15
    )
    np.testing.assert_allclose(seat @ seat.T, np.eye(3), atol=1e-15)


def test_seatings_are_turns_about_y_and_then_x_each_or_many_at_once():
    about_x, about_y = np.array([0.0, 3.0, -20.0]), np.array([1.0, -4.0, 0.0])
    found = seating_rotation(about_x, about_y)
    turns = Rotation.from_euler("XY", np.stack([about_x, about_y], axis=-1), degrees=True)
    np.testing.assert_allclose(found, turns.as_matrix(), atol=1e-15)
    np.testing.assert_array_equal(found[1], seating_rotation(3.0, -4.0))
