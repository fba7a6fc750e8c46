"""Rendering of pages: templates that extend ``page.html``, strict about undefined names.

Jinja translates a template into Python, which takes longer than most pages take to fill: the translation is kept in the
cache of results.
"""

import base64
import contextlib
import hashlib
import json
import os
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.atomic_write import write_text
from anisoscope.base.cache import Cache, Entry
from anisoscope.base.language import decimal, language, message, shown, translated

if TYPE_CHECKING:
    import jinja2

Filters = Mapping[str, Callable[..., str]]
_parts: dict[str, str] = {}


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


def template_environment(package: str, **functions: Any) -> "jinja2.Environment":  # noqa: ANN401 - names of templates
    """Templates of a package, and parts that pages brought, strict about undefined names; what they show is escaped.

    Args:
        package: has a folder ``templates``.
        functions: that templates call; of the filters only those of Jinja may stand at a constant.
    """
    import jinja2

    class Translations(jinja2.BytecodeCache):
        """Keeps translated templates."""

        def load_bytecode(self, bucket: jinja2.bccache.Bucket) -> None:
            kept = _translation(bucket)
            content = kept.read() if _written_by_user(kept.path) else None
            if content is not None:
                bucket.bytecode_from_string(content)

        def dump_bytecode(self, bucket: jinja2.bccache.Bucket) -> None:
            kept = _translation(bucket)
            kept.write(bucket.bytecode_to_string())
            with contextlib.suppress(OSError):
                kept.path.chmod(0o644)
                kept.path.parent.chmod(0o755)

    found = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(package), jinja2.DictLoader(_parts)]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=shown,
        bytecode_cache=Translations(),
    )
    found.globals.update(functions)
    return found


def _translation(bucket: "jinja2.bccache.Bucket") -> Entry:
    """Place of a translation; constants in it are written in the language of the reader."""
    given = [bucket.key, bucket.checksum, language(), sys.version]
    return Cache().entry("templates", given, __name__, libraries=("anisoscope", "jinja2"))


def _written_by_user(path: Path) -> bool:
    """Test that other users cannot have written a file, so that it may be run."""
    if not hasattr(os, "getuid"):
        return True
    try:
        each = [one.stat() for one in (path, path.parent)]
    except OSError:
        return False
    return all(one.st_uid == os.getuid() and not one.st_mode & 0o022 for one in each)


@cache
def _environment(_template: str) -> "jinja2.Environment":
    """Environment of one template, because each brings its filters."""
    return template_environment(
        "anisoscope.report", _=message, said=translated, decimal=decimal, language=language
    )


def _part(template: str, source: str) -> "jinja2.Template":
    """A part that a template includes, translated once a process; filters are looked up when it is shown."""
    name = f"part {hashlib.sha256(source.encode()).hexdigest()}"
    _parts[name] = source
    return _environment(template).get_template(name)


def css_string(text: str) -> str:
    """A string of a style sheet, in quotation marks; other characters than letters and digits are escaped."""
    return '"' + "".join(c if c.isalnum() or c in " -._" else f"\\{ord(c):06x}" for c in text) + '"'
