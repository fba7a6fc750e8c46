"""Two maps of one part, or of a tool and its part: registered, subtracted, and what has changed.

The difference B − A stands on the points of the first map A, after the second map B was registered and its plane
brought to that of what has not changed. It is negative where material was lost. Its uncertainty has the noise of both
maps, the uncertainty of the position times the slope, what interpolation between points does not know, and that of
the plane.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.profiles.editing.gaps import fill_gaps
from anisoscope.profiles.editing.interpolation import Interpolated, continued
from anisoscope.profiles.editing.registration import Placed, centred_axes, register, registered, white_noise
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.level import level
from anisoscope.profiles.metrology.quantity import Quantity, few
from anisoscope.profiles.metrology.ridgemeasurement import RidgeMeasurement
from anisoscope.profiles.metrology.ridges import measure_ridges

Mask = npt.NDArray[np.bool_]

SEED, GROW = 5.0, 1.5
MARGIN_POINTS = 3
SMOOTH_POINTS = 3
SEGMENTS = 8
LEAST_SEGMENTS = 3
FACET = (0.2, 0.48)
CREST_REACH = 0.4
WALL = (0.3, 0.6)
SECTION_STEPS = 4000


@dataclass(frozen=True)
class Volume:
    """What was lost or gained.

    Attributes:
        volume_um3: volume with its standard uncertainty.
        area_um2: area over which it was lost or gained, seen from above.
        depth_um: largest loss or gain, of means over 3 × 3 points.
        filled_share: share of the volume in gaps, where the difference was filled from around.
    """

    volume_um3: Quantity
    area_um2: float
    depth_um: float
    filled_share: float


@dataclass(frozen=True)
class RidgeChange:
    """One ridge in both maps; changes are second minus first.

    Attributes:
        number: as in the measurement of the first map.
        position_um: as there.
        height_a_um: from foot to crest of the mean profile along the ridge, in the first map.
        height_b_um: the same in the second map.
        crest_change_um: change of the height of the crest.
        height_change_um: change of the height from foot to crest.
        radius_a_um: radius of a round crest that misses as much of the edge as the first map does.
        radius_b_um: radius of a round crest that misses that and the area lost.
        radius_change_um: their difference.
        lost_area_um2: cross-section lost over the ridge, gains counted negative.
    """

    number: int
    position_um: float
    height_a_um: Quantity
    height_b_um: Quantity
    crest_change_um: Quantity
    height_change_um: Quantity
    radius_a_um: Quantity
    radius_b_um: Quantity
    radius_change_um: Quantity
    lost_area_um2: Quantity


@dataclass(frozen=True)
class Replication:
    """How much of the relief of the first map (tool) the second one (part) has.

    Attributes:
        relief: least-squares factor of the heights of the second map on those of the first, 1 for a faithful copy.
        height: ratio of the ridge heights, mean over the ridges; without value where there are no ridges.
    """

    relief: Quantity
    height: Quantity


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two registered maps.

    Attributes:
        first: the first map A.
        second: the second map B as registered, on the points of A, in its plane; NaN where not common.
        difference: B − A.
        u_um: (rows, cols) standard uncertainty of the difference.
        placed: where the points of A lie in B.
        mirrored: whether B was turned over (negated and mirrored along x) first.
        lost: what was lost.
        gained: what was gained.
        net_um3: sum of the difference over all common points.
        ridges: the ridges one by one; empty where there are none.
        ridges_note: why there are none.
        replication: how much of the relief of A is in B.
        changed: (rows, cols) −1 where material was lost, 1 where it was gained, 0 elsewhere.
    """

    first: HeightMap
    second: HeightMap
    difference: HeightMap
    u_um: FloatArray
    placed: Placed
    mirrored: bool
    lost: Volume
    gained: Volume
    net_um3: Quantity
    ridges: tuple[RidgeChange, ...]
    ridges_note: str
    replication: Replication
    changed: npt.NDArray[np.int8]

    def __repr__(self) -> str:
        """One line: place, volumes lost and gained."""
        lost, gained = self.lost.volume_um3, self.gained.volume_um3
        return (
            f"Comparison(shift {self.placed.x_um:.4g}, {self.placed.y_um:.4g} µm, turned {self.placed.angle_deg:.3f}°: "
            f"lost {lost.value:.5g} ± {lost.u:.2g} µm³, gained {gained.value:.5g} ± {gained.u:.2g} µm³)"
        )


