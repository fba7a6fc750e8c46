"""``anisoscope cache``: results on disk that can be computed again."""

import time
from collections.abc import Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

from cyclopts import App

from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.tables import print_lines, print_table

if TYPE_CHECKING:
    from anisoscope.base.cache import Stored

app = App(name="cache", help="Show or clear the cache of results that can be computed again.")


@app.command
def info(*, json_: Json = False) -> int:
    """Show folder, size, limit and content of the cache.

    Examples:
        anisoscope cache info
    """
    from anisoscope.base.cache import LIMIT_VARIABLE, VARIABLE, Cache, cache_folder, limit_bytes

    limit, entries, folder = limit_bytes(), Cache().stored(), cache_folder()
    size = sum(one.size for one in entries)
    if json_:
        kinds = [{"kind": kind, **_numbers(rows)} for kind, rows in _by_kind(entries)]
        return print_json({"folder": str(folder), "limit_bytes": limit, **_numbers(entries), "kinds": kinds})
    print_lines(f"{folder}: {len(entries)} entries, {_megabytes(size)} of {_megabytes(limit)}")
    if folder.exists() and not folder.is_dir():
        print_lines(f"{folder} is not a folder: nothing is cached")
    if entries:
        rows = [[kind, *_cells(rows)] for kind, rows in _by_kind(entries)]
        print_table("cached results", ["kind", "entries", "size", "last used", "longest unused"], rows)
    print_lines(f"another folder: {VARIABLE}; another limit: {LIMIT_VARIABLE}")
    return 0


@app.command
def clear(*, json_: Json = False) -> int:
    """Remove all results in the cache; they are computed again when needed.

    Examples:
        anisoscope cache clear
    """
    from anisoscope.base.cache import Cache, cache_folder

    folder, gone = cache_folder(), Cache().clear()
    left = len(Cache().stored())
    if json_:
        kinds = [{"kind": kind, **_numbers(rows)} for kind, rows in _by_kind(gone)]
        return print_json({"folder": str(folder), "removed": _numbers(gone), "kinds": kinds, "left": left})
    for kind, rows in _by_kind(gone):
        print_lines(f"removed {len(rows)} {kind}, {_megabytes(sum(one.size for one in rows))}")
    size = _megabytes(sum(one.size for one in gone))
    print_lines(
        f"{folder}: {len(gone)} entries removed, {size}" + (f"; {left} could not be removed" if left else "")
    )
    return 0


def _by_kind(entries: "Sequence[Stored]") -> "list[tuple[str, list[Stored]]]":
    ordered = sorted(entries, key=lambda one: one.kind)
    return [(kind, list(rows)) for kind, rows in groupby(ordered, key=lambda one: one.kind)]


def _numbers(entries: "Sequence[Stored]") -> dict[str, Any]:
    """Count, size, and seconds since the entry used last and the one unused for longest were used."""
    ages = _ages(entries)
    return {
        "entries": len(entries),
        "bytes": sum(one.size for one in entries),
        "last_used_s": min(ages, default=None),
        "longest_unused_s": max(ages, default=None),
    }


def _cells(entries: "Sequence[Stored]") -> list[str]:
    ages = _ages(entries)
    size = _megabytes(sum(one.size for one in entries))
    return [str(len(entries)), size, _age(min(ages)), _age(max(ages))]


def _ages(entries: "Sequence[Stored]") -> list[float]:
    now = time.time()
    return [round(max(0.0, now - one.used_at), 1) for one in entries]


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.1f} MB"


def _age(seconds: float) -> str:
    for unit, length in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} s"
