"""One way to make a page: templates that extend ``page.html``, strict about what they are given."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from anisoscope.atomicfile import write_text

Filters = Mapping[str, Callable[..., str]]


def write_page(path: Path, template: str, content: Mapping[str, Any], filters: Filters | None = None) -> None:
    """Write a self-contained page, all or nothing.

    Args:
        path: file to write.
        template: name of a template of this package.
        content: what the template shows; a name that it misses is an error.
        filters: functions that the template calls by name.

    Raises:
        RecordError: the file cannot be written.
    """
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("anisoscope.report"), autoescape=True, undefined=jinja2.StrictUndefined
    )
    environment.filters.update(filters or {})
    write_text(path, environment.get_template(template).render(**content))
