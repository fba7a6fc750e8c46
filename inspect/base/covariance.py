"""Roots of covariances that every processor computes alike, for draws, distances and principal directions.

Eigenvectors are determined up to their signs only, and where eigenvalues are equal up to a basis of their space; which
ones a library returns depends on its kernel, which it picks by the processor. Numbers must not depend on them:

- Draws and distances take the symmetric root R = Σ √λ v vᵀ of V = Σ λ v vᵀ. It holds eigenvectors as projectors only,
  so that it is unique; it is continuous in V, also where eigenvalues are equal or zero (N. J. Higham, Functions of
  Matrices, 2008, 1.7 and 6.2); and when the order of the values changes, its rows and columns change alike. The factor
  of Cholesky has none of this where V is singular, as covariances of contrasts often are, without adding variance that
  nobody stated.
- Directions that are results themselves have the sign that makes their largest component positive.

Next to zero a root magnifies rounding: √1e-16 is 1e-8. Eigenvalues below `ROUNDING` of the largest are zero.

The values of one matrix have one unit, or units in which they are of comparable size: tolerances are shares of the
largest eigenvalue.
"""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError

ROUNDING = 1e-12
"""Share of the largest eigenvalue below which one is zero: some thousand roundings of the sums that it came from."""
NEGATIVE = 1e-6
"""The same of a negative one that is taken for zero: a covariance from a file has the digits of the file only."""
_AS_LARGE = 1.0 - 1e-6  # components that are equal but for rounding: the first one has the sign


def root(covariance: FloatArray, *, least: float = 0.0) -> FloatArray:
    """Symmetric R with R·R = V; N draws are their standard normal numbers (N, n) times R.

    Args:
        covariance: (…, n, n) V.
        least: share of the largest eigenvalue that those have which are zero; with `ROUNDING` R can be inverted.

    Returns:
        (…, n, n) R.

    Raises:
        MeasurementError: V is no covariance, as it has a negative eigenvalue.
    """
    values, vectors = _spectrum(covariance)
    return _rebuilt(np.sqrt(np.maximum(values, least * values[..., -1:])), vectors)


def whitening(covariance: FloatArray) -> FloatArray:
    """The symmetric W with W·W = V⁺, of (…, n, n) V: |W d|² is the squared distance of d within the range of V.

    Raises:
        MeasurementError: V is no covariance, as it has a negative eigenvalue.
    """
    values, vectors = _spectrum(covariance)
    known = np.where(values > 0.0, values, 1.0)
    return _rebuilt(np.where(values > 0.0, 1.0 / np.sqrt(known), 0.0), vectors)


def rank(covariance: FloatArray) -> int:
    """Number of eigenvalues of an (n, n) covariance that are not zero; arguments and errors as of `root`."""
    return int(np.count_nonzero(_spectrum(covariance)[0]))


def positive_part(symmetric: FloatArray) -> FloatArray:
    """(n, n) covariance nearest to a symmetric matrix: a difference of covariances that were estimated may be none.

    In the Frobenius norm (N. J. Higham, Linear Algebra Appl. 103 (1988) 103).
    """
    values, vectors = np.linalg.eigh(symmetric)
    return _rebuilt(np.maximum(values, 0.0), vectors)


def principal(symmetric: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) eigenvalues, ascending, and (n, n) principal directions, one a row, with signs by `signed`."""
    values, vectors = np.linalg.eigh(symmetric)
    return values, signed(vectors.T)


def signed(directions: FloatArray) -> FloatArray:
    """Directions (…, n) with their largest component positive; the first one of components that are equally large."""
    size = np.abs(directions)
    first = np.argmax(size >= _AS_LARGE * size.max(axis=-1, keepdims=True), axis=-1)
    leading = np.take_along_axis(directions, first[..., None], axis=-1)
    return np.where(leading < 0.0, -directions, directions)


def _spectrum(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    values, vectors = np.linalg.eigh(covariance)
    largest = np.maximum(values[..., -1:], 0.0)
    if np.any(values[..., :1] < -NEGATIVE * largest):
        raise MeasurementError(
            "uncertainties contradict each other: their covariance has a negative eigenvalue; check the covariances "
            "and correlations that were stated"
        )
    return np.where(values > ROUNDING * largest, values, 0.0), vectors


def _rebuilt(values: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray((vectors * values[..., None, :]) @ np.swapaxes(vectors, -1, -2))
