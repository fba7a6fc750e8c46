"""The white reference file: a flat picture of a tile, written by ``calibrate flat`` and read by every inspection."""

import hashlib
import io
import json
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import CalibrationError, RecordError, RigFileError
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.imaging.linearisation import Stack, WhiteReference, hot_pixels
from anisoscope.rig.bayer import channel_of_pixels

_KIND = "anisoscope white reference"
SPOT_SHARE = 0.02
MAX_SPOTS, MAX_STRUCTURE, MAX_GRADIENT = 0.0005, 0.01, 0.2


def make_reference(
    flat: Stack,
    dark: Stack,
    *,
    reflectance: float,
    light_cosine: float,
    camera: str,
    full_scale: int,
    filters: str = "mono",
) -> dict[str, Any]:
    """Signal and metadata of a white reference from flat and dark frames.

    Args:
        flat: frames of the white tile, light on.
        dark: frames with the light off, same exposure and gain.
        reflectance: reflectance of the tile, 0 to 1.
        light_cosine: cosine of the angle between the light and the normal of the tile.
        camera: serial number of the camera.
        full_scale: largest count of the camera.
        filters: the colour filters on its pixels, as `anisoscope.rig.bayer` names them.

    Raises:
        CalibrationError: the tile is saturated or dark.
    """
    hot = hot_pixels(dark)
    saturated = float(np.mean(flat.saturated & ~hot))  # a defective pixel says nothing about the exposure
    if saturated > 0.001:
        raise CalibrationError(
            f"{saturated:.1%} of the flat are saturated: shorten --exposure and take it again"
        )
    signal = flat.mean - dark.mean
    usual = usual_of_filters(signal, filters, hot)
    level = float(usual.min()) / full_scale
    if level < 0.05:
        raise CalibrationError(
            f"the flat reaches only {level:.1%} of full scale: lengthen --exposure, light on?"
        )
    signal = np.where(hot, usual, signal) / (flat.exposure_s * flat.gain)
    return {
        "signal": signal.astype(np.float32),
        "meta": {
            "kind": _KIND,
            "schema": 1,
            "unit": "counts per second at gain 1, dark subtracted",
            "radiance": reflectance * light_cosine / float(np.pi),
            "light_cosine": light_cosine,
            "reflectance": reflectance,
            "camera": camera,
            "filters": filters,
            "frames": flat.frames,
            "exposure_s": flat.exposure_s,
            "gain": flat.gain,
            "level": level,
            "taken_at": datetime.now(UTC).isoformat(timespec="seconds"),
        },
    }


def usual_of_filters(
    signal: npt.NDArray[np.float32], filters: str, hot: npt.NDArray[np.bool_] | None = None
) -> npt.NDArray[np.float32]:
    """(rows, cols) median of the pixels behind the filter of each pixel, without hot ones; of all without filters."""
    channel = channel_of_pixels(filters, (signal.shape[0], signal.shape[1]))
    good = np.ones(signal.shape, dtype=bool) if hot is None else ~hot
    medians = [np.median(signal[(channel == one) & good]) for one in range(int(channel.max()) + 1)]
    return np.array(medians, dtype=np.float32)[channel]


def write_reference(path: Path, reference: dict[str, Any]) -> None:
    """Write a white reference as a 32-bit TIFF with its metadata, atomically.

    Raises:
        RecordError: the folder cannot be made or written.
    """
    import tifffile  # noqa: PLC0415 - start-up time

    buffer = io.BytesIO()
    tifffile.imwrite(buffer, reference["signal"], description=json.dumps(reference["meta"]), metadata=None)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(f"cannot write {path}: {error.strerror}") from error
    write_bytes(path, buffer.getvalue())


_ADVICE = "take one with `anisoscope calibrate flat`"


def read_reference(path: Path) -> WhiteReference:
    """Read a white reference; the last one is remembered, until its file changes.

    Raises:
        RigFileError: there is no such file.
        CalibrationError: damaged, or not a white reference.
    """
    if not path.is_file():
        raise RigFileError(f"the flat {path} does not exist: {_ADVICE}")
    found = path.stat()
    return _reference_of(path, (found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino))


