"""A rig as a Sparkplug B edge node: births, data and deaths, plain JSON, and orders of jobs, over MQTT 3.1.1.

One thread publishes, so that sequence numbers are in order; what the client's thread, the jobs and signals bring is
queued for it. Each connection is a session with a last will of its own. A result counts as published when the broker
has acknowledged its JSON message (QoS 1); what is not acknowledged is sent again after a cut, marked as historical.
"""

import contextlib
import json
import queue
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion
from pydantic import BaseModel, ConfigDict, ValidationError

from anisoscope.base.atomic_write import write_text
from anisoscope.base.crash import Steady
from anisoscope.base.errors import AnisoscopeError, RecordError, UsageError
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.history.rows import CAUSE, Row
from anisoscope.history.store import open_history
from anisoscope.line.jobs import Job, Jobs, Refused, order_of
from anisoscope.line.sparkplug import (
    BD_SEQ,
    LARGEST,
    REBIRTH,
    Kind,
    MalformedError,
    Metric,
    Names,
    Sequence256,
    decoded,
    encoded,
    milliseconds,
)

ORDER, STOP = "Command/Order", "Command/Stop"
LATEST = 100
"""Inspections that the yield counts."""
_PORT, _TLS_PORT = 1883, 8883
_AGAIN_S = (1.0, 2.0, 5.0, 10.0, 30.0)
_LOOK_S = 1.0
_AT_ONCE = 50
_KEEP_ALIVE_S = 30


@dataclass(frozen=True)
class Broker:
    """Address of a broker: ``mqtt://[user:password@]host[:1883]`` or ``mqtts://…[:8883]``."""

    host: str
    port: int
    tls: bool
    user: str | None
    password: str | None = field(default=None, repr=False)

    def __str__(self) -> str:
        return f"{'mqtts' if self.tls else 'mqtt'}://{self.host}:{self.port}"


def broker_of(address: str) -> Broker:
    """A broker by its address.

    Raises:
        UsageError: it is none.
    """
    try:
        parts = urlsplit(address)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    if parts.scheme not in ("mqtt", "mqtts") or not parts.hostname or parts.path.strip("/") or parts.query:
        raise UsageError(
            f"a broker has an address such as mqtt://broker:1883 or mqtts://…, not {address.rpartition('@')[2][:40]}"
        )
    tls = parts.scheme == "mqtts"
    user, password = (None if one is None else unquote(one) for one in (parts.username, parts.password))
    return Broker(parts.hostname, port or (_TLS_PORT if tls else _PORT), tls, user, password)


class _State(BaseModel):
    """Memory of a node: the number of its last session, and the last inspection that the broker acknowledged."""

    model_config = ConfigDict(extra="forbid")

    bd_seq: int | None = None
    published: int | None = None


