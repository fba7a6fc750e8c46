import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.picture import (
    Plate,
    View,
    checkerboard,
    displayed,
    plate_picture,
    view_of,
)

RIG = Convention()
DESIGN, PLASTIC = RidgeDesign(100.0, 10.0), Material()


@pytest.fixture
def rng():
    return np.random.default_rng(9)


def model(stage_deg, tilt_deg=0.0, convention=RIG, bounces=1):
    light, camera = directions((Pose(stage_deg, tilt_deg),), convention)
    return corrected.radiance(light, camera, DESIGN, PLASTIC, bounces)[0]


def shot(plate, stage=0.0, tilt=0.0, convention=RIG, pixels=120, **options):
    pose = Pose(stage, tilt)
    pixel_um = max(plate.size_um) / pixels
    return plate_picture(
        plate, pose, convention, view_of(pose, convention, (pixels, pixels), pixel_um), **options
    )


def plate(second, ridge_deg=(0.0, 90.0), design=DESIGN, material=PLASTIC):
    return Plate(np.asarray(second, dtype=bool), 1000.0, design, material, ridge_deg)


@pytest.mark.parametrize(
    ("stage", "row", "column"),
    [(0, 24.5, 84.5), (90, 14.5, 24.5), (180, 74.5, 14.5), (270, 84.5, 74.5), (-90, 84.5, 74.5)],
)
def test_a_mark_turns_counter_clockwise_with_the_stage(stage, row, column):
    """A mark 35 to the right and 25 above the axis."""
    view = view_of(Pose(stage), RIG, (100, 100), 10.0)
    shown = view.row_column(np.array(350.0), np.array(250.0))
    np.testing.assert_allclose(shown, (row, column), atol=1e-9)


def test_the_other_sense_and_the_azimuth_of_the_facets_turn_the_picture():
    clockwise = Convention(rotation_sense="cw", facet_azimuth_deg=10.0)
    assert view_of(Pose(90.0), clockwise, (9, 9), 1.0).turn_deg == -80.0
    view = view_of(Pose(0.0), Convention(facet_azimuth_deg=90.0), (101, 101), 1.0)
    row, column = view.row_column(np.array(30.0), np.array(0.0))  # facets lean toward +x, which now is up
    assert (row, column) == pytest.approx((20.0, 50.0))


@pytest.mark.parametrize(("plane", "axis"), [("perpendicular", 0), ("in-plane", 1)])
def test_tilt_foreshortens_the_axis_in_its_plane(plane, axis):
    view = view_of(Pose(0.0, 60.0), Convention(tilt_plane=plane), (101, 101), 1.0)
    place = view.row_column(np.array(40.0), np.array(40.0))
    expected = [10.0, 90.0]
    expected[axis] = 30.0 if axis == 0 else 70.0
    assert [float(p) for p in place] == pytest.approx(expected)


@pytest.mark.parametrize(("stage", "tilt"), [(0, 0), (37, 20), (90, -10), (180, 0), (211, 40)])
def test_positions_and_pixels_are_inverse(stage, tilt, rng):
    view = view_of(Pose(stage, tilt), RIG, (80, 120), 7.0)
    row, column = rng.uniform(0, 80, 50), rng.uniform(0, 120, 50)
    np.testing.assert_allclose(view.row_column(*view.sample_xy(row, column)), (row, column), atol=1e-9)


def test_the_picture_agrees_with_the_lens_of_the_virtual_rig():
    from anisoscope.sim.bench.benchfile import OpticsPart, SensorPart
    from anisoscope.sim.bench.optics import pixel_from_mm

    optics, sensor = OpticsPart(pixel_um=5.0), SensorPart(rows=200, cols=300)
    centre = np.array(optics.axis_px)
    matrix = pixel_from_mm(optics, sensor, 25.0, 15.0)
    view = view_of(Pose(25.0, 15.0), RIG, (200, 300), 5.0)
    row, column = view.row_column(np.array(310.0), np.array(-120.0))
    np.testing.assert_allclose(matrix @ [0.31, -0.12, 1.0] - centre, [column, row])


def test_an_asymmetric_pattern_lands_where_it_was_drawn():
    """An L: the first column and the last row; at 90° the column lies at the bottom, the row on the right."""
    second = np.zeros((5, 5), dtype=bool)
    second[:, 0] = second[4, :] = True
    for stage, turned in ((0, second), (90, np.rot90(second)), (180, np.rot90(second, 2))):
        found = shot(plate(second), stage, pixels=50).radiance
        first, other = model(stage), model(stage + 90)
        np.testing.assert_allclose(found[5::10, 5::10], np.where(turned, other, first), rtol=1e-9)


@pytest.mark.parametrize(("tilt", "bounces"), [(0.0, 1), (-10.0, 1), (0.0, None)])
def test_fields_have_the_radiance_of_the_model(tilt, bounces):
    found = shot(plate(checkerboard(4)), 0.0, tilt, bounces=bounces)
    expected = [model(stage, tilt, bounces=bounces) for stage in (0.0, 90.0)]
    assert found.fields == pytest.approx(expected, rel=1e-9)
    shown = found.radiance[np.isfinite(found.radiance)]
    assert shown.mean() == pytest.approx(np.mean(expected), rel=0.01 if tilt else 1e-9)


