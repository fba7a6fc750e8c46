"""The white reference file: a flat picture of a tile, written by ``calibrate flat`` and read by every inspection."""

import hashlib
import io
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.atomicfile import write_bytes
from anisoscope.errors import CalibrationError, RecordError
from anisoscope.linear import Stack, WhiteReference, hot_pixels

_KIND = "anisoscope white reference"


def make_reference(
    flat: Stack, dark: Stack, *, reflectance: float, light_cosine: float, camera: str, full_scale: int
) -> dict[str, Any]:
    """Signal and metadata of a white reference from flat and dark frames.

    Args:
        flat: frames of the white tile, light on.
        dark: frames with the light off, taken alike.
        reflectance: reflectance of the tile, 0 to 1.
        light_cosine: cosine of the angle between the light and the normal of the tile.
        camera: serial number of the camera.
        full_scale: largest count of the camera.

    Raises:
        CalibrationError: the tile is saturated or dark.
    """
    saturated = float(flat.saturated.mean())
    if saturated > 0.001:
        raise CalibrationError(
            f"{saturated:.1%} of the flat are saturated: shorten --exposure and take it again"
        )
    signal = flat.mean - dark.mean
    level = float(np.median(signal)) / full_scale
    if level < 0.05:
        raise CalibrationError(
            f"the flat reaches only {level:.1%} of full scale: lengthen --exposure, light on?"
        )
    signal = np.where(hot_pixels(dark), np.nan, signal) / (flat.exposure_s * flat.gain)
    signal = np.where(np.isnan(signal), np.nanmedian(signal), signal)
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
            "frames": flat.frames,
            "exposure_s": flat.exposure_s,
            "gain": flat.gain,
            "level": level,
            "taken_at": datetime.now(UTC).isoformat(timespec="seconds"),
        },
    }


def write_reference(path: Path, reference: dict[str, Any]) -> None:
    """Write a white reference as a 32-bit TIFF with its metadata, all or nothing.

    Raises:
        RecordError: the folder cannot be made or written.
    """
    import tifffile  # noqa: PLC0415

    buffer = io.BytesIO()
    tifffile.imwrite(buffer, reference["signal"], description=json.dumps(reference["meta"]), metadata=None)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(f"cannot write {path}: {error.strerror}") from error
    write_bytes(path, buffer.getvalue())


def read_reference(path: Path) -> WhiteReference:
    """Read a white reference.

    Raises:
        CalibrationError: missing, damaged, or not a white reference.
    """
    import tifffile  # noqa: PLC0415

    advice = "take one with `anisoscope calibrate flat`"
    if not path.is_file():
        raise CalibrationError(f"the flat {path} does not exist: {advice}")
    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages.first
            signal, meta = page.asarray(), json.loads(page.description)
        if meta["kind"] != _KIND:
            raise CalibrationError(f"{path} is not a white reference: {advice}")
        if signal.ndim != 2 or not np.isfinite(signal).all() or np.median(signal) <= 0.0:
            raise CalibrationError(f"{path} holds no picture of a white tile: {advice}")
        return WhiteReference(
            np.asarray(signal, dtype=np.float32),
            float(meta["radiance"]),
            str(meta["camera"]),
            str(meta["taken_at"]),
            float(meta["reflectance"]),
            hashlib.sha256(path.read_bytes()).hexdigest(),
        )
    except CalibrationError:
        raise
    except Exception as error:
        raise CalibrationError(f"the flat {path} cannot be read ({error}): {advice}") from error
