"""Tables of the commands, and the console that they are printed on."""

import re
from collections.abc import Iterable, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

from anisoscope.base.language import per_cent
from anisoscope.cli.json_output import print_json
from anisoscope.cli.log import verbose

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

    from anisoscope.kinds.command_output import CommandOutput


_NUMBER = re.compile(r"[<>≤≥±+−-]?\s*\d|–$")
"""How a cell with a number begins; columns without any are aligned to the left."""


@cache
def _console_type() -> "type[Console]":
    from rich.console import Console

    class Reading(Console):
        """Writes numbers in per cent as they are read."""

        def render_str(self, text: str, **how: Any) -> "Text":  # noqa: ANN401 - as rich calls it
            return super().render_str(per_cent(text), **how)

    return Reading


def console(*, stderr: bool = False) -> "Console":
    """Console that wraps at the width of the terminal, or at 120 columns without one."""
    found = _console_type()(stderr=stderr)
    return found if found.is_terminal else _console_type()(stderr=stderr, width=120)


def print_table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], caption: str | None = None
) -> None:
    """Print a table; neither headers nor data become markup."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(
        title=title, title_justify="left", caption=caption and escape(caption), caption_justify="left"
    )
    for number, column in enumerate(columns):
        words = number == 0 or not any(_NUMBER.match(row[number]) for row in rows)
        table.add_column(escape(column), justify="left" if words else "right")
    for row in rows:
        table.add_row(*(escape(cell) for cell in row))
    console().print(table)


def print_output(output: "CommandOutput", *, json_: bool) -> None:
    """Print an answer that a kind of part gives: as JSON, or its tables and lines."""
    if json_:
        print_json(output.content)
        return
    for table in (*(output.behind if verbose() else ()), *output.tables):
        print_table(table.title, table.columns, table.rows, table.caption)
    print_lines(*output.lines)
    if output.behind and not verbose():
        print_lines(f"tables ({', '.join(table.title for table in output.behind)}): --verbose")


def print_lines(*lines: str, stderr: bool = False) -> None:
    """Print lines as they are: neither markup nor wrapping changes them."""
    out = console(stderr=stderr)
    for line in lines:
        out.print(line, markup=False, highlight=False, soft_wrap=True)


def answer(content: Any, lines: Iterable[str], *, json_: bool) -> None:  # noqa: ANN401 - any result
    """Print a result as JSON, or lines."""
    if json_:
        print_json(content)
    else:
        print_lines(*lines)
