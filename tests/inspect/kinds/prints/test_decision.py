"""The verdict on a print: every defect at its listed size, good prints, guard bands, and the cause that is named."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import MeasurementError
from anisoscope.kinds.prints.causes import explain_print
from anisoscope.kinds.prints.decision import decide_print
from anisoscope.kinds.prints.expectation import rig_sources
from anisoscope.kinds.prints.model import State
from anisoscope.kinds.prints.sources import total
from anisoscope.record.verdict import Verdict
from anisoscope.sim.materials.inks import synthetic_ink

LISTED = [
    (State(alpha=np.log(1.10)), "roughness", 0.10),
    pytest.param(State(alpha=np.log(0.30 / 0.19)), "roughness", 0.30 / 0.19 - 1.0, marks=pytest.mark.soak),
    (State(missing=0.10), "missing-ink", 0.10),
    (State(ratio=np.log(1.15)), "brushing", 0.15),
    (State(tilt_x_deg=0.6, tilt_y_deg=-0.8), "lean", 1.0),
    (State(shift_nm=10.0), "film-thickness", 10.0),
    (State(other=0.05), "wrong-ink-synthetic red", 0.05),
    pytest.param(State(other=1.0), "wrong-ink-synthetic red", 1.0, marks=pytest.mark.soak),
    (State(red=np.log(1.12), green=np.log(1.12), blue=np.log(1.12)), "bright-ink", 0.12),
]


def explained(sheet, measured, decision):
    """The diagnosis of a sheet."""
    return explain_print(sheet.recipe, sheet.expected, measured, decision)


def by_name(decision):
    """Quantities by their names."""
    return {one.name: one for one in decision.quantities}


@pytest.mark.parametrize(("state", "cause", "severity"), LISTED)
def test_a_defect_of_the_listed_size_fails_and_is_named(sheet, state, cause, severity):
    measured, decision = sheet.all(state).decided(synthetic_ink("synthetic-red"))
    assert decision.verdict is Verdict.FAIL, decision.reasons
    best, *others = explained(sheet, measured, decision).causes
    assert best.cause == cause
    assert best.severity == pytest.approx(severity, rel=0.05)
    low, high = best.interval
    assert low <= severity <= (high or 1.0) or best.severity == pytest.approx(severity, rel=0.02)
    assert not any(one.tie for one in others)


def test_a_halftone_with_too_much_ink_on_white_is_told_from_brighter_ink(make_recipe, predict, sheet):
    """On a white sheet more ink covers more white; on a black one nothing tells it from ink that is brighter."""
    for substrate, tied in ((0.8, {"dot-gain"}), (0.0, {"dot-gain", "bright-ink"})):
        recipe = make_recipe(
            print={"coverage": 0.6, "substrate": substrate, "u_substrate": 0.003},
            poses={"tilts_deg": [0.0, 10.0, 20.0]},
            area={"cell_mm": 0.4},
        )
        printed = type(sheet)(recipe, predict(recipe), np.random.default_rng(5)).all(State(missing=-0.25))
        measured, decision = printed.decided()
        assert by_name(decision)["gain"].deviation > 0.1
        found = explained(printed, measured, decision).causes
        assert {one.cause for one in found if one.tie} == tied
        gain = next(one for one in found if one.cause == "dot-gain")
        assert gain.severity == pytest.approx(0.25, abs=0.03)


def test_a_curled_sheet_fails_and_is_named(sheet):
    """Curl of ±1° over a sheet of 2.4 mm changes the tilt by 1.67° over 2 mm."""
    measured, decision = sheet.curled(1.67).decided()
    assert by_name(decision)["curl"].verdict is Verdict.FAIL
    assert by_name(decision)["curl"].value == pytest.approx(1.67, abs=0.05)
    assert by_name(decision)["tilt"].verdict is Verdict.PASS
    best = explained(sheet, measured, decision).causes[0]
    assert (best.cause, best.severity) == ("curl", pytest.approx(1.67, abs=0.15))


def test_a_sheet_curled_along_a_diagonal_is_named_with_its_size(sheet):
    rows, cols = sheet.grid.shape
    x, y = np.meshgrid((np.arange(cols) + 0.5) / cols - 0.5, 0.5 - (np.arange(rows) + 0.5) / rows)
    way = np.array([0.6, 0.8])
    for place in np.ndindex(rows, cols):
        tilt_x, tilt_y = np.round(3.0 * way * (way @ (x[place], y[place])), 9)
        sheet.states[place] = State(tilt_x_deg=float(tilt_x), tilt_y_deg=float(tilt_y))
    measured, decision = sheet.decided()
    assert by_name(decision)["curl"].value == pytest.approx(3.0, abs=0.05)
    best = explained(sheet, measured, decision).causes[0]
    assert (best.cause, best.severity) == ("curl", pytest.approx(3.0, abs=0.1))
    assert best.interval[0] <= 3.0 <= best.interval[1]


def test_a_sheet_that_stands_on_edge_leans(sheet):
    measured, decision = sheet.all(State(tilt_x_deg=-5.4, tilt_y_deg=7.2)).decided()
    assert by_name(decision)["tilt"].value == pytest.approx(9.0, abs=0.01)
    best = explained(sheet, measured, decision).causes[0]
    assert (best.cause, best.severity) == ("lean", pytest.approx(9.0, rel=0.01))


def test_a_spot_fails_and_is_found(sheet):
    measured, decision = sheet.spotted(slice(3, 6), slice(10, 14), 0.5).decided()
    assert decision.verdict is Verdict.FAIL
    assert decision.map.record.share == pytest.approx(12.0 / 400.0)
    (spot,) = decision.map.record.spots
    assert (spot.x, spot.y) == (pytest.approx(0.2), pytest.approx(0.55))
    assert (spot.width, spot.length) == (pytest.approx(0.4), pytest.approx(0.3))
    assert explained(sheet, measured, decision).causes[0].cause == "spots"


def test_c_is_hardly_seen_and_not_judged(sheet):
    """A change of 0.3 makes about ΔE 1 and no verdict."""
    _, decision = sheet.all(State(c=0.3)).decided()
    assert decision.verdict is Verdict.PASS
    assert max(one.delta_e for one in decision.colours) < 1.3


def test_good_prints_pass_at_their_stated_spread(good, sheet):
    """Drawn from all uncertainties but those of the lobe's form: none fails, D² follows χ²."""
    recipe, expected = good
    everything = (*expected.sources, *rig_sources(recipe, expected))
    covariance = total(everything, 63)
    root, rng = np.linalg.cholesky(covariance), np.random.default_rng(3)
    plain = recipe.model_copy(update={"area": None})
    base, found = sheet.measured(), []
    for _ in range(12):
        channels = np.exp(expected.scene.log_channels() + root @ rng.standard_normal(63)).reshape(21, 3)
        found.append(decide_print(expected, replace(base, channels=channels, sources=()), plain))
    assert not any(one.verdict is Verdict.FAIL for one in found)
    assert sum(one.verdict is Verdict.PASS for one in found) >= 4  # 8.5 ± 1.6 are due
    assert np.mean([one.d2 for one in found]) == pytest.approx(63.0, abs=4.0 * np.sqrt(126.0 / 12.0))


