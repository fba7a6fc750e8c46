"""Histogram of the slopes of a height map, shared by many poses (see `census_kernels`)."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.material import Material
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light import threads
from anisoscope.sim.light.horizon import Horizon
from anisoscope.sim.light.shine import Shine

Floats = npt.NDArray[np.float32]
Cells = tuple[npt.NDArray[np.int64], FloatArray]
Facets = Literal["symmetric", "diagonal", "antidiagonal"]

FACETS: tuple[Facets, ...] = ("symmetric", "diagonal", "antidiagonal")
NODES_PER_ALPHA = 8.0
BANDS = 8  # bands of rows that are counted side by side; fixed, so that sums do not depend on the machine
MOST_NODES = 1000  # on one axis; normals beyond are evaluated facet by facet
COARSEST = 0.05  # distance of nodes, so that the few normals near the horizon, where sizes grow, stay exact


def node_spacing(material: Material, direction_deg: float = 0.0) -> tuple[float, float]:
    """Distances of the nodes along u and v: an eighth of the roughness; in steps of √2, so that close values share.

    Lobes with a tail are more peaked: the fourth derivative of P at its centre, of which the error of the cubics is a
    multiple, is (1 + τ)(1 + 2τ) times that of Beckmann's lobe.
    """
    tail, (_, width) = material.tail, material.second_lobe or (0.0, 1.0)
    peaked = ((1.0 + tail) * (1.0 + 2.0 * tail)) ** 0.25
    alphas = [alpha * min(1.0, width) / peaked for alpha in (material.alpha_across, material.alpha_along)]
    if direction_deg != 0.0:
        alphas = [min(alphas)] * 2
    distances = [min(alpha / NODES_PER_ALPHA, COARSEST) for alpha in alphas]
    steps = [2.0 ** (np.floor(2.0 * np.log2(distance)) / 2.0) for distance in distances]
    return float(steps[0]), float(steps[1])


@dataclass(frozen=True, eq=False)
class Census:
    """The facets of a map, counted by normal; u and v are coordinates of normals (`census_kernels.projected`).

    Attributes:
        u: (R, C) coordinates across; R = rows, or twice the rows where cells are split into triangles.
        v: (R, C) coordinates along. NaN in u: not counted here.
        weights: (C,) weights of the columns in a mean, halved for triangles.
        grid: first node and number of nodes per unit along u, the same along v.
        nodes: (N, 2) slopes of the nodes that facets touch.
        where: (N,) places of these nodes in the flattened grid.
        shape: nodes along v and u.
        weight: (N,) how much surface there is at each node.
        edges: cells that straddle an edge, counted as their two parts, as `census_kernels.facets_left` gives them.
        apart: cells evaluated one by one, likewise.
        total: weight of all facets with known heights.
        rows: rows of cells.
    """

    u: Floats
    v: Floats
    weights: FloatArray
    grid: FloatArray
    nodes: FloatArray
    where: npt.NDArray[np.intp]
    shape: tuple[int, int]
    weight: FloatArray
    edges: Cells
    apart: Cells
    total: float
    rows: int

    def band(self, first: int, last: int) -> "Census":
        """Census of the rows of cells from ``first`` to before ``last``, for the light hidden in them."""
        parts = 2 if len(self.u) > self.rows else 1
        u, v = (
            a.reshape(parts, self.rows, -1)[:, first:last].reshape(parts * (last - first), -1)
            for a in (self.u, self.v)
        )
        return replace(
            self,
            u=u,
            v=v,
            rows=last - first,
            edges=_in(self.edges, first, last),
            apart=_in(self.apart, first, last),
        )


def _in(cells: Cells, first: int, last: int) -> Cells:
    """Entries of some rows, counted from the first of them."""
    where, slopes = cells
    inside = (where[:, 0] >= first) & (where[:, 0] < last)
    return where[inside] - np.array([first, 0]), slopes[inside]


def take_census(
    surface: HeightMap,
    facets: Facets,
    column_weights: FloatArray,
    spacing: tuple[float, float],
    steepest: FloatArray,
) -> Census:
    """Count the facets of a map.

    Args:
        surface: the map, (rows, cols).
        facets: how cells become facets.
        column_weights: (cols − 1,) weights of the columns in a mean.
        spacing: distances of the nodes along u and v.
        steepest: lowest and highest slope along x, lowest and highest along y.
    """
    from anisoscope.sim.light import census_kernels as kernels  # noqa: PLC0415 - numba when first needed

    triangles = FACETS.index(facets)
    z = np.ascontiguousarray(surface.height_um, dtype=np.float64)
    shown = z, surface.pixel_x_um, surface.pixel_y_um, triangles
    limits = _limits(surface, spacing, steepest)
    rows, cols = z.shape[0] - 1, z.shape[1] - 1
    facets_shape = (rows if triangles == 0 else 2 * rows, cols)
    u, v = np.empty(facets_shape, dtype=np.float32), np.empty(facets_shape, dtype=np.float32)
    left = np.empty(facets_shape[0], dtype=np.int64)
    threads.each(lambda run: kernels.normals(*shown, limits, *run, u, v, left), threads.runs(rows, BANDS))
    where, slopes, held = kernels.facets_left(*shown, limits, u, v, left)
    edges, apart = (where[held], slopes[held]), (where[~held], slopes[~held])
    weights = column_weights if triangles == 0 else 0.5 * column_weights
    steps = np.array(spacing)
    first = limits[::2] - 2.0 * steps
    grid = np.stack([first, 1.0 / steps], axis=-1).ravel()
    columns, lines = ((limits[1::2] - first) / steps).astype(int) + 4
    shape = int(lines), int(columns)
    found, cells = np.zeros((BANDS + 1, *shape)), np.zeros((BANDS + 1, *shape), dtype=np.bool_)

    def count_band(band: tuple[int, tuple[int, int]]) -> None:
        number, run = band
        kernels.count(u[slice(*run)], v[slice(*run)], weights, grid, found[number], cells[number])

    threads.each(count_band, enumerate(threads.runs(len(u), BANDS)))
    kernels.count(*kernels.edge_parts(*edges, weights), grid, found[BANDS], cells[BANDS])
    at = np.flatnonzero(_around(np.any(cells, axis=0)))
    row, col = np.divmod(at, shape[1])
    nodes = kernels.slopes_at(first[0] + col * steps[0], first[1] + row * steps[1])
    weight = found.sum(axis=0).ravel()[at]
    missing = np.isnan(v).sum(axis=0) if left.any() else np.zeros(cols)
    total = float((len(v) - missing) @ weights)
    return Census(u, v, weights, grid, nodes, at, shape, weight, edges, apart, total, rows)


def _limits(surface: HeightMap, spacing: tuple[float, float], steepest: FloatArray) -> FloatArray:
    """Lowest and highest u, lowest and highest v, of the grid: all normals, or as many as it may hold.

    A grid that cannot hold all lies around the median slope of a sample of the map.
    """
    z = surface.height_um
    rows = z[:: max(1, z.shape[0] // 200)]
    cols = z[:, :: max(1, z.shape[1] // 200)]
    slopes = np.diff(rows, axis=1) / surface.pixel_x_um, np.diff(cols, axis=0) / surface.pixel_y_um
    limits = []
    for slope, step, ends in zip(slopes, spacing, steepest.reshape(2, 2), strict=True):
        low, high = 2.0 * ends / (1.0 + np.hypot(1.0, ends)) + np.array([-0.5, 0.5]) * step
        if high - low > MOST_NODES * step:
            known = slope[np.isfinite(slope)]
            median = float(np.median(known)) if known.size else 0.0
            centre = 2.0 * median / (1.0 + np.hypot(1.0, median))
            low, high = (
                max(low, centre - 0.5 * MOST_NODES * step),
                min(high, centre + 0.5 * MOST_NODES * step),
            )
        limits += [low, high]
    return np.array(limits)


def _around(cells: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Nodes that the cubics of some cells use: one before each, and two after."""
    for axis in (0, 1):
        cells = cells | np.roll(cells, -1, axis) | np.roll(cells, 1, axis) | np.roll(cells, 2, axis)
    return cells


