"""Measure the ridges of a height map: pitch, angles, heights, roughness, burrs, each with its uncertainty.

The chain: period and direction from the spectrum (:mod:`.period`), tilt from points whole pitches apart
(:mod:`.level`), the median ridge and the positions tile by tile (:mod:`.ridgefold`), planes of the facets
(:mod:`.ridgefit`), what stands out (:mod:`.burrlist`), the same once more without it, then slopes (:mod:`.ridgefit`)
and crest (:mod:`.ridgecrest`). A ridge is the unit that is repeated: uncertainties come from how the ridges of the
map differ.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.base.parallel import one_blas_thread
from anisoscope.profiles.heightmap import HeightMap, known_mean, row_blocks
from anisoscope.profiles.level import periodic_form, periodic_tilt
from anisoscope.profiles.metrology import ridgekernels as kernels
from anisoscope.profiles.metrology.burrlist import Outlier, find_outliers, limits
from anisoscope.profiles.metrology.quantity import Quantity, variation
from anisoscope.profiles.metrology.ridgecrest import (
    Crest,
    Line,
    against_the_surface,
    core_of_wall,
    mean_profile,
    measure_crest,
    without_tip,
)
from anisoscope.profiles.metrology.ridgefit import (
    Planes,
    Single,
    facet_bow,
    facet_line,
    fit_planes,
    height_step,
    measure_slopes,
    ridge_angle,
    segments_along,
    shows_stairs,
    single_ridges,
    slope_of_ends,
    slope_of_steps,
    slow_slopes,
)
from anisoscope.profiles.metrology.ridgefold import (
    Course,
    Facet,
    Folded,
    Grid,
    Positions,
    fold_median,
    orient,
    refine,
)
from anisoscope.profiles.metrology.ridgemeasurement import MOST_BOW, MeanRidge, Ridge, RidgeMeasurement
from anisoscope.profiles.metrology.ridgeoutline import SIGMA_OF_LIMIT
from anisoscope.profiles.metrology.ridgesums import profile_sums, wall_sums
from anisoscope.profiles.period import MIN_SCORE, Period, find_period

BINS_A_PIXEL = 2
SLOPE_ROWS = 200
COURSE_PASSES = 4
SETTLED = 0.03
FORM_PASSES = 2
LESS_ALIKE = 0.01
SECOND_POINTS = 400
SECOND_DEG = 5.0
MIN_QUARTER = 16
SECOND_SHARE = 0.03
MOST_SIGMA = 0.5 * SIGMA_OF_LIMIT
MOST_TIP = 0.25


def measure_ridges(
    surface: HeightMap, period_limit_um: float | None = None, *, tip_radius_um: float | None = None
) -> RidgeMeasurement:
    """Measure the ridges of a map, (rows, cols) in µm, in any direction.

    Args:
        surface: the map; missing points and tilt may remain, strong form should be removed.
        period_limit_um: lateral period limit of the instrument, the period at which its transfer function is 50 %
            (ISO 25178-600): the blur of a Gaussian point spread function with σ = 0.187 of it is taken off wall,
            height, radii and alpha. None: not known.
        tip_radius_um: radius of the ball at the tip of a stylus or probe, in place of a period limit: taken off crest,
            foot and height (:func:`.ridgecrest.without_tip`). Roughness is that of the scanned surface.

    Raises:
        HeightMapError: no ridges are found, fewer than four of them, or fewer than eight pixels a pitch, or
            more than half of the map is interpolated.
        UsageError: a period limit that is no length, or of more than half a pitch; a tip radius of more than a quarter
            of the pitch, or larger than the crest that it saw, or beside a period limit.
    """
    surface = surface.measured()
    if period_limit_um is not None and not 0.0 <= period_limit_um < float("inf"):
        raise UsageError(f"the lateral period limit is a length in µm, at least 0, not {period_limit_um:g}")
    sigma = None if period_limit_um is None else SIGMA_OF_LIMIT * period_limit_um
    if tip_radius_um is not None:
        if period_limit_um is not None or not 0.0 < tip_radius_um < float("inf"):
            raise UsageError("the tip radius is a length in µm above 0, in place of a lateral period limit")
        sigma = 0.0
    with one_blas_thread():
        return replace(_fitted(surface, sigma), tip_um=tip_radius_um).measured()


def _fitted(surface: HeightMap, sigma_um: float | None) -> "_Fit":
    """All steps up to the sums over the ridges."""
    period = _checked(find_period(surface), surface)
    if sigma_um is not None and sigma_um > MOST_SIGMA * period.pitch_um:
        raise UsageError(
            f"a lateral period limit of {sigma_um / SIGMA_OF_LIMIT:.4g} µm leaves no facet of ridges "
            f"{period.pitch_um:.4g} µm apart; it may be half of the pitch"
        )
    rounded_um, stairs = height_step(surface.height_um), shows_stairs(surface.height_um)
    surface, period, form_um = _without_form(surface, period)
    tilt = periodic_tilt(surface, period)
    grid = replace(_levelled(surface, tilt), rounded_um=rounded_um if stairs else 0.0)
    course, facet, folded = orient(grid, Course(period.pitch_um, period.direction_deg), sigma_um or 0.0)
    for _ in range(COURSE_PASSES):
        before, course = course, refine(grid, course, folded, 0.0).course
        folded = fold_median(grid, course)
        if _moved(before, course, grid) < SETTLED:
            break
    planes = fit_planes(grid, course, facet, folded)
    above, owner, burrs, out = _outliers(grid, course, facet, folded, planes)
    clean = replace(grid, out=out)
    planes = fit_planes(clean, course, facet, folded, planes)
    wall = _resolved_wall(folded, course, grid)
    above[out] = np.nan
    with ThreadPoolExecutor(1) as beside:
        second = beside.submit(_second_direction, surface, grid, course, folded)
        positions = refine(clean, course, folded, wall)
    return _Fit(
        surface,
        period,
        tilt,
        clean,
        course,
        facet,
        folded,
        planes,
        positions,
        above,
        owner,
        burrs,
        form_um,
        second.result(),
        sigma_um,
        rounded_um,
    )


def _second_direction(surface: HeightMap, grid: Grid, course: Course, folded: Folded) -> float | None:
    """Direction of other ridges in what the ridges found leave of the map; None where there are none.

    Looked for on a map thinned to at most 400 rows and columns.
    """
    thin = max(1, -(-max(grid.z.shape) // SECOND_POINTS))
    frame, part_z = course.frame(grid, folded.shift), np.ascontiguousarray(grid.z[::thin, ::thin])
    frame = frame._replace(qi=thin * frame.qi, qj=thin * frame.qj)
    left = kernels.above_profile(part_z, frame, folded.height_um)
    part = HeightMap(left, surface.pixel_x_um * thin, surface.pixel_y_um * thin)
    other = find_period(part)
    away = (
        abs((other.direction_deg - course.direction_deg + 90.0) % 180.0 - 90.0) if other.is_periodic else 0.0
    )
    share = float(np.nanvar(left) / np.nanvar(part_z))
    return other.direction_deg if away > SECOND_DEG and share > SECOND_SHARE else None


def _without_form(surface: HeightMap, period: Period) -> tuple[HeightMap, Period, float]:
    """The map without form (waviness, curvature), its period, and the rms of the form in µm.

    A form of high order can follow ridges that differ in turn. Without a true form the ridges are more alike; if they
    are less, only orders are tried that cannot follow them, or none.
    """
    rms = 0.0
    slow = 0.5 * float(np.abs(period.across()[::-1]) @ surface.extent_um) / period.pitch_um
    for _ in range(FORM_PASSES):
        for highest in (np.inf, slow):
            form = periodic_form(surface, period, highest)
            if form.order == 1:
                return surface, period, rms
            height = form.height_um(surface.shape)
            flat = surface.with_height(surface.height_um - height)
            after = find_period(flat)
            if after.score > period.score - LESS_ALIKE:
                break
        else:
            return surface, period, rms
        rms = float(np.hypot(rms, np.std(height)))
        surface, period = flat, _checked(after)
    return surface, period, rms


def _moved(before: Course, after: Course, grid: Grid) -> float:
    """Shift of the ridges at the rim of the map by a new course, in pixels across."""
    pixel = np.array(grid.pixel)
    half = 0.5 * float(np.hypot(*(np.array(grid.z.shape) * pixel)))
    stretch = abs(after.pitch_um / before.pitch_um - 1.0)
    return half * float(
        np.hypot(stretch, np.radians(after.direction_deg - before.direction_deg)) / pixel.min()
    )


def _checked(period: Period, surface: HeightMap | None = None) -> Period:
    if period.is_periodic:
        return period
    if surface is not None and len(parts := directions_of_parts(surface)) > 1:
        raise HeightMapError(
            f"ridges of more than one direction: {', '.join(f'{one:.1f}°' for one in parts)} in different parts of "
            "the map; crop it to one of them"
        )
    raise HeightMapError(
        f"no ridges found: each ridge would have to predict at least {MIN_SCORE:g} of the variance of the "
        f"others, here the periodicity score is {period.score:.2f}; at least four ridges must lie in the map (measure "
        "a larger field), and strong form must be removed before"
    )


def directions_of_parts(surface: HeightMap) -> list[float]:
    """Directions of the ridges in the quarters of a map, those that differ by more than 5°."""
    rows, cols = (n // 2 for n in surface.shape)
    found: list[float] = []
    for i in (0, rows):
        for j in (0, cols):
            height = surface.height_um[i : i + rows, j : j + cols]
            if min(height.shape) < MIN_QUARTER or not np.isfinite(height).any():
                continue
            period = find_period(HeightMap(height, surface.pixel_x_um, surface.pixel_y_um))
            known = [abs((period.direction_deg - one + 90.0) % 180.0 - 90.0) for one in found]
            if period.is_periodic and min(known, default=90.0) > SECOND_DEG:
                found.append(period.direction_deg)
    return found


def _levelled(surface: HeightMap, tilt: tuple[float, float]) -> Grid:
    rows, cols = surface.shape
    x, y = np.arange(cols) * surface.pixel_x_um, np.arange(rows) * surface.pixel_y_um
    z = np.empty(surface.shape)
    for block in row_blocks(surface.shape):
        np.subtract(surface.height_um[block], np.add.outer(tilt[1] * y[block], tilt[0] * x), out=z[block])
    mean = known_mean(z)
    for block in row_blocks(surface.shape):
        z[block] -= mean
    return Grid(z, np.zeros(surface.shape, dtype=bool), (surface.pixel_y_um, surface.pixel_x_um))


def _resolved_wall(folded: Folded, course: Course, grid: Grid) -> float:
    """Width of the wall of the median ridge, 0 where it is not wider than two pixels."""
    bins = folded.height_um.size
    height = np.roll(folded.height_um, bins // 2)
    low, high = core_of_wall(np.arange(bins) * course.pitch_um / bins, height)
    width, step = (high - low) / 0.6, course.step_um(grid.pixel)
    return width if width > 2.0 * step else 0.0


def _outliers(
    grid: Grid, course: Course, facet: Facet, folded: Folded, planes: Planes
) -> tuple[FloatArray, npt.NDArray[np.int16], tuple[Outlier, ...], kernels.Mask]:
    """Heights over the ridges, the ridge of every facet point, outliers, and their mask."""
    frame = course.frame(grid, folded.shift)
    line = facet_line(folded, facet, course.pitch_um)
    mean = np.array([*line, 0.0])
    span = (facet.begin, facet.end)
    above, owner, place = kernels.residuals(grid.z, frame, span, planes.planes, folded.height_um, mean)
    bins = folded.height_um.size
    at = (np.arange(bins) + folded.shift) / bins
    sigma = float(np.median(planes.sigma_um[planes.fitted]))
    inside = (at >= facet.begin) & (at <= facet.end)
    resolved = _resolved_wall(folded, course, grid) > 0.0
    outline, peak = limits(sigma, folded.spread_um, folded.height_um, inside, resolved=resolved)
    burrs, out = find_outliers(above, place, outline, peak, grid.pixel)
    return above, owner, burrs, out


@dataclass(frozen=True, eq=False)
class _Fit:
    """Everything fitted, from which the measurement is put together."""

    surface: HeightMap
    period: Period
    tilt: tuple[float, float]
    grid: Grid
    course: Course
    facet: Facet
    folded: Folded
    planes: Planes
    positions: Positions
    above: FloatArray
    owner: npt.NDArray[np.int16]
    burrs: tuple[Outlier, ...]
    form_um: float
    second_deg: float | None
    sigma_um: float | None
    rounded_um: float
    tip_um: float | None = None

    def measured(self) -> RidgeMeasurement:
        """The measurement."""
        course, pitch = self.positions.course, self.positions.pitch_um
        ex, ey = self.course.downhill()
        removed = self.tilt[0] * ex + self.tilt[1] * ey
        assert pitch.u is not None
        ends = slope_of_ends(self.folded, self.facet, self.course.pitch_um)
        steps = slope_of_steps(self.planes, self.facet, self.course.pitch_um, self.grid.rounded_um)
        angle = ridge_angle(self.planes, self.course, removed, pitch.u, ends, steps)
        crest, x_um, height_um = self._crest(angle)
        wall_angle = against_the_surface(crest.wall_angle_deg, removed, self.planes.tilt_across)
        slow = slow_slopes(self.planes)
        slopes = measure_slopes(
            self.above,
            self.owner,
            self.grid.pixel,
            self.course,
            self.planes.weight.size,
            slow,
            self.rounded_um,
            self.sigma_um or 0.0,
            crest.blur_um,
        )
        segments = segments_along(self.planes, self.course, self.grid, removed)
        singles = single_ridges(self.planes, self.course, self.facet, removed)
        ridges = self._ridges(singles, crest)
        span = (self.facet.begin * self.course.pitch_um, self.facet.end * self.course.pitch_um)
        lean_x, lean_y = course.downhill()
        bow = facet_bow(self.folded, self.facet, self.course.pitch_um)
        return RidgeMeasurement(
            pitch, self._surface_pitch(removed), self.positions.direction_deg, angle, wall_angle, crest.height_um,
            crest.height_loss, crest.edge_radius_um, crest.foot_loss, crest.foot_radius_um,
            slopes.alpha_along, slopes.alpha_across, slopes.noise_um,
            (float(min(self.grid.pixel)), float(span[1] - span[0])), float(np.degrees(np.arctan2(lean_y, lean_x))),
            variation([r.angle_deg for r in ridges]), variation([r.height_um for r in ridges]),
            variation([r.shift_um for r in ridges]), variation([one.angle_deg for one in segments]), segments,
            tuple(ridges), self.burrs, self.surface.missing_share,
            (span[1] - span[0]) / self.course.pitch_um, crest.plateau, self.period.score,
            self._mean_ridge(x_um, height_um, span), self.form_um,
            bow, self.second_deg, slopes.line_drift_um,
            slopes.height_step_um, slopes.short_share, slopes.lay_um,
            None if self.sigma_um is None or self.tip_um is not None else self.sigma_um / SIGMA_OF_LIMIT,
            crest.blur_um / SIGMA_OF_LIMIT if bow <= MOST_BOW else 0.0, self.positions.strip_um, self.tip_um,
        )  # fmt: skip

    def _surface_pitch(self, removed: float) -> Quantity:
        """Pitch in the plane through equal places of all ridges, from that in the plane of the map."""
        pitch, (ex, ey) = self.positions.pitch_um, self.course.downhill()
        assert pitch.value is not None
        assert pitch.u is not None
        across = removed + self.planes.tilt_across
        along = self.tilt[1] * ex - self.tilt[0] * ey + self.planes.tilt_along
        stretch = float(np.sqrt(1.0 + across**2 / (1.0 + along**2)))
        return Quantity(pitch.value * stretch, pitch.u * stretch)

    def _line(self) -> tuple[float, float]:
        return facet_line(self.folded, self.facet, self.course.pitch_um)

    def _crest(self, angle: Quantity) -> tuple[Crest, FloatArray, FloatArray]:
        course, folded, facet = self.course, self.folded, self.facet
        frame, (height, slope) = course.frame(self.grid, folded.shift), self._line()
        bins, profile = BINS_A_PIXEL * folded.height_um.size, folded.height_um
        span, mean = (facet.begin, facet.end), np.array([height, slope, 0.0])
        parts = profile_sums(self.above, self.grid.out, frame, span, profile, mean, bins)
        x_um, height_um, _ = mean_profile(parts.sum(axis=0), course.pitch_um)
        core = core_of_wall(x_um, height_um)
        sigma = float(np.median(self.planes.sigma_um[self.planes.fitted]))
        step = course.step_um(self.grid.pixel)
        limit = 4.0 * sigma + 0.3 * step * float(np.ptp(height_um)) / max(core[1] - core[0], step)
        walls = wall_sums(self.above, frame, profile, core, limit)
        line = Line(height - slope * facet.middle * course.pitch_um, slope)
        crest = measure_crest(parts, walls, line, angle, self.positions.pitch_um, step, sigma, self.sigma_um)
        if self.tip_um is not None:
            if self.tip_um > MOST_TIP * course.pitch_um:
                raise UsageError(
                    f"a tip radius of {self.tip_um:g} µm leaves no facet of ridges {course.pitch_um:.4g} µm apart; it "
                    "may be a quarter of the pitch"
                )
            crest = without_tip(crest, self.tip_um, angle)
        return crest, x_um, height_um

    def _ridges(self, singles: list[Single | None], crest: Crest) -> list[Ridge]:
        assert crest.height_um.value is not None
        frame = self.course.frame(self.grid)
        share = crest.height_um.value / (-self._line()[1] * self.course.pitch_um)
        found: list[Ridge] = []
        for k, single in enumerate(singles):
            if single is None:
                continue
            step, u_step = single.step_um.value, single.step_um.u
            height = (
                Quantity(None) if step is None or u_step is None else Quantity(step * share, u_step * share)
            )
            shift, u = float(self.positions.shift_um[k]), float(self.positions.shift_u_um[k])
            known = Quantity(shift, u) if np.isfinite(shift) and np.isfinite(u) else Quantity(None)
            at = (k + frame.first + self.course.offset) * self.course.pitch_um
            moved = at + (shift if np.isfinite(shift) else 0.0)
            found.append(
                Ridge(len(found) + 1, moved, single.angle_deg, height, known, int(self.planes.points[k]))
            )
        return found

    def _mean_ridge(self, x_um: FloatArray, height_um: FloatArray, span: tuple[float, float]) -> MeanRidge:
        height, slope = self._line()
        middle = self.facet.middle * self.course.pitch_um
        ends = (height + slope * (span[0] - middle), height + slope * (span[1] - middle))
        rows = np.arange(0, self.above.shape[0] - 2, max(1, self.above.shape[0] // SLOPE_ROWS))
        here, next_, after = (
            np.where(self.owner[rows + k] >= 0, self.above[rows + k], np.nan) for k in range(3)
        )
        # the two quotients share no point, so that their noise is independent
        gx, gy = np.diff(here, axis=1) / self.grid.pixel[1], ((after - next_) / self.grid.pixel[0])[:, :-1]
        ex, ey = self.course.downhill()
        known = np.isfinite(gx) & np.isfinite(gy)
        gx, gy = gx[known], gy[known]
        return MeanRidge(x_um, height_um, span, ends, ex * gx + ey * gy, ex * gy - ey * gx)