@lru_cache(maxsize=1)
def _reference_of(path: Path, _state: tuple[int, ...]) -> WhiteReference:
    import tifffile  # noqa: PLC0415 - start-up time

    try:
        content = bounded_bytes(path, MOST_PICTURE_BYTES)
        with tifffile.TiffFile(io.BytesIO(content)) as file:
            page = file.pages.first
            signal, meta = page.asarray(), json.loads(page.description)
        signal.flags.writeable = False
        if meta["kind"] != _KIND:
            raise CalibrationError(f"{path} is not a white reference: {_ADVICE}")
        if signal.ndim != 2 or not np.isfinite(signal).all() or np.median(signal) <= 0.0:
            raise CalibrationError(f"{path} holds no picture of a white tile: {_ADVICE}")
        return WhiteReference(
            np.asarray(signal, dtype=np.float32),
            float(meta["radiance"]),
            str(meta["camera"]),
            str(meta["taken_at"]),
            float(meta["reflectance"]),
            hashlib.sha256(content).hexdigest(),
            str(meta.get("filters", "mono")),
        )
    except CalibrationError:
        raise
    except Exception as error:
        raise CalibrationError(f"the flat {path} cannot be read ({error}): {_ADVICE}") from error


def exposure_for(path: Path, radiance: float, level: float, gain: float = 1.0) -> float:
    """Exposure in seconds at which a radiance reaches a share of the camera's full scale.

    Args:
        path: of the white reference, which states how far the tile reached at its own exposure.
        radiance: in 1/sr.
        level: share of full scale.
        gain: of the camera.

    Raises:
        CalibrationError: as for `read_reference`, or an early one that does not state its level.
    """
    import tifffile  # noqa: PLC0415 - start-up time

    white = read_reference(path)
    with tifffile.TiffFile(path) as file:
        meta = json.loads(file.pages.first.description)
    try:
        reached = float(meta["level"]) / (float(meta["exposure_s"]) * float(meta["gain"]))
    except KeyError:
        raise CalibrationError(
            f"the flat {path} does not state how bright the tile was: take it again with `anisoscope calibrate flat`"
        ) from None
    usual = usual_of_filters(white.signal, white.filters)  # the level is that of the darkest filter
    return float(level / (reached * usual.max() / usual.min() * gain * radiance / white.radiance))


@dataclass(frozen=True)
class Tile:
    """Properties of the tile itself, measured with the flat.

    Attributes:
        gradient: brightness at the edges of the picture along its steepest direction, bright by dark side, minus 1;
            a vignette is even and does not count.
        structure: robust relative scatter of 3 × 3 pixels about their surroundings, minus the contribution of noise.
        spots: share of the picture that differs from its surroundings by more than 2 % and five times the scatter.
        remarks: notes for the operator.
    """

    gradient: float
    structure: float
    spots: float
    remarks: tuple[str, ...]


def inspect_tile(signal: npt.NDArray[np.float32], noise: float, filters: str = "mono") -> Tile:
    """Check that the tile is clean and evenly lit.

    Args:
        signal: (rows, cols) of the white reference.
        noise: relative standard deviation of a pixel due to noise alone.
        filters: the colour filters on the pixels; the mosaic of a white tile is not counted as structure.
    """
    if filters != "mono":
        signal = signal / usual_of_filters(signal, filters)
    rows, cols = signal.shape
    window = max(5, min(rows, cols) // 8 | 1)
    small = cv2.blur(signal, (3, 3))
    ratio = small / cv2.blur(cv2.medianBlur(small, 5), (window, window)) - 1.0
    ratio = np.asarray(ratio - cv2.blur(np.asarray(ratio, dtype=np.float32), (window, window)))
    scatter = 1.4826 * float(np.median(np.abs(ratio)))
    structure = float(np.sqrt(max(scatter**2 - (noise / 3.0) ** 2, 0.0)))
    spots = float(np.mean(np.abs(ratio) > max(SPOT_SHARE, 5.0 * scatter)))
    y, x = np.meshgrid(np.linspace(-1.0, 1.0, rows), np.linspace(-1.0, 1.0, cols), indexing="ij")
    level = float(signal.mean(dtype=np.float64))
    across, down = (float(np.sum(axis * signal) / np.sum(axis**2)) / level for axis in (x, y))
    gradient = 2.0 * float(np.hypot(across, down))
    remarks = []
    if spots > MAX_SPOTS:
        remarks.append(
            f"{spots:.2%} of the flat are spots (usual at most {MAX_SPOTS:.2%}): clean tile and lens"
        )
    if structure > MAX_STRUCTURE:
        remarks.append(
            f"the flat is mottled by {structure:.2%} (usual at most {MAX_STRUCTURE:.0%}): clean the tile"
        )
    if gradient > MAX_GRADIENT:
        remarks.append(
            f"the flat rises by {gradient:.0%} across the picture (usual at most {MAX_GRADIENT:.0%}): centre the "
            "light, lay the tile flat"
        )
    return Tile(gradient, structure, spots, tuple(remarks))
