"""Where an archive is: a folder (a network share too), or a bucket of a store that speaks S3 (extra ``archive``).

A store holds files by name. A file appears whole or not at all, and reading or writing one either succeeds or raises an
`ArchiveError` of one line.
"""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar
from urllib.parse import parse_qs, unquote, urlsplit

from anisoscope.base.errors import AnisoscopeError, UsageError

Result = TypeVar("Result")
TIMEOUT_S = 10.0


class ArchiveError(AnisoscopeError):
    """An archive that cannot be reached, read or written, or that holds something else than it should."""

    exit_code: ClassVar[int] = 69


@dataclass(frozen=True)
class Stored:
    """A file of a store: its name, bytes, and when it was written (UTC)."""

    name: str
    size: int
    written_at: datetime


class Store(Protocol):
    """Files by names with forward slashes; every method raises `ArchiveError` where the store does not answer."""

    url: str

    def put(self, name: str, path: Path) -> None:
        """Store the content of a local file."""
        ...

    def write(self, name: str, content: bytes) -> None:
        """Store some bytes."""
        ...

    def read(self, name: str) -> bytes | None:
        """The content of a file, or None where there is none."""
        ...

    def size(self, name: str) -> int | None:
        """Number of bytes of a file, or None where there is none."""
        ...

    def files(self, below: str) -> Iterator[Stored]:
        """All files below a folder."""
        ...

    def delete(self, name: str) -> None:
        """Delete a file; none is no error."""
        ...


def open_store(url: str) -> Store:
    """The store of a URL: a path, ``file:///path``, or ``s3://bucket/folder?endpoint=https://host:9000``.

    Credentials of S3 are those of its environment variables or files (``AWS_ACCESS_KEY_ID``, ``~/.aws/credentials``).

    Raises:
        UsageError: another URL, or the extra ``archive`` is not installed.
    """
    parts = urlsplit(url)
    if parts.scheme == "s3":
        if not parts.netloc:
            raise UsageError(f"{url}: name a bucket: s3://bucket/folder")
        return S3Store(url)
    if parts.scheme == "file":
        return FolderStore(Path(unquote(parts.path)))
    if "://" in url:
        raise UsageError(f"{url}: an archive is a folder, file:// or s3://, not {parts.scheme}://")
    return FolderStore(Path(url))


