"""Signatures of a height map whose recipe states the roughness of the whole plastic."""

from dataclasses import replace

import numpy as np

from anisoscope.diagnosis.causes import all_causes
from anisoscope.diagnosis.signatures import _Scene
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.recipe_models import models_of
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.light.geometry import directions


def test_a_rougher_plastic_is_rougher_as_a_whole_not_its_lobe(make_recipe, tmp_path):
    """The map shows a part of the roughness, which a change of the plastic's leaves as it is."""
    plain = ridges(RidgeDesign(100.0, 10.0), (41, 201), (4.0, 4.0))
    rough = add_facet_roughness(plain, 0.03, 0.06, 16.0, np.random.default_rng(3))
    write_height_map(rough, tmp_path / "map.npz")
    table = {"height_map": str(tmp_path / "map.npz"), "design": None, "reflections": "direct"}
    recipe = make_recipe(surface={**table, "roughness": "plastic", "walls": "sampled"}, area=None)
    scene = _Scene(recipe, 10.0)
    cause = next(one for one in all_causes() if one.name == "roughness-across")
    convention, material = Convention(10.0), recipe.material.material()
    model = models_of(recipe, recipe.poses.poses(), convention).model
    sides = directions(recipe.poses.poses(), convention)
    for extent in (0.0, 0.2):
        seen = scene.look(*cause.change(scene.surface, scene.state, extent), None, with_map=False).radiance
        rougher = replace(material, alpha_across=material.alpha_across * (1.0 + extent))
        np.testing.assert_allclose(np.log(seen / model(*sides, rougher)), 0.0, atol=2e-3)