def shine_at_nodes(census: Census, shine: Shine) -> FloatArray:
    """(N,) what the nodes of the grid shine, all of it lit and seen."""
    from anisoscope.sim.light.census_kernels import shine_at  # noqa: PLC0415 - start-up time

    values = np.empty(len(census.nodes))
    shine_at(census.nodes, shine, values)
    return values


def _sky(census: Census, at_nodes: FloatArray) -> Floats:
    """The values of the nodes on the whole grid, zero elsewhere."""
    sky = np.zeros(census.shape, dtype=np.float32)
    sky.ravel()[census.where] = at_nodes
    return sky


def added(census: Census, shine: Shine, horizon: Horizon, at_nodes: FloatArray) -> float:
    """Loss by shadows from the sum over the counted facets, all lit and seen, and gain by facets apart.

    Args:
        census: of the map, or of a band of its rows.
        shine: the pose.
        horizon: of the same map, or band.
        at_nodes: (N,) what the nodes shine.
    """
    from anisoscope.sim.light import census_kernels as kernels  # noqa: PLC0415 - start-up time

    light, camera = np.array(shine.light), np.array(shine.camera)
    shadowed = not (horizon.whole(light) and horizon.whole(camera))
    if not shadowed and not len(census.apart[0]):
        return 0.0
    shares = horizon.shares(light), horizon.shares(camera)
    same_side = float(light[:2] @ camera[:2]) >= 0.0
    found = kernels.apart_shine(*census.apart, census.weights, *shares, same_side, shine)
    if shadowed:
        shown = census.weights, census.grid, _sky(census, at_nodes), *shares
        found -= kernels.hidden(census.u, census.v, *shown, same_side)
        where, slopes = census.edges
        found -= kernels.hidden_edges(where, slopes, *shown, shine.light, shine.camera)
    return float(found)


