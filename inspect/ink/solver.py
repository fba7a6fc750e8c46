"""Least squares of one form of an ink's light to goniometer readings.

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
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json
from anisoscope.ink.goniometer import Readings
from anisoscope.parameters.material import LONGEST_TAIL, SHORTEST_TAIL
from anisoscope.sim.light.ink.angles import shift
from anisoscope.sim.light.ink.distributions import Distribution, tail_of
from anisoscope.sim.light.ink.ink import MOST_C

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
_STEPS = 60
_CLOSE = 1e-9
_SETTLED, _NEARLY = 1e-9, 1e-6
"""Relative change of χ² at which a fit ends; of one by the bright part of a lobe that has another form."""
_WIDEST_STEP = 0.5
_GLOSS_STARTS = (0.0, 6.0)
"""c of a gloss where the search begins: as Fresnel's reflectance rises, and constant."""


@dataclass(frozen=True)
class Form:
    """Terms of the light that are fitted.

    Attributes:
        distribution: of the flakes' normals; None: its tail is fitted.
        alpha: roughness where it is not fitted; 1 is a matte print, whose ln f is linear.
        bases: terms that are added: "paper", matte, with a spectrum of its own; "gloss", a second lobe of no colour, of
            which roughness, level and c are fitted; "flakes", a second lobe of the same ρ and c.
    """

    distribution: Distribution | None = "ggx"
    alpha: float | None = None
    bases: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """The form in words."""
        names: dict[Distribution | None, str] = {
            "ggx": "the lobe of the paper (GGX)",
            "beckmann": "Beckmann's lobe",
            None: "a lobe of any tail",
        }
        lobe = "a matte print" if self.alpha == 1.0 else names[self.distribution]
        return " and ".join([lobe, *(BASES[one] for one in self.bases)])


BASES = {"paper": "paper", "gloss": "gloss", "flakes": "a second lobe"}


@dataclass(frozen=True, eq=False)
class Base:
    """A term that adds to the ink's light: its name in `BASES`, roughness, (W,) ln ρ and (W,) c."""

    name: str
    alpha: float
    log_rho: FloatArray = field(metadata=LEFT_OUT)
    c: FloatArray

    @property
    @in_json()
    def rho(self) -> FloatArray:
        """(W,) ρ, BRDF scale."""
        return np.exp(self.log_rho)


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
        u_tail: standard uncertainty of a fitted tail.
        base: terms that add to it.
        u_light: (G, W) standard uncertainty of ln of the fitted light; None of the published fit.
        chi2: weighted sum of squares; 0 where it was not asked for.
        parameters: number of fitted ones.
        form: terms that were fitted.
        shared: parameters that all wavelengths share, by name; logarithms but for the c of a gloss.
        each: (W, E) those of each wavelength: ln ρ, c, and ln ρ of paper.
    """

    alpha: float
    u_alpha: float
    log_rho: FloatArray
    u_log_rho: FloatArray
    c: FloatArray
    u_c: FloatArray
    residual: FloatArray
    distribution: Distribution = "ggx"
    u_tail: float = 0.0
    base: tuple[Base, ...] = ()
    u_light: FloatArray | None = None
    chi2: float = 0.0
    parameters: int = 0
    form: Form = Form()
    shared: dict[str, float] = field(default_factory=dict)
    each: FloatArray | None = None


def log_lobe(
    alpha: float, half_deg: FloatArray, tail: float = 1.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(G,) ln(D/4) at half angles, of Eq. 3 (tail 1), Beckmann's (0) or between; derivatives by ln α and ln tail."""
    slopes = (np.tan(np.radians(half_deg)) / alpha) ** 2
    level = -np.log(4.0 * np.pi * alpha**2) - 4.0 * np.log(np.cos(np.radians(half_deg)))
    if tail < SHORTEST_TAIL:
        return level - slopes, 2.0 * slopes - 2.0, np.zeros_like(slopes)
    rise, share = np.log1p(tail * slopes), slopes / (1.0 + tail * slopes)
    power = 1.0 + 1.0 / tail
    return level - power * rise, 2.0 * tail * power * share - 2.0, rise / tail - tail * power * share


