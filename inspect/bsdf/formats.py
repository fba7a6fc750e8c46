"""File formats of reflectance: export with what each one loses, import by content."""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.plugins import Registry
from anisoscope.base.progress import Advance, silent
from anisoscope.base.regular_file import regular_file
from anisoscope.bsdf.file_format import BsdfFile
from anisoscope.bsdf.klems import write_klems
from anisoscope.bsdf.merl import RGB_NM, read_merl, write_merl
from anisoscope.bsdf.mitsuba_scene import Shape, write_scene
from anisoscope.bsdf.reflectance import Reflectance, hemisphere, physics_of, shuffled
from anisoscope.bsdf.rgl import COARSE, HIGHEST_DEG, Resolution, read_rgl, write_rgl
from anisoscope.bsdf.tensor_tree import write_tensor_tree
from anisoscope.bsdf.zemax import ROTATION_DEG, write_zemax
from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.colour.observer import xyz_weights
from anisoscope.sim.light.colour.spaces import linear_srgb

FormatName = Literal["rgl", "merl", "zemax", "klems", "tensor-tree"]
BSDF_FILES = Registry("anisoscope.bsdf_files", "format of reflectance files", BsdfFile, UsageError)
"""Formats that are read, by name."""
_SUFFIXES: dict[str, FormatName] = {".bsdf": "rgl", ".binary": "merl", ".xml": "klems"}
_HEAD = 4096
_COMPARED = 4096
COARSE_FORMATS = {
    "klems": "a Klems matrix (93 % rms off in Radiance)",
    "tensor-tree": "a tensor tree (28 % rms off in Radiance)",
}
"""Formats that do not hold ridges; what Radiance gave of ridges of 10° and α .06 × .10."""
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
    *,
    coarse: bool = False,
) -> Exported:
    """Write a reflectance, read the file back, and compare.

    Args:
        reflectance: what is written.
        path: the file.
        name: its format.
        resolution: of an RGL file.
        on_progress: called with what is being done, steps done and steps in all.
        scene: scene for Mitsuba to write as well, and the shape in it; of an RGL file.
        coarse: write ridges as a Klems matrix or a tensor tree, too.

    Raises:
        UsageError: the format cannot hold it, or the file would be huge.
        RecordError: the file cannot be written.
    """
    if name in COARSE_FORMATS and reflectance.ridged and not coarse:
        raise UsageError(
            f"{reflectance.name}: {COARSE_FORMATS[name]} is not for ridges, whose lobes are narrower than its cells; "
            "write an RGL .bsdf, or --coarse to write it all the same"
        )
    losses = list(reflectance.notes)
    light, camera = compared_directions()
    source = reflectance.evaluate(light, camera)
    reflectance, lost = _in_channels(reflectance, name, source)
    losses += lost
    if reflectance.costly and name != "rgl":
        reflectance, text = _tabulated(reflectance, resolution, on_progress)
        losses.append(text)
    if lost or reflectance.channels != source.shape[1]:
        source = reflectance.evaluate(light, camera)
    if name == "rgl":
        write_rgl(reflectance, path, resolution, on_progress)
        if scene is not None:
            write_scene(scene[0], path, scene[1])
    else:
        _WRITERS[name](reflectance, path, on_progress)
    found = BSDF_FILES[name].read(path).evaluate(light, camera)
    losses += _of_format(name, reflectance, source, found)
    if name == "merl":
        cells = _rms(read_merl(path, nearest=True).evaluate(light, camera), source)
        losses.append(
            f"readers that take the nearest cell, as that of the data does, are {cells:.1%} rms off"
        )
    return Exported(name, path.stat().st_size, tuple(losses), _rms(found, source))


def _in_channels(
    reflectance: Reflectance, name: FormatName, source: FloatArray
) -> tuple[Reflectance, list[str]]:
    """The reflectance with the channels that a format holds, and what that loses."""
    many = reflectance.channels
    if many == 1 or name == "rgl":
        return reflectance, []
    if name == "merl":
        if reflectance.wavelengths_nm == RGB_NM:
            return reflectance, []
        linear = linear_srgb(source @ xyz_weights(standard("D65"), np.array(reflectance.wavelengths_nm)))
        text = (
            f"of {many} wavelengths 3 channels remain, linear sRGB under D65; {np.mean(linear < 0.0):.1%} of their "
            "values are negative and become 0"
        )
        return _in_rgb(reflectance), [text]
    luminous = _luminous(reflectance, source)
    off = _rms(np.broadcast_to(luminous, source.shape), source)
    text = (
        f"of {many} wavelengths one value remains, the luminous mean under D65, which is {off:.0%} rms off single "
        "wavelengths; --wavelength keeps one of them"
    )
    return _in_luminance(reflectance), [text]


def _tabulated(
    reflectance: Reflectance, resolution: Resolution | None, on_progress: Advance
) -> tuple[Reflectance, str]:
    """A reflectance that takes long to evaluate, read back from an RGL file, and what that loses."""
    size = resolution or COARSE
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sampled.bsdf"
        write_rgl(reflectance, path, size, on_progress)
        found = read_rgl(path)
    off = deviation(found, reflectance)
    text = (
        f"sampled on {size.theta} × {size.phi} directions of the light and {size.square} × {size.square} of the camera "
        f"first, {off:.1%} rms off; --nodes takes more"
    )
    return replace(found, name=reflectance.name), text


