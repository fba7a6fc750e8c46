"""``anisoscope spc``: control charts and capability of measured series."""

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance
from anisoscope.cli.help_page import everyday
from anisoscope.cli.history.options import Place, Selection
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.statistics.source import EVERYTHING, Csv, Html, Limit, Number, print_grid, readings_from
from anisoscope.cli.tables import print_lines

if TYPE_CHECKING:
    from anisoscope.quality.capability import Specification
    from anisoscope.quality.control import ControlStudy, Settings
    from anisoscope.quality.drift import Drift
    from anisoscope.quality.individuals import Period
    from anisoscope.quality.readings import Readings

LISTED = 20  # patterns in the terminal


@dataclass(frozen=True)
@everyday("by", "baseline", "period", "lower", "upper", "drift")
class Charting:
    """Chart type and rules for a series."""

    by: Annotated[
        str | None,
        Parameter(name="--by", help="A chart for each product, recipe, lot, cavity, station or operator."),
    ] = None
    baseline: Annotated[
        int | None,
        Parameter(
            name="--baseline", help="Limits from this many measured values at the start; else from all."
        ),
    ] = None
    period: Annotated[
        str | None,
        Parameter(
            name="--period",
            help="Limits from the values of this reference period, such as 2026-11-01..2026-11-07 or 14d..7d.",
        ),
    ] = None
    weight: Annotated[float, Parameter(name="--lambda", help="Weight of the newest value in the EWMA.")] = 0.2
    width: Annotated[float, Parameter(name="--ewma-limit", help="Limits of the EWMA, in its sigma (L).")] = (
        3.0
    )
    center: Annotated[
        float | None,
        Parameter(name="--known-mean", help="Known mean, in place of a baseline; with --known-sigma."),
    ] = None
    sigma: Annotated[
        float | None,
        Parameter(name="--known-sigma", help="Known short-term standard deviation; with --known-mean."),
    ] = None
    lower: Annotated[float | None, Parameter(name="--lower", help="Lower limit of good parts.")] = None
    upper: Annotated[float | None, Parameter(name="--upper", help="Upper limit of good parts.")] = None
    distribution: Annotated[
        str | None,
        Parameter(
            name="--distribution",
            help="Capability by the quantiles of a distribution too: best, lognormal, weibull, rayleigh, "
            "folded-normal, logistic or normal.",
        ),
    ] = None

    drift: Annotated[
        bool,
        Parameter(
            name="--drift",
            help="Test for a drift, with false alarms of 1 % in total, and name the cycle data that it came with.",
        ),
    ] = False
    against: Annotated[
        str | None,
        Parameter(
            name="--against",
            help="With --drift: the cycle data, or other numbers, to compare with, separated by commas.",
        ),
    ] = None

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

    def settings(self, readings: "Readings") -> "Settings":
        """Options as settings of the chart of some readings.

        Raises:
            UsageError: a period that is none, or readings without times.
        """
        from anisoscope.quality.control import Settings

        period = None if self.period is None else period_of(readings, self.period)
        return Settings(
            self.baseline, self.weight, self.width, self.center, self.sigma, period, self.distribution
        )


def period_of(readings: "Readings", text: str) -> "Period":
    """The readings of a period, such as ``2026-11-01..2026-11-07``; either end may be missing.

    Raises:
        UsageError: it is no period, or the readings have no times.
    """
    from anisoscope.history.filters import parse_moment
    from anisoscope.quality.individuals import Period

    begin, dots, end = text.partition("..")
    if not dots or not (begin or end):
        raise UsageError(f"--period takes FROM..TO, such as 2026-11-01..2026-11-07, not {text!r}")
    moments = [readings.moment(place) for place in range(len(readings))]
    if not any(moments):
        raise UsageError(f"{readings.source}: no reading has a time, which --period needs")
    now = datetime.now(UTC)
    first = parse_moment(begin, "--period", now=now) if begin else datetime.min.replace(tzinfo=UTC)
    last = parse_moment(end, "--period", now=now, at_end=True) if end else datetime.max.replace(tzinfo=UTC)
    if last < first:
        raise UsageError(f"--period {text} ends before it begins: write the earlier day first")
    inside = np.array([one is not None and first <= one <= last for one in moments], dtype=np.bool_)
    return Period(f"{begin or 'the beginning'} to {end or 'the end'}", inside)


USUAL = Charting()


