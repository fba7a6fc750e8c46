"""Predictive test: is a part like n golden parts of its rig, for any n from one on?

A part's contrasts are y = f(θ) + b + G s + e: b is common to all parts of a rig (material, light angle, error of the
model), s differs from part to part, e from inspection to inspection. The mean of n golden parts replaces f + b. The
shape of the scatter about it is known beforehand from recipe ([scatter]) and measurement: W, the covariance of y for a
given material, averaged over what the material may be, through the response to second order. Its size is that of the
golden parts, W·s² with s² = (ν₀ + q)/(ν₀ + m(n − 1)) and q = Σ (y − ȳ)ᵀW⁻¹(y − ȳ): the stated size counts as much as
ν₀ = `PRIOR_FREEDOM` degrees of freedom (scaled inverse χ² prior; Gelman et al., Bayesian Data Analysis, 2.6). The
statistics take the lesser of the stated size and s² with what few parts leave unknown of it, so that one part serves,
three replace what was stated where parts scatter less, and little is lost where they do not. Drawn parts have the
stated size. With a smaller one the statistics are smaller, so that the level holds for every size up to the stated one.
Golden parts that scatter more than stated, beyond chance, are believed.

Golden parts of one lot or day share what differs between lots and days: their mean is only as good as that of as many
parts as there are batches, and their scatter shows less than that of good parts (`assumed_size`).

Two statistics share the level: T² of all contrasts, and the scores of the deviation in the directions of the named
defects, sᵀV⁻¹d/√(sᵀV⁻¹s), each the likelihood ratio of this defect against a good part (Neyman and Pearson 1933).
The distribution of T² and of each score is simulated: golden sets and parts drawn from the same model. The scores share
their part of the level so that the sum of the powers is greatest (Spjøtvoll, Ann. Math. Statist. 43 (1972) 398): a
defect that is found anyway leaves its share to one that is not. The shares depend on what is stated and on the number
of golden parts, not on the part (Genovese, Roeder and Wasserman, Biometrika 93 (2006) 509). The least p value over its
share is counted among the drawn parts as well, so that p is uniform and the level used up although the tests depend on
each other (Westfall and Young, Resampling-Based Multiple Testing, 1993, 2.3).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import ROUNDING, positive_part, root
from anisoscope.base.errors import MeasurementError
from anisoscope.base.significance import LEVELS, calibrated, calibrated_at, chi2_tail, f_tail, quantiles
from anisoscope.prediction.second_order import Response

PRIOR_FREEDOM = 0.5
"""Degrees of freedom as which the stated size of the scatter counts."""
MAX_BIRGE = 3.0
"""Ratio of the scatter among golden parts to the stated one beyond which the stated one is not theirs."""
NAMED_SHARE = 0.7
"""Share of the level for the named defects; the squared distance, which finds any other, has the rest."""
_EVEN = 0.2  # share of that level which the named defects have alike; the rest goes where it finds most
_COUNTED = np.concatenate([LEVELS[:-2], np.arange(0.3, 1.0, 0.1), [0.99, 0.999, 1.0]])
_PORTIONS = 100  # in which the rest is given away
_MATERIALS, _PARTS = 60, 300  # draws of what all parts share, and parts for each
_SETS, _NEW = 150, 60  # golden sets, and new parts for each
_SEED = 11
_SMALLEST = 1e-300
_SCORES = np.linspace(0.0, 15.0, 301)
_STEPS = 300  # of the estimate of variance components
LEARNING_PARTS = 10
"""Number of golden parts that a stated scatter is worth where golden parts of another recipe correct it."""
_TAIL = 0.001  # for which the size is taken: about the share of the level that a named defect has
_BETWEEN = 0.5  # share of the variance of good parts that is between batches, where the batches are few
_DETERMINED = 0.5  # degrees of freedom below which an input is not determined


@dataclass(frozen=True, eq=False)
class Scatter:
    """Scatter of the contrasts of good parts on one rig.

    Attributes:
        response: change of the m contrasts with K inputs, to second order.
        common: (K,) standard deviations of what all parts share, in the response's units.
        own: (K,) standard deviations of what differs from part to part, likewise.
        errors: (m, m) covariance of the errors of one inspection.
        defects: (m,) change of the contrasts by every named defect at its smallest interesting size.
        lobes: responses with every tail that the lobe may as likely have; all parts of a rig have the same. Without
            any it is known, and ``response`` is that of its parts.
        states: of the defects that are a state of one input, the input and how far it is off in the response's units:
            parts with a defect scatter as the response bends there.
        prior_parts: number of golden parts as which the stated scatter counts, shape and size (inverse Wishart prior;
            Gelman et al., 3.6); None: golden parts show its size.
    """

    response: Response
    common: FloatArray
    own: FloatArray
    errors: FloatArray
    defects: Mapping[str, FloatArray]
    lobes: tuple[Response, ...] = ()
    states: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    prior_parts: int | None = None

    def drawn(self, shared: FloatArray, parts: int, rng: np.random.Generator) -> FloatArray:
        """(N, parts, m) contrasts of good parts, for (N, K) states of what all parts share; the lobes take turns."""
        count, k = shared.shape
        states = shared[:, None] + self.own * rng.standard_normal((count, parts, k))
        errors = rng.standard_normal((count, parts, len(self.errors))) @ root(self.errors)
        lobes = self.lobes or (self.response,)
        for turn, lobe in enumerate(lobes):
            errors[turn :: len(lobes)] += lobe.change(states[turn :: len(lobes)])
        return np.asarray(errors)

    def shared(self, count: int, rng: np.random.Generator) -> FloatArray:
        """(N, K) states of what all parts share."""
        return np.asarray(self.common * rng.standard_normal((count, len(self.common))))

    @cached_property
    def covariance(self) -> FloatArray:
        """(m, m) W: covariance of the parts of one rig, averaged over what the material may be."""
        rng = np.random.default_rng(_SEED)
        parts = self.drawn(self.shared(_MATERIALS, rng), _PARTS, rng)
        off = parts - parts.mean(axis=1, keepdims=True)
        return np.asarray(np.einsum("npi,npj->ij", off, off) / (_MATERIALS * (_PARTS - 1.0)))

    def covariance_with(self, defect: str) -> FloatArray:
        """(m, m) covariance of parts with a defect, by the tangents in its state; of good parts where it is none."""
        if defect not in self.states:
            return self.covariance
        source, extent = self.states[defect]
        state = extent * (np.array(self.response.sources) == source)
        lobes = self.lobes or (self.response,)
        tangents = np.array([lobe.tangent(state) for lobe in lobes]) * self.own
        return np.asarray(np.mean(tangents @ tangents.transpose(0, 2, 1), axis=0) + self.errors)


@dataclass(frozen=True)
class Direction:
    """Test for one named defect.

    Attributes:
        defect: its name.
        score: of the part in its direction, in standard deviations of good parts.
        p_value: of the score for a good part, adjusted for the other directions and the distance.
        separation: mean score of a part with this defect at its smallest interesting size.
        power: probability that a part with this defect is significant.
        detectable: multiple of the smallest interesting size that is significant in 9 of 10 parts, which scatter as
            those of that size.
    """

    defect: str
    score: float
    p_value: float
    separation: float
    power: float
    detectable: float


@dataclass(frozen=True)
class PredictiveTest:
    """Result of the predictive test.

    Attributes:
        t2: squared distance from the mean of the golden parts.
        dof: number of contrasts.
        p_value: of both statistics together, for a good part.
        p_distance: of the squared distance alone.
        p_direction: the least of the directions; None without named defects.
        directions: one a named defect.
        birge: ratio of the golden parts' scatter to the stated one; None for a single golden part.
        size: s², variance of good parts over the stated one, as the golden parts and the stated size have it together.
    """

    t2: float
    dof: int
    p_value: float
    p_distance: float
    p_direction: float | None
    directions: tuple[Direction, ...]
    birge: float | None
    size: float = 1.0

    @property
    def strongest(self) -> Direction | None:
        """The named defect that the part is most like, where its score decides and not the distance."""
        if self.p_direction is None or self.p_direction > self.p_value:
            return None
        return min(self.directions, key=lambda one: (one.p_value, -one.score))


def birge_ratio(golden: FloatArray, covariance: FloatArray) -> float | None:
    """Scatter among (n, m) golden contrasts over the stated (m, m) one: about 1 where it is theirs; None for n = 1.

    Σ (g − ḡ)ᵀ W⁻¹ (g − ḡ) / (m (n − 1)); Birge 1932.
    """
    count, m = golden.shape
    if count < 2:
        return None
    off = golden - golden.mean(axis=0)
    return float(np.einsum("ni,ij,nj->", off, np.linalg.inv(covariance), off) / (m * (count - 1.0)))


def size_of(golden: FloatArray, stated: FloatArray) -> float:
    """Size s² of the scatter of good parts, as a multiple of the stated (m, m) covariance.

    The stated size counts as `PRIOR_FREEDOM` degrees of freedom; of a single part it is all that is known. Tests and
    limits take what `assumed_size` makes of it.

    Args:
        golden: (n, m) contrasts of golden parts.
        stated: (m, m) covariance.
    """
    off = golden - golden.mean(axis=0)
    squares = float(np.einsum("ni,ij,nj->", off, np.linalg.inv(stated), off))
    return float(_size(np.array(squares), golden.shape[1], len(golden)))


def size_interval(golden: FloatArray, stated: FloatArray) -> tuple[float, float] | None:
    """95 % interval of the size that golden parts alone show, by χ²; None for one part."""
    from scipy.special import chdtri  # noqa: PLC0415 - start-up time

    ratio, free = birge_ratio(golden, stated), golden.shape[1] * (len(golden) - 1.0)
    if ratio is None:
        return None
    return ratio * free / float(chdtri(free, 0.025)), ratio * free / float(chdtri(free, 0.975))


def _size(squares: FloatArray, m: int, count: int) -> FloatArray:
    return np.asarray((PRIOR_FREEDOM + squares) / (PRIOR_FREEDOM + m * (count - 1.0)))


def assumed_size(
    size: FloatArray | float, m: int, count: int, tail: float, batches: int | None = None
) -> FloatArray:
    """Size of the scatter for a probability ``tail``: the stated one, or that of the golden parts where it is less.

    That of the golden parts is multiplied by the square of Student's quantile over the normal one, for what few parts
    leave unknown. Parts of few batches show little of what differs between batches: half of the variance is taken to be
    of that kind, and the size is divided by the share that they show on average. A size that is greater than the stated
    one beyond chance (95 %) stays.

    Args:
        size: (…) s² of `size_of`.
        m: number of contrasts.
        count: golden parts.
        tail: one-sided probability of the quantiles.
        batches: of the golden parts, alike in size; None: the parts are independent.
    """
    from scipy.special import chdtri, ndtri, stdtrit  # noqa: PLC0415 - start-up time

    free = m * (count - 1.0)
    if free == 0.0:
        return np.ones_like(np.asarray(size, dtype=np.float64))
    wider = (stdtrit(_freedom(m, count), 1.0 - tail) / ndtri(1.0 - tail)) ** 2
    several = min(batches or count, count)
    shown = 1.0 - _BETWEEN + _BETWEEN * (count - count / several) / (count - 1.0)
    squares = np.asarray(size) * (PRIOR_FREEDOM + free) - PRIOR_FREEDOM
    contradicts = squares > float(chdtri(free, 0.025))
    return np.where(contradicts, size, np.minimum(wider / shown * np.asarray(size), 1.0))


def _freedom(m: int, count: int) -> float:
    """Degrees of freedom of χ² with the relative variance that the size has for parts of the stated one."""
    free = m * (count - 1.0)
    return (PRIOR_FREEDOM + free) ** 2 / free if free > 0.0 else np.inf


def predictive_test(
    scatter: Scatter, golden: FloatArray, value: FloatArray, alpha: float, batches: int | None = None
) -> PredictiveTest:
    """Test a part against golden parts.

    Args:
        scatter: of good parts on this rig.
        golden: (n, m) contrasts of the golden parts, n ≥ 1.
        value: (m,) of the part.
        alpha: level of significance at which powers are computed, and for which the tests share the level.
        batches: number of lots or days of the golden parts, at most n; None: the parts are independent.

    Raises:
        MeasurementError: there is no golden part, or the stated scatter is zero in some direction.
    """
    stated, count = _checked(scatter, golden), len(golden)
    several = _several(scatter, count, batches)
    null = _null_of(scatter, count, several)
    size = size_of(golden, stated)
    inverse = _precision(scatter, golden, several)
    d = value - golden.mean(axis=0)
    t2 = float(d @ inverse @ d)
    p_distance = float(calibrated_at(null.distance_theory(np.array([t2])), null.knots[0])[0])
    names = tuple(scatter.defects)
    if not names:
        birge = birge_ratio(golden, stated)
        return PredictiveTest(t2, len(d), p_distance, p_distance, None, (), birge, size)
    shifts = np.array([scatter.defects[name] for name in names])
    separation = np.sqrt(np.einsum("ci,ij,cj->c", shifts, inverse, shifts))
    scores = shifts @ inverse @ d / np.maximum(separation, 1e-12)
    levels = _levels(scatter, count, several, alpha)
    chances = levels.adjusted(null.score_chances(scores) / levels.shares)
    p_direction = float(chances.min())
    return PredictiveTest(
        t2,
        len(d),
        min(p_direction, float(levels.adjusted(np.array([p_distance / levels.of_distance]))[0])),
        p_distance,
        p_direction,
        _directions(names, scores, chances, separation, levels),
        birge_ratio(golden, stated),
        size,
    )


def separations(
    scatter: Scatter, count: int, alpha: float, size: float = 1.0, batches: int | None = None
) -> tuple[Direction, ...]:
    """Power of ``count`` golden parts for each named defect; of no part: scores are zero, p values one.

    Args:
        scatter: of good parts on this rig.
        count: golden parts, 1 or more.
        alpha: level of significance of the verdict.
        size: variance of good parts over the stated one.
        batches: number of lots or days of the golden parts; None: the parts are independent.
    """
    several = _several(scatter, count, batches)
    levels = _levels(scatter, count, several, alpha)
    m = len(scatter.errors)
    learnt = _size(np.array(size * m * (count - 1.0)), m, count)
    usual = float(assumed_size(learnt, m, count, _TAIL, several)) if scatter.prior_parts is None else 1.0
    none, separation = np.zeros(len(levels.limits)), _stated(scatter, several)[0] / np.sqrt(usual)
    levels = replace(levels, spreads=levels.spreads * np.sqrt(size / usual))
    return _directions(tuple(scatter.defects), none, none + 1.0, separation, levels)


def detectable(
    scatter: Scatter, count: int, alpha: float, size: float = 1.0, batches: int | None = None
) -> dict[str, float]:
    """Multiple of each named defect's smallest size that ``count`` golden parts show in 9 of 10 parts."""
    return {one.defect: one.detectable for one in separations(scatter, count, alpha, size, batches)}


