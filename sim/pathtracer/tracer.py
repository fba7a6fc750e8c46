"""Radiance maps of a height map of plastic: direct light of every cell, and light reflected several times.

The surface is the mesh of two triangles a cell. Direct light is computed for every triangle; whether it is lit and seen
says one random point of each, which is right in the mean and rough within a cell. Light that is reflected more than
once varies smoothly, but for the place on a ridge: it is traced on a sample of paths, as a function of the column
(with a pitch: of the place across it), and added.

Nothing here is shared with `anisoscope.sim.light`: a predictor that is compared with what is rendered from here is
compared with another derivation of the same physics, or with another physics.

Every cell of the map is two triangles, cut from (row, col) to (row + 1, col + 1). A ray goes from one crossing of a
grid line or diagonal to the next; between two crossings ray and surface are both straight, so that a ray is blocked
exactly where it is below the surface at a crossing. Places count in cells (u along columns, v along rows) and z in
µm; so do the ways of rays. Beyond the edge rows go on for ever; columns repeat after ``period`` columns where it is
not 0, and go on likewise where it is. Unknown heights block nothing.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
import numpy.typing as npt
from numba import get_num_threads, njit

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.base.parallel import for_each
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.pathtracer.plastic import Plastic

MOST_STEPS = 20000
CLEAR_UM = 1e-6
FADED, LEAST_REFLECTIONS = 0.1, 2

Vector = tuple[float, float, float]
Corners = tuple[float, float, float, float]
Function = TypeVar("Function", bound=Callable[..., Any])
_FAST = {"contract", "arcp", "nsz", "reassoc", "afn"}  # not "nnan": unknown heights are NaN


def _compiled(function: Function) -> Function:
    decorated: Any = njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")(function)
    return cast("Function", decorated)


class Mesh(NamedTuple):
    """(rows, cols) heights above the lowest point, sizes of a cell, columns of a period, and the highest point."""

    z: FloatArray
    px: float
    py: float
    period: int
    top: float


class Interface(NamedTuple):
    """A `Plastic`: parts (K, 2) are shares and factors on α, the table that of transmission."""

    along: float
    across: float
    eta: float
    tail: float
    base: float
    parts: FloatArray
    table: FloatArray


class Hit(NamedTuple):
    """Point at which a ray meets the surface, and slopes of the triangle along x and y in µm per µm."""

    met: bool
    place: Vector
    sx: float
    sy: float


@_compiled
def _corners(mesh: Mesh, col: int, row: int) -> Corners:
    """Heights of a cell at (row, col), (row, col + 1), (row + 1, col), (row + 1, col + 1), also beyond the edge."""
    rows, cols = mesh.z.shape
    below, above = min(max(row, 0), rows - 1), min(max(row + 1, 0), rows - 1)
    left, right = min(max(col, 0), cols - 1), min(max(col + 1, 0), cols - 1)
    if mesh.period > 0 and (col < 0 or col > cols - 2):
        left = col % mesh.period
        right = left + 1
    return mesh.z[below, left], mesh.z[below, right], mesh.z[above, left], mesh.z[above, right]


@_compiled
def _height(corners: Corners, fu: float, fv: float) -> float:
    """Height of the surface within a cell."""
    z00, z01, z10, z11 = corners
    if fu > fv:
        return z00 + fu * (z01 - z00) + fv * (z11 - z01)
    return z00 + fv * (z10 - z00) + fu * (z11 - z10)


@_compiled
def _leaves(share: float, way: float) -> float:
    """Time until a ray leaves its cell in one direction."""
    if way > 0.0:
        return (1.0 - share) / way
    return -share / way if way < 0.0 else math.inf


@_compiled
def _crosses(fu: float, fv: float, way: Vector, until: float) -> float:
    """Time at which a ray crosses the diagonal of its cell before ``until``, else ``until``."""
    rate = way[0] - way[1]
    if rate == 0.0 or fu == fv:
        return until
    time = (fv - fu) / rate
    return time if 0.0 < time < until else until


@_compiled
def _stepped(cell: int, share: float, way: float, leaves: bool) -> tuple[int, float]:
    """The next cell in one direction and the place within it, where the ray leaves this one."""
    if not leaves:
        return cell, share
    return (cell + 1, 0.0) if way > 0.0 else (cell - 1, 1.0)


@_compiled
def blocked(mesh: Mesh, place: Vector, way: Vector) -> bool:
    """Whether a ray that rises from a point of the surface meets the surface again."""
    u, v, height = place
    du, dv, dz = way
    if du == 0.0 and dv == 0.0:
        return False
    col, row = math.floor(u), math.floor(v)
    fu, fv = u - col, v - row
    for _ in range(MOST_STEPS):
        if height > mesh.top:
            return False
        tu, tv = _leaves(fu, du), _leaves(fv, dv)
        time = min(tu, tv)
        corners = _corners(mesh, col, row)
        part = _crosses(fu, fv, way, time)
        if part < time:
            at = fu + part * du
            if height + part * dz < corners[0] + at * (corners[3] - corners[0]) - CLEAR_UM:
                return True
        fu, fv, height = fu + time * du, fv + time * dv, height + time * dz
        if height < _height(corners, fu, fv) - CLEAR_UM:
            return True
        col, fu = _stepped(col, fu, du, tu <= tv)
        row, fv = _stepped(row, fv, dv, tv <= tu)
    return False


@_compiled
def _slopes(corners: Corners, lower: bool) -> tuple[float, float]:
    """Rises of one of the two triangles of a cell, per cell; the lower one is at greater columns."""
    z00, z01, z10, z11 = corners
    return (z01 - z00, z11 - z01) if lower else (z11 - z10, z10 - z00)


@_compiled
def _met_within(
    corners: Corners, place: Vector, way: Vector, time: float, lower: bool
) -> tuple[float, float, float]:
    """Time at which a ray goes through a triangle before ``time``, −1 if it does not; and its slopes per cell."""
    sx, sy = _slopes(corners, lower)
    gap = place[2] - (corners[0] + place[0] * sx + place[1] * sy)
    change = way[2] - way[0] * sx - way[1] * sy
    if change < 0.0 and gap >= -CLEAR_UM and gap + time * change < -CLEAR_UM:
        return max(gap, 0.0) / -change, sx, sy
    return -1.0, sx, sy


@_compiled
def first_hit(mesh: Mesh, place: Vector, way: Vector) -> Hit:
    """First point at which a ray from above the surface or on it meets the surface."""
    u, v, height = place
    du, dv, dz = way
    col, row = math.floor(u), math.floor(v)
    fu, fv = u - col, v - row
    for _ in range(MOST_STEPS):
        if dz >= 0.0 and height > mesh.top:
            break
        tu, tv = _leaves(fu, du), _leaves(fv, dv)
        time = min(tu, tv, 1e12)
        corners = _corners(mesh, col, row)
        part = _crosses(fu, fv, way, time)
        lower = fu > fv or (fu == fv and du > dv)
        found, sx, sy = _met_within(corners, (fu, fv, height), way, part, lower)
        if found < 0.0 and part < time:
            there = (fu + part * du, fu + part * du, height + part * dz)
            found, sx, sy = _met_within(corners, there, way, time - part, not lower)
            found = found + part if found >= 0.0 else found
        if found >= 0.0:
            at = (col + fu + found * du, row + fv + found * dv, height + found * dz)
            return Hit(True, at, sx / mesh.px, sy / mesh.py)
        if time >= 1e12:
            break
        fu, fv, height = fu + time * du, fv + time * dv, height + time * dz
        col, fu = _stepped(col, fu, du, tu <= tv)
        row, fv = _stepped(row, fv, dv, tv <= tu)
    return Hit(False, (0.0, 0.0, 0.0), 0.0, 0.0)


@_compiled
def _way(mesh: Mesh, direction: Vector) -> Vector:
    """A direction in cells and µm."""
    return direction[0] / mesh.px, direction[1] / mesh.py, direction[2]


@_compiled
def _unit(x: float, y: float, z: float) -> Vector:
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@_compiled
def _into(direction: Vector, sx: float, sy: float) -> Vector:
    """Components of a direction across the ridges on a facet, along them, and along its normal."""
    steep = 1.0 + sy * sy
    size = math.sqrt(steep + sx * sx)
    long = math.sqrt(steep)
    x, y, z = direction
    along = (y + sy * z) / long
    normal = (z - sx * x - sy * y) / size
    # (along) × (normal) = (1 + sy², −sx·sy, sx)/(long·size)
    across = (steep * x - sx * sy * y + sx * z) / (long * size)
    return across, along, normal


@_compiled
def _out_of(local: Vector, sx: float, sy: float) -> Vector:
    """The direction whose components on a facet are given; see `_into`."""
    steep = 1.0 + sy * sy
    size = math.sqrt(steep + sx * sx)
    long = math.sqrt(steep)
    across, along, normal = local[0] / (long * size), local[1] / long, local[2] / size
    return (
        steep * across - sx * normal,
        -sx * sy * across + along - sy * normal,
        sx * across + sy * along + normal,
    )


@_compiled
def _smith(a: float, tail: float) -> float:
    """Smith's Λ of one component at a = 1/(α·tan θ); see `shadowing`."""
    a = max(a, 1e-6)
    if tail == 0.0:
        if a > 4.0:
            return 0.0
        return 0.5 * (math.exp(-a * a) / (a * math.sqrt(math.pi)) - math.erfc(a))
    if tail == 1.0:
        return 0.5 * (math.sqrt(1.0 + 1.0 / (a * a)) - 1.0)
    s = a / math.sqrt(2.0 + a * a)
    less = 2.0 / ((2.0 + a * a) * (1.0 + s))
    whole = 1.0 + 0.5 * a * a
    first = 2.0 / (3.0 * whole * math.sqrt(whole))
    return max(0.5303300858899106 * (first / a - math.sqrt(2.0) * less * less * (2.0 + s) / 3.0), 0.0)


