"""``anisoscope spc``: control charts and capability of measured series."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.history.options import ALL, Place, Selection
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.statistics.source import Csv, Html, Limit, Number, print_grid, readings_from
from anisoscope.cli.tables import print_lines

if TYPE_CHECKING:
    from anisoscope.operations.statistics import Charts
    from anisoscope.quality.readings import Readings

LISTED = 20  # patterns in the terminal


@dataclass(frozen=True)
@everyday("chart", "subgroup", "by", "baseline", "lower", "upper")
class Charting:
    """Chart type and rules for a series.

    Attributes:
        chart: i-mr: single values; xbar-r, xbar-s: means of subgroups and their range or standard deviation; p: share
            of parts that FAIL; u: deviations of a part; p-laney, u-laney: where lots differ. By default i-mr, with
            --subgroup xbar-s.
        subgroup: What a subgroup is: lot, day, cavities (one part of each), or how many readings in a row, such as 5.
        of: Number that says how many parts a count of --number is of, in p and u charts.
        by: A chart for each product, recipe, lot, cavity, station or operator.
        baseline: Limits from this many measured values at the start; else from all.
        period: Limits from the values of this reference period, such as 2026-11-01..2026-11-07 or 14d..7d.
        limits_from: Limits of earlier data from this file, for later data.
        limits_to: Write the limits of these charts to this file (TOML).
        width: Limits of the EWMA, in its sigma (L).
        center: Known mean, in place of a baseline; with --known-sigma.
        sigma: Known short-term standard deviation; with --known-mean.
        rules: Nelson's rules that count, such as 1,2,5,6; all eight by default (on average a false alarm in 73 values),
            of p and u charts 1 to 4.
        distribution: Capability by the quantiles of a distribution too: best, lognormal, weibull, rayleigh,
            folded-normal, logistic or normal.
        drift: Test for a drift, with false alarms of 1 % in total, and name the cycle data that it came with.
        against: With --drift: the cycle data, or other numbers, to compare with, separated by commas.
    """

    chart: str | None = None
    subgroup: str | None = None
    of: str | None = None
    by: str | None = None
    baseline: int | None = None
    period: str | None = None
    limits_from: Path | None = None
    limits_to: Path | None = None
    weight: Annotated[float, Parameter(name="--lambda", help="Weight of the newest value in the EWMA.")] = 0.2
    width: Annotated[float, Parameter(name="--ewma-limit")] = 3.0
    center: Annotated[float | None, Parameter(name="--known-mean")] = None
    sigma: Annotated[float | None, Parameter(name="--known-sigma")] = None
    lower: Annotated[float | None, Parameter(help="Lower limit of good parts.")] = None
    upper: Annotated[float | None, Parameter(help="Upper limit of good parts.")] = None
    rules: str | None = None
    distribution: str | None = None

    drift: bool = False
    against: str | None = None

    def compared(self) -> tuple[str, ...] | None:
        """What numbers are compared with; None for all cycle data.

        Raises:
            UsageError: no drift is asked for.
        """
        if self.against is None:
            return None
        if not self.drift:
            raise UsageError("--against goes with --drift")
        return tuple(name.strip() for name in self.against.split(",") if name.strip())


USUAL = Charting()


def spc(
    *,
    csv: Csv = None,
    place: Place = None,
    number: Number = None,
    which: Selection = ALL,
    limit: Limit = 0,
    charting: Annotated[Charting, Parameter(name="*")] = USUAL,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Control charts and capability: I-MR, EWMA, Nelson's rules, Cp, Cpk; drift, and what it came with.

    Without --number it prints an overview of all numbers, and the page of --html shows the charts of the first one.
    --recipe also takes a recipe file: its tolerances are then the limits of good parts, and no inspection is left out.
    Without it, and without --lower and --upper, the tolerances in the history are used.

    Exit codes: 0 stable, 1 not stable or drifting, 64 and above no chart is possible.

    Examples:
        anisoscope spc --number "ln 0-90" --recipe plate.toml --html spc.html
        anisoscope spc -n "ln 0-90" --subgroup lot --drift --html drift.html
        anisoscope spc --csv heights.csv --lower 9.8 --upper 10.2
    """
    from anisoscope.operations.statistics import control_charts
    from anisoscope.quality.capability import Specification
    from anisoscope.quality.chart_limits import read_chart_limits, write_chart_limits
    from anisoscope.quality.control import Settings

    compared = charting.compared()
    tolerances = _tolerances(which.values.get("recipe"))
    chosen = which if tolerances is None else replace(cast("Any", which), recipe=None)
    readings = readings_from(csv, place, chosen, limit, machine=charting.drift)
    limits = None
    if charting.lower is not None or charting.upper is not None:
        limits = Specification(charting.lower, charting.upper)
    settings = Settings(
        charting.baseline,
        charting.weight,
        charting.width,
        charting.center,
        charting.sigma,
        distribution=charting.distribution,
        rules=None if charting.rules is None else _rules(charting.rules),
        chart=charting.chart or ("i-mr" if charting.subgroup is None else "xbar-s"),
    )
    known = None if charting.limits_from is None else read_chart_limits(charting.limits_from)
    with progress("control charts", quiet=json_) as advance:
        found = control_charts(
            readings,
            number,
            by=charting.by,
            settings=settings,
            subgroup=charting.subgroup,
            of=charting.of,
            known=known,
            period=charting.period,
            limits=limits,
            tolerances=tolerances,
            drift=charting.drift,
            against=compared,
            on_progress=advance,
        )
    first = found.charts[0].number
    title = first if charting.by is None else f"{first}, by {charting.by}"
    if html is not None:
        from anisoscope.report.spc_page import Points, write_spc_page

        drawn = [
            (one.study, Points(one.readings, html), one.drift) for one in found.charts if one.number == first
        ]
        page = f"Control charts: {title}"
        write_spc_page(html, page, _source(readings), found.studies, drawn, found.skipped)
    if charting.limits_to is not None:
        write_chart_limits(charting.limits_to, found.studies, readings.source)
    if json_:
        print_json(found)
    else:
        _show(readings, found)
        if html is not None:
            print_lines(f"{html}: charts of {title}")
    return 0 if found.stable else 1


def _rules(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(one) for one in text.split(","))
    except ValueError:
        raise UsageError(
            f"--rules takes numbers separated by commas, such as 1,2,5,6, not {text!r}"
        ) from None


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
