"""Rendering of pages: templates that extend ``page.html``, strict about undefined names."""

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from anisoscope.base.atomic_write import write_text

if TYPE_CHECKING:
    import jinja2

Filters = Mapping[str, Callable[..., str]]


def write_page(path: Path, template: str, content: Mapping[str, Any], filters: Filters | None = None) -> None:
    """Write a self-contained page, atomically.

    Args:
        path: file to write.
        template: name of a template of this package.
        content: what the template shows; a name that it misses is an error.
        filters: functions that the template calls by name.

    Raises:
        RecordError: the file cannot be written.
    """
    write_text(path, ready_template(template, filters).render(**content))


def ready_template(template: str, filters: Filters | None = None) -> "jinja2.Template":
    """A template, translated once a process; arguments as for `write_page`."""
    environment = _environment(template)
    environment.filters.update(filters or {})
    return environment.get_template(template)


@cache
def _environment(_template: str) -> "jinja2.Environment":
    """An environment of its own for every template, because each brings filters of its own."""
    import jinja2

    return jinja2.Environment(
        loader=jinja2.PackageLoader("anisoscope.report"), autoescape=True, undefined=jinja2.StrictUndefined
    )
