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
def powers_inside(
    spectra: npt.NDArray[np.complex64],
    phases: npt.NDArray[np.complex128],
    frequency_x: tuple[float, float],
    frequency_y: tuple[float, float],
    wavelengths: FloatArray,
    middle: tuple[float, float],
    half_width: tuple[float, float],
    into: tuple[float, float, float, float],
    radius: float,
    found: FloatArray,
) -> None:
    """Sum of the power of all orders in a window, each times its `share_inside`, at every wavelength.

    Args:
        spectra: (Y, X, K) Fourier coefficients.
        phases: (L, K) wave of every level.
        frequency_x: the first one and their distance in cycles per µm.
        frequency_y: likewise.
        wavelengths: (L,) in µm.
        middle: (x, y) frequency of the direction, in cycles per wavelength.
        half_width: of the window, likewise.
        into: matrix, row by row, from frequencies about it to those in which the larger disc is the unit circle.
        radius: of the smaller disc there.
        found: (L,) of the sums, which are written.
    """
    for line in range(wavelengths.size):
        wavelength, total = wavelengths[line], 0.0
        at_x, at_y = middle[0] / wavelength, middle[1] / wavelength
        wide_x, wide_y = half_width[0] / wavelength, half_width[1] / wavelength
        first_col = math.ceil((at_x - wide_x - frequency_x[0]) / frequency_x[1])
        last_col = math.floor((at_x + wide_x - frequency_x[0]) / frequency_x[1])
        first_row = math.ceil((at_y - wide_y - frequency_y[0]) / frequency_y[1])
        last_row = math.floor((at_y + wide_y - frequency_y[0]) / frequency_y[1])
        for row in range(first_row, last_row + 1):
            y = (frequency_y[0] + row * frequency_y[1] - at_y) * wavelength
            for col in range(first_col, last_col + 1):
                x = (frequency_x[0] + col * frequency_x[1] - at_x) * wavelength
                across, along = into[0] * x + into[1] * y, into[2] * x + into[3] * y
                apart = math.sqrt(across * across + along * along)
                if apart < 1.0 + radius:
                    real = imaginary = 0.0
                    for k in range(phases.shape[1]):
                        part, turned = spectra[row, col, k], phases[line, k]
                        real += turned.real * part.real - turned.imag * part.imag
                        imaginary += turned.real * part.imag + turned.imag * part.real
                    total += share_inside(apart, radius) * (real * real + imaginary * imaginary)
        found[line] = total
