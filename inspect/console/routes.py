"""The pages of a station and of a live picture, and the interface of programs below ``/api/v1``, which they use too."""

import asyncio
import json
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, FastAPI, HTTPException, Request, Response
from fastapi.responses import HTMLResponse, JSONResponse, StreamingResponse
from pydantic import BaseModel, ConfigDict, Field

from anisoscope.base.json_fields import as_json
from anisoscope.base.language import message, translated
from anisoscope.console.access import Access, Needs, Session
from anisoscope.console.guided import Begin, described
from anisoscope.console.live import Live
from anisoscope.console.pages import render, report_at
from anisoscope.console.station import Named, Start, Station
from anisoscope.inspection.recipe_store import RecipeEntry
from anisoscope.operations.rigging import question_of
from anisoscope.rig.jogging import Jogger, Step


def _picture_words(away: str) -> dict[str, str]:
    """Words of the script of the live picture; ``away``: when nothing answers."""
    return {
        "away": away,
        "stopping": message("Stopping …"),
        "halted": message("Stopped: the axes stand still."),
        "unconfirmed": message("STOP NOT CONFIRMED: use the emergency stop."),
        "good": message("exposure is good; no picture so far was sharper (move the focus to compare)"),
        "undefined": message("undefined"),
        "angle": message("{angle}° counter-clockwise from upright", angle="{angle}"),
    }


def _words() -> dict[str, str]:
    """Words of the scripts of the station page."""
    away = message("The console does not answer. The inspection goes on; Stop at the rig itself.")
    return _picture_words(away) | {
        "frame": message("frame"),
        "ending": message("Stopping: waits for the end of this step: {doing}", doing="{doing}"),
        "next": message("What to do next"),
        "stopped": message("stopped"),
        "mine": message("You hold the rig."),
        "free": message("The rig is free."),
        "held": message("{name} holds the rig.", name="{name}"),
        "asks": message("{name} asks for it.", name="{name}"),
        "you": message("you"),
        "PASS": message("good"),
        "WARN": message("look at it"),
        "FAIL": message("not good"),
        "SKIPPED": message("not done"),
    }


Looking = Annotated[Session, Depends(Needs("look"))]
Operating = Annotated[Session, Depends(Needs("operate"))]


def station_router(station: Station) -> APIRouter:
    """Routes of a station: its page, and the interface of programs below ``/api/v1``, which the page uses too."""
    router = APIRouter()
    for add in (_add_pages, _add_readings, _add_pictures, _add_changes, _add_guides):
        add(router, station)
    return router


def _add_pages(router: APIRouter, station: Station) -> None:
    @router.get("/station", include_in_schema=False)
    def page(request: Request, session: Looking) -> HTMLResponse:
        return render(
            request,
            "station.html",
            me=session.short,
            recipes=station.all_recipes(),
            calibrations=station.calibrations(),
            resumable=station.resumable(),
            places=station.has_places(),
            question=question_of(station.place.rig),
            guides=[one for one in described(station.place.rig) if session.may(one["needs"])],
            name=station.name or "",
            words=_words(),
        )

    @router.get("/inspections/{folder}/report.html", include_in_schema=False)
    def report(folder: str, _: Looking) -> Response:
        return report_at(station.report(folder))

    @router.get("/api/v1/openapi.json", include_in_schema=False)
    def schema(request: Request, _: Looking) -> JSONResponse:
        app: FastAPI = request.app
        return JSONResponse(app.openapi())


def _add_readings(router: APIRouter, station: Station) -> None:
    @router.get("/api/v1/session", summary="Who asks, and the token that every change takes in X-CSRF-Token")
    def session_(session: Looking) -> dict[str, Any]:
        return {
            "name": session.name,
            "roles": sorted(session.roles),
            "token": session.token,
            "id": session.short,
        }

    @router.get("/api/v1/recipes", summary="Recipes that may be inspected here")
    def recipes(_: Looking) -> list[RecipeEntry]:
        return station.all_recipes()

    @router.get("/api/v1/status", summary="What the station does now")
    def status(_: Looking) -> dict[str, Any]:
        return station.state()[1]

    @router.get("/api/v1/calibrations", summary="Calibrations of the rig and how long they hold")
    def calibrations(_: Looking) -> list[dict[str, Any]]:
        return station.calibrations()

    @router.get("/api/v1/resumable", summary="Interrupted inspections")
    def resumable(_: Looking) -> list[str]:
        return station.resumable()

    @router.get(
        "/api/v1/events", summary="Server-sent events: state, progress; Last-Event-ID goes on from there"
    )
    async def events(request: Request, session: Looking, after: str = "") -> StreamingResponse:
        station.check_room()
        stream = station.log.stream(
            request.headers.get("last-event-id", after), station.state, station.in_words
        )
        watched = _watched(station, session, stream, request.app.state.access)
        return StreamingResponse(watched, media_type="text/event-stream")

    @router.get("/api/v1/results", summary="Past inspections of the history, the latest last")
    def results(
        _: Looking, serial: str | None = None, limit: Annotated[int, Field(ge=1, le=1000)] = 50
    ) -> Any:  # noqa: ANN401
        return past(station.place.history, serial, limit)


async def _watched(
    station: Station, session: Session, stream: AsyncIterator[str], access: Access
) -> AsyncIterator[str]:
    """Events while the session holds: not after its end, or a change of its account."""
    with station.watched_by(session):
        async for text in stream:
            if not access.holds(session):
                return
            yield text


