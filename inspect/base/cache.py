"""Cache of results on disk, keyed by what they are computed from and by the code that computes them.

The folder is ``$ANISOSCOPE_CACHE``, or the user's cache folder; all in it may be deleted at any time. An entry is a
file in a folder of its kind, named by the hash of its key: the values that the caller gives (a recipe, the geometry of
a rig, hashes of files), the sources of the computing module and of its transitive imports
(`anisoscope.base.source_digest`), and the versions of the libraries that compute. A file that was cut off, altered, or
put there by somebody else is not an entry: its result is computed again. Where nothing can be written, nothing is
cached; nor is anything while a source is newer than the process: the loaded code is not what the digest is of.

Above the limit (``$ANISOSCOPE_CACHE_LIMIT_MB``, 512 MB) the entries that were not used for longest are removed. Any
number of processes may share the folder: entries appear whole, under names that say what they hold.
"""

import contextlib
import hashlib
import json
import os
import re
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TypeVar

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.base.source_digest import SourceDigests

Result = TypeVar("Result")

VARIABLE = "ANISOSCOPE_CACHE"
LIMIT_VARIABLE = "ANISOSCOPE_CACHE_LIMIT_MB"
LIMIT_MB = 512.0
LIBRARIES = ("anisoscope", "numpy", "scipy", "numba")
"""Distributions whose versions enter every key: they compute."""
_MAGIC = b"anisoscope cache 1\n"
_DIGEST_BYTES = 32
_NAME = re.compile(r"[0-9a-f]{32}\.entry")
_PARTIAL = re.compile(r"\.[0-9a-f]{32}\.entry\.\w+\.partial")
_MEMO = "sources.json"
_LEFTOVER_S = 3600.0
"""Age at which a partly written file belongs to a process that is gone."""


def cache_folder() -> Path:
    """Folder of results that can be computed again."""
    from platformdirs import user_cache_path  # noqa: PLC0415 - start-up time

    return Path(os.environ[VARIABLE]) if os.environ.get(VARIABLE) else user_cache_path("anisoscope")


def limit_bytes() -> int:
    """Largest size of the cache.

    Raises:
        UsageError: the environment variable is no number of megabytes.
    """
    text = os.environ.get(LIMIT_VARIABLE, "")
    try:
        megabytes = float(text) if text else LIMIT_MB
    except ValueError:
        megabytes = -1.0
    if not 0.0 <= megabytes < float("inf"):
        raise UsageError(f"{LIMIT_VARIABLE} takes a number of megabytes, 0 or more, not {text!r}")
    return round(megabytes * 1e6)


@dataclass(frozen=True)
class Stored:
    """One entry as a file.

    Attributes:
        kind: what it holds, such as "signatures".
        path: its file.
        size: bytes.
        used_at: when it was last written or read, seconds since the epoch.
    """

    kind: str
    path: Path
    size: int
    used_at: float


@dataclass(frozen=True)
class Entry:
    """Place of one result in a cache.

    Attributes:
        cache: the folder.
        path: the file.
        modules: what computes it.
    """

    cache: "Cache"
    path: Path
    modules: tuple[str, ...] = ()

    def read(self) -> bytes | None:
        """The stored content; None where there is none, or where it is not what was written."""
        if not sources_loaded(*self.modules):
            return None
        try:
            packed = self.path.read_bytes()
        except OSError:
            return None
        start = len(_MAGIC) + _DIGEST_BYTES
        content = packed[start:]
        if packed[:start] != _MAGIC + self._checksum(content):
            return None
        with contextlib.suppress(OSError):  # a folder that can only be read
            os.utime(self.path)
        _digests().save()
        return content

    def write(self, content: bytes) -> None:
        """Store content; in the user's cache folder, where that is impossible, nothing happens.

        Raises:
            RecordError: a folder of somebody's choice cannot be written.
        """
        if not sources_loaded(*self.modules):  # edited while it was computed
            return
        packed = _MAGIC + self._checksum(content) + content
        limit = self.cache.limit()
        if limit is not None and len(packed) > limit:
            return
        # a name of its own: another process may be writing the same entry
        writer = f"{os.getpid()}_{threading.get_ident()}"
        partial = self.path.with_name(f".{self.path.name}.{writer}.partial")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            try:
                partial.write_bytes(packed)  # without a sync: what a crash cuts off is no entry
                partial.replace(self.path)
            finally:
                partial.unlink(missing_ok=True)
        except OSError as error:
            if self.cache.folder is not None:
                raise RecordError(f"cannot write {self.path}: {error.strerror}") from error
            return
        _digests().save()
        self.cache.trim(self.path)

    def result(
        self,
        compute: Callable[[], Result],
        pack: Callable[[Result], bytes],
        unpack: Callable[[bytes], Result],
    ) -> Result:
        """The stored result, or the computed one, which is then stored."""
        content = self.read()
        if content is not None:
            return unpack(content)
        found = compute()
        self.write(pack(found))
        return found

    def _checksum(self, content: bytes) -> bytes:
        """Of the content under this name: a file that was renamed is foreign, too."""
        return hashlib.sha256(self.path.stem.encode() + content).digest()


