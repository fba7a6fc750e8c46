"""Digest of the source of a module and of everything that it imports, read from the import statements.

A cached result is as good as the code that computed it. Which code that is follows from the import statements, those
inside functions included; no list of modules is kept by hand. Modules of other distributions count by their version
(`anisoscope.base.cache`), not by their source. A source that was written after this process began to load code may be
another one than what is loaded: then no digest says which code computes (`SourceDigests.loaded`).
"""

import ast
import contextlib
import hashlib
import importlib.util
import json
import os
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

OWN = "anisoscope"
DATA_FOLDERS = ("data", "templates")
"""Folders beside a module whose files it may read: they count like its source."""
_FORMAT = 1
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
        waiting = list(modules)
        while waiting:
            name = waiting.pop()
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
            found.update(self._data_beside(name, file))
            base = name if file.name == "__init__.py" else parent
            waiting += [importlib.util.resolve_name(one, base) for one in self._source(file).imports]
        return found

    def _data_beside(self, name: str, file: Path) -> Iterator[tuple[str, Path]]:
        package = name if file.name == "__init__.py" else name.rpartition(".")[0]
        for folder in DATA_FOLDERS:
            if folder in self._listing(file.parent):
                for path in sorted((file.parent / folder).rglob("*")):
                    if path.is_file() and "__pycache__" not in path.parts:
                        yield f"{package}/{path.relative_to(file.parent).as_posix()}", path

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
            kept = json.loads(self.memo.read_text(encoding="utf-8"))
            if kept["format"] == _FORMAT:
                self._parsed = {
                    str(path): ([int(one) for one in state], _Source(str(digest), tuple(map(str, imports))))
                    for path, (state, digest, imports) in kept["files"].items()
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
    """What changes whenever a file is written or replaced; the time of change cannot be set by a copying program."""
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
    """Names in all import statements: ``from a import b`` gives ``a`` and ``a.b``, which may be a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (one.name for one in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            if node.module:
                yield base
            yield from (f"{base}.{one.name}" if node.module else base + one.name for one in node.names)
