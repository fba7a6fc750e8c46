"""Parts of a plastic that the recipe does not know, by the closed form: lobes with a tail, of other widths."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.diagnosis.evidence import Evidence, against, covariance_of, inputs_of
from anisoscope.diagnosis.part_diagnosis import diagnosis_record
from anisoscope.diagnosis.ranking import OTHER, PLASTIC, diagnose
from anisoscope.diagnosis.signatures import signatures
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.prediction.expectation import Component, expectation
from anisoscope.prediction.sensitivity import State

LIGHT = 10.0
CAUSES = ("ridge-angle", "roughness-along", "roughness-across", "roughness", "colour", "light-angle")
NOISE = 0.003


@pytest.fixture(scope="module")
def recipe():
    return RidgeRecipe.model_validate(
        {
            "schema": 1,
            "product": "plate",
            "surface": {"pitch_um": 100.0, "design": {"ridge_angle_deg": 10.0}, "reflections": "direct"},
            "material": {
                "alpha_along": 0.08,
                "alpha_across": 0.08,
                "albedo": 0.1,
                "u_albedo": 0.005,
                "u_tail": 0.0,
            },
            "poses": {"angles_deg": [0.0, 90.0, 180.0], "tilts_deg": [0.0, -10.0, 10.0]},
            "acquisition": {"exposure_s": 0.006},
            "region": {"size_mm": [2.0, 2.0]},
            "area": {"max_share": 0.03},
        }
    )


@pytest.fixture(scope="module")
def poses(recipe):
    return recipe.poses.poses()


@pytest.fixture(scope="module")
def nominal(recipe):
    return State(recipe.material.material(), LIGHT)


@pytest.fixture(scope="module")
def known(recipe, by_closed_form):
    return by_closed_form(recipe, CAUSES)


@pytest.fixture(scope="module")
def part(recipe, poses, nominal, shown_by):
    """``part(tail=1.0, alpha_along=0.07)`` is the evidence of a part of a plastic with these changes."""
    expected = expectation(recipe, LIGHT)
    own = (Component("own", "measurement", np.full(len(poses), NOISE), shared=False),)
    V = covariance_of(expected.components + own, recipe.uncertainty.scale_share, len(poses))
    inputs = inputs_of(recipe, expected, own)
    rng = np.random.default_rng(3)

    def evidence(ridge_angle_deg=10.0, **changes):
        state = replace(nominal, material=replace(nominal.material, **changes))
        radiance = shown_by(poses, state, ridge_angle_deg)
        noise = NOISE * rng.standard_normal(len(radiance))
        return Evidence(np.log(radiance / expected.radiance) + noise, V, inputs=inputs)

    return evidence


def test_the_tail_has_the_signature_of_the_closed_form(recipe, known):
    found = signatures(recipe, LIGHT, names=("tail",))
    assert found.found == ()
    np.testing.assert_allclose(found.tail.change, known.tail.change, atol=0.01)
    assert np.abs(known.tail.change).max() > 0.3


@pytest.mark.parametrize("widths", [(0.06, 0.06), (0.068, 0.055)])
def test_a_lobe_with_a_tail_is_another_plastic_and_no_defect(known, part, widths):
    """GGX of a width that is no rougher than the recipe's: what no cause explains is told as the plastic's."""
    found = diagnose(known, part(tail=1.0, alpha_along=widths[0], alpha_across=widths[1]))
    assert found.causes[0].cause == PLASTIC
    assert found.causes[0].weight > 0.9
    assert found.unexplained_p > 0.01
    sizes = {one.cause: one for one in found.causes[0].components}
    assert sizes["tail"].severity == pytest.approx(1.0, abs=0.5)
    assert "anisoscope calibrate material" in diagnosis_record(found, 0.01).says


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"ridge_angle_deg": 9.0}, "ridge-angle"),
        ({"alpha_along": 0.104, "alpha_across": 0.104}, "roughness"),
        ({"alpha_across": 0.11}, "roughness-across"),
        ({"albedo": 0.13}, "colour"),
    ],
)
def test_a_defect_of_the_recipes_own_plastic_is_not_called_another_plastic(known, part, change, cause):
    found = diagnose(known, part(**change))
    assert found.causes[0].cause == cause
    weights = {one.cause: one.weight for one in found.causes}
    assert weights[PLASTIC] < 0.2
    assert weights[OTHER] < 0.05


def test_against_golden_parts_of_the_same_plastic_its_lobe_is_no_matter(recipe, known, part):
    """The tail cancels with golden parts of the same plastic: the ridge angle is named, or ties."""
    ggx = {"tail": 1.0, "alpha_along": 0.06, "alpha_across": 0.06}
    golden = np.array([part(**ggx).deviation for _ in range(3)])
    found = diagnose(known, against(part(ridge_angle_deg=9.0, **ggx), golden, recipe.uncertainty.scale_share))
    assert "ridge-angle" in {one.cause for one in found.ties}
    assert PLASTIC not in {one.cause for one in found.ties}
