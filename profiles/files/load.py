"""Read and write height maps of every supported format, checked and with their provenance."""

import hashlib
import stat
from pathlib import Path

import numpy as np

from anisoscope.base.errors import HeightMapError
from anisoscope.base.regular_file import regular_file
from anisoscope.parameters.height_map_file import FileScales, Rows
from anisoscope.parameters.keywords import by_keywords
from anisoscope.profiles.files.arrays import write_array
from anisoscope.profiles.files.checks import refuse, trusting
from anisoscope.profiles.files.content import check_size
from anisoscope.profiles.files.exr import write_exr
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.formats import find_format
from anisoscope.profiles.files.gsf import write_gsf
from anisoscope.profiles.files.gwy import write_gwy
from anisoscope.profiles.files.images import write_ply, write_png, write_stl, write_tiff
from anisoscope.profiles.files.sur import write_sur
from anisoscope.profiles.files.text import write_text
from anisoscope.profiles.files.units import micrometres_per
from anisoscope.profiles.files.x3p_write import write_x3p
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.provenance import provenance_of, with_comment

HEAD_BYTES = 4096
WRITERS = {
    ".x3p": write_x3p,
    ".gsf": write_gsf,
    ".gwy": write_gwy,
    ".sur": write_sur,
    ".npz": write_array,
    ".npy": write_array,
    ".csv": write_text,
    ".txt": write_text,
    ".tif": write_tiff,
    ".tiff": write_tiff,
    ".exr": write_exr,
    ".png": write_png,
}
SCATTERED = ("text", "xyz", "stl", "ply")
LAYER_SUFFIXES = (".npz", ".gwy", ".exr")
MESH_WRITERS = {".stl": write_stl, ".ply": write_ply}


def _fingerprint(path: Path) -> tuple[str, bytes]:
    """sha256 of a file, and its first bytes.

    Raises:
        HeightMapError: no such file, not a regular file, not readable, or empty.
    """
    head = b""
    try:
        mode = path.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):  # a pipe or a device may never end
            refuse(path.name, "file", "is a pipe, a device or a socket", "give a regular file")
        check_size(path)
        with regular_file(path) as stream:
            head = stream.read(HEAD_BYTES)
            stream.seek(0)
            digest = hashlib.file_digest(stream, "sha256")
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    if not head:
        refuse(path.name, "file", "is empty", "export it again")
    return digest.hexdigest(), head


def _check_given(name: str, found: Format, given: FileScales) -> None:
    """Refuse units for a format that states its own, and image options for others."""
    if not found.units_from_user and (given.z_unit or given.xy_unit):
        refuse(
            name,
            "units",
            f"a file of format {found.title} states its own",
            "leave --z-unit and --xy-unit out",
        )
    if found.units_from_user != "counts" and given.height_per_count is not None:
        refuse(name, "height per count", "is for pictures", f"leave it out for {found.title}")
    if given.missing and found.name not in {"text", "xyz"}:
        refuse(name, "missing points", "numbers that mark them are for text files", "leave --missing out")
    if given.channel is not None and not found.channels:
        refuse(name, "channel", f"files of format {found.title} have one map", "leave --channel out")
    if given.grid_um is not None and found.name not in SCATTERED:
        refuse(name, "grid", "scattered points are those of text files and meshes", "leave --grid out")
    if given.mask_regions and ".x3p" not in found.suffixes:
        refuse(name, "mask", "only x3p files hold a mask.png", "leave --mask-from-x3p out")


@by_keywords(scales=FileScales)
def read_height_map(path: Path | str, *, scales: FileScales) -> HeightMap:
    """Read a height map, by content and extension, and check that it is plausible.

    Args:
        path: a file of one of `anisoscope.profiles.files.formats.all_formats`; how well each was tried stands in
            ``docs/height-maps.md``.
        scales: what the file does not state, or its fields as keywords; with ``role`` "tool" the part is the negative
            of the map: z changes its sign and x is mirrored. ``rows`` "auto" is up for x3p and sdf, as their standards
            define it, for opd, text and numpy; down for all others, whose first row is the top of the picture. What
            ``trust`` let pass is listed as ``trusted`` in the origin, other channels as ``other_channels``.

    Returns:
        The map; its origin holds ``file``, ``sha256``, ``format``, ``reader``, ``pixel_um`` [y, x],
        ``missing_share``, ``role``, ``corrected`` (what was changed on the way, if anything), instrument and date
        as far as the file gives them, and ``made``, ``defects`` and ``history`` of a map that we wrote.

    Raises:
        HeightMapError: unreadable, damaged, ambiguous or implausible; one line that says what to do.
    """
    path = Path(path)
    if scales.role not in ("part", "tool"):
        raise HeightMapError(f"unknown role {scales.role!r}; a height map is of a part or of a tool")
    micrometres_per(scales.z_unit or "um")
    micrometres_per(scales.xy_unit or "um")
    sha256, head = _fingerprint(path)
    found = find_format(path, head)
    _check_given(path.name, found, scales)
    with trusting(scales.trust) as trusted:
        surface = _oriented(found.read(path, scales), scales.role, scales.rows)
    passed = {"trusted": trusted.passed} if trusted.passed else {}
    return surface.with_height(
        surface.height_um,
        file=path.name,
        sha256=sha256,
        reader=surface.origin.get("reader", "anisoscope"),
        pixel_um=[surface.pixel_y_um, surface.pixel_x_um],
        missing_share=surface.missing_share,
        role=scales.role,
        **passed,
    )


def _oriented(surface: HeightMap, role: str, rows: Rows) -> HeightMap:
    """The map of the part with y rising; ``corrected`` names what was flipped."""
    origin = provenance_of(dict(surface.origin))
    top_first = origin.pop("first_row", None) == "top"
    done = list(origin.pop("corrected", []))
    height, layers = surface.height_um, dict(surface.layers)
    if rows == "down" or (rows == "auto" and top_first):
        height = height[::-1]
        layers = {key: layer[::-1] for key, layer in layers.items()}
        done.append("rows turned: the first of the file is the top of the picture")
    if role == "tool":
        height = -height[:, ::-1]
        layers = {key: layer[:, ::-1] for key, layer in layers.items()}
        done.append("negated and mirrored, from the tool to the part")
    if not done:
        return surface if origin == surface.origin else HeightMap(
            height, surface.pixel_x_um, surface.pixel_y_um, origin, layers
        )  # fmt: skip
    turned = np.array(height, order="C")
    turned.flags.writeable = False
    return HeightMap(turned, surface.pixel_x_um, surface.pixel_y_um, {**origin, "corrected": done}, layers)


def write_height_map(surface: HeightMap, path: Path | str) -> None:
    """Write a map in the format of the extension: x3p, sur, gwy, gsf, npz, npy, csv or txt, tif, exr, png, stl, ply.

    x3p, npz and csv (a matrix) keep every float64 height, npy too but no pixel size; gwy keeps metres, sur 31 bits of
    the largest height, gsf, tif and exr 24 bits, png 16 bits of the range. stl and ply are meshes
    of 24 bits. x3p, npz, gsf and exr keep the provenance: ``made``, ``defects`` and ``history`` of the origin. npz, gwy
    and exr keep the layers.

    Raises:
        HeightMapError: unknown extension, the file cannot be written, or the provenance is too long.
    """
    path = Path(path)
    writers = WRITERS | MESH_WRITERS
    writer = writers.get(path.suffix.lower())
    if writer is None:
        refuse(path.name, "format", f"unknown extension {path.suffix!r}", f"written are {', '.join(writers)}")
    writer(with_comment(surface, path), path)
