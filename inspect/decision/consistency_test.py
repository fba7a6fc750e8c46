"""Is a part as predicted, or as the golden parts are? Squared distance, degrees of freedom and p value.

Both take into account that ln L bends with the inputs that all poses share (`response`; or as the model itself
says, `states`): the distance from the prediction is that from the nearest state of the inputs, and what T² of
good parts exceeds how often is found by drawing golden sets and parts from the stated uncertainties instead of from a
normal distribution.
"""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.significance import hotelling, log_basis, mahalanobis
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.prediction.expectation import Component, Expectation
from anisoscope.prediction.profile_likelihood import Combined, nearest, nearest_anywhere
from anisoscope.prediction.second_order import Response

DRAWS = 10000
LEVELS = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0])
_SEED = 11
_BLOCK = 1000
_SINGULAR = 1e-9


def from_prediction(expected: Expectation, measured: Measured) -> tuple[float, int, float]:
    """D² of all contrasts together, how many there are, and the chance of more for a part as predicted.

    Raises:
        MeasurementError: nothing is uncertain, so that nothing can be weighed.
    """
    from scipy.stats import chi2  # noqa: PLC0415 - 1 s

    basis = log_basis(len(expected.poses))
    off = basis @ np.log(measured.radiance / expected.radiance)
    if expected.states is not None:
        own = _covariance(expected.outside_states + measured.components, basis)
        if _regular(own):
            d2 = nearest_anywhere(Combined(expected.states, basis), off, own, expected.states.farthest)
            return d2, len(basis), float(chi2.sf(d2, len(basis)))
    alone = own_covariance(expected, measured)
    if expected.response is not None and _regular(alone):
        d2 = float(nearest(expected.response.within(basis), off[None], alone[None])[0])
        return d2, len(basis), float(chi2.sf(d2, len(basis)))
    d2, dof = mahalanobis(off, _covariance(expected.components + measured.components, basis))
    return d2, dof, float(chi2.sf(d2, dof))


def from_golden(expected: Expectation, measured: Measured, golden: FloatArray) -> tuple[float, int, float]:
    """T² from the mean of golden parts, how many contrasts there are, and the chance of more for a good part.

    Args:
        expected: the prediction; it tells how good parts scatter beyond the normal distribution, not where they lie.
        measured: the part.
        golden: (n, P − 1) contrasts of the golden parts in the basis of `log_basis`.

    Raises:
        MeasurementError: too few golden parts, or they do not vary in every direction.
    """
    basis = log_basis(len(expected.poses))
    t2, normal = hotelling(basis @ np.log(measured.radiance), golden)
    alone = own_covariance(expected, measured)
    if expected.response is None or not _regular(alone):
        return t2, len(basis), normal
    drawn = golden_chances(expected.response.within(basis), alone, len(golden))
    return t2, len(basis), float(calibrated(np.array([normal]), drawn)[0])


def own_covariance(expected: Expectation, measured: Measured) -> FloatArray:
    """(P − 1, P − 1) covariance of the contrasts of what the response does not hold."""
    return _covariance(expected.alone + measured.components, log_basis(len(expected.poses)))


def _covariance(components: tuple[Component, ...], basis: FloatArray) -> FloatArray:
    total = np.zeros((basis.shape[1], basis.shape[1]))
    for component in components:
        total += component.covariance()
    return np.asarray(basis @ total @ basis.T)


def _regular(covariance: FloatArray) -> bool:
    values = np.linalg.eigvalsh(covariance)
    return bool(values[0] > _SINGULAR * values[-1])


def golden_chances(response: Response, covariance: FloatArray, count: int) -> FloatArray:
    """P values of T² that good parts would get by the normal theory, drawn from the stated uncertainties.

    Args:
        response: of the m contrasts.
        covariance: (m, m) of what every contrast has for itself.
        count: golden parts in a set, more than m.

    Returns:
        (DRAWS,) p values, ascending; uniform where the response is straight.
    """
    from scipy.stats import f  # noqa: PLC0415 - 1 s

    rng = np.random.default_rng(_SEED)
    pool, parts = (response.draw(covariance, DRAWS, rng) for _ in range(2))
    m = covariance.shape[0]
    t2 = np.empty(DRAWS)
    for start in range(0, DRAWS, _BLOCK):
        block = slice(start, start + _BLOCK)
        golden = pool[rng.integers(0, DRAWS, (len(parts[block]), count))]
        mean = golden.mean(axis=1)
        inner = golden - mean[:, None]
        scatter = inner.transpose(0, 2, 1) @ inner / (count - 1.0)
        off = parts[block] - mean
        t2[block] = np.einsum("ni,ni->n", off, np.linalg.solve(scatter, off[..., None])[..., 0])
    t2 *= count / (count + 1.0)
    return np.sort(f.sf(t2 * (count - m) / (m * (count - 1.0)), m, count - m))


def calibrated(p_values: FloatArray, drawn: FloatArray) -> FloatArray:
    """How often good parts get p values as small as these.

    Between and below the levels at which the drawn ones are counted ln p goes on as a straight line of ln p.

    Args:
        p_values: p values by the normal theory.
        drawn: those of drawn good parts, ascending.
    """
    at = np.append(np.quantile(drawn, LEVELS[:-1]), 1.0)
    small = np.log(np.maximum(p_values, 1e-300))
    found = np.interp(small, np.log(at), np.log(LEVELS))
    low, high = 0, int(np.flatnonzero(LEVELS == 0.1)[0])
    slope = np.log(LEVELS[high] / LEVELS[low]) / np.log(at[high] / at[low])
    beyond = np.log(LEVELS[low]) + slope * (small - np.log(at[low]))
    return np.asarray(np.exp(np.where(p_values < at[low], beyond, found)))
