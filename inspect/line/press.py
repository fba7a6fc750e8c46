"""Cycle data of an injection moulding machine by OPC UA: the events of OPC 40077 (EUROMAP 77) after every cycle.

The machine fires an event of a type of its own below CycleParametersEventType (OPC 40083). Its fields are known by
their browse names, ``CycleTime`` or ``InjectionUnitCycleParameters_1/CushionVolume``; what it has is read from the
types in its server. Durations are in milliseconds, as there; other units are those of the machine.
"""

import asyncio
import contextlib
import logging
import math
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any
from urllib.parse import urlsplit

from asyncua import Client, ua
from asyncua.common.events import Event, get_filter_from_event_type
from asyncua.ua.uaerrors import UaError

from anisoscope.base.crash import Steady, as_foreseen
from anisoscope.base.errors import AnisoscopeError, UsageError
from anisoscope.history.covariates import CycleData
from anisoscope.history.store import History
from anisoscope.line.opcua_security import Security
from anisoscope.line.opcua_types import subtypes

GENERAL_TYPES = "http://opcfoundation.org/UA/PlasticsRubber/GeneralTypes/"
CYCLE_PARAMETERS = 1038
COUNTERS = ("MachineCycleCounter", "JobCycleCounter")
_AGAIN_S = (1.0, 2.0, 5.0, 10.0, 30.0)
_LOOK_S = 1.0
_REALS = (ua.VariantType.Double, ua.VariantType.Float)

Take = Callable[[Sequence[CycleData]], str | None]


def cycle_of(event: Event, wanted: Sequence[str], source: str) -> tuple[CycleData, list[str]]:
    """Cycle data of an event.

    Args:
        event: with its fields by browse names.
        wanted: fields that are taken, or none: all that are real numbers.
        source: where it comes from.

    Returns:
        The cycle, and of the wanted fields those that hold no number.
    """
    values: Mapping[str, Any] = {name: getattr(event, name) for name in event.data_types}
    names = wanted or [name for name, kind in event.data_types.items() if kind in _REALS]
    numbers = {
        name: float(values[name])
        for name in names
        if isinstance(values.get(name), int | float) and not isinstance(values[name], bool)
    }
    numbers = {name: value for name, value in numbers.items() if math.isfinite(value)}
    part, at = values.get("PartId"), values.get("Time")
    moment = (at if isinstance(at, datetime) else datetime.now(UTC)).replace(tzinfo=UTC)
    cycle = CycleData(
        at=moment, serial=part if isinstance(part, str) and part else None, source=source, numbers=numbers
    )
    return cycle, [name for name in wanted if name not in numbers]


@contextlib.asynccontextmanager
async def _connected(client: Client) -> AsyncIterator[Client]:
    """A session of a client, which ends it.

    Raises:
        UaError: also where the server ends the opening of the channel with an error, which asyncua takes for a bug.
    """
    try:
        await client.connect()
    except AssertionError:
        raise UaError("it refused the connection: it has to trust the certificate of --certificate") from None
    try:
        yield client
    finally:
        await client.disconnect()


