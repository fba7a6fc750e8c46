"""Rays or waves for a recipe: chosen by what the surface needs, said with a reason, counted where it is honest."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError, RecipeError
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction import recipe_models as models
from anisoscope.prediction.cache import _unpacked, packed
from anisoscope.prediction.expectation import PLASTIC, expectation
from anisoscope.prediction.optics_selection import OpticsRequest, Rig, predict_with_optics
from anisoscope.prediction.part_scatter import with_design
from anisoscope.prediction.predict import predict_design, predict_height_map
from anisoscope.prediction.relief_preparation import prepare_relief
from anisoscope.prediction.sensitivity import Shape
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.unresolved import resolve
from anisoscope.sim.light.wave.choice import NUMERICAL_ERROR

NARROW = {
    "surface": {"pitch_um": 12.0, "design": {"ridge_angle_deg": 4.0}},
    "region": {"size_mm": [1.0, 1.0]},
}
SMOOTH = {"alpha_along": 0.04, "alpha_across": 0.04, "u_tail": None}


def narrow(make_recipe, optics="auto", angle_deg=4.0, **change):
    """Ridges of 12 µm of a smooth plastic, where rays are off by a tenth."""
    surface = {**NARROW["surface"], "optics": optics, "design": {"ridge_angle_deg": angle_deg}}
    poses = {"angles_deg": [0.0, 90.0]}
    return make_recipe(surface=surface, material=SMOOTH, region=NARROW["region"], poses=poses, **change)


@pytest.fixture(scope="module")
def waves():
    """Prediction of the narrow ridges by waves, which takes a while; made when it is first wanted."""
    kept = []

    def found(make_recipe):
        kept.extend(() if kept else [expectation(narrow(make_recipe), 10.0)])
        return kept[0]

    return found


def sources(found):
    return [component.source for component in found.components]


def test_plastic_ridges_stay_on_rays_and_the_stated_error_is_told_but_not_counted(make_recipe):
    """Their own model, to the last bit; diffraction of ridges of 100 µm is a bound on the lobe's middle."""
    found = expectation(make_recipe(), 10.0)
    recipe = make_recipe()
    poses, convention = recipe.poses.poses(), Convention(10.0)
    rays = predict_design(recipe.surface.ridge_design(), recipe.material.material(), poses, convention)
    assert found.model == "corrected"
    assert np.array_equal(found.radiance, rays.radiance)
    assert found.optics["model"] == "geometric"
    assert 0.005 < found.optics["stated_error"] < 0.03
    assert "geometric within" in found.optics["reason"]
    assert not any("wave" in source for source in sources(found))
    assert "zero of the tilt" not in sources(found)


def test_narrow_ridges_are_predicted_by_waves_as_predict_does_it(make_recipe, waves):
    recipe = narrow(make_recipe)
    found = waves(make_recipe)
    rig = Rig(recipe.material.material(), recipe.poses.poses(), Convention(10.0))
    (alone,) = predict_with_optics(recipe.surface.ridge_design(), lambda _: None, rig, OpticsRequest("wave"))
    assert (found.model, found.optics["model"], found.optics["asked"]) == ("wave", "wave", "auto")
    assert found.radiance == pytest.approx(alone.radiance, rel=1e-9)
    (numerical,) = (c for c in found.components if c.source == "numerical error of the wave model")
    assert numerical.relative == pytest.approx(NUMERICAL_ERROR)
    assert not numerical.shared
    assert "tail of the lobe" in sources(found)  # by rays: waves know no tail


def test_sensitivities_turn_the_ridges_of_a_design_by_rays_and_by_waves(make_recipe):
    """What predicts another ridge angle is the predictor of a recipe with that angle."""
    for optics, name in (("geometric", "corrected"), ("wave", "wave")):
        recipe, turned = (narrow(make_recipe, optics, angle_deg) for angle_deg in (4.0, 4.2))
        seen, material = directions(recipe.poses.poses(), Convention(10.0)), recipe.material.material()
        made, other = (models.models_of(one, one.poses.poses(), Convention(10.0)) for one in (recipe, turned))
        assert made.name == name
        found = made.sampled(Shape(4.2))(*seen, material)
        # two reflections stand in for all of them: exact but for how their ratio changes with the angle
        np.testing.assert_allclose(found, other.model(*seen, material), rtol=1e-4)
        assert np.abs(np.log(found / made.model(*seen, material))).max() > 0.01


