"""Fit of an ink to goniometer readings: the form of its light, uncertainties, and warnings."""

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.base.rejection import Misfit, best_model, misfit, rejection_words
from anisoscope.ink.goniometer import Readings
from anisoscope.ink.solver import (
    ALPHA_RANGE,
    BASES,
    LEAST,
    SKIPPED_FROM_DEG,
    Base,
    Form,
    Grid,
    Method,
    Solution,
    grid_of,
    solve_as_published,
    solve_jointly,
)
from anisoscope.sim.light.colour.observer import white_point, xyz_weights
from anisoscope.sim.light.colour.spaces import ciede2000, lab
from anisoscope.sim.light.ink.distributions import Distribution
from anisoscope.sim.light.ink.ink import Ink, InkUncertainty
from anisoscope.sim.light.ink.model import albedo_warning
from anisoscope.sim.materials.spectra import find_illuminant

BoolArray = npt.NDArray[np.bool_]

SCATTER = (0.01, 0.01, 0.003, 0.1, 0.05)
"""Scatter of good sheets about the one that was measured: roughness, level, colour, c, form of the lobe."""
_BANDS = 8.0
_BIN_DEG = 2.5
_THIRDS = 3


def left_by_angle(half_deg: FloatArray, residual: FloatArray) -> tuple[tuple[float, ...], ...]:
    """The misfit of `InkUncertainty`, in its order: what the fit leaves in steps of 2.5°, less the scatter of places.

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
DIM = 3e-3
_VISIBLE_NM = (400.0, 700.0)
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
        distribution: of the flakes' normals, or its tail.
        u_tail: standard uncertainty of a fitted tail.
        base: terms that add to the light of the flakes.
        u_light: (G, W) standard uncertainty of ln of the fitted light; None of the published two steps.
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
    u_tail: float = field(default=0.0, metadata=LEFT_OUT)
    base: tuple[Base, ...] = ()
    u_light: FloatArray | None = field(default=None, metadata=LEFT_OUT)
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

    @property
    @in_json("mirror_delta_e2000")
    def mirror_delta_e(self) -> float | None:
        """Rms CIEDE2000 of the fit in the mirror direction (D65, brightest reading as white); None without readings."""
        grid = self.grid
        whole = grid.mirror & np.isfinite(grid.value).all(axis=1)
        if not whole.any() or grid.nm[0] > _VISIBLE_NM[0] or grid.nm[-1] < _VISIBLE_NM[1]:
            return None
        light = find_illuminant("d65")
        read = grid.value[whole] @ xyz_weights(light, grid.nm)
        fitted = (grid.value[whole] / np.exp(self.residual[whole])) @ xyz_weights(light, grid.nm)
        white, bright = white_point(light), float(read[:, 1].max())
        return _rms(ciede2000(lab(read / bright, white), lab(fitted / bright, white)))

    def ink(self, name: str, source: str = "") -> Ink:
        """The ink, in the BRDF scale.

        Raises:
            ModelError: fitted values outside the range of inks.
        """
        rho, c, nm = (tuple(values.tolist()) for values in (self.rho, self.c, self.nm))
        base = tuple(
            Ink(
                "base", one.alpha, nm, tuple(one.rho.tolist()), tuple(one.c.tolist()),
                distribution="ggx" if one.name == "paper" else "beckmann",
            )
            for one in self.base
        )  # fmt: skip
        return Ink(
            name, self.alpha, nm, rho, c, "brdf", source, distribution=self.distribution,
            uncertainty=self.uncertainty, base=base,
        )  # fmt: skip

    @property
    def uncertainty(self) -> InkUncertainty | None:
        """By the fit, the scatter from sheet to sheet and the misfit; None where u is not determined."""
        u_light = self.u_rho / self.rho if self.u_light is None else self.u_light[_brightest(self.grid)]
        shares = (self.u_alpha / self.alpha, _rms(u_light), _rms(self.u_c))
        if not np.isfinite(shares).all():
            return None
        alpha, level, c = shares
        several = np.hypot([alpha, level, level / np.sqrt(_BANDS), c, self.u_tail], SCATTER)
        alpha, level, colour, c, lobe = (float(f"{min(one, 1.0):.2g}") for one in several)
        return InkUncertainty(
            alpha, level, colour, c, lobe, *left_by_angle(self.grid.half_deg, self.residual)
        )


def _brightest(grid: Grid) -> BoolArray:
    """(G,) the places whose half angle is within a step of the smallest."""
    return np.asarray(grid.half_deg <= grid.half_deg.min() + _BIN_DEG)


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
    constant) are tried in its place (`base.rejection`), and then lobes of any tail, with paper, gloss or both besides.
    These are fitted with an error of `DIM` of the peak besides: else the dim flank decides on the bright mirror
    direction. Where none holds, or residuals exceed twice the unstated noise, that of the smallest information
    criterion is taken. All uncertainties are from the scatter about the fit, so that the Birge ratio is in them.

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
    if len(grid.nm) < 2:
        raise UsageError(f"readings of one wavelength, {grid.nm[0]:g} nm: an ink needs two or more")
    if method == "paper":
        return _warned(_ink_fit(solve_as_published(grid), method, grid, readings.scale), share)
    count = int(np.isfinite(grid.value).sum())

    def test(found: Solution) -> Misfit:
        return misfit(found.form.words, found.chi2, count, found.parameters, known=noise is not None)

    def rival(form: Form) -> Solution:
        return solve_jointly(grid, share, form)

    matte = (partial(rival, Form(alpha=1.0)),)
    stages = ((partial(rival, Form("beckmann")), *matte),)
    solution, tests = best_model(solve_jointly(grid, share), stages, test, matte)
    chosen, bright = test(solution), None
    if solution.alpha < 1.0 and (chosen.rejected or (noise is None and chosen.chi2 > 4.0 * chosen.dof)):
        bright = _by_the_bright_part(grid, share, count)
        # an error of the peak hides what the flank says: a form that holds with it has to hold without
        if noise is not None and not test(bright).rejected:
            whole = solve_jointly(grid, share, bright.form, start=bright)
            tests = (*tests, test(whole))
            chosen = tests[-1]
            if not chosen.rejected:
                solution, bright = whole, None
    words = rejection_words(next(one for one in tests if one == chosen), tests)
    if bright is not None:
        words.append(
            f"residuals of {solution.form.words}, {100 * _rms(solution.residual):.2g} % rms, exceed twice the noise of "
            f"{100 * share:.2g} %: {bright.form.words} is fitted where the print is bright"
        )
        solution = bright
    found = _ink_fit(solution, method, grid, readings.scale)
    return _warned(replace(found, tests=tests, misfit=chosen, warnings=tuple(words)), share)


def _by_the_bright_part(grid: Grid, noise: float, count: int) -> Solution:
    """The fit of the smallest information criterion; bases are added one by one as long as it falls."""

    def criterion(one: Solution) -> float:
        return misfit("", one.chi2, count, one.parameters, known=False).bic

    plain = [solve_jointly(grid, noise, form, DIM) for form in (Form(), Form("beckmann"), Form(None))]
    now = plain[-1]
    while len(now.form.bases) < len(BASES):
        tries = []
        for name in BASES:
            if name in now.form.bases:
                continue
            try:
                form = replace(now.form, bases=(*now.form.bases, name))
                tries.append(solve_jointly(grid, noise, form, DIM, now))
            except UsageError:  # more parameters than readings
                continue
        better = min(tries, key=criterion, default=now)
        if criterion(better) >= criterion(now):
            break
        now = better
    for name in now.form.bases:  # which another may have made needless
        left = tuple(one for one in now.form.bases if one != name)
        now = min(now, solve_jointly(grid, noise, replace(now.form, bases=left), DIM, now), key=criterion)
    return min([*plain, now], key=criterion)


def _rms(residual: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(residual**2)))


def _ink_fit(solution: Solution, method: Method, grid: Grid, scale: str) -> InkFit:
    rho = np.exp(solution.log_rho)
    return InkFit(
        method, solution.alpha, solution.u_alpha, grid.nm, rho, rho * solution.u_log_rho, solution.c, solution.u_c,
        solution.residual, grid, scale, (), solution.distribution, solution.u_tail, solution.base, solution.u_light,
    )  # fmt: skip


def _warned(found: InkFit, noise: float) -> InkFit:
    warnings = [*found.warnings, *_coverage(found), *_misfit(found, noise)]
    if found.grid.dropped:
        reasons: dict[str, int] = {}
        for one in found.grid.dropped:
            reasons[one.reason] = reasons.get(one.reason, 0) + 1
        texts = ", ".join(f"{count} {reason}" for reason, count in reasons.items())
        warnings.append(f"{len(found.grid.dropped)} readings dropped: {texts}")
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
