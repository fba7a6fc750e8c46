"""Plug-ins by name: entry points of installed packages, so that a third party's registers like a built-in one."""

import functools
import sys
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points

from anisoscope.base.errors import AnisoscopeError


def installed(group: str) -> Mapping[str, EntryPoint]:
    """The plug-ins of a group by name."""
    return _installed(group, tuple(sys.path))


@functools.cache
def _installed(group: str, _path: tuple[str, ...]) -> Mapping[str, EntryPoint]:
    """Looked up once for a search path: reading the metadata of all packages takes as long as opening a port."""
    return {entry.name: entry for entry in sorted(entry_points(group=group))}


def load(group: str, name: str, what: str, error: type[AnisoscopeError]) -> object:
    """The plug-in of a name.

    Args:
        group: group of entry points.
        name: name in it.
        what: what the plug-ins are, for the message, such as "kind of part".
        error: what is raised.

    Raises:
        error: none is installed under this name, or it does not load; the message has one line.
    """
    found = installed(group)
    if name not in found:
        raise error(f"there is no {what} '{name}'; installed: {', '.join(found) or 'none'}")
    try:
        return found[name].load()
    except Exception as problem:
        reason = str(problem).splitlines()[0] if str(problem) else type(problem).__name__
        raise error(f"the {what} '{name}' does not load: {reason}") from problem
