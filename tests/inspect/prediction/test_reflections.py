"""Reflections of predictions against reference numbers of an independent prototype, against paths, and the budget."""

import json
from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.cli import run
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import expectation
from anisoscope.prediction.height_map_uncertainty import pixel_error
from anisoscope.prediction.reflections import (
    STAND_IN_NODES,
    STAND_IN_NODES_OF_TAIL,
    Followed,
    Groove,
    StandIn,
    fitted_groove,
    reflections_of_map,
)
from anisoscope.prediction.relief_preparation import prepare_relief
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.relief_paths import interreflection as followed_paths

DESIGN = RidgeDesign(100.0, 10.0)
DARK_PLASTIC = Material(0.08, 0.08, 0.1, 1.5)
POSES = pose_grid((0.0, 90.0, 180.0), (0.0, -10.0, 10.0))
SIDES = directions(POSES, Convention())
SMOOTH = {"alpha_along": 0.08, "alpha_across": 0.08, "albedo": 0.1}


@pytest.fixture
def dark_recipe(make_recipe):
    def made(**surface):
        return make_recipe(material=SMOOTH, surface=surface)

    return made


@pytest.fixture(scope="module")
def measured_map(tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "map.x3p"
    surface = add_facet_roughness(ridges(DESIGN, (150, 501), 1.0), 0.03, 0.03, 8.0, np.random.default_rng(1))
    write_height_map(surface, path)
    return path


def test_all_over_direct_light_of_smooth_dark_plastic_is_the_reference():
    """Ridges of 10°, α 0.08, ρ 0.1: from direct light alone, 18 and 32 % of ln L would be missing at 90 and 180°."""
    direct = corrected.radiance(*SIDES, DESIGN, DARK_PLASTIC)
    ratio = 1.0 + Groove(DESIGN).light(*SIDES, DARK_PLASTIC) / direct
    reference = [1.011, 1.196, 1.372, 1.011, 1.000, 1.029, 1.011, 1.213, 1.029]
    np.testing.assert_allclose(ratio, reference, atol=0.0015)


@pytest.mark.parametrize(("reflections", "log_ratio"), [("direct", 0.115), (2, -0.024), ("all", -0.022)])
def test_the_ratio_of_90_to_180_degrees_is_the_reference(dark_recipe, reflections, log_ratio):
    found = expectation(dark_recipe(reflections=reflections), 10.0)
    assert np.log(found.radiance[1] / found.radiance[2]) == pytest.approx(log_ratio, abs=0.0015)
    assert found.optics["bounces"] == {"direct": 1}.get(reflections, reflections)


def test_the_budget_holds_amplitude_and_model_of_the_reflections(dark_recipe):
    found = {c.source: c for c in expectation(dark_recipe(), 10.0).components}
    amplitude, model = found["amplitude of the reflections"], found["model of the reflections"]
    within = 1.0 - 1.0 / np.array([1.011, 1.196, 1.372])
    np.testing.assert_allclose(amplitude.relative, 0.1 * within, atol=2e-4)
    assert amplitude.shared
    np.testing.assert_allclose(model.relative, np.hypot(0.005, 0.05 * within), atol=2e-4)
    assert not model.shared
    direct = {c.source for c in expectation(dark_recipe(reflections="direct"), 10.0).components}
    assert not any("reflections" in source for source in direct)


def test_two_reflections_stand_in_for_all_of_them_nearby():
    stand_in = StandIn(Groove(DESIGN), *SIDES, DARK_PLASTIC)
    exact = Groove(DESIGN).light(*SIDES, DARK_PLASTIC)
    np.testing.assert_allclose(stand_in.of(Groove(DESIGN))(*SIDES, DARK_PLASTIC), exact, rtol=1e-12)
    rougher = replace(DARK_PLASTIC, alpha_across=0.084, albedo=0.11)
    steeper = Groove(RidgeDesign(100.0, 10.2))
    found = stand_in.of(steeper)(*SIDES, rougher)
    np.testing.assert_allclose(found, steeper.light(*SIDES, rougher), rtol=0.004, atol=1e-6)


@pytest.mark.parametrize(
    ("tail", "nodes"), [(0.0, STAND_IN_NODES), (0.5, STAND_IN_NODES_OF_TAIL), (1.4, STAND_IN_NODES_OF_TAIL)]
)
def test_the_rule_of_the_stand_in_is_off_by_less_than_a_thousandth(tail, nodes):
    plastic = replace(DARK_PLASTIC, tail=tail)
    exact = Groove(DESIGN, bounces=2, nodes=10).light(*SIDES, plastic)
    found = Groove(DESIGN, bounces=2, nodes=nodes).light(*SIDES, plastic)
    np.testing.assert_allclose(found, exact, rtol=1e-3, atol=1e-6)


def test_the_light_of_a_groove_does_not_depend_on_its_size_and_turns_with_its_facets():
    small, turned = Groove(RidgeDesign(20.0, 10.0)), Groove(DESIGN, lean_deg=180.0)
    found = Groove(DESIGN).light(*SIDES, DARK_PLASTIC)
    np.testing.assert_array_equal(small.light(*SIDES, DARK_PLASTIC), found)
    half = directions(POSES, Convention(facet_azimuth_deg=180.0))
    np.testing.assert_allclose(turned.light(*half, DARK_PLASTIC), found, rtol=1e-9)


@pytest.mark.parametrize(
    ("angle", "wall", "rough"),
    [
        (6.0, "perpendicular", 0.03),
        (10.0, "vertical", 0.0),
        (20.0, "perpendicular", 0.03),
        *(
            pytest.param(*design, rough, marks=pytest.mark.soak)
            for *design, rough in (
                (6.0, "perpendicular", 0.0),
                (10.0, "vertical", 0.03),
                (20.0, "perpendicular", 0.0),
            )
        ),
    ],
)
def test_the_groove_of_a_map_is_that_of_its_ridges(angle, wall, rough):
    surface = ridges(RidgeDesign(100.0, angle, wall), (160, 601), 1.0)
    surface = add_facet_roughness(surface, rough, rough, 8.0, np.random.default_rng(1))
    found = fitted_groove(Relief(surface, 100.0))
    assert found.design.ridge_angle_deg == pytest.approx(angle, abs=0.1)
    assert (found.design.wall, found.lean_deg) == (wall if angle > 8.0 else "perpendicular", 0.0)
    np.testing.assert_allclose(found.resolved, rough, atol=0.006)
    mirrored = fitted_groove(Relief(surface.with_height(surface.height_um[:, ::-1]), 100.0))
    assert mirrored.lean_deg == 180.0
    placed = fitted_groove(prepare_relief(surface.with_height(surface.height_um[:, ::-1]))[0])
    assert placed.lean_deg == 0.0


def test_a_single_ridge_has_a_groove_and_a_rough_plane_has_paths():
    one = fitted_groove(Relief(ridges(DESIGN, (4, 101), 1.0), 100.0))
    assert one.design.ridge_angle_deg == pytest.approx(10.0, abs=0.05)
    plane = HeightMap(5.0 * np.random.default_rng(1).standard_normal((40, 60)), 1.0, 1.0)
    with pytest.raises(HeightMapError, match="no groove"):
        fitted_groove(Relief(plane))
    found = reflections_of_map(Relief(plane), 2)
    assert isinstance(found, Followed)
    assert "no groove" in found.reason
    traced = followed_paths(Relief(plane), *SIDES, DARK_PLASTIC, 2)
    np.testing.assert_array_equal(found.light(*SIDES, DARK_PLASTIC), traced.radiance)


def test_the_groove_added_to_a_map_agrees_with_paths_on_it():
    """A closed case: sharp ridges, whose paths on fine points are those of facet and wall."""
    relief = Relief(ridges(DESIGN, (60, 601), 1.0), 100.0)
    all_light = corrected.radiance(*SIDES, DESIGN, DARK_PLASTIC, bounces=None)
    paths = followed_paths(relief, *SIDES, DARK_PLASTIC).radiance
    np.testing.assert_allclose(
        fitted_groove(relief).light(*SIDES, DARK_PLASTIC), paths, atol=0.025 * all_light.min()
    )


def test_pixels_count_by_the_light_between_facet_and_wall():
    """4 % at 180° and 2 to 2.5 % at 90° for pixels of 1/50 of the pitch, about 1 % where there is direct light only."""
    indirect = Groove(DESIGN).light(*SIDES, DARK_PLASTIC)[:3]
    radiance = corrected.radiance(*SIDES, DESIGN, DARK_PLASTIC)[:3] + indirect
    share = pixel_error(2.0, 100.0, radiance, indirect) / radiance
    np.testing.assert_allclose(share, [0.0116, 0.025, 0.041], atol=0.003)
    np.testing.assert_allclose(pixel_error(1.0, 100.0, radiance, indirect), 0.5 * share * radiance)


@pytest.mark.parametrize("surface", ["design", "map"])
def test_predict_with_a_recipe_is_what_an_inspection_expects_to_the_digit(
    dark_recipe, measured_map, tmp_path, capsys, surface
):
    table = {"height_map": str(measured_map), "design": None} if surface == "map" else {}
    recipe = dark_recipe(**table)
    path = tmp_path / "recipe.toml"
    path.write_text(
        as_toml(recipe.model_dump(mode="json", by_alias=True, exclude_none=True)), encoding="utf-8"
    )
    assert run(["predict", "--recipe", str(path), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    expected = expectation(recipe, 10.0)
    assert [pose["radiance"] for pose in printed["poses"]] == expected.radiance.tolist()
    assert printed["optics"]["reflections_from"] == "groove"
    options = ["--alpha-along", "0.08", "--alpha-across", "0.08", "--albedo", "0.1", "--pitch", "100"]
    subject = [str(measured_map)] if surface == "map" else ["--ridge-angle", "10"]
    assert run(["predict", *subject, *options, "--no-uncertainty", "--json"]) == 0
    by_options = json.loads(capsys.readouterr().out)
    assert [pose["radiance"] for pose in by_options["poses"]] == expected.radiance.tolist()


def as_toml(table, name=""):
    """A recipe's tables as TOML."""
    plain = "".join(
        f"{key} = {json.dumps(value)}\n" for key, value in table.items() if not isinstance(value, dict)
    )
    inner = "".join(
        as_toml(value, f"{name}.{key}" if name else key)
        for key, value in table.items()
        if isinstance(value, dict)
    )
    return (f"[{name}]\n" if name else "") + plain + inner


def test_options_that_a_recipe_decides_are_refused(tmp_path, capsys):
    assert run(["predict", "--recipe", str(tmp_path / "r.toml"), "--albedo", "0.3"]) != 0
    assert "leave --albedo out" in capsys.readouterr().err
