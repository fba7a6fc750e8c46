"""Registration of two height maps: where the points of one lie in the other.

Coarse: normalised cross-correlation of the measured points (Padfield 2012) over all shifts, and over turns from the
directions of the ridges or on a grid of angles. The best places of it are refined,
and the one whose heights agree best counts: ridges agree at every pitch, only what differs from ridge to ridge tells
them apart. Fine: least squares of the heights at full resolution, with Tukey weights, so that what has changed between
the maps does not move them. The scale is fitted in the end, as a check; the registered position stays rigid.
"""

from copy import copy
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, RegistrationError
from anisoscope.base.json_fields import in_json
from anisoscope.profiles.editing.interpolation import Interpolated, averaged, continued
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.fold import fold
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.period import Period, find_period
from anisoscope.profiles.textures.forms import fit_form

ANGLE_POINTS, SHIFT_POINTS = 96, 320
ANGLES_DEG = tuple(float(angle) for angle in range(-12, 13, 2))
LEAST_OVERLAP, LEAST_OVERLAP_NEAR = 0.25, 0.05
LEAST_CORRELATION, LEAST_AGREEMENT = 0.3, 0.6
FIT_SAMPLES, TRIAL_SAMPLES = 100_000, 8_000
ROUNDS, TRIAL_ROUNDS = 40, 6
CANDIDATES = 10
RIDGES_AGREE = 0.1
SETTLED_PIXELS = 5e-4
INTERPOLATED = 0.015
"""Standard deviation of the shift in pixels that comes of interpolation."""
BETWEEN_POINTS, FAR_BETWEEN_POINTS, NO_EDGES = 0.1, 0.6, 10.0
STEEP = 1.5
CLEAR_PIXELS = 0.03
TRAP_PIXELS = 1.5
LEAST_COST, FLOOR = 2e-3, 1e-3
CHANGED, CHANGE_POINTS = 1.5, 5
TUKEY = 4.685
MAD = 1.4826
TILES = 8
LEAST_INFORMATION = 0.3
SMOOTH_PIXELS = 1.0


@dataclass(frozen=True)
class Placed:
    """Places of the points of a first map in a second one.

    A point at p from the middle of the first map lies at R(angle)·p + (x, y) from the middle of the second; heights of
    the second exceed those of the first by the plane offset + slope_x·x + slope_y·y about the middle of the first.

    Attributes:
        x_um: shift along x.
        y_um: shift along y.
        angle_deg: by how much the second map is turned counter-clockwise.
        u_x_um: standard uncertainty of the shift; None along ridges that carry nothing to tell it by.
        u_y_um: the same along y.
        u_angle_deg: standard uncertainty of the angle.
        scale: size in the second map over size in the first, fitted as a check; the shift is that of scale 1.
        u_scale: its standard uncertainty.
        offset_um: offset of the heights.
        slope_x: slope of the plane along x.
        slope_y: slope along y.
        u_offset_um: standard uncertainty of the offset.
        residual_um: robust standard deviation of the heights against each other, under a Gaussian of a pixel.
        overlap: share of the first map's measured points that are measured in the second.
        correlation: of the heights of both without their planes, −1 to 1.
        ambiguity: how well the second best place agrees against the best, 0 to 1; near 1 the maps agree at several
            places, as ridges without anything else do, and the place of largest overlap was taken.
    """

    x_um: float
    y_um: float
    angle_deg: float
    u_x_um: float | None
    u_y_um: float | None
    u_angle_deg: float
    scale: float
    u_scale: float
    offset_um: float
    slope_x: float
    slope_y: float
    u_offset_um: float
    residual_um: float
    overlap: float
    correlation: float
    ambiguity: float

    @property
    @in_json()
    def scale_agrees(self) -> bool:
        """Whether the scales of the maps agree within 3 u, or within 1 in 1000."""
        return abs(self.scale - 1.0) <= max(3.0 * self.u_scale, 1e-3)

    def plane_um(self, y_um: FloatArray, x_um: FloatArray) -> FloatArray:
        """By how much the plane of the second map exceeds that of the first, at points in µm from the middle."""
        return np.asarray(self.offset_um + self.slope_y * y_um + self.slope_x * x_um)

    def positions(
        self, y_um: FloatArray, x_um: FloatArray, second: HeightMap
    ) -> tuple[FloatArray, FloatArray]:
        """(y, x): where points of the first map, from its middle, lie in the second, from its first point; in µm."""
        motion = np.array([self.x_um, self.y_um, np.radians(self.angle_deg), 1.0])
        return _moved(y_um, x_um, motion, _middle(second))

    def found_at(
        self, y_um: FloatArray, x_um: FloatArray, second: HeightMap
    ) -> tuple[FloatArray, FloatArray]:
        """(y, x): the opposite of ``positions``."""
        middle = _middle(second)
        y, x = y_um - middle[0] - self.y_um, x_um - middle[1] - self.x_um
        cos, sin = np.cos(np.radians(self.angle_deg)), np.sin(np.radians(self.angle_deg))
        return cos * y - sin * x, cos * x + sin * y


