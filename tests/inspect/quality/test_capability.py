"""Cp and Cpk: published examples, and intervals that hold as often as they say."""

import numpy as np
import pytest
from scipy.stats import norm

from anisoscope.base.errors import UsageError
from anisoscope.quality.capability import Specification, capability, nearer_index, spread_index
from anisoscope.quality.limits import individuals, limits_of


def exact(mean, sigma, count, rng):
    """Values that have exactly this mean and standard deviation."""
    z = rng.normal(size=count)
    return mean + sigma * (z - z.mean()) / z.std(ddof=1)


def test_nist_example(rng):
    """e-Handbook 6.1.6: limits 8 and 20, mean 16, s 2: Cp 1.0, Cpk 0.6667."""
    values = exact(16.0, 2.0, 50, rng)
    found = capability(values, limits_of(individuals(values)), Specification(8.0, 20.0))
    assert found.pp.value == pytest.approx(1.0)
    assert found.ppk.value == pytest.approx(0.6667, abs=5e-5)


def test_montgomery_interval_of_cp():
    """Introduction to Statistical Quality Control, example 8.4: limits 38 and 62, s 1.75, n 20: 2.29, 1.57 to 3.01."""
    found = spread_index(62.0 - 38.0, 1.75, 19)
    assert (found.value, found.low, found.high) == pytest.approx((2.29, 1.57, 3.01), abs=0.006)


def test_intervals_hold_as_often_as_they_say(rng):
    """3000 series of 40: Pp and Ppk at 95 %, Cp and Cpk from moving ranges as well."""
    true_cp, true_cpk, hits = 10.0 / 6.0, 4.0 / 3.0, np.zeros(4)
    for values in rng.normal(1.0, 1.0, (3000, 40)):
        found = capability(values, limits_of(individuals(values)), Specification(-5.0, 5.0))
        pairs = ((found.pp, true_cp), (found.ppk, true_cpk), (found.cp, true_cp), (found.cpk, true_cpk))
        hits += [index.low <= truth <= index.high for index, truth in pairs]
    np.testing.assert_allclose(hits / 3000, 0.95, atol=0.015)


def test_a_limit_on_one_side_has_no_cp(rng):
    values = exact(1.0, 0.5, 30, rng)
    found = capability(values, limits_of(individuals(values)), Specification(None, 2.5))
    assert (found.cp, found.pp) == (None, None)
    assert found.ppk.value == pytest.approx(1.0)
    assert found.outside_expected == pytest.approx(norm.sf(3.0))
    lower = capability(-values, limits_of(individuals(-values)), Specification(-2.5, None))
    assert lower.ppk.value == pytest.approx(found.ppk.value)


def test_missing_values_do_not_count_and_outside_is_counted(rng):
    values = np.append(exact(0.0, 1.0, 60, rng), [np.nan, 9.0, -9.0])
    found = capability(values, limits_of(individuals(values)), Specification(-8.0, 8.0))
    assert (found.count, found.outside) == (62, 2)


def test_a_process_beyond_its_limit_has_a_negative_cpk():
    assert nearer_index(-0.5, 30, 29.0).high < 0.0


@pytest.mark.parametrize(("lower", "upper"), [(None, None), (1.0, 1.0), (2.0, 1.0)])
def test_limits_that_are_none(lower, upper):
    with pytest.raises(UsageError, match="limit"):
        Specification(lower, upper)
