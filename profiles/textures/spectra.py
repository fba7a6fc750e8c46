"""Power spectral densities of a surface, and the direction of its lay (ISO 25178-2).

Heights count from their mean; missing points weigh nothing. The field is not taken as periodic: spectra are taken
under a Hann window by default.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.heightmap import HeightMap, known_mean, row_blocks

Window = Literal["hann", "none"]

DIRECTIONS = 720
COLUMNS = 32
FEWEST_CYCLES = 2.0


@dataclass(frozen=True, eq=False)
class Spectrum:
    """A power spectral density over frequencies in 1/µm."""

    frequency: FloatArray
    density: FloatArray


def known_heights(surface: HeightMap) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Heights about their mean, 0 where missing, and the measured points."""
    check_heights("height map", surface.height_um)
    known = np.isfinite(surface.height_um)
    mean = float(np.mean(surface.height_um[known]))
    return np.where(known, surface.height_um - mean, 0.0), known


def _taper(shape: tuple[int, int], window: Window, axes: tuple[int, ...]) -> FloatArray:
    """Window (rows, cols) or (1, cols) of mean square 1."""
    taper = np.ones((1, 1))
    for axis in axes:
        count = shape[axis]
        one = np.ones(count) if window == "none" else np.sin(np.pi * (np.arange(count) + 0.5) / count) ** 2
        taper = taper * np.expand_dims(one / np.sqrt(np.mean(one**2)), 1 - axis)
    return taper


def _frequencies(count: int, pixel_um: float) -> FloatArray:
    return np.fft.fftfreq(count, pixel_um).astype(np.float64)


def areal_density(surface: HeightMap, window: Window = "hann") -> tuple[FloatArray, FloatArray, FloatArray]:
    """Two-dimensional, two-sided density.

    Args:
        surface: the map.
        window: "hann", or "none" for a field that is periodic.

    Returns:
        Frequencies along y (rows,) and x (cols,) in 1/µm as :func:`numpy.fft.fftfreq` orders them, and the density
        (rows, cols) in µm⁴: its sum times the steps of both frequencies is Sq², exactly without a window.

    Raises:
        HeightMapError: nothing was measured.
    """
    from scipy import fft  # noqa: PLC0415 - slow to import

    height, known = known_heights(surface)
    (rows, cols), (py, px) = surface.shape, (surface.pixel_y_um, surface.pixel_x_um)
    taper = _taper(surface.shape, window, (0, 1))
    share = float(np.mean(np.where(known, taper**2, 0.0)))
    power = np.abs(fft.fft2(height * taper)) ** 2
    density = power * (px * py / (rows * cols * share))
    return _frequencies(rows, py), _frequencies(cols, px), density


