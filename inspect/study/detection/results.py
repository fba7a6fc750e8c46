"""Results of a detection study by world and recipe, as plain numbers, under several decision rules.

`shipped` is the rule of ``inspect``. The other rules show the effect of a better recipe or calibration on the same
measured radiances:

- `spread`: the recipe states the spread of the ridge angle of good parts.
- `known`: roughness and albedo of every part's batch have a third of the uncertainty.
- `golden`: T² against golden parts, with p from good parts drawn from the budget (as in ``inspect`` with golden parts).
- `normal`: as `golden`, with p from the normal distribution.
- `taught`: the prediction is shifted to the mean of the golden parts; the budget is unchanged.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.significance import calibrated, hotelling, log_basis
from anisoscope.decision.consistency_test import golden_chances
from anisoscope.diagnosis.separability import Separability
from anisoscope.prediction.expectation import Component, Expectation
from anisoscope.prediction.profile_likelihood import nearest
from anisoscope.prediction.second_order import Response
from anisoscope.sim.light.contrasts import consecutive_pairs
from anisoscope.study.detection.chunk import MEASURED_SOURCES
from anisoscope.study.detection.evaluation import (
    COVERAGE,
    SHARED_SOURCES,
    Area,
    Rate,
    area_under_curve,
    curve,
    diagnosed,
    fitted_shapes,
    histogram,
    intervals_held,
    rate,
    separability_of,
    threshold,
    true_extents,
    uniformity,
)
from anisoscope.study.detection.product import (
    BY_NAME,
    CLASSES,
    GOOD,
    RecipeName,
    Size,
    World,
    expected_of,
    recipe_of,
)

Columns = dict[str, npt.NDArray[Any]]
Rule = Literal["shipped", "spread", "known", "golden", "normal", "taught"]

RULES: tuple[Rule, ...] = ("shipped", "spread", "known", "golden", "normal", "taught")
OF_GOLDEN = ("golden", "normal", "taught")
GOLDEN_PARTS = 25
BETTER = 3.0
ALONG, ACROSS, ALBEDO = "roughness along the ridges", "roughness across the ridges", "albedo of the plastic"


@dataclass(frozen=True, eq=False)
class Bench:
    """Common inputs of all parts of one recipe: prediction, its components by name, and the golden parts.

    Attributes:
        expected: of the recipe.
        stated: of the recipe that also states the spread of the ridge angle.
        golden: (n, P) ln L over the prediction of the golden parts.
        size: of the study.
        name: of the recipe.
        drawn: p values of T² of good parts under the normal theory, drawn as in ``inspect``.
    """

    expected: Expectation
    stated: Expectation
    golden: FloatArray
    size: Size
    name: RecipeName
    drawn: FloatArray

    def response(self, *, spread: bool, better: float) -> Response:
        """That of the prediction, with the ridge angle of good parts, or with the material known better."""
        response = (self.stated if spread else self.expected).response
        assert response is not None
        known = (ALONG, ACROSS, ALBEDO)
        scale = np.array([1.0 / better if source in known else 1.0 for source in response.sources])
        return Response(response.sources, response.slope * scale, response.bend * np.outer(scale, scale))

    def spread(self) -> FloatArray:
        """(P, P) covariance of ln L that the spread of the ridge angle adds."""
        with_it, without = (
            np.sum([component.covariance() for component in expectation.components], axis=0)
            for expectation in (self.stated, self.expected)
        )
        return np.asarray(with_it - without)


def bench_of(name: RecipeName, size: Size, golden: FloatArray, own: FloatArray) -> Bench:
    """The bench of a recipe; ``golden``: (n, P), ``own``: (P, P) usual covariance of a measurement."""
    expected = expected_of(name, size)
    drawn = _drawn(expected, len(golden), own)
    return Bench(expected, expected_of(name, size, stated=True), golden, size, name, drawn)


def p_values(rule: Rule, data: Columns, kind: str, bench: Bench) -> FloatArray:
    """P value of the means of every part under a rule; NaN for an INVALID part.

    Args:
        rule: the rule.
        data: columns of one class.
        kind: the class.
        bench: recipe and golden parts.
    """
    name = bench.name
    deviation = np.asarray(data[f"{name}/deviation"], dtype=np.float64)
    own = covariance_of_measurement(data[f"{name}/own"])
    if rule in ("golden", "normal"):
        basis = log_basis(deviation.shape[1])
        normal = _against_golden(deviation @ basis.T, bench.golden @ basis.T)
        return normal if rule == "normal" else calibrated(normal, bench.drawn)
    response = bench.response(spread=rule != "shipped", better=BETTER if rule == "known" else 1.0)
    alone = own + np.sum([component.covariance() for component in bench.expected.alone], axis=0)
    if rule == "known":
        deviation = deviation - _known(data, kind, bench)
    if rule == "taught":
        count = len(bench.golden)
        deviation = deviation - bench.golden.mean(axis=0)
        # the mean of the golden parts is as good as the budget of one by their number
        return _chi2(deviation / np.sqrt(1.0 + 1.0 / count), alone, response)
    return _chi2(deviation, alone, response)


def _drawn(expected: Expectation, count: int, own: FloatArray) -> FloatArray:
    basis = log_basis(len(own))
    alone = own + np.sum([component.covariance() for component in expected.alone], axis=0)
    assert expected.response is not None
    return golden_chances(expected.response.within(basis), basis @ alone @ basis.T, count)


def _against_golden(values: FloatArray, golden: FloatArray) -> FloatArray:
    """P values of `significance.hotelling` for many (N, m) parts against the same golden ones (n, m)."""
    from scipy.stats import f  # noqa: PLC0415 - 1 s

    first, _ = hotelling(values[0], golden)
    n, m = golden.shape
    off = values - golden.mean(axis=0)
    scatter = np.cov(golden, rowvar=False)
    t2 = n / (n + 1.0) * np.einsum("ni,ni->n", off, np.linalg.solve(scatter, off.T).T)
    assert np.isclose(t2[0], first)
    return np.asarray(f.sf(t2 * (n - m) / (m * (n - 1.0)), m, n - m))


def covariance_of_measurement(own: FloatArray) -> FloatArray:
    """(N, P, P) covariances from the (N, S, P) components of the measurements."""
    shared = np.array([source in SHARED_SOURCES for source in MEASURED_SOURCES])
    alone = np.sum(own[:, ~shared] ** 2, axis=1)
    together = np.einsum("nsi,nsj->nij", own[:, shared], own[:, shared])
    return np.asarray(together + alone[:, :, None] * np.eye(own.shape[2]))


def distances(deviation: FloatArray, covariance: FloatArray) -> FloatArray:
    """(N,) D² of (N, P) deviations of ln L with (N, P, P) covariances, the scale left out."""
    basis = log_basis(deviation.shape[1])
    off = deviation @ basis.T
    within = basis @ covariance @ basis.T
    return np.asarray(np.einsum("ni,ni->n", off, np.linalg.solve(within, off[..., None])[..., 0]))


def _chi2(deviation: FloatArray, alone: FloatArray, response: Response) -> FloatArray:
    """As `consistency_test.from_prediction`, with (N, P, P) covariances outside the response."""
    from scipy.stats import chi2  # noqa: PLC0415 - 1 s

    basis = log_basis(deviation.shape[1])
    d2 = nearest(response.within(basis), deviation @ basis.T, basis @ alone @ basis.T)
    return np.asarray(chi2.sf(d2, len(basis)))


def _known(data: Columns, kind: str, bench: Bench) -> FloatArray:
    """(N, P) change of ln L of every part's batch, known to a third of the recipe's uncertainty.

    Defects remain unknown.
    """
    part = recipe_of(bench.name, bench.size).material
    across = np.asarray(data["across"], dtype=np.float64)
    if kind == "roughness":
        across = across - np.log1p(BY_NAME[kind].extent)
    truth = (
        (ALONG, data["along"], part.u_alpha_share),
        (ACROSS, across, part.u_alpha_share),
        (ALBEDO, data["albedo"] - part.albedo, part.u_albedo),
    )
    rng = np.random.default_rng(11)  # the same error of the batch's calibration every time
    response = bench.expected.response
    assert response is not None
    z = np.zeros((len(across), len(response.sources)))
    for source, value, u in truth:
        found = value / u + rng.standard_normal(len(across)) / BETTER
        z[:, response.sources.index(source)] = found
    return response.change(z)


def limits(shift: FloatArray, data: Columns, bench: Bench) -> tuple[float, list[tuple[str, float]]]:
    """Size of a mean shift (P,) of ln L in σ, and the sources of σ with their shares of its square.

    The shift is projected on V⁻¹δ, the direction of its largest significance; V is the mean over the parts and includes
    the ridge angle.
    """
    own = np.asarray(data[f"{bench.name}/own"], dtype=np.float64).mean(axis=0)
    measured = [
        Component(source, "measurement", relative, source in SHARED_SOURCES)
        for source, relative in zip(MEASURED_SOURCES, own, strict=True)
    ]
    basis = log_basis(len(shift))
    parts = [(c.source, basis @ c.covariance() @ basis.T) for c in (*bench.stated.components, *measured)]
    total = np.sum([matrix for _, matrix in parts], axis=0)
    weight = np.linalg.solve(total, basis @ shift)
    square = float(weight @ total @ weight)
    shares = [(source, float(weight @ matrix @ weight) / square) for source, matrix in parts]
    return float(np.sqrt(square)), sorted(shares, key=lambda pair: -pair[1])


Results = dict[str, Any]

LEVEL = 0.01
GOLDEN_SETS = 40
TAUGHT_DIAGNOSES = 60  # parts of a class that are diagnosed again against golden parts
_SEED = 3
DRAWN = ("shipped+area", "known+area", "golden+area")
_TINY = 1e-300


def results_of(world: World, data: dict[str, Columns], name: RecipeName, size: Size) -> Results:
    """Results of one recipe in one world.

    Args:
        world: the world.
        data: columns of every class, good parts among them.
        name: of the recipe.
        size: of the study.
    """
    valid = {kind: _valid(columns, name) for kind, columns in data.items()}
    good = valid[GOOD]
    pool = golden_pool(len(good["extent"]))
    own = covariance_of_measurement(good[f"{name}/own"]).mean(axis=0)
    first = bench_of(name, size, good[f"{name}/deviation"][pool[0]], own)
    benches = [replace(first, golden=good[f"{name}/deviation"][part]) for part in pool]
    compared = {
        kind: compared_sets(len(columns["extent"]), pool, of_good=kind == GOOD)
        for kind, columns in valid.items()
    }
    scores = {kind: _scores(columns, kind, name, benches, compared[kind]) for kind, columns in valid.items()}
    with_area(scores)
    good_scores = scores[GOOD]
    apart = separability_of(name, size)
    return {
        "good": {
            "parts": len(good["extent"]),
            "invalid": int(len(data[GOOD]["extent"]) - len(good["extent"])),
            "golden_sets": len(pool),
            "false_alarms": _false_alarms(good, name, good_scores),
            "p_values": {rule: _of_p(good_scores[rule]) for rule in RULES},
            "coverage": _coverage_of_good(good, name, benches[0]),
        },
        "classes": [
            {
                **_class(kind.name, valid, scores, good_scores, name, benches[0], apart.get(kind.cause)),
                "intervals": _intervals(kind.name, valid, name, size) if world == "same" else None,
            }
            for kind in CLASSES
        ],
    }


def _intervals(kind: str, data: dict[str, Columns], name: RecipeName, size: Size) -> Results | None:
    """Intervals of extents where everything that varies is stated: only the world of the predictor is known so well."""
    held = intervals_held(kind, data, name, size)
    if held is None:
        return None
    return {
        "spread_stated": _rate(held.stated),
        "doubt_of_this_world": _rate(held.doubted),
        "doubts": [asdict(doubt) for doubt in held.doubts],
    }


def golden_pool(parts: int) -> list[npt.NDArray[np.int_]]:
    """Numbers of the good parts that serve as golden parts: sets of 25, at most half of all parts, drawn at random.

    Many sets are drawn, because results differ widely between sets.
    """
    count = min(GOLDEN_PARTS, parts // 2)
    rng = np.random.default_rng(_SEED)
    return [rng.permutation(parts)[:count] for _ in range(GOLDEN_SETS)]


def compared_sets(parts: int, pool: list[npt.NDArray[np.int_]], *, of_good: bool) -> npt.NDArray[np.int_]:
    """(parts,) number of the golden set compared with every part: in turn, never one that contains it."""
    members = [set(part.tolist()) if of_good else set() for part in pool]
    found = np.arange(parts) % len(pool)
    for number in range(parts):
        while number in members[found[number]]:
            found[number] = (found[number] + 1) % len(pool)
    return found


def _valid(columns: Columns, name: RecipeName) -> Columns:
    keep = columns[f"{name}/valid"].astype(bool)
    return {key: values[keep] for key, values in columns.items()}


def _scores(
    data: Columns, kind: str, name: RecipeName, benches: list[Bench], compared: npt.NDArray[np.int_]
) -> dict[str, FloatArray]:
    """Scores (high is bad) of every part: −lg p of the means by every rule and of the marks, and the share."""
    found: dict[str, FloatArray] = {}
    for rule in RULES:
        if rule in OF_GOLDEN:
            p = np.full(len(data["extent"]), np.nan)
            for number, bench in enumerate(benches):
                mine = compared == number
                if not mine.any():
                    continue
                p[mine] = p_values(rule, {key: values[mine] for key, values in data.items()}, kind, bench)
        else:
            p = p_values(rule, data, kind, benches[0])
        found[rule] = -np.log10(np.maximum(p, _TINY))
    # groups whose chance is nil in floating point are told apart by their size
    found["marks"] = -np.log10(np.maximum(data[f"{name}/p_marks"], _TINY)) + 1e-3 * data[f"{name}/mark_cells"]
    found["share"] = np.asarray(data[f"{name}/share"], dtype=np.float64)
    return found


def with_area(scores: dict[str, dict[str, FloatArray]]) -> None:
    """Add to the scores of every class those of the deviating area, and of means and area combined.

    The score of the area is −lg of the normal tail, with location and scale from half of the good parts. Of two
    criteria, each has half of the level.
    """
    from scipy.stats import norm  # noqa: PLC0415 - 1 s

    good_shares = scores[GOOD]["share"][::2]
    middle, spread = float(np.mean(good_shares)), max(float(np.std(good_shares, ddof=1)), 1e-6)
    for found in scores.values():
        found["area"] = np.asarray(-norm.logsf((found["share"] - middle) / spread) / np.log(10.0))
        for rule in RULES:
            found[f"{rule}+area"] = np.maximum(found[rule], found["area"]) - np.log10(2.0)


def _false_alarms(good: Columns, name: RecipeName, scores: dict[str, FloatArray]) -> Results:
    limit = -np.log10(LEVEL)
    found: Results = {rule: _rate(rate(scores[rule] > limit)) for rule in RULES}
    found["marks"] = _rate(rate(good[f"{name}/p_marks"] < LEVEL))
    found["area share over its limit"] = _rate(rate(good[f"{name}/share_fails"].astype(bool)))
    found["verdict FAIL"] = _rate(rate(_fails(good, name, scores)))
    for rule in RULES:
        found[f"{rule}+area"] = _rate(rate(scores[f"{rule}+area"] > limit))
    return found


def _fails(data: Columns, name: RecipeName, scores: dict[str, FloatArray]) -> npt.NDArray[np.bool_]:
    """Whether the verdict is FAIL as shipped: by the means or by the share of the area."""
    return np.asarray((scores["shipped"] > -np.log10(LEVEL)) | data[f"{name}/share_fails"].astype(bool))


def _of_p(scores: FloatArray) -> Results:
    p = 10.0**-scores
    distance, chance = uniformity(p)
    return {"histogram": histogram(p), "kolmogorov": distance, "chance": chance}


def _rate(found: Rate) -> Results:
    return {"rate": found.value, "count": found.count, "of": found.of, "interval": [found.low, found.high]}


def _area(found: Area) -> Results:
    return {"auc": found.value, "u": found.u, "interval": list(found.interval)}


def _coverage_of_good(good: Columns, name: RecipeName, bench: Bench) -> Results:
    """Coverage of the 95 % intervals of good parts."""
    pairs = consecutive_pairs(bench.expected.poses)
    first, second = np.array(pairs).T
    error = good[f"{name}/error"][:, first] - good[f"{name}/error"][:, second]
    own = covariance_of_measurement(good[f"{name}/own"])
    u = np.sqrt(own[:, first, first] + own[:, second, second] - 2.0 * own[:, first, second])
    found = {
        "measured contrast holds the true one (measurement alone)": _rate(rate(np.abs(error) <= COVERAGE * u))
    }
    off, all_u = good[f"{name}/pair_deviation"], good[f"{name}/pair_u"]
    found["predicted contrast (as shipped)"] = _rate(rate(np.abs(off) <= COVERAGE * all_u))
    spread = bench.spread()
    of_pairs = spread[first, first] + spread[second, second] - 2.0 * spread[first, second]
    more = np.sqrt(all_u**2 + of_pairs)
    found["predicted contrast (spread of the ridge angle stated)"] = _rate(
        rate(np.abs(off) <= COVERAGE * more)
    )
    for number, (i, j) in enumerate(pairs):
        poses = bench.expected.poses
        title = (
            f"{poses[i].stage_deg:g}°/{poses[j].stage_deg:g}° at tilt {poses[i].tilt_deg:g}° (spread stated)"
        )
        found[title] = _rate(rate(np.abs(off[:, number]) <= COVERAGE * more[:, number]))
    for parameter, held in fitted_shapes(good, name, bench.size).items():
        found[f"{parameter}, fitted over the tilts"] = _rate(rate(held))
    return found


def _class(
    kind: str,
    data: dict[str, Columns],
    scores: dict[str, dict[str, FloatArray]],
    good: dict[str, FloatArray],
    name: RecipeName,
    bench: Bench,
    apart: Separability | None,
) -> Results:
    columns, own = data[kind], scores[kind]
    way = np.where(columns["extent"] < 0.0, -1.0, 1.0)[:, None]  # deviations of opposite sign must not cancel
    shift = np.mean(
        way * (columns[f"{name}/deviation"] - data[GOOD][f"{name}/deviation"].mean(axis=0)), axis=0
    )
    sigmas, sources = limits(shift, columns, bench)
    keys = ("area", "marks", *RULES, *(f"{rule}+area" for rule in RULES))
    return {
        "name": kind,
        "title": BY_NAME[kind].title,
        "parts": len(columns["extent"]),
        "area_share": float(columns["spoiled"].mean()),
        "verdict_fail": _rate(rate(_fails(columns, name, own))),
        "scores": {key: _detection(own[key], good[key]) for key in keys},
        "roc": {key: [list(map(float, axis)) for axis in curve(own[key], good[key])] for key in DRAWN},
        "mean_shift_sigmas": sigmas,
        "limited_by": [[source, share] for source, share in sources[:4]],
        "diagnosis": _diagnosis(kind, columns, name, bench, apart),
    }


def _detection(bad: FloatArray, good: FloatArray) -> Results:
    """Detection at the nominal threshold, and at that set on half of the good parts and tried on the others."""
    set_on, tried_on = good[::2], good[1::2]
    limit = threshold(set_on, LEVEL)
    found: Results = {**_area(area_under_curve(bad, good)), "set": _rate(rate(bad > limit))}
    found["false_alarms_set"] = _rate(rate(tried_on > limit))
    found["nominal"] = _rate(rate(bad > -np.log10(LEVEL)))
    return found


def _diagnosis(
    kind: str, data: Columns, name: RecipeName, bench: Bench, apart: Separability | None
) -> Results:
    cause, extent, size = BY_NAME[kind].cause, BY_NAME[kind].extent, bench.size
    diagnoses = diagnosed(kind, data, name, size, len(data["extent"]))
    taught = diagnosed(kind, data, name, size, TAUGHT_DIAGNOSES, bench.golden)
    named, counts = np.unique(diagnoses["first"], return_counts=True)
    order = np.argsort(-counts)
    needed = None if apart is None else apart.separation_extent
    right, u, low, high = (diagnoses[name] for name in ("extent", "u", "low", "high"))
    inside = np.isfinite(right)
    truth = true_extents(kind, data, size)
    # an open end holds everything beyond
    held = ~(truth < low) & ~(truth > high)
    closed = inside & np.isfinite(low) & np.isfinite(high)
    return {
        "right_first": _rate(rate(diagnoses["first"] == cause)),
        "right_first_or_second": _rate(rate((diagnoses["first"] == cause) | (diagnoses["second"] == cause))),
        "right_tied": _rate(rate(diagnoses["tied"])),
        "confidently_wrong": _rate(rate(diagnoses["wrong"])),
        "ties": float(diagnoses["ties"].mean()),
        "right_first_against_golden": _rate(rate(taught["first"] == cause)),
        "confidently_wrong_against_golden": _rate(rate(taught["wrong"])),
        "first": [[str(named[k]) or "none", int(counts[k])] for k in order[:4]],
        "shows_from": None if apart is None else apart.detection_extent,
        "told_apart_from": needed,
        "separable": bool(needed is not None and extent >= abs(needed)),
        "extent": extent,
        "extent_interval_holds": _rate(rate(held[inside])),
        "extent_interval_closed": _rate(rate(closed[inside])),
        "extent_median": float(np.median(right[inside])) if inside.any() else None,
        "extent_u_median": float(np.median(u[inside])) if inside.any() else None,
    }


__all__ = ["LEVEL", "RULES", "Rule", "compared_sets", "golden_pool", "results_of", "with_area"]
