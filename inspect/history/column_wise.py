"""Column-wise reading of many inspections for statistics, without building rows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from sys import intern
from typing import Any

import numpy as np
import numpy.typing as npt
from sqlalchemy import ColumnElement, Connection, func, select

from anisoscope.history.chain import unpack_rows
from anisoscope.history.columns import parsed_labels
from anisoscope.history.filters import Filters
from anisoscope.history.schema import inspections, layouts
from anisoscope.history.statements import chosen

TEXTS = ("serial", "verdict", "product", "recipe", "lot", "cavity", "station", "operator", "folder")


_AT_ONCE = 2000


@dataclass(frozen=True, eq=False)
class Columns:
    """Inspections, the oldest first.

    Attributes:
        times: (n,) when their records were made, UTC, datetime64[us].
        texts: n words by the names of `TEXTS`; "" where nothing was said. The recipe is product and digits, as in rows.
        numbers: (n,) by label; NaN where an inspection does not have the number.
        base: folder that relative folders of inspections are in.
    """

    times: npt.NDArray[np.datetime64]
    texts: Mapping[str, tuple[str, ...]]
    numbers: Mapping[str, npt.NDArray[np.float64]]
    base: Path = Path()


def read_columns(connection: Connection, filters: Filters, base: Path = Path()) -> Columns:
    """Read the columns of the selected inspections; ``base`` as of the columns.

    Raises:
        UsageError: a filter that makes no sense.
    """
    table = inspections.c
    words = (func.coalesce(table[name], "") if name != "recipe" else _recipe() for name in TEXTS)
    selection = (table.created_us, *words, table.layout, table.numbers)
    found = connection.execute(
        chosen(connection, select(*selection), filters),
        execution_options={"stream_results": True, "yield_per": _AT_ONCE},
    )
    columns: list[list[Any]] = [[] for _ in selection]
    for some in found.partitions(_AT_ONCE):
        for place, values in enumerate(zip(*some, strict=True)):
            # of a word that many rows have, one copy is enough
            columns[place] += map(intern, values) if 0 < place <= len(TEXTS) else values
    for column in columns:
        column.reverse()
    moments, *texts, kinds, data = columns
    return Columns(
        np.array(moments, dtype=np.int64).astype("datetime64[us]"),
        dict(zip(TEXTS, map(tuple, texts), strict=True)),
        _numbers(connection, kinds, data),
        base,
    )


def _recipe() -> ColumnElement[str]:
    """Product and digits, joined by the database, which costs no loop here."""
    table = inspections.c
    return table.product + " " + table.recipe


def _numbers(
    connection: Connection, kinds: Sequence[int], data: Sequence[bytes]
) -> dict[str, npt.NDArray[np.float64]]:
    """Numbers by label, from each row and the labels of its layout."""
    labels = {
        int(row[0]): parsed_labels(row[1])
        for row in connection.execute(select(layouts.c.id, layouts.c.labels))
    }
    layout = np.array(kinds, dtype=np.int64)
    found: dict[str, npt.NDArray[np.float64]] = {}
    for kind in dict.fromkeys(kinds):
        at = np.flatnonzero(layout == kind)
        rows = data if len(at) == len(data) else [data[k] for k in at.tolist()]
        values = unpack_rows(list(map(bytes, rows)), len(labels[kind]))
        for place, label in enumerate(labels[kind]):
            found.setdefault(label, np.full(len(layout), np.nan))[at] = values[:, place]
    return found
