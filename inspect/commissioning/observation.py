"""Evaluation of commissioning pictures: markers, ridges and radiance of every pose, and pictures for the page.

The ridged part in a picture: its mean radiance over a spot that turns with it, and the direction of its ridges.

Ridges that the camera resolves are a wave in the picture. Its wave vector, the maximum of the windowed spectrum found
to a small part of a bin, lies across the ridges; carried through the map of the markers it is free of foreshortening.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError
from anisoscope.base.progress import Advance
from anisoscope.commissioning.markers import FLIP, Fix, edge_blur_px, find_fixture, modules_of
from anisoscope.commissioning.part import RidgedPart
from anisoscope.commissioning.series import Look, PictureSet
from anisoscope.rig.rigfile import RigFile

MIN_PERIODS = 4.0
MIN_PIXELS_PER_PITCH = 2.5
CLEAR = 30.0
_AROUND = 0.3  # share by which the wave number may differ from 1/pitch


@dataclass(frozen=True, eq=False)
class Spot:
    """Round spot of the sample in a picture, with weights that fall to 0 at its edge.

    Attributes:
        rows, cols: the rectangle of pixels that holds it.
        weight: its weights.
        center_px: (column, row).
        radius_mm: on the sample.
    """

    rows: slice
    cols: slice
    weight: FloatArray
    center_px: tuple[float, float]
    radius_mm: float


def frame_of(pixel_um: float, tilt_deg: float, shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Map in place of the markers' one on a rig without markers: an unturned fixture at the picture's centre.

    Returns:
        (2, 2) map from mm to pixels, (2,) origin.
    """
    squeeze = np.diag([1.0, np.cos(np.radians(tilt_deg))])
    return squeeze @ FLIP * (1000.0 / pixel_um), np.array([(shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0])


def spot_in(
    shape: tuple[int, int],
    matrix: FloatArray,
    origin_px: FloatArray,
    center_mm: tuple[float, float],
    radius_mm: float,
) -> Spot:
    """The pixels of a round spot of the sample.

    Args:
        shape: (rows, cols) of the picture.
        matrix: (2, 2) from sample mm to pixels (column, row).
        origin_px: (2,) pixel of the sample's origin.
        center_mm: middle of the spot on the sample.
        radius_mm: radius on the sample.

    Raises:
        MeasurementError: a part of it lies outside the picture.
    """
    middle = matrix @ np.asarray(center_mm) + origin_px
    reach = radius_mm * np.sqrt(np.sum(matrix**2, axis=1))
    low, high = np.floor(middle - reach).astype(int), np.ceil(middle + reach).astype(int) + 1
    if np.any(low < 0) or high[0] > shape[1] or high[1] > shape[0]:
        raise MeasurementError(
            f"the spot of {2 * radius_mm:g} mm on the part reaches beyond the picture: give a smaller --spot-mm"
        )
    cols, rows = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    offset = np.stack([cols - middle[0], rows - middle[1]]).reshape(2, -1)
    distance = np.hypot(*(np.linalg.inv(matrix) @ offset)).reshape(cols.shape) / radius_mm
    weight = np.where(distance < 1.0, np.cos(0.5 * np.pi * np.minimum(distance, 1.0)) ** 2, 0.0)
    return Spot(
        slice(int(low[1]), int(high[1])),
        slice(int(low[0]), int(high[0])),
        weight,
        (float(middle[0]), float(middle[1])),
        radius_mm,
    )


def mean_radiance(look: Look, spot: Spot) -> tuple[float, float]:
    """Weighted mean over the spot, and its relative standard uncertainty from the noise of the pixels.

    Raises:
        MeasurementError: next to no light there.
    """
    values = look.image[spot.rows, spot.cols].astype(np.float64)
    known = np.isfinite(values)
    weight = np.where(known, spot.weight, 0.0)
    total = float(weight.sum())
    if total < 0.8 * float(spot.weight.sum()):
        raise MeasurementError(
            f"at stage reading {look.reading_deg:g}° too many pixels of the part are saturated or hot: "
            "shorten --exposure"
        )
    mean = float(np.sum(weight * np.where(known, values, 0.0)) / total)
    noise = np.where(known, look.noise[spot.rows, spot.cols], 0.0).astype(np.float64)
    u = float(np.sqrt(np.sum((weight * noise) ** 2)) / total)
    if mean <= 5.0 * u:
        raise MeasurementError(
            f"at stage reading {look.reading_deg:g}° no light comes from the part: is the light on, the "
            "exposure long enough?"
        )
    return mean, u / mean


@dataclass(frozen=True)
class Wave:
    """Ridges as a plane wave in a picture.

    Attributes:
        wave_per_px: (column, row) wave vector, periods per pixel.
        clarity: power of its peak over the middle of the powers around.
    """

    wave_per_px: tuple[float, float]
    clarity: float


def ridge_wave(look: Look, spot: Spot, matrix: FloatArray, pitch_mm: float) -> Wave | None:
    """Plane wave of the ridges in the picture, or None where the camera does not resolve them.

    Args:
        look: the picture.
        spot: where the ridges are.
        matrix: (2, 2) from sample mm to pixels.
        pitch_mm: pitch of the ridges.
    """
    pixels_per_mm = float(np.sqrt(abs(np.linalg.det(matrix))))
    if pitch_mm * pixels_per_mm < MIN_PIXELS_PER_PITCH or 2 * spot.radius_mm / pitch_mm < MIN_PERIODS:
        return None
    values = look.image[spot.rows, spot.cols].astype(np.float64)
    known = np.isfinite(values) & (spot.weight > 0)
    mean = np.sum(np.where(known, values * spot.weight, 0.0)) / np.sum(spot.weight[known])
    window = np.where(known, (values - mean) * spot.weight, 0.0)
    size = int(2 ** np.ceil(np.log2(2 * max(window.shape))))
    power = np.abs(np.fft.fft2(window, (size, size))) ** 2
    v, u = np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size), indexing="ij")
    # in waves per pitch on the sample, so that foreshortening does not matter
    number = np.hypot(*(matrix.T @ np.stack([u.ravel(), v.ravel()]))).reshape(u.shape) * pitch_mm
    ring = np.abs(number - 1.0) < _AROUND
    best = np.unravel_index(np.argmax(np.where(ring, power, 0.0)), power.shape)
    clarity = float(power[best] / max(float(np.median(power[ring])), 1e-300))
    if clarity < CLEAR:
        return None
    start = np.array([u[best], v[best]])
    return Wave(_refined(window, start, 1.0 / size), clarity)


