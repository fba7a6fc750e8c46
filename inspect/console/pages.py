"""Pages of the console: templates over one base, and the files that they load from here alone."""

from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from fastapi import APIRouter, HTTPException, Request, Response
from fastapi.responses import HTMLResponse

from anisoscope.base.errors import RecordError
from anisoscope.base.language import NAMES, decimal, language, message, translated
from anisoscope.base.notation import true_minus
from anisoscope.console.access import Permission
from anisoscope.report.page import template_environment

if TYPE_CHECKING:
    import jinja2
    import markupsafe

KINDS = {".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
STATIC = (
    "console.css",
    "console.js",
    "fleet.css",
    "fleet.js",
    "guide.js",
    "icon.svg",
    "picture.js",
    "station.js",
)

REPORT_POLICY = (
    "sandbox allow-scripts allow-popups; default-src 'none'; script-src 'unsafe-inline' data: blob:; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; media-src data:; worker-src blob: data:"
)
"""Of a report, which runs its scripts with an origin of its own: it reaches neither the session nor the network."""


def render(request: Request, template: str, **content: object) -> HTMLResponse:
    """A page of a template that extends ``base.html``.

    Args:
        request: its session decides what the navigation shows.
        template: its name.
        content: what it shows; a name that it misses is an error.
    """
    session = request.state.session
    may: dict[Permission, bool] = {name: session.may(name) for name in get_args(Permission)}
    common = {
        "lang": language(),
        "languages": NAMES.items(),
        "session": session,
        "may": may,
        "single": request.app.state.access.accounts is None,
        "pages": request.app.state.pages,
        "here": request.url.path,
    }
    return HTMLResponse(_environment().get_template(template).render(**common, **content))


def drawn(template: str, **content: object) -> "markupsafe.Markup":
    """A part of a page that is the same in every session."""
    import markupsafe

    return markupsafe.Markup(_environment().get_template(template).render(**content))  # noqa: S704 - escaped there


@cache
def _environment() -> "jinja2.Environment":
    found = template_environment("anisoscope.console", _=message)
    found.filters |= {"translated": translated, "decimal": decimal, "typeset": true_minus}
    return found


@cache
def _static(name: str) -> bytes:
    return (files("anisoscope.console") / "templates" / name).read_bytes()


def report_at(path: Path) -> Response:
    """A report, with a policy that shuts it off.

    Raises:
        RecordError: it cannot be read.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror}") from error
    return Response(content, media_type="text/html", headers={"Content-Security-Policy": REPORT_POLICY})


def static_router() -> APIRouter:
    """Style sheets, scripts and the icon."""
    router = APIRouter()

    @router.get("/static/{name}", include_in_schema=False)
    def static(name: str) -> Response:
        if name not in STATIC:
            raise HTTPException(404, "there is no such file")
        kind = KINDS[name[name.rindex(".") :]]
        return Response(_static(name), media_type=kind, headers={"Cache-Control": "no-cache"})

    return router
