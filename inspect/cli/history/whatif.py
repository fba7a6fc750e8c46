"""``anisoscope whatif``: judge inspections of the past by another recipe."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.history.history import write_line
from anisoscope.cli.history.options import Place, Which, filters_of, opened
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import OF_WORKERS, PRINTED, Output
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table
from anisoscope.parameters.workers import Workers
from anisoscope.record.verdict import Verdict
from anisoscope.views.options import Given, with_options

if TYPE_CHECKING:
    from anisoscope.study.whatif import WhatIf

KEYS = tuple(Which.option)
MOST_LINES = 20


@with_options(workers=replace(OF_WORKERS, group=None))
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
    workers: Given[Workers],
    output: Output = PRINTED,
) -> int:
    """Judge past inspections by another recipe: which verdicts change, what that means for escapes and cost.

    A changed decision, tolerance, material or design takes what inspections kept; a changed region, pose or condition
    of the measurement takes their frames. The folders stay as they are.

    Exit codes: 0 no verdict changes, 1 some do, 3 none does but some could not be judged, 64 and above an error.

    Examples:
        anisoscope whatif --recipe tighter.toml --where since=30d
        anisoscope whatif --recipe tighter.toml --where lot=L42 --html flips.html --cost-escape 900 --cost-reject 4
    """
    from anisoscope.operations.past import whatif as judged
    from anisoscope.study.whatif import Costs

    which, html = selection(where or ()), output.html
    if (cost_escape is None) != (cost_reject is None):
        raise UsageError("--cost-escape and --cost-reject go together")
    if html is not None and (html.resolve() == recipe.resolve() or not html.absolute().parent.is_dir()):
        raise UsageError(f"--html {html}: name a page in a folder that exists, not the recipe")
    costs = None if cost_escape is None or cost_reject is None else Costs(cost_escape, cost_reject)
    with opened(place) as found, progress("inspections", quiet=output.json_) as advance:
        result = judged(
            found,
            recipe,
            filters_of(which, limit),
            costs=costs,
            workers=workers.made(),
            html=html,
            on_progress=advance,
        )
    if output.json_:
        print_json(result)
    else:
        _print(result, html)
    return 1 if result.flips else Verdict.INVALID.exit_code if result.unjudged else 0


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


def _print(found: "WhatIf", html: Path | None) -> None:
    from anisoscope.operations.past import judged_text, risk_texts

    write_line(f"{found.product}, {found.recipe}")
    write_line(f"inspections: {judged_text(found)}")
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
    for name, then, now in risk_texts(found):
        write_line(f"{name}: {then}" if then == now else f"{name}: then {then}, now {now}")
    if html is not None:
        write_line(f"page: {html}")
