"""Fit of an ink to goniometer readings: parameters, uncertainties, and warnings.

The joint fit determines α, ρ(λ) and c(λ) together from the logarithms of all readings: ln f = ln(D(α, θh)/4) + ln ρ(λ)
+ c(λ)·x. For a given α the problem is linear, wavelength by wavelength; the remaining search is in α alone (variable
projection: Golub and Pereyra 1973). Because the linear part does not depend on α, the Jacobian of the projected
residuals, and with it the Gauss-Newton step, is exact.

All wavelengths of one place share the errors of its angles and of its level, and these errors shift α. Therefore u(α)
is the larger of two estimates: from the scatter of single readings, and from sums over places (Liang and Zeger 1986),
which are valid for any correlation within a place.

The two-step fit of Pranovich 2024, as published, serves for comparison; it is biased even without noise. Step 1: a GGX
lobe of any height is fitted to the spectrum-averaged readings of each angle of the light, and α is the mean. The rise
of exp(c·x) across the lobe is attributed to its width. Step 2: ρ and c of every wavelength follow from the mirror
direction (Eq. 7) with α fixed. Light at 70° is left out.
"""

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.base.rejection import Misfit, best_model, misfit, rejection_words
from anisoscope.ink.goniometer import Readings
from anisoscope.sim.light.ink.angles import shift
from anisoscope.sim.light.ink.distributions import Distribution
from anisoscope.sim.light.ink.ink import Ink, InkUncertainty
from anisoscope.sim.light.ink.model import albedo_warning

BoolArray = npt.NDArray[np.bool_]

FLOOR_SHARE = 1e-5
"""Usual noise floor, as a share of the largest reading."""

CLEAR = 3.0
"""Readings up to this many noise floors are dropped: the logarithm of what is mostly noise misleads."""

LEAST = 3


@dataclass(frozen=True)
class Dropped:
    """A reading that the fit does not use.

    Attributes:
        line: of the file.
        theta_i_deg: of the light.
        theta_o_deg: of the detector.
        wavelength_nm: of the reading.
        value: BRDF in 1/sr.
        reason: why.
    """

    line: int
    theta_i_deg: float
    theta_o_deg: float
    wavelength_nm: float
    value: float
    reason: str


@dataclass(frozen=True, eq=False)
class Grid:
    """Readings by place (G) and wavelength (W).

    Attributes:
        theta_i_deg: (G,).
        theta_o_deg: (G,) with its sign.
        nm: (W,) rising.
        value: (G, W) BRDF, NaN without a usable reading.
        floor: noise floor of the readings, 1/sr.
        dropped: readings that are left out.
    """

    theta_i_deg: FloatArray
    theta_o_deg: FloatArray
    nm: FloatArray
    value: FloatArray
    floor: float
    dropped: tuple[Dropped, ...]

    @property
    def half_deg(self) -> FloatArray:
        """(G,) angle of the half vector from the normal."""
        return np.abs(self.theta_i_deg - self.theta_o_deg) / 2.0

    @property
    def x(self) -> FloatArray:
        """(G,) 1 − cos((θi + |θo|)/2)."""
        return shift(np.cos(np.radians(self.theta_i_deg)), np.cos(np.radians(self.theta_o_deg)))

    @property
    def mirror(self) -> BoolArray:
        """(G,) the places in the mirror direction."""
        return np.asarray(np.abs(self.theta_i_deg - self.theta_o_deg) < 0.01)


