"""``anisoscope profile texture``: surface texture parameters of ISO 25178-2."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import Json, parse_numbers
from anisoscope.cli.profile.many import (
    NONE,
    ManyOptions,
    Values,
    check_table,
    expanded,
    measure_each,
    print_sheet,
)
from anisoscope.cli.profile.profile import AS_STATED, FilterType, Scales
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.profiles.heightmap import HeightMap
    from anisoscope.profiles.textures.features import Features
    from anisoscope.profiles.textures.texture import MapUncertainty, Spread, Texture

ParameterRow = tuple[str, float, str, str]
"""Name, value, unit and meaning of a parameter."""


@dataclass(frozen=True)
class UncertaintyOptions:
    """Uncertainty of the values, by Monte Carlo."""

    uncertainty: Annotated[
        int | None,
        Parameter(
            name="--draws",
            help="Number of draws of noise, height scale and pixel size, such as 100: standard uncertainties of all "
            "values; each draw takes as long as the measurement.",
        ),
    ] = None
    u_height_noise: Annotated[
        float, Parameter("--u-height-noise", help="Noise of a height, standard deviation in µm.")
    ] = 0.0
    u_height_scale: Annotated[
        float, Parameter("--u-height-scale", help="Of the scale of the heights, relative.")
    ] = 0.0
    u_pixel_size: Annotated[
        float, Parameter("--u-pixel-size", help="Of the pixel size, relative, both axes together.")
    ] = 0.0
    seed: Annotated[int, Parameter(help="Seed of the draws.")] = 0

    def check(self) -> None:
        """Refuse what makes no sense before a map is read.

        Raises:
            UsageError: draws without an uncertainty of the map, or the other way round; a value out of range.
        """
        given = any((self.u_height_noise, self.u_height_scale, self.u_pixel_size))
        if self.uncertainty is None:
            if given:
                raise UsageError("--u-height-noise, --u-height-scale and --u-pixel-size take --draws NUMBER")
            return
        if not given:
            raise UsageError("--draws takes --u-height-noise, --u-height-scale or --u-pixel-size")
        if self.uncertainty < 2:
            raise UsageError(f"--draws takes two draws or more, not {self.uncertainty}")
        if self.seed < 0:
            raise UsageError(f"--seed takes a whole number from 0, not {self.seed}")
        self.of_map()

    def of_map(self) -> "MapUncertainty":
        """Uncertainties of the map."""
        from anisoscope.profiles.textures.texture import MapUncertainty

        return MapUncertainty(self.u_height_noise, self.u_height_scale, self.u_pixel_size)

    def spreads(
        self, surface: "HeightMap", evaluate: "Callable[[HeightMap], Values]", on_progress: Advance = silent
    ) -> "Mapping[str, Spread]":
        """Uncertainty of every value by name; empty where none was chosen."""
        from anisoscope.profiles.textures.texture import texture_uncertainty

        if self.uncertainty is None:
            return {}
        return texture_uncertainty(
            surface, evaluate, self.of_map(), self.uncertainty, seed=self.seed, on_progress=on_progress
        )


CERTAIN = UncertaintyOptions()


def texture(
    *files: Path,
    s_filter: Annotated[
        float | None, Parameter(help="Nesting index of the S-filter in µm; removes shorter waves.")
    ] = None,
    l_filter: Annotated[
        float | None, Parameter(help="Nesting index of the L-filter in µm; removes longer waves.")
    ] = None,
    s_filter_type: Annotated[
        FilterType,
        Parameter(
            help="S-filter of ISO 16610: gaussian (-61), robust (-71) or spline (separable, -22 along x and y)."
        ),
    ] = "gaussian",
    l_filter_type: Annotated[FilterType, Parameter(help="The same for the L-filter.")] = "gaussian",
    form: Annotated[
        str, Parameter(help="Form that is removed: none, plane, poly1 … poly10, sphere or cylinder.")
    ] = "plane",
    plot: Annotated[
        Path | None, Parameter(help="Picture of spectra, autocorrelation and bearing curve: *.png or *.svg.")
    ] = None,
    features: Annotated[
        bool,
        Parameter(negative="", help="Also hills and dales: Spd, Spc, S5p, S5v, S10z, Sha, Sda, Shv, Sdv."),
    ] = False,
    pruning: Annotated[float, Parameter(help="Wolf pruning of hills and dales in % of Sz.")] = 5.0,
    ratios: Annotated[
        str | None,
        Parameter(help="Material ratios in %, such as 2,50: Smc, Vm and Vv there, and Sxp of the first two."),
    ] = None,
    heights: Annotated[
        str | None, Parameter(help="Heights in µm from the mean, such as -0.5,0.5: Smr there.")
    ] = None,
    json_: Json = False,
    doubt: Annotated[UncertaintyOptions, Parameter(name="*", group="Uncertainty")] = CERTAIN,
    many: Annotated[ManyOptions, Parameter(name="*", group="Several files")] = NONE,
    scales: Annotated[Scales, Parameter(name="*")] = AS_STATED,
) -> int:
    """Height, spatial, hybrid, functional and feature parameters (ISO 25178-2) of height maps.

    Args:
        files: Height maps in a format of docs/height-maps.md, or patterns.

    Examples:
        anisoscope profile texture part.x3p --s-filter 3 --l-filter 250
        anisoscope profile texture 'lot/*.x3p' --limits limits.toml --table lot.html
    """
    from anisoscope.profiles.limits import sheet_of
    from anisoscope.profiles.textures.texture import texture as measure
    from anisoscope.report.study_page import check_picture

    check_picture(plot)
    free = _free(ratios, heights)
    doubt.check()

    def measured(surface: "HeightMap") -> "Texture":
        return measure(
            surface,
            form=form,
            s_filter_um=s_filter,
            l_filter_um=l_filter,
            s_filter=s_filter_type,
            l_filter=l_filter_type,
            pruning=0.01 * pruning if features else None,
        )

    def valued(surface: "HeightMap") -> Values:
        return _values(measured(surface), free)

    chosen = expanded(files)
    if len(chosen) > 1 or many.table is not None:
        if plot is not None:
            raise UsageError("--plot draws one map; give one file and no --table")

        def with_uncertainty(path: Path) -> Values:
            surface = scales.read(path)
            values = valued(surface)
            spreads = doubt.spreads(surface, valued)
            return {**values, **{f"u({name})": (one.u, values[name][1]) for name, one in spreads.items()}}

        return measure_each(chosen, with_uncertainty, many, to_json=json_)
    check_table(many)
    surface = scales.read(chosen[0])
    found = measured(surface)
    with progress(chosen[0].name, quiet=doubt.uncertainty is None) as advance:
        spreads = doubt.spreads(surface, valued, advance)
    if plot is not None:
        _draw(found, plot)
    sheet = sheet_of(many.limits, _values(found, free))
    if json_:
        print_json(
            _as_json(found, free) | _spreads_as_json(doubt, spreads) | ({"sheet": sheet} if sheet else {})
        )
    else:
        _print(chosen[0].name, found, free, spreads)
    return print_sheet(sheet, silent=json_)


def _spreads_as_json(doubt: UncertaintyOptions, spreads: "Mapping[str, Spread]") -> dict[str, Any]:
    if not spreads:
        return {}
    return {
        "u": {name: one.u for name, one in spreads.items()},
        "shift": {name: one.shift for name, one in spreads.items()},
        "uncertainty": fields_of(doubt.of_map()) | {"draws": doubt.uncertainty, "seed": doubt.seed},
    }


def _print(name: str, found: "Texture", free: "Free", spreads: "Mapping[str, Spread]") -> None:
    def of(parameter: str) -> list[str]:
        if not spreads:
            return []
        one = spreads[parameter]
        return [
            f"{one.u:.2g}" if math.isfinite(one.u) else "–",
            f"{one.shift:+.1g}" if math.isfinite(one.shift) else "–",
        ]

    rows = [
        [
            parameter,
            (_bound(found) if parameter == "Str" else "") + _number(value),
            *of(parameter),
            unit,
            meaning,
        ]
        for parameter, value, unit, meaning in _rows(found, free)
    ]
    caption = _caption(found)
    if spreads:
        caption += (
            "\nu: standard uncertainty (k = 1) from noise, height scale and pixel size; "
            "shift: what as much noise again adds"
        )
    columns = ["parameter", "value", *(["u", "shift"] if spreads else []), "unit", "meaning"]
    print_table(name, columns, rows, caption=caption)


Free = tuple[tuple[float, ...], tuple[float, ...]]
"""Material ratios in %, and heights in µm, at which the bearing curve is read."""
NO_FREE: Free = ((), ())


def _free(ratios: str | None, heights: str | None) -> Free:
    shares = () if ratios is None else parse_numbers(ratios, "--ratios", "2,50")
    if any(not 0.0 <= share <= 100.0 for share in shares):
        raise UsageError(f"--ratios takes material ratios from 0 to 100 %, not {ratios!r}")
    return shares, () if heights is None else parse_numbers(heights, "--heights", "-0.5,0.5")


def _free_rows(found: "Texture", free: Free) -> "list[ParameterRow]":
    from anisoscope.profiles.textures.bearing import bearing

    if not any(free):
        return []
    curve, (shares, heights) = bearing(found.surface.map), free
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
    known = {row[0] for row in _rows(found, NO_FREE)}
    return [row for row in rows if row[0] not in known]


def _values(found: "Texture", free: Free) -> Values:
    return {name: (value, unit) for name, value, unit, _ in _rows(found, free)}


def _bound(found: "Texture") -> str:
    return "≤ " if found.spatial.str_is_bound else ""


def _number(value: float) -> str:
    return f"{value:.5g}" if math.isfinite(value) else "–"


def _as_json(found: "Texture", free: Free) -> dict[str, Any]:
    limited = found.surface
    parts = {
        name: {key.rstrip("_"): value for key, value in fields_of(getattr(found, name)).items()}
        for name in ("heights", "spatial", "hybrid", "core", "volumes")
    }
    bearing = {"smr_mean": found.smr_mean, "smc_10_um": found.smc_10_um, "smc_80_um": found.smc_80_um}
    return {
        "surface": limited.name,
        "form": limited.form,
        "s_filter_um": limited.s_filter_um,
        "l_filter_um": limited.l_filter_um,
        "s_filter": limited.s_filter,
        "l_filter": limited.l_filter,
        "missing_share": limited.map.missing_share,
        **parts,
        "bearing": bearing,
        "sxp_um": found.sxp_um,
        "ssw_um": found.ssw_um,
        "features": found.features,
        "free": {name: {"value": value, "unit": unit} for name, value, unit, _ in _free_rows(found, free)},
    }


def _rows(found: "Texture", free: Free) -> "list[ParameterRow]":
    h, s, y, c, v = found.heights, found.spatial, found.hybrid, found.core, found.volumes
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
        ("Smr(0 µm)", 100.0 * found.smr_mean, "%", "material ratio of the mean height"),
        ("Smc(10 %)", found.smc_10_um, "µm", "height of 10 % material, from the mean"),
        ("Smc(80 %)", found.smc_80_um, "µm", "height of 80 % material, from the mean"),
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
        ("Sxp", found.sxp_um, "µm", "extreme peak height, Smc(2.5 %) − Smc(50 %)"),
        ("Ssw", found.ssw_um, "µm", "dominant spatial wavelength"),
    ]
    if found.features is not None:
        rows += _feature_rows(found.features)
    return rows + _free_rows(found, free) if any(free) else rows


def _feature_rows(f: "Features") -> "list[ParameterRow]":
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


def _caption(found: "Texture") -> str:
    from anisoscope.profiles.textures.filters import Smoothing, standard_of, transmission

    limited = found.surface
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
    if found.spatial.str_is_bound:
        lines.append("Str is an upper bound: along the lay f_ACF stays above 0.2 for half the field")
    if math.isnan(found.spatial.std_deg) and found.spatial.str_ > 0.0:
        lines.append("no Std: a surface of Str 0.5 or more has no lay, and the strongest direction is chance")
    return "\n".join(lines)


def _draw(found: "Texture", path: Path) -> None:
    import numpy as np

    from anisoscope.profiles.textures import spatial, spectra
    from anisoscope.profiles.textures.bearing import bearing
    from anisoscope.report.study_page import Chart, Curve, write_picture

    surface = found.surface.map
    lines = [(f"along {axis}", spectra.line_density(surface, axis)) for axis in ("x", "y")]
    radial = spectra.radial_density(surface)
    acf = spatial.autocorrelation(surface)
    curve = bearing(surface)

    def spectrum(label: str, one: spectra.Spectrum) -> Curve:
        chosen = (one.frequency > 0.0) & (one.density > 0.0)
        return Curve(label, one.frequency[chosen], one.density[chosen])

    charts = (
        Chart(
            "spectra of profiles",
            "frequency [1/µm]",
            "density [µm³]",
            tuple(spectrum(label, one) for label, one in lines),
            log=True,
            points=False,
        ),
        Chart(
            "spectrum over rings",
            "frequency [1/µm]",
            "density [µm⁴]",
            (spectrum("all directions", radial),),
            log=True,
            points=False,
        ),
        Chart(
            "autocorrelation",
            "lag [µm]",
            "f_ACF",
            (
                Curve("along x", *acf.along_x()),
                Curve("along y", *acf.along_y()),
                Curve("0.2", np.array([0.0, _last(acf)]), np.full(2, spatial.THRESHOLD), dashed=True),
            ),
            points=False,
        ),
        Chart(
            "bearing curve",
            "material ratio [%]",
            "height from the mean [µm]",
            (
                Curve("bearing", 100.0 * curve.ratio, curve.height_um),
                Curve(
                    "core",
                    np.array([0.0, 100.0]),
                    found.core.top_um - np.array([0.0, found.core.sk_um]),
                    dashed=True,
                ),
            ),
            points=False,
        ),
    )
    # a flat map has no spectrum that a logarithmic axis could show
    chosen = [chart for chart in charts if not chart.log or all(one.x.size for one in chart.curves)]
    write_picture(path, chosen, columns=2)


def _last(acf: Any) -> float:  # noqa: ANN401 - the module of the type is slow to import
    return max(float(acf.along_x()[0][-1]), float(acf.along_y()[0][-1]))
