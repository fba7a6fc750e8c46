"""Where the parts of a cavity deviate: maps of their cells, laid over each other."""

from base64 import b64encode
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import AnisoscopeError
from anisoscope.base.language import message
from anisoscope.history.comparing import record_of
from anisoscope.history.rows import Row

if TYPE_CHECKING:
    from anisoscope.imaging.deviation_map import CellMap

MAPPED, BROAD, HIGH = 100, 420.0, 420.0


@dataclass(frozen=True)
class HeatMap:
    """The deviating cells of the parts of a cavity, laid over each other.

    Attributes:
        title: product and cavity.
        count: parts.
        width, height: of the pictures, in units of the drawing.
        bar: length of the scale bar in mm, and in these units.
        share: picture of the share of parts in which a cell deviates, and its largest value.
        mean: picture of the mean ln ratio less that of the flank, of the pair of poses where it is largest, and that.
    """

    title: str
    count: int
    width: float
    height: float
    bar: tuple[float, float]
    share: tuple[str, float]
    mean: tuple[str, float]


@dataclass(eq=False)
class _Sums:
    count: int
    deviating: FloatArray
    off: FloatArray


def heat_maps(rows: Sequence[Row]) -> tuple[list[HeatMap], list[str]]:
    """Maps of inspections, and where those are whose cells are not here."""
    sums, missing = dict[tuple[str, str, float, tuple[int, ...]], _Sums](), Counter[str]()
    for row in rows:
        try:
            found = _deviations(row)
        except (AnisoscopeError, OSError, ValueError, KeyError) as error:
            missing[message("cannot be read: {why}", why=" ".join(str(error).split()))] += 1
            continue
        if isinstance(found, str):
            missing[found] += 1
            continue
        cells, side_mm = found
        key = (row.product, row.cavity or message("not stated"), side_mm, cells.off.shape)
        one = sums.setdefault(key, _Sums(0, np.zeros(cells.off.shape[1:]), np.zeros(cells.off.shape)))
        one.count += 1
        one.deviating += cells.deviating()
        one.off += cells.off
    drawn = [
        _heat_map(message("{product}, cavity {cavity}", product=product, cavity=cavity), one, side)
        for (product, cavity, side, _), one in sums.items()
    ]
    return drawn, [f"{number} {text}" for text, number in missing.most_common()]


def _deviations(row: Row) -> "tuple[CellMap, float] | str":
    """Map of the cells of an inspection and their side in mm, or where it is."""
    from anisoscope.inspection.kept_measurement import read_kept
    from anisoscope.kinds.parts import Redeciding
    from anisoscope.kinds.registry import kind_named

    folder = Path(row.folder)
    if not folder.is_dir():
        return message(
            "not on this computer: made at {at} in {folder}, or in the archive (`anisoscope archive list`)",
            at=row.station or message("a station that was not stated"),
            folder=folder.parent,
        )
    record = record_of(row)
    kept = read_kept(folder, record)
    kind = kind_named(record.kind)
    found = None
    if kept is not None and isinstance(kind, Redeciding):
        found = kind.deviations(kept, record.recipe)
    return (
        message("without a map: INVALID, of a kind without one, or of an earlier version")
        if found is None
        else found
    )


def _heat_map(title: str, sums: _Sums, side_mm: float) -> HeatMap:
    share, mean = sums.deviating / sums.count, sums.off / sums.count
    strongest = np.take_along_axis(mean, np.abs(mean).argmax(axis=0)[None], axis=0)[0]
    most, limit = float(share.max()), float(np.abs(strongest).max())
    rows, cols = share.shape
    unit = min(BROAD / cols, HIGH / rows)
    bar_mm = max(
        (
            step * 10.0**power
            for power in range(-3, 4)
            for step in (1, 2, 5)
            if step * 10.0**power <= cols * side_mm / 3
        ),
        default=side_mm,
    )
    return HeatMap(
        title,
        sums.count,
        cols * unit,
        rows * unit,
        (bar_mm, bar_mm / side_mm * unit),
        (_picture(share / (most or 1.0)), most),
        (_picture(strongest / (limit or 1.0)), limit),
    )


RED, BLUE = np.array([0xA0, 0x10, 0x20]), np.array([0x10, 0x40, 0xA0])


def _picture(values: FloatArray) -> str:
    """A picture of values from -1, blue, by 0, white, to 1, red, a pixel each."""
    import cv2

    dark = np.where(values[..., None] < 0.0, BLUE, RED)
    rgb = 255.0 + np.abs(values)[..., None] * (dark - 255.0)
    done, content = cv2.imencode(".png", rgb[..., ::-1].round().astype(np.uint8))
    assert done
    return f"data:image/png;base64,{b64encode(content.tobytes()).decode()}"
