"""Compiled inner loops of a picture of inks (numba, cached on disk after the first call).

A row is worked on in steps, each a plain loop over its pixels that the compiler turns into vector instructions; only
the look-up of colours goes pixel by pixel.
"""

import math

import numpy as np
import numpy.typing as npt

from anisoscope.base.kernel_compilation import jit_kernel, log_compilation

log_compilation(__file__)

Float32 = npt.NDArray[np.float32]
Vector = tuple[float, float, float]

# float32 for the compiler, plain numbers for the type checker
ZERO: float = np.float32(0.0)  # type: ignore[assignment]
HALF: float = np.float32(0.5)  # type: ignore[assignment]
ONE: float = np.float32(1.0)  # type: ignore[assignment]
FAINT: float = np.float32(1e-12)  # type: ignore[assignment]
PI: float = np.float32(math.pi)  # type: ignore[assignment]
SCRATCH = 10
"""Rows of scratch space: the normal's components, cosines to camera and light, place in the table, lobe, colours."""


@jit_kernel(inline="always", fastmath=True)
def _smith(slant: float, tail: float) -> float:
    """Smith's Λ for a squared slant (α tanθ)², between Beckmann's and that of GGX linear in the tail."""
    ggx = HALF * (math.sqrt(ONE + slant) - ONE)
    if tail == ONE:
        return ggx
    if slant < FAINT:
        return ZERO
    a = ONE / math.sqrt(slant)
    gauss = max(ZERO, 0.5 * (math.exp(-a * a) / (a * math.sqrt(math.pi)) - math.erfc(a)))
    return gauss + tail * (ggx - gauss)


@jit_kernel(inline="always", fastmath=True)
def _density(spread: float, up: float, area: float, tail: float) -> float:
    """D from the spread (x/α_x)² + (y/α_y)² of the half vector, its height, and α_x·α_y."""
    square = up * up
    if tail != ONE:
        x = spread / square
        if tail > FAINT:
            some = max(tail, FAINT)  # fast arithmetic divides before it asks
            x = (ONE + ONE / some) * math.log(ONE + some * x)
        return math.exp(-x) / (PI * area * square * square)
    total = spread + square
    return ONE / (PI * area * total * total)


@jit_kernel(fastmath=True)
def _cosines(work: Float32, x: float, y: float, z: float, into: int) -> None:
    """Cosines between the normals of a row and a unit vector."""
    across, down, up, found = work[0], work[1], work[2], work[into]
    for c in range(found.size):
        found[c] = across[c] * x + down[c] * y + up[c] * z


@jit_kernel(fastmath=True)
def _places(work: Float32, last: float) -> None:
    """Place in the table of the goniochromatic model (Eq. 6), cosines cut to [0, 1]."""
    lit, seen, found = work[4], work[3], work[5]
    for c in range(found.size):
        i = min(max(lit[c], ZERO), ONE)
        o = min(max(seen[c], ZERO), ONE)
        both, neither = (ONE + i) * (ONE + o), (ONE - i) * (ONE - o)
        found[c] = max(ZERO, ONE - HALF * (math.sqrt(both) - math.sqrt(neither))) * last


@jit_kernel(fastmath=True)
def _plain_lobe(work: Float32, beam: Float32, alpha: float) -> None:
    """E/4·D·cosθi of the isotropic GGX lobe; 0 where the surface turns away.

    The square of the half vector across the normal comes from components, not from 1 − cos²: so narrow lobes keep.
    """
    hx, hy, hz = beam[3], beam[4], beam[5]
    narrow = ONE / (alpha * alpha)
    scale = beam[6] * narrow / PI
    along_x, along_y, along_z, seen, lit, found = work[0], work[1], work[2], work[3], work[4], work[6]
    for c in range(found.size):
        x, y, z = along_x[c], along_y[c], along_z[c]
        cx, cy, cz = y * hz - z * hy, z * hx - x * hz, x * hy - y * hx
        up = x * hx + y * hy + z * hz
        total = (cx * cx + cy * cy + cz * cz) * narrow + up * up
        faces = lit[c] > ZERO and seen[c] > ZERO
        found[c] = scale * lit[c] / max(total * total, FAINT) if faces else ZERO


@jit_kernel(inline="always", fastmath=True)
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