def grid_of(readings: Readings, floor: float | None = None, below_deg: float | None = None) -> Grid:
    """Sort readings by place and wavelength; a place with two readings has two rows.

    Args:
        readings: BRDF values.
        floor: noise floor in 1/sr; readings up to three times as large are dropped. None: a share of the
            largest reading.
        below_deg: angles of the light from which readings are dropped.

    Raises:
        UsageError: a floor that is not positive, or nothing is left.
    """
    largest = float(np.max(readings.value))
    if largest <= 0.0:
        raise UsageError("no reading lies above 0: there is nothing to fit")
    lowest = FLOOR_SHARE * largest if floor is None else floor
    if not 0.0 < lowest < largest:
        raise UsageError(
            f"the noise floor must lie above 0 and below the largest reading ({largest:g}/sr), not at {lowest:g}"
        )
    steep = readings.theta_i_deg >= (np.inf if below_deg is None else below_deg)
    why = np.where(
        steep, "angle left out", np.where(readings.value <= CLEAR * lowest, "near the noise floor", "")
    )
    nm, column = np.unique(readings.wavelength_nm, return_inverse=True)
    angle_i, number_i = np.unique(readings.theta_i_deg, return_inverse=True)
    angle_o, number_o = np.unique(readings.theta_o_deg, return_inverse=True)
    place = number_i * len(angle_o) + number_o
    times = _times(place * len(nm) + column)
    at, row = np.unique(place + len(angle_i) * len(angle_o) * times, return_inverse=True)
    at = at % (len(angle_i) * len(angle_o))
    value = np.full((len(at), len(nm)), np.nan)
    value[row, column] = np.where(why == "", readings.value, np.nan)
    few = np.sum(np.isfinite(value), axis=0) < LEAST
    why = np.where((why == "") & few[column], "too few at this wavelength", why)
    if few.all():
        raise UsageError(
            f"no wavelength has {LEAST} readings clear of the noise floor of {lowest:g}/sr: there is nothing to fit"
        )
    usable = np.isfinite(value[:, ~few]).any(axis=1)
    light, detector = angle_i[at // len(angle_o)], angle_o[at % len(angle_o)]
    return Grid(
        light[usable], detector[usable], nm[~few], value[usable][:, ~few], lowest, _dropped(readings, why)
    )


def _times(key: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """(N,) how many readings with the same key come before each one."""
    order = np.argsort(key, kind="stable")
    count = np.arange(len(order))
    new = np.concatenate([[True], np.diff(key[order]) != 0])
    found = np.empty_like(count)
    found[order] = count - np.maximum.accumulate(np.where(new, count, 0))
    return found


def _dropped(readings: Readings, why: npt.NDArray[np.str_]) -> tuple[Dropped, ...]:
    return tuple(
        Dropped(
            readings.lines[n],
            float(readings.theta_i_deg[n]),
            float(readings.theta_o_deg[n]),
            float(readings.wavelength_nm[n]),
            float(readings.value[n]),
            str(why[n]),
        )
        for n in np.flatnonzero(why != "")
    )


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
        residual: (G, W) ln measured − ln fitted, NaN without a reading.
        distribution: of the flakes' normals.
        chi2: weighted sum of squares; 0 where it was not asked for.
        parameters: number of fitted ones.
    """

    alpha: float
    u_alpha: float
    log_rho: FloatArray
    u_log_rho: FloatArray
    c: FloatArray
    u_c: FloatArray
    residual: FloatArray
    distribution: Distribution = "ggx"
    chi2: float = 0.0
    parameters: int = 0


def log_lobe(
    alpha: float, half_deg: FloatArray, distribution: Distribution = "ggx"
) -> tuple[FloatArray, FloatArray]:
    """(G,) ln(D/4) at half angles, of Eq. 3 or Beckmann's, and its derivative by ln α."""
    sine, cosine = np.sin(np.radians(half_deg)) ** 2, np.cos(np.radians(half_deg)) ** 2
    if distribution == "beckmann":
        slope = sine / cosine / alpha**2
        return -slope - np.log(4.0 * np.pi * alpha**2 * cosine**2), 2.0 * slope - 2.0
    square = alpha**2
    total = square * cosine + sine
    value = np.log(square / (4.0 * np.pi)) - 2.0 * np.log(total)
    return value, 2.0 - 4.0 * square * cosine / total


def _sum(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("gw,gw->w", one, other))


class _Projection:
    """Weighted least squares in (1, x) of every wavelength: (G, W) weights, 0 without a reading."""

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


def solve_jointly(
    grid: Grid,
    noise: float,
    distribution: Distribution = "ggx",
    alpha: float | None = None,
    dim: float = 0.0,
) -> Solution:
    """Fit all readings of a grid.

    Args:
        grid: the readings.
        noise: relative standard deviation of a reading, in addition to the floor of the grid. It sets the weights only;
            the uncertainties come from the scatter about the fit.
        distribution: of the flakes' normals.
        alpha: roughness where it is not fitted; 1 is a matte print, whose ln f is linear.
        dim: standard deviation of every reading besides, as a share of the largest one of its wavelength: where the
            lobe has another form, its bright part counts.

    Raises:
        UsageError: readings that do not separate ρ from c, or do not determine the width of the lobe.
    """
    given = np.isfinite(grid.value)
    measured = np.where(given, grid.value, 1.0)
    level, held, found = measured, alpha is not None, np.nan if alpha is None else alpha
    floor = np.hypot(grid.floor, dim * np.max(np.where(given, grid.value, 0.0), axis=0))
    projection, base = _projection(grid, given, noise, level, floor)
    for _ in range(_REWEIGHTED):
        found = found if held else _search(grid, projection, base, found, distribution)
        lobe = log_lobe(found, grid.half_deg, distribution)[0][:, None]
        log_rho, c, _ = projection(base - lobe)
        level = np.exp(lobe + log_rho + c * grid.x[:, None])
        projection, base = _projection(grid, given, noise, level, floor)
    if not held:
        found = _search(grid, projection, base, found, distribution)
    return _finish(grid, given, projection, base, found, distribution, held=held)


def _projection(
    grid: Grid, given: npt.NDArray[np.bool_], noise: float, level: FloatArray, floor: FloatArray
) -> tuple[_Projection, FloatArray]:
    """Weights for the level of the fit, and logarithms of the readings."""
    variance = noise**2 + (floor / level) ** 2
    projection = _Projection(grid.x, np.where(given, 1.0 / variance, 0.0))
    if np.any(projection.spread <= 1e-9 * projection.total):
        at = int(np.argmax(projection.spread <= 1e-9 * projection.total))
        raise UsageError(
            f"at {grid.nm[at]:g} nm all readings have the same sum of angles, which does not tell rho from c: "
            "measure at several angles of the light"
        )
    return projection, np.log(np.where(given, grid.value, 1.0))


def _cost(
    grid: Grid, projection: _Projection, base: FloatArray, alpha: float, distribution: Distribution
) -> tuple[float, float, float]:
    """Weighted sum of squares at an α, its Gauss-Newton step in ln α, and the curvature."""
    lobe, slope = log_lobe(alpha, grid.half_deg, distribution)
    rest = projection(base - lobe[:, None])[2]
    along = projection(np.broadcast_to(slope[:, None], base.shape))[2]
    weighted = projection.weight * along
    curvature, pull = float(np.vdot(weighted, along)), float(np.vdot(weighted, rest))
    return float(np.vdot(projection.weight * rest, rest)), pull / max(curvature, 1e-30), curvature


def _search(
    grid: Grid, projection: _Projection, base: FloatArray, start: float, distribution: Distribution
) -> float:
    alpha = start
    if not np.isfinite(start):
        alpha = min(_STARTS, key=lambda one: _cost(grid, projection, base, float(one), distribution)[0])
    cost, step, curvature = _cost(grid, projection, base, alpha, distribution)
    if curvature <= 1e-6 * float(projection.weight.sum()):
        raise UsageError(
            "the readings do not say how wide the lobe is: measure away from the mirror direction as well as in it"
        )
    for _ in range(_STEPS):
        step = float(np.clip(step, -0.5, 0.5))
        trial = float(np.clip(alpha * np.exp(step), *ALPHA_RANGE))
        found = _cost(grid, projection, base, trial, distribution)
        if found[0] <= cost:
            alpha, (cost, step, _) = trial, found
        else:
            step *= 0.5
        if abs(step) < _CLOSE:
            break
    return float(alpha)


def _finish(
    grid: Grid,
    given: npt.NDArray[np.bool_],
    projection: _Projection,
    base: FloatArray,
    alpha: float,
    distribution: Distribution,
    *,
    held: bool,
) -> Solution:
    lobe, slope = log_lobe(alpha, grid.half_deg, distribution)
    log_rho, c, rest = projection(base - lobe[:, None])
    at_zero, turn, along = projection(np.broadcast_to(slope[:, None], base.shape))
    cost, _, curvature = _cost(grid, projection, base, alpha, distribution)
    parameters = 2 * len(grid.nm) + (not held)
    freedom = int(given.sum()) - parameters
    if freedom < 1:
        raise UsageError(f"{int(given.sum())} readings for {parameters} parameters: measure at more angles")
    scatter = cost / freedom
    score = np.sum(projection.weight * along * rest, axis=1)
    shared = float(score @ score) * len(score) / (len(score) - 1) / curvature**2
    from_alpha = 0.0 if held else max(scatter / curvature, shared)
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
        distribution,
        cost,
        parameters,
    )


SKIPPED_FROM_DEG = 70.0
_STEPS_paperfit = 20


def solve_as_published(grid: Grid) -> Solution:
    """Fit a grid in two steps; the uncertainties of ρ and c are conditional on the fitted α.

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
            "no angle of the light has three readings: the published fit needs some away from the mirror direction"
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
    for _ in range(_STEPS_paperfit):
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


Method = Literal["joint", "paper"]
SCATTER = (0.01, 0.01, 0.003, 0.1, 0.05)
"""Scatter of good sheets about the one that was measured: roughness, level, colour, c, form of the lobe."""
_BANDS = 8.0
_BIN_DEG = 5.0
_THIRDS = 3


def left_by_angle(half_deg: FloatArray, residual: FloatArray) -> tuple[tuple[float, ...], ...]:
    """The misfit of `InkUncertainty`, in its order: what the fit leaves in steps of 5°, less the scatter of places.

    Args:
        half_deg: (G,) half angles of the places.
        residual: (G, W) ln measured − ln fitted, wavelengths rising, NaN without a reading.
    """
    near = np.rint(half_deg / _BIN_DEG).astype(int)
    parts = np.array_split(residual, min(_THIRDS, residual.shape[1]), axis=1)
    counts = [np.isfinite(one).sum(axis=1, keepdims=True) for one in (residual, *parts)]
    whole, *thirds = (
        np.nansum(one, axis=1, keepdims=True) / np.maximum(count, 1)
        for one, count in zip((residual, *parts), counts, strict=True)
    )
    # a place without a reading in a third of the spectrum says nothing there
    apart = np.hstack([(one - whole) * (count > 0) for one, count in zip(thirds, counts[1:], strict=True)])
    steps, found = np.unique(near), []
    for values in (whole, apart):
        each = [values[near == step] for step in steps]
        scatter = [float(one.var(axis=0, ddof=1).mean()) for one in each if len(one) >= LEAST]
        random = min(scatter, default=0.0)
        found.append([max(float(np.mean(one**2)) - random, 0.0) ** 0.5 for one in each])
    shares = [tuple(float(f"{share:.2g}") for share in one) for one in found]
    at_deg = tuple(float(_BIN_DEG * step) for step in steps)
    return at_deg, *shares


NOISE = 0.03
DIM = 1e-3
_WEAK_C = 1.0
_WEAK_ALPHA = 0.02


def _of_grid(grid: Grid) -> dict[str, Any]:
    readings = int(np.isfinite(grid.value).sum())
    return {"readings": readings, "noise_floor": grid.floor, "dropped": grid.dropped}


@dataclass(frozen=True, eq=False)
class InkFit:
    """A fitted ink; ρ in the BRDF scale.

    Attributes:
        method: "joint", or "paper" for the published two steps.
        alpha: roughness α.
        u_alpha: its standard uncertainty.
        nm: (W,) wavelengths.
        rho: (W,).
        u_rho: (W,) with the contribution of α for the joint fit.
        c: (W,).
        u_c: (W,) likewise.
        residual: (G, W) ln measured − ln fitted at the places of the grid, NaN without a reading.
        grid: the readings as they were fitted.
        scale: conversion of the readings to a BRDF.
        warnings: reasons to doubt the result.
        distribution: of the flakes' normals.
        tests: of the model and, where it was rejected, of its rivals; none of the published two steps.
        misfit: that of these parameters.
    """

    method: Method
    alpha: float = field(metadata=LEFT_OUT)
    u_alpha: float = field(metadata=LEFT_OUT)
    nm: FloatArray = field(metadata=json_field("wavelengths_nm"))
    rho: FloatArray = field(metadata=LEFT_OUT)
    u_rho: FloatArray = field(metadata=LEFT_OUT)
    c: FloatArray = field(metadata=LEFT_OUT)
    u_c: FloatArray = field(metadata=LEFT_OUT)
    residual: FloatArray = field(metadata=LEFT_OUT)
    grid: Grid = field(metadata=json_field(by=_of_grid, merged=True))
    scale: str
    warnings: tuple[str, ...]
    distribution: Distribution = "ggx"
    tests: tuple[Misfit, ...] = ()
    misfit: Misfit | None = field(default=None, metadata=LEFT_OUT)

    @property
    @in_json()
    def fits(self) -> bool:
        """Whether the readings do not reject this ink; without a stated noise nothing does."""
        return self.misfit is None or not self.misfit.rejected

    @property
    @in_json("alpha")
    def alpha_with_u(self) -> dict[str, float]:
        """Roughness and its uncertainty, which is NaN where it is not determined."""
        return {"value": self.alpha, "u": self.u_alpha}

    @property
    @in_json("rho")
    def rho_with_u(self) -> dict[str, FloatArray]:
        """(W,) values and uncertainties."""
        return {"value": self.rho, "u": self.u_rho}

    @property
    @in_json("c")
    def c_with_u(self) -> dict[str, FloatArray]:
        """(W,) values and uncertainties."""
        return {"value": self.c, "u": self.u_c}

    @property
    @in_json()
    def convention(self) -> str:
        """Scale of ρ."""
        return "brdf"

    @property
    @in_json("residual_rms")
    def rms(self) -> float:
        """Root mean square of the residuals: the relative scatter of the readings about the fit."""
        return _rms(self.residual)

    def ink(self, name: str, source: str = "") -> Ink:
        """The ink, in the BRDF scale.

        Raises:
            ModelError: fitted values outside the range of inks.
        """
        rho, c, nm = (tuple(values.tolist()) for values in (self.rho, self.c, self.nm))
        return Ink(
            name,
            self.alpha,
            nm,
            rho,
            c,
            "brdf",
            source,
            distribution=self.distribution,
            uncertainty=self.uncertainty,
        )

    @property
    def uncertainty(self) -> InkUncertainty | None:
        """By the fit, the scatter from sheet to sheet and the misfit; None where u is not determined."""
        shares = (
            self.u_alpha / self.alpha,
            *(float(np.sqrt(np.mean(one**2))) for one in (self.u_rho / self.rho, self.u_c)),
        )
        if not np.isfinite(shares).all():
            return None
        alpha, level, c = shares
        several = np.hypot([alpha, level, level / np.sqrt(_BANDS), c, 0.0], SCATTER)
        alpha, level, colour, c, lobe = (float(f"{min(one, 1.0):.2g}") for one in several)
        return InkUncertainty(
            alpha, level, colour, c, lobe, *left_by_angle(self.grid.half_deg, self.residual)
        )


@dataclass(frozen=True, eq=False)
class RigInk:
    """Ink from a rig, and how well it describes the print that it was made of.

    Attributes:
        ink: with its uncertainty; ρ is a BRDF.
        film_nm: n·d of the film whose spectrum it has.
        tilt_deg: by how much the flakes of that print lean toward +x and +y; no part of the ink.
        poses: number of poses.
        rms: of ln of all channels that the ink leaves.
        bright: the same in the poses of the smallest half angle.
    """

    ink: Ink
    film_nm: float
    tilt_deg: tuple[float, float]
    poses: int
    rms: float
    bright: float

    def lines(self) -> tuple[str, ...]:
        """What was found, in words."""
        ink, known = self.ink, self.ink.uncertainty
        assert known is not None
        across = "" if ink.alpha_y is None else f" along {ink.brush_deg:g}°, {ink.alpha_y:.4f} across"
        u = f"u {100.0 * known.alpha_share:.2g} %"
        lobe = f"{ink.name}: alpha {ink.alpha:.4f}{across} ({u}), tail {ink.distribution}"
        film = f"spectrum and c of a film of {self.film_nm:g} nm (n·d), because a rig does not see them"
        left = (
            f"{100.0 * self.bright:.2g} % rms where the print is brightest, {100.0 * self.rms:.2g} % in all"
        )
        return (f"{lobe}; {film}", f"{self.poses} poses: left {left}")


def fit(
    readings: Readings, method: Method = "joint", *, noise: float | None = None, floor: float | None = None
) -> InkFit:
    """Fit α, ρ(λ) and c(λ) to readings.

    Where the noise is stated and the joint fit rejected, Beckmann's lobe and a matte print (α = 1, Eq. 3 then being
    constant) are tried in its place (`base.rejection`). Where none holds, or residuals exceed twice the unstated noise,
    both lobes are fitted with an error of `DIM` of the peak besides, and the one with the smaller χ² is taken: else the
    dim flank decides on the bright mirror direction. All uncertainties are from the scatter about the fit, so that the
    Birge ratio is in them.

    Args:
        readings: as a BRDF.
        method: "joint": all at once (`anisoscope.ink.fitting`); "paper": two steps, as published.
        noise: relative standard deviation of a reading. None: unknown, `NOISE` for the weights of the joint fit.
        floor: noise floor in 1/sr; readings up to three times as large are dropped, those above it weigh less.
            None: 1e-5 of the largest reading.

    Raises:
        UsageError: readings that do not determine the parameters; the message says what to measure.
    """
    share = NOISE if noise is None else noise
    if not 0.0 < share < 1.0:
        raise UsageError(f"the noise of a reading is a share in 0 to 1, not {share:g}")
    grid = grid_of(readings, floor, SKIPPED_FROM_DEG if method == "paper" else None)
    if method == "paper":
        return _warned(_ink_fit(solve_as_published(grid), method, grid, readings.scale), share)
    count = int(np.isfinite(grid.value).sum())

    def test(found: Solution) -> Misfit:
        words = "a matte print" if found.alpha == 1.0 else _LOBES[found.distribution]
        return misfit(words, found.chi2, count, found.parameters, known=noise is not None)

    def rival(distribution: Distribution, alpha: float | None = None) -> Solution:
        return solve_jointly(grid, share, distribution, alpha)

    matte = (partial(rival, "ggx", 1.0),)
    solution, tests = best_model(
        solve_jointly(grid, share), ((partial(rival, "beckmann"), *matte),), test, matte
    )
    chosen = test(solution)
    words = rejection_words(next(one for one in tests if one == chosen), tests)
    left = _rms(solution.residual)
    if solution.alpha < 1.0 and (chosen.rejected or (noise is None and left > 2.0 * share)):
        bright = [solve_jointly(grid, share, kind, dim=DIM) for kind in _LOBES]
        solution = min(bright, key=lambda one: one.chi2)
        line = (
            f"residuals of {100 * left:.2g} % rms exceed twice the noise of {100 * share:.2g} %: the model does not "
            "follow these readings, or their noise is larger"
        )
        lobe = _LOBES[solution.distribution]
        words.append(f"{line}; {lobe} is fitted where the print is bright{_off_mirror(grid, solution)}")
    found = _ink_fit(solution, method, grid, readings.scale)
    return _warned(replace(found, tests=tests, misfit=chosen, warnings=tuple(words)), share)


def _rms(residual: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(residual**2)))


def _off_mirror(grid: Grid, solution: Solution) -> str:
    if not grid.mirror.any():
        return ""
    rest = solution.residual[grid.mirror]
    return f", and in the mirror direction {100 * float(np.nanmean(rest)):+.2g} % off (rms {100 * _rms(rest):.2g} %)"


_LOBES: dict[Distribution, str] = {"ggx": "the lobe of the paper (GGX)", "beckmann": "Beckmann's lobe"}


def _ink_fit(solution: Solution, method: Method, grid: Grid, scale: str) -> InkFit:
    rho = np.exp(solution.log_rho)
    return InkFit(
        method,
        solution.alpha,
        solution.u_alpha,
        grid.nm,
        rho,
        rho * solution.u_log_rho,
        solution.c,
        solution.u_c,
        solution.residual,
        grid,
        scale,
        (),
        solution.distribution,
    )


def _warned(found: InkFit, noise: float) -> InkFit:
    warnings = [*found.warnings, *_coverage(found), *_misfit(found, noise)]
    if found.grid.dropped:
        reasons: dict[str, int] = {}
        for one in found.grid.dropped:
            reasons[one.reason] = reasons.get(one.reason, 0) + 1
        texts = ", ".join(f"{count} {reason}" for reason, count in reasons.items())
        warnings.append(f"{len(found.grid.dropped)} readings dropped: {texts}")
    if len(found.nm) > 1:
        too_bright = albedo_warning(found.ink("ink"))
        warnings += [too_bright] if too_bright else []
    return replace(found, warnings=tuple(warnings))


def _coverage(solution: InkFit) -> list[str]:
    found: list[str] = []
    grid = solution.grid
    if solution.misfit is not None and solution.misfit.model == "a matte print":
        return found
    tangent = np.tan(np.radians(grid.half_deg))
    if tangent.max() < solution.alpha:
        found.append(
            f"weak coverage: half angles end at {grid.half_deg.max():.3g}°, within the lobe "
            f"({np.degrees(np.arctan(solution.alpha)):.3g}°): measure farther from the mirror direction"
        )
    if tangent.min() > solution.alpha:
        found.append("weak coverage: no reading lies within the lobe: measure in the mirror direction")
    if not solution.u_alpha <= _WEAK_ALPHA * solution.alpha:
        found.append(
            f"weak coverage: alpha is known to ±{100 * solution.u_alpha / solution.alpha:.2g} % only"
        )
    if solution.alpha <= ALPHA_RANGE[0] * 1.001 or solution.alpha >= ALPHA_RANGE[1] * 0.999:
        found.append(f"alpha stands at the end of its range, {solution.alpha:g}")
    weak = int(np.count_nonzero(~(solution.u_c <= _WEAK_C)))
    if weak:
        found.append(
            f"weak coverage: c is known to no better than ±{_WEAK_C:g} at {weak} of {len(grid.nm)} wavelengths: "
            "measure over more angles of the light"
        )
    return found


def _misfit(found: InkFit, noise: float) -> list[str]:
    if found.rms <= 2.0 * noise or found.method == "joint":
        return []
    return [
        (
            f"residuals of {100 * found.rms:.2g} % rms exceed twice the noise of {100 * noise:.2g} %: "
            "the model does not follow these readings, or their noise is larger"
        )
    ]
