"""The database of a history: SQLite in a file, or PostgreSQL by URL; transactions in which one process writes."""

import logging
import os
import socket
import sqlite3
import ssl
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

from sqlalchemy import URL, Connection, Dialect, Engine, create_engine, event, text
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from anisoscope.history import schema
from anisoscope.history.address import Address
from anisoscope.history.problems import HistoryError

# What becomes of a connection that the server cut is in our own message; the pool's traceback goes to the log only.
logging.getLogger("sqlalchemy").addHandler(logging.NullHandler())
WAIT_S = 12
IDLE_S = 60
"""A client of PostgreSQL that does nothing within a transaction for so long is cut off; it takes milliseconds else."""
_WRITES = "anisoscope_writes"
# Any number will do, as long as every writer takes the same one.
_LOCK = 0x616E_6973
# A rig that loses its power while it writes holds the lock until the server misses it: after 10 + 3 × 5 s, not hours.
_SESSION = {
    "tcp_keepalives_idle": "10",
    "tcp_keepalives_interval": "5",
    "tcp_keepalives_count": "3",
    "idle_in_transaction_session_timeout": f"{IDLE_S}s",
}
_ONE_STATE: dict[str, Any] = {"isolation_level": "REPEATABLE READ", "postgresql_readonly": True}
_LOCK_NOT_AVAILABLE, _NO_RIGHT = "55P03", "42501"
_HOLDER = """
SELECT a.application_name, host(a.client_addr), extract(epoch FROM clock_timestamp() - a.xact_start)
FROM pg_locks l JOIN pg_stat_activity a USING (pid)
WHERE l.locktype = 'advisory' AND l.granted AND l.classid = 0 AND l.objid = :lock AND l.objsubid = 1
"""


class Database:
    """Database of one history.

    Writers wait for each other: on SQLite by BEGIN IMMEDIATE, on PostgreSQL by an advisory lock that ends with its
    transaction, so that it dies with its process. Reading changes no byte of a file, and works on a medium that
    cannot be written.

    Args:
        address: where it is.
        wait_s: for how long a writer of PostgreSQL waits for others.
    """

    def __init__(self, address: Address, *, wait_s: float = WAIT_S) -> None:
        self.address = address
        self.wait_s = wait_s
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
        with self._explained("read"), self.engine.connect() as connection:
            reader = connection if self.is_sqlite else connection.execution_options(**_ONE_STATE)
            with reader.begin():
                yield reader

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """Exclusive write transaction; it is safe on disk once this is left.

        Raises:
            HistoryError: the database cannot be reached or written.
        """
        with self._explained("write"), self.engine.connect() as connection:
            if self.is_sqlite:
                _write_ahead(connection)
            writer = connection.execution_options(**{_WRITES: True})
            with writer.begin():
                if not self.is_sqlite:
                    self._wait_for_others(writer)
                yield writer

    def bring_up_to_date(self, writer: Connection, found: int) -> None:
        """Make the tables of an earlier version, or none, those of the present one.

        Raises:
            HistoryError: this user may not.
        """
        try:
            schema.migrate(writer)
        except DBAPIError as error:
            if found == 0 or _code(error) != _NO_RIGHT:
                raise
            raise HistoryError(
                f"cannot write the history {self.address}: its tables are of version {found}, this anisoscope needs "
                f"{schema.VERSION}, and this user may not change them: add something as their owner"
            ) from error

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()

    def _wait_for_others(self, writer: Connection) -> None:
        writer.execute(text(f"SET LOCAL lock_timeout = '{self.wait_s * 1e3:.0f}ms'"))
        try:
            writer.execute(text(f"SELECT pg_advisory_xact_lock({_LOCK})"))
        except DBAPIError as error:
            if _code(error) != _LOCK_NOT_AVAILABLE:
                raise
            raise HistoryError(f"cannot write the history {self.address}: {self._holder()}") from error

    def _holder(self) -> str:
        """Who writes, and for how long."""
        with self.engine.connect() as connection:
            found = connection.execute(text(_HOLDER), {"lock": _LOCK}).first()
        if found is None:
            return f"other programs wrote for more than {self.wait_s:g} s; try again"
        name, host, seconds = found
        where = f" at {host}" if host else ""
        return (
            f"{name or 'another program'}{where} has been writing for {seconds:.0f} s; try again, or end that program "
            f"(the server cuts it off when its computer is gone, or after {IDLE_S} s without a statement)"
        )

    @contextmanager
    def _explained(self, doing: str) -> Iterator[None]:
        try:
            yield
        except (
            SQLAlchemyError,
            self.engine.dialect.loaded_dbapi.Error,  # a line cut while a transaction begins
            OSError,
            UnicodeDecodeError,
        ) as error:
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


