"""Read a TOML file of ours into a model; every mistake becomes one line that names file, key and remedy."""

import difflib
import json
import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin
from urllib.parse import quote

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
)
from pydantic_core import ErrorDetails

from anisoscope.base.errors import ConfigError, RecipeError, RigFileError
from anisoscope.base.quantity import Likely, read_number, unit_of
from anisoscope.base.toml_table import read_toml

ModelT = TypeVar("ModelT", bound=BaseModel)
_FILES = {".csv", ".toml"}
_CHOICE = re.compile(r"constrained-\w+|function-\w+\[.*\]")
"""What pydantic adds to a key where one of several types is wanted."""
_PLACEHOLDER = re.compile(r"\$\{([^}]*)\}")
_TYPE_WORDS: dict[object, str] = {
    str: "a text",
    Path: "a path",
    float: "a number",
    int: "a whole number",
    bool: "true or false",
    tuple: "a list",
    list: "a list",
    dict: "a table",
}


def _relative_to_folder(value: Path, info: ValidationInfo) -> Path:
    folder = (info.context or {}).get("folder")
    return value if folder is None else Path(folder) / value


def _file_relative_to_folder(value: str, info: ValidationInfo) -> str:
    return str(_relative_to_folder(Path(value), info)) if Path(value).suffix.lower() in _FILES else value


Share = Annotated[float, Field(ge=0.0, le=1.0)]
Positive = Annotated[float, Field(gt=0.0)]


def _length(value: object, info: ValidationInfo, likely: Likely) -> object:
    if isinstance(value, str) or (isinstance(value, int | float) and not isinstance(value, bool)):
        name = info.field_name or ""
        return read_number(str(value), name, unit_of(name), likely)
    return value


def length(likely: Likely) -> BeforeValidator:
    """A length in the unit of its key, from a number or a text with a unit; errors as of `read_number`."""
    return BeforeValidator(partial(_length, likely=likely))


NotNegative = Annotated[float, Field(ge=0.0)]
LocalPath = Annotated[Path, AfterValidator(_relative_to_folder)]
"""A path; a relative one counts from the folder of the file in which it stands."""
NameOrFile = Annotated[str, Field(min_length=1), AfterValidator(_file_relative_to_folder)]
"""A name of something that comes with the package, or a path, which ends in .csv or .toml and counts as `LocalPath`."""


