"""The median ridge of a levelled map: which way its large facets lean, where they lie and where the walls stand."""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.metrology import ridgekernels as kernels
from anisoscope.profiles.metrology.ridgekernels import Frame, Mask

LEVELS = 4096
MAX_BINS = 2048
TILES = 12
SAMPLES = 60_000
MIN_BINS = 8
LEAST_SLOPE = 0.3
SLOPE_WINDOW = 40


@dataclass(frozen=True)
class Grid:
    """Levelled heights (rows, cols) in µm, NaN where missing, points to leave out, and the pixel (y, x) in µm."""

    z: FloatArray
    out: Mask
    pixel: tuple[float, float]


@dataclass(frozen=True)
class Course:
    """How the ridges run over the grid.

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
    low, step = low - margin, (high - low + 2.0 * margin) / LEVELS
    counts, places = kernels.histogram(grid.z, grid.out, course.frame(grid), bins, low, step, LEVELS)
    total = counts.sum(axis=1)
    filled = np.flatnonzero(total)
    cumulated = np.cumsum(counts[filled], axis=1)

    def quantile(share: float) -> FloatArray:
        wanted = share * total[filled]
        at = np.argmax(cumulated >= wanted[:, None], axis=1)
        here = counts[filled, at]
        before = cumulated[np.arange(filled.size), at] - here
        found: FloatArray = low + step * (at + (wanted - before) / here)
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


def _falling_run(height: FloatArray) -> tuple[int, int]:
    """First bin and length of the longest stretch that falls at about the usual slope of what falls."""
    window = max(1, height.size // SLOPE_WINDOW)
    slope = np.roll(height, -window) - np.roll(height, window)
    falling = slope < 0
    if not falling.any():
        return 0, 0
    return _runs(falling & (-slope > LEAST_SLOPE * float(np.median(-slope[falling]))))


def orient(grid: Grid, course: Course) -> tuple[Course, Facet, Folded]:
    """Turn and shift a course so that the large facets fall along it and the walls stand at whole pitches.

    The large facet is the longest run of one sign of slope, one pixel and 1 % of the pitch less at both ends. Symmetric
    ridges have two such runs; then the longer one is taken.

    Returns:
        The course, the facet on it, and the median ridge.

    Raises:
        HeightMapError: too few pixels a pitch, or no facet.
    """
    half = 0.5 * course.step_um(grid.pixel) / course.pitch_um
    first = fold_median(grid, Course(course.pitch_um, course.direction_deg, 1, -half))
    runs = {1: _falling_run(first.height_um), -1: _falling_run(first.height_um[::-1])}
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
    trim = course.step_um(grid.pixel) / course.pitch_um + 0.01
    start = (begin + place) / bins - wall
    start -= np.floor(start)
    facet = Facet(float(start + trim), float(start + (length - 1) / bins - trim))
    if facet.end - facet.begin < 3.0 / bins:
        raise HeightMapError(
            "the facets of this height map are narrower than about six pixels: nothing to fit"
        )
    return found, facet, fold_median(grid, found)
