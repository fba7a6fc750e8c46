"""Compiled sums over diffraction orders as a lamp and a lens, both discs, blur them (numba, cached on disk)."""

import math

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.kernel_compilation import jit_kernel, log_compilation

log_compilation(__file__)


@jit_kernel(nogil=True, error_model="numpy")
def share_inside(apart: float, radius: float) -> float:
    """Share of a circle of a radius up to 1 inside the unit circle, at a distance of their centres."""
    d = max(apart, 1e-12)
    if d <= 1.0 - radius:
        return 1.0
    if d >= 1.0 + radius:
        return 0.0
    small = min(max((d * d + radius * radius - 1.0) / (2.0 * d * radius), -1.0), 1.0)
    unit = min(max((d * d + 1.0 - radius * radius) / (2.0 * d), -1.0), 1.0)
    sides = (1.0 + radius + d) * (1.0 + radius - d) * (d + radius - 1.0) * (d - radius + 1.0)
    overlap = radius * radius * math.acos(small) + math.acos(unit) - 0.5 * math.sqrt(max(sides, 0.0))
    return overlap / (math.pi * radius * radius)


@jit_kernel(nogil=True, error_model="numpy")
def shares_inside(apart: FloatArray, radius: float, found: FloatArray) -> None:
    """`share_inside` at (n,) distances, into ``found``."""
    for i in range(apart.size):
        found[i] = share_inside(apart[i], radius)


@jit_kernel(nogil=True, error_model="numpy")
def _across(x: float, y: float, z: float, size: float) -> tuple[float, float, float, float]:
    """Map, row by row, from the unit disc to the frequencies per wavelength of a disc about a unit vector."""
    horizontal, half = math.hypot(x, y), 0.5 * size
    east, north = (x / horizontal, y / horizontal) if horizontal > 1e-12 else (1.0, 0.0)
    return half * east * z, -half * north, half * north * z, half * east


@jit_kernel(nogil=True, error_model="numpy")
def _power_inside(
    spectra: npt.NDArray[np.complex64],
    waves: npt.NDArray[np.complex128],
    frequency_x: tuple[float, float],
    frequency_y: tuple[float, float],
    wavelength: float,
    middle: tuple[float, float],
    half_width: tuple[float, float],
    into: tuple[float, float, float, float],
    radius: float,
) -> float:
    """Sum of the power of all orders in a window, each times its `share_inside`; arguments as of `densities_seen`.

    Args:
        spectra: (Y, X, TK) Fourier coefficients.
        waves: (TK,) their factors.
        frequency_x: the first one and their distance in cycles per µm.
        frequency_y: likewise.
        wavelength: in µm.
        middle: (x, y) frequency of the direction in cycles per µm.
        half_width: of the window, likewise.
        into: matrix, row by row, from frequencies about it, per wavelength, to those in which the larger disc is the
            unit circle.
        radius: of the smaller disc there.
    """
    total = 0.0
    first_col = math.ceil((middle[0] - half_width[0] - frequency_x[0]) / frequency_x[1])
    last_col = math.floor((middle[0] + half_width[0] - frequency_x[0]) / frequency_x[1])
    first_row = math.ceil((middle[1] - half_width[1] - frequency_y[0]) / frequency_y[1])
    last_row = math.floor((middle[1] + half_width[1] - frequency_y[0]) / frequency_y[1])
    for row in range(first_row, last_row + 1):
        y = (frequency_y[0] + row * frequency_y[1] - middle[1]) * wavelength
        for col in range(first_col, last_col + 1):
            x = (frequency_x[0] + col * frequency_x[1] - middle[0]) * wavelength
            across, along = into[0] * x + into[1] * y, into[2] * x + into[3] * y
            apart = math.sqrt(across * across + along * along)
            if apart < 1.0 + radius:
                real = imaginary = 0.0
                for k in range(waves.size):
                    part, wave = spectra[row, col, k], waves[k]
                    real += wave.real * part.real - wave.imag * part.imag
                    imaginary += wave.real * part.imag + wave.imag * part.real
                total += share_inside(apart, radius) * (real * real + imaginary * imaginary)
    return total


