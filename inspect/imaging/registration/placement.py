"""Placement of the sample in a picture from the ArUco markers of the fixture, and resampling on its raster.

Markers are detected on a reduced picture and measured on the linear one at full size. A side of a marker is a straight
line through the centres of the brightness steps on many scan lines across it; corners are intersections of sides. Blur
rounds a corner but does not shift the middle of a side; dirt shifts some steps, but not most of them.

The model is a similarity (rotation, scale, shift) of a plate foreshortened along the picture's rows by the cosine of
the tilt; a single inconsistent marker is identified and left out. Where the plate is tilted and the markers resolve it,
one more parameter q describes the perspective of its far side: with (X, Y) the similarity in pixels from the middle of
the picture and c the cosine, u = X/(1 + qY), v = cY/(1 + qY), a pinhole camera whose axis is tilted about the picture's
horizontal axis (Hartley and Zisserman, Multiple View Geometry, 2nd edition, 8.1; q = sin(tilt)·focal length/distance).

Where the lens is calibrated, corners are straightened before the fit, and pictures are resampled through its distortion
(`anisoscope.imaging.registration.lens`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import RegistrationError, RigFileError
from anisoscope.imaging.linearisation import RadianceImage, upper_quantile
from anisoscope.imaging.registration.lens import Corners, Lens, fit_lens
from anisoscope.rig.fixture import Fixture

Image = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

_PADDING = 16
_REDUCED_PX = 768  # a picture is reduced while its longer side stays above
_COMPRESSIONS = (0.7, 1.0, 0.5)
_MAX_LINES = 160
_ROUNDS = 2


@dataclass(frozen=True, eq=False)
class Marker:
    """A marker found in a picture.

    Attributes:
        id: its number in the dictionary.
        corners: (4, 2) column and row, top left first, clockwise.
        blur_px: standard deviation of the edge spread across its sides.
    """

    id: int
    corners: FloatArray
    blur_px: float


def dictionary_of(fixture: Fixture) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of a fixture's markers."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, fixture.dictionary))


def marker_corners_mm(fixture: Fixture) -> dict[int, FloatArray]:
    """Corners of every marker in sample millimetres, (4, 2): OpenCV's order, top left first, clockwise."""
    half = fixture.marker_mm / 2.0
    offsets = np.array([[-half, half], [half, half], [half, -half], [-half, -half]])
    return {marker.id: offsets + np.array([marker.x_mm, marker.y_mm]) for marker in fixture.markers}


