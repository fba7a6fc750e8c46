"""Roughness of the facets: Beckmann's α along and across the ridges, without the noise of the instrument."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.metrology.quantity import Quantity, jackknife
from anisoscope.profiles.metrology.ridgefold import Course
from anisoscope.profiles.metrology.ridgesums import noise_sums, structure_sums

CLIP = 4.0
KEPT_VARIANCE = 0.99893  # of a normal distribution, within ±4 standard deviations of it
THIRD = 400.0  # Σ of the squared coefficients of a third difference along both axes
LEAST_WINDOWS = 400
SAMPLED_ROWS = 60
MANY_POINTS = 500_000
LAGS = np.array([(0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0), (1, 2), (2, 1), (1, -2), (2, -1)])


@dataclass(frozen=True)
class Slopes:
    """Roughness and noise.

    Attributes:
        alpha_along: √2 times the standard deviation of the slope along the ridges.
        alpha_across: the same across them.
        noise_um: standard deviation of the white noise of the heights.
    """

    alpha_along: Quantity
    alpha_across: Quantity
    noise_um: Quantity


def _robust(values: FloatArray) -> float:
    known = np.abs(values[np.isfinite(values)])
    return 1.4826 * float(np.median(known)) if known.size else 0.0


def _first_limits(above: FloatArray, owner: npt.NDArray[np.int16]) -> tuple[FloatArray, float]:
    """Clipping limits of the differences at every lag and of the third difference, from a sample of rows."""
    rows = np.unique(np.linspace(0, above.shape[0] - 4, SAMPLED_ROWS).astype(np.intp))
    part = [np.where(owner[rows + k] >= 0, above[rows + k], np.nan) for k in range(4)]
    found = []
    for down, right in LAGS.tolist():
        ahead, start = part[down], part[0]
        if right >= 0:
            found.append(_robust(ahead[:, right:] - start[:, : start.shape[1] - right]))
        else:
            found.append(_robust(ahead[:, :right] - start[:, -right:]))
    third = part[3] - 3.0 * part[2] + 3.0 * part[1] - part[0]
    return CLIP * np.array(found), CLIP * _robust(np.diff(third, n=3, axis=1))


def _interpolation(pixel: tuple[float, float], directions: list[tuple[float, float]]) -> FloatArray:
    """(directions, lags) weights that turn differences at the lags into the variance of the slope over one pixel.

    Mean squared differences D(τ) of a smooth surface are, near 0, a quadratic and a quartic form of the lag. Both are
    fitted with weights τ⁻³, and read at the lag of one pixel in each direction (x, y); along x or y that is nearly
    the value measured there.
    """
    y, x = (LAGS * np.array(pixel)).T
    far = np.hypot(*(LAGS.T)) ** -3.0

    def forms(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.stack([x * x, x * y, y * y, x**4, x**3 * y, x * x * y * y, x * y**3, y**4], axis=-1)

    solve = np.linalg.pinv(forms(x, y) * far[:, None]) * far
    length = np.array([1.0 / np.hypot(ex / pixel[1], ey / pixel[0]) for ex, ey in directions])
    ex, ey = np.array(directions).T
    weights: FloatArray = (forms(ex * length, ey * length) @ solve) / length[:, None] ** 2
    return weights


def measure_slopes(
    above: FloatArray, owner: npt.NDArray[np.int16], pixel: tuple[float, float], course: Course, ridges: int
) -> Slopes:
    """Roughness of the facets from height differences over one or two pixels.

    The variance of a slope along u is D(u)/u² at a lag u of one pixel, D the mean squared height difference; for
    ridges that do not run along the grid D is interpolated. Differences beyond four standard deviations are left out.
    White noise of standard deviation σ adds 2σ² to every D. σ comes from the third difference along both axes
    of 4 × 4 points, whose variance is 400 σ²; a surface that is smooth over two or three pixels hardly adds to
    it. Uncertainties: leaving out one ridge after the other.

    Args:
        above: (rows, cols) heights over the planes of the facets in µm, NaN where missing or spoiled.
        owner: (rows, cols) ridge of every point, −1 off the facets.
        pixel: (y, x) in µm.
        course: how the ridges run.
        ridges: their number.
    """
    limit, third = _first_limits(above, owner)
    every = 2 if above.size > MANY_POINTS else 1
    total = structure_sums(above, owner, LAGS, limit, ridges, 8 * every).sum(axis=0)
    if total[:, 0].min() < LEAST_WINDOWS / 8:
        return Slopes(Quantity(None), Quantity(None), Quantity(None))
    better = CLIP * np.sqrt(total[:, 1] / total[:, 0] / KEPT_VARIANCE)
    structure = structure_sums(above, owner, LAGS, better, ridges, every)
    noise = noise_sums(above, owner, third, ridges)
    spare = noise.sum(axis=0)
    heard = bool(spare[0] >= LEAST_WINDOWS)
    if heard:
        better_third = CLIP * float(np.sqrt(spare[1] / spare[0] / KEPT_VARIANCE))
        noise = noise_sums(above, owner, better_third, ridges)
    points = structure[..., 0].sum(axis=1)
    used = (points > 0.02 * points.max()) & ((noise[:, 0] > 0) | (not heard))
    ex, ey = course.downhill()
    weights = _interpolation(pixel, [(-ey, ex), (ex, ey)])

    def variances(sums: FloatArray) -> FloatArray:
        own = sums[-1] / sums[-2] / KEPT_VARIANCE / THIRD if heard else 0.0
        pairs = sums[:-2].reshape(-1, 2)
        return np.append(weights @ (pairs[:, 1] / pairs[:, 0] / KEPT_VARIANCE - 2.0 * own), own)

    parts = np.concatenate([structure.reshape(ridges, -1), noise], axis=1)
    (along, across, own), u = jackknife(parts[used], variances, points[used])
    found = (
        Quantity(float(np.sqrt(own)), float(u[2] / (2.0 * np.sqrt(own)))) if own > 0 else Quantity(0.0, 0.0)
    )
    return Slopes(_alpha(along, u[0], heard), _alpha(across, u[1], heard), found if heard else Quantity(None))


def _alpha(variance: float, u: float, heard: bool) -> Quantity:
    """√(2·variance); a bound where the variance is not clear of 0, or still holds noise."""
    if not heard or variance <= 2.0 * u:
        return Quantity(None, at_most=float(np.sqrt(2.0 * (max(variance, 0.0) + 2.0 * u))))
    alpha = float(np.sqrt(2.0 * variance))
    return Quantity(alpha, float(u / alpha))
