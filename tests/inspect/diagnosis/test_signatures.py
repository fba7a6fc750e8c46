"""Signatures of a recipe: of a whole plastic on a height map, and those that a recipe with more tilts holds."""

from dataclasses import replace

import numpy as np

from anisoscope.diagnosis.causes import all_causes
from anisoscope.diagnosis.signatures import _Scene, signatures
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


def test_signatures_are_those_of_the_same_recipe_with_more_tilts(make_recipe):
    """Shares are those of cells that deviate in fewer poses; only what is not whole with more of them is computed."""
    names = ("burrs", "wear", "roughness-along", "tail")
    recipe = make_recipe()
    wider = make_recipe(poses={"tilts_deg": [-5.0, 0.0, 10.0]})
    alone, more = (signatures(one, 10.0, names=names) for one in (recipe, wider))
    moved = tuple(replace(one, change=one.change + 1.0) for one in more.found)
    short = replace(moved[1], extents=moved[1].extents[1:], change=moved[1].change[1:])
    taken = signatures(recipe, 10.0, names=names, known=replace(more, found=(moved[0], short, *moved[2:])))
    assert taken.poses == alone.poses
    np.testing.assert_array_equal(taken.radiance, alone.radiance)
    assert [one.cause.name for one in taken.found] == [one.cause.name for one in alone.found]
    for one, own, off in zip(
        (*taken.found, taken.tail), (*alone.found, alone.tail), (1, 0, 1, 0), strict=True
    ):
        np.testing.assert_array_equal(one.extents, own.extents)
        np.testing.assert_allclose(one.change, own.change + off, atol=1e-12)
        np.testing.assert_allclose(one.share, own.share, atol=1e-12)
        assert (one.tangents is None, one.levels is None) == (own.tangents is None, own.levels is None)
        if own.tangents is not None:
            np.testing.assert_allclose(one.tangents.slope, own.tangents.slope, atol=1e-10)
        if own.levels is not None:
            np.testing.assert_array_equal(one.forms, own.forms)
            for few, all_own in zip(one.levels, own.levels, strict=True):
                np.testing.assert_array_equal(few.each[0].alone, all_own.each[0].alone)
    assert alone.found[0].levels is not None
    assert alone.found[0].share.max() > 0.0
