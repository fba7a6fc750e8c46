"""Pages and pictures of etched designs: content for `report.design_page`, and half vectors in colours."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_bytes
from anisoscope.parameters.etching import PatternOptions
from anisoscope.report.design_page import (
    CaptionedPicture,
    DesignPage,
    LobeCurves,
    PhaseCurve,
    write_design_page,
)
from anisoscope.report.figures import BLUE, MUTED, new_figure
from anisoscope.sim.design.appearance import Picture, mirrored_dots, pattern_under, screen
from anisoscope.sim.design.depths import tolerances
from anisoscope.sim.design.designfile import DesignFile
from anisoscope.sim.design.layout import Layout
from anisoscope.sim.design.lobe import AxisLobe
from anisoscope.sim.design.models import LobeModel, MixtureModel, model_density
from anisoscope.sim.design.pattern import make_layout
from anisoscope.sim.design.refine import Refined
from anisoscope.sim.design.resolution import PICTURE, REACH, Tradeoff, expected
from anisoscope.sim.light.colour.spaces import encode

UNITS = {
    "sigma_x": ("σ_h along x", "1"),
    "sigma_y": ("σ_h along y", "1"),
    "rel_l2": ("missed, relative L2, both axes", "1"),
    "rel_l2_x": ("missed along x", "1"),
    "rel_l2_y": ("missed along y", "1"),
    "one_width_x": ("missed with one width along x", "1"),
    "one_width_y": ("missed with one width along y", "1"),
    "intrinsic_x": ("missed with steps of any width, along x", "1"),
    "intrinsic_y": ("missed with steps of any width, along y", "1"),
    "unreachable_x": ("wanted light that stays out of reach, along x", "1"),
    "unreachable_y": ("wanted light that stays out of reach, along y", "1"),
    "hole_x": ("width of the hole along h_x", "1"),
    "hole_y": ("width of the hole along h_y", "1"),
    "ring_x": ("end of the ring at h_x", "1"),
    "ring_y": ("end of the ring at h_y", "1"),
    "hole_floor": ("floor of the hole over the ring, from the source", "1"),
}
"""What the figures of a design file mean, and their units."""


LOOK_H = 0.06
"""Half vector of the two lights under which patterns are shown: a lamp 7° from the camera."""

SOURCE = (
    "Levin et al. 2013, Fabricating BRDFs at high spatial resolution using wave optics, with its equations mended: the "
    "source blurs the lobe too, and mixtures count by area. Scalar waves, no shadows, one material."
)
DRAWN_BAND = (380.0, 750.0)
LEAST_SPIKE = 1e-6
"""Share of the light below which nothing is said to be left of a mirror."""


def write_design_report(
    design: DesignFile, path: Path, axes: Sequence[AxisLobe] = (), warnings: Sequence[str] = ()
) -> None:
    """Write the page of one reflectance.

    Raises:
        RecordError: the file cannot be written.
    """
    tile = make_layout(
        np.zeros((1, 1), dtype=np.int64), [design], np.random.default_rng(0), PatternOptions(tiles=4)
    )
    write_design_page(
        DesignPage(
            title=design.name,
            subtitle=_subtitle(design),
            answer=answer_of(design),
            warnings=warnings,
            figures=figure_rows(design),
            lobes=_curves(design, axes),
            phase=_phase(design),
            pictures=_pictures(design),
            tolerances=tolerance_rows(design, tile),
            notes=(SOURCE, _brightness_note()),
        ),
        path,
    )


def write_refined_report(design: DesignFile, layout: Layout, found: Refined, path: Path) -> None:
    """Write the page of a refined dot.

    Raises:
        RecordError: the file cannot be written.
    """
    table = layout.heights_um
    grey = (table - table.min()) / max(float(np.ptp(table)), 1e-9)
    dot = CaptionedPicture(
        np.repeat(grey[layout.tiles[0]][::-1, :, None], 3, axis=2), "The dot; deeper is darker"
    )
    figures = [
        ("relative error of the best random dot", f"{found.start_error:.4f}", "1"),
        ("relative error", f"{found.error:.4f}", "1"),
        ("generations", str(found.generations), "1"),
        ("ended by", found.stopped, ""),
        *figure_rows(design),
    ]
    write_design_page(
        DesignPage(
            title=f"Dot of {design.name}",
            subtitle=_subtitle(design),
            answer=f"The dot misses the expected lobe by {found.error:.1%}; the best random dot missed it by "
            f"{found.start_error:.1%}. {_spike(design)}".rstrip(),
            figures=figures,
            phase=_phase(design),
            progress=found.history,
            pictures=(dot, *_pictures(design)),
            tolerances=tolerance_rows(design, layout),
            notes=(SOURCE, _brightness_note()),
        ),
        path,
    )


def write_pattern_report(layout: Layout, designs: Sequence[DesignFile], path: Path) -> None:
    """Write the page of a pattern.

    Raises:
        RecordError: the file cannot be written.
    """
    views = [
        (pattern_under(layout, designs, *h), words)
        for h, words in (((LOOK_H, 0.0), "Lamp to the side (x)"), ((0.0, LOOK_H), "Lamp above (y)"))
    ]
    brightest = max(float(each.max()) for (_, each), _ in views)
    looks = tuple(
        CaptionedPicture(
            np.repeat(_encoded(picture / brightest)[..., None], 3, axis=2), f"{words}, h = {LOOK_H:g}"
        )
        for (picture, _), words in views
    )
    figures = [
        (
            name,
            f"{views[0][0][1][number] / brightest:.3f}, {views[1][0][1][number] / brightest:.3f}",
            "side, above",
        )
        for number, name in enumerate(layout.names)
    ]
    high, wide = (1e-3 * side for side in layout.size_um)
    etched = next(design for design in designs if design.passes_nm)
    pictures = tuple(
        CaptionedPicture(picture.srgb, f"{design.name}: {picture.caption}")
        for design in designs
        for picture in (screen(design, white=True), mirrored_dots(design, white=True))
    )
    write_design_page(
        DesignPage(
            title="Pattern of " + ", ".join(layout.names),
            subtitle=f"{wide:.2f} × {high:.2f} mm, {layout.index.size} dots of {layout.dot_um:g} µm, "
            f"{len(layout.tiles)} tiles",
            answer=_told_apart(
                [[float(each[k]) / brightest for (_, each), _ in views] for k in range(len(designs))]
            ),
            figures=figures,
            phase=_phase(etched),
            pictures=pictures,
            looks=looks,
            tolerances=tolerance_rows(etched, layout),
            notes=(SOURCE, "Brightness of the classes is relative to the brightest.", _brightness_note()),
        ),
        path,
    )


def _encoded(
    linear: FloatArray,
) -> FloatArray:
    return encode(np.repeat(linear[..., None], 3, axis=-1)).srgb[..., 0]


def _brightness_note() -> str:
    return "Pictures are scaled to their brightest parts; a specular spike may burn out."


def _subtitle(design: DesignFile) -> str:
    kind = {"lobe": "glossy lobe", "antimirror": "anti-mirror", "mirror": "mirror", "mixture": "mixture"}
    passes = " + ".join(f"{depth:.1f}" for depth in design.passes_nm)
    return f"{kind[design.model.kind]}; {2 ** len(design.passes_nm)} levels from etch passes of {passes} nm"


def answer_of(design: DesignFile) -> str:
    """What a design does, in a sentence or two: how near it comes to what was wanted, and what is left of a mirror."""
    found = design.figures
    along = [f"{found[f'rel_l2_{axis}']:.1%} along {axis}" for axis in "xy" if f"rel_l2_{axis}" in found]
    if along:
        begins = f"The lobe misses what was wanted by {' and '.join(along)} (relative L2)."
    elif "rel_l2" in found:
        begins = f"The lobe misses what was wanted by {found['rel_l2']:.1%} (relative L2)."
    elif "hole_x" in found and "hole_y" in found:
        begins = f"Light is missing about the mirror direction, {found['hole_x']:.3g} wide in h_x and "
        begins += f"{found['hole_y']:.3g} in h_y."
    elif design.passes_nm:
        begins = "Etched steps spread the light about the mirror direction."
    else:
        begins = "Nothing is etched: a mirror."
    return f"{begins} {_spike(design)}".rstrip()


def _spike(design: DesignFile) -> str:
    """What the etch passes leave of the mirror."""
    if not design.passes_nm:
        return ""
    low, high = design.band_nm
    span = f"at {low:g} nm" if low == high else f"from {low:g} to {high:g} nm"
    passes = " and ".join(f"{depth:.1f}" for depth in design.passes_nm)
    spike = design.depths.epsilon**2
    left = f"at most {spike:.2g} of the light (|τ|²)" if spike >= LEAST_SPIKE else "nothing"
    return f"Etched {passes} nm deep, it leaves {left} of the bright spike of a mirror {span}."


def _told_apart(levels: Sequence[Sequence[float]]) -> str:
    """By how much the classes of a pattern, each from the side and from above, differ at most."""
    if len(levels) < 2:
        return "One reflectance covers the whole pattern."
    ratios = [
        (max(one[k] for one in levels) / max(min(one[k] for one in levels), 1e-9), where)
        for k, where in enumerate(("to the side", "above"))
    ]
    most, where = max(ratios)
    told = f"{most:.2g} times as bright" if most < 1e3 else "more than 1000 times as bright"
    return (
        f"With the lamp {where} the brightest class is {told} as the darkest: the pattern shows best there."
    )


def _curves(design: DesignFile, axes: Sequence[AxisLobe]) -> tuple[LobeCurves, ...]:
    if axes:
        return tuple(
            LobeCurves(name, one.h, one.target, one.achieved)
            for name, one in zip(("x", "y"), axes, strict=True)
        )
    h = np.linspace(-0.3, 0.3, 601)
    f, zero = 2.0e3 * h / design.wavelength_nm, np.zeros(1)
    tau = design.depths.tau_at(design.wavelength_nm)
    along_x = model_density(design.model, f, zero, design.coherence_um, 112.0, tau)[0]
    along_y = model_density(design.model, zero, f, design.coherence_um, 112.0, tau)[:, 0]
    return LobeCurves("x", h, None, along_x), LobeCurves("y", h, None, along_y)


def _phase(design: DesignFile) -> PhaseCurve:
    nm = np.linspace(min(DRAWN_BAND[0], design.band_nm[0]), max(DRAWN_BAND[1], design.band_nm[1]), 371)
    return PhaseCurve(nm, design.depths.tau(nm), design.band_nm)


def _pictures(design: DesignFile) -> tuple[CaptionedPicture, ...]:
    found: list[Picture] = [
        screen(design, white=False), screen(design, white=True),
        mirrored_dots(design, white=False), mirrored_dots(design, white=True),
    ]  # fmt: skip
    return tuple(CaptionedPicture(one.srgb, one.caption) for one in found)


def tolerance_rows(design: DesignFile, layout: Layout) -> list[list[str]]:
    """Rows of the table of tolerances."""
    if not design.passes_nm:
        return []
    mine = [number for number, name in enumerate(layout.names) if name == design.name]
    tiles = layout.tiles[np.isin(layout.tile_class, mine)]
    rows = tolerances(
        design.depths, tiles, layout.grid_um, wavelength_nm=design.wavelength_nm,
        coherence_um=design.coherence_um, width_um=mean_width_um(design),
    )  # fmt: skip
    return [
        [
            f"{one.over_etch_nm:+g}".replace("-", "−") if one.over_etch_nm else "0", f"{one.width_bias_nm:g}",
            f"{one.tau:.4f}", f"{one.worst_tau:.4f}", f"{max(one.spike_over_lobe, 0.0):.4f}",
            f"{100.0 * one.lobe_energy:.2f}", f"{100.0 * one.lobe_change:.2f}",
        ]
        for one in rows
    ]  # fmt: skip


def mean_width_um(design: DesignFile) -> float:
    """Geometric mean of the mean widths of the steps along both axes."""
    model = design.model
    if isinstance(model, MixtureModel):
        model = model.models[0]
    if isinstance(model, LobeModel):
        x, y = (widths.mean_um for widths in model.axes(0.0))
        return float(np.sqrt(x * y))
    return float(np.sqrt(np.prod(model.widths_um))) if model.kind == "antimirror" else 1.0


def figure_rows(design: DesignFile) -> list[tuple[str, str, str]]:
    """(quantity, value, unit) of a design."""
    rows = [
        (UNITS[key][0], f"{value:.4g}", UNITS[key][1])
        for key, value in design.figures.items()
        if key in UNITS
    ]
    if design.passes_nm:
        rows.append(("etch passes", ", ".join(f"{depth:.1f}" for depth in design.passes_nm), "nm"))
        low, high = design.band_nm
        span = f"at {low:g} nm" if low == high else f"from {low:g} to {high:g} nm"
        rows.append((f"largest mean phase |τ| {span}", f"{design.depths.epsilon:.4f}", "1"))
    rows += [
        ("design wavelength", f"{design.wavelength_nm:g}", "nm"),
        ("coherence length", f"{design.coherence_um:g}", "µm"),
        ("smallest feature", f"{design.min_width_um:g}", "µm"),
    ]
    return rows


def draw_panels(panels: list[tuple[FloatArray, str, str, float, float]], reach: float, path: Path) -> None:
    """Draw (values, title, colours, low, top) of half vectors side by side into a PNG."""
    with new_figure(3.4 * len(panels), 3.2) as (figure, axes):
        axes.remove()
        for panel, (values, title, colours, low, top) in zip(
            figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
        ):
            shown = panel.imshow(
                values,
                origin="lower",
                cmap=colours,
                vmin=low,
                vmax=top,
                extent=(-reach, reach, -reach, reach),
            )
            if values.ndim == 2:
                figure.colorbar(shown, ax=panel, shrink=0.8)
            panel.set_title(title, fontsize=9)
            panel.set_xlabel("h_x [1]")
        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    write_bytes(path, stream.getvalue())


def draw_tradeoff(design: DesignFile, found: tuple[Tradeoff, ...], path: Path) -> None:
    """Expected reflectance, one dot of each pair, and the error over n."""
    h = np.linspace(-REACH, REACH, PICTURE)
    panels = [(expected(design, found[0].coherence_um, h, found[0].dot_um), "expected")]
    panels += [(one.observed, f"Δd {one.dot_um:g}, Δc {one.coherence_um:g} µm") for one in found]
    with new_figure(2.1 * len(panels) + 3.2, 2.6) as (figure, axes):
        axes.remove()
        row = figure.subplots(1, len(panels) + 1, width_ratios=[1.0] * len(panels) + [1.4])
        for panel, (density, title) in zip(row, panels, strict=False):
            panel.imshow(
                density, origin="lower", cmap="gray", extent=(-REACH, REACH, -REACH, REACH),
                vmin=0.0, vmax=float(np.percentile(density, 99.7)),
            )  # fmt: skip
            panel.set_title(title, fontsize=8)
            panel.set_xlabel("h_x [1]")
        n = np.array([one.windows for one in found])
        last = row[-1]
        last.loglog(n, [one.error for one in found], "o", color=BLUE)
        line = np.array([n.min(), n.max()])
        last.loglog(line, found[-1].error * np.sqrt(n[-1] / line), "--", color=MUTED, linewidth=1.0)
        last.set_xlabel("windows n; dashed: 1/√n")
        last.set_ylabel("relative error [1]")
        last.grid()
        stream = io.BytesIO()
        kind = path.suffix.lower()[1:]
        figure.savefig(
            stream, format=kind, dpi=110, metadata={"Date": None} if kind == "svg" else {"Software": None}
        )
    write_bytes(path, stream.getvalue())