@jit_kernel(fastmath=True)
def _any_lobe(
    work: Float32, tangent: Float32, beam: Float32, camera: Vector, lobe: Float32, standard: bool
) -> None:
    """E/4·D·cosθi, or E/4·D·G/cosθo for a standard model, of any lobe; 0 where the surface turns away."""
    ax, ay, tail, turned = lobe[0], lobe[1], lobe[4], lobe[5] > ZERO
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
        value = beam[6] * _density(spread, up, ax * ay, tail)
        if standard:
            lit, seen = (
                _smith(slant_i / (cos_i * cos_i), tail),
                _smith(slant_o / (cos_o * cos_o), tail),
            )
            work[6, c] = value / (cos_o * (ONE + lit + seen))
        else:
            work[6, c] = value * cos_i


@jit_kernel(fastmath=True)
def _add_one(work: Float32, share: float, colours: Float32) -> None:
    """Add an ink that covers a row evenly: share · lobe · colour at its place in the table."""
    last = np.int32(colours.shape[0] - 2)
    value, position, red, green, blue = work[6], work[5], work[7], work[8], work[9]
    for c in range(value.size):
        index = min(np.int32(position[c]), last)
        beyond = position[c] - np.float32(index)
        entry = colours[np.uint32(index)]  # unsigned: nothing to guard against wrapping around
        strength = value[c] * share
        red[c] += strength * (entry[0] + beyond * entry[3])
        green[c] += strength * (entry[1] + beyond * entry[4])
        blue[c] += strength * (entry[2] + beyond * entry[5])


@jit_kernel(fastmath=True)
def _add(work: Float32, coverage: Float32, first: int, stop: int, colours: Float32) -> None:
    """Add inks that share one lobe: coverage · lobe · colour at the place in their tables."""
    last, alike = np.int32(colours.shape[1] - 2), coverage.shape[0] == 1
    value, position, red, green, blue = work[6], work[5], work[7], work[8], work[9]
    for c in range(value.size):
        if value[c] == ZERO:
            continue
        index = min(np.int32(position[c]), last)
        beyond = position[c] - np.float32(index)
        covered = coverage[np.uint32(0 if alike else c)]
        for k in range(first, stop):
            strength = value[c] * covered[k]
            entry = colours[k, np.uint32(index)]
            red[c] += strength * (entry[0] + beyond * entry[3])
            green[c] += strength * (entry[1] + beyond * entry[4])
            blue[c] += strength * (entry[2] + beyond * entry[5])


@jit_kernel()
def _take_apart(normal: Float32, work: Float32) -> None:
    """Components of the normals of a row, and no colours yet."""
    x, y, z, red, green, blue = work[0], work[1], work[2], work[7], work[8], work[9]
    for c in range(x.size):
        x[c], y[c], z[c] = normal[c, 0], normal[c, 1], normal[c, 2]
        red[c], green[c], blue[c] = ZERO, ZERO, ZERO


@jit_kernel()
def _put_together(work: Float32, result: Float32) -> None:
    """The colours of a row."""
    red, green, blue = work[7], work[8], work[9]
    for c in range(red.size):
        result[c, 0], result[c, 1], result[c, 2] = red[c], green[c], blue[c]


@jit_kernel(inline="always")
def _run_end(lobes: Float32, first: int) -> int:
    """End of the run of inks with the same lobe as the first one."""
    stop = first + 1
    while stop < lobes.shape[0]:
        for j in range(lobes.shape[1]):
            if lobes[stop, j] != lobes[first, j]:
                return stop
        stop += 1
    return stop


@jit_kernel(nogil=True, fastmath=True)
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
        colours: (L, K, N, 6) tables: red, green, blue, and how much each changes up to the next entry.
        standard: Torrance-Sparrow in place of the goniochromatic model.
        begin: first row.
        stop: row after the last.
        work: (SCRATCH, cols), anything.
        result: (rows, cols, 3), filled.
    """
    last: float = np.float32(colours.shape[2] - 1)  # type: ignore[assignment]
    for r in range(begin, stop):
        _take_apart(normal[r], work)
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
                if standard or lobes[k, 4] != ONE or lobes[k, 5] > ZERO:
                    _any_lobe(work, tangent[r], beams[n], camera, lobes[k], standard)
                else:
                    _plain_lobe(work, beams[n], lobes[k, 0])
                if after == k + 1 and coverage.shape[0] == 1:
                    _add_one(work, covered[0, k], colours[n, k])
                else:
                    _add(work, covered, k, after, colours[n])
                k = after
        _put_together(work, result[r])
