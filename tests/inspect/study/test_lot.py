"""Parts of a lot: predicted as a recipe of their own would be, and judged as an inspection judges them."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.decision.consistency import scatter_of
from anisoscope.decision.decision import guarded
from anisoscope.kinds.ridges.kind import RIDGES
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.prediction.expectation import expectation
from anisoscope.record.verdict import Verdict
from anisoscope.study import lot as lots
from anisoscope.study.lot import VERDICTS, Lot, Shift, Spread, judged_on_rig, setting_of

MATERIAL = {"alpha_along": 0.06, "alpha_across": 0.1, "albedo": 0.2, "u_tail": 0.0}
DESIGN = {"ridge_angle_deg": 10.0, "edge_radius_um": 0.0}
TABLE = {
    "schema": 1,
    "product": "plate",
    "acquisition": {"exposure_s": 0.01},
    "region": {"size_mm": [2.0, 2.0]},
    "surface": {"pitch_um": 100.0, "design": DESIGN},
    "material": MATERIAL,
    "poses": {"angles_deg": [0, 90, 180], "tilts_deg": [0, 10]},
}
LIGHT_DEG = 10.0


def recipe(**tables):
    return RidgeRecipe.model_validate(TABLE | tables)


def of_design(**numbers):
    return recipe(surface={"pitch_um": 100.0, "design": DESIGN | numbers})


def exact_rig(setting, radius_um=0.0):
    zero = np.zeros(len(setting.usual))
    return lots._Rig(setting.nominal, radius_um, zero, zero)


@pytest.mark.parametrize(
    ("shift", "alike"),
    [
        (Shift(ridge_angle=1.0), of_design(ridge_angle_deg=11.0)),
        (
            Shift(alpha=0.2, albedo=-0.1),
            recipe(material=MATERIAL | {"alpha_along": 0.072, "alpha_across": 0.12, "albedo": 0.18}),
        ),
        (Shift(edge_radius=3.0), of_design(edge_radius_um=3.0)),
    ],
)
def test_a_part_of_a_shifted_lot_is_that_of_a_recipe_that_states_it(shift, alike):
    one = recipe(decision={"tolerance": 0.3})
    setting = setting_of(Lot(one, LIGHT_DEG, Spread(), shift))
    rig = exact_rig(setting, setting.crests.mean_um)
    light = lots.drawn_parts(setting, rig, 2, Spread(), shift, np.random.default_rng(1))
    np.testing.assert_allclose(light.true[0], light.true[1])
    np.testing.assert_allclose(light.true[0], np.log(expectation(alike, LIGHT_DEG).radiance), atol=3e-3)
    off = light.measured - light.true
    assert 0.0 < np.abs(off).max() < 5.0 * np.max([one.relative for one in setting.errors])


def test_verdicts_are_those_of_the_kind_and_of_the_rule():
    """With tolerances by which some parts pass, some fail, and some stay open."""
    one = recipe(decision={"tolerance": 0.35, "deviation": "fail"})
    lot = Lot(one, LIGHT_DEG, Spread(ridge_angle=1.0, alpha=0.1, seating=0.1), parts=90, rigs=3)
    judged = judged_on_rig((lot, 1), np.random.default_rng(5))
    assert len(judged.verdict) == 30
    assert set(judged.verdict) == {0, 1, 2}
    rule = one.decision
    for verdict, significant, deviation, u in zip(
        judged.verdict, judged.significant, judged.deviation, judged.u, strict=True
    ):
        alone = {
            guarded(float(d), float(s), 0.35, rule.coverage)[0] for d, s in zip(deviation, u, strict=True)
        }
        worst = Verdict.FAIL if significant else Verdict.PASS
        order = [Verdict.PASS, Verdict.INCONCLUSIVE, Verdict.FAIL]
        assert VERDICTS[verdict] == max([*alone, worst], key=order.index)


def test_a_part_is_judged_as_by_its_kind():
    one = recipe(material={key: value for key, value in MATERIAL.items() if key != "u_tail"})
    setting = setting_of(Lot(one, LIGHT_DEG, Spread()))
    rng = np.random.default_rng(3)
    off = np.log(setting.expected.radiance) + 0.1 * rng.standard_normal((4, 6))
    golden = lots.golden_set(setting, off[:2])
    plain = one.model_copy(update={"area": None})
    for log_radiance in off[2:]:
        measured = lots.measured_as(setting, log_radiance)
        theirs = RIDGES.decide(None, plain, setting.expected, measured, golden)
        ours = lots.decide(
            setting.expected, measured, setting.recipe, golden, RIDGES.part_scatter(one, LIGHT_DEG)
        )
        assert (ours.verdict, ours.p_value) == (theirs.verdict, theirs.p_value)
        assert ours.golden == 2


def test_what_is_drawn_of_good_parts_is_drawn_once_for_all_parts():
    one = recipe()
    setting = setting_of(Lot(one, LIGHT_DEG, Spread(), golden=2))
    measured = [lots.measured_as(setting, np.full(6, level)) for level in (-2.0, -1.0)]
    first, second = (scatter_of(setting.scatter, each) for each in measured)
    assert first is second


def test_golden_parts_find_what_a_plastic_without_a_measured_lobe_hides():
    """Parts that share a rig are found together: the gain of one rig is 7 of 40, with a standard deviation of 5."""
    one = recipe(material={key: value for key, value in MATERIAL.items() if key != "u_tail"})
    counts = dict.fromkeys((0, 3), 0)
    for golden in counts:
        lot = Lot(one, LIGHT_DEG, Spread.of(one), Shift(ridge_angle=1.0), 40, 2, golden)
        for rig in range(8):
            judged = judged_on_rig((lot, 0), np.random.default_rng(2 + rig))
            counts[golden] += int(np.count_nonzero(judged.significant))
    assert counts[3] > counts[0] + 8  # three standard deviations below 53


def test_rigs_differ_and_the_parts_of_one_share_its_state():
    one = recipe(decision={"tolerance": 0.3})
    lot = Lot(one, LIGHT_DEG, Spread(ridge_angle=0.01), parts=8, rigs=2, u_pose=0.001)
    means = []
    for number in (0, 1):
        judged = judged_on_rig((lot, number), np.random.default_rng(number))
        assert judged.true.std(axis=0).max() < 0.01
        means.append(judged.true.mean(axis=0))
    assert np.abs(means[0] - means[1]).max() > 0.02


def test_spread_of_a_recipe_is_its_table_scatter():
    stated = recipe(scatter={"ridge_angle_deg": 0.3, "alpha_share": 0.07, "albedo_share": 0.02})
    assert Spread.of(stated) == Spread(0.3, 0.07, 0.02, 0.0, 0.0, 0.1)


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ({"parts": 3}, "3 parts on 25"),
        ({"rigs": 1}, "2 rigs or more"),
        ({"golden": -1}, "golden parts is 0 or more"),
        ({"u_pose": 1.0}, "is a share, not 1"),
    ],
)
def test_lots_that_mean_nothing_are_refused(numbers, words):
    with pytest.raises(UsageError, match=words):
        replace(Lot(recipe(), LIGHT_DEG, Spread()), **numbers)
    with pytest.raises(UsageError, match="alpha must be 0 or more"):
        Spread(alpha=-0.1)
    with pytest.raises(UsageError, match="albedo must be a finite number"):
        Shift(albedo=float("nan"))
