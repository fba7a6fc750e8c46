"""The fleet page: every station of a history."""

from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse

from anisoscope.console.access import Needs, Session
from anisoscope.console.pages import render


def fleet_router(history: str | Path | None) -> APIRouter:
    """Routes of the fleet page.

    Args:
        history: what `anisoscope.history.store.open_history` takes; None without a history.
    """
    router = APIRouter()

    @router.get("/fleet", include_in_schema=False)
    def page(request: Request, _: Annotated[Session, Depends(Needs("look"))]) -> HTMLResponse:
        return render(request, "fleet.html", count=_count(history))

    return router


def _count(history: str | Path | None) -> int:
    """Number of inspections in the history; 0 where it is not there yet."""
    from anisoscope.history.address import parse_address  # noqa: PLC0415 - loads SQLAlchemy
    from anisoscope.history.store import open_history  # noqa: PLC0415

    if history is None:
        return 0
    path = parse_address(history).path
    if path is not None and not path.exists():
        return 0
    with open_history(history, create=False) as found:
        return found.count()
