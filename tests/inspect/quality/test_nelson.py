"""Nelson's eight tests: each pattern alone, its false alarms in closed form, and what ends a pattern."""

import itertools
import math

import numpy as np
import pytest
from scipy.special import ndtr

from anisoscope.base.errors import UsageError
from anisoscope.quality.control import Settings
from anisoscope.quality.nelson import LENGTHS, RULES, flagged, flags, signals

# the shortest series in which a rule is met and none that is shorter; noise that meets no rule stands before it
QUIET = [0.4, -0.6, -0.2, 0.7, -0.5]
PATTERNS = {
    1: [3.1],
    2: [0.2, 0.9, 0.3, 0.8, 0.7, 0.2, 0.5, 0.1, 0.6],
    3: [-1.9, -1.6, -0.9, 0.4, 0.5, 1.2],
    4: [0.2, -0.4, 0.9, -0.1, 0.1, -0.9, 0.3, -1.2, 1.5, -0.3, 1.4, -0.4, 0.8, -0.2],
    5: [2.1, -0.5, 2.4],
    6: [-1.2, -1.4, 0.3, -1.1, -1.6],
    7: [0.5, 0.3, -0.4, -0.6, 0.2, 0.1, -0.9, 0.4, 0.8, -0.1, -0.3, -0.5, 0.6, 0.7, -0.2],
    8: [1.1, -1.2, -1.4, 1.3, -1.1, 1.6, 1.2, -1.5],
}


def rules_met(z):
    return {flag.rule for flag in flags(np.array(z), 0.0, 1.0)}


@pytest.mark.parametrize("rule", RULES)
def test_each_pattern_is_found_when_complete_and_not_before(rule):
    pattern = PATTERNS[rule]
    assert rules_met(pattern) == {rule}
    assert rule not in rules_met(pattern[:-1])
    (flag,) = flags(np.array(pattern), 0.0, 1.0)
    assert (flag.first, flag.last, flag.seen_at) == (0, len(pattern) - 1, len(pattern) - 1)
    assert len(pattern) == LENGTHS[rule]
    assert flag.text == RULES[rule]


@pytest.mark.parametrize("rule", RULES)
def test_patterns_are_the_same_upside_down_and_on_any_scale(rule):
    z = np.array(QUIET + PATTERNS[rule])
    found = [(f.rule, f.first, f.last) for f in flags(z, 0.0, 1.0)]
    for scale in (-1.0, 0.01, -300.0):
        other = flags(7.0 + scale * z, 7.0, abs(scale))
        assert [(f.rule, f.first, f.last) for f in other] == found


@pytest.mark.parametrize("rule", [2, 3, 4, 5, 6, 7, 8])
def test_what_is_missing_ends_a_pattern(rule):
    pattern = PATTERNS[rule]
    for place in range(1, len(pattern)):
        assert rules_met([*pattern[:place], np.nan, *pattern[place:]]) == set()


def test_ties_neither_rise_nor_fall_and_the_centre_is_no_side():
    assert 3 not in rules_met([-1.9, -1.6, -0.9, -0.9, 0.4, 0.5])
    assert 3 in rules_met([-1.9, -1.6, -0.9, -0.8, 0.4, 0.5])
    assert 2 not in rules_met([0.5] * 5 + [0.0] + [0.5] * 5)
    assert 2 in rules_met([0.5] * 9)
    steps = [0.3, -0.3] * 6
    assert 4 not in rules_met([*steps, -0.3, 0.3])
    assert 4 in rules_met([*steps, 0.3, -0.3])


def test_exactly_one_sigma_is_neither_within_nor_beyond():
    z = np.array([0.5] * 7 + [1.0] + [0.5] * 7) * np.array([1, -1] * 7 + [1])
    assert not signals(z, 0.0, 1.0)[7].any()
    assert not signals(np.array([1.5, -1.5, -1.5, 1.5, 1.0, -1.5, 1.5, -1.5]), 0.0, 1.0)[8].any()
    assert not signals(np.array([3.0]), 0.0, 1.0)[1].any()


