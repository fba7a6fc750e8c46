"""Options that the commands about the history share."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from anisoscope.base.errors import UsageError

if TYPE_CHECKING:
    from anisoscope.history.filters import Filters
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
_MOMENT = "2026-11-01, 2026-11-01T14:30, today, or how long ago: 12h, 7d, 2w."


SELECTION = Group("Which inspections", sort_key=20)


@Parameter(group=SELECTION)
@dataclass(frozen=True)
class Which:
    """Selection of inspections."""

    since: Annotated[str | None, Parameter(name="--since", help=f"Not earlier than {_MOMENT}")] = None
    until: Annotated[
        str | None, Parameter(name="--until", help="Not later than this; a date includes its day.")
    ] = None
    serial: Annotated[
        str | None, Parameter(name=["--serial", "-s"], help="Of the part with this serial number.")
    ] = None
    product: Annotated[str | None, Parameter(name="--product", help="Of this product.")] = None
    recipe: Annotated[
        str | None,
        Parameter(
            name="--recipe",
            help="By this recipe: as the history shows it, or four or more digits of its SHA-256.",
        ),
    ] = None
    lot: Annotated[str | None, Parameter(name="--lot", help="Of this lot.")] = None
    cavity: Annotated[str | None, Parameter(name="--cavity", help="Of this cavity.")] = None
    verdict: Annotated[
        str | None, Parameter(name="--verdict", help="PASS, FAIL, INCONCLUSIVE or INVALID.")
    ] = None
    station: Annotated[str | None, Parameter(name="--station", help="Of this station.")] = None
    operator: Annotated[str | None, Parameter(name="--operator", help="Of this operator.")] = None

    def filters(self, limit: int | None = None) -> "Filters":
        """Selection as filters.

        Args:
            limit: at most so many; None or 0 for all of them.

        Raises:
            UsageError: a time, a verdict or a limit that is none.
        """
        from datetime import UTC, datetime

        from anisoscope.history.filters import Filters, parse_moment

        now = datetime.now(UTC)
        verdict = None if self.verdict is None else self.verdict.upper()
        if verdict is not None and verdict not in VERDICTS:
            raise UsageError(f"--verdict takes {', '.join(VERDICTS)}, not {self.verdict!r}")
        if limit is not None and limit < 0:
            raise UsageError(f"--limit takes a positive whole number, or 0 for no limit, not {limit}")
        return Filters(
            since=None if self.since is None else parse_moment(self.since, "--since", now=now),
            until=None if self.until is None else parse_moment(self.until, "--until", now=now, at_end=True),
            lot=self.lot,
            cavity=self.cavity,
            product=self.product,
            recipe=self.recipe,
            station=self.station,
            operator=self.operator,
            serial=self.serial,
            verdict=verdict,
            limit=limit or None,
        )


ALL = Which()


Selection = Annotated[Which, Parameter(name="*")]


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
