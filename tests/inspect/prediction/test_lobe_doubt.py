"""ln L over the tail of the lobe against the model itself, and what follows where it is unmeasured."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.decision.consistency import from_prediction
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.cache import _unpacked, packed
from anisoscope.prediction.expectation import PLASTIC, Component, expectation
from anisoscope.prediction.lobe_doubt import LIKELY_TAILS, likely_tails
from anisoscope.prediction.part_scatter import part_scatter
from anisoscope.prediction.propagation import TAIL
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions

UNMEASURED = {"u_tail": None, "u_alpha_share": None, "u_albedo": None}
NOISE = 0.003


@pytest.fixture
def unmeasured(make_recipe):
    """A recipe without a word on the lobe, in light that reflects twice at most, and its prediction."""
    recipe = make_recipe(material=UNMEASURED, surface={"reflections": 2})
    return recipe, expectation(recipe, 10.0)


def log_radiance(recipe, tail, **shape):
    sides = directions(recipe.poses.poses(), Convention(10.0))
    material = replace(recipe.material.material(), tail=tail)
    return np.log(corrected.radiance(*sides, RidgeDesign(100.0, 10.0, **shape), material, bounces=2))


def p_value(expected, logs):
    noise = Component("noise", "measurement", np.full(len(logs), NOISE), shared=False)
    grid = Grid((0.0, 0.0), 0.025, (4, 4))
    part = Measured(np.exp(logs), (noise,), (), np.ones((len(logs), 1, 1)), np.zeros(len(logs)), grid, None)
    return from_prediction(expected, part)[2]


@pytest.mark.parametrize("tail", [0.0, 0.12, 0.7, 1.0])
def test_the_curve_over_the_tail_is_that_of_the_model(unmeasured, tail):
    recipe, expected = unmeasured
    shift, response = expected.lobes.at(tail)
    np.testing.assert_allclose(shift, log_radiance(recipe, tail) - log_radiance(recipe, 0.0), atol=3e-3)
    rougher = recipe.material.model_copy(update={"alpha_along": 1.02 * recipe.material.alpha_along})
    change = log_radiance(recipe.model_copy(update={"material": rougher}), tail) - log_radiance(recipe, tail)
    k = response.sources.index("roughness along the ridges")
    z = 0.02 / recipe.material.u_alpha_share
    np.testing.assert_allclose(response.change(z * np.eye(len(response.sources))[k]), change, atol=1e-3)


def test_a_plastic_with_an_unmeasured_lobe_is_in_doubt_about_all_of_its_lobe(make_recipe, unmeasured):
    recipe, expected = unmeasured
    part = recipe.material
    assert (part.u_tail, part.u_alpha_share, part.u_albedo) == (None, 0.1, pytest.approx(0.1 * part.albedo))
    (tail,) = (c for c in expected.components if c.source == TAIL)
    np.testing.assert_allclose(tail.relative, expected.lobes.at(0.5)[0], atol=1e-9)
    assert np.abs(tail.relative).max() > 0.1
    known = expectation(make_recipe(surface={"reflections": 2}), 10.0)
    assert known.lobes is None
    assert not any(c.source == TAIL for c in known.components)
    second = make_recipe(material={**UNMEASURED, "second_lobe": [0.15, 2.5]}).material
    assert (second.u_tail, second.u_alpha_share) == (0.0, 0.05)


@pytest.mark.parametrize("tail", [0.0, 0.3, 1.0])
def test_good_parts_of_any_lobe_pass_and_large_defects_do_not(make_recipe, unmeasured, tail):
    recipe, expected = unmeasured
    assert p_value(expected, log_radiance(recipe, tail)) > 0.1
    assert p_value(expected, log_radiance(recipe, tail, height_loss=0.2)) < 0.01
    if tail == 1.0:  # a lobe that is said to be known and is not
        known = expectation(make_recipe(surface={"reflections": 2}), 10.0)
        assert p_value(known, log_radiance(recipe, tail)) < 1e-4


def test_a_stated_tail_counts_by_its_distance(make_recipe):
    recipe = make_recipe(material={"tail": 0.4, "u_tail": 0.1}, surface={"reflections": 2})
    lobes = expectation(recipe, 10.0).lobes
    assert lobes.tails[[0, -1]] == pytest.approx([0.1, 0.7])
    assert lobes.penalty(0.6) == pytest.approx(4.0)
    assert likely_tails(0.4, 0.1) == pytest.approx((0.4 - 0.1 * 1.5**0.5, 0.4, 0.4 + 0.1 * 1.5**0.5))
    assert likely_tails(0.0, 0.1)[0] == 0.0
    assert likely_tails(0.4, 0.0) == (0.4,)


def test_the_scatter_of_parts_is_known_for_every_likely_lobe(unmeasured, make_recipe):
    recipe, _ = unmeasured
    scatter = part_scatter(recipe, 10.0)
    assert len(scatter.lobes) == len(LIKELY_TAILS)
    np.testing.assert_array_equal(scatter.lobes[0].slope, scatter.response.slope)
    for tail, lobe in zip(LIKELY_TAILS, scatter.lobes, strict=True):
        stated = make_recipe(material={**UNMEASURED, "tail": tail}, surface={"reflections": 2})
        np.testing.assert_allclose(
            part_scatter(stated, 10.0).response.slope, lobe.slope, rtol=1e-3, atol=2e-6
        )
    assert len(part_scatter(make_recipe(), 10.0).lobes) == 1


def test_the_doubt_of_the_lobe_is_kept_on_disk(unmeasured):
    recipe, found = unmeasured
    again = _unpacked(packed(found), recipe, 10.0, PLASTIC)
    assert packed(again) == packed(found)
    np.testing.assert_array_equal(again.lobes.at(0.3)[0], found.lobes.at(0.3)[0])
    assert np.isinf(again.lobes.u)
