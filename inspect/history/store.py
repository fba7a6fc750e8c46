"""The history of all inspections: append-only, chained by hashes, one chain for all rigs that write into it."""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from sqlalchemy import Connection

from anisoscope.base.errors import UsageError
from anisoscope.base.notebook import data_frame, html_table
from anisoscope.history import chain, schema, statements
from anisoscope.history.address import Address, parse_address
from anisoscope.history.column_wise import Columns, read_columns
from anisoscope.history.columns import disposition_from, row_from
from anisoscope.history.covariates import Covariates, CycleData, append_covariates, read_covariates
from anisoscope.history.database import Database
from anisoscope.history.dispositions import Disposition, checked_disposition
from anisoscope.history.filters import Filters
from anisoscope.history.problems import Damage, HistoryError
from anisoscope.history.rows import NewRow, Row, seal_of, storable
from anisoscope.record.schema import RECORD_NAME

EVERYTHING = Filters()
_PORTION = 500
LATEST = 10  # the latest ones, in a notebook


@dataclass(frozen=True, eq=False)
class Series:
    """Time series of one number, the oldest first.

    Attributes:
        ids: (n,) ids of the inspections, int64.
        times: (n,) when their records were made, UTC, datetime64[us].
        values: (n,) the number, float64; inspections that do not have it are left out.
    """

    ids: npt.NDArray[np.int64]
    times: npt.NDArray[np.datetime64]
    values: npt.NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, eq=False)
class Selection:
    """Inspections of one state of a history, read as they are needed; from `History.selection`."""

    filters: Filters
    _connection: Connection
    _place: Path | None

    def labels(self) -> tuple[str, ...]:
        """Labels of all numbers that some of the inspections have, each once."""
        return statements.labels(self._connection, self.filters)

    def verdicts(self) -> dict[str, dict[str, int]]:
        """Number of inspections by product and verdict, in the order in which the products came."""
        return statements.verdicts(self._connection, self.filters)

    def decided(self, product: str | None = None) -> Iterator[tuple[Row, list[Disposition]]]:
        """Inspections with their dispositions, both the oldest first.

        Args:
            product: only those of this product.
        """
        found = statements.stream(self._connection, self.filters, product)
        while some := [row_from(values, self._place) for values in islice(found, _PORTION)]:
            decided = _dispositions(self._connection, [row.id for row in some])
            yield from ((row, decided.get(row.id, [])) for row in some)


def _dispositions(connection: Connection, row_ids: Sequence[int]) -> dict[int, list[Disposition]]:
    found: dict[int, list[Disposition]] = {}
    for values in statements.dispositions(connection, row_ids):
        found.setdefault(values["inspection"], []).append(disposition_from(values))
    return found


