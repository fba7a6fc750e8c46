"""Aligning the turned pictures without markers, by the edges of what lies under the camera.

Grey values flip when the part is turned, so only the magnitude of their gradient counts. Every picture is turned back
about the rotation axis by what the stage says; what is left is found by correlating edges at a coarse scale, then
refined by enhanced correlation (Evangelidis and Psarakis, IEEE PAMI 30, 2008) down to a fine one, where neighbouring
edges no longer mix. Ridges repeat, so that fine edges fit as well one pitch further; coarse ones, which see the outline
and single marks, say which place is meant. Where they do not, or anything else is unclear, the pictures are refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.errors import RegistrationError
from anisoscope.registration.placement import Grid, Placement, resample

FloatArray = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

COARSE_PX, FINE_PX = 8.0, (3.0, 1.5, 1.0)
MAX_SIDE = 1024
MAX_SHIFT_PX = 5.0
MAX_TURN_DEG = 0.2
UNKNOWN_AXIS_SHARE = 0.15
MAX_SECOND_PEAK = 0.85
MIN_COARSE, MIN_FINE = 0.3, 0.5
MAX_APART_PX = 3.0
MAX_RESIDUAL_PX = 0.5
_MIN_QUADRANTS = 3
_ADVICE = "describe a [fixture] with markers in the rig file"


@dataclass(frozen=True)
class Seen:
    """A picture to be aligned.

    Attributes:
        image: (rows, cols) linear picture; NaN where a pixel has no value.
        stage_deg: angle of the sample by the stage.
        tilt_deg: tilt of the camera.
    """

    image: Image
    stage_deg: float
    tilt_deg: float = 0.0


def place_by_edges(
    pictures: Sequence[Seen], pixel_um: float, axis_px: tuple[float, float] | None = None
) -> list[Placement]:
    """Where the sample stands in every picture, seen from the first one.

    Args:
        pictures: at least one; the first is the reference.
        pixel_um: size of a pixel on the sample.
        axis_px: (column, row) of the rotation axis, calibrated; without it, it is estimated from the pictures.

    Returns:
        One a picture; the sample's origin is the rotation axis.

    Raises:
        RegistrationError: there is too little structure, the pictures fit in several places, or they fit elsewhere than
            stage and axis say.
    """
    shape = pictures[0].image.shape
    start = axis_px or ((shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0)
    nominal = [_nominal(seen, pixel_um, start) for seen in pictures]
    grid = _raster(shape, start, pixel_um)
    scale = grid.pixel_mm * 1000.0 / pixel_um
    layers = [
        [
            np.nan_to_num(resample(_edges(seen.image, sigma * scale), place, grid))
            for sigma in (COARSE_PX, *FINE_PX)
        ]
        for seen, place in zip(pictures, nominal, strict=True)
    ]
    reach = MAX_SHIFT_PX if axis_px is not None else UNKNOWN_AXIS_SHARE * min(shape)
    found = [nominal[0]]
    for number in range(1, len(pictures)):
        name = f"at {pictures[number].stage_deg:g}°"
        warp, residual = _aligned(
            list(zip(layers[0], layers[number], strict=True)), 2.0 * reach / scale, name
        )
        found.append(_moved(nominal[number], warp, grid, residual * scale))
    centred = found if axis_px is not None else _about_the_axis(found)
    for seen, place in zip(pictures[1:], centred[1:], strict=True):
        _check(seen, place, centred[0])
    return centred


def _nominal(seen: Seen, pixel_um: float, axis_px: tuple[float, float]) -> Placement:
    """Where the sample stands if stage, axis and tilt are right."""
    factor = 1000.0 / pixel_um * np.exp(1j * np.radians(seen.stage_deg))
    squeeze = float(np.cos(np.radians(seen.tilt_deg)))
    matrix = np.array(
        [
            [factor.real, -factor.imag, axis_px[0]],
            [-squeeze * factor.imag, -squeeze * factor.real, axis_px[1]],
        ]
    )
    return Placement(matrix, seen.stage_deg % 360.0, pixel_um, axis_px, 0.0, 0)


def _raster(shape: tuple[int, ...], axis_px: tuple[float, float], pixel_um: float) -> Grid:
    """A square about the axis, as large as the circle that every turned picture shows."""
    radius = min(*axis_px, shape[1] - 1 - axis_px[0], shape[0] - 1 - axis_px[1])
    side = 2.0 * max(radius, 8.0)
    points = min(int(side), MAX_SIDE) // 4 * 4
    return Grid((0.0, 0.0), side / points * pixel_um / 1000.0, (points, points))


def _edges(image: Image, sigma_px: float) -> Image:
    """Magnitude of the gradient at a scale, by what is usual around, so that strong and weak edges count alike."""
    known = np.isfinite(image)
    level = float(np.median(image[known][::16])) if known.any() else 0.0
    calm = np.sqrt(np.maximum(np.where(known, image, level), 0.0, dtype=np.float32))
    calm = np.asarray(cv2.GaussianBlur(calm, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE))
    across, down = (cv2.Sobel(calm, cv2.CV_32F, *order, ksize=3) for order in ((1, 0), (0, 1)))
    magnitude = np.hypot(across, down)
    usual = cv2.GaussianBlur(magnitude, (0, 0), 4.0 * sigma_px, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(magnitude / (usual + 0.3 * float(magnitude.mean()) + 1e-12), dtype=np.float32)


def _window(side: int, margin: float) -> Image:
    """1 within a circle, falling to 0 at the distance ``margin`` inside the inscribed one."""
    at = np.arange(side, dtype=np.float32) - (side - 1) / 2.0
    radius = np.hypot(at[:, None], at)
    inner = side / 2.0 - margin
    soft = np.clip((inner - radius) / max(0.15 * side, 1.0), 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * soft), dtype=np.float32)


def _aligned(layers: list[tuple[Image, Image]], reach: float, name: str) -> tuple[FloatArray, float]:
    """How the other picture lies against the first one.

    Args:
        layers: edges of both, turned back, from the coarse scale to the finest.
        reach: largest shift, in points.
        name: of the other picture, for messages.

    Returns:
        (2, 3) map from points of the first picture's raster to those of the other's; its uncertainty in points.
    """
    side = layers[0][0].shape[0]
    shift = _coarse_shift(*layers[0], reach, name)
    warp = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]], dtype=np.float32)
    window = _window(side, 2.0 * FINE_PX[0] + float(np.hypot(*shift)))
    inside = np.asarray(window > 0.02, dtype=np.uint8)
    warp, _ = _refined(*layers[0], warp, inside, cv2.MOTION_TRANSLATION, name)
    coarse, correlation = warp, 0.0
    for first, other in layers[1:]:
        warp, correlation = _refined(first, other, warp, inside, cv2.MOTION_EUCLIDEAN, name)
    middle = np.array([(side - 1) / 2.0, (side - 1) / 2.0, 1.0])
    apart = float(np.hypot(*(warp @ middle - coarse @ middle)))
    if correlation < MIN_FINE or apart > MAX_APART_PX:
        raise RegistrationError(
            f"{name} the edges are not surely those of the first picture (correlation {correlation:.2f}, at least "
            f"{MIN_FINE:g} needed; coarse and fine ones {apart:.1f} px apart, limit {MAX_APART_PX:g} px): is it the "
            f"same part, in focus and lit? else {_ADVICE}"
        )
    back = _pulled(layers[2][1], warp)
    if _fits_nearby(layers[2][0], back, window):
        raise RegistrationError(f"{name} ridges so narrow fit one pitch further as well: {_ADVICE}")
    return np.asarray(warp, dtype=np.float64), _residual(layers[2][0], back, window, name)


def _pulled(edges: Image, warp: Image) -> Image:
    size = edges.shape[::-1]
    return np.asarray(cv2.warpAffine(edges, warp, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP))


def _correlation(first: Image, other: Image, window: Image) -> FloatArray:
    """Correlation of two pictures for every shift of the other one, both axes in the order of `numpy.fft.fftfreq`."""
    parts = [(edges - np.average(edges, weights=window)) * window for edges in (first, other)]
    power = float(np.sqrt(np.prod([(part.astype(np.float64) ** 2).sum() for part in parts])))
    spectra = [np.fft.rfft2(part) for part in parts]
    surface = np.fft.irfft2(np.conj(spectra[0]) * spectra[1], first.shape)
    return np.asarray(surface / max(power, 1e-12), dtype=np.float64)


def _distance(side: int, row: float = 0.0, col: float = 0.0) -> FloatArray:
    """Distance of every shift from one shift, around the edges."""
    away = np.fft.fftfreq(side, 1.0 / side)
    down, across = ((away - at + side / 2.0) % side - side / 2.0 for at in (row, col))
    return np.asarray(np.hypot(down[:, None], across), dtype=np.float64)


def _coarse_shift(first: Image, other: Image, reach: float, name: str) -> tuple[float, float]:
    """(columns, rows) where coarse edges correlate best: the only clear peak, and within reach."""
    side = first.shape[0]
    surface = _correlation(first, other, _window(side, 2.0 * FINE_PX[0]))
    near = _distance(side) <= reach + 1.0
    row, col = (int(i) for i in np.unravel_index(np.where(near, surface, -np.inf).argmax(), surface.shape))
    best = float(surface[row, col])
    if best < MIN_COARSE:
        raise RegistrationError(
            f"{name} the picture shows too little structure in common with the first one (correlation {best:.2f}, at "
            f"least {MIN_COARSE:g} needed): is it the same part, in focus, lit, and inside the picture? else {_ADVICE}"
        )
    away = np.fft.fftfreq(side, 1.0 / side)
    second = float(surface[_distance(side, away[row], away[col]) > 2.0 * COARSE_PX].max())
    if second > MAX_SECOND_PEAK * best:
        raise RegistrationError(
            f"{name} the picture fits in several places about as well (second peak {second / best:.0%} of the first, "
            f"limit {MAX_SECOND_PEAK:.0%}): ridges that fill the picture look alike after every pitch, or the part "
            f"slipped; show the part's outline, or {_ADVICE}"
        )
    return float(away[col]), float(away[row])


def _refined(
    first: Image, other: Image, warp: Image, inside: npt.NDArray[np.uint8], motion: int, name: str
) -> tuple[Image, float]:
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-5)
    try:
        correlation, found = cv2.findTransformECC(first, other, warp.copy(), motion, criteria, inside, 1)
    except cv2.error as problem:
        raise RegistrationError(
            f"{name} the edges of the picture cannot be fitted to those of the first one: is it the same part, in "
            f"focus and lit? else {_ADVICE}"
        ) from problem
    return np.asarray(found, dtype=np.float32), float(correlation)


def _fits_nearby(first: Image, back: Image, window: Image) -> bool:
    """Does a place so near that coarse edges cannot tell it fit about as well?"""
    surface = _correlation(first, back, window)
    away = _distance(first.shape[0])
    ring = (away > 2.5) & (away <= 2.0 * MAX_APART_PX)
    highest = surface == cv2.dilate(surface, np.ones((3, 3), np.uint8))
    return bool(np.any(ring & highest & (surface > 0.9 * surface[0, 0])))


def _residual(first: Image, back: Image, window: Image, name: str) -> float:
    """Standard uncertainty of the fit, in points: the shift left in each quarter on its own, by their root mean square.

    Raises:
        RegistrationError: fewer than three of them agree at all.
    """
    down, across = (np.gradient(back, axis=axis) for axis in (0, 1))
    half = first.shape[0] // 2
    shifts = []
    for rows in (slice(0, half), slice(-half, None)):
        for cols in (slice(0, half), slice(-half, None)):
            weight = window[rows, cols].ravel()
            used = weight > 0.02
            wanted, seen = (edges[rows, cols].ravel()[used] for edges in (first, back))
            slopes = [edges[rows, cols].ravel()[used] for edges in (across, down)]
            root = np.sqrt(weight[used])
            design = np.stack([seen, np.ones_like(seen), *slopes], axis=1) * root[:, None]
            gain, _, right, below = np.linalg.lstsq(design, wanted * root, rcond=None)[0]
            if np.corrcoef(wanted, seen)[0, 1] > MIN_COARSE and gain > 0.0:
                shifts.append((right / gain, below / gain))
    if len(shifts) < _MIN_QUADRANTS:
        raise RegistrationError(
            f"{name} only {len(shifts)} quarters of the picture fit those of the first one (at least {_MIN_QUADRANTS} "
            f"needed): is part of it dark, out of focus or hidden? else {_ADVICE}"
        )
    return float(np.sqrt(np.mean(np.sum(np.square(shifts), axis=1)) / len(shifts)))


def _moved(nominal: Placement, warp: FloatArray, grid: Grid, residual_px: float) -> Placement:
    """The placement under which the picture fits the first one."""
    to_mm = grid.to_mm()
    motion = to_mm @ np.vstack([warp, [0.0, 0.0, 1.0]]) @ np.linalg.inv(to_mm)
    matrix = nominal.matrix @ motion
    turn = float(np.degrees(np.arctan2(motion[1, 0], motion[0, 0])))
    axis = (float(matrix[0, 2]), float(matrix[1, 2]))
    return Placement(matrix, (nominal.angle_deg + turn) % 360.0, nominal.pixel_um, axis, residual_px, 0)


def _about_the_axis(places: list[Placement]) -> list[Placement]:
    """The same placements with the origin in the point that moves least: the rotation axis."""
    turned = [place for place in places[1:] if np.abs(place.matrix - places[0].matrix)[:, :2].max() > 1e-3]
    if not turned:
        return places
    design = np.concatenate([place.matrix[:, :2] - places[0].matrix[:, :2] for place in turned])
    wanted = np.concatenate([places[0].matrix[:, 2] - place.matrix[:, 2] for place in turned])
    origin = np.linalg.lstsq(design, wanted, rcond=None)[0]
    found = []
    for place in places:
        matrix = place.matrix.copy()
        matrix[:, 2] += matrix[:, :2] @ origin
        axis = (float(matrix[0, 2]), float(matrix[1, 2]))
        found.append(Placement(matrix, place.angle_deg, place.pixel_um, axis, place.residual_px, 0))
    return found


def _check(seen: Seen, place: Placement, first: Placement) -> None:
    """Does the picture stand where stage and axis say?"""
    off = float(np.hypot(*np.subtract(place.axis_px, first.axis_px)))
    turn = (place.angle_deg - seen.stage_deg + 180.0) % 360.0 - 180.0
    if off > MAX_SHIFT_PX or abs(turn) > MAX_TURN_DEG:
        raise RegistrationError(
            f"at {seen.stage_deg:g}° the edges place the part {off:.1f} px and {turn:+.2f}° from where the rotation "
            f"axis and the stage say (limits {MAX_SHIFT_PX:g} px, {MAX_TURN_DEG:g}°): did the part slip, or is the "
            "rotation axis not where it was calibrated?"
        )
    if place.residual_px > MAX_RESIDUAL_PX:
        raise RegistrationError(
            f"at {seen.stage_deg:g}° the quarters of the picture leave {place.residual_px:.2f} px of doubt (limit "
            f"{MAX_RESIDUAL_PX:g} px): check focus and tilt, or {_ADVICE}"
        )
