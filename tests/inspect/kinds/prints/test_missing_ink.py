"""Sheets on which nothing, or next to it, is printed: FAIL where the ink is missing, INVALID where it is no print."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError, MeasurementError
from anisoscope.decision.reference_parts import golden_path
from anisoscope.inspection.recompute import recompute
from anisoscope.kinds.prints.causes import explain_print
from anisoscope.kinds.prints.decision import decide_print
from anisoscope.kinds.prints.missing_ink import without_ink
from anisoscope.kinds.prints.model import State
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.reference_prints import GoldenPrints
from anisoscope.parameters.geometry import Convention
from anisoscope.record.verdict import Verdict
from anisoscope.sim.light.geometry import directions


@pytest.fixture(scope="module")
def few(make_recipe, predict):
    """A recipe with nine poses and no map, and what it predicts."""
    recipe = make_recipe(poses={"tilts_deg": [0.0, 10.0, 20.0]}, area=None)
    return recipe, predict(recipe)


@pytest.fixture
def seen(few, sheet):
    """``seen(channels)`` is a measurement of (9, 3) channels."""
    base, grid = sheet.measured(), few[1].channels.shape
    own = tuple(replace(one, factor=one.factor[: grid[0] * 3, : grid[0] * 3]) for one in base.sources)
    return lambda channels: replace(
        base, channels=np.asarray(channels), cells=channels[:, :, None, None], sources=own, pictures=None
    )


def diffuse(expected, reflectance):
    """(9, 3) channels of a dull sheet; one reflectance, or one a channel."""
    to_light, _ = directions(expected.poses, Convention(10.0))
    return to_light[:, 2:] / np.pi * np.broadcast_to(reflectance, (9, 3))


@pytest.mark.parametrize("missing", [0.92, 1.0])
def test_a_sheet_without_ink_fails_and_says_so(few, seen, missing):
    recipe, expected = few
    measured = seen(expected.scene.channels(State(missing=missing)))
    decision = decide_print(expected, measured, recipe)
    assert (decision.verdict, decision.fit, decision.map) == (Verdict.FAIL, None, None)
    assert decision.bare.missing == pytest.approx(missing, abs=0.002)
    assert decision.bare.low <= missing <= decision.bare.high
    nothing = "nothing is printed here, the ink is missing" in decision.reasons[0]
    assert nothing is (missing == 1.0)
    (gain,) = decision.quantities
    assert (gain.name, gain.verdict) == ("gain", Verdict.FAIL)
    assert gain.deviation == pytest.approx(-missing, abs=0.002)
    (cause,) = explain_print(recipe, expected, measured, decision).causes
    assert (cause.cause, cause.severity) == ("missing-ink", decision.bare.missing)


def test_the_substrate_may_be_off_by_what_the_recipe_says_of_it(few, seen):
    """0.04 ± 0.01: a sheet of 0.055 is the substrate's, one of 0.2 is not."""
    recipe, expected = few
    assert without_ink(expected, seen(diffuse(expected, 0.055)), recipe).missing > 0.98
    assert without_ink(expected, seen(diffuse(expected, 0.2)), recipe) is None


@pytest.mark.parametrize(
    ("sheet_of", "says"),
    [
        (
            lambda expected: diffuse(expected, 0.85),
            r"grey and dull of reflectance 0\.85.*substrate has 0\.04",
        ),
        pytest.param(
            lambda expected: diffuse(expected, [0.055, 0.04, 0.025]),
            "cannot be fitted: is this the recipe's ink",
            marks=pytest.mark.soak,
        ),
        (lambda expected: diffuse(expected, 0.04) * np.linspace(0.7, 1.4, 9)[:, None], "cannot be fitted"),
    ],
    ids=["white sheet", "brown sheet", "uneven light"],
)
def test_what_is_no_sheet_of_this_product_gives_no_verdict(few, seen, sheet_of, says):
    recipe, expected = few
    with pytest.raises(MeasurementError, match=says):
        decide_print(expected, seen(sheet_of(expected)), recipe)


def test_an_unprinted_sheet_on_the_rig(print_rig):
    done = print_rig.inspect({"coverage": 0.0}, drawn=True)
    record = done.record
    assert record.verdict == "FAIL", record.reasons
    assert "nothing is printed here, the ink is missing" in record.reasons[0]
    assert record.details.lobe is None
    assert record.diagnosis.causes[0].cause == "missing-ink"
    page = done.report.read_text()
    assert "No lobe of any width" in page
    assert "explained by ink that is missing" in page
    again = recompute(done.folder)
    assert (again.differences, again.notes) == ((), ())
    recipe_path = print_rig.folder / "print" / "recipe.toml"
    with pytest.raises(CalibrationError, match="hardly anything is printed there"):
        GoldenPrints.with_inspection(None, PrintRecipe.read(recipe_path), record)
    assert not golden_path(recipe_path).exists()


def test_a_cap_on_the_lens_stays_invalid(print_rig):
    record = print_rig.inspect({"coverage": 0.0}, bench={"optics": {"electrons": 1000.0}}).record
    assert record.verdict == "INVALID"
    assert record.details is None
