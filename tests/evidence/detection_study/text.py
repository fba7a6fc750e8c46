"""The results of a detection study as Markdown, put between two marks of a page, and the numbers that they rest on."""

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import UsageError
from detection_study.product import OF_INTEREST

Results = dict[str, Any]

BEGIN, END = "<!-- results: begin -->", "<!-- results: end -->"
CAUSES_BEGIN, CAUSES_END = "<!-- causes: begin -->", "<!-- causes: end -->"
SEPARABLE = 80.0
"""Per cent of the parts for which the ideal observer names the right cause, from which on a defect is separable."""
DIAGNOSED = ("first", "tied", "interval", "separable")
BY_REFERENCE = {
    "plastic": "prediction, plastic never measured",
    "design": "prediction, plastic calibrated",
    "golden-1x1": "1 golden part",
    "golden-3x1": "3 golden parts of one batch",
    "golden-5x1": "5 of one batch",
    "golden-10x1": "10 of one batch",
    "golden-25x1": "25 of one batch",
    "golden-3x2": "3 golden parts of two batches",
    "golden-5x2": "5 of two batches",
    "golden-10x2": "10 of two batches",
    "golden-25x2": "25 of two batches",
    "golden-25x5": "25 of five batches",
    "plastic-3x2": "3 of two batches, plastic never measured",
    "lot-5-0": "lot of 5, all good",
    "lot-5-1": "lot of 5, one bad",
    "lot-10-0": "lot of 10, all good",
    "lot-10-1": "lot of 10, one bad",
    "lot-10-2": "lot of 10, two bad",
}
_PASS = ("plastic", "design", "golden-3x2", "golden-10x2", "golden-25x5", "lot-5-1", "lot-10-1")
SHOWN = {"fail": (*_PASS[:2], "golden-1x1", *_PASS[2:]), "pass": _PASS}
"""References in the tables of found parts, and in those of parts that pass."""
COVERED = {
    "measured": "measured contrasts hold the true ones",
    "plastic": "predicted contrasts, plastic never measured",
    "calibrated": "predicted contrasts, plastic calibrated",
}
_ALARMS = ("golden-3x2", "golden-5x2", "golden-10x2", "golden-25x2", "golden-25x5", "lot-5-1", "lot-10-1")
_FOUND = {
    "height-loss": {"standard": 98.0, "tilted": 98.0},
    "wear": {"standard": 98.0, "tilted": 98.0},
    "ridge-angle-1": {"standard": 95.0, "tilted": 99.0},
    "ridge-angle": {"standard": 55.0, "tilted": 80.0},
    "roughness": {"standard": 80.0, "tilted": 98.0},
}
"""Goals of what three golden parts of two batches find, per cent, by class and poses."""
_LEVEL, _WRONG = (0.3, 2.0), 5.0
"""Goals of false alarms, and of wrong PASS at exactly the smallest interesting size, per cent."""


def numbers_of(found: Results) -> Results:
    """Numbers of a study that its page shows, in a small table stored next to it."""
    cases = []
    for world, by in found["worlds"].items():
        for recipe, results in by.items():
            cases.append(
                {
                    "world": world,
                    "recipe": recipe,
                    "residual": round(results["residual"], 1),
                    "good": _outcomes(results["good"]),
                    "area": _rate(results["area_over_limit"]),
                    "coverage": {key: _rate(results["coverage"][key]) for key in COVERED},
                    "classes": [
                        {key: one[key] for key in ("name", "title")}
                        | {"area": _rate(one["area_over_limit"]), "by": _outcomes(one["by"])}
                        for one in results["classes"]
                    ],
                }
            )
    plan = {key: found["plan"][key] for key in ("rigs", "pictured", "seed", "photographed", "size")}
    return {"plan": plan, "cases": cases, "rendered": found["rendered"]}


def _outcomes(by: Results) -> Results:
    return {
        name: {key: _rate(value) for key, value in rates.items() if value["of"]} for name, rates in by.items()
    }


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
                    told = one["separable"] if key == "separable" else one["diagnosis"][key]
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