@_compiled
def _lambda(local: Vector, plastic: Interface) -> float:
    """Λ of a direction, of all components of the lobe."""
    x, y = plastic.across * local[0], plastic.along * local[1]
    spread = math.sqrt(x * x + y * y)
    if spread < 1e-9:
        return 0.0
    total = 0.0
    for k in range(plastic.parts.shape[0]):
        total += plastic.parts[k, 0] * _smith(local[2] / (spread * plastic.parts[k, 1]), plastic.tail)
    return total


@_compiled
def _density(half: Vector, plastic: Interface) -> float:
    """Density over the plane of slopes of the microfacets with normal ``half``."""
    x, y = half[0] / (half[2] * plastic.across), half[1] / (half[2] * plastic.along)
    square = x * x + y * y
    total, tail = 0.0, plastic.tail
    for k in range(plastic.parts.shape[0]):
        wide = plastic.parts[k, 1] * plastic.parts[k, 1]
        own = square / wide
        if tail == 0.0:
            value = math.exp(-own) if own < 80.0 else 0.0
        else:
            value = 1.0 + tail * own
            value = 1.0 / (value * value * (value if tail == 0.5 else 1.0))
        total += plastic.parts[k, 0] * value / wide
    return total / (math.pi * plastic.along * plastic.across)