def separating_areas(scatter: Scatter) -> dict[str, float]:
    """Area under the curve of the directed test of each defect, its scatter known: by simulation.

    The probability that the score of a part with the defect at its smallest interesting size exceeds that of a good
    part; both scatter alike, and the defect adds its change.
    """
    rng = np.random.default_rng(_SEED)
    parts = scatter.drawn(scatter.shared(_MATERIALS, rng), _PARTS, rng)
    off = (parts - parts.mean(axis=1, keepdims=True)).reshape(-1, parts.shape[-1])
    inverse = np.linalg.inv(scatter.covariance)
    found = {}
    for name, shift in scatter.defects.items():
        good = np.sort(off @ inverse @ shift)
        bad = good + shift @ inverse @ shift
        found[name] = float(np.mean(np.searchsorted(good, bad) / len(good)))
    return found


@dataclass(frozen=True)
class SuggestedScatter:
    """Scatter of an input between the golden parts, as a multiple of the stated one.

    Attributes:
        source: the input.
        ratio: estimate.
        low: lower end of its 95 % interval.
        high: upper end; infinite where the golden parts do not determine it.
        freedom: degrees of freedom that the golden parts determine of it.
    """

    source: str
    ratio: float
    low: float
    high: float
    freedom: float


def suggested_scatter(scatter: Scatter, golden: FloatArray) -> tuple[SuggestedScatter, ...]:
    """Scatter of each input that differs between parts, estimated from golden parts.

    Maximum likelihood of the variance components of the linear response by expectation and maximisation (Dempster,
    Laird and Rubin 1977). Intervals by χ² with the degrees of freedom that the parts determine of each input: n − 1
    times the share by which they narrow it, with the stated scatter or with the estimate, whichever is less: a large
    estimate of an input that hardly shows would claim to be well known.

    Args:
        scatter: stated scatter.
        golden: (n, m) contrasts of golden parts, n ≥ 3.

    Raises:
        MeasurementError: fewer than three golden parts.
    """
    from scipy.special import chdtri  # noqa: PLC0415 - start-up time

    count = len(golden)
    if count < 3:
        raise MeasurementError(f"{count} golden parts do not show how parts scatter: at least 3 are needed")
    (slope, errors), off = _linear(scatter), golden - golden.mean(axis=0)
    variance, rest = np.ones(slope.shape[1]), np.ones(slope.shape[1])
    stated = np.einsum("km,mk->k", slope.T @ np.linalg.inv(slope @ slope.T + errors), slope)
    for _ in range(_STEPS):
        squares, rest = _expected(slope, errors, off, variance)
        variance = squares / (count - 1.0) + rest
    narrowed = np.clip(1.0 - rest / np.maximum(variance, 1e-300), 0.0, 1.0)
    known = (count - 1.0) * np.minimum(narrowed, stated)
    found = []
    for k, place in enumerate(np.flatnonzero(scatter.own > 0.0)):
        ratio, freedom = float(np.sqrt(variance[k])), float(known[k])
        low, high = 0.0, float("inf")
        if freedom > _DETERMINED:
            low, high = (ratio * float(np.sqrt(freedom / chdtri(freedom, tail))) for tail in (0.025, 0.975))
        found.append(SuggestedScatter(scatter.response.sources[place], ratio, low, high, freedom))
    return tuple(found)


