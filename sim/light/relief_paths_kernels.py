"""Compiled path tracing of rough plastic on a height map (numba, cached on disk after the first call).

Paths start all over the map and are followed from the camera; at every facet met, light is let in from all light
directions asked for. Light that reflects exactly twice is also followed from the light, and the two estimates
are weighed by the densities with which they draw the same path (Veach and Guibas 1995, balance heuristic): one
draws from the lobe about the camera's mirror direction, the other about the light's.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.kernel_compilation import jit_kernel
from anisoscope.sim.light.relief_rays import Terrain, height, meet, slopes
from anisoscope.sim.light.relief_scatter_kernels import (
    GLOSSY,
    Frame,
    Vector,
    drawn_density,
    facet_frame,
    from_facet,
    reflectance,
    to_facet,
)
from anisoscope.sim.light.shine import Plastic

Facet = tuple[Frame, Vector, tuple[int, int]]

LONGEST = 200  # reflections followed at most

GENERATOR = np.array([1, 182667, 469891, 498753, 110745, 446247, 250185, 118627, 245333], dtype=np.int64)
"""Generating vector of a rank-1 lattice for powers of two points (Cools, Kuo and Nuyens 2006)."""


class Draws(NamedTuple):
    """The point of the lattice that a path uses: its number, among how many, and the shift (D,)."""

    number: int
    among: int
    shift: FloatArray


class Course(NamedTuple):
    """Arguments of the paths that begin in one direction.

    Attributes:
        origin: unit vector from which paths are followed.
        origin_open: whether that direction is known to reach everything.
        ends: (K, 3) unit vectors.
        ends_open: (K,) the same for these.
        depth: largest number of reflections.
        ahead: the origin is the camera and the ends are lights; else the reverse.
    """

    origin: Vector
    origin_open: bool
    ends: FloatArray
    ends_open: npt.NDArray[np.bool_]
    depth: int
    ahead: bool


@jit_kernel(inline="always")
def _draw(draws: Draws, dimension: int) -> float:
    """Coordinate 0 ≤ u < 1: of the shifted lattice, and beyond its dimensions of a hash."""
    if dimension < GENERATOR.size:
        step = float((draws.number * GENERATOR[dimension]) & (draws.among - 1))
        value = float(step / draws.among + draws.shift[dimension])
        return value - 1.0 if value >= 1.0 else value
    key = np.uint64(draws.number) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(dimension)
    key ^= np.uint64(draws.shift[0] * 9007199254740992.0)
    for factor in (np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)):
        key = (key ^ (key >> np.uint64(30))) * factor
    key ^= key >> np.uint64(31)
    return float(key >> np.uint64(11)) / 9007199254740992.0


@jit_kernel()
def _leave(view: Vector, plastic: Plastic, draws: Draws, dimension: int) -> Vector:
    """A local direction: the mirror image of ``view`` in a random microfacet, or of cosine density."""
    choice, turn = _draw(draws, dimension), 2.0 * math.pi * _draw(draws, dimension + 1)
    share = _draw(draws, dimension + 2)
    if choice >= GLOSSY:
        radius = math.sqrt(share)
        return radius * math.cos(turn), radius * math.sin(turn), math.sqrt(1.0 - share)
    lobe = plastic.lobe
    if choice < GLOSSY * lobe.weight:
        steep = lobe.width * math.sqrt(-math.log(1.0 - share))
    elif lobe.tail == 0.0:
        steep = math.sqrt(-math.log(1.0 - share))
    else:  # the inverse of 1 − (1 + τ r²)^(−1/τ)
        steep = math.sqrt(math.expm1(-lobe.tail * math.log1p(-share)) / lobe.tail)
    hu, hv = plastic.alpha_u * steep * math.cos(turn), plastic.alpha_v * steep * math.sin(turn)
    size = 1.0 + hu * hu + hv * hv
    twice = 2.0 * (view[0] * hu + view[1] * hv + view[2]) / size
    return twice * hu - view[0], twice * hv - view[1], twice - view[2]


@jit_kernel(inline="always")
def _open(terrain: Terrain, place: Vector, cell: tuple[int, int], way: Vector) -> bool:
    return not meet(terrain, place, cell, way)[0]


@jit_kernel(inline="always")
def _within(terrain: Terrain, place: Vector, beyond_x: float, beyond_y: float) -> bool:
    """Whether a place is within the averaged area, or at most so many columns and rows beyond."""
    x, rows = place[0], terrain.z.shape[0] - 1
    if terrain.period > 0:
        x -= math.floor(x / terrain.period) * terrain.period
    return -beyond_x <= x < terrain.span + beyond_x and -beyond_y <= place[1] < rows + beyond_y


@jit_kernel(inline="always")
def _growth(terrain: Terrain) -> float:
    """Area on which paths from the light begin over that on which paths from the camera do."""
    rows = terrain.z.shape[0] - 1
    return float((1.0 + 2.0 * terrain.beyond_x / terrain.span) * (1.0 + 2.0 * terrain.beyond_y / rows))


@jit_kernel()
def _begin(terrain: Terrain, draws: Draws, course: Course) -> tuple[bool, Facet, Vector]:
    """Whether the origin reaches the facet on which a path begins, that facet, and the direction back there."""
    beyond_x, beyond_y = (0.0, 0.0) if course.ahead else (terrain.beyond_x, terrain.beyond_y)
    y = _draw(draws, 0) * (terrain.z.shape[0] - 1 + 2.0 * beyond_y) - beyond_y
    x = _draw(draws, 1) * (terrain.span + 2.0 * beyond_x) - beyond_x
    row, col = math.floor(y), math.floor(x)
    gx, gy = slopes(terrain, row, col, x - col, y - row)
    frame, cell = facet_frame(gx, gy, terrain.turn), (row, col)
    place = x, y, height(terrain, row, col, x - col, y - row)
    view = to_facet(frame, course.origin)
    reached = view[2] > 0.0  # false where NaN
    if reached and not course.origin_open:
        reached = _open(terrain, place, cell, course.origin)
    return reached, (frame, place, cell), view


@jit_kernel()
def _gather(
    terrain: Terrain,
    plastic: Plastic,
    facet: Facet,
    view: Vector,
    course: Course,
    shares: tuple[float, float, float],
    sums: FloatArray,
) -> None:
    """Add what a path finds at a facet toward each end of its course.

    ``shares`` are what the path carries, its density, and the factor of the density of its reverse, 0 for none.
    """
    frame, place, cell = facet
    carried, own, reverse = shares
    ends = course.ends
    for end in range(len(ends)):
        to_end = ends[end, 0], ends[end, 1], ends[end, 2]
        local = to_facet(frame, to_end)
        value, lobe = reflectance(local, view, plastic)
        if value > 0.0 and (course.ends_open[end] or _open(terrain, place, cell, to_end)):
            weight = own / (own + reverse * drawn_density(lobe, view[2]) / frame[2])
            sums[end] += weight * carried * value * local[2]


@jit_kernel(inline="always")
def _survival(share: float, count: int) -> float:
    """Russian roulette; before the fourth facet it would leave glossy-diffuse-glossy light to a few paths."""
    return min(1.0, share) if count > 3 else 1.0


@jit_kernel()
def _follow(
    terrain: Terrain,
    plastic: Plastic,
    draws: Draws,
    course: Course,
    sums: FloatArray,
) -> None:
    """One path; adds what it finds toward each end to ``sums``. From the light, it counts where it ends on the map."""
    reached, facet, view = _begin(terrain, draws, course)
    if not reached:
        return
    ahead = course.ahead
    end_x, end_y = (terrain.beyond_x, terrain.beyond_y) if ahead else (0.0, 0.0)
    growth = 1.0 if ahead else _growth(terrain)
    reverse = growth if not ahead else 1.0 / _growth(terrain)
    frame = facet[0]
    carried, own = growth * frame[2] * view[2], 1.0 / frame[2]
    for count in range(2, course.depth + 1):
        dimension = 4 * count - 6
        way = _leave(view, plastic, draws, dimension)
        value, lobe = reflectance(view, way, plastic)
        density = drawn_density(lobe, way[2])
        if value <= 0.0 or density <= 0.0:
            return
        if count > 2:
            own /= drawn_density(lobe, view[2])
        share = value * way[2] / density
        alive = _survival(share, count)
        if _draw(draws, dimension + 3) >= alive:
            return
        carried *= share / alive
        frame, place, cell = facet
        ray = from_facet(frame, way)
        met, hit_x, hit_y, hit_z, row, col = meet(terrain, place, cell, ray)
        if not met:
            return
        gx, gy = slopes(terrain, row, col, hit_x - col, hit_y - row)
        frame = facet_frame(gx, gy, terrain.turn)
        facet = frame, (hit_x, hit_y, hit_z), (row, col)
        view = to_facet(frame, (-ray[0], -ray[1], -ray[2]))
        if view[2] <= 0.0:
            return
        own *= density * view[2] / way[2]
        counted = _within(terrain, facet[1], end_x, end_y)
        if ahead or counted:
            shares = carried, own, reverse if counted else 0.0
            _gather(terrain, plastic, facet, view, course, shares, sums)


@jit_kernel(nogil=True)
def follow_paths(
    terrain: Terrain,
    plastic: Plastic,
    shifts: FloatArray,
    count: int,
    course: Course,
    sums: FloatArray,
) -> None:
    """Sum over paths of what arrives from each end in the direction of the origin.

    Args:
        terrain: the map.
        plastic: the material.
        shifts: (R, D) shifts of the lattice, one a replicate.
        count: paths of each replicate, a power of two.
        course: where they begin and end.
        sums: (R, K) radiances times the cosine between camera and z, per irradiance perpendicular to the beam;
            added to.
    """
    for replicate in range(len(shifts)):
        for number in range(count):
            draws = Draws(number, count, shifts[replicate])
            _follow(terrain, plastic, draws, course, sums[replicate])
