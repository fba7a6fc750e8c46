"""The eight tests of L. S. Nelson for unusual patterns on a chart (Journal of Quality Technology 16 (1984) 237).

What is missing ends every pattern: nobody knows on which side it would have been. Two equal values neither rise nor
fall, a value on the centre line lies on neither side, and one exactly at 1 sigma is neither within nor beyond.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.quality.limits import BoolArray

IntArray = npt.NDArray[np.int64]

RULES: Mapping[int, str] = {
    1: "one value beyond 3 sigma",
    2: "nine values in a row on one side of the centre",
    3: "six values in a row rise or fall",
    4: "fourteen values in a row go up and down by turns",
    5: "two of three values beyond 2 sigma on one side",
    6: "four of five values beyond 1 sigma on one side",
    7: "fifteen values in a row within 1 sigma",
    8: "eight values in a row beyond 1 sigma, on either side",
}
MEANING: Mapping[int, str] = {
    1: "a single odd part, or a large shift",
    2: "the mean has shifted",
    3: "a drift: wear, warming up, a fading lamp",
    4: "two things take turns, such as two cavities or two operators",
    5: "the mean shifts, or the spread grows",
    6: "a small shift of the mean",
    7: "limits that are too wide, or values that mix two sources",
    8: "two populations in one chart",
}
LENGTHS: Mapping[int, int] = {1: 1, 2: 9, 3: 6, 4: 14, 5: 3, 6: 5, 7: 15, 8: 8}


@dataclass(frozen=True)
class Flag:
    """A pattern that was found.

    Attributes:
        rule: number of the rule.
        first, last: indices of its first and last value.
        seen_at: index of the value at which it became complete.
    """

    rule: int
    first: int
    last: int
    seen_at: int

    @property
    def text(self) -> str:
        """The rule in words."""
        return RULES[self.rule]


def signals(values: FloatArray, center: float, sigma: float | FloatArray) -> dict[int, BoolArray]:
    """For every rule, whether its pattern is complete at each value.

    Args:
        values: (N,), NaN is missing.
        center: centre line.
        sigma: standard deviation of the values, or (N,) of each.

    Returns:
        (N,) for every rule. Rules 5 and 6 are complete only at a value that lies beyond itself.
    """
    z = (values - center) / sigma
    step = np.zeros(len(z), dtype=np.int64)
    step[1:] = np.nan_to_num(np.sign(np.diff(values))).astype(np.int64)
    turn = np.zeros(len(z), dtype=np.int64)
    turn[2:] = step[2:] * step[1:-1] == -1
    side = np.nan_to_num(np.sign(values - center)).astype(np.int64)
    return {
        1: np.abs(z) > 3.0,
        2: _run(side) >= 9,
        3: _run(step) >= 5,
        4: _run(turn) >= 12,
        5: _most_of(z, 2.0, 2, 3),
        6: _most_of(z, 1.0, 4, 5),
        7: _run((np.abs(z) < 1.0).astype(np.int64)) >= 15,
        8: _run((np.abs(z) > 1.0).astype(np.int64)) >= 8,
    }


def _run(key: IntArray) -> IntArray:
    """Length of the run of equal keys that ends at each place; 0 where the key is 0."""
    place = np.arange(len(key))
    start = np.zeros(len(key), dtype=np.int64)
    start[1:] = np.where(key[1:] != key[:-1], place[1:], 0)
    return np.where(key == 0, 0, place - np.maximum.accumulate(start) + 1)


def _most_of(z: FloatArray, far: float, least: int, span: int) -> BoolArray:
    """Rule of k out of n points beyond a distance on one side, the last one among them.

    A span that reaches back over a missing value is cut short there.
    """
    found = np.zeros(len(z), dtype=np.bool_)
    since = _run((~np.isnan(z)).astype(np.int64))
    for beyond in (z > far, z < -far):
        total = np.zeros(len(z), dtype=np.int64)
        for back in range(span):
            earlier = np.zeros(len(z), dtype=np.bool_)
            earlier[back:] = beyond[: max(len(z) - back, 0)]
            total += earlier & (since > back)
        found |= beyond & (total >= least)
    return found


def flags(
    values: FloatArray, center: float, sigma: float | FloatArray, rules: Collection[int] = tuple(RULES)
) -> tuple[Flag, ...]:
    """All patterns of a series, in order of occurrence; overlapping ones of a rule are one.

    Args:
        values: (N,), NaN is missing.
        center: centre line.
        sigma: standard deviation of the values, or (N,) of each.
        rules: numbers of the rules that count.
    """
    side = np.nan_to_num(np.sign(values - center)).astype(np.int64)
    found: list[Flag] = []
    for rule, seen in signals(values, center, sigma).items():
        if rule in rules:
            found += _of_rule(rule, np.flatnonzero(seen), side, np.isnan(values))
    return tuple(sorted(found, key=lambda flag: (flag.seen_at, flag.rule)))


def _of_rule(rule: int, seen: IntArray, side: IntArray, missing: BoolArray) -> list[Flag]:
    """Merge overlapping runs of a rule and, where the side matters, of the same side."""
    if len(seen) == 0:
        return []
    gaps = np.concatenate([[-1], np.flatnonzero(missing)])
    first = np.maximum(seen - (LENGTHS[rule] - 1), gaps[np.searchsorted(gaps, seen) - 1] + 1)
    opens = first[1:] > seen[:-1]
    if rule in (2, 5, 6):
        opens |= side[seen[1:]] != side[seen[:-1]]
    start = np.flatnonzero(np.concatenate([[True], opens]))
    end = np.append(start[1:], len(seen)) - 1
    found = zip(first[start].tolist(), seen[end].tolist(), seen[start].tolist(), strict=True)
    return [Flag(rule, *places) for places in found]


def flagged(found: tuple[Flag, ...], count: int) -> BoolArray:
    """(count,) values that belong to any pattern."""
    marks = np.zeros(count + 1, dtype=np.int64)
    for flag in found:
        marks[flag.first] += 1
        marks[flag.last + 1] -= 1
    return np.cumsum(marks[:-1]) > 0
