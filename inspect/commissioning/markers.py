"""Pose from the markers of one picture: rotation of the fixture, pixel size, foreshortening, and focus.

The markers of a picture fix an affine map from sample millimetres (x right, y up) to pixels. It is taken apart into
A = scale · S · F · R(ψ): R the turn of the fixture, F the mirror that makes rows run down, and S the squeeze by
cos(tilt) across the tilt axis. A parallel view under +tilt and
under −tilt is the same picture of a plane, so the markers give the size of a tilt and never its sign.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.imaging.registration.placement import MIN_MARKERS, Image, find_markers, marker_corners_mm
from anisoscope.rig.fixture import Fixture

FLIP = np.diag([1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Fix:
    """Pose of the fixture in one picture.

    Attributes:
        matrix: (2, 2) from sample mm to pixels (column, row), without the shift.
        origin_px: (2,) column and row of the fixture's origin.
        angle_deg: its angle ψ, counter-clockwise as seen, 0 to 360.
        pixel_um: size of a pixel on the sample, along the tilt axis.
        squeeze: ratio of the scales across and along the tilt axis, cos(tilt).
        squeeze_deg: direction of the squeeze in the picture, from its horizontal, −90 to 90.
        residual_px: rms distance of the corners from the fit.
        markers: how many markers were found.
        corners_px: (N, 2) the corners found.
    """

    matrix: FloatArray
    origin_px: FloatArray
    angle_deg: float
    pixel_um: float
    squeeze: float
    squeeze_deg: float
    residual_px: float
    markers: int
    corners_px: FloatArray


def find_fixture(image: Image, fixture: Fixture) -> Fix | None:
    """The fixture in a picture, or None where fewer than three of its markers are detected.

    Args:
        image: (rows, cols) linear picture.
        fixture: the markers.
    """
    known = marker_corners_mm(fixture)
    found = [(marker.id, marker.corners) for marker in find_markers(image, fixture) if marker.id in known]
    if len({number for number, _ in found}) < MIN_MARKERS:
        return None
    points = np.concatenate([known[number] for number, _ in found])
    pixels = np.concatenate([corners for _, corners in found])
    design = np.column_stack([points, np.ones(len(points))])
    solution = np.linalg.lstsq(design, pixels, rcond=None)[0]
    residual = float(np.sqrt(np.mean(np.sum((design @ solution - pixels) ** 2, axis=1))))
    return _fix_from(solution[:2].T, solution[2], residual, len(found), pixels)


def _fix_from(
    matrix: FloatArray, origin: FloatArray, residual: float, markers: int, corners: FloatArray
) -> Fix:
    sizes, axes = np.linalg.eigh(matrix @ matrix.T)  # ascending: the squeezed direction first
    small, large = np.sqrt(np.maximum(sizes, 1e-12))
    root = axes @ np.diag([1.0 / small, 1.0 / large]) @ axes.T
    turn = FLIP @ root @ matrix
    angle = np.degrees(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
    direction = np.degrees(np.arctan2(-axes[1, 0], axes[0, 0]))
    return Fix(
        matrix,
        origin,
        float(angle % 360.0),
        float(1000.0 / large),
        float(small / large),
        float((direction + 90.0) % 180.0 - 90.0),
        residual,
        markers,
        corners,
    )


def modules_of(dictionary: str) -> int:
    """Modules along the side of a marker of a dictionary, its black border included."""
    return int(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)).markerSize) + 2


def edge_blur_px(image: Image, fix: Fix, modules: int) -> float:
    """Blur of the marker edges: rms width of their brightness step, in pixels.

    Args:
        image: (rows, cols) linear picture.
        fix: the markers in it.
        modules: modules along the side of a marker, its black border included.
    """
    widths = []
    for corners in fix.corners_px.reshape(-1, 4, 2):
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            widths.append(_side_blur(image, start, end, modules))
    return float(np.median(widths))


def _side_blur(image: Image, start: FloatArray, end: FloatArray, modules: int) -> float:
    length = float(np.linalg.norm(end - start))
    along = (end - start) / max(length, 1e-9)
    reach = max(0.48 * length / modules, 2.0)  # up to the next edge and no further
    across = np.linspace(-reach, reach, int(8 * reach) + 1)
    base = start + np.linspace(0.2, 0.8, max(12, int(length)))[:, None] * (end - start)
    points = (base[:, None, :] + across[None, :, None] * np.array([-along[1], along[0]])).astype(np.float32)
    strip = cv2.remap(
        np.nan_to_num(image),
        points[..., 0],
        points[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    steps = np.diff(strip.astype(np.float64).mean(axis=0))
    steps = np.maximum(steps * np.sign(steps.sum()), 0.0)
    at = 0.5 * (across[1:] + across[:-1])
    total = max(float(steps.sum()), 1e-12)
    middle = float(steps @ at) / total
    return float(np.sqrt(steps @ (at - middle) ** 2 / total))
