"""Fit of wall and crest of ridges to the heights about the wall: place, draft and radius."""

from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import principal
from anisoscope.parameters.ridges import STEEPEST_DRAFT_DEG, RidgeDesign

DRAFT_U_DEG = 6.0
"""Of a wall of which the map shows nothing, about the perpendicular one: walls stand within 0° and 20°."""
RADIUS_UM, RADIUS_U_UM = 0.75, 0.75
"""Of a crest of which the map shows nothing."""
LARGEST_RADIUS = 0.2  # of the pitch

WINDOW_PIXELS, WINDOW_SHARE = 6.0, 0.06  # points of the fit on either side of the wall; of the pitch at least
BINS_A_PIXEL = 8
FEWEST_PLACES = 4
PLACES, GRID, ZOOMS = 31, 11, 8  # of the grid of places, of drafts and radii; how often it is narrowed
DEEP, SETTLED = 14.0, 0.5
"""Of the posterior: −2 ln of what is left out; share of the grid that is not narrowed further."""
STEEP_DEG, MOST_DRAFT_DEG = 25.0, 35.0
LEAST_SIGMA, PLACE_SIGMA = 0.005, 0.03  # of a pixel: of heights in a bin, and of its place
MISFIT = 0.08  # of the height of the ridges: rms of the heights about the fitted profile


@dataclass(frozen=True, eq=False)
class WallFit:
    """Wall and crest of ridges with one top.

    Attributes:
        top: the ridges with this top, whose wall and radius are not looked at.
        mean: (3,) place of the wall in µm, its draft in degrees and the radius of the crest in µm.
        steps: (3, 3) their principal standard deviations.
        misfit: rms of the heights about the best profile in µm.
        square: χ² of the best profile.
    """

    top: RidgeDesign
    mean: FloatArray
    steps: FloatArray
    misfit: float
    square: float

    @property
    def design(self) -> RidgeDesign:
        """The ridges with the mean wall and crest."""
        return with_wall(self.top, self.mean[1], self.mean[2])


def with_wall(design: RidgeDesign, draft_deg: float, radius_um: float) -> RidgeDesign:
    """The ridges with another wall and crest, within what ridges can have."""
    draft = float(np.clip(draft_deg, 0.0, STEEPEST_DRAFT_DEG))
    design = replace(design, wall=draft, edge_radius_um=0.0)
    if design.height_loss > 0.0:
        return design
    most = LARGEST_RADIUS * design.pitch_um
    if design.foot_radius_um > 0.0:
        most = max(0.0, min(most, design.arcs_um - design.foot_radius_um))
    return replace(design, edge_radius_um=float(np.clip(radius_um, 0.0, most)))