@_compiled
def _fresnel(cosine: float, index: float) -> float:
    """Unpolarised reflectance of light that comes from the thinner side."""
    root = math.sqrt(index * index - 1.0 + cosine * cosine)
    normal = (cosine - root) / (cosine + root)
    square = index * index * cosine
    parallel = (square - root) / (square + root)
    return 0.5 * (normal * normal + parallel * parallel)


@_compiled
def _entered(table: FloatArray, cosine: float) -> float:
    position = min(max(cosine, 0.0), 1.0) * (table.shape[0] - 1)
    low = min(int(position), table.shape[0] - 2)
    return float(table[low] + (position - low) * (table[low + 1] - table[low]))


@_compiled
def _scattered(light: Vector, camera: Vector, plastic: Interface) -> float:
    """f·cos_i·cos_o of a facet, directions in its frame; 0 below its horizon."""
    if light[2] <= 0.0 or camera[2] <= 0.0:
        return 0.0
    half = _unit(light[0] + camera[0], light[1] + camera[1], light[2] + camera[2])
    toward = light[0] * half[0] + light[1] * half[1] + light[2] * half[2]
    square = half[2] * half[2]
    density = _density(half, plastic) / (square * square)
    shadow = 1.0 + _lambda(light, plastic) + _lambda(camera, plastic)
    mirrored = _fresnel(toward, plastic.eta) * density / (4.0 * shadow)
    entered = _entered(plastic.table, light[2]) * _entered(plastic.table, camera[2])
    return mirrored + plastic.base * entered * light[2] * camera[2]


