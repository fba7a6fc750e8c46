"""Warm-up of a lamp: its brightness over time as an exponential approach plus a steady drift.

The brightness of a lamp changes quickly after switching on, then more slowly; the remainder is its drift. Contrasts
compare frames minutes apart, so that the drift per minute and its uncertainty are the relevant numbers.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError, UsageError

MIN_FRAMES = 8
ALLOWED_PER_MINUTE = 0.001
COVERAGE = 2.0
# The exponential must explain this much more of the scatter per parameter than chance does.
SIGNIFICANT_F = 8.0
TIME_CONSTANTS = 40


@dataclass(frozen=True)
class WarmUp:
    """Drift and noise of the lamp from a series of frames; shares are of its brightness at the end.

    Attributes:
        frames: number of frames.
        duration_s: time from the first to the last.
        change_share: change of the fit from the first frame to the last.
        change_uncertainty: its standard uncertainty.
        drift_per_minute: change of brightness per minute at the end of the series.
        drift_uncertainty: its standard uncertainty.
        steady_per_minute: the part of the drift that does not come from warming up.
        warmup_share: excess brightness of the cold lamp at the beginning; 0 if it is not significant.
        time_constant_s: time in which the warm-up fades to 1/e; None without a warm-up, or if the series is too short.
        noise_share: scatter of the single frames around the fit.
        allowed_per_minute: drift that counts as warm.
        wait_s: recommended further waiting; None if waiting does not help, because the drift is steady.
        verdict: ``warm``, ``cold``, or ``undecided`` (watch for longer).
    """

    frames: int
    duration_s: float
    change_share: float
    change_uncertainty: float
    drift_per_minute: float
    drift_uncertainty: float
    steady_per_minute: float
    warmup_share: float
    time_constant_s: float | None
    noise_share: float
    allowed_per_minute: float
    wait_s: float | None
    verdict: Literal["warm", "cold", "undecided"]

    def sentence(self) -> str:
        """One line for the operator."""
        drift = f"{100.0 * self.drift_per_minute:+.3f} % ± {100.0 * self.drift_uncertainty:.3f} % per minute"
        if self.verdict == "warm":
            return f"the lamp is warm: it changes by {drift}"
        if self.verdict == "undecided":
            return f"the lamp changes by {drift}; watch it for longer to know whether it is warm"
        if self.wait_s is None:
            return f"the lamp changes by {drift}, and does not settle; check its supply"
        return f"the lamp is not warm yet: it changes by {drift}; wait {self.wait_s / 60.0:.1f} min"


def fit_warmup(
    time_s: Sequence[float] | FloatArray,
    level: Sequence[float] | FloatArray,
    *,
    allowed_per_minute: float = ALLOWED_PER_MINUTE,
) -> WarmUp:
    """Judge a series of brightnesses.

    The model is L(t) = c + d·t + a·exp(−t/τ), fitted by least squares for every τ of a grid (the rest is linear); the
    exponential is kept if it is significant. Uncertainties come from the scatter around the fit.

    Args:
        time_s: times in seconds, rising.
        level: brightness at these times, without black level, in any unit.
        allowed_per_minute: drift that counts as warm, as a share per minute.

    Raises:
        UsageError: fewer than 8 frames, or times that do not rise.
        CalibrationError: the lamp is dark.
    """
    t, y = np.asarray(time_s, dtype=np.float64), np.asarray(level, dtype=np.float64)
    if t.ndim != 1 or t.shape != y.shape or len(t) < MIN_FRAMES:
        raise UsageError(f"a warm-up needs at least {MIN_FRAMES} frames with their times, not {len(t)}")
    if not (np.isfinite(t).all() and np.isfinite(y).all() and (np.diff(t) > 0.0).all()):
        raise UsageError("the times of a warm-up must rise, and its levels be numbers")
    t = t - t[0]
    if y.mean() <= 0.0:
        raise CalibrationError("the lamp is dark; switch it on and uncover the lens before watching it")
    fit = _best_fit(t, y)
    return _assessed(fit, t, allowed_per_minute)


@dataclass(frozen=True)
class _Fit:
    """c, d, a of the model, τ (None without exponential), the sum of squares and its degrees of freedom."""

    constant: float
    slope: float
    amplitude: float
    tau_s: float | None
    squares: float
    free: int

    def drift(self, at_s: float) -> float:
        """dL/dt."""
        if self.tau_s is None:
            return self.slope
        return self.slope - self.amplitude / self.tau_s * math.exp(-at_s / self.tau_s)

    def change(self, at_s: float) -> float:
        """L at a time, less that at the begin."""
        faded = 0.0 if self.tau_s is None else self.amplitude * (1.0 - math.exp(-at_s / self.tau_s))
        return self.slope * at_s - faded


def _design(t: FloatArray, tau_s: float | None) -> FloatArray:
    columns = [np.ones_like(t), t] + ([] if tau_s is None else [np.exp(-t / tau_s)])
    return np.stack(columns, axis=1)


def _solve(t: FloatArray, y: FloatArray, tau_s: float | None) -> _Fit:
    design = _design(t, tau_s)
    found = np.linalg.lstsq(design, y, rcond=None)[0]
    squares = float(np.sum((y - design @ found) ** 2))
    amplitude = float(found[2]) if tau_s is not None else 0.0
    free = max(1, len(t) - design.shape[1] - (tau_s is not None))
    return _Fit(float(found[0]), float(found[1]), amplitude, tau_s, squares, free)


def _best_fit(t: FloatArray, y: FloatArray) -> _Fit:
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - heavy

    line = _solve(t, y, None)
    # Beyond the length of the series an exponential cannot be told from a line.
    grid = np.geomspace(np.diff(t).min(), t[-1], TIME_CONSTANTS)
    squares = [_solve(t, y, float(tau)).squares for tau in grid]
    best = int(np.argmin(squares))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    tau = math.exp(
        minimize_scalar(
            lambda x: _solve(t, y, math.exp(x)).squares,
            bounds=(math.log(low), math.log(high)),
            method="bounded",
        ).x
    )
    curve = _solve(t, y, tau)
    gained = (line.squares - curve.squares) / 2.0
    noise = max(curve.squares / curve.free, (1e-12 * float(y.mean())) ** 2)
    return curve if gained / noise > SIGNIFICANT_F else line


def _uncertainty(fit: _Fit, t: FloatArray, gradient: list[float]) -> float:
    """Standard uncertainty of a quantity with a gradient by c, d, a and τ, from the Jacobian and the scatter."""
    design = _design(t, fit.tau_s)
    if fit.tau_s is not None:
        tau, a = fit.tau_s, fit.amplitude
        design = np.column_stack([design, a * t / tau**2 * np.exp(-t / tau)])
    scale = np.linalg.norm(design, axis=0)
    scale[scale == 0.0] = 1.0
    inverse = np.linalg.pinv(design / scale)
    return math.sqrt(fit.squares / fit.free) * float(np.linalg.norm(np.asarray(gradient) / scale @ inverse))


def _drift_uncertainty(fit: _Fit, t: FloatArray) -> float:
    """Standard uncertainty of dL/dt at the end."""
    if fit.tau_s is None:
        return _uncertainty(fit, t, [0.0, 1.0])
    end, tau, a = float(t[-1]), fit.tau_s, fit.amplitude
    fade = math.exp(-end / tau)
    return _uncertainty(fit, t, [0.0, 1.0, -fade / tau, a * fade / tau**2 * (1.0 - end / tau)])


def _change_uncertainty(fit: _Fit, t: FloatArray) -> float:
    """Standard uncertainty of L at the end less L at the begin."""
    end = float(t[-1])
    if fit.tau_s is None:
        return _uncertainty(fit, t, [0.0, end])
    fade = math.exp(-end / fit.tau_s)
    return _uncertainty(fit, t, [0.0, end, fade - 1.0, fit.amplitude * end / fit.tau_s**2 * fade])


def _assessed(fit: _Fit, t: FloatArray, allowed: float) -> WarmUp:
    end = float(t[-1])
    last = float(_design(t[-1:], fit.tau_s)[0] @ _parameters(fit))
    per_minute = 60.0 / last
    drift, doubt = fit.drift(end) * per_minute, _drift_uncertainty(fit, t) * per_minute
    steady = fit.slope * per_minute
    verdict: Literal["warm", "cold", "undecided"] = "undecided"
    if abs(drift) + COVERAGE * doubt <= allowed:
        verdict = "warm"
    elif abs(drift) - COVERAGE * doubt > allowed:
        verdict = "cold"
    return WarmUp(
        frames=len(t),
        duration_s=end,
        change_share=fit.change(end) / last,
        change_uncertainty=_change_uncertainty(fit, t) / last,
        drift_per_minute=drift,
        drift_uncertainty=doubt,
        steady_per_minute=steady,
        warmup_share=fit.amplitude / last,
        time_constant_s=fit.tau_s,
        noise_share=math.sqrt(fit.squares / fit.free) / last,
        allowed_per_minute=allowed,
        wait_s=_wait_s(fit, end, last, allowed, warm=verdict == "warm"),
        verdict=verdict,
    )


def _parameters(fit: _Fit) -> FloatArray:
    linear = [fit.constant, fit.slope]
    return np.asarray(linear if fit.tau_s is None else [*linear, fit.amplitude])


def _wait_s(fit: _Fit, end_s: float, last: float, allowed: float, *, warm: bool) -> float | None:
    """Time from the end of the series until the remaining warm-up drift is within the limit."""
    if warm:
        return 0.0
    if fit.tau_s is None:
        return 0.0 if abs(fit.slope) * 60.0 / last <= allowed else None
    rate = abs(fit.amplitude) / fit.tau_s * 60.0 / last
    settled_s = fit.tau_s * math.log(rate / allowed) if rate > allowed else 0.0
    return max(0.0, settled_s - end_s)
