"""Plug-ins by name: entry points of installed packages, so that a third party's registers like a built-in one."""

import functools
import sys
from collections.abc import Callable, Mapping
from importlib.metadata import EntryPoint, EntryPoints, entry_points

from anisoscope.base.errors import AnisoscopeError


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
