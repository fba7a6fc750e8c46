"""Points of charts from readings: which of them form a subgroup, and counts of parts that fail or deviate."""

from collections import Counter

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.quality.capability import DEVIATION, TOLERANCE
from anisoscope.quality.limits import Points, counted_points, individuals, subgroup_points
from anisoscope.quality.readings import INVALID, Readings

COUNTED = {"p": "parts that FAIL", "u": "deviations beyond their tolerance"}
"""What charts of counts count where no number is named."""


def charted_points(
    readings: Readings, number: str, chart: str, subgroup: str | None = None, of: str | None = None
) -> tuple[Points, Readings, tuple[str, ...]]:
    """Points of a chart, the first reading of each, and notes on what was left out.

    Args:
        readings: in the order in which they were measured.
        number: its name, or one of ``COUNTED``.
        chart: one of ``anisoscope.quality.limits.CHARTS``.
        subgroup: see `subgroups`; by default each reading is a point.
        of: number that says how many parts a count is of; one by default.

    Raises:
        UsageError: a column that there is not, or a chart and subgroups that do not go together.
    """
    if chart == "i-mr":
        if subgroup is not None or of is not None:
            raise UsageError("--subgroup and --of go with --chart xbar-r, xbar-s, p or u")
        return individuals(readings.numbers[number], readings.labels), readings, ()
    if subgroup is None and (chart.startswith("xbar") or (chart[0] == "p" and of is None)):
        raise UsageError(
            f"--chart {chart} needs subgroups: --subgroup lot, day, cavities, or how many readings"
        )
    if subgroup is None:
        groups, left = [(name, [place]) for place, name in enumerate(readings.labels)], 0
    else:
        groups, left = subgroups(readings, subgroup)
    labels = [name for name, _ in groups]
    first = readings.at([places[0] for _, places in groups])
    texts = {name: column for name, column in first.texts.items() if name not in ("folder", "serial")}
    stand = Readings(first.source, texts, first.numbers, first.zone, first.base, machine=first.machine)
    notes = (
        ()
        if not left
        else (f"{left} of {len(readings)} readings belong to no whole subgroup and are left out",)
    )
    if chart.startswith("xbar"):
        if of is not None:
            raise UsageError("--of goes with --chart p or u")
        values = readings.numbers[number]
        return subgroup_points([values[places] for _, places in groups], labels, chart), stand, notes
    counts, sizes = _counts(readings, number, of)
    known = ~np.isnan(counts) & ~np.isnan(sizes)
    counts, sizes = np.where(known, counts, 0.0), np.where(known, sizes, 0.0)
    totals = [np.array([column[places].sum() for _, places in groups]) for column in (counts, sizes)]
    return counted_points(totals[0], totals[1], labels, chart), stand, notes


def repeated(readings: Readings, number: str) -> tuple[str, ...]:
    """Note on serial numbers that several readings have; none where all have the same, as a check standard's."""
    serials = readings.texts.get("serial", ())
    if number in readings.numbers:
        serials = tuple(
            one for one, value in zip(serials, readings.numbers[number], strict=False) if not np.isnan(value)
        )
    serials = tuple(filter(None, serials))
    several = [one for one, count in Counter(serials).items() if count > 1]
    if not several or len(set(serials)) == 1:
        return ()
    what = "serial number has" if len(several) == 1 else "serial numbers have"
    kept = "the last verdict counts" if number == COUNTED["p"] else "all of them are on the chart"
    return (f"{len(several)} {what} several inspections, such as {several[0]}: {kept}",)


def _counts(readings: Readings, number: str, of: str | None) -> tuple[FloatArray, FloatArray]:
    """Counts and parts of every reading."""
    if number == COUNTED["p"]:
        verdicts = readings.column("verdict")
        judged = [place for place, one in enumerate(verdicts) if one != INVALID]
        serials = readings.texts.get("serial", ())
        if any(serials):  # a part that was inspected or judged again counts once
            judged = list({serials[place] or place: place for place in judged}.values())
        counts = np.full(len(verdicts), np.nan)
        counts[judged] = [float(verdicts[place] == "FAIL") for place in judged]
    elif number == COUNTED["u"]:
        pairs = [
            (found, readings.numbers[TOLERANCE + name.removeprefix(DEVIATION)])
            for name, found in readings.numbers.items()
            if name.startswith(DEVIATION) and TOLERANCE + name.removeprefix(DEVIATION) in readings.numbers
        ]
        if not pairs:
            raise UsageError(
                f"{readings.source}: no deviation has a tolerance: name a column of counts by --number"
            )
        counts = np.array([np.abs(found) > most for found, most in pairs]).sum(axis=0).astype(np.float64)
        counts = np.where(np.isnan(pairs[0][0]), np.nan, counts)
    else:
        counts = readings.number(number)[1]
    return counts, np.ones(len(counts)) if of is None else readings.number(of)[1]


def subgroups(readings: Readings, how: str) -> tuple[list[tuple[str, list[int]]], int]:
    """Names and places of subgroups in the order in which they begin, and how many readings belong to none.

    Args:
        readings: in the order in which they were measured.
        how: ``day`` (of this computer's zone); ``cavities``: parts that follow each other until a cavity comes again;
            a number: so many that follow each other; else a column of words, such as ``lot``.

    Raises:
        UsageError: it is none of these.
    """
    count = len(readings)
    if (how.isdecimal() and len(how) < 10) or how == "cavities":
        found = _in_a_row(readings, how)
    else:
        words = _days(readings) if how == "day" else readings.column(how)
        places: dict[str, list[int]] = {}
        for place, word in enumerate(words):
            if word:
                places.setdefault(word, []).append(place)
        found = list(places.items())
    left = count - sum(len(places) for _, places in found)
    if not found:
        raise UsageError(f"{readings.source}: no reading belongs to a subgroup of {how}")
    return found, left


def _days(readings: Readings) -> tuple[str, ...]:
    moments = [readings.moment(place) for place in range(len(readings))]
    if not any(moments):
        raise UsageError(f"{readings.source}: no reading has a time, which --subgroup day needs")
    return tuple("" if one is None else f"{one:%Y-%m-%d}" for one in moments)


def _in_a_row(readings: Readings, how: str) -> list[tuple[str, list[int]]]:
    """Readings that follow each other: so many, or until a cavity comes again."""
    if how == "cavities":
        starts, seen = [0], set[str]()
        for place, cavity in enumerate(readings.column("cavity")):
            if cavity in seen:
                starts.append(place)
                seen = set()
            seen.add(cavity)
        ends = [*starts[1:], len(readings)]
    else:
        size = int(how)
        if size < 2:
            raise UsageError(f"--subgroup takes 2 readings or more, not {how}")
        starts = list(range(0, len(readings) - size + 1, size))
        ends = [start + size for start in starts]
    labels = readings.labels
    pairs = zip(starts, ends, strict=True)
    return [
        ("–".join(dict.fromkeys((labels[start], labels[end - 1]))), list(range(start, end)))
        for start, end in pairs
    ]
