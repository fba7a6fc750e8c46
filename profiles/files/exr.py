"""Read and write OpenEXR, with the extra ``exr``: heights in µm as float32, NaN where missing.

Our files hold the heights in channel Z, an intensity in Y and a colour in R, G, B, in the numbers of the instrument;
the attribute ``heightMap`` states unit and pixel, ``comments`` holds the provenance. Files of other programs have no
unit: pixel and unit are asked for, and the heights are channel Z, Y, or the only one. The first row is the top of the
picture. Decoding is done by OpenEXR in the guarded process.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.checks import checked_map, refuse
from anisoscope.profiles.files.content import scaled
from anisoscope.profiles.files.decoder_process import decode, require_decoder
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.units import micrometres_per, require_pixel
from anisoscope.profiles.heightmap import COLOUR, INTENSITY, INTERPOLATED, HeightMap, Layer

MAGIC = b"\x76\x2f\x31\x01"
NOTE = re.compile(r"heights in um; pixel_um \(y, x\): ([0-9.eE+-]+), ([0-9.eE+-]+)")
LAYERS = {INTENSITY: ("Y",), COLOUR: ("R", "G", "B"), INTERPOLATED: (INTERPOLATED,)}


def _noted(name: str, text: object) -> tuple[float, float] | None:
    """Pixel (y, x) in µm that :func:`write_exr` noted."""
    found = NOTE.fullmatch(str(text or ""))
    try:
        return (float(found[1]), float(found[2])) if found else None
    except ValueError:
        return refuse(name, "heightMap", repr(str(text)[:60]), "the file is damaged; copy or export it again")


def read_exr(path: Path | str, given: FileScales | None = None) -> HeightMap:
    """Read an OpenEXR file.

    Args:
        path: the file.
        given: pixel size and unit of the heights, for a file that we did not write.

    Returns:
        (rows, cols) heights in µm, first row at the top of the picture (``origin["first_row"]``), with its layers.

    Raises:
        HeightMapError: OpenEXR is not installed, no scales, damaged, or implausible.
    """
    path = Path(path)
    name, given = path.name, given or FileScales()
    answer, raw = decode("exr", path, channels=[])
    noted = _noted(name, answer.get("heightMap"))
    if noted is not None and (given.pixel_um or given.z_unit):
        refuse(
            name, "units", "the file states its own pixel and unit", "leave the pixel size and the unit out"
        )
    pixel = noted or require_pixel(name, given.pixel_um)
    if noted is None and given.z_unit is None:
        refuse(name, "height scale", "the file states none", "give the unit of its numbers with --z-unit")
    origin: dict[str, Any] = {"format": "exr", "first_row": "top"}
    if comment := answer.get("comments"):
        origin["comment"] = comment
    layers: dict[str, Layer] = {}
    for layer, channels in LAYERS.items():
        if noted is not None and set(channels) <= set(answer["channels"]):
            parts = decode("exr", path, channels=channels)[1]
            layers[layer] = np.stack(np.hsplit(parts, 3), axis=2) if layer == COLOUR else parts
    factor = micrometres_per(given.z_unit or "um")
    return checked_map(name, scaled(raw, factor), pixel, origin, layers=layers)


def write_exr(surface: HeightMap, path: Path | str) -> None:
    """Write heights in µm as float32 to channel Z, layers to Y and to R, G, B; ``comment`` of the origin to the header.

    Raises:
        HeightMapError: OpenEXR is not installed, or the file cannot be written.
    """
    path = Path(path)
    require_decoder("exr", path.name)
    import OpenEXR  # noqa: PLC0415 - an extra

    note = f"heights in um; pixel_um (y, x): {surface.pixel_y_um!r}, {surface.pixel_x_um!r}"
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "heightMap": note,
        **({"comments": str(comment)} if (comment := surface.origin.get("comment")) else {}),
    }
    grids: dict[str, npt.NDArray[Any]] = {"Z": surface.height_um}
    for layer, channels in LAYERS.items():
        if layer in surface.layers:
            values = surface.layers[layer].reshape(*surface.shape, -1)
            grids |= {channel: values[..., k] for k, channel in enumerate(channels)}
    pixels = {key: np.array(grid[::-1], dtype=np.float32, order="C") for key, grid in grids.items()}
    try:
        path.open("ab").close()  # OpenEXR says nothing of why it cannot write
        OpenEXR.File(header, pixels).write(str(path))
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be written ({error.strerror})") from None
    except RuntimeError as error:
        raise HeightMapError(f"{path}: cannot be written ({' '.join(str(error).split())[:100]})") from None


EXR = Format("exr", "OpenEXR picture", (".exr",), read_exr, ((0, MAGIC),), units_from_user="scales", place=16)
