"""How often a height map has which slope: what many poses share (see `census_kernels`)."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light import threads
from anisoscope.sim.light.material import Material, diffuse_scale, fresnel, transmittance_table

FloatArray = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]
Facets = Literal["symmetric", "diagonal", "antidiagonal"]

FACETS: tuple[Facets, ...] = ("symmetric", "diagonal", "antidiagonal")
NODES_PER_ALPHA = 10.0
BANDS = 8  # bands of rows that are counted side by side; fixed, so that sums do not depend on the machine
MOST_NODES = 1000  # on one axis; slopes beyond are evaluated facet by facet


def node_spacing(material: Material) -> tuple[float, float]:
    """Distances of the nodes along x and y: a tenth of the roughness; in steps of √2, so that close values share."""
    alphas = material.alpha_across, material.alpha_along
    steps = [2.0 ** (np.floor(2.0 * np.log2(alpha / NODES_PER_ALPHA)) / 2.0) for alpha in alphas]
    return float(steps[0]), float(steps[1])


@dataclass(frozen=True, eq=False)
class Census:
    """The facets of a map, counted by slope.

    Attributes:
        gx: (R, C) slopes along x; R = rows, or twice the rows where cells are split into triangles.
        gy: (R, C) slopes along y.
        kind: (R, C) MISSING, COUNTED or APART.
        weights: (C,) weights of the columns in a mean, halved for triangles.
        grid: first node and distance of nodes along x, the same along y.
        nodes: (N, 2) slopes of the nodes that facets touch.
        where: (N,) places of these nodes in the flattened grid.
        shape: nodes along y and x.
        weight: (N,) how much surface there is at each node.
        apart: (M, 2) row and column of the cells evaluated one by one.
        apart_slopes: (M, 4) slopes along x before and after an edge, share of the first, slope along y.
        total: weight of all facets with known heights.
    """

    gx: Floats
    gy: Floats
    kind: npt.NDArray[np.uint8]
    weights: FloatArray
    grid: FloatArray
    nodes: FloatArray
    where: npt.NDArray[np.intp]
    shape: tuple[int, int]
    weight: FloatArray
    apart: npt.NDArray[np.int64]
    apart_slopes: FloatArray
    total: float


def take_census(
    surface: HeightMap, facets: Facets, column_weights: FloatArray, spacing: tuple[float, float]
) -> Census:
    """Count the facets of a map.

    Args:
        surface: the map, (rows, cols).
        facets: how cells become facets.
        column_weights: (cols − 1,) weights of the columns in a mean.
        spacing: distances of the nodes along x and y.
    """
    from anisoscope.sim.light import census_kernels as kernels  # noqa: PLC0415 - numba when first needed

    triangles = FACETS.index(facets)
    pixels = surface.pixel_x_um, surface.pixel_y_um
    limits = _limits(surface, spacing)
    z = np.ascontiguousarray(surface.height_um, dtype=np.float64)
    rows, cols = z.shape[0] - 1, z.shape[1] - 1
    facets_shape = (rows if triangles == 0 else 2 * rows, cols)
    gx, gy = np.empty(facets_shape, dtype=np.float32), np.empty(facets_shape, dtype=np.float32)
    kind = np.empty(facets_shape, dtype=np.uint8)
    threads.each(
        lambda run: kernels.facet_slopes(z, *pixels, triangles, limits, run[0], run[1], gx, gy, kind),
        threads.runs(rows, BANDS),
    )
    apart, apart_slopes = kernels.facets_apart(z, *pixels, triangles, kind)
    weights = column_weights if triangles == 0 else 0.5 * column_weights
    box = kernels.extent(gx, gy, kind)
    grid = np.array([box[0] - 2.0 * spacing[0], spacing[0], box[2] - 2.0 * spacing[1], spacing[1]])
    shape = int((box[3] - grid[2]) / spacing[1]) + 4, int((box[1] - grid[0]) / spacing[0]) + 4
    found = np.full((BANDS, *shape), np.nan)
    bands = list(enumerate(threads.runs(gx.shape[0], BANDS)))

    def count_band(band: tuple[int, tuple[int, int]]) -> None:
        part = slice(*band[1])
        kernels.count(gx[part], gy[part], kind[part], weights, grid, found[band[0]])

    threads.each(count_band, bands)
    touched = np.isfinite(found).any(axis=0)
    where = np.flatnonzero(touched)
    row, col = np.divmod(where, shape[1])
    nodes = np.stack([grid[0] + col * grid[1], grid[2] + row * grid[3]], axis=-1)
    weight = np.nansum(found[:, touched], axis=0)
    total = float((kind != kernels.MISSING).sum(axis=0) @ weights)
    return Census(gx, gy, kind, weights, grid, nodes, where, shape, weight, apart, apart_slopes, total)


def _limits(surface: HeightMap, spacing: tuple[float, float]) -> FloatArray:
    """Slopes that the grid can hold, around the median slope of a sample of the map."""
    z = surface.height_um
    rows = z[:: max(1, z.shape[0] // 200)]
    cols = z[:, :: max(1, z.shape[1] // 200)]
    slopes = np.diff(rows, axis=1) / surface.pixel_x_um, np.diff(cols, axis=0) / surface.pixel_y_um
    limits = []
    for slope, step in zip(slopes, spacing, strict=True):
        known = slope[np.isfinite(slope)]
        centre = float(np.median(known)) if known.size else 0.0
        limits += [centre - 0.5 * MOST_NODES * step, centre + 0.5 * MOST_NODES * step]
    return np.array(limits)


@dataclass(frozen=True, eq=False)
class Shine:
    """What facets of one material shine in one pose: arguments of the kernels."""

    light: FloatArray
    camera: FloatArray
    half: FloatArray
    lobe: FloatArray
    table: FloatArray

    @classmethod
    def of(cls, light: FloatArray, camera: FloatArray, material: Material) -> "Shine":
        """For (3,) unit vectors to light and camera."""
        half = light + camera
        half = half / np.linalg.norm(half)
        mirror = float(fresnel(np.asarray(light @ half), material.index))
        alpha = material.alpha_along, material.alpha_across
        lobe = np.array([mirror / (4.0 * np.pi * alpha[0] * alpha[1]), *alpha, diffuse_scale(material)])
        return cls(light, camera, half, lobe, transmittance_table(material))


def mean_radiance(census: Census, shine: Shine, lit: Floats, seen: Floats) -> float:
    """Mean radiance [1/sr] of the surface in one pose; ``lit`` and ``seen`` are (rows, C) shares of the cells."""
    from anisoscope.sim.light import census_kernels as kernels  # noqa: PLC0415

    arguments = shine.light, shine.camera, shine.half, shine.lobe, shine.table
    at_nodes = kernels.shine_at(census.nodes, *arguments)
    sky = np.zeros(census.shape, dtype=np.float32)
    sky.ravel()[census.where] = at_nodes
    same_side = float(shine.light[:2] @ shine.camera[:2]) >= 0.0
    lost = kernels.hidden(
        census.gx, census.gy, census.kind, census.weights, census.grid, sky, lit, seen, same_side
    )
    total = float(census.weight @ at_nodes - lost)
    apart = kernels.apart_shine(
        census.apart, census.apart_slopes, census.weights, lit, seen, same_side, *arguments
    )
    total += apart
    return total / census.total
