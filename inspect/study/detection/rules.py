"""Decision rules for the pose means of many parts: as shipped, with more information, and against golden parts.

`shipped` is what ``inspect`` decides. The others answer what a better recipe or calibration would give, from the same
measured radiances: `spread` is that of a recipe that states the spread of the ridge angle of good parts; `known` knows
roughness and albedo of every part's batch three times better; `golden` is T² against golden parts with the chance that
good parts drawn from the budget have (the rule of ``inspect`` where there are such), `normal` the same with the chance
of the normal distribution; `taught` shifts the prediction to their mean and keeps the budget.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.significance import hotelling, log_basis
from anisoscope.decision.consistency_test import calibrated, golden_chances
from anisoscope.prediction.expectation import Component, Expectation
from anisoscope.prediction.profile_likelihood import nearest
from anisoscope.prediction.second_order import Response
from anisoscope.study.detection.chunk import MEASURED_SOURCES
from anisoscope.study.detection.diagnosis import SHARED_SOURCES
from anisoscope.study.detection.product import (
    BY_NAME,
    RecipeName,
    Size,
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
    """What all parts of one recipe are weighed with: prediction, its components by name, and the golden parts.

    Attributes:
        expected: of the recipe.
        stated: of the recipe that states the spread of the ridge angle too.
        golden: (n, P) ln L over the prediction of the golden parts.
        size: of the study.
        name: of the recipe.
        drawn: p values that T² of good parts gets by the normal theory, drawn as ``inspect`` does.
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


def p_values(rule: Rule, seen: Columns, kind: str, bench: Bench) -> FloatArray:
    """P value of the means of every part under a rule; NaN for an INVALID part.

    Args:
        rule: the rule.
        seen: columns of one class.
        kind: the class.
        bench: recipe and golden parts.
    """
    name = bench.name
    deviation = np.asarray(seen[f"{name}/deviation"], dtype=np.float64)
    own = covariance_of_measurement(seen[f"{name}/own"])
    if rule in ("golden", "normal"):
        basis = log_basis(deviation.shape[1])
        normal = _against_golden(deviation @ basis.T, bench.golden @ basis.T)
        return normal if rule == "normal" else calibrated(normal, bench.drawn)
    response = bench.response(spread=rule != "shipped", better=BETTER if rule == "known" else 1.0)
    alone = own + np.sum([component.covariance() for component in bench.expected.alone], axis=0)
    if rule == "known":
        deviation = deviation - _known(seen, kind, bench)
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
    """As `weighing.from_prediction`, for (N, P) parts with (N, P, P) covariances of what the response does not hold."""
    from scipy.stats import chi2  # noqa: PLC0415 - 1 s

    basis = log_basis(deviation.shape[1])
    d2 = nearest(response.within(basis), deviation @ basis.T, basis @ alone @ basis.T)
    return np.asarray(chi2.sf(d2, len(basis)))


def _known(seen: Columns, kind: str, bench: Bench) -> FloatArray:
    """(N, P) change of ln L that is known of every part's batch: true up to a third of the recipe's uncertainty.

    What makes a part defective is not known.
    """
    part = recipe_of(bench.name, bench.size).material
    across = np.asarray(seen["across"], dtype=np.float64)
    if kind == "roughness":
        across = across - np.log1p(BY_NAME[kind].extent)
    truth = (
        (ALONG, seen["along"], part.u_alpha_share),
        (ACROSS, across, part.u_alpha_share),
        (ALBEDO, seen["albedo"] - part.albedo, part.u_albedo),
    )
    rng = np.random.default_rng(11)  # the same error of the batch's calibration every time
    response = bench.expected.response
    assert response is not None
    z = np.zeros((len(across), len(response.sources)))
    for source, value, u in truth:
        found = value / u + rng.standard_normal(len(across)) / BETTER
        z[:, response.sources.index(source)] = found
    return response.change(z)


def limits(shift: FloatArray, seen: Columns, bench: Bench) -> tuple[float, list[tuple[str, float]]]:
    """How many σ a mean shift (P,) of ln L is, and what makes σ up: sources with their share of its square.

    The shift is weighed along V⁻¹δ, where it shows most; V is the mean over the parts, with the ridge angle.
    """
    own = np.asarray(seen[f"{bench.name}/own"], dtype=np.float64).mean(axis=0)
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