def turned_over(surface: HeightMap) -> HeightMap:
    """A tool as its part stands: heights negated, mirrored along x."""
    return surface.with_height(-surface.height_um[:, ::-1])


def compare_maps(first: HeightMap, second: HeightMap, *, mirrored: bool = False) -> Comparison:
    """Register the second map on the first and measure what has changed, as ``anisoscope profile compare`` does.

    Args:
        first: map A, before wear, or the tool; (rows, cols) in µm.
        second: map B, after wear, or the part; pixel and size may differ.
        mirrored: one is a tool and the other its part: B is negated and mirrored along x first.

    Raises:
        UsageError: one is no height map.
        RegistrationError: the maps have too little in common, or overlap too little.
        HeightMapError: nothing was measured.
    """
    for surface in (first, second):
        if not isinstance(surface, HeightMap):
            raise UsageError(f"compare_maps takes two HeightMaps, not {type(surface).__name__}")
    other = turned_over(second) if mirrored else second
    placed = register(first, other)
    on_grid = registered(first, other, placed)
    difference = first.with_height(on_grid.height_um - first.height_um)
    u_um, u_plane = _uncertainty(first, other, placed, on_grid)
    lost, gained, changed = _volumes(difference, u_um, u_plane)
    area = first.pixel_x_um * first.pixel_y_um
    known = np.isfinite(difference.height_um)
    u_net = area * float(np.hypot(np.count_nonzero(known) * u_plane, np.sqrt(np.sum(u_um[known] ** 2))))
    net = Quantity(area * float(np.sum(difference.height_um[known])), u_net)
    ridges, note = _ridges(first, on_grid)
    return Comparison(
        first, on_grid, difference, u_um, placed, mirrored, lost, gained, net, ridges, note,
        Replication(_relief(first, on_grid), _height_ratio(ridges)), changed,
    )  # fmt: skip


def _uncertainty(
    first: HeightMap, second: HeightMap, placed: Placed, on_grid: HeightMap
) -> tuple[FloatArray, float]:
    """Standard uncertainty of the difference (rows, cols), and of its plane alone."""
    y, x = np.meshgrid(*centred_axes(first), indexing="ij")
    noise = float(np.hypot(white_noise(first), white_noise(second)))
    smooth = continued(on_grid.height_um)
    slope_y, slope_x = np.gradient(smooth, first.pixel_y_um, first.pixel_x_um)
    linear = Interpolated(second).at(*placed.positions(y, x, second)) - placed.plane_um(y, x)
    between = np.nan_to_num(linear - on_grid.height_um)
    turn = np.radians(placed.u_angle_deg)
    by_x = slope_x * np.hypot(placed.u_x_um or 0.0, turn * y)
    by_y = slope_y * np.hypot(placed.u_y_um or 0.0, turn * x)
    u = np.sqrt(noise**2 + by_x**2 + by_y**2 + between**2 + placed.u_offset_um**2)
    return np.where(
        np.isfinite(on_grid.height_um) & np.isfinite(first.height_um), u, np.nan
    ), placed.u_offset_um


