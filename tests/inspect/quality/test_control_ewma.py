"""EWMA: the NIST example, Montgomery's with its exact limits, and closed forms."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.quality.control import ewma


def test_nist_example(published):
    """e-Handbook 6.3.2.4: averages as printed, limits of the long run 52.5884 and 47.4115, nothing outside."""
    found = ewma(published.nist_ewma_values, 50.0, 2.0539, 0.3)
    np.testing.assert_allclose(found.values, published.nist_ewma, atol=0.0051)
    assert found.upper[-1] == pytest.approx(52.5884, abs=5e-4)
    assert found.lower[-1] == pytest.approx(47.4115, abs=5e-4)
    assert not found.outside.any()


def test_montgomery_example_with_exact_limits(published):
    """Introduction to Statistical Quality Control, table 9.10: lambda 0.1, L 2.7; the last two are out."""
    found = ewma(published.montgomery_shift, 10.0, 1.0, 0.1, 2.7)
    assert found.values[:2] == pytest.approx([9.945, 9.7495])
    assert found.values[-3:] == pytest.approx([10.5731, 10.6468, 10.6341], abs=5e-5)
    assert found.upper[:2] == pytest.approx([10.27, 10.36], abs=0.005)
    assert found.upper[-1] == pytest.approx(10.62, abs=0.005)
    assert found.lower[-1] == pytest.approx(9.38, abs=0.005)
    assert np.flatnonzero(found.outside).tolist() == [28, 29]


def test_weight_one_is_the_chart_of_the_values(rng):
    values = rng.normal(size=50)
    found = ewma(values, 0.0, 1.0, 1.0)
    np.testing.assert_allclose(found.values, values, atol=1e-12)
    np.testing.assert_array_equal(found.upper, 3.0)


def test_the_average_stands_still_where_nothing_is_measured():
    whole = ewma(np.array([1.0, 2.0, 3.0]), 0.0, 1.0)
    gappy = ewma(np.array([1.0, np.nan, 2.0, np.nan, 3.0]), 0.0, 1.0)
    np.testing.assert_array_equal(gappy.values, np.insert(whole.values, [1, 2], np.nan))
    np.testing.assert_array_equal(gappy.upper[[0, 2, 4]], whole.upper)


def test_limits_are_those_of_simulated_averages(rng):
    values = rng.normal(size=(8000, 6))
    averages = np.array([ewma(row, 0.0, 1.0, 0.3).values for row in values])
    np.testing.assert_allclose(averages.std(axis=0) * 3.0, ewma(values[0], 0.0, 1.0, 0.3).upper, rtol=0.03)


@pytest.mark.parametrize(
    ("weight", "width", "word"), [(0.0, 3.0, "lambda"), (1.2, 3.0, "lambda"), (0.2, 0.0, "L")]
)
def test_settings_without_sense_are_refused(weight, width, word):
    with pytest.raises(UsageError, match=word):
        ewma(np.arange(9.0), 0.0, 1.0, weight, width)


def test_limits_of_points_of_unequal_scatter_are_those_of_simulated_averages(rng):
    sigma = np.array([1.0, 0.5, 2.0, 0.3, 1.0])
    values = sigma * rng.normal(size=(8000, 5))
    averages = np.array([ewma(row, 0.0, sigma, 0.3).values for row in values])
    np.testing.assert_allclose(averages.std(axis=0) * 3.0, ewma(values[0], 0.0, sigma, 0.3).upper, rtol=0.03)