def _of_format(
    name: FormatName, reflectance: Reflectance, source: FloatArray, found: FloatArray
) -> list[str]:
    """What the format itself loses, in numbers."""
    negative = float(np.mean(source < 0.0))
    below = [f"{negative:.2%} of the values are negative; Radiance takes them as 0"] if negative else []
    peak = f"the highest value falls from {source.max():.3g} to {found.max():.3g} 1/sr"
    if name == "rgl":
        beyond = np.cos(np.radians(HIGHEST_DEG)) ** 2
        return [
            f"light from more than {HIGHEST_DEG:g}° takes the values of {HIGHEST_DEG:g}°: {beyond:.2%} of all light"
        ]
    if name == "zemax" and not reflectance.isotropic:
        turned = physics_of(reflectance).anisotropy
        text = (
            f"OpticStudio's scatter model uses one of the {len(ROTATION_DEG)} sample rotations, other programs all; a "
            f"quarter turn changes the values by {turned:.0%} rms"
        )
        return [text]
    if name == "klems":
        return [f"lobes narrower than the patches, 10° near the normal, are spread over them: {peak}", *below]
    if name == "tensor-tree":
        return [f"lobes narrower than the smallest cells are spread over them: {peak}", *below]
    return []


def read_reflectance(path: Path) -> Reflectance:
    """Read a file of any of these formats, identified by its content.

    Raises:
        UsageError: it cannot be read, or is of none of them.
    """
    try:
        head = _head(path)
    except OSError as problem:
        raise UsageError(f"cannot read {path}: {problem.strerror or problem}") from problem
    found = _file_that_begins(head)
    if found is None:
        titles = ", ".join(one.title for one in BSDF_FILES.values())
        raise UsageError(
            f"{path}: none of the formats that are read: {titles} (a table of single directions is read by bsdf import)"
        )
    return found.read(path)


def _head(path: Path) -> bytes:
    with regular_file(path) as stream:
        return stream.read(_HEAD)


def _file_that_begins(head: bytes) -> BsdfFile | None:
    return next((one for one in BSDF_FILES.values() if one.begins(head)), None)


_WRITERS: dict[FormatName, Callable[[Reflectance, Path, Advance], None]] = {
    "merl": lambda reflectance, path, _: write_merl(reflectance, path),
    "zemax": write_zemax,
    "klems": write_klems,
    "tensor-tree": write_tensor_tree,
}


def is_reflectance_file(path: Path) -> bool:
    """Whether a file is of one of these formats; a table of text is not."""
    try:
        return _file_that_begins(_head(path)) is not None
    except OSError:
        return False


def deviation(one: Reflectance, other: Reflectance) -> float:
    """Rms difference of two reflectances over the rms of the second; `Exported.rms` says where."""
    light, camera = compared_directions()
    return _rms(one.evaluate(light, camera), other.evaluate(light, camera))


def _rms(found: FloatArray, wanted: FloatArray) -> float:
    return float(np.sqrt(np.mean((found - wanted) ** 2) / max(float(np.mean(wanted**2)), 1e-300)))


def compared_directions(tried: int = _COMPARED) -> tuple[FloatArray, FloatArray]:
    """(N, 3) unit vectors to light and camera on which reflectances are compared.

    ``tried`` is a power of 2; those of its pairs are left out whose camera is lower than 60° from the normal.
    """
    light = hemisphere(tried, _HIGHEST_DEG)
    normal = shuffled(hemisphere(tried, _NORMAL_DEG, 0.5))
    camera = 2.0 * np.sum(light * normal, axis=1, keepdims=True) * normal - light
    up = camera[:, 2] > np.cos(np.radians(_HIGHEST_DEG))
    return light[up], camera[up]


def _in_rgb(reflectance: Reflectance) -> Reflectance:
    """Blue, green and red under the wavelengths by which MERL files know them."""
    weights = xyz_weights(standard("D65"), np.array(reflectance.wavelengths_nm))
    return replace(
        reflectance,
        evaluate=lambda light, camera: np.maximum(
            linear_srgb(reflectance.evaluate(light, camera) @ weights), 0.0
        )[:, ::-1],
        wavelengths_nm=RGB_NM,
    )


def _in_luminance(reflectance: Reflectance) -> Reflectance:
    return replace(
        reflectance,
        evaluate=lambda light, camera: _luminous(reflectance, reflectance.evaluate(light, camera)),
        wavelengths_nm=(),
    )


def _luminous(reflectance: Reflectance, values: FloatArray) -> FloatArray:
    """(N, 1) luminous means of (N, W) values."""
    if reflectance.wavelengths_nm == RGB_NM:
        weights = np.array([0.0722, 0.7152, 0.2126])
    else:
        weights = xyz_weights(standard("D65"), np.array(reflectance.wavelengths_nm))[:, 1]
    return np.asarray((values @ weights)[:, None])
