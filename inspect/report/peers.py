"""Comparison of a part with its peers: the golden parts of its recipe, and the parts of its lot."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.history.rows import NewRow, storable
from anisoscope.record.schema import Record
from anisoscope.report.figures import BLUE, INK, MUTED, ORANGE, new_figure, svg_uri


@dataclass(frozen=True)
class LotPart:
    """Another part of the lot: its verdict, and its contrasts in the order of the record."""

    serial: str
    verdict: str
    contrasts: tuple[float, ...]


@dataclass(frozen=True)
class Lot:
    """The parts of a lot that were inspected before."""

    name: str
    parts: tuple[LotPart, ...]

    @property
    def verdicts(self) -> str:
        """Number of each verdict, the most frequent first."""
        found = Counter(part.verdict for part in self.parts).most_common()
        return ", ".join(f"{count} {verdict}" for verdict, count in found)


@dataclass(frozen=True)
class LotMate:
    """A part of the same lot as the history remembers it.

    Attributes:
        serial, product, verdict: of the inspection.
        numbers: by the labels of `anisoscope.history`.
        folder: of the inspection; empty where it has none.
    """

    serial: str
    product: str
    verdict: str
    numbers: Mapping[str, float]
    folder: str = ""

    @classmethod
    def of(cls, row: NewRow) -> "LotMate":
        """The part of a row of the history."""
        return cls(row.serial, row.product, row.verdict, row.numbers, row.folder)


LotMates = Callable[[str | None], Sequence[LotMate]]
"""The inspections of a lot, the oldest first; empty without a lot."""


def no_lot_mates(lot: str | None) -> tuple[LotMate, ...]:
    """Nothing is known of any lot."""
    del lot
    return ()


def lot_of(record: Record, mates: Sequence[LotMate]) -> Lot | None:
    """The lot of a part without the part itself; of what was inspected repeatedly, the last time.

    Args:
        record: the part.
        mates: inspections of its lot, the oldest first.
    """
    if record.particulars.lot is None or not mates:
        return None
    labels = [] if record.details is None else list(record.details.compared())
    last: dict[str, LotMate] = {}
    for mate in mates:
        if mate.product == storable(record.product):
            before = last.get(mate.serial, mate).numbers
            last[mate.serial] = replace(mate, numbers={**before, **mate.numbers})
    last.pop(storable(record.serial), None)
    return Lot(record.particulars.lot, tuple(_part(mate, labels) for mate in last.values()))


def _part(mate: LotMate, labels: Sequence[str]) -> LotPart:
    """Values of a mate; none of its contrasts where some are not contrasts of this part."""
    known = all(label in mate.numbers for label in labels)
    return LotPart(mate.serial, mate.verdict, tuple(mate.numbers[label] for label in labels) if known else ())


@dataclass(frozen=True)
class Place:
    """One contrast of a part among its peers.

    Attributes:
        label: name of the contrast.
        measured: of this part.
        mean: of the peers.
        s: their standard deviation, or None of a single one.
        off: how far this part lies from the mean, in ``s``.
        below: how many peers lie below.
    """

    label: str
    measured: float
    mean: float
    s: float | None
    off: float | None
    below: int


@dataclass(frozen=True)
class Peers:
    """A part among others: ``count`` of them, a place a contrast, and a drawing as a data URI."""

    count: int
    places: tuple[Place, ...]
    strip: str


def among(
    labels: Sequence[str], peers: FloatArray, measured: Sequence[float], name: str, quantity: str
) -> Peers:
    """Put a part among its peers.

    Args:
        labels: C names of the contrasts.
        peers: (n, C), n at least 1.
        measured: (C,) of this part.
        name: what the peers are.
        quantity: what the contrasts are, with their unit.
    """
    places = tuple(
        _place(label, column, value) for label, column, value in zip(labels, peers.T, measured, strict=True)
    )
    return Peers(len(peers), places, _strip(labels, peers, measured, name, quantity))


def _place(label: str, peers: FloatArray, measured: float) -> Place:
    mean = float(peers.mean())
    s = float(peers.std(ddof=1)) if len(peers) > 1 else None
    off = (measured - mean) / s if s else None
    return Place(label, measured, mean, s, off, int(np.sum(peers < measured)))


def _strip(
    labels: Sequence[str], peers: FloatArray, measured: Sequence[float], name: str, quantity: str
) -> str:
    """Every peer as a dot and this part as a diamond, one strip a contrast, all from the mean of the peers."""
    off = peers - peers.mean(axis=0)
    with new_figure(9.0, 1.15 + 0.42 * len(labels)) as (figure, axes):
        strip = np.arange(len(labels), dtype=np.float64)
        spread = 0.12 * (np.arange(len(off)) % 5 - 2)
        rows = (strip[None, :] + spread[:, None]).ravel()
        known = axes.scatter(off.ravel(), rows, s=20, color=BLUE, alpha=0.6, linewidths=0)
        here = np.asarray(measured) - peers.mean(axis=0)
        mine = axes.scatter(
            here, strip, s=70, marker="D", color=ORANGE, edgecolor=INK, linewidths=0.8, zorder=3
        )
        axes.axvline(0.0, color=MUTED, linewidth=0.9)
        axes.set_yticks(range(len(labels)), labels)
        axes.set_ylim(len(labels) - 0.45, -0.55)
        axes.grid(axis="x")
        axes.set_xlabel(f"{quantity}, from the mean of the {name}")
        figure.legend(
            [known, mine], [name, "this part"], loc="outside upper right", ncols=2, frameon=False, fontsize=8
        )
        return svg_uri(figure)
