"""The test for drift: bets that are fair for every order of the values, and parameters that are named rightly."""

import itertools
import math

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.quality.drift import (
    FALSE_ALARMS,
    NONE,
    drift_study,
    log_bets,
    log_evidence,
    onset_weights,
    sequential_ranks,
)
from anisoscope.quality.nelson import flags
from anisoscope.sim.press import CONTRAST, MEASURED, SENSITIVITIES, SETTINGS, Change, mould

LIMIT = -math.log(FALSE_ALARMS)


def labels(count):
    return tuple(f"P{k}" for k in range(count))


def ranks_of(series, rng=None):
    """Ranks of the newest value of many series at once, (S, N), by counting; equal values in random order."""
    found = np.empty(series.shape, dtype=np.int64)
    for n in range(series.shape[1]):
        low = (series[:, :n] < series[:, n : n + 1]).sum(axis=1)
        equal = (series[:, :n] == series[:, n : n + 1]).sum(axis=1)
        found[:, n] = 1 + low + (0 if rng is None else rng.integers(0, equal + 1))
    return found


def test_every_order_of_six_values_together_leaves_the_stakes_as_they_were():
    orders = np.array(list(itertools.permutations(range(6))), dtype=float)
    evidence = np.exp(log_evidence(ranks_of(orders)))
    assert np.allclose(evidence.mean(axis=0), 1.0, rtol=1e-12)
    assert evidence.max() > 1.3  # and is not 1 for each


@pytest.mark.parametrize("count", [1, 2, 9, 400])
def test_a_bet_is_fair_over_all_ranks(count):
    ranks = np.ones((count, count), dtype=np.int64)
    ranks[:, -1] = np.arange(1, count + 1)
    assert np.allclose(np.exp(log_bets(ranks)[..., -1]).mean(axis=-1), 1.0, rtol=1e-9)


def test_ranks_are_those_of_counting_and_ties_are_drawn():
    values = np.random.default_rng(3).standard_normal(60)
    assert sequential_ranks(values).tolist() == ranks_of(values[None])[0].tolist()
    same = sequential_ranks(np.ones(400))
    assert abs((same / np.arange(1, 401)).mean() - 0.5) < 0.05
    assert log_evidence(same).max() < LIMIT


def test_only_the_order_counts():
    values = np.random.default_rng(4).standard_normal(80)
    one, other = (drift_study("x", v, labels(80), {}) for v in (values, np.exp(3.0 * values)))
    assert np.array_equal(one.log_evidence, other.log_evidence)


DISTRIBUTIONS = {
    "normal": lambda rng, shape: rng.standard_normal(shape),
    "exponential": lambda rng, shape: rng.exponential(size=shape),
    "Cauchy": lambda rng, shape: rng.standard_cauchy(shape),
    "rounded": lambda rng, shape: np.round(rng.standard_normal(shape)),
}


def alarms(name, count, length):
    rng = np.random.default_rng([11, len(name)])
    ranks = ranks_of(DISTRIBUTIONS[name](rng, (count, length)), rng)
    return int((log_evidence(ranks).max(axis=1) >= LIMIT).sum())


@pytest.mark.parametrize("name", ["exponential", "rounded"])
def test_few_series_without_drift_ever_raise_an_alarm(name):
    assert alarms(name, 200, 300) <= 5  # the limit of 1 % is kept well: .5 ± .7 are seen


def test_nelsons_rules_alarm_in_every_series_of_that_length():
    rng = np.random.default_rng(12)
    series = rng.standard_normal((100, 1000))
    first = [min(flag.seen_at for flag in flags(values, 0.0, 1.0)) + 1 for values in series]
    assert 45 < np.mean(first) < 110  # 74 ± 7.5, as the first alarm is spread like an exponential


@pytest.mark.statistics
@pytest.mark.parametrize("name", list(DISTRIBUTIONS))
def test_false_alarms_in_total_are_at_most_one_percent(name):
    assert alarms(name, 2000, 1000) <= 20  # 2 to 8 are seen


def wandering(share, count, length, rng):
    """Normal values with a share of the variance in a wander, whose correlation from part to part is 0.8."""
    made = np.empty((count, length))
    made[:, 0] = rng.standard_normal(count)
    for n in range(1, length):
        made[:, n] = 0.8 * made[:, n - 1] + 0.6 * rng.standard_normal(count)
    return np.sqrt(1.0 - share) * rng.standard_normal((count, length)) + np.sqrt(share) * made


@pytest.mark.statistics
@pytest.mark.parametrize(("share", "low", "high"), [(0.05, 0.0, 0.03), (0.1, 0.03, 0.12), (0.2, 0.25, 0.42)])
def test_series_that_wander_by_themselves_raise_alarms(share, low, high):
    """The limit of the test: 1, 7, 33 % of series of 1,000 parts (docs/evidence/statistics.md)."""
    ranks = ranks_of(wandering(share, 400, 1000, np.random.default_rng(13)))
    rate = float((log_evidence(ranks).max(axis=1) >= LIMIT).mean())
    assert low <= rate <= high, rate


