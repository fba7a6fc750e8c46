"""How many parts of a lot pass a recipe, with the risks of both sides, from the verdicts of drawn parts."""

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from anisoscope.base.progress import Advance, silent
from anisoscope.decision.decision import pair_values
from anisoscope.prediction.expectation import Expectation
from anisoscope.record.verdict import Verdict
from anisoscope.sim.light.contrasts import consecutive_pairs
from anisoscope.study.lot import VERDICTS, Judged, Lot, judged_on_rig, setting_of
from anisoscope.study.statistics import Rate, rate
from anisoscope.study.sweep import Workers, sweep


@dataclass(frozen=True)
class LotContrast:
    """One contrast over the lot.

    Attributes:
        from_deg: first stage angle.
        to_deg: second stage angle.
        tilt_deg: tilt.
        predicted: of the nominal part.
        mean: measured, of the lot.
        sd: measured, between its parts.
        u: standard uncertainty of measured − predicted as stated, rms over the lot.
        tolerance: or None.
        outside: parts whose true contrast is outside the tolerance; None without one.
    """

    from_deg: float
    to_deg: float
    tilt_deg: float
    predicted: float
    mean: float
    sd: float
    u: float
    tolerance: float | None
    outside: Rate | None


@dataclass(frozen=True)
class PartYield:
    """Verdicts over a lot.

    Attributes:
        verdicts: parts by their verdict.
        significant: parts that deviate significantly.
        contrasts: one a contrast that is judged.
        conforming: parts whose true contrasts are all within the tolerances; None without tolerances.
        producer_risk: of the conforming ones, those that FAIL (JCGM 106:2012, 9.3, for the lot).
        consumer_risk: of the others, those that PASS.
    """

    verdicts: dict[str, Rate]
    significant: Rate
    contrasts: tuple[LotContrast, ...]
    conforming: Rate | None
    producer_risk: Rate | None
    consumer_risk: Rate | None


def part_yield(lot: Lot, workers: Workers, seed: int = 1, advance: Advance = silent) -> PartYield:
    """Draw, predict, measure and judge the parts of a lot.

    Args:
        lot: the parts and how they are inspected.
        workers: processes or cluster; the result does not depend on them.
        seed: of everything random.
        advance: called with the number of finished rigs.

    Raises:
        UsageError, HeightMapError, RecipeError: as for `lot.setting_of`.
        SweepError: a process failed.
    """
    expected = setting_of(lot).expected  # errors of the recipe come before any process
    tasks = [(lot, number) for number in range(lot.rigs)]
    found = sweep(judged_on_rig, tasks, workers, seed=seed, advance=advance, doing="rigs")
    rigs = np.repeat(np.arange(lot.rigs), [len(one.verdict) for one in found])
    together = Judged(
        *(np.concatenate([getattr(one, name.name) for one in found]) for name in fields(Judged))
    )
    return _summary(lot, expected, together, rigs)


def _summary(lot: Lot, expected: Expectation, judged: Judged, rigs: npt.NDArray[np.int_]) -> PartYield:
    tolerances, pairs = lot.recipe.tolerances(), consecutive_pairs(expected.poses)
    predicted = pair_values(pairs, expected.radiance, lot.recipe.decision.contrast)
    inside = None if tolerances is None else np.asarray(np.abs(judged.true) <= np.array(tolerances))
    contrasts = []
    for k, (first, second) in enumerate(pairs):
        one = judged.deviation[:, k]
        contrasts.append(
            LotContrast(
                expected.poses[first].stage_deg,
                expected.poses[second].stage_deg,
                expected.poses[first].tilt_deg,
                float(predicted[k]),
                float(predicted[k] + one.mean()),
                float(one.std(ddof=1)),
                float(np.sqrt(np.mean(judged.u[:, k] ** 2))),
                None if tolerances is None else tolerances[k],
                None if inside is None else rate(~inside[:, k], rigs),
            )
        )
    by_verdict = {one.value: rate(judged.verdict == place, rigs) for place, one in enumerate(VERDICTS)}
    conforming = producer = consumer = None
    if inside is not None:
        good = np.asarray(inside.all(axis=1))
        conforming = rate(good, rigs)
        producer = rate(judged.verdict[good] == VERDICTS.index(Verdict.FAIL), rigs[good])
        consumer = rate(judged.verdict[~good] == VERDICTS.index(Verdict.PASS), rigs[~good])
    significant = rate(judged.significant, rigs)
    return PartYield(by_verdict, significant, tuple(contrasts), conforming, producer, consumer)
