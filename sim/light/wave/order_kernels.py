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
def power_inside(
    spectra: npt.NDArray[np.complex64],
    phases: npt.NDArray[np.complex128],
    frequency_x: FloatArray,
    frequency_y: FloatArray,
    cols: tuple[int, int],
    rows: tuple[int, int],
    middle: tuple[float, float],
    into: tuple[float, float, float, float],
    radius: float,
) -> float:
    """Sum of the power of all orders in a window, each times its `share_inside`.

    Args:
        spectra: (K, Y, X) Fourier coefficients.
        phases: (K,) wave of every level.
        frequency_x: (X,) in cycles per µm.
        frequency_y: (Y,) likewise.
        cols: first column of the window, and the one after the last.
        rows: likewise.
        middle: (x, y) frequency of the direction.
        into: matrix, row by row, from frequencies about it to those in which the larger disc is the unit circle.
        radius: of the smaller disc there.
    """
    total = 0.0
    for row in range(rows[0], rows[1]):
        y = frequency_y[row] - middle[1]
        for col in range(cols[0], cols[1]):
            x = frequency_x[col] - middle[0]
            across, along = into[0] * x + into[1] * y, into[2] * x + into[3] * y
            apart = math.sqrt(across * across + along * along)
            if apart < 1.0 + radius:
                real = imaginary = 0.0
                for k in range(phases.size):
                    part, turned = spectra[k, row, col], phases[k]
                    real += turned.real * part.real - turned.imag * part.imag
                    imaginary += turned.real * part.imag + turned.imag * part.real
                total += share_inside(apart, radius) * (real * real + imaginary * imaginary)
    return total
