"""Compiled inner loop of the fused reflectance (numba, cached on disk after the first call).

Phase, sine and cosine, low-pass and decimation along both axes in one pass over a strip of columns: the wave itself is
never held, only a few rows of it. The polynomials of the sine and cosine of 2π·t are least squares at Chebyshev nodes
over |t| ≤ ½; they are off by less than 1e-6.
"""

import numpy as np
import numpy.typing as npt

from anisoscope.base.kernel_compilation import jit_kernel, log_compilation

log_compilation(__file__)

Floats = npt.NDArray[np.float32]

_FAST = {"contract", "nnan", "ninf", "nsz", "arcp"}
_HALF = np.float32(0.5)
COSINE = tuple(
    np.float32(value)
    for value in (0.999999211, -19.7389804, 64.9286574, -85.2716215, 58.7904921, -21.0711056)
)
SINE = tuple(
    np.float32(value) for value in (6.28318492, -41.3415892, 81.5999433, -76.6144725, 41.3428824, -12.4712435)
)


@jit_kernel(nogil=True, error_model="numpy", fastmath=_FAST)
def strip(
    height_um: Floats,
    first: int,
    last: int,
    cycles_per_um: float,
    carrier_x: Floats,
    carrier_y: Floats,
    taps_y: Floats,
    step_y: int,
    real: Floats,
    imaginary: Floats,
    work: Floats,
) -> None:
    """Low-passed, decimated columns ``first`` to ``last`` of exp(−2πi·(cycles·z + carriers)).

    Args:
        height_um: (rows, cols) heights.
        first: first column.
        last: column after the last.
        cycles_per_um: turns of the phase per µm of height.
        carrier_x: (cols,) turns along x.
        carrier_y: (rows,) turns along y.
        taps_y: (2·half + 7,) filter along y, three zeros on either side: four rows are added at once.
        step_y: rows between outputs.
        real: (outputs, width) is added to, width ≥ last − first; output o stands at row (o − half // step)·step.
        imaginary: the same.
        work: (8, width) scratch.
    """
    c0, c1, c2, c3, c4, c5 = COSINE
    s0, s1, s2, s3, s4, s5 = SINE
    scale = np.float32(cycles_per_um)
    rows, width, half = height_um.shape[0], last - first, (taps_y.size - 6) // 2
    lead = half // step_y
    # Loops run over rows of their own: over two indices the compiler would guard every number against wrapping around.
    carrier = carrier_x[first:last]
    for top in range(0, rows, 4):
        for line in range(4):
            row = min(top + line, rows - 1)
            turn, height = carrier_y[row], height_um[row, first:last]
            cosine, sine = work[line], work[line + 4]
            for c in range(width):
                t = height[c] * scale + (carrier[c] + turn)
                t -= np.floor(t + _HALF)
                u = t * t
                cosine[c] = c0 + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5))))
                sine[c] = -t * (s0 + u * (s1 + u * (s2 + u * (s3 + u * (s4 + u * s5)))))
        if top + 4 > rows:
            work[rows - top : 4] = np.float32(0.0)
            work[4 + rows - top :] = np.float32(0.0)
        begin = lead - (half - top) // step_y if half >= top else lead + (top - half + step_y - 1) // step_y
        end = min(lead + (top + 3 + half) // step_y + 1, real.shape[0])
        for out in range(begin, end):
            place = top - (out - lead) * step_y + half + 3
            w0, w1, w2, w3 = taps_y[place], taps_y[place + 1], taps_y[place + 2], taps_y[place + 3]
            for c in range(width):
                real[out, c] += w0 * work[0, c] + w1 * work[1, c] + w2 * work[2, c] + w3 * work[3, c]
                imaginary[out, c] += w0 * work[4, c] + w1 * work[5, c] + w2 * work[6, c] + w3 * work[7, c]


@jit_kernel(nogil=True, error_model="numpy", fastmath=_FAST | {"reassoc"})
def gather(
    real: Floats,
    imaginary: Floats,
    first: int,
    last: int,
    taps_x: Floats,
    step_x: int,
    result_real: Floats,
    result_imaginary: Floats,
) -> None:
    """Low-pass and decimate along x what :func:`strip` gave; add it to (outputs along y, outputs along x) results."""
    half = taps_x.size // 2
    lead = half // step_x
    begin = lead - (half - first) // step_x if half >= first else lead + (first - half + step_x - 1) // step_x
    for row in range(real.shape[0]):
        for out in range(begin, lead + (last - 1 + half) // step_x + 1):
            middle = (out - lead) * step_x
            low, high = max(first, middle - half), min(last, middle + half + 1)
            weights = taps_x[low - middle + half : high - middle + half]
            seen_real, seen_imaginary = (
                real[row, low - first : high - first],
                imaginary[row, low - first : high - first],
            )
            sum_real = np.float32(0.0)
            sum_imaginary = np.float32(0.0)
            for c in range(weights.size):
                sum_real += weights[c] * seen_real[c]
                sum_imaginary += weights[c] * seen_imaginary[c]
            result_real[row, out] += sum_real
            result_imaginary[row, out] += sum_imaginary
