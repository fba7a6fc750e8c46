"""What the commands share: tables, number lists, progress."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent

if TYPE_CHECKING:
    from rich.console import Console


def parse_numbers(text: str, option: str, example: str = "0,90,180") -> tuple[float, ...]:
    """Numbers of a comma-separated option.

    Raises:
        UsageError: the text is not a list of finite numbers.
    """
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(
            f"{option} takes numbers separated by commas, such as {example}, not {text!r}"
        ) from None
    if not all(abs(number) < float("inf") for number in numbers):
        raise UsageError(f"{option} takes finite numbers, not {text!r}")
    return numbers


def console(*, stderr: bool = False) -> "Console":
    """Console that wraps at the width of the terminal, or at 120 columns without one."""
    from rich.console import Console

    found = Console(stderr=stderr)
    return found if found.is_terminal else Console(stderr=stderr, width=120)


def print_table(title: str, columns: list[str], rows: list[list[str]], caption: str | None = None) -> None:
    """Print a table; neither headers nor data become markup."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(
        title=title, title_justify="left", caption=caption and escape(caption), caption_justify="left"
    )
    for number, column in enumerate(columns):
        table.add_column(escape(column), justify="left" if number == 0 else "right")
    for row in rows:
        table.add_row(*(escape(cell) for cell in row))
    console().print(table)


@contextmanager
def progress(label: str, *, quiet: bool = False) -> Iterator[Advance]:
    """A progress bar on standard error, where that is a terminal; yields the function that moves it."""
    if quiet or not console(stderr=True).is_terminal:
        yield silent
        return
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.fields[label]}"),
        BarColumn(),
        TextColumn("{task.description}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console(stderr=True)) as bar:
        task = bar.add_task("", total=None, label=escape(label))

        def advance(doing: str, done: int, total: int) -> None:
            bar.update(task, description=escape(doing), completed=done, total=total)

        yield advance
