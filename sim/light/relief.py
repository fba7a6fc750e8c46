"""Radiance predicted from a height map, facet by facet.

Every four neighbouring points form a facet with the normal of its symmetric gradients (or two triangles), the lobe
of its *unresolved* roughness, and a Lambertian base. Which part of it is both lit and seen follows from the horizon
along the azimuths of light and camera (`horizon_kernels`). The map is never rotated: the directions are.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from threading import Lock

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, ModelError
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.material import Material
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light import threads
from anisoscope.sim.light.census import (
    FACETS,
    Census,
    Facets,
    added,
    cell_radiance,
    node_spacing,
    shine_at_nodes,
    take_census,
)
from anisoscope.sim.light.horizon import Horizon, SharesOfSmallMap, bands
from anisoscope.sim.light.shine import Shine, shine_in, turn_of

ShareArray = npt.NDArray[np.float32]

MAX_MISSING_SHARE = 0.25
POSES_AT_ONCE = 16  # of which the values at the nodes of the census are held


@dataclass(frozen=True)
class Relief:
    """A height map prepared for prediction.

    Attributes:
        surface: the map, levelled.
        pitch_um: distance along x after which the surface repeats, or None. With it, shadows cast from
            beyond the edge are taken from inside the map, and means run over whole pitches.
        max_missing_share: share of missing facets above which prediction is refused.
        facets: "symmetric": four points form one facet with the symmetric gradients; facets that straddle an edge
            across x are split. "diagonal": each cell is two triangles, split along the diagonal from (row, col) to
            (row + 1, col + 1); "antidiagonal": along the other. A mesh of these triangles is the same surface.
        direction_deg: direction of the ridges, counter-clockwise from +y: the lobe's frame on the map.
        turn_deg: azimuth on the map of the sample frame's x axis, in which directions to light and camera are given.
            0: they are those of the map, whatever the direction of the ridges.

    Raises:
        ModelError: no such kind of facets.
        HeightMapError: too much of the map is missing, or it is smaller than one period.
    """

    surface: HeightMap
    pitch_um: float | None = None
    max_missing_share: float = MAX_MISSING_SHARE
    facets: Facets = "symmetric"
    direction_deg: float = 0.0
    turn_deg: float = 0.0

    def __post_init__(self) -> None:
        if self.facets not in FACETS:
            raise ModelError(f"facets are {', '.join(FACETS)}, not {self.facets!r}")
        missing = self.missing_share
        if missing > self.max_missing_share:
            raise HeightMapError(
                f"{missing:.1%} of the facets of this height map are missing (limit {self.max_missing_share:.0%}): "
                "measure it again, or fill the gaps in the instrument's software"
            )
        if self.pitch_um is not None and self._columns_per_pitch > self.surface.shape[1] - 1 + 1e-6:
            width = (self.surface.shape[1] - 1) * self.surface.pixel_x_um
            raise HeightMapError(
                f"the height map is {width:g} µm wide, less than one pitch of {self.pitch_um:g} µm: "
                "a prediction needs at least one whole ridge"
            )

    @property
    def _columns_per_pitch(self) -> float:
        assert self.pitch_um is not None
        return self.pitch_um / self.surface.pixel_x_um

    @cached_property
    def missing_share(self) -> float:
        """Share of facets without a height at one of their corners."""
        known = np.isfinite(self.surface.height_um)
        whole = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
        return float(1.0 - whole.mean())

    def on_map(self, directions: FloatArray) -> FloatArray:
        """(P, 3) directions in the sample frame, on the axes of the map."""
        if self.turn_deg == 0.0:
            return directions
        cos, sin = turn_of(self.turn_deg)
        x, y, z = np.asarray(directions).T
        return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)

    @property
    def pixels_um(self) -> tuple[float, float]:
        """Distances of columns and of rows."""
        return self.surface.pixel_x_um, self.surface.pixel_y_um

    @cached_property
    def depth_um(self) -> float:
        """Height of the highest point above the lowest."""
        return float(np.nanmax(self.surface.height_um) - np.nanmin(self.surface.height_um))

    @cached_property
    def steepest(self) -> FloatArray:
        """Lowest and highest slope along x, lowest and highest along y, from point to point, and where it repeats."""
        from anisoscope.sim.light.census_kernels import steepest  # noqa: PLC0415 - numba when first needed

        z, wrap = self.rows_first, self.wrap_columns()
        bands = threads.runs(z.shape[0] - 1, threads.count())
        rises = np.empty((len(bands), 4, z.shape[1]), dtype=np.float32)
        threads.each(lambda band: steepest(z, *band[1], rises[band[0]]), enumerate(bands))
        if wrap > 0:
            seams = np.stack([z[:, 0] - z[:, wrap - 1], z[:, z.shape[1] - wrap] - z[:, -1]])
            known = seams[np.isfinite(seams)]
            rises[0, 0, -1], rises[0, 1, -1] = known.min(initial=np.inf), known.max(initial=-np.inf)
        lowest, highest = rises[:, ::2].min(axis=(0, 2)), rises[:, 1::2].max(axis=(0, 2))
        slopes = np.stack([lowest, highest], axis=-1).ravel() / np.repeat(self.pixels_um, 2)
        return np.asarray(slopes, dtype=np.float64)

    @cached_property
    def rows_first(self) -> ShareArray:
        """(rows, cols) heights above the middle, in single precision for the horizon."""
        height = self.surface.height_um
        return np.asarray(height - (np.nanmin(height) + 0.5 * self.depth_um), dtype=np.float32)

    @cached_property
    def _columns_first(self) -> ShareArray:
        return np.ascontiguousarray(self.rows_first.T)

    def columns_first(self, low: int, high: int) -> ShareArray:
        """(cols, high − low + 1) heights above the middle of the rows from ``low`` to ``high``."""
        whole = high - low + 1 == len(self.rows_first)
        return self._columns_first if whole else np.ascontiguousarray(self.rows_first[low : high + 1].T)

    @cached_property
    def shares(self) -> SharesOfSmallMap:
        """Visible shares that are known already."""
        return SharesOfSmallMap(self.surface.height_um.size)

    def census(self, material: Material) -> Census:
        """The facets counted by slope, on a grid fine enough for the roughness of a material."""
        spacing = node_spacing(material, self.direction_deg)
        cached = self.__dict__.get("_census")
        if cached is None or cached[0] != spacing:
            cached = (
                spacing,
                take_census(self.surface, self.facets, self.column_weights(), spacing, self.steepest),
            )
            self.__dict__["_census"] = cached
        return cached[1]

    def column_weights(self) -> FloatArray:
        """(cols − 1,) weights of the facet columns in a mean: whole pitches, the last column in part."""
        columns = self.surface.shape[1] - 1
        weights = np.ones(columns)
        if self.pitch_um is not None:
            span = np.floor(columns / self._columns_per_pitch + 1e-6) * self._columns_per_pitch
            weights = np.clip(span - np.arange(columns), 0.0, 1.0)
        return weights

    def wrap_columns(self) -> int:
        """Columns after which the surface repeats, rounded; 0 if unknown."""
        if self.pitch_um is None:
            return 0
        columns = self.surface.shape[1] - 1
        return round(float(np.floor(columns / self._columns_per_pitch + 1e-6)) * self._columns_per_pitch)


def radiance_maps(
    relief: Relief, to_light: FloatArray, to_camera: FloatArray, material: Material
) -> Iterator[ShareArray]:
    """For each pose, what every facet adds to the radiance per macroscopic area [1/sr].

    Args:
        relief: the surface.
        to_light: (P, 3) unit vectors in the frame of the sample.
        to_camera: (P, 3) unit vectors in the frame of the sample.
        material: the plastic, with the roughness that the map does *not* resolve.

    Yields:
        P maps (rows − 1, cols − 1), NaN where the height is missing; their mean is the radiance.

    Raises:
        ModelError: light or camera stands at or below the horizon of the sample.
    """
    return shine_maps(
        relief,
        (
            shine_in(*pose, material, relief.direction_deg)
            for pose in zip(relief.on_map(to_light), relief.on_map(to_camera), strict=True)
        ),
    )


def shine_maps(relief: Relief, shines: Iterable[Shine]) -> Iterator[ShareArray]:
    """As `radiance_maps`, for poses and materials together, as kernels take them."""
    from anisoscope.sim.light.kernels import facet_radiance  # noqa: PLC0415 - start-up time

    z = np.ascontiguousarray(relief.surface.height_um, dtype=np.float64)
    horizon = Horizon(relief, relief.shares)
    for shine in shines:
        lit, seen = horizon.shares(np.array(shine.light)), horizon.shares(np.array(shine.camera))
        shown = np.empty(lit.shape, dtype=np.float32)

        def fill(run: tuple[int, int]) -> None:
            facet_radiance(
                z,
                relief.surface.pixel_x_um,
                relief.surface.pixel_y_um,
                FACETS.index(relief.facets),
                shine,  # noqa: B023 - called before the next pose
                lit,  # noqa: B023
                seen,  # noqa: B023
                run[0],
                run[1],
                shown,  # noqa: B023
            )

        threads.each(fill, threads.runs(len(shown), threads.count()))
        yield shown


def radiance(
    relief: Relief,
    to_light: FloatArray,
    to_camera: FloatArray,
    material: Material,
    progress: Advance = silent,
) -> FloatArray:
    """Mean radiance [1/sr] of the surface per unit irradiance perpendicular to the beam, direct light.

    Missing facets are left out; with a known pitch the mean runs over whole pitches. Facets are counted by slope
    once, so that each further pose costs little more than its shadows. Shadows of a large map are found a band of rows
    at a time: the memory is that of the census, the size of the map, and does not grow with the poses.

    Args:
        relief: the surface.
        to_light: (P, 3) unit vectors in the frame of the sample.
        to_camera: (P, 3) unit vectors in the frame of the sample.
        material: the plastic, with the roughness that the map does *not* resolve.
        progress: called after each pose.

    Returns:
        (P,) values.

    Raises:
        ModelError: light or camera stands at or below the horizon of the sample.
    """
    census = relief.census(material)
    shines = [
        shine_in(*pose, material, relief.direction_deg)
        for pose in zip(relief.on_map(to_light), relief.on_map(to_camera), strict=True)
    ]
    rows = bands(relief.surface.shape)
    if len(rows) == 1:
        relief.columns_first(*rows[0])  # prepared once, before threads share it
    idle, lock, done = list[Horizon](), Lock(), 0

    def predict(work: tuple[tuple[int, int], range]) -> FloatArray:
        """Hidden light of a band of rows, in each of some poses."""
        nonlocal done
        band, some = work
        part = census if len(rows) == 1 else census.band(*band)
        horizon = idle.pop() if idle else Horizon(relief, relief.shares, None if len(rows) == 1 else band)
        found = np.zeros(len(some))
        for place, pose in enumerate(some):
            found[place] = added(part, shines[pose], horizon, at_nodes[pose % POSES_AT_ONCE])
            with lock:
                done += 1
                progress("predicting poses", done // len(rows), len(shines))
        if len(rows) == 1:
            idle.append(horizon)
        return found

    total = np.zeros(len(shines))
    for first in range(0, len(shines), POSES_AT_ONCE):
        group = range(len(shines))[first : first + POSES_AT_ONCE]
        at_nodes = threads.each(partial(shine_at_nodes, census), [shines[pose] for pose in group])
        shares = [group[place : place + 1] for place in range(len(group))] if len(rows) == 1 else [group]
        hidden = np.concatenate(threads.each(predict, product(rows, shares))).reshape(len(rows), -1)
        total[group.start : group.stop] = sum(hidden) + [float(census.weight @ nodes) for nodes in at_nodes]
    return total / census.total


def radiance_of_cells(
    relief: Relief, to_light: FloatArray, to_camera: FloatArray, material: Material, side_um: float
) -> tuple[FloatArray, FloatArray]:
    """Mean radiance [1/sr] of the surface, and of square cells that are larger than its points.

    Both from the count of slopes, to a few 1e-5 of the lobe's peak, in a fraction of the time of `radiance_maps`.

    Args:
        relief: the surface.
        to_light: (P, 3) unit vectors in the frame of the sample.
        to_camera: (P, 3) unit vectors in the frame of the sample.
        material: the plastic, with the roughness that the map does *not* resolve.
        side_um: side of a cell.

    Returns:
        (P,) means as of `radiance`; (P, cell rows, cell cols), 0 where no height of a cell is known.

    Raises:
        ModelError: light or camera stands at or below the horizon of the sample.
    """
    census, horizon = relief.census(material), Horizon(relief, relief.shares)
    pixel_x, pixel_y = relief.pixels_um
    rows, cols = relief.surface.shape
    places = (
        (np.arange(rows - 1) * pixel_y / side_um).astype(np.int64),
        (np.arange(cols - 1) * pixel_x / side_um).astype(np.int64),
    )
    found = [
        cell_radiance(census, shine_in(*pose, material, relief.direction_deg), horizon, places)
        for pose in zip(relief.on_map(to_light), relief.on_map(to_camera), strict=True)
    ]
    return np.array([mean for mean, _ in found]), np.array([cells for _, cells in found])