class Part(BaseModel):
    """A table of one of our files: frozen, finite numbers, no unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


def read_toml_model(
    path: Path,
    model: type[ModelT],
    *,
    error: type[ConfigError] = RigFileError,
    substitutions: Mapping[str, str] | None = None,
) -> ModelT:
    """Read a file into a pydantic model, strictly: texts are not converted to numbers.

    Args:
        path: the file, UTF-8.
        model: what it has to hold.
        error: raised for every mistake.
        substitutions: values for ``${name}`` in texts; percent-encoded where the text is a URL.

    Raises:
        ConfigError: as `error`; the file is missing, is no TOML, or does not hold what the model wants.
    """
    data = read_toml(path, error)
    if "camera" in model.model_fields and "sample" in data and "camera" not in data:
        raise error(
            f"{path}: this is the bench file of a virtual rig: `anisoscope rig sim bench {path} --pty --write-rig "
            "rig.toml` serves it, and writes the rig file"
        )
    _check_not_swapped(path, data, error)
    try:
        filled = _substitute(data, substitutions or {}, ())
        text = json.dumps(filled, default=str)
        return model.model_validate_json(text, strict=True, context={"folder": path.resolve().parent})
    except _UnknownPlaceholder as problem:
        raise error(f"{path}: {problem}") from None
    except ValidationError as problem:
        raise error(f"{path}: {one_line(problem, model)}") from problem


_MARKS = {RecipeError: {"product", "acquisition"}, RigFileError: {"stage", "camera"}}
"""Keys by which a file of each sort is recognised: the other sort has none of them."""
_SORTS = {RecipeError: "recipe", RigFileError: "rig file"}


def _check_not_swapped(path: Path, data: Mapping[str, Any], error: type[ConfigError]) -> None:
    for other, marks in _MARKS.items():
        if (
            error in _MARKS
            and other is not error
            and marks <= data.keys()
            and not _MARKS[error] & data.keys()
        ):
            raise error(
                f"{path}: this is a {_SORTS[other]}, and a {_SORTS[error]} is needed here: are the two swapped?"
            )


def one_line(problem: ValidationError, model: type[BaseModel]) -> str:
    """Return the first mistake of a validation as ``key: what is wrong; what is expected``."""
    mistakes = problem.errors(include_url=False)
    # A misspelt key shows twice, as unknown and as missing: the first says more.
    mistakes.sort(key=lambda mistake: mistake["type"] != "extra_forbidden")
    others = len({_key(mistake["loc"]) for mistake in mistakes}) - 1
    more = f" (and {others} more)" if others else ""
    return _describe(mistakes[0], model) + more


class _UnknownPlaceholder(Exception):
    pass


def _substitute(value: object, known: Mapping[str, str], key: tuple[str | int, ...]) -> object:
    if isinstance(value, dict):
        return {name: _substitute(item, known, (*key, name)) for name, item in value.items()}
    if isinstance(value, list):
        return [_substitute(item, known, (*key, number)) for number, item in enumerate(value)]
    if not isinstance(value, str):
        return value

    def fill(match: re.Match[str]) -> str:
        name = match.group(1)
        if name not in known:
            names = ", ".join(f"${{{other}}}" for other in known) or "none"
            raise _UnknownPlaceholder(f"{_key(key)}: unknown placeholder ${{{name}}}; known: {names}")
        return quote(known[name], safe="/:\\ ") if "://" in value else known[name]

    return _PLACEHOLDER.sub(fill, value)


def _describe(mistake: ErrorDetails, model: type[BaseModel]) -> str:
    location = mistake["loc"]
    key = _key(location)
    if mistake["type"] == "extra_forbidden":
        return f"{key}: unknown key{_suggestion(str(location[-1]), _fields(model, location[:-1]))}"
    if mistake["type"] == "missing":
        expected = _fields(model, location[:-1]).get(str(location[-1]))
        return f"{key}: missing; expected {_words(expected)}"
    text = mistake["msg"].removeprefix("Value error, ")
    if mistake["type"] == "value_error" or not key:
        return f"{key}: {text}" if key else text
    shown = json.dumps(mistake["input"], ensure_ascii=False, default=str)
    return f"{key}: {text[:1].lower()}{text[1:]}, not {shown if len(shown) <= 40 else shown[:37] + '…'}"


def _key(location: tuple[str | int, ...]) -> str:
    text = ""
    for part in location:
        if isinstance(part, int):
            text += f"[{part}]"
        elif not _CHOICE.fullmatch(part):
            text += f".{part}"
    return text.removeprefix(".")


def _suggestion(name: str, fields: Mapping[str, object]) -> str:
    stem = name.rsplit("_", maxsplit=1)[0]
    same_stem = [other for other in fields if other.rsplit("_", maxsplit=1)[0] == stem]
    close = same_stem or difflib.get_close_matches(name, fields, n=1, cutoff=0.5)
    if close:
        return f"; did you mean '{close[0]}'?"
    return f"; known here: {', '.join(sorted(fields))}" if fields else ""


def _fields(model: type[BaseModel], location: tuple[str | int, ...]) -> dict[str, object]:
    """Keys (as written in the file) and types of the table at a location."""
    here: object = model
    for part in location:
        if isinstance(part, str):
            here = _table(here)
            here = _own_fields(here).get(part)
    return _own_fields(_table(here))


def _own_fields(table: object) -> dict[str, object]:
    if not (isinstance(table, type) and issubclass(table, BaseModel)):
        return {}
    return {field.alias or name: field.annotation for name, field in table.model_fields.items()}


def _table(annotation: object) -> object:
    """The model inside ``Model | None``, ``tuple[Model, ...]`` and the like."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in get_args(annotation):
        found = _table(inner)
        if found is not None:
            return found
    return None


def _words(annotation: object) -> str:
    origin = get_origin(annotation)
    if origin in {Union, UnionType, Annotated}:
        return " or ".join(_words(inner) for inner in get_args(annotation) if isinstance(inner, type))
    if _table(annotation) is annotation and annotation is not None:
        return "a table"
    if origin is not None and (word := _TYPE_WORDS.get(origin)):
        return word
    choices = [repr(choice) for choice in get_args(annotation)]
    return _TYPE_WORDS.get(annotation) or (" or ".join(choices) if choices else "a value")
