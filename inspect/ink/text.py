"""Fits and colours of inks as text, common to terminal and page."""

import numpy as np

from anisoscope.ink.appearance import Show
from anisoscope.ink.fitting import InkFit
from anisoscope.ink.solver import BASES

METHODS = {"joint": "joint fit of all readings", "paper": "two steps, as published"}


def summary(found: InkFit) -> str:
    """One line on a fit."""
    u = f" ± {found.u_alpha:.2g}" if np.isfinite(found.u_alpha) else " ± unknown"
    if not found.fits:
        u = " (the model is rejected)"
    if found.distribution != "ggx":
        tail = found.distribution
        u += f" ({tail} distribution)" if isinstance(tail, str) else f" (tail {tail:.2g})"
    if found.base:
        u += " with " + " and ".join(BASES[one.name] for one in found.base)
    mirror = found.mirror_delta_e
    off = "" if mirror is None else f", ΔE2000 {mirror:.2g} in the mirror direction"
    used = int(np.isfinite(found.grid.value).sum())
    return (
        f"{METHODS[found.method]}: alpha {found.alpha:.5g}{u}, residuals {100 * found.rms:.2g} % rms{off} over "
        f"{used} readings at {len(found.grid.theta_i_deg)} places and {len(found.nm)} wavelengths"
    )


def fit_rows(found: InkFit) -> list[list[str]]:
    """Wavelength, ρ, u, c, u as texts."""
    values = zip(found.nm, found.rho, found.u_rho, found.c, found.u_c, strict=True)
    return [
        [
            f"{nm:g}",
            f"{r:.5g}",
            f"{ur:.2g}" if found.fits else "–",
            signed(c),
            f"{uc:.2g}" if found.fits else "–",
        ]
        for nm, r, ur, c, uc in values
    ]


FIT_COLUMNS = ("wavelength [nm]", "ρ [1]", "u(ρ) [1]", "c [1]", "u(c) [1]")


def signed(value: float) -> str:
    """A number with its sign, minus as the typographic one."""
    return f"{value:+.3f}".replace("-", "−")


SHOW_COLUMNS = ("θ [°]", "X [1]", "Y [1]", "Z [1]", "x [1]", "y [1]", "sRGB", "ΔE2000 from the first [1]")


def show_rows(appearance: Show, number: int) -> list[list[str]]:
    """Angle, XYZ, chromaticity, hex and colour difference of one ink as texts."""
    one = appearance.inks[number]
    rows = []
    for theta, xyz, code, difference in zip(one.theta_deg, one.xyz, one.hexes, one.difference, strict=True):
        total = max(float(xyz.sum()), 1e-30)
        chroma = [f"{part / total:.4f}" for part in xyz[:2]]
        rows.append([f"{theta:g}", *(f"{part:.4g}" for part in xyz), *chroma, code, f"{difference:.2f}"])
    return rows


def show_notes(appearance: Show) -> list[str]:
    """Notes on how the colours are computed."""
    where = "in the mirror direction"
    if appearance.inks[0].off_mirror_deg:
        where = f"{appearance.inks[0].off_mirror_deg:+g}° from the mirror direction".replace("-", "−")
    adapted = "white adapted to that of sRGB (Bradford)" if appearance.adapted else "no chromatic adaptation"
    clipped = sum(one.clipped for one in appearance.inks)
    total = sum(len(one.theta_deg) for one in appearance.inks)
    return [
        (
            f"Light {appearance.illuminant.name}, {where}, model {appearance.model}; CIE 1931 2° observer, "
            f"Y = 1 for a perfect white; {adapted}."
        ),
        (
            f"Shown and compared at exposure {appearance.exposure:.3g}; {clipped} of {total} colours are out of the "
            "gamut of sRGB and clipped."
        ),
    ]
