"""The stated uncertainty of a prediction against what the prediction really does."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm, qmc

from anisoscope.base.errors import RecipeError
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import expectation
from anisoscope.prediction.part_scatter import part_scatter
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, seating_rotation

DESIGN = RidgeDesign(100.0, 10.0)
SPREAD = {"design": {"u_ridge_angle_deg": 0.2}}
ZS = 0.1 * norm.ppf((np.arange(4) + 0.5) / 4)  # small, so that the first order is all there is
PAIRS = np.array([[1, -1, 0], [0, 1, -1]])


def log_ratios(recipe, light_deg=10.0, seating=(0.0, 0.0), design=DESIGN, **material):
    to_light, to_camera = directions(recipe.poses.poses(), Convention(light_deg))
    seat = seating_rotation(*seating)
    plastic = replace(recipe.material.material(), **material)
    return PAIRS @ np.log(
        corrected.radiance(to_light @ seat, to_camera @ seat, design, plastic, bounces=None)
    )


CHANGES = {
    "roughness along the ridges": lambda recipe, z: log_ratios(recipe, alpha_along=0.06 * (1 + 0.03 * z)),
    "roughness across the ridges": lambda recipe, z: log_ratios(recipe, alpha_across=0.10 * (1 + 0.03 * z)),
    "albedo of the plastic": lambda recipe, z: log_ratios(recipe, albedo=0.2 + 0.006 * z),
    "refractive index": lambda recipe, z: log_ratios(recipe, index=1.5 + 0.005 * z),
    "light angle": lambda recipe, z: log_ratios(recipe, light_deg=10.0 + 0.1 * z),
    "seating tilt about x": lambda recipe, z: log_ratios(recipe, seating=(0.05 * z, 0.0)),
    "seating tilt about y": lambda recipe, z: log_ratios(recipe, seating=(0.0, 0.05 * z)),
    "ridge angle of the design": lambda recipe, z: log_ratios(
        recipe, design=RidgeDesign(100.0, 10.0 + 0.2 * z)
    ),
}


EACH_RUN = {"roughness along the ridges", "light angle", "seating tilt about y", "ridge angle of the design"}


@pytest.mark.parametrize(
    "source", [name if name in EACH_RUN else pytest.param(name, marks=pytest.mark.soak) for name in CHANGES]
)
def test_every_component_is_the_spread_that_its_cause_makes(make_recipe, source):
    recipe = make_recipe(surface=SPREAD)
    (part,) = (c for c in expectation(recipe, 10.0).components if c.source == source)
    stated = np.sqrt(np.diag(PAIRS @ part.covariance() @ PAIRS.T))
    spread = np.std([CHANGES[source](recipe, z) for z in ZS], axis=0) / np.std(ZS)
    np.testing.assert_allclose(stated, spread, rtol=0.03, atol=3e-4)


@pytest.mark.parametrize("optics", [1, None])
def test_the_edge_radius_of_a_design_counts_with_its_uncertainty(make_recipe, optics):
    """Crests of 2 ± 0.5 µm, which scatter by a fifth, in direct light and with all reflections."""
    stated = {"edge_radius_um": 2.0, "u_edge_radius_share": 0.25}
    reflections = "all" if optics is None else "direct"
    recipe = make_recipe(surface={"design": stated, "reflections": reflections})
    expected = expectation(recipe, 10.0)

    def radiance(radius):
        design = RidgeDesign(100.0, 10.0, edge_radius_um=radius)
        sides = directions(recipe.poses.poses(), Convention(10.0))
        return corrected.radiance(*sides, design, recipe.material.material(), bounces=optics)

    np.testing.assert_allclose(expected.radiance, radiance(2.0), rtol=1e-6)
    (part,) = (c for c in expected.components if c.source == "edge radius")
    slope = 0.5 * (np.log(radiance(2.05)) - np.log(radiance(1.95))) / 0.05
    np.testing.assert_allclose(part.relative, np.hypot(0.5, 0.4) * slope, rtol=0.05, atol=2e-4)
    assert np.abs(part.relative).max() > 2e-3
    assert part.shared
    sharp = expectation(make_recipe(), 10.0)
    assert not any("edge" in c.source for c in sharp.components)


def test_an_unmeasured_edge_is_in_the_budget_and_not_in_the_prediction(make_recipe):
    """The radius is anything up to 1 µm, and the form that of a few chords, which may stand in the mirror direction."""
    sharp, unmeasured = (
        expectation(make_recipe(surface={"design": {"edge_radius_um": one}}), 10.0) for one in (0.0, None)
    )
    np.testing.assert_array_equal(unmeasured.radiance, sharp.radiance)
    (radius,) = (c for c in unmeasured.components if c.source == "edge radius")
    (form,) = (c for c in unmeasured.components if c.source == "form of the edge")
    recipe = make_recipe()
    sides, plastic = directions(recipe.poses.poses(), Convention(10.0)), recipe.material.material()

    def radiance(radius_um):
        return corrected.radiance(
            *sides, RidgeDesign(100.0, 10.0, edge_radius_um=radius_um), plastic, bounces=None
        )

    half = np.log(radiance(0.5) / radiance(0.0))
    np.testing.assert_allclose(radius.relative, half * np.sqrt(4.0 / 3.0 + 0.01), rtol=0.05, atol=2e-4)
    assert 0.005 < half[2] < form.relative[2] < 0.03
    assert radius.shared
    assert not form.shared
    flat = expectation(
        make_recipe(surface={"design": {"ridge_angle_deg": 0.0, "edge_radius_um": None}}), 10.0
    )
    assert not any("edge" in c.source for c in flat.components)


def test_edges_scatter_from_part_to_part(make_recipe):
    """What is common to the parts is how far the radius is from measured; what differs is a fifth of it."""
    parts = part_scatter(make_recipe(surface={"design": {"edge_radius_um": None}}), 10.0)
    at = parts.response.sources.index("edge radius")
    assert parts.common[at] / parts.own[at] == pytest.approx((1.0 / np.sqrt(3.0)) / (0.2 * 0.5))
    assert not parts.response.bend[:, at].any()
    assert "edge radius" not in part_scatter(make_recipe(), 10.0).response.sources


def test_a_spread_that_is_not_stated_is_in_nothing(make_recipe):
    plain, stated = (expectation(make_recipe(**change), 10.0) for change in ({}, {"surface": SPREAD}))
    name = "ridge angle of the design"
    assert not any(name in c.source for c in plain.components)
    assert name not in plain.response.sources
    assert stated.response.sources == (*plain.response.sources, name)
    np.testing.assert_array_equal(stated.radiance, plain.radiance)
    np.testing.assert_array_equal(stated.response.slope[:, :-1], plain.response.slope)
    np.testing.assert_array_equal(stated.response.bend[:, :-1, :-1], plain.response.bend)
    kept = [c for c in stated.components if name not in c.source]
    assert [c.source for c in kept] == [c.source for c in plain.components]


@pytest.mark.statistics
def test_the_whole_covariance_is_that_of_material_drawn_from_its_uncertainty(make_recipe):
    recipe = make_recipe()
    part = recipe.material
    draws = []
    for along, across, albedo, index in norm.ppf(qmc.Sobol(4, rng=3).random(32)):
        draws.append(
            log_ratios(
                recipe,
                alpha_along=part.alpha_along * (1 + part.u_alpha_share * along),
                alpha_across=part.alpha_across * (1 + part.u_alpha_share * across),
                albedo=part.albedo + part.u_albedo * albedo,
                index=part.index + part.u_index * index,
            )
        )
    of_material = ("roughness", "albedo", "refractive")
    stated = sum(
        c.covariance() for c in expectation(recipe, 10.0).components if c.source.startswith(of_material)
    )
    np.testing.assert_allclose(np.sqrt(np.diag(PAIRS @ stated @ PAIRS.T)), np.std(draws, axis=0), rtol=0.12)


def test_the_change_per_degree_is_that_of_a_turned_stage(make_recipe):
    found = expectation(make_recipe(), 10.0)
    turned = expectation(make_recipe(poses={"angles_deg": [0.5, 90.5, 180.5]}), 10.0)
    back = expectation(make_recipe(poses={"angles_deg": [-0.5, 89.5, 179.5]}), 10.0)
    slope = np.log(turned.radiance / back.radiance)
    np.testing.assert_allclose(found.per_degree, slope, rtol=0.02, atol=1e-4)


@pytest.fixture(scope="module")
def measured_map(tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "map.x3p"
    surface = ridges(DESIGN, (401, 501), (1.0, 1.0))
    surface = add_facet_roughness(surface, 0.03, 0.03, 8.0, np.random.default_rng(1))
    write_height_map(surface, path)
    return path, surface


def test_a_height_map_is_one_more_source_of_uncertainty(make_recipe, measured_map):
    path, _ = measured_map
    surface = {"pitch_um": 100.0, "height_map": str(path), "design": None, "walls": "sampled"}
    recipe = make_recipe(surface=surface, uncertainty={"height_map_share": 0.02})
    found, ideal = expectation(recipe, 10.0), expectation(make_recipe(), 10.0)
    assert (found.model, ideal.model) == ("relief", "corrected")
    (part,) = (c for c in found.components if c.source.startswith("height map"))
    (amplitude,) = (c for c in found.components if c.source == "amplitude of the reflections")
    within = (
        amplitude.relative / recipe.uncertainty.reflections_share
    )  # share of the light that reflects again
    # of a pitch a pixel of facet is lost; a wall of a pixel reflects otherwise
    pixel_share = 0.01 * np.hypot((1.0 - within) / np.sqrt(3.0), 7.5 * within)
    np.testing.assert_allclose(part.covariance(), np.diag(0.02**2 + pixel_share**2))
    sources = [{c.source for c in one.components if "second order" not in c.source} for one in (found, ideal)]
    assert sources[0] - sources[1] == {part.source}
    names = {"roughness across the ridges", "seating tilt about y"}
    stated = [{c.source: c.relative for c in e.components if c.source in names} for e in (found, ideal)]
    for name in names:  # roughness that the map resolves softens the lobe a little
        np.testing.assert_allclose(stated[0][name], stated[1][name], rtol=0.35, atol=2e-3)


def test_walls_that_are_fitted_are_sources_of_their_own(make_recipe, measured_map):
    table = {"pitch_um": 100.0, "height_map": str(measured_map[0]), "design": None}
    found = expectation(make_recipe(surface=table), 10.0)
    walls = [c for c in found.components if c.source.startswith("walls and crests between the points")]
    assert [c.shared for c in walls] == [True, True, True, False]


def test_missing_rows_at_the_edge_of_a_map_leave_the_uncertainty_known(make_recipe, measured_map, tmp_path):
    _, surface = measured_map
    height = surface.height_um.copy()
    height[:90] = np.nan
    write_height_map(surface.with_height(height), tmp_path / "holes.x3p")
    table = {"pitch_um": 100.0, "height_map": str(tmp_path / "holes.x3p"), "design": None}
    found = expectation(make_recipe(surface=table), 10.0)
    assert all(np.isfinite(c.relative).all() for c in found.components)


@pytest.mark.parametrize(
    "material",
    [
        {"alpha_along": 0.001},
        {"alpha_across": 1.0},
        {"albedo": 0.0},
        {"albedo": 1.0},
        {"index": 1.001},
        {"index": 4.0},
    ],
)
def test_materials_at_the_edge_of_what_is_possible_have_an_uncertainty(make_recipe, material):
    found = expectation(make_recipe(material=material, poses={"angles_deg": [0.0, 20.0]}), 10.0)
    assert all(np.isfinite(c.relative).all() for c in found.components)


def test_a_part_that_should_be_black_is_refused(make_recipe):
    recipe = make_recipe(  # diffraction would leave a little light
        material={"albedo": 0.0, "alpha_along": 0.01, "alpha_across": 0.01}, surface={"optics": "geometric"}
    )
    with pytest.raises(RecipeError, match=r"at 0°.*no light of this part") as caught:
        expectation(recipe, 10.0)
    assert "\n" not in str(caught.value)


def test_the_facet_azimuth_is_a_turn_of_the_part(make_recipe):
    lying = expectation(make_recipe(poses={"facet_azimuth_deg": 90.0}), 10.0)
    turned = expectation(make_recipe(poses={"angles_deg": [90.0, 180.0, 270.0]}), 10.0)
    np.testing.assert_allclose(lying.radiance, turned.radiance, rtol=1e-9)