class _Terms:
    """ln f of a form at places of a grid, with its derivatives by what all wavelengths share, and by those of each."""

    def __init__(self, grid: Grid, form: Form) -> None:
        self.grid, self.form = grid, form
        self.shared = [
            *(["alpha"] if form.alpha is None else []),
            *(["tail"] if form.distribution is None else []),
            *(["gloss alpha", "gloss c", "gloss"] if "gloss" in form.bases else []),
            *(["flakes alpha", "flakes"] if "flakes" in form.bases else []),
        ]
        ends = {
            "alpha": np.log(ALPHA_RANGE),
            "tail": np.log([SHORTEST_TAIL, LONGEST_TAIL]),
            "gloss alpha": np.log(ALPHA_RANGE),
            "gloss c": [-20.0, 20.0],
            "gloss": [-30.0, 5.0],
            "flakes alpha": np.log(ALPHA_RANGE),
            "flakes": [-20.0, 5.0],
        }
        self.ends = np.array([ends[name] for name in self.shared]).reshape(-1, 2)
        self.paper = "paper" in form.bases
        self.each = 3 if self.paper else 2

    def of(self, shared: FloatArray) -> dict[str, float]:
        """The shared parameters by name, with those that are held."""
        known = {"alpha": np.log(self.form.alpha or 1.0)}
        if self.form.distribution is not None:
            known["tail"] = np.log(max(tail_of(self.form.distribution), 1e-300))
        return known | dict(zip(self.shared, shared.tolist(), strict=True))

    def __call__(self, shared: FloatArray, each: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(G, W) ln f, (G, W, shared) and (G, W, each) derivatives, at (shared,) and (W, each) parameters."""
        at, x, half = self.of(shared), self.grid.x[:, None], self.grid.half_deg
        dark, still = np.full((len(x), 1), -np.inf), np.zeros(len(x))
        lobe, wider, longer = log_lobe(np.exp(at["alpha"]), half, np.exp(at["tail"]))
        (level, blunter, _), (second, steeper, _) = (
            log_lobe(np.exp(at[name]), half, 0.0) if name in at else (None, still, still)
            for name in ("gloss alpha", "flakes alpha")
        )
        colour = each[:, 0] + each[:, 1] * x
        own = lobe[:, None] + colour
        paper = each[:, 2] - np.log(4.0 * np.pi) if self.paper else dark
        gloss = dark if level is None else level[:, None] + at["gloss"] + at["gloss c"] * x
        flakes = dark if second is None else second[:, None] + at["flakes"] + colour
        total = np.logaddexp(np.logaddexp(own, flakes), np.logaddexp(paper, gloss))
        part, other, matte, shiny = (np.exp(one - total) for one in (own, flakes, paper, gloss))
        slopes = {
            "alpha": part * wider[:, None],
            "tail": part * longer[:, None],
            "gloss alpha": shiny * blunter[:, None],
            "gloss c": shiny * x,
            "gloss": shiny,
            "flakes alpha": other * steeper[:, None],
            "flakes": other,
        }
        ink = part + other
        of_each = [ink, ink * x, matte][: self.each]
        of_shared = [slopes[name] for name in self.shared]
        empty = np.zeros((*total.shape, 0))
        return total, np.stack(of_shared, axis=-1) if of_shared else empty, np.stack(of_each, axis=-1)


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations in which wavelengths meet only in what they share: S shared and E own parameters of each.

    Attributes:
        rest: (W, G) residuals; these and the derivatives are divided by the uncertainty of a reading.
        shared: (W, G, S) derivatives.
        each: (W, G, E).
    """

    rest: FloatArray
    shared: FloatArray
    each: FloatArray

    @property
    def cost(self) -> float:
        """Weighted sum of squares."""
        return float(np.vdot(self.rest, self.rest))

    def inverse_of_each(self, damping: float = 0.0) -> FloatArray:
        """(W, E, E) inverse of what belongs to one wavelength."""
        own = self.each.mT @ self.each
        scale = np.einsum("wii->wi", own)
        return np.asarray(np.linalg.inv(own + (damping + 1e-14) * scale[:, :, None] * np.eye(own.shape[-1])))

    def turned(self, inverse: FloatArray) -> FloatArray:
        """(W, E, S) by how much the own parameters follow the shared ones."""
        return np.asarray(inverse @ (self.each.mT @ self.shared))

    def freed(self, turned: FloatArray) -> FloatArray:
        """(W, G, S) derivatives by the shared parameters where the own ones follow."""
        return np.asarray(self.shared - self.each @ turned)

    def step(self, damping: float) -> tuple[FloatArray, FloatArray]:
        """(S,) and (W, E) step of Gauss and Newton, damped."""
        inverse = self.inverse_of_each(damping)
        turned = self.turned(inverse)
        shared = np.zeros(self.shared.shape[-1])
        if shared.size:
            freed = self.freed(turned)
            left = (freed.mT @ self.shared).sum(axis=0)
            left = left + damping * np.diag(np.diag(left)) + 1e-30 * np.eye(len(left))
            pull = (freed.mT @ self.rest[..., None]).sum(axis=0)[:, 0]
            shared = np.linalg.lstsq(left, pull, rcond=1e-13)[0]
        own = inverse @ (self.each.mT @ self.rest[..., None])
        return shared, own[..., 0] - turned @ shared


def _normal(
    terms: _Terms, weight: FloatArray, logs: FloatArray, shared: FloatArray, each: FloatArray
) -> _Normal:
    value, of_shared, of_each = terms(shared, each)
    white = np.sqrt(weight)
    slopes = (np.moveaxis(white[..., None] * one, 0, 1) for one in (of_shared, of_each))
    return _Normal((white * (logs - value)).T, *slopes)


def _settled(
    terms: _Terms,
    weight: FloatArray,
    logs: FloatArray,
    shared: FloatArray,
    each: FloatArray,
    end: float = _SETTLED,
) -> tuple[FloatArray, FloatArray, _Normal]:
    """Parameters of least squares by damped steps, and their normal equations."""
    now, damping = _normal(terms, weight, logs, shared, each), 0.0
    for _ in range(_STEPS):
        of_shared, of_each = now.step(damping)
        most = float(np.abs(of_shared).max(initial=0.0))
        share = min(1.0, _WIDEST_STEP / max(most, 1e-300))
        trial = np.clip(shared + share * of_shared, *terms.ends.T)
        own = each + share * np.clip(of_each, -3.0, 3.0)
        own[:, 1] = np.clip(own[:, 1], -MOST_C, MOST_C)
        after = _normal(terms, weight, logs, trial, own)
        if after.cost <= now.cost or not np.isfinite(now.cost):
            close = max(most, float(np.abs(of_each).max())) < _CLOSE
            less = now.cost - after.cost <= end * now.cost
            shared, each, now, damping = trial, own, after, 0.1 * damping if damping > 1e-6 else 0.0
            if close or (less and damping == 0.0):
                break
        else:
            if most < _CLOSE and float(np.abs(of_each).max()) < _CLOSE:
                break
            damping = max(10.0 * damping, 1e-4)
            if damping > 1e8:
                break
    return shared, each, now


def solve_jointly(
    grid: Grid, noise: float, form: Form | None = None, dim: float = 0.0, start: Solution | None = None
) -> Solution:
    """Fit all readings of a grid.

    Args:
        grid: the readings.
        noise: relative standard deviation of a reading, in addition to the floor of the grid. It sets the weights only;
            the uncertainties come from the scatter about the fit.
        form: terms that are fitted; GGX if None.
        dim: standard deviation of every reading besides, as a share of the largest one of its wavelength: where the
            lobe has another form, its bright part counts.
        start: a fit of fewer bases or of the same, where the search begins; needed where there are bases.

    Raises:
        UsageError: readings that do not separate ρ from c, or do not determine the width of the lobe.
    """
    chosen = form or Form()
    given = np.isfinite(grid.value)
    terms, logs = _Terms(grid, chosen), np.log(np.where(given, grid.value, 1.0))
    level = np.exp(logs)
    floor = np.hypot(grid.floor, dim * np.max(np.where(given, grid.value, 0.0), axis=0))

    def weights() -> FloatArray:
        return np.where(given, 1.0 / (noise**2 + (floor / level) ** 2), 0.0)

    weight = weights()
    _check_angles(grid, weight)
    parameters = len(terms.shared) + terms.each * len(grid.nm)
    freedom = int(given.sum()) - parameters
    if freedom < 1:
        raise UsageError(f"{int(given.sum())} readings for {parameters} parameters: measure at more angles")
    starts = [_start(terms, weight, logs)] if start is None else _more(terms, weight, logs, start)
    tries = [_settled(terms, weight, logs, *one, _NEARLY if dim else _SETTLED) for one in starts]
    shared, each, now = min(tries, key=lambda one: one[2].cost)
    if chosen.alpha is None:
        _check_width(now, weight)
    # where the bright part counts, a flank that the fit misses must not weigh less the more it is missed
    for _ in range(_REWEIGHTED if dim == 0.0 else 0):
        level = np.exp(terms(shared, each)[0])
        weight = weights()
        shared, each, now = _settled(terms, weight, logs, shared, each)
    return _finish(terms, weight, shared, each, now, freedom)


def _start(terms: _Terms, weight: FloatArray, logs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where the search of a fit without bases begins: the best of some roughnesses."""
    form = terms.form
    tail = [] if form.distribution is not None else [np.log(0.5)]
    found = []
    for width in [[]] if form.alpha is not None else [[np.log(one)] for one in _STARTS]:
        shared, each = np.array([*width, *tail]), np.zeros((len(terms.grid.nm), 2))
        held = _normal(terms, weight, logs, shared, each)
        each = each + replace(held, shared=held.shared[..., :0]).step(0.0)[1]  # linear without a base
        found.append((_normal(terms, weight, logs, shared, each).cost, shared, each))
    return min(found, key=lambda one: one[0])[1:]


def _more(
    terms: _Terms, weight: FloatArray, logs: FloatArray, before: Solution
) -> list[tuple[FloatArray, FloatArray]]:
    """Where the search begins that adds a base to a fit: half of the flakes' level, half or twice their roughness."""
    assert before.each is not None
    known, each = before.shared, before.each[:, : terms.each]
    if terms.each > each.shape[1]:
        least = np.min(np.where(weight > 0.0, logs, np.inf), axis=0)
        each = np.column_stack([each, least + np.log(2.0 * np.pi)])
    low, high = np.log(ALPHA_RANGE)
    narrow, wide = (float(np.clip(known["alpha"] + step, low, high)) for step in (-np.log(2.0), np.log(2.0)))
    guesses: list[dict[str, float]] = [{}]
    if "gloss" in terms.shared and "gloss" not in known:
        top = float(np.median(np.max(np.where(weight > 0.0, logs, -np.inf), axis=0)))
        of_gloss = {"gloss alpha": narrow, "gloss": top + np.log(2.0 * np.pi) + 2.0 * narrow}
        guesses = [{**of_gloss, "gloss c": c} for c in _GLOSS_STARTS]
    elif "flakes" in terms.shared and "flakes" not in known:
        guesses = [{"flakes alpha": width, "flakes": -1.0} for width in (narrow, wide)]
    return [(np.array([(known | one)[name] for name in terms.shared]), each) for one in guesses]


def _check_angles(grid: Grid, weight: FloatArray) -> None:
    total = weight.sum(axis=0)
    apart = grid.x[:, None] - (grid.x @ weight) / total
    alike = np.sum(weight * apart**2, axis=0) <= 1e-9 * total
    if np.any(alike):
        raise UsageError(
            f"at {grid.nm[int(np.argmax(alike))]:g} nm all readings have the same sum of angles, which does not tell "
            "rho from c: measure at several angles of the light"
        )


def _check_width(now: _Normal, weight: FloatArray) -> None:
    freed = now.freed(now.turned(now.inverse_of_each()))[..., 0]
    if np.vdot(freed, freed) <= 1e-6 * weight.sum():
        raise UsageError(
            "the readings do not say how wide the lobe is: measure away from the mirror direction as well as in it"
        )


def _finish(
    terms: _Terms, weight: FloatArray, shared: FloatArray, each: FloatArray, now: _Normal, freedom: int
) -> Solution:
    scatter, inverse = now.cost / freedom, now.inverse_of_each()
    turned = now.turned(inverse)
    freed = now.freed(turned)
    covariance = _of_shared(now, freed, scatter)
    own = scatter * inverse + turned @ covariance @ turned.mT
    u_each = np.sqrt(np.einsum("wii->wi", own))
    light = scatter * np.sum(now.each @ inverse * now.each, axis=-1)
    light = (light + np.sum(freed @ covariance * freed, axis=-1)).T
    given, inside = weight > 0.0, np.maximum(weight, 1e-300)
    form, at, u = (
        terms.form,
        terms.of(shared),
        dict(zip(terms.shared, np.sqrt(np.diag(covariance)), strict=True)),
    )
    alpha, tail = float(np.exp(at["alpha"])), float(np.exp(at["tail"]))
    c, base = each[:, 1], []
    for name in form.bases:
        if name == "paper":
            base.append(Base(name, 1.0, each[:, 2], np.zeros_like(c)))
        else:
            gloss = name == "gloss"
            colour = (np.zeros_like(c), np.full_like(c, at["gloss c"])) if gloss else (each[:, 0], c)
            base.append(Base(name, float(np.exp(at[f"{name} alpha"])), at[name] + colour[0], colour[1]))
    return Solution(
        alpha,
        alpha * float(u.get("alpha", 0.0)),
        each[:, 0],
        u_each[:, 0],
        each[:, 1],
        u_each[:, 1],
        np.where(given, now.rest.T / np.sqrt(inside), np.nan),
        tail if form.distribution is None else form.distribution,
        tail * float(u.get("tail", 0.0)),
        tuple(base),
        np.where(given, np.sqrt(light / inside), np.nan),
        now.cost,
        now.shared.shape[-1] + each.size,
        form,
        at,
        each,
    )


def _of_shared(now: _Normal, freed: FloatArray, scatter: float) -> FloatArray:
    """(S, S) covariance of what all wavelengths share, from single readings, enlarged where places say so."""
    if not freed.shape[-1]:
        return np.zeros((0, 0))
    inverse = np.linalg.pinv((freed.mT @ freed).sum(axis=0), rcond=1e-13, hermitian=True)
    score = np.sum(freed * now.rest[..., None], axis=0)
    of_places = inverse @ (score.T @ score) @ inverse * len(score) / (len(score) - 1)
    found = scatter * inverse
    more = np.sqrt(np.maximum(np.diag(of_places) / np.maximum(np.diag(found), 1e-300), 1.0))
    return np.asarray(found * np.outer(more, more))


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
