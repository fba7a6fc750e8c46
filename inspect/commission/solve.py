"""Least squares over radiances and what is known beforehand: the solver of `anisoscope.commission.light`."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Model = Callable[[dict[str, float]], FloatArray]

_HELD = frozenset({"log_mean", "log_ratio", "index", "albedo", "tilt_zero_deg", "seat_x_deg"})
_SLOW = ("log_mean", "index")  # every new value makes a table of the interface: their slopes are taken once


@dataclass(frozen=True)
class Known:
    """A parameter before the fit: value, standard uncertainty (None where nothing is known), step, and bounds."""

    name: str
    words: str
    value: float
    u: float | None
    scale: float = 1.0
    bounds: tuple[float, float] = field(default=(-np.inf, np.inf))


@dataclass(frozen=True, eq=False)
class Solved:
    """The minimum: parameters, χ² over data and what was known, residuals over u, and slopes of the data over u."""

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
        """Covariance of the parameters; `weaken` makes what was known beforehand worth less by this factor."""
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
    """Least squares over data and what is known; quick leaves roughness tables alone, which take long to make."""
    from scipy.optimize import least_squares  # noqa: PLC0415 - takes long to import

    held = _HELD if quick else frozenset()
    free = [n for n, one in enumerate(known) if one.name not in held]
    values = np.array([one.value for one in known])
    values[1] = light_deg
    prior_u = np.array([np.inf if one.u is None else one.u for one in known])
    names = [one.name for one in known]
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

    kept: dict[str, FloatArray] = {}

    def slopes(some: FloatArray) -> FloatArray:
        base, columns = rest(some), []
        for n, step in enumerate(1e-3 * scale):
            if names[free[n]] in kept:
                columns.append(kept[names[free[n]]])
                continue
            moved = some.copy()
            moved[n] += step if some[n] + step < high[n] else -step
            columns.append((rest(moved) - base) / (moved[n] - some[n]))
            if names[free[n]] in _SLOW:
                kept[names[free[n]]] = columns[-1]
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
