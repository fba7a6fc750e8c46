"""Collisions: combinations of axes that a rig file forbids, checked before a motion and along its way.

A row of ``[[collisions]]`` forbids readings of two or more axes at the same time. Axes move one after the other, so
the way of a motion is a line along one axis while the others stand: a row forbids it where the line meets the range of
the axis that moves and all others stand in theirs. An axis that was not homed may stand anywhere.
"""

import itertools
import math
import re
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Literal, NoReturn

from pydantic import field_validator, model_validator

from anisoscope.base.errors import LimitExceeded, RigError
from anisoscope.base.toml_file import Part
from anisoscope.rig.stage import FULL_TURN_DEG, SYMBOLS, RotationStage, turns_round, unit_of

AxisTable = Literal["stage", "tilt", "x", "y", "z"]
Range = tuple[float, float]
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"
_RANGE = re.compile(
    rf"\s*(?:(?P<side>[<>])\s*(?P<end>{_NUMBER})|(?P<low>{_NUMBER})\s*\.\.\s*(?P<high>{_NUMBER}))\s*"
)


class Collision(Part):
    """A row: readings of two or more axes that are forbidden together, as ``"> 10"``, ``"< 2"`` or ``"80 .. 100"``.

    Readings in degrees or mm, as `min_deg` and `max_mm` of an axis have them; the ends themselves are allowed.
    """

    stage: str | None = None
    tilt: str | None = None
    x: str | None = None
    y: str | None = None
    z: str | None = None
    why: str = ""

    @field_validator("stage", "tilt", "x", "y", "z")
    @classmethod
    def _is_a_range(cls, text: str | None) -> str | None:
        if text is not None:
            low, high = _range_of(text)
            if not low < high:
                raise ValueError(f"{text!r}: the range ends below its beginning")
        return text

    @model_validator(mode="after")
    def _two_axes(self) -> "Collision":
        if len(self.ranges) < 2:
            raise ValueError(
                'a row names two axes or more, such as { tilt = "> 10", z = "< 2" }; one axis alone has min and max '
                "among its options"
            )
        return self

    @property
    def ranges(self) -> dict[str, Range]:
        """Forbidden open interval of every axis that is named."""
        texts = {name: getattr(self, name) for name in ("stage", "tilt", "x", "y", "z")}
        return {name: _range_of(text) for name, text in texts.items() if text is not None}

    def __str__(self) -> str:
        row = ", ".join(f"{name} {getattr(self, name)}" for name in self.ranges)
        return f"{row} ({self.why})" if self.why else row


def _range_of(text: str) -> Range:
    found = _RANGE.fullmatch(text)
    if found is None:
        raise ValueError(f'{text!r} is no range of readings: write "> 10", "< 2" or "80 .. 100"')
    if found["side"] is None:
        return float(found["low"]), float(found["high"])
    end = float(found["end"])
    return (end, math.inf) if found["side"] == ">" else (-math.inf, end)


