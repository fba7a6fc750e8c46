"""Registration of the turned pictures without markers, by the edges of the part.

Every picture is turned back about the rotation axis by the stage angle; the remaining small shift and rotation are
fitted to the directions of edges. Ridges are periodic, so that a picture fits equally well one pitch further; outline
and single marks resolve the ambiguity. Pictures whose position stays ambiguous are refused.

Turning the part inverts contrasts, and with them the sign of every gradient. The direction modulo 180° is invariant,
and so is the square of the gradient as a complex number (orientation correlation of Fitch et al., BMVC 2002, squared to
be independent of the sign of contrast). The weight of an edge saturates above the noise.

All shifts are correlated at once by Fourier transform. The harmonics of the ridges are damped in the spectrum, so that
they do not mask the features that distinguish one pitch from the next. The best position is refined by least squares in
shift and rotation over all edges.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import RegistrationError
from anisoscope.imaging.registration.lens import Lens
from anisoscope.imaging.registration.placement import Grid, Placement, resample

Image = npt.NDArray[np.float32]

COARSE_PX, FINE_PX = 1.6, 0.8
NOISE_GRADIENTS = 4.0
USUAL_SHARE = 0.5
DAMPING = 300.0
NEAR_PX = 3.0
TILES = 8
STEPS = 10
CONVERGENCE_PX = 3e-3


@dataclass(frozen=True, eq=False)
class Fit:
    """Alignment of a picture with the first one.

    Attributes:
        warp: (2, 3) map from points of the first picture to those of the other one.
        score: correlation of the edges' directions, 1 where they agree everywhere.
        u_px: standard uncertainty of a position in points, rms over the window, from the scatter between tiles.
    """

    warp: FloatArray
    score: float
    u_px: float


def noise_of(image: Image) -> float:
    """Standard deviation of white noise, from second differences along both axes, which pass over edges."""
    second = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    found = cv2.filter2D(image, cv2.CV_32F, second)[2:-2:2, 2:-2:2]
    return float(np.median(np.abs(found)) / 0.6745 / 6.0)


def directions(image: Image, sigma_px: float) -> Image:
    """Squared direction of the gradient as real and imaginary part, of length 1 at clear edges and 0 without edges.

    Args:
        image: (rows, cols) picture; NaN where it has no value.
        sigma_px: scale.

    Returns:
        (rows, cols, 2).
    """
    known = np.isfinite(image)
    filled = np.where(known, image, np.float32(np.median(image[known]) if known.any() else 0.0))
    calm = cv2.GaussianBlur(filled, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE)
    across, down = _slopes(np.asarray(calm, dtype=np.float32))
    power = across**2 + down**2
    usual = cv2.GaussianBlur(power, (0, 0), 4.0 * sigma_px, borderType=cv2.BORDER_REPLICATE)
    drowned = (
        NOISE_GRADIENTS * noise_of(filled) / (np.sqrt(8.0 * np.pi) * sigma_px**2)
    )  # of blurred white noise
    length = power + USUAL_SHARE**2 * usual + np.float32(drowned**2 + 1e-20)
    if not known.all():
        reach = 2 * int(np.ceil(3.0 * sigma_px)) + 3
        known = cv2.erode(known.astype(np.uint8), np.ones((reach, reach), np.uint8)) > 0
        length = np.where(known, length, np.float32(np.inf))
    return np.stack([(across**2 - down**2) / length, 2.0 * across * down / length], axis=-1)


def all_shifts(first: Image, other: Image, window: Image) -> FloatArray:
    """Correlation for every shift of the other field, both axes in the order of `numpy.fft.fftfreq`."""
    weighted = [np.ascontiguousarray(field * window[..., None]) for field in (first, other)]
    spectra = [np.fft.fft2(field.view(np.complex64)[..., 0]) for field in weighted]
    powers = [np.abs(spectrum) ** 2 for spectrum in spectra]
    together = powers[0] + powers[1]
    damped = 1.0 / (together + DAMPING * np.median(together) + 1e-20)
    norm = float(np.sqrt(np.prod([float((power * damped).sum()) for power in powers]))) / window.size
    found = np.fft.ifft2(np.conj(spectra[0]) * spectra[1] * damped).real
    return np.asarray(found / max(norm, 1e-12), dtype=np.float64)


def clearest(surface: FloatArray) -> tuple[tuple[float, float], float, float]:
    """(columns, rows) of the best shift, its correlation, and the ratio of the second-best peak to it."""
    row, col = (int(i) for i in np.unravel_index(surface.argmax(), surface.shape))
    away = [np.fft.fftfreq(size, 1.0 / size) for size in surface.shape]
    distance = [
        np.abs((line - line[at] + len(line) / 2.0) % len(line) - len(line) / 2.0)
        for line, at in zip(away, (row, col), strict=True)
    ]
    elsewhere = np.hypot(distance[0][:, None], distance[1]) > NEAR_PX
    peak = float(surface[row, col])
    second = float(surface.max(where=elsewhere, initial=0.0))
    return (float(away[1][col]), float(away[0][row])), peak, second / max(peak, 1e-12)


def shifted(shift: tuple[float, float]) -> FloatArray:
    """The warp of a shift alone."""
    return np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])


def refined(first: Image, other: Image, warp: FloatArray, window: Image) -> Fit:
    """Least-squares refinement of a warp in shift, rotation about the centre, and gain."""
    reach = 0.35 * first.shape[0]
    for _ in range(STEPS):
        design, rest, _ = _linear(first, other, warp, reach)
        right = np.array([float(np.vdot(column, window[..., None] * rest)) for column in design])
        step = np.linalg.lstsq(_normal(design, window), right, rcond=None)[0][:3]
        step *= min(1.0, 1.0 / max(float(np.abs(step).max()), 1e-12))
        warp = _stepped(warp, step, reach, first.shape[0])
        if np.abs(step).max() < CONVERGENCE_PX:
            break
    design, rest, seen = _linear(first, other, warp, reach)
    inverse = np.linalg.pinv(_normal(design, window))
    pulls = np.stack([_by_tiles(window * np.sum(column * rest, axis=-1)) for column in design])
    covariance = (inverse @ pulls @ pulls.T @ inverse)[:3, :3]
    both, one, two = (
        float(np.vdot(a * window[..., None], b)) for a, b in ((first, seen), (first, first), (seen, seen))
    )
    score = both / max(float(np.sqrt(one * two)), 1e-12)
    return Fit(warp, score, float(np.sqrt(np.trace(covariance))))


def _pulled(field: Image, warp: FloatArray) -> Image:
    """The field resampled by the warp; 0 outside."""
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(field, warp, field.shape[1::-1], flags=flags), dtype=np.float32)


def _slopes(field: Image) -> tuple[Image, Image]:
    across, down = (cv2.Sobel(field, cv2.CV_32F, *order, ksize=3, scale=0.125) for order in ((1, 0), (0, 1)))
    return np.asarray(across, dtype=np.float32), np.asarray(down, dtype=np.float32)


def _linear(
    first: Image, other: Image, warp: FloatArray, reach: float
) -> tuple[tuple[Image, ...], Image, Image]:
    """Derivatives by shift, rotation (in points at ``reach``) and gain; the residual; the other field resampled."""
    seen = _pulled(other, warp)
    gain = np.float32(np.vdot(seen, first) / max(float(np.vdot(seen, seen)), 1e-12))
    across, down = (gain * slope for slope in _slopes(seen))
    away = ((np.arange(first.shape[0]) - (first.shape[0] - 1) / 2.0) / reach).astype(np.float32)
    turn = away[None, :, None] * down - away[:, None, None] * across
    return (across, down, turn, seen), first - gain * seen, seen


def _normal(design: tuple[Image, ...], window: Image) -> FloatArray:
    weighted = [column * window[..., None] for column in design]
    return np.array([[float(np.vdot(a, b)) for b in design] for a in weighted])


def _stepped(warp: FloatArray, step: FloatArray, reach: float, side: int) -> FloatArray:
    """The warp after a shift and a rotation about the centre of the first picture."""
    turn, middle = step[2] / reach, (side - 1) / 2.0
    cos, sin = np.cos(turn), np.sin(turn)
    motion = np.array([[cos, -sin, step[0]], [sin, cos, step[1]], [0.0, 0.0, 1.0]])
    motion[:2, 2] += middle - motion[:2, :2] @ [middle, middle]
    return np.asarray(warp @ motion)


def _by_tiles(values: Image) -> FloatArray:
    """Sums over square tiles."""
    means = cv2.resize(values.astype(np.float32), (TILES, TILES), interpolation=cv2.INTER_AREA)
    return np.asarray(means, dtype=np.float64).ravel() * (values.size / TILES**2)


MAX_SIDE = 1024
MAX_SHIFT_PX = 5.0
MAX_TURN_DEG = 0.2
UNKNOWN_AXIS_SHARE = 0.3
MAX_SECOND_PEAK = 0.7
MIN_PEAK, MIN_SCORE = 0.12, 0.5
MAX_RESIDUAL_PX = 0.4
_MARGIN = 8.0
_ADVICE = "describe a [fixture] with markers in the rig file"


@dataclass(frozen=True)
class TurnedPicture:
    """A picture to be registered.

    Attributes:
        image: (rows, cols) linear picture; NaN where a pixel has no value.
        stage_deg: angle of the sample by the stage.
        tilt_deg: tilt of the camera.
    """

    image: Image
    stage_deg: float
    tilt_deg: float = 0.0


def place_by_edges(
    pictures: Sequence[TurnedPicture],
    pixel_um: float,
    axis_px: tuple[float, float] | None = None,
    lens: Lens | None = None,
) -> list[Placement]:
    """Register every picture to the first one.

    Args:
        pictures: at least one; the first is the reference.
        pixel_um: size of a pixel on the sample.
        axis_px: (column, row) of the rotation axis, calibrated; without it, it is estimated from the pictures.
        lens: distortion of the pictures, where it is calibrated.

    Returns:
        One placement per picture; the sample's origin is the rotation axis.

    Raises:
        RegistrationError: too little structure, an ambiguous position, or one that contradicts stage and axis.
    """
    shape = pictures[0].image.shape
    start = axis_px or ((shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0)
    found = _placed(pictures, pixel_um, start, UNKNOWN_AXIS_SHARE * min(shape), lens)
    if axis_px is None:
        # repeated about the axis found, so that all sides of the part have equal weight
        about = _about_the_axis(found)[0].axis_px
        found = _about_the_axis(_placed(pictures, pixel_um, about, 2.0 * MAX_SHIFT_PX, lens))
    for seen, place in zip(pictures[1:], found[1:], strict=True):
        _check(seen, place, found[0])
    return found


def _placed(
    pictures: Sequence[TurnedPicture],
    pixel_um: float,
    axis_px: tuple[float, float],
    reach_px: float,
    lens: Lens | None,
) -> list[Placement]:
    """Placement in every picture, searched within ``reach`` of the nominal one."""
    nominal = [replace(_nominal(seen, pixel_um, axis_px), lens=lens) for seen in pictures]
    grid = _raster(pictures[0].image.shape, axis_px, pixel_um)
    scale = grid.pixel_mm * 1000.0 / pixel_um
    first = _turned_back(pictures[0].image, nominal[0], grid, scale)
    found = [nominal[0]]
    for seen, place in zip(pictures[1:], nominal[1:], strict=True):
        other = _turned_back(seen.image, place, grid, scale)
        fit = _aligned(first, other, reach_px / scale, f"at {seen.stage_deg:g}°")
        found.append(_moved(place, fit.warp, grid, fit.u_px * scale))
    return found


def _nominal(seen: TurnedPicture, pixel_um: float, axis_px: tuple[float, float]) -> Placement:
    """Nominal placement from stage, axis and tilt."""
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
    """Square raster about the axis that circumscribes the circle common to all turned pictures."""
    radius = min(*axis_px, shape[1] - 1 - axis_px[0], shape[0] - 1 - axis_px[1])
    side = 2.0 * max(radius, 8.0)
    points = min(int(side), MAX_SIDE) // 4 * 4
    return Grid((0.0, 0.0), side / points * pixel_um / 1000.0, (points, points))


def _turned_back(image: Image, place: Placement, grid: Grid, scale: float) -> Image:
    """The picture on the raster, with variance-stabilised noise; NaN where it has no value."""
    calm = np.sqrt(np.maximum(image, 0.0, dtype=np.float32))
    if scale > 1.0:
        calm = np.asarray(cv2.GaussianBlur(calm, (0, 0), 0.35 * scale), dtype=np.float32)
    return resample(calm, place, grid)


def _window(side: int, margin: float, soft: float) -> Image:
    """1 within a circle, falling over ``soft`` points to 0 at the distance ``margin`` inside the inscribed one."""
    at = np.arange(side, dtype=np.float32) - (side - 1) / 2.0
    inside = np.clip((side / 2.0 - margin - np.hypot(at[:, None], at)) / soft, 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * inside), dtype=np.float32)


def _aligned(first: Image, other: Image, reach: float, name: str) -> Fit:
    """Align another picture, turned back, with the first one.

    Args:
        first: (side, side) picture.
        other: likewise.
        reach: largest shift, in points.
        name: of the other picture, for messages.
    """
    side = first.shape[0]
    window = _window(side, _MARGIN, 0.15 * side)
    fine = [directions(picture, FINE_PX) for picture in (first, other)]
    surface = all_shifts(fine[0], fine[1], window)
    shift, peak, second = clearest(surface)
    if peak < MIN_PEAK:
        raise RegistrationError(
            f"{name} the picture shows too little structure in common with the first one (correlation {peak:.2f}, at "
            f"least {MIN_PEAK:g} needed): is it the same part, in focus, lit, and inside the picture? else {_ADVICE}"
        )
    if second > MAX_SECOND_PEAK:
        raise RegistrationError(
            f"{name} the picture fits in several places about as well (second peak {second:.0%} of the first, "
            f"limit {MAX_SECOND_PEAK:.0%}): ridges look alike after every pitch, or the part slipped; show the part's "
            f"outline, or {_ADVICE}"
        )
    if float(np.hypot(*shift)) > reach:
        raise RegistrationError(
            f"{name} the edges fit only {np.hypot(*shift) / side:.0%} of the picture away from where the stage says: "
            f"did the part slip? else {_ADVICE}"
        )
    window = _window(side, _MARGIN + float(np.hypot(*shift)), _MARGIN)
    coarse = [directions(picture, COARSE_PX) for picture in (first, other)]
    fit = refined(fine[0], fine[1], refined(coarse[0], coarse[1], shifted(shift), window).warp, window)
    if fit.score < MIN_SCORE:
        raise RegistrationError(
            f"{name} the edges are not surely those of the first picture (correlation {fit.score:.2f}, at least "
            f"{MIN_SCORE:g} needed): is it the same part, in focus and lit? else {_ADVICE}"
        )
    return fit


def _moved(nominal: Placement, warp: FloatArray, grid: Grid, residual_px: float) -> Placement:
    """The placement corrected by the fitted warp."""
    to_mm = grid.to_mm()
    motion = to_mm @ np.vstack([warp, [0.0, 0.0, 1.0]]) @ np.linalg.inv(to_mm)
    matrix = nominal.matrix @ motion
    turn = float(np.degrees(np.arctan2(motion[1, 0], motion[0, 0])))
    axis = (float(matrix[0, 2]), float(matrix[1, 2]))
    angle_deg = (nominal.angle_deg + turn) % 360.0
    return replace(nominal, matrix=matrix, angle_deg=angle_deg, axis_px=axis, residual_px=residual_px)


def _about_the_axis(places: list[Placement]) -> list[Placement]:
    """The placements with the origin moved to the point that moves least: the rotation axis."""
    turned = [place for place in places[1:] if np.abs(place.matrix - places[0].matrix)[:, :2].max() > 1e-3]
    if not turned:
        return places
    design = np.concatenate([place.matrix[:, :2] - places[0].matrix[:, :2] for place in turned])
    target = np.concatenate([places[0].matrix[:, 2] - place.matrix[:, 2] for place in turned])
    origin = np.linalg.lstsq(design, target, rcond=None)[0]
    found = []
    for place in places:
        matrix = place.matrix.copy()
        matrix[:, 2] += matrix[:, :2] @ origin
        axis = (float(matrix[0, 2]), float(matrix[1, 2]))
        found.append(replace(place, matrix=matrix, axis_px=axis))
    return found


def _check(seen: TurnedPicture, place: Placement, first: Placement) -> None:
    """Compare a placement with stage angle and rotation axis."""
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
            f"at {seen.stage_deg:g}° parts of the picture leave {place.residual_px:.2f} px of doubt (limit "
            f"{MAX_RESIDUAL_PX:g} px): check focus and tilt, or {_ADVICE}"
        )