def test_rays_that_are_asked_for_against_the_choice_carry_what_they_neglect(make_recipe, waves):
    found = expectation(narrow(make_recipe, "geometric"), 10.0)
    assert (found.model, found.optics["asked"]) == ("corrected", "geometric")
    assert "rays are asked for" in found.optics["reason"]
    (neglected,) = (c for c in found.components if c.source == "waves, neglected by rays")
    bound = found.optics["stated_error_per_sr"]
    assert neglected.relative == pytest.approx(bound / np.sqrt(3.0) / found.radiance)
    assert np.all(
        np.abs(found.radiance - waves(make_recipe).radiance) < bound
    )  # it is a bound, in every pose


def test_where_waves_cannot_be_had_rays_say_so_unless_waves_were_asked_for(make_recipe, monkeypatch):
    def fails(*_):
        raise HeightMapError("too coarse")

    monkeypatch.setattr(models, "wave_model", fails)
    found = expectation(narrow(make_recipe), 10.0)
    assert found.model == "corrected"
    assert "waves cannot be had (too coarse)" in found.optics["reason"]
    assert "waves, neglected by rays" in sources(found)
    with pytest.raises(RecipeError, match=r"surface\.optics: waves cannot be had: too coarse"):
        expectation(narrow(make_recipe, "wave"), 10.0)


def test_lamp_and_lens_of_the_recipe_are_those_of_the_prediction(make_recipe):
    """A wide lamp smears the lobe: the bright pose loses, and the coherence length shrinks."""
    found = [
        expectation(make_recipe(light=light), 10.0)
        for light in (None, {"lamp_half_angle_deg": 4.0, "wavelength_nm": 450.0})
    ]
    assert found[1].optics["coherence_um"] < found[0].optics["coherence_um"]
    assert found[1].optics["wavelengths_nm"] == [pytest.approx(450.0)]
    assert found[1].radiance.max() < found[0].radiance.max()


def test_the_choice_is_kept_with_the_prediction(make_recipe, waves):
    recipe = narrow(make_recipe)
    found = waves(make_recipe)
    again = _unpacked(packed(found), recipe, 10.0, PLASTIC)
    assert again.optics == found.optics
    assert packed(replace(again, optics=None)) != packed(found)


@pytest.fixture
def textured(make_recipe, tmp_path):
    """``textured(**surface)`` is the recipe of a map of rough ridges; its material is stated with one table."""
    plain = ridges(RidgeDesign(100.0, 10.0), (101, 401), (2.0, 2.0))
    rough = add_facet_roughness(plain, 0.03, 0.04, 16.0, np.random.default_rng(3))
    write_height_map(rough, tmp_path / "map.npz")
    table = {"height_map": str(tmp_path / "map.npz"), "design": None}
    return rough, lambda **surface: make_recipe(surface={**table, **surface}, area=None)


def test_the_roughness_of_a_plastic_is_shared_by_map_and_lobe_as_predict_shares_it(textured):
    surface, recipe_with = textured
    recipe = recipe_with(roughness="plastic")
    found, of_lobe = expectation(recipe, 10.0), expectation(recipe_with(), 10.0)
    poses, convention, material = recipe.poses.poses(), Convention(10.0), recipe.material.material()
    wanted = predict_height_map(surface, material, poses, convention, pitch_um=100.0, roughness="plastic")
    np.testing.assert_allclose(found.radiance, wanted.radiance, rtol=1e-9)
    assert found.optics["resolved_alpha_across"] == pytest.approx(wanted.notes["resolved_alpha_across"])
    assert np.abs(np.log(found.radiance / of_lobe.radiance)).max() > 0.03
    # its uncertainty is that of the whole roughness
    rougher = replace(material, alpha_across=1.03 * material.alpha_across)
    changed = predict_height_map(surface, rougher, poses, convention, pitch_um=100.0, roughness="plastic")
    (across,) = (c.relative for c in found.components if c.source == "roughness across the ridges")
    np.testing.assert_allclose(across, np.log(changed.radiance / wanted.radiance), atol=0.003)


def test_the_lobe_on_a_map_and_the_design_like_it_take_the_rest_and_the_whole(textured):
    surface, recipe_with = textured
    recipe = recipe_with(roughness="plastic")
    relief, _ = prepare_relief(surface, 100.0)
    lobe, material = models.lobe_on(relief, recipe), recipe.material.material()
    assert lobe.alpha_across == pytest.approx(np.sqrt(0.1**2 - resolve(relief).across ** 2))
    assert models.lobe_on(relief, recipe_with()) == material
    assert with_design(recipe).material.material() == material
    assert with_design(recipe_with()).material.alpha_across > material.alpha_across


@pytest.mark.parametrize(
    "change", [{"height_map": None, "design": {"ridge_angle_deg": 10.0}}, {"optics": "wave"}]
)
def test_a_design_and_waves_know_no_resolved_roughness(textured, change):
    with pytest.raises(ValueError, match="takes the slopes of a height_map off, by rays"):
        textured[1](roughness="plastic", **change)
