"""Calibrations whose result is a picture: white reference, dark picture, stray light."""

from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.errors import CalibrationError, RigFileError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.calibration.frames import Bed, calibration_bed, write_picture
from anisoscope.calibration.record import (
    CalibrationRecord,
    Kind,
    Value,
    dated,
    days_of,
    picture_of,
    picture_path,
    record_path,
    write_calibration,
)
from anisoscope.calibration.white_reference import (
    inspect_tile,
    make_reference,
    read_reference,
    write_reference,
)
from anisoscope.imaging.linearisation import Stack, WhiteReference, check_size
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.taking import Taking
from anisoscope.rig.rigfile import read_rig
from anisoscope.sim.light.geometry import directions

TOO_BRIGHT_STRAY = 0.05


def take_flat(
    rig_path: Path,
    out: Path,
    *,
    exposure_s: float,
    frames: int = 16,
    reflectance: float = 0.99,
    on_progress: Advance = silent,
) -> dict[str, Any]:
    """Photograph a white tile with usual settings; see `calibrate_flat`.

    Returns:
        The metadata of the reference.
    """
    meta, _ = calibrate_flat(
        rig_path, out, Taking(exposure_s, frames=frames), reflectance=reflectance, on_progress=on_progress
    )
    return meta


def calibrate_flat(
    rig_path: Path,
    out: Path,
    taking: Taking,
    *,
    reflectance: float = 0.99,
    on_progress: Advance = silent,
) -> tuple[dict[str, Any], CalibrationRecord]:
    """Photograph a white tile that fills the picture; write the white reference and its record.

    The stage does not move. An arm with a tilt axis is set to 0°.

    Args:
        rig_path: rig file.
        out: file to write (TIFF); the record is written next to it.
        taking: exposure, gain, frames; the same number of frames is recorded with the light off.
        reflectance: reflectance of the tile, 0 to 1.
        on_progress: called with what is being done, steps done and steps in all.

    Returns:
        The metadata of the reference, and its record.

    Raises:
        UsageError: a reflectance outside 0 to 1.
        RigFileError, RigError: the rig.
        CalibrationError: the tile is saturated or dark.
        RecordError: a file cannot be written.
    """
    if not 0.0 < reflectance <= 1.0:
        raise UsageError(f"the reflectance of the tile must lie between 0 and 1, not {reflectance}")
    days_of("flat", taking.valid_days)
    with calibration_bed(rig_path, taking, on_progress) as bed:
        dark, flat = bed.stack("dark", taking), bed.stack("flat", taking)
        light_cosine = _light_cosine(bed)
        content = bed.content(taking, 2 * taking.frames, flat)
        reference = make_reference(
            flat,
            dark,
            reflectance=reflectance,
            light_cosine=light_cosine,
            camera=bed.camera.serial,
            full_scale=bed.full_scale,
            filters=bed.rig.camera.info.filters,
        )
    write_reference(out, reference)
    tile = inspect_tile(reference["signal"], _relative_noise(flat, dark), reference["meta"]["filters"])
    meta: dict[str, Any] = reference["meta"]
    content |= {
        "values": {
            "radiance": Value(value=meta["radiance"], unit="1/sr"),
            "level": Value(value=meta["level"]),
            "gradient": Value(value=tile.gradient),
            "structure": Value(value=tile.structure),
            "spots": Value(value=tile.spots),
        },
        "details": {"reflectance": reflectance, "light_cosine": light_cosine},
        "remarks": tile.remarks,
        "picture": picture_of(out),
    }
    return meta, _written("flat", content, out, taking)


def calibrate_dark(
    rig_path: Path, out: Path, taking: Taking, *, on_progress: Advance = silent
) -> CalibrationRecord:
    """Photograph with the light off: mean dark picture, hot pixels, level and noise.

    The picture has two pages: mean counts, and 1 where a pixel is hot.

    Args:
        rig_path: rig file.
        out: file to write; picture and record share its name.
        taking: exposure and gain of the inspections that will use it.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        RigFileError, RigError: the rig.
        RecordError: a file cannot be written.
    """
    days_of("dark", taking.valid_days)
    with calibration_bed(rig_path, taking, on_progress) as bed:
        dark = bed.stack("dark", taking)
        content = bed.content(taking, taking.frames, dark)
        full_scale = bed.full_scale
    _write_alongside(out, np.stack([dark.mean, dark.hot.astype(np.float32)]))
    level, hot = float(np.median(dark.mean)), float(dark.hot.mean())
    noise = float(np.sqrt(np.mean(np.square(dark.noise[~dark.hot], dtype=np.float64))))
    pattern = float(np.std(dark.mean[~dark.hot], dtype=np.float64))
    remarks = []
    if level > 0.2 * full_scale:
        remarks.append(
            f"the dark level is {level / full_scale:.0%} of full scale: does light reach the camera?"
        )
    if hot > 0.01:
        remarks.append(f"{hot:.1%} of the pixels are hot: cool the camera, or shorten the exposure")
    content |= {
        "values": {
            "level": Value(value=level, u=max(dark.flicker, noise / np.sqrt(dark.mean.size)), unit="counts"),
            "noise": Value(
                value=noise, u=noise / np.sqrt(2.0 * dark.mean.size * (dark.frames - 1)), unit="counts"
            ),
            "pattern": Value(value=pattern, unit="counts"),
            "hot_share": Value(value=hot),
        },
        "in_limits": not remarks,
        "remarks": tuple(remarks),
        "picture": picture_of(picture_path(out)),
    }
    return _written("dark", content, out, taking)


