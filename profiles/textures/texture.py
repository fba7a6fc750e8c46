"""Areal surface texture parameters of ISO 25178-2 of a scale-limited surface."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.texture import Extent, Filtering, MapUncertainty, Smoothing
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.heightmap import HeightMap, known_mean, row_blocks
from anisoscope.profiles.textures.bearing import Bearing, Core, Volumes, bearing, core, volumes
from anisoscope.profiles.textures.features import Features, features
from anisoscope.profiles.textures.filters import (
    ScaleLimited,
    scale_limited,
    standard_of,
    transmission,
)
from anisoscope.profiles.textures.spatial import Spatial, spatial
from anisoscope.profiles.textures.spectra import dominant_wavelength


@dataclass(frozen=True)
class Heights:
    """Height parameters (ISO 25178-2, 4.1), about the mean height.

    Attributes:
        sa_um: arithmetic mean height.
        sq_um: root mean square height.
        sz_um: maximum height Sp + Sv.
        sp_um: maximum peak height.
        sv_um: maximum pit depth.
        ssk: skewness; NaN on a surface without heights.
        sku: kurtosis, 3 for Gaussian heights; NaN on a surface without heights.
    """

    sa_um: float
    sq_um: float
    sz_um: float
    sp_um: float
    sv_um: float
    ssk: float
    sku: float


@dataclass(frozen=True)
class Hybrid:
    """Hybrid parameters (ISO 25178-2, 4.3).

    Attributes:
        sdq: root mean square gradient, height per length.
        sdr: developed interfacial area ratio, 0.01 = 1 %.
    """

    sdq: float
    sdr: float


ParameterRow = tuple[str, float, str, str]
"""Name, value, unit and meaning of a parameter."""


def _of_surface(limited: ScaleLimited) -> dict[str, Any]:
    names = ("form", "s_filter_um", "l_filter_um", "s_filter", "l_filter")
    found = {name: getattr(limited, name) for name in names}
    return {"surface": limited.name, **found, "missing_share": limited.map.missing_share}


def _by_name(rows: Sequence[ParameterRow]) -> dict[str, Any]:
    return {name: {"value": value, "unit": unit} for name, value, unit, _ in rows}


@dataclass(frozen=True)
class Texture:
    """Texture parameters of a map, and the surface they refer to.

    Attributes:
        surface: the scale-limited surface.
        heights: height parameters.
        spatial: spatial parameters.
        hybrid: hybrid parameters.
        core: Sk, Spk, Svk and their ratios.
        volumes: Vmp, Vmc, Vvc, Vvv at 10 % and 80 %.
        smr_mean: material ratio of the mean height, Smr(0 µm), 0 to 1.
        smc_10_um: height in µm above which 10 % stands, Smc(10 %).
        smc_80_um: height in µm above which 80 % stands, Smc(80 %).
        sxp_um: extreme peak height Sxp: Smc(2.5 %) − Smc(50 %).
        ssw_um: dominant spatial wavelength Ssw: that of the largest amplitude; NaN on a flat surface.
        features: feature parameters, where they were wanted.
        free: parameters of the bearing curve at material ratios and heights that were asked for.
    """

    surface: ScaleLimited = field(metadata=json_field(by=_of_surface, merged=True))
    heights: Heights
    spatial: Spatial
    hybrid: Hybrid
    core: Core
    volumes: Volumes
    smr_mean: float = field(metadata=LEFT_OUT)
    smc_10_um: float = field(metadata=LEFT_OUT)
    smc_80_um: float = field(metadata=LEFT_OUT)
    sxp_um: float
    ssw_um: float
    features: Features | None = None
    free: tuple[ParameterRow, ...] = field(default=(), metadata=json_field(by=_by_name))

    @property
    @in_json("bearing")
    def of_bearing(self) -> dict[str, float]:
        """Material ratio of the mean height, and heights of 10 % and 80 % material."""
        return {"smr_mean": self.smr_mean, "smc_10_um": self.smc_10_um, "smc_80_um": self.smc_80_um}

    @property
    def values(self) -> dict[str, tuple[float, str]]:
        """Value and unit by name of the parameter."""
        return {name: (value, unit) for name, value, unit, _ in self.rows()}

    def rows(self) -> list[ParameterRow]:
        """Name, value, unit and meaning of every parameter."""
        h, s, y, c, v = self.heights, self.spatial, self.hybrid, self.core, self.volumes
        rows: list[ParameterRow] = [
            ("Sa", h.sa_um, "µm", "arithmetic mean height"),
            ("Sq", h.sq_um, "µm", "root mean square height"),
            ("Sz", h.sz_um, "µm", "maximum height"),
            ("Sp", h.sp_um, "µm", "maximum peak height"),
            ("Sv", h.sv_um, "µm", "maximum pit depth"),
            ("Ssk", h.ssk, "", "skewness"),
            ("Sku", h.sku, "", "kurtosis"),
            ("Sal", s.sal_um, "µm", "autocorrelation length, threshold 0.2"),
            ("Str", s.str_, "", "texture aspect ratio, threshold 0.2"),
            ("Std", s.std_deg, "°", "direction of the lay, counter-clockwise from +y"),
            ("Sdq", y.sdq, "", "root mean square gradient"),
            ("Sdr", 100.0 * y.sdr, "%", "developed interfacial area ratio"),
            ("Smr(0 µm)", 100.0 * self.smr_mean, "%", "material ratio of the mean height"),
            ("Smc(10 %)", self.smc_10_um, "µm", "height of 10 % material, from the mean"),
            ("Smc(80 %)", self.smc_80_um, "µm", "height of 80 % material, from the mean"),
            ("Sk", c.sk_um, "µm", "core height"),
            ("Spk", c.spk_um, "µm", "reduced peak height"),
            ("Svk", c.svk_um, "µm", "reduced dale depth"),
            ("Smrk1", 100.0 * c.smr1, "%", "material ratio of the peaks"),
            ("Smrk2", 100.0 * c.smr2, "%", "material ratio down to the dales"),
            ("Vmp", v.vmp_um, "µm³/µm²", "material volume of the peaks, 10 %"),
            ("Vmc", v.vmc_um, "µm³/µm²", "material volume of the core, 10–80 %"),
            ("Vvc", v.vvc_um, "µm³/µm²", "void volume of the core, 10–80 %"),
            ("Vvv", v.vvv_um, "µm³/µm²", "void volume of the dales, 80 %"),
        ]
        rows += [
            ("Sxp", self.sxp_um, "µm", "extreme peak height, Smc(2.5 %) − Smc(50 %)"),
            ("Ssw", self.ssw_um, "µm", "dominant spatial wavelength"),
        ]
        if self.features is not None:
            rows += _feature_rows(self.features)
        known = {row[0] for row in rows}
        return [*rows, *(row for row in self.free if row[0] not in known)]

    def notes(self) -> list[str]:
        """What the surface is, and what its filters do to the values."""
        limited = self.surface
        named = {"gaussian": "Gaussian", "robust": "robust Gaussian", "spline": "spline"}

        def words(name: str, cutoff: float | None, kind: Smoothing) -> str:
            if cutoff is None:
                return f"{name} none"
            return f"{name} {named[kind]} ({standard_of(kind)}), nesting index {cutoff:g} µm"

        lines = [
            f"{limited.name}; missing {100.0 * limited.map.missing_share:.3g} %",
            "; ".join(
                (
                    words("S-filter", limited.s_filter_um, limited.s_filter),
                    words("L-filter", limited.l_filter_um, limited.l_filter),
                )
            ),
        ]
        pixel = max(limited.map.pixel_x_um, limited.map.pixel_y_um)
        for cutoff, kind in (
            (limited.s_filter_um, limited.s_filter),
            (limited.l_filter_um, limited.l_filter),
        ):
            if kind != "spline" and cutoff is not None and cutoff < 4.0 * pixel:
                share = 100.0 * transmission(cutoff, pixel, cutoff)
                lines.append(
                    f"few pixels in {cutoff:g} µm: the filter passes {share:.0f} % there instead of 50 %"
                )
        if self.spatial.str_is_bound:
            lines.append("Str is an upper bound: along the lay f_ACF stays above 0.2 for half the field")
        if math.isnan(self.spatial.std_deg) and self.spatial.str_ > 0.0:
            lines.append(
                "no Std: a surface of Str 0.5 or more has no lay, and the strongest direction is chance"
            )
        return lines


def _feature_rows(f: Features) -> list[ParameterRow]:
    return [
        ("Spd", 1e6 * f.spd_per_um2, "1/mm²", "density of peaks"),
        ("Spc", 1e3 * f.spc_per_um, "1/mm", "arithmetic mean peak curvature"),
        ("S5p", f.s5p_um, "µm", "mean height of the five highest peaks"),
        ("S5v", f.s5v_um, "µm", "mean depth of the five deepest pits"),
        ("S10z", f.s10z_um, "µm", "ten-point height"),
        ("Sha", f.sha_um2, "µm²", "mean area of closed hills"),
        ("Sda", f.sda_um2, "µm²", "mean area of closed dales"),
        ("Shv", f.shv_um3, "µm³", "mean volume of closed hills above their saddle"),
        ("Sdv", f.sdv_um3, "µm³", "mean volume of closed dales below their saddle"),
    ]


def _free_rows(curve: Bearing, shares: Sequence[float], heights: Sequence[float]) -> list[ParameterRow]:
    rows: list[ParameterRow] = []
    for share in shares:
        ratio = 0.01 * share
        rows += [
            (f"Smc({share:g} %)", curve.smc(ratio), "µm", "height of this material ratio, from the mean"),
            (f"Vm({share:g} %)", curve.above(ratio), "µm³/µm²", "material volume above it"),
            (f"Vv({share:g} %)", curve.below(ratio), "µm³/µm²", "void volume below it"),
        ]
    if len(shares) > 1:
        low, high = shares[:2]
        value = curve.smc(0.01 * low) - curve.smc(0.01 * high)
        rows.append((f"Sxp({low:g} %, {high:g} %)", value, "µm", "difference of their heights"))
    rows += [
        (
            f"Smr({height:g} µm)",
            100.0 * curve.smr(height),
            "%",
            "material ratio of this height, from the mean",
        )
        for height in heights
    ]
    return rows


def heights(surface: HeightMap) -> Heights:
    """Height parameters over the measured points of a map.

    Raises:
        HeightMapError: nothing was measured.
    """
    check_heights("height map", surface.height_um)
    mean, count = known_mean(surface.height_um), 0
    sums = np.zeros(4)
    peak, pit, largest = -np.inf, -np.inf, 0.0
    for block in row_blocks(surface.shape):
        part = surface.height_um[block]
        height = part[np.isfinite(part)]
        if height.size == 0:
            continue
        largest = max(largest, float(np.abs(height).max()))
        height = height - mean
        square = height * height
        sums += [np.abs(height).sum(), square.sum(), (square * height).sum(), (square * square).sum()]
        peak, pit, count = max(peak, float(height.max())), max(pit, float(-height.min())), count + height.size
    sa, variance, third, fourth = (sums / count).tolist()
    sq = float(np.sqrt(variance))
    # heights that differ by rounding alone have no shape
    flat = sq <= 1e-12 * largest
    return Heights(
        sa_um=sa,
        sq_um=sq,
        sz_um=peak + pit,
        sp_um=peak,
        sv_um=pit,
        ssk=float("nan") if flat else third / sq**3,
        sku=float("nan") if flat else fourth / sq**4,
    )


def hybrid(surface: HeightMap) -> Hybrid:
    """Sdq and Sdr of a map.

    Slopes are differences of neighbouring points over their distance, each between two measured points; the area is
    that of the cells of four measured points, as the mean of their two triangulations. A wave of n pixels so
    loses the share (π/n)²/6 of its slope.

    Raises:
        HeightMapError: no two neighbours were measured along x or along y.
    """
    height, py, px = surface.height_um, surface.pixel_y_um, surface.pixel_x_um
    along_y, along_x, area = (np.zeros(2) for _ in range(3))  # sum and number
    for block in row_blocks(height.shape):
        part = height[block.start : block.stop + 1]  # and the first row of the next block
        slope_y, slope_x = np.diff(part, axis=0) / py, np.diff(part, axis=1) / px
        own = slope_x[: block.stop - block.start]
        along_y += _sum(slope_y * slope_y)
        along_x += _sum(own * own)
        cells = np.zeros((slope_x.shape[0] - 1, slope_x.shape[1]))
        for across in (slope_x[:-1], slope_x[1:]):
            for along in (slope_y[:, :-1], slope_y[:, 1:]):
                cells += np.sqrt(1.0 + across * across + along * along)
        area += _sum(cells)
    if along_y[1] == 0.0 or along_x[1] == 0.0:
        raise HeightMapError("slopes need measured points side by side along x and along y; there are none")
    sdq = float(np.sqrt(along_y[0] / along_y[1] + along_x[0] / along_x[1]))
    return Hybrid(sdq, 0.25 * float(area[0] / area[1]) - 1.0 if area[1] else float("nan"))


def _sum(values: FloatArray) -> FloatArray:
    """(2,) sum and number of the values that are not NaN."""
    known = ~np.isnan(values)
    return np.array([np.sum(values, where=known), np.count_nonzero(known)], dtype=np.float64)


@by_keywords(filtering=Filtering, extent=Extent)
def texture(surface: HeightMap, *, filtering: Filtering, extent: Extent) -> Texture:
    """Filter a map and take all parameters.

    Args:
        surface: the map, (rows, cols) in µm; missing points stay out of everything.
        filtering: form and filters, or the fields as keywords.
        extent: further parameters, or the fields as keywords.

    Raises:
        UsageError: the surface is no height map, or there is no such kind of filter.
        HeightMapError: a nesting index that the map cannot hold, or too little was measured.
    """
    if not isinstance(surface, HeightMap):
        raise UsageError(f"texture takes a HeightMap, not {type(surface).__name__}")
    limited = scale_limited(surface.measured(), filtering=filtering)
    curve = bearing(limited.map)
    return Texture(
        surface=limited,
        heights=heights(limited.map),
        spatial=spatial(limited.map),
        hybrid=hybrid(limited.map),
        core=core(curve),
        volumes=volumes(curve),
        smr_mean=curve.smr(0.0),
        smc_10_um=curve.smc(0.1),
        smc_80_um=curve.smc(0.8),
        sxp_um=curve.smc(0.025) - curve.smc(0.5),
        ssw_um=dominant_wavelength(limited.map),
        features=features(limited.map, 0.01 * extent.pruning_percent, border=extent.border_features)
        if extent.features
        else None,
        free=tuple(_free_rows(curve, extent.ratios_percent, extent.heights_um)),
    )


@dataclass(frozen=True)
class Spread:
    """What the uncertainties of a map make of a parameter.

    Attributes:
        u: standard deviation of the draws: the standard uncertainty; NaN where fewer than two draws have a value.
        shift: mean of the draws minus the value of the map: what one more portion of noise adds.
    """

    u: float
    shift: float


def texture_uncertainty(
    surface: HeightMap,
    evaluate: Callable[[HeightMap], Mapping[str, tuple[float, str]]],
    inputs: MapUncertainty,
    *,
    on_progress: Advance = silent,
) -> dict[str, Spread]:
    """Uncertainties of parameters of a map, by Monte Carlo (JCGM 101:2008, 7).

    Each draw multiplies the heights by 1 + ``height_scale`` g and both pixel sizes by 1 + ``pixel_size`` g and adds
    noise to every height, g and noise normal; everything is then evaluated anew, filters and form included. Without
    draws there are none.

    Args:
        surface: the map, (rows, cols) in µm.
        evaluate: values and units by name, of a map; those in ° are directions, which repeat after 180°.
        inputs: standard uncertainties of the map, number and seed of the draws; the same seed gives the same
            uncertainties.
        on_progress: called at every draw.

    Raises:
        HeightMapError: a drawn map cannot be evaluated.
    """
    draws = inputs.draws
    if draws is None:
        return {}
    nominal = evaluate(surface)
    rng = np.random.default_rng(inputs.seed)
    found: dict[str, list[float]] = {name: [] for name in nominal}
    for number in range(draws):
        on_progress("uncertainty", number, draws)
        height_factor, pixel_factor = 1.0 + np.array([inputs.height_scale, inputs.pixel_size]) * (
            rng.standard_normal(2)
        )
        height = surface.height_um * height_factor
        if inputs.height_noise_um > 0.0:
            height += inputs.height_noise_um * rng.standard_normal(height.shape)
        drawn = replace(
            surface.with_height(height),
            pixel_x_um=surface.pixel_x_um * float(pixel_factor),
            pixel_y_um=surface.pixel_y_um * float(pixel_factor),
        )
        for name, (value, _) in evaluate(drawn).items():
            found.setdefault(name, []).append(value)
    on_progress("uncertainty", draws, draws)
    return {
        name: _spread(np.array(found[name]) - value, direction=unit == "°")
        for name, (value, unit) in nominal.items()
    }


def _spread(difference: FloatArray, *, direction: bool) -> Spread:
    known = difference[np.isfinite(difference)]
    if known.size < 2:
        return Spread(float("nan"), float("nan"))
    if direction:
        known = (known + 90.0) % 180.0 - 90.0
    return Spread(float(np.std(known, ddof=1)), float(np.mean(known)))