def centred_axes(surface: HeightMap) -> tuple[FloatArray, FloatArray]:
    """Positions (rows,) along y and (cols,) along x of the points of a map from its middle, in µm."""
    rows, cols = surface.shape
    y = (np.arange(rows, dtype=np.float64) - 0.5 * (rows - 1)) * surface.pixel_y_um
    x = (np.arange(cols, dtype=np.float64) - 0.5 * (cols - 1)) * surface.pixel_x_um
    return y, x


def _middle(surface: HeightMap) -> tuple[float, float]:
    rows, cols = surface.shape
    return 0.5 * (rows - 1) * surface.pixel_y_um, 0.5 * (cols - 1) * surface.pixel_x_um


def _moved(
    y: FloatArray, x: FloatArray, motion: FloatArray, middle: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    cos, sin = motion[3] * np.cos(motion[2]), motion[3] * np.sin(motion[2])
    return middle[0] + motion[1] + sin * x + cos * y, middle[1] + motion[0] + cos * x - sin * y


def register(
    first: HeightMap,
    second: HeightMap,
    *,
    near_um: tuple[float, float] | None = None,
    search_deg: float = 12.0,
) -> Placed:
    """Find where the points of the first map lie in the second.

    Args:
        first: the map that stays, (rows, cols) in µm.
        second: the other map; pixel and size may differ.
        near_um: (x, y) shift about which to search, within a quarter of the field; all shifts where it is not given.
        search_deg: largest turn that is tried; directions of ridges are tried whatever it is.

    Raises:
        RegistrationError: the maps have too little in common, or overlap too little.
        HeightMapError: nothing was measured.
    """
    for surface in (first, second):
        check_heights("height map", surface.height_um)
    one, two = (
        surface.with_height(surface.height_um - fit_form(surface, "plane").height_um)
        for surface in (first, second)
    )
    pixel = _coarse_pixel(one, two, SHIFT_POINTS)
    small = (
        (one, two) if pixel < 1.5 * _largest_pixel(one, two) else (_shrunk(one, pixel), _shrunk(two, pixel))
    )
    trial = _Pair(*small, TRIAL_SAMPLES)
    costs = []
    for start in _coarse(one, two, near_um, search_deg):
        try:
            found = _Fit(trial, start, TRIAL_ROUNDS)
        except RegistrationError:
            continue
        costs.append((found.cost(), found.motion))
    if not costs:
        raise RegistrationError("the maps overlap too little to register them; take maps that share more")
    costs.sort(key=lambda one: one[0])
    pair = _Pair(one, two, FIT_SAMPLES)
    fit = _best_fit(pair, costs[0][1])
    planes = _plane_numbers(first, one), _plane_numbers(second, two)
    reach = 0.5 * min(*one.extent_um, *two.extent_um) / SHIFT_POINTS + 3.0 * pixel
    others = [cost for cost, motion in costs[1:] if np.hypot(*(motion - costs[0][1])[:2]) > reach]
    return fit.placed(planes, costs[0][0] / others[0] if others else 0.0)


def _best_fit(pair: "_Pair", start: FloatArray) -> "_Fit":
    """The fit without edges, which wear moves, where the rest determines the place; else that with them."""
    whole = _Fit(pair, start, ROUNDS)
    pixel = min(pair.two.pixel_x_um, pair.two.pixel_y_um)
    inner = whole
    try:
        for pass_ in range(3):
            unchanged = np.ones(pair.z.size, dtype=bool) if pass_ == 0 else inner.unchanged()
            inner = _Fit(pair.part(unchanged), inner.motion, ROUNDS, NO_EDGES, pair)
    except RegistrationError:
        return whole
    clear = inner.fixed is not None and not len(inner.fixed) and float(inner.u().max()) < CLEAR_PIXELS * pixel
    return inner if clear else _without_trap(pair, whole)


def _without_trap(pair: "_Pair", fit: "_Fit") -> "_Fit":
    """A fit by edges, or that from where rejected points pull it to, if it agrees better.

    Worn walls a pixel aside may all be rejected, and then nothing tells that they are aside.
    """
    pull = fit.unrejected_step(edges=True)[:2]
    away = TRAP_PIXELS * min(pair.two.pixel_x_um, pair.two.pixel_y_um) / max(float(np.hypot(*pull)), 1e-300)
    try:
        other = _Fit(pair, fit.motion + np.append(max(away, 1.0) * pull, [0.0, 0.0]), ROUNDS)
    except RegistrationError:
        return fit
    sigma = min(fit.deviation(), other.deviation())
    return other if other.disagreement(sigma) < fit.disagreement(sigma) else fit


def _plane_numbers(surface: HeightMap, flat: HeightMap) -> FloatArray:
    """Offset at the middle and slopes along x and y of the plane that was taken off."""
    plane = fit_form(surface, "plane").height_um
    rows, cols = flat.shape
    slope_y = float(plane[-1, 0] - plane[0, 0]) / ((rows - 1) * flat.pixel_y_um)
    slope_x = float(plane[0, -1] - plane[0, 0]) / ((cols - 1) * flat.pixel_x_um)
    return np.array([0.5 * float(plane[0, 0] + plane[-1, -1]), slope_x, slope_y])


def _largest_pixel(one: HeightMap, two: HeightMap) -> float:
    return max(one.pixel_x_um, one.pixel_y_um, two.pixel_x_um, two.pixel_y_um)


def _coarse_pixel(one: HeightMap, two: HeightMap, points: int) -> float:
    return max(_largest_pixel(one, two), max(*one.extent_um, *two.extent_um) / points)


def _shrunk(surface: HeightMap, pixel_um: float) -> HeightMap:
    """A map with square pixels of at least this size."""
    steps = [
        pixel_um if pixel_um > 1.01 * pixel else pixel for pixel in (surface.pixel_y_um, surface.pixel_x_um)
    ]
    return averaged(surface, (steps[0], steps[1]))


def _square(surface: HeightMap, pixel_um: float, angle: float = 0.0) -> FloatArray:
    """Heights on square pixels about the middle of the field, turned back by an angle (radians)."""
    height, width = surface.extent_um
    reach_y = abs(height * np.cos(angle)) + abs(width * np.sin(angle))
    reach_x = abs(width * np.cos(angle)) + abs(height * np.sin(angle))
    rows, cols = (2 * int(0.5 * reach / pixel_um) + 1 for reach in (reach_y, reach_x))
    y = (np.arange(rows, dtype=np.float64) - rows // 2)[:, None] * pixel_um
    x = (np.arange(cols, dtype=np.float64) - cols // 2)[None, :] * pixel_um
    return Interpolated(surface).at(*_moved(y, x, np.array([0.0, 0.0, angle, 1.0]), _middle(surface)))


def _coarse(
    one: HeightMap, two: HeightMap, near_um: tuple[float, float] | None, search_deg: float
) -> list[FloatArray]:
    """Shift (x, y), angle and scale of the highest correlations."""
    periods = find_period(one), find_period(two)
    ridged = all(period.is_periodic for period in periods)
    angles = _angles(periods, search_deg)
    if len(angles) > 1:
        pixel = _coarse_pixel(one, two, ANGLE_POINTS)
        small = _shrunk(one, pixel), _shrunk(two, pixel)
        heights = [_Correlated(*small, angle, pixel, near_um).highest() for angle in angles]
        angles = [angles[int(np.argmax(heights))]]
    pixel = _coarse_pixel(one, two, SHIFT_POINTS)
    whole = _Correlated(_shrunk(one, pixel), _shrunk(two, pixel), angles[0], pixel, near_um)
    if not whole.highest() >= LEAST_CORRELATION:
        raise RegistrationError(
            f"the maps have too little in common to register them (correlation {whole.highest():.2f}, at least "
            f"{LEAST_CORRELATION:g}); check that both show the same place, whether one is mirrored, and remove strong "
            "form"
        )
    found = whole.best(whole.value)
    if ridged:
        # among the places where ridges stand on ridges, that where what differs from ridge to ridge agrees
        first, second = (
            _shrunk(_without_ridges(*each), pixel) for each in zip((one, two), periods, strict=True)
        )
        rest = _Correlated(first, second, angles[0], pixel, near_um)
        fits = whole.value >= whole.highest() - RIDGES_AGREE
        found = rest.best(np.where(fits, rest.value, -1.0)) + found
    if near_um is None:
        found.append(np.array([0.0, 0.0, angles[0], 1.0]))
    return found


def _angles(periods: tuple[Period, Period], search_deg: float) -> list[float]:
    """Turns in radians that are worth trying."""
    if all(period.is_periodic for period in periods):
        turn = np.radians(periods[1].direction_deg - periods[0].direction_deg)
        return [float(turn), float(turn + np.pi)]
    return [float(np.radians(angle)) for angle in ANGLES_DEG if abs(angle) <= search_deg] or [0.0]


def _without_ridges(surface: HeightMap, period: Period) -> HeightMap:
    """Heights against the median ridge; where they differ much, at walls, cut."""
    folded = fold(surface, period.pitch_um, period.direction_deg)
    rest = surface.height_um - folded.at(folded.phase)
    spread = MAD * float(np.nanmedian(np.abs(rest)))
    return surface.with_height(np.clip(rest, -3.0 * spread, 3.0 * spread))


class _Correlated:
    """Correlation of the first map with the second turned back by an angle, and the shifts (x, y) in µm."""

    def __init__(
        self,
        one: HeightMap,
        two: HeightMap,
        angle: float,
        pixel: float,
        near_um: tuple[float, float] | None,
    ) -> None:
        self.angle = angle
        value = _correlations(
            _square(one, pixel),
            _square(two, pixel, angle),
            LEAST_OVERLAP if near_um is None else LEAST_OVERLAP_NEAR,
        )
        rows, cols = (np.arange(n) - n // 2 for n in value.shape)
        # the turned map is shifted along its own axes
        self.x = pixel * (np.cos(angle) * cols[None, :] - np.sin(angle) * rows[:, None])
        self.y = pixel * (np.sin(angle) * cols[None, :] + np.cos(angle) * rows[:, None])
        if near_um is not None:
            far = np.maximum(
                np.abs(self.x - near_um[0]) / (0.25 * one.extent_um[1]),
                np.abs(self.y - near_um[1]) / (0.25 * one.extent_um[0]),
            )
            value = np.where(far <= 1.0, value, -1.0)
        self.value = value

    def highest(self) -> float:
        """The highest correlation."""
        return float(self.value.max())

    def best(self, value: FloatArray) -> list[FloatArray]:
        """Shift, angle and scale of the highest peaks of a field like the correlation."""
        from scipy import ndimage  # noqa: PLC0415 - slow to import

        peaks = (value >= ndimage.maximum_filter(value, 5)) & (value > -1.0)
        places = np.argwhere(peaks)
        # of places that agree alike, as along ideal ridges, those of largest overlap come first
        far = np.hypot(self.x[peaks], self.y[peaks])
        order = np.lexsort((far, -np.round(value[peaks], 3)))[:CANDIDATES]
        return [np.array([self.x[i, j], self.y[i, j], self.angle, 1.0]) for i, j in places[order]]


def _correlations(a: FloatArray, b: FloatArray, least: float) -> FloatArray:
    """Correlation of the common measured points at every shift; (i, j) from the middle: b is i rows, j columns on.

    −1 where less than the share ``least`` of the smaller map is common. Source: Padfield 2012, eq. 18.
    """
    from scipy import fft  # noqa: PLC0415 - slow to import

    known = [np.isfinite(one) for one in (a, b)]
    data = [
        np.where(k, one - np.mean(one[k]), 0.0) if k.any() else np.zeros(one.shape)
        for one, k in zip((a, b), known, strict=True)
    ]
    full = [n + m - 1 for n, m in zip(a.shape, b.shape, strict=True)]
    size = [fft.next_fast_len(n, real=True) for n in full]

    def spectrum(field: FloatArray) -> npt.NDArray[np.complex128]:
        return np.asarray(fft.rfft2(field, size))

    first = [spectrum(field) for field in (known[0].astype(np.float64), data[0], data[0] ** 2)]
    second = [spectrum(field) for field in (known[1].astype(np.float64), data[1], data[1] ** 2)]

    def sums(left: int, right: int) -> FloatArray:
        return np.asarray(fft.irfft2(np.conj(first[left]) * second[right], size))

    pairs = np.maximum(np.rint(sums(0, 0)), 0.0)
    enough = pairs >= max(least * min(np.count_nonzero(k) for k in known), 4.0)
    count = np.maximum(pairs, 1.0)
    sum_a, sum_b = sums(1, 0), sums(0, 1)
    mixed = sums(1, 1) - sum_a * sum_b / count
    spread = (sums(2, 0) - sum_a**2 / count) * (sums(0, 2) - sum_b**2 / count)
    tiny = 1e-9 * max(float(spread.max()), 0.0)
    value = np.where(enough & (spread > tiny), mixed / np.sqrt(np.maximum(spread, tiny + 1e-300)), -1.0)
    # lag (i, j) of b against a lies at index (i, j) modulo the size; bring the middles of both together
    shift = [m // 2 - n // 2 for n, m in zip(a.shape, b.shape, strict=True)]
    half = [max((n + m) // 2 - 2, 0) for n, m in zip(a.shape, b.shape, strict=True)]
    rows, cols = ((np.arange(-h, h + 1) + s) % n for h, s, n in zip(half, shift, size, strict=True))
    return np.asarray(value[np.ix_(rows, cols)])


class _Pair:
    """Points of the first map, and the second one between its points, with slopes."""

    def __init__(self, one: HeightMap, two: HeightMap, samples: int) -> None:
        self.two = two
        self.middle = _middle(two)
        self.noise = white_noise(two)
        width_um = SMOOTH_PIXELS * _largest_pixel(one, two)
        one, two = _smoothed(one, width_um), _smoothed(two, width_um)
        self.width_um = width_um
        self.between, self.linear = Interpolated(two, 3), Interpolated(two)
        slopes = np.gradient(continued(two.height_um), two.pixel_y_um, two.pixel_x_um)
        self.slopes = [Interpolated(two.with_height(np.asarray(slope))) for slope in slopes]
        y, x = centred_axes(one)
        i, j = np.nonzero(np.isfinite(one.height_um))
        step = max(1, i.size // samples)
        self.one, self.places = one, (i[::step], j[::step])
        self.tile = (i[::step] * TILES // one.shape[0]) * TILES + j[::step] * TILES // one.shape[1]
        self.y, self.x, self.z = y[i[::step]], x[j[::step]], one.height_um[i[::step], j[::step]]
        self.length = max(float(np.hypot(y[-1], x[-1])), 1e-9)
        self.floor = max(FLOOR * float(np.std(self.z)), 1e-9)

    def part(self, chosen: npt.NDArray[np.bool_]) -> "_Pair":
        """The same with some of the points."""
        found = copy(self)
        found.places = self.places[0][chosen], self.places[1][chosen]
        found.tile = self.tile[chosen]
        found.y, found.x, found.z = (values[chosen] for values in (self.y, self.x, self.z))
        return found


class _Fit:
    """Least squares of shift, angle, plane, and in the end scale."""

    def __init__(
        self,
        pair: _Pair,
        start: FloatArray,
        rounds: int,
        between: float = BETWEEN_POINTS,
        whole: _Pair | None = None,
    ) -> None:
        self.between = between
        self.whole = pair if whole is None else whole
        self.pair = pair
        self.two, self.length = pair.two, pair.length
        self.y, self.x, self.z = pair.y, pair.x, pair.z
        self.motion = start.copy()
        self.plane = np.zeros(3)
        self.rounds = rounds
        self.fixed: FloatArray | None = None
        self._settle()

    def _residuals(self) -> tuple[FloatArray, FloatArray]:
        """Residuals (n,), NaN where the second map is missing, and their derivatives (n, 7), of similar size each."""
        py, px = _moved(self.y, self.x, self.motion, self.pair.middle)
        off = self.pair.between.at(py, px) - self.z
        off -= self.plane[0] + (self.plane[1] * self.x + self.plane[2] * self.y) / self.length
        by, bx = (slope.at(py, px) for slope in self.pair.slopes)
        cos, sin = np.cos(self.motion[2]), np.sin(self.motion[2])
        turned_x, turned_y = cos * self.x - sin * self.y, sin * self.x + cos * self.y
        ones = np.ones_like(off)
        columns = (
            bx, by, (by * turned_x - bx * turned_y) / self.length, (bx * turned_x + by * turned_y) / self.length,
            -ones, -self.x / self.length, -self.y / self.length,
        )  # fmt: skip
        return off, np.stack(columns, axis=1)

    def _system(
        self, between: float | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray, npt.NDArray[np.bool_], float]:
        """Residuals and derivatives of the common points, their weights, which they are, and the deviation.

        Where the surface is steeper than elsewhere, what interpolation does not know counts like a displacement by
        ``between`` pixels. Weights are relative to those of a flat place.
        """
        between = self.between if between is None else between
        off, design = self._residuals()
        known = np.isfinite(off) & np.isfinite(design).all(axis=1)
        if np.count_nonzero(known) < max(50, 0.02 * off.size):
            raise RegistrationError(
                f"the registered maps have only {np.count_nonzero(known)} points in common; take maps that "
                "overlap more"
            )
        off, design = off[known], design[known]
        blur = self._blur(design, between)
        sigma = max(MAD * float(np.median(np.abs(off - np.median(off)))), self.pair.floor)
        spread = np.hypot(sigma, blur)
        apart = off / (TUKEY * spread)
        weight = np.where(np.abs(apart) < 1.0, (1.0 - apart**2) ** 2, 0.0) * (sigma / spread) ** 2
        return off, design, weight, known, sigma

    def _blur(self, design: FloatArray, between: float | None = None) -> FloatArray:
        """Heights (n,) in µm that a displacement by ``between`` pixels makes where it is steeper than elsewhere."""
        pixel = np.array([self.two.pixel_x_um, self.two.pixel_y_um])
        slope = np.hypot(design[:, 0] * pixel[0], design[:, 1] * pixel[1])
        steep = np.maximum(slope - STEEP * float(np.median(slope)), 0.0)
        return np.asarray((self.between if between is None else between) * steep)

    def _settle(self) -> None:
        pixel = min(self.two.pixel_x_um, self.two.pixel_y_um)
        free = [0, 1, 2, 4, 5, 6]
        for count in range(self.rounds):
            rough = count < TRIAL_ROUNDS - 1
            off, design, weight, _, _ = self._system(max(FAR_BETWEEN_POINTS, self.between) if rough else None)
            part = design[:, free]
            normal = part.T @ (weight[:, None] * part)
            if self.fixed is None:
                self.fixed = self._undetermined(normal[:2, :2], float(np.sum(weight)))
            step = self._solve(normal, -part.T @ (weight * off))
            step[:3] *= min(1.0, 2.0 * pixel / max(float(np.abs(step[:3]).max()), 1e-300))
            self.motion[:2] += step[:2]
            self.motion[2] += step[2] / self.length
            self.plane += step[3:]
            if not rough and float(np.abs(step[:3]).max()) < SETTLED_PIXELS * pixel:
                break

    def _undetermined(self, information: FloatArray, count: float) -> FloatArray:
        """Directions (k, 2) of the shift that only noise would determine."""
        # slopes of white noise after a Gaussian of width s have the variance σ²·pixel area/(8πs⁴)
        area = self.two.pixel_x_um * self.two.pixel_y_um
        own = np.eye(2) * count * self.pair.noise**2 * area / (8.0 * np.pi * self.pair.width_um**4)
        values, vectors = np.linalg.eigh(information)
        real = np.array([float(v @ (information - own) @ v) for v in vectors.T])
        lost = (real < LEAST_INFORMATION * np.maximum(values, 0.0)) | (values <= 1e-6 * values[-1])
        return np.asarray(vectors.T[lost])

    def _solve(self, normal: FloatArray, right: FloatArray) -> FloatArray:
        """Solution without steps in directions that are not determined."""
        if self.fixed is not None and len(self.fixed):
            keep = np.eye(normal.shape[0])
            for direction in self.fixed:
                keep[:2, :2] -= np.outer(direction, direction)
            normal, right = keep @ normal @ keep, keep @ right
        return np.asarray(np.linalg.lstsq(normal, right, rcond=1e-12)[0])

    def unchanged(self) -> npt.NDArray[np.bool_]:
        """Mask of points of the pair away from places where the maps differ.

        Next to a change the difference is too small to be rejected, but not zero.
        """
        from scipy import ndimage  # noqa: PLC0415 - slow to import

        one = self.whole.one
        y, x = np.meshgrid(*centred_axes(one), indexing="ij")
        off = self.whole.between.at(*_moved(y, x, self.motion, self.whole.middle)) - one.height_um
        off -= self.plane[0] + (self.plane[1] * x + self.plane[2] * y) / self.length
        sigma = self._system()[4]
        near = ndimage.uniform_filter(np.nan_to_num(off), CHANGE_POINTS, mode="nearest")
        changed = ndimage.binary_dilation(np.abs(near) > CHANGED * sigma, iterations=CHANGE_POINTS - 1)
        return np.asarray(~changed[self.whole.places])

    def cost(self) -> float:
        """Cost of the fit: deviation of the heights, larger where few points are common."""
        _, _, _, known, sigma = self._system()
        least = LEAST_COST * float(np.std(self.z))
        return float(np.hypot(sigma, least)) / float(np.sqrt(np.mean(known)))

    def deviation(self) -> float:
        """Robust standard deviation of the heights against each other, at least the floor."""
        return self._system()[4]

    def disagreement(self, sigma: float) -> float:
        """Mean of Tukey's function over the common points, 0 where they agree, 1 where they are rejected."""
        off, design, _, _, _ = self._system()
        apart = np.minimum(np.abs(off) / (TUKEY * np.hypot(sigma, self._blur(design))), 1.0)
        return float(np.mean(1.0 - (1.0 - apart**2) ** 3))

    def unrejected_step(self, *, edges: bool) -> FloatArray:
        """Step (x, y, turn · length, scale) of the fit if no point were rejected.

        Args:
            edges: whether steep places count like others.
        """
        off, design, _, _, sigma = self._system()
        weight = np.ones(off.size) if edges else (sigma / np.hypot(sigma, self._blur(design))) ** 2
        free = [0, 1, 2, 4, 5, 6]
        part = design[:, free]
        step = self._solve(part.T @ (weight[:, None] * part), -part.T @ (weight * off))
        return np.append(step[:3], 0.0)

    def u(self) -> FloatArray:
        """Standard uncertainties (2,) of the shift in µm, of noise alone."""
        off, design, weight, known, _ = self._system()
        covariance = self._covariance(off, design, weight, self.pair.tile[known])
        return np.asarray(np.sqrt(np.maximum(np.diag(covariance)[:2], 0.0)))

    def placed(self, planes: tuple[FloatArray, FloatArray], ambiguity: float) -> Placed:
        """The result, with the planes (offset, slope x, slope y) of both maps put back."""
        off, design, weight, known, sigma = self._system()
        covariance = self._covariance(off, design, weight, self.pair.tile[known])
        scale_step = self._scale(off, design, weight)
        by_interpolation = self._linear_step(design, weight, known)
        fixed = self.fixed if self.fixed is not None else np.empty((0, 2))
        loose = [bool(len(fixed)) and bool(np.any(np.abs(fixed[:, k]) > 0.05)) for k in (0, 1)]
        u = np.sqrt(np.maximum(np.diag(covariance), 0.0) + by_interpolation**2)
        # what has changed may pull at the fit by anything between nothing and the whole
        u[:3] = np.hypot(u[:3], self.unrejected_step(edges=False)[:3] / np.sqrt(12.0))
        # between the points of a surface with walls no interpolation is right, whatever the noise
        beside = INTERPOLATED * np.array([self.two.pixel_x_um, self.two.pixel_y_um])
        leaning = np.abs(weight @ design[:, :2]) / np.sum(weight)
        u[:2], u[4] = np.hypot(u[:2], beside), float(np.hypot(u[4], np.hypot(*(leaning * beside))))
        u[3] = np.hypot(u[3], beside.max())  # at the border, a length away
        first, second = planes
        cos, sin = np.cos(self.motion[2]), np.sin(self.motion[2])
        # slopes of the second map's plane, along the axes of the first
        turned = np.array([cos * second[1] + sin * second[2], -sin * second[1] + cos * second[2]])
        slopes = self.plane[1:] / self.length + turned - first[1:]
        offset = (
            self.plane[0] + second[0] - first[0] + second[1] * self.motion[0] + second[2] * self.motion[1]
        )
        z = self.z[known]
        if not sigma < LEAST_AGREEMENT * float(np.std(z)):
            raise RegistrationError(
                f"the maps have too little in common to register them: their heights differ by {sigma:.3g} µm, those "
                f"of one by {float(np.std(z)):.3g} µm; check that both show the same place, and whether one is mirrored"
            )
        both = np.corrcoef(z, z + off)[0, 1] if np.ptp(z) > 0.0 else 0.0
        angle = float(np.degrees(self.motion[2]))
        return Placed(
            x_um=float(self.motion[0]), y_um=float(self.motion[1]), angle_deg=180.0 - (180.0 - angle) % 360.0,
            u_x_um=None if loose[0] else float(u[0]), u_y_um=None if loose[1] else float(u[1]),
            u_angle_deg=float(np.degrees(u[2] / self.length)),
            scale=1.0 + scale_step / self.length, u_scale=float(u[3] / self.length),
            offset_um=float(offset), slope_x=float(slopes[0]), slope_y=float(slopes[1]), u_offset_um=float(u[4]),
            residual_um=sigma, overlap=float(np.mean(known)), correlation=float(both), ambiguity=float(ambiguity),
        )  # fmt: skip

    def _covariance(
        self, off: FloatArray, design: FloatArray, weight: FloatArray, tile: npt.NDArray[np.intp]
    ) -> FloatArray:
        """Covariance from the scatter of tiles of the field, whose points may be correlated (sandwich estimator)."""
        normal = design.T @ (weight[:, None] * design)
        score = weight[:, None] * design * off[:, None]
        tiles = np.stack([np.bincount(tile, column, minlength=TILES * TILES) for column in score.T], axis=1)
        tiles = tiles[np.bincount(tile, minlength=TILES * TILES) > 0]
        meat = tiles.T @ tiles * (len(tiles) / max(len(tiles) - design.shape[1], 1))
        inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
        return np.asarray(inverse @ meat @ inverse)

    def _linear_step(
        self, design: FloatArray, weight: FloatArray, known: npt.NDArray[np.bool_]
    ) -> FloatArray:
        """Step of the fit if heights between points were linear, which bounds the error of interpolation."""
        py, px = _moved(self.y[known], self.x[known], self.motion, self.pair.middle)
        change = self.pair.linear.at(py, px) - self.pair.between.at(py, px)
        change = np.where(np.isfinite(change), change, 0.0)
        normal = design.T @ (weight[:, None] * design)
        return np.asarray(np.linalg.lstsq(normal, -design.T @ (weight * change), rcond=1e-12)[0])

    def _scale(self, off: FloatArray, design: FloatArray, weight: FloatArray) -> float:
        """Step of the scale, times the length, when everything is fitted together."""
        normal = design.T @ (weight[:, None] * design)
        return float(np.linalg.lstsq(normal, -design.T @ (weight * off), rcond=1e-12)[0][3])


def _smoothed(surface: HeightMap, width_um: float) -> HeightMap:
    """Heights under a narrow Gaussian, so that steps between points become slopes that can be shifted."""
    from scipy import ndimage  # noqa: PLC0415 - slow to import

    known = np.isfinite(surface.height_um)
    sigma = width_um / surface.pixel_y_um, width_um / surface.pixel_x_um
    filled = continued(surface.height_um, 2)
    total = ndimage.gaussian_filter(filled, sigma, mode="nearest", truncate=3.0)
    return surface.with_height(np.where(known, total, np.nan))


def white_noise(surface: HeightMap) -> float:
    """Standard deviation in µm of white noise, from mixed second differences, whose deviation is twice as large.

    Slopes cancel in them; edges are spread wide and count little in the median.
    """
    z = surface.height_um
    mixed = z[1:, 1:] - z[1:, :-1] - z[:-1, 1:] + z[:-1, :-1]
    mixed = mixed[np.isfinite(mixed)]
    return 0.5 * MAD * float(np.median(np.abs(mixed))) if mixed.size else 0.0


def registered(first: HeightMap, second: HeightMap, placed: Placed) -> HeightMap:
    """The second map on the points of the first, its plane brought to that of the first; NaN where missing.

    Raises:
        HeightMapError: no point of the second lies on the first.
    """
    y, x = np.meshgrid(*centred_axes(first), indexing="ij")
    height = Interpolated(second, 3).at(*placed.positions(y, x, second)) - placed.plane_um(y, x)
    if not np.isfinite(height).any():
        raise HeightMapError("the registered maps have no measured point in common")
    return HeightMap(height, first.pixel_x_um, first.pixel_y_um, second.origin)
