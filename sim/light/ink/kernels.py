"""Compiled inner loops of a picture of inks (numba, cached on disk after the first call).

A row is worked on in steps, each a plain loop over its pixels that the compiler turns into vector instructions; only
the look-up of colours goes pixel by pixel.
"""

import math

import numpy as np
import numpy.typing as npt

from anisoscope.sim.light.compiled import announce, borrowing

announce()

Float32 = npt.NDArray[np.float32]
Vector = tuple[float, float, float]

# float32 for the compiler, plain numbers for the type checker
ZERO: float = np.float32(0.0)  # type: ignore[assignment]
HALF: float = np.float32(0.5)  # type: ignore[assignment]
ONE: float = np.float32(1.0)  # type: ignore[assignment]
FAINT: float = np.float32(1e-12)  # type: ignore[assignment]
PI: float = np.float32(math.pi)  # type: ignore[assignment]
SCRATCH = 7
"""Rows of scratch space: the normal's components, cosines to camera and light, place in the table, lobe."""


@borrowing(inline="always", fastmath=True)
def _smith(slant: float, beckmann: bool) -> float:
    """Smith's Λ for a squared slant (α tanθ)²."""
    if not beckmann:
        return HALF * (math.sqrt(ONE + slant) - ONE)
    if slant < FAINT:
        return ZERO
    a = ONE / math.sqrt(slant)
    return max(ZERO, 0.5 * (math.exp(-a * a) / (a * math.sqrt(math.pi)) - math.erfc(a)))


@borrowing(inline="always", fastmath=True)
def _density(spread: float, up: float, area: float, beckmann: bool) -> float:
    """D from the spread (x/α_x)² + (y/α_y)² of the half vector, its height, and α_x·α_y."""
    square = up * up
    if beckmann:
        return math.exp(-spread / square) / (PI * area * square * square)
    total = spread + square
    return ONE / (PI * area * total * total)


@borrowing(fastmath=True)
def _cosines(work: Float32, x: float, y: float, z: float, into: int) -> None:
    """Cosines between the normals of a row and a unit vector."""
    for c in range(work.shape[1]):
        work[into, c] = work[0, c] * x + work[1, c] * y + work[2, c] * z


@borrowing(fastmath=True)
def _places(work: Float32, last: float) -> None:
    """Where in the table the goniochromatic model looks (Eq. 6), cosines cut to [0, 1]."""
    for c in range(work.shape[1]):
        i = min(max(work[4, c], ZERO), ONE)
        o = min(max(work[3, c], ZERO), ONE)
        both, neither = (ONE + i) * (ONE + o), (ONE - i) * (ONE - o)
        work[5, c] = max(ZERO, ONE - HALF * (math.sqrt(both) - math.sqrt(neither))) * last


@borrowing(fastmath=True)
def _plain_lobe(work: Float32, beam: Float32, alpha: float) -> None:
    """E/4·D·cosθi of the isotropic GGX lobe; 0 where the surface turns away.

    The square of the half vector across the normal comes from components, not from 1 − cos²: so narrow lobes keep.
    """
    hx, hy, hz = beam[3], beam[4], beam[5]
    narrow = ONE / (alpha * alpha)
    scale = beam[6] * narrow / PI
    for c in range(work.shape[1]):
        x, y, z = work[0, c], work[1, c], work[2, c]
        cx, cy, cz = y * hz - z * hy, z * hx - x * hz, x * hy - y * hx
        up = x * hx + y * hy + z * hz
        total = (cx * cx + cy * cy + cz * cz) * narrow + up * up
        faces = work[4, c] > ZERO and work[3, c] > ZERO
        work[6, c] = scale * work[4, c] / max(total * total, FAINT) if faces else ZERO


@borrowing(inline="always", fastmath=True)
def _turned(x: float, y: float, z: float, beam: Float32, camera: Vector, lobe: Float32, t: Float32) -> Vector:
    """Spread of the half vector, and slants of light and camera, over an anisotropic lobe; t is the tangent."""
    bx, by, bz = y * t[2] - z * t[1], z * t[0] - x * t[2], x * t[1] - y * t[0]
    p, q = lobe[2], lobe[3]
    ux, uy, uz = (p * t[0] + q * bx) * lobe[0], (p * t[1] + q * by) * lobe[0], (p * t[2] + q * bz) * lobe[0]
    vx, vy, vz = (p * bx - q * t[0]) * lobe[1], (p * by - q * t[1]) * lobe[1], (p * bz - q * t[2]) * lobe[1]
    along = (ux * beam[3] + uy * beam[4] + uz * beam[5]) / (lobe[0] * lobe[0])
    across = (vx * beam[3] + vy * beam[4] + vz * beam[5]) / (lobe[1] * lobe[1])
    spread = along * along + across * across
    along, across = ux * beam[0] + uy * beam[1] + uz * beam[2], vx * beam[0] + vy * beam[1] + vz * beam[2]
    slant_i = along * along + across * across
    along = ux * camera[0] + uy * camera[1] + uz * camera[2]
    across = vx * camera[0] + vy * camera[1] + vz * camera[2]
    return spread, slant_i, along * along + across * across


