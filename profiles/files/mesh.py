"""Read meshes of a surface (STL, PLY): their corners are the measured points.

Corners on a regular grid, as in meshes that we and instruments write, give back its heights; others are interpolated
with ``--grid``. STL has no unit and PLY none that readers know: millimetres where the header says so, as ours does,
else that of ``--z-unit``. VTK reads the file in the guarded process.
"""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from anisoscope.base.regular_file import regular_file
from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.checks import refuse
from anisoscope.profiles.files.content import DAMAGED
from anisoscope.profiles.files.decoder_process import decode
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.gridding import gridded
from anisoscope.profiles.files.images import STL_HEADER_BYTES, TRIANGLE
from anisoscope.profiles.files.text import points_to_map
from anisoscope.profiles.files.units import micrometres_per
from anisoscope.profiles.heightmap import HeightMap

STATED = re.compile(rb"unit\s*[:=]?\s*(mm|um|nm|m)\b")
PLY_BYTES = {
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
"""Sizes of the types of a PLY file; others are a byte."""
CORNERS = 3
HEADER_BYTES = 1000


def read_mesh(path: Path | str, given: FileScales | None = None) -> HeightMap:
    """Read an STL or PLY file.

    Args:
        path: the file.
        given: unit of all three axes, and the step of a grid for corners that lie on none.

    Raises:
        HeightMapError: damaged, no unit, corners on no grid, or two heights at one place.
    """
    path, given = Path(path), given or FileScales()
    name = path.name
    with regular_file(path) as stream:
        stated = STATED.search(stream.read(HEADER_BYTES))
    own = stated[1].decode() if stated else None
    unit = given.z_unit or own
    if given.pixel_um is not None:
        refuse(
            name,
            "pixel size",
            "a mesh brings its own",
            "leave the pixel size out, or give a step with --grid",
        )
    if unit is None:
        refuse(name, "units", "a mesh states none", "say that of x, y and z with --z-unit, mostly mm")
    if own is not None and micrometres_per(own) != micrometres_per(unit):
        refuse(name, "units", f"the header states {own}, not {unit}", "leave --z-unit out")
    answer, points = decode("mesh", path)
    _check_whole(path, answer)
    origin = {"format": path.suffix.lower()[1:], "reader": answer["reader"], "z_unit": unit, "xy_unit": unit}
    points_um = points.astype(float) * micrometres_per(unit)
    if given.grid_um is not None:
        return gridded(name, points_um, given.grid_um, origin)
    return points_to_map(name, points_um, origin)


def _check_whole(path: Path, read: Mapping[str, Any]) -> None:
    """Compare what VTK read with what the file announces: it takes a truncated file for a smaller mesh.

    Raises:
        HeightMapError: the file ends early.
    """
    with regular_file(path) as stream:
        head = stream.read(HEADER_BYTES)
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(size - HEADER_BYTES, 0))
        tail = stream.read()
    if head.startswith(b"ply"):
        whole = size >= _least_bytes(head)
    else:
        announced = int.from_bytes(head[STL_HEADER_BYTES : STL_HEADER_BYTES + 4], "little")
        binary = size == STL_HEADER_BYTES + 4 + TRIANGLE.itemsize * announced
        whole = binary or (head.lstrip().startswith(b"solid") and b"endsolid" in tail)
    if not whole:
        refuse(
            path.name, "size", f"{read['corners']} corners, {read['faces']} faces of {size} bytes", DAMAGED
        )


def _least_bytes(head: bytes) -> int:
    """Bytes that a PLY file has at least by its header, all faces being triangles."""
    header, _, _ = head.partition(b"end_header")
    least, count = len(header) + len(b"end_header\n"), 0
    for line in header.decode("latin-1").splitlines():
        word, *rest = line.split() or [""]
        if word == "element" and len(rest) == 2 and rest[1].isdecimal():
            count = int(rest[1])
        elif word == "property" and len(rest) > 1:
            listed = rest[0] == "list" and len(rest) > 3
            sizes = [PLY_BYTES.get(kind, 1) for kind in (rest[1:3] if listed else rest[:1])]
            each = sizes[0] + (CORNERS * sizes[1] if listed else 0)
            least += count * (each if b"format binary" in header else 2 * (CORNERS + 1 if listed else 1))
    return least


STL = Format("stl", "STL mesh", (".stl",), read_mesh, units_from_user="scales", place=18)
PLY = Format(
    "ply",
    "PLY mesh",
    (".ply",),
    read_mesh,
    ((0, b"ply\n"), (0, b"ply\r")),
    units_from_user="scales",
    place=19,
)