def test_every_point_of_the_picture_is_counted_once():
    """Turned by an odd angle, the picture holds the light of the plate."""
    board = plate(checkerboard(3))
    view = view_of(Pose(33.0), RIG, (200, 200), 25.0)
    found = plate_picture(board, Pose(33.0), RIG, view)
    assert found.cover.sum() * 25.0**2 == pytest.approx(3000.0**2, rel=1e-3)
    first, second = model(33.0), model(123.0)
    light = np.sum(np.nan_to_num(found.radiance) * found.cover)
    assert light == pytest.approx((5 * first + 4 * second) / 9 * found.cover.sum(), rel=0.01)


def test_checkerboard_inverts_after_a_quarter_turn():
    """With facets toward +x and −y, each kind of field stands at 90° as the other did at 0°."""
    board = plate(checkerboard(3), ridge_deg=(0.0, -90.0))
    before, after = shot(board, 0.0), shot(board, 90.0)
    assert after.fields[1] == pytest.approx(before.fields[0], rel=1e-9)
    assert after.fields[0] == pytest.approx(before.fields[1], rel=1e-9)  # mirror symmetry at zero tilt
    np.testing.assert_allclose(after.radiance + before.radiance, sum(before.fields), rtol=1e-9)
    tilted = [shot(board, stage, 10.0).fields for stage in (0.0, 90.0)]
    assert tilted[1][1] == pytest.approx(tilted[0][0], rel=1e-9)
    assert tilted[0][1] == pytest.approx(model(90.0, -10.0), rel=1e-9)  # L(−90°, 10°) = L(90°, −10°)
    assert tilted[1][0] == pytest.approx(model(90.0, 10.0), rel=1e-9)


def test_checkerboard_of_facets_toward_x_and_y_fades_by_the_known_anisotropy():
    board = plate(checkerboard(3), ridge_deg=(0.0, 90.0))
    after = shot(board, 90.0).fields
    assert after == pytest.approx((model(90.0), model(180.0)), rel=1e-9)


def test_near_light_converges_to_parallel_light():
    """The deviation falls as the first power of the distance, and is gone far away."""
    board, far = plate(checkerboard(6)), shot(plate(checkerboard(6)))
    inside = far.cover == 1.0
    errors = [
        np.max(np.abs(shot(board, light_distance_um=d).radiance - far.radiance)[inside])
        for d in (1e5, 1e6, 1e7, 1e8)
    ]
    assert errors[0] > 0.01
    np.testing.assert_allclose(np.divide(errors[1:], errors[:-1]), 0.1, rtol=0.25)
    assert errors[-1] < 3e-4 * far.fields[0]


def test_near_light_is_the_model_at_every_point(rng):
    """Direction and inverse square, point by point, without the grid."""
    distance, board = 20_000.0, plate(np.zeros((6, 6)), material=Material(0.05, 0.08))
    pose = Pose(40.0, 10.0)
    view = view_of(pose, RIG, (61, 61), 100.0)
    found = plate_picture(board, pose, RIG, view, distance).radiance
    light, camera = (d[0] for d in directions((pose,), RIG))
    for row, column in rng.integers(10, 50, (40, 2)):
        x, y = view.sample_xy(np.array(float(row)), np.array(float(column)))
        ray = distance * light - np.array([x, y, 0.0])
        length = np.linalg.norm(ray)
        expected = corrected.radiance(ray[None] / length, camera[None], DESIGN, board.material)[0]
        expected *= (distance / length) ** 2
        assert found[row, column] == pytest.approx(expected, rel=2e-3)


def test_the_side_of_a_near_light_is_brighter_on_diffuse_plastic():
    board = plate(np.zeros((4, 4)), design=RidgeDesign(100.0, 0.0), material=Material(0.5, 0.5, 0.9))
    found = shot(board, 90.0, light_distance_um=8000.0, convention=Convention(light_angle_deg=30.0)).radiance
    assert np.nanmean(found[:, -20:]) > 1.2 * np.nanmean(found[:, :20])


def test_near_light_refuses_what_it_cannot_do():
    board = plate(checkerboard(4))
    with pytest.raises(ModelError, match="direct light only"):
        shot(board, light_distance_um=1e5, bounces=2)
    smooth = plate(checkerboard(4), material=Material(0.002, 0.002))
    with pytest.raises(ModelError, match="too fine a grid"):
        shot(smooth, light_distance_um=1000.0)


def test_display_is_srgb_of_the_share_of_white():
    linear = np.array([0.0, 0.001, 0.2158605, 1.0, 3.0, np.nan])
    np.testing.assert_array_equal(displayed(linear * 0.3, 0.3), [0, 3, 128, 255, 255, 0])
    np.testing.assert_array_equal(displayed(np.array([0.1, 0.2]), 0.4, "linear"), [64, 128])


def test_extent_bounds_what_is_seen():
    view = View((10, 10), 1.0, 30.0, (1.0, 0.5))
    height, width = view.extent_um((20.0, 60.0))
    corners = np.array([[-30, -10], [30, -10], [30, 10], [-30, 10]], dtype=float)
    row, column = view.row_column(corners[:, 0], corners[:, 1])
    assert (height, width) == pytest.approx((np.ptp(row), np.ptp(column)))