def block_of(numbers: Results) -> str:
    """Markdown of the results, from the stored numbers."""
    plan, cases = numbers["plan"], numbers["cases"]
    rigs, pictured, size = plan["rigs"], plan["pictured"], plan["size"]
    computed = rigs - pictured
    parts = [
        (
            f"{rigs} rigs in each world, seed {plan['seed']}. Of {computed} the means of the poses are computed: "
            f"{computed * size['good']} good parts, {computed * size['bad']} of a class, and {computed} lots. Of "
            f"{pictured} in the worlds {', '.join(plan['photographed'])} the parts are photographed: "
            f"{pictured * size['good_pictured']} good ones and {pictured * size['bad_pictured']} of a class, all that "
            "there is of the area and of local defects. Per cent, with 95 % intervals in which parts of one rig count "
            "together."
        )
    ]
    recipes = list(dict.fromkeys(case["recipe"] for case in cases))
    parts += ["### Goals", _goals(cases, recipes)] if cases else []
    for recipe in recipes:
        own = [case for case in cases if case["recipe"] == recipe]
        worlds = [case["world"] for case in own]

        def of_good(shown: Any, names: Sequence[str], own: list[Results] = own) -> list[list[str]]:
            return [
                [BY_REFERENCE[name], *(shown(case["good"].get(name, {})) for case in own)] for name in names
            ]

        def by_class(shown: Any, own: list[Results] = own) -> list[list[str]]:
            return [
                [one["title"], *(shown(case["classes"][number]) for case in own)]
                for number, one in enumerate(own[0]["classes"])
            ]

        def several(key: str, one: Results) -> str:
            return " / ".join(_first(one["by"].get(name, {}).get(key, [])) for name in SHOWN[key])

        parts.append(f"### Poses: {recipe}")
        flagged = of_good(lambda one: _interval(one.get("fail", [])), list(BY_REFERENCE))
        flagged.append(["area over its limit", *(_interval(case["area"]) for case in own)])
        parts.append(_table("good parts that fail at nominal 1 %", worlds, flagged))
        parts.append(
            _table(
                "good parts that pass",
                worlds,
                of_good(lambda one: _interval(one.get("pass", [])), SHOWN["pass"]),
            )
        )
        names = " / ".join(_short(name) for name in SHOWN["fail"])
        parts.append(_table(f"FAIL with {names}", worlds, by_class(partial(several, "fail"))))
        wrong = [
            [
                f"{one['title']}, {BY_REFERENCE[name]}",
                *(_wrong(case["classes"][number]["by"].get(name, {})) for case in own),
            ]
            for number, one in enumerate(own[0]["classes"])
            for name in SHOWN["pass"]
            if one["by"].get(name, {}).get("pass")
        ]
        parts.append(_table("wrong PASS (the defect itself excluded)", worlds, wrong))
        rows = [
            [title, *(_interval(case["coverage"][key]) for case in own)] for key, title in COVERED.items()
        ]
        rows.append(["calibration: residual over noise", *(f"{case['residual']:g}" for case in own)])
        parts.append(_table("95 % intervals of contrasts that hold", worlds, rows))
        parts.append(_table("area over its limit", worlds, by_class(lambda one: _interval(one["area"]))))
    if numbers["rendered"]:
        parts.append(rendered_table(numbers["rendered"]))
    return "\n\n".join(parts)


def _wrong(rates: Results) -> str:
    return f"{_interval(rates.get('pass', []))}, ({_first(rates.get('excluded', []))})"


