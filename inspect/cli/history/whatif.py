"""``anisoscope whatif``: judge inspections of the past by another recipe."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.history.history import write_line
from anisoscope.cli.history.options import Place, Which, opened
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.study.optimise import HtmlOption, JobsOption, SchedulerOption
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.history.rows import Row
    from anisoscope.study.statistics import Rate
    from anisoscope.study.whatif import WhatIf

KEYS = tuple(Which.__dataclass_fields__)
MOST_LINES = 20


def whatif(
    *,
    recipe: Annotated[Path, Parameter(help="The other recipe; its golden parts are those next to it.")],
    place: Place = None,
    where: Annotated[
        list[str] | None,
        Parameter(help=f"Which inspections: KEY=VALUE, repeatable; keys are {', '.join(KEYS)}."),
    ] = None,
    limit: Annotated[int, Parameter(help="At most so many, the latest ones; 0 for all.")] = 0,
    cost_escape: Annotated[float | None, Parameter(help="What a bad part costs that passes.")] = None,
    cost_reject: Annotated[float | None, Parameter(help="What a good part costs that fails.")] = None,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    html: HtmlOption = None,
    json_: Json = False,
) -> int:
    """Judge past inspections by another recipe: which verdicts change, what that means for escapes and cost.

    A changed decision, tolerance, material or design takes what inspections kept; a changed region, pose or condition
    of the measurement takes their frames. The folders stay as they are.

    Exit codes: 0 no verdict changes, 1 some do, 64 and above an error.

    Examples:
        anisoscope whatif --recipe tighter.toml --where since=30d
        anisoscope whatif --recipe tighter.toml --where lot=L42 --html flips.html --cost-escape 900 --cost-reject 4
    """
    from anisoscope.study.sweep import Workers
    from anisoscope.study.whatif import Costs, what_if

    which = selection(where or ())
    if (cost_escape is None) != (cost_reject is None):
        raise UsageError("--cost-escape and --cost-reject go together")
    if html is not None and (html.resolve() == recipe.resolve() or not html.absolute().parent.is_dir()):
        raise UsageError(f"--html {html}: name a page in a folder that exists, not the recipe")
    costs = None if cost_escape is None or cost_reject is None else Costs(cost_escape, cost_reject)
    with opened(place) as found:
        rows = found.rows(which.filters(limit))
        decided = {
            key: one[-1].decision for key, one in found.dispositions_of([r.id for r in rows]).items() if one
        }
    with progress("inspections", quiet=json_) as advance:
        result = what_if(recipe, rows, decided, Workers(jobs, scheduler), costs, advance)
    if html is not None:
        write_html(html, result, {row.id: row for row in rows})
    if json_:
        print_json(result)
    else:
        _print(result, html)
    return 1 if result.flips else 0


def selection(where: Sequence[str]) -> Which:
    """The inspections that ``--where`` selects.

    Raises:
        UsageError: a condition that is none.
    """
    values: dict[str, str] = {}
    for one in where:
        key, sign, value = one.partition("=")
        if key not in KEYS or not sign or not value:
            raise UsageError(f"--where takes KEY=VALUE with one of {', '.join(KEYS)}, not {one[:80]!r}")
        if key in values:
            raise UsageError(f"--where {key} is given twice")
        values[key] = value
    return Which(**values)


def write_html(path: Path, found: "WhatIf", rows: "Mapping[int, Row]") -> None:
    """Write the page of a what-if, with pictures of the parts whose verdict changes."""
    from anisoscope.inspection.past_pages import thumbnail_of
    from anisoscope.report.inspection_page import REPORT_NAME
    from anisoscope.report.past_pages import MOST_PICTURES, FlippedPart, RiskLine, write_whatif_page
    from anisoscope.study.whatif import VERDICTS

    parts = []
    for number, one in enumerate(found.flipped):
        report = Path(one.folder) / REPORT_NAME
        parts.append(
            FlippedPart(
                one.serial,
                one.before,
                str(one.after),
                one.reasons[0] if one.reasons else "",
                one.disposition,
                "frames" if one.judged_from == "frames" else "kept numbers",
                thumbnail_of(rows[one.id]) if number < MOST_PICTURES else None,
                report.as_uri() if report.is_file() else None,
            )
        )
    risks = [RiskLine(name, then, now) for name, then, now in _risk_texts(found)]
    table = [(before, [_number(found, before, after) for after in VERDICTS]) for before in VERDICTS]
    facts = [("recipe", f"{found.product}: {found.recipe}"), ("inspections", _sources(found))]
    unjudged = [(one.serial, one.reasons[0]) for one in found.unjudged]
    title = f"What if: {len(found.flipped)} of {len(found.inspections)} verdicts change"
    write_whatif_page(path, title, facts, VERDICTS, table, risks, parts, unjudged)


def _number(found: "WhatIf", before: str, after: str) -> int:
    return sum((one.before, one.after) == (before, after) for one in found.inspections)


def _sources(found: "WhatIf") -> str:
    words = [f"{len(found.inspections)}"]
    kept, frames = found.count("kept"), found.count("frames")
    words += [f"{kept} judged from kept numbers"] if kept else []
    words += [f"{frames} from frames"] if frames else []
    words += [f"{len(found.unjudged)} could not be judged"] if found.unjudged else []
    why = next((one.frames_because for one in found.inspections if one.frames_because), None)
    return ", ".join(words) + (f" ({why})" if why else "")


def _risk_texts(found: "WhatIf") -> list[tuple[str, str, str]]:
    then, now = found.before, found.after
    lines = [
        ("escapes: bad parts that PASS", _rate_text(then.escapes), _rate_text(now.escapes)),
        (
            "false rejects: good parts that FAIL",
            _rate_text(then.false_rejects),
            _rate_text(now.false_rejects),
        ),
    ]
    if then.cost is not None and now.cost is not None:
        lines.append(("cost of both", f"{then.cost:g}", f"{now.cost:g}"))
    return lines


def _rate_text(one: "Rate") -> str:
    if not one.of:
        return "no such part was decided by a reviewer"
    share, low, high = (f"{100.0 * value:.2g}" for value in (one.value, one.low, one.high))
    return f"{one.count} of {one.of}: {share} % (95 %: {low} to {high} %)"


def _print(found: "WhatIf", html: Path | None) -> None:
    write_line(f"{found.product}, {found.recipe}")
    write_line(f"inspections: {_sources(found)}")
    if found.flips:
        print_table(
            "verdicts that change", ["change", "inspections"], [[k, str(n)] for k, n in found.flips.items()]
        )
    else:
        write_line("no verdict changes")
    for one in found.flipped[:MOST_LINES]:
        write_line(f"  {one.serial}: {one.flip}: {one.reasons[0] if one.reasons else ''}")
    if len(found.flipped) > MOST_LINES:
        write_line(f"  and {len(found.flipped) - MOST_LINES} more; --json and --html have all of them")
    for one in found.unjudged[:MOST_LINES]:
        write_line(f"  {one.serial}: not judged: {one.reasons[0]}")
    for name, then, now in _risk_texts(found):
        write_line(f"{name}: {then}" if then == now else f"{name}: then {then}, now {now}")
    if html is not None:
        write_line(f"page: {html}")
