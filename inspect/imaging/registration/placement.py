"""Placement of the sample in a picture from the ArUco markers of the fixture, and resampling on its raster."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import RegistrationError, RigFileError
from anisoscope.imaging.linearisation import RadianceImage
from anisoscope.imaging.registration.markers import (
    Agreed,
    agree,
    dictionary_of,
    find_markers,
    marker_corners_mm,
)
from anisoscope.rig.fixture import Fixture

__all__ = ["marker_corners_mm"]

Image = npt.NDArray[np.float32]

MIN_MARKERS = 3


@dataclass(frozen=True, eq=False)
class Placement:
    """Placement of the sample in one picture.

    Attributes:
        matrix: (2, 3) map from sample millimetres (x right, y up, at stage angle 0) to (column, row); with
            `perspective` the upper rows of a homography.
        angle_deg: angle of the sample, counter-clockwise in the picture, 0 to 360.
        pixel_um: size of a pixel on the sample.
        axis_px: (column, row) of the sample's origin.
        residual_px: rms distance of the marker corners from the fit; without markers, of parts of the picture.
        markers: number of markers used; 0 where the pictures are registered by edges.
        perspective: third row of the homography without its 1, per millimetre; zeros for parallel projection.
        blur_px: standard deviation of the edge spread at the markers, where it is known.
        black_share: brightness of the markers' black relative to their white, where it is known.
        squeeze: measured foreshortening of the picture's rows, relative to the cosine of the tilt.
        u_squeeze: its standard uncertainty.
        dropped: ids of inconsistent markers that were left out.
    """

    matrix: FloatArray
    angle_deg: float
    pixel_um: float
    axis_px: tuple[float, float]
    residual_px: float
    markers: int
    perspective: tuple[float, float] = (0.0, 0.0)
    blur_px: float | None = None
    black_share: float | None = None
    squeeze: float = 1.0
    u_squeeze: float = 0.0
    dropped: tuple[int, ...] = ()

    @property
    def homography(self) -> FloatArray:
        """(3, 3) map from sample millimetres to (column, row, 1), up to a factor."""
        return np.vstack([self.matrix, [*self.perspective, 1.0]])


@dataclass(frozen=True, eq=False)
class View:
    """One photographed pose: picture, placement of the sample, commanded angles."""

    stage_deg: float
    tilt_deg: float
    image: RadianceImage
    placement: Placement


def check_fixture(fixture: Fixture) -> None:
    """Check that pictures can be registered by this fixture.

    Raises:
        RigFileError: an unknown dictionary, a marker that it does not hold, or too few markers.
    """
    if not hasattr(cv2.aruco, fixture.dictionary):
        raise RigFileError(
            f"fixture.dictionary: OpenCV has no dictionary '{fixture.dictionary}'; one of its names is DICT_4X4_50"
        )
    size = len(dictionary_of(fixture).bytesList)
    unknown = [marker.id for marker in fixture.markers if marker.id >= size]
    if unknown:
        raise RigFileError(
            f"fixture.markers: {fixture.dictionary} holds the markers 0 to {size - 1}, not {unknown[0]}"
        )
    if len(fixture.markers) < MIN_MARKERS:
        raise RigFileError(
            f"fixture.markers: {len(fixture.markers)} described, at least {MIN_MARKERS} are needed to align pictures"
        )


def _detect(image: Image, fixture: Fixture) -> list[tuple[int, FloatArray]]:
    """The fixture's markers and their corners (4, 2)."""
    return [(marker.id, marker.corners) for marker in find_markers(image, fixture)]


