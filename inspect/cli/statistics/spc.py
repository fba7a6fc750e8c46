"""``anisoscope spc``: control charts and capability of measured series."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance
from anisoscope.cli.help_page import everyday
from anisoscope.cli.history.options import Place
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.statistics.source import (
    EVERYTHING,
    Csv,
    Html,
    Limit,
    Number,
    Selection,
    print_grid,
    readings_from,
    write_lines,
)

if TYPE_CHECKING:
    from anisoscope.quality.capability import Specification
    from anisoscope.quality.control import ControlStudy, Settings
    from anisoscope.quality.readings import Readings

LISTED = 20  # patterns in the terminal


@dataclass(frozen=True)
@everyday("by", "baseline", "lower", "upper")
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
    weight: Annotated[float, Parameter(name="--lambda", help="Weight of the newest value in the EWMA.")] = 0.2
    width: Annotated[float, Parameter(name="--width", help="Limits of the EWMA, in its sigma (L).")] = 3.0
    center: Annotated[
        float | None, Parameter(name="--center", help="Known mean, in place of a baseline; with --sigma.")
    ] = None
    sigma: Annotated[
        float | None, Parameter(name="--sigma", help="Known short-term standard deviation; with --center.")
    ] = None
    lower: Annotated[float | None, Parameter(name="--lower", help="Lower limit of good parts.")] = None
    upper: Annotated[float | None, Parameter(name="--upper", help="Upper limit of good parts.")] = None

    def settings(self) -> "Settings":
        """Options as settings of the chart."""
        from anisoscope.quality.control import Settings

        return Settings(self.baseline, self.weight, self.width, self.center, self.sigma)


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
    """Control charts and capability: I-MR, EWMA, Nelson's rules, Cp, Cpk.

    Without --number an overview of all numbers; the page of --html then shows the charts of the first one. --recipe
    takes a recipe file too: its tolerances are then the limits of good parts, and nothing is left out for it. Without
    it, and without --lower and --upper, the tolerances that the history remembers are used.

    Exit codes: 0 stable, 1 not stable, 64 and above nothing could be charted.

    Examples:
        anisoscope spc --number "ln 0-90" --recipe plate.toml --html spc.html
        anisoscope spc --csv heights.csv --lower 9.8 --upper 10.2
    """
    from anisoscope.quality.capability import charted

    settings = charting.settings()
    tolerances = _tolerances(which.recipe)
    chosen = which if tolerances is None else replace(which, recipe=None)
    readings = readings_from(csv, place, chosen, limit)
    names = charted(readings) if number is None else (readings.number(number)[0],)
    if not names:
        raise UsageError(f"{readings.source}: there is no number to chart")
    if number is None and len(names) > 1 and (charting.lower, charting.upper, charting.center) != (None,) * 3:
        raise UsageError("limits and known means belong to one number: name it with --number")
    studies, skipped = [], []
    with progress("control charts", quiet=json_) as advance:
        for name, group, study in _all(readings, names, charting, settings, tolerances, advance):
            if isinstance(study, str):
                skipped.append(f"{_title(name, group)}: {study}")
            else:
                studies.append((name, study))
    if not studies:
        raise UsageError(skipped[0])
    _deliver(readings, studies, skipped, html, json_=json_)
    return 0 if all(study.stable for _, study in studies) else 1


def _deliver(
    readings: "Readings",
    studies: "list[tuple[str, ControlStudy]]",
    skipped: list[str],
    html: Path | None,
    *,
    json_: bool,
) -> None:
    """Write the page, with charts of the first number, and print."""
    found = [study for _, study in studies]
    first = [study for name, study in studies if name == studies[0][0]]
    if html is not None:
        from anisoscope.report.spc_page import write_spc_page

        write_spc_page(html, f"Control charts: {first[0].name}", _source(readings), found, first, skipped)
    if json_:
        content = {
            "source": readings.source,
            "studies": found,
            "skipped": skipped,
        }
        print_json(content)
        return
    _show(readings, found, skipped, alone=len(found) == 1 and not skipped)
    if html is not None:
        write_lines(f"{html}: charts of {first[0].name}")


def _tolerances(recipe: str | None) -> dict[str, float] | None:
    """Tolerances of a recipe file; None where the text is no file."""
    if recipe is None or not Path(recipe).is_file():
        if recipe is not None and recipe.endswith(".toml"):
            raise UsageError(f"--recipe: there is no file {recipe}")
        return None
    from anisoscope.kinds.registry import kind_of

    kind = kind_of(Path(recipe))
    return kind.tolerances(kind.read_recipe(Path(recipe)))


def _all(
    readings: "Readings",
    names: tuple[str, ...],
    charting: Charting,
    settings: "Settings",
    tolerances: dict[str, float] | None,
    advance: Advance,
) -> "list[tuple[str, str, ControlStudy | str]]":
    """Control study of every number in every group, or the reason for its absence."""
    from anisoscope.quality.control import control_study
    from anisoscope.quality.readings import GROUPS

    if charting.by is not None and charting.by not in GROUPS:
        raise UsageError(f"--by takes {', '.join(GROUPS)}, not {charting.by!r}")
    groups = readings.grouped(charting.by)
    found: list[tuple[str, str, ControlStudy | str]] = []
    for name in names:
        for group, part in groups.items():
            advance(_title(name, group), len(found), len(names) * len(groups))
            values = part.numbers[name]
            try:
                limits = _specification(part, name, charting, tolerances)
                chart = control_study(_title(name, group), values, part.labels, settings, limits)
                found.append((name, group, chart))
            except UsageError as error:
                if len(names) * len(groups) == 1:
                    raise
                found.append((name, group, str(error)))
    return found


def _title(name: str, group: str) -> str:
    return f"{name}, {group}" if group else name


def _specification(
    readings: "Readings", name: str, charting: Charting, tolerances: dict[str, float] | None
) -> "Specification | None":
    from anisoscope.quality.capability import Specification, specification

    if charting.lower is not None or charting.upper is not None:
        return Specification(charting.lower, charting.upper)
    return specification(readings, name, tolerances)


def _source(readings: "Readings") -> str:
    times = readings.texts.get("time", ())
    period = f", {min(times)} to {max(times)}" if times and all(times) else ""
    return f"{readings.source}: {len(readings)} readings{period}"


def _show(readings: "Readings", studies: "list[ControlStudy]", skipped: list[str], *, alone: bool) -> None:
    from anisoscope.report.spc_page import overview, tables

    write_lines(_source(readings))
    if not alone:
        print_grid(overview(studies))
    else:
        for grid in tables(studies[0], LISTED):
            print_grid(grid)
        if studies[0].normality is not None:
            write_lines(f"Anderson-Darling: p {studies[0].normality.p:.3g}, {studies[0].normality.hint}")
        write_lines(*studies[0].notes)
    write_lines(*(f"left out: {line}" for line in skipped))
    for study in studies if len(studies) <= LISTED else studies[:1]:
        write_lines(f"{study.name}: {study.verdict}")
