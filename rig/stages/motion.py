"""The rules of motion that every driver of a stage keeps.

A stage has arrived when it is not busy *and* stands at the target; the time for a move follows from distance
and velocity, and running out of it raises and stops; limits are checked before the move; an absolute move
needs a reference search first; stop works from another thread. Angles are in degrees; of a linear stage
(``unit = "mm"``) all these numbers are millimetres.
"""

import collections
import contextlib
import logging
import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Self

from anisoscope.base.clock import SYSTEM, Clock
from anisoscope.base.errors import LimitExceeded, MotionTimeout, NotHomed, RigError
from anisoscope.base.language import message
from anisoscope.rig.stage import (
    SYMBOLS,
    MotionRules,
    MotionState,
    Unit,
    apart_deg,
    between_readings,
    check_limits,
)

POLL_S = 0.1
SETTLE_S = 0.2
LOST_REFERENCE_TOLERANCES = 10.0
READING_S = 0.05  # what a motion waits for a reading of another thread
SAMPLE_S = 0.25
# A stage that reports motion and gets on by less than this share of its speed for so long does not move.
WORD_S = 8.0  # so long a motion goes on without a word of what is waited for
STANDSTILL_S, STANDSTILL_SHARE, STANDSTILL_SAMPLES = 3.0, 0.001, 6


_waiting = logging.getLogger("anisoscope.waiting")  # which every command prints


class _Underway(Exception):
    """A motion of this connection goes on."""