def _volumes(
    difference: HeightMap, u_um: FloatArray, u_plane: float
) -> tuple[Volume, Volume, npt.NDArray[np.int8]]:
    """Volumes lost and gained where the change stands out of its uncertainty, and around it; and where that is."""
    from scipy import ndimage  # noqa: PLC0415 - slow to import
    from skimage.filters import apply_hysteresis_threshold  # noqa: PLC0415

    measured = np.isfinite(difference.height_um)
    filled = fill_gaps(difference)
    inside = np.isfinite(filled)
    change = np.where(inside, filled, 0.0)
    weight = ndimage.uniform_filter(inside.astype(np.float64), SMOOTH_POINTS, mode="constant")
    mean = ndimage.uniform_filter(change, SMOOTH_POINTS, mode="constant") / np.maximum(weight, 1e-9)
    u_here = continued(u_um)
    # noise falls by the points of the window; the rest of the uncertainty does not, and is small away from walls
    u_mean = np.maximum(u_here / SMOOTH_POINTS + u_plane, 1e-12)
    # what interpolation does not know at edges is not a change
    ratio = np.where(inside, mean / np.maximum(u_mean, u_here / SEED), 0.0)
    cores: list[Mask] = [
        apply_hysteresis_threshold(sign * ratio, GROW, SEED)  # type: ignore[no-untyped-call]
        for sign in (-1.0, 1.0)
    ]
    area = difference.pixel_x_um * difference.pixel_y_um
    found = []
    for sign, core, other in ((-1.0, cores[0], cores[1]), (1.0, cores[1], cores[0])):
        if not core.any():
            found.append(Volume(Quantity(0.0, 0.0), 0.0, 0.0, 0.0))
            continue
        # the skirts of a change are below its noise; there the noise adds up to nothing
        far = ndimage.distance_transform_edt(~core)
        nearer = far <= ndimage.distance_transform_edt(~other) if other.any() else inside
        wide = (far <= MARGIN_POINTS) & nearer & inside
        volume = sign * area * float(np.sum(change[wide]))
        in_gaps = sign * area * float(np.sum(change[wide & ~measured]))
        noise = area * float(np.sqrt(np.sum(u_here[wide] ** 2)))
        u = float(np.hypot(noise, area * np.count_nonzero(wide) * u_plane))
        depth = float((sign * mean[core]).max())
        found.append(
            Volume(
                Quantity(volume, u),
                area * float(np.count_nonzero(core)),
                depth,
                in_gaps / volume if volume else 0.0,
            )
        )
    return found[0], found[1], cores[1].astype(np.int8) - cores[0].astype(np.int8)


