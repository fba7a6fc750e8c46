"""The two-step fit of Pranovich 2024, as published, to compare with: it is biased, also without noise.

Step 1: spectrum-averaged readings of each angle of the light are fitted by a GGX lobe of any height; α is the mean.
The rise of exp(c·x) across the lobe is taken for a part of its width. Step 2: ρ and c of every wavelength in the mirror
direction (Eq. 7), α held. Light at 70° is left out.
"""

import numpy as np
import numpy.typing as npt

from anisoscope.errors import UsageError
from anisoscope.ink.grid import Grid
from anisoscope.ink.jointfit import ALPHA_RANGE, Solution, log_lobe

FloatArray = npt.NDArray[np.float64]

SKIPPED_FROM_DEG = 70.0
_STEPS = 20


def solve_as_published(grid: Grid) -> Solution:
    """Fit a grid in two steps; uncertainties of ρ and c hold for the α found, and do not carry its own.

    Raises:
        UsageError: too few angles for one of the steps.
    """
    alphas = _lobe_widths(grid)
    alpha = float(np.mean(alphas))
    u_alpha = float(np.std(alphas, ddof=1) / np.sqrt(len(alphas))) if len(alphas) > 1 else float("nan")
    rho, c, u_log_rho, u_c = _mirror_spectra(grid, alpha)
    fitted = log_lobe(alpha, grid.half_deg)[0][:, None] + np.log(rho) + c * grid.x[:, None]
    return Solution(alpha, u_alpha, np.log(rho), u_log_rho, c, u_c, np.log(grid.value) - fitted)


def _lobe_widths(grid: Grid) -> FloatArray:
    """One α for each angle of the light with three readings or more."""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - loads slowly

    widths = []
    for angle in np.unique(grid.theta_i_deg):
        chosen = grid.theta_i_deg == angle
        mean, half = np.nanmean(grid.value[chosen], axis=1), grid.half_deg[chosen]
        if len(mean) < 3:
            continue

        def misfit(log_alpha: float, mean: FloatArray = mean, half: FloatArray = half) -> float:
            shape = np.exp(log_lobe(float(np.exp(log_alpha)), half)[0])
            height = float(shape @ mean / (shape @ shape))
            return float(np.sum((mean - height * shape) ** 2))

        starts = np.linspace(np.log(ALPHA_RANGE[0]), np.log(ALPHA_RANGE[1]), 40)
        best = int(np.argmin([misfit(float(one)) for one in starts]))
        bounds = float(starts[max(best - 1, 0)]), float(starts[min(best + 1, len(starts) - 1)])
        widths.append(float(np.exp(minimize_scalar(misfit, bounds=bounds, method="bounded").x)))
    if not widths:
        raise UsageError(
            "no angle of the light has three readings: the published fit needs some beside the mirror direction"
        )
    return np.array(widths)


def _mirror_spectra(grid: Grid, alpha: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(W,) ρ, c, u(ln ρ), u(c) by least squares of the readings in the mirror direction."""
    value = grid.value[grid.mirror]
    given = np.isfinite(value)
    angles = np.round(grid.theta_i_deg[grid.mirror], 2)
    if min(len(np.unique(angles[column])) for column in given.T) < 3:
        raise UsageError(
            "the published fit needs readings in the mirror direction (θo = θi) at three angles or more"
        )
    x = np.where(given, grid.x[grid.mirror][:, None], 0.0)
    value = np.where(given, value, 0.0)
    rows = given.astype(np.float64)
    logs = np.log(np.where(given, value, 1.0))
    slope = _slope(x, logs, rows)
    height = (logs * rows).sum(axis=0) / rows.sum(axis=0) - slope * (x * rows).sum(axis=0) / rows.sum(axis=0)
    a = b = d = inverse = np.ones_like(height)
    for _ in range(_STEPS):
        fitted = rows * np.exp(height + slope * x)
        a, b, d = (fitted**2).sum(axis=0), (fitted**2 * x).sum(axis=0), (fitted**2 * x**2).sum(axis=0)
        p, q = (fitted * (value - fitted)).sum(axis=0), (fitted * x * (value - fitted)).sum(axis=0)
        inverse = 1.0 / (a * d - b * b)
        height, slope = height + (d * p - b * q) * inverse, slope + (a * q - b * p) * inverse
    freedom = np.maximum(rows.sum(axis=0) - 2.0, 1.0)
    scatter = ((value - rows * np.exp(height + slope * x)) ** 2).sum(axis=0) / freedom
    rho = 4.0 * np.pi * alpha**2 * np.exp(height)
    return rho, slope, np.sqrt(scatter * d * inverse), np.sqrt(scatter * a * inverse)


def _slope(x: FloatArray, y: FloatArray, rows: FloatArray) -> FloatArray:
    count = rows.sum(axis=0)
    centred = (x - (x * rows).sum(axis=0) / count) * rows
    return np.asarray((centred * y).sum(axis=0) / (centred**2).sum(axis=0))
