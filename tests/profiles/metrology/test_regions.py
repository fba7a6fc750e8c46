"""Regions of one ridge direction: where they are, which way they run, and how steep they are."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness
from anisoscope.profiles.metrology.regions import direction_regions
from anisoscope.profiles.patterns import GrooveDesign, flat, turned_ridges, v_grooves

SPEC = importlib.util.spec_from_file_location("boards", Path(__file__).with_name("boards.py"))
boards = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(boards)
turned_board = boards.turned_board


@pytest.mark.parametrize(
    "turn_deg", [37.0, *(pytest.param(turn, marks=pytest.mark.soak) for turn in (0.0, 90.0))]
)
def test_fields_of_a_board_are_found_however_it_lies_on_the_grid(turn_deg):
    surface, second = turned_board(turn_deg, 500, 4.0, 500.0)
    found = direction_regions(surface)
    assert len(found.azimuths_deg) == 2
    expected = [(turn_deg + one + 180.0) % 360.0 - 180.0 for one in (0.0, -90.0)]
    np.testing.assert_allclose(sorted(found.azimuths_deg), sorted(expected), atol=0.1)
    of_second = int(np.argmin(np.abs(np.array(found.azimuths_deg) - expected[1])))
    classes = np.array([-1, *(one.direction_class for one in found.regions)])[found.labels]
    assert np.mean((classes == of_second) == second) > 0.985
    assert {one.number for one in found.regions} == set(np.unique(found.labels)) - {0}


def test_opposite_leans_are_two_directions_and_angles_are_those_of_each():
    shape, gentle, steep = (240, 480), RidgeDesign(100.0, 6.0), RidgeDesign(100.0, 14.0)
    right = turned_ridges(gentle, shape, 4.0).height_um
    left = turned_ridges(steep, shape, 4.0, direction_deg=180.0).height_um
    height = np.where(np.arange(shape[1]) < 240, right, left)
    rng = np.random.default_rng(1)
    found = direction_regions(HeightMap(height + 0.05 * rng.standard_normal(shape), 4.0, 4.0))
    assert len(found.regions) == 2
    first, second = sorted(found.regions, key=lambda one: one.centre_um[0])
    assert abs(first.azimuth_deg) < 0.5
    assert abs(abs(second.azimuth_deg) - 180.0) < 0.5
    for region, design in ((first, gentle), (second, steep)):
        ridges = found.ridges(region)
        assert ridges.ridge_angle_deg.value == pytest.approx(design.ridge_angle_deg, abs=0.3)
        assert ridges.pitch_um == pytest.approx(100.0, rel=0.01)
        assert region.share == pytest.approx(0.5, abs=0.01)


def test_rough_ridges_of_one_direction_are_one_region():
    surface = add_facet_roughness(
        turned_ridges(RidgeDesign(100.0, 10.0), (300, 300), 4.0, direction_deg=20.0),
        alpha_along=0.06,
        alpha_across=0.06,
        correlation_um=12.0,
        rng=np.random.default_rng(3),
    )
    found = direction_regions(surface)
    assert len(found.regions) == 1
    assert found.azimuths_deg[0] == pytest.approx(20.0, abs=2.0)


def test_grooves_have_a_direction_without_lean_and_a_plane_has_none():
    found = direction_regions(v_grooves(GrooveDesign(100.0, 12.0), (300, 300), 4.0, direction_deg=30.0))
    assert not found.one_sided
    assert found.regions[0].direction_deg == pytest.approx(30.0, abs=1.0)
    assert direction_regions(flat((100, 100), 4.0)).regions == ()


def test_missing_points_belong_to_no_region():
    surface, _ = turned_board(0.0, 400, 4.0, 800.0)
    height = surface.height_um.copy()
    height[:60, :90] = np.nan
    found = direction_regions(surface.with_height(height))
    assert (found.labels[:60, :90] == 0).all()
    assert len(found.azimuths_deg) == 2


@pytest.mark.parametrize("width", [1.0, 4.0, 16.0, 60.0])
def test_textures_and_hills_have_no_regions(width):
    height = 2.0 * width * gaussian_filter(np.random.default_rng(1).standard_normal((300, 300)), width)
    assert direction_regions(HeightMap(height, 1.0, 1.0)).regions == ()


def test_rough_facets_and_lost_walls_leave_the_regions():
    board, _ = turned_board(0.0, 400, 2.5, 250.0)
    rough = gaussian_filter(np.random.default_rng(2).standard_normal(board.shape), 3.0)
    height = board.height_um + 1.5 * rough / rough.std()
    found = direction_regions(HeightMap(height, board.pixel_x_um, board.pixel_y_um))
    assert len(found.azimuths_deg) == 2
    steep = np.hypot(*np.gradient(board.height_um, board.pixel_y_um, board.pixel_x_um)) > np.tan(
        np.radians(30.0)
    )
    found = direction_regions(HeightMap(np.where(steep, np.nan, height), board.pixel_x_um, board.pixel_y_um))
    assert len(found.azimuths_deg) == 2