def test_a_long_run_is_one_flag_and_two_runs_are_two():
    z = np.array([0.5] * 30)
    (flag,) = [f for f in flags(z, 0.0, 1.0) if f.rule == 2]
    assert (flag.first, flag.last, flag.seen_at) == (0, 29, 8)
    z = np.array([0.5] * 12 + [-0.5] * 12)
    found = [f for f in flags(z, 0.0, 1.0) if f.rule == 2]
    assert [(f.first, f.last) for f in found] == [(0, 11), (12, 23)]
    found = [f for f in flags(np.array([5.0, 5.0]), 0.0, 1.0) if f.rule == 1]
    assert [(f.first, f.last) for f in found] == [(0, 0), (1, 1)]


def closed_form():
    """Probability that a pattern is complete at a value of a stable normal process (.003 to .005 after Nelson)."""
    p1, p2, p3 = (float(ndtr(-k)) for k in (1.0, 2.0, 3.0))
    four_of_five = sum(math.comb(4, k) * p1**k * (1 - p1) ** (4 - k) for k in (3, 4))
    zigzag = [1, 1]  # permutations of n that go up and down by turns, from up (Euler numbers)
    for n in range(1, 14):
        zigzag.append(sum(math.comb(n, k) * zigzag[k] * zigzag[n - k] for k in range(n + 1)) // 2)
    return {
        1: 2 * p3,
        2: 2 * 0.5**9,
        3: 2 / math.factorial(6),
        4: 2 * zigzag[14] / math.factorial(14),
        5: 2 * p2 * (1 - (1 - p2) ** 2),
        6: 2 * p1 * four_of_five,
        7: (1 - 2 * p1) ** 15,
        8: (2 * p1) ** 8,
    }


@pytest.mark.parametrize("count", [200_000, pytest.param(2_000_000, marks=pytest.mark.statistics)])
def test_false_alarms_are_as_many_as_theory_says(rng, count):
    values = rng.normal(size=count)
    found = {rule: int(seen.sum()) for rule, seen in signals(values, 0.0, 1.0).items()}
    for rule, chance in closed_form().items():
        expected = chance * len(values)
        # signals come in clusters of up to a dozen, which widens the scatter of their count
        assert found[rule] == pytest.approx(expected, abs=6.0 * math.sqrt(4.0 * expected)), rule


def test_flags_are_the_brute_force_ones(rng):
    """Rules 2, 5 and 6 against a plain loop over windows, on series with gaps and ties."""
    values = np.round(rng.normal(size=600), 1)
    values[rng.random(600) < 0.05] = np.nan
    found = signals(values, 0.0, 1.0)
    for at in range(len(values)):
        for rule, far, least, span in ((5, 2.0, 2, 3), (6, 1.0, 4, 5), (2, 0.0, 9, 9)):
            met = False
            for side in (1, -1):
                back = list(itertools.takewhile(lambda v: not np.isnan(v), values[at::-1][:span]))
                met |= bool(back) and side * back[0] > far and sum(side * v > far for v in back) >= least
            assert found[rule][at] == met, (rule, at)


def test_flagged_values_are_those_of_all_patterns():
    z = np.array([*QUIET, 3.5, *QUIET])
    found = flags(z, 0.0, 1.0)
    assert np.flatnonzero(flagged(found, len(z))).tolist() == [5]
    assert not flagged((), 4).any()


def test_rules_that_are_not_chosen_do_not_count():
    z = np.array([*QUIET, *PATTERNS[1], *QUIET, *PATTERNS[2]])
    assert {one.rule for one in flags(z, 0.0, 1.0)} == {1, 2}
    for rule in (1, 2):
        assert {one.rule for one in flags(z, 0.0, 1.0, (rule, 7))} == {rule}
    with pytest.raises(UsageError, match="the numbers 1 to 8"):
        Settings(rules=(1, 9))
    with pytest.raises(UsageError, match="the numbers 1 to 8"):
        Settings(rules=())
