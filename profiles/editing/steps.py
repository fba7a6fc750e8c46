"""Steps of editing: an operation with its values, as text, in Python, and in the history of a map."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.profiles.editing.operations import OPERATIONS, Operation, Read, Value
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.heightmap import HeightMap

ITEM = re.compile(r'\s*(?:([a-z_][a-z_0-9]*):)?(?:"([^"]*)"|([^,]*))\s*(?:,|$)')


@dataclass(frozen=True)
class Step:
    """One step: an operation and its values.

    Attributes:
        operation: what is done.
        values: all its values by name, defaults included.
    """

    operation: Operation
    values: Mapping[str, Value]

    @classmethod
    def of(cls, name: str, **given: object) -> Self:
        """A step by the name of its operation.

        Raises:
            UsageError: no such operation, or values that it does not take.
        """
        operation = OPERATIONS.get(name)
        if operation is None:
            raise UsageError(f"there is no step {name!r}; there are {', '.join(OPERATIONS)}")
        return cls(operation, operation.checked(given))

    @classmethod
    def parse(cls, text: str) -> Self:
        """A step from a text such as ``level``, ``form=poly2`` or ``filter=gaussian,25,keep:short``.

        After ``=`` stand values, separated by commas, in the order of the operation's parameters or with their name and
        a colon; a value that holds a comma stands between double quotes.

        Raises:
            UsageError: no such operation, or values that it does not take.
        """
        name, sign, rest = text.partition("=")
        name = name.strip()
        if name not in OPERATIONS:
            raise UsageError(f"there is no step {name!r}; there are {', '.join(OPERATIONS)}")
        names = [one.name for one in OPERATIONS[name].parameters]
        given: dict[str, object] = {}
        for place, (key, value) in enumerate(_items(rest) if sign else ()):
            if not key and place >= len(names):
                raise UsageError(f"{text}: {name} takes at most {len(names)} values: {', '.join(names)}")
            chosen = key or names[place]
            if chosen in given:
                raise UsageError(f"{text}: {chosen} is given twice")
            given[chosen] = value
        return cls.of(name, **given)

    def apply(self, surface: HeightMap, read: Read = read_height_map) -> HeightMap:
        """The edited map; the step, what it found, and size and missing share after it are added to its history.

        Args:
            surface: the map; it is not changed.
            read: reads the files of further maps.

        Raises:
            HeightMapError: the map cannot be edited in this way.
            UsageError: values that do not go together.
        """
        edited, found = self.operation.run(surface, self.values, read)
        if not np.isfinite(edited.height_um).any():
            measured = int(np.count_nonzero(np.isfinite(surface.height_um)))
            raise HeightMapError(
                f"{self.operation.name}: no measured point is left of {measured}; take values that keep some"
            )
        entry: dict[str, Any] = {"step": self.operation.name, "values": self._plain()}
        if found:
            entry["found"] = found
        entry |= _state(edited)
        history = [*_history(surface), entry]
        origin = {**surface.origin, "history": history}
        noted = {"pixel_um": entry["pixel_um"], "missing_share": entry["missing_share"]}
        origin |= {key: value for key, value in noted.items() if key in origin}
        return replace(edited, origin=origin)

    def _plain(self) -> dict[str, Any]:
        """The values as JSON holds them; those without a value left out."""
        found: dict[str, Any] = {}
        for name, value in self.values.items():
            if isinstance(value, HeightMap):
                found[name] = str(value.origin.get("file", "a map in memory"))
            elif value is not None:
                found[name] = value
        return found


def _items(text: str) -> Iterable[tuple[str, str]]:
    """Names ("" where there is none) and values of a text, at least one."""
    at = 0
    while True:
        found = ITEM.match(text, at)
        if found is None:
            raise UsageError(f"a step is NAME=VALUE,NAME:VALUE,…, not {text!r}")
        key, quoted, plain = found.groups()
        yield key or "", (quoted if quoted is not None else plain.strip())
        if not found.group(0).endswith(","):
            return
        at = found.end()


def _state(surface: HeightMap) -> dict[str, Any]:
    return {
        "points": list(surface.shape),
        "pixel_um": [surface.pixel_y_um, surface.pixel_x_um],
        "missing_share": surface.missing_share,
    }


def _history(surface: HeightMap) -> list[dict[str, Any]]:
    """Steps so far; a map that comes from a file begins with it."""
    history = list(surface.origin.get("history", []))
    if not history and "file" in surface.origin:
        source = {
            key: surface.origin[key]
            for key in ("file", "sha256", "role", "corrected")
            if key in surface.origin
        }
        history.append({"step": "read", "values": source, **_state(surface)})
    return history


def edit_map(
    surface: HeightMap,
    steps: Iterable[str | Step | Mapping[str, Any]],
    *,
    read: Read = read_height_map,
) -> HeightMap:
    """Edit a map step by step, as ``anisoscope profile edit`` does.

    Args:
        surface: the map, (rows, cols) in µm; it is not changed.
        steps: texts such as ``"form=poly2"``, mappings such as ``{"step": "crop", "x0": 50.0}``, or steps.
            Lengths are µm, angles degrees.
        read: reads the files of further maps.

    Returns:
        The edited map; ``origin["history"]`` lists every step with its values and what it found.

    Raises:
        UsageError: no map, no such step, or values that it does not take.
        HeightMapError: the map cannot be edited in this way.
    """
    if not isinstance(surface, HeightMap):
        raise UsageError(f"edit_map takes a HeightMap, not {type(surface).__name__}")
    if isinstance(steps, str | Mapping):
        raise UsageError("edit_map takes a list of steps, such as ['level', 'filter=gaussian,25']")
    for step in [_step(one) for one in steps]:
        surface = step.apply(surface, read)
    return surface


def _step(given: str | Step | Mapping[str, Any]) -> Step:
    if isinstance(given, Step):
        return given
    if isinstance(given, str):
        return Step.parse(given)
    values = {str(key): value for key, value in given.items()}
    return Step.of(str(values.pop("step", "")), **values)


def described(entry: Mapping[str, Any]) -> str:
    """An entry of a history on one line."""
    parts = [
        f"{key} {_short(value)}"
        for key, value in {**entry.get("values", {}), **entry.get("found", {})}.items()
    ]
    rows, cols = entry.get("points", (0, 0))
    share = float(entry.get("missing_share", 0.0))
    return f"{entry.get('step')}: {', '.join(parts) or '–'}; {rows} × {cols} points, {100.0 * share:.3g} % missing"


def _short(value: object) -> str:
    if isinstance(value, float | np.floating):
        return f"{float(value):.6g}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_short(one) for one in value) + "]"
    return str(value)[:80]
