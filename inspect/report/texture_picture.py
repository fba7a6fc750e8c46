"""Picture of a surface texture: spectra, autocorrelation and bearing curve."""

from pathlib import Path

import numpy as np

from anisoscope.profiles.textures import spatial, spectra
from anisoscope.profiles.textures.bearing import bearing
from anisoscope.profiles.textures.texture import Texture
from anisoscope.report.study_page import Chart, Curve, write_picture


def write_texture_picture(found: Texture, path: Path | str) -> None:
    """Write spectra, autocorrelation and bearing curve as PNG or SVG, atomically.

    Raises:
        RecordError: the file cannot be written.
        UsageError: the file name says no kind of picture.
    """
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
    write_picture(Path(path), chosen, columns=2)


def _last(acf: spatial.Autocorrelation) -> float:
    return max(float(acf.along_x()[0][-1]), float(acf.along_y()[0][-1]))
