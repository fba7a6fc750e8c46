"""Results as JSON: models and dataclasses by their fields; arrays become lists, NaN and infinity null.

A field of a dataclass is a key of that name. What differs is declared where the field or property stands::

    @dataclass(frozen=True)
    class Series:
        values: FloatArray = field(metadata=LEFT_OUT)
        weight: float = field(metadata=json_field("lambda"))
        lamp: Lamp = field(metadata=json_field(by=attrgetter("name")))

        @property
        @in_json()
        def count(self) -> int: ...
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from datetime import date
from enum import Enum
from functools import cache
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_METADATA = "anisoscope.json"
_MARK = "_json_key"
_Getter = TypeVar("_Getter", bound=Callable[..., Any])


@dataclass(frozen=True)
class _Shown:
    """JSON of a field: key (None: name of the field), conversion, keys of the value among those of the result."""

    key: str | None = None
    by: Callable[[Any], Any] | None = None
    merged: bool = False
    only_given: bool = False


LEFT_OUT: Mapping[str, Any] = {_METADATA: None}
"""Metadata of a field that is not in JSON, such as a picture."""


def json_field(
    key: str | None = None,
    *,
    by: Callable[[Any], Any] | None = None,
    merged: bool = False,
    only_given: bool = False,
) -> Mapping[str, Any]:
    """Metadata of a field that is shown in another way.

    Args:
        key: in place of the field's name.
        by: makes what is shown of the value.
        merged: the keys of the value, a dataclass or mapping, stand among those of the result.
        only_given: no key where the value is None or an empty tuple or text.
    """
    return {_METADATA: _Shown(key, by, merged, only_given)}


def in_json(key: str | None = None, *, only_given: bool = False) -> Callable[[_Getter], _Getter]:
    """Mark the getter of a property as part of the JSON of its class; placed below ``@property``.

    Args:
        key: in place of the property's name.
        only_given: no key where the value is None or an empty tuple or text.
    """

    def mark(getter: _Getter) -> _Getter:
        setattr(getter, _MARK, (key or getter.__name__, only_given))
        return getter

    return mark


def fields_of(result: "DataclassInstance") -> dict[str, Any]:
    """The keys of a dataclass with their values as they are: fields, then marked properties."""
    found: dict[str, Any] = {}
    for one in fields(result):
        shown = one.metadata.get(_METADATA, _AS_IT_IS)
        if shown is None:
            continue
        value = getattr(result, one.name)
        if shown.only_given and _missing(value):
            continue
        if shown.by is not None:
            value = shown.by(value)
        if shown.merged:
            found |= fields_of(value) if is_dataclass(value) and not isinstance(value, type) else value
        else:
            found[shown.key or one.name] = value
    for name, (key, only_given) in _properties(type(result)).items():
        value = getattr(result, name)
        if not (only_given and _missing(value)):
            found[key] = value
    return found


def _missing(value: Any) -> bool:  # noqa: ANN401
    return value is None or (isinstance(value, tuple | str) and not value)


_AS_IT_IS = _Shown()


@cache
def _properties(kind: type) -> dict[str, tuple[str, bool]]:
    """Names of the marked properties of a class, those of its bases first, and their marks."""
    names = dict.fromkeys(name for base in reversed(kind.__mro__) for name in vars(base))
    getters = {name: getattr(getattr(kind, name, None), "fget", None) for name in names}
    return {name: getattr(getter, _MARK) for name, getter in getters.items() if hasattr(getter, _MARK)}


_PLAIN = frozenset({str, int, bool, type(None)})


def as_json(value: Any) -> Any:  # noqa: ANN401 - results of all commands
    """A result as JSON holds it: models and dataclasses by their fields, arrays as lists, NaN and infinity as null."""
    if type(value) in _PLAIN:  # most of what a long export writes
        return value
    plain = value if type(value) in {dict, float} else _plain(value)
    if isinstance(plain, Mapping):
        return {key: as_json(item) for key, item in plain.items()}
    if isinstance(plain, list | tuple):
        return [as_json(item) for item in plain]
    if isinstance(plain, float):
        return float(plain) if isfinite(plain) else None
    return plain


def _plain(value: Any) -> Any:  # noqa: ANN401
    """A value with its outermost layer as JSON holds it."""
    if hasattr(value, "model_dump"):  # of pydantic, without importing it
        return value.model_dump(mode="json", by_alias=True)
    if hasattr(value, "tolist"):  # arrays and numbers of numpy, likewise
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return fields_of(value)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, date):
        return value.isoformat()
    return str(value) if isinstance(value, Path) else value
