"""Distances, many tests at once, golden parts: against closed forms, references and simulated false alarms."""

import numpy as np
import pytest
from scipy.stats import chi2, f, multivariate_normal, norm

from anisoscope.base.errors import MeasurementError
from anisoscope.base.significance import (
    chi2_tail,
    f_tail,
    holm,
    hotelling,
    joint_conformance,
    log_basis,
    mahalanobis,
    two_sided,
)


def test_distance_and_rank():
    deviation = np.array([0.1, -0.2])
    full = np.array([[0.04, 0.01], [0.01, 0.02]])
    d2, rank = mahalanobis(deviation, full)
    assert (d2, rank) == (pytest.approx(deviation @ np.linalg.inv(full) @ deviation), 2)
    assert mahalanobis(np.array([0.3, 0.6]), np.outer([1.0, 2.0], [1.0, 2.0])) == (pytest.approx(0.09), 1)
    with pytest.raises(MeasurementError, match="no source of uncertainty"):
        mahalanobis(deviation, np.zeros((2, 2)))


def test_the_basis_takes_the_scale_out():
    basis = log_basis(4)
    assert basis.shape == (3, 4)
    np.testing.assert_allclose(basis @ np.full(4, 0.7), 0.0)
    assert np.linalg.matrix_rank(basis) == 3


def test_the_limit_of_t2_for_six_contrasts_and_25_parts():
    """The 1 % limit of T² for a 26th part, p = 6, n = 25, against 16.8 of χ²: the scatter is itself uncertain."""
    p, n = 6, 25
    limit = (n + 1) / n * p * (n - 1) / (n - p) * f.isf(0.01, p, n - p)
    assert limit == pytest.approx(31.0, abs=0.1)
    assert chi2.isf(0.01, p) == pytest.approx(16.8, abs=0.05)


def test_golden_parts_give_as_many_false_alarms_as_stated():
    rng = np.random.default_rng(4)
    root = rng.normal(size=(3, 3))
    p_values = []
    for _ in range(3000):
        parts = rng.normal(size=(13, 3)) @ root.T
        p_values.append(hotelling(parts[0], parts[1:])[1])
    for level in (0.01, 0.05, 0.5):
        spread = np.sqrt(level * (1 - level) / 3000)
        assert np.mean(np.array(p_values) < level) == pytest.approx(level, abs=4 * spread)


def test_one_contrast_with_golden_parts_is_students_t():
    rng = np.random.default_rng(1)
    parts, new = rng.normal(size=(9, 1)), np.array([2.5])
    t = (new[0] - parts.mean()) / (parts.std(ddof=1) * np.sqrt(1 + 1 / 9))
    t2, p_value = hotelling(new, parts)
    assert t2 == pytest.approx(t**2)
    from scipy.stats import t as student

    assert p_value == pytest.approx(2 * student.sf(abs(t), 8))


def test_too_few_or_too_equal_golden_parts_are_refused():
    with pytest.raises(MeasurementError, match="at least 4 are needed"):
        hotelling(np.zeros(3), np.zeros((3, 3)))
    with pytest.raises(MeasurementError, match="added twice"):
        hotelling(np.zeros(2), np.tile([1.0, 2.0], (9, 1)))


def test_holm_against_the_worked_steps():
    """Sorted .005, .01, .03, .04 times 4, 3, 2, 1, never falling."""
    np.testing.assert_allclose(holm(np.array([0.01, 0.04, 0.03, 0.005])), [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(holm(np.array([0.9, 0.8])), [1.0, 1.0])


def test_holm_keeps_the_level_over_all():
    rng = np.random.default_rng(3)
    p = rng.random((4000, 5))
    share = np.mean([holm(row).min() < 0.05 for row in p])
    assert share == pytest.approx(1 - 0.99**5, abs=0.012)


def test_two_sided_p_values():
    np.testing.assert_allclose(two_sided(np.array([0.0, 1.96, -2.5758])), [1.0, 0.05, 0.01], atol=1e-4)


def test_joint_conformance_of_independent_deviations_is_the_product():
    deviation, u, tolerance = np.array([0.1, -0.2]), np.array([0.1, 0.05]), np.array([0.25, 0.25])
    one = norm.cdf((tolerance - deviation) / u) - norm.cdf((-tolerance - deviation) / u)
    assert joint_conformance(deviation, np.diag(u**2), tolerance) == pytest.approx(one.prod(), abs=1e-4)


def test_joint_conformance_of_deviations_that_move_together():
    covariance = 0.01 * np.array([[1.0, 0.9], [0.9, 1.0]])
    deviation, tolerance = np.array([0.1, 0.15]), np.array([0.2, 0.2])
    draws = multivariate_normal(deviation, covariance).rvs(200_000, random_state=1)
    share = np.mean((np.abs(draws) <= tolerance).all(axis=1))
    assert joint_conformance(deviation, covariance, tolerance) == pytest.approx(share, abs=0.004)
    assert joint_conformance(deviation, np.zeros((2, 2)), tolerance) == 1.0


def test_tails_are_those_of_the_distributions():
    at = np.array([0.0, 0.3, 2.0, 30.0, 900.0])
    np.testing.assert_allclose(chi2_tail(at, 3), chi2.sf(at, 3), rtol=1e-12)
    np.testing.assert_allclose(f_tail(at, 2.0, 7.5), f.sf(at, 2.0, 7.5), rtol=1e-12)


@pytest.mark.parametrize("rho", [-0.999, -0.4, 0.0, 0.7, 0.999999])
@pytest.mark.parametrize("deviation", [(0.0, 0.0), (0.25, -0.1), (0.2, 0.25), (-0.6, 0.3)])
def test_two_contrasts_conform_as_the_integral_says(rho, deviation):
    """P = ∫ φ(z)·[Φ((b − ρz)/√(1 − ρ²)) − Φ((a − ρz)/√(1 − ρ²))] dz, by quadrature."""
    scale, tolerance = np.array([0.1, 0.2]), np.array([0.25, 0.25])
    found = joint_conformance(
        np.array(deviation), np.outer(scale, scale) * np.array([[1.0, rho], [rho, 1.0]]), tolerance
    )
    low, high = (-tolerance - deviation) / scale, (tolerance - deviation) / scale
    z = np.linspace(low[0], high[0], 400_001)
    root = np.sqrt(1.0 - rho * rho)
    inner = norm.cdf((high[1] - rho * z) / root) - norm.cdf((low[1] - rho * z) / root)
    assert found == pytest.approx(np.trapezoid(norm.pdf(z) * inner, z), abs=1e-7)
