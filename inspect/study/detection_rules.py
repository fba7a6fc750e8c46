"""Ways to weigh the means of the poses of many parts: as shipped, with more told, and against golden parts.

`shipped` is what ``inspect`` decided. The others answer what a better recipe or calibration would give, from the same
measured radiances: `spread` adds the spread of the ridge angle of good parts to the budget; `known` knows roughness and
albedo of every part's batch three times better; `golden` is Hotelling's T² against golden parts (the rule of
``inspect`` where there are such); `taught` shifts the prediction to their mean and keeps the budget.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from anisoscope.expectation import Component, Expectation
from anisoscope.significance import hotelling, log_basis
from anisoscope.study.detection_chunk import MEASURED_SOURCES
from anisoscope.study.detection_product import (
    BY_NAME,
    RecipeName,
    Size,
    expected_of,
    recipe_of,
    ridge_angle_component,
)

FloatArray = npt.NDArray[np.float64]
Columns = dict[str, npt.NDArray[Any]]
Rule = Literal["shipped", "spread", "known", "golden", "taught"]

RULES: tuple[Rule, ...] = ("shipped", "spread", "known", "golden", "taught")
GOLDEN_PARTS = 25
BETTER = 3.0
ALONG, ACROSS, ALBEDO = "roughness along the ridges", "roughness across the ridges", "albedo of the plastic"
SHARED_SOURCES = ("stray light",)


@dataclass(frozen=True, eq=False)
class Bench:
    """What all parts of one recipe are weighed with: prediction, its components by name, and the golden parts.

    Attributes:
        expected: of the recipe.
        components: of the prediction, the ridge angle of good parts among them.
        golden: (n, P) ln L over the prediction of the golden parts.
        size: of the study.
        name: of the recipe.
    """

    expected: Expectation
    components: tuple[Component, ...]
    golden: FloatArray
    size: Size
    name: RecipeName


def bench_of(name: RecipeName, size: Size, golden: FloatArray) -> Bench:
    """The bench of a recipe; ``golden``: (n, P)."""
    expected = expected_of(name, size)
    spread = ridge_angle_component(expected)
    return Bench(expected, (*expected.components, spread), golden, size, name)


def p_values(rule: Rule, seen: Columns, kind: str, bench: Bench) -> FloatArray:
    """P value of the means of every part under a rule; 0 for a part that could not be judged never occurs: NaN.

    Args:
        rule: the rule.
        seen: columns of one class.
        kind: the class.
        bench: recipe and golden parts.
    """
    name = bench.name
    if rule == "shipped":
        return np.asarray(seen[f"{name}/p_means"], dtype=np.float64)
    deviation = np.asarray(seen[f"{name}/deviation"], dtype=np.float64)
    if rule == "golden":
        basis = log_basis(deviation.shape[1])
        golden = bench.golden @ basis.T
        return _against_golden(deviation @ basis.T, golden)
    components, own = bench.components, covariance_of_measurement(seen[f"{name}/own"])
    if rule == "known":
        deviation = deviation - _known(seen, kind, bench)
        components = tuple(_scaled(component) for component in components)
    covariance = own + np.sum([component.covariance() for component in components], axis=0)
    if rule == "taught":
        count = len(bench.golden)
        deviation = deviation - bench.golden.mean(axis=0)
        covariance = covariance * (1.0 + 1.0 / count)
    return _chi2(deviation, covariance)


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


def _chi2(deviation: FloatArray, covariance: FloatArray) -> FloatArray:
    from scipy.stats import chi2  # noqa: PLC0415 - 1 s

    return np.asarray(chi2.sf(distances(deviation, covariance), deviation.shape[1] - 1))


def _scaled(component: Component) -> Component:
    better = component.source in (ALONG, ACROSS, ALBEDO)
    factor = 1.0 / BETTER if better else 1.0
    return Component(component.source, component.kind, component.relative * factor, component.shared)


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
    relative = {component.source: component.relative for component in bench.components}
    known = np.zeros((len(across), len(bench.expected.poses)))
    for source, value, u in truth:
        found = value / u + rng.standard_normal(len(across)) / BETTER
        known += np.outer(found, relative[source])
    return known


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
    parts = [(c.source, basis @ c.covariance() @ basis.T) for c in (*bench.components, *measured)]
    total = np.sum([matrix for _, matrix in parts], axis=0)
    weight = np.linalg.solve(total, basis @ shift)
    square = float(weight @ total @ weight)
    shares = [(source, float(weight @ matrix @ weight) / square) for source, matrix in parts]
    return float(np.sqrt(square)), sorted(shares, key=lambda pair: -pair[1])