@dataclass(eq=False)
class History:
    """Open history from `open_history`; closed on leaving the context."""

    address: Address
    _database: Database = field(init=False)
    _is_present: bool = field(init=False, default=False)  # whether the tables are of the present version

    def __post_init__(self) -> None:
        self._database = Database(self.address)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def __repr__(self) -> str:
        """One line: its address and number of inspections, from a query."""
        return f"History({self.address}, {self.count()} inspections)"

    def _repr_html_(self) -> str:
        rows = [
            (row.id, f"{row.created_at:%Y-%m-%d %H:%M}", row.serial, row.product, row.verdict)
            for row in self.rows(Filters(limit=LATEST))
        ]
        title = f"{self.address}: {self.count()} inspections, the latest {len(rows)}"
        return html_table(title, ("id", "UTC", "serial", "product", "verdict"), rows)

    def to_frame(self, filters: Filters = EVERYTHING) -> Any:  # noqa: ANN401 - pandas need not be installed
        """Inspections as a pandas data frame, the oldest first: when, words, and a column for every measured number.

        Args:
            filters: which inspections.

        Raises:
            UsageError: pandas is not installed, or as for `rows`.
            HistoryError: as for `rows`.
        """
        found = self.columns(filters)
        return data_frame({"created_at": found.times, **found.texts, **found.numbers})

    def append(self, new: NewRow) -> Row:
        """Add an inspection; it is safe on disk when this returns. Its seal is added once, however often it is tried.

        Returns:
            The row in the history, which is the earlier one where the seal was there already.

        Raises:
            HistoryError: the database cannot be reached or written.
        """
        return self.append_all([new])[0]

    def append_all(self, news: Sequence[NewRow]) -> list[Row]:
        """Add many inspections in one transaction: all of them, or none.

        Raises:
            HistoryError: as for `append`.
        """
        with self.writing() as connection:
            return statements.append_rows(connection, news, self.address.path)

    def reading(self) -> AbstractContextManager[Connection]:
        """Transaction that sees one state of the history."""
        return self._database.reading()

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """Exclusive write transaction on tables of the present version."""
        with self._database.writing() as connection:
            if not self._is_present:
                found = schema.version_of(connection)
                schema.check_version(found, self.address)
                if found < schema.VERSION:
                    self._database.bring_up_to_date(connection, found)
            yield connection
        self._is_present = True

    def _row(self, values: Any) -> Row:  # noqa: ANN401 - a row of any query
        return row_from(values, self.address.path)

    def rows(self, filters: Filters = EVERYTHING) -> list[Row]:
        """Inspections, the oldest first; with a limit the latest ones.

        Raises:
            UsageError: a filter that makes no sense.
            HistoryError: the database cannot be read.
        """
        with self._database.reading() as connection:
            return [self._row(found) for found in statements.rows(connection, filters)]

    @contextmanager
    def selection(self, filters: Filters = EVERYTHING) -> Iterator[Selection]:
        """Read inspections in the memory of a few, however many there are.

        Raises:
            UsageError, HistoryError: as for `rows`.
        """
        with self._database.reading() as connection:
            yield Selection(filters, connection, self.address.path)

    def count(self, filters: Filters = EVERYTHING) -> int:
        """Number of inspections; the filter's limit is ignored.

        Raises:
            UsageError, HistoryError: as for `rows`.
        """
        with self._database.reading() as connection:
            return statements.count(connection, filters)

    def last_id(self) -> int:
        """Id of the last inspection that was added; 0 before the first."""
        with self._database.reading() as connection:
            return statements.head(connection, schema.inspections)[0]

    def after(self, row_id: int, most: int) -> list[Row]:
        """The inspections that were added after one, in the order in which they were added.

        Args:
            row_id: its id; 0 for all.
            most: so many at most.
        """
        with self._database.reading() as connection:
            return [self._row(found) for found in statements.after(connection, row_id, most)]

    def row(self, row_id: int) -> Row | None:
        """The inspection with an id, or None."""
        return self._one(schema.inspections.c.id == row_id)

    def row_by_seal(self, seal: str) -> Row | None:
        """The inspection whose record has a seal, or None."""
        return self._one(schema.inspections.c.seal == bytes.fromhex(seal))

    def used_by_others(self, pixels: Sequence[str], serial: str) -> Row | None:
        """The first inspection of another serial number that shows one of these pictures, or None.

        Args:
            pixels: `anisoscope.rig.frame.Frame.pixels` of the frames.
            serial: of the part itself.

        Raises:
            HistoryError: the database cannot be read.
        """
        with self._database.reading() as connection:
            if schema.version_of(connection) < schema.WITH_PICTURES:
                return None
            found = statements.used_by_others(connection, pixels, storable(serial))
            return None if found is None else self._row(found)

    def differing_frames(self, after: int = 0) -> dict[str, int]:
        """Serial numbers of several inspections with frames of their own, and how many of these each has.

        Args:
            after: at least one of them was added after this id.

        Raises:
            HistoryError: the database cannot be read.
        """
        with self._database.reading() as connection:
            if schema.version_of(connection) < schema.WITH_PICTURES:
                return {}
            return statements.differing_frames(connection, after)

    def _one(self, condition: Any) -> Row | None:  # noqa: ANN401 - SQLAlchemy's conditions have no common type
        with self._database.reading() as connection:
            found = statements.one(connection, condition)
            return None if found is None else self._row(found)

    def series(self, filters: Filters, number: str) -> Series:
        """Time series of one number, the oldest first.

        Args:
            filters: which inspections.
            number: its label, such as ``ln 0-90``.

        Raises:
            UsageError, HistoryError: as for `rows`.
        """
        with self._database.reading() as connection:
            ids, times, values = statements.series(connection, filters, number)
        return Series(
            np.array(ids, dtype=np.int64),
            np.array(times, dtype="datetime64[us]"),
            np.array(values, dtype=np.float64),
        )

    def columns(self, filters: Filters = EVERYTHING) -> Columns:
        """Many inspections column by column, the oldest first; much quicker than their rows.

        Raises:
            UsageError, HistoryError: as for `rows`.
        """
        with self._database.reading() as connection:
            place = self.address.path
            return read_columns(connection, filters, Path() if place is None else place.parent)

    def labels(self, filters: Filters = EVERYTHING) -> tuple[str, ...]:
        """Labels of all numbers that some of these inspections have, each once.

        Raises:
            UsageError, HistoryError: as for `rows`.
        """
        with self._database.reading() as connection:
            return statements.labels(connection, filters)

    def dispose(self, row_id: int, *, reviewer: str, decision: str, comment: str = "") -> Disposition:
        """Add a reviewer's disposition of an inspection; earlier ones are unchanged.

        Raises:
            UsageError: there is no such inspection, nobody decides, or something that is no decision.
            HistoryError: the database cannot be reached or written.
        """
        who, what, why = checked_disposition(reviewer, decision, comment)
        with self.writing() as connection:
            if statements.one(connection, schema.inspections.c.id == row_id) is None:
                raise UsageError(f"the history {self.address} has no inspection {row_id}")
            return statements.append_disposition(connection, row_id, who, what, why)

    def dispositions(self, row_id: int) -> list[Disposition]:
        """Dispositions of an inspection, the oldest first.

        Raises:
            HistoryError: the database cannot be read.
        """
        return self.dispositions_of([row_id]).get(row_id, [])

    def dispositions_of(self, row_ids: Sequence[int]) -> dict[int, list[Disposition]]:
        """The same for many inspections, by their ids.

        Raises:
            HistoryError: the database cannot be read.
        """
        with self._database.reading() as connection:
            return _dispositions(connection, row_ids)

    def add_covariates(self, news: Sequence[CycleData]) -> int:
        """Add cycle data of machines in one transaction; those that are there already are passed over.

        Returns:
            How many are new.

        Raises:
            HistoryError: the database cannot be reached or written.
        """
        with self.writing() as connection:
            return append_covariates(connection, news)

    def covariates(self) -> Covariates:
        """All cycle data of machines.

        Raises:
            HistoryError: the database cannot be read.
        """
        with self._database.reading() as connection:
            return read_covariates(connection)

    def verify_chain(self) -> list[Damage]:
        """Recompute every hash; list the damage, each entry naming its row.

        Raises:
            HistoryError: the database cannot be read at all.
        """
        return chain.verify_chain(self._database)

    def head(self) -> str:
        """Hash of the last inspection, hexadecimal: a copy of it elsewhere reveals a truncated history."""
        with self._database.reading() as connection:
            return statements.head(connection, schema.inspections)[1].hex()

    def disposition_head(self) -> str:
        """The same of the last disposition; zeros before the first."""
        with self._database.reading() as connection:
            return statements.head(connection, schema.dispositions)[1].hex()

    def covariate_head(self) -> str:
        """The same of the last cycle data."""
        with self._database.reading() as connection:
            there = schema.version_of(connection) >= schema.WITH_COVARIATES
            return (statements.head(connection, schema.covariates)[1] if there else chain.START).hex()

    def holds(self, head: str) -> bool:
        """Whether a row of any chain has this hash: a history that is only added to holds every head.

        The zeros of a chain without rows are held too.
        """
        if bytes.fromhex(head) == chain.START:
            return True
        with self._database.reading() as connection:
            chains = [schema.inspections, schema.dispositions]
            if schema.version_of(connection) >= schema.WITH_COVARIATES:
                chains.append(schema.covariates)
            return any(statements.holds(connection, table, bytes.fromhex(head)) for table in chains)