def half_plane_power(surface: HeightMap) -> FloatArray:
    """(rows, cols // 2 + 1) power under a Hann window at the frequencies of :func:`numpy.fft.rfft2`, no scale.

    Raises:
        HeightMapError: nothing was measured.
    """
    from scipy import fft  # noqa: PLC0415 - slow to import

    check_heights("height map", surface.height_um)
    mean = known_mean(surface.height_um)
    up, right = (_taper(surface.shape, "hann", (axis,)) for axis in (0, 1))
    rows, cols = surface.shape
    spectrum = np.empty((rows, cols // 2 + 1), dtype=np.complex128)
    for block in row_blocks(surface.shape):
        part = surface.height_um[block]
        spectrum[block] = fft.rfft(np.where(np.isfinite(part), part - mean, 0.0) * up[block] * right, axis=1)
    power = np.empty(spectrum.shape)
    for start in range(0, spectrum.shape[1], COLUMNS):
        both = fft.fft(np.ascontiguousarray(spectrum[:, start : start + COLUMNS].T), axis=1)
        power[:, start : start + COLUMNS] = (both.real**2 + both.imag**2).T
    return power


def line_density(surface: HeightMap, axis: Literal["x", "y"], window: Window = "hann") -> Spectrum:
    """One-dimensional, one-sided density of the profiles along an axis, averaged over all of them.

    Returns:
        Frequencies from 0 in 1/µm and the density in µm³: its sum times the step of the frequency is Sq², exactly
        without a window.

    Raises:
        HeightMapError: nothing was measured.
    """
    from scipy import fft  # noqa: PLC0415 - slow to import

    height, known = known_heights(surface)
    number = 1 if axis == "x" else 0
    pixel, count = (surface.pixel_x_um, surface.pixel_y_um)[1 - number], surface.shape[number]
    taper = _taper(surface.shape, window, (number,))
    share = float(np.mean(np.where(known, taper**2, 0.0)))
    power = np.mean(np.abs(fft.rfft(height * taper, axis=number)) ** 2, axis=1 - number)
    twice = np.full(power.size, 2.0)
    twice[0] = 1.0
    if count % 2 == 0:
        twice[-1] = 1.0
    return Spectrum(np.abs(_frequencies(count, pixel)[: power.size]), twice * power * pixel / (count * share))


def radial_density(surface: HeightMap, window: Window = "hann") -> Spectrum:
    """Two-dimensional density (µm⁴) averaged over rings of equal frequency, for isotropic surfaces.

    Rings are as wide as the coarser step of the frequency and end where the coarser sampling does.

    Raises:
        HeightMapError: nothing was measured.
    """
    fy, fx, density = areal_density(surface, window)
    radius = np.hypot(fy[:, None], fx[None, :])
    step = max(fy[1], fx[1])
    rings = int(min(np.abs(fy).max(), np.abs(fx).max()) / step)
    ring = np.rint(radius / step).astype(np.intp)
    inside = (ring > 0) & (ring <= rings)
    count = np.bincount(ring[inside], minlength=rings + 1)[1:]
    total = np.bincount(ring[inside], density[inside], minlength=rings + 1)[1:]
    mean = np.bincount(ring[inside], radius[inside], minlength=rings + 1)[1:]
    filled = count > 0
    return Spectrum(mean[filled] / count[filled], total[filled] / count[filled])


def angular_spectrum(surface: HeightMap) -> tuple[FloatArray, FloatArray]:
    """Power by direction of the wave vector (ISO 25178-2, 3.2.9).

    Returns:
        Directions of the wave vectors in degrees counter-clockwise from +x, within [−90, 90), and the integral of
        R·power over the frequencies R along each, from two cycles a field to the end of the coarser sampling.

    Raises:
        HeightMapError: nothing was measured.
    """
    from scipy.ndimage import map_coordinates  # noqa: PLC0415 - slow to import

    (rows, cols), density = surface.shape, half_plane_power(surface)
    fy, fx = _frequencies(rows, surface.pixel_y_um), _frequencies(cols, surface.pixel_x_um)
    shifted = np.fft.fftshift(density, axes=0)
    del density
    low = FEWEST_CYCLES * max(fy[1], fx[1])
    high = min(np.abs(fy).max(), np.abs(fx).max()) - min(fy[1], fx[1])
    direction = -90.0 + 180.0 * np.arange(DIRECTIONS) / DIRECTIONS
    if high <= low:
        return direction, np.zeros(DIRECTIONS)
    radius = np.arange(low, high, 0.5 * min(fy[1], fx[1]))
    angle = np.radians(direction)[:, None]
    # directions within ±90° lie in the half plane of positive frequencies along x
    i = rows // 2 + radius * np.sin(angle) / fy[1]
    j = radius * np.cos(angle) / fx[1]
    power = map_coordinates(shifted, [i, j], order=1, mode="nearest")
    return direction, np.asarray((power * radius).sum(axis=1))


def lay(surface: HeightMap) -> float:
    """Std: direction of the lay in degrees counter-clockwise from +y, within (−90, 90]; NaN without texture."""
    direction, power = angular_spectrum(surface)
    peak = int(np.argmax(power))
    if power[peak] <= 0.0:
        return float("nan")
    near = np.arange(peak - 2, peak + 3)
    weight = power[near % DIRECTIONS] - 0.5 * power[peak]
    weight = np.maximum(weight, 0.0)
    step = 180.0 / DIRECTIONS
    angle = direction[peak] + step * float(np.sum(weight * (near - peak)) / np.sum(weight))
    # a wave vector at angle a from +x belongs to ridges at angle a from +y
    return float(90.0 - (90.0 - angle) % 180.0)


def dominant_wavelength(surface: HeightMap) -> float:
    """Ssw: wavelength in µm of the largest amplitude of the windowed heights; NaN on a flat surface.

    Between the frequencies of the transform the maximum is that of a parabola through the logarithms. Waves of less
    than two cycles a field are form. Source: ISO 25178-2:2021, dominant spatial wavelength.

    Raises:
        HeightMapError: nothing was measured.
    """
    fy, fx, density = areal_density(surface)
    cycles = np.hypot(fy[:, None] / fy[1], fx[None, :] / fx[1])
    power = np.where(cycles < FEWEST_CYCLES, 0.0, density)
    i, j = np.unravel_index(int(np.argmax(power)), power.shape)
    if power[i, j] <= 0.0:
        return float("nan")
    rows, cols = power.shape
    found = []
    for number, count, at in ((0, rows, int(i)), (1, cols, int(j))):
        near = np.take(density[:, j] if number == 0 else density[i], [at - 1, at, at + 1], mode="wrap")
        log = np.log(np.maximum(near, 1e-12 * float(near[1])))
        bend = log[0] - 2.0 * log[1] + log[2]
        shift = 0.5 * (log[0] - log[2]) / bend if bend < 0.0 else 0.0
        step = (fy, fx)[number][1]
        place = at if at <= (count - 1) // 2 else at - count
        found.append((place + float(np.clip(shift, -0.5, 0.5))) * step)
    return float(1.0 / np.hypot(*found))
