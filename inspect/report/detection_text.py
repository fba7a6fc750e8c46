"""The results of a detection study as Markdown, put between two marks of a page, and the numbers that they rest on."""

import json
from pathlib import Path
from typing import Any

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import UsageError

Results = dict[str, Any]

BEGIN, END = "<!-- results: begin -->", "<!-- results: end -->"
TARGET_AUC = 0.99
ALARMS = {
    "shipped": "D² against the prediction, as shipped",
    "spread": "… with the spread of the ridge angle stated",
    "golden": "T² from 25 golden parts, as shipped",
    "normal": "T² by the normal theory",
    "taught": "prediction shifted to 25 golden parts, its own budget",
    "area share over its limit": "area over its limit",
    "verdict FAIL": "verdict, means and area together",
}
COVERED = {
    "measured contrast holds the true one (measurement alone)": "measured contrasts hold the true ones",
    "predicted contrast (as shipped)": "predicted contrasts hold the measured ones",
    "ridge_angle_deg, fitted over the tilts": "ridge angle, fitted over the tilts",
    "alpha_along, fitted over the tilts": "roughness along the ridges, fitted",
    "alpha_across, fitted over the tilts": "roughness across the ridges, fitted",
}
INTERVALS = {
    "spread_stated": "the spread of the ridge angle stated",
    "doubt_of_this_world": "the doubt as in this world",
}


def numbers_of(found: Results) -> Results:
    """Numbers of a study that its page shows, in a small table stored next to it."""
    numbers: Results = {
        "plan": {key: found["plan"][key] for key in ("parts", "defective", "seed")},
        "cases": [],
    }
    for world, by in found["worlds"].items():
        for recipe, results in by.items():
            good = results["good"]
            numbers["cases"].append(
                {
                    "where": f"{world}, {recipe}",
                    "alarms": {key: _rate(good["false_alarms"][key]) for key in ALARMS},
                    "coverage": {
                        key: _rate(good["coverage"][key]) for key in COVERED if key in good["coverage"]
                    },
                    "classes": [_class(one) for one in results["classes"]],
                }
            )
    best = {name: _reaching(rows) for name, rows in found["outlook"].items()}
    return {**numbers, "outlook": best}


def _rate(results: Results) -> list[float]:
    """Rate and its interval, in per cent."""
    low, high = results["interval"]
    return [round(100.0 * value, 1) for value in (results["rate"] or 0.0, low, high)]


def _class(one: Results) -> Results:
    about, scores = one["diagnosis"], one["scores"]
    best = max(("shipped+area", "golden+area"), key=lambda key: scores[key]["auc"])
    numbers: Results = {}
    if one["intervals"] is not None:
        numbers = {key: _rate(one["intervals"][key]) for key in INTERVALS}
        numbers["doubts"] = [
            [round(doubt[key], 3) for key in ("change", "share")] for doubt in one["intervals"]["doubts"]
        ]
    return {
        "name": one["name"],
        "title": one["title"],
        "fails": _rate(one["verdict_fail"])[0],
        "auc": [round(scores[key]["auc"], 3) for key in ("shipped+area", "golden+area")],
        "best": round(scores[best]["auc"], 3),
        "sigmas": round(one["mean_shift_sigmas"], 1),
        "limits": [[source, round(100.0 * share)] for source, share in one["limited_by"][:3]],
        "separable": about["separable"],
        "needed": about["told_apart_from"],
        "first": _rate(about["right_first"])[0],
        "tied": _rate(about["right_tied"])[0],
        "wrong": _rate(about["confidently_wrong"])[0],
        "golden_first": _rate(about["right_first_against_golden"])[0],
        "extent": _rate(about["extent_interval_holds"])[0],
        **numbers,
    }


def _reaching(rows: list[Results]) -> Results:
    """Plans that reach the target area, the first three in the order of trial, and the best of all."""
    short = [{**row, "sigmas": round(row["sigmas"], 1), "auc": round(row["auc"], 3)} for row in rows]
    enough = [row for row in short if row["auc"] >= TARGET_AUC]
    return {"enough": enough[:3], "best": max(short, key=lambda row: row["auc"])}


