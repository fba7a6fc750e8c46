"""The page of a detection study: both worlds side by side in tables, ROC curves and p values of the good parts."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from anisoscope.report.detection_text import INTERVALS
from anisoscope.report.figures import MUTED, page_style, svg_uri
from anisoscope.report.page import write_page
from anisoscope.report.study_page import Chart, Curve, Table, chart_figure, chart_uri

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Results = dict[str, Any]

RULE_TITLES = {
    "shipped": "prediction, as shipped",
    "spread": "… with the spread of the ridge angle stated",
    "known": "… and roughness, albedo known 3× better",
    "golden": "25 golden parts, T²",
    "normal": "25 golden parts, T² by the normal theory",
    "taught": "prediction shifted to 25 golden parts",
}


def write_detection_page(path: Path, found: Results) -> None:
    """Write the page, atomically.

    Args:
        path: file to write.
        found: the study as JSON.

    Raises:
        RecordError: the file cannot be written.
    """
    plan = found["plan"]
    subtitle = (
        f"{plan['parts']} good parts and {plan['defective']} of each class of defects in every world, "
        f"seed {plan['seed']}"
    )
    groups = [
        *((f"ROC, {_where(world, recipe)}", _roc(results)) for world, recipe, results in _cases(found)),
        ("P values of good parts", [_p_values(found, world, recipe) for world, recipe, _ in _cases(found)]),
    ]
    content = {
        "title": "How often good parts fail and bad ones pass",
        "subtitle": subtitle,
        "tables": tables_of(found),
        "groups": groups,
        "notes": found["notes"],
    }
    write_page(path, "detection.html", content)


def _cases(found: Results) -> list[tuple[str, str, Results]]:
    return [
        (world, recipe, results) for world, by in found["worlds"].items() for recipe, results in by.items()
    ]


def _where(world: str, recipe: str) -> str:
    return f"{world} world, {recipe} recipe"


def tables_of(found: Results) -> list[Table]:
    """The tables of a study, worlds and recipes side by side."""
    return [
        _false_alarms(found),
        _detection(found),
        _means(found),
        _diagnosis(found),
        _coverage(found),
        _limits(found),
        _outlook(found),
    ]


def percent(rate: Results) -> str:
    """A rate with its interval."""
    if not rate["of"]:
        return "–"
    low, high = rate["interval"]
    return f"{rate['rate']:.1%} ({low:.1%}–{high:.1%})"


def _short(rate: Results) -> str:
    return f"{rate['rate']:.0%}" if rate["of"] else "–"


def _columns(found: Results) -> tuple[str, ...]:
    return tuple(f"{world}, {recipe}" for world, recipe, _ in _cases(found))


def _false_alarms(found: Results) -> Table:
    cases = _cases(found)
    names = list(cases[0][2]["good"]["false_alarms"])
    rows = [
        (
            RULE_TITLES.get(name, name),
            *(percent(results["good"]["false_alarms"][name]) for _, _, results in cases),
        )
        for name in names
        if not name.endswith("+area")
    ]
    note = "Nominal 1 %; 95 % intervals. Marks: chance of the least probable group of deviating cells."
    return Table("False alarms", ("good parts that are flagged", *_columns(found)), tuple(rows), note)


def _detection(found: Results) -> Table:
    cases = _cases(found)
    rows = []
    for number, one in enumerate(cases[0][2]["classes"]):
        cells = []
        for _, _, results in cases:
            scores = results["classes"][number]["scores"]
            both, verdict = scores["shipped+area"], results["classes"][number]["verdict_fail"]
            cells.append(f"{_short(verdict)} / {_short(both['set'])} / {both['auc']:.3f}")
        rows.append((one["title"], *cells))
    note = (
        "Verdict FAIL as shipped (means at nominal 1 %, area over its limit) / means and area at the threshold that "
        "half of the good parts set for 1 % / area under the ROC curve."
    )
    return Table("Detection", ("class", *_columns(found)), tuple(rows), note)


def _means(found: Results) -> Table:
    rows = []
    for world, recipe, results in _cases(found):
        for one in results["classes"]:
            aucs = [
                _auc(one["scores"][key])
                for key in (*RULE_TITLES, "marks", "area", "golden+area", "known+area")
            ]
            rows.append((one["title"], f"{world}, {recipe}", *aucs))
    columns = (
        "class",
        "where",
        *RULE_TITLES.values(),
        "marks",
        "area",
        "golden parts and area",
        "known 3× better and area",
    )
    return Table(
        "Area under the curve by rule",
        columns,
        tuple(rows),
        "Means of the poses alone by every rule, the map alone, and both; ± u.",
    )


def _auc(results: Results) -> str:
    return f"{results['auc']:.3f} ± {results['u']:.3f}"


def _diagnosis(found: Results) -> Table:
    rows = []
    for world, recipe, results in _cases(found):
        for one in results["classes"]:
            about = one["diagnosis"]
            needed = about["told_apart_from"]
            rows.append(
                (
                    one["title"],
                    f"{world}, {recipe}",
                    "yes" if about["separable"] else "no" if needed is None else f"from {abs(needed):.3g}",
                    _short(about["right_first"]),
                    _short(about["right_first_or_second"]),
                    _short(about["right_tied"]),
                    _short(about["confidently_wrong"]),
                    _short(about["right_first_against_golden"]),
                    ", ".join(f"{name} {count}" for name, count in about["first"][:3]),
                    _short(about["extent_interval_holds"]),
                )
            )
    columns = (
        "class", "where", "separable (3 σ)", "right cause first", "first or second", "among the ties",
        "confidently wrong", "first, against golden parts", "named first", "extent in its 95 % interval",
    )  # fmt: skip
    return Table("Diagnosis", columns, tuple(rows))


def _coverage(found: Results) -> Table:
    rows = []
    for world, recipe, results in _cases(found):
        where = f"{world}, {recipe}"
        rows += [(title, where, percent(rate)) for title, rate in results["good"]["coverage"].items()]
        for one in results["classes"]:
            extent = f"extent of {one['title']}"
            rows.append((extent, where, percent(one["diagnosis"]["extent_interval_holds"])))
            if one["intervals"] is not None:
                known = one["intervals"]
                rows += [
                    (f"{extent}, {words}", where, percent(known[key])) for key, words in INTERVALS.items()
                ]
                rows.append((f"{extent}, that doubt", where, _doubts(known["doubts"])))
    note = (
        "The spread of the ridge angle is that of good parts. Doubts as in this world: of the change of ln L and of "
        "the share of deviating cells, counted on one half of the parts, tried on the other, and the halves change "
        "places; the spread is stated as well."
    )
    return Table("Coverage of 95 % intervals", ("quantity", "where", "covered"), tuple(rows), note)


def _doubts(halves: list[Results]) -> str:
    change, share = (" and ".join(f"{half[key]:.1%}" for half in halves) for key in ("change", "share"))
    return f"change {change}, share {share}"


def _limits(found: Results) -> Table:
    rows = [
        (
            one["title"],
            f"{world}, {recipe}",
            f"{one['mean_shift_sigmas']:.2f}",
            ", ".join(f"{source} {share:.0%}" for source, share in one["limited_by"]),
        )
        for world, recipe, results in _cases(found)
        for one in results["classes"]
    ]
    note = "Shift of the class from the good parts, in σ of the combination that tells most, and what makes up σ²."
    return Table(
        "What limits detection by the means",
        ("class", "where", "shift [σ]", "share of σ²"),
        tuple(rows),
        note,
    )


def _outlook(found: Results) -> Table:
    rows = [
        (name, row["poses"], row["calibration"], f"{row['sigmas']:.2f}", f"{row['auc']:.3f}")
        for name, tried in found["outlook"].items()
        for row in tried
    ]
    return Table(
        "What other poses and less uncertainty would reach",
        ("class", "poses", "uncertainties", "shift [σ]", "area under the curve of D²"),
        tuple(rows),
        "Computed, not simulated: distance of the class from all that good parts may be.",
    )


def _roc(results: Results) -> list[tuple[str, str]]:
    charts = []
    for one in results["classes"]:
        lines = [
            Curve(_name(key), np.array(false), np.array(found)) for key, (false, found) in one["roc"].items()
        ]
        diagonal = np.linspace(0.0, 1.0, 2)
        lines.append(Curve("chance", diagonal, diagonal, dashed=True))
        chart = Chart(one["title"], "false alarms [1]", "detected [1]", tuple(lines), points=False)
        charts.append((chart_uri(chart), one["title"]))
    return charts


def _name(key: str) -> str:
    return {
        "shipped+area": "as shipped",
        "known+area": "material known 3× better",
        "golden+area": "golden parts",
    }[key]


def _p_values(found: Results, world: str, recipe: str) -> tuple[str, str]:
    import matplotlib as mpl

    about = found["worlds"][world][recipe]["good"]["p_values"]
    with mpl.rc_context(page_style()):
        figure = chart_figure(1, 1)
        axes: Axes = figure.subplots()
        for rule in ("shipped", "spread", "golden"):
            counts = np.array(about[rule]["histogram"], dtype=np.float64)
            edges = np.linspace(0.0, 1.0, len(counts) + 1)
            axes.stairs(counts / max(counts.sum(), 1.0) * len(counts), edges, label=RULE_TITLES[rule])
        axes.axhline(1.0, color=MUTED, linestyle="--", linewidth=0.9)
        axes.set_xlabel("p of the means [1]")
        axes.set_ylabel("density [1]")
        axes.legend(frameon=False, fontsize=7.0)
        return svg_uri(figure), _where(world, recipe)
