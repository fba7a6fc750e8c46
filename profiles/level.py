"""Level a height map without being fooled by its ridges.

A least-squares plane tilts a sawtooth by 0.1° to 0.3°, since its facets all lean the same way and the field
rarely holds whole pitches. Points one or more whole pitches apart stand on the same place of the shape; the
median of their height differences is the tilt alone, whatever the shape.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.heightmap import HeightMap, sampled
from anisoscope.profiles.period import Period, find_period

MIN_PAIRS = 100
MAX_SAMPLES = 400_000
FORM_SAMPLES = 40_000
FORM_BINS = 128
FORM_ORDERS = (2, 4, 6, 9, 12)
FORM_REWEIGHED = (4, 9)
FORM_CLIP = 4.0
FORM_GAIN = 0.995
TILES = 12
ALONG = 0.7
"""Sine of the angle between the lines of a scan and the direction across ridges, from which on they run along."""


@dataclass(frozen=True)
class Levelled:
    """A levelled map and the form removed from it.

    Attributes:
        map: the map without tilt, mean height 0.
        tilt_x: slope dz/dx that was removed (height per length, no unit).
        tilt_y: slope dz/dy that was removed.
        period: the period that was used, or that made the plane fit necessary.
    """

    map: HeightMap
    tilt_x: float
    tilt_y: float
    period: Period

    @property
    def tilt_x_deg(self) -> float:
        """Inclination along x in degrees."""
        return float(np.degrees(np.arctan(self.tilt_x)))

    @property
    def tilt_y_deg(self) -> float:
        """Inclination along y in degrees."""
        return float(np.degrees(np.arctan(self.tilt_y)))


def _shifted_difference(surface: HeightMap, dx_um: float, dy_um: float) -> float | None:
    """Median of h(r + d) − h(r) in µm, between bilinear neighbours; None if too few points have a partner."""
    rows, cols = surface.shape
    sx, sy = dx_um / surface.pixel_x_um, dy_um / surface.pixel_y_um
    j0, i0 = int(np.floor(sx)), int(np.floor(sy))
    ax, ay = sx - j0, sy - i0
    top, bottom = max(0, -i0), min(rows, rows - i0 - 1)
    left, right = max(0, -j0), min(cols, cols - j0 - 1)
    if bottom <= top or right <= left:
        return None
    thin = max(1, int(np.sqrt((bottom - top) * (right - left) / MAX_SAMPLES)))
    height = surface.height_um

    def at(i: int, j: int) -> FloatArray:
        return height[top + i : bottom + i : thin, left + j : right + j]

    there = (1 - ay) * ((1 - ax) * at(i0, j0) + ax * at(i0, j0 + 1)) + ay * (
        (1 - ax) * at(i0 + 1, j0) + ax * at(i0 + 1, j0 + 1)
    )
    difference = there - at(0, 0)
    difference = difference[np.isfinite(difference)]
    return float(np.median(difference)) if difference.size >= MIN_PAIRS else None


def _reach(surface: HeightMap, direction: tuple[float, float]) -> float:
    """Half the length in µm of the field along a direction (x, y)."""
    height, width = surface.extent_um
    spans = [
        size / abs(part) for size, part in zip((width, height), direction, strict=True) if abs(part) > 1e-9
    ]
    return 0.5 * min(spans)


def periodic_tilt(surface: HeightMap, period: Period) -> tuple[float, float]:
    """Tilt (dz/dx, dz/dy) of a ridged map, from points whole pitches apart."""
    across, along = period.across(), period.along()
    pitches = max(1, int(_reach(surface, across) / period.pitch_um))
    far, long = pitches * period.pitch_um, _reach(surface, along)
    rise_across = _shifted_difference(surface, far * across[0], far * across[1])
    rise_along = _shifted_difference(surface, long * along[0], long * along[1])
    # a map too short to tell its tilt along one direction is taken as level in that direction
    a = 0.0 if rise_across is None else rise_across / far
    b = 0.0 if rise_along is None else rise_along / long
    return a * across[0] + b * along[0], a * across[1] + b * along[1]


@dataclass(frozen=True, eq=False)
class PeriodicForm:
    """Form beneath ridges: a polynomial without its level and tilt.

    Attributes:
        order: of the polynomial; 1 where there is no form that counts.
        factors: of the products of Legendre polynomials, in the order of ``_powers``.
    """

    order: int
    factors: FloatArray

    def height_um(self, shape: tuple[int, int]) -> FloatArray:
        """(rows, cols) form in µm over the whole field."""
        rows, cols = shape
        up = np.stack([_legendre(np.linspace(-1.0, 1.0, rows), n) for n in range(self.order + 1)], axis=1)
        right = np.stack([_legendre(np.linspace(-1.0, 1.0, cols), n) for n in range(self.order + 1)])
        products = np.zeros((self.order + 1, self.order + 1))
        for (a, b), factor in zip(_powers(self.order), self.factors, strict=True):
            if a + b >= 2:
                products[b, a] = factor
        found: FloatArray = up @ products @ right
        return found


def _legendre(x: FloatArray, order: int) -> FloatArray:
    return np.asarray(np.polynomial.legendre.legval(x, np.eye(order + 1)[order]), dtype=np.float64)


def _powers(order: int) -> list[tuple[int, int]]:
    """Orders (along x, along y) of the products, by their sum from 1 on."""
    return [(a, total - a) for total in range(1, order + 1) for a in range(total, -1, -1)]


class _Folded:
    """A sample of points of a ridged map: height = profile of the place on the ridge + form.

    The points are in the order of the halves of the map that predict each other, in each by their bin: the sums over a
    bin of a half are sums over neighbours, and those over the map are those of both halves.
    """

    def __init__(self, surface: HeightMap, period: Period) -> None:
        rows, cols = surface.shape
        known = sampled(np.isfinite(surface.height_um), FORM_SAMPLES)
        i, j = np.divmod(known, cols)
        (ex, ey), (ux, uy) = period.across(), period.along()
        phase = (ex * surface.pixel_x_um * j + ey * surface.pixel_y_um * i) / period.pitch_um
        place = ((phase - np.floor(phase)) * FORM_BINS).astype(np.intp) % FORM_BINS
        along = ux * surface.pixel_x_um * j + uy * surface.pixel_y_um * i
        tile = np.floor((along - along.min()) / max(float(np.ptp(along)), 1e-9) * TILES)
        even = (np.floor(phase) + tile) % 2 == 0
        order = np.argsort(place + FORM_BINS * even, kind="stable")
        known, i, j, self.bin = known[order], i[order], j[order], place[order]
        odd = known.size - int(np.count_nonzero(even))
        self.halves = slice(odd, None), slice(odd)
        self.count = np.bincount(self.bin, minlength=FORM_BINS)
        self.z = surface.height_um.ravel()[known]
        legendre, every = np.polynomial.legendre, np.eye(FORM_ORDERS[-1] + 1)
        right, up = (
            legendre.legval(np.linspace(-1.0, 1.0, count), every).take(place, axis=1)
            for count, place in ((cols, j), (rows, i))
        )
        self.lines = np.empty((1 + len(_powers(FORM_ORDERS[-1])), self.z.size))
        self.lines[0] = self.z
        for number, (a, b) in enumerate(_powers(FORM_ORDERS[-1]), start=1):
            np.multiply(right[a], up[b], out=self.lines[number])
        self.weight = np.ones(self.z.size)

    def moments(self, order: int, half: slice) -> "_Moments":
        """Weighted sums of heights and terms up to an order over one half."""
        weight, place = self.weight[half], self.bin[half]
        root = np.sqrt(weight)
        part = self.lines[: 1 + len(_powers(order)), half] * root
        products = part @ part.T
        part *= root
        found = np.zeros((len(part), FORM_BINS))
        starts = np.flatnonzero(np.diff(place, prepend=-1))
        found[:, place[starts]] = np.add.reduceat(part, starts, axis=1)
        return _Moments(products, found, np.bincount(place, weight, FORM_BINS).astype(np.float64))

    def factors(self, order: int) -> FloatArray:
        """Least-squares factors of a form up to an order."""
        first, second = (self.moments(order, half) for half in self.halves)
        return first.joined(second).normal().factors(order)

    def residual(self, factors: FloatArray) -> FloatArray:
        """Heights of all points over the form and the weighted mean of their bin."""
        left = self.z - factors @ self.lines[1 : 1 + factors.size]
        total, sums = (np.bincount(self.bin, one, FORM_BINS) for one in (self.weight, self.weight * left))
        return np.asarray(left - (sums / np.maximum(total, 1e-300))[self.bin])

    def reweigh(self, residual: FloatArray) -> None:
        """Points of bins that scatter (walls) weigh little, those that stand out (burrs) nothing."""
        size = np.abs(residual)
        spread = 1.4826 * self._medians(size)
        spread = np.maximum(spread, 0.1 * float(np.median(spread[self.count > 0])) + 1e-9)
        everywhere = spread[self.bin]
        self.weight = np.where(size <= FORM_CLIP * everywhere, everywhere**-2.0, 0.0)

    def _medians(self, size: FloatArray) -> FloatArray:
        """(bins,) median of values from 0 on in every bin, by one sort of bin and share of the largest value."""
        largest = max(float(size.max()), 1e-300) * 1.001
        ordered = np.sort(self.bin + size / largest)
        starts = np.minimum(np.cumsum(self.count) - self.count, ordered.size - 1)
        low, high = (ordered[starts + half] for half in (np.maximum(self.count - 1, 0) // 2, self.count // 2))
        return np.asarray(largest * (0.5 * (low + high) - np.arange(FORM_BINS)))


@dataclass(frozen=True, eq=False)
class _Moments:
    """Weighted sums over points: products of heights and terms, heights and terms in every bin, and weights there."""

    products: FloatArray
    sums: FloatArray
    weight: FloatArray

    def joined(self, other: "_Moments") -> "_Moments":
        """Those of two samples together."""
        return _Moments(self.products + other.products, self.sums + other.sums, self.weight + other.weight)

    def normal(self) -> "_Normal":
        """Normal equations of a form about a profile that is free in every bin."""
        sums = self.sums / np.sqrt(np.where(self.weight > 0.0, self.weight, 1.0))
        return _Normal(self.products - sums @ sums.T)


@dataclass(frozen=True, eq=False)
class _Normal:
    """Weighted products of the heights and the terms, each less its mean in the same bin; heights first."""

    gram: FloatArray

    def factors(self, order: int) -> FloatArray:
        """Least-squares factors up to an order."""
        count = 1 + len(_powers(order))
        found = np.linalg.lstsq(self.gram[1:count, 1:count], self.gram[1:count, 0], rcond=1e-10)[0]
        return np.asarray(found, dtype=np.float64)

    def left(self, factors: FloatArray) -> float:
        """Sum of squares that a form leaves."""
        away = np.append(1.0, -factors)
        return float(away @ self.gram[: away.size, : away.size] @ away)


def periodic_form(surface: HeightMap, period: Period, highest: float = FORM_ORDERS[-1]) -> PeriodicForm:
    """Form of a ridged map, from points at equal places of different ridges: waviness, curvature, warp.

    Heights are modelled as a profile that repeats and a polynomial of order 2 to 12, fitted together; the shape
    of the ridges does not pull at the form. The order counts whose form, fitted to every second piece of ridge,
    predicts the others best, if it leaves 0.5 % less than a tilt.

    Args:
        surface: the map, (rows, cols) in µm.
        period: of its ridges.
        highest: order above which none is tried.
    """
    folded = _Folded(surface, period)
    if folded.z.size < 4 * (len(folded.lines) - 1):
        return PeriodicForm(1, np.zeros(2))
    for order in FORM_REWEIGHED:
        folded.reweigh(folded.residual(folded.factors(order)))
    moments = [folded.moments(FORM_ORDERS[-1], half) for half in folded.halves]
    halves = [one.normal() for one in moments]

    def missed(order: int) -> float:
        return sum(one.left(other.factors(order)) for one, other in (halves, halves[::-1]))

    best, least = 1, FORM_GAIN * missed(1)
    for order in (one for one in FORM_ORDERS if one <= highest):
        left = missed(order)
        if left < least:
            best, least = order, FORM_GAIN * left
    return PeriodicForm(best, moments[0].joined(moments[1]).normal().factors(best))


def _plane_tilt(surface: HeightMap) -> tuple[float, float]:
    """Slopes of the least-squares plane through the measured points."""
    known = np.isfinite(surface.height_um)
    i, j = np.nonzero(known)
    x, y = j * surface.pixel_x_um, i * surface.pixel_y_um
    z = surface.height_um[known]
    x, y, z = x - x.mean(), y - y.mean(), z - z.mean()
    normal = np.array([[x @ x, x @ y], [x @ y, y @ y]])
    slopes = np.linalg.lstsq(normal, np.array([x @ z, y @ z]), rcond=None)[0]
    return float(slopes[0]), float(slopes[1])


def level(surface: HeightMap, period: Period | None = None) -> Levelled:
    """Take tilt and mean height off a map, (rows, cols) in µm.

    With ridges, the tilt comes from points whole pitches apart across the ridges and half the field apart
    along them; without, from a least-squares plane. ``origin["levelling"]`` says which.

    Args:
        surface: the map; missing points stay missing.
        period: its period, if it is known already.

    Raises:
        HeightMapError: nothing was measured.
    """
    check_heights("height map", surface.height_um)
    period = find_period(surface) if period is None else period
    if period.is_periodic:
        tilt, method = periodic_tilt(surface, period), "median over whole pitches"
    else:
        tilt, method = _plane_tilt(surface), "least-squares plane"
    rows, cols = surface.shape
    x, y = np.arange(cols) * surface.pixel_x_um, np.arange(rows) * surface.pixel_y_um
    height = surface.height_um - tilt[0] * x[None, :] - tilt[1] * y[:, None]
    height = height - np.nanmean(height)
    note = {"method": method, "tilt_x": tilt[0], "tilt_y": tilt[1]}
    return Levelled(surface.with_height(height, levelling=note), tilt[0], tilt[1], period)


def line_offsets(surface: HeightMap, scan: Literal["x", "y"]) -> FloatArray:
    """(lines,) height of every line against the others in µm, without their mean and their slope.

    The height of a line is the median of its differences from the median line, which single features do not move. The
    slope of the map across the lines stays.

    Args:
        surface: the map.
        scan: axis along which the instrument scanned.

    Raises:
        HeightMapError: fewer than three lines with points, or ridges lie along the lines.
    """
    lines = surface.height_um if scan == "x" else surface.height_um.T
    measured = np.flatnonzero(np.isfinite(lines).any(axis=1))
    if len(measured) < 3:
        raise HeightMapError("align-lines: fewer than three lines have points")
    period = find_period(surface)
    if period.is_periodic and abs(period.across()[1 if scan == "x" else 0]) > ALONG:
        raise HeightMapError(
            f"align-lines: ridges lie along the lines of {scan}, which would be taken for their heights; take scan "
            f"{'y' if scan == 'x' else 'x'} if the instrument scanned across the ridges"
        )
    common = lines[:, np.isfinite(lines).any(axis=0)]
    off = common[measured] - np.nanmedian(common, axis=0)
    place = np.arange(len(lines), dtype=float)
    offsets = np.interp(place, measured, np.nanmedian(off, axis=1))
    return np.asarray(offsets - np.polyval(np.polyfit(place, offsets, 1), place))