@_compiled
def _mixed(state: np.uint64) -> tuple[float, np.uint64]:
    """Next number of the splitmix64 generator (Steele et al. 2014), and its state."""
    state = state + np.uint64(0x9E3779B97F4A7C15)
    mixed = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    mixed = mixed ^ (mixed >> np.uint64(31))
    return (mixed >> np.uint64(11)) * (1.0 / 9007199254740992.0), state


@_compiled
def _toward_lamp(mesh: Mesh, light: Vector, near: float, row: int, col: int) -> tuple[Vector, float]:
    """Direction to the lamp from a cell, and its level there such that a level plane is lit evenly."""
    if near == 0.0:
        return light, 1.0
    x = mesh.px * (col + 0.5 - 0.5 * (mesh.z.shape[1] - 1))
    y = mesh.py * (row + 0.5 - 0.5 * (mesh.z.shape[0] - 1))
    to = _unit(light[0] - near * x, light[1] - near * y, light[2])
    return to, light[2] / to[2]


@_compiled
def _cell(
    mesh: Mesh, row: int, col: int, light: Vector, camera: Vector, plastic: Interface, state: np.uint64
) -> float:
    """Radiance of a cell times the cosine of the camera, of light that is reflected once."""
    corners = _corners(mesh, col, row)
    total = 0.0
    for triangle in range(2):
        lower = triangle == 0
        rise_x, rise_y = _slopes(corners, lower)
        sx, sy = rise_x / mesh.px, rise_y / mesh.py
        value = _scattered(_into(light, sx, sy), _into(camera, sx, sy), plastic)
        if value <= 0.0:
            continue
        fu, state = _mixed(state)
        fv, state = _mixed(state)
        if (fv > fu) == lower:
            fu, fv = fv, fu
        place = (col + fu, row + fv, corners[0] + fu * rise_x + fv * rise_y)
        if blocked(mesh, place, _way(mesh, light)) or blocked(mesh, place, _way(mesh, camera)):
            continue
        total += 0.5 * value * math.sqrt(1.0 + sx * sx + sy * sy)
    return total


@_compiled
def direct(
    mesh: Mesh,
    plastic: Interface,
    light: Vector,
    camera: Vector,
    near: float,
    seed: int,
    first: int,
    last: int,
    out: npt.NDArray[np.float32],
) -> None:
    """Radiance of the cells of rows ``first`` to ``last``, of light that is reflected once, per macroscopic area.

    One point of each triangle, drawn by its cell, says whether it is lit and seen. A lamp at a distance has
    ``near`` = 1/distance [1/µm], else 0: its direction at each cell is that toward it, its level on a level plane is
    even, as a flat field leaves it.
    """
    for row in range(first, last):
        for col in range(mesh.z.shape[1] - 1):
            corners = _corners(mesh, col, row)
            if not corners[0] + corners[1] + corners[2] + corners[3] < math.inf:
                out[row, col] = math.nan
                continue
            to_lamp, level = _toward_lamp(mesh, light, near, row, col)
            state = np.uint64(seed) + np.uint64(row) * np.uint64(0xD1342543DE82EF95)
            state = state + np.uint64(col) * np.uint64(0x2545F4914F6CDD1D)
            out[row, col] = level * _cell(mesh, row, col, to_lamp, camera, plastic, state) / camera[2]