def _goals(cases: list[Results], recipes: list[str]) -> str:
    """Table of the goals: least and greatest of the worlds, and in how many of them the goal is met."""

    def cell(values: list[float], low: float, high: float) -> str:
        met = sum(low <= value <= high for value in values)
        return f"{min(values):g}–{max(values):g}, {met} of {len(values)}" if values else "–"

    def good(recipe: str, name: str) -> list[float]:
        own = [case["good"].get(name, {}) for case in cases if case["recipe"] == recipe]
        return [one["fail"][0] for one in own if "fail" in one]

    def bad(recipe: str, name: str, key: str, kind: str) -> list[float]:
        own = [one for case in cases if case["recipe"] == recipe for one in case["classes"]]
        rates = [one["by"].get(name, {}).get(key, []) for one in own if one["name"] == kind]
        return [rate[0] for rate in rates if rate]

    rows = [
        [
            f"good parts that fail, {BY_REFERENCE[name]}: {_LEVEL[0]:g} to {_LEVEL[1]:g}",
            *(cell(good(recipe, name), *_LEVEL) for recipe in recipes),
        ]
        for name in _ALARMS
    ]
    for name in SHOWN["pass"]:
        row = [f"wrong PASS, {BY_REFERENCE[name]}: at most {_WRONG:g}"]
        for recipe in recipes:
            each = zip(*(bad(recipe, name, "pass", kind) for kind in OF_INTEREST), strict=True)
            row.append(cell([max(of) for of in each], 0.0, _WRONG))
        rows.append(row)
    for kind, goals in _FOUND.items():
        title = next(one["title"] for one in cases[0]["classes"] if one["name"] == kind)
        stated = ", ".join(f"{goal:g} {recipe}" for recipe, goal in goals.items())
        row = [f"{title} found with 3 golden parts of two batches: at least {stated}"]
        for recipe in recipes:
            goal = goals.get(recipe, goals["tilted"])
            row.append(cell(bad(recipe, "golden-3x2", "fail", kind), goal, 100.0))
        rows.append(row)
    note = (
        "Least and greatest of the worlds, and in how many of them the goal is met; of wrong PASS the class with most. "
        "The goals of tilted poses are those of suggested ones too."
    )
    return f"{note}\n\n{_table('goal', recipes, rows)}"


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


def _short(name: str) -> str:
    kind, _, rest = name.partition("-")
    if kind == "lot":
        return f"lot of {rest.partition('-')[0]}"
    return f"{rest.partition('x')[0]} golden" if kind == "golden" else name


def _interval(values: list[float]) -> str:
    return f"{values[0]:g} ({values[1]:g}–{values[2]:g})" if values else "–"


def _table(first: str, columns: list[str], rows: list[list[str]]) -> str:
    head = [f"| {' | '.join([first, *columns])} |", "|" + "---|" * (len(columns) + 1)]
    return "\n".join([*head, *(f"| {' | '.join(row)} |" for row in rows)])


def _first(values: list[float]) -> str:
    return f"{values[0]:g}" if values else "–"


def with_results(page: str, numbers: Results) -> str:
    """A Markdown page with the results between its marks.

    Raises:
        UsageError: the page has no such marks.
    """
    if "cases" in numbers:
        page = _between(page, BEGIN, END, block_of(numbers))
    if "causes" in numbers:
        page = _between(page, CAUSES_BEGIN, CAUSES_END, causes_block(numbers["causes"]))
    return page


def _between(page: str, begin: str, end: str, block: str) -> str:
    if page.count(begin) != 1 or page.count(end) != 1:
        raise UsageError(f"the page must have one line {begin} and one {end}: the results come between them")
    before, _, rest = page.partition(begin)
    return f"{before}{begin}\n\n{block}\n\n{end}{rest.partition(end)[2]}"


def write_results(path: Path, found: Results) -> None:
    """Write the results of a study into a Markdown page, and its numbers next to it (``.json``).

    A study with a diagnosis writes its causes only: it may be a smaller one.

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
    if found["plan"]["diagnosed"]:
        numbers = before | {"causes": causes_of(found)}
    else:
        numbers = numbers_of(found) | ({"causes": before["causes"]} if "causes" in before else {})
    write_text(path, with_results(page, numbers))
    write_text(stored, json.dumps(numbers, indent=1, ensure_ascii=False) + "\n")
