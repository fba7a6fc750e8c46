"""File formats of reflectance: export with what each one loses, import by content."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.bsdf.klems import read_klems, write_klems
from anisoscope.bsdf.merl import RGB_NM, is_merl, read_merl, write_merl
from anisoscope.bsdf.mitsuba_scene import Shape, write_scene
from anisoscope.bsdf.reflectance import Reflectance, hemisphere, shuffled
from anisoscope.bsdf.rgl import Resolution, read_rgl, write_rgl
from anisoscope.bsdf.tensor_file import MAGIC as TENSOR_MAGIC
from anisoscope.bsdf.zemax import is_zemax, read_zemax, write_zemax
from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.colour.observer import xyz_weights
from anisoscope.sim.light.colour.spaces import linear_srgb

FormatName = Literal["rgl", "merl", "zemax", "klems"]
_SUFFIXES: dict[str, FormatName] = {".bsdf": "rgl", ".binary": "merl", ".xml": "klems"}
_HEAD = 4096
_COMPARED = 4096
_HIGHEST_DEG, _NORMAL_DEG = 60.0, 30.0


@dataclass(frozen=True)
class Exported:
    """An export.

    Attributes:
        format: of the file.
        size: of the file in bytes.
        losses: what the format does not hold, one sentence each.
        rms: rms of (file − source) over the rms of the source, in directions to 60° and half vectors to 30° from the
            normal, where lobes are.
    """

    format: FormatName
    size: int
    losses: tuple[str, ...]
    rms: float


def format_of(path: Path) -> FormatName:
    """The format to write, by the extension.

    Raises:
        UsageError: an extension of none of them.
    """
    found = _SUFFIXES.get(path.suffix.lower())
    if found is None:
        raise UsageError(
            f"{path}: .bsdf is RGL, .binary MERL, .xml Klems; name the format of another extension with --file-format "
            "(Zemax' files end in .bsdf as well)"
        )
    return found


def export(
    reflectance: Reflectance,
    path: Path,
    name: FormatName,
    resolution: Resolution | None = None,
    on_progress: Advance = silent,
    scene: tuple[Path, Shape] | None = None,
) -> Exported:
    """Write a reflectance, read the file back, and compare.

    Args:
        reflectance: what is written.
        path: the file.
        name: its format.
        resolution: of an RGL file.
        on_progress: called with what is being done, steps done and steps in all.
        scene: scene for Mitsuba to write as well, and the shape in it; of an RGL file.

    Raises:
        UsageError: the format cannot hold it, or the file would be huge.
        RecordError: the file cannot be written.
    """
    losses = list(reflectance.notes)
    if name == "merl" and reflectance.channels > 1:
        reflectance = _in_rgb(reflectance)
        losses.append("of the spectrum only linear sRGB under D65 is kept; negative values are cut to 0")
    if name in ("zemax", "klems") and reflectance.channels > 1:
        reflectance = _luminous(reflectance)
        losses.append(
            "of the spectrum only the luminous mean under D65 is kept; --wavelength keeps one wavelength"
        )
    reader: Callable[[Path], Reflectance]
    if name == "rgl":
        write_rgl(reflectance, path, resolution, on_progress)
        reader = read_rgl
        if scene is not None:
            write_scene(scene[0], path, scene[1])
    elif name == "merl":
        write_merl(reflectance, path)
        reader = read_merl
    elif name == "zemax":
        write_zemax(reflectance, path, on_progress)
        reader = read_zemax
        if not reflectance.isotropic:
            losses.append("OpticStudio's scatter model uses one sample rotation only; other programs use all")
    else:
        write_klems(reflectance, path, on_progress)
        reader = read_klems
        losses.append("lobes narrower than the patches (10° wide near the normal) are spread over them")
    return Exported(name, path.stat().st_size, tuple(losses), deviation(reader(path), reflectance))


def read_reflectance(path: Path) -> Reflectance:
    """Read a file of any of these formats, identified by its content.

    Raises:
        UsageError: it cannot be read, or is of none of them.
    """
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD)
    except OSError as problem:
        raise UsageError(f"cannot read {path}: {problem.strerror or problem}") from problem
    if head.startswith(TENSOR_MAGIC):
        return read_rgl(path)
    if is_merl(head):
        return read_merl(path)
    if head.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(b"<"):
        return read_klems(path)
    if is_zemax(head):
        return read_zemax(path)
    raise UsageError(
        f"{path}: none of the formats that are read: RGL .bsdf, MERL binary, Klems XML, Zemax BSDF (a table of single "
        "directions is read by bsdf import)"
    )


def is_reflectance_file(path: Path) -> bool:
    """Whether a file is of one of these formats; a table of text is not."""
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD)
    except OSError:
        return False
    return head.startswith((TENSOR_MAGIC, b"<")) or is_merl(head) or is_zemax(head)


def deviation(one: Reflectance, other: Reflectance) -> float:
    """Rms difference of two reflectances over the rms of the second; `Exported.rms` says where."""
    light, camera = compared_directions()
    difference = one.evaluate(light, camera) - (reference := other.evaluate(light, camera))
    return float(np.sqrt(np.mean(difference**2) / max(float(np.mean(reference**2)), 1e-300)))


def compared_directions() -> tuple[FloatArray, FloatArray]:
    """(N, 3) unit vectors to light and camera on which reflectances are compared."""
    light = hemisphere(_COMPARED, _HIGHEST_DEG)
    normal = shuffled(hemisphere(_COMPARED, _NORMAL_DEG, 0.5))
    camera = 2.0 * np.sum(light * normal, axis=1, keepdims=True) * normal - light
    up = camera[:, 2] > np.cos(np.radians(_HIGHEST_DEG))
    return light[up], camera[up]


def _in_rgb(reflectance: Reflectance) -> Reflectance:
    """Blue, green and red under the wavelengths by which MERL files know them."""
    if reflectance.wavelengths_nm == RGB_NM:
        return reflectance
    weights = xyz_weights(standard("D65"), np.array(reflectance.wavelengths_nm))
    return replace(
        reflectance,
        evaluate=lambda light, camera: np.maximum(
            linear_srgb(reflectance.evaluate(light, camera) @ weights), 0.0
        )[:, ::-1],
        wavelengths_nm=RGB_NM,
    )


def _luminous(reflectance: Reflectance) -> Reflectance:
    if reflectance.wavelengths_nm == RGB_NM:
        weights = np.array([0.0722, 0.7152, 0.2126])
    else:
        weights = xyz_weights(standard("D65"), np.array(reflectance.wavelengths_nm))[:, 1]
    return replace(
        reflectance,
        evaluate=lambda light, camera: (reflectance.evaluate(light, camera) @ weights)[:, None],
        wavelengths_nm=(),
    )
