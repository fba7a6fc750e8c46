"""Walls and crests that fall between the points of a height map, wherever the ridges run on it."""

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import expectation
from anisoscope.prediction.height_map_uncertainty import edge_contributions, relief_model
from anisoscope.prediction.predict import predict_height_map
from anisoscope.prediction.relief_preparation import prepare_relief
from anisoscope.prediction.ridge_edges import ridge_edges
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.patterns import checkerboard, turned_ridges
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions

DARK_PLASTIC = Material(0.08, 0.08, 0.1)
POSES = (Pose(0.0), Pose(90.0), Pose(180.0))
SIDES = directions(POSES, Convention())
UPRIGHT = RidgeDesign(99.3, 10.0, 3.0, 0.0, 1.0)
"""Steep walls, and no whole number of pixels a pitch."""


def sampled(design, pixel_um, direction_deg=0.0, shape=None, phase=0.37):
    size = shape or (60, int(620.0 / pixel_um))
    return turned_ridges(design, size, pixel_um, direction_deg=direction_deg, phase=phase)


def with_reflections(surface):
    """Radiance with two reflections, its uncertainty from walls and crests, and the fit."""
    relief, _ = prepare_relief(surface, 100.0)
    edges = ridge_edges(relief)
    indirect = edges.indirect(*SIDES, DARK_PLASTIC, 2)
    radiance = relief_model(relief, edges=edges)(*SIDES, DARK_PLASTIC) + indirect
    stated = edge_contributions(edges, SIDES, DARK_PLASTIC, radiance, indirect)
    return radiance, np.sqrt(sum(one.absolute**2 for one in stated)), edges


@pytest.mark.parametrize("pixel_um", [1.0, 2.0])
def test_a_wall_between_the_points_is_found_and_predicted(pixel_um):
    found, _, edges = with_reflections(sampled(UPRIGHT, pixel_um))
    assert edges.design.wall == pytest.approx(3.0, abs=1.5)
    assert edges.design.edge_radius_um == pytest.approx(1.0, abs=0.35)
    truth = corrected.radiance(*SIDES, UPRIGHT, DARK_PLASTIC, 2)
    np.testing.assert_allclose(found, truth, rtol=0.03)
    perpendicular = corrected.indirect_radiance(*SIDES, RidgeDesign(99.3, 10.0), DARK_PLASTIC, 2)
    relief, _ = prepare_relief(sampled(UPRIGHT, pixel_um), 100.0)
    before = relief_model(relief)(*SIDES, DARK_PLASTIC) + perpendicular
    assert np.max(np.abs(before / truth - 1.0)) > 0.05


def test_points_that_are_missing_at_the_walls_are_those_of_the_profile():
    surface = sampled(UPRIGHT, 2.0)
    height = np.array(surface.height_um)
    steep = np.abs(np.gradient(height, 2.0, axis=1)) > 0.6
    gone = steep & (np.random.default_rng(0).random(height.shape) < 0.5)
    height[gone] = np.nan
    found, u, _ = with_reflections(surface.with_height(height))
    truth = corrected.radiance(*SIDES, UPRIGHT, DARK_PLASTIC, 2)
    assert 0.01 < np.isnan(height).mean() < 0.1
    assert np.all(np.abs(found - truth) < 2.0 * u + 0.005 * truth)


@pytest.mark.parametrize("phase", [0.2, 0.371, 0.79])
def test_what_whole_pixels_a_pitch_leave_open_is_stated(phase):
    """Every wall is sampled at the same places: its draft is open, and that is in the uncertainty."""
    design = RidgeDesign(100.0, 10.0, 5.0, 0.0, 1.2)
    found, u, edges = with_reflections(sampled(design, 2.0, phase=phase))
    truth = corrected.radiance(*SIDES, design, DARK_PLASTIC, 2)
    assert np.all(np.abs(found - truth) < 2.5 * u)
    assert np.abs(edges.steps[:, 1]).max() > 0.05


@pytest.mark.parametrize(
    "directions_deg", [(0.0, 37.0, 90.0), pytest.param((0.0, 17.0, -52.0, 90.0), marks=pytest.mark.soak)]
)
def test_a_surface_is_expected_alike_whichever_way_it_lies_on_its_map(make_recipe, tmp_path, directions_deg):
    """By predict, and as an inspection expects it; lobe, pitch and walls turn with the ridges."""
    design, lobe = RidgeDesign(100.0, 10.0, 8.0, 0.0, 1.0), {"alpha_along": 0.06, "alpha_across": 0.1}
    plastic, found = Material(0.06, 0.1, 0.2), {}
    truth = corrected.radiance(*SIDES, design, plastic, None)
    for direction in directions_deg:
        surface = sampled(design, 2.0, direction, (310, 310))
        found[direction] = predict_height_map(surface, plastic, POSES, Convention()).radiance
        np.testing.assert_allclose(found[direction], truth, rtol=0.02 if direction % 90.0 == 0.0 else 0.01)
        path = tmp_path / f"{direction}.x3p"
        write_height_map(surface, path)
        if direction in (0.0, 37.0):
            table = {"pitch_um": 100.0, "height_map": str(path), "design": None}
            recipe = make_recipe(surface=table, material=lobe | {"albedo": 0.2})
            expected = expectation(recipe, 10.0)
            np.testing.assert_allclose(expected.radiance, found[direction], rtol=1e-6)
    np.testing.assert_allclose(found[90.0], found[0.0], rtol=1e-6)


@pytest.mark.parametrize(("field_um", "pitch_um"), [(800.0, None), (200.0, 100.0)])
def test_ridges_of_two_directions_are_refused_where_the_lobe_has_a_direction(field_um, pitch_um):
    surface = checkerboard(RidgeDesign(100.0, 10.0), (401, 401), 4.0, field_um)
    with pytest.raises(HeightMapError, match=r"crop the map to ridges of one direction, or give alpha_along"):
        predict_height_map(surface, Material(0.06, 0.1), POSES, Convention(), pitch_um)


def test_a_round_lobe_sees_ridges_of_two_directions_facet_by_facet():
    surface = checkerboard(RidgeDesign(100.0, 10.0), (401, 401), 4.0, 800.0)
    found = predict_height_map(surface, DARK_PLASTIC, POSES, Convention(), bounces=1).radiance
    turned = [directions(POSES, Convention(facet_azimuth_deg=azimuth)) for azimuth in (0.0, -90.0)]
    both = [corrected.radiance(*sides, RidgeDesign(100.0, 10.0), DARK_PLASTIC) for sides in turned]
    np.testing.assert_allclose(found, np.mean(both, axis=0), rtol=0.05)