def test_the_guard_band_decides_near_a_limit(sheet):
    """T − g and T + g of the level: 5 % ∓ 1.645 · 1.3 %."""
    verdicts = {}
    for missing in (0.01, 0.05, 0.09):
        _, decision = sheet.all(State(missing=missing)).decided()
        verdicts[missing] = by_name(decision)["gain"].verdict
    assert verdicts == {0.01: Verdict.PASS, 0.05: Verdict.INCONCLUSIVE, 0.09: Verdict.FAIL}


def test_a_significant_deviation_warns_or_fails(good, sheet):
    recipe, expected = good
    measured = sheet.all(State(tilt_x_deg=0.3, ratio=0.02)).measured()
    for rule, verdict in (("warn", Verdict.PASS), ("fail", Verdict.FAIL)):
        strict = recipe.model_copy(
            update={"decision": recipe.decision.model_copy(update={"deviation": rule})}
        )
        decision = decide_print(expected, measured, strict)
        assert decision.p_value < 1e-6
        assert decision.verdict is verdict
        assert ("significant" in " ".join(decision.reasons)) is True


def test_the_uncertainty_of_a_share_is_that_of_the_share(sheet):
    """Twice the level is known twice as badly as one: ln of it is known alike."""
    _, good = sheet.decided()
    _, twice = sheet.all(State(red=np.log(2.0), green=np.log(2.0), blue=np.log(2.0))).decided()
    one, two = (by_name(decision)["gain"] for decision in (good, twice))
    assert two.deviation == pytest.approx(1.0, abs=0.01)
    assert two.u == pytest.approx(2.0 * one.u, rel=0.01)
    assert two.u == pytest.approx(np.linalg.norm([u for _, _, u in two.contributions]))


def test_contributions_add_up_to_the_uncertainty(sheet):
    _, decision = sheet.decided()
    for one in decision.quantities:
        if one.contributions:
            assert one.u == pytest.approx(np.linalg.norm([u for _, _, u in one.contributions]))


def test_a_map_that_is_too_noisy_is_no_verdict(good, sheet):
    recipe, expected = good
    measured = replace(sheet.measured(), cell_noise=np.full((21, 3), 0.1))
    with pytest.raises(MeasurementError, match=r"noise alone makes ΔE .* in a cell.*larger cells"):
        decide_print(expected, measured, recipe)
