"""Read and write height maps of every supported format, checked and with their provenance."""

import hashlib
from pathlib import Path
from typing import Literal

import numpy as np

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.arrays import write_array
from anisoscope.profiles.files.checks import refuse
from anisoscope.profiles.files.formats import Format, find_format
from anisoscope.profiles.files.gsf import write_gsf
from anisoscope.profiles.files.images import write_tiff
from anisoscope.profiles.files.text import write_text
from anisoscope.profiles.files.units import Given, Layout, micrometres_per
from anisoscope.profiles.files.x3p_write import write_x3p
from anisoscope.profiles.heightmap import HeightMap

Rows = Literal["auto", "up", "down"]
HEAD_BYTES = 64
WRITERS = {
    ".x3p": write_x3p,
    ".gsf": write_gsf,
    ".npz": write_array,
    ".npy": write_array,
    ".csv": write_text,
    ".txt": write_text,
    ".tif": write_tiff,
    ".tiff": write_tiff,
}


def _fingerprint(path: Path) -> tuple[str, bytes]:
    """sha256 of a file, and its first bytes.

    Raises:
        HeightMapError: no such file, a folder, not readable, or empty.
    """
    head = b""
    try:
        with path.open("rb") as stream:
            head = stream.read(HEAD_BYTES)
            stream.seek(0)
            digest = hashlib.file_digest(stream, "sha256")
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    if not head:
        refuse(path.name, "file", "is empty", "export it again")
    return digest.hexdigest(), head


def _check_given(name: str, found: Format, given: Given) -> None:
    """Refuse units for a format that states its own, and image options for others."""
    if not found.units_from_user and (given.z_unit or given.xy_unit):
        refuse(
            name, "units", f"a file of format {found.name} states its own", "leave --z-unit and --xy-unit out"
        )
    if found.units_from_user != "counts" and given.height_per_count is not None:
        refuse(name, "height per count", "is for pictures", f"leave it out for {found.name}")


def read_height_map(
    path: Path | str,
    *,
    pixel_um: tuple[float, float] | None = None,
    z_unit: str | None = None,
    role: str = "part",
    xy_unit: str | None = None,
    layout: Layout = "auto",
    height_per_count: float | None = None,
    rows: Rows = "auto",
) -> HeightMap:
    """Read a height map, by content and extension, and check that it is plausible.

    Args:
        path: a file of one of :data:`~anisoscope.profiles.files.formats.FORMATS`; how well each was tried stands in
            ``docs/height-maps.md``.
        pixel_um: (y, x) pixel size in µm for files that have none.
        z_unit: unit of the heights for formats that state none: um, nm, mm or m; µm where it is not given.
        role: "part", or "tool" for the mould: the part is its negative, so that z changes its sign and x
            is mirrored.
        xy_unit: unit of x and y in a list of points; that of the heights where it is not given.
        layout: "matrix" or "xyz" where a text file with three columns could be either.
        height_per_count: height of one count of an integer picture, in ``z_unit``.
        rows: whether y rises ("up") or falls ("down") with the rows of the file. "auto": up for x3p and sdf,
            as their standards define it, for opd, text and numpy; down for all others, whose first row
            is the top of the picture.

    Returns:
        The map; its origin holds ``file``, ``sha256``, ``format``, ``reader``, ``pixel_um`` [y, x],
        ``missing_share``, ``role``, ``corrected`` (what was changed on the way, if anything), and instrument
        and date as far as the file gives them.

    Raises:
        HeightMapError: unreadable, damaged, ambiguous or implausible; one line that says what to do.
    """
    path = Path(path)
    if role not in ("part", "tool"):
        raise HeightMapError(f"unknown role {role!r}; a height map is of a part or of a tool")
    micrometres_per(z_unit or "um")
    micrometres_per(xy_unit or "um")
    given = Given(pixel_um, z_unit, height_per_count, xy_unit, layout)
    sha256, head = _fingerprint(path)
    found = find_format(path, head)
    _check_given(path.name, found, given)
    surface = _oriented(found.read(path, given), role, rows)
    return surface.with_height(
        surface.height_um,
        file=path.name,
        sha256=sha256,
        reader=surface.origin.get("reader", "anisoscope"),
        pixel_um=[surface.pixel_y_um, surface.pixel_x_um],
        missing_share=surface.missing_share,
        role=role,
    )


def _oriented(surface: HeightMap, role: str, rows: Rows) -> HeightMap:
    """The map of the part with y rising; ``corrected`` names what was flipped."""
    origin = dict(surface.origin)
    top_first = origin.pop("first_row", None) == "top"
    done = list(origin.pop("corrected", []))
    height = surface.height_um
    if rows == "down" or (rows == "auto" and top_first):
        height = height[::-1]
        done.append("rows turned: the first of the file is the top of the picture")
    if role == "tool":
        height = -height[:, ::-1]
        done.append("negated and mirrored, from the tool to the part")
    if not done:
        return surface if origin == surface.origin else HeightMap(
            height, surface.pixel_x_um, surface.pixel_y_um, origin
        )  # fmt: skip
    turned = np.array(height, order="C")
    turned.flags.writeable = False
    return HeightMap(turned, surface.pixel_x_um, surface.pixel_y_um, {**origin, "corrected": done})


def write_height_map(surface: HeightMap, path: Path | str) -> None:
    """Write a map in the format of the extension: x3p, gsf, npz, npy, csv or txt (matrix), tif.

    x3p, npz and csv keep every float64 height, npy too but no pixel size; gsf and tif keep 24 bits.

    Raises:
        HeightMapError: unknown extension, or the file cannot be written.
    """
    path = Path(path)
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        refuse(path.name, "format", f"unknown extension {path.suffix!r}", f"written are {', '.join(WRITERS)}")
    writer(surface, path)
