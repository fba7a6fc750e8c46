"""The median ridge of a levelled map: which way its large facets lean, where they lie and where the walls stand.

Pitch and direction from where every ridge stands, tile by tile, against the median ridge.
"""

from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.metrology import ridgekernels as kernels
from anisoscope.profiles.metrology.quantity import Quantity, jackknife
from anisoscope.profiles.metrology.ridgekernels import Frame, Mask

LEVELS = 4096
MAX_BINS = 2048
TILES = 12
SAMPLES = 60_000
MIN_BINS = 8
LEAST_SLOPE = 0.3
SLOPE_WINDOW = 40
BLURRED_ENDS = 1.5


@dataclass(frozen=True)
class Grid:
    """Levelled heights (rows, cols) in µm, NaN where missing, points to leave out, and the pixel (y, x) in µm.

    ``rounded_um`` is the step to which heights are rounded, 0 where facets show no stairs.
    """

    z: FloatArray
    out: Mask
    pixel: tuple[float, float]
    rounded_um: float = 0.0


@dataclass(frozen=True)
class Course:
    """Course of the ridges over the grid.

    Attributes:
        pitch_um: distance of the walls.
        direction_deg: of the ridge lines, counter-clockwise from +y.
        lean: +1 if the large facets fall toward (cos, sin) of the direction, −1 if they fall the other way.
        offset: place of a wall in pitches from the corner of the map, in the direction in which the facets fall.
    """

    pitch_um: float
    direction_deg: float
    lean: int = 1
    offset: float = 0.0

    def downhill(self) -> tuple[float, float]:
        """Unit vector (x, y) across the ridges, in the direction in which the facets fall."""
        angle = np.radians(self.direction_deg)
        return self.lean * float(np.cos(angle)), self.lean * float(np.sin(angle))

    def frame(self, grid: Grid, shift: float = 0.5) -> Frame:
        """The course in numbers of the grid."""
        (ex, ey), (rows, cols) = self.downhill(), grid.z.shape
        ux, uy = -ey, ex
        qi, qj = ey * grid.pixel[0] / self.pitch_um, ex * grid.pixel[1] / self.pitch_um
        vi, vj = uy * grid.pixel[0], ux * grid.pixel[1]
        q = np.array([a + b for a in (0.0, qi * (rows - 1)) for b in (0.0, qj * (cols - 1))]) - self.offset
        v = [a + b for a in (0.0, vi * (rows - 1)) for b in (0.0, vj * (cols - 1))]
        first = int(np.floor(q.min()))
        length = (max(v) - min(v)) * (1.0 + 1e-9) + 1e-9
        return Frame(
            qi, qj, self.offset, vi, vj, min(v), self.pitch_um,
            first, int(np.floor(q.max())) - first + 2, length / TILES, TILES, shift,
        )  # fmt: skip

    def step_um(self, pixel: tuple[float, float]) -> float:
        """Distance across the ridges of neighbouring points of a row or column, the smaller one."""
        ex, ey = self.downhill()
        return min(pixel[1] / max(abs(ex), 1e-9), pixel[0] / max(abs(ey), 1e-9))


@dataclass(frozen=True)
class Folded:
    """The median ridge by place on it, and its spread.

    Attributes:
        height_um: (bins,) medians.
        spread_um: (bins,) robust standard deviations (interquartile range/1.349).
        shift: the places are (b + shift)/bins.
    """

    height_um: FloatArray
    spread_um: FloatArray
    shift: float


