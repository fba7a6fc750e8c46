"""Etch masks of a layout: GDSII with a cell for every tile and a layer for every pass.

Units are µm with a database grid of 1 nm. A text on layer 0 of the top cell says the schema, the depths and the grid,
so that the file can be read back without further files.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import ConfigError
from anisoscope.sim.design.layout import Layout

Booleans = npt.NDArray[np.bool_]

SCHEMA_VERSION = 1
TOP = "ANISOSCOPE"
TEXT_LAYER = 0
FIRST_LAYER = 1


def write_gds(layout: Layout, path: Path) -> dict[str, int]:
    """Write the masks; polygons of layer 1, 2, … are etched in pass 1, 2, ….

    Neighbouring dots with the same tile become one array.

    Returns:
        How many cells, polygons in cells, and references there are.

    Raises:
        ConfigError: the file cannot be written.
    """
    import gdstk  # noqa: PLC0415 - loaded when first needed

    library = gdstk.Library("ANISOSCOPE", unit=1e-6, precision=1e-9)
    top = library.new_cell(TOP)
    header = {
        "anisoscope_masks": SCHEMA_VERSION, "passes_nm": [round(d, 4) for d in layout.passes_nm],
        "grid_um": layout.grid_um, "size_um": list(layout.size_um),
    }  # fmt: skip
    top.add(gdstk.Label(json.dumps(header), (0.0, 0.0), layer=TEXT_LAYER))
    cells: dict[int, gdstk.Cell] = {}
    polygons = 0
    for number in np.unique(layout.index).tolist():  # a cell that lies nowhere would be a second top cell
        tile = layout.tiles[number]
        cell = library.new_cell(f"{_cell_name(layout.names[int(layout.tile_class[number])])}_{number}")
        for bit in range(len(layout.passes_nm)):
            for x0, y0, x1, y1 in rectangles((tile >> bit) & 1 == 1):
                corner, other = (
                    (x0 * layout.grid_um, y0 * layout.grid_um),
                    (x1 * layout.grid_um, y1 * layout.grid_um),
                )
                cell.add(gdstk.rectangle(corner, other, layer=FIRST_LAYER + bit))
                polygons += 1
        cells[number] = cell
    references = 0
    for row, line in enumerate(layout.index):
        for first, many, tile_number in _runs(line):
            place = first * layout.dot_um, row * layout.dot_um
            spacing = (layout.dot_um, layout.dot_um)
            top.add(gdstk.Reference(cells[tile_number], place, columns=many, rows=1, spacing=spacing))
            references += 1
    try:
        library.write_gds(path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error}); check the folder") from None
    return {"cells": len(cells) + 1, "polygons": polygons, "references": references}


def _cell_name(name: str) -> str:
    allowed = "".join(
        letter if letter.isascii() and (letter.isalnum() or letter in "_$?") else "_" for letter in name
    )
    return allowed[:24].upper() or "DOT"


def _runs(line: npt.NDArray[np.integer]) -> Iterator[tuple[int, int, int]]:
    """(first, how many, tile) of runs of equal tiles."""
    starts = np.flatnonzero(np.diff(line, prepend=line[0] - 1 if line[0] else 1) != 0)
    for first, last in zip(starts, [*starts[1:], line.size], strict=True):
        yield int(first), int(last - first), int(line[first])


def rectangles(mask: Booleans) -> list[tuple[int, int, int, int]]:
    """(x0, y0, x1, y1) of rectangles that cover a mask once: runs along rows, joined where rows repeat them."""
    found: list[tuple[int, int, int, int]] = []
    live: dict[tuple[int, int], int] = {}
    padded = np.pad(mask, ((0, 1), (1, 1))).astype(np.int8)
    for y, line in enumerate(padded):
        turns = np.flatnonzero(np.diff(line))
        runs = set(zip(turns[::2].tolist(), turns[1::2].tolist(), strict=True))
        ended = [run for run in live if run not in runs]
        found.extend((run[0], live.pop(run), run[1], y) for run in ended)
        for run in runs:
            live.setdefault(run, y)
    return found


def write_preview(layout: Layout, path: Path) -> None:
    """Write a PNG of the layout, one pixel a dot, the classes as even shades of grey; first row at the top.

    Raises:
        RecordError: the file cannot be written.
    """
    many = max(1, len(layout.names) - 1)
    write_png(np.asarray(255.0 / many * layout.classes[::-1]), path)


def write_tile_preview(layout: Layout, number: int, path: Path) -> None:
    """Write a PNG of one tile, one pixel a grid point; deeper is darker.

    Raises:
        RecordError: the file cannot be written.
    """
    table = layout.heights_um
    shade = 255.0 * (table - table.min()) / max(float(np.ptp(table)), 1e-9)
    write_png(shade[layout.tiles[number]][::-1], path)


def write_png(shades: npt.NDArray[np.floating], path: Path) -> None:
    """Write grey values of 0 to 255.

    Raises:
        RecordError: the file cannot be written.
    """
    import cv2  # noqa: PLC0415 - slow to import

    from anisoscope.base.atomic_write import write_bytes  # noqa: PLC0415 - start-up time

    done, data = cv2.imencode(".png", np.asarray(np.rint(shades), dtype=np.uint8))
    assert done
    write_bytes(path, data.tobytes())
