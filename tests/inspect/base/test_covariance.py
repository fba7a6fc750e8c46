"""Roots of covariances: unique whatever eigenvectors a library picks, continuous where they are not."""

import numpy as np
import pytest

from anisoscope.base.covariance import ROUNDING, positive_part, principal, rank, root, signed, whitening
from anisoscope.base.errors import MeasurementError

LOOP = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0], [-1.0, 0.0, 1.0]])
"""Differences around a closed loop add up to zero; their two eigenvalues are equal."""


@pytest.fixture
def other_eigenvectors(monkeypatch):
    """A kernel with other signs, and with another basis where eigenvalues are equal."""
    own = np.linalg.eigh

    def turned(matrix):
        values, vectors = own(matrix)
        vectors = -vectors
        for k in range(matrix.shape[-1] - 1):
            if np.allclose(values[k], values[k + 1], rtol=1e-9, atol=1e-12):
                c, s = np.cos(0.7), np.sin(0.7)
                vectors[:, k : k + 2] = vectors[:, k : k + 2] @ np.array([[c, -s], [s, c]])
        return values, vectors

    def install():
        monkeypatch.setattr(np.linalg, "eigh", turned)

    return install


@pytest.mark.parametrize("covariance", [LOOP @ LOOP.T, np.diag([1.0, 1.0, 4.0]), np.ones((4, 4))])
def test_no_number_depends_on_the_eigenvectors_that_a_library_picks(other_eigenvectors, covariance):
    found = root(covariance), whitening(covariance)
    other_eigenvectors()
    for before, now in zip(found, (root(covariance), whitening(covariance)), strict=True):
        np.testing.assert_allclose(now, before, atol=1e-12)
    half, weight = found
    np.testing.assert_allclose(half @ half, covariance, atol=1e-12)
    np.testing.assert_allclose(weight @ covariance @ weight, weight @ half, atol=1e-12)  # the projector


def test_draws_have_the_covariance(rng):
    """Sixty thousand draws: the standard deviation of a variance is 0.6 % of it."""
    covariance = LOOP @ LOOP.T
    drawn = rng.standard_normal((60_000, 3)) @ root(covariance)
    np.testing.assert_allclose(np.cov(drawn, rowvar=False), covariance, atol=0.04)
    assert np.abs(drawn.sum(axis=1)).max() < 1e-12  # what has no variance is not drawn


def test_a_root_does_not_know_the_order_of_the_values(rng):
    half = rng.normal(size=(5, 3))
    covariance, order = half @ half.T, rng.permutation(5)
    there = root(covariance[np.ix_(order, order)])
    np.testing.assert_allclose(there, root(covariance)[np.ix_(order, order)], atol=1e-12)


def test_a_root_is_continuous_where_eigenvalues_meet_and_vanish():
    for small in (1e-9, 1e-15):
        near = root(np.diag([1.0, 1.0 + small, small]) + small * np.ones((3, 3)))
        np.testing.assert_allclose(near, np.diag([1.0, 1.0, 0.0]), atol=2.0 * np.sqrt(small))
    assert np.all(root(np.diag([1.0, 1e-16])) == np.diag([1.0, 0.0]))  # rounding is no variance


def test_distances_are_within_the_range_of_the_covariance():
    covariance = LOOP @ LOOP.T
    assert rank(covariance) == 2
    off = LOOP @ np.array([0.3, -0.1, 0.5])
    expected = off @ np.linalg.pinv(covariance, rcond=1e-9) @ off
    assert np.sum((whitening(covariance) @ off) ** 2) == pytest.approx(expected)
    assert rank(np.zeros((2, 2))) == 0
    assert np.all(whitening(np.zeros((2, 2))) == 0.0)


def test_many_covariances_have_their_roots_at_once_and_can_be_made_regular():
    stack = np.stack([np.eye(3), 4.0 * np.eye(3), np.diag([0.0, 1.0, 9.0])])
    found = root(stack, least=ROUNDING)
    np.testing.assert_allclose(found[1], 2.0 * np.eye(3))
    np.testing.assert_allclose(np.diag(found[2]), [3e-6, 1.0, 3.0])
    np.testing.assert_allclose(root(stack)[2], np.diag([0.0, 1.0, 3.0]), atol=1e-15)


def test_what_rounding_leaves_is_clipped_and_what_is_no_covariance_is_refused():
    np.testing.assert_allclose(root(np.diag([1.0, -1e-9])), np.diag([1.0, 0.0]))
    for function in (root, whitening, rank):
        with pytest.raises(MeasurementError, match="negative eigenvalue"):
            function(np.array([[1.0, 2.0], [2.0, 1.0]]))
    np.testing.assert_allclose(positive_part(np.array([[1.0, 2.0], [2.0, 1.0]])), np.full((2, 2), 1.5))


def test_principal_directions_have_one_sign(other_eigenvectors):
    matrix = np.array([[2.0, -1.0, 0.0], [-1.0, 3.0, 0.5], [0.0, 0.5, 1.0]])
    values, rows = principal(matrix)
    np.testing.assert_allclose((rows.T * values) @ rows, matrix, atol=1e-12)
    assert np.all(rows[np.arange(3), np.abs(rows).argmax(axis=1)] > 0.0)
    other_eigenvectors()
    np.testing.assert_allclose(principal(matrix)[1], rows)
    even = np.array([-1.0, 1.0]) / np.sqrt(2.0)
    for rounding in (0.0, 1e-15, -1e-15):  # which of two equal components is larger, rounding decides
        assert np.all(signed(even + np.array([0.0, rounding])) * [1.0, -1.0] > 0.0)