def block_of(numbers: Results) -> str:
    """Markdown of the results, from the stored numbers."""
    plan, cases = numbers["plan"], numbers["cases"]
    where = [case["where"] for case in cases]
    parts = [
        *numbers.get("notes", []),
        (
            f"{plan['parts']} good parts and {plan['defective']} of every class in each world, seed {plan['seed']}. "
            "Per cent, with 95 % intervals; in bold what is separable by 3 σ."
        ),
        _table(
            "good parts that are flagged at nominal 1 %",
            where,
            [[title, *(_interval(case["alarms"][key]) for case in cases)] for key, title in ALARMS.items()],
        ),
        _table(
            "verdict FAIL as shipped / AUC as shipped / AUC with 25 golden parts", where, _detected(cases)
        ),
        _table(
            "diagnosis: named first / among the ties / confidently wrong / first against golden parts",
            where,
            _diagnosed(cases),
        ),
        _table("95 % intervals that hold the truth", where, _covered(cases)),
        _limits(cases, numbers["outlook"]),
    ]
    return "\n\n".join(parts)


def _interval(values: list[float]) -> str:
    return f"{values[0]:g} ({values[1]:g}–{values[2]:g})"


def _table(first: str, columns: list[str], rows: list[list[str]]) -> str:
    head = [f"| {' | '.join([first, *columns])} |", "|" + "---|" * (len(columns) + 1)]
    return "\n".join([*head, *(f"| {' | '.join(row)} |" for row in rows)])


def _detected(cases: list[Results]) -> list[list[str]]:
    rows = []
    for number, one in enumerate(cases[0]["classes"]):
        cells = [case["classes"][number] for case in cases]
        rows.append(
            [one["title"], *(f"{c['fails']:g} / {c['auc'][0]:.2f} / {c['auc'][1]:.2f}" for c in cells)]
        )
    return rows


def _diagnosed(cases: list[Results]) -> list[list[str]]:
    rows = []
    for number, one in enumerate(cases[0]["classes"]):
        cells = []
        for case in cases:
            c = case["classes"][number]
            text = f"{c['first']:g} / {c['tied']:g} / {c['wrong']:g} / {c['golden_first']:g}"
            cells.append(f"**{text}**" if c["separable"] else text)
        rows.append([one["title"], *cells])
    return rows


def _covered(cases: list[Results]) -> list[list[str]]:
    rows = [
        [title, *(_interval(case["coverage"][key]) if key in case["coverage"] else "–" for case in cases)]
        for key, title in COVERED.items()
    ]
    for number, one in enumerate(cases[0]["classes"]):
        cells = [case["classes"][number] for case in cases]
        rows.append([f"extent of {one['title']}", *(f"{cell['extent']:g}" for cell in cells)])
        for key, words in INTERVALS.items():
            if any(key in cell for cell in cells):
                results = (_interval(cell[key]) if key in cell else "–" for cell in cells)
                rows.append([f"… {words}", *results])
    return rows


def _limits(cases: list[Results], outlook: Results) -> str:
    lines = [
        "What keeps an area under the curve below .99 (better of the two rules; shares of σ² of the means):",
        "",
    ]
    for case in cases:
        for one in case["classes"]:
            if one["best"] < TARGET_AUC:
                why = ", ".join(f"{source} {share:g} %" for source, share in one["limits"])
                lines.append(
                    f"- {one['title']} ({case['where']}): {one['best']:.3f} at {one['sigmas']:g} σ; {why}"
                )
    lines += ["", "What would reach .99 by the means alone, computed for D² against the prediction:", ""]
    for name, results in outlook.items():
        title = next(one["title"] for one in cases[0]["classes"] if one["name"] == name)
        found = (
            "; ".join(_option(row) for row in results["enough"])
            or f"nothing tried; best: {_option(results['best'])}"
        )
        lines.append(f"- {title}: {found}")
    return "\n".join(lines)


def _option(row: Results) -> str:
    return f"{row['poses']}, {row['calibration']} ({row['sigmas']:g} σ, AUC {row['auc']:.3f})"


def with_results(page: str, numbers: Results) -> str:
    """A Markdown page with the results between its marks.

    Raises:
        UsageError: the page has no such marks.
    """
    if page.count(BEGIN) != 1 or page.count(END) != 1:
        raise UsageError(f"the page must have one line {BEGIN} and one {END}: the results come between them")
    before, _, rest = page.partition(BEGIN)
    return f"{before}{BEGIN}\n\n{block_of(numbers)}\n\n{END}{rest.partition(END)[2]}"


def write_results(path: Path, found: Results) -> None:
    """Write the results of a study into a Markdown page, and its numbers next to it (``.json``).

    Raises:
        UsageError: the page is missing or has no marks.
        RecordError: it cannot be written.
    """
    try:
        page = path.read_text(encoding="utf-8")
    except OSError as problem:
        raise UsageError(f"{path} cannot be read: {problem.strerror}") from problem
    numbers = numbers_of(found)
    write_text(path, with_results(page, numbers))
    write_text(path.with_suffix(".json"), json.dumps(numbers, indent=1, ensure_ascii=False) + "\n")
