"""Golden prints: the set beside a recipe, and prints judged by it."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.kinds.prints.causes import explain_print
from anisoscope.kinds.prints.decision import decide_print
from anisoscope.kinds.prints.expectation import rig_sources, scatter_of_prints
from anisoscope.kinds.prints.lobe_fit import PARAMETERS
from anisoscope.kinds.prints.model import State
from anisoscope.kinds.prints.reference_comparison import compare_with_golden, linear_fit
from anisoscope.kinds.prints.reference_prints import GoldenPrints
from anisoscope.record.verdict import Verdict
from anisoscope.sim.materials.inks import synthetic_ink

SPREAD = {"alpha": 0.01, "ratio": 0.005, "skew": 0.005, "tilt_x_deg": 0.1, "tilt_y_deg": 0.1, "red": 0.01,
          "green": 0.01, "blue": 0.01, "lobe": 0.02, "shift_nm": 0.3}  # fmt: skip
BIAS = State(alpha=0.01, tilt_x_deg=0.1, red=0.01, shift_nm=1.0)
"""By how much the house's good prints are not what the ink file says."""


def drawn(scene, rng, more=None):
    """(63,) ln of the channels of a good print of the house, with what one does to it, and noise."""
    changes = {name: getattr(BIAS, name) + s * rng.standard_normal() for name, s in SPREAD.items()}
    for name, value in (more or {}).items():
        changes[name] = changes.get(name, 0.0) + value
    logs = scene.log_channels(State(**changes))
    return logs + 0.001 * rng.standard_normal(logs.size)


@pytest.fixture(scope="module")
def house(good, golden_of):
    """Recipe, prediction and 40 golden prints."""
    recipe, expected = good
    rng = np.random.default_rng(8)
    rows = [drawn(expected.scene, rng) for _ in range(40)]
    rule = recipe.decision.model_copy(update={"deviation": "fail"})
    plain = recipe.model_copy(update={"area": None, "decision": rule})
    return plain, expected, golden_of(recipe, expected, rows)


@pytest.fixture(scope="module")
def beside(house):
    """``beside(logs)`` weighs a print by the golden ones."""
    recipe, expected, golden = house
    of_rig = rig_sources(recipe, expected)
    fit, stated = linear_fit(expected, (*expected.common, *of_rig)), scatter_of_prints(recipe, expected)
    return lambda logs: compare_with_golden(golden, expected, logs, fit, stated)


@pytest.fixture
def decided(house, sheet):
    """``decided(more)`` judges another print of the house by its golden prints."""
    recipe, expected, golden = house
    base = sheet.measured()

    def decide(more=None, *, by=golden, rule=recipe):
        scene = replace(expected.scene, other=synthetic_ink("synthetic-red"))
        channels = np.exp(drawn(scene, np.random.default_rng(4), more)).reshape(-1, 3)
        measured = replace(base, channels=channels)
        return measured, decide_print(expected, measured, rule, by)

    return decide


@pytest.mark.parametrize("count", [3, 6, 9, 10, 11, 30])
def test_good_prints_are_like_the_golden_ones(house, golden_of, count):
    """Level over 200 sets of the house's prints, each with one print more; their colours scatter as much as the level.

    Of 200 prints in all: the sets have prints in common, so that rates scatter more than those of independent ones.
    """
    recipe, expected, _ = house
    rng = np.random.default_rng(21)
    pool = np.array([drawn(expected.scene, rng) for _ in range(200)])
    of_rig = rig_sources(recipe, expected)
    fit, stated = linear_fit(expected, (*expected.common, *of_rig)), scatter_of_prints(recipe, expected)
    found = []
    for _ in range(200):
        own, *others = rng.choice(len(pool), count + 1, replace=False)
        golden = golden_of(recipe, expected, pool[others])
        found.append(compare_with_golden(golden, expected, pool[own], fit, stated).p_value)
    assert np.isfinite(found).all()
    assert np.mean(np.array(found) < 0.01) <= 0.03
    assert np.mean(np.array(found) < 0.05) <= 0.1


def test_what_is_good_in_this_house_is_not_as_predicted(decided):
    _, by_them = decided()
    _, predicted = decided(by=None)
    assert (by_them.verdict, predicted.verdict) == (Verdict.PASS, Verdict.FAIL)
    assert (by_them.dof, predicted.dof) == (9, 63)
    assert by_them.p_value > 0.05
    assert predicted.p_value < 1e-6
    assert "like the 40 golden prints (level 0.01)" in by_them.reasons[-2]
    assert "for a print as predicted" in " ".join(predicted.reasons)


