"""Cycle data of machines in the history: numbers by time or serial number, in a chain of their own.

A part takes the data that name its serial number; other data hold for the parts that are inspected after them, for a
day at most. Each number is looked for by itself, so that several machines and files add to one part.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
import numpy.typing as npt
from sqlalchemy import Connection, insert, select

from anisoscope.history import schema
from anisoscope.history.chain import COVARIATE_FIELDS, digest_of, hash_of, pack, unpack
from anisoscope.history.columns import parsed_labels, to_us
from anisoscope.history.rows import storable
from anisoscope.history.statements import head, layout_of

LONGEST_US = 86_400_000_000
"""For so long, in microseconds, data without a serial number hold for the parts that come after them."""
_AT_ONCE = 500
_TABLE = schema.covariates


@dataclass(frozen=True, kw_only=True)
class CycleData:
    """Numbers of a machine that are to enter the history.

    Attributes:
        at: when they were measured; None if it was not said.
        serial: of the part that they belong to, or None; one of both is given.
        source: file or device that they come from.
        numbers: by label.
    """

    at: datetime | None
    serial: str | None
    source: str
    numbers: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Covariates:
    """Cycle data of a history, in the order in which they were added.

    Attributes:
        times: (n,) microseconds since 1970, -1 where no time was said.
        serials: n serial numbers, "" where none was said.
        numbers: (n,) by label; NaN where they do not have the number.
    """

    times: npt.NDArray[np.int64]
    serials: tuple[str, ...]
    numbers: Mapping[str, npt.NDArray[np.float64]]

    def of_parts(
        self, serials: Sequence[str], times: npt.NDArray[np.int64]
    ) -> dict[str, npt.NDArray[np.float64]]:
        """The numbers of inspected parts, (m,) by label; NaN where there is none.

        Args:
            serials: m serial numbers.
            times: (m,) when they were inspected, in microseconds since 1970.
        """
        return {label: self._joined(column, serials, times) for label, column in self.numbers.items()}

    def _joined(
        self, column: npt.NDArray[np.float64], serials: Sequence[str], moments: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.float64]:
        there = np.flatnonzero(~np.isnan(column))
        own: dict[str, list[int]] = {}
        for place in there.tolist():
            if self.serials[place]:
                own.setdefault(self.serials[place], []).append(place)
        common = np.array([place for place in there.tolist() if not self.serials[place]], dtype=np.int64)
        common = common[np.argsort(self.times[common], kind="stable")]
        found = np.full(len(serials), np.nan)
        last = np.searchsorted(self.times[common], moments, side="right") - 1
        for number, (serial, moment) in enumerate(zip(serials, moments.tolist(), strict=True)):
            mine = [place for place in own.get(serial, ()) if self.times[place] <= moment]
            if mine:
                found[number] = column[max(mine, key=lambda place: (self.times[place], place))]
            elif last[number] >= 0 and moment - self.times[common[last[number]]] <= LONGEST_US:
                found[number] = column[common[last[number]]]
        return found


def append_covariates(connection: Connection, news: Sequence[CycleData]) -> int:
    """Append cycle data; those that are there already are passed over.

    Args:
        connection: in a transaction that writes.
        news: the data.

    Returns:
        How many are new.
    """
    rows = {bytes(row["digest"]): row for row in map(_columns, news)}
    keys = list(rows)
    for start in range(0, len(keys), _AT_ONCE):
        some = keys[start : start + _AT_ONCE]
        for known in connection.scalars(select(_TABLE.c.digest).where(_TABLE.c.digest.in_(some))):
            del rows[bytes(known)]
    last, previous = head(connection, _TABLE)
    layouts: dict[str, int] = {}
    added = []
    for row in rows.values():
        last += 1
        labels = row.pop("labels")
        if labels not in layouts:
            layouts[labels] = layout_of(connection, labels)
        row |= {"id": last, "previous": previous, "layout": layouts[labels]}
        previous = row["hash"] = hash_of("covariates", COVARIATE_FIELDS, row | {"labels": labels})
        added.append(row)
    for start in range(0, len(added), _AT_ONCE):
        connection.execute(insert(_TABLE), added[start : start + _AT_ONCE])
    return len(added)


def _columns(new: CycleData) -> dict[str, Any]:
    """The columns of cycle data without id and hashes; the digest is that of everything but the source."""
    labels = json.dumps([storable(one) for one in new.numbers], ensure_ascii=False, separators=(",", ":"))
    numbers = pack([float(value) for value in new.numbers.values()])
    at = None if new.at is None else to_us(new.at)
    serial = None if new.serial is None else storable(new.serial)
    content = json.dumps([at, serial, labels, numbers.hex()], ensure_ascii=False)
    return {
        "measured_us": at,
        "serial": serial,
        "source": storable(new.source),
        "labels": labels,
        "numbers": numbers,
        "digest": digest_of(content),
    }


def read_covariates(connection: Connection) -> Covariates:
    """All cycle data; none of a history of an earlier version."""
    if schema.version_of(connection) < schema.WITH_COVARIATES:
        return Covariates(np.empty(0, dtype=np.int64), (), {})
    columns = (_TABLE.c.measured_us, _TABLE.c.serial, _TABLE.c.numbers, schema.layouts.c.labels)
    joined = _TABLE.join(schema.layouts, _TABLE.c.layout == schema.layouts.c.id)
    rows = connection.execute(select(*columns).select_from(joined).order_by(_TABLE.c.id)).all()
    numbers: dict[str, npt.NDArray[np.float64]] = {}
    for place, (_, _, data, line) in enumerate(rows):
        labels = parsed_labels(line)
        for label, value in zip(labels, unpack(bytes(data), len(labels)), strict=True):
            numbers.setdefault(label, np.full(len(rows), np.nan))[place] = value
    times = np.array([-1 if row[0] is None else row[0] for row in rows], dtype=np.int64)
    return Covariates(times, tuple(row[1] or "" for row in rows), numbers)
