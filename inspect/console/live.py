"""What browsers see of a station: numbered events, of which none is lost, and the live picture with advice."""

import asyncio
import contextlib
import json
import math
import secrets
import threading
from collections import deque
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from anisoscope.base.clock import SYSTEM, Clock
from anisoscope.base.errors import RigError
from anisoscope.base.json_fields import as_json
from anisoscope.rig.hold import HeldLight, SharedCamera
from anisoscope.rig.light import ChannelLight, Light

if TYPE_CHECKING:
    from anisoscope.live_view.lamps import RigLamps
    from anisoscope.parameters.taking import FocusMeasure

MOST_EVENTS = 5000
ALIVE_S = 10.0
LAMP_S = 5.0
LEAST_GAP_S = 0.03
SATURATED_SHARE, DARK_MEAN = 0.001, 0.1
BETTER, WORSE = 1.02, 0.98


class EventLog:
    """The latest events, numbered; threads add them, coroutines wait for them.

    Attributes:
        run: a name of this log, which another one after a restart does not have.
    """

    def __init__(self) -> None:
        self.run = secrets.token_hex(4)
        self._lock = threading.Lock()
        self._events: deque[tuple[int, str, dict[str, Any]]] = deque(maxlen=MOST_EVENTS)
        self._waiting: set[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = set()
        self.number = 0
        self._closed = False

    def close(self) -> None:
        """End all streams, and those to come."""
        with self._lock:
            self._closed = True
            self._wake()

    def _wake(self) -> None:
        for loop, event in self._waiting:
            with contextlib.suppress(RuntimeError):  # its loop has ended
                loop.call_soon_threadsafe(event.set)

    def add(self, kind: str, content: dict[str, Any]) -> None:
        """Add an event and wake who waits."""
        with self._lock:
            self.number += 1
            self._events.append((self.number, kind, content))
            self._wake()

    def after(self, number: int) -> list[tuple[int, str, dict[str, Any]]] | None:
        """Events after a number; None where some of them are gone, or the number is not of this log."""
        with self._lock:
            first = self._events[0][0] if self._events else self.number + 1
            if not first - 1 <= number <= self.number:
                return None
            return [event for event in self._events if event[0] > number]

    def last_seen(self, id_: str) -> int | None:
        """Number of an event's id; None for one of another log."""
        run, _, number = id_.partition("-")
        return int(number) if run == self.run and number.isdigit() else None

    async def stream(
        self,
        last_id: str,
        state: Callable[[], tuple[int, dict[str, Any]]],
        shown: Callable[[dict[str, Any]], dict[str, Any]] = lambda content: content,
    ) -> AsyncIterator[str]:
        """Server-sent events after an id, or the state and what follows it, until the log is closed.

        Args:
            last_id: id of the last event that the reader has; "" for none.
            state: number of the last event and the state, in the language of the reader.
            shown: the content of an event in that language.
        """
        woken = asyncio.Event()
        me = (asyncio.get_running_loop(), woken)
        with self._lock:
            self._waiting.add(me)
        number = self.last_seen(last_id)
        try:
            while not self._closed:
                woken.clear()
                events = None if number is None else self.after(number)
                if events is None:
                    number, content = state()
                    events = [(number, "state", content)]
                else:
                    events = [(number, kind, shown(content)) for number, kind, content in events]
                for number, kind, content in events:
                    data = json.dumps(content, allow_nan=False)
                    yield f"id: {self.run}-{number}\nevent: {kind}\ndata: {data}\n\n"
                if not events:
                    try:
                        async with asyncio.timeout(ALIVE_S):
                            await woken.wait()
                    except TimeoutError:
                        yield ": alive\n\n"
        finally:
            with self._lock:
                self._waiting.discard(me)


@dataclass(frozen=True)
class Eyes:
    """Camera and light of the live picture, its channel where none is named, and how to get the lamps of the rig."""

    camera: SharedCamera
    light: Light | None
    channel: str | None = None
    lamps: "Callable[[], RigLamps] | None" = None


class Live:
    """Live picture with numbers and advice; taken on request, once for all who look.

    Args:
        eyes: camera and light; None where the rig has none at hand.
        clock: a monotonic clock in seconds.
        gap_s: time between two pictures at least, in seconds; who asks earlier gets the one before.
        measure: measure of sharpness.
    """

    def __init__(
        self,
        eyes: Eyes | None,
        clock: Clock = SYSTEM,
        gap_s: float = LEAST_GAP_S,
        measure: "FocusMeasure" = "tenengrad",
    ) -> None:
        from anisoscope.live_view.view import Meter

        self._eyes, self._clock, self._gap_s = eyes, clock, gap_s
        self._measure: FocusMeasure = measure
        self._lock = threading.Lock()
        self._new_meter: Callable[[], Meter] = Meter
        self._meter = Meter()
        self._newest: tuple[float, tuple[float, float, str | None], bytes, dict[str, Any]] | None = None
        self._lit = False
        self._paused = False
        self._off: threading.Timer | None = None

    def look(
        self, exposure_s: float, gain: float, channel: str | None = None
    ) -> tuple[bytes, dict[str, Any]]:
        """The newest picture as JPEG, and its numbers with advice.

        Args:
            exposure_s: exposure.
            gain: gain of the camera.
            channel: of the light; None takes the usual one.

        Raises:
            RigError: there is no camera, or the rig is at work.
        """
        from anisoscope.live_view.picture import as_jpeg, draw
        from anisoscope.live_view.view import look_at

        with self._lock:
            if self._paused:
                raise RigError("the rig is at work: its frames are shown as they come")
            if self._eyes is None:
                raise RigError("the camera of the rig cannot be used here")
            asked = (exposure_s, gain, channel or self._eyes.channel)
            if self._newest is not None and self._newest[1] != asked:
                self._new_sequence()
                self._darken()  # another channel may be wanted
            if self._newest is not None and self._clock() - self._newest[0] < self._gap_s:
                return self._newest[2:]
            if not self._lit and self._eyes.light is not None:
                if asked[2] is not None and isinstance(self._eyes.light, (ChannelLight, HeldLight)):
                    self._eyes.light.select(asked[2])
                self._eyes.light.on()
                self._lit = True
            counts, info = self._eyes.camera.grab(exposure_s, gain), self._eyes.camera.info
            now_s, lamps = self._clock(), self._eyes.lamps
            read = () if lamps is None else lamps().read(counts, info, (exposure_s, gain), now_s, asked[2])
            reading = self._meter.read(look_at(counts, info, focus=self._measure), now_s, read)
            view, before = reading.view, None if self._newest is None else self._newest[3]["focus"]
            numbers = as_json(reading) | {
                "advice": [
                    *exposure_advice(view.mean, view.saturated_share),
                    *focus_advice(view.focus, before, reading.relative_focus),
                ],
            }
            jpeg = as_jpeg(draw(counts, info, view, reading.relative_focus))
            self._newest = (self._clock(), asked, jpeg, numbers)
            self._lamp_off_later()
            return jpeg, numbers

    def _new_sequence(self) -> None:
        self._meter, self._newest = self._new_meter(), None
        if self._eyes is not None and self._eyes.lamps is not None:
            self._eyes.lamps().forget()

    def _lamp_off_later(self) -> None:
        if self._off is not None:
            self._off.cancel()
        self._off = threading.Timer(LAMP_S, self._rest)
        self._off.daemon = True
        self._off.start()

    def _rest(self) -> None:
        with self._lock:
            self._darken()

    def _darken(self) -> None:
        if self._lit and self._eyes is not None and self._eyes.light is not None:
            self._lit = False
            with contextlib.suppress(RigError):  # who uses the rig next says what is wrong with it
                self._eyes.light.off()

    def pause(self) -> None:
        """Leave camera and light to others."""
        with self._lock:
            if self._off is not None:
                self._off.cancel()
            self._darken()
            self._paused, self._newest = True, None

    def go_on(self) -> None:
        """Take pictures again, on request."""
        with self._lock:
            self._paused = False
            self._new_sequence()


def exposure_advice(mean: float, saturated_share: float) -> list[str]:
    """Advice on the exposure, in English; empty where it is right."""
    if saturated_share > SATURATED_SHARE:
        return ["too bright: shorten the exposure"]
    return ["too dark: lengthen the exposure"] if mean < DARK_MEAN else []


def focus_advice(focus: float, before: float | None, relative: float) -> list[str]:
    """In which direction to go on with the focus, from the last two pictures; empty where neither is sharper."""
    if not math.isfinite(focus) or before is None or before <= 0.0:
        return []
    if focus > BETTER * before:
        return ["sharper: go on in this direction"]
    if focus < WORSE * before or relative < 0.9:
        return ["less sharp than it was: go back"]
    return []
