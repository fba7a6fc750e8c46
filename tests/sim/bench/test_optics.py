"""Where things appear on the sensor, and how bright. Positions are worked out here, by complex numbers."""

import cv2
import numpy as np
import pytest
from scipy.special import j1

from anisoscope.base.errors import RigFileError
from anisoscope.rig.fixture import Fixture, Marker
from anisoscope.sim.bench.benchfile import OpticsPart, SensorPart
from anisoscope.sim.bench.optics import (
    defocus_transfer,
    defocused,
    image_of_fixture,
    image_of_surface,
    pixel_from_mm,
    vignette,
)

SENSOR = SensorPart(rows=360, cols=400)
ANGLES = (0.0, 33.0, 90.0, 180.0, 271.5)
PLACES = ((1.1, 0.2), (-0.3, 1.2), (-1.0, -0.6))


def optics(**fields):
    return OpticsPart(**({"pixel_um": 9.0, "blur_um": 6.0, "axis_px": (7.25, -4.5)} | fields))


def place_px(x_mm, y_mm, angle_deg, part):
    """(column, row): counter-clockwise turn about the axis, rows running down."""
    turned = (x_mm + 1j * y_mm) * np.exp(1j * np.radians(angle_deg)) * 1000.0 / part.pixel_um
    middle = (SENSOR.cols - 1) / 2 + part.axis_px[0], (SENSOR.rows - 1) / 2 + part.axis_px[1]
    return np.array([middle[0] + turned.real, middle[1] - turned.imag])


def centroid(image, near, radius):
    rows, cols = np.indices(image.shape)
    weight = np.where(np.hypot(cols - near[0], rows - near[1]) < radius, image, 0.0)
    return np.array([np.sum(weight * cols), np.sum(weight * rows)]) / weight.sum()


def label_centroid_mm(marker, side_mm, dictionary):
    """Centre of brightness of a printed label relative to the bare plate, in sample millimetres."""
    code = cv2.aruco.generateImageMarker(dictionary, marker.id, dictionary.markerSize + 2, borderBits=1)
    paper = np.pad(np.where(code > 0, 0.75, 0.03), 1, constant_values=0.75) - 0.04
    module = side_mm / (dictionary.markerSize + 2)
    index = (np.arange(len(paper)) - (len(paper) - 1) / 2) * module
    x = np.sum(paper.sum(axis=0) * index) / paper.sum()
    y = -np.sum(paper.sum(axis=1) * index) / paper.sum()
    return marker.x_mm + x, marker.y_mm + y


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("pixel_um", [9.0, 6.1])
def test_markers_appear_where_the_geometry_says(angle, pixel_um):
    part = optics(pixel_um=pixel_um)
    reach = 0.62 * pixel_um / 9.0
    markers = tuple(Marker(id=k, x_mm=reach * x, y_mm=reach * y) for k, (x, y) in enumerate(PLACES))
    fixture = Fixture(marker_mm=0.3 * reach, markers=markers)
    image = image_of_fixture(fixture, part, SENSOR, angle) - 0.04
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for marker in markers:
        expected = place_px(*label_centroid_mm(marker, fixture.marker_mm, dictionary), angle, part)
        found = centroid(image, expected, 1000 * 0.34 * reach / pixel_um)
        np.testing.assert_allclose(found, expected, atol=0.05)


@pytest.mark.parametrize("angle", ANGLES)
def test_the_map_from_millimetres_to_pixels_turns_counter_clockwise(angle):
    part = optics()
    for x, y in PLACES:
        np.testing.assert_allclose(
            pixel_from_mm(part, SENSOR, angle) @ [x, y, 1.0], place_px(x, y, angle, part)
        )


@pytest.mark.parametrize("angle", ANGLES)
def test_a_bright_patch_beside_the_axis_appears_at_its_place(angle):
    part, (rows, cols), pixel_y, pixel_x = optics(), (401, 601), 3.0, 2.0
    x_mm, y_mm = 0.34, 0.21  # the patch; the first row of a radiance map lies at −y
    y, x = np.indices((rows, cols), dtype=float)
    x_um, y_um = (x - (cols - 1) / 2) * pixel_x, (y - (rows - 1) / 2) * pixel_y
    patch = np.exp(-((x_um - 1000 * x_mm) ** 2 + (y_um - 1000 * y_mm) ** 2) / (2 * 40.0**2))
    image, _ = image_of_surface(patch.astype(np.float32), (pixel_y, pixel_x), part, SENSOR, angle)
    expected = place_px(x_mm, y_mm, angle, part)
    np.testing.assert_allclose(centroid(image, expected, 25.0), expected, atol=0.05)


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("pixel_um", [4.0, 9.0])
def test_light_is_conserved(angle, pixel_um):
    """Radiance times area on the sensor is radiance times area on the sample, for a pattern that ends inside."""
    part, rng = optics(pixel_um=pixel_um), np.random.default_rng(2)
    y, x = np.meshgrid(np.linspace(-1, 1, 301), np.linspace(-1, 1, 401), indexing="ij")
    pattern = np.where(np.hypot(x, y) < 0.8, 0.2 + rng.random(x.shape), 0.0).astype(np.float32)
    image, _ = image_of_surface(pattern, (3.0, 2.0), part, SENSOR, angle)
    on_sensor = image.sum(dtype=float) * pixel_um**2
    assert on_sensor == pytest.approx(pattern.sum(dtype=float) * 6.0, rel=2e-3)