def spc(
    *,
    csv: Csv = None,
    place: Place = None,
    number: Number = None,
    which: Selection = EVERYTHING,
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
        anisoscope spc -n "ln 0-90" --drift --html drift.html
        anisoscope spc --csv heights.csv --lower 9.8 --upper 10.2
    """
    from anisoscope.quality.capability import charted

    compared = charting.compared()
    tolerances = _tolerances(which.recipe)
    chosen = which if tolerances is None else replace(which, recipe=None)
    readings = readings_from(csv, place, chosen, limit, machine=charting.drift)
    names = charted(readings) if number is None else (readings.number(number)[0],)
    if not names:
        raise UsageError(f"{readings.source}: there is no number to chart")
    if number is None and len(names) > 1 and (charting.lower, charting.upper, charting.center) != (None,) * 3:
        raise UsageError("limits and known means belong to one number: name it with --number")
    charts, skipped = [], []
    with progress("control charts", quiet=json_) as advance:
        for one in _all(readings, names, charting, compared, tolerances, advance):
            if isinstance(one, str):
                skipped.append(one)
            else:
                charts.append(one)
    if not charts:
        raise UsageError(skipped[0])
    _deliver(readings, charts, charting.by, skipped, html, json_=json_)
    return 0 if all(one.study.stable and (one.drift is None or not one.drift.seen) for one in charts) else 1


@dataclass(frozen=True, eq=False)
class _Chart:
    """A control study of a number, with the readings that it is of."""

    number: str
    readings: "Readings"
    study: "ControlStudy"
    drift: "Drift | None" = None


def _deliver(
    readings: "Readings",
    charts: list[_Chart],
    by: str | None,
    skipped: list[str],
    html: Path | None,
    *,
    json_: bool,
) -> None:
    """Write the page, with charts of the first number, and print."""
    found, number = [one.study for one in charts], charts[0].number
    title = number if by is None else f"{number}, by {by}"
    if html is not None:
        from anisoscope.report.spc_page import Points, write_spc_page

        first = [(one.study, Points(one.readings, html), one.drift) for one in charts if one.number == number]
        write_spc_page(html, f"Control charts: {title}", _source(readings), found, first, skipped)
    if json_:
        content = {
            "source": readings.source,
            "studies": found,
            "skipped": skipped,
        }
        drifts = [one.drift for one in charts if one.drift is not None]
        print_json(content | ({"drifts": drifts} if drifts else {}))
        return
    _show(readings, found, skipped, alone=len(found) == 1 and not skipped)
    _show_drifts([one.drift for one in charts if one.drift is not None])
    if html is not None:
        print_lines(f"{html}: charts of {title}")


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


def _all(
    readings: "Readings",
    names: tuple[str, ...],
    charting: Charting,
    compared: tuple[str, ...] | None,
    tolerances: dict[str, float] | None,
    advance: Advance,
) -> list[_Chart | str]:
    """Chart of every number in every group, or the reason for its absence."""
    from anisoscope.quality.control import control_study
    from anisoscope.quality.drift import drift_study
    from anisoscope.quality.readings import GROUPS

    if charting.by is not None and charting.by not in GROUPS:
        raise UsageError(f"--by takes {', '.join(GROUPS)}, not {charting.by!r}")
    groups = readings.grouped(charting.by)
    found: list[_Chart | str] = []
    for name in names:
        for group, part in groups.items():
            title = _title(name, charting.by, group)
            advance(title, len(found), len(names) * len(groups))
            values = part.numbers[name]
            try:
                limits = _specification(part, name, charting, tolerances)
                study = control_study(title, values, part.labels, charting.settings(part), limits)
                drift = None
                if charting.drift:
                    drift = drift_study(title, values, part.labels, part.against(compared, name))
                found.append(_Chart(name, part, study, drift))
            except UsageError as error:
                if len(names) * len(groups) == 1:
                    raise
                found.append(f"{title}: {error}")
    return found


def _title(name: str, by: str | None, group: str) -> str:
    if by is None:
        return name
    return f"{name}, {by} {group}" if group else f"{name}, {by} not stated"


def _specification(
    readings: "Readings", name: str, charting: Charting, tolerances: dict[str, float] | None
) -> "Specification | None":
    from anisoscope.quality.capability import Specification, specification

    if charting.lower is not None or charting.upper is not None:
        return Specification(charting.lower, charting.upper)
    return specification(readings, name, tolerances)


def _source(readings: "Readings") -> str:
    first, last = readings.moment(0), readings.moment(-1)
    known = first is not None and last is not None
    period = f", {first:%Y-%m-%d %H:%M} to {last:%Y-%m-%d %H:%M %Z}" if known else ""
    return f"{readings.source}: {len(readings)} readings{period}"


def _show(readings: "Readings", studies: "list[ControlStudy]", skipped: list[str], *, alone: bool) -> None:
    from anisoscope.report.spc_page import overview, tables

    print_lines(_source(readings))
    if not alone:
        print_grid(overview(studies))
    else:
        for grid in tables(studies[0], LISTED):
            print_grid(grid)
        if studies[0].normality is not None:
            print_lines(f"Anderson-Darling: p {studies[0].normality.p:.3g}, {studies[0].normality.hint}")
        print_lines(*studies[0].notes)
    print_lines(*(f"left out: {line}" for line in skipped))
    for study in studies if len(studies) <= LISTED else studies[:1]:
        print_lines(f"{study.name}: {study.verdict}")


def _show_drifts(drifts: "list[Drift]") -> None:
    from anisoscope.report.drift_sections import parameter_table

    for drift in drifts:
        if drift.parameters:
            print_grid(parameter_table(drift))
        print_lines(f"{drift.name}: {drift.verdict}", *drift.notes)
