"""Fit of the light's position and of the lean of facets and tilt to the radiances of a known ridged part.

The corrected ridge model is fitted to ln L. In the small-angle picture of the lobe the half vector has in the frame
of the ridges the slopes (a cos φ − τ sin φ, −a sin φ − τ cos φ), a half the light angle, τ the tilt, and the lobe is
exp(−((h_x − θr)/α_v)² − (h_y/α_u)²). So one turn without tilt gives only a·θr/α_v² and a²(1/α_v² − 1/α_u²): the
light angle follows from what is known of part and scale. Tilts are angles known from the axis: under them ridge angle
and roughness, and with them the light angle, are measured. A light beside the plane (azimuth β) acts as a tilt of −a·β
does, so that β is worth what is known of the zero of the tilt. What is known beforehand stands as an observation.

Light that reflects between facet and wall is part of all this; a fit of direct light takes it for another light angle.
Its amplitude is a parameter with the prior that predictions give it, and its model error widens the uncertainty of
every pose (`prediction.reflections`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError
from anisoscope.commissioning.model import RigModel
from anisoscope.commissioning.part import RidgedPart
from anisoscope.parameters.material import LONGEST_TAIL
from anisoscope.prediction.reflections import AMPLITUDE_U, OF_INDIRECT

Model = Callable[[dict[str, float]], FloatArray]

_HELD = frozenset(
    {"log_mean", "log_ratio", "index", "albedo", "tail", "tilt_zero_deg", "seat_x_deg", "reflections"}
)
_SLOW = (
    "log_mean",
    "index",
    "tail",
)  # every new value makes a table of the interface: their slopes are taken once


@dataclass(frozen=True)
class Known:
    """Prior of a parameter: value, standard uncertainty (None for no prior), step, and bounds."""

    name: str
    words: str
    value: float
    u: float | None
    scale: float = 1.0
    bounds: tuple[float, float] = field(default=(-np.inf, np.inf))


@dataclass(frozen=True, eq=False)
class Solved:
    """Minimum: parameters, χ² over data and priors, residuals over u, and slopes of the data over u."""

    x: FloatArray
    chi2: float
    dof: int
    z: FloatArray
    data_jac: FloatArray
    prior_u: FloatArray  # infinite where nothing is known

    def named(self, known: list[Known]) -> dict[str, float]:
        """The parameters by name."""
        return {one.name: float(value) for one, value in zip(known, self.x, strict=True)}

    def covariance(self, weaken: float = 1.0) -> FloatArray:
        """Covariance of the parameters; `weaken` divides the weight of the priors by this factor."""
        weight = np.where(np.isfinite(self.prior_u), 1.0 / (weaken * self.prior_u), 0.0)
        stacked = np.concatenate([self.data_jac, np.diag(weight)])
        size = np.maximum(np.linalg.norm(stacked, axis=0), 1e-300)
        scaled = stacked / size
        inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-14)
        return np.asarray(inverse / np.outer(size, size), dtype=np.float64)

    def correlation(self) -> FloatArray:
        """Correlation of the parameters."""
        covariance = self.covariance()
        u = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        return np.asarray(np.clip(covariance / np.outer(u, u), -1.0, 1.0), dtype=np.float64)


def solve(
    model: Model,
    known: list[Known],
    measured: FloatArray,
    u: FloatArray,
    light_deg: float,
    *,
    quick: bool,
    start: FloatArray | None = None,
) -> Solved:
    """Least squares over data and priors; quick holds the parameters whose roughness tables are slow to compute."""
    from scipy.optimize import least_squares  # noqa: PLC0415 - takes long to import

    held = _HELD if quick else frozenset()
    free = [n for n, one in enumerate(known) if one.name not in held]
    values = np.array([one.value for one in known])
    # The light angle starts here without a prior: it is not drawn to the value of the rig file.
    values[1] = light_deg
    prior_u = np.array([np.inf if one.u is None else one.u for one in known])
    names = [one.name for one in known]
    # Without a white reference the scale has no prior: start where the mean residual is 0.
    if np.isnan(values[0]):
        known = [replace(known[0], value=0.0), *known[1:]]
        values[0] = 0.0
        values[0] = float(np.mean(measured - model(dict(zip(names, values, strict=True)))))
    centre = np.array([one.value for one in known])
    if start is not None:
        values = start.copy()

    def all_of(some: FloatArray) -> FloatArray:
        whole = values.copy()
        whole[free] = some
        return whole

    def rest(some: FloatArray) -> FloatArray:
        whole = all_of(some)
        data = (model(dict(zip(names, whole, strict=True))) - measured) / u
        has = np.isfinite(prior_u)
        return np.concatenate([data, (whole[has] - centre[has]) / prior_u[has]])

    low, high = (np.array([known[n].bounds[side] for n in free]) for side in (0, 1))
    scale = np.array([known[n].scale for n in free])

    cached: dict[str, FloatArray] = {}

    def slopes(some: FloatArray) -> FloatArray:
        base, columns = rest(some), []
        # Own differences instead of those of SciPy: slopes of slow parameters hardly change, and are computed once.
        for n, step in enumerate(1e-3 * scale):
            if names[free[n]] in cached:
                columns.append(cached[names[free[n]]])
                continue
            moved = some.copy()
            moved[n] += step if some[n] + step < high[n] else -step
            columns.append((rest(moved) - base) / (moved[n] - some[n]))
            if names[free[n]] in _SLOW:
                cached[names[free[n]]] = columns[-1]
        return np.stack(columns, axis=1)

    found = least_squares(
        rest, np.clip(values[free], low + 1e-6, high - 1e-6), jac=slopes, bounds=(low, high), x_scale=scale,
        ftol=1e-4, xtol=1e-6, max_nfev=10 if quick else 12,
    )  # fmt: skip
    whole = all_of(found.x)
    count = len(measured)
    jac = np.zeros((count, len(known)))
    jac[:, free] = slopes(found.x)[:count]
    dof = count + int(np.sum(np.isfinite(prior_u))) - len(known)
    return Solved(whole, float(np.sum(found.fun**2)), max(dof, 1), -found.fun[:count], jac, prior_u)


WEAK = 1e3  # priors are widened by this to ask what the pictures alone say
SURE = 13.8  # difference of χ² at which a side is decided: odds of a thousand to one
FAR_BEHIND = 300.0
LIGHT_RANGE_DEG = (0.5, 60.0)
_Branch = tuple[bool, int]


@dataclass(frozen=True, eq=False)
class Radiances:
    """Measured radiances of N poses.

    Attributes:
        lean_deg: azimuth in the untilted picture across the ridges, counter-clockwise; the facets lean there or to
            the opposite side.
        tilt_deg: tilt as far as the present sign and the geometric zero say.
        radiance: in 1/sr if `absolute`, else in any unit.
        u_relative: relative standard uncertainty of each.
        absolute: whether the scale k is known, by `u_scale`.
        u_scale: relative standard uncertainty of k.
        u_tilt_deg: standard uncertainty of the zero of the tilt.
        free_sign: whether the sign of the tilt is to be found.
    """

    lean_deg: FloatArray
    tilt_deg: FloatArray
    radiance: FloatArray
    u_relative: FloatArray
    absolute: bool = False
    u_scale: float = 0.02
    u_tilt_deg: float = 0.1
    free_sign: bool = False


@dataclass(frozen=True)
class Parameter:
    """One parameter of the fit.

    Attributes:
        name: key.
        words: what it is, with its unit.
        prior, u_prior: what was known beforehand; None where nothing was.
        value, u: after the fit.
        u_alone: standard uncertainty from the pictures alone; infinite where they do not determine it.
    """

    name: str
    words: str
    prior: float
    u_prior: float | None
    value: float
    u: float
    u_alone: float


@dataclass(frozen=True, eq=False)
class LightFit:
    """The fit.

    Attributes:
        parameters: in the order of `correlation`.
        correlation: (Q, Q).
        fitted: (N,) fitted radiances, in the unit of the measured.
        z: (N,) residuals of ln L over their uncertainty, before it was widened.
        chi2, dof: of the fit; dof counts the observations beforehand.
        widened: factor (Birge ratio) by which uncertainties were widened.
        half_turn: whether the facets lean to the side opposite to `lean_deg`.
        side_chi2: χ² that the wrong side costs.
        sign: sign of the tilt relative to the one given, or None where it was not asked for.
        sign_chi2: χ² that the wrong sign costs.
    """

    parameters: tuple[Parameter, ...]
    correlation: FloatArray
    fitted: FloatArray
    z: FloatArray
    chi2: float
    dof: int
    widened: float
    half_turn: bool
    side_chi2: float
    sign: int | None
    sign_chi2: float | None

    def __getitem__(self, name: str) -> Parameter:
        return next(parameter for parameter in self.parameters if parameter.name == name)


def _known(part: RidgedPart, radiances: Radiances, light_deg: float, bounces: int | None) -> list[Known]:
    log_scale = 0.0 if radiances.absolute else float("nan")
    mean = float(0.5 * np.log(part.alpha_across * part.alpha_along))
    ratio = float(np.log(part.alpha_across / part.alpha_along))
    known = [
        Known("log_scale", "ln k", log_scale, radiances.u_scale if radiances.absolute else None),
        Known("light_deg", "light angle [°]", light_deg, None, 1.0, LIGHT_RANGE_DEG),
        Known("azimuth_deg", "light azimuth [°]", 0.0, None, 1.0, (-60.0, 60.0)),
        Known("tilt_zero_deg", "zero of the tilt [°]", 0.0, max(radiances.u_tilt_deg, 1e-3), 0.1),
        Known("ridge_deg", "ridge angle [°]", part.ridge_angle_deg, part.u_ridge_angle_deg, 0.1, (0.1, 44.9)),
        Known("log_mean", "ln √(α along·α across)", mean, part.u_log_mean, 0.05, (-6.0, -0.5)),
        Known("log_ratio", "ln (α across/α along)", ratio, part.u_log_ratio, 0.05, (-2.0, 2.0)),
        Known("albedo", "albedo", part.albedo, part.u_albedo, 0.01, (0.0, 1.0)),
        Known("index", "refractive index", part.index, part.u_index, 0.01, (1.05, 3.9)),
        Known("seat_x_deg", "seating about x [°]", 0.0, part.u_seating_deg, 0.1, (-5.0, 5.0)),
        Known("seat_y_deg", "seating about y [°]", 0.0, part.u_seating_deg, 0.1, (-5.0, 5.0)),
    ]  # fmt: skip
    if part.u_tail > 0.0:
        known.append(Known("tail", "tail of the lobe", part.tail, part.u_tail, 0.05, (0.0, LONGEST_TAIL)))
    if bounces == 1:
        return known
    return [*known, Known("reflections", "amplitude of the reflections", 1.0, AMPLITUDE_U, 0.1, (0.0, 5.0))]


def fit_light(
    part: RidgedPart, radiances: Radiances, light_deg: float = 10.0, *, bounces: int | None = None
) -> LightFit:
    """Fit light angle, light azimuth, sides and signs to the radiances of a ridged part.

    Args:
        part: the part and what is known of it.
        radiances: the radiances.
        light_deg: where the search begins; it does not pull.
        bounces: reflections that the model counts; None counts all.

    Raises:
        MeasurementError: too few poses, or nothing fits.
    """
    if len(radiances.radiance) < 6:
        raise MeasurementError(
            f"the light angle needs radiances of at least 6 poses, not {len(radiances.radiance)}"
        )
    known = _known(part, radiances, light_deg, bounces)
    measured = np.log(radiances.radiance)
    begin = {one.name: light_deg if one.name == "light_deg" else one.value for one in known}

    def solved(key: _Branch, u: FloatArray, near: Solved | None) -> Solved:
        start = None if near is None else near.x
        model = _model(part, radiances, *key, bounces)
        close = model.anchored(begin if near is None else near.named(known))
        return solve(close, known, measured, u, light_deg, quick=near is None, start=start)

    branches: list[_Branch] = list(product((False, True), (1, -1) if radiances.free_sign else (1,)))
    trials = {key: solved(key, radiances.u_relative, None) for key in branches}
    nearest = min(trials, key=lambda key: trials[key].chi2)
    first = trials[nearest]
    indirect = _model(part, radiances, *nearest, bounces).indirect_share(first.named(known))
    u = np.hypot(radiances.u_relative, OF_INDIRECT * indirect)
    # what lies far behind needs no better look
    trials = {
        key: solved(key, u, trial)
        if trial.chi2 < first.chi2 + FAR_BEHIND * max(1.0, first.chi2 / first.dof)
        else trial
        for key, trial in trials.items()
    }
    best = min(trials, key=lambda key: trials[key].chi2)
    full = trials[best]
    # a model that is off everywhere makes every difference look sure
    unit = max(1.0, full.chi2 / full.dof)
    sides = [trial.chi2 for key, trial in trials.items() if key[0] != best[0]]
    signs = [trial.chi2 for key, trial in trials.items() if key[1] != best[1]]
    widened = float(np.sqrt(unit))
    return LightFit(
        _parameters(known, full, widened),
        full.correlation(),
        np.exp(_model(part, radiances, *best, bounces)(full.named(known))),
        full.z,
        full.chi2,
        full.dof,
        widened,
        best[0],
        (min(sides) - full.chi2) / unit,
        best[1] if radiances.free_sign else None,
        (min(signs) - full.chi2) / unit if signs else None,
    )


def _model(
    part: RidgedPart, radiances: Radiances, half_turn: bool, sign: int, bounces: int | None
) -> RigModel:
    return RigModel(
        part, radiances.lean_deg + (180.0 if half_turn else 0.0), sign * radiances.tilt_deg, bounces
    )


def _parameters(known: list[Known], solved: Solved, widened: float) -> tuple[Parameter, ...]:
    u = np.sqrt(np.diag(solved.covariance())) * widened
    alone = np.sqrt(np.maximum(np.diag(solved.covariance(WEAK)), 0.0)) * widened
    return tuple(
        Parameter(
            one.name,
            one.words,
            one.value,
            one.u,
            float(solved.x[n]),
            float(u[n]),
            float(alone[n]) if one.u is None or alone[n] < 0.5 * WEAK * one.u else float("inf"),
        )
        for n, one in enumerate(known)
    )