def open_history(place: str | Path, *, create: bool = True) -> History:
    """Open a history. The database of another program stays as it is.

    Tables of an earlier version are brought up to date before something is added; reading leaves them as they are.

    Args:
        place: a file, a folder that holds ``history.sqlite``, or a URL: see `parse_address`.
        create: make one where there is none.

    Raises:
        UsageError: this is no place of a history.
        HistoryError: it cannot be reached, there is none, something else is there, or a later program made it.
    """
    address = parse_address(place)
    if address.path is not None and not address.path.exists():
        if not create:
            raise _none(address)
        try:
            address.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise HistoryError(f"cannot make the history {address}: {error.strerror}") from error
    history = History(address)
    try:
        _check(history, address, create)
    except BaseException:
        history.close()
        raise
    return history


def _check(history: History, address: Address, create: bool) -> None:
    database = history._database  # noqa: SLF001 - the other half of the constructor
    with database.reading() as connection:
        found = schema.version_of(connection)
        others = schema.tables(connection) if found == 0 else []
    schema.check_version(found, address)
    if others and database.is_sqlite:
        raise HistoryError(
            f"{address} is no history: it has the tables of something else ({', '.join(others[:3])}); name another file"
        )
    if found == 0 and not create:
        raise _none(address)
    if found < schema.WITH_DISPOSITIONS:
        with history.writing():
            pass