def _code(error: DBAPIError) -> str:
    """SQLSTATE of an error of PostgreSQL."""
    detail = error.orig.args[0] if error.orig is not None and error.orig.args else ""
    return str(detail.get("C", "")) if isinstance(detail, dict) else ""


def _sqlite(path: Path) -> Engine:
    engine = create_engine(_url(path), connect_args={"timeout": WAIT_S})

    @event.listens_for(engine, "do_connect")
    def connect(dialect: Dialect, _record: object, given: Any, named: Any) -> Any:  # noqa: ANN401
        connection = dialect.connect(*given, **named)
        try:
            connection.execute("SELECT 1 FROM sqlite_master LIMIT 1").fetchone()
        except sqlite3.Error as error:
            if str(getattr(error, "sqlite_errorname", "")).startswith("SQLITE_IOERR_SHM"):
                # a full disk has no room for the memory that several readers share: this one reads alone
                connection.close()
                connection = dialect.connect(*given, **named)
                connection.execute("PRAGMA locking_mode = EXCLUSIVE")
        return connection

    @event.listens_for(engine, "connect")
    def prepare(connection: sqlite3.Connection, _record: object) -> None:
        connection.isolation_level = None  # transactions begin where we say so
        connection.execute("PRAGMA synchronous = FULL")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        writes = connection.get_execution_options().get(_WRITES, False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine


def _url(path: Path) -> URL:
    """Address of a file; on a medium that cannot be written, for reading without locks and log files.

    Raises:
        HistoryError: rows in the write-ahead log of such a medium would be missing.
    """
    if not path.exists() or all(os.access(one, os.W_OK, **_EFFECTIVE) for one in (path, path.parent)):
        return URL.create("sqlite+pysqlite", database=str(path))
    log = path.with_name(path.name + "-wal")
    if log.exists() and log.stat().st_size > 0:
        raise HistoryError(
            f"{path} cannot be written, and its last rows are in {log.name}: copy both files to a folder that can be "
            "written, and read them there"
        )
    return URL.create(
        "sqlite+pysqlite", database=f"file:{quote(str(path))}", query={"immutable": "1", "uri": "true"}
    )


_EFFECTIVE = {"effective_ids": True} if os.access in os.supports_effective_ids else {}


def _write_ahead(connection: Connection) -> None:
    """Concurrent readers and a writer; a file system without support falls back to SQLite's default."""
    driver = connection.connection.driver_connection
    assert isinstance(driver, sqlite3.Connection)
    for attempt in range(50):
        try:
            if driver.execute("PRAGMA journal_mode").fetchone()[0] == "wal":
                return
            driver.execute("PRAGMA journal_mode = WAL")
        except sqlite3.OperationalError as error:
            # the change does not wait for others as writing does
            if "locked" not in str(error) or attempt == 49:
                raise
            time.sleep(0.02)
        else:
            return


def _postgresql(address: Address) -> Engine:
    name = f"anisoscope, process {os.getpid()} on {socket.gethostname()}"
    options: dict[str, Any] = {"timeout": WAIT_S + 3, "application_name": name[:63]}
    assert address.url is not None
    if address.tls is not None:
        options["ssl_context"] = address.tls
    engine = create_engine(
        address.url,
        connect_args=options,
        # After waiting for the lock a writer must see what the one before it wrote.
        isolation_level="READ COMMITTED",
        pool_size=1,
        pool_pre_ping=True,  # a server may have been started anew meanwhile
    )

    @event.listens_for(engine, "connect")
    def prepare(connection: Any, _record: object) -> None:  # noqa: ANN401 - pg8000 has no types
        settings = ", ".join(f"set_config('{name}', '{value}', false)" for name, value in _SESSION.items())
        cursor = connection.cursor()
        cursor.execute(f"SELECT {settings}")
        cursor.close()
        connection.commit()

    return engine
