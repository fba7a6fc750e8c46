"""Aligning the turned pictures by the ArUco markers of the fixture."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.errors import RegistrationError, RigFileError
from anisoscope.rig.fixture import Fixture

FloatArray = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

MIN_MARKERS = 3
_PADDING = 16


@dataclass(frozen=True, eq=False)
class Placement:
    """Where the fixture stands in one picture.

    Attributes:
        matrix: (2, 3) map from sample millimetres (x right, y up, at stage angle 0) to (column, row).
        angle_deg: angle of the sample, counter-clockwise as seen, 0 to 360.
        pixel_um: size of a pixel on the sample.
        axis_px: (column, row) of the fixture's origin.
        residual_px: rms distance of the marker corners from the fit.
        markers: how many markers were found.
    """

    matrix: FloatArray
    angle_deg: float
    pixel_um: float
    axis_px: tuple[float, float]
    residual_px: float
    markers: int


def check_fixture(fixture: Fixture) -> None:
    """Can pictures be aligned by this fixture at all?

    Raises:
        RigFileError: an unknown dictionary, a marker that it does not hold, or too few markers.
    """
    if not hasattr(cv2.aruco, fixture.dictionary):
        raise RigFileError(
            f"fixture.dictionary: OpenCV has no dictionary '{fixture.dictionary}'; one of its names is DICT_4X4_50"
        )
    size = len(_dictionary(fixture).bytesList)
    unknown = [marker.id for marker in fixture.markers if marker.id >= size]
    if unknown:
        raise RigFileError(
            f"fixture.markers: {fixture.dictionary} holds the markers 0 to {size - 1}, not {unknown[0]}"
        )
    if len(fixture.markers) < MIN_MARKERS:
        raise RigFileError(
            f"fixture.markers: {len(fixture.markers)} described, at least {MIN_MARKERS} are needed to align pictures"
        )


def _dictionary(fixture: Fixture) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, fixture.dictionary))


def marker_corners_mm(fixture: Fixture) -> dict[int, FloatArray]:
    """Corners of every marker in sample millimetres, (4, 2): top left first, clockwise as seen, as OpenCV counts."""
    half = fixture.marker_mm / 2.0
    offsets = np.array([[-half, half], [half, half], [half, -half], [-half, -half]])
    return {marker.id: offsets + np.array([marker.x_mm, marker.y_mm]) for marker in fixture.markers}


def _detect(image: Image, fixture: Fixture) -> list[tuple[int, FloatArray]]:
    """Markers and their corners (4, 2).

    They are found on a compressed picture, where dim markers show too, and refined on the linear one, because
    compression would move blurred edges toward the dark side.
    """
    filled = np.nan_to_num(image)
    top = max(float(np.percentile(filled[::4, ::4], 99.5)), 1e-9)
    calm = cv2.GaussianBlur(filled, (0, 0), 1.0)  # noise in the dark hides markers
    squeezed = np.asarray(255.0 * np.sqrt(np.clip(calm / top, 0.0, 1.0)), dtype=np.uint8)
    # OpenCV misses labels that nearly touch the edge of the picture
    seen = cv2.copyMakeBorder(squeezed, _PADDING, _PADDING, _PADDING, _PADDING, cv2.BORDER_REPLICATE)
    detector = cv2.aruco.ArucoDetector(_dictionary(fixture), _detection())
    corners, ids, _ = detector.detectMarkers(seen)
    if not corners:
        return []
    linear = np.clip(filled / top, 0.0, 2.0).astype(np.float32)
    modules = _dictionary(fixture).markerSize + 2
    return [
        (int(i), _refined(linear, found.reshape(4, 2).astype(np.float64) - _PADDING, modules))
        for i, found in zip(ids.ravel(), corners, strict=True)
    ]


def _detection() -> cv2.aruco.DetectorParameters:
    """Thresholds that noise in the dark does not cross, over windows from a fraction of a module to several."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshConstant = 15
    parameters.adaptiveThreshWinSizeMax = 53
    return parameters


def _refined(image: Image, corners: FloatArray, modules: int) -> FloatArray:
    """Corners (4, 2) as the crossings of straight lines through the sides of the marker, in two rounds.

    Blur rounds a corner, but leaves the middle of a side where it is.
    """
    for _ in range(2):
        following = np.roll(corners, -1, axis=0)
        sides = [_side(image, a, b, modules) for a, b in zip(corners, following, strict=True)]
        crossings = []
        for (first, along), (second, beside) in zip([sides[-1], *sides[:-1]], sides, strict=True):
            steps = np.linalg.lstsq(np.stack([along, -beside], axis=1), second - first, rcond=None)[0]
            crossings.append(first + steps[0] * along)
        corners = np.array(crossings)
    return corners


