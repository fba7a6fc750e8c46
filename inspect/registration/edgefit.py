"""Laying one turned picture onto another by the directions of their edges, with what the fit leaves in doubt.

Grey values flip when the part is turned, and with them the sign of every gradient; its direction modulo 180° stays, and
so does its square as a complex number (orientation correlation of Fitch et al., BMVC 2002, with the square that makes
it blind to contrast). A strong edge counts hardly more than a weak one that noise does not drown.

All shifts are tried at once by Fourier transform. What repeats stands out in the spectrum and is damped there, so that
ridges do not drown the outline and the marks that tell one pitch from the next. The best place is refined by least
squares in shift and turn, by all edges.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

COARSE_PX, FINE_PX = 1.6, 0.8
NOISE_GRADIENTS = 4.0
USUAL_SHARE = 0.5
DAMPING = 300.0
NEAR_PX = 3.0
TILES = 8
STEPS = 10
ENOUGH_PX = 3e-3


@dataclass(frozen=True, eq=False)
class Fit:
    """How a picture lies on the first one.

    Attributes:
        warp: (2, 3) map from points of the first picture to those of the other one.
        score: correlation of the edges' directions, 1 where they agree everywhere.
        u_px: standard uncertainty of a place, root mean square over the window, in points: by how much tiles disagree.
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
    """Squared direction of the gradient: real and imaginary part, length 1 at clear edges and 0 where there are none.

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
    """(columns, rows) of the best shift, its correlation, and the best one elsewhere by it."""
    row, col = (int(i) for i in np.unravel_index(surface.argmax(), surface.shape))
    away = [np.fft.fftfreq(size, 1.0 / size) for size in surface.shape]
    apart = [
        np.abs((line - line[at] + len(line) / 2.0) % len(line) - len(line) / 2.0)
        for line, at in zip(away, (row, col), strict=True)
    ]
    elsewhere = np.hypot(apart[0][:, None], apart[1]) > NEAR_PX
    peak = float(surface[row, col])
    second = float(surface.max(where=elsewhere, initial=0.0))
    return (float(away[1][col]), float(away[0][row])), peak, second / max(peak, 1e-12)


def shifted(shift: tuple[float, float]) -> FloatArray:
    """The warp of a shift alone."""
    return np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])


def refined(first: Image, other: Image, warp: FloatArray, window: Image) -> Fit:
    """The warp near one at which the fields agree best: least squares in shift, turn about the middle, and gain."""
    reach = 0.35 * first.shape[0]
    for _ in range(STEPS):
        design, rest, _ = _linear(first, other, warp, reach)
        right = np.array([float(np.vdot(column, window[..., None] * rest)) for column in design])
        step = np.linalg.lstsq(_normal(design, window), right, rcond=None)[0][:3]
        step *= min(1.0, 1.0 / max(float(np.abs(step).max()), 1e-12))
        warp = _stepped(warp, step, reach, first.shape[0])
        if np.abs(step).max() < ENOUGH_PX:
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
    """The field where the warp says; 0 outside."""
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(field, warp, field.shape[1::-1], flags=flags), dtype=np.float32)


def _slopes(field: Image) -> tuple[Image, Image]:
    across, down = (cv2.Sobel(field, cv2.CV_32F, *order, ksize=3, scale=0.125) for order in ((1, 0), (0, 1)))
    return np.asarray(across, dtype=np.float32), np.asarray(down, dtype=np.float32)


def _linear(
    first: Image, other: Image, warp: FloatArray, reach: float
) -> tuple[tuple[Image, ...], Image, Image]:
    """Derivatives by shift, turn (in points at ``reach``) and gain; what is left; the other field pulled back."""
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
    """The warp after a shift and a turn about the middle of the first picture."""
    turn, middle = step[2] / reach, (side - 1) / 2.0
    cos, sin = np.cos(turn), np.sin(turn)
    motion = np.array([[cos, -sin, step[0]], [sin, cos, step[1]], [0.0, 0.0, 1.0]])
    motion[:2, 2] += middle - motion[:2, :2] @ [middle, middle]
    return np.asarray(warp @ motion)


def _by_tiles(values: Image) -> FloatArray:
    """Sums over square tiles."""
    means = cv2.resize(values.astype(np.float32), (TILES, TILES), interpolation=cv2.INTER_AREA)
    return np.asarray(means, dtype=np.float64).ravel() * (values.size / TILES**2)