def calibrate_stray(
    rig_path: Path,
    out: Path,
    taking: Taking,
    *,
    target_reflectance: float = 1e-4,
    on_progress: Advance = silent,
) -> CalibrationRecord:
    """Photograph black glass or a light trap under the lit lamp: the remaining signal is stray light.

    The picture holds counts per second at gain 1. The uncertainty of the stray radiance is that of its mean, of the
    flat's scale, and of the light reflected by the target itself: anything up to its reflectance.

    Args:
        rig_path: rig file; its flat gives the scale.
        out: file to write; picture and record share its name.
        taking: a long exposure is best.
        target_reflectance: upper limit of the diffuse reflectance of the target.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        UsageError: a reflectance outside 0 to 1.
        RigFileError, RigError: the rig; it names no flat, or one that does not exist.
        CalibrationError: no dark target.
        RecordError: a file cannot be written.
    """
    if not 0.0 <= target_reflectance < 1.0:
        raise UsageError(f"the reflectance of the target must lie between 0 and 1, not {target_reflectance}")
    days_of("stray", taking.valid_days)
    part = read_rig(rig_path, channel=taking.light_channel).calibration
    if part is None:
        raise RigFileError(
            f"{rig_path} names no flat, which scales stray light: take one with `anisoscope calibrate flat` first"
        )
    white = read_reference(part.flat)
    with calibration_bed(rig_path, taking, on_progress) as bed:
        if white.camera != bed.camera.serial:
            raise CalibrationError(
                f"the flat was taken with camera {white.camera}, this is {bed.camera.serial}: "
                "take a new one with `anisoscope calibrate flat`"
            )
        check_size(white, (bed.camera.rows, bed.camera.cols))
        dark, lit = bed.stack("dark", taking), bed.stack("stray", taking)
        light_cosine = _light_cosine(bed)
        content = bed.content(taking, 2 * taking.frames, lit)
    radiance, noise = _stray_radiance(lit, dark, white)
    if radiance > TOO_BRIGHT_STRAY * white.radiance:
        raise CalibrationError(
            f"the target is {radiance / white.radiance:.0%} as bright as the tile (limit {TOO_BRIGHT_STRAY:.0%}): "
            "lay black glass or a light trap on the stage, and keep other light off the rig"
        )
    signal = (lit.mean - dark.mean) / np.float32(lit.exposure_s * lit.gain)
    _write_alongside(out, np.where(dark.hot | lit.saturated, np.float32(np.median(signal)), signal))
    own = target_reflectance * light_cosine / np.pi / np.sqrt(3.0)
    content |= {
        "values": {
            "stray_radiance": Value(value=radiance, u=float(np.hypot(noise, own)), unit="1/sr"),
            "share_of_tile": Value(value=radiance / white.radiance),
        },
        "details": {"target_reflectance": target_reflectance, "flat_sha256": white.sha256},
        "picture": picture_of(picture_path(out)),
    }
    return _written("stray", content, out, taking)


def _stray_radiance(lit: Stack, dark: Stack, white: WhiteReference) -> tuple[float, float]:
    """Mean radiance [1/sr] over the picture, and its standard uncertainty from noise and flicker."""
    used = ~(dark.hot | lit.saturated | white.unlit)
    scale = white.radiance_per_signal[used] / (lit.exposure_s * lit.gain)
    signal = (lit.mean - dark.mean)[used]
    pixel = np.mean(scale) * np.sqrt(np.mean(lit.noise[used] ** 2) / lit.frames / used.sum())
    common = np.mean(scale) * np.hypot(lit.flicker / np.sqrt(lit.frames), dark.flicker / np.sqrt(dark.frames))
    return float(np.mean(scale * signal, dtype=np.float64)), float(np.hypot(pixel, common))


def _relative_noise(flat: Stack, dark: Stack) -> float:
    """Standard deviation of a pixel of the mean flat that noise alone makes, by the signal."""
    noise = float(np.median(flat.noise)) / np.sqrt(flat.frames)
    return float(noise / max(float(np.median(flat.mean - dark.mean)), 1e-9))


def _light_cosine(bed: Bed) -> float:
    """Cosine of the angle between the light and the normal of the stage."""
    convention = Convention(bed.file.light.angle_deg)
    to_light, _ = directions((Pose(0.0, bed.tilt_deg),), convention)
    return float(to_light[0, 2])


def _write_alongside(out: Path, picture: np.ndarray[Any, np.dtype[np.float32]]) -> None:
    write_picture(picture_path(out), picture)


def _written(kind: Kind, content: dict[str, Any], out: Path, taking: Taking) -> CalibrationRecord:
    record = dated(kind, content, valid_days=taking.valid_days)
    write_calibration(record, record_path(out))
    return record