def _relief(first: HeightMap, second: HeightMap) -> Quantity:
    """Least-squares factor of the second map's heights on the first one's, from tiles of the field."""
    known = np.isfinite(first.height_um) & np.isfinite(second.height_um)
    i, j = np.nonzero(known)
    rows, cols = first.shape
    y, x = i / rows - 0.5, j / cols - 0.5
    design = np.stack([np.ones_like(y), x, y], axis=1)
    normal = design.T @ design
    a, b = first.height_um[known], second.height_um[known]
    a, b = (z - design @ np.linalg.lstsq(normal, design.T @ z, rcond=None)[0] for z in (a, b))
    tile = (i * SEGMENTS // rows) * SEGMENTS + j * SEGMENTS // cols
    mixed = np.bincount(tile, a * b, minlength=SEGMENTS**2)
    square = np.bincount(tile, a * a, minlength=SEGMENTS**2)
    if not float(square.sum()) > 0.0:
        return Quantity(None)
    factor = float(mixed.sum() / square.sum())
    scatter = float(np.sum((mixed - factor * square) ** 2))
    count = int(np.count_nonzero(square))
    return Quantity(factor, few(count - 1) * float(np.sqrt(scatter)) / float(square.sum()))


def _height_ratio(ridges: Sequence[RidgeChange]) -> Quantity:
    ratios = np.array(
        [one.height_b_um.value / one.height_a_um.value for one in ridges
         if one.height_a_um.value and one.height_b_um.value is not None]
    )  # fmt: skip
    if ratios.size < LEAST_SEGMENTS:
        return Quantity(None)
    u = few(ratios.size - 1) * float(np.std(ratios, ddof=1) / np.sqrt(ratios.size))
    return Quantity(float(ratios.mean()), u)


def _ridges(first: HeightMap, second: HeightMap) -> tuple[tuple[RidgeChange, ...], str]:
    """Every ridge in both maps, or why there is none."""
    try:
        found = measure_ridges(first)
    except HeightMapError as error:
        return (), str(error)
    sections = _Sections(first, second, found)
    changes = [sections.change(ridge.number, ridge.position_um) for ridge in found.ridges]
    return tuple(change for change in changes if change is not None), ""


class _Sections:
    """Mean profiles across single ridges in segments along them, of both maps, on the same points."""

    def __init__(self, first: HeightMap, second: HeightMap, found: RidgeMeasurement) -> None:
        pitch, lean = found.pitch_um.value, np.radians(found.lean_deg)
        facet = found.ridge_angle_deg.value
        assert pitch is not None
        assert facet is not None
        self.pitch = pitch
        y, x = np.arange(first.shape[0]) * first.pixel_y_um, np.arange(first.shape[1]) * first.pixel_x_um
        across = np.add.outer(y * np.sin(lean), x * np.cos(lean))
        self.across = across
        self.along = np.add.outer(y * np.cos(lean), -x * np.sin(lean))
        known = np.isfinite(first.height_um) & np.isfinite(second.height_um)
        self.known = known
        # both about the plane through equal places of the ridges
        tilt = first.height_um - level(first).map.height_um
        self.heights = (first.height_um - tilt, second.height_um - tilt)
        self.step = float(np.hypot(first.pixel_x_um * np.cos(lean), first.pixel_y_um * np.sin(lean)))
        wall, u_wall = _wall(found)
        self.beside_facet, self.at_edge = _missing_sections(np.radians(facet), wall)
        sides = [
            _missing_sections(np.radians(facet), min(wall + k * u_wall, 0.5 * np.pi))[1] for k in (-1, 1)
        ]
        self.u_share = 0.5 * abs(sides[1] - sides[0]) / self.at_edge

    def change(self, number: int, position_um: float) -> RidgeChange | None:
        """One ridge, or None where too little of it is common."""
        place = self.across - position_um
        near = self.known & (place > -0.5 * self.pitch) & (place < 0.5 * self.pitch)
        if np.count_nonzero(near) < 50:
            return None
        at, along = place[near], self.along[near]
        segment = np.minimum(
            ((along - along.min()) / max(float(np.ptp(along)), 1e-9) * SEGMENTS).astype(np.intp), SEGMENTS - 1
        )
        heights = [height[near] for height in self.heights]
        rows = [
            self._section(at[segment == k], [height[segment == k] for height in heights])
            for k in range(SEGMENTS)
        ]
        values = np.array([row for row in rows if row is not None])
        if len(values) < LEAST_SEGMENTS:
            return None
        mean = [_mean(column) for column in values.T]
        # what is missing at the crest in the first map, and what was lost since, as squares of the radius
        before, lost = values[:, 5] / self.beside_facet, values[:, 4] / self.at_edge
        squares = _mean(before), _mean(before + lost)
        edge = replace(
            squares[1],
            u=float(np.hypot(squares[1].u or 0.0, self.u_share * abs(mean[4].value or 0.0) / self.at_edge)),
        )
        radii = [_root(squares[0]), _root(edge)]
        change = Quantity(None)
        if radii[1].value is not None:
            start = float(np.sqrt(max(squares[0].value or 0.0, 0.0)))
            change = Quantity(
                radii[1].value - start, _root_change(start, radii[1].value, squares[0], _mean(lost))
            )
        rise_a, rise_b, crest, rise, section = mean[:5]
        return RidgeChange(
            number, position_um, rise_a, rise_b, crest, rise, radii[0], radii[1], change, section
        )

    def _section(self, at: FloatArray, heights: list[FloatArray]) -> tuple[float, ...] | None:
        """Heights a, b, change of the crest and of the height, area lost, area missing at the crest a."""
        bins = max(8, int(self.pitch / self.step))
        index = np.minimum(((at / self.pitch + 0.5) * bins).astype(np.intp), bins - 1)
        count = np.bincount(index, minlength=bins)
        if np.count_nonzero(count) < 0.9 * bins:
            return None
        filled = count > 0
        x = np.bincount(index, at, minlength=bins)[filled] / count[filled]
        profiles = [np.bincount(index, z, minlength=bins)[filled] / count[filled] for z in heights]
        line = np.polyfit(*self._facet(x, profiles[0]), 1)
        rises = [float(z.max() - z.min()) for z in profiles]
        crest = float(profiles[1].max() - profiles[0].max())
        lost = float(np.trapezoid(profiles[0] - profiles[1], x))
        # the crest stands where the wall meets the facet, near position 0; the facet falls toward +x
        part = (x > self._vertex(x, profiles[0], line)) & (x < CREST_REACH * self.pitch)
        missing = float(np.sum((np.polyval(line, x[part]) - profiles[0][part]) * np.gradient(x)[part]))
        return (*rises, crest, rises[1] - rises[0], lost, missing)

    def _facet(self, x: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        part = (x > FACET[0] * self.pitch) & (x < FACET[1] * self.pitch)
        return x[part], z[part]

    @staticmethod
    def _vertex(x: FloatArray, z: FloatArray, line: FloatArray) -> float:
        """Where the wall, prolonged from 30 % and 60 % of its rise, meets the line of the facet."""
        top, foot = int(np.argmax(z)), float(z.min())
        wall = slice(int(np.argmin(z[: top + 1])), top + 1)
        levels = foot + np.array(WALL) * (float(np.polyval(line, 0.0)) - foot)
        low, high = np.interp(levels, np.maximum.accumulate(z[wall]), x[wall])
        slope = float(levels[1] - levels[0]) / max(float(high - low), 1e-9)
        return float(high + (np.polyval(line, high) - levels[1]) / (slope - line[0]))


def _root(square: Quantity) -> Quantity:
    """Root of a square with its uncertainty; a bound where the square is below twice its uncertainty."""
    assert square.value is not None
    assert square.u is not None
    least = 2.0 * square.u
    if square.value <= max(least, 0.0):
        return Quantity(None, at_most=float(np.sqrt(max(square.value, 0.0) + least)))
    root = float(np.sqrt(square.value))
    return Quantity(root, square.u / (2.0 * root))


def _root_change(start: float, end: float, square: Quantity, lost: Quantity) -> float:
    """Standard uncertainty of √(s + l) − √s, s and l with theirs."""
    by_lost = (lost.u or 0.0) / (2.0 * end)
    at_least = max(start, float(np.sqrt(square.u or 0.0)), 1e-9)
    by_start = (square.u or 0.0) * abs(1.0 / (2.0 * end) - 1.0 / (2.0 * at_least))
    return float(np.hypot(by_lost, by_start))


def _mean(values: FloatArray) -> Quantity:
    """Mean of segments and its standard uncertainty."""
    u = few(values.size - 1) * float(np.std(values, ddof=1) / np.sqrt(values.size))
    return Quantity(float(values.mean()), u)


def _wall(found: RidgeMeasurement) -> tuple[float, float]:
    """Inclination of the walls in radians and its uncertainty.

    Where the pixels do not resolve the wall, pitch, facet and full height tell it: h = p/(cot θ + cot ψ).
    """
    wall = found.wall_angle_deg
    if wall.value is not None:
        return float(np.radians(wall.value)), float(np.radians(wall.u or 0.0))
    pitch, height, loss = found.pitch_um.value, found.height_um, found.height_loss.value or 0.0
    assert pitch is not None
    assert height.value is not None
    assert found.ridge_angle_deg.value is not None
    full = height.value / (1.0 - min(loss, 0.9))
    facet = 1.0 / np.tan(np.radians(found.ridge_angle_deg.value))
    run = max(pitch / full - facet, 0.0)
    u_facet = facet**2 * np.radians(found.ridge_angle_deg.u or 0.0)
    u_run = float(np.hypot(pitch / full**2 * (height.u or 0.0), u_facet))
    least = np.radians(wall.at_least) if wall.at_least is not None else 0.0
    return float(max(np.arctan2(1.0, run), least)), u_run / (1.0 + run**2)


def _missing_sections(facet: float, wall: float) -> tuple[float, float]:
    """Area that a round crest of radius 1 misses under the facet's line from the vertex on, and at the whole edge.

    Facet and wall rise at these angles (radians) to a vertex at 0; the arc touches both.
    """
    half = 0.5 * (np.pi - facet - wall)
    reach = 1.0 / np.tan(half)
    touch = reach * np.cos(facet)
    centre_x, centre_z = touch - np.sin(facet), -np.tan(facet) * touch - np.cos(facet)
    x = np.linspace(0.0, touch, SECTION_STEPS)
    arc = centre_z + np.sqrt(np.maximum(1.0 - (x - centre_x) ** 2, 0.0))
    return float(np.trapezoid(-np.tan(facet) * x - arc, x)), float(reach - (0.5 * np.pi - half))
