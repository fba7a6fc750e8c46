"""Channels from the raw pixels of a mosaic: exact means, noise, and what makes them unfit."""

import numpy as np
import pytest

from anisoscope.base.errors import MeasurementError, RegistrationError, Saturated
from anisoscope.imaging.linearisation import RadianceImage
from anisoscope.imaging.registration.placement import Placement, View
from anisoscope.kinds.prints.measurement import cell_grid, measure_print, region_mean
from anisoscope.rig.bayer import channel_of_pixels

SIZE, PIXEL_UM = 300, 10.0
LEVELS = np.array([0.1, 0.4, 0.2])


def placed(angle_deg=0.0):
    """A view of the plate from above, turned, its origin in the middle."""
    turn, scale, middle = np.radians(angle_deg), 1000.0 / PIXEL_UM, (SIZE - 1) / 2.0
    cos, sin = scale * np.cos(turn), scale * np.sin(turn)
    matrix = np.array([[cos, -sin, middle], [-sin, -cos, middle]])
    return Placement(matrix, angle_deg, PIXEL_UM, (middle, middle), 0.1, 4)


def view(value, noise=0.01, saturated=None, angle_deg=0.0):
    picture = np.asarray(value, dtype=np.float32)
    scatter = np.full_like(picture, noise)
    clipped = np.zeros(picture.shape, dtype=bool) if saturated is None else saturated
    return View(angle_deg, 0.0, RadianceImage(picture, scatter, clipped, 0.5), placed(angle_deg))


@pytest.fixture
def mosaic():
    """A flat picture through a mosaic of three levels."""
    return LEVELS[channel_of_pixels("grbg", (SIZE, SIZE))]


def test_each_channel_is_the_mean_of_its_own_pixels(make_recipe, mosaic):
    found = measure_print([view(mosaic), view(mosaic, angle_deg=37.0)], None, make_recipe(), "grbg")
    assert found.channels == pytest.approx(np.tile(LEVELS, (2, 1)), rel=1e-6)
    assert found.cells.shape == (2, 3, 20, 20)
    assert found.cells == pytest.approx(np.broadcast_to(LEVELS[:, None, None], found.cells.shape), rel=1e-6)
    # 200 × 200 pixels, half of them green: the noise of a mean is that of a pixel over the root of their number
    noise = np.sqrt(np.diag(found.sources[0].covariance())).reshape(2, 3) * LEVELS
    assert noise[0] == pytest.approx(0.01 / np.sqrt(np.array([1.0, 2.0, 1.0]) * 1e4), rel=0.02)
    cell = found.cell_noise[0] * LEVELS
    assert cell == pytest.approx(0.01 / np.sqrt(np.array([25.0, 50.0, 25.0])), rel=0.1)


def test_without_a_map_all_of_a_long_region_counts(make_recipe):
    """Of a region twice as wide as high the outer half is twice as bright."""
    off = np.abs(np.arange(SIZE) - (SIZE - 1) / 2.0)
    picture = np.tile(np.where(off > 60.0, 2.0, 1.0), (SIZE, 1))
    region = {"size_mm": [2.4, 1.2], "center_mm": [0.0, 0.2]}
    found = measure_print([view(picture)], None, make_recipe(area=None, region=region), "rggb")
    assert found.channels == pytest.approx(np.full((1, 3), 1.5), rel=0.01)
    assert found.cells.shape == (1, 3, 1, 1)
    assert found.cells[..., 0, 0] == pytest.approx(found.channels)


def test_cells_lie_where_the_region_says(make_recipe):
    recipe = make_recipe(region={"center_mm": [0.2, -0.1]})
    rows, cols = np.indices((SIZE, SIZE))
    x_mm = (cols - (SIZE - 1) / 2.0) * PIXEL_UM / 1000.0
    y_mm = ((SIZE - 1) / 2.0 - rows) * PIXEL_UM / 1000.0
    found = measure_print([view(10.0 + 2.0 * x_mm + y_mm)], None, recipe, "rggb")
    grid = cell_grid(recipe)
    column, row = np.meshgrid(np.arange(20), np.arange(20))
    places = np.stack([column, row, np.ones_like(row)], axis=-1) @ grid.to_mm().T
    wanted = 10.0 + 2.0 * places[..., 0] + places[..., 1]
    assert found.cells[0] == pytest.approx(np.broadcast_to(wanted, (3, 20, 20)), abs=0.03)
    assert found.channels[0] == pytest.approx(np.full(3, 10.0 + 0.4 - 0.1), abs=0.01)


def test_turned_parts_show_the_same_cells(make_recipe):
    """A mark stays in its cell while the stage turns."""
    recipe = make_recipe()
    rows, cols = np.indices((SIZE, SIZE))
    found = []
    for angle in (0.0, 90.0, 180.0):
        where = placed(angle).homography @ [0.45, -0.25, 1.0]
        mark = np.hypot(cols - where[0], rows - where[1]) < 6.0
        found.append(view(np.where(mark, 0.1, 1.0), angle_deg=angle))
    cells = measure_print(found, None, recipe, "rggb").cells[:, 1]
    darkest = [np.unravel_index(one.argmin(), one.shape) for one in cells]
    assert len({tuple(int(k) for k in at) for at in darkest}) == 1


def test_pixels_without_a_value_do_not_count(make_recipe, mosaic):
    holed = mosaic.copy()
    holed[100:104, 120:124] = np.nan
    assert region_mean(view(holed), make_recipe(), "grbg") == pytest.approx(LEVELS.mean(), rel=1e-6)


def test_drift_is_that_of_the_first_pose(make_recipe, mosaic):
    found = measure_print([view(mosaic)], view(1.01 * mosaic), make_recipe(), "grbg")
    assert found.drift == pytest.approx(0.01, rel=1e-4)


def test_what_is_unfit_is_said(make_recipe, mosaic):
    recipe = make_recipe()
    clipped = np.zeros(mosaic.shape, dtype=bool)
    clipped[140:160, 140:160] = True
    with pytest.raises(Saturated, match=r"1\.00% of the region are saturated .*exposure_s"):
        measure_print([view(mosaic, saturated=clipped)], None, recipe, "grbg")
    with pytest.raises(RegistrationError, match="outside the picture"):
        measure_print([view(mosaic)], None, make_recipe(region={"size_mm": [2.9, 3.2]}), "grbg")
    with pytest.raises(MeasurementError, match=r"darker than the dark frames in red.*brackets"):
        measure_print([view(mosaic - 0.2)], None, recipe, "grbg")
    holed = mosaic.copy()
    holed[50:90] = np.nan
    with pytest.raises(MeasurementError, match=r"20\.0% of the region have no usable pixels"):
        measure_print([view(holed)], None, recipe, "grbg")
    with pytest.raises(MeasurementError, match="usable pixels of some colour"):
        measure_print([view(mosaic)], None, make_recipe(area={"cell_mm": 0.03}), "grbg")