def _none(address: Address) -> HistoryError:
    return HistoryError(
        f"there is no history {address} yet: an inspection begins it, and `anisoscope history add FOLDER…` makes one "
        "of finished ones"
    )


_BY_ID, _BY_SERIAL = "id:", "serial:"
_MAX_DIGITS = 18


def find(history: History, name: str) -> Row:
    """Inspection by serial number, id or folder; of a part that was inspected several times, the latest one.

    Args:
        history: where to look.
        name: serial number, id, or folder of a finished inspection. ``id:7`` and ``serial:7`` tell apart what else
            could be both.

    Raises:
        UsageError: there is none, or it is not clear which.
        RecordError: the record of the folder cannot be read.
        HistoryError: the history cannot be read.
    """
    if name.startswith(_BY_ID):
        return _found_row(_by_id(history, name.removeprefix(_BY_ID)), history, name)
    if name.startswith(_BY_SERIAL):
        return _found_row(_by_serial(history, name.removeprefix(_BY_SERIAL)), history, name)
    if "\0" not in name and (Path(name) / RECORD_NAME).is_file():
        row = history.row_by_seal(seal_of(Path(name)))
        if row is None:
            raise UsageError(
                f"{name} is not in the history {history.address}: `anisoscope history add {name}` adds it"
            )
        return row
    found = [row for row in (_by_id(history, name), _by_serial(history, name)) if row is not None]
    if len(found) == 2 and found[0] != found[1]:
        raise UsageError(
            f"{name} is both an id and a serial number: say {_BY_ID}{name} or {_BY_SERIAL}{name}"
        )
    return _found_row(found[0] if found else None, history, name)


def _by_id(history: History, text: str) -> Row | None:
    plain = text.isascii() and text.isdigit() and len(text) <= _MAX_DIGITS
    return history.row(int(text)) if plain else None


def _by_serial(history: History, serial: str) -> Row | None:
    rows = history.rows(Filters(serial=serial, limit=1))
    return rows[0] if rows else None


def _found_row(row: Row | None, history: History, name: str) -> Row:
    if row is None:
        raise UsageError(
            f"the history {history.address} has no inspection {name[:80]!r}: name a serial number, an id or a folder"
        )
    return row