def cell_radiance(
    census: Census,
    shine: Shine,
    horizon: Horizon,
    places: tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]],
) -> tuple[float, FloatArray]:
    """Mean radiance [1/sr] of the surface in one pose, and that of coarse cells; 0 where no height of a cell is known.

    Args:
        census: of the map.
        shine: the pose.
        horizon: of the same map.
        places: (rows,) and (C,) cell of every row and column of facets, ascending from 0.
    """
    from anisoscope.sim.light import census_kernels as kernels  # noqa: PLC0415 - start-up time

    light, camera = np.array(shine.light), np.array(shine.camera)
    at_nodes = shine_at_nodes(census, shine)
    mean = (float(census.weight @ at_nodes) + added(census, shine, horizon, at_nodes)) / census.total
    shares = horizon.shares(light), horizon.shares(camera)
    same_side = float(light[:2] @ camera[:2]) >= 0.0
    rows, cols = places
    known = ~np.isnan(census.v[: len(rows)])
    by_row = np.add.reduceat(known, np.flatnonzero(np.diff(rows, prepend=-1)), axis=0, dtype=np.int64)
    count = np.add.reduceat(by_row, np.flatnonzero(np.diff(cols, prepend=-1)), axis=1)
    total = np.zeros(count.shape)
    kernels.counted_in_cells(
        census.u, census.v, census.grid, _sky(census, at_nodes), *shares, same_side, *places, total
    )
    part = len(rows) / len(census.u)
    for where, slopes in (census.edges, census.apart):
        kernels.left_in_cells(where, slopes, part, *shares, same_side, shine, *places, total)
    return mean, np.asarray(total / np.maximum(count, 1))
