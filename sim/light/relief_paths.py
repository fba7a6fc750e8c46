"""Light that reflects more than once on a height map, by tracing paths over it.

Paths start evenly on the map and run from facet to facet: the same facets, rough plastic and mean as in `relief`,
whatever their shape. At every facet met, the light of all poses that share the camera's direction is let in, if it
is not in shadow. Light that reflects exactly twice is followed from both ends, with the weights of the balance
heuristic (`relief_paths_kernels`); from three reflections on, paths end by Russian roulette, so that nothing is
left out. Places and directions come from shifted lattices, always the same; the scatter of independent shifts
gives the standard error.
"""

from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.material import Material
from anisoscope.sim.light import threads
from anisoscope.sim.light.census import FACETS
from anisoscope.sim.light.horizon import Horizon
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.shine import plastic_of, turn_of, vector

if TYPE_CHECKING:
    from anisoscope.sim.light.relief_rays import Terrain


PATHS = 32768
REPLICATES = 8
BEYOND = 2.0  # heights of the map beyond its edges from which light is followed back onto it
SCRAMBLE = 20170731  # seed of the shifts: results are the same every time


@dataclass(frozen=True, eq=False)
class Indirect:
    """Light that reflects more than once, per unit irradiance perpendicular to the beam.

    Attributes:
        radiance: (P,) in 1/sr.
        standard_error: (P,) standard error of the tracing, in 1/sr.
    """

    radiance: FloatArray
    standard_error: FloatArray


def _groups(directions: FloatArray) -> list[list[int]]:
    """Numbers of equal directions (P, 3), together."""
    groups: dict[bytes, list[int]] = {}
    for number, direction in enumerate(np.round(directions, 12) + 0.0):
        groups.setdefault(direction.tobytes(), []).append(number)
    return list(groups.values())


def _check(to_light: FloatArray, to_camera: FloatArray, bounces: int | None, paths: int) -> None:
    if bounces is not None and bounces < 1:
        raise ModelError(f"light reflects at least once, not {bounces} times")
    if paths < 1:
        raise ModelError(f"at least one path must be followed, not {paths}")
    if np.shape(to_light) != np.shape(to_camera) or np.shape(to_light)[1:] != (3,):
        raise ModelError(
            f"directions to light and camera must both be (P, 3), not {np.shape(to_light)} and {np.shape(to_camera)}"
        )
    if np.any(to_light[:, 2] < 1e-3) or np.any(to_camera[:, 2] < 1e-3):
        raise ModelError("light or camera stands at or below the horizon of the sample")


def _known_share(relief: Relief, span: float) -> float:
    """Share of the facets that are not missing, of those that the mean runs over."""
    if relief.missing_share == 0.0:
        return 1.0
    height = relief.surface.height_um
    known = np.isfinite(height[:-1] + height[1:])
    columns = np.mean(known[:, :-1] & known[:, 1:], axis=0)
    weights = np.clip(span - np.arange(columns.size), 0.0, 1.0)
    return float(columns @ weights / weights.sum())


def _terrain(relief: Relief) -> "Terrain":
    from anisoscope.sim.light.relief_blocks import ceilings  # noqa: PLC0415 - numba when first needed
    from anisoscope.sim.light.relief_rays import Terrain, bends  # noqa: PLC0415 - start-up time

    heights, period, facets = relief.rows_first, relief.wrap_columns(), FACETS.index(relief.facets)
    pixel_x, pixel_y = relief.pixels_um
    span = float(relief.column_weights().sum())
    none = np.empty((0, 0), dtype=np.float32)
    bulge, part = bends(heights, period, pixel_x) if facets == 0 else (none, none)
    return Terrain(
        z=heights,
        top=float(np.nanmax(heights)),
        period=period,
        span=min(span, float(period)) if period else span,
        beyond_x=0.0 if period else BEYOND * relief.depth_um / pixel_x,
        beyond_y=BEYOND * relief.depth_um / pixel_y,
        pixel_x=pixel_x,
        pixel_y=pixel_y,
        bulge=bulge,
        part=part,
        facets=facets,
        turn=turn_of(relief.direction_deg),
        ceiling=ceilings(heights, bulge, period),
    )


def interreflection(
    relief: Relief,
    to_light: FloatArray,
    to_camera: FloatArray,
    material: Material,
    bounces: int | None = None,
    paths: int = PATHS,
    progress: Advance = silent,
) -> Indirect:
    """Radiance [1/sr] of light that reflects two to ``bounces`` times, per unit irradiance of the beam.

    The mean is that of `relief.radiance`: per macroscopic area, over whole pitches (to the nearest column) where
    the pitch is known, missing facets left out. Along x the map then repeats; beyond its other edges the nearest
    point of the edge goes on, and reflects as the map does. Missing facets neither reflect nor block. Points
    between four heights follow from them linearly; facets have the slopes that `relief` gives them.

    Args:
        relief: the surface.
        to_light: (P, 3) unit vectors in the sample frame, above the horizon.
        to_camera: (P, 3) unit vectors in the sample frame, above the horizon.
        material: the plastic, with the roughness that the map does not resolve.
        bounces: largest number of reflections; None follows all.
        paths: paths per direction, from the camera and again from the light; rounded up to 8 times a power
            of two. The standard error falls about as 1/√paths.
        progress: receives the number of completed directions.

    Returns:
        (P,) radiances and their standard errors.

    Raises:
        ModelError: fewer than one reflection or path, or a direction at or below the horizon.
    """
    to_light, to_camera = np.asarray(to_light, dtype=np.float64), np.asarray(to_camera, dtype=np.float64)
    _check(to_light, to_camera, bounces, paths)
    to_light, to_camera = relief.on_map(to_light), relief.on_map(to_camera)
    poses = len(to_light)
    if bounces == 1 or poses == 0:
        return Indirect(np.zeros(poses), np.zeros(poses))
    from anisoscope.sim.light.relief_paths_kernels import (  # noqa: PLC0415 - numba when first needed
        GENERATOR,
        LONGEST,
        Course,
        follow_paths,
    )

    terrain, plastic = _terrain(relief), plastic_of(material)
    count = 1 << max(0, int(np.ceil(np.log2(paths / REPLICATES))))
    shifts = np.random.default_rng(SCRAMBLE).random((REPLICATES, GENERATOR.size))
    depth = LONGEST if bounces is None else min(bounces, LONGEST)
    found = np.zeros((REPLICATES, poses))
    horizon = Horizon(relief)
    ways = [(to_camera, to_light, True), (to_light, to_camera, False)]
    tasks = [(group, *way) for way in ways for group in _groups(way[0])]
    done, lock = 0, Lock()

    def follow(task: tuple[list[int], FloatArray, FloatArray, bool]) -> FloatArray:
        nonlocal done
        group, origins, all_ends, ahead = task
        origin, ends = origins[group[0]], all_ends[group]
        ends_open = np.array([horizon.whole(end) for end in ends])
        course = Course(vector(origin), horizon.whole(origin), ends, ends_open, depth, ahead)
        sums = np.zeros((REPLICATES, len(ends)))
        follow_paths(terrain, plastic, shifts, count, course, sums)
        with lock:
            done += 1
            progress("reflections", done, len(tasks))
        return sums / count

    for (group, *_), shown in zip(tasks, threads.each(follow, tasks), strict=True):
        found[:, group] += shown
    found /= to_camera[:, 2] * _known_share(relief, terrain.span)
    return Indirect(found.mean(axis=0), found.std(axis=0, ddof=1) / np.sqrt(REPLICATES))