def locate(image: Image, fixture: Fixture, tilt_deg: float = 0.0) -> Placement:
    """Find the fixture in a picture and fit a similarity: rotation, scale, shift.

    A tilted camera sees the plate foreshortened along the rows of the picture's height by cos(tilt); this is
    removed before the fit. Perspective adds one parameter where the markers resolve it (`markers`). A single
    inconsistent marker is left out and reported.

    Args:
        image: (rows, cols) linear picture.
        fixture: the markers and their positions.
        tilt_deg: tilt of the camera about the picture's horizontal axis.

    Raises:
        RegistrationError: fewer than three of the fixture's markers are visible, or they contradict each other.
    """
    known = marker_corners_mm(fixture)
    found = find_markers(image, fixture)
    distinct = len({marker.id for marker in found})
    if distinct < MIN_MARKERS:
        raise RegistrationError(
            f"only {distinct} of {len(known)} fixture markers are seen (at least {MIN_MARKERS} needed): "
            "check that the light is on, the lens is clear and in focus, and the fixture is the one in the rig file"
        )
    middle = ((image.shape[1] - 1) / 2.0, (image.shape[0] - 1) / 2.0)
    agreed = agree(found, known, float(np.cos(np.radians(tilt_deg))), middle)
    return _placement(agreed)


def _placement(agreed: Agreed) -> Placement:
    fit, used = agreed.fit, agreed.markers
    blurs, blacks = [marker.blur_px for marker in used], [marker.black_share for marker in used]
    upper = fit.homography[:2]
    return Placement(
        upper,
        fit.angle_deg,
        fit.pixel_um,
        (float(upper[0, 2]), float(upper[1, 2])),
        fit.residual_px,
        len(used),
        perspective=(float(fit.homography[2, 0]), float(fit.homography[2, 1])),
        blur_px=float(np.median(blurs)),
        black_share=float(np.median(blacks)),
        squeeze=agreed.squeeze,
        u_squeeze=agreed.u_squeeze,
        dropped=agreed.dropped,
    )


def angle_between(first_deg: float, second_deg: float) -> float:
    """Signed smallest rotation from the first angle to the second, −180 to 180."""
    return (second_deg - first_deg + 180.0) % 360.0 - 180.0


@dataclass(frozen=True)
class Grid:
    """A raster on the sample, its columns along the ridges.

    Attributes:
        center_mm: (x, y) of the raster's centre, in sample millimetres at stage angle 0.
        pixel_mm: distance of neighbouring points.
        shape: (rows, cols); the first row lies farthest along the ridges.
        turn_deg: azimuth of the raster's x axis: the side toward which the facets lean.
    """

    center_mm: tuple[float, float]
    pixel_mm: float
    shape: tuple[int, int]
    turn_deg: float = 0.0

    @property
    def size_mm(self) -> tuple[float, float]:
        """(along the ridges, across them)."""
        return self.shape[0] * self.pixel_mm, self.shape[1] * self.pixel_mm

    def to_mm(self) -> FloatArray:
        """(3, 3) map from (column, row, 1) to sample millimetres."""
        rows, cols = self.shape
        step, turn = self.pixel_mm, np.radians(self.turn_deg)
        centred = np.array([[step, 0, -step * (cols - 1) / 2], [0, -step, step * (rows - 1) / 2], [0, 0, 1]])
        cos, sin = np.cos(turn), np.sin(turn)
        x, y = self.center_mm
        return np.asarray(np.array([[cos, -sin, x], [sin, cos, y], [0, 0, 1]]) @ centred, dtype=np.float64)


def resample(image: Image, placement: Placement, grid: Grid) -> Image:
    """The picture resampled once on the sample's raster; NaN where the picture has no value.

    Args:
        image: (rows, cols) linear picture.
        placement: of the sample in it.
        grid: the raster.

    Returns:
        ``grid.shape`` values; points outside the picture are NaN.
    """
    matrix = placement.homography @ grid.to_mm()
    rows, cols = grid.shape
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    nothing = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": (float("nan"),)}
    if any(placement.perspective):
        warped = cv2.warpPerspective(image, matrix, (cols, rows), flags=flags, **nothing)  # type: ignore[call-overload]
    else:
        warped = cv2.warpAffine(image, matrix[:2], (cols, rows), flags=flags, **nothing)  # type: ignore[call-overload]
    return np.asarray(warped, dtype=np.float32)
