"""Facts of all inspections in memory, a few bytes each, for questions over all of them at once.

A history is append-only: what was read once stands, and only what came since is read again. A query of a database that
groups all rows would read all of their numbers, reasons and hashes from the medium every time.
"""

import re
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from sqlalchemy import Connection, case, func, null, select

from anisoscope.history.columns import parsed_labels, to_us
from anisoscope.history.filters import Filters
from anisoscope.history.rows import CAUSE
from anisoscope.history.schema import inspections, layouts
from anisoscope.history.store import History

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
WORDS = ("product", "station", "lot", "cavity", "operator", "verdict", "cause")
_ALIKE = ("product", "station", "lot", "cavity", "operator", "verdict")
_AT_ONCE = 5000
_EXTENT = re.compile(r" \([^()]*\)")
_NUMBER = re.compile(r"[-+±−]*\d+(?:[.,]\d+)*(?:e[-+]?\d+)?", re.IGNORECASE)
_LONGEST = 120


def cause_of(labels: tuple[str, ...], reasons: tuple[str, ...]) -> str:
    """Why a part did not pass: the diagnosed cause, else the first reason of the verdict without its numbers.

    Args:
        labels: of its numbers, which name a diagnosed cause: see `anisoscope.history.rows.numbers_of`.
        reasons: of the verdict.
    """
    known = next((label.removeprefix(CAUSE) for label in labels if label.startswith(CAUSE)), None)
    if known is not None:
        return known
    first = _NUMBER.sub("…", _EXTENT.sub("", reasons[0])) if reasons else "no reason recorded"
    return first if len(first) <= _LONGEST else f"{first[: _LONGEST - 1]}…"


@dataclass(frozen=True, eq=False)
class Facts:
    """Inspections in the order of their ids.

    Attributes:
        ids: (n,).
        times: (n,) microseconds since 1970.
        codes: (n,) by the names of `WORDS`: places in ``words``.
        words: by the same names; the first is "" for what was not stated. Parts that passed have no cause.
    """

    ids: IntArray
    times: IntArray
    codes: Mapping[str, npt.NDArray[np.int32]]
    words: Mapping[str, tuple[str, ...]]

    def __len__(self) -> int:
        return len(self.ids)

    def matching(self, filters: Filters, cause: str | None = None) -> BoolArray:
        """(n,) which of them meet all conditions; serial number, recipe, ids and limit are no matter here."""
        found = np.ones(len(self), dtype=np.bool_)
        wanted = {name: getattr(filters, name) for name in _ALIKE} | {"cause": cause}
        for name, word in wanted.items():
            if word is not None:
                known = self.words[name]
                found &= self.codes[name] == known.index(word) if word in known else False
        if filters.since is not None:
            found &= self.times >= to_us(filters.since)
        if filters.until is not None:
            found &= self.times < to_us(filters.until)
        return found

    def ordered(self, chosen: BoolArray) -> IntArray:
        """Places of the chosen ones, the oldest first."""
        places = np.flatnonzero(chosen)
        return places[np.argsort(self.times[places], kind="stable")]

    def counts(self, name: str, chosen: BoolArray) -> dict[str, int]:
        """How many of the chosen ones have which word, the most frequent first; words that none has are left out."""
        number = np.bincount(self.codes[name][chosen], minlength=len(self.words[name]))
        order = np.argsort(-number, kind="stable")
        return {self.words[name][k]: int(number[k]) for k in order if number[k]}


_NOTHING = np.empty(0, np.int64)
_NONE = Facts(_NOTHING, _NOTHING, dict.fromkeys(WORDS, np.empty(0, np.int32)), dict.fromkeys(WORDS, ("",)))


@dataclass(eq=False)
class Overview:
    """Facts of a history that are brought up to date at every question; several threads may ask."""

    _lock: threading.Lock = field(default_factory=threading.Lock)
    _facts: Facts | None = None
    _words: dict[str, dict[str, int]] = field(default_factory=dict)
    _last: bytes = b""

    def facts(self, history: History | None) -> Facts:
        """The facts of all inspections that a history has now; None is one without inspections.

        Raises:
            HistoryError: the history cannot be read.
        """
        if history is None:
            return _NONE
        with self._lock, history.reading() as connection:
            if self._facts is None or not self._continues(connection, self._facts):
                self._words = {name: {"": 0} for name in WORDS}
                self._facts = _NONE
            self._facts = self._grown(connection, self._facts)
            return self._facts

    def _continues(self, connection: Connection, facts: Facts) -> bool:
        """Whether the last known inspection is what it was; else this is another history, or one that was restored."""
        if not len(facts):
            return False
        table = inspections.c
        found = connection.scalar(select(table.hash).where(table.id == int(facts.ids[-1])))
        return found is not None and bytes(found) == self._last

    def _grown(self, connection: Connection, facts: Facts) -> Facts:
        last = int(facts.ids[-1]) if len(facts) else 0
        labels = {
            int(row[0]): parsed_labels(row[1])
            for row in connection.execute(select(layouts.c.id, layouts.c.labels))
        }
        table = inspections.c
        why = case((table.verdict == "PASS", null()), else_=table.reasons)
        words = (func.coalesce(table[name], "") for name in _ALIKE)
        statement = select(table.id, table.created_us, table.hash, table.layout, why, *words)
        statement = statement.where(table.id > last).order_by(table.id)
        found = connection.execute(
            statement, execution_options={"stream_results": True, "yield_per": _AT_ONCE}
        )
        parts = [facts, *(self._part(list(map(tuple, some)), labels) for some in found.partitions(_AT_ONCE))]
        if len(parts) == 1:
            return facts
        return Facts(
            np.concatenate([one.ids for one in parts]),
            np.concatenate([one.times for one in parts]),
            {name: np.concatenate([one.codes[name] for one in parts]) for name in WORDS},
            {name: tuple(known) for name, known in self._words.items()},
        )

    def _part(self, rows: list[tuple[Any, ...]], labels: Mapping[int, tuple[str, ...]]) -> Facts:
        ids, times, hashes, kinds, why, *columns = zip(*rows, strict=True)
        causes = [
            "" if one is None else cause_of(labels[kind], parsed_labels(one))
            for kind, one in zip(kinds, why, strict=True)
        ]
        codes = {}
        for name, column in zip(WORDS, (*columns, causes), strict=True):
            known = self._words[name]
            codes[name] = np.array([known.setdefault(word, len(known)) for word in column], np.int32)
        self._last = bytes(hashes[-1])
        return Facts(np.array(ids, np.int64), np.array(times, np.int64), codes, {})
