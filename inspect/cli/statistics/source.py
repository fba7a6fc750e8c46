"""Source of the numbers for the commands of statistics: a CSV file or the history."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.history.options import ALL, DEFAULT_OUT, Place, Selection, Which, filters_of

if TYPE_CHECKING:
    from anisoscope.quality.readings import Readings
    from anisoscope.report.statistics_sections import Grid

Csv = Annotated[
    Path | None,
    Parameter(
        name="--csv",
        help="Readings from this CSV file (or AQDEF: .dfq, .dfd) instead of the history: see docs/statistics.md.",
    ),
]
Number = Annotated[
    str | None,
    Parameter(name=["--number", "-n"], help="Which number, such as 'ln 0-90'; else the first one."),
]
Limit = Annotated[int, Parameter(help="At most so many, the latest ones; 0 for all.")]
Alpha = Annotated[
    float, Parameter(name="--significance", help="Significance of the tests; intervals cover the rest.")
]


@dataclass(frozen=True)
class Source:
    """Source of the readings, and the number in them."""

    csv: Csv = None
    place: Place = None
    number: Number = None
    which: Selection = ALL
    limit: Limit = 0

    def readings(self, *, machine: bool = False) -> "Readings":
        """The readings that are meant; errors as for `readings_from`."""
        return readings_from(self.csv, self.place, self.which, self.limit, machine=machine)


Readable = Annotated[Source, Parameter(name="*")]
SOURCE = Source()


def readings_from(
    csv: Path | None, place: str | None, which: Which, limit: int = 0, *, machine: bool = False
) -> "Readings":
    """The readings that are meant.

    Args:
        csv: a file, or None for the history.
        place: the history.
        which: which of them; times only with the history.
        limit: at most so many, the latest ones; 0 for all.
        machine: with the cycle data of machines that the history holds.

    Raises:
        UsageError: options that do not go together, a wrong line, or nothing left.
        HistoryError: there is no history, or it cannot be read.
    """
    if csv is None:
        from anisoscope.history.address import chosen
        from anisoscope.quality.readings import history_readings, with_machine

        found = chosen(place, DEFAULT_OUT)
        if found is None:
            raise UsageError("name the readings: --csv FILE or --history PLACE")
        readings = history_readings(found, filters_of(which, limit))
        return with_machine(readings, found) if machine else readings
    from anisoscope.quality.readings import read_readings

    if place is not None:
        raise UsageError("--csv and --history are two sources: name one of them")
    if "since" in which or "until" in which:
        raise UsageError(
            "--since and --until go with the history: leave out the lines of the CSV file instead"
        )
    if limit < 0:
        raise UsageError(f"--limit takes a positive whole number, or 0 for all, not {limit}")
    return read_readings(csv).only(which.values).latest(limit)


def print_grid(grid: "Grid") -> None:
    """Print a table of a page."""
    from anisoscope.cli.tables import print_table

    print_table(grid.title, list(grid.columns), [list(row) for row in grid.rows], grid.note or None)