class StageBase(ABC):
    """Motion rules common to all stages; a driver adds query, start and stop.

    Errors of every motion: `NotConnected`, `ProtocolError`, `Stalled` from the driver; `MotionTimeout`,
    `LimitExceeded`, `NotHomed` from here; plain `RigError` for a move that was stopped by another thread.
    """

    unit: Unit = "deg"
    home_deg = 0.0
    search_turns = 2.0  # of all that it can turn, the way of a reference search at most

    def __init__(
        self, name: str, rules: MotionRules, limits_deg: tuple[float, float], resolution_deg: float
    ) -> None:
        self._name = name
        self.rules = rules
        self._limits_deg = limits_deg
        self._resolution_deg = resolution_deg
        self._motion = threading.Lock()
        # A driver whose device shares its port with others puts the lock of the port here.
        self._bus: contextlib.AbstractContextManager[object] = contextlib.nullcontext()
        self._stopping = threading.Event()
        self._homed = False
        self._left_at_deg: float | None = None
        self._samples: collections.deque[tuple[float, float]] = collections.deque()

    # What the driver adds.

    @abstractmethod
    def _read_deg(self) -> float:
        """Query the angle in degrees."""

    @abstractmethod
    def _begin_home(self) -> None:
        """Send the command that starts the reference search."""

    @abstractmethod
    def _begin_move(self, target_deg: float) -> None:
        """Send the command that starts an absolute move."""

    @abstractmethod
    def _is_busy(self, wait_s: float) -> bool:
        """Wait up to `wait_s` seconds for the end of the motion; return whether it still goes on."""

    def _is_surely_busy(self) -> bool:
        """Query at the end of a move's time whether the stage still moves."""
        return self._is_busy(0.0)

    def _read_moving_deg(self) -> float | None:
        """Query the angle in degrees during a motion; None where the device does not report it then."""
        return None

    def _slowed(self) -> tuple[float, str]:
        """Factor by which a setting at the device makes motions longer, and the words for it."""
        return 1.0, ""

    @abstractmethod
    def _send_stop(self) -> None:
        """Send the stop command without waiting for anything; called from any thread."""

    @abstractmethod
    def _disconnect(self) -> None:
        """Close the connection."""

    # What every stage does.

    def _shown(self, value: float, digits: int = 4) -> str:
        """A number in the unit, for messages."""
        return f"{value:.{digits}g}{SYMBOLS[self.unit]}"

    def _away(self, at: float, target: float) -> float:
        """How far a reading is from another, in the unit: of what turns, readings a turn apart are the same place."""
        return abs(apart_deg(at, target) if self.unit == "deg" else at - target)

    @property
    def name(self) -> str:
        """Model and serial number, for records."""
        return self._name

    @property
    def _clock(self) -> Clock:
        """Time by which motions are waited for."""
        return SYSTEM

    @property
    def limits_deg(self) -> tuple[float, float]:
        """Lowest and highest permitted angle in degrees."""
        return self._limits_deg

    @property
    def resolution_deg(self) -> float:
        """Smallest step in degrees."""
        return self._resolution_deg

    @property
    def is_homed(self) -> bool:
        """Whether the reference search was done since the connection was made, and not lost since."""
        return self._homed

    def position_deg(self) -> float:
        """Read the angle in degrees; during a move of another thread this waits for its end.

        Raises:
            NotHomed: the reference was lost since it was searched: the device says so, or it does not stand where the
                last motion left it, by more than ten times its tolerance. The reading means nothing then.
        """
        with self._motion, self._bus:
            referenced = self._homed  # some devices say with the reading that they have lost it
            now_deg = self._read_deg()
            if referenced:
                self._check_reference(now_deg)
            return now_deg

    def motion_state(self) -> MotionState:
        """State of the motion, without waiting for its end; may be called from any thread.

        A motion of this connection is known by it; any other one by two readings.
        """
        try:
            return between_readings(self._read_at_rest, 2.0 * self._resolution_deg, self._clock)
        except _Underway:
            samples = list(self._samples)[-2:]
            if len(samples) < 2 or samples[1][0] <= samples[0][0]:
                return MotionState(True, samples[-1][1] if samples else None, None)
            (before_s, before_deg), (now_s, now_deg) = samples
            return MotionState(True, now_deg, (now_deg - before_deg) / (now_s - before_s))

    def _read_at_rest(self) -> float:
        if not self._motion.acquire(blocking=False):
            raise _Underway
        try:
            with self._bus:
                return self._read_deg()
        finally:
            self._motion.release()

    def home(self) -> float:
        """Search the reference and return the angle read back, in degrees."""
        with self._one_motion():
            self._homed = False
            low, high = self._limits_deg
            span = max(high - low, 360.0) if self.unit == "deg" else high - low
            limit_s = self.search_turns * self.rules.timeout_s(span)
            reached = self._move("home", self._begin_home, self.home_deg, limit_s)
            self._homed = True
            return reached

    def move_to(self, angle_deg: float) -> float:
        """Move to an angle in degrees and return the angle read back.

        Raises:
            NotHomed: no reference search yet, or the reference was lost.
            LimitExceeded: the target is outside the limits; nothing was sent.
            MotionTimeout: not there in the time that the distance needs; the stage was stopped.
        """
        with self._one_motion():
            return self._move_to(angle_deg)

    def move_by(self, delta_deg: float) -> float:
        """Move by an angle in degrees and return the angle read back; errors as for `move_to`."""
        with self._one_motion():
            return self._move_to(self._read_deg() + delta_deg)

    def stop(self) -> None:
        """Stop at once, from any thread; a move that waits in another thread ends with a `RigError`."""
        self._stopping.set()
        self._send_stop()
        if self._motion.acquire(timeout=self.rules.margin_s):
            try:
                with self._bus:
                    self._wait_until_still()
            finally:
                self._motion.release()

    def close(self) -> None:
        """Stop if a move is under way, and disconnect; closing twice is fine."""
        if self._motion.locked():
            with contextlib.suppress(RigError):
                self.stop()
        self._homed = False
        self._disconnect()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @contextlib.contextmanager
    def _one_motion(self) -> Iterator[None]:
        if not self._motion.acquire(timeout=READING_S):
            raise RigError(f"{self.name} is moving already; wait for it, or stop it first")
        try:
            with self._bus:
                self._stopping.clear()
                yield
        finally:
            self._motion.release()

    def _move_to(self, angle_deg: float) -> float:
        if not math.isfinite(angle_deg):
            raise LimitExceeded(f"{self.name}: {angle_deg} is no place to move to; give a number")
        if not self._homed:
            raise NotHomed(f"{self.name} was not homed; search the reference before moving to an angle")
        check_limits(self, angle_deg)
        start = self._read_deg()
        self._check_reference(start)
        timeout_s = self.rules.timeout_s(angle_deg - start)
        return self._move(
            f"move to {self._shown(angle_deg)}", lambda: self._begin_move(angle_deg), angle_deg, timeout_s
        )

    def _check_reference(self, now_deg: float) -> None:
        """Refuse a stage that is not at its last position: a power cycle or a hand has lost its count."""
        if self._left_at_deg is None:
            return
        if self._away(now_deg, self._left_at_deg) > LOST_REFERENCE_TOLERANCES * self.rules.tolerance_deg:
            self._homed = False
            raise NotHomed(
                f"{self.name} stands at {self._shown(now_deg)} but was left at {self._shown(self._left_at_deg)}: "
                "it was switched off or moved by hand; home it again"
            )

    def _off_target(self, what: str, at_deg: float, target_deg: float) -> MotionTimeout:
        away_deg = self._away(at_deg, target_deg)
        at, away, target = (
            self._shown(one, digits) for one, digits in ((at_deg, 6), (away_deg, 3), (target_deg, 6))
        )
        text = f"{self.name}: the {what} ended at {at}, {away} from {target}"
        if away_deg > LOST_REFERENCE_TOLERANCES * self.rules.tolerance_deg:
            self._homed = False
            return MotionTimeout(f"{text}; home it again")
        return MotionTimeout(f"{text}; check load and backlash, or raise tolerance_{self.unit} of the driver")

    def _move(self, what: str, begin: Callable[[], None], target_deg: float, timeout_s: float) -> float:
        self._left_at_deg = None
        self._samples.clear()
        try:
            begin()
            reached = self._await(what, target_deg, timeout_s)
        except BaseException:
            with contextlib.suppress(RigError):
                self._send_stop()
                self._wait_until_still()
            raise
        self._left_at_deg = reached
        return reached

    def _await(self, what: str, target_deg: float, timeout_s: float) -> float:
        short_since: float | None = None
        begun = told = self._clock()
        deadline = begun + timeout_s  # from here: a busy computer may have taken long to send the command
        factor = 1.0
        while True:
            if self._clock() - told >= WORD_S:
                told = self._clock()
                spent, limit = f"{told - begun:.0f}", f"{deadline - begun:.0f}"
                _waiting.warning(
                    message(
                        "{name} has moved for {time} s; it may take {limit} s",
                        name=self.name,
                        time=spent,
                        limit=limit,
                    )
                )
            if self._clock() >= deadline and self._slowed()[0] > factor:
                factor, why = self._slowed()
                deadline = begun + factor * timeout_s
                _waiting.warning(
                    "%s: %s; the %s may take up to %.0f s", self.name, why, what, deadline - begun
                )
            left_s = deadline - self._clock()
            busy = self._is_busy(min(POLL_S, left_s)) if left_s > 0.0 else self._is_surely_busy()
            if self._stopping.is_set():
                self._send_stop()
                self._wait_until_still()
                raise RigError(f"{self.name}: the {what} was stopped at {self._shown(self._read_deg())}")
            if busy:
                self._observe(what)
            at_deg = self._read_deg() if not busy else math.nan
            if self._away(at_deg, target_deg) <= self.rules.tolerance_deg:
                return at_deg
            now = self._clock()
            short_since = None if busy else short_since or now
            if short_since is not None and now - short_since >= SETTLE_S:
                raise self._off_target(what, at_deg, target_deg)
            if left_s <= 0.0:
                raise MotionTimeout(
                    f"{self.name}: the {what} did not end within {deadline - begun:.1f} s, and was stopped; look for "
                    f"an obstacle, or correct velocity_{self.unit}_s of the driver"
                )

    def _observe(self, what: str) -> None:
        """Sample the angle of a moving stage; raise where it reports motion and rests."""
        now = self._clock()
        if self._samples and now - self._samples[-1][0] < SAMPLE_S:
            return
        at_deg = self._read_moving_deg()
        if at_deg is None:
            return
        self._samples.append((now, at_deg))
        while len(self._samples) > 2 and now - self._samples[1][0] >= STANDSTILL_S:
            self._samples.popleft()
        since_s = now - self._samples[0][0]
        # few samples in a long time: this computer slept, and the next answer may be one of before
        if since_s < STANDSTILL_S or len(self._samples) < STANDSTILL_SAMPLES:
            return
        least_deg = max(2.0 * self._resolution_deg, STANDSTILL_SHARE * self.rules.velocity_deg_s * since_s)
        places = [place for _, place in self._samples]
        if max(places) - min(places) < least_deg:
            raise MotionTimeout(
                f"{self.name}: the {what} does not get on: it reports motion and has stood at {self._shown(at_deg)} "
                f"for {since_s:.0f} s; look for an obstacle, or switch it off and on"
            )

    def _wait_until_still(self) -> None:
        """After a stop command: read pending messages until the device is at rest."""
        deadline = self._clock() + self.rules.margin_s
        while self._is_busy(min(POLL_S, self.rules.margin_s)):
            if self._clock() >= deadline:
                return