class Guard:
    """The rows of a rig and its open axes.

    Args:
        rows: forbidden combinations.
        axes: all axes that the rows name, by their tables.
        home_order: axes whose reference search in this order is safe, wherever those that follow stand.
    """

    def __init__(
        self,
        rows: Sequence[Collision],
        axes: Mapping[str, RotationStage],
        home_order: Sequence[str] = (),
    ) -> None:
        self._rows, self._axes, self._home_order = tuple(rows), dict(axes), tuple(home_order)
        self._lock = threading.Lock()

    def guarded(self, table: str) -> "GuardedStage":
        """An axis that refuses what collides."""
        return GuardedStage(self._axes[table], table, self)

    @contextmanager
    def motion(self, table: str, *targets: float) -> Iterator[None]:
        """Allow one motion of an axis from its position over target readings; a reference search without any.

        Raises:
            LimitExceeded: a row forbids it; it is named, and nothing was moved.
            RigError: another axis moves.
        """
        if not self._lock.acquire(blocking=False):
            raise RigError(
                f"another axis of this rig moves; with [[collisions]] one moves after the other: wait, and move the "
                f"{table} again"
            )
        try:
            here = self._stands(table) if targets else None
            way = targets if here is None else (here, *targets)
            self._check(table, way or self._axes[table].limits_deg, self._stands, home=not targets)
            yield
        finally:
            self._lock.release()

    def order(
        self, ways: Mapping[str, Sequence[float]], standing: Mapping[str, float] | None = None
    ) -> tuple[str, ...]:
        """Order in which axes can go their ways, the order of `ways` if it is free.

        Args:
            ways: readings over which every axis goes, its target last.
            standing: readings where the axes stand; those of the devices by default.

        Raises:
            LimitExceeded: no order is free; the row that forbids the first one is named.
        """
        concerned = {name for row in self._rows for name in row.ranges}
        start = {name: standing.get(name) if standing else self._stands(name) for name in concerned}
        refused: LimitExceeded | None = None
        for tried in itertools.permutations(ways):
            at: dict[str, float | None] = dict(start)
            try:
                for name in tried:
                    if name not in concerned:
                        continue
                    here = at[name]
                    self._check(name, ways[name] if here is None else (here, *ways[name]), at.get)
                    at[name] = ways[name][-1]
            except LimitExceeded as problem:
                refused = refused or problem
            else:
                return tried
        assert refused is not None
        raise refused

    def check_together(self, readings: Mapping[str, float]) -> None:
        """Check that axes may have these readings at the same time; errors as for `order`."""
        for name, reading in readings.items():
            self._check(name, (reading,), readings.get)

    def _stands(self, table: str) -> float | None:
        axis = self._axes[table]
        return axis.position_deg() if axis.is_homed else None

    def _check(
        self,
        table: str,
        way: Sequence[float],
        standing: Callable[[str], float | None],
        *,
        home: bool = False,
    ) -> None:
        low, high = min(way), max(way)
        for row in self._rows:
            ranges = row.ranges
            if table not in ranges or not self._meets(table, low, high, ranges[table]):
                continue
            passed_over = self._after(table) if home else ()
            others = {name: standing(name) for name in ranges if name != table and name not in passed_over}
            if home and not others:
                continue
            if any(
                at is not None and not self._inside(name, at, ranges[name]) for name, at in others.items()
            ):
                continue
            self._refuse(table, row, others, home=home)

    def _after(self, table: str) -> tuple[str, ...]:
        """Axes that search their references after this one."""
        order = self._home_order
        return order[order.index(table) + 1 :] if table in order else ()

    def _inside(self, table: str, at: float, forbidden: Range) -> bool:
        slack = (
            2.0 * self._axes[table].resolution_deg
        )  # an axis that was sent to the end of a range stands about there
        return self._meets(table, at, at, (forbidden[0] + slack, forbidden[1] - slack))

    def _meets(self, table: str, low: float, high: float, forbidden: Range) -> bool:
        """Whether a way meets a range; that of a stage that turns round lies in every turn, but for an open one."""
        first, last = forbidden
        if table == "stage" and turns_round(self._axes[table].limits_deg) and math.isfinite(last - first):
            turns = FULL_TURN_DEG * (math.floor((low - last) / FULL_TURN_DEG) + 1)
            first, last = first + turns, last + turns
        return first < high and low < last

    def _refuse(
        self, table: str, row: Collision, others: Mapping[str, float | None], *, home: bool
    ) -> NoReturn:
        doing = "homing" if home else "moving"
        stands = [
            f"the {name} stands at {at:.4g}{SYMBOLS[unit_of(self._axes[name])]}"
            for name, at in others.items()
            if at is not None
        ]
        unknown = " and ".join(f"the {name}" for name, at in others.items() if at is None)
        stands += [f"where {unknown} stands is not known before homing"] if unknown else []
        text = f"{doing} the {table} may collide: [[collisions]] forbids {row}, and {' and '.join(stands)}"
        if not unknown:
            raise LimitExceeded(f"{text}; nothing was moved: move {' or '.join(others)} first")
        also = f", or name {table} before it in home_order of the rig file, if that is safe" if home else ""
        raise LimitExceeded(f"{text}; nothing was moved: home {unknown} first{also}")


class GuardedStage:
    """An axis of a rig with forbidden combinations; see `Guard`."""

    def __init__(self, stage: RotationStage, table: str, guard: Guard) -> None:
        self._stage, self._table, self._guard = stage, table, guard

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - what its driver has beyond the protocol
        return getattr(self._stage, name)

    @property
    def name(self) -> str:
        """Model and serial number, for records."""
        return self._stage.name

    @property
    def limits_deg(self) -> Range:
        """Lowest and highest permitted reading."""
        return self._stage.limits_deg

    @property
    def resolution_deg(self) -> float:
        """Smallest step."""
        return self._stage.resolution_deg

    @property
    def is_homed(self) -> bool:
        """Whether its reference is known."""
        return self._stage.is_homed

    def position_deg(self) -> float:
        """The reading."""
        return self._stage.position_deg()

    def home(self) -> float:
        """Search the reference; return the reading. Errors as for `Guard.motion`, too."""
        with self._guard.motion(self._table):
            return self._stage.home()

    def move_to(self, angle_deg: float) -> float:
        """Move to a reading; return the one reached. Errors as for `Guard.motion`, too."""
        with self._guard.motion(self._table, angle_deg):
            return self._stage.move_to(angle_deg)

    def move_by(self, delta_deg: float) -> float:
        """Move by an amount; return the reading reached. Errors as for `Guard.motion`, too."""
        with self._guard.motion(self._table, self._stage.position_deg() + delta_deg):
            return self._stage.move_by(delta_deg)

    def stop(self) -> None:
        """Stop at once."""
        self._stage.stop()

    def close(self) -> None:
        """Disconnect."""
        self._stage.close()
