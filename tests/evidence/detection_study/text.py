"""The results of a detection study as Markdown, put between two marks of a page, and the numbers that they rest on."""

import json
from pathlib import Path
from typing import Any

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import UsageError

Results = dict[str, Any]

BEGIN, END = "<!-- results: begin -->", "<!-- results: end -->"
CAUSES_BEGIN, CAUSES_END = "<!-- causes: begin -->", "<!-- causes: end -->"
SEPARABLE = 80.0
"""Per cent of the parts for which the ideal observer names the right cause, from which on a defect is separable."""
DIAGNOSED = ("first", "tied", "interval", "separable")
RULES = {
    "plastic-0": "prediction, plastic never measured",
    "calibrated-0": "prediction, plastic calibrated, without `[scatter]`",
    "spread-0": "… with `[scatter]`, as inspections",
    "plastic-3": "3 golden parts, plastic never measured",
    "calibrated-1": "1 golden part, plastic calibrated",
    "calibrated-3": "3 golden parts",
    "calibrated-10": "10 golden parts",
    "calibrated-25": "25 golden parts",
}
POWERED = ("spread-0", "calibrated-1", "calibrated-3", "calibrated-25")
COVERED = {
    "measured": "measured contrasts hold the true ones",
    "plastic": "predicted contrasts, plastic never measured",
    "calibrated": "predicted contrasts, plastic calibrated, without `[scatter]`",
    "spread": "… with `[scatter]`, as inspections",
}


def numbers_of(found: Results) -> Results:
    """Numbers of a study that its page shows, in a small table stored next to it."""
    cases = []
    for world, by in found["worlds"].items():
        for recipe, results in by.items():
            cases.append(
                {
                    "world": world,
                    "recipe": recipe,
                    "residual": round(results["calibration"]["residual_over_noise"], 1),
                    "alarms": {key: _rate(results["false_alarms"][key]) for key in RULES},
                    "uniform": {key: round(results["uniform"][key], 3) for key in RULES},
                    "coverage": {key: _rate(results["coverage"][key]) for key in COVERED},
                    "classes": [_class(one) for one in results["classes"]],
                }
            )
    size = found["plan"]["size"]
    plan = {key: found["plan"][key] for key in ("rigs", "pictured", "seed")}
    plan["worlds"] = found["plan"]["photographed"]
    plan |= {key: size[key] for key in ("golden", "good", "bad")}
    return {"plan": plan, "cases": cases, "rendered": found["rendered"]}


def causes_of(found: Results) -> Results:
    """Numbers of a study's diagnosis: per cent of every world, by recipe and class; None where nothing was counted."""
    plan = {key: found["plan"][key] for key in ("rigs", "seed")} | {"worlds": list(found["worlds"])}
    recipes = list(next(iter(found["worlds"].values())))
    counted: Results = {recipe: {} for recipe in recipes}
    for by in found["worlds"].values():
        for recipe in recipes:
            for one in by[recipe]["classes"]:
                rates = counted[recipe].setdefault(one["title"], {key: [] for key in DIAGNOSED})
                for key in DIAGNOSED:
                    told = one["diagnosis"][key]
                    rates[key].append(round(100.0 * told["rate"], 1) if told["of"] else None)
    parts = max(
        one["diagnosis"]["first"]["of"]
        for by in found["worlds"].values()
        for one in by[recipes[0]]["classes"]
    )
    return {"plan": plan | {"parts": parts}, "counted": counted}


def causes_block(numbers: Results) -> str:
    """Markdown of the diagnosis, from the stored numbers."""
    plan, counted = numbers["plan"], numbers["counted"]
    recipes = list(counted)
    titles = list(counted[recipes[0]])
    keys = ("first", "tied", "interval")
    rows = [
        [
            title,
            *(" / ".join(_over_worlds(counted[recipe][title][key]) for key in keys) for recipe in recipes),
        ]
        for title in titles
    ]
    ideal = [
        [title, *(_over_worlds(counted[recipe][title]["separable"]) for recipe in recipes)]
        for title in titles
        if any(_known(counted[recipe][title]["separable"]) for recipe in recipes)
    ]
    intro = (
        f"{plan['rigs']} rigs in each of {len(plan['worlds'])} worlds, {plan['parts']} parts of a class, seed "
        f"{plan['seed']}. Per cent of all worlds, and in brackets of the world where it is least."
    )
    lines = [f"- **{recipe}**: {_of_separable(counted[recipe])}" for recipe in recipes]
    return "\n\n".join(
        [
            intro,
            _table("right cause first / among the ties / severity within its interval", recipes, rows),
            _table("right cause first for the ideal observer", recipes, ideal),
            "\n".join(lines),
        ]
    )