def binned_heights(
    offset: FloatArray, height: FloatArray, ridge: FloatArray, pixel: float, half: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n,) places about the wall in µm, median heights of all ridges there, and their standard deviations.

    Args:
        offset: (N,) places of the points about the wall of their ridge in µm.
        height: (N,) heights in µm.
        ridge: (N,) numbers of the ridges.
        pixel: distance of neighbouring points in µm.
        half: largest distance from the wall in µm.
    """
    index = np.floor((offset + half) * BINS_A_PIXEL / pixel).astype(np.intp)
    order = np.lexsort((height, index))
    offset, height, ridge, index = offset[order], height[order], ridge[order], index[order]
    starts = np.flatnonzero(np.diff(index, prepend=-1))
    counts = np.diff(np.append(starts, index.size))
    place = np.add.reduceat(offset, starts) / counts
    low, middle, high = (height[starts + (counts * share).astype(np.intp)] for share in (0.25, 0.5, 0.75))
    even = counts % 2 == 0
    before = height[starts + np.maximum(counts // 2 - 1, 0)]
    median = np.where(even, 0.5 * (middle + before), middle)
    ridges = np.unique(ridge).size
    scatter = (high - low) / 1.349 / np.sqrt(np.minimum(counts, ridges))
    usual = float(np.median(scatter))
    median = np.asarray(median)
    slope = np.gradient(median, place) if place.size > 1 else np.zeros(1)
    if (
        place.size * pixel < BINS_A_PIXEL * half
    ):  # few places, some of which differ by no more than they are known
        ends = (np.interp(place + side * 0.5 * pixel, place, median) for side in (1.0, -1.0))
        slope = np.maximum(np.abs(slope), np.abs(np.subtract(*ends)) / pixel)
    sigma = np.sqrt(
        np.maximum(scatter, usual) ** 2 + pixel**2 * (LEAST_SIGMA**2 + (PLACE_SIGMA * slope) ** 2)
    )
    return place, median, np.asarray(sigma)


def fitted_wall(
    place: FloatArray, height: FloatArray, sigma: FloatArray, plain: RidgeDesign, pixel: float
) -> WallFit:
    """Wall and crest of ridges with one top, fitted to heights about the wall.

    The posterior is summed over a grid of all three, which is narrowed until it holds little else: a wall on which one
    point or none falls has a posterior with edges, of which a least-squares fit knows nothing.

    Args:
        place: (n,) places about the wall in µm.
        height: (n,) heights in µm.
        sigma: (n,) their standard deviations.
        plain: the ridges, with their top.
        pixel: distance of neighbouring points in µm.
    """
    reach = max(2.0 * pixel, plain.wall_width_um)
    largest = min(
        LARGEST_RADIUS * plain.pitch_um, 0.5 * WINDOW_PIXELS * pixel + 0.5 * WINDOW_SHARE * plain.pitch_um
    )
    least = np.array([-reach, 0.0, 0.0])
    most = np.array(
        [reach, STEEPEST_DRAFT_DEG if plain.ridge_angle_deg > STEEP_DEG else MOST_DRAFT_DEG, largest]
    )
    grids = _axes(least, most)
    grids[2] = largest * np.linspace(0.0, 1.0, GRID) ** 2
    narrowed = 0
    while True:
        square, misfit = _squares(place, height, sigma, plain, grids)
        at = np.unravel_index(int(square.argmin()), square.shape)
        birge = max(1.0, float(misfit[at]) / max(place.size - 3, 1))
        depth = (square - square.min()) / birge
        ends, settled = [], True
        for axis, grid in enumerate(grids):
            profile = depth.min(axis=tuple(other for other in range(3) if other != axis))
            inside = np.flatnonzero(profile < DEEP)
            low, high = max(inside[0] - 1, 0), min(inside[-1] + 1, grid.size - 1)
            settled &= bool(high - low >= SETTLED * (grid.size - 1))
            ends.append((grid[low], grid[high]))
        narrowed += 1
        if settled or narrowed == ZOOMS:
            break
        grids = _axes(*(np.array(side) for side in zip(*ends, strict=True)))
    widths = [np.gradient(grid) for grid in grids]
    weight = np.exp(-0.5 * depth) * widths[0][:, None, None] * widths[1][:, None] * widths[2]
    weight /= weight.sum()
    points = np.stack(np.meshgrid(*grids, indexing="ij"), axis=-1).reshape(-1, 3)
    mean = weight.ravel() @ points
    covariance = (points - mean).T @ ((points - mean) * weight.reshape(-1, 1))
    scale = np.array([pixel, DRAFT_U_DEG, RADIUS_U_UM])
    squares, directions = principal(covariance / np.outer(scale, scale))
    steps = np.sqrt(np.maximum(squares, 0.0))[:, None] * directions * scale
    best = [float(grid[index]) for grid, index in zip(grids, at, strict=True)]
    left = height - with_wall(plain, best[1], best[2]).profile(place - best[0])
    return WallFit(plain, mean, np.asarray(steps), float(np.std(left)), float(misfit.min()))


def _axes(least: FloatArray, most: FloatArray) -> list[FloatArray]:
    """Grid of place, draft and radius between two corners."""
    return [np.linspace(a, b, n) for a, b, n in zip(least, most, (PLACES, GRID, GRID), strict=True)]


def _squares(
    place: FloatArray, height: FloatArray, sigma: FloatArray, plain: RidgeDesign, grids: list[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """(places, drafts, radii) sums of squares with what is known before, and those of the heights alone.

    Large misfits count linearly (pseudo-Huber), and the level of the heights is free.
    """
    places, drafts, radii = grids
    heights = np.empty((places.size, drafts.size, radii.size))
    offset = place - places[:, None]
    for j, draft in enumerate(drafts):
        for k, radius in enumerate(radii):
            left = height - with_wall(plain, draft, radius).profile(offset)
            left = (left - np.median(left, axis=1, keepdims=True)) / sigma
            heights[:, j, k] = np.sum(2.0 * (np.sqrt(1.0 + left**2) - 1.0), axis=1)
    before = ((drafts - plain.ridge_angle_deg) / DRAFT_U_DEG)[:, None] ** 2 + (
        (radii - RADIUS_UM) / RADIUS_U_UM
    ) ** 2
    return heights + before, heights
