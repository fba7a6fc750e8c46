"""The database of a history: SQLite in a file, or PostgreSQL by URL; transactions in which one process writes."""

import sqlite3
import ssl
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, Engine, create_engine, event, text
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from anisoscope.history.address import Address
from anisoscope.history.problems import HistoryError

WAIT_S = 12
_WRITES = "anisoscope_writes"
# Any number will do, as long as every writer takes the same one.
_LOCK = 0x616E_6973


class Database:
    """Database of one history.

    Writers wait for each other: on SQLite by BEGIN IMMEDIATE, on PostgreSQL by an advisory lock that ends with its
    transaction, so that it dies with its process.
    """

    def __init__(self, address: Address) -> None:
        self.address = address
        self.engine = _sqlite(address.path) if address.path is not None else _postgresql(address)

    @property
    def is_sqlite(self) -> bool:
        """Whether it is a file."""
        return self.address.path is not None

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """A transaction that sees one state of the history.

        Raises:
            HistoryError: the database cannot be reached or read.
        """
        with self._explained("read"), self.engine.connect() as connection, connection.begin():
            yield connection

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """Exclusive write transaction; it is safe on disk once this is left.

        Raises:
            HistoryError: the database cannot be reached or written.
        """
        with self._explained("write"), self.engine.connect() as connection:
            writer = connection.execution_options(**{_WRITES: True})
            with writer.begin():
                if not self.is_sqlite:
                    writer.execute(text(f"SET LOCAL lock_timeout = '{WAIT_S}s'"))
                    writer.execute(text(f"SELECT pg_advisory_xact_lock({_LOCK})"))
                yield writer

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()

    @contextmanager
    def _explained(self, doing: str) -> Iterator[None]:
        try:
            yield
        except (SQLAlchemyError, OSError, sqlite3.Error, UnicodeDecodeError) as error:
            raise HistoryError(f"cannot {doing} the history {self.address}: {_reason(error)}") from error


def _reason(error: BaseException) -> str:
    """Message of the database, in one line and without the statement."""
    origin = error.orig if isinstance(error, DBAPIError) and error.orig is not None else error
    detail = origin.args[0] if origin.args else str(origin)
    if isinstance(detail, dict):  # PostgreSQL's message with its parts
        detail = detail.get("M", detail)
    if isinstance(origin, ssl.SSLCertVerificationError):
        detail = f"its certificate is not trusted: {origin.verify_message}"
    elif isinstance(origin, OSError):
        detail = origin.strerror or str(origin)
    lines = str(detail).splitlines()
    return lines[0] if lines else type(origin).__name__


def _sqlite(path: Path) -> Engine:
    engine = create_engine(
        URL.create("sqlite+pysqlite", database=str(path)),
        connect_args={"timeout": WAIT_S},
    )

    @event.listens_for(engine, "connect")
    def prepare(connection: sqlite3.Connection, _record: object) -> None:
        connection.isolation_level = None  # transactions begin where we say so
        _write_ahead(connection)
        connection.execute("PRAGMA synchronous = FULL")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        writes = connection.get_execution_options().get(_WRITES, False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine


def _write_ahead(connection: sqlite3.Connection) -> None:
    """Concurrent readers and a writer; a file system without support falls back to SQLite's default."""
    for attempt in range(50):
        try:
            if connection.execute("PRAGMA journal_mode").fetchone()[0] == "wal":
                return
            connection.execute("PRAGMA journal_mode = WAL")
        except sqlite3.OperationalError as error:
            # the change does not wait for others as writing does
            if "locked" not in str(error) or attempt == 49:
                raise
            time.sleep(0.02)
        else:
            return


def _postgresql(address: Address) -> Engine:
    options: dict[str, Any] = {"timeout": WAIT_S + 3, "application_name": "anisoscope"}
    if address.tls is not None:
        options["ssl_context"] = address.tls
    return create_engine(
        address.url,
        connect_args=options,
        # After waiting for the lock a writer must see what the one before it wrote.
        isolation_level="READ COMMITTED",
        pool_size=1,
        pool_pre_ping=True,  # a server may have been started anew meanwhile
    )
