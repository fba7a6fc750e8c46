"""JSON of the commands: results as they are, on standard output; what is not finite becomes null."""

import json
import sys
from dataclasses import fields, is_dataclass
from datetime import date
from enum import Enum
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def as_json(value: Any) -> Any:  # noqa: ANN401 - results of all commands
    """A result as JSON holds it: models and dataclasses by their fields, arrays as lists, NaN and infinity as null."""
    plain = _plain(value)
    if isinstance(plain, dict):
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


def fields_of(result: "DataclassInstance") -> dict[str, Any]:
    """The fields of a dataclass by name, as they are."""
    return {field.name: getattr(result, field.name) for field in fields(result)}


def print_json(value: Any) -> None:  # noqa: ANN401
    """Print a result as JSON; escaped, so that it reaches every terminal and pipe."""
    sys.stdout.write(json.dumps(as_json(value), indent=2, allow_nan=False) + "\n")
    sys.stdout.flush()


def print_json_line(value: Any) -> None:  # noqa: ANN401
    """Print a result as one line of JSON, as soon as it is known."""
    sys.stdout.write(json.dumps(as_json(value), allow_nan=False) + "\n")
    sys.stdout.flush()
