"""Fit of an ink to goniometer readings: parameters, their uncertainties, and what speaks against them."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.errors import UsageError
from anisoscope.ink.goniometer import Readings
from anisoscope.ink.grid import Grid, grid_of
from anisoscope.ink.jointfit import ALPHA_RANGE, Solution, solve_jointly
from anisoscope.ink.paperfit import SKIPPED_FROM_DEG, solve_as_published
from anisoscope.sim.light.ink.albedo import albedo_warning
from anisoscope.sim.light.ink.ink import Ink

FloatArray = npt.NDArray[np.float64]
Method = Literal["joint", "paper"]

NOISE = 0.03
_WEAK_C = 1.0
_WEAK_ALPHA = 0.02


@dataclass(frozen=True, eq=False)
class InkFit:
    """A fitted ink; ρ in the BRDF scale.

    Attributes:
        method: "joint", or "paper" for the published two steps.
        alpha: roughness α.
        u_alpha: its standard uncertainty.
        nm: (W,) wavelengths.
        rho: (W,).
        u_rho: (W,) with the share of α for the joint fit.
        c: (W,).
        u_c: (W,) likewise.
        residual: (G, W) ln measured − ln fitted at the places of the grid, NaN where there is no reading.
        grid: the readings as they were fitted.
        scale: how the readings became a BRDF.
        warnings: what speaks against the result.
    """

    method: Method
    alpha: float
    u_alpha: float
    nm: FloatArray
    rho: FloatArray
    u_rho: FloatArray
    c: FloatArray
    u_c: FloatArray
    residual: FloatArray
    grid: Grid
    scale: str
    warnings: tuple[str, ...]

    @property
    def rms(self) -> float:
        """Root mean square of the residuals: the relative scatter of the readings about the fit."""
        return float(np.sqrt(np.nanmean(self.residual**2)))

    def ink(self, name: str, source: str = "") -> Ink:
        """The ink, in the BRDF scale.

        Raises:
            ModelError: fitted numbers that no ink can have.
        """
        rho, c, nm = (tuple(values.tolist()) for values in (self.rho, self.c, self.nm))
        return Ink(name, self.alpha, nm, rho, c, "brdf", source)


def fit(
    readings: Readings, method: Method = "joint", *, noise: float = NOISE, floor: float | None = None
) -> InkFit:
    """Fit α, ρ(λ) and c(λ) to readings.

    Args:
        readings: as a BRDF.
        method: "joint": all at once (`anisoscope.ink.jointfit`); "paper": two steps, as published.
        noise: relative standard deviation of a reading, for the weights of the joint fit.
        floor: noise floor in 1/sr; readings up to three times as large are dropped, those above it weigh less.
            None: 1e-5 of the largest reading.

    Raises:
        UsageError: readings that do not determine the parameters; the message says what to measure.
    """
    if not 0.0 < noise < 1.0:
        raise UsageError(f"the noise of a reading is a share in 0 to 1, not {noise:g}")
    grid = grid_of(readings, floor, SKIPPED_FROM_DEG if method == "paper" else None)
    solution = solve_jointly(grid, noise) if method == "joint" else solve_as_published(grid)
    rho = np.exp(solution.log_rho)
    found = InkFit(
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
        readings.scale,
        (),
    )
    return _warned(found, solution, noise)


def _warned(found: InkFit, solution: Solution, noise: float) -> InkFit:
    warnings = [*_coverage(found.grid, solution), *_misfit(found, noise)]
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


def _coverage(grid: Grid, solution: Solution) -> list[str]:
    found = []
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
    if found.rms <= 2.0 * noise:
        return []
    return [
        (
            f"residuals of {100 * found.rms:.2g} % rms exceed twice the noise of {100 * noise:.2g} %: "
            "the model does not follow these readings, or their noise is larger"
        )
    ]
