"""The fleet page: every station of a history, its yield, causes and control charts; reports, dispositions, exports.

What is asked for stands in the address, so that a view can be sent. All of it works without scripts, but for
dispositions, whose token a script sends.
"""

import itertools
import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cached_property, partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal
from urllib.parse import urlencode

import numpy as np
from fastapi import APIRouter, Depends, HTTPException, Query, Request, Response
from fastapi import Path as InPath
from fastapi.responses import HTMLResponse, StreamingResponse
from pydantic import BaseModel, ConfigDict, Field, model_validator

from anisoscope.base.clock import SYSTEM, Clock
from anisoscope.base.errors import AnisoscopeError, RecordError, UsageError
from anisoscope.base.language import decimal, language, message, translated
from anisoscope.base.notation import number_name, number_text, true_minus
from anisoscope.console.access import Access, Needs, Session
from anisoscope.console.pages import drawn, render, report_at
from anisoscope.console.trail import Trail
from anisoscope.history.address import parse_address
from anisoscope.history.dispositions import DECISIONS, MAX_COMMENT, Decision, Disposition, checked_disposition
from anisoscope.history.filters import MOST_IDS, Filters, parse_moment
from anisoscope.history.rows import MAX_TEXT, Row
from anisoscope.history.signs import Sign, State, read_signs
from anisoscope.inspection.report_seal import report_state
from anisoscope.quality.capability import charted, specification
from anisoscope.quality.control import ControlStudy, Settings, control_study
from anisoscope.quality.limits import individuals
from anisoscope.quality.nelson import MEANING, flagged
from anisoscope.quality.readings import Readings, readings_of
from anisoscope.record.schema import REPORT_NAME
from anisoscope.record.verdict import Verdict
from anisoscope.study.statistics import Rate, rate

if TYPE_CHECKING:  # what reads histories is slow to import: the station's page does not wait for it
    from markupsafe import Markup

    from anisoscope.history.overview import Facts, IntArray, Overview
    from anisoscope.history.store import History


A_PAGE, A_PORTION = 50, 500
CHARTED, CHARTS = 2000, 12
CAUSES, STATIONS, CHOICES, LAST = 12, 100, 200, 20
FRESH_S, VIEWS = 1.0, 64
SAYING = {"running", "fault"}
LETTERS = {"PASS": "P", "FAIL": "F", "INCONCLUSIVE": "?", "INVALID": "!"}

Looks = Annotated[Session, Depends(Needs("look"))]
Number = Annotated[int, InPath(ge=1, lt=2**62)]


class Asked(BaseModel):
    """Query of a view; empty fields of a form ask for nothing."""

    model_config = ConfigDict(extra="forbid")

    since: str | None = Field(None, max_length=40)
    until: str | None = Field(None, max_length=40)
    product: str | None = Field(None, max_length=MAX_TEXT)
    station: str | None = Field(None, max_length=MAX_TEXT)
    lot: str | None = Field(None, max_length=MAX_TEXT)
    cavity: str | None = Field(None, max_length=MAX_TEXT)
    serial: str | None = Field(None, max_length=MAX_TEXT)
    verdict: Verdict | None = None
    cause: str | None = Field(None, max_length=MAX_TEXT)
    page: int = Field(1, ge=1, le=1_000_000)
    number: str | None = Field(None, max_length=MAX_TEXT)
    by: Literal["station", "cavity", "lot", "product"] | None = None

    @model_validator(mode="before")
    @classmethod
    def _without_empty(cls, given: Any) -> Any:  # noqa: ANN401 - anything may be asked
        return (
            {name: value for name, value in given.items() if value != ""}
            if isinstance(given, dict)
            else given
        )

    def filters(self, now: datetime) -> Filters:
        """The selection; `cause` is not part of it.

        Raises:
            UsageError: a time that is none.
        """
        return Filters(
            since=None if self.since is None else parse_moment(self.since, "since", now=now),
            until=None if self.until is None else parse_moment(self.until, "until", now=now, at_end=True),
            **{
                name: getattr(self, name)
                for name in ("product", "station", "lot", "cavity", "serial", "verdict")
            },
        )

    def query(self, **changes: object) -> str:
        """The part of an address behind its path that asks for the same, changed; None asks for nothing."""
        values = self.model_dump(exclude_defaults=True, mode="json") | {"page": None} | changes
        found = urlencode({name: value for name, value in values.items() if value is not None})
        return f"?{found}" if found else ""