@_compiled
def _next_way(toward: Vector, plastic: Interface, state: np.uint64) -> tuple[Vector, np.uint64]:
    """A direction in which light goes on, in the frame of the facet: half of them drawn from the lobe.

    The others are drawn by their cosine. It may be below the facet.
    """
    choice, state = _mixed(state)
    one, state = _mixed(state)
    two, state = _mixed(state)
    turn = 2.0 * math.pi * two
    if choice >= 0.5:
        flat = math.sqrt(one)
        return (flat * math.cos(turn), flat * math.sin(turn), math.sqrt(1.0 - one)), state
    pick, state = _mixed(state)
    k = 0
    while k < plastic.parts.shape[0] - 1 and pick > plastic.parts[k, 0]:
        pick -= plastic.parts[k, 0]
        k += 1
    # radius of the slopes that a share ``one`` of the microfacets does not exceed
    square = -math.log(1.0 - one)
    if plastic.tail > 0.0:
        square = (math.exp(plastic.tail * square) - 1.0) / plastic.tail
    radius = plastic.parts[k, 1] * math.sqrt(square)
    half = _unit(plastic.across * radius * math.cos(turn), plastic.along * radius * math.sin(turn), 1.0)
    twice = 2.0 * (toward[0] * half[0] + toward[1] * half[1] + toward[2] * half[2])
    return (twice * half[0] - toward[0], twice * half[1] - toward[1], twice * half[2] - toward[2]), state


@_compiled
def _chance(toward: Vector, onward: Vector, plastic: Interface) -> float:
    """Density per solid angle with which `_next_way` draws a direction."""
    half = _unit(toward[0] + onward[0], toward[1] + onward[1], toward[2] + onward[2])
    cosine = onward[0] * half[0] + onward[1] * half[1] + onward[2] * half[2]
    lobe = _density(half, plastic) / (half[2] * half[2] * half[2] * 4.0 * cosine)
    return 0.5 * lobe + 0.5 * onward[2] / math.pi


@_compiled
def _balance(
    at_start: Vector, onward: Vector, at_end: Vector, back: Vector, plastic: Interface, level: float
) -> float:
    """Weight of a path of two reflections drawn from one of its ends, by the balance heuristic (Veach 1995).

    The same path may be drawn from the other end; either end starts evenly over the level plane.

    Args:
        at_start: direction to the end that it is drawn from, on the facet next to it.
        onward: from there to the other facet.
        at_end: direction to the other end, on the other facet.
        back: from there to the first one.
        plastic: of both.
        level: cosine of the other end on the level plane over that of this one.
    """
    own = at_start[2] * _chance(at_start, onward, plastic) * back[2] * level
    other = at_end[2] * _chance(at_end, back, plastic) * onward[2]
    return own / (own + other)


@_compiled
def _lit(mesh: Mesh, plastic: Interface, light: Vector, hit: Hit, toward: Vector) -> tuple[float, Vector]:
    """f·cos_i·cos_o of direct light at a point, 0 in shadow; and the direction to the lamp on its facet."""
    to_light = _into(light, hit.sx, hit.sy)
    value = _scattered(to_light, toward, plastic)
    if value > 0.0 and blocked(mesh, hit.place, _way(mesh, light)):
        value = 0.0
    return value, to_light


