"""Areal surface texture parameters of ISO 25178-2 of a scale-limited surface."""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.textures.bearing import Core, Volumes, bearing, core, volumes
from anisoscope.profiles.textures.filters import Form, ScaleLimited, scale_limited
from anisoscope.profiles.textures.spatial import Spatial, spatial


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
    """

    surface: ScaleLimited
    heights: Heights
    spatial: Spatial
    hybrid: Hybrid
    core: Core
    volumes: Volumes
    smr_mean: float
    smc_10_um: float
    smc_80_um: float


def heights(surface: HeightMap) -> Heights:
    """Height parameters over the measured points of a map.

    Raises:
        HeightMapError: nothing was measured.
    """
    check_heights("height map", surface.height_um)
    height = surface.height_um[np.isfinite(surface.height_um)]
    height = height - float(np.mean(height))
    square = height * height
    sq = float(np.sqrt(np.mean(square)))
    peak, pit = float(height.max()), float(-height.min())
    # heights that differ by rounding alone have no shape
    flat = sq <= 1e-12 * float(np.nanmax(np.abs(surface.height_um)))
    return Heights(
        sa_um=float(np.mean(np.abs(height))),
        sq_um=sq,
        sz_um=peak + pit,
        sp_um=peak,
        sv_um=pit,
        ssk=float("nan") if flat else float(np.mean(square * height)) / sq**3,
        sku=float("nan") if flat else float(np.mean(square * square)) / sq**4,
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
    slope_y, slope_x = np.diff(height, axis=0) / py, np.diff(height, axis=1) / px
    if np.isnan(slope_y).all() or np.isnan(slope_x).all():
        raise HeightMapError("slopes need measured points side by side along x and along y; there are none")
    sdq = float(np.sqrt(np.nanmean(slope_y**2) + np.nanmean(slope_x**2)))
    top, bottom, left, right = slope_x[:-1], slope_x[1:], slope_y[:, :-1], slope_y[:, 1:]
    areas: list[FloatArray] = [
        np.sqrt(1.0 + across**2 + along**2)
        for across, along in ((top, left), (bottom, right), (top, right), (bottom, left))
    ]
    cells = 0.25 * sum(areas[1:], areas[0])
    if np.isnan(cells).all():
        return Hybrid(sdq, float("nan"))
    return Hybrid(sdq, float(np.nanmean(cells)) - 1.0)


def texture(
    surface: HeightMap,
    *,
    form: Form = "plane",
    s_filter_um: float | None = None,
    l_filter_um: float | None = None,
) -> Texture:
    """Filter a map and take all parameters.

    Args:
        surface: the map, (rows, cols) in µm; missing points stay out of everything.
        form: least-squares form to remove.
        s_filter_um: nesting index in µm of the Gaussian S-filter; None for none.
        l_filter_um: nesting index in µm of the Gaussian L-filter; None for none.

    Raises:
        UsageError: the surface is no height map.
        HeightMapError: a nesting index that the map cannot hold, or too little was measured.
    """
    if not isinstance(surface, HeightMap):
        raise UsageError(f"texture takes a HeightMap, not {type(surface).__name__}")
    limited = scale_limited(surface, form=form, s_filter_um=s_filter_um, l_filter_um=l_filter_um)
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
    )
