"""How a design looks: its lobe on a screen, dots mirrored in it, a pattern under two lights.

Colours are those of the CIE 1931 observer under daylight (D65) or a line; brightness is scaled, not absolute.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.design.depths import Depths
from anisoscope.sim.design.designfile import DesignFile
from anisoscope.sim.design.layout import Layout
from anisoscope.sim.design.models import model_density
from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.colour.observer import matching_functions, xyz_weights
from anisoscope.sim.light.colour.spaces import encode, linear_srgb

WHITE_NM = tuple(float(w) for w in np.arange(400.0, 701.0, 20.0))
LINE_NM = 550.0
POINTS = 161
REACH = 0.2
DOT_UM = 112.0
BRIGHTEST = 99.7
"""Percentile of the brightness that is shown as white: a spike may saturate, the lobe must remain visible."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture, first row at the top.

    Attributes:
        srgb: (rows, cols, 3) encoded sRGB, 0 to 1.
        caption: what it shows.
    """

    srgb: FloatArray
    caption: str


def spectral_density(
    design: DesignFile, wavelengths_nm: Sequence[float], h: FloatArray, dot_um: float = DOT_UM
) -> FloatArray:
    """(W, H, H) density over half vectors times 1/λ² (the γ² of a surface), rows along rising h_y.

    The design's coherence length belongs to its wavelength; at others the same source has another.
    """
    found = []
    depths = Depths(design.passes_nm, design.band_nm) if design.passes_nm else None
    for nm in wavelengths_nm:
        tau = 1.0 if depths is None else depths.tau_at(nm)
        f = 2.0 * h / (1e-3 * nm)
        coherence = design.coherence_um * nm / design.wavelength_nm
        found.append(model_density(design.model, f, f, coherence, dot_um, tau) / (1e-3 * nm) ** 2)
    return np.stack(found)


def screen(design: DesignFile, *, white: bool) -> Picture:
    """The light that the design throws on a diffuse screen (Levin et al. 2013, Fig. 8 and 9)."""
    h = np.linspace(-REACH, REACH, POINTS)
    light = "white light (D65)" if white else f"{LINE_NM:g} nm"
    return Picture(
        _coloured(spectral_density(design, _lines(white), h), white),
        f"Lobe on a screen, {light}; |h| ≤ {REACH:g}",
    )


def mirrored_dots(design: DesignFile, *, white: bool) -> Picture:
    """A plane with dots reflected in the design: every dot is blurred by the lobe (Levin et al. 2013, Fig. 10)."""
    h = np.linspace(-2.0 * REACH, 2.0 * REACH, 2 * POINTS - 1)
    one = spectral_density(design, _lines(white), h)
    step = POINTS // 3
    total = np.zeros((one.shape[0], POINTS, POINTS))
    for down in (-1, 0, 1):
        for over in (-1, 0, 1):
            y, x = POINTS // 2 + 1 - down * step, POINTS // 2 + 1 - over * step
            total += one[:, y - 1 : y - 1 + POINTS, x - 1 : x - 1 + POINTS]
    light = "white light (D65)" if white else f"{LINE_NM:g} nm"
    return Picture(_coloured(total, white), f"Nine dots mirrored in the design, {light}")


def _lines(white: bool) -> tuple[float, ...]:
    return WHITE_NM if white else (LINE_NM,)


def _coloured(density: FloatArray, white: bool) -> FloatArray:
    """(rows, cols, 3) encoded sRGB, rows from the top."""
    if white:
        weights = xyz_weights(standard("d65"), np.array(WHITE_NM))
    else:
        nm, functions = matching_functions()
        weights = np.array([[np.interp(LINE_NM, nm, functions[:, k]) for k in range(3)]])
    xyz = np.moveaxis(density, 0, -1)[::-1] @ weights
    linear = linear_srgb(xyz / max(float(np.percentile(xyz[..., 1], BRIGHTEST)), 1e-12))
    if not white:  # a pure line lies outside of every screen's colours
        linear = np.clip(linear, 0.0, None)
    return encode(linear).srgb


def pattern_under(
    layout: Layout, designs: Sequence[DesignFile], h_x: float, h_y: float, most: int = 512
) -> tuple[FloatArray, FloatArray]:
    """Brightness of a layout under white light from one direction, camera above.

    Args:
        layout: the dots.
        designs: of every class.
        h_x: half vector along x.
        h_y: half vector along y.
        most: larger layouts are thinned to this many dots a side.

    Returns:
        (rows, cols), first row at the top, and (classes,) the brightness of each class: luminance per unit of light.
    """
    weights = xyz_weights(standard("d65"), np.array(WHITE_NM))[:, 1]
    each = np.empty(len(designs))
    for number, design in enumerate(designs):
        found = []
        depths = Depths(layout.passes_nm, design.band_nm)
        for nm in WHITE_NM:
            tau = depths.tau_at(nm)
            x, y = (np.array([2.0e3 * value / nm]) for value in (h_x, h_y))
            coherence = layout.coherence_um * nm / layout.wavelength_nm
            one = model_density(design.model, x, y, coherence, layout.dot_um, tau)
            found.append(float(one[0, 0]) / (1e-3 * nm) ** 2)
        each[number] = float(np.dot(weights, found))
    step = max(1, -(-max(layout.index.shape) // most))
    return each[layout.classes[::-1][::step, ::step]], each