class EdgeNode:
    """The node; `run` serves until `end`.

    Args:
        broker: where it publishes.
        names: of group, node and device.
        history: whose inspections are published.
        memory: file that remembers sessions and what was published.
        say: takes a line for the operator.
        jobs: that may be ordered, entered; None publishes only.
    """

    def __init__(
        self,
        broker: Broker,
        names: Names,
        history: str | Path,
        memory: Path,
        say: Callable[[str], None],
        jobs: Jobs | None = None,
    ) -> None:
        self._broker, self._names, self._history, self._memory = broker, names, history, memory
        self._say, self._jobs = say, jobs
        self._events: queue.SimpleQueue[tuple[Any, ...]] = queue.SimpleQueue()
        self._client: paho.Client | None = None
        self._session = self._tries = 0
        self._is_online = False
        self._sequence = Sequence256()
        self._kinds: dict[str, Kind] = {}
        self._values: dict[str, Any] = {}
        self._verdicts: dict[int, str] = {}
        self._sent, self._lost_at = 0, 0
        self._waiting: dict[int, int] = {}
        self._remembered, self._is_over = self._recall(), False
        if jobs is not None:
            jobs.listen(
                lambda kind, job, _: self._events.put(("job", kind, job)) if kind != "progress" else None
            )

    # From any thread.

    def end(self) -> None:
        """Make `run` publish its death and return."""
        self._events.put(("end",))

    # The thread that publishes.

    def run(self) -> None:
        """Connect, publish, and connect again after cuts, until `end`.

        Raises:
            HistoryError: the history cannot be read at the start, or there is none and no jobs can be ordered.
            RecordError: the memory cannot be written at the start.
        """
        self._begin()
        steady, wait_s = Steady("line mqtt", self._say), 0.0
        while not self._is_over:
            wait_s = steady(partial(self._step, wait_s), _AGAIN_S[0])

    def _step(self, wait_s: float) -> float:
        """Connect if it is time, and take an event; returns for how long to wait before the next try to connect."""
        if self._client is None and wait_s <= 0.0:
            wait_s = self._connect()
        try:
            event = self._events.get(timeout=max(wait_s if self._client is None else _LOOK_S, 0.01))
        except queue.Empty:
            self._look()
            return 0.0
        if event[0] == "end":
            self._is_over = True
            self._die()
        elif event[0] in ("connected", "lost", "message", "acknowledged") and event[1] != self._session:
            pass  # of an earlier session
        elif event[0] == "lost" or (event[0] == "connected" and event[2]):
            return self._cut("the connection was cut" if event[0] == "lost" else str(event[2]))
        else:
            getattr(self, f"_on_{event[0]}")(*event[2 if event[0] != "job" else 1 :])
        return wait_s

    def _recall(self) -> _State:
        if not self._memory.exists():
            return _State()
        try:
            return _State.model_validate_json(bounded_bytes(self._memory))
        except (OSError, ValidationError) as error:
            raise RecordError(
                f"{self._memory} cannot be used: remove it to begin anew ({str(error).splitlines()[0]})"
            ) from None

    def _remember(self, **changes: int) -> None:
        self._remembered = self._remembered.model_copy(update=changes)
        write_text(self._memory, self._remembered.model_dump_json())

    def _begin(self) -> None:
        """Begin with births of the latest inspections. Without a memory, the history counts as published."""
        with open_history(self._history, create=self._jobs is not None) as history:
            last = history.last_id()
            before = history.after(max(last - LATEST, 0), LATEST)
        self._memory.parent.mkdir(parents=True, exist_ok=True)
        if self._remembered.published is None:
            self._remember(published=last)
        self._sent = min(self._remembered.published or 0, last)
        names: dict[str, Kind] = {
            "State": "String", "Job": "String", "Inspections": "Int64", "Yield": "Double",
            "Result/Id": "Int64", "Result/Time": "DateTime", "Result/Verdict": "String", "Result/Serial": "String",
            "Result/Recipe": "String", "Result/Lot": "String", "Result/Cavity": "String", "Result/Cause": "String",
            "Result/Cause weight": "Double",
        }  # fmt: skip
        if self._jobs is not None:
            names |= {ORDER: "String", STOP: "Boolean"}
        self._kinds = names
        for row in before:
            if row.id <= self._sent:
                self._take(row)
        self._state()

    def _state(self) -> None:
        running = None if self._jobs is None else self._jobs.running
        self._values["State"] = (
            "publishing" if self._jobs is None else "ready" if running is None else "running"
        )
        self._values["Job"] = None if running is None else running.id

    def _take(self, row: Row) -> bool:
        """The values of the device after an inspection; whether there are new names among them."""
        self._verdicts[row.id] = row.verdict
        self._verdicts = {number: self._verdicts[number] for number in sorted(self._verdicts)[-LATEST:]}
        cause = next((name for name in row.numbers if name.startswith(CAUSE)), None)
        self._values |= {
            "Inspections": row.id,
            "Yield": sum(one == "PASS" for one in self._verdicts.values()) / len(self._verdicts),
            "Result/Id": row.id,
            "Result/Time": milliseconds(row.created_at),
            "Result/Verdict": row.verdict,
            "Result/Serial": row.serial,
            "Result/Recipe": row.recipe,
            "Result/Lot": row.lot,
            "Result/Cavity": row.cavity,
            "Result/Cause": None if cause is None else cause.removeprefix(CAUSE),
            "Result/Cause weight": None if cause is None else row.numbers[cause],
        }
        numbers = {
            f"Numbers/{name}": value for name, value in row.numbers.items() if not name.startswith(CAUSE)
        }
        new = [name for name in numbers if name not in self._kinds]
        self._kinds |= dict.fromkeys(new, "Double")
        self._values |= {name: numbers.get(name) for name in self._kinds if name.startswith("Numbers/")}
        return bool(new)

    # Sessions.

    def _connect(self) -> float:
        """Begin a session; returns for how long to wait before the next try, 0 where it is under way."""
        last = self._remembered.bd_seq
        self._remember(bd_seq=Sequence256(last).next())
        self._session += 1
        session = self._session
        client = paho.Client(
            CallbackAPIVersion.VERSION2,
            clean_session=True,
            protocol=paho.MQTTv311,
            reconnect_on_failure=False,
        )
        client.will_set(self._names.topic("NDEATH"), self._death(), qos=1, retain=False)
        if self._broker.user is not None:
            client.username_pw_set(self._broker.user, self._broker.password)
        if self._broker.tls:
            client.tls_set()
        events = self._events
        client.on_connect = lambda _c, _u, _f, code, _p: events.put(
            ("connected", session, code if code.is_failure else None)
        )
        client.on_disconnect = lambda _c, _u, _f, code, _p: events.put(("lost", session, code))
        client.on_publish = lambda _c, _u, mid, _r, _p: events.put(("acknowledged", session, mid))
        client.on_message = lambda _c, _u, message: events.put(("message", session, message))
        try:
            client.connect(self._broker.host, self._broker.port, keepalive=_KEEP_ALIVE_S)
        except (OSError, ValueError) as error:
            return self._later(getattr(error, "strerror", None) or str(error))
        self._client = client
        client.loop_start()
        return 0.0

    def _cut(self, why: str) -> float:
        client, self._client, self._is_online = self._client, None, False
        if client is not None:
            client.loop_stop()
        self._waiting.clear()
        self._lost_at = self._sent
        self._sent = self._remembered.published or 0
        return self._later(why)

    def _later(self, why: str) -> float:
        wait_s = _AGAIN_S[min(self._tries, len(_AGAIN_S) - 1)]
        if self._tries == 0:
            self._say(f"broker {self._broker}: {why}; trying again")
        self._tries += 1
        return wait_s

    def _on_connected(self, _failure: None) -> None:
        assert self._client is not None
        topics = [self._names.topic("NCMD")]
        if self._jobs is not None:
            topics += [self._names.topic("DCMD"), self._names.plain("order"), self._names.plain("stop")]
        self._client.subscribe([(topic, 1) for topic in topics])
        self._is_online, self._tries = True, 0
        self._bear()
        self._say(f"connected to {self._broker}")
        self._look()

    def _death(self) -> bytes:
        return encoded([Metric(BD_SEQ, "Int64", self._remembered.bd_seq)], datetime.now(UTC), None)

    def _die(self) -> None:
        """Publish the deaths, as a clean disconnection sends no last will."""
        client = self._client
        if client is None:
            return
        if self._is_online:
            self._publish("DDEATH", [])
            client.publish(self._names.topic("NDEATH"), self._death(), qos=1).wait_for_publish(5.0)
        client.disconnect()
        client.loop_stop()
        with contextlib.suppress(queue.Empty):  # what the broker acknowledged meanwhile
            while True:
                event = self._events.get_nowait()
                if event[:2] == ("acknowledged", self._session):
                    self._on_acknowledged(event[2])

    def _publish(self, kind: str, metrics: list[Metric]) -> None:
        if self._client is not None:
            payload = encoded(metrics, datetime.now(UTC), self._sequence.next())
            self._client.publish(self._names.topic(kind), payload, qos=0, retain=False)

    def _plain(self, what: str, content: dict[str, Any], *, qos: int = 1) -> int:
        assert self._client is not None
        return self._client.publish(self._names.plain(what), json.dumps(content), qos=qos, retain=False).mid

    def _bear(self) -> None:
        self._sequence.restart()
        node = [Metric(BD_SEQ, "Int64", self._remembered.bd_seq), Metric(REBIRTH, "Boolean", value=False)]
        self._publish("NBIRTH", node)
        self._bear_device()

    def _bear_device(self) -> None:
        values = self._values | {STOP: False, ORDER: ""}
        self._publish("DBIRTH", [Metric(name, kind, values.get(name)) for name, kind in self._kinds.items()])

    # What is published.

    def _look(self) -> None:
        """Publish the inspections that the history has and the broker has not."""
        if not self._is_online:
            return
        try:
            with open_history(self._history, create=False) as history:
                rows = history.after(self._sent, _AT_ONCE)
        except AnisoscopeError as problem:
            self._say(str(problem))
            return
        for row in rows:
            self._result(row)
        if len(rows) == _AT_ONCE:
            self._events.put(("more", self._session))

    def _on_more(self) -> None:
        self._look()

    def _result(self, row: Row) -> None:
        late = row.id <= self._lost_at
        before = dict(self._values)
        if self._take(row):
            self._bear_device()
        changed = [
            Metric(name, kind, self._values.get(name), is_historical=late)
            for name, kind in self._kinds.items()
            if name.startswith("Result/") or self._values.get(name) != before.get(name)
        ]
        self._publish("DDATA", changed)
        content = {
            "id": row.id, "time": row.created_at.isoformat(), "serial": row.serial, "recipe": row.recipe,
            "lot": row.lot, "cavity": row.cavity, "verdict": row.verdict, "reasons": list(row.reasons),
            "numbers": dict(row.numbers), "yield": self._values["Yield"],
        }  # fmt: skip
        self._waiting[self._plain("result", content)] = row.id
        self._sent = row.id

    def _on_acknowledged(self, mid: int) -> None:
        row = self._waiting.pop(mid, None)
        if row is not None and row > (self._remembered.published or 0):
            self._remember(published=row)

    def _on_job(self, kind: str, job: Job) -> None:
        before = {name: self._values.get(name) for name in ("State", "Job")}
        self._state()
        if not self._is_online:
            return
        if kind != "accepted":
            self._look()
            self._answer(job)
        self._publish(
            "DDATA",
            [
                Metric(name, "String", self._values[name])
                for name, old in before.items()
                if self._values[name] != old
            ],
        )
        self._plain("state", {"state": self._values["State"], "job": self._values["Job"]})

    def _answer(self, job: Job) -> None:
        self._plain(
            "answer", {"job": job.id, "state": job.state, "verdict": job.verdict, "problem": job.problem}
        )

    # Commands.

    def _on_message(self, message: paho.MQTTMessage) -> None:
        """Carry a command out, or refuse it in one line: nothing moves then."""
        try:
            if message.retain:
                raise MalformedError("it was retained by the broker: it may be old, and is not carried out")
            if len(message.payload) > LARGEST:
                raise MalformedError(
                    f"the payload has {len(message.payload)} bytes; {LARGEST} are taken at most"
                )
            if message.topic.startswith("spB"):
                self._command(
                    decoded(bytes(message.payload)), is_node=message.topic == self._names.topic("NCMD")
                )
            elif message.topic == self._names.plain("stop"):
                self._stop()
            else:
                self._order(message.payload.decode("utf-8"))
        except (UsageError, RecordError, UnicodeDecodeError) as problem:
            text = str(problem).splitlines()[0]
            self._say(f"{message.topic} refused: {text}")
            why = problem.why if isinstance(problem, Refused) else "malformed"
            self._plain("answer", {"refused": why, "text": text})

    def _command(self, metrics: list[Metric], *, is_node: bool) -> None:
        known = {REBIRTH} if is_node else {ORDER, STOP}
        for one in metrics:
            if one.name not in known:
                raise MalformedError(
                    f"there is no command {one.name[:80]!r}; there are: {', '.join(sorted(known))}"
                )
            wanted = str if one.name == ORDER else bool
            if not isinstance(one.value, wanted):
                raise MalformedError(
                    f"{one.name} takes a {'text' if wanted is str else 'truth value'}, not {str(one.value)[:40]!r}"
                )
        for one in metrics:
            if one.name == REBIRTH and one.value:
                self._bear()
            elif one.name == STOP and one.value:
                self._stop()
            elif one.name == ORDER:
                self._order(str(one.value))

    def _order(self, text: str) -> None:
        assert self._jobs is not None
        try:
            content = json.loads(text)
        except (ValueError, RecursionError):
            raise MalformedError("an order is a JSON object with job, recipe and serial") from None
        self._answer(self._jobs.submit(order_of(content)))

    def _stop(self) -> None:
        assert self._jobs is not None
        found = self._jobs.stop()
        for table, problem in found.items():
            self._say(f"{table}: {problem}")
        self._plain("answer", {"stopped": not found})
