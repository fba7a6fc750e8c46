"""Progress of a command, on standard error."""

from collections.abc import Iterator
from contextlib import contextmanager

from anisoscope.base.progress import Advance, silent
from anisoscope.cli.tables import console


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