@pytest.mark.statistics
def test_a_step_of_two_standard_deviations_is_seen_after_nine_parts():
    series = np.random.default_rng(14).standard_normal((300, 250))
    series[:, 150:] += 2.0
    above = log_evidence(ranks_of(series)) >= LIMIT
    seen = np.where(above.any(axis=1), above.argmax(axis=1) - 150 + 1, 100)
    assert np.median(seen) == pytest.approx(9, abs=1)


def test_an_onset_is_found():
    rng = np.random.default_rng(5)
    values = rng.standard_normal(160)
    values[120:] += 2.5
    weights = onset_weights(sequential_ranks(values))
    assert weights.sum() == pytest.approx(1.0)
    assert abs(int(np.argmax(weights)) - 120) <= 3
    found = drift_study("x", values, labels(160), {})
    assert 120 <= found.alarm_at < 135
    assert found.onset_first <= 120 <= found.onset_last
    assert found.driver is None
    assert found.seen


def spread(number):
    """Standard deviation of a measured number of the press without drift, from its stated sensitivities."""
    parts = {name: (SENSITIVITIES[name], MEASURED[name], 1.0) for name in SENSITIVITIES}
    slopes = (
        parts[number][0]
        if number in parts
        else {one: sum(CONTRAST[name] * SENSITIVITIES[name][one] for name in CONTRAST) for one in SETTINGS}
    )
    variance = sum((slopes[one] * SETTINGS[one][1]) ** 2 for one in SETTINGS)
    return math.sqrt(variance + MEASURED[number] ** 2), slopes


def campaign(count, seed):
    """Drifts of every setting, as step and as ramp, seen in every number: which were named within 30 parts."""
    rng = np.random.default_rng(seed)
    wrong = []
    for k in range(count):
        setting, number = list(SETTINGS)[k % 5], ["ridge height", "edge radius", "ln 0-90"][(k // 5) % 3]
        sigma, slopes = spread(number)
        size = rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 4.0) * sigma / abs(slopes[setting])
        onset = int(rng.integers(60, 300))
        made = mould(onset + 30, (Change(setting, size, onset, (0, 15)[k % 2]),), rng)
        found = drift_study(number, made.measured[number], labels(onset + 30), made.cycles)
        if found.alarm_at is None or found.alarm_at < onset or found.driver != setting:
            wrong.append((setting, number, onset, found.verdict))
    return wrong


def test_the_parameter_that_drifts_is_named_within_30_parts():
    assert len(campaign(30, 6)) <= 4  # of .75 that are due; five have a chance of .1 %


@pytest.mark.statistics
def test_in_nine_of_ten_drifts_the_right_parameter_is_first_within_30_parts():
    assert len(campaign(200, 7)) <= 20


def background(rng, count):
    return {f"x{k}": rng.standard_normal(count) for k in range(12)}


def test_a_drift_that_no_parameter_explains_is_none_of_them():
    rng = np.random.default_rng(8)
    for ramp in (1, 15):
        machine = background(rng, 180)
        values = rng.standard_normal(180) + 2.5 * np.clip((np.arange(180) - 149) / ramp, 0.0, 1.0)
        found = drift_study("x", values, labels(180), machine)
        assert found.driver == NONE
        assert found.none_of_them > 0.9
        assert sum(one.weight for one in found.parameters) + found.none_of_them == pytest.approx(1.0)


def test_what_explains_the_usual_spread_is_not_taken_for_the_driver():
    rng = np.random.default_rng(9)
    machine = background(rng, 230)
    machine["x1"][200:] += 3.0
    values = 2.0 * machine["x0"] + 2.0 * machine["x1"] + rng.standard_normal(230)
    found = drift_study("x", values, labels(230), machine)
    by_name = {one.name: one for one in found.parameters}
    assert found.driver == "x1"
    assert abs(by_name["x0"].correlation) > 0.5
    assert by_name["x0"].weight < 0.01
    assert by_name["x1"].weight > 0.9
    assert found.none_of_them > 0.0


def test_a_parameter_may_act_some_parts_later():
    rng = np.random.default_rng(10)
    machine = background(rng, 230)
    machine["x3"][195:] += 3.0
    values = rng.standard_normal(230)
    values[4:] += 1.5 * machine["x3"][:-4]
    found = drift_study("x", values, labels(230), machine)
    assert (found.driver, found.parameters[0].lag) == ("x3", 4)


def test_what_is_missing_or_never_changes_is_left_out_and_named():
    rng = np.random.default_rng(13)
    machine = background(rng, 120)
    machine["rare"] = np.where(np.arange(120) < 60, np.nan, 1.0)
    machine["fixed"] = np.full(120, 7.0)
    machine["x2"][5] = np.nan
    values = rng.standard_normal(120)
    values[[3, 80]] = np.nan
    found = drift_study("x", values, labels(120), machine)
    assert not found.seen
    assert "no drift" in found.verdict
    assert [note.split(" is ")[0] for note in found.notes] == ["rare", "fixed"]
    assert len(found.parameters) == 12
    assert math.isnan(found.none_of_them)
    with pytest.raises(UsageError, match="needs 8 measured values"):
        drift_study("x", values[:8], labels(8), {})