def _add_pictures(router: APIRouter, station: Station) -> None:
    @router.get(
        "/api/v1/live.jpg", summary="Live picture with the exposure of a recipe; its numbers in X-Numbers"
    )
    def live(recipe: str, _: Looking) -> Response:
        entry = station.recipe(recipe)
        if entry.problem is not None:
            raise HTTPException(409, entry.problem)
        return _picture(station.live, (entry.exposure_s, entry.gain, entry.channel))

    @router.get("/api/v1/frames/{number}.jpg", summary="A frame of the present inspection, small")
    def frame(number: int, _: Looking) -> Response:
        return Response(station.frame(number), media_type="image/jpeg")


def _picture(live: Live, taken: tuple[float, float, str | None], **more: str) -> Response:
    jpeg, numbers = live.look(*taken)
    said = numbers | {
        "advice": [message(one) for one in numbers["advice"]],
        "lamps": [one | {"words": _lamp_words(one)} for one in numbers.get("lamps", [])],
        **more,
    }
    return Response(jpeg, media_type="image/jpeg", headers={"X-Numbers": json.dumps(said)})


def _lamp_words(shown: dict[str, Any]) -> str:
    from anisoscope.live_view.lamps import Lamp, in_words

    lamp = Lamp(**shown)
    return f"{translated(lamp.name)}: {in_words(lamp)}"


def _add_changes(router: APIRouter, station: Station) -> None:
    @router.post("/api/v1/take", summary="Hold the rig, or ask its holder for it")
    def take(session: Operating) -> dict[str, Any]:
        station.take(session)
        return station.state()[1]

    @router.post("/api/v1/release", summary="Hand the rig over")
    def release(session: Operating) -> dict[str, Any]:
        station.release(session)
        return station.state()[1]

    @router.post("/api/v1/start", summary="Inspect a part")
    def start(asked: Start, session: Operating) -> dict[str, Any]:
        station.start(session, asked)
        return station.state()[1]

    @router.post("/api/v1/resume", summary="Go on with an interrupted inspection")
    def resume(asked: Named, session: Operating) -> dict[str, Any]:
        station.resume(session, asked.name)
        return station.state()[1]

    @router.post("/api/v1/check", summary="Test the rig with the exposure of a recipe")
    def check(asked: Named, session: Operating) -> dict[str, Any]:
        station.check(session, asked.name)
        return station.state()[1]

    @router.post("/api/v1/stop", summary="Stop the rig; everybody may")
    async def stop(session: Annotated[Session, Depends(Needs("stop"))]) -> dict[str, str]:
        # not in the threads of the other routes, all of which may wait for a camera
        return await asyncio.to_thread(station.stop, session)


def _add_guides(router: APIRouter, station: Station) -> None:
    @router.get("/api/v1/guides", summary="Guided work: commissioning, calibrations, golden parts, gauge R&R")
    def guides(_: Looking) -> list[dict[str, Any]]:
        return described(station.place.rig)

    @router.post("/api/v1/guides/begin", summary="Begin guided work, with a reason")
    def begin(given: Begin, session: Operating) -> dict[str, Any]:
        station.begin_guide(session, given)
        return station.state()[1]

    @router.post("/api/v1/guides/step", summary="Do the next step")
    def step(session: Operating) -> dict[str, Any]:
        station.do_step(session)
        return station.state()[1]

    @router.post("/api/v1/guides/end", summary="End guided work, finished or not")
    def end(session: Operating) -> dict[str, Any]:
        station.end_guide(session)
        return station.state()[1]


class Jog(BaseModel):
    """A step of an axis, or finer or coarser steps."""

    model_config = ConfigDict(extra="forbid")

    axis: str = Field("", max_length=40)
    sign: Literal[-1, 1] = 1
    size: Literal["finer", "coarser"] | None = None


def live_router(live: Live, exposure_s: float, gain: float, jogger: Jogger | None, name: str) -> APIRouter:
    """Routes of a live picture alone, without inspections: that of the station page.

    Args:
        live: takes the pictures.
        exposure_s: exposure.
        gain: gain of the camera.
        jogger: moves axes from the page; None shows the picture only.
        name: of the rig, for the heading.
    """
    router = APIRouter()

    @router.get("/station", include_in_schema=False)
    def page(request: Request, _: Looking) -> HTMLResponse:
        words = _picture_words(message("The live picture has ended."))
        axes = [] if jogger is None else list(jogger.axes)
        return render(request, "live.html", name=name, axes=axes, words=words)

    @router.get("/api/v1/live.jpg", summary="Live picture; its numbers in X-Numbers")
    def picture(_: Looking) -> Response:
        return _picture(
            live, (exposure_s, gain, None), **({} if jogger is None else {"axes": jogger.state()})
        )

    if jogger is None:
        return router

    @router.post("/api/v1/jog", summary="A step of an axis, or finer or coarser steps")
    def jog(asked: Jog, _: Operating) -> dict[str, str]:
        jogger.do(asked.size or Step(asked.axis, asked.sign))
        return {"axes": jogger.state()}

    @router.post("/api/v1/stop", summary="Stop all axes; everybody may")
    async def stop(_: Annotated[Session, Depends(Needs("stop"))]) -> dict[str, str]:
        await asyncio.to_thread(jogger.stop)
        return {}

    return router


def past(history: str | Path | None, serial: str | None, limit: int) -> Any:  # noqa: ANN401 - rows as JSON
    """Past inspections with what was decided about them, the oldest first; none without a history."""
    from anisoscope.history.address import parse_address
    from anisoscope.history.export import with_dispositions
    from anisoscope.history.filters import Filters
    from anisoscope.history.store import open_history

    if history is None:
        return []
    path = parse_address(history).path
    if path is not None and not path.exists():
        return []
    with open_history(history, create=False) as found:
        rows = found.rows(Filters(serial=serial, limit=limit))
        decided = found.dispositions_of([row.id for row in rows])
        return as_json([with_dispositions(row, decided.get(row.id, [])) for row in rows])