@pytest.mark.parametrize(
    ("more", "words", "cause"),
    [
        ({"alpha": np.log(1.10)}, "lobe and level", "roughness"),
        ({"ratio": 0.05}, "lobe and level", "brushing"),
        ({"missing": 0.10}, "lobe and level", "missing-ink"),
        ({"shift_nm": 8.0}, "the colour at", "film-thickness"),
        ({"other": 0.04}, "the colour at", "wrong-ink-synthetic red"),
    ],
)
def test_what_differs_from_the_golden_prints_is_found_and_named(decided, house, more, words, cause):
    recipe, expected, _ = house
    measured, decision = decided(more)
    assert decision.verdict is Verdict.FAIL
    assert decision.p_value < 1e-3
    line = next(line for line in decision.reasons if line.startswith("all channels together"))
    assert "for a print like the 40 golden prints" in line
    assert words in line
    best = [one for one in explain_print(recipe, expected, measured, decision).causes if one.tie]
    assert cause in {one.cause for one in best}
    assert len(best) <= 2


def test_a_deviation_warns_unless_the_recipe_lets_it_fail(decided, house):
    recipe, mild = house[0], {"ratio": 0.04}
    rule = recipe.decision.model_copy(update={"deviation": "warn"})
    wide = recipe.tolerances.model_copy(update={"delta_e": 4.0, "ln_ratio": 0.1, "alpha_share": 0.1})
    warns = recipe.model_copy(update={"decision": rule, "tolerances": wide})
    assert decided(mild)[1].verdict is Verdict.FAIL
    decision = decided(mild, rule=warns)[1]
    assert decision.verdict is Verdict.PASS
    assert decision.reasons[0].startswith("warning: significant deviation")


def test_a_lean_is_told_by_the_fit_and_not_by_the_colours(house, beside):
    """A sheet that lies otherwise in its seat changes the brightness of tilted poses, which is no colour of its own."""
    found = beside(drawn(house[1].scene, np.random.default_rng(6), {"tilt_y_deg": 0.7}))
    assert found.p_fitted < 0.01
    assert min(one.p_value for one in found.colours) > 0.01
    at = PARAMETERS.index("tilt_y_deg")
    assert found.measured[at] - found.fitted[:, at].mean() == pytest.approx(0.7, abs=0.25)


def test_differences_of_colour_are_those_of_the_eye(house, beside):
    """ΔE2000 from the golden mean: of a print whose level alone is 4 % higher, and the scatter of the golden ones."""
    _, expected, golden = house
    mean = golden.logs().mean(axis=0)
    found = beside(mean + np.log(1.04))
    usual = np.exp(mean).reshape(-1, 3)
    wanted = expected.eye.difference(1.04 * usual, usual)
    assert [one.delta_e for one in found.colours] == pytest.approx(wanted, abs=0.05)
    level = [PARAMETERS.index(name) for name in ("red", "green", "blue")]
    off = found.measured - found.fitted.mean(axis=0)
    assert off[level] == pytest.approx([np.log(1.04)] * 3, abs=1e-6)
    assert np.delete(off, level) == pytest.approx(0.0, abs=1e-6)
    assert all(0.1 < one.spread < 1.5 for one in found.colours)


def test_too_few_prints_decide_nothing(house):
    _, _, golden = house
    few = golden.model_copy(update={"parts": golden.parts[: golden.needed - 1]})
    assert few.lacking == "2 golden prints: from 3 on prints are compared with them"
    assert golden.lacking is None


def test_the_key_is_of_what_changes_a_measurement(make_recipe):
    key = GoldenPrints.key_of(make_recipe())
    for same in (
        {"print": {"u_c": 0.2}},
        {"tolerances": {"delta_e": 3.0}},
        {"acquisition": {"settle_s": 2.0}},
    ):
        assert GoldenPrints.key_of(make_recipe(**same)) == key
    for other in ({"acquisition": {"exposure_s": 0.006}}, {"region": {"size_mm": [1.0, 1.0]}}):
        assert GoldenPrints.key_of(make_recipe(**other)) != key