Wants = Annotated[Asked, Query()]


class Decided(BaseModel):
    """A disposition from the page; who decides is who is logged in."""

    model_config = ConfigDict(extra="forbid")

    decision: Decision
    reason: str = Field(min_length=1, max_length=MAX_COMMENT, pattern=r"\S")


def fleet_router(
    history: str | Path | None,
    now: Callable[[], datetime] = lambda: datetime.now(UTC),
    clock: Clock = SYSTEM,
) -> APIRouter:
    """Routes of the fleet page.

    Args:
        history: what `anisoscope.history.store.open_history` takes; None without a history.
        now: the time, with a zone.
        clock: a monotonic clock in seconds.
    """
    router = APIRouter()
    get = partial(router.get, include_in_schema=False)
    fleet = _Fleet(history, now, _Views(clock))

    @router.get("/api/v1/stations", summary="Stations of the history: what each does, and since when")
    def stations(_: Looks) -> list[StationNow]:
        return fleet.stations()

    @get("/fleet")
    def page(request: Request, _: Looks, asked: Wants) -> HTMLResponse:
        view, mark = fleet.view(asked)
        return render(request, "fleet.html", view=view, mark=mark)

    @get("/fleet/view")
    def view(request: Request, _: Looks, asked: Wants) -> Response:
        content, mark = fleet.view(asked)
        if request.headers.get("if-none-match") == mark:
            return Response(status_code=304, headers={"ETag": mark})
        return HTMLResponse(content, headers={"ETag": mark})

    @get("/fleet/charts")
    def charts(request: Request, _: Looks, asked: Wants) -> HTMLResponse:
        return render(request, "fleet_charts.html", asked=asked, **fleet.charts(asked))

    @get("/fleet/maps")
    def maps(request: Request, _: Looks, asked: Wants) -> HTMLResponse:
        return render(request, "fleet_maps.html", asked=asked, **fleet.maps(asked))

    @get("/fleet/export/{form}")
    def export(form: Literal["csv", "json"], _: Looks, asked: Wants) -> Response:
        kind = "text/csv; charset=utf-8" if form == "csv" else "application/json"
        name = {"Content-Disposition": f'attachment; filename="inspections.{form}"'}
        return StreamingResponse(fleet.export(form, asked), media_type=kind, headers=name)

    _add_inspections(router, fleet)
    return router


def _add_inspections(router: APIRouter, fleet: "_Fleet") -> None:
    """Routes of one inspection."""

    @router.get("/fleet/inspections/{number}", include_in_schema=False)
    def inspection(request: Request, _: Looks, number: Number) -> HTMLResponse:
        row, decided = fleet.inspection(number)
        content = {
            "decided": decided,
            "decisions": DECISIONS,
            "numbers": _numbers(row),
            "where": _report(row)[1],
        }
        return render(request, "fleet_inspection.html", row=row, time=_time, **content)

    @router.get("/fleet/inspections/{number}/report", include_in_schema=False)
    def report(_: Looks, number: Number) -> Response:
        path, where = _report(fleet.inspection(number)[0])
        if path is None:
            raise HTTPException(404, where)
        return report_at(path)

    @router.post("/fleet/inspections/{number}/dispositions", include_in_schema=False)
    def dispose(
        request: Request,
        session: Annotated[Session, Depends(Needs("review"))],
        number: Number,
        given: Decided,
    ) -> dict[str, Any]:
        access: Access = request.app.state.access
        made = fleet.dispose(number, session.name, given, access.trail)
        return {"id": made.id, "reviewer": made.reviewer, "decision": made.decision, "reason": made.comment}


