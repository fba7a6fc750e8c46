"""The page of the study of all worlds and recipes."""

from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.report.study_page import Chart, Curve, StudyPage, Table
from detection_study.text import COVERED, RULES

Results = dict[str, Any]

_GOLDEN = (1, 3, 10, 25)


def write_detection_page(path: Path, found: Results) -> None:
    """Write the page, atomically.

    Args:
        path: file to write.
        found: the study as JSON.

    Raises:
        RecordError: the file cannot be written.
    """
    plan = found["plan"]
    size = plan["size"]
    subtitle = (
        f"{plan['rigs']} rigs in every world, each with {size['golden']} golden parts, {size['good']} good ones and "
        f"{size['bad']} of each class of defects, seed {plan['seed']}"
    )
    charts = [_power(where, results) for where, results in _cases(found)]
    title = "How often good parts fail and bad ones pass"
    StudyPage(title, subtitle, charts, tables_of(found), found["notes"]).write(path)


def _cases(found: Results) -> list[tuple[str, Results]]:
    return [
        (f"{world}, {recipe}", results)
        for world, by in found["worlds"].items()
        for recipe, results in by.items()
    ]


def percent(rate: Results) -> str:
    """A rate with its interval."""
    if not rate["of"]:
        return "–"
    low, high = rate["interval"]
    return f"{rate['rate']:.1%} ({low:.1%}–{high:.1%})"


def _short(rate: Results) -> str:
    return f"{rate['rate']:.0%}" if rate["of"] else "–"


def _area(found: Results) -> str:
    return "–" if found["value"] is None else f"{found['value']:.3f} ± {found['u']:.3f}"


def tables_of(found: Results) -> list[Table]:
    """The tables of a study."""
    tables = []
    if found["worlds"]:
        tables = [_false_alarms(found), _coverage(found), _detection(found), _diagnosis(found)]
    return [*tables, _rendered(found["rendered"])] if found["rendered"] else tables


def _false_alarms(found: Results) -> Table:
    cases = _cases(found)
    rows = [(where, *(percent(results["false_alarms"][key]) for key in RULES)) for where, results in cases]
    rows = [
        (*row, percent(results["area_over_limit"])) for row, (_, results) in zip(rows, cases, strict=True)
    ]
    note = "Nominal 1 %; 95 % intervals, in which parts of one rig count together."
    return Table("False alarms", ("good parts that are flagged", *RULES.values(), "area"), tuple(rows), note)


def _coverage(found: Results) -> Table:
    rows = tuple(
        (where, *(percent(results["coverage"][key]) for key in COVERED)) for where, results in _cases(found)
    )
    return Table("Coverage of 95 % intervals", ("where", *COVERED.values()), rows, "Contrasts of good parts.")


def _detection(found: Results) -> Table:
    rows = [
        (
            one["title"],
            where,
            *(_short(one["power"][key]) for key in RULES),
            _short(one["area_over_limit"]),
            _area(one["auc"]),
            _area(one["ideal"]),
        )
        for where, results in _cases(found)
        for one in results["classes"]
    ]
    columns = ("class", "where", *RULES.values(), "area", "AUC, 25 golden parts", "AUC of the ideal observer")
    note = (
        "By the means of all poses at nominal 1 %, and by the area; the ideal observer sees the means alone."
    )
    return Table("Detection", columns, tuple(rows), note)


def _diagnosis(found: Results) -> Table:
    rows = [
        (
            one["title"],
            where,
            *(percent(one["diagnosis"][key]) for key in ("first", "tied", "wrong", "interval")),
            ", ".join(f"{name} {count}" for name, count in one["diagnosis"]["named"]),
        )
        for where, results in _cases(found)
        for one in results["classes"]
        if one["diagnosis"] is not None
    ]
    columns = (
        "class", "where", "right cause first", "among the ties", "confidently wrong", "severity in its interval",
        "named first",
    )  # fmt: skip
    return Table("Diagnosis against three golden parts", columns, tuple(rows))


def _rendered(rows: list[Results]) -> Table:
    found = tuple(
        (
            row["where"],
            f"{row['pass']} of {row['good']}",
            *(
                (f"{len(row[key])} of {row['bad']}" if "bad" in row else "–")
                for key in ("fail", "first", "tied")
            ),
            f"{len(row['held'])} of {row['severities']}" if "bad" in row else "–",
        )
        for row in rows
    )
    columns = (
        "judged against", "good: PASS", "bad: FAIL", "right cause first", "among the ties", "severity in its interval",
    )  # fmt: skip
    return Table("Parts rendered by Mitsuba", columns, found)


def _power(where: str, results: Results) -> Chart:
    lines = [
        Curve(
            one["title"],
            np.array(_GOLDEN, dtype=np.float64),
            np.array([one["power"][f"calibrated-{count}"]["rate"] for count in _GOLDEN]),
        )
        for one in results["classes"]
        if one["parts"] > 0
    ]
    return Chart(f"{where}: found by the means at nominal 1 %", "golden parts [1]", "found [1]", tuple(lines))
