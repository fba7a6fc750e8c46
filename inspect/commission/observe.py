"""From commissioning pictures to numbers: markers, ridges and radiance of every pose, and a few pictures to show."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.commission.markers import Fix, edge_blur_px, find_fixture, modules_of
from anisoscope.commission.part import RidgedPart
from anisoscope.commission.ridges import (
    Spot,
    frame_of,
    lean_line_deg,
    mean_radiance,
    ridge_wave,
    spot_in,
    squeeze_of,
)
from anisoscope.commission.series import Look, Taken
from anisoscope.progress import Advance
from anisoscope.rig.rigfile import RigFile

Image = npt.NDArray[np.float32]

SHOWN = 3
SHOWN_PX = 480


@dataclass(frozen=True, eq=False)
class Seen:
    """What one picture says.

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
    """A picture for the page, made smaller by `scale`.

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

    seen: tuple[Seen, ...]
    blur_px: float | None
    pictures: tuple[Picture, ...]


def observe(taken: Taken, file: RigFile, part: RidgedPart, advance: Advance) -> Observed:
    """Look at every picture.

    Args:
        taken: the pictures.
        file: the rig file, for fixture and pixel size.
        part: where its ridges are, and their pitch.
        advance: progress.

    Raises:
        MeasurementError: the spot is dark, saturated or outside of a picture.
    """
    seen, pictures, blurs = [], [], []
    turn = [
        shots.pose.stage_deg for shots in taken.shots if shots.pose.tilt_deg == taken.shots[0].pose.tilt_deg
    ]
    chosen = {round(n * len(turn) / SHOWN) for n in range(SHOWN)}
    for number, look in enumerate(taken.looks()):
        advance("markers and ridges", number, len(taken.shots))
        fix = find_fixture(look.image, file.fixture) if file.fixture is not None else None
        found, spot = _see(look, fix, file, part)
        seen.append(found)
        if fix is not None and file.fixture is not None and fix.squeeze > 0.97:
            blurs.append(edge_blur_px(look.image, fix, modules_of(file.fixture.dictionary)))
        if number in chosen:
            pictures.append(_picture(look, found, spot))
    return Observed(tuple(seen), float(np.median(blurs)) if blurs else None, tuple(pictures))


def _see(look: Look, fix: Fix | None, file: RigFile, part: RidgedPart) -> tuple[Seen, Spot]:
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
        Seen(look.reading_deg, look.tilt_reading_deg, look.again, fix, ridge, radiance, u, look.flicker),
        spot,
    )


def _picture(look: Look, seen: Seen, spot: Spot) -> Picture:
    scale = min(1.0, SHOWN_PX / max(look.image.shape))
    small = cv2.resize(np.nan_to_num(look.image), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return Picture(
        np.asarray(small, dtype=np.float32),
        scale,
        look.reading_deg,
        look.tilt_reading_deg,
        seen.fix.corners_px if seen.fix is not None else np.empty((0, 2)),
        spot.center_px,
        0.5 * spot.weight.shape[1],
        seen.ridge_deg,
    )