@dataclass(eq=False)
class _Views:
    """Drawn views, shared by all sessions and checked against the state of the history once a second."""

    clock: Clock
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _asked_at: float = -math.inf
    _state: object = None
    _drawn: "OrderedDict[str, tuple[object, Markup, str]]" = field(default_factory=OrderedDict)

    def view(
        self, name: str, state: Callable[[], object], draw: "Callable[[], Markup]"
    ) -> "tuple[Markup, str]":
        """A view and its mark, which changes with it; drawn anew where the state is another one."""
        with self._lock:
            if self.clock() - self._asked_at >= FRESH_S:
                self._state, self._asked_at = state(), self.clock()
            known = self._drawn.get(name)
            if known is None or known[0] != self._state:
                content = draw()
                known = self._state, content, f'"{sha256(content.encode()).hexdigest()[:32]}"'
            self._drawn[name] = known
            self._drawn.move_to_end(name)
            while len(self._drawn) > VIEWS:
                self._drawn.popitem(last=False)
            return known[1:]


@dataclass(eq=False)
class _Fleet:
    """Views of a history."""

    place: str | Path | None
    now: Callable[[], datetime]
    views: _Views

    @cached_property
    def overview(self) -> "Overview":
        """The facts of the history, read at the first question."""
        from anisoscope.history.overview import Overview

        return Overview()

    @contextmanager
    def history(self) -> "Iterator[History | None]":
        """The history; None where there is none yet."""
        path = None if self.place is None else parse_address(self.place).path
        if self.place is None or (path is not None and not path.exists()):
            yield None
            return
        from anisoscope.history.store import open_history

        with open_history(self.place, create=False) as found:
            yield found

    def selected(self, history: "History | None", asked: Asked) -> "tuple[Facts, IntArray]":
        """All facts, and the places of what is wanted, the oldest first."""
        facts, filters = self.overview.facts(history), asked.filters(self.now())
        chosen = facts.matching(filters, asked.cause)
        if filters.serial is not None and history is not None:
            known = [row.id for row in history.rows(Filters(serial=filters.serial, limit=MOST_IDS))]
            chosen &= np.isin(facts.ids, known)
        return facts, facts.ordered(chosen)

    def state(self) -> object:
        """State on which views depend: the newest rows, the stations, and the minute, for ages are in words."""
        minute = int(self.now().timestamp() // 60)
        with self.history() as history:
            if history is None:
                return minute
            does = tuple((one.station, *one.now(), one.words) for one in read_signs(history))
            return minute, history.head(), history.disposition_head(), does

    def view(self, asked: Asked) -> "tuple[Markup, str]":
        """The view of stations, causes and a page of the list, and its mark."""

        def draw() -> "Markup":
            return drawn("fleet_view.html", asked=asked, **self.page(asked))

        return self.views.view(f"{language()} {asked.query(page=asked.page)}", self.state, draw)

    def page(self, asked: Asked) -> dict[str, Any]:
        """Stations, causes and a page of the list."""
        with self.history() as history:
            facts, places = self.selected(history, asked)
            ids = _ids(facts, places[::-1][(asked.page - 1) * A_PAGE : asked.page * A_PAGE])
            rows = [] if history is None else history.rows(Filters(ids=ids))[::-1]
            signs = [] if history is None else read_signs(history)
            decided = {} if history is None else history.dispositions_of(ids)
        chosen = np.zeros(len(facts), dtype=np.bool_)
        chosen[places] = True
        return {
            "total": len(facts),
            "count": len(places),
            "stations": _stations(facts, places, signs, self.now(), asked.station)[:STATIONS],
            "rate": _yield(facts, places),
            "verdicts": facts.counts("verdict", chosen),
            "causes": _pareto(facts.counts("cause", chosen)),
            "rows": [(row, decided.get(row.id, [])) for row in rows],
            "last_page": max(1, -(-len(places) // A_PAGE)),
            "choices": _choices(facts),
            "time": _time,
            "since": partial(_since, now=self.now()),
            "letters": LETTERS,
        }

    def stations(self) -> list["StationNow"]:
        """State of every station; silent ones are known by their inspections."""
        with self.history() as history:
            if history is None:
                return []
            facts, places = self.selected(history, Asked())
            found = _stations(facts, places, read_signs(history), self.now())
        return [one.present for one in found if one.present is not None]

    def charts(self, asked: Asked) -> dict[str, Any]:
        """Control charts of the latest ones."""
        with self.history() as history:
            facts, places = self.selected(history, asked)
            ids = _ids(facts, places[-CHARTED:])
            columns = None if history is None else history.columns(Filters(ids=ids))
        content = {"choices": _choices(facts), "count": len(places), "shown": len(ids)}
        if columns is None or not columns.numbers:
            return content | {"names": {}, "charts": [], "left_out": []}
        found = readings_of(columns, "the selection")
        readings = Readings(found.source, {**found.texts, "id": tuple(map(str, ids))}, found.numbers, UTC)
        names = {name: _named(name) for name in charted(readings)}
        charts, left_out = _charts(readings, asked, next(iter(names))) if names else ([], [])
        return content | {"names": names, "charts": charts, "left_out": left_out}

    def maps(self, asked: Asked) -> dict[str, Any]:
        """Maps of the deviations of the latest ones, by product and cavity."""
        from anisoscope.console import heat_maps

        with self.history() as history:
            facts, places = self.selected(history, asked)
            ids = _ids(facts, places[-heat_maps.MAPPED :])
            rows = [] if history is None else history.rows(Filters(ids=ids))
        found, missing = heat_maps.heat_maps(rows)
        content = {"choices": _choices(facts), "count": len(places), "shown": len(rows)}
        return content | {"maps": found, "missing": missing}

    def export(self, form: Literal["csv", "json"], asked: Asked) -> Iterator[str]:
        """An export, in pieces.

        Raises:
            HTTPException: there is no history.
        """
        from anisoscope.history.export import csv_lines, json_lines

        with self.history() as history:
            if history is None:
                raise HTTPException(404, "there is no history yet")
            facts, places = self.selected(history, asked)
            labels = dict.fromkeys(
                label
                for ids in _portions(facts, places, MOST_IDS)
                for label in history.labels(Filters(ids=ids))
            )
        entries = self.entries(_portions(facts, places, A_PORTION))
        return _together(csv_lines(entries, tuple(labels)) if form == "csv" else json_lines(entries))

    def entries(self, portions: Sequence[tuple[int, ...]]) -> Iterator[tuple[Row, list[Disposition]]]:
        """Inspections with what was decided, read a portion at a time."""
        for ids in portions:
            with self.history() as history:
                if history is None:
                    raise RecordError("the history went away during the export")
                with history.selection(Filters(ids=ids)) as chosen:
                    found = list(chosen.decided())
            yield from found

    def inspection(self, number: int) -> tuple[Row, list[Disposition]]:
        """An inspection and what was decided about it.

        Raises:
            HTTPException: there is none.
        """
        with self.history() as history:
            row = None if history is None else history.row(number)
            if history is None or row is None:
                raise HTTPException(404, f"the history has no inspection {number}")
            return row, history.dispositions(number)

    def dispose(self, number: int, who: str, given: Decided, trail: Trail) -> Disposition:
        """Record a decision, first in the audit trail.

        Raises:
            HTTPException: there is no such inspection.
            RecordError, HistoryError: it cannot be recorded.
        """
        row, _ = self.inspection(number)
        who, what, why = checked_disposition(who, given.decision, given.reason.strip())
        with self.history() as history:
            assert history is not None
            trail.add(who, "disposition", why, inspection=number, serial=row.serial, decision=what)
            return history.dispose(number, reviewer=who, decision=what, comment=why)


def _ids(facts: "Facts", places: "IntArray") -> tuple[int, ...]:
    return tuple(facts.ids[places].tolist())


def _portions(facts: "Facts", places: "IntArray", size: int) -> list[tuple[int, ...]]:
    return [_ids(facts, places[start : start + size]) for start in range(0, len(places), size)]


def _choices(facts: "Facts") -> dict[str, list[str]]:
    """Words to choose from, the most frequent ones; of lots the latest."""
    every = np.ones(len(facts), dtype=np.bool_)
    found = {
        name: sorted(word for word in list(facts.counts(name, every))[:CHOICES] if word)
        for name in ("product", "station", "cavity", "cause")
    }
    return found | {
        "lot": [word for word in facts.words["lot"][::-1] if word][:CHOICES],
        "verdict": list(LETTERS),
    }


# Stations, yield and causes.


class StationNow(BaseModel):
    """Present state of a station.

    Attributes:
        station: its name.
        state: ``idle``, ``running``, ``fault`` (the last task failed), ``off`` (its program ended in order), or
            ``no sign``.
        since: when that began; without a sign the moment of the last one, or of the last inspection.
        words: serial number of the part at work, or what is wrong.
    """

    station: str
    state: State
    since: datetime
    words: str = ""


@dataclass(frozen=True)
class Station:
    """Station, as known from the history.

    Attributes:
        name: "" where none was stated.
        count: inspections.
        last: when the last one was made; None without one.
        age: since then, in words.
        verdicts: of the last ones, the oldest first.
        rate: share of PASS in all that could be judged.
        present: what it does; None where no name was stated.
    """

    name: str
    count: int
    last: datetime | None
    age: str
    verdicts: tuple[str, ...]
    rate: Rate
    present: StationNow | None


def _stations(
    facts: "Facts", places: "IntArray", signs: Sequence[Sign], now: datetime, only: str | None = None
) -> list[Station]:
    """The stations of some inspections, that with the last inspection first, and those that give signs."""
    from anisoscope.history.columns import us_to_datetime

    codes = facts.codes["station"][places]
    order = np.argsort(codes, kind="stable")
    words, verdicts = facts.words["station"], facts.words["verdict"]
    given, found = {sign.station: sign for sign in signs}, dict[str, Station]()
    times = np.full(len(words), -1)
    np.maximum.at(times, facts.codes["station"], facts.times)
    latest = {name: us_to_datetime(at) for name, at in zip(words, times.tolist(), strict=True) if at >= 0}
    for some in np.split(places[order], np.flatnonzero(np.diff(codes[order])) + 1) if len(places) else ():
        last = us_to_datetime(int(facts.times[some[-1]]))
        shown = tuple(verdicts[code] for code in facts.codes["verdict"][some[-LAST:]])
        name = words[facts.codes["station"][some[0]]]
        present = _present(name, given.get(name), latest[name])
        found[name] = Station(name, len(some), last, _age(now - last), shown, _yield(facts, some), present)
    listed = sorted(found.values(), key=lambda one: one.last or now, reverse=True)
    nothing = _yield(facts, places[:0])
    for name in sorted(given.keys() - found.keys()):
        if only in {None, name}:
            present = _present(name, given[name], latest.get(name))
            listed.append(Station(name, 0, None, "", (), nothing, present))
    return listed


def _present(name: str, sign: Sign | None, last: datetime | None) -> StationNow | None:
    if not name:
        return None
    if sign is None:
        assert last is not None
        return StationNow(station=name, state="no sign", since=last)
    state, since = sign.now(last)
    return StationNow(station=name, state=state, since=since, words=sign.words if state in SAYING else "")


def _yield(facts: "Facts", places: "IntArray") -> Rate:
    """Share of PASS in all that could be judged: INVALID says nothing about the part."""
    words = np.array(facts.words["verdict"])[facts.codes["verdict"][places]]
    return rate(words[words != "INVALID"] == "PASS")


def _pareto(counts: Mapping[str, int]) -> list[tuple[str, int, float, float]]:
    """Causes with number, share and cumulated share, the most frequent first; "" is the rest of them."""
    counts = {cause: number for cause, number in counts.items() if cause}
    total, so_far, found = sum(counts.values()), 0, []
    listed = [*itertools.islice(counts.items(), CAUSES)]
    listed += [("", rest)] if (rest := total - sum(n for _, n in listed)) else []
    for cause, number in listed:
        so_far += number
        found.append((cause, number, number / total, so_far / total))
    return found


def _named(number: str) -> str:
    return true_minus(translated(number_name(number)))


def _age(since: timedelta) -> str:
    seconds = since.total_seconds()
    if seconds < 0.0:
        return message("in the future: the clocks differ")
    if seconds < 120.0:
        return message("less than 2 min ago")
    units = ((86400.0, "d"), (3600.0, "h"), (60.0, "min"))
    size, unit = next((size, unit) for size, unit in units if seconds >= 2.0 * size)
    return message("{time} ago", time=f"{seconds / size:.0f} {unit}")


def _since(moment: datetime, now: datetime) -> str:
    at, today = moment.astimezone(), now.astimezone().date()
    return at.strftime("%H:%M" if at.date() == today else "%Y-%m-%d %H:%M")


def _time(moment: datetime) -> str:
    return moment.astimezone().strftime("%Y-%m-%d %H:%M:%S")


# Control charts.

WIDTH, HEIGHT, LEFT, RIGHT, EDGE = 960.0, 270.0, 12.0, 130.0, 24.0
DOTS, PATTERNS, LINE = 300, 15, 13.0


@dataclass(frozen=True)
class Chart:
    """A control chart to draw.

    Attributes:
        title: its number and group.
        study: what it shows.
        lines: points of polylines, interrupted where values are missing.
        dots: x, y, text, and whether the value belongs to a pattern.
        levels: y, y of the text, text and kind of horizontal lines.
        patterns: what was found, what it may mean, id and serial number of the inspection that completed it.
        more: patterns that are not listed.
        note: why there is no capability, or "".
    """

    title: str
    study: ControlStudy
    lines: list[str]
    dots: list[tuple[float, float, str, bool]]
    levels: list[tuple[float, float, str, str]]
    patterns: list[tuple[str, str, str, str]]
    more: int
    note: str


def _charts(readings: Readings, asked: Asked, first: str) -> tuple[list[Chart], list[str]]:
    """Charts of the groups with the most values, and why others are left out.

    Raises:
        UsageError: there is no such number.
    """
    name, _ = readings.number(asked.number or first)
    groups = sorted(readings.grouped(asked.by).items(), key=lambda item: len(item[1]), reverse=True)
    found, left_out = list[Chart](), list[str]()
    for group, part in groups[:CHARTS]:
        title = _named(name)
        title += "" if asked.by is None else f", {translated(asked.by)} {group or message('not stated')}"
        try:
            found.append(_chart(title, name, part))
        except UsageError as error:
            left_out.append(f"{title}: {translated(str(error))}")
    if len(groups) > CHARTS:
        left_out.append(message("{count} more: choose one above", count=len(groups) - CHARTS))
    return found, left_out


def _chart(title: str, name: str, part: Readings) -> Chart:
    try:
        limits, note = specification(part, name), ""
    except UsageError as error:
        limits, note = None, str(error)
    values, labels = part.numbers[name], part.labels
    study = control_study(title, individuals(values, labels), Settings(), limits)
    line = study.line
    levels = [(float(line.center[0]), message("centre"), "centre")]
    levels += [(float(line.lower[0]), message("lower limit"), "limit")]
    levels += [(float(line.upper[0]), message("upper limit"), "limit")]
    if limits is not None:
        sides = (limits.lower, limits.upper)
        levels += [(side, message("tolerance"), "tolerance") for side in sides if side is not None]
    heights = np.concatenate([values[~np.isnan(values)], [y for y, *_ in levels]])
    low, high = float(heights.min()), float(heights.max())
    scale = (HEIGHT - 2.0 * EDGE) / ((high - low) or 1.0)
    x = LEFT + np.arange(len(values)) * (WIDTH - LEFT - RIGHT) / max(1, len(values) - 1)
    y = HEIGHT - EDGE - (values - low) * scale
    marked, known = flagged(study.flags, len(values)), ~np.isnan(values)
    shown = np.flatnonzero(known & (marked | (len(values) <= DOTS)))
    patterns = [
        (
            f"{message('rule {number}', number=one.rule)}: {translated(one.text)}",
            MEANING[one.rule],
            part.texts["id"][one.seen_at],
            labels[one.seen_at],
        )
        for one in study.flags
    ]
    return Chart(
        title,
        study,
        [
            " ".join(f"{x[k]:.1f},{y[k]:.1f}" for k in run)
            for run in np.split(np.arange(len(values)), np.flatnonzero(np.diff(known)) + 1)
            if len(run) and known[run[0]]
        ],
        [
            (
                round(x[k], 1),
                round(y[k], 1),
                f"{labels[k]}: {decimal(number_text(name, values[k]))}",
                bool(marked[k]),
            )
            for k in shown.tolist()
        ],
        _spread(
            [
                (HEIGHT - EDGE - (y - low) * scale, f"{text} {decimal(f'{y:.4g}')}", kind)
                for y, text, kind in levels
            ]
        ),
        patterns[:PATTERNS],
        max(0, len(patterns) - PATTERNS),
        note,
    )


def _spread(levels: list[tuple[float, str, str]]) -> list[tuple[float, float, str, str]]:
    """Levels from the top, their texts moved down where they would overlap."""
    found, free = [], 0.0
    for y, text, kind in sorted(levels):
        at = max(y + 4.0, free)
        free = at + LINE
        found.append((round(y, 1), round(at, 1), true_minus(text), kind))
    return found


# One inspection: its numbers, and where its report is.


def _numbers(row: Row) -> list[tuple[str, str, str, str, str]]:
    """Name, value, standard uncertainty, deviation and tolerance."""

    def cell(label: str, form: str) -> str:
        return decimal(true_minus(form.format(row.numbers[label]))) if label in row.numbers else ""

    return [
        (
            _named(label),
            decimal(true_minus(number_text(label, value))),
            cell(f"u {label}", "{:.2g}"),
            cell(f"deviation {label}", "{:+.4g}"),
            cell(f"tolerance {label}", "±{:g}"),
        )
        for label, value in row.numbers.items()
        if not label.startswith(("u ", "deviation ", "tolerance "))
    ]


def _report(row: Row) -> tuple[Path | None, str]:
    """The report of an inspection, or None and where it is.

    A report is served if its folder is on this computer, holds the record that the history knows by its seal, and the
    report is what that record's inspection wrote: no row can name another file of this computer.
    """
    from anisoscope.history.comparing import record_of

    folder = Path(row.folder)
    try:
        if not folder.is_dir():
            at = (
                message("station {name}", name=row.station)
                if row.station
                else message("a station that was not stated")
            )
            where = message(
                "The report is not on this computer. It was written at {at}, into {folder}",
                at=at,
                folder=row.folder,
            )
            return None, where
        record_of(row)
        state = report_state(folder).state
        path = folder / REPORT_NAME
        if state != "written" or path.resolve().parent != folder.resolve():
            text = (
                message("{folder} has no report", folder=row.folder)
                if state == "missing"
                else message(
                    "{folder} has a report that was changed since, which is not shown", folder=row.folder
                )
            )
            again = message("`anisoscope show id:{id} --html FILE` makes it again", id=row.id)
            return None, f"{text}; {again}"
    except (AnisoscopeError, OSError, ValueError) as error:
        return None, message("The report cannot be shown: {why}", why=error)
    return path, ""


def _together(lines: Iterator[str]) -> Iterator[str]:
    while some := "".join(itertools.islice(lines, A_PORTION)):
        yield some
