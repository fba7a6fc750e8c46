"""Rendering of pages: templates that extend ``page.html``, strict about undefined names."""

import base64
import hashlib
import json
from collections.abc import Callable, Mapping
from functools import cache, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.atomic_write import write_text
from anisoscope.base.language import decimal, language, message, shown, translated

if TYPE_CHECKING:
    import jinja2

Filters = Mapping[str, Callable[..., str]]


def write_page(
    path: Path,
    template: str,
    content: Mapping[str, Any],
    filters: Filters | None = None,
    parts: Mapping[str, str] | None = None,
) -> None:
    """Write a self-contained page, atomically.

    Args:
        path: file to write.
        template: as the others, as for `page_text`.
        content: what the template shows.
        filters: functions that it calls.
        parts: sources of templates that it includes.

    Raises:
        RecordError: the file cannot be written.
    """
    write_text(path, page_text(template, content, filters, parts))


def page_text(
    template: str,
    content: Mapping[str, Any],
    filters: Filters | None = None,
    parts: Mapping[str, str] | None = None,
) -> str:
    """A self-contained page.

    Args:
        template: name of a template of this package.
        content: what the template shows; a name that it misses is an error.
        filters: functions that the template calls by name.
        parts: sources of templates that the template includes by these names.
    """
    ready = ready_template(template, filters)
    included = {name: _part(template, source) for name, source in (parts or {}).items()}
    return ready.render(**content, **included)


def template_text(template: str) -> str:
    """The source of a template of this package."""
    return (files("anisoscope.report") / "templates" / template).read_text(encoding="utf-8")


def ready_template(template: str, filters: Filters | None = None) -> "jinja2.Template":
    """A template, translated once a process; arguments as for `write_page`."""
    environment = _environment(template)
    environment.filters.update(filters or {})
    return environment.get_template(template)


def scripted(data: Mapping[str, Any], *scripts: str) -> dict[str, Any]:
    """Values of a template with a script: ``data`` as JSON, ``script``, and its ``script_hash`` for the policy.

    Args:
        data: finite numbers, texts, and lists and tables of them.
        scripts: names of scripts of this package, which become one.
    """
    from markupsafe import Markup

    text = json.dumps(data, allow_nan=False)
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    source = "\n".join(map(template_text, scripts))
    return {
        "data": Markup(text),  # noqa: S704 - no character of it can end the element
        "script": Markup(source),  # noqa: S704 - a file of this package
        "script_hash": "sha256-" + base64.b64encode(hashlib.sha256(source.encode()).digest()).decode(),
    }


def packed(numbers: npt.NDArray[np.generic]) -> str:
    """Little-endian bytes in base64."""
    little = numbers.astype(numbers.dtype.newbyteorder("<"))
    return base64.b64encode(np.ascontiguousarray(little).tobytes()).decode()


@cache
def _environment(_template: str) -> "jinja2.Environment":
    """Environment of one template, because each brings its filters."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("anisoscope.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=shown,
    )
    environment.globals.update(_=message, said=translated, decimal=decimal, language=language)
    return environment


@lru_cache(maxsize=64)
def _part(template: str, source: str) -> "jinja2.Template":
    """A part that a template includes, translated once a process; filters are looked up when it is shown."""
    return _environment(template).from_string(source)


def css_string(text: str) -> str:
    """A string of a style sheet, in quotation marks; other characters than letters and digits are escaped."""
    return '"' + "".join(c if c.isalnum() or c in " -._" else f"\\{ord(c):06x}" for c in text) + '"'
