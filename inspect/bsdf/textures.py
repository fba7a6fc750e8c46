"""Textures for renderers: heights and normals as EXR and 16-bit PNG, and masks of classes of fields or dots.

Pictures have the greatest y in their first row. Normals are coded as (n + 1)/2 in red, green and blue; heights of a PNG
run from its lowest to its highest point, which the caller states.
"""

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.profiles.heightmap import HeightMap

WORDS = 65535.0
"""Highest value of a 16-bit picture."""


@dataclass(frozen=True)
class HeightTextures:
    """Textures of a height map.

    Attributes:
        files: that were written.
        lowest_um, highest_um: heights of black and white of the PNG.
        step_nm: height of one of its levels.
        normal_step_deg: largest error of a normal of the PNG by its levels.
        without_exr: OpenEXR is not installed: no EXR files.
    """

    files: tuple[str, ...]
    lowest_um: float
    highest_um: float
    step_nm: float
    normal_step_deg: float
    without_exr: bool


def write_height_textures(surface: HeightMap, folder: Path) -> HeightTextures:
    """Write ``height`` and ``normals`` of a map into a folder.

    Raises:
        HeightMapError: a pixel without a height.
        RecordError: a file cannot be written.
    """
    height = surface.height_um
    missing = float(np.mean(~np.isfinite(height)))
    if missing:
        raise HeightMapError(
            f"{missing:.2%} of the pixels have no height, and textures know none: `anisoscope profile fill` first"
        )
    low, high = float(height.min()), float(height.max())
    span = max(high - low, 1e-9)
    normals = normals_of(surface)
    write_png16(folder / "height.png", (height[::-1] - low) / span)
    write_png16(folder / "normals.png", 0.5 * (normals[::-1] + 1.0))
    files = ["height.png", "normals.png"]
    if has_exr():
        write_exr(folder / "height.exr", {"Y": height[::-1]})
        write_exr(folder / "normals.exr", {c: 0.5 * (normals[::-1, :, k] + 1.0) for k, c in enumerate("RGB")})
        files += ["height.exr", "normals.exr"]
    worst = float(np.degrees(np.sqrt(3.0) / WORDS))
    return HeightTextures(tuple(files), low, high, 1e3 * span / WORDS, worst, not has_exr())


def normals_of(surface: HeightMap) -> FloatArray:
    """(rows − 1, cols − 1, 3) normals of the facets between four points, by their symmetric gradients."""
    z = surface.height_um
    x = 0.5 * (z[:-1, 1:] - z[:-1, :-1] + z[1:, 1:] - z[1:, :-1]) / surface.pixel_x_um
    y = 0.5 * (z[1:, :-1] - z[:-1, :-1] + z[1:, 1:] - z[:-1, 1:]) / surface.pixel_y_um
    normal = np.stack([-x, -y, np.ones_like(x)], axis=-1)
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def write_masks(folder: Path, classes: npt.NDArray[np.integer]) -> list[str]:
    """Write a mask for every class but the first, white where it is; returns the names of the files.

    Args:
        folder: of the files.
        classes: (rows, cols) class of every field or dot, from 0, first row at the top.

    Raises:
        RecordError: a file cannot be written.
    """
    names = []
    for number in range(1, int(classes.max()) + 1):
        names.append(f"mask-{number}.png")
        _write_png(folder / names[-1], np.where(classes == number, 255, 0).astype(np.uint8))
    return names


def has_exr() -> bool:
    """Whether EXR files can be written."""
    return importlib.util.find_spec("OpenEXR") is not None


def write_exr(path: Path, channels: dict[str, FloatArray]) -> None:
    """Write channels (rows, cols) as 32-bit floats, first row at the top.

    Raises:
        UsageError: the file cannot be written.
    """
    library: Any = importlib.import_module("OpenEXR")
    header = {"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage}
    pixels = {name: np.ascontiguousarray(one, dtype=np.float32) for name, one in channels.items()}
    try:
        library.File(header, pixels).write(str(path))
    except (OSError, RuntimeError) as problem:
        raise UsageError(f"{path}: cannot be written ({problem})") from None


def write_png16(path: Path, values: FloatArray) -> None:
    """Write values (rows, cols) or (rows, cols, 3) from 0 to 1 as a 16-bit PNG; errors as for `write_bytes`."""
    words = np.rint(WORDS * np.clip(values, 0.0, 1.0)).astype(np.uint16)
    _write_png(path, words if words.ndim == 2 else words[..., ::-1])


def _write_png(path: Path, picture: npt.NDArray[Any]) -> None:
    write_bytes(path, cv2.imencode(".png", np.ascontiguousarray(picture))[1].tobytes())
