"""``anisoscope spc``: control charts and capability of measured series."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import MORE
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Html, Json
from anisoscope.cli.progress import progress
from anisoscope.cli.statistics.source import SOURCE, Readable, print_grid
from anisoscope.cli.tables import print_lines
from anisoscope.parameters.charting import Charting
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.operations.statistics import Charts
    from anisoscope.quality.readings import Readings

LISTED = 20  # patterns in the terminal


def _rules(text: str, option: str) -> tuple[int, ...]:
    try:
        return tuple(int(one) for one in text.split(","))
    except ValueError:
        raise UsageError(
            f"{option} takes numbers separated by commas, such as 1,2,5,6, not {text!r}"
        ) from None


OF_CHARTING = Options(
    Charting,
    names={
        "weight": "--lambda",
        "width": "--ewma-limit",
        "center": "--known-mean",
        "sigma": "--known-sigma",
    },
    readers={
        "rules": _rules,
        "against": lambda text, _: tuple(name.strip() for name in text.split(",") if name.strip()),
    },
    groups=dict.fromkeys(
        (
            "of",
            "period",
            "limits_from",
            "weight",
            "width",
            "center",
            "sigma",
            "rules",
            "distribution",
            "drift",
            "against",
        ),
        MORE,
    ),
    whole=True,
)


@with_options(charting=OF_CHARTING)
def spc(
    *,
    source: Readable = SOURCE,
    charting: Given[Charting],
    limits_to: Annotated[Path | None, Parameter(group=MORE)] = None,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Control charts and capability: I-MR, EWMA, Nelson's rules, Cp, Cpk; drift, and what it came with.

    Without --number it prints an overview of all numbers, and the page of --html shows the charts of the first one.
    --recipe also takes a recipe file: its tolerances are then the limits of good parts, and no inspection is left out.
    Without it, and without --lower and --upper, the tolerances in the history are used.

    Exit codes: 0 stable, 1 not stable or drifting, 64 and above no chart is possible.

    Args:
        limits_to: Write the limits of these charts to this file (TOML).

    Examples:
        anisoscope spc --number "ln 0-90" --recipe plate.toml --html spc.html
        anisoscope spc -n "ln 0-90" --subgroup lot --drift --html drift.html
        anisoscope spc --csv heights.csv --lower 9.8 --upper 10.2
    """
    from anisoscope.operations.statistics import control_charts
    from anisoscope.quality.chart_limits import write_chart_limits

    asked = charting.made()
    tolerances = _tolerances(source.which.values.get("recipe"))
    if tolerances is not None:
        source = replace(source, which=replace(cast("Any", source.which), recipe=None))
    readings = source.readings(machine=asked.drift)
    with progress("control charts", quiet=json_) as advance:
        found = control_charts(
            readings, source.number, charting=asked, tolerances=tolerances, on_progress=advance
        )
    first = found.charts[0].number
    title = first if asked.by is None else f"{first}, by {asked.by}"
    if html is not None:
        from anisoscope.report.spc_page import Points, write_spc_page

        drawn = [
            (one.study, Points(one.readings, html), one.drift) for one in found.charts if one.number == first
        ]
        page = f"Control charts: {title}"
        write_spc_page(html, page, _source(readings), found.studies, drawn, found.skipped)
    if limits_to is not None:
        write_chart_limits(limits_to, found.studies, readings.source)
    if json_:
        print_json(found)
    else:
        _show(readings, found)
        if html is not None:
            print_lines(f"{html}: charts of {title}")
    return 0 if found.stable else 1


def _tolerances(recipe: str | None) -> dict[str, float] | None:
    """Tolerances of a recipe file; None where the text is no file."""
    if recipe is None or not Path(recipe).is_file():
        if recipe is not None and recipe.endswith(".toml"):
            raise UsageError(f"--recipe: there is no file {recipe}")
        return None
    from anisoscope.kinds.parts import stating
    from anisoscope.kinds.registry import kind_of

    kind = kind_of(Path(recipe))
    read = kind.read_recipe(Path(recipe))
    return stating(kind, read).tolerances(read)


def _source(readings: "Readings") -> str:
    first, last = readings.moment(0), readings.moment(-1)
    known = first is not None and last is not None
    period = f", {first:%Y-%m-%d %H:%M} to {last:%Y-%m-%d %H:%M %Z}" if known else ""
    return f"{readings.source}: {len(readings)} readings{period}"


def _show(readings: "Readings", found: "Charts") -> None:
    from anisoscope.report.drift_sections import parameter_table
    from anisoscope.report.spc_page import overview, tables

    studies = found.studies
    print_lines(_source(readings))
    if len(studies) > 1 or found.skipped:
        print_grid(overview(studies))
    else:
        for grid in tables(studies[0], LISTED):
            print_grid(grid)
        if studies[0].normality is not None:
            print_lines(f"Anderson-Darling: p {studies[0].normality.p:.3g}, {studies[0].normality.hint}")
        print_lines(*studies[0].notes)
    print_lines(*(f"left out: {line}" for line in found.skipped))
    for study in studies if len(studies) <= LISTED else studies[:1]:
        print_lines(f"{study.name}: {study.verdict}")
    for drift in found.drifts:
        if drift.parameters:
            print_grid(parameter_table(drift))
        print_lines(f"{drift.name}: {drift.verdict}", *drift.notes)
