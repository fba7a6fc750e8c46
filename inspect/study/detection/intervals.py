"""Do 95 % intervals of extents hold the truth in 95 % of the parts, once everything is stated that varies?

The diagnosis doubts its signatures as real parts ask for, and a recipe need not state how much the ridge angle of good
parts spreads. In the same world both are known: the spread is stated, and how far signatures are off, how widely shares
of deviating cells scatter, and what good parts show is counted on one half of the parts. The intervals of the other
half are then tried, and the halves change places. What still misses 95 % is the machinery's own.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.diagnosis.evidence import Evidence
from anisoscope.diagnosis.likelihood import costs, fit_extent, interval
from anisoscope.diagnosis.signatures import Signature
from anisoscope.study.detection.diagnosis import evidence, signatures_of, true_extents
from anisoscope.study.detection.product import BY_NAME, RecipeName, Size
from anisoscope.study.detection.statistics import Rate, rate

Columns = dict[str, npt.NDArray[Any]]

MOST = 1.0
"""Relative doubt up to which one is looked for."""


@dataclass(frozen=True)
class Doubt:
    """How far signatures can be believed in the study's own world.

    Attributes:
        change: relative standard uncertainty of the change of ln L.
        share: relative standard uncertainty of the share of deviating cells.
        background: share of deviating cells on good parts.
        u_background: its standard deviation from part to part, what the measurement knows of it left out.
    """

    change: float
    share: float
    background: float
    u_background: float


@dataclass(frozen=True, eq=False)
class Part:
    """One part: what its diagnosis rests on, and how much of the defect it truly has."""

    evidence: Evidence
    truth: float


@dataclass(frozen=True)
class Held:
    """How often intervals of one class hold the truth.

    Attributes:
        stated: by a recipe that states the spread of the ridge angle, with the doubts of real parts.
        doubted: the same with the doubts of the study's world.
        doubts: these doubts, from either half of the parts.
    """

    stated: Rate
    doubted: Rate
    doubts: tuple[Doubt, ...]


def intervals_held(kind: str, seen: dict[str, Columns], name: RecipeName, size: Size) -> Held | None:
    """How often the intervals of a class hold the truth; None of fewer than two parts or a cause not looked for.

    Args:
        kind: the class.
        seen: columns of the class and of good parts, valid ones only.
        name: of the recipe.
        size: of the study.
    """
    known = {one.cause.name: one for one in signatures_of(name, size, stated=True).found}
    signature, columns = known.get(BY_NAME[kind].cause), seen[kind]
    count = len(columns["extent"])
    if signature is None or count < 2:
        return None
    truth = true_extents(kind, columns, size)
    parts = [Part(evidence(columns, name, size, n, None, stated=True), float(truth[n])) for n in range(count)]
    halves = parts[::2], parts[1::2]
    doubts = tuple(
        doubt_of(signature, half, *background_of_good(seen["good"], name, first))
        for first, half in enumerate(halves)
    )
    doubted = [
        holds(*doubting(signature, part, doubt))
        for doubt, half in zip(doubts, halves[::-1], strict=True)
        for part in half
    ]
    stated = [holds(signature, part) for part in parts]
    return Held(rate(np.array(stated)), rate(np.array(doubted)), doubts)


def background_of_good(good: Columns, name: RecipeName, first: int) -> tuple[float, float]:
    """Share of deviating cells on every second good part, and its scatter beyond that of the measurement."""
    share = np.asarray(good[f"{name}/share"][first::2], dtype=np.float64)
    known = np.asarray(good[f"{name}/u_share"][first::2], dtype=np.float64)
    return float(share.mean()), float(np.sqrt(max(share.var(ddof=1) - np.mean(known**2), 0.0)))


def doubt_of(signature: Signature, parts: list[Part], background: float, u_background: float) -> Doubt:
    """The doubts that make parts most likely at their true extents."""
    means = [replace(part.evidence, share=None) for part in parts]

    def of_change(doubt: float) -> float:
        one = replace(signature, cause=replace(signature.cause, doubt=doubt))
        return sum(
            float(costs(one, seen, np.array([part.truth]), as_input=True)[1][0])
            for seen, part in zip(means, parts, strict=True)
        )

    shares = signature.at(np.array([part.truth for part in parts]))[1]
    off = np.array([part.evidence.share for part in parts], dtype=np.float64) - background - shares
    known = np.array([part.evidence.u_share for part in parts])

    def of_share(doubt: float) -> float:
        variance = known**2 + u_background**2 + (doubt * shares) ** 2
        return float(np.sum(off**2 / variance + np.log(variance)))

    return Doubt(_least(of_change), _least(of_share), background, u_background)


def _least(cost: Callable[[float], float]) -> float:
    """Where a cost is least between 0 and `MOST`; 0 where no doubt makes it less."""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - 0.3 s

    found = minimize_scalar(cost, bounds=(0.0, MOST), method="bounded", options={"xatol": 1e-3})
    return float(found.x) if found.fun < cost(0.0) else 0.0


def doubting(signature: Signature, part: Part, doubt: Doubt) -> tuple[Signature, Part]:
    """Signature and part with the doubts of the study's world in place of those of real parts."""
    seen = replace(
        part.evidence,
        background=doubt.background,
        u_background=doubt.u_background,
        share_relative=doubt.share,
        share_floor=0.0,
    )
    return replace(signature, cause=replace(signature.cause, doubt=doubt.change)), replace(
        part, evidence=seen
    )


def holds(signature: Signature, part: Part) -> bool:
    """Does the interval of a part hold its true extent? An open end holds everything beyond."""
    low, high = interval(signature, part.evidence, fit_extent(signature, part.evidence))
    return not (low is not None and part.truth < low) and not (high is not None and part.truth > high)
