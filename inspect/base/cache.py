"""Cache of results on disk, keyed by what they are computed from and by the code that computes them.

The folder is ``$ANISOSCOPE_CACHE``, or the user's cache folder; all in it may be deleted at any time. An entry is a
file in a folder of its kind, named by the hash of its key: the values that the caller gives (a recipe, the geometry of
a rig, hashes of files), the sources of the computing module and of its transitive imports (`SourceDigests`), and the
versions of the libraries that compute. A file that was cut off, altered or written by another program is not an entry:
its result is computed again. Where nothing can be written, nothing is cached.

The transitive imports follow from the import statements, those inside functions included, and from the entry points
of a group where a module makes a `Registry` of it; there is no list of modules. Modules of other distributions count by
their version, not by their source, but for plug-ins. A source newer than the process may differ
from the loaded code: then no digest identifies the code that computes (`SourceDigests.loaded`), and nothing is cached.

Above the limit (``$ANISOSCOPE_CACHE_LIMIT_MB``, 512 MB) the least recently used entries are removed. Any number of
processes may share the folder: entries are written atomically, under names that identify their content.
"""

import ast
import contextlib
import hashlib
import importlib.util
import json
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TypeVar

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.base.plugins import Registry, installed

OWN = "anisoscope"
DATA_FOLDERS = ("data", "templates")
"""Data folders next to a module: their files count like its source."""
_FORMAT = 2
_PLUGINS = "@"
"""Before the name of a group of entry points, among the imports of a module."""
_BLOCKS = ("body", "handlers", "orelse", "finalbody", "cases")
"""Where nodes of a syntax tree hold statements."""
_LOADED_AT = time.time()
"""When this process began to load code that is cached: modules that cache import this one before they compute."""


@dataclass(frozen=True)
class _Source:
    """One file: digest of its content, and the names of all that it imports (modules, or objects in them)."""

    digest: str
    imports: tuple[str, ...] = ()


@dataclass
class SourceDigests:
    """Digests of sources in this process; parsed files are remembered by their state in the file system.

    Args:
        memo: file in which another process finds what this one parsed; without it every process parses all files.
    """

    memo: Path | None = None
    _digests: dict[tuple[str, ...], tuple[str, tuple[Path, ...]]] = field(default_factory=dict)
    _listings: dict[Path, frozenset[str]] = field(default_factory=dict)
    _packages: dict[str, tuple[Path, ...]] = field(default_factory=dict)
    _parsed: dict[str, tuple[list[int], _Source]] = field(default_factory=dict)
    _changed: bool = False
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def of(self, *modules: str) -> str:
        """Hash of the sources of modules and of their transitive imports within their own top-level packages.

        It is computed once a process: code that is loaded does not change with its file.

        Raises:
            LookupError: one of the modules has no source file.
        """
        with self._lock:
            if modules not in self._digests:
                self._read_memo()
                files = self._files(modules)
                if missing := set(modules) - set(files):
                    raise LookupError(f"no source file of {', '.join(sorted(missing))}")
                digest = hashlib.sha256()
                for name in sorted(files):
                    digest.update(f"{name}\0{self._source(files[name]).digest}\n".encode())
                self._digests[modules] = digest.hexdigest(), tuple(files.values())
            return self._digests[modules][0]

    def loaded(self, *modules: str) -> bool:
        """Whether all these sources are older than what this process has loaded, so that the digest is of that code.

        Raises:
            LookupError: one of the modules has no source file.
        """
        self.of(*modules)
        files = self._digests[modules][1]
        try:
            return all(max(state.st_mtime, state.st_ctime) <= _LOADED_AT for state in map(os.stat, files))
        except OSError:  # removed since
            return False

    def modules(self, *modules: str) -> tuple[str, ...]:
        """Names of the modules, and of the data files, that the digest is computed from."""
        with self._lock:
            return tuple(sorted(self._files(modules)))

    def _files(self, modules: Iterable[str]) -> dict[str, Path]:
        followed = {OWN, *(name.partition(".")[0] for name in modules)}
        found: dict[str, Path] = {}
        seen: set[str] = set()
        searched: set[tuple[str, Path]] = set()
        waiting = list(modules)
        while waiting:
            name = waiting.pop()
            if name.startswith(_PLUGINS):
                plugins = [entry.module for entry in installed(name.removeprefix(_PLUGINS)).values()]
                followed |= {module.partition(".")[0] for module in plugins}
                waiting += plugins
                continue
            if name in seen or name.partition(".")[0] not in followed:
                continue
            seen.add(name)
            parent = name.rpartition(".")[0]
            if parent:
                waiting.append(parent)  # an import runs the packages around a module, too
            file = self._file_of(name)
            if file is None:  # an object in a module, or a package without __init__.py
                continue
            found[name] = file
            base = name if file.name == "__init__.py" else parent
            if (base, file.parent) not in searched:  # by a module beside this one
                searched.add((base, file.parent))
                found.update(self._data_files(base, file.parent))
            waiting += [importlib.util.resolve_name(one, base) for one in self._source(file).imports]
        return found

    def _data_files(self, package: str, place: Path) -> Iterator[tuple[str, Path]]:
        for folder in DATA_FOLDERS:
            if folder in self._listing(place):
                for path in sorted((place / folder).rglob("*")):
                    if path.is_file() and "__pycache__" not in path.parts:
                        yield f"{package}/{path.relative_to(place).as_posix()}", path

    def _file_of(self, name: str) -> Path | None:
        parent, _, leaf = name.rpartition(".")
        for folder in self._folders_of(parent) if parent else ():
            listing = self._listing(folder)
            if f"{leaf}.py" in listing:
                return folder / f"{leaf}.py"
        for folder in self._folders_of(name):
            if "__init__.py" in self._listing(folder):
                return folder / "__init__.py"
        loaded = sys.modules.get(name) if not parent else None  # a single file, or a program that is run
        origin = getattr(loaded, "__file__", None)
        return Path(origin) if isinstance(origin, str) and origin.endswith(".py") else None

    def _folders_of(self, package: str) -> tuple[Path, ...]:
        """Folders of a package; none of what is no package."""
        if package not in self._packages:
            parent, _, leaf = package.rpartition(".")
            if "." in parent:  # the installation may map the first two levels to any folder
                folders = tuple(
                    folder / leaf for folder in self._folders_of(parent) if leaf in self._listing(folder)
                )
                self._packages[package] = tuple(folder for folder in folders if folder.is_dir())
            else:
                self._packages[package] = _search_locations(package)
        return self._packages[package]

    def _listing(self, folder: Path) -> frozenset[str]:
        if folder not in self._listings:
            try:
                self._listings[folder] = frozenset(one.name for one in os.scandir(folder))
            except OSError:
                self._listings[folder] = frozenset()
        return self._listings[folder]

    def _source(self, file: Path) -> _Source:
        state = _state(file)
        known = self._parsed.get(str(file))
        if known is None or known[0] != state:
            known = self._parsed[str(file)] = (state, _parse(file))
            self._changed = True
        return known[1]

    def _read_memo(self) -> None:
        if self.memo is None or self._parsed:
            return
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
            memo = json.loads(self.memo.read_text(encoding="utf-8"))
            if memo["format"] == _FORMAT:
                self._parsed = {
                    str(path): ([int(one) for one in state], _Source(str(digest), tuple(map(str, imports))))
                    for path, (state, digest, imports) in memo["files"].items()
                }

    def save(self) -> None:
        """Write the memo if files were parsed; where that is impossible, the next process parses them again."""
        with self._lock:
            if self.memo is None or not self._changed:
                return
            self._changed = False
            self._write(self.memo)

    def _write(self, memo: Path) -> None:
        files = {
            path: (state, one.digest, one.imports)
            for path, (state, one) in self._parsed.items()
            if Path(path).is_file()  # of another installation, which may be gone
        }
        partial = memo.with_name(f".{memo.name}.{os.getpid()}.partial")
        with contextlib.suppress(OSError):
            try:
                memo.parent.mkdir(parents=True, exist_ok=True)
                partial.write_text(json.dumps({"format": _FORMAT, "files": files}), encoding="utf-8")
                partial.replace(memo)
            finally:
                partial.unlink(missing_ok=True)


