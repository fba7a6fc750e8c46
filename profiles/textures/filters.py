"""Filters of ISO 16610 with missing points, and scale-limited surfaces.

The Gaussian filter is that of ISO 16610-21 (profile) and -61 (areal): the weight s(x) = exp(−π(x/(αλ))²)/(αλ) along
each axis, with α = √(ln 2/π), passes half of the amplitude at the nesting index λ. Weights are cut at ±λ, where s has
fallen to 7·10⁻⁷ of its peak. Missing points weigh nothing, and neither does what lies beyond the field: the weighted
sum is divided by the sum of the weights (zero-order Gaussian regression, as in ISO 16610-31). Within about λ/2
of an end or a gap the filter of order 0 is therefore one-sided and does not follow a slope; a regression of order 1
or 2 follows it.

The weights are sampled at the pixels. With λ of four pixels or more this changes nothing that can be measured;
below, the filter passes more than half at λ (see :func:`transmission`).

No filter gives a height where none was measured.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.texture import Filtering, Smoothing
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.heightmap import HeightMap, known_mean, row_blocks, sealed
from anisoscope.profiles.textures.forms import fit_form

Direction = Literal["xy", "x", "y"]
Element = Literal["ball", "disk"]
Mask = npt.NDArray[np.bool_]

ALPHA = float(np.sqrt(np.log(2.0) / np.pi))
LEAST_PIXELS = 2.0
LEAST_WEIGHT = 1e-6
DETERMINED = 1e-4
TUKEY = 4.4478
ROBUST_PASSES = 30
SETTLED = 1e-4
BLOCK_POINTS = 60_000
MAX_ELEMENT_POINTS = 40_000


@dataclass(frozen=True)
class ScaleLimited(Filtering):
    """A scale-limited surface (ISO 25178-2, 3.1) and its filter settings.

    Attributes:
        map: heights about their mean, in µm.
    """

    map: HeightMap = field(kw_only=True)

    @property
    def name(self) -> str:
        """What ISO 25178-2 calls the surface."""
        named = {"none": "no form", "poly2": "second order"}
        form = f"{named.get(self.form, self.form)} removed"
        if self.l_filter_um is not None:
            kind = "S-L surface" if self.s_filter_um is not None else "L-filtered surface without S-filter"
        else:
            kind = "S-F surface" if self.s_filter_um is not None else "surface without S- and L-filter"
        return f"{kind}, {form}"


def weights(cutoff_um: float, pixel_um: float) -> FloatArray:
    """Weights of the Gaussian filter at whole pixels within ±λ, sum 1."""
    reach = int(np.ceil(cutoff_um / pixel_um))
    x = np.arange(-reach, reach + 1) * pixel_um / cutoff_um
    weight = np.exp(-np.pi * (x / ALPHA) ** 2)
    return np.asarray(weight / weight.sum())


def transmission(cutoff_um: float, pixel_um: float, wavelength_um: float) -> float:
    """Share of the amplitude of a wavelength along an axis that the sampled low-pass filter passes."""
    weight = weights(cutoff_um, pixel_um)
    offset = (np.arange(weight.size) - weight.size // 2) * pixel_um
    return float(np.sum(weight * np.cos(2.0 * np.pi * offset / wavelength_um)))


def gaussian_mean(
    surface: HeightMap, cutoff_um: float, *, direction: Direction = "xy", order: int = 0
) -> FloatArray:
    """Mean surface of the Gaussian regression filter (the long waves), (rows, cols) in µm; NaN where missing.

    Args:
        surface: the map.
        cutoff_um: nesting index λ in µm.
        direction: "xy" for the areal filter (ISO 16610-61), "x" or "y" for profiles along one axis (-21).
        order: of the local polynomial (ISO 16610-31): 0, 1 or 2.

    Raises:
        HeightMapError: an index below two pixels or beyond the field, an unknown order, or nothing was measured.
    """
    check_heights("height map", surface.height_um)
    check_cutoff("filter", cutoff_um, surface, direction)
    known = np.isfinite(surface.height_um)
    return _Regression(surface, cutoff_um, direction, order).mean(known.astype(np.float64))


def robust_gaussian_mean(
    surface: HeightMap, cutoff_um: float, *, direction: Direction = "xy", order: int = 2
) -> FloatArray:
    """Mean surface of the robust Gaussian regression filter, (rows, cols) in µm; NaN where missing.

    Weights of Tukey fall to zero at 4.4478 times the median of the absolute residuals, repeated until that median
    settles. Source: ISO 16610-71 (areal) and -31 (profile).

    Args:
        surface: the map.
        cutoff_um: nesting index λ in µm.
        direction: as in :func:`gaussian_mean`.
        order: of the local polynomial: 0, 1 or 2.

    Raises:
        HeightMapError: as in :func:`gaussian_mean`.
    """
    check_heights("height map", surface.height_um)
    check_cutoff("filter", cutoff_um, surface, direction)
    known = np.isfinite(surface.height_um)
    regression = _Regression(surface, cutoff_um, direction, order)
    weight = known.astype(np.float64)
    before = np.inf
    found = regression.mean(weight)
    for _ in range(ROBUST_PASSES):
        residual = np.abs(surface.height_um - found)
        limit = TUKEY * float(np.median(residual[known]))
        if limit <= 0.0 or abs(before - limit) <= SETTLED * limit:
            break
        before = limit
        weight = np.where(known & (residual < limit), (1.0 - (residual / limit) ** 2) ** 2, 0.0)
        found = regression.mean(weight)
    return found


class _Regression:
    """Local polynomials of an order, weighted by the Gaussian weight and by a weight of every point."""

    def __init__(self, surface: HeightMap, cutoff_um: float, direction: Direction, order: int) -> None:
        if order not in (0, 1, 2):
            raise HeightMapError(f"the order of a Gaussian regression filter is 0, 1 or 2, not {order}")
        self.known = np.isfinite(surface.height_um)
        self.centre = float(np.mean(surface.height_um[self.known]))
        self.height: FloatArray = np.where(self.known, surface.height_um - self.centre, 0.0)
        pixels = (surface.pixel_y_um, surface.pixel_x_um)
        self.kernels = [
            weights(cutoff_um, pixel) if name in direction else np.ones(1)
            for name, pixel in zip("yx", pixels, strict=True)
        ]
        # positions in units of λ
        self.offsets = [
            (np.arange(kernel.size) - kernel.size // 2) * pixel / cutoff_um
            for kernel, pixel in zip(self.kernels, pixels, strict=True)
        ]
        self.terms = [
            (b, a)
            for total in range(order + 1)
            for b in range(total + 1)
            for a in (total - b,)
            if (b == 0 or "y" in direction) and (a == 0 or "x" in direction)
        ]

    def _moment(self, field: FloatArray, powers: tuple[int, int]) -> FloatArray:
        """Σ kernel · offset^power · field around every point."""
        from scipy.signal import oaconvolve  # noqa: PLC0415 - slow to import

        for axis, (kernel, offset, power) in enumerate(zip(self.kernels, self.offsets, powers, strict=True)):
            if kernel.size > 1:
                taken = np.expand_dims((kernel * offset**power)[::-1], 1 - axis)
                field = oaconvolve(field, taken, mode="same", axes=axis)
        return field

    def mean(self, weight: FloatArray) -> FloatArray:
        """The mean surface, NaN where missing."""
        total = self._moment(weight * self.height, (0, 0))
        share = self._moment(weight, (0, 0))
        found = total / np.maximum(share, LEAST_WEIGHT)
        if len(self.terms) > 1:
            self._follow(weight, total, share, found)
        return np.where(self.known, self.centre + found, np.nan)

    def _follow(self, weight: FloatArray, total: FloatArray, share: FloatArray, found: FloatArray) -> None:
        """Replace the weighted mean by the polynomial where the points about a place determine it."""
        size = len(self.terms)
        wanted = {tuple(np.add(one, two).tolist()) for one in self.terms for two in self.terms}
        moments = {powers: self._moment(weight, powers) for powers in wanted if powers != (0, 0)}
        moments[0, 0] = share
        data = [total, *(self._moment(weight * self.height, powers) for powers in self.terms[1:])]
        flat_moments = {powers: one.ravel() for powers, one in moments.items()}
        flat_data = [one.ravel() for one in data]
        places = np.flatnonzero(self.known & (share > LEAST_WEIGHT))
        out = found.ravel()
        for first in range(0, places.size, BLOCK_POINTS):
            at = places[first : first + BLOCK_POINTS]
            matrix = np.empty((at.size, size, size))
            right = np.stack([one[at] for one in flat_data], axis=1)
            for row, one in enumerate(self.terms):
                for column, two in enumerate(self.terms):
                    matrix[:, row, column] = flat_moments[one[0] + two[0], one[1] + two[1]][at]
            scale = np.maximum(matrix[:, 0, 0], LEAST_WEIGHT)
            matrix /= scale[:, None, None]
            right /= scale[:, None]
            fit = np.linalg.det(matrix) > DETERMINED ** (size - 1)
            out[at[fit]] = np.linalg.solve(matrix[fit], right[fit][:, :, None])[:, 0, 0]


def spline_mean(surface: HeightMap, cutoff_um: float, *, direction: Direction = "xy") -> FloatArray:
    """Mean surface of the cubic spline filter (the long waves), (rows, cols) in µm; NaN where missing.

    The spline s minimises Σ(z − s)² + α⁴Σ(second difference of s)², α = 1/(2 sin(πΔ/λ)), its ends free: it follows
    slopes and has no effect at the ends. Source: ISO 16610-22. "xy" smooths along x, then along y: a separable
    spline, which passes less of oblique waves than an isotropic filter; it is not the areal spline of ISO 16610-62.

    Args:
        surface: the map.
        cutoff_um: nesting index λ in µm, where half of the amplitude passes.
        direction: "x", "y", or both one after the other.

    Raises:
        HeightMapError: an index below two pixels or beyond the field, or nothing was measured.
    """
    check_heights("height map", surface.height_um)
    check_cutoff("filter", cutoff_um, surface, direction)
    known = np.isfinite(surface.height_um)
    found: FloatArray = np.where(known, surface.height_um, 0.0)
    if "x" in direction:
        found = _splines(found, known, cutoff_um, surface.pixel_x_um)
    if "y" in direction:
        found = _splines(found.T, known.T, cutoff_um, surface.pixel_y_um).T
    return np.where(known, found, np.nan)


def _splines(height: FloatArray, known: Mask, cutoff_um: float, pixel_um: float) -> FloatArray:
    """Smoothing splines along the rows; rows with fewer than two points stay as they are."""
    from scipy.linalg import solveh_banded  # noqa: PLC0415 - slow to import

    count = height.shape[1]
    if count < 3:
        return height
    stiff = (2.0 * np.sin(np.pi * pixel_um / cutoff_um)) ** -4.0
    banded = np.zeros((3, count))
    second = np.array([1.0, -2.0, 1.0])
    for k in range(3):
        for m in range(3 - k):
            banded[2 - k, m + k : m + k + count - 2] += stiff * second[m] * second[m + k]
    out = height.copy()
    whole = known.all(axis=1)
    if whole.any():
        full = banded.copy()
        full[2] += 1.0
        out[whole] = solveh_banded(full, height[whole].T).T
    for row in np.flatnonzero(~whole & (np.count_nonzero(known, axis=1) >= 2)):
        part = banded.copy()
        part[2] += known[row]
        middle = float(np.mean(height[row][known[row]]))
        out[row] = middle + solveh_banded(part, np.where(known[row], height[row] - middle, 0.0))
    return out


def mean_surface(
    surface: HeightMap,
    cutoff_um: float,
    kind: Smoothing,
    *,
    direction: Direction = "xy",
    order: int | None = None,
) -> FloatArray:
    """Mean surface (the long waves) of a filter, (rows, cols) in µm; NaN where missing.

    Args:
        surface: the map.
        cutoff_um: nesting index λ in µm.
        kind: "gaussian" (:func:`gaussian_mean`), "robust" (:func:`robust_gaussian_mean`) or "spline"
            (:func:`spline_mean`).
        direction: "xy", "x" or "y".
        order: of the Gaussian regressions; 0 for "gaussian" and 2 for "robust" where it is not given.

    Raises:
        UsageError: no such kind, or an order of a spline.
        HeightMapError: as the filters do.
    """
    if kind == "gaussian":
        return gaussian_mean(surface, cutoff_um, direction=direction, order=0 if order is None else order)
    if kind == "robust":
        return robust_gaussian_mean(
            surface, cutoff_um, direction=direction, order=2 if order is None else order
        )
    if kind != "spline":
        raise UsageError(f"a filter is gaussian, robust or spline, not {kind!r}")
    if order is not None:
        raise UsageError("filter: a spline filter has no order")
    return spline_mean(surface, cutoff_um, direction=direction)


def standard_of(kind: Smoothing, direction: Direction = "xy") -> str:
    """The part of ISO 16610 that defines a filter; the areal spline is that of profiles along both axes."""
    if kind == "spline":
        return "ISO 16610-22" + (" along x and y, separable" if direction == "xy" else "")
    areal, profile = {"gaussian": ("61", "21"), "robust": ("71", "31")}[kind]
    return f"ISO 16610-{areal if direction == 'xy' else profile}"


def morphological(
    surface: HeightMap, radius_um: float, *, closing: bool = True, element: Element = "ball"
) -> FloatArray:
    """Envelope of a ball or disk that rolls over (closing) or under (opening) the surface; NaN where missing.

    Source: ISO 16610-85. A missing point carries no ball and bounds none.

    Args:
        surface: the map.
        radius_um: of the ball, or of the horizontal disk.
        closing: the envelope from above, which bridges dales; else from below, which cuts peaks.
        element: "ball", or "disk".

    Raises:
        HeightMapError: a radius below one pixel or too many pixels wide, or nothing was measured.
    """
    from scipy import ndimage  # noqa: PLC0415 - slow to import

    check_heights("height map", surface.height_um)
    pixel = max(surface.pixel_x_um, surface.pixel_y_um)
    if not radius_um >= pixel:
        raise HeightMapError(f"a {element} of {radius_um:g} µm is smaller than a pixel ({pixel:g} µm)")
    reach = [int(radius_um / one + 1e-9) for one in (surface.pixel_y_um, surface.pixel_x_um)]
    if (2 * reach[0] + 1) * (2 * reach[1] + 1) > MAX_ELEMENT_POINTS:
        raise HeightMapError(
            f"a {element} of {radius_um:g} µm covers {2 * reach[0] + 1} × {2 * reach[1] + 1} points, at most "
            f"{MAX_ELEMENT_POINTS} are taken; resample the map to a larger pixel first"
        )
    y = np.arange(-reach[0], reach[0] + 1)[:, None] * surface.pixel_y_um
    x = np.arange(-reach[1], reach[1] + 1)[None, :] * surface.pixel_x_um
    square = radius_um**2 - x**2 - y**2
    inside = square >= -1e-9 * radius_um**2
    shape = np.where(inside, np.sqrt(np.maximum(square, 0.0)) - radius_um if element == "ball" else 0.0, 0.0)
    known = np.isfinite(surface.height_um)
    sign = 1.0 if closing else -1.0
    height = np.pad(
        np.where(known, sign * surface.height_um, -np.inf), [(n, n) for n in reach], constant_values=-np.inf
    )
    raised = ndimage.grey_dilation(height, footprint=inside, structure=shape, mode="constant", cval=-np.inf)
    found = ndimage.grey_erosion(raised, footprint=inside, structure=shape, mode="constant", cval=np.inf)
    return np.where(known, sign * found[reach[0] : -reach[0] or None, reach[1] : -reach[1] or None], np.nan)


def check_cutoff(name: str, cutoff_um: float, surface: HeightMap, direction: Direction = "xy") -> None:
    """Refuse a nesting index that the map cannot hold along the axes that are filtered.

    Raises:
        HeightMapError: not a number, below two pixels, or beyond the shorter side of the field.
    """
    if direction not in ("xy", "x", "y"):
        raise HeightMapError(f"a filter works along xy, x or y, not {direction!r}")
    pixels, fields = (surface.pixel_y_um, surface.pixel_x_um), surface.extent_um
    chosen = [k for k, axis in enumerate("yx") if axis in direction]
    pixel, field = max(pixels[k] for k in chosen), min(fields[k] for k in chosen)
    if not cutoff_um >= LEAST_PIXELS * pixel:
        raise HeightMapError(
            f"a {name} of {cutoff_um:g} µm is below two pixels ({2.0 * pixel:g} µm); "
            "take a larger one, or leave it out"
        )
    if not cutoff_um <= field:
        raise HeightMapError(
            f"a {name} of {cutoff_um:g} µm is beyond the field ({field:.6g} µm along its shorter side); "
            "take a smaller one, or leave it out"
        )


def without_form(surface: HeightMap, form: str) -> FloatArray:
    """F-operation: heights in µm without a fitted form (:func:`.forms.fit_form`), about their mean.

    A least-squares plane turns a sawtooth by 0.1° to 0.3°; level ridged maps first
    (:func:`anisoscope.profiles.level.level`) and take ``"none"``.

    Raises:
        HeightMapError: nothing was measured, no such form, or too few points for it.
    """
    left, height = fit_form(surface, form).height_um, surface.height_um
    for block in row_blocks(height.shape):
        np.subtract(height[block], left[block], out=left[block])
    mean = known_mean(left)
    for block in row_blocks(height.shape):
        left[block] -= mean
    return left


@by_keywords(filtering=Filtering)
def scale_limited(surface: HeightMap, *, filtering: Filtering) -> ScaleLimited:
    """The S-F or S-L surface of a map.

    The form is removed before the S-filter, which then meets no tilt at the ends of the field, and again after it.

    Args:
        surface: the map; missing points stay missing.
        filtering: form (:func:`.forms.fit_form`) and filters (:func:`mean_surface`), or the fields as keywords.

    Raises:
        UsageError: no such kind of filter.
        HeightMapError: a nesting index that the map cannot hold, or an S-filter that is not below the L-filter.
    """
    s_filter_um, l_filter_um = filtering.s_filter_um, filtering.l_filter_um
    for name, cutoff in (("S-filter", s_filter_um), ("L-filter", l_filter_um)):
        if cutoff is not None:
            check_cutoff(name, cutoff, surface)
    if s_filter_um is not None and l_filter_um is not None and s_filter_um >= l_filter_um:
        raise HeightMapError(
            f"the S-filter ({s_filter_um:g} µm) must be below the L-filter ({l_filter_um:g} µm); "
            "between them lie the waves that are measured"
        )
    found = surface.with_height(sealed(without_form(surface, filtering.form)))
    if s_filter_um is not None:
        found = found.with_height(sealed(mean_surface(found, s_filter_um, filtering.s_filter)))
        found = found.with_height(sealed(without_form(found, filtering.form)))
    if l_filter_um is not None:
        found = found.with_height(
            sealed(found.height_um - mean_surface(found, l_filter_um, filtering.l_filter))
        )
    height = found.height_um
    if l_filter_um is not None:  # else about its mean already
        height = sealed(height - known_mean(height))
    limited = surface.with_height(height, filtering=dict(vars(filtering)))
    return ScaleLimited(**vars(filtering), map=limited)