class PressReader:
    """Takes the cycles of a machine; `run` follows it through cuts of the connection.

    Args:
        address: ``opc.tcp://host:port/…``.
        take: receives cycles and returns a line for the operator, or None; where it raises they are given to it again.
        say: takes a line for the operator.
        wanted: browse names of the fields to take; none: all that are real numbers.
        again_s: waiting times before the next tries to connect.
        security: the own certificate, and the machines that are trusted; None: without encryption.

    Raises:
        UsageError: the address is none of OPC UA.
    """

    def __init__(
        self,
        address: str,
        take: Take,
        say: Callable[[str], None],
        wanted: Sequence[str] = (),
        again_s: Sequence[float] = _AGAIN_S,
        security: Security | None = None,
    ) -> None:
        try:
            parts = urlsplit(address)
            host, port = parts.hostname, parts.port or 4840
        except ValueError:
            parts, host, port = urlsplit(""), None, 0
        if parts.scheme != "opc.tcp" or not host:
            raise UsageError(
                f"a machine has an address such as opc.tcp://press:4840, not {address.rpartition('@')[2][:60]!r}"
            )
        self._url, self._source, self._security = address, f"{host}:{port}", security
        self._address = parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()  # without a password
        self._take, self._say, self._wanted, self._again_s = take, say, tuple(wanted), again_s
        self._heard: asyncio.Queue[Event] = asyncio.Queue()
        self._waiting: list[CycleData] = []
        self._counted: dict[str, int] = {}
        self._said: set[str] = set()
        self._steady = Steady("line press", say)
        self.taken = 0

    def event_notification(self, event: Event) -> None:
        """Called by the subscription."""
        self._heard.put_nowait(event)

    def status_change_notification(self, status: object) -> None:
        """Called by the subscription when it ends, with its connection."""

    async def run(self, most: int | None = None) -> None:
        """Take cycles, until so many are taken, or until cancelled.

        Raises:
            UsageError: before the first connection: the server is none of OPC 40077, or its cycles do not have a field
                that is wanted. Later that is tried again.
        """
        logging.getLogger("asyncua").setLevel(
            logging.CRITICAL
        )  # what it logs of a cut is said in a line here
        tries, said, was_connected = 0, "", False
        while most is None or self.taken < most:
            try:
                found = Client(self._url, timeout=10.0)
                if self._security is not None:
                    await self._security.secure(found)
                async with _connected(found) as client:
                    await self._subscribe(client)
                    self._tell(f"connected to {self._address}")
                    tries, said, was_connected = 0, "", True
                    while most is None or self.taken < most:
                        await client.check_connection()
                        await self._follow()
            except Exception as problem:  # a machine that is off for a night is followed again
                if isinstance(problem, AnisoscopeError) and not was_connected:
                    raise
                foreseen = OSError, UaError, TimeoutError, asyncio.IncompleteReadError
                own = problem if isinstance(problem, foreseen) else as_foreseen(problem, "line press")
                why = " ".join(str(own).split()) or type(problem).__name__
                if why != said:
                    self._tell(f"{self._address}: {why.removeprefix(f'{self._address}: ')}; trying again")
                said = why
                await asyncio.sleep(self._again_s[min(tries, len(self._again_s) - 1)])
                tries += 1

    async def _subscribe(self, client: Client) -> None:
        try:
            namespace = await client.get_namespace_index(GENERAL_TYPES)
        except ValueError:
            raise UsageError(
                f"{self._address}: this is no server of OPC 40077 (EUROMAP 77): it lacks {GENERAL_TYPES}"
            ) from None
        types = await subtypes(client.get_node(ua.NodeId(CYCLE_PARAMETERS, namespace)))
        chosen = await get_filter_from_event_type(types)
        there = {Event.browse_path_to_attribute_name(one.BrowsePath) for one in chosen.SelectClauses}
        missing = [name for name in self._wanted if name not in there]
        if missing:
            raise UsageError(
                f"{self._address}: its cycles have no {missing[0]!r}; they have {', '.join(sorted(there))}"
            )
        subscription = await client.create_subscription(500, self)
        await subscription.subscribe_events(ua.ObjectIds.Server, evfilter=chosen)

    async def _follow(self) -> None:
        """Take what is heard within a moment."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_LOOK_S):
                self._hear(await self._heard.get())
        while not self._heard.empty():
            self._hear(self._heard.get_nowait())
        if not self._waiting:
            return
        news = tuple(self._waiting)
        said = await asyncio.to_thread(self._steady, lambda: (self._take(news),), ())
        if said:  # else they wait for the next try
            self.taken += len(news)
            self._waiting.clear()
            self._tell(said[0])

    def _hear(self, event: Event) -> None:
        cycle, lacking = cycle_of(event, self._wanted, self._source)
        for name in lacking:
            self._once(f"{self._address}: {name} holds no number; cycles are taken without it")
        for name in COUNTERS:
            count = getattr(event, name, None)
            if isinstance(count, int):
                missed = count - self._counted.get(name, count) - 1
                self._counted[name] = count
                if missed > 0:
                    self._tell(f"{self._address}: {missed} cycles before {name} {count} were not heard")
                break
        if cycle.numbers:
            self._waiting.append(cycle)

    def _once(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            self._tell(text)

    def _tell(self, text: str | None) -> None:
        if text is None:
            return
        with contextlib.suppress(Exception):  # nobody hears
            self._say(text)


def follow_press(
    address: str,
    opening: Callable[[], History],
    say: Callable[[str], None],
    fields: Sequence[str] = (),
    machine: str = "",
    cycles: int | None = None,
    security: Security | None = None,
) -> None:
    """Add the cycles of a machine to a history as they come.

    Args:
        address: ``opc.tcp://host:port/…``.
        opening: opens the history, for every cycle.
        say: takes a line for the operator.
        fields: browse names of the fields to take; none: all that are real numbers.
        machine: put before the names of the numbers.
        cycles: end after so many; None: never.
        security: the own certificate, and the machines that are trusted; None: without encryption.

    Raises:
        UsageError: the address is not that of a machine with these fields.
        HistoryError: the history cannot be written.
    """

    def take(news: Sequence[CycleData]) -> str:
        named = [
            replace(one, numbers={f"{machine} {name}".strip(): value for name, value in one.numbers.items()})
            for one in news
        ]
        with opening() as history:
            added = history.add_covariates(named)
        return f"{added} added, {len(news) - added} there already"

    reader = PressReader(address, take, say, fields, security=security)
    with opening() as history:  # one that cannot be written is said before a cycle is waited for
        say(f"cycles go to {history.address}")
    asyncio.run(reader.run(cycles))
