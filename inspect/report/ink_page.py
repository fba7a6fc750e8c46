"""Pages and pictures of inks: a fit with its residuals, and colours against angle."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.ink.appearance import Appearance, Show
from anisoscope.ink.fitting import InkFit
from anisoscope.ink.text import FIT_COLUMNS, SHOW_COLUMNS, fit_rows, show_notes, show_rows, summary
from anisoscope.report.figures import BLUE, GRID, MUTED, RED, new_figure, svg_uri
from anisoscope.report.page import write_page
from anisoscope.report.study_page import Chart, Curve, check_picture, write_picture
from anisoscope.sim.light.ink.ink import Ink

if TYPE_CHECKING:
    from matplotlib.axes import Axes


LISTED = 200
LEAST_APART = 60.0
"""Smallest distance in sRGB codes of two distinguishable curve colours."""


def write_ink_fit_page(found: InkFit, ink: Ink, title: str, path: Path | str) -> None:
    """Write the page of a fit, atomically.

    Raises:
        RecordError: the file cannot be written.
    """
    pictures = (
        (
            _lobe_chart(found),
            "Readings averaged over wavelength, and the fit, against the angle of the detector",
        ),
        (_residual_chart(found), "Residuals of ln(BRDF) by half angle, all wavelengths"),
        (_residual_map(found), "Residuals by place and wavelength"),
        (_band_chart(found, "rho"), "ρ with bars of two standard uncertainties"),
        (_band_chart(found, "c"), "c with bars of two standard uncertainties"),
    )
    dropped = [
        [
            f"{d.line}",
            f"{d.theta_i_deg:g}",
            f"{d.theta_o_deg:g}".replace("-", "−"),
            f"{d.wavelength_nm:g}",
            f"{d.value:.3g}",
            d.reason,
        ]
        for d in found.grid.dropped[:LISTED]
    ]
    content = {
        "title": title,
        "subtitle": f"{summary(found)}; {found.scale}",
        "warnings": found.warnings,
        "pictures": pictures,
        "swatches": [],
        "tables": [
            ("Parameters", FIT_COLUMNS, fit_rows(found)),
            *([("Readings dropped", _DROPPED, dropped)] if dropped else []),
        ],
        "notes": [
            f"Source: {ink.source}.",
            f"Noise floor {found.grid.floor:.2g}/sr.",
            *(
                [f"{len(found.grid.dropped) - LISTED} more were dropped."]
                if len(found.grid.dropped) > LISTED
                else []
            ),
        ],
    }
    write_page(Path(path), "ink.html", content)


_DROPPED = ("line", "θi [°]", "θo [°]", "wavelength [nm]", "BRDF [1/sr]", "reason")


def _lobe_chart(found: InkFit) -> str:
    grid = found.grid
    with new_figure(4.2, 3.0) as (figure, axes):
        from matplotlib import colormaps

        lights = np.unique(grid.theta_i_deg)
        fitted = np.exp(np.log(grid.value) - found.residual)
        for number, light in enumerate(lights):
            rows = np.flatnonzero(grid.theta_i_deg == light)
            rows = rows[np.argsort(grid.theta_o_deg[rows])]
            colour = colormaps["viridis"](0.9 * number / max(len(lights) - 1, 1))
            at = grid.theta_o_deg[rows]
            axes.plot(at, np.nanmean(grid.value[rows], axis=1), "o", color=colour, markersize=3.5)
            axes.plot(
                at, np.nanmean(fitted[rows], axis=1), "-", color=colour, linewidth=1.1, label=f"θi {light:g}°"
            )
        axes.set_xlabel("θo [°]")
        axes.set_ylabel("BRDF, mean over wavelength [1/sr]")
        axes.grid()
        axes.legend(frameon=False, fontsize=7, ncols=2)
        return svg_uri(figure)


def _residual_chart(found: InkFit) -> str:
    with new_figure(4.2, 3.0) as (figure, axes):
        half = np.broadcast_to(found.grid.half_deg[:, None], found.residual.shape)
        axes.axhline(0.0, color=RED, linewidth=0.8)
        axes.plot(
            half.ravel(),
            100.0 * found.residual.ravel(),
            ".",
            color=BLUE,
            markersize=2,
            alpha=0.35,
            rasterized=True,
        )
        _label(axes, "half angle θh [°]", "residual of ln(BRDF) [%]")
        return svg_uri(figure)


def _residual_map(found: InkFit) -> str:
    with new_figure(4.2, 3.0) as (figure, axes):
        order = np.lexsort((found.grid.theta_o_deg, found.grid.theta_i_deg))
        most = float(np.nanpercentile(np.abs(found.residual), 99)) * 100.0 or 1.0
        shown = axes.pcolormesh(
            found.nm, np.arange(len(order)), 100.0 * found.residual[order], cmap="RdBu_r", vmin=-most, vmax=most,
            shading="nearest", rasterized=True,
        )  # fmt: skip
        lights = found.grid.theta_i_deg[order]
        ticks = [int(np.argmax(lights == light)) for light in np.unique(lights)]
        axes.set_yticks(ticks, [f"{lights[tick]:g}°" for tick in ticks])
        axes.set_xlabel("wavelength [nm]")
        axes.set_ylabel("θi, within it rising θo")
        figure.colorbar(shown, ax=axes, label="residual [%]")
        return svg_uri(figure)


def _band_chart(found: InkFit, name: str) -> str:
    value, u = (found.rho, found.u_rho) if name == "rho" else (found.c, found.u_c)
    with new_figure(4.2, 3.0) as (figure, axes):
        bars = np.where(np.isfinite(u), 2.0 * u, 0.0)
        axes.errorbar(
            found.nm,
            value,
            bars,
            fmt="o-",
            color=BLUE,
            ecolor=MUTED,
            markersize=2.5,
            linewidth=1.0,
            capsize=1.5,
        )
        axes.axhline(0.0, color=GRID, linewidth=0.8)
        _label(axes, "wavelength [nm]", "ρ [1]" if name == "rho" else "c [1]")
        return svg_uri(figure)


def _label(axes: "Axes", x: str, y: str) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid()


def write_ink_show_page(shown: Show, title: str, path: Path | str) -> None:
    """Write the page of colours against angle, atomically.

    Raises:
        RecordError: the file cannot be written.
    """
    swatches = [
        (one.ink.name, [(f"{theta:g}°", code) for theta, code in zip(one.theta_deg, one.hexes, strict=True)])
        for one in shown.inks
    ]
    content = {
        "title": title,
        "subtitle": show_notes(shown)[0],
        "warnings": [],
        "pictures": [(_chart_uri(chart), chart.title) for chart in _charts(shown)],
        "swatches": swatches,
        "tables": [
            (f"{one.ink.name}, alpha {one.ink.alpha:g}", SHOW_COLUMNS, show_rows(shown, number))
            for number, one in enumerate(shown.inks)
        ],
        "notes": [
            *show_notes(shown)[1:],
            *(f"{one.ink.name}: {one.ink.source}." for one in shown.inks if one.ink.source),
        ],
    }
    write_page(Path(path), "ink.html", content)


def write_ink_picture(shown: Show, path: Path) -> None:
    """Write spectra and colours as one PNG or SVG picture, atomically.

    Raises:
        UsageError: a name that ends in neither.
        RecordError: the file cannot be written.
    """
    check_picture(path)
    write_picture(path, _charts(shown))


def _charts(shown: Show) -> list[Chart]:
    colours = _own_colours(shown)

    def curves(of: Callable[[Appearance], tuple[FloatArray, FloatArray]]) -> tuple[Curve, ...]:
        return tuple(
            Curve(one.ink.name, *of(one), colour=colour)
            for one, colour in zip(shown.inks, colours, strict=True)
        )

    rho = curves(lambda one: (one.ink.nm, one.ink.rho_brdf))
    c = curves(lambda one: (one.ink.nm, one.ink.c_values))
    apart = curves(lambda one: (one.theta_deg, one.difference))
    bright = curves(lambda one: (one.theta_deg, one.xyz[:, 1]))
    place = curves(lambda one: (one.xyz[:, 0] / one.xyz.sum(axis=1), one.xyz[:, 1] / one.xyz.sum(axis=1)))
    return [
        Chart("Reflectance ρ", "wavelength [nm]", "ρ [1]", rho, points=False),
        Chart("Goniochromatism c", "wavelength [nm]", "c [1]", c, points=False),
        Chart("Chromaticity against angle", "x [1]", "y [1]", place),
        Chart("Brightness against angle", "θ [°]", "Y [1]", bright),
        Chart("Colour difference from the first angle", "θ [°]", "ΔE2000 [1]", apart),
    ]


def _own_colours(shown: Show) -> list[str | None]:
    """The colour that every ink shows first; None for all of them where two look alike."""
    codes = [one.hexes[0] for one in shown.inks]
    rgb = np.array([[int(code[k : k + 2], 16) for k in (1, 3, 5)] for code in codes], dtype=np.float64)
    apart = np.linalg.norm(rgb[:, None] - rgb[None, :], axis=-1) + 255.0 * np.eye(len(rgb))
    return [None] * len(codes) if apart.min() < LEAST_APART else list(codes)


def _chart_uri(chart: Chart) -> str:
    with new_figure(4.2, 3.2) as (figure, axes):
        chart.draw(axes)
        return svg_uri(figure)
