"""Plug-ins by name: entry points of installed packages, so that a third party's registers like a built-in one."""

import functools
import sys
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from typing import Protocol, TypeVar

from anisoscope.base.errors import AnisoscopeError


class Placed(Protocol):
    """Item of a registry: it has a name, and a place in lists."""

    @property
    def name(self) -> str:
        """Name of its entry point."""
        ...

    @property
    def place(self) -> int:
        """The same place is sorted by name."""
        ...


T = TypeVar("T", bound=Placed)


def installed(group: str) -> Mapping[str, EntryPoint]:
    """The plug-ins of a group by name."""
    return _installed(group, tuple(sys.path))


@functools.cache
def _selection(_path: tuple[str, ...]) -> Callable[..., EntryPoints]:
    """Looked up once for a search path: reading the metadata of all packages takes as long as opening a port."""
    return entry_points().select


@functools.cache
def _installed(group: str, path: tuple[str, ...]) -> Mapping[str, EntryPoint]:
    return {entry.name: entry for entry in sorted(_selection(path)(group=group))}


@functools.cache
def _rivals(group: str, name: str, path: tuple[str, ...]) -> tuple[str, ...]:
    """Packages that install different plug-ins under one name; empty where there is one plug-in."""
    found = _selection(path)(group=group, name=name)
    if len({entry.value for entry in found}) < 2:
        return ()
    return tuple(sorted({"an unnamed package" if entry.dist is None else entry.dist.name for entry in found}))


def load(group: str, name: str, what: str, error: type[AnisoscopeError]) -> object:
    """The plug-in of a name.

    Args:
        group: group of entry points.
        name: name in it.
        what: what the plug-ins are, for the message, such as "kind of part".
        error: what is raised.

    Raises:
        error: none or more than one is installed under this name, or it does not load; the message has one line.
    """
    found = installed(group)
    if name not in found:
        raise error(f"there is no {what} '{name}'; installed: {', '.join(found) or 'none'}")
    rivals = _rivals(group, name, tuple(sys.path))
    if rivals:
        raise error(f"several packages install a {what} '{name}': {', '.join(rivals)}: uninstall all but one")
    try:
        return found[name].load()
    except Exception as problem:
        reason = str(problem).splitlines()[0] if str(problem) else type(problem).__name__
        raise error(f"the {what} '{name}' does not load: {reason}") from problem


class Registry(MutableMapping[str, T]):
    """Objects of a class by name, each the plug-in of its name; a program may add its own for its own time.

    Args:
        group: group of entry points. It stands in the call itself: results in the cache follow the sources of its
            plug-ins by it (`anisoscope.base.cache`).
        what: what the objects are, for messages.
        kind: their class.
        error: what is raised where one does not load or is none.
    """

    def __init__(self, group: str, what: str, kind: type[T], error: type[AnisoscopeError]) -> None:
        self._group, self._what, self._kind, self._error = group, what, kind, error
        self._loaded: dict[tuple[str, ...], dict[str, T]] = {}
        self._added: dict[str, T] = {}

    def _installed(self) -> dict[str, T]:
        path = tuple(sys.path)
        if path not in self._loaded:
            self._loaded[path] = {name: self._load(name) for name in installed(self._group)}
        return self._loaded[path]

    def _load(self, name: str) -> T:
        found = load(self._group, name, self._what, self._error)
        if not isinstance(found, self._kind):
            raise self._error(
                f"the {self._what} '{name}' does not load: {found!r} is no object of {self._kind.__name__}"
            )
        if found.name != name:
            raise self._error(f"the {self._what} '{name}' does not load: it calls itself '{found.name}'")
        return found

    def _all(self) -> dict[str, T]:
        every = {**self._installed(), **self._added}
        return {name: every[name] for name in sorted(every, key=lambda name: (every[name].place, name))}

    def __getitem__(self, name: str) -> T:
        return self._all()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())

    def __setitem__(self, name: str, one: T) -> None:
        self._added[name] = one

    def __delitem__(self, name: str) -> None:
        del self._added[name]
