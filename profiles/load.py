"""Read and write height maps of every supported format, checked and with their provenance."""

import hashlib
from pathlib import Path
from typing import NoReturn

from anisoscope.errors import HeightMapError
from anisoscope.profiles.arrays import read_array, write_array
from anisoscope.profiles.checks import refuse
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.text import Layout, read_text, write_text
from anisoscope.profiles.units import micrometres_per
from anisoscope.profiles.x3p import read_x3p
from anisoscope.profiles.x3p_write import write_x3p

FORMATS = {
    ".x3p": "ISO 25178-72",
    ".npy": "numpy array",
    ".npz": "numpy archive",
    ".csv": "matrix or points",
    ".txt": "matrix or points",
    ".xyz": "points",
}
TEXT = {".csv", ".txt", ".xyz"}
WRITERS = {".x3p": write_x3p, ".npy": write_array, ".csv": write_text, ".txt": write_text}


def _unknown(path: Path) -> NoReturn:
    known = ", ".join(f"{suffix} ({what})" for suffix, what in FORMATS.items())
    refuse(path.name, "format", f"unknown extension {path.suffix!r}", f"read are {known}")


def _fingerprint(path: Path) -> tuple[str, bytes]:
    """sha256 of a file, and its first bytes.

    Raises:
        HeightMapError: no such file, a folder, not readable, or empty.
    """
    digest = hashlib.sha256()
    head = b""
    try:
        with path.open("rb") as stream:
            while block := stream.read(2**20):
                head = head or block[:8]
                digest.update(block)
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    if not head:
        refuse(path.name, "file", "is empty", "export it again")
    return digest.hexdigest(), head


def _dispatch(
    path: Path,
    head: bytes,
    *,
    pixel_um: tuple[float, float] | None,
    z_unit: str,
    xy_unit: str | None,
    layout: Layout,
) -> HeightMap:
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        _unknown(path)
    is_zip, is_npy = head.startswith(b"PK"), head.startswith(b"\x93NUMPY")
    if suffix in TEXT and not (is_zip or is_npy):
        return read_text(path, pixel_um=pixel_um, z_unit=z_unit, xy_unit=xy_unit, layout=layout)
    if is_npy or (is_zip and suffix == ".npz"):
        return read_array(path, pixel_um=pixel_um, z_unit=z_unit)
    if is_zip and suffix == ".x3p":
        if pixel_um is not None or z_unit not in ("um", "µm"):
            refuse(path.name, "units", "an x3p file states its own", "leave the pixel size and the unit out")
        return read_x3p(path)
    return refuse(
        path.name,
        "content",
        f"does not look like {suffix} ({FORMATS[suffix]})",
        "the file is damaged or misnamed",
    )


def read_height_map(
    path: Path | str,
    *,
    pixel_um: tuple[float, float] | None = None,
    z_unit: str = "um",
    role: str = "part",
    xy_unit: str | None = None,
    layout: Layout = "auto",
) -> HeightMap:
    """Read a height map, by content and extension, and check that it is plausible.

    Args:
        path: x3p, npy, npz, csv, txt or xyz file.
        pixel_um: (y, x) pixel size in µm for formats that have none (matrices as text or npy).
        z_unit: unit of the heights for formats that state none: um, nm, mm or m.
        role: "part", or "tool" for the mould: the part is its negative, so that z changes its sign and x
            is mirrored.
        xy_unit: unit of x and y in a list of points; that of the heights where it is not given.
        layout: "matrix" or "xyz" where a text file with three columns could be either.

    Returns:
        The map; its origin holds ``file``, ``sha256``, ``format``, ``pixel_um`` [y, x], ``missing_share``,
        ``role``, and instrument and date as far as the file gives them.

    Raises:
        HeightMapError: unreadable, damaged, ambiguous or implausible; one line that says what to do.
    """
    path = Path(path)
    if role not in ("part", "tool"):
        raise HeightMapError(f"unknown role {role!r}; a height map is of a part or of a tool")
    micrometres_per(z_unit)
    sha256, head = _fingerprint(path)
    surface = _dispatch(path, head, pixel_um=pixel_um, z_unit=z_unit, xy_unit=xy_unit, layout=layout)
    height = surface.height_um if role == "part" else -surface.height_um[:, ::-1]
    return surface.with_height(
        height,
        file=path.name,
        sha256=sha256,
        pixel_um=[surface.pixel_y_um, surface.pixel_x_um],
        missing_share=surface.missing_share,
        role=role,
    )


def write_height_map(surface: HeightMap, path: Path | str) -> None:
    """Write a map in the format of the extension: x3p, npy, csv or txt (matrix).

    Raises:
        HeightMapError: unknown extension, or the file cannot be written.
    """
    path = Path(path)
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        refuse(path.name, "format", f"unknown extension {path.suffix!r}", f"written are {', '.join(WRITERS)}")
    writer(surface, path)
