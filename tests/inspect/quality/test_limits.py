"""I-MR charts: the NIST example, and what is missing."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.quality.control import Settings, control_study
from anisoscope.quality.limits import (
    given_limits,
    individuals,
    limits_of,
    moving_range,
    sigma_freedom,
)


def test_nist_example_of_flow_rates(published):
    """e-Handbook 6.3.2.2: mean 50.81, mean moving range 1.8778, limits 45.8159 and 55.8041 (with d2 = 1.128)."""
    limits = control_study("flow", individuals(published.nist_flowrate), Settings()).limits
    assert limits.center == pytest.approx(50.81)
    assert limits.range_center == pytest.approx(1.8778, abs=5e-5)
    assert limits.lower == pytest.approx(45.8159, abs=0.002)
    assert limits.upper == pytest.approx(55.8041, abs=0.002)
    assert limits.range_upper == pytest.approx(3.267 * 1.8778, abs=0.002)


def test_a_missing_value_takes_two_moving_ranges_with_it():
    ranges = moving_range(np.array([1.0, 3.0, np.nan, 9.0, 8.0]))
    np.testing.assert_array_equal(ranges, [np.nan, 2.0, np.nan, np.nan, 1.0])


def test_a_baseline_counts_measured_values_only():
    values = np.array([1.0, np.nan, 2.0, 1.0, np.nan, 2.0, 1.0, 50.0, 90.0])
    limits = limits_of(individuals(values), 5)
    assert (limits.center, limits.baseline, limits.freedom) == (
        pytest.approx(1.4),
        5,
        sigma_freedom(2),
    )
    assert limits_of(individuals(values)).center > 20.0


@pytest.mark.parametrize(
    ("values", "baseline", "word"),
    [
        ([1.0, 2.0, 3.0], None, "at least 5"),
        ([1.0, 2.0, 1.0, 2.0, 1.0, 2.0], 7, "6 were measured"),
        ([4.0] * 9, None, "all values of the baseline are the same"),
        ([1.0, np.nan] * 6, None, "follow each other"),
        ([np.nan] * 8, None, "not 0"),
    ],
)
def test_what_carries_no_chart_is_refused(values, baseline, word):
    with pytest.raises(UsageError, match=word):
        limits_of(individuals(np.array(values)), baseline)


def test_given_limits_are_taken_as_they_are(rng):
    settings = Settings(center=10.0, sigma=2.0)
    limits = control_study("x", individuals(rng.normal(size=9)), settings).limits
    assert (limits.lower, limits.upper, limits.baseline) == (4.0, 16.0, 0)
    assert limits.range_center == pytest.approx(2.0 * 1.12838, abs=1e-4)
    with pytest.raises(UsageError, match="sigma above 0"):
        given_limits(0.0, 0.0)


def test_freedom_of_mean_moving_ranges_is_what_simulation_finds(rng):
    """The relative variance of sigma from moving ranges, over 20 000 series of 25."""
    ranges = np.abs(np.diff(rng.normal(size=(20_000, 25)), axis=1)).mean(axis=1)
    relative = ranges.var() / ranges.mean() ** 2
    assert sigma_freedom(24) == pytest.approx(1.0 / (2.0 * relative), rel=0.05)
    assert sigma_freedom(100_000) / 100_000 == pytest.approx(0.605, abs=0.001)