def learnt_scatter(scatter: Scatter, golden: FloatArray, alike: Mapping[str, str]) -> dict[str, float]:
    """Scatter of inputs as golden parts correct what was stated, as multiples of it, for further parts of the plastic.

    Posterior mode of the variance components by expectation and maximisation (Dempster, Laird and Rubin 1977, 3.2 and
    4.4), the stated ones worth `LEARNING_PARTS` parts: what golden parts do not show keeps its stated scatter.

    Args:
        scatter: stated scatter.
        golden: (n, m) contrasts of golden parts, n ≥ 2.
        alike: by the input's source the name that inputs of one scatter share.

    Returns:
        The multiple by that name.
    """
    (slope, errors), off = _linear(scatter), golden - golden.mean(axis=0)
    names = [alike[scatter.response.sources[place]] for place in np.flatnonzero(scatter.own > 0.0)]
    groups = {name: np.array([one == name for one in names]) for name in dict.fromkeys(names)}
    variance, free = np.ones(len(names)), len(golden) - 1.0
    for _ in range(_STEPS):
        squares, rest = _expected(slope, errors, off, variance)
        for group in groups.values():
            total = float(np.sum((squares + free * rest)[group]))
            variance[group] = (LEARNING_PARTS + total) / (LEARNING_PARTS + free * np.count_nonzero(group))
    return {name: float(np.sqrt(variance[group][0])) for name, group in groups.items()}


