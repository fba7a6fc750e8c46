"""Two maps of one part, or of a tool and its part: registered, subtracted, and what has changed.

The difference B − A stands on the points of the first map A, after the second map B was registered and its plane
brought to that of what has not changed. It is negative where material was lost. Its uncertainty has the noise of both
maps, the uncertainty of the position and the scale times the slope, what interpolation between points does not know,
and that of the plane; what all points share adds up in volumes. A difference at an edge that a displacement by 0.07
pixels makes is no change.

A tool is turned over first: A is then the part that it would mould, and material that is lost was not filled. Moulded
parts shrink as they cool, and two instruments differ; where the maps show that the scales differ, B is stretched to
that of A, and by how much is stated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.base.json_fields import LEFT_OUT
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
LEAST_SHRINKAGE, MOST_SHRINKAGE = 1e-4, 0.05
MOST_FITS = 6
EDGE_POINTS, EDGE_REACH, NOISE_STEPS = 0.07, 5, 5.0
SMOOTH_POINTS = 3
SEGMENTS = 8
LEAST_SEGMENTS = 3
FACET, ON_FACET = (0.2, 0.48), (0.2, 0.9)
CREST_REACH = 0.4
STEEPEST = 1.56
SMEARED = 0.25  # variance of pixel, bin and place together, in pixels
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
        radius_b_um: radius of a round crest that misses that and the area lost; of a part of a tool, as much of its own
            edge as it does.
        radius_change_um: their difference.
        lost_area_um2: cross-section lost over the ridge, gains counted negative.
        angle_a_deg: ridge angle in the first map.
        angle_b_deg: the same in the second map.
        angle_change_deg: their difference.
        relief: least-squares factor of the heights of the second map on those of the first, over this ridge.
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
    angle_a_deg: Quantity
    angle_b_deg: Quantity
    angle_change_deg: Quantity
    relief: Quantity


@dataclass(frozen=True)
class Replication:
    """How much of the relief of the first map (tool) the second one (part) has.

    Attributes:
        relief: least-squares factor of the heights of the second map on those of the first, 1 for a faithful copy.
        height: ratio of the ridge heights, mean over the ridges; without value where there are no ridges.
        shrinkage: by how much the second map is smaller, a share; without value where it was not stretched.
    """

    relief: Quantity
    height: Quantity
    shrinkage: Quantity


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two registered maps.

    Attributes:
        first: the first map A; a tool as its part would stand.
        measured: the second map B as it was measured, with the scale of A.
        second: the second map B as registered, on the points of A, in its plane; NaN where not common.
        difference: B − A.
        u_um: (rows, cols) standard uncertainty of the difference.
        placed: where the points of A lie in B.
        mirrored: whether A is a tool that was turned over (negated and mirrored along x) first.
        lost: what was lost.
        gained: what was gained.
        net_um3: sum of the difference over all common points.
        ridges: the ridges one by one; empty where there are none.
        ridges_note: why there are none.
        replication: how much of the relief of A is in B.
        changed: (rows, cols) −1 where material was lost, 1 where it was gained, 0 elsewhere.
        relief: (rows, cols) the factor of the heights of B on those of A, in segments of ridges or, where there are
            none, in tiles; NaN where it is not known.
    """

    first: HeightMap = field(metadata=LEFT_OUT)
    measured: HeightMap = field(metadata=LEFT_OUT)
    second: HeightMap = field(metadata=LEFT_OUT)
    difference: HeightMap = field(metadata=LEFT_OUT)
    u_um: FloatArray = field(metadata=LEFT_OUT)
    placed: Placed
    mirrored: bool
    lost: Volume
    gained: Volume
    net_um3: Quantity
    ridges: tuple[RidgeChange, ...]
    ridges_note: str
    replication: Replication
    changed: npt.NDArray[np.int8] = field(metadata=LEFT_OUT)
    relief: FloatArray = field(metadata=LEFT_OUT)

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
        mirrored: A is a tool and B its part: A is negated and mirrored along x first.

    Raises:
        UsageError: one is no height map.
        RegistrationError: the maps have too little in common, or overlap too little.
        HeightMapError: nothing was measured.
    """
    for surface in (first, second):
        if not isinstance(surface, HeightMap):
            raise UsageError(f"compare_maps takes two HeightMaps, not {type(surface).__name__}")
    first, second = first.measured(), second.measured()
    if mirrored:
        first = turned_over(first)
    shrinkage, placed = _shrinkage(first, second, _start(first, second) if mirrored else 1.0)
    second = _stretched(second, 1.0 - (shrinkage.value or 0.0))
    on_grid = registered(first, second, placed)
    difference = first.with_height(on_grid.height_um - first.height_um)
    doubt = _Doubt.of(first, second, placed, on_grid)
    u_um = doubt.u_um
    lost, gained, changed = _volumes(difference, doubt)
    area = first.pixel_x_um * first.pixel_y_um
    known = np.isfinite(difference.height_um)
    net = Quantity(area * float(np.sum(difference.height_um[known])), area * doubt.of_sum(known))
    factor, tiles = _relief(first, on_grid)
    ridges, note, cells = _ridges(first, on_grid, mirrored=mirrored)
    return Comparison(
        first, second, on_grid, difference, u_um, placed, mirrored, lost, gained, net, ridges, note,
        Replication(factor, _height_ratio(ridges), shrinkage), changed, cells if ridges else tiles,
    )  # fmt: skip


def _start(first: HeightMap, second: HeightMap) -> float:
    """Ratio of the pitches of a part and its tool, 1 where it says no shrinkage of a mould."""
    try:
        pitches = [measure_ridges(one).pitch_um.value or 1.0 for one in (first, second)]
    except HeightMapError:
        return 1.0
    start = pitches[1] / pitches[0]
    return start if LEAST_SHRINKAGE < abs(1.0 - start) < MOST_SHRINKAGE else 1.0


def _shrinkage(first: HeightMap, second: HeightMap, scale: float) -> tuple[Quantity, Placed]:
    """By how much the second map is smaller, without value where the maps do not show it; its place, stretched by that.

    Args:
        first: map A.
        second: map B.
        scale: where the fit of the scale begins; one fit goes part of the way only.
    """
    placed = register(first, _stretched(second, scale))
    if scale == 1.0 and abs(1.0 - placed.scale) <= max(LEAST_SHRINKAGE, 3.0 * placed.u_scale):
        return Quantity(None), placed
    for _ in range(MOST_FITS):
        scale *= placed.scale
        if not max(LEAST_SHRINKAGE, 3.0 * placed.u_scale) < abs(1.0 - scale) < MOST_SHRINKAGE:
            return Quantity(None), register(first, second)
        placed = register(first, _stretched(second, scale))
        if abs(1.0 - placed.scale) <= 0.3 * placed.u_scale:
            break
    return Quantity(1.0 - scale, placed.u_scale), placed


def _stretched(surface: HeightMap, scale: float) -> HeightMap:
    """A map whose lateral scale is divided by a number; heights stay."""
    pixels = surface.pixel_x_um / scale, surface.pixel_y_um / scale
    return HeightMap(surface.height_um, *pixels, surface.origin)


@dataclass(frozen=True, eq=False)
class _Doubt:
    """What is not known of the difference B − A.

    Attributes:
        u_um: (rows, cols) standard uncertainty of each point, NaN where not common.
        edge_um: (rows, cols) bound of what a displacement by a quarter of a pixel does at edges.
        noise_um: the part of ``u_um`` that is independent from point to point.
        plane_um: standard uncertainty of the plane.
        common_um: (k, rows, cols) height that each of what all points share changes by one standard uncertainty:
            shift along x and y, turn, scale, offset, interpolation.
    """

    u_um: FloatArray
    edge_um: FloatArray
    noise_um: float
    plane_um: float
    common_um: FloatArray

    @classmethod
    def of(cls, first: HeightMap, second: HeightMap, placed: Placed, on_grid: HeightMap) -> "_Doubt":
        """That of two registered maps."""
        from scipy import ndimage  # noqa: PLC0415 - slow to import

        y, x = np.meshgrid(*centred_axes(first), indexing="ij")
        noise = float(np.hypot(white_noise(first), white_noise(second)))
        smooth = continued(on_grid.height_um)
        slope_y, slope_x = np.gradient(smooth, first.pixel_y_um, first.pixel_x_um)
        linear = Interpolated(second).at(*placed.positions(y, x, second)) - placed.plane_um(y, x)
        between = np.nan_to_num(linear - on_grid.height_um)
        turn = np.radians(placed.u_angle_deg)
        common = np.stack([
            slope_x * (placed.u_x_um or 0.0), slope_y * (placed.u_y_um or 0.0),
            (slope_y * x - slope_x * y) * turn, (slope_x * x + slope_y * y) * placed.u_scale,
            np.full_like(x, placed.u_offset_um), between,
        ])  # fmt: skip
        u = np.sqrt(noise**2 + np.sum(common**2, axis=0))
        known = np.isfinite(on_grid.height_um) & np.isfinite(first.height_um)
        edge = np.zeros(first.shape)
        for axis in (0, 1):
            step = np.diff(continued(first.height_um), axis=axis, append=0.0)
            step = np.delete(step, -1, axis)
            high, low = (
                f(step, EDGE_REACH, mode="nearest") for f in (ndimage.maximum_filter, ndimage.minimum_filter)
            )
            pad = [(0, int(axis == 0)), (0, int(axis == 1))]
            edge = np.maximum(edge, np.pad(high - low, pad, mode="edge"))
        edge = EDGE_POINTS * np.maximum(edge - NOISE_STEPS * noise, 0.0)
        return cls(np.where(known, u, np.nan), edge, noise, placed.u_offset_um, common)

    def of_sum(self, where: Mask) -> float:
        """Standard uncertainty of the sum of the difference over some points."""
        common = self.common_um[:, where].sum(axis=1)
        return float(np.sqrt(np.count_nonzero(where) * self.noise_um**2 + np.sum(common**2)))


def _volumes(difference: HeightMap, doubt: _Doubt) -> tuple[Volume, Volume, npt.NDArray[np.int8]]:
    """Volumes lost and gained where the change stands out of its uncertainty, and around it; and where that is."""
    from scipy import ndimage  # noqa: PLC0415 - slow to import
    from skimage.filters import apply_hysteresis_threshold  # noqa: PLC0415

    measured = np.isfinite(difference.height_um)
    filled = fill_gaps(difference)
    inside = np.isfinite(filled)
    change = np.where(inside, filled, 0.0)
    weight = ndimage.uniform_filter(inside.astype(np.float64), SMOOTH_POINTS, mode="constant")
    mean = ndimage.uniform_filter(change, SMOOTH_POINTS, mode="constant") / np.maximum(weight, 1e-9)
    u_here = np.hypot(continued(doubt.u_um), doubt.edge_um)
    u_plane = doubt.plane_um
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
        volume = max(sign * area * float(np.sum(change[wide])), 0.0)
        in_gaps = sign * area * float(np.sum(change[wide & ~measured]))
        u = area * doubt.of_sum(wide)
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


def _relief(first: HeightMap, second: HeightMap) -> tuple[Quantity, FloatArray]:
    """Least-squares factor of the second map's heights on the first one's, from tiles of the field; that of each."""
    over_field = np.full(first.shape, np.nan)
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
        return Quantity(None), over_field
    factor = float(mixed.sum() / square.sum())
    over_field[known] = (mixed / np.maximum(square, 1e-300))[tile]
    scatter = float(np.sum((mixed - factor * square) ** 2))
    count = int(np.count_nonzero(square))
    return Quantity(factor, few(count - 1) * float(np.sqrt(scatter)) / float(square.sum())), over_field


def _height_ratio(ridges: Sequence[RidgeChange]) -> Quantity:
    ratios = np.array(
        [one.height_b_um.value / one.height_a_um.value for one in ridges
         if one.height_a_um.value and one.height_b_um.value is not None]
    )  # fmt: skip
    if ratios.size < LEAST_SEGMENTS:
        return Quantity(None)
    u = few(ratios.size - 1) * float(np.std(ratios, ddof=1) / np.sqrt(ratios.size))
    return Quantity(float(ratios.mean()), u)


def _ridges(
    first: HeightMap, second: HeightMap, *, mirrored: bool
) -> tuple[tuple[RidgeChange, ...], str, FloatArray]:
    """Every ridge in both maps, or why there is none; and the factor of relief of each segment of a ridge."""
    try:
        found = measure_ridges(first)
    except HeightMapError as error:
        return (), str(error), np.full(first.shape, np.nan)
    sections = _Sections(first, second, found, own_edges=mirrored)
    changes = [sections.change(ridge.number, ridge.position_um) for ridge in found.ridges]
    return tuple(change for change in changes if change is not None), "", sections.relief


class _Sections:
    """Mean profiles across single ridges in segments along them, of both maps, on the same points."""

    def __init__(
        self, first: HeightMap, second: HeightMap, found: RidgeMeasurement, *, own_edges: bool
    ) -> None:
        self.own_edges = own_edges
        self.relief = np.full(first.shape, np.nan)
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
        wall, u_wall = _wall(found)
        self.wall_slope = float(np.tan(min(wall, STEEPEST)))
        self.step = float(np.hypot(first.pixel_x_um * np.cos(lean), first.pixel_y_um * np.sin(lean)))
        self.beside_facet, self.at_edge = _missing_sections(np.radians(facet), wall)
        # a corner under a Gaussian of variance σ² misses σ²/4 times the change of slope on each side
        corner = self.wall_slope + float(np.tan(np.radians(facet)))
        self.of_pixels = 0.25 * SMEARED * self.step**2 * corner / self.beside_facet
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
        angles = self._angles(place)
        if angles is None:
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
        self.relief[near] = np.array([np.nan if row is None else row[-1] for row in rows])[segment]
        # what is missing at the crest in both maps, as squares of the radius: of the first map without what pixels take
        # off a sharp edge; of the second what was lost since, or, where area is lost elsewhere too, what its own edge
        # misses
        before, lost = values[:, 5] / self.beside_facet - self.of_pixels, values[:, 4] / self.at_edge
        if self.own_edges:
            lost = values[:, 6] / self.beside_facet - before
        by_wall = self.u_share * abs(float(np.mean(lost)))
        squares = [
            replace(one, u=float(np.hypot(one.u or 0.0, more)))
            for one, more in (
                (_mean(before), self.of_pixels),
                (_mean(before + lost), np.hypot(by_wall, self.of_pixels)),
            )
        ]
        edge = squares[1]
        radii = [_root(squares[0]), _root(edge)]
        change = Quantity(None)
        if radii[1].value is not None:
            start = float(np.sqrt(max(squares[0].value or 0.0, 0.0)))
            change = Quantity(
                radii[1].value - start, _root_change(start, radii[1].value, squares[0], _mean(lost))
            )
        rise_a, rise_b, crest, rise, section = mean[:5]
        return RidgeChange(
            number,
            position_um,
            rise_a,
            rise_b,
            crest,
            rise,
            radii[0],
            radii[1],
            change,
            section,
            *angles,
            mean[7],
        )

    def _section(self, at: FloatArray, heights: list[FloatArray]) -> tuple[float, ...] | None:
        """Heights a, b, change of the crest and of the height, area lost, areas missing at the crests a, b.

        The factor of relief comes last.
        """
        bins = max(8, int(self.pitch / self.step))
        index = np.minimum(((at / self.pitch + 0.5) * bins).astype(np.intp), bins - 1)
        count = np.bincount(index, minlength=bins)
        if np.count_nonzero(count) < 0.9 * bins:
            return None
        filled = count > 0
        x = np.bincount(index, at, minlength=bins)[filled] / count[filled]
        profiles = [np.bincount(index, z, minlength=bins)[filled] / count[filled] for z in heights]
        lines = [np.polyfit(*self._facet(x, z), 1) for z in profiles]
        rises = [float(z.max() - z.min()) for z in profiles]
        crest = float(profiles[1].max() - profiles[0].max())
        lost = float(np.trapezoid(profiles[0] - profiles[1], x))
        # of the first map, for a round crest may leave no straight wall in the second
        wall = self._wall_line(x, profiles[0], lines[0])
        missing = [self._missing(x, z, line, wall) for z, line in zip(profiles, lines, strict=True)]
        a, b = (z - z.mean() for z in profiles)
        return *rises, crest, rises[1] - rises[0], lost, *missing, float(a @ b / (a @ a))

    def _angles(self, place: FloatArray) -> tuple[Quantity, Quantity, Quantity] | None:
        """Ridge angles of both maps and their change, from planes fitted to segments of the facet after a wall."""
        on = self.known & (place > ON_FACET[0] * self.pitch) & (place < ON_FACET[1] * self.pitch)
        at, along = place[on], self.along[on]
        if at.size < 50:
            return None
        segment = ((along - along.min()) / max(float(np.ptp(along)), 1e-9) * SEGMENTS).astype(np.intp)
        found = []
        for k in range(SEGMENTS):
            here = np.minimum(segment, SEGMENTS - 1) == k
            if (
                np.count_nonzero(here) > 10
                and np.ptp(at[here]) > 0.5 * (ON_FACET[1] - ON_FACET[0]) * self.pitch
            ):
                design = np.column_stack([at[here], along[here], np.ones(np.count_nonzero(here))])
                heights = np.column_stack([height[on][here] for height in self.heights])
                slopes = np.linalg.lstsq(design, heights, rcond=None)[0][0]
                found.append(np.degrees(np.arctan(-slopes)))
        if len(found) < LEAST_SEGMENTS:
            return None
        a, b = np.array(found).T
        return _mean(a), _mean(b), _mean(b - a)

    def _missing(
        self, x: FloatArray, z: FloatArray, line: FloatArray, wall: tuple[float, float, float]
    ) -> float:
        """Area that is missing at the crest under the line of the facet.

        The crest stands where the wall meets the facet, near position 0; the facet falls toward +x.
        """
        at, level, slope = wall
        vertex = float(at + (np.polyval(line, at) - level) / (slope - line[0]))
        part = (x > vertex) & (x < CREST_REACH * self.pitch)
        return float(np.sum((np.polyval(line, x[part]) - z[part]) * np.gradient(x)[part]))

    def _facet(self, x: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        part = (x > FACET[0] * self.pitch) & (x < FACET[1] * self.pitch)
        return x[part], z[part]

    def _wall_line(self, x: FloatArray, z: FloatArray, line: FloatArray) -> tuple[float, float, float]:
        """A point of the wall, where it has risen by half to the line of the facet, and its slope.

        Pixels widen a narrow wall about its middle, so that its slope is not that of the profile.
        """
        top, foot = int(np.argmax(z)), float(z.min())
        wall = slice(int(np.argmin(z[: top + 1])), top + 1)
        level = foot + 0.5 * (float(np.polyval(line, 0.0)) - foot)
        at = float(np.interp(level, np.maximum.accumulate(z[wall]), x[wall]))
        return at, level, self.wall_slope


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
    pitch, height = found.pitch_um.value, found.height_um
    loss = (found.height_loss.value or 0.0) + (found.foot_loss.value or 0.0)
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
