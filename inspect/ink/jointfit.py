"""The joint fit: α, ρ(λ) and c(λ) at once, from the logarithms of all readings.

ln f = ln(D(α, θh)/4) + ln ρ(λ) + c(λ)·x. For one α the rest is linear, wavelength by wavelength; what is left is a
search along α alone (variable projection: Golub and Pereyra 1973). Because the linear part does not depend on α, the
Gauss-Newton step of the projected residuals is exact in its Jacobian.

All wavelengths of one place share the errors of its angles and of its level, and α is what these shift. So u(α) is the
larger one of two: from the scatter of single readings, and from sums over places (Liang and Zeger 1986), which
hold whatever the readings of one place share.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.errors import UsageError
from anisoscope.ink.grid import Grid

FloatArray = npt.NDArray[np.float64]

ALPHA_RANGE = (0.005, 1.0)
_STARTS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
_REWEIGHTED = 2
_STEPS = 30
_CLOSE = 1e-8


@dataclass(frozen=True, eq=False)
class Solution:
    """Parameters and standard uncertainties, W wavelengths.

    Attributes:
        alpha: roughness.
        u_alpha: its standard uncertainty.
        log_rho: (W,) ln ρ, BRDF scale.
        u_log_rho: (W,).
        c: (W,).
        u_c: (W,).
        residual: (G, W) ln measured − ln fitted, NaN where there is no reading.
    """

    alpha: float
    u_alpha: float
    log_rho: FloatArray
    u_log_rho: FloatArray
    c: FloatArray
    u_c: FloatArray
    residual: FloatArray


def log_lobe(alpha: float, half_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(G,) ln(D/4) of Eq. 3 at half angles, and its derivative by ln α."""
    sine, cosine = np.sin(np.radians(half_deg)) ** 2, np.cos(np.radians(half_deg)) ** 2
    square = alpha**2
    total = square * cosine + sine
    value = np.log(square / (4.0 * np.pi)) - 2.0 * np.log(total)
    return value, 2.0 - 4.0 * square * cosine / total


def _sum(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("gw,gw->w", one, other))


class _Projection:
    """Weighted least squares in (1, x) of every wavelength: (G, W) weights, 0 where there is no reading."""

    def __init__(self, x: FloatArray, weight: FloatArray) -> None:
        self.weight = weight
        self.total = weight.sum(axis=0)
        self.middle = (x @ weight) / self.total
        self.x = x[:, None] - self.middle
        self.spread = _sum(weight * self.x, self.x)

    def __call__(self, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Value at x = 0, slope, and residuals of (G, W) values."""
        weighted = self.weight * y
        mean = weighted.sum(axis=0) / self.total
        slope = _sum(weighted, self.x) / self.spread
        return mean - slope * self.middle, slope, y - mean - slope * self.x


def solve_jointly(grid: Grid, noise: float) -> Solution:
    """Fit all readings of a grid.

    Args:
        grid: the readings.
        noise: relative standard deviation of a reading, beside the floor of the grid; it weighs, the uncertainties come
            from the scatter about the fit.

    Raises:
        UsageError: readings that do not tell ρ from c, or do not say how wide the lobe is.
    """
    given = np.isfinite(grid.value)
    measured = np.where(given, grid.value, 1.0)
    level, alpha = measured, np.nan
    projection, base = _projection(grid, given, noise, level)
    for _ in range(_REWEIGHTED):
        alpha = _search(grid, projection, base, alpha)
        log_rho, c, _ = projection(base - log_lobe(alpha, grid.half_deg)[0][:, None])
        level = np.exp(log_lobe(alpha, grid.half_deg)[0][:, None] + log_rho + c * grid.x[:, None])
        projection, base = _projection(grid, given, noise, level)
    return _finish(grid, given, projection, base, _search(grid, projection, base, alpha))


def _projection(
    grid: Grid, given: npt.NDArray[np.bool_], noise: float, level: FloatArray
) -> tuple[_Projection, FloatArray]:
    """Weights for the level of the fit, and logarithms of the readings."""
    variance = noise**2 + (grid.floor / level) ** 2
    projection = _Projection(grid.x, np.where(given, 1.0 / variance, 0.0))
    if np.any(projection.spread <= 1e-9 * projection.total):
        at = int(np.argmax(projection.spread <= 1e-9 * projection.total))
        raise UsageError(
            f"at {grid.nm[at]:g} nm all readings have the same sum of angles, which does not tell rho from c: "
            "measure at several angles of the light"
        )
    return projection, np.log(np.where(given, grid.value, 1.0))


def _cost(grid: Grid, projection: _Projection, base: FloatArray, alpha: float) -> tuple[float, float, float]:
    """Weighted sum of squares at an α, its Gauss-Newton step in ln α, and the curvature."""
    lobe, slope = log_lobe(alpha, grid.half_deg)
    rest = projection(base - lobe[:, None])[2]
    along = projection(np.broadcast_to(slope[:, None], base.shape))[2]
    weighted = projection.weight * along
    curvature, pull = float(np.vdot(weighted, along)), float(np.vdot(weighted, rest))
    return float(np.vdot(projection.weight * rest, rest)), pull / max(curvature, 1e-30), curvature


def _search(grid: Grid, projection: _Projection, base: FloatArray, start: float) -> float:
    alpha = start
    if not np.isfinite(start):
        alpha = min(_STARTS, key=lambda one: _cost(grid, projection, base, float(one))[0])
    cost, step, curvature = _cost(grid, projection, base, alpha)
    if curvature <= 1e-6 * float(projection.weight.sum()):
        raise UsageError(
            "the readings do not say how wide the lobe is: measure beside the mirror direction as well as in it"
        )
    for _ in range(_STEPS):
        step = float(np.clip(step, -0.5, 0.5))
        trial = float(np.clip(alpha * np.exp(step), *ALPHA_RANGE))
        found = _cost(grid, projection, base, trial)
        if found[0] <= cost:
            alpha, (cost, step, _) = trial, found
        else:
            step *= 0.5
        if abs(step) < _CLOSE:
            break
    return float(alpha)


def _finish(
    grid: Grid, given: npt.NDArray[np.bool_], projection: _Projection, base: FloatArray, alpha: float
) -> Solution:
    lobe, slope = log_lobe(alpha, grid.half_deg)
    log_rho, c, rest = projection(base - lobe[:, None])
    at_zero, turn, along = projection(np.broadcast_to(slope[:, None], base.shape))
    cost, _, curvature = _cost(grid, projection, base, alpha)
    freedom = int(given.sum()) - 2 * len(grid.nm) - 1
    if freedom < 1:
        raise UsageError(
            f"{int(given.sum())} readings for {2 * len(grid.nm) + 1} parameters: measure at more angles"
        )
    scatter = cost / freedom
    score = np.sum(projection.weight * along * rest, axis=1)
    shared = float(score @ score) * len(score) / (len(score) - 1) / curvature**2
    from_alpha = max(scatter / curvature, shared)
    u_slope = scatter / projection.spread
    u_start = scatter / projection.total + projection.middle**2 * u_slope
    return Solution(
        alpha,
        alpha * float(np.sqrt(from_alpha)),
        log_rho,
        np.sqrt(u_start + at_zero**2 * from_alpha),
        c,
        np.sqrt(u_slope + turn**2 * from_alpha),
        np.where(given, rest, np.nan),
    )