def _linear(scatter: Scatter) -> tuple[FloatArray, FloatArray]:
    """Linear response to what differs between parts, and the rest of their covariance.

    Returns:
        (m, k) change by one stated standard deviation of each input, and the (m, m) covariance of what is not linear in
        them, besides the errors of an inspection: without it inputs that hardly show would explain it.
    """
    varies = np.flatnonzero(scatter.own > 0.0)
    slope = scatter.response.slope[:, varies] * scatter.own[varies]
    return slope, scatter.errors + positive_part(scatter.covariance - slope @ slope.T - scatter.errors)


def _expected(
    slope: FloatArray, errors: FloatArray, off: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(k,) sums of the squares of the expected inputs, and their remaining variances, given (n, m) deviations."""
    gain = (slope * variance).T @ np.linalg.inv((slope * variance) @ slope.T + errors)
    rest = variance * (1.0 - np.einsum("km,mk->k", gain, slope))
    return np.sum((off @ gain.T) ** 2, axis=0), rest


def _directions(
    names: tuple[str, ...],
    scores: FloatArray,
    chances: FloatArray,
    separation: FloatArray,
    levels: "_Levels",
) -> tuple[Direction, ...]:
    from scipy.special import ndtr, ndtri  # noqa: PLC0415 - start-up time

    return tuple(
        Direction(
            name,
            float(score),
            float(chance),
            float(mean),
            float(ndtr((mean - limit) / spread)),
            float((limit + spread * ndtri(0.9)) / mean) if mean > 0.0 else float("inf"),
        )
        for name, score, chance, mean, limit, spread in zip(
            names, scores, chances, separation, levels.limits, levels.spreads, strict=True
        )
    )


def _checked(scatter: Scatter, golden: FloatArray) -> FloatArray:
    if len(golden) == 0:
        raise MeasurementError(
            "there is no golden part to compare with: add one with `anisoscope golden add`"
        )
    stated = scatter.covariance
    values = np.linalg.eigvalsh(stated)
    if not values[0] > ROUNDING * max(values[-1], 1e-300):
        raise MeasurementError(
            "some contrast of good parts is stated without any uncertainty or scatter: state some under [uncertainty] "
            "or [scatter] in the recipe"
        )
    return stated


def _several(scatter: Scatter, count: int, batches: int | None) -> int:
    """Number of golden parts as which their mean counts."""
    return count if scatter.prior_parts is not None else min(batches or count, count)


def _precision(scatter: Scatter, golden: FloatArray, batches: int) -> FloatArray:
    """(…, m, m) inverse covariance of a part about the mean of (…, n, m) golden ones."""
    *_, count, m = golden.shape
    off = golden - golden.mean(axis=-2, keepdims=True)
    prior = scatter.prior_parts
    if prior is not None:
        squares = np.einsum("...ni,...nj->...ij", off, off)
        covariance = (prior * scatter.covariance + squares) / (prior + count - 1.0)
        return np.asarray(np.linalg.inv(covariance * (1.0 + 1.0 / count)))
    weight = np.linalg.inv(scatter.covariance)
    size = _size(np.einsum("...ni,ij,...nj->...", off, weight, off), m, count)
    taken = assumed_size(size, m, count, _TAIL, batches) * (1.0 + 1.0 / batches)
    return np.asarray(weight / taken[..., None, None])


@dataclass(frozen=True, eq=False)
class _Null:
    """Distribution of both statistics for good parts, as p values of a simple theory, one for each drawn part.

    Attributes:
        m: number of contrasts.
        freedom: degrees of freedom of the scatter; infinite where its size alone is learnt.
        distances: (N,) p values of T² of drawn good parts by χ² or F.
        scores: for each named defect (N,) p values of the score of drawn good parts by the normal distribution, or
            Student's.
    """

    m: int
    freedom: float
    distances: FloatArray
    scores: tuple[FloatArray, ...]

    @cached_property
    def knots(self) -> tuple[FloatArray, ...]:
        """Quantiles of the distances and of the scores, at `LEVELS`."""
        return tuple(quantiles(one) for one in (self.distances, *self.scores))

    def distance_theory(self, t2: FloatArray) -> FloatArray:
        """P values by χ² with m degrees of freedom, or by F."""
        if np.isinf(self.freedom):
            return np.maximum(chi2_tail(t2, self.m), _SMALLEST)
        rest = self.freedom - self.m + 1.0
        return np.maximum(f_tail(t2 * rest / (self.freedom * self.m), self.m, rest), _SMALLEST)

    def score_theory(self, scores: FloatArray) -> FloatArray:
        """P values of scores by the normal distribution or Student's, one-sided."""
        from scipy.special import ndtr, stdtr  # noqa: PLC0415 - start-up time

        below = ndtr(-scores) if np.isinf(self.freedom) else stdtr(self.freedom, -scores)
        return np.clip(below, _SMALLEST, 1.0)

    def score_chances(self, scores: FloatArray) -> FloatArray:
        """(C,) p values of the (C,) scores of a part, each by the drawn good parts' scores in its direction."""
        pairs = zip(self.score_theory(scores)[:, None], self.knots[1:], strict=True)
        return np.array([float(calibrated_at(one, at)[0]) for one, at in pairs])

    def score_limits(self, levels: FloatArray) -> FloatArray:
        """(..., C) scores beyond which each direction is significant at (..., C) levels."""
        theory = self.score_theory(_SCORES)
        chances = [calibrated_at(theory, at) for at in self.knots[1:]]
        return np.stack([np.interp(-levels[..., k], -one, _SCORES) for k, one in enumerate(chances)], axis=-1)


def _stated(scatter: Scatter, batches: int) -> tuple[FloatArray, FloatArray]:
    """(C,) means and standard deviations of the scores of parts with the named defects, by the stated scatter."""
    inverse = np.linalg.inv(scatter.covariance * (1.0 + 1.0 / batches))
    shifts = np.array(list(scatter.defects.values()))
    separation = np.sqrt(np.einsum("ci,ij,cj->c", shifts, inverse, shifts))
    unit = shifts @ inverse / np.maximum(separation, 1e-12)[:, None]
    of_parts = (
        np.array([scatter.covariance_with(name) for name in scatter.defects]) + scatter.covariance / batches
    )
    return separation, np.sqrt(np.einsum("ci,cij,cj->c", unit, of_parts, unit))


@dataclass(frozen=True, eq=False)
class _Levels:
    """Shares of the level that the tests have.

    Attributes:
        of_distance: share of the squared distance.
        shares: (C,) share of each named defect; the sum of all shares is 1.
        least: (N,) least p value over its share of drawn good parts, times ``scale``, which makes it at most 1.
        scale: the smallest share.
        limits: (C,) scores beyond which a part is significant.
        spreads: (C,) standard deviations of the scores of parts with the defects.
    """

    of_distance: float
    shares: FloatArray
    least: FloatArray
    scale: float
    limits: FloatArray
    spreads: FloatArray

    @cached_property
    def knots(self) -> FloatArray:
        """Quantiles of ``least`` at `_COUNTED`."""
        return quantiles(self.least, _COUNTED)

    def adjusted(self, over_share: FloatArray) -> FloatArray:
        """P values over their shares as p values of all tests together."""
        return calibrated_at(np.minimum(self.scale * over_share, 1.0), self.knots, _COUNTED)


@lru_cache(maxsize=16)
def _levels(scatter: Scatter, count: int, batches: int, alpha: float) -> _Levels:
    null = _null_of(scatter, count, batches)
    rest = 1.0 - NAMED_SHARE
    separation, spreads = _stated(scatter, batches)
    shares = NAMED_SHARE * _shares(separation, spreads, null, alpha)
    drawn = [null.distances, *null.scores]
    over_share = [calibrated(one, one) / share for one, share in zip(drawn, (rest, *shares), strict=True)]
    scale = min(rest, float(shares.min()))
    found = _Levels(rest, shares, scale * np.min(over_share, axis=0), scale, shares, spreads)
    tried = np.geomspace(alpha, min(20.0 * alpha, 1.0 / scale), _PORTIONS)
    level = np.interp(np.log(alpha), np.log(found.adjusted(tried)), np.log(tried))
    return replace(found, limits=null.score_limits(np.exp(level) * shares))


def _shares(separation: FloatArray, spreads: FloatArray, null: _Null, alpha: float) -> FloatArray:
    """(C,) shares that the directions of the named defects have of their level; the sum is 1.

    Portion by portion to the direction whose power gains most: the greatest sum where powers are concave in the level.
    """
    from scipy.special import ndtr  # noqa: PLC0415 - start-up time

    directions = np.arange(len(separation))
    shares = _EVEN / len(separation) + (1.0 - _EVEN) * np.arange(_PORTIONS + 1.0) / _PORTIONS
    limits = null.score_limits(NAMED_SHARE * alpha * np.repeat(shares[:, None], len(separation), axis=1))
    gains = np.vstack(
        [np.diff(ndtr((separation - limits) / spreads), axis=0), np.full(len(separation), -1.0)]
    )
    portions = np.zeros(len(separation), dtype=int)
    for _ in range(_PORTIONS):
        portions[np.argmax(gains[portions, directions])] += 1
    return np.asarray(shares[portions])


@lru_cache(maxsize=16)
def _null_of(scatter: Scatter, count: int, batches: int) -> _Null:
    """Draw golden sets and new parts from the stated scatter; the mean is that of as many parts as batches."""
    rng = np.random.default_rng(_SEED + count)
    m, prior = len(scatter.errors), scatter.prior_parts
    drawn = scatter.drawn(scatter.shared(_SETS, rng), count + _NEW, rng)
    golden, parts = drawn[:, :count], drawn[:, count:]
    inverse = _precision(scatter, golden, batches)
    d = parts - golden[:, :batches].mean(axis=1, keepdims=True)
    t2 = np.einsum("spi,spi->sp", d @ inverse, d).ravel()
    bare = _Null(m, np.inf if prior is None else prior + count - 1.0, np.empty(0), ())
    distances = bare.distance_theory(t2)
    if not scatter.defects:
        return replace(bare, distances=distances)
    shifts = np.array(list(scatter.defects.values()))
    weighed = shifts @ inverse
    norms = np.sqrt(np.einsum("scj,cj->sc", weighed, shifts))
    scores = np.einsum("scj,spj->csp", weighed / norms[..., None], d)
    return replace(
        bare, distances=distances, scores=tuple(bare.score_theory(found.ravel()) for found in scores)
    )
