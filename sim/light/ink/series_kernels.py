"""Compiled inner loops of a picture whose colours are polynomials: no look-up, so that all steps become vectors.

They hold for the goniochromatic model with isotropic GGX lobes; what is otherwise goes by table
(`anisoscope.sim.light.ink.kernels`). Kernels are cached on disk after the first call.
"""

import math

import numpy as np
import numpy.typing as npt

from anisoscope.base.kernel_compilation import jit_kernel, log_compilation
from anisoscope.sim.light.ink.kernels import FAINT, HALF, ONE, PI, ZERO, Vector

log_compilation(__file__)

Float32 = npt.NDArray[np.float32]

TWO: float = np.float32(2.0)  # type: ignore[assignment]
SCRATCH = 11
"""Rows of scratch space: normal, roots of 1 ± cosine to the camera, place, lobe, colours, coverage."""


@jit_kernel()
def _seen_part(normal: Float32) -> tuple[int, int]:
    """From and to which pixel of a row there is something to see."""
    first, stop = 0, normal.size // 3
    while first < stop and normal[3 * first] == normal[3 * first + 1] == normal[3 * first + 2] == ZERO:
        first += 1
    while first < stop and normal[3 * stop - 3] == normal[3 * stop - 2] == normal[3 * stop - 1] == ZERO:
        stop -= 1
    return first, stop


@jit_kernel(fastmath=True)
def _begin(normal: Float32, camera: Vector, work: Float32, count: int) -> None:
    """Components of the normals of a row, what they make of the camera, and no colours yet.

    The normals come as one run of numbers: how far they are apart is then known to the compiler.
    """
    along_x, along_y, along_z, near, far = work[0], work[1], work[2], work[3], work[4]
    red, green, blue = work[7], work[8], work[9]
    for c in range(count):
        x, y, z = normal[3 * c], normal[3 * c + 1], normal[3 * c + 2]
        seen = min(max(x * camera[0] + y * camera[1] + z * camera[2], ZERO), ONE)
        along_x[c], along_y[c], along_z[c] = x, y, z
        near[c] = HALF * math.sqrt(ONE + seen)
        far[c] = HALF * math.sqrt(ONE - seen) if seen > ZERO else ONE  # 1: turned away from the camera
        red[c], green[c], blue[c] = ZERO, ZERO, ZERO


@jit_kernel(fastmath=True)
def _light(work: Float32, beam: Float32, alpha: float, count: int) -> None:
    """Places (Eq. 6) from −1 to 1, and E/4·D·cosθi of the isotropic GGX lobe; 0 where the surface turns away.

    The square of the half vector across the normal comes from components, not from 1 − cos²: so narrow lobes keep.
    """
    lx, ly, lz, hx, hy, hz = beam[0], beam[1], beam[2], beam[3], beam[4], beam[5]
    narrow = ONE / (alpha * alpha)
    scale = beam[6] * narrow / PI
    along_x, along_y, along_z, near, far = work[0], work[1], work[2], work[3], work[4]
    place, value = work[5], work[6]
    for c in range(count):
        x, y, z = along_x[c], along_y[c], along_z[c]
        lit = min(max(x * lx + y * ly + z * lz, ZERO), ONE)
        shift = ONE - near[c] * math.sqrt(ONE + lit) + far[c] * math.sqrt(ONE - lit)
        place[c] = TWO * max(shift, ZERO) - ONE
        cx, cy, cz = y * hz - z * hy, z * hx - x * hz, x * hy - y * hx
        up = x * hx + y * hy + z * hz
        total = (cx * cx + cy * cy + cz * cz) * narrow + up * up
        value[c] = scale * lit / max(total * total, FAINT) if far[c] < ONE else ZERO


@jit_kernel(fastmath=True)
def _cover(work: Float32, coverage: Float32, step: int, count: int) -> None:
    """The lobe times a coverage that is every so many numbers."""
    value, covered = work[6], work[10]
    for c in range(count):
        covered[c] = value[c] * coverage[step * c]


@jit_kernel(inline="always", fastmath=True)
def _at(t: float, s: Float32) -> float:
    """A polynomial of degree 8 (Horner)."""
    high: float = s[4] + t * (s[5] + t * (s[6] + t * (s[7] + t * s[8])))
    found: float = s[0] + t * (s[1] + t * (s[2] + t * (s[3] + t * high)))
    return found


@jit_kernel(fastmath=True)
def _add(work: Float32, value: Float32, series: Float32, count: int) -> None:
    """Add the colours of an ink at their places, times a value."""
    place, red, green, blue = work[5], work[7], work[8], work[9]
    for c in range(count):
        t, strength = place[c], value[c]
        red[c] += strength * _at(t, series[0])
        green[c] += strength * _at(t, series[1])
        blue[c] += strength * _at(t, series[2])


@jit_kernel()
def _end(work: Float32, result: Float32, count: int) -> None:
    """The colours of a row."""
    red, green, blue = work[7], work[8], work[9]
    for c in range(count):
        result[3 * c], result[3 * c + 1], result[3 * c + 2] = red[c], green[c], blue[c]


@jit_kernel(nogil=True)
def shade_by_series(
    normal: Float32,
    coverage: Float32,
    camera: Vector,
    beams: Float32,
    alphas: Float32,
    series: Float32,
    even: bool,
    begin: int,
    stop: int,
    work: Float32,
    result: Float32,
) -> None:
    """Rows ``begin`` to ``stop`` of Σ over lights and inks of E·w·f·cosθi.

    Args:
        normal: (rows, 3·cols), zero where there is nothing.
        coverage: (rows, cols·K); not looked at if inks cover all evenly.
        camera: unit vector to the camera, in float32.
        beams: (L, 7 or more) unit vector to the light, half vector, irradiance/4.
        alphas: (K,) roughness of the isotropic GGX lobes.
        series: (L, K, 3, 9) polynomials as `table.InkTable.series` gives them.
        even: how much the inks cover stands in the polynomials.
        begin: first row.
        stop: row after the last.
        work: (SCRATCH, cols), anything.
        result: (rows, 3·cols), filled.
    """
    inks = alphas.size
    for r in range(begin, stop):
        first, after = _seen_part(normal[r])
        count = after - first
        result[r, : 3 * first] = ZERO
        result[r, 3 * after :] = ZERO
        _begin(normal[r, 3 * first :], camera, work, count)
        for n in range(beams.shape[0]):
            for k in range(inks):
                if k == 0 or alphas[k] != alphas[k - 1]:
                    _light(work, beams[n], alphas[k], count)
                if not even:
                    _cover(work, coverage[r, inks * first + k :], inks, count)
                _add(work, work[6 if even else 10], series[n, k], count)
        _end(work, result[r, 3 * first :], count)
