"""Options that the commands about the history share."""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from difflib import get_close_matches
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.history.filters import Filters, parse_moment
from anisoscope.views.options import Given, Options, options_class

if TYPE_CHECKING:
    from anisoscope.history.store import History

DEFAULT_OUT = Path("inspections")
VERDICTS = ("PASS", "FAIL", "INCONCLUSIVE", "INVALID")

Place = Annotated[
    str | None,
    Parameter(
        name="--history",
        help="The history: a file, a folder of inspections, or a postgresql:// URL. By default what "
        "ANISOSCOPE_HISTORY says, else inspections/history.sqlite.",
    ),
]


SELECTION = Group("Which inspections", sort_key=20)
OF_FILTERS = Options(
    Filters,
    names={"serial": ("--serial", "-s")},
    without={"limit": "an option of its own", "ids": "no words of people"},
)
if TYPE_CHECKING:
    Which = Given[Filters]
else:
    Which = options_class(OF_FILTERS)
ALL = Which()
Selection = Annotated[Which, Parameter(name="*", group=SELECTION)]


def filters_of(which: Which, limit: int | None = None) -> Filters:
    """Selection as filters.

    Args:
        which: the options.
        limit: at most so many; None or 0 for all of them.

    Raises:
        UsageError: a moment, a verdict or a limit that is none.
    """
    if limit is not None and limit < 0:
        raise UsageError(f"--limit takes a positive whole number, or 0 for no limit, not {limit}")
    now, stated = datetime.now(UTC), which.values
    for name in {"since", "until"} & stated.keys():
        stated[name] = parse_moment(stated[name], f"--{name}", now=now, at_end=name == "until")
    if "verdict" in stated:
        if stated["verdict"].upper() not in VERDICTS:
            near = get_close_matches(stated["verdict"].upper(), VERDICTS, 1)
            meant_ = f"; did you mean --verdict {near[0]}?" if near else ""
            raise UsageError(f"--verdict takes {', '.join(VERDICTS)}, not {stated['verdict']!r}{meant_}")
        stated["verdict"] = stated["verdict"].upper()
    return Filters(**stated, limit=limit or None)


def meant(place: str | None) -> "str | Path":
    """Place of the history that is meant.

    Raises:
        UsageError: none is meant.
    """
    from anisoscope.history.address import chosen

    found = chosen(place, DEFAULT_OUT)
    if found is None:
        raise UsageError("no history is meant: name one with --history, or unset ANISOSCOPE_HISTORY=none")
    return found


def opened(place: str | None, *, create: bool = False) -> "History":
    """The history that is meant, open.

    Raises:
        UsageError: none is meant.
        HistoryError: there is none, or it cannot be reached.
    """
    from anisoscope.history.store import open_history

    return open_history(meant(place), create=create)


@contextmanager
def opened_for(place: str | None, *names: str) -> "Iterator[tuple[History, bool]]":
    """A history that has the inspections of these names, open, and whether it was made for them.

    Without a stated history, folders of inspections are looked up in the one beside them; where that lacks one of
    them, they make a history of their own for the duration of a command.

    Args:
        place: stated history.
        names: serial numbers, ids or folders.

    Raises:
        HistoryError: as of `opened`.
        UsageError: as of `opened`; a path that is no such folder, where there is no history.
        RecordError: the record of a folder cannot be read.
    """
    from anisoscope.history.address import HISTORY_NAME
    from anisoscope.history.rows import row_of
    from anisoscope.history.store import open_history
    from anisoscope.record.schema import RECORD_NAME, read_record

    folders = [Path(name) for name in names if "\0" not in name and (Path(name) / RECORD_NAME).is_file()]
    default = DEFAULT_OUT / HISTORY_NAME
    if meant(place) != default or len(folders) < len(names):
        wrong = [
            name for name in names if "\0" not in name and Path(name).exists() and Path(name) not in folders
        ]
        if meant(place) == default and wrong and not default.exists():
            raise UsageError(
                f"{wrong[0]} is no folder of a finished inspection: it holds no {RECORD_NAME}; name such a folder, or "
                "a serial number and --history"
            )
        with opened(place) as found:
            yield found, False
        return
    rows = [row_of(read_record(folder), folder) for folder in folders]
    beside = folders[0].resolve().parent / HISTORY_NAME
    if beside.is_file():
        with open_history(beside) as found:
            if all(found.row_by_seal(row.seal) is not None for row in rows):
                yield found, False
                return
    with TemporaryDirectory() as folder, open_history(Path(folder) / HISTORY_NAME, create=True) as found:
        found.append_all(rows)
        yield found, True
