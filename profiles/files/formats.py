"""Readable file formats, and the recognition of a file's format."""

import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.arrays import read_array
from anisoscope.profiles.files.checks import refuse
from anisoscope.profiles.files.exr import MAGIC as EXR_MAGIC
from anisoscope.profiles.files.exr import read_exr
from anisoscope.profiles.files.gsf import MAGIC as GSF_MAGIC
from anisoscope.profiles.files.gsf import read_gsf
from anisoscope.profiles.files.gwy import MAGIC as GWY_MAGIC
from anisoscope.profiles.files.gwy import read_gwy
from anisoscope.profiles.files.images import PNG_MAGIC, read_image
from anisoscope.profiles.files.library import LIBRARY_FORMATS, read_library
from anisoscope.profiles.files.metropro import MAGICS as METROPRO_MAGICS
from anisoscope.profiles.files.metropro import read_metropro
from anisoscope.profiles.files.opd import read_opd
from anisoscope.profiles.files.plain_grids import TMD_MAGIC, read_nms, read_tmd
from anisoscope.profiles.files.plain_grids import VERSION as NMS_VERSION
from anisoscope.profiles.files.plu import read_plu
from anisoscope.profiles.files.sdf import VERSIONS as SDF_VERSIONS
from anisoscope.profiles.files.sdf import read_sdf
from anisoscope.profiles.files.sur import PACKED as PACKED_SUR
from anisoscope.profiles.files.sur import PLAIN as PLAIN_SUR
from anisoscope.profiles.files.sur import read_sur
from anisoscope.profiles.files.text import read_text
from anisoscope.profiles.files.units import Given
from anisoscope.profiles.files.x3p import ZIP_TROUBLE, read_x3p
from anisoscope.profiles.heightmap import HeightMap

ZIPPED = (".x3p", ".npz")


def _x3p(path: Path, given: Given) -> HeightMap:
    if given.pixel_um is not None:
        refuse(path.name, "units", "an x3p file states its own", "leave the pixel size and the unit out")
    return read_x3p(path, given.regions)


def _array(path: Path, given: Given) -> HeightMap:
    return read_array(path, pixel_um=given.pixel_um, z_unit=given.z_unit or "um")


def _text(path: Path, given: Given) -> HeightMap:
    return read_text(
        path,
        pixel_um=given.pixel_um,
        z_unit=given.z_unit,
        xy_unit=given.xy_unit,
        layout=given.layout,
    )


@dataclass(frozen=True)
class Format:
    """A format that can be read.

    Attributes:
        name: what it is called.
        suffixes: its extensions.
        read: its reader.
        signatures: (position, bytes) by which a file is known, one of them.
        units_from_user: what the user may state: "scales" (pixel and units of x, y, z), "counts" (pixel and height of a
            count), or "" where the file states its own units.
    """

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[Path, Given], HeightMap]
    signatures: tuple[tuple[int, bytes], ...] = ()
    units_from_user: str = ""

    def begins(self, head: bytes) -> bool:
        """Whether the first bytes of a file are those of this format."""
        return any(head[at : at + len(sign)] == sign for at, sign in self.signatures)


OWN_FORMATS = (
    Format("ISO 25178-72 x3p", (".x3p",), _x3p),
    Format("ISO 25178-71 sdf", (".sdf",), read_sdf,
           tuple((0, f"{kind}{version}".encode()) for version in SDF_VERSIONS for kind in "ab")),
    Format("Gwyddion simple field", (".gsf",), read_gsf, ((0, GSF_MAGIC),)),
    Format("Gwyddion gwy", (".gwy",), read_gwy, ((0, GWY_MAGIC),)),
    Format("Digital Surf sur", (".sur",), read_sur, ((0, PLAIN_SUR), (0, PACKED_SUR))),
    Format("TrueMap tmd", (".tmd",), read_tmd, ((0, TMD_MAGIC),)),
    Format("Sensofar plu", (".plu", ".apx"), read_plu),
    Format("Wyko opd", (".opd",), read_opd, ((2, b"Directory\0"),)),
    Format("Zygo MetroPro", (".dat",), read_metropro, tuple((0, magic) for magic in METROPRO_MAGICS)),
    Format("NanoFocus nms", (".nms",), read_nms, ((32, NMS_VERSION.encode()),)),
    Format("numpy array", (".npy",), _array, ((0, b"\x93NUMPY"),), "scales"),
    Format("numpy archive", (".npz",), _array, (), "scales"),
    Format("matrix or points", (".csv", ".txt", ".asc"), _text, (), "scales"),
    Format("points", (".xyz",), _text, (), "scales"),
    Format("TIFF picture", (".tif", ".tiff"), read_image, ((0, b"II*\0"), (0, b"MM\0*")), "counts"),
    Format("OpenEXR picture", (".exr",), read_exr, ((0, EXR_MAGIC),), "scales"),
    Format("PNG picture", (".png",), read_image, ((0, PNG_MAGIC),), "counts"),
)  # fmt: skip
FORMATS = OWN_FORMATS + tuple(
    Format(entry.name, entry.suffixes, partial(read_library, key=entry.key)) for entry in LIBRARY_FORMATS
)


def readable() -> str:
    """Every extension that can be read, as a list for people."""
    return ", ".join(suffix for entry in FORMATS for suffix in entry.suffixes)


def _in_zip(path: Path) -> Format | None:
    """The format of a zip file by what is in it."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = [name.replace("\\", "/").rpartition("/")[2].lower() for name in archive.namelist()]
    except ZIP_TROUBLE:
        return None
    suffix = ".x3p" if "main.xml" in names else ".plux" if "index.xml" in names else ".npz"
    known = suffix != ".npz" or any(name.endswith(".npy") for name in names)
    return _by_suffix(suffix) if known else None


def _by_suffix(suffix: str) -> Format | None:
    return next((entry for entry in FORMATS if suffix in entry.suffixes), None)


def _unknown(path: Path, given: Given) -> HeightMap:
    """Read a file of unknown extension if the library recognises its first bytes."""
    try:
        return read_library(path, given)
    except HeightMapError as error:
        if "not recognised" not in str(error):
            raise
    return refuse(
        path.name,
        "format",
        f"unknown extension {path.suffix!r}",
        f"read are {readable()}; the first bytes belong to none of those that can be told by them",
    )


def find_format(path: Path, head: bytes) -> Format:
    """The format by extension, compared with the first bytes; by them alone where the extension is unknown.

    Raises:
        HeightMapError: the extension promises a format, and the content is another one.
    """
    promised = _by_suffix(path.suffix.lower())
    found = next((entry for entry in FORMATS if entry.begins(head)), None)
    is_zip = head.startswith(b"PK")
    if promised is None:
        return found or (_in_zip(path) if is_zip else None) or Format("unknown", (), _unknown)
    if promised not in OWN_FORMATS or found is promised:
        return promised
    if is_zip and promised.read in (_x3p, _array):
        return _in_zip(path) or promised
    if found is not None and found.read is _array and promised.units_from_user == "scales":
        return found
    if found is None and not promised.signatures and promised.suffixes[0] not in ZIPPED:
        return promised
    return refuse(
        path.name,
        "content",
        f"does not look like {path.suffix.lower()} ({promised.name})"
        + (f" but like {found.name}" if found else ""),
        "the file is damaged or misnamed",
    )
