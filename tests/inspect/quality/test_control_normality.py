"""Anderson-Darling: against scipy, the published critical values, and simulated levels."""

import numpy as np
import pytest
from scipy import stats

from anisoscope.quality.control import anderson_darling, p_value


def test_published_critical_values():
    """D'Agostino and Stephens (1986), table 4.7, case 3: 0.631, 0.752, 0.873, 1.035 at 10, 5, 2.5 and 1 %."""
    for adjusted, p in ((0.631, 0.10), (0.752, 0.05), (0.873, 0.025), (1.035, 0.01)):
        assert p_value(adjusted) == pytest.approx(p, rel=0.03)


def test_the_statistic_is_that_of_scipy(rng):
    values = rng.normal(3.0, 2.0, 200)
    expected = stats.anderson(values, "norm", method="interpolate").statistic
    assert anderson_darling(values).statistic == pytest.approx(expected, rel=1e-9)
    assert anderson_darling(np.append(values, np.nan)).count == 200


def test_normal_values_are_rejected_as_often_as_said_and_skewed_ones_mostly(rng):
    series = rng.normal(size=(3000, 30))
    rejected = np.mean([anderson_darling(row).p < 0.05 for row in series])
    assert rejected == pytest.approx(0.05, abs=0.013)
    assert np.mean([anderson_darling(np.exp(row)).p < 0.05 for row in series[:300]]) > 0.9


def test_the_probability_never_leaves_its_range_and_falls():
    p = np.array([p_value(a) for a in np.linspace(0.01, 40.0, 4000)])
    assert p.min() >= 0.0
    assert p.max() <= 1.0
    assert np.all(np.diff(p) < 1e-2)


def test_hints_say_what_to_do(rng):
    assert "nothing speaks against" in anderson_darling(rng.normal(size=50)).hint
    assert "look for shifts" in anderson_darling(rng.exponential(size=200)).hint
    assert "rounded" in anderson_darling(np.round(rng.normal(size=200))).hint
    assert "smallest departure" in anderson_darling(rng.exponential(size=6000)).hint


@pytest.mark.parametrize("values", [[1.0] * 20, [1.0, 2.0, 3.0], [np.nan] * 20])
def test_nothing_is_said_of_too_little(values):
    assert anderson_darling(np.array(values)) is None