@_compiled
def _path(
    mesh: Mesh,
    plastic: Interface,
    light: Vector,
    camera: Vector,
    level: float,
    start: Vector,
    depth: int,
    state: np.uint64,
) -> tuple[float, float, float]:
    """Radiance that one path from the camera brings by two to ``depth`` reflections, and the columns it meets first.

    Two reflections are weighed against the same path from the lamp. ``level`` is the cosine of the lamp on the level
    plane over that of the camera.
    """
    place, back = start, camera
    weight, total, at, second = 1.0, 0.0, 0.0, 0.0
    earlier, went = camera, camera
    for reflection in range(depth):
        hit = first_hit(mesh, place, _way(mesh, (-back[0], -back[1], -back[2])))
        if not hit.met:
            break
        place = hit.place
        toward = _into(back, hit.sx, hit.sy)
        if toward[2] <= 0.0:
            break
        if reflection == 0:
            at = place[0]
        else:
            value, to_light = _lit(mesh, plastic, light, hit, toward)
            value *= weight / toward[2]
            if reflection == 1:
                second = place[0]
                value *= _balance(earlier, went, to_light, toward, plastic, level) if value > 0.0 else 0.0
            total += value
        if reflection == depth - 1:
            break
        onward, state = _next_way(toward, plastic, state)
        value = _scattered(onward, toward, plastic)
        if value <= 0.0:
            break
        weight *= value / (toward[2] * _chance(toward, onward, plastic))
        if weight < FADED and reflection >= LEAST_REFLECTIONS:  # every other goes on, with twice the weight
            stays, state = _mixed(state)
            weight *= 2.0 if stays < 0.5 else 0.0
        if weight == 0.0:
            break
        earlier, went = toward, onward
        to = _out_of(onward, hit.sx, hit.sy)
        back = (-to[0], -to[1], -to[2])
    return total, at, second


@_compiled
def _start(mesh: Mesh, u: float, v: float, toward: Vector) -> Vector:
    """Point of entry of a path from far away that meets the plane at half the height at a share (u, v) of the map."""
    rows, cols = mesh.z.shape
    rise = 0.5 * mesh.top / toward[2]
    return (
        u * (cols - 1) + rise * toward[0] / mesh.px,
        v * (rows - 1) + rise * toward[1] / mesh.py,
        mesh.top,
    )


@_compiled
def _bin(mesh: Mesh, column: float, bins: int) -> int:
    """Bin of a column; one beyond the edge of a map that repeats is inside."""
    cells = mesh.z.shape[1] - 1
    if mesh.period > 0:
        column %= cells
    return min(max(int(column / cells * bins), 0), bins - 1)


@_compiled
def indirect(
    mesh: Mesh,
    plastic: Interface,
    light: Vector,
    camera: Vector,
    depth: int,
    seed: int,
    first: int,
    last: int,
    sums: FloatArray,
) -> None:
    """Add the radiance of paths ``first`` to ``last`` with two to ``depth`` reflections to the bins of their columns.

    A path comes from the camera, and meets the plane at half the height evenly; at every point that it meets it is
    continued by the lobe or by the base, and light comes in directly from the lamp. A narrow lobe hardly ever catches
    the lamp that way: two reflections are followed from the lamp to the camera, too, and either way counts by how
    likely it finds the path.
    """
    shift_u, state = _mixed(np.uint64(seed))
    shift_v, state = _mixed(state)
    level = light[2] / camera[2]
    bins = sums.shape[0]
    for number in range(first, last):
        # evenly over the map (R2 sequence, Roberts 2018)
        u = (number * 0.7548776662466927 + shift_u) % 1.0
        v = (number * 0.5698402909980532 + shift_v) % 1.0
        own = np.uint64(seed) + np.uint64(number) * np.uint64(0xA24BAED4963EE407)
        total, at, _ = _path(mesh, plastic, light, camera, level, _start(mesh, u, v, camera), depth, own)
        sums[_bin(mesh, at, bins)] += total
        own ^= np.uint64(0xD1342543DE82EF95)
        total, _, at = _path(mesh, plastic, camera, light, 1.0 / level, _start(mesh, u, v, light), 2, own)
        sums[_bin(mesh, at, bins)] += level * total


Image = npt.NDArray[np.float32]

