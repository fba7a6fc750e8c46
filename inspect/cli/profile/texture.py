"""``anisoscope profile texture``: surface texture parameters of ISO 25178-2."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import Json
from anisoscope.cli.profile.profile import AS_STATED, Scales
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.profiles.textures.texture import Texture


def texture(
    file: Path,
    /,
    *,
    s_filter: Annotated[
        float | None, Parameter(help="Nesting index of the Gaussian S-filter in µm; removes shorter waves.")
    ] = None,
    l_filter: Annotated[
        float | None, Parameter(help="Nesting index of the Gaussian L-filter in µm; removes longer waves.")
    ] = None,
    form: Annotated[
        Literal["plane", "none", "poly2"], Parameter(help="Least-squares form that is removed.")
    ] = "plane",
    plot: Annotated[
        Path | None, Parameter(help="Picture of spectra, autocorrelation and bearing curve: *.png or *.svg.")
    ] = None,
    json_: Json = False,
    scales: Annotated[Scales, Parameter(name="*")] = AS_STATED,
) -> int:
    """Height, spatial, hybrid and functional parameters (ISO 25178-2) of a height map.

    Args:
        file: Height map in a format of docs/height-maps.md.
    """
    from anisoscope.profiles.textures.texture import texture as measure
    from anisoscope.report.study_page import check_picture

    check_picture(plot)
    found = measure(scales.read(file), form=form, s_filter_um=s_filter, l_filter_um=l_filter)
    if plot is not None:
        _draw(found, plot)
    if json_:
        print_json(_as_json(found))
    else:
        print_table(
            file.name, ["parameter", "value", "unit", "meaning"], _rows(found), caption=_caption(found)
        )
    return 0


def _as_json(found: "Texture") -> dict[str, Any]:
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
        "missing_share": limited.map.missing_share,
        **parts,
        "bearing": bearing,
    }


def _rows(found: "Texture") -> list[list[str]]:
    h, s, y, c, v = found.heights, found.spatial, found.hybrid, found.core, found.volumes
    bound = "≤ " if s.str_is_bound else ""
    rows: list[tuple[str, float, str, str]] = [
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
    return [
        [
            name,
            (bound if name == "Str" else "") + (f"{value:.5g}" if math.isfinite(value) else "–"),
            unit,
            meaning,
        ]
        for name, value, unit, meaning in rows
    ]


def _caption(found: "Texture") -> str:
    from anisoscope.profiles.textures.filters import transmission

    limited = found.surface

    def words(name: str, cutoff: float | None) -> str:
        if cutoff is None:
            return f"{name} none"
        return f"{name} Gaussian (ISO 16610-61), nesting index {cutoff:g} µm"

    lines = [
        f"{limited.name}; missing {100.0 * limited.map.missing_share:.3g} %",
        f"{words('S-filter', limited.s_filter_um)}; {words('L-filter', limited.l_filter_um)}",
    ]
    pixel = max(limited.map.pixel_x_um, limited.map.pixel_y_um)
    for cutoff in (limited.s_filter_um, limited.l_filter_um):
        if cutoff is not None and cutoff < 4.0 * pixel:
            share = 100.0 * transmission(cutoff, pixel, cutoff)
            lines.append(
                f"few pixels in {cutoff:g} µm: the filter passes {share:.0f} % there instead of 50 %"
            )
    if found.spatial.str_is_bound:
        lines.append("Str is an upper bound: along the lay f_ACF stays above 0.2 for half the field")
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
