"""What a recipe is said to tell."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from anisoscope.base.progress import silent
from anisoscope.diagnosis.cause_model import PLASTIC_CAUSES, CauseModel, Option
from anisoscope.diagnosis.signatures import signatures
from anisoscope.kinds import surface_check as recipecheck
from anisoscope.kinds.surface_check import check_recipe
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.light.unresolved import resolve

CAUSES = ("roughness-along", "light-angle")


def _few(recipe):
    return tuple(cause for cause in PLASTIC_CAUSES.causes(recipe) if cause.name in CAUSES)


def _signatures_of_few(recipe, light_angle_deg, advance, _):
    return signatures(recipe, light_angle_deg, advance, CAUSES)


_signatures_of_few.__module__ = signatures.__module__  # whose source enters the key of what is stored
FEW = CauseModel(_few, _signatures_of_few)
# in direct light both causes act alike on two poses; reflections answer otherwise to either
TIED = {"poses": {"angles_deg": [0.0, 180.0]}, "area": None, "surface": {"reflections": "direct"}}


def test_planned_contrasts_budget_and_causes(make_recipe):
    found = check_recipe(make_recipe(), 10.0, model=FEW)
    assert [(p.from_deg, p.to_deg) for p in found.pairs] == [(0.0, 90.0), (90.0, 180.0)]
    for pair, k in zip(found.pairs, range(2), strict=True):
        assert pair.ratio == pytest.approx(0.25 / (2 * pair.u))
        total = sum(row.contributions[k] ** 2 for row in found.budget) ** 0.5
        assert total == pytest.approx(pair.u, rel=1e-6)
    assert {cause.cause for cause in found.causes} == set(CAUSES)
    assert (found.advice, found.never) == ((), ())  # nothing was tried


def test_the_roughness_of_the_whole_plastic_is_that_of_map_and_lobe(make_recipe, monkeypatch):
    plain = ridges(RidgeDesign(100.0, 10.0), (101, 401), (2.0, 2.0))
    rough = add_facet_roughness(plain, 0.04, 0.03, 16.0, np.random.default_rng(3))
    monkeypatch.setattr(recipecheck, "resolve", lambda relief: seen.append(relief.surface) or resolve(relief))
    seen = []
    recipe = make_recipe()
    line = recipecheck._roughness(recipe, SimpleNamespace(surface=rough, turn_deg=0.0))
    assert seen == [rough]
    numbers = [float(number) for number in re.findall(r"0\.\d+", line)]
    assert numbers[:2] == pytest.approx([0.04, 0.03], rel=0.25)
    lobe = np.array([recipe.material.alpha_along, recipe.material.alpha_across])
    assert numbers[2:] == pytest.approx(np.hypot(numbers[:2], lobe), abs=0.001)
    assert recipecheck._roughness(recipe, SimpleNamespace(surface=None)) is None


def test_a_narrow_tolerance_and_none_are_said(make_recipe):
    (line,) = check_recipe(make_recipe(decision={"tolerance": 0.01}), 10.0, model=FEW).complaints
    assert line.startswith("T/U is ")
    line, *_ = check_recipe(
        make_recipe(material={"u_tail": None}, decision={"tolerance": 3.0}), 10.0, model=FEW
    ).complaints
    assert "lobe of the plastic is unmeasured" in line
    (line,) = check_recipe(make_recipe(decision={"tolerance": None}), 10.0, model=FEW).complaints
    assert line.startswith("no tolerance")
    line, *_ = check_recipe(make_recipe(uncertainty={"scale_share": 1.0}), 10.0, model=FEW).complaints
    assert line.startswith("uncertainty.scale_share is 100%: the reflectance of the white tile is unknown")


def test_tilts_that_help_are_named(make_recipe):
    found = check_recipe(make_recipe(**TIED), 10.0, tries=(0.0, 20.0), model=FEW)
    by_name = {cause.cause: cause for cause in found.causes}
    assert by_name["light-angle"].inseparable_causes == ("roughness-along",)
    assert [one.tilt_deg for one in found.advice] == [20.0]
    assert ("light-angle", "roughness-along") in found.advice[0].tells_apart
    assert ("light-angle", "roughness-along") not in found.never
    assert found.lamps == ()  # of plastic no other wavelength is tried


def test_what_nothing_tells_is_said(make_recipe):
    found = check_recipe(make_recipe(**TIED), 10.0, tries=(0.5,), model=FEW)
    assert found.advice == ()
    assert ("light-angle", "roughness-along") in found.never


def test_a_second_lamp_is_named_by_what_no_nearer_one_tells(make_recipe, monkeypatch):
    pair, back, third = ("a", "b"), ("b", "a"), ("a", "c")
    known = (
        Option("tilt", "a tilt", {"a": {"b": 1.0, "c": None}, "b": {"a": 1.0}}),
        Option("lamp", "no help", {"a": {"b": None, "c": None}, "b": {"a": None}}),
        Option("lamp", "near", {"a": {"b": 2.0, "c": None}, "b": {"a": None}}),
        Option("lamp", "far", {"a": {"b": 1.0, "c": None}, "b": {"a": 1.0}}),
    )
    asked = []

    def options(_recipe, _angle, names, _advance, _causes):
        asked.append(names)
        return known

    monkeypatch.setattr(recipecheck, "cached_options", options)
    found = recipecheck.second_lamps_for(make_recipe(), 0.0, [pair, back, third], silent, PLASTIC_CAUSES)
    assert [(one.says, one.tells_apart) for one in found] == [("near", (pair,)), ("far", (back,))]
    assert asked == [["a", "b", "c"]]


def _with_burrs(recipe, light_angle_deg, advance, _):
    return signatures(recipe, light_angle_deg, advance, ("burrs",))


_with_burrs.__module__ = signatures.__module__
BURRS = CauseModel(
    lambda recipe: tuple(one for one in PLASTIC_CAUSES.causes(recipe) if one.name == "burrs"), _with_burrs
)


def test_thresholds_of_a_design_are_said_to_be_unknown_and_those_of_a_map_are_its_own(make_recipe, tmp_path):
    line = check_recipe(make_recipe(surface={"reflections": "direct"}), 10.0, model=BURRS).thresholds
    assert "not known yet, because a design has no texture" in line
    assumed, even = (float(one) for one in re.findall(r"burrs from ([0-9.]+) %", line))
    assert even <= assumed
    smooth = ridges(RidgeDesign(100.0, 10.0), (101, 401), (2.0, 2.0))
    rough = add_facet_roughness(smooth, 0.04, 0.04, 8.0, np.random.default_rng(3))
    write_height_map(rough, tmp_path / "rough.x3p")
    of_map = {"height_map": tmp_path / "rough.x3p", "design": None, "reflections": "direct"}
    line = check_recipe(make_recipe(surface=of_map), 10.0, model=BURRS).thresholds
    first, second = (float(one) for one in re.findall(r"0\.\d\d", line)[:2])
    assert 0.1 < second < first < 0.8
    assert "burrs from" in line