def _refined(window: FloatArray, start: FloatArray, step: float) -> tuple[float, float]:
    """Maximum of the spectrum near a start: paraboloids through ln |spectrum|² on ever finer 3 × 3 grids."""
    rows, cols = np.arange(window.shape[0]), np.arange(window.shape[1])
    at = start.copy()
    offsets = np.array([-1.0, 0.0, 1.0])
    for _ in range(4):
        across = np.exp(-2j * np.pi * np.outer(cols, at[0] + step * offsets))
        down = np.exp(-2j * np.pi * np.outer(at[1] + step * offsets, rows))
        height = np.log(np.abs(down @ window @ across) ** 2 + 1e-300)
        first = 0.5 * np.array([np.mean(height[:, 2] - height[:, 0]), np.mean(height[2] - height[0])])
        second = np.array(
            [
                np.mean(height[:, 2] + height[:, 0] - 2.0 * height[:, 1]),
                np.mean(height[2] + height[0] - 2.0 * height[1]),
            ]
        )
        shift = np.where(second < 0.0, -first / np.where(second < 0.0, second, -1.0), np.sign(first))
        at = at + step * np.clip(shift, -1.0, 1.0)
        step *= 0.5
    return float(at[0]), float(at[1])


def lean_line_deg(wave: Wave, squeeze: FloatArray) -> float:
    """Direction across the ridges in the untilted picture, counter-clockwise as seen, 0 to 180.

    Args:
        wave: the ridges' wave.
        squeeze: (2, 2) how the tilt squeezes pixels.
    """
    x, y = FLIP @ squeeze.T @ np.asarray(wave.wave_per_px)
    return float(np.degrees(np.arctan2(y, x)) % 180.0)


def squeeze_of(fix: Fix) -> FloatArray:
    """(2, 2) foreshortening of pixels from the markers: identity under an upright camera."""
    along = np.radians(fix.squeeze_deg)
    direction = np.array([np.cos(along), -np.sin(along)])
    return np.asarray(np.eye(2) - (1.0 - fix.squeeze) * np.outer(direction, direction), dtype=np.float64)


Image = npt.NDArray[np.float32]

PICTURES = 3
PICTURE_PX = 480


