"""Pictures of the fixture painted here, module by module, without the bench: what was put in must come back."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from anisoscope.base.errors import RegistrationError, RigFileError
from anisoscope.imaging.registration.placement import (
    Grid,
    angle_between,
    check_fixture,
    locate,
    marker_corners_mm,
    resample,
)
from anisoscope.rig.fixture import Fixture, Marker

SIZE = 460
PIXEL_UM = 9.0
SUB = 4
PLACES = ((1.56, 0.0), (0.0, 1.56), (-1.56, 0.0), (0.0, -1.56))
FIXTURE = Fixture(
    marker_mm=0.52, markers=tuple(Marker(id=k, x_mm=x, y_mm=y) for k, (x, y) in enumerate(PLACES))
)
ANGLES = (0.0, 17.3, 90.0, 180.0, 271.0)
RASTERS = {(0.0, 90.0), (17.3, 0.0), (17.3, 90.0), (90.0, 90.0)}  # of each run


def truth(angle_deg, pixel_um, shift_px=(0.0, 0.0)):
    """(2, 3) map from sample millimetres to (column, row): turn counter-clockwise, rows down."""
    factor = np.exp(1j * np.radians(angle_deg)) * 1000.0 / pixel_um
    middle = (SIZE - 1) / 2
    return np.array(
        [
            [factor.real, -factor.imag, middle + shift_px[0]],
            [-factor.imag, -factor.real, middle + shift_px[1]],
        ]
    )


def paint(matrix, fixture=FIXTURE, part=0.1, missing=(), vignetting=0.0, noise=0.0):
    """A picture of paper labels on a dark plate with a square part in the middle, by averaging points in pixels."""
    at = (np.arange(SIZE * SUB) + 0.5) / SUB - 0.5
    col, row = np.meshgrid(at, at)
    # points in a lattice would put an upright edge at a multiple of their distance
    jitter = np.random.default_rng(8).uniform(-0.5 / SUB, 0.5 / SUB, (2, *col.shape))
    col, row = col + jitter[0], row + jitter[1]
    full = np.vstack([matrix, [0.0, 0.0, 1.0]])
    x, y, _ = np.tensordot(np.linalg.inv(full), np.stack([col, row, np.ones_like(col)]), 1)
    picture = np.where(np.maximum(np.abs(x), np.abs(y)) < 0.6, part, 0.02)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, fixture.dictionary))
    modules = dictionary.markerSize + 2
    for marker in fixture.markers:
        if marker.id in missing:
            continue
        code = cv2.aruco.generateImageMarker(dictionary, marker.id, modules, borderBits=1) > 0
        paper = np.pad(code, 1, constant_values=True)
        right = np.floor((x - marker.x_mm) / fixture.marker_mm * modules + modules / 2 + 1).astype(int)
        down = np.floor((marker.y_mm - y) / fixture.marker_mm * modules + modules / 2 + 1).astype(int)
        inside = (right >= 0) & (right < modules + 2) & (down >= 0) & (down < modules + 2)
        picture[inside] = np.where(paper[down[inside], right[inside]], 0.24, 0.01)
    pixels = picture.reshape(SIZE, SUB, SIZE, SUB).mean(axis=(1, 3))
    line = np.linspace(-1, 1, SIZE) ** 2
    shade = 1.0 - vignetting * (line[:, None] + line[None, :]) / 2
    clean = gaussian_filter(pixels, 0.8) * shade
    return (clean + noise * np.random.default_rng(3).standard_normal(clean.shape)).astype(np.float32)


def worst_px(found, expected):
    """Largest error over the part, in pixels."""
    corners = np.array([[x, y, 1.0] for x in (-0.6, 0.6) for y in (-0.6, 0.6)])
    return np.linalg.norm(corners @ (found - expected).T, axis=1).max()


@pytest.mark.parametrize(
    "angle", [0.0, 17.3, *(pytest.param(angle, marks=pytest.mark.soak) for angle in ANGLES[2:4]), ANGLES[4]]
)
def test_turn_scale_and_shift_come_back(angle):
    matrix = truth(angle, PIXEL_UM, (5.4, -3.7))
    place = locate(paint(matrix, noise=0.004), FIXTURE)
    assert worst_px(place.matrix, matrix) < 0.03
    assert angle_between(angle, place.angle_deg) == pytest.approx(0.0, abs=0.02)
    assert place.pixel_um == pytest.approx(PIXEL_UM, rel=5e-4)
    np.testing.assert_allclose(place.axis_px, matrix[:, 2], atol=0.03)
    assert place.markers == 4
    assert place.residual_px < 0.1


def test_a_part_whose_brightness_flips_does_not_move_the_pictures():
    places = [locate(paint(truth(30.0, PIXEL_UM), part=part), FIXTURE).matrix for part in (0.003, 2.5)]
    np.testing.assert_allclose(places[0] @ [0.5, 0.5, 1.0], places[1] @ [0.5, 0.5, 1.0], atol=0.02)


def test_uneven_light_does_not_move_the_pictures():
    matrix = truth(12.0, PIXEL_UM)
    assert worst_px(locate(paint(matrix, vignetting=0.5), FIXTURE).matrix, matrix) < 0.03


def test_a_picture_without_values_here_and_there_is_still_located():
    matrix = truth(45.0, PIXEL_UM)
    picture = paint(matrix)
    picture[np.random.default_rng(1).random(picture.shape) < 1e-4] = np.nan
    picture[190:210, 190:210] = np.nan
    assert worst_px(locate(picture, FIXTURE).matrix, matrix) < 0.06


def test_three_markers_are_enough():
    matrix = truth(100.0, PIXEL_UM)
    place = locate(paint(matrix, missing=(1,)), FIXTURE)
    assert place.markers == 3
    assert worst_px(place.matrix, matrix) < 0.03


@pytest.mark.parametrize("angle", [0.0, 45.0, pytest.param(90.0, marks=pytest.mark.soak)])
def test_labels_that_nearly_touch_the_edge_of_the_picture_count(angle):
    # labels end 3 pixels from the edge
    reach = (SIZE / 2 - 3) * PIXEL_UM / 1000 - 0.52 * 4 / 6
    markers = tuple(
        Marker(id=k, x_mm=reach * x / 1.56, y_mm=reach * y / 1.56) for k, (x, y) in enumerate(PLACES)
    )
    fixture = Fixture(marker_mm=0.52, markers=markers)
    assert locate(paint(truth(angle, PIXEL_UM), fixture), fixture).markers == 4


@pytest.mark.parametrize("missing", [(0, 1), (0, 1, 2, 3)])
def test_fewer_than_three_markers_are_refused(missing):
    with pytest.raises(RegistrationError, match=f"only {4 - len(missing)} of 4 fixture markers"):
        locate(paint(truth(0.0, PIXEL_UM), missing=missing), FIXTURE)


def test_a_mirrored_picture_is_named():
    picture = paint(truth(17.3, PIXEL_UM))
    with pytest.raises(RegistrationError, match=r"the picture is mirrored: .*ReverseX"):
        locate(picture[:, ::-1], FIXTURE)


def test_markers_of_another_fixture_do_not_count():
    other = Fixture(
        marker_mm=0.52, markers=tuple(m.model_copy(update={"id": m.id + 10}) for m in FIXTURE.markers)
    )
    with pytest.raises(RegistrationError, match="only 0 of 4"):
        locate(paint(truth(0.0, PIXEL_UM), other), FIXTURE)


def test_a_marker_elsewhere_than_the_rig_file_says_is_left_out():
    moved = FIXTURE.markers[0].model_copy(update={"y_mm": 0.1})
    wrong = FIXTURE.model_copy(update={"markers": (moved, *FIXTURE.markers[1:])})
    matrix = truth(0.0, PIXEL_UM)
    place = locate(paint(matrix), wrong)
    assert (place.dropped, place.markers) == ((0,), 3)
    assert worst_px(place.matrix, matrix) < 0.03


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dictionary": "DICT_NONE"}, "fixture.dictionary"),
        ({"markers": FIXTURE.markers[:2]}, "at least 3 are needed"),
        ({"markers": (*FIXTURE.markers, Marker(id=50, x_mm=0.0, y_mm=0.0))}, "not 50"),
    ],
)
def test_a_fixture_that_cannot_work_is_refused_beforehand(changes, message):
    check_fixture(FIXTURE)
    with pytest.raises(RigFileError, match=message):
        check_fixture(FIXTURE.model_copy(update=changes))


def test_corners_run_clockwise_from_the_top_left():
    corners = marker_corners_mm(FIXTURE)[1]
    np.testing.assert_allclose(corners - [0.0, 1.56], 0.26 * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]))


@pytest.mark.parametrize(
    ("first", "second", "turn"), [(0, 90, 90), (90, 0, -90), (350, 10, 20), (10, 350, -20), (0, 720, 0)]
)
def test_the_turn_between_two_angles_is_the_short_way(first, second, turn):
    assert angle_between(first, second) == pytest.approx(turn)


@pytest.mark.parametrize("turn", [0.0, 30.0, 90.0, 180.0])
def test_a_raster_has_its_first_row_farthest_along_the_ridges(turn):
    grid = Grid((0.3, -0.2), 0.05, (8, 6), turn)
    along = 1j * np.exp(1j * np.radians(turn))  # ridges run at a right angle to the facets' azimuth
    to_mm = grid.to_mm()

    def at(column, row):
        x, y, _ = to_mm @ [column, row, 1.0]
        return complex(x, y)

    assert at(2.5, 3.5) == pytest.approx(0.3 - 0.2j)
    assert at(2.5, 0.0) - at(2.5, 7.0) == pytest.approx(7 * 0.05 * along)
    assert at(5.0, 3.5) - at(0.0, 3.5) == pytest.approx(5 * 0.05 * along / 1j)
    assert grid.size_mm == pytest.approx((0.4, 0.3))


@pytest.mark.parametrize(
    ("angle", "turn"),
    [
        pytest.param(angle, turn, marks=() if (angle, turn) in RASTERS else pytest.mark.soak)
        for angle in ANGLES
        for turn in (0.0, 90.0)
    ],
)
def test_whatever_the_stage_angle_the_raster_shows_the_same_place(angle, turn):
    """A picture of the sample's x and y coordinates, turned on the stage, gives the raster's own coordinates."""
    matrix = truth(angle, PIXEL_UM, (4.0, 1.0))
    place = locate(paint(matrix), FIXTURE)
    col, row = np.meshgrid(np.arange(SIZE, dtype=float), np.arange(SIZE, dtype=float))
    x, y, _ = np.tensordot(
        np.linalg.inv(np.vstack([matrix, [0, 0, 1.0]])), np.stack([col, row, np.ones_like(col)]), 1
    )
    grid = Grid((0.1, 0.2), 0.03, (30, 20), turn)
    points = np.stack([*np.indices(grid.shape)[::-1], np.ones(grid.shape)])
    expected = np.tensordot(grid.to_mm(), points, 1)
    for image, wanted in ((x, expected[0]), (y, expected[1])):
        found = resample(image.astype(np.float32), place, grid)
        np.testing.assert_allclose(found, wanted, atol=0.05 * PIXEL_UM / 1000 + PIXEL_UM / 1000 / 32)


def test_points_outside_the_picture_have_no_value():
    matrix = truth(0.0, PIXEL_UM)
    place = locate(paint(matrix), FIXTURE)
    found = resample(np.ones((SIZE, SIZE), np.float32), place, Grid((2.0, 0.0), 0.02, (10, 40)))
    edge_mm = (SIZE - 1) / 2 * PIXEL_UM / 1000
    x = 2.0 + (np.arange(40) - 19.5) * 0.02
    assert np.isfinite(found[:, x < edge_mm - 0.02]).all()
    assert np.isnan(found[:, x > edge_mm + 0.02]).all()
