"""How a command enters a finished inspection into the history, without putting its verdict at risk."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from anisoscope.inspection.run import Inspected

HistoryOption = Annotated[
    str | None,
    Parameter(
        name="--history",
        help="History that the inspection enters: a file, a postgresql:// URL, or `none`. By default what "
        "ANISOSCOPE_HISTORY says, else history.sqlite in the folder of inspections.",
    ),
]


def history_place(option: str | None, out: Path) -> str | Path | None:
    """Where inspections in a folder are remembered; looked at before anything moves. None: nowhere.

    Raises:
        UsageError: there can be no history.
    """
    from anisoscope.history.address import chosen, parse_address

    place = chosen(option, out)
    if place is not None:
        parse_address(place)
    return place


def remember(inspected: "Inspected", place: str | Path | None) -> None:
    """Enter a finished inspection into the history; on failure print one line with the remedy.

    Verdict and exit code are those of the part: what becomes of a database changes neither.
    """
    if place is None:
        return
    try:
        from anisoscope.history.rows import row_of
        from anisoscope.history.store import open_history

        with open_history(place) as history:
            history.append(row_of(inspected.record, inspected.folder))
    except Exception as error:  # noqa: BLE001 - record and verdict stand, whatever goes wrong here
        problem = " ".join(str(error).split()) or type(error).__name__
        print(  # noqa: T201
            f"anisoscope: the inspection is not in the history yet: {problem}; "
            f"`anisoscope history add {inspected.folder}{_where(place)}` adds it",
            file=sys.stderr,
        )


def _where(place: str | Path) -> str:
    """The option that names a history, if commands would not find it by themselves; without a password."""
    from anisoscope.history.address import VARIABLE, parse_address

    return "" if os.environ.get(VARIABLE, "").strip() == place else f" --history {parse_address(place)}"