BIN_UM = 4.0
_BATCHES = 16
ENOUGH = 1e-3
"""Standard error of the light that is reflected more than once, in shares of direct light, that a picture may have."""
EQUAL_ROWS = 48
"""Rows whose random points are drawn where all rows of a map are equal; the others repeat them."""


@dataclass(frozen=True, eq=False)
class Indirect:
    """Light that is reflected more than once.

    Attributes:
        profile: (cols − 1,) radiance in 1/sr by column of cells.
        mean: over the map.
        standard_error: of the mean, from batches of paths.
    """

    profile: FloatArray
    mean: float
    standard_error: float


class PathTracer:
    """A height map of one plastic under a distant or near lamp of unit irradiance.

    Args:
        surface: heights in µm; unknown ones are NaN.
        plastic: what it is made of.
        pitch_um: distance along x after which the surface repeats: light from beyond the edge comes from inside, and
            light that is reflected more than once is taken to repeat. Without it the edge goes on for ever.
        reflections: largest number of reflections of a path; 1 is direct light alone.
        paths: number of paths a pose for the light that is reflected more than once.
        lamp_distance_um: distance of the lamp from the middle of the map, or None for a distant one. A near one
            changes the direction of direct light over the map, not its level on a level plane.
        seed: of everything random; equal seeds give equal maps.

    Raises:
        ModelError: less than one reflection or path, or a lamp at no distance.
    """

    def __init__(
        self,
        surface: HeightMap,
        plastic: Plastic,
        *,
        pitch_um: float | None = None,
        reflections: int = 5,
        paths: int = 131072,
        lamp_distance_um: float | None = None,
        seed: int = 1,
    ) -> None:
        if reflections < 1 or paths < _BATCHES:
            raise ModelError(
                f"a path tracer needs 1 reflection and {_BATCHES} paths or more, not {reflections} and {paths}"
            )
        if lamp_distance_um is not None and not lamp_distance_um > 0.0:
            raise ModelError(f"the lamp must stand at a positive distance, not {lamp_distance_um} µm")
        self.surface, self.plastic = surface, plastic
        self.pitch_um, self.reflections, self.paths, self.seed = pitch_um, reflections, paths, seed
        self._near = 0.0 if lamp_distance_um is None else 1.0 / lamp_distance_um
        lowest = float(np.nanmin(surface.height_um))
        self._z = np.ascontiguousarray(surface.height_um - lowest, dtype=np.float64)
        self._top = float(np.nanmax(self._z)) + 1e-3

    @cached_property
    def _varies_along_x(self) -> bool:
        """Whether the heights vary more from column to column than from row to row."""
        height = self.surface.height_um
        return bool(np.std(np.nanmean(height, axis=0)) >= np.std(np.nanmean(height, axis=1)))

    @cached_property
    def _rows_are_equal(self) -> bool:
        return bool(np.all(self._z == self._z[:1]))

    @property
    def _period(self) -> int:
        """Columns after which the surface repeats, 0 if it does not repeat on the grid."""
        if self.pitch_um is None:
            return 0
        columns = self.pitch_um / self.surface.pixel_x_um
        whole = round(columns)
        cells = self.surface.shape[1] - 1
        if abs(columns - whole) > 1e-6 * columns or not 0 < whole <= cells:
            return 0
        return whole * (cells // whole)

    def radiance(self, to_light: FloatArray, to_camera: FloatArray) -> Image:
        """(rows − 1, cols − 1) radiance of the cells per macroscopic area, 1/sr under unit irradiance; NaN unknown.

        Args:
            to_light: (3,) unit vector to the lamp, above the horizon.
            to_camera: (3,) unit vector to the camera, likewise.
        """
        found = self.direct(to_light, to_camera)
        if self.reflections > 1:
            enough = ENOUGH * float(np.nanmean(found, dtype=float))
            found += self.indirect(to_light, to_camera, enough).profile.astype(np.float32)
        return found

    def direct(self, to_light: FloatArray, to_camera: FloatArray) -> Image:
        """The same of light that is reflected once."""
        rows, cols = self.surface.shape
        out = np.empty((rows - 1, cols - 1), dtype=np.float32)
        given = self._given(to_light, to_camera)
        rendered = min(rows - 1, EQUAL_ROWS) if self._rows_are_equal and self._near == 0.0 else rows - 1

        def render(band: tuple[int, int]) -> None:
            direct(*given, self._near, self.seed, *band, out)

        for_each(render, _runs(rendered, 4 * _threads()), _threads())
        for first in range(rendered, rows - 1, rendered):
            out[first : first + rendered] = out[: min(rendered, rows - 1 - first)]
        return out

    def indirect(self, to_light: FloatArray, to_camera: FloatArray, enough: float = 0.0) -> Indirect:
        """Light of two to ``reflections`` reflections, by column; see `PathTracer.radiance`.

        Args:
            to_light: as for `PathTracer.radiance`.
            to_camera: likewise.
            enough: standard error of the mean [1/sr] at which no more paths are traced.
        """
        cells = self.surface.shape[1] - 1
        width = cells * self.surface.pixel_x_um
        bins = max(1, min(cells, round(width / BIN_UM)))
        sums = np.zeros((_BATCHES, bins))
        given = self._given(to_light, to_camera)
        batches = list(enumerate(_runs(self.paths, _BATCHES)))
        counts = np.array([last - first for _, (first, last) in batches])

        def trace(batch: tuple[int, tuple[int, int]]) -> None:
            indirect(*given, self.reflections, self.seed, *batch[1], sums[batch[0]])

        traced, error, means = 0, math.inf, np.zeros(1)
        while traced < _BATCHES and error > enough:
            for_each(trace, batches[traced : traced + _BATCHES // 4], _threads())
            traced += _BATCHES // 4
            means = sums[:traced].sum(axis=1) / counts[:traced]
            error = float(np.std(means, ddof=1) / np.sqrt(traced))
        by_bin = sums.sum(axis=0) * bins / counts[:traced].sum()
        middles = (np.arange(cells) + 0.5) * bins / cells - 0.5
        if self.pitch_um is not None and width >= self.pitch_um:
            by_bin = _folded(by_bin, width / bins / self.pitch_um)
        profile = np.interp(middles, np.arange(bins), by_bin)
        mean = float(np.mean(means))
        if not self._varies_along_x:  # ridges along x: what columns show beyond their mean is chance
            profile = np.ones_like(profile)
        profile *= mean / max(float(profile.mean()), 1e-300)
        return Indirect(profile, mean, error)

    def _given(self, to_light: FloatArray, to_camera: FloatArray) -> tuple[Any, Any, Any, Any]:
        surface, plastic = self.surface, self.plastic
        mesh = Mesh(self._z, float(surface.pixel_x_um), float(surface.pixel_y_um), self._period, self._top)
        interface = Interface(
            float(plastic.alpha_along),
            float(plastic.alpha_across),
            float(plastic.index),
            float(plastic.tail),
            float(plastic.base),
            plastic.components,
            np.array(plastic.transmission),
        )
        light, camera = (tuple(float(one) for one in side) for side in (to_light, to_camera))
        return mesh, interface, light, camera


def _folded(values: FloatArray, pitches_a_bin: float) -> FloatArray:
    """Values of bins replaced by the mean of all that have the same place in their pitch."""
    places = max(1, round(1.0 / pitches_a_bin))
    phase = ((np.arange(len(values)) + 0.5) * pitches_a_bin) % 1.0
    number = np.minimum((phase * places).astype(int), places - 1)
    count = np.maximum(np.bincount(number, minlength=places), 1)
    return np.asarray((np.bincount(number, values, minlength=places) / count)[number])


def _threads() -> int:
    return int(get_num_threads())


def _runs(length: int, most: int) -> list[tuple[int, int]]:
    parts = max(1, min(length, most))
    return [(n * length // parts, (n + 1) * length // parts) for n in range(parts)]
