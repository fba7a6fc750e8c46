"""Scale-limited surfaces: form removal and areal Gaussian filters.

The Gaussian filter is that of ISO 16610-61: the weight s(x) = exp(−π(x/(αλ))²)/(αλ) along each axis, with
α = √(ln 2/π), passes half of the amplitude at the nesting index λ. Weights are cut at ±λ, where s has fallen
to 7·10⁻⁷ of its peak. Missing points weigh nothing, and neither does what lies beyond the field: the weighted
sum is divided by the sum of the weights (zero-order Gaussian regression, as in ISO 16610-31). Within about λ/2
of an end or a gap the filter is therefore one-sided and does not follow a slope.

The weights are sampled at the pixels. With λ of four pixels or more this changes nothing that can be measured;
below, the filter passes more than half at λ (see :func:`transmission`).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.heightmap import HeightMap

Form = Literal["plane", "poly2", "none"]

ALPHA = float(np.sqrt(np.log(2.0) / np.pi))
LEAST_PIXELS = 2.0
LEAST_WEIGHT = 1e-6
POWERS = {
    "none": (),
    "plane": ((0, 0), (1, 0), (0, 1)),
    "poly2": ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)),
}


@dataclass(frozen=True)
class ScaleLimited:
    """A scale-limited surface (ISO 25178-2, 3.1) and its filter settings.

    Attributes:
        map: heights about their mean, in µm.
        form: the F-operation.
        s_filter_um: nesting index of the S-filter in µm; None where it was not applied.
        l_filter_um: nesting index of the L-filter in µm; None where it was not applied.
    """

    map: HeightMap
    form: Form
    s_filter_um: float | None
    l_filter_um: float | None

    @property
    def name(self) -> str:
        """What ISO 25178-2 calls the surface."""
        form = {"none": "no form removed", "plane": "plane removed", "poly2": "second order removed"}[
            self.form
        ]
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


def gaussian_mean(surface: HeightMap, cutoff_um: float) -> FloatArray:
    """Mean surface of the areal Gaussian filter (the long waves), (rows, cols) in µm; NaN where missing.

    Args:
        surface: the map.
        cutoff_um: nesting index λ in µm.

    Raises:
        HeightMapError: an index below two pixels or beyond the field, or nothing was measured.
    """
    from scipy.signal import oaconvolve  # noqa: PLC0415 - slow to import

    check_heights("height map", surface.height_um)
    check_cutoff("filter", cutoff_um, surface)
    known = np.isfinite(surface.height_um)
    mean = float(np.mean(surface.height_um[known]))
    total: FloatArray = np.where(known, surface.height_um - mean, 0.0)
    weight: FloatArray = known.astype(np.float64)
    for axis, pixel in enumerate((surface.pixel_y_um, surface.pixel_x_um)):
        kernel = np.expand_dims(weights(cutoff_um, pixel), 1 - axis)
        total = oaconvolve(total, kernel, mode="same", axes=axis)
        weight = oaconvolve(weight, kernel, mode="same", axes=axis)
    return np.where(known, mean + total / np.maximum(weight, LEAST_WEIGHT), np.nan)


def check_cutoff(name: str, cutoff_um: float, surface: HeightMap) -> None:
    """Refuse a nesting index that the map cannot hold.

    Raises:
        HeightMapError: not a number, below two pixels, or beyond the shorter side of the field.
    """
    pixel, field = max(surface.pixel_x_um, surface.pixel_y_um), min(surface.extent_um)
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


def without_form(surface: HeightMap, form: Form) -> FloatArray:
    """F-operation: heights in µm without their least-squares plane or polynomial, about their mean.

    A least-squares plane turns a sawtooth by 0.1° to 0.3°; level ridged maps first
    (:func:`anisoscope.profiles.level.level`) and take ``"none"``.

    Raises:
        HeightMapError: nothing was measured, or too few points for the polynomial.
    """
    check_heights("height map", surface.height_um)
    if form not in POWERS:
        raise HeightMapError(f"a form is {', '.join(POWERS)}, not {form!r}")
    height, known = surface.height_um, np.isfinite(surface.height_um)
    rows, cols = surface.shape
    y, x = np.linspace(-1.0, 1.0, rows)[:, None], np.linspace(-1.0, 1.0, cols)[None, :]
    terms = [np.broadcast_to(x**a * y**b, (rows, cols)) for a, b in POWERS[form]]
    if terms:
        columns = [term[known] for term in terms]
        normal = np.array([[float(one @ two) for two in columns] for one in columns])
        # NaN and infinity have been left out, so a singular matrix means points on one line
        if np.linalg.cond(normal) > 1e12:
            raise HeightMapError(f"the measured points do not determine the form {form!r}; take --form none")
        zero = height[known] - float(np.mean(height[known]))
        factors = np.linalg.solve(normal, np.array([float(column @ zero) for column in columns]))
        for factor, term in zip(factors, terms, strict=True):
            height = height - factor * term
    return height - float(np.mean(height[known]))


def scale_limited(
    surface: HeightMap,
    *,
    form: Form = "plane",
    s_filter_um: float | None = None,
    l_filter_um: float | None = None,
) -> ScaleLimited:
    """The S-F or S-L surface of a map.

    The form is removed before the S-filter, which then meets no tilt at the ends of the field, and again after it.

    Args:
        surface: the map; missing points stay missing.
        form: least-squares form to remove.
        s_filter_um: nesting index in µm below which waves are removed.
        l_filter_um: nesting index in µm above which waves are removed.

    Raises:
        HeightMapError: a nesting index that the map cannot hold, or an S-filter that is not below the L-filter.
    """
    for name, cutoff in (("S-filter", s_filter_um), ("L-filter", l_filter_um)):
        if cutoff is not None:
            check_cutoff(name, cutoff, surface)
    if s_filter_um is not None and l_filter_um is not None and s_filter_um >= l_filter_um:
        raise HeightMapError(
            f"the S-filter ({s_filter_um:g} µm) must be below the L-filter ({l_filter_um:g} µm); "
            "between them lie the waves that are measured"
        )
    found = surface.with_height(without_form(surface, form))
    if s_filter_um is not None:
        found = found.with_height(gaussian_mean(found, s_filter_um))
        found = found.with_height(without_form(found, form))
    if l_filter_um is not None:
        found = found.with_height(found.height_um - gaussian_mean(found, l_filter_um))
    note = {"form": form, "s_filter_um": s_filter_um, "l_filter_um": l_filter_um}
    height = found.height_um - float(np.nanmean(found.height_um))
    return ScaleLimited(surface.with_height(height, filtering=note), form, s_filter_um, l_filter_um)