@dataclass(frozen=True, eq=False)
class ObservedPose:
    """Quantities measured in one picture.

    Attributes:
        reading_deg, tilt_reading_deg: readings of stage and tilt.
        again: the first pose, photographed again at the end.
        fix: the markers, or None.
        ridge_deg: direction across the ridges in the untilted picture, 0 to 180; None where they are not resolved.
        radiance, u_noise: mean over the spot, relative uncertainty from the noise of its pixels.
        flicker: relative change of the light from frame to frame.
    """

    reading_deg: float
    tilt_reading_deg: float
    again: bool
    fix: Fix | None
    ridge_deg: float | None
    radiance: float
    u_noise: float
    flicker: float


@dataclass(frozen=True, eq=False)
class Picture:
    """Picture for the page, reduced by `scale`.

    Attributes:
        image: (rows, cols).
        scale: pixels of it per pixel of the camera.
        reading_deg, tilt_reading_deg: where it was taken.
        corners_px: (N, 2) corners of the markers, camera pixels.
        center_px, radius_px: the spot, camera pixels.
        ridge_deg: direction across the ridges, or None.
    """

    image: Image
    scale: float
    reading_deg: float
    tilt_reading_deg: float
    corners_px: npt.NDArray[np.float64]
    center_px: tuple[float, float]
    radius_px: float
    ridge_deg: float | None


@dataclass(frozen=True, eq=False)
class Observed:
    """All poses in the order in which they were photographed, `blur_px` of the marker edges, pictures to show."""

    poses: tuple[ObservedPose, ...]
    blur_px: float | None
    pictures: tuple[Picture, ...]


def observe(picture_set: PictureSet, file: RigFile, part: RidgedPart, advance: Advance) -> Observed:
    """Evaluate every picture.

    Args:
        picture_set: the pictures.
        file: the rig file, for fixture and pixel size.
        part: where its ridges are, and their pitch.
        advance: progress.

    Raises:
        MeasurementError: the spot is dark, saturated or outside of a picture.
    """
    poses, pictures, blurs = [], [], []
    turn = [
        shots.pose.stage_deg
        for shots in picture_set.shots
        if shots.pose.tilt_deg == picture_set.shots[0].pose.tilt_deg
    ]
    chosen = {round(n * len(turn) / PICTURES) for n in range(PICTURES)}
    for number, look in enumerate(picture_set.looks()):
        advance("markers and ridges", number, len(picture_set.shots))
        fix = find_fixture(look.image, file.fixture) if file.fixture is not None else None
        found, spot = _see(look, fix, file, part)
        poses.append(found)
        if fix is not None and file.fixture is not None and fix.squeeze > 0.97:
            blurs.append(edge_blur_px(look.image, fix, modules_of(file.fixture.dictionary)))
        if number in chosen:
            pictures.append(_picture(look, found, spot))
    return Observed(tuple(poses), float(np.median(blurs)) if blurs else None, tuple(pictures))


def _see(look: Look, fix: Fix | None, file: RigFile, part: RidgedPart) -> tuple[ObservedPose, Spot]:
    if fix is not None:
        matrix, origin, center, squeeze = fix.matrix, fix.origin_px, part.center_mm, squeeze_of(fix)
    else:
        tilt = look.tilt_reading_deg - (file.tilt.zero_deg if file.tilt is not None else 0.0)
        matrix, origin = frame_of(file.camera.pixel_um, tilt, look.image.shape)
        center, squeeze = (0.0, 0.0), np.diag([1.0, np.cos(np.radians(tilt))])
    spot = spot_in(look.image.shape, matrix, origin, center, part.spot_mm / 2.0)
    radiance, u = mean_radiance(look, spot)
    wave = ridge_wave(look, spot, matrix, part.pitch_um / 1000.0)
    ridge = None if wave is None else lean_line_deg(wave, squeeze)
    return (
        ObservedPose(
            look.reading_deg, look.tilt_reading_deg, look.again, fix, ridge, radiance, u, look.flicker
        ),
        spot,
    )


def _picture(look: Look, pose: ObservedPose, spot: Spot) -> Picture:
    scale = min(1.0, PICTURE_PX / max(look.image.shape))
    small = cv2.resize(np.nan_to_num(look.image), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return Picture(
        np.asarray(small, dtype=np.float32),
        scale,
        look.reading_deg,
        look.tilt_reading_deg,
        pose.fix.corners_px if pose.fix is not None else np.empty((0, 2)),
        spot.center_px,
        0.5 * spot.weight.shape[1],
        pose.ridge_deg,
    )
