"""Options that the commands about the history share."""

from datetime import UTC, datetime
from pathlib import Path
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
            raise UsageError(f"--verdict takes {', '.join(VERDICTS)}, not {stated['verdict']!r}")
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