@dataclass(frozen=True)
class Cache:
    """A folder of results.

    Args:
        folder: where it lies, by default the user's cache folder, which is limited in size.
    """

    folder: Path | None = None

    def entry(self, kind: str, given: object, *modules: str, libraries: Sequence[str] = LIBRARIES) -> Entry:
        """The place of a result.

        Args:
            kind: what it is, such as "signatures"; a name that can be a folder's.
            given: all that it is computed from, as JSON.
            modules: the modules that compute and pack it, mostly ``__name__``; also those that are found through entry
                points, which no import statement names.
            libraries: distributions whose versions count.
        """
        place = self._place()
        software = [source_digest(*modules), [_version(name) for name in libraries]]
        key = json.dumps([kind, software, given], sort_keys=True)
        return Entry(self, place / kind / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.entry", modules)

    def stored(self) -> list[Stored]:
        """All entries, those that were not used for longest first."""
        return sorted(self._files(_NAME), key=lambda one: one.used_at)

    def limit(self) -> int | None:
        """Largest size in bytes; None for a folder of somebody's choice. Nonsense in the variable counts as unset."""
        if self.folder is not None:
            return None
        try:
            return limit_bytes()
        except UsageError:  # ``cache info`` reports it; an inspection is not stopped by it
            return round(LIMIT_MB * 1e6)

    def trim(self, newest: Path) -> None:
        """Remove entries until the limit holds, those that were not used for longest first.

        Args:
            newest: an entry that stays: it has just been written.
        """
        limit = self.limit()
        if limit is None:
            return
        entries = self.stored()
        total = sum(one.size for one in entries)
        for one in entries:
            if total <= limit:
                break
            if one.path != newest and _removed(one.path):
                total -= one.size
        self._remove_leftovers()

    def clear(self) -> list[Stored]:
        """Remove all entries and nothing else; returns those that are gone."""
        found = [one for one in self.stored() if _removed(one.path)]
        self._remove_leftovers()
        _removed(self._place() / _MEMO)
        for folder in {one.path.parent for one in found}:
            with contextlib.suppress(OSError):  # not empty
                folder.rmdir()
        return found

    def _remove_leftovers(self) -> None:
        for one in self._files(_PARTIAL):
            if time.time() - one.used_at > _LEFTOVER_S:
                _removed(one.path)

    def _place(self) -> Path:
        return cache_folder() if self.folder is None else self.folder

    def _files(self, name: re.Pattern[str]) -> Iterator[Stored]:
        with contextlib.suppress(OSError):
            for path in self._place().glob("*/*.*"):
                with contextlib.suppress(OSError):  # another process has removed it
                    if name.fullmatch(path.name) and not path.is_symlink():
                        state = path.stat()
                        yield Stored(path.parent.name, path, state.st_size, state.st_mtime)


@cache
def _digests() -> SourceDigests:
    return SourceDigests(cache_folder() / _MEMO)


def source_digest(*modules: str) -> str:
    """Hash of the sources of modules and of all that they import; see `SourceDigests.of`."""
    return _digests().of(*modules)


def sources_loaded(*modules: str) -> bool:
    """Whether the sources on disk are those that this process has loaded; see `SourceDigests.loaded`."""
    return _digests().loaded(*modules)


@cache
def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""


def _removed(path: Path) -> bool:
    try:
        path.unlink()
    except OSError:
        return False
    return True
