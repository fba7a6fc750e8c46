"""``anisoscope research papers``: every figure and table of the three papers, as printed and as computed here."""

import sys
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import Html, Json, check_suffix
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.study.papers.rows import Paper, Row

FOOT = (
    "Compared by number: the paper prints a value. By order: it prints or states which is larger. By shape: it states "
    "how a curve behaves. Rows that are not reproduced say why."
)


def papers(
    *,
    only: Annotated[
        Literal["levin", "luongo", "pranovich"] | None, Parameter(help="One of the papers.")
    ] = None,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Compute every figure and table of the three papers and compare it with what is printed.

    Exit code 1 if a row that can be compared differs.

    Examples:
        anisoscope research papers --html papers.html
        anisoscope research papers --only luongo
    """
    from anisoscope.study.papers.levin import PAPER as LEVIN
    from anisoscope.study.papers.luongo import PAPER as LUONGO
    from anisoscope.study.papers.pranovich import PAPER as PRANOVICH

    check_suffix(html, "--html", ".html")
    if html is not None and not html.parent.is_dir():
        raise UsageError(f"--html {html}: there is no folder {html.parent}")
    chosen = [one for one in (LEVIN, LUONGO, PRANOVICH) if only in (None, one.key)]
    total = sum(len(one.makers) for one in chosen)
    found: list[tuple[Paper, list[Row]]] = []
    with progress("papers", quiet=json_) as advance:
        for paper in chosen:
            rows: list[Row] = []
            for make in paper.makers:
                advance(paper.key, sum(len(done) for _, done in found) + len(rows), total)
                rows.append(make())
            found.append((paper, rows))
    every = [row for _, rows in found for row in rows]
    counted = [row for row in every if row.holds is not None]
    agreeing = sum(row.holds is True for row in counted)
    summary = (
        f"{agreeing} of {len(counted)} rows that can be compared agree; {len(every) - len(counted)} are drawings, "
        "photographs or data that are not published"
    )
    if html is not None:
        from anisoscope.report.page import write_page

        content = {
            "title": "The three papers, repeated", "subtitle": summary + ".", "papers": found, "foot": FOOT,
        }  # fmt: skip
        write_page(html, "papers.html", content)
    if json_:
        print_json(
            {
                "agree": agreeing, "compared": len(counted),
                "papers": [
                    {"paper": paper.key, "source": paper.source, "rows": [fields_of(row) for row in rows]}
                    for paper, rows in found
                ],
            }
        )  # fmt: skip
    else:
        for paper, rows in found:
            print_table(
                paper.title,
                ["in the paper", "printed", "here", "result"],
                [
                    [row.label, row.printed, row.ours, _result(row.holds)]
                    for row in rows
                ],
            )  # fmt: skip
        sys.stdout.write(summary + "\n")
        if html is not None:
            sys.stdout.write(f"written: {html}\n")
    return 0 if agreeing == len(counted) else 1


def _result(holds: bool | None) -> str:
    return "–" if holds is None else "agrees" if holds else "differs"
