"""Kernels of the rank-1 polish: what a dot's spectrum becomes when one of its rectangles changes its level.

A rectangle's spectrum is the product of one factor along y and one along x, so that another level adds a matrix of
rank 1 to the spectrum of the dot. All arrays are float32 and contiguous; frequencies are split into bins of
``fine`` samples, and a window of the source covers ``wide`` bins. Where the spectrum is symmetric about 0
only rows from ``first`` on are used; the others mirror them.
"""

import numpy as np
import numpy.typing as npt

from anisoscope.base.kernel_compilation import jit_kernel, log_compilation

log_compilation(__file__)

Floats = npt.NDArray[np.float32]


@jit_kernel(fastmath=True, nogil=True)
def windows_along_x(
    real: Floats, imag: Floats, change: tuple[float, float], factor_y: tuple[Floats, Floats],
    factor_x: tuple[Floats, Floats], sizes: tuple[int, int, int], out: Floats, power: Floats,
) -> None:  # fmt: skip
    """Power of spectrum + change·factor_y·factor_x, summed over the bins of rows and the windows of columns.

    ``sizes`` are (fine, wide, first bin); ``out`` is (bins, windows), ``power`` (columns,) is work space.
    """
    fine, wide, first = sizes
    bins, many = out.shape
    span = wide * fine
    for b in range(first, bins):
        power[:] = np.float32(0.0)
        for q in range(b * fine, (b + 1) * fine):
            yr = np.float32(change[0] * factor_y[0][q] - change[1] * factor_y[1][q])
            yi = np.float32(change[0] * factor_y[1][q] + change[1] * factor_y[0][q])
            for r in range(power.shape[0]):
                vr = real[q, r] + yr * factor_x[0][r] - yi * factor_x[1][r]
                vi = imag[q, r] + yr * factor_x[1][r] + yi * factor_x[0][r]
                power[r] += vr * vr + vi * vi
        total = np.float64(0.0)
        for r in range(span):
            total += power[r]
        out[b, 0] = total
        for x in range(1, many):
            for r in range((x - 1) * fine, x * fine):
                total += power[r + span] - power[r]
            out[b, x] = total
        if first > 0:
            for x in range(many):
                out[bins - 1 - b, many - 1 - x] = out[b, x]


@jit_kernel(fastmath=True, nogil=True)
def squared_error(
    along_x: Floats, target: Floats, wide: int, scale: float, column: Floats, rest: Floats
) -> float:
    """Sum of squares of scale·(windows along y too) − target; ``rest`` (windows, windows) receives the differences."""
    many = target.shape[0]
    column[:] = np.float32(0.0)
    for b in range(wide):
        for x in range(many):
            column[x] += along_x[b, x]
    total = np.float64(0.0)
    for y in range(many):
        part = np.float32(0.0)
        for x in range(many):
            off = np.float32(scale) * column[x] - target[y, x]
            rest[y, x] = off
            part += off * off
        total += part
        if y + 1 < many:
            for x in range(many):
                column[x] += along_x[y + wide, x] - along_x[y, x]
    return total


@jit_kernel(fastmath=True, nogil=True)
def add_change(
    real: Floats, imag: Floats, change: tuple[float, float],
    factor_y: tuple[Floats, Floats], factor_x: tuple[Floats, Floats],
) -> None:  # fmt: skip
    """Spectrum += change·factor_y·factor_x."""
    for q in range(real.shape[0]):
        yr = np.float32(change[0] * factor_y[0][q] - change[1] * factor_y[1][q])
        yi = np.float32(change[0] * factor_y[1][q] + change[1] * factor_y[0][q])
        for r in range(real.shape[1]):
            real[q, r] += yr * factor_x[0][r] - yi * factor_x[1][r]
            imag[q, r] += yr * factor_x[1][r] + yi * factor_x[0][r]


@jit_kernel(fastmath=True, nogil=True)
def try_changes(
    cells: npt.NDArray[np.int64], to: npt.NDArray[np.int64], levels: npt.NDArray[np.int64],
    phase_real: Floats, phase_imag: Floats, real: Floats, imag: Floats,
    factors_y: tuple[Floats, Floats], factors_x: tuple[Floats, Floats], sizes: tuple[int, int, int],
    scale: float, target: Floats, best: float,
    along_x: Floats, power: Floats, column: Floats, rest: Floats,
) -> float:  # fmt: skip
    """Give cells other levels one after the other, keeping each change that lowers the error; returns the error.

    ``cells`` (N,) are flat numbers, ``to`` (N,) levels; ``levels``, ``real`` and ``imag`` are changed in place.
    """
    cols = levels.shape[1]
    for n in range(cells.shape[0]):
        k, j = cells[n] // cols, cells[n] % cols
        old, new = levels[k, j], to[n]
        if old == new:
            continue
        change = (phase_real[new] - phase_real[old], phase_imag[new] - phase_imag[old])
        y = (factors_y[0][k], factors_y[1][k])
        x = (factors_x[0][j], factors_x[1][j])
        windows_along_x(real, imag, change, y, x, sizes, along_x, power)
        found = squared_error(along_x, target, sizes[1], scale, column, rest)
        if found < best:
            best = found
            levels[k, j] = new
            add_change(real, imag, change, y, x)
    return best