@jit_kernel(nogil=True, error_model="numpy")
def densities_seen(
    spectra: npt.NDArray[np.complex64],
    powers: npt.NDArray[np.complex128],
    levels_um: FloatArray,
    frequency_x: tuple[float, float],
    frequency_y: tuple[float, float],
    wavelengths: FloatArray,
    to_light: FloatArray,
    to_camera: FloatArray,
    discs: tuple[float, float],
    most_round: float,
    waves: npt.NDArray[np.complex128],
    found: FloatArray,
) -> None:
    """Sum of the power of all orders that lamp and lens let by, times W, in all directions at every wavelength.

    A direction that is out of reach, or in which the smaller disc is no circle where the larger one is, is NaN.

    Args:
        spectra: (Y, X, TK) Fourier coefficients, those of the first term before those of the next.
        powers: (T,) factors of the terms.
        levels_um: (K,) heights.
        frequency_x: the first one and their distance in cycles per µm.
        frequency_y: likewise.
        wavelengths: (L,) in µm.
        to_light: (P, 3) unit vectors.
        to_camera: likewise.
        discs: diameters of lamp and lens in direction cosines.
        most_round: ratio of the axes up to which an ellipse is a circle.
        waves: (TK,) room for the waves of a direction.
        found: (P, L) of the sums in µm², which are written.
    """
    shortest = wavelengths[0]
    for line in range(1, wavelengths.size):
        shortest = min(shortest, wavelengths[line])
    for p in range(to_light.shape[0]):
        for line in range(wavelengths.size):
            found[p, line] = math.nan
        if min(to_light[p, 2], to_camera[p, 2]) < 1e-6:
            continue
        half_x, half_y, half_z = (
            0.5 * (to_light[p, 0] + to_camera[p, 0]),
            0.5 * (to_light[p, 1] + to_camera[p, 1]),
            0.5 * (to_light[p, 2] + to_camera[p, 2]),
        )
        lamp = _across(to_light[p, 0], to_light[p, 1], to_light[p, 2], discs[0])
        lens = _across(to_camera[p, 0], to_camera[p, 1], to_camera[p, 2], discs[1])
        wide_x = math.hypot(lamp[0], lamp[1]) + math.hypot(lens[0], lens[1])
        wide_y = math.hypot(lamp[2], lamp[3]) + math.hypot(lens[2], lens[3])
        small, large = (lamp, lens) if discs[0] <= discs[1] else (lens, lamp)
        turned = large[0] * large[3] - large[1] * large[2]
        # from frequencies to those in which the larger disc is the unit circle, and the smaller one there
        xx, xy, yx, yy = large[3] / turned, -large[1] / turned, -large[2] / turned, large[0] / turned
        a, b = xx * small[0] + xy * small[2], xx * small[1] + xy * small[3]
        c, d = yx * small[0] + yy * small[2], yx * small[1] + yy * small[3]
        mean, differ = 0.5 * math.hypot(a + d, c - b), 0.5 * math.hypot(a - d, c + b)
        long, short = mean + differ, abs(mean - differ)
        beyond = max(
            abs(2.0 * half_x) + wide_x + shortest * frequency_x[0],
            abs(2.0 * half_y) + wide_y + shortest * frequency_y[0],
        )
        if beyond > 0.0 or not 0.0 < long <= most_round * short:
            continue
        radius, area = math.sqrt(long * short), math.pi * abs(turned)
        for line in range(wavelengths.size):
            wavelength = wavelengths[line]
            for k in range(levels_um.size):
                turn = -4.0 * math.pi * half_z / wavelength * levels_um[k]
                wave = complex(math.cos(turn), math.sin(turn))
                for term in range(powers.size):
                    waves[term * levels_um.size + k] = powers[term] * wave
            power = _power_inside(
                spectra,
                waves,
                frequency_x,
                frequency_y,
                wavelength,
                (2.0 * half_x / wavelength, 2.0 * half_y / wavelength),
                (wide_x / wavelength, wide_y / wavelength),
                (xx, xy, yx, yy),
                radius,
            )
            found[p, line] = power / area * wavelength * wavelength
