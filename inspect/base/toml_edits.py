"""Edits of a TOML file: some values are changed, comments, line ends and everything else stay."""

import re
import tomllib
from collections.abc import Mapping
from typing import Any

from anisoscope.base.errors import ConfigError, RecipeError


def with_values(
    text: str,
    changes: Mapping[tuple[str, ...], Any],
    error: type[ConfigError] = RecipeError,
    what: str = "recipe",
    remarks: Mapping[tuple[str, ...], str] | None = None,
) -> str:
    """The text with some values changed; comments and everything else are preserved.

    Args:
        text: of a recipe or another file.
        changes: new values by (key,) at the top, (table, key), or (table, table in it, key).
        error: what is raised.
        what: word for the file in its message.
        remarks: comments of changed values, in place of those that stand behind them.

    Raises:
        ConfigError: the layout of the file does not allow the change.
    """
    end = "\r\n" if "\r\n" in text else "\n"
    expected = tomllib.loads(text)
    for place, value in changes.items():
        table = expected
        for name in place[:-1]:
            table = table.setdefault(name, {})
        table[place[-1]] = value
        text = _changed(text, place, value, end, (remarks or {}).get(place, ""))
    try:
        found = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        found = {}
    if found != expected:
        keys = ", ".join(".".join(place) for place in changes)
        raise error(
            f"{keys} cannot be changed in this {what}: write each on a line of its own, in its [table]"
        )
    return text


def _changed(text: str, place: tuple[str, ...], value: object, end: str, remark: str) -> str:
    lines = text.splitlines()
    own = f"  # {remark}" if remark else ""
    start, stop = 0, len(lines)
    headers = [k for k, line in enumerate(lines) if re.match(r"\s*\[", line)]
    if len(place) == 1:
        stop = headers[0] if headers else stop
    else:
        name = r"\s*\.\s*".join(map(re.escape, place[:-1]))
        named = [k for k in headers if re.match(rf"\s*\[\s*{name}\s*\]", lines[k])]
        if not named:
            return end.join(
                [*lines, "", f"[{'.'.join(place[:-1])}]", f"{place[-1]} = {toml_literal(value)}{own}", ""]
            )
        start = named[0] + 1
        stop = next((k for k in headers if k >= start), stop)
    key = re.compile(rf"(\s*{re.escape(place[-1])}\s*=\s*)([^#]*?)(\s*#.*)?$")
    for k in range(start, stop):
        match = key.match(lines[k])
        if match:
            lines[k : _end(lines, k)] = [f"{match[1]}{toml_literal(value)}{own or match[3] or ''}"]
            return end.join([*lines, ""])
    lines.insert(start, f"{place[-1]} = {toml_literal(value)}{own}")
    return end.join([*lines, ""])


def _end(lines: list[str], first: int) -> int:
    """First line after a value, which may be an array over several lines."""
    depth = 0
    for k in range(first, len(lines)):
        code = lines[k].partition("#")[0]
        depth += code.count("[") - code.count("]")
        if depth <= 0:
            return k + 1
    return first + 1


def toml_literal(value: object) -> str:
    """A value in TOML syntax."""
    import tomli_w  # noqa: PLC0415 - start-up time

    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_literal(item) for item in value) + "]"
    return tomli_w.dumps({"x": value}).removeprefix("x = ").strip()