@borrowing(fastmath=True)
def _any_lobe(
    work: Float32, tangent: Float32, beam: Float32, camera: Vector, lobe: Float32, standard: bool
) -> None:
    """E/4·D·cosθi, or E/4·D·G/cosθo for a standard model, of any lobe; 0 where the surface turns away."""
    ax, ay, beckmann, turned = lobe[0], lobe[1], lobe[4] > ZERO, lobe[5] > ZERO
    for c in range(work.shape[1]):
        work[6, c] = ZERO
        cos_o, cos_i = min(work[3, c], ONE), min(work[4, c], ONE)
        if cos_i <= ZERO or cos_o <= ZERO:
            continue
        x, y, z = work[0, c], work[1, c], work[2, c]
        if turned:
            spread, slant_i, slant_o = _turned(x, y, z, beam, camera, lobe, tangent[c])
        else:
            cx, cy = y * beam[5] - z * beam[4], z * beam[3] - x * beam[5]
            cz = x * beam[4] - y * beam[3]
            spread = (cx * cx + cy * cy + cz * cz) / (ax * ax)
            slant_i, slant_o = ax * ax * (ONE - cos_i * cos_i), ax * ax * (ONE - cos_o * cos_o)
        up = x * beam[3] + y * beam[4] + z * beam[5]
        value = beam[6] * _density(spread, up, ax * ay, beckmann)
        if standard:
            lit, seen = (
                _smith(slant_i / (cos_i * cos_i), beckmann),
                _smith(slant_o / (cos_o * cos_o), beckmann),
            )
            work[6, c] = value / (cos_o * (ONE + lit + seen))
        else:
            work[6, c] = value * cos_i


@borrowing(fastmath=True)
def _add(work: Float32, coverage: Float32, first: int, stop: int, colours: Float32, result: Float32) -> None:
    """Add inks that share one lobe: coverage · lobe · colour at the place in their tables, to a row of the picture."""
    alike, last = coverage.shape[0] == 1, colours.shape[1] - 1
    for c in range(work.shape[1]):
        value = work[6, c]
        if value == ZERO:
            continue
        position = work[5, c]
        index = min(int(position), last - 1)
        share = position - np.float32(index)
        red, green, blue = result[c, 0], result[c, 1], result[c, 2]
        for k in range(first, stop):
            high = value * coverage[0 if alike else c, k]
            low = high * (ONE - share)
            high *= share
            red += low * colours[k, index, 0] + high * colours[k, index + 1, 0]
            green += low * colours[k, index, 1] + high * colours[k, index + 1, 1]
            blue += low * colours[k, index, 2] + high * colours[k, index + 1, 2]
        result[c, 0], result[c, 1], result[c, 2] = red, green, blue


@borrowing(inline="always")
def _run_end(lobes: Float32, first: int) -> int:
    """Where the run of inks with the same lobe as the first one ends."""
    stop = first + 1
    while stop < lobes.shape[0]:
        for j in range(lobes.shape[1]):
            if lobes[stop, j] != lobes[first, j]:
                return stop
        stop += 1
    return stop


@borrowing(nogil=True, fastmath=True)
def shade(
    normal: Float32,
    tangent: Float32,
    coverage: Float32,
    camera: Vector,
    beams: Float32,
    lobes: Float32,
    colours: Float32,
    standard: bool,
    begin: int,
    stop: int,
    work: Float32,
    result: Float32,
) -> None:
    """Rows ``begin`` to ``stop`` of Σ over lights and inks of E·w·f·cosθi.

    Args:
        normal: (rows, cols, 3), zero where there is nothing.
        tangent: (rows, cols, 3), looked at for anisotropic inks.
        coverage: (rows, cols, K) or (1, 1, K).
        camera: unit vector to the camera, in float32.
        beams: (L, 8) unit vector to the light, half vector, irradiance/4, and 1 − cosθd.
        lobes: (K, 6) as `shading.lobes` gives them.
        colours: (L, K, N, 3) tables.
        standard: Torrance-Sparrow in place of the goniochromatic model.
        begin: first row.
        stop: row after the last.
        work: (SCRATCH, cols), anything.
        result: (rows, cols, 3), filled.
    """
    last: float = np.float32(colours.shape[2] - 1)  # type: ignore[assignment]
    for r in range(begin, stop):
        for c in range(work.shape[1]):
            work[0, c], work[1, c], work[2, c] = normal[r, c, 0], normal[r, c, 1], normal[r, c, 2]
            result[r, c, 0], result[r, c, 1], result[r, c, 2] = ZERO, ZERO, ZERO
        _cosines(work, camera[0], camera[1], camera[2], 3)
        covered = coverage[0 if coverage.shape[0] == 1 else r]
        for n in range(beams.shape[0]):
            _cosines(work, beams[n, 0], beams[n, 1], beams[n, 2], 4)
            if standard:
                work[5, :] = beams[n, 7] * last
            else:
                _places(work, last)
            k = 0
            while k < lobes.shape[0]:
                after = _run_end(lobes, k)
                if standard or lobes[k, 4] > ZERO or lobes[k, 5] > ZERO:
                    _any_lobe(work, tangent[r], beams[n], camera, lobes[k], standard)
                else:
                    _plain_lobe(work, beams[n], lobes[k, 0])
                _add(work, covered, k, after, colours[n], result[r])
                k = after