def _side(image: Image, start: FloatArray, end: FloatArray, modules: int) -> tuple[FloatArray, FloatArray]:
    """A point of one side of a marker and its direction: centres of brightness steps on lines across it."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / max(length, 1e-9)
    normal = np.array([-along[1], along[0]])
    # within the black border on one side and within the white label on the other
    reach = float(np.clip(0.45 * length / modules, 2.0, 8.0))
    across = np.linspace(-reach, reach, int(8 * reach) + 1)
    base = start + np.linspace(0.15, 0.85, max(12, int(0.7 * length)))[:, None] * (end - start)
    points = (base[:, None, :] + across[None, :, None] * normal).astype(np.float32)
    seen = cv2.remap(image, points[..., 0], points[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    steps = np.diff(seen.astype(np.float64), axis=1)
    steps *= np.sign(steps.sum())  # signed, so that noise cancels
    rise = steps.sum(axis=1)
    offset = steps @ (0.5 * (across[1:] + across[:-1])) / np.maximum(rise, 0.2 * np.median(rise) + 1e-12)
    offset = np.clip(offset, -reach, reach)
    edge = base + offset[:, None] * normal
    middle = edge.mean(axis=0)
    return middle, np.asarray(np.linalg.svd(edge - middle)[2][0], dtype=np.float64)


def locate(image: Image, fixture: Fixture, tilt_deg: float = 0.0) -> Placement:
    """Find the fixture in a picture and fit a similarity: rotation, scale, shift.

    A tilted camera sees the plate foreshortened along the rows of the picture's height by cos(tilt); this is
    taken out before the fit (parallel projection, as through a telecentric or a long working-distance lens).

    Args:
        image: (rows, cols) linear picture.
        fixture: the markers and where they stand.
        tilt_deg: tilt of the camera about the picture's horizontal axis.

    Raises:
        RegistrationError: fewer than three of the fixture's markers are seen.
    """
    known = marker_corners_mm(fixture)
    found = [(i, c) for i, c in _detect(image, fixture) if i in known]
    distinct = len({i for i, _ in found})
    if distinct < MIN_MARKERS:
        raise RegistrationError(
            f"only {distinct} of {len(known)} fixture markers are seen (at least {MIN_MARKERS} needed): "
            "check that the light is on, the lens is clear and in focus, and the fixture is the one in the rig file"
        )
    points = np.concatenate([known[i] for i, _ in found])
    pixels = np.concatenate([c for _, c in found])
    return _fit(points, pixels, len(found), float(np.cos(np.radians(tilt_deg))))


def _fit(points_mm: FloatArray, pixels: FloatArray, markers: int, squeeze: float) -> Placement:
    """Least-squares similarity after stretching rows by 1/squeeze; rows run down, so y is mirrored first."""
    source = points_mm[:, 0] - 1j * points_mm[:, 1]
    target = pixels[:, 0] + 1j * pixels[:, 1] / squeeze
    centred = source - source.mean()
    factor = np.vdot(centred, target - target.mean()) / np.vdot(centred, centred)
    shift = target.mean() - factor * source.mean()
    residual = float(np.sqrt(np.mean(np.abs(factor * source + shift - target) ** 2)))
    matrix = np.array([[factor.real, factor.imag, shift.real], [factor.imag, -factor.real, shift.imag]])
    matrix[1] *= squeeze
    return Placement(
        matrix,
        float(-np.degrees(np.angle(factor)) % 360.0),
        float(1000.0 / abs(factor)),
        (float(shift.real), float(shift.imag * squeeze)),
        residual,
        markers,
    )


def angle_between(first_deg: float, second_deg: float) -> float:
    """Signed smallest turn from the first angle to the second, −180 to 180."""
    return (second_deg - first_deg + 180.0) % 360.0 - 180.0


@dataclass(frozen=True)
class Grid:
    """A raster on the sample, its columns along the ridges.

    Attributes:
        center_mm: (x, y) of the raster's middle, in sample millimetres at stage angle 0.
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
    """The picture on the sample's raster, warped once; NaN where the picture has no value.

    Args:
        image: (rows, cols) linear picture.
        placement: where the fixture stands in it.
        grid: the raster.

    Returns:
        ``grid.shape`` values; points outside the picture are NaN.
    """
    matrix = placement.matrix @ grid.to_mm()
    rows, cols = grid.shape
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpAffine(
        image, matrix, (cols, rows), flags=flags, borderMode=cv2.BORDER_CONSTANT, borderValue=(float("nan"),)
    )
    return np.asarray(warped, dtype=np.float32)
