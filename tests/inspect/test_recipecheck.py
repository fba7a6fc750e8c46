"""What a recipe is said to tell."""

import pytest

from anisoscope import recipecheck
from anisoscope.diagnosis.signatures import signatures
from anisoscope.recipecheck import check_recipe

CAUSES = ("roughness-along", "light-angle")


@pytest.fixture(autouse=True)
def few_causes(monkeypatch):
    monkeypatch.setattr(
        recipecheck,
        "remembered_signatures",
        lambda recipe, angle, advance: signatures(recipe, angle, advance, CAUSES),
    )


def test_planned_contrasts_budget_and_causes(make_recipe):
    found = check_recipe(make_recipe(), 10.0)
    assert [(p.from_deg, p.to_deg) for p in found.pairs] == [(0.0, 90.0), (90.0, 180.0)]
    for pair, k in zip(found.pairs, range(2), strict=True):
        assert pair.ratio == pytest.approx(0.25 / (2 * pair.u))
        total = sum(row.contributions[k] ** 2 for row in found.budget) ** 0.5
        assert total == pytest.approx(pair.u, rel=1e-6)
    assert {cause.cause for cause in found.causes} == set(CAUSES)
    assert found.advice == ()


def test_a_narrow_tolerance_and_none_are_said(make_recipe):
    (line,) = check_recipe(make_recipe(decision={"tolerance": 0.01}), 10.0).complaints
    assert line.startswith("T/U is ")
    (line,) = check_recipe(make_recipe(decision={"tolerance": None}), 10.0).complaints
    assert line.startswith("no tolerance")


def test_tilts_that_help_are_named(make_recipe):
    poses = {"angles_deg": [0.0, 180.0]}
    found = check_recipe(make_recipe(poses=poses, area=None), 10.0, tries=(0.0, 20.0))
    by_name = {cause.cause: cause for cause in found.causes}
    assert by_name["light-angle"].never_told_from == ("roughness-along",)
    assert [one.tilt_deg for one in found.advice] == [20.0]
    assert ("light-angle", "roughness-along") in found.advice[0].tells_apart
