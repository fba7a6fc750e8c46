"""How many parts of a lot pass a recipe, with the risks of both sides, from the verdicts of drawn parts.

And how often a defect of the whole part is found, by its size.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.decision.decision import pair_values
from anisoscope.parameters.workers import Workers
from anisoscope.prediction.expectation import Expectation
from anisoscope.quality.detection_probability import Trials
from anisoscope.record.verdict import Verdict
from anisoscope.sim.light.contrasts import consecutive_pairs
from anisoscope.study.lot import VERDICTS, Judged, Lot, Shift, judged_on_rig, setting_of
from anisoscope.study.statistics import Rate, rate
from anisoscope.study.sweep import sweep


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


LARGEST_DEFECT = {"ridge_angle": 4.0, "alpha": 1.0, "albedo": 1.0, "height_loss": 0.5, "edge_radius": 20.0}
"""Largest size that is tried, in the units of `Shift`."""
_PILOT_SIZES, _PILOT_PARTS = 9, 12
_SIZES = 20


def detection_trials(
    lot: Lot, defect: str, largest: float | None, workers: Workers, seed: int = 1, advance: Advance = silent
) -> Trials:
    """Draw parts with a defect of many sizes, and good ones, and judge them; every part on a rig of its own.

    So no two parts share a rig, its golden parts or its plastic, and their verdicts are independent.

    Args:
        lot: good parts and how they are inspected; its number of parts is that with a defect, a tenth more have none.
        defect: a name in `Shift`.
        largest: largest size; None: a short series of trials finds sizes from hardly ever to nearly always found.
        workers: processes or cluster; the result does not depend on them.
        seed: of everything random.
        advance: called with the number of finished parts.

    Returns:
        Sizes, evenly spread in their logarithm, and whether the verdict was FAIL.

    Raises:
        UsageError: another defect, a size that is none, or no size that is found at all.
        HeightMapError, RecipeError: as for `lot.setting_of`.
        SweepError: a process failed.
    """
    if defect not in LARGEST_DEFECT:
        raise UsageError(
            f"--defect takes {', '.join(LARGEST_DEFECT)}, not {defect!r}; defects that show in the picture only, such "
            "as scratches, need master parts: inspect them and use --csv"
        )
    if largest is not None and not 0.0 < largest < float("inf"):
        raise UsageError(f"the largest size must be a finite number above 0, not {largest:g}")
    setting_of(lot)  # errors of the recipe come before any process

    def judged(sizes: FloatArray, each: int, seed: int) -> Trials:
        own = [replace(lot, shift=Shift(**{defect: float(size)}), parts=each, rigs=each) for size in sizes]
        tasks = [(one, number) for one in own for number in range(each)]
        found = sweep(judged_on_rig, tasks, workers, seed=seed, advance=advance, doing="parts")
        fail = VERDICTS.index(Verdict.FAIL)
        return Trials(np.repeat(sizes, each), np.array([bool(one.verdict[0] == fail) for one in found]))

    ends = (largest / _SIZES, largest) if largest is not None else _range_of(defect, judged, seed + 1)
    each = max(lot.parts // _SIZES, 2)
    sizes = np.geomspace(*ends, _SIZES)
    bad, good = judged(sizes, each, seed), judged(np.zeros(1), max(lot.parts // 10, 10), seed + 2)
    return Trials(np.concatenate([good.size, bad.size]), np.concatenate([good.hit, bad.hit]))


def _range_of(
    defect: str, judged: Callable[[FloatArray, int, int], Trials], seed: int
) -> tuple[float, float]:
    """Sizes from hardly ever found to nearly always found, by a short series of trials."""
    tried = LARGEST_DEFECT[defect] * 2.0 ** -np.arange(_PILOT_SIZES, dtype=np.float64)[::-1]
    share = judged(tried, _PILOT_PARTS, seed).hit.reshape(_PILOT_SIZES, -1).mean(axis=1)
    if share.max() < 0.5:
        raise UsageError(
            f"{defect} of {tried[-1]:g} is found in {share[-1]:.0%}: no size of it is found reliably"
        )
    rarely, nearly = np.flatnonzero(share <= 0.05), np.flatnonzero(share >= 0.95)
    first = tried[rarely[-1]] if rarely.size else tried[0]
    last = tried[nearly[nearly > (rarely[-1] if rarely.size else -1)][0]] if nearly.size else tried[-1]
    return float(first), float(last)
