"""Address of a history: an SQLite file, a folder that holds one, or a URL of PostgreSQL."""

import os
import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from anisoscope.base.errors import UsageError

if TYPE_CHECKING:  # a file needs no library to be named
    from sqlalchemy import URL

HISTORY_NAME = "history.sqlite"
VARIABLE = "ANISOSCOPE_HISTORY"
NONE = "none"
_DRIVER = "postgresql+pg8000"
_SCHEMES = ("postgresql", "postgres", _DRIVER)
_PORT = 5432
MODES = ("disable", "prefer", "require", "verify-ca", "verify-full")


@dataclass(frozen=True)
class Address:
    """A history's place; as text it does not show the password.

    Attributes:
        url: of a server, for the database's driver; None of a file.
        path: the file, or None of a server.
        tls: how the connection is encrypted; False: not at all; None: if the server offers it.
    """

    url: "URL | None" = None
    path: Path | None = None
    tls: ssl.SSLContext | Literal[False] | None = None

    def __str__(self) -> str:
        return str(self.path) if self.url is None else self.url.render_as_string(hide_password=True)


def parse_address(text: str | Path) -> Address:
    """Parse the place of a history; nothing is opened.

    Args:
        text: a file, a folder of inspections, ``sqlite:///FILE`` or ``postgresql://USER:PASSWORD@HOST/DATABASE``.
            ``?host=/folder`` names the folder of a local server's socket; ``?sslmode=`` and ``sslrootcert=`` encrypt
            as they do for PostgreSQL's own programs.

    Raises:
        UsageError: it is none of these.
    """
    if isinstance(text, Path) or "://" not in text:
        return _file(Path(text))
    from sqlalchemy import make_url
    from sqlalchemy.exc import ArgumentError

    try:
        url = make_url(text)
    except (ArgumentError, ValueError):
        raise UsageError(
            "this is no address of a history: it takes a file, sqlite:///FILE, or "
            "postgresql://USER:PASSWORD@HOST/DATABASE"
        ) from None
    if url.drivername in {"sqlite", "sqlite+pysqlite"}:
        if not url.database or url.database == ":memory:" or url.query:
            raise UsageError(
                "a history in SQLite is a file: name it, as in sqlite:///inspections/history.sqlite"
            )
        return _file(Path(url.database))
    if url.drivername not in _SCHEMES:
        raise UsageError(
            f"a history cannot be in {url.drivername!r}: it takes a file, sqlite:///FILE, or postgresql://…"
        )
    return _server(url.set(drivername=_DRIVER))


def chosen(option: str | None, out: Path) -> str | Path | None:
    """The history that is meant: the option, the environment, or the file in the folder of inspections.

    Returns:
        What `parse_address` takes, or None where no history is wanted.
    """
    name = option if option is not None else os.environ.get(VARIABLE, "").strip() or None
    if name is None:
        return out / HISTORY_NAME
    return None if name == NONE else name


def _file(path: Path) -> Address:
    file = path / HISTORY_NAME if path.is_dir() else path
    file = file.absolute()
    return Address(path=file)


def _server(url: "URL") -> Address:
    query = dict(url.query)
    host, mode, root = query.pop("host", None), query.pop("sslmode", "prefer"), query.pop("sslrootcert", None)
    if query.keys() - {"unix_sock"} or not url.database:
        raise UsageError(
            f"the address {url.render_as_string(hide_password=True)} cannot be used: it takes a database, and after "
            f"a question mark host=/FOLDER, unix_sock=FILE, sslmode={', '.join(MODES)}, or sslrootcert=FILE"
        )
    if isinstance(host, str):
        query["unix_sock"] = f"{host}/.s.PGSQL.{url.port or _PORT}"
    return Address(url.set(query=query), None, _tls(str(mode), None if root is None else str(root)))


def _tls(mode: str, root: str | None) -> ssl.SSLContext | Literal[False] | None:
    if mode not in MODES:
        raise UsageError(f"sslmode is one of {', '.join(MODES)}, not {mode!r}")
    if root is not None and not mode.startswith("verify"):
        raise UsageError(
            f"sslrootcert is looked at with sslmode=verify-ca or verify-full only, not with {mode}"
        )
    if mode in {"disable", "prefer"}:
        return False if mode == "disable" else None
    try:
        context = ssl.create_default_context(cafile=root)
    except OSError as error:
        raise UsageError(
            f"sslrootcert={root}: holds no certificate that can be read: {error.strerror}"
        ) from error
    context.check_hostname = mode == "verify-full"
    if mode == "require":  # encrypts without knowing whom one talks to, as it does everywhere
        context.verify_mode = ssl.CERT_NONE
    return context