def _search_locations(package: str) -> tuple[Path, ...]:
    try:
        spec = importlib.util.find_spec(package)
    except (ImportError, ValueError):  # of a parent that is no package; of a program that is run
        return ()
    return tuple(Path(one) for one in (spec and spec.submodule_search_locations) or ())


def _state(file: Path) -> list[int]:
    """State that changes whenever a file is written or replaced; a copying program cannot set the time of change."""
    found = file.stat()
    return [found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino]


def _parse(file: Path) -> _Source:
    content = file.read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    if file.suffix != ".py":
        return _Source(digest)
    try:
        tree = ast.parse(content)
    except SyntaxError:  # a program that is not Python's, or that cannot be imported anyway
        return _Source(digest)
    return _Source(digest, tuple(sorted(set(_imports(tree)))))


def _imports(tree: ast.AST) -> Iterator[str]:
    """Names in all import statements: ``from a import b`` gives ``a`` and ``a.b``, which may be a module.

    A group of entry points of which a registry is made is among them, marked.
    """
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            yield from (one.name for one in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            if node.module:
                yield base
            yield from (f"{base}.{one.name}" if node.module else base + one.name for one in node.names)
        elif isinstance(node, ast.Assign) and isinstance(node.value, ast.Call):
            called = node.value
            if isinstance(called.func, ast.Name) and called.func.id == Registry.__name__:
                group = called.args[0]
                if isinstance(group, ast.Constant) and isinstance(group.value, str):
                    yield _PLUGINS + group.value
        for block in _BLOCKS:  # statements stand in blocks of statements: no expression is looked through
            waiting += getattr(node, block, ())


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
        """The stored content; None without an entry, or if it is not the content that was written."""
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
        """Largest size in bytes; None for a folder chosen by the user. An invalid variable counts as unset."""
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


def read_sources(*modules: str) -> None:
    """Remember the digests of all sources that modules import, so that no later process has to parse them."""
    _digests().of(*modules)
    _digests().save()


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