class FolderStore:
    """A folder of this computer, or of a network share.

    Args:
        folder: made where something is stored.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.url = folder, str(folder)

    def put(self, name: str, path: Path) -> None:
        """Store the content of a local file."""
        with self._writing(name) as target, path.open("rb") as source:
            shutil.copyfileobj(source, target, 1 << 20)

    def write(self, name: str, content: bytes) -> None:
        """Store some bytes."""
        with self._writing(name) as target:
            target.write(content)

    @contextlib.contextmanager
    def _writing(self, name: str) -> Iterator[Any]:
        place = self.folder / name
        temporary: Path | None = None
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            descriptor, partial = tempfile.mkstemp(dir=place.parent, prefix=".partial-")
            temporary = Path(partial)
            with os.fdopen(descriptor, "wb") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            temporary.chmod(0o644)
            temporary.replace(place)
            temporary = None
        except OSError as error:
            raise ArchiveError(f"{place}: cannot be written: {error.strerror or error}") from error
        finally:
            if temporary is not None:
                with contextlib.suppress(OSError):
                    temporary.unlink()

    def read(self, name: str) -> bytes | None:
        """The content of a file, or None."""
        try:
            return (self.folder / name).read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise ArchiveError(f"{self.folder / name}: cannot be read: {error.strerror or error}") from error

    def size(self, name: str) -> int | None:
        """Number of bytes of a file, or None."""
        try:
            return (self.folder / name).stat().st_size
        except FileNotFoundError:
            return None
        except OSError as error:
            raise ArchiveError(f"{self.folder / name}: cannot be read: {error.strerror or error}") from error

    def files(self, below: str) -> Iterator[Stored]:
        """All files below a folder."""
        for path in sorted((self.folder / below).rglob("*")):
            if path.is_file() and not path.name.startswith(".partial-"):
                found = path.stat()
                name = path.relative_to(self.folder).as_posix()
                yield Stored(name, found.st_size, datetime.fromtimestamp(found.st_mtime, UTC))

    def delete(self, name: str) -> None:
        """Delete a file."""
        try:
            (self.folder / name).unlink(missing_ok=True)
        except OSError as error:
            raise ArchiveError(
                f"{self.folder / name}: cannot be deleted: {error.strerror or error}"
            ) from error


class S3Store:
    """A bucket, by s3fs.

    Args:
        url: ``s3://bucket/folder``, with ``?endpoint=`` where it is not Amazon's.

    Raises:
        UsageError: the extra ``archive`` is not installed.
    """

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self.url = url
        self._root = f"{parts.netloc}{parts.path}".rstrip("/")
        try:
            from s3fs import S3FileSystem  # noqa: PLC0415 - an extra
        except ImportError as error:
            raise UsageError(f"{url}: S3 needs the package s3fs: pip install anisoscope[archive]") from error
        endpoint = next(iter(parse_qs(parts.query).get("endpoint", [])), None)
        self._files: Any = S3FileSystem(
            endpoint_url=endpoint,
            use_listings_cache=False,
            skip_instance_cache=True,
            config_kwargs={
                "connect_timeout": TIMEOUT_S,
                "read_timeout": 6.0 * TIMEOUT_S,
                "retries": {"max_attempts": 2},
            },
        )

    def _do(self, what: Callable[[], Result]) -> Result:
        """Ask the server; its many errors become one line."""
        try:
            return what()
        except FileNotFoundError:
            raise
        except PermissionError as error:
            raise ArchiveError(
                f"{self.url}: the server refuses these credentials ({_first_line(error)}): check AWS_ACCESS_KEY_ID and "
                "AWS_SECRET_ACCESS_KEY, and what they may do"
            ) from error
        except Exception as error:
            if type(error).__name__ == "NoCredentialsError":
                raise ArchiveError(
                    f"{self.url}: no credentials: set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
                ) from error
            raise ArchiveError(f"{self.url}: no answer, or a wrong one: {_first_line(error)}") from error

    def _at(self, name: str) -> str:
        return f"{self._root}/{name}"

    def put(self, name: str, path: Path) -> None:
        """Store the content of a local file."""
        self._there(lambda: self._files.put_file(str(path), self._at(name)))

    def write(self, name: str, content: bytes) -> None:
        """Store some bytes."""
        self._there(lambda: self._files.pipe_file(self._at(name), content))

    def _there(self, what: Callable[[], object]) -> None:
        try:
            self._do(what)
        except FileNotFoundError as error:
            raise ArchiveError(f"{self.url}: there is no such bucket") from error

    def read(self, name: str) -> bytes | None:
        """The content of a file, or None."""
        try:
            content: bytes = self._do(lambda: self._files.cat_file(self._at(name)))
        except FileNotFoundError:
            return None
        return content

    def size(self, name: str) -> int | None:
        """Number of bytes of a file, or None."""
        try:
            return int(self._do(lambda: self._files.info(self._at(name)))["size"])
        except FileNotFoundError:
            return None

    def files(self, below: str) -> Iterator[Stored]:
        """All files below a folder."""
        try:
            found = self._do(lambda: self._files.find(self._at(below), detail=True))
        except FileNotFoundError:
            return
        for path, info in sorted(found.items()):
            yield Stored(path.removeprefix(f"{self._root}/"), int(info["size"]), info["LastModified"])

    def delete(self, name: str) -> None:
        """Delete a file."""
        with contextlib.suppress(FileNotFoundError):
            self._do(lambda: self._files.rm_file(self._at(name)))


def _first_line(error: BaseException) -> str:
    text = str(error).strip() or type(error).__name__
    return text.splitlines()[0]
