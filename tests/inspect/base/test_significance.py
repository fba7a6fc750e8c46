"""Distances, many tests at once, golden parts: against closed forms, references and simulated false alarms."""

import numpy as np
import pytest
from scipy.stats import chi2, f, multivariate_normal, norm

from anisoscope.base.errors import MeasurementError
from anisoscope.base.significance import (
    DOUBT,
    chi2_tail,
    f_tail,
    holm,
    joint_conformance,
    like_sample,
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


@pytest.mark.parametrize(("count", "values"), [(3, 9), (3, 2), (6, 5), (7, 5), (10, 9), (25, 9)])
def test_as_many_good_parts_are_unlike_golden_ones_as_the_level_says(count, values):
    """Of any number of golden parts from three on, at most, in the form that is stated or about so."""
    rng = np.random.default_rng(4)
    form = rng.normal(size=(values, values))
    scale = np.exp(DOUBT * rng.normal(size=(3000, 1, values)))
    parts = rng.normal(size=(3000, count + 1, values)) @ form
    off = (rng.normal(size=(3000, count + 1, values)) * scale) @ form
    doubted = np.array([like_sample(one[0], one[1:], form.T @ form)[1] for one in off])
    found = np.array([like_sample(one[0], one[1:], form.T @ form)[1] for one in parts])
    assert np.isfinite(found).all()
    smaller = [like_sample(0.1 * one[0], 0.1 * one[1:], form.T @ form)[1] for one in parts[:300]]
    assert (smaller >= found[:300] - 1e-12).all()
    for level in (0.003, 0.01, 0.05, 0.5):
        spread = 4.5 * np.sqrt(level * (1 - level) / 3000)
        assert np.mean(doubted < level) <= level + spread
        assert np.mean(found < level) <= level + spread
        assert np.mean(found < level) >= 0.4 * level - spread


@pytest.mark.parametrize(("count", "most"), [(3, 0.03), (10, 0.02), (25, 0.02)])
def test_a_scatter_of_another_form_than_stated_costs_little(count, most):
    """Only one value of nine varies as it should, the others a tenth of it, as where all but the seat is steady."""
    rng = np.random.default_rng(5)
    parts = rng.normal(size=(2000, count + 1, 9)) * np.array([1.0, *[0.1] * 8])
    found = [like_sample(one[0], one[1:], np.eye(9))[1] for one in parts]
    assert np.mean(np.array(found) < 0.01) <= most


def test_good_parts_with_long_tails_are_drawn_as_they_are():
    """Of squares of normal values T² is far more often large than of normal ones; its own distribution counts."""
    rng, n = np.random.default_rng(8), 10
    parts = rng.normal(size=(20000, n + 1, 2)) ** 4
    form = np.cov(parts.reshape(-1, 2).T)
    off = parts[:, 1:] - parts[:, 1:].mean(axis=1, keepdims=True)
    size = np.einsum("rni,ij,rnj->r", off, np.linalg.inv(form), off)
    own = 2.0 * (0.5 + size)[:, None, None] / (0.5 + 2.0 * (n - 1)) * form
    scatter = (own + np.swapaxes(off, 1, 2) @ off) / (n + 1.0) * (1.0 + 1.0 / n)
    away = parts[:, 0] - parts[:, 1:].mean(axis=1)
    t2 = np.einsum("ri,ri->r", away, np.linalg.solve(scatter, away[..., None])[..., 0])
    pool = rng.normal(size=(16, 128, 2)) ** 4
    for level in (0.1, 0.02):
        part = int(np.argsort(-t2)[int(level * len(t2))])
        (found, p_value), normal = (
            like_sample(parts[part, 0], parts[part, 1:], form, alike) for alike in (pool, None)
        )
        assert found == pytest.approx(t2[part])
        assert p_value == pytest.approx(level, rel=0.3)
        assert normal[1] < 0.7 * p_value
    for count in (3, 4, 25, 200):  # of a rig 128 good parts are simulated
        some = pool.reshape(-1, 2)[:count]
        assert 0.0 < like_sample(pool[-1, -1], some, form, pool)[1] <= 1.0


def test_many_golden_parts_tell_the_form_themselves():
    """500 parts of another form than stated: T² is that of their own covariance."""
    rng = np.random.default_rng(6)
    form = np.diag([1.0, 2.0, 0.5])
    parts, new = rng.normal(size=(500, 3)) @ form, np.diag(form)
    t2, p_value = like_sample(new, parts, np.eye(3))
    assert t2 == pytest.approx(3.0, rel=0.2)
    assert p_value == pytest.approx(chi2.sf(3.0, 3), abs=0.08)


def test_too_few_golden_parts_and_an_unstated_scatter_are_refused():
    with pytest.raises(MeasurementError, match="at least 3 do"):
        like_sample(np.zeros(3), np.zeros((2, 3)), np.eye(3))
    with pytest.raises(MeasurementError, match="without any uncertainty"):
        like_sample(np.zeros(2), np.ones((5, 2)), np.diag([1.0, 0.0]))


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