def _known(values: list[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def _over_worlds(values: list[float | None]) -> str:
    """Mean over the worlds, and the least of them."""
    known = _known(values)
    return f"{sum(known) / len(known):.0f} ({min(known):.0f})" if known else "–"


def _of_separable(classes: Results) -> str:
    """What holds of the classes that the ideal observer separates."""
    shown = [
        (title, rates)
        for title, rates in classes.items()
        if (known := _known(rates["separable"])) and sum(known) / len(known) >= SEPARABLE
    ]
    if not shown:
        return "no defect is separable"
    means = [
        sum(every := [value for _, rates in shown for value in _known(rates[key])]) / len(every)
        for key in ("first", "tied", "interval")
    ]
    return (
        f"separable are {', '.join(title for title, _ in shown)}; of these the right cause is first in "
        f"{means[0]:.0f} %, among the ties in {means[1]:.0f} %, and {means[2]:.0f} % of the severities are within "
        "their intervals"
    )


def _rate(results: Results) -> list[float]:
    """Rate and its interval, in per cent; empty where nothing was tried."""
    if not results["of"]:
        return []
    low, high = results["interval"]
    return [round(100.0 * value, 1) for value in (results["rate"] or 0.0, low, high)]


def _class(one: Results) -> Results:
    about = one["diagnosis"]
    keys = ("first", "tied", "wrong", "interval")
    told = {} if about is None else {key: _rate(about[key]) for key in keys}
    return {
        "name": one["name"],
        "title": one["title"],
        "power": {key: _rate(one["power"][key]) for key in RULES},
        "area": _rate(one["area_over_limit"]),
        "auc": _round(one["auc"]["value"]),
        "ideal": _round(one["ideal"]["value"]),
        "diagnosis": told,
    }


def _round(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def block_of(numbers: Results) -> str:
    """Markdown of the results, from the stored numbers."""
    plan, cases = numbers["plan"], numbers["cases"]
    rigs = plan["rigs"]
    parts = [
        (
            f"{rigs} rigs in each world, each with {plan['golden']} golden parts, {plan['good']} good ones that are "
            f"judged and {plan['bad']} of every class: {rigs * plan['good']} good parts and {rigs * plan['bad']} of a "
            f"class, seed {plan['seed']}. Parts of {plan['pictured']} of them are photographed in the worlds "
            f"{', '.join(plan['worlds'])}: area and local defects are those of {plan['pictured'] * plan['good']} and "
            f"{plan['pictured'] * plan['bad']} parts. Per cent, with 95 % intervals in which parts of one rig count "
            "together."
        )
    ]
    for recipe in dict.fromkeys(case["recipe"] for case in cases):
        own = [case for case in cases if case["recipe"] == recipe]
        worlds = [case["world"] for case in own]
        parts.append(f"### Poses: {recipe}")
        rows = [[title, *(_interval(case["alarms"][key]) for case in own)] for key, title in RULES.items()]
        parts.append(_table("good parts flagged at nominal 1 %", worlds, rows))
        rows = [
            [title, *(_interval(case["coverage"][key]) for case in own)] for key, title in COVERED.items()
        ]
        rows.append(["calibration: residual over noise", *(f"{case['residual']:g}" for case in own)])
        parts.append(_table("95 % intervals of contrasts that hold", worlds, rows))
        parts.append(
            _table(
                "found by the means with " + " / ".join(_short(key) for key in POWERED), worlds, _power(own)
            )
        )
        rows = _by_class(own, _areas)
        parts.append(_table("AUC of the means, 25 golden parts / ideal observer", worlds, rows))
        parts.append(
            _table("area over its limit", worlds, _by_class(own, lambda one: _interval(one["area"])))
        )
        told = [case for case in own if any(one["diagnosis"] for one in case["classes"])]
        if told:
            title = "3 golden parts: right cause first / among the ties / confidently wrong / interval holds severity"
            parts.append(_table(title, [case["world"] for case in told], _by_class(told, _diagnosed)))
    if numbers["rendered"]:
        parts.append(rendered_table(numbers["rendered"]))
    return "\n\n".join(parts)


def rendered_table(rows: list[Results]) -> str:
    """Table of the parts that Mitsuba rendered."""
    columns = [
        "good: PASS",
        "least p of good",
        "bad: FAIL",
        "right cause first",
        "among the ties",
        "severity held",
    ]
    found = []
    for row in rows:
        low = row["pass_interval"][0]
        good = f"{row['pass']} of {row['good']} (≥ {100.0 * low:.0f} %)"
        least = f"{row['p_values'][0]:.2g}" if row["p_values"] else "–"
        if "bad" in row:
            of = f"of {row['bad']}"
            told = [f"{len(row[key])} {of}" for key in ("fail", "first", "tied")]
            told.append(f"{len(row['held'])} of {row['severities']}")
        else:
            told = ["–"] * 4
        found.append([row["where"], good, least, *told])
    missed = [
        f"{row['where']}: passed {', '.join(name for name in _BAD if name not in row['fail'])}"
        for row in rows
        if "bad" in row and len(row["fail"]) < row["bad"]
    ]
    lines = [f"- {line}" for line in missed]
    return "\n".join(
        ["### Parts rendered by Mitsuba", "", _table("judged against", columns, found), "", *lines]
    )


_BAD = (
    "angle-1", "angle-0.5", "angle+0.5", "angle+1", "rough+20", "rough+60", "height-loss", "wear-5", "wear-10",
    "burrs-2", "burrs-10", "scratches",
)  # fmt: skip


def _short(rule: str) -> str:
    count = rule.rpartition("-")[2]
    return "the prediction" if count == "0" else f"{count} golden"


def _interval(values: list[float]) -> str:
    return f"{values[0]:g} ({values[1]:g}–{values[2]:g})" if values else "–"


def _table(first: str, columns: list[str], rows: list[list[str]]) -> str:
    head = [f"| {' | '.join([first, *columns])} |", "|" + "---|" * (len(columns) + 1)]
    return "\n".join([*head, *(f"| {' | '.join(row)} |" for row in rows)])


def _by_class(cases: list[Results], shown: Any) -> list[list[str]]:
    return [
        [one["title"], *(shown(case["classes"][number]) for case in cases)]
        for number, one in enumerate(cases[0]["classes"])
    ]


def _power(cases: list[Results]) -> list[list[str]]:
    return _by_class(cases, lambda one: " / ".join(_first(one["power"][key]) for key in POWERED))


def _first(values: list[float]) -> str:
    return f"{values[0]:g}" if values else "–"


def _diagnosed(one: Results) -> str:
    told = one["diagnosis"]
    return " / ".join(_first(told.get(key, [])) for key in ("first", "tied", "wrong", "interval"))


def _areas(one: Results) -> str:
    return "–" if one["auc"] is None else f"{one['auc']:.3f} / {one['ideal']:.3f}"


def with_results(page: str, numbers: Results) -> str:
    """A Markdown page with the results between its marks.

    Raises:
        UsageError: the page has no such marks.
    """
    page = _between(page, BEGIN, END, block_of(numbers))
    if "causes" in numbers and CAUSES_BEGIN in page:
        page = _between(page, CAUSES_BEGIN, CAUSES_END, causes_block(numbers["causes"]))
    return page


def _between(page: str, begin: str, end: str, block: str) -> str:
    if page.count(begin) != 1 or page.count(end) != 1:
        raise UsageError(f"the page must have one line {begin} and one {end}: the results come between them")
    before, _, rest = page.partition(begin)
    return f"{before}{begin}\n\n{block}\n\n{end}{rest.partition(end)[2]}"


def write_results(path: Path, found: Results) -> None:
    """Write the results of a study into a Markdown page, and its numbers next to it (``.json``).

    A study with a diagnosis writes only its causes where the page has marks for them: it may be a smaller one.

    Raises:
        UsageError: the page is missing or has no marks.
        RecordError: it cannot be written.
    """
    try:
        page = path.read_text(encoding="utf-8")
    except OSError as problem:
        raise UsageError(f"{path} cannot be read: {problem.strerror}") from problem
    stored = path.with_suffix(".json")
    before = json.loads(stored.read_text(encoding="utf-8")) if stored.is_file() else {}
    if before and found["plan"]["diagnosed"] and found["worlds"] and CAUSES_BEGIN in page:
        numbers = before | {"causes": causes_of(found)}
    else:
        numbers = numbers_of(found) | ({"causes": before["causes"]} if "causes" in before else {})
    write_text(path, with_results(page, numbers))
    write_text(stored, json.dumps(numbers, indent=1, ensure_ascii=False) + "\n")