def fold_median(grid: Grid, course: Course) -> Folded:
    """Median and spread of the heights at every place on the ridge; bins are about a pixel wide.

    Rounded heights stand for all heights within their step, as in the median of grouped data.

    Raises:
        HeightMapError: a pitch of fewer than eight pixels.
    """
    bins = int(min(round(course.pitch_um / course.step_um(grid.pixel)), MAX_BINS))
    if bins < MIN_BINS:
        raise HeightMapError(
            f"the ridges are {course.pitch_um:.4g} µm apart, {bins} pixels: their facets need at least {MIN_BINS} "
            "pixels a pitch; measure with a larger magnification"
        )
    sample = grid.z.ravel()[:: max(1, grid.z.size // SAMPLES)]
    low, high = np.quantile(sample[np.isfinite(sample)], (0.002, 0.998)).tolist()
    margin = 0.2 * (high - low) + 1e-9
    low, step = low - margin, max((high - low + 2.0 * margin) / LEVELS, grid.rounded_um)
    counts, places = kernels.histogram(grid.z, grid.out, course.frame(grid), bins, low, step, LEVELS)
    total = counts.sum(axis=1)
    filled = np.flatnonzero(total)
    cumulated = np.cumsum(counts[filled], axis=1)

    def quantile(share: float) -> FloatArray:
        rank = share * total[filled]
        at = np.argmax(cumulated >= rank[:, None], axis=1)
        here = counts[filled, at]
        before = cumulated[np.arange(filled.size), at] - here
        found: FloatArray = low + step * (at + (rank - before) / here)
        return found

    shift = float(np.mean(places[filled] / total[filled] * bins - filled))
    everywhere = np.arange(bins)
    median = np.interp(everywhere, filled, quantile(0.5), period=bins)
    spread = np.interp(everywhere, filled, (quantile(0.75) - quantile(0.25)) / 1.349, period=bins)
    return Folded(median, np.maximum(spread, 0.29 * step), shift)


def _runs(mask: Mask) -> tuple[int, int]:
    """Start and length of the longest run of a ring of booleans."""
    if mask.all():
        return 0, mask.size
    start = int(np.argmin(mask))
    edges = np.diff(np.concatenate([[0], np.roll(mask, -start).astype(np.int8), [0]]))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if begins.size == 0:
        return 0, 0
    longest = int(np.argmax(ends - begins))
    return (int(begins[longest]) + start) % mask.size, int(ends[longest] - begins[longest])


@dataclass(frozen=True)
class Facet:
    """Places on the ridge of the large facet: where it begins below the crest and where it ends above the foot."""

    begin: float
    end: float

    @property
    def middle(self) -> float:
        """The place in the middle."""
        return 0.5 * (self.begin + self.end)


def _falling_run(height: FloatArray, rounded_um: float) -> tuple[int, int]:
    """First bin and length of the longest stretch that falls at about the usual slope of what falls.

    Slopes are taken over a step of rounded heights at least.
    """
    stair = 0.5 * height.size * rounded_um / max(float(np.ptp(height)), 1e-12)
    window = max(1, height.size // SLOPE_WINDOW, int(np.ceil(min(stair, 0.2 * height.size))))
    slope = np.roll(height, -window) - np.roll(height, window)
    falling = slope < 0
    if not falling.any():
        return 0, 0
    return _runs(falling & (-slope > LEAST_SLOPE * float(np.median(-slope[falling]))))


def orient(grid: Grid, course: Course, sigma_um: float = 0.0) -> tuple[Course, Facet, Folded]:
    """Turn and shift a course so that the large facets fall along it and the walls are at whole pitches.

    The large facet is the longest run of one sign of slope, one pixel and 1 % of the pitch less at both ends. Symmetric
    ridges have two such runs; then the longer one is taken. A point spread function of standard deviation ``sigma_um``
    bends the ends, which are left out.

    Returns:
        The course, the facet on it, and the median ridge.

    Raises:
        HeightMapError: too few pixels a pitch, or no facet.
    """
    half = 0.5 * course.step_um(grid.pixel) / course.pitch_um
    first = fold_median(grid, Course(course.pitch_um, course.direction_deg, 1, -half))
    steps = grid.rounded_um
    runs = {1: _falling_run(first.height_um, steps), -1: _falling_run(first.height_um[::-1], steps)}
    lean = 1 if runs[1][1] >= runs[-1][1] else -1
    bins = first.height_um.size
    height = first.height_um if lean == 1 else first.height_um[::-1]
    begin, length = runs[lean]
    if length < 3:
        raise HeightMapError(
            "the ridges of this height map have no facet: no stretch of three pixels falls evenly"
        )
    rise = np.roll(height, -(begin + length))[: bins - length + 1]
    middle = 0.5 * (float(rise.min()) + float(rise.max()))
    lowest = int(np.argmin(rise[: int(np.argmax(rise)) + 1]))
    at = lowest + int(np.argmax(rise[lowest:] >= middle))
    part = (middle - rise[at - 1]) / (rise[at] - rise[at - 1]) if at > 0 and rise[at] > rise[at - 1] else 0.0
    place = first.shift if lean == 1 else 1.0 - first.shift
    wall = (begin + length + at - 1 + float(part) + place) / bins
    offset = -half + wall if lean == 1 else half + wall
    found = Course(course.pitch_um, course.direction_deg, lean, float(offset))
    trim = (course.step_um(grid.pixel) + BLURRED_ENDS * sigma_um) / course.pitch_um + 0.01
    start = (begin + place) / bins - wall
    start -= np.floor(start)
    facet = Facet(float(start + trim), float(start + (length - 1) / bins - trim))
    if facet.end - facet.begin < 3.0 / bins:
        raise HeightMapError(
            "the facets of this height map are narrower than about six pixels: nothing to fit"
        )
    return found, facet, fold_median(grid, found)


LEAST_INFORMATION = 0.05
WALL_ROWS = 64
INTERPOLATED = 0.1
GAP_PASSES = 3
FINEST = 0.01
CLIP = 4.0
STRIPS = 6
LEAST_OF_STRIP = 4
CLEAR = 6.0


@dataclass(frozen=True)
class Positions:
    """Positions of the ridges.

    Attributes:
        course: the course after correction.
        pitch_um: its pitch.
        direction_deg: its direction.
        shift_um: (ridges,) distance of every wall from its place in the course, NaN where unknown.
        shift_u_um: (ridges,) standard uncertainties, from the scatter along the ridge.
        strip_um: rms shift between strips of the map, such as stitched fields; 0 where tiles explain it.
    """

    course: Course
    pitch_um: Quantity
    direction_deg: Quantity
    shift_um: FloatArray
    shift_u_um: FloatArray
    strip_um: float


def _shifts(sums: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(ridges, tiles) shift of every tile in µm with its height left free, its information, and its place q and v.

    On the facet alone, height and shift cannot be separated, nor pitch and tilt; what counts is the wall.
    """
    w, s, ss, e, es, q, v = (sums[..., n] for n in range(7))
    with np.errstate(divide="ignore", invalid="ignore"):
        information = np.nan_to_num(ss - s * s / w)
        information = np.asarray(np.where(information < 1e-6 * ss, 0.0, information), dtype=np.float64)
        shift = np.nan_to_num((e * s / w - es) / information, posinf=0.0, neginf=0.0)
        return shift, information, np.nan_to_num(q / ss), np.nan_to_num(v / ss)


def _normal(weight: FloatArray, design: FloatArray) -> FloatArray:
    """(ridges, 3, 4) normal equations of a plane through shifts, one for each ridge, from (ridges, tiles, 4) rows."""
    found: FloatArray = np.einsum("km,kma,kmb->kab", weight, design[..., :3], design)
    return found


def _solve(normal: FloatArray) -> FloatArray:
    """(3,) shift, and its change by q and by v, from the (3, 4) normal equations."""
    return np.asarray(np.linalg.lstsq(normal[:, :3], normal[:, 3], rcond=None)[0], dtype=np.float64)


def refine(grid: Grid, course: Course, folded: Folded, wall_um: float) -> Positions:
    """Correct pitch, direction and offset of a course by the positions of its ridges.

    Each tile (a ridge times a twelfth of the field along it) is shifted against the median ridge by weighted least
    squares; a plane through the shifts gives the corrections. Uncertainties: by leaving out one ridge after the
    other, and what the pixel grid hides: walls narrower than the largest gap between the places at which they
    are sampled may stand anywhere within that gap.

    Args:
        grid: levelled heights.
        course: where the ridges are, to a fraction of a pixel.
        folded: the median ridge there.
        wall_um: width of the wall, 0 if unknown.
    """
    frame = course.frame(grid, folded.shift)
    step = course.step_um(grid.pixel)
    slope = (
        np.gradient(np.pad(folded.height_um, 1, mode="wrap"))[1:-1] * folded.height_um.size / course.pitch_um
    )
    # equal weights on both sides of the wall: what differs from bin to bin there is where the grid happens to sample it
    steepest = np.max(np.abs([np.roll(slope, k) for k in (-1, 0, 1)]), axis=0)
    least = (
        0.1 * step * float(np.median(np.abs(slope)))
    )  # else a smooth surface a little out of place is no match
    spread = np.hypot(max(float(np.median(folded.spread_um)), least), steepest * step / np.sqrt(12.0))
    sums = kernels.phase_sums(grid.z, grid.out, frame, folded.height_um, spread)
    shift, information, q, v = _shifts(sums)
    good = information > LEAST_INFORMATION * information.max()
    middle_q, middle_v = float(np.mean(q[good])), 0.5 * frame.tile * frame.tiles
    design = np.stack([np.ones_like(q), (q - middle_q) * course.pitch_um, v - middle_v, shift], axis=-1)
    first = _normal(information * good, design)
    away = np.abs(shift - design[..., :3] @ _solve(first.sum(axis=0)))
    good &= away <= max(CLIP * 1.4826 * float(np.median(away[good])), 0.1 * step)
    weight = information * good
    parts = _normal(weight, design)
    left = shift - design[..., :3] @ _solve(parts.sum(axis=0))
    used = parts[:, 0, 0] > LEAST_INFORMATION * parts[:, 0, 0].max()
    (start, by_r, by_v), u = jackknife(parts[used], _solve, parts[used, 0, 0], fitted=2)
    ex, ey = course.downhill()
    across, along = design[..., 1], design[..., 2]
    strip = 0.0
    for place in (across * ex - along * ey, across * ey + along * ex):
        rms, u_strips = _strips(place, weight, left, design, FINEST * step)
        if rms > 0.0:
            strip, u = max(strip, rms), np.maximum(u, u_strips)
    gap = _hidden_gap(grid, course, int(used.sum()))
    # lines between places that far apart are not quite the wall, even where several of them lie on it
    dead = max(gap - wall_um, INTERPOLATED * gap, FINEST * step) / np.sqrt(6.0)
    turn = np.hypot(u[2], dead / (frame.tile * frame.tiles))
    stretch = np.hypot(u[1] * course.pitch_um, dead / max(int(used.sum()) - 1, 1))
    corrected = _corrected(
        course, start - by_r * middle_q * course.pitch_um - by_v * (middle_v + frame.v0), by_r, by_v
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.where(used, weight.sum(axis=1), np.nan)
        mean = (weight * left).sum(axis=1) / size
        scatter = (weight * (left - mean[:, None]) ** 2).sum(axis=1) / size
        count = np.count_nonzero(weight, axis=1)
        error = np.sqrt(scatter / np.maximum(count - 1, 1))
    return Positions(
        corrected,
        Quantity(corrected.pitch_um, float(stretch)),
        Quantity(corrected.direction_deg, float(np.degrees(turn))),
        mean,
        np.where(count > 2, error, np.nan),
        strip,
    )


def _strips(
    place: FloatArray, weight: FloatArray, left: FloatArray, design: FloatArray, least_um: float
) -> tuple[float, FloatArray]:
    """Rms shift in µm of strips of the map against its plane, and (3,) uncertainties of the plane by leaving each out.

    0 where the ridges in the strips scatter as much. Strips of fewer than four ridges are not looked at: what is
    between groups of ridges is between ridges.

    Args:
        place: (ridges, tiles) place of the tiles, along which the strips follow each other.
        weight: (ridges, tiles) weight of the tiles.
        left: (ridges, tiles) their shifts against the plane in µm.
        design: (ridges, tiles, 4) rows of the plane's least squares.
        least_um: least standard uncertainty of a strip.
    """
    on = weight > 0.0
    edges = np.linspace(float(place[on].min()), float(place[on].max()) + 1e-9, STRIPS + 1)
    strip = np.digitize(place, edges[1:-1])
    parts, means, errors = [], [], []
    for k in range(STRIPS):
        w = weight * (strip == k)
        ridges = int(np.count_nonzero(w.any(axis=1)))
        if ridges < LEAST_OF_STRIP:
            continue
        means.append(float((w * left).sum() / w.sum()))
        each = (w * (left - means[-1])).sum(axis=1) / w.sum()
        errors.append(float(each @ each) * ridges / (ridges - 1))
        parts.append(_normal(w, design).sum(axis=0))
    freedom = len(parts) - 3
    if freedom < 1:
        return 0.0, np.zeros(3)
    squares, variance = np.square(means), np.maximum(errors, least_um**2)
    if float(np.sum(squares / variance)) < freedom + CLEAR * np.sqrt(2.0 * freedom):
        return 0.0, np.zeros(3)
    normal = np.stack(parts)
    _, u = jackknife(normal, _solve, normal[:, 0, 0], fitted=3)
    return float(np.sqrt(np.mean(squares))), np.sqrt(2.0) * u  # neighbouring strips may be of one field


def _corrected(course: Course, start: float, by_r: float, by_v: float) -> Course:
    """The course whose walls are ``start`` + ``by_r``·(q·pitch) + ``by_v``·v µm further."""
    ex, ey = course.downhill()
    fx = ((1.0 - by_r) * ex + by_v * ey) / course.pitch_um
    fy = ((1.0 - by_r) * ey - by_v * ex) / course.pitch_um
    # q counts from the offset: q = f·x − offset, and shifts were fitted over q, not over f·x
    offset = course.offset * (1.0 - by_r) + start / course.pitch_um
    size = float(np.hypot(fx, fy))
    angle = float(np.degrees(np.arctan2(course.lean * fy, course.lean * fx)))
    lean, offset = course.lean, float(offset)
    if not -90.0 < angle <= 90.0:
        angle, lean = angle - np.copysign(180.0, angle), -lean
    return replace(course, pitch_um=1.0 / size, direction_deg=angle, offset=offset, lean=lean)


def _hidden_gap(grid: Grid, course: Course, walls: int) -> float:
    """The largest gap of all courses that the gap itself leaves open.

    Few walls along the grid are sampled at few places, which a slightly wrong pitch spreads too widely.
    """
    gap = _gap(grid, course)
    for _ in range(GAP_PASSES):
        open_um = gap / max(walls - 1, 1)
        near = [_gap(grid, replace(course, pitch_um=course.pitch_um + way * open_um)) for way in (-1.0, 1.0)]
        gap = max(gap, *near)
    return gap


def _gap(grid: Grid, course: Course) -> float:
    """Largest gap in µm between the places, a pixel about the walls, at which the map samples them."""
    frame, step = course.frame(grid), course.step_um(grid.pixel)
    rows, cols = grid.z.shape
    i = np.arange(0, rows, max(1, rows // WALL_ROWS)) if abs(frame.qj) >= abs(frame.qi) else np.arange(rows)
    j = np.arange(cols) if abs(frame.qj) >= abs(frame.qi) else np.arange(0, cols, max(1, cols // WALL_ROWS))
    q = np.add.outer(i * frame.qi, j * frame.qj) - frame.q0
    from_wall = (q - np.rint(q)).ravel() * course.pitch_um
    near = np.sort(from_wall[np.abs(from_wall) <= step])
    return float(np.diff(near).max()) if near.size > 1 else 2.0 * step