def find_markers(image: Image, fixture: Fixture) -> list[Marker]:
    """The fixture's markers in a linear picture (rows, cols), NaN where a pixel has no value.

    If the reduced picture does not show all of them, the picture is searched at full size.
    """
    thinned = image[::4, ::4]
    known = np.isfinite(thinned)
    top = max(upper_quantile(thinned if known.all() else thinned[known], 0.995), 1e-9)
    expected = {marker.id for marker in fixture.markers}
    factor = max(1, max(image.shape) // _REDUCED_PX)
    found = _detect(image, fixture, top, factor)
    if factor > 1 and not expected <= {number for number, _ in found}:
        found = _detect(image, fixture, top, 1)
    modules = dictionary_of(fixture).markerSize + 2
    return [_measured(image, number, corners, modules, top) for number, corners in found]


def _detect(image: Image, fixture: Fixture, top: float, factor: int) -> list[tuple[int, FloatArray]]:
    """The fixture's markers and their rough corners (4, 2).

    Compressing brightness reveals dim markers next to a bright part, but blur fades their black; so several are tried.
    """
    small = _reduced(image, factor)
    calm = np.clip(cv2.GaussianBlur(small, (0, 0), 1.0) / top, 0.0, 1.0)  # noise in the dark hides markers
    detector = cv2.aruco.ArucoDetector(dictionary_of(fixture), _detection())
    expected = {marker.id for marker in fixture.markers}
    found: list[tuple[int, FloatArray]] = []
    for power in _COMPRESSIONS:
        missing = expected - {number for number, _ in found}
        if not missing:
            break
        squeezed = np.asarray(255.0 * calm**power, dtype=np.uint8)
        # OpenCV misses labels that nearly touch the edge of the picture
        padded = cv2.copyMakeBorder(squeezed, _PADDING, _PADDING, _PADDING, _PADDING, cv2.BORDER_REPLICATE)
        corners, ids, _ = detector.detectMarkers(padded)
        numbers = [int(number) for number in ids.ravel()] if corners else []
        found += [
            (number, (one.reshape(4, 2).astype(np.float64) - _PADDING + 0.5) * factor - 0.5)
            for number, one in zip(numbers, corners, strict=True)
            if number in missing
        ]
    return found


def _reduced(image: Image, factor: int) -> Image:
    """The picture with gaps filled, binned ``factor`` × ``factor``."""
    if factor > 1:
        rows, cols = (size - size % factor for size in image.shape)
        image = np.asarray(
            cv2.resize(image[:rows, :cols], (cols // factor, rows // factor), interpolation=cv2.INTER_AREA)
        )
    return np.nan_to_num(image)


def _detection() -> cv2.aruco.DetectorParameters:
    """Detector settings: thresholds above dark noise, windows from a fraction of a module to several.

    Fewer windows are faster, but move corners by hundredths of a pixel, and with them what `recompute` finds.
    """
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshConstant = 15
    parameters.adaptiveThreshWinSizeMax = 53
    return parameters


def _measured(image: Image, number: int, corners: FloatArray, modules: int, top: float) -> Marker:
    """A marker whose corners are the intersections of lines through its sides, refined in two rounds."""
    edge, across = np.zeros(2), np.zeros(2)
    for _ in range(_ROUNDS):
        points, along, edge, across = _sides(image, corners, modules, top)
        before, neighbour = np.roll(points, 1, axis=0), np.roll(along, 1, axis=0)
        turn = neighbour[:, 0] * along[:, 1] - neighbour[:, 1] * along[:, 0]
        gap = points - before
        steps = (gap[:, 0] * along[:, 1] - gap[:, 1] * along[:, 0]) / np.where(np.abs(turn) < 1e-3, 1.0, turn)
        corners = before + steps[:, None] * neighbour
    return Marker(number, corners, _spread(edge, across))


def _sides(
    image: Image, corners: FloatArray, modules: int, top: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A point (4, 2) and the direction (4, 2) of every side, and the edge profile with its positions."""
    ends = np.roll(corners, -1, axis=0)
    lengths = np.linalg.norm(ends - corners, axis=1)
    along = (ends - corners) / np.maximum(lengths, 1e-9)[:, None]
    normals = np.stack([-along[:, 1], along[:, 0]], axis=1)
    # within the black border on one side and within the white label on the other
    reach = float(np.clip(0.45 * lengths.mean() / modules, 2.0, 8.0))
    across = np.linspace(-reach, reach, int(8 * reach) + 1)
    lines = int(np.clip(0.7 * lengths.mean(), 12, _MAX_LINES))
    base = corners[:, None, :] + np.linspace(0.15, 0.85, lines)[:, None] * (ends - corners)[:, None, :]
    lit = _lit_along(image, base, across[:, None] * normals[:, None, :])
    lit /= top
    np.clip(lit, 0.0, 2.0, out=lit)
    offset, used = _steps(lit, across)
    ramp = np.linspace(-1.0, 1.0, lines)
    level, slope, used = _straight(ramp, offset, used)
    first, last = (np.clip(level + end * slope, -reach, reach)[:, None] * normals for end in (-1.0, 1.0))
    start, stop = base[:, 0] + first, base[:, -1] + last
    direction = (stop - start) / np.maximum(np.linalg.norm(stop - start, axis=1), 1e-9)[:, None]
    edge = np.median([lit[side, used[side]].mean(axis=0) for side in range(4)], axis=0)
    edge = edge[::-1] if edge[0] > edge[-1] else edge
    return 0.5 * (start + stop), direction, edge, across


def _lit_along(image: Image, base: FloatArray, away: FloatArray) -> FloatArray:
    """Brightness (4, lines, points) at places (4, lines, 2) and points (4, points, 2) away from them."""
    column, row = (
        (base[:, :, None, axis] + away[:, None, :, axis]).astype(np.float32).reshape(-1, away.shape[1])
        for axis in (0, 1)
    )
    sampled = cv2.remap(image, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled, dtype=np.float64).reshape(*base.shape[:2], -1)


def _steps(lit: FloatArray, across: FloatArray) -> tuple[FloatArray, Mask]:
    """Centres (4, lines) of the brightness steps across the sides, and which scan lines have a regular step.

    Args:
        lit: (4, lines, points) brightness; NaN where a pixel has no value.
        across: (points,) places along the lines.
    """
    middles = 0.5 * (across[1:] + across[:-1])
    # centroid of the gradient, by parts; NaN where any value of the line is
    moment = lit @ (np.pad(middles, (1, 0)) - np.pad(middles, (0, 1)))
    rise = lit[..., -1] - lit[..., 0]
    whole = np.isfinite(moment)
    if not whole.all():
        rise = np.where(whole, rise, 0.0)
        moment = np.nan_to_num(np.diff(lit, axis=2)) @ middles
    sense = np.sign(rise.sum(axis=1))[:, None]  # signed, so that noise cancels
    rise = rise * sense
    usual = _medians(rise)[:, None]
    offset = sense * moment / np.maximum(rise, 0.2 * usual + 1e-12)
    used = whole & (rise > 0.5 * usual) & (rise < 1.5 * usual)
    used |= used.sum(axis=1, keepdims=True) < lit.shape[1] // 3
    return np.clip(offset, across[0], across[-1]), used


def _medians(values: FloatArray, used: Mask | None = None) -> FloatArray:
    """Median of every row over the values used, at least one per row."""
    count = np.full(len(values), values.shape[1]) if used is None else used.sum(axis=1)
    ordered = np.sort(values if used is None else np.where(used, values, np.inf), axis=1)
    rows = np.arange(len(values))
    return np.asarray(0.5 * (ordered[rows, (count - 1) // 2] + ordered[rows, count // 2]))


def _straight(ramp: FloatArray, offset: FloatArray, used: Mask) -> tuple[FloatArray, FloatArray, Mask]:
    """Level and slope (4,) of robust straight lines through the centres, and which were used."""
    level = _medians(offset, used)
    slope, close = np.zeros(len(level)), used
    for _ in range(3):
        away = np.abs(offset - level[:, None] - slope[:, None] * ramp)
        close = used & (away <= np.maximum(3.0 * 1.4826 * _medians(away, used), 0.05)[:, None])
        count = np.maximum(close.sum(axis=1), 1)
        middle = close @ ramp / count
        mean = (close * offset).sum(axis=1) / count
        centred = close * (ramp - middle[:, None])
        slope = (centred * offset).sum(axis=1) / np.maximum((centred**2).sum(axis=1), 1e-12)
        level = mean - slope * middle
    return level, slope, close


def _spread(edge: FloatArray, across: FloatArray) -> float:
    """Standard deviation of the edge spread of a rising profile, from its 20 and 80 percent crossings."""
    rising = np.maximum.accumulate(edge)
    share = (rising - rising[0]) / max(float(rising[-1] - rising[0]), 1e-12)
    low, high = (float(np.interp(level, share, across)) for level in (0.2, 0.8))
    return (high - low) / (2.0 * 0.8416)


MIN_MARKERS = 3
OFF_PX = 0.3
"""A marker off by less is within what the measurement of corners does; printing is `LimitsPart.marker_off_um`."""
OFF_SIGMA = 4.0
_MIN_SQUEEZE_CHANGE = 2e-4  # tilts below 1° show no perspective
_MIN_F = 12.0
_FIT_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class Fit:
    """Fitted pose of the plate.

    Attributes:
        homography: (3, 3) map from sample millimetres to (column, row, 1), its last element 1.
        angle_deg: angle of the sample, counter-clockwise in the picture, 0 to 360.
        pixel_um: size of a pixel on the sample, at its origin.
        residual_px: rms distance of the corners from the fit.
        parameters: number of parameters.
    """

    homography: FloatArray
    angle_deg: float
    pixel_um: float
    residual_px: float
    parameters: int

    def to_pixels(self, points_mm: FloatArray) -> FloatArray:
        """(N, 2) column and row of points (N, 2)."""
        projected = np.column_stack([points_mm, np.ones(len(points_mm))]) @ self.homography.T
        return np.asarray(projected[:, :2] / projected[:, 2:])


@dataclass(frozen=True, eq=False)
class Agreed:
    """A fit to mutually consistent markers.

    Attributes:
        fit: the fit.
        markers: the markers used.
        dropped: ids of the others.
        squeeze: measured foreshortening of the rows, relative to the assumed one.
        u_squeeze: its standard uncertainty.
        bent_share: radial distortion at the corners of the picture that explains the residual, else 0.
    """

    fit: Fit
    markers: tuple[Marker, ...]
    dropped: tuple[int, ...]
    squeeze: float
    u_squeeze: float
    bent_share: float


def agree(
    found: Sequence[Marker],
    known_mm: dict[int, FloatArray],
    squeeze: float,
    shape: tuple[int, int],
    off_um: float = 0.0,
) -> Agreed:
    """Fit the plate to the mutually consistent markers.

    Args:
        found: markers in the picture, all of them of the fixture.
        known_mm: (4, 2) corners of every marker of the fixture.
        squeeze: cosine of the tilt.
        shape: (rows, cols) of the picture.
        off_um: distance by which a marker may be off the others, µm on the sample; 0.3 px are always allowed.

    Raises:
        RegistrationError: markers are inconsistent, and too few to identify the wrong one.
    """
    middle_px = ((shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0)

    def fitted(markers: Sequence[Marker]) -> Fit:
        points = np.concatenate([known_mm[marker.id] for marker in markers])
        return fit_plate(points, np.concatenate([m.corners for m in markers]), squeeze, middle_px)

    def off(marker: Marker, fit: Fit) -> float:
        return float(np.sqrt(np.mean(np.sum((fit.to_pixels(known_mm[marker.id]) - marker.corners) ** 2, 1))))

    def contradiction() -> RegistrationError:
        off_px = [(off(m, whole), m.id) for m in used]
        return RegistrationError(
            _contradiction(max(off_px), limit, _bent_share(used, known_mm, squeeze, shape))
        )

    used = tuple(found)
    whole = fitted(used)
    limit = max(OFF_PX, off_um / whole.pixel_um)
    without = {i: fitted([*used[:i], *used[i + 1 :]]) for i in range(len(used)) if len(used) > MIN_MARKERS}
    suspects = [
        i for i, fit in without.items() if off(used[i], fit) > max(limit, OFF_SIGMA * fit.residual_px)
    ]
    dropped: tuple[int, ...] = ()
    if suspects:
        # a wrong marker spoils every fit that includes it; leaving out the right one gives clearly the best fit
        order = sorted(suspects, key=lambda i: without[i].residual_px)
        best = without[order[0]]
        rest = [without[i].residual_px for i in without if i != order[0]]
        if best.residual_px > limit or min(rest) < 1.5 * best.residual_px:
            raise contradiction()
        dropped = (used[order[0]].id,)
        used = (*used[: order[0]], *used[order[0] + 1 :])
        whole = best
    measured, u_squeeze, rest_px = _measured_squeeze(
        np.concatenate([known_mm[m.id] for m in used]), np.concatenate([m.corners for m in used])
    )
    # markers that agree on another foreshortening indicate a wrong tilt, which the tilt gate decides on
    if whole.residual_px > limit and rest_px > limit:
        raise contradiction()
    bent = _bent_share(used, known_mm, squeeze, shape) if whole.residual_px > OFF_PX else 0.0
    return Agreed(whole, used, dropped, measured / squeeze, u_squeeze / squeeze, bent)


def _bent_share(
    markers: Sequence[Marker], known_mm: dict[int, FloatArray], squeeze: float, shape: tuple[int, int]
) -> float:
    """Radial distortion at the corners of the picture that explains most of what the markers are off, else 0."""
    points = np.concatenate([known_mm[m.id] for m in markers])
    found = fit_lens([Corners(points, np.concatenate([m.corners for m in markers]), squeeze)], shape)
    return found.lens.share if found.lens is not None and found.residual_px < 0.5 * found.plain_px else 0.0


def _contradiction(worst: tuple[float, int], limit: float, bent_share: float) -> str:
    return (
        f"the fixture markers contradict each other (marker {worst[1]} is off by {worst[0]:.2f} px, limit "
        f"{limit:.2g} px): {lens_advice(bent_share)}clean them, check focus and tilt, and that all stand where the rig "
        "file says"
    )


def lens_advice(bent_share: float) -> str:
    """The lens as a cause of what markers are off, for a message; "" where it is none."""
    if bent_share == 0.0:
        return ""
    return (
        f"a lens with {abs(bent_share):.1%} of {'barrel' if bent_share > 0 else 'pincushion'} distortion at the "
        "corners explains it: take a calibration with `anisoscope calibrate rotation`; else "
    )


def fit_plate(
    points_mm: FloatArray, pixels: FloatArray, squeeze: float, middle_px: tuple[float, float]
) -> Fit:
    """Least-squares pose of the plate, with perspective where it is tilted and the points resolve it.

    Args:
        points_mm: (N, 2) sample millimetres.
        pixels: (N, 2) column and row.
        squeeze: cosine of the tilt.
        middle_px: (column, row) of the middle of the picture.
    """
    centred = pixels - np.asarray(middle_px)
    plain = _solve(points_mm, centred, squeeze, None)
    if 1.0 - squeeze < _MIN_SQUEEZE_CHANGE:
        return _as_fit(points_mm, pixels, plain, squeeze, middle_px, 4)
    bent = plain
    for _ in range(_FIT_ROUNDS):
        bent = _solve(points_mm, centred, squeeze, bent)
    fits = (
        _as_fit(points_mm, pixels, plain, squeeze, middle_px, 4),
        _as_fit(points_mm, pixels, bent, squeeze, middle_px, 5),
    )
    first, second = (len(points_mm) * fit.residual_px**2 for fit in fits)
    free = 2 * len(points_mm) - 5
    return fits[1] if (first - second) * free > _MIN_F * second else fits[0]


def _solve(
    points_mm: FloatArray, centred: FloatArray, squeeze: float, previous: FloatArray | None
) -> FloatArray:
    """(5,) real and imaginary part of the similarity, its shift, and q; q only where a previous solution is given."""
    x, y = points_mm.T
    u, v = centred.T
    one, none = np.ones_like(x), np.zeros_like(x)
    columns = [
        np.concatenate([x, -squeeze * y]),
        np.concatenate([y, squeeze * x]),
        np.concatenate([one, none]),
        np.concatenate([none, squeeze * one]),
    ]
    if previous is not None:
        depth = previous[1] * x - previous[0] * y + previous[3]
        columns.append(np.concatenate([-u * depth, -v * depth]))
    # rows are scaled, so that all count as distances in the plate
    found = np.linalg.lstsq(np.stack(columns, axis=1), np.concatenate([u, v]), rcond=None)[0]
    return np.asarray(np.pad(found, (0, 5 - len(found))), dtype=np.float64)


def _as_fit(
    points_mm: FloatArray,
    pixels: FloatArray,
    found: FloatArray,
    squeeze: float,
    middle_px: tuple[float, float],
    parameters: int,
) -> Fit:
    a, b, right, down, q = (float(value) for value in found)
    inner = np.array(
        [
            [a, b, right],
            [squeeze * b, -squeeze * a, squeeze * down],
            [q * b, -q * a, 1.0 + q * down],
        ]
    )
    homography = np.array([[1.0, 0.0, middle_px[0]], [0.0, 1.0, middle_px[1]], [0.0, 0.0, 1.0]]) @ inner
    homography /= homography[2, 2]
    factor = complex(a, b)
    fit = Fit(
        homography,
        float(-np.degrees(np.angle(factor)) % 360.0),
        float(1000.0 * (1.0 + q * down) / abs(factor)),
        0.0,
        parameters,
    )
    residual = float(np.sqrt(np.mean(np.sum((fit.to_pixels(points_mm) - pixels) ** 2, axis=1))))
    return Fit(homography, fit.angle_deg, fit.pixel_um, residual, parameters)


def _measured_squeeze(points_mm: FloatArray, pixels: FloatArray) -> tuple[float, float, float]:
    """Scale of rows over columns from a free affine fit, its standard uncertainty, and the rms residual."""
    design = np.column_stack([points_mm, np.ones(len(points_mm))])
    affine = np.linalg.lstsq(design, pixels, rcond=None)[0]
    rest = pixels - design @ affine
    variance = float(np.sum(rest**2)) / (2 * len(points_mm) - 6) * np.linalg.inv(design.T @ design)
    scales = np.linalg.norm(affine[:2], axis=0)
    across = affine[:2].T / scales[:, None]
    u_share = [float(np.sqrt(row @ variance[:2, :2] @ row)) for row in across] / scales
    ratio = float(scales[1] / scales[0])
    rest_px = float(np.sqrt(np.mean(np.sum(rest**2, axis=1))))
    return ratio, ratio * float(np.hypot(*u_share)), rest_px


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
        squeeze: measured foreshortening of the picture's rows, relative to the cosine of the tilt.
        u_squeeze: its standard uncertainty.
        dropped: ids of inconsistent markers that were left out.
        lens: distortion of the picture, where it is calibrated; all other places are those without distortion.
        bent_share: radial distortion at the corners of the picture that explains a residual above 0.3 px, else 0.
    """

    matrix: FloatArray
    angle_deg: float
    pixel_um: float
    axis_px: tuple[float, float]
    residual_px: float
    markers: int
    perspective: tuple[float, float] = (0.0, 0.0)
    blur_px: float | None = None
    squeeze: float = 1.0
    u_squeeze: float = 0.0
    dropped: tuple[int, ...] = ()
    lens: Lens | None = None
    bent_share: float = 0.0

    @property
    def homography(self) -> FloatArray:
        """(3, 3) map from sample millimetres to (column, row, 1) without distortion, up to a factor."""
        return np.vstack([self.matrix, [*self.perspective, 1.0]])

    def seen(self, straight: FloatArray) -> FloatArray:
        """(..., 2) column and row in the picture, of places without distortion."""
        return straight if self.lens is None else self.lens.seen(straight)

    def straight(self, seen: FloatArray) -> FloatArray:
        """(..., 2) column and row without distortion, of places in the picture."""
        return seen if self.lens is None else self.lens.straight(seen)


@dataclass(frozen=True, eq=False)
class View:
    """One photographed pose: picture, placement of the sample, commanded angles.

    ``u_level`` is the relative standard uncertainty of the level by which the picture was normalised, 0 where it was
    not.
    """

    stage_deg: float
    tilt_deg: float
    image: RadianceImage
    placement: Placement
    u_level: float = 0.0


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


def locate(
    image: Image,
    fixture: Fixture,
    tilt_deg: float = 0.0,
    *,
    lens: Lens | None = None,
    marker_off_um: float = 0.0,
) -> Placement:
    """Find the fixture in a picture and fit a similarity: rotation, scale, shift.

    A tilted camera sees the plate foreshortened along the rows of the picture's height by cos(tilt); this is
    removed before the fit. Perspective adds one parameter where the markers resolve it. A single
    inconsistent marker is left out and reported.

    Args:
        image: (rows, cols) linear picture.
        fixture: the markers and their positions.
        tilt_deg: tilt of the camera about the picture's horizontal axis.
        lens: distortion of the picture, where it is calibrated.
        marker_off_um: distance by which a marker may be off the others, µm; 0.3 px are always allowed.

    Raises:
        RegistrationError: fewer than three of the fixture's markers are visible, or they contradict each other.
    """
    found = find_markers(image, fixture)
    if len({marker.id for marker in found}) < MIN_MARKERS:
        mirrored = find_markers(np.ascontiguousarray(image[:, ::-1]), fixture)
        if len({marker.id for marker in mirrored}) >= MIN_MARKERS:
            raise RegistrationError(
                "the picture is mirrored: its markers are seen only in its mirror image: switch the mirroring of the "
                'camera off or on (features = "ReverseX=…" in [camera.options]), or of the program that saves the '
                "pictures, and take a new flat"
            )
    return place_markers(found, fixture, image.shape[:2], tilt_deg, lens=lens, marker_off_um=marker_off_um)


def place_markers(
    found: Sequence[Marker],
    fixture: Fixture,
    shape: tuple[int, int],
    tilt_deg: float = 0.0,
    *,
    lens: Lens | None = None,
    marker_off_um: float = 0.0,
) -> Placement:
    """Placement by the markers found in a picture of (rows, cols); arguments and errors as for `locate`."""
    known = marker_corners_mm(fixture)
    distinct = len({marker.id for marker in found})
    if distinct < MIN_MARKERS:
        raise RegistrationError(
            f"only {distinct} of {len(known)} fixture markers are seen (at least {MIN_MARKERS} needed): check that "
            "the light is on, nothing covers them, the lens is clear and in focus, and the fixture is the one in the "
            "rig file"
        )
    if lens is not None:
        found = [replace(marker, corners=lens.straight(marker.corners)) for marker in found]
    return _placement(agree(found, known, float(np.cos(np.radians(tilt_deg))), shape, marker_off_um), lens)


def _placement(agreed: Agreed, lens: Lens | None) -> Placement:
    fit, used = agreed.fit, agreed.markers
    blurs = [marker.blur_px for marker in used]
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
        squeeze=agreed.squeeze,
        u_squeeze=agreed.u_squeeze,
        dropped=agreed.dropped,
        lens=lens,
        bent_share=agreed.bent_share,
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

    def of_cell(self, row: float, col: float, cells: tuple[int, ...]) -> tuple[float, float]:
        """Sample millimetres of a place in a raster of (rows, columns) cells over the same area."""
        rows, cols = cells
        point = ((col + 0.5) * self.shape[1] / cols - 0.5, (row + 0.5) * self.shape[0] / rows - 0.5, 1.0)
        x, y, _ = self.to_mm() @ np.array(point)
        return float(x), float(y)


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
    if placement.lens is not None:
        row, column = np.indices(grid.shape).astype(np.float64)
        x, y, scale = np.einsum("ij,jrc->irc", matrix, np.stack([column, row, np.ones_like(row)]))
        at = placement.seen(np.stack([x / scale, y / scale], axis=-1)).astype(np.float32)
        warped = cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR, **nothing)  # type: ignore[call-overload]
    elif any(placement.perspective):
        warped = cv2.warpPerspective(image, matrix, (cols, rows), flags=flags, **nothing)  # type: ignore[call-overload]
    else:
        warped = cv2.warpAffine(image, matrix[:2], (cols, rows), flags=flags, **nothing)  # type: ignore[call-overload]
    return np.asarray(warped, dtype=np.float32)