def test_the_sample_covers_its_own_area_and_no_more():
    radiance = np.full((201, 301), 0.5, dtype=np.float32)
    image, cover = image_of_surface(radiance, (3.0, 2.0), optics(), SENSOR, 20.0)
    assert cover.sum() * 81.0 == pytest.approx(200 * 3.0 * 300 * 2.0, rel=0.02)
    np.testing.assert_allclose(image[cover == 1.0], 0.5, rtol=1e-5)
    assert not image[cover == 0.0].any()


def test_facets_without_a_height_are_not_dark_spots():
    radiance = np.full((201, 301), 0.5, dtype=np.float32)
    radiance[np.random.default_rng(1).random(radiance.shape) < 0.1] = np.nan
    radiance[90:130, 100:180] = np.nan
    image, cover = image_of_surface(radiance, (3.0, 2.0), optics(), SENSOR, 20.0)
    np.testing.assert_allclose(image[cover == 1.0], 0.5, rtol=1e-4)


def test_blur_spreads_a_point_by_lens_and_pixel():
    part = optics(pixel_um=4.0, blur_um=10.0, axis_px=(0.0, 0.0))
    point = np.zeros((401, 401), dtype=np.float32)
    point[200, 200] = 1.0
    image, _ = image_of_surface(point, (1.0, 1.0), part, SENSOR, 0.0)
    cols = np.arange(SENSOR.cols) - (SENSOR.cols - 1) / 2
    spread = np.sum(image.sum(axis=0) * cols**2) / image.sum() * 16.0
    assert spread == pytest.approx(10.0**2 + 4.0**2 / 12, rel=0.03)


def test_the_transfer_in_focus_is_that_of_two_overlapping_circles():
    share = np.linspace(0.0, 2.5, 11)
    half = np.minimum(share / 2.0, 1.0)
    expected = 2.0 / np.pi * (np.arccos(half) - half * np.sqrt(1.0 - half**2))
    np.testing.assert_allclose(defocus_transfer(share, 0.0), expected, atol=1e-12)


def test_far_out_of_focus_the_transfer_is_that_of_an_even_disc():
    share = np.linspace(1e-6, 0.02, 9)
    a = 4.0 * np.pi * 30.0 * share
    np.testing.assert_allclose(defocus_transfer(share, 30.0), 2.0 * j1(a) / a, atol=0.006)


@pytest.mark.parametrize("distance_mm", [-2.0, 0.7])
def test_a_point_out_of_focus_becomes_a_disc_as_wide_as_the_cone_of_light(distance_mm):
    part = optics(pixel_um=4.0, numerical_aperture=0.08, wavelength_nm=500.0)
    point = np.zeros((151, 161))
    point[75, 80] = 1.0
    image = defocused(point, part, distance_mm)
    rows, cols = np.indices(image.shape)
    distance_um = 4.0 * np.hypot(rows - 75, cols - 80)
    radius_um = 1000.0 * abs(distance_mm) * 0.08
    np.testing.assert_allclose(defocused(np.ones((31, 40)), part, distance_mm), 1.0, rtol=1e-6)
    assert 0.997 < image.sum() < 1.0  # light at the edge of the aperture is diffracted beyond the picture
    assert image[distance_um < 1.1 * radius_um].sum() > 0.95
    second = np.sum(image * np.where(distance_um < 1.3 * radius_um, distance_um**2, 0.0))
    assert second == pytest.approx(radius_um**2 / 2.0, rel=0.06)


def test_a_shifted_stage_takes_its_axis_along_and_a_part_its_place():
    part = optics()
    for x, y in PLACES:
        moved = pixel_from_mm(part, SENSOR, 33.0, 0.0, (0.4, -0.7), (x, y)) @ [0.1, 0.2, 1.0]
        away = np.array([0.4, 0.7]) * 1000.0 / part.pixel_um
        np.testing.assert_allclose(moved, place_px(x + 0.1, y + 0.2, 33.0, part) + away)


def test_vignetting_is_none_in_the_middle_and_full_in_the_corners():
    shade = vignette(optics(vignetting=0.3), SensorPart(rows=101, cols=201))
    assert shade[50, 100] == pytest.approx(1.0)
    np.testing.assert_allclose(shade[[0, 0, -1, -1], [0, -1, 0, -1]], 0.7, rtol=1e-6)
    assert np.all(np.diff(shade[50, :101]) >= 0)


@pytest.mark.parametrize(("dictionary", "number"), [("DICT_NONE", 0), ("DICT_4X4_50", 50)])
def test_a_fixture_that_opencv_cannot_print_is_refused(dictionary, number):
    marker = Marker(id=number, x_mm=0.0, y_mm=0.0)
    fixture = Fixture(dictionary=dictionary, marker_mm=0.5, markers=(marker,))
    with pytest.raises(RigFileError, match=r"^fixture\.(dictionary|markers)"):
        image_of_fixture(fixture, optics(), SENSOR, 0.0)
