"""Page of one height map: appearance, ridges, and origin."""

import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import HeightMapError
from anisoscope.base.progress import Advance, silent
from anisoscope.profiles.heightmap import COLOUR, INTERPOLATED, HeightMap
from anisoscope.profiles.level import level
from anisoscope.profiles.metrology.burrlist import Outlier
from anisoscope.profiles.metrology.quantity import as_text
from anisoscope.profiles.metrology.regions import DirectionRegions
from anisoscope.profiles.metrology.ridgemeasurement import MeanRidge, RidgeMeasurement
from anisoscope.profiles.metrology.ridges import measure_ridges
from anisoscope.profiles.textures.amplitude import amplitude
from anisoscope.report.figures import (
    BLUE,
    GREEN,
    MUTED,
    ORANGE,
    RED,
    new_figure,
    new_map_figure,
    png_uri,
    svg_uri,
)
from anisoscope.report.page import write_page
from anisoscope.report.surface_view import Picture3D, Renderer, SceneScale, viewer_of

PICTURE_POINTS = 900
MARKED = 200
LISTED = 30
DRAWN = (0.001, 0.999)
VIEW_POINTS, VIEW_EXAGGERATION = 400, 1000.0
MISSING_GREY = 200.0
COLOURS = {"burr": RED, "spike": "#ffffff", "pit": ORANGE}
NUMBERS = (
    ("Pitch", "pitch_um", "µm"),
    ("Pitch on the tilted surface", "surface_pitch_um", "µm"),
    ("Direction of the ridges, from +y", "direction_deg", "°"),
    ("Ridge angle", "ridge_angle_deg", "°"),
    ("Wall angle", "wall_angle_deg", "°"),
    ("Ridge height", "height_um", "µm"),
    ("Height loss at the crest", "height_loss", "1"),
    ("Edge radius of the crest", "edge_radius_um", "µm"),
    ("Height loss at the foot", "foot_loss", "1"),
    ("Radius of the foot", "foot_radius_um", "µm"),
    ("α along the ridges", "alpha_along", "1"),
    ("α across the ridges", "alpha_across", "1"),
    ("White noise of the heights", "noise_um", "µm"),
    ("Ridge angle, ridge to ridge", "angle_variation_deg", "°"),
    ("Ridge height, ridge to ridge", "height_variation_um", "µm"),
    ("Position, ridge to ridge", "shift_variation_um", "µm"),
    ("Ridge angle, along the ridges", "along_variation_deg", "°"),
)


def map_picture(surface: HeightMap, burrs: tuple[Outlier, ...] = ()) -> str:
    """Levelled map in false colours, as a data URI: missing points grey, interpolated hatched, outstanding circled.

    Args:
        surface: the map; heights in µm.
        burrs: what to circle, at most the first 200.
    """
    from matplotlib.collections import EllipseCollection

    rows, cols = surface.shape
    step = max(1, -(-max(rows, cols) // PICTURE_POINTS))
    heights = surface.height_um[::step, ::step]
    height, width = (n * 1e-3 for n in surface.extent_um)
    with new_map_figure((height, width)) as (figure, axes, bar):
        low, high = np.nanpercentile(heights, [0.5, 99.5])
        axes.set_facecolor("#9aa5ae")
        image = axes.imshow(
            np.ma.masked_invalid(heights), origin="lower", cmap="viridis", extent=(0.0, width, 0.0, height),
            vmin=low, vmax=max(high, low + 1e-9), interpolation="nearest",
        )  # fmt: skip
        if (guessed := surface.layers.get(INTERPOLATED)) is not None:
            part = guessed[::step, ::step]
            y, x = (
                (np.arange(n) + 0.5) * size / n for n, size in zip(part.shape, (height, width), strict=True)
            )
            axes.contourf(x, y, part, levels=[0.5, 1.5], colors="none", hatches=["////"])
        for kind, colour in COLOURS.items():
            marked = [one for one in burrs[:MARKED] if one.kind == kind]
            if marked:
                size = [max(2.6 * np.sqrt(one.area_um2) * 1e-3, 0.012 * width) for one in marked]
                axes.add_collection(
                    EllipseCollection(
                        size,
                        size,
                        np.zeros(len(marked)),
                        units="xy",
                        facecolors="none",
                        edgecolors=colour,
                        linewidths=0.9,
                        offsets=[(1e-3 * one.x_um, 1e-3 * one.y_um) for one in marked],
                        offset_transform=axes.transData,
                    )
                )
        axes.set_xlim(0.0, width)
        axes.set_ylim(0.0, height)
        figure.colorbar(image, cax=bar, label="height [µm]")
        return svg_uri(figure)


def write_region_picture(path: Path, regions: DirectionRegions) -> None:
    """Write a PNG: heights in grey, regions coloured by their direction, outlined, and numbered.

    Raises:
        RecordError: the file cannot be written.
    """
    from matplotlib.figure import Figure

    surface = regions.surface
    step = max(1, -(-max(surface.shape) // PICTURE_POINTS))
    height, width = (1e-3 * one for one in surface.extent_um)
    extent = (0.0, width, 0.0, height)
    figure = Figure(figsize=(6.0, 6.0 * min(max(height / width, 0.3), 3.0)), layout="constrained")
    axes = figure.add_subplot()
    heights = np.ma.masked_invalid(surface.height_um[::step, ::step])
    axes.imshow(heights, origin="lower", cmap="gray", extent=extent)
    classes = np.zeros(len(regions.regions) + 1)
    for one in regions.regions:
        classes[one.number] = one.direction_class + 1.0
    labels = regions.labels[::step, ::step]
    shown = np.ma.masked_equal(classes[labels], 0.0)
    most = max(len(regions.azimuths_deg), 2)
    axes.imshow(
        shown,
        origin="lower",
        cmap="tab10",
        alpha=0.35,
        extent=extent,
        vmin=0.5,
        vmax=10.5 if most <= 10 else most + 0.5,
    )
    border = np.zeros(labels.shape, dtype=bool)
    border[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    border[1:] |= labels[1:] != labels[:-1]
    axes.imshow(
        np.ma.masked_equal(border, False), origin="lower", cmap="gray", extent=extent, vmin=0.0, vmax=2.0
    )
    for one in regions.regions:
        x, y = (1e-3 * place for place in one.centre_um)
        label = f"{one.number}\n{one.direction_deg:.0f}°"
        axes.text(x, y, label, ha="center", va="center", fontsize=7, color="black")
    axes.set(xlabel="x [mm]", ylabel="y [mm]", title="direction of the ridges from +y")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150)
    write_bytes(path, buffer.getvalue())


def ridge_chart(mean: MeanRidge) -> str:
    """The mean ridge about its wall and the fitted facet, as a data URI."""
    with new_figure(4.6, 2.9) as (_figure_, axes):
        axes.plot(mean.x_um, mean.height_um, ".", color=BLUE, markersize=2.5, label="mean ridge")
        axes.plot(mean.facet_um, mean.facet_height_um, color=RED, linewidth=1.3, label="fitted facet")
        pitch = float(mean.x_um[-1] - mean.x_um[0])
        before = [x - pitch for x in mean.facet_um]
        drop = (mean.facet_height_um[1] - mean.facet_height_um[0]) / (mean.facet_um[1] - mean.facet_um[0])
        inside = [max(x, float(mean.x_um[0])) for x in before]
        if inside[1] > inside[0]:
            heights = [mean.facet_height_um[0] + drop * (x - before[0]) for x in inside]
            axes.plot(inside, heights, color=RED, linewidth=1.3)
        axes.set_xlim(float(mean.x_um[0]), float(mean.x_um[-1]))
        axes.grid()
        axes.set_xlabel("position from the wall, facets falling to the right [µm]")
        axes.set_ylabel("height [µm]")
        axes.legend(frameon=False, fontsize=8)
        return svg_uri(_figure_)


def slope_chart(found: RidgeMeasurement) -> str:
    """Distribution of point slopes along and across, with the ones that α and noise predict."""
    noise = found.noise_um.value or 0.0
    # of single points over one pixel: α is what is left of their variance without the noise
    extra = 2.0 * (noise / found.bandwidth_um[0]) ** 2
    mean = found.mean_ridge
    with new_figure(4.6, 2.9) as (figure, axes):
        series = (
            ("across", mean.slopes_across, found.alpha_across, BLUE),
            ("along", mean.slopes_along, found.alpha_along, GREEN),
        )
        reach = 4.0 * max((float(np.std(np.clip(s, -2, 2))) for _, s, _, _ in series if s.size), default=0.1)
        edges = np.linspace(-reach, reach, 81)
        x = np.linspace(-reach, reach, 241)
        for name, slopes, alpha, colour in series:
            if not slopes.size:
                continue
            axes.stairs(
                np.histogram(slopes, edges)[0] / slopes.size / np.diff(edges), edges, color=colour, alpha=0.6
            )
            if alpha.value is not None:
                axes.plot(
                    x,
                    _normal(x, 0.5 * alpha.value**2 + extra),
                    color=colour,
                    linewidth=1.4,
                    label=f"{name}: α and noise",
                )
                axes.plot(
                    x,
                    _normal(x, 0.5 * alpha.value**2),
                    color=colour,
                    linewidth=1.0,
                    linestyle="--",
                    label=f"{name}: α alone",
                )
        axes.set_xlabel("slope of the facets against their planes")
        axes.set_ylabel("density")
        axes.set_xlim(-reach, reach)
        axes.grid()
        if axes.get_legend_handles_labels()[0]:  # none where alpha is withheld
            axes.legend(frameon=False, fontsize=7.5)
        return svg_uri(figure)


def _normal(x: FloatArray, variance: float) -> FloatArray:
    found: FloatArray = np.exp(-0.5 * x * x / variance) / np.sqrt(2.0 * np.pi * variance)
    return found


def angle_chart(found: RidgeMeasurement) -> str:
    """Ridge angle of every ridge with its 95 % interval, as a data URI."""
    with new_figure(4.6, 2.4) as (figure, axes):
        for ridge in found.ridges:
            value, u = ridge.angle_deg.value, ridge.angle_deg.u
            if value is not None and u is not None:
                axes.errorbar(
                    ridge.number, value, yerr=1.96 * u, fmt="o", color=BLUE, capsize=3, markersize=4
                )
        if found.ridge_angle_deg.value is not None:
            axes.axhline(found.ridge_angle_deg.value, color=MUTED, linewidth=0.9, linestyle=":")
        axes.grid(axis="y")
        axes.set_xlabel("ridge")
        axes.set_ylabel("ridge angle [°]")
        axes.locator_params(axis="x", integer=True)
        return svg_uri(figure)


ORIGIN_WORDS = {
    "sha256": "SHA-256",
    "reader": "read by",
    "pixel_um": "pixel size along y, x [µm]",
    "missing_share": "missing share of the points",
    "z_unit": "unit of the heights",
    "xy_unit": "unit of the positions",
    "um_per_count": "height of one count [µm]",
    "first_row": "first row of the picture",
}
"""Names of entries of an origin that their keys do not say."""


def _origin_lines(origin: dict[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Origin of a map as pairs of name and text; nested entries are named with what holds them."""
    lines: list[tuple[str, str]] = []
    for key, value in origin.items():
        name = ORIGIN_WORDS.get(key) or re.sub(r" (um|mm|nm|deg)$", r" [\1]", key.replace("_", " "))
        name = name.replace("[um]", "[µm]").replace("[deg]", "[°]")
        if isinstance(value, dict):
            lines += _origin_lines(value, f"{prefix}{name}, ")
        elif value not in (None, "", [], ()):
            text = ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
            lines.append((f"{prefix}{name}", text))
    return lines


def _ridge_part(measured: RidgeMeasurement) -> dict[str, Any]:
    found = measured.stated()
    return {
        "numbers": [(text, *as_text(getattr(found, key)), unit) for text, key, unit in NUMBERS],
        "remarks": found.remarks(),
        "ridge_chart": ridge_chart(found.mean_ridge),
        "slope_chart": slope_chart(found),
        "angle_chart": angle_chart(found) if found.straight else None,
        "ridge_rows": [
            (
                one.number,
                f"{one.position_um:.2f}".replace("-", "−"),
                *(cell for each in (one.angle_deg, one.height_um, one.shift_um) for cell in as_text(each)),
            )
            for one in found.ridges
        ],
        "counts": {k: sum(one.kind == k for one in found.burrs) for k in COLOURS},
        "burrs": found.burrs[:LISTED],
    }


def write_profile_page(
    surface: HeightMap,
    name: str,
    path: Path,
    on_progress: Advance = silent,
    *,
    period_limit_um: float | None = None,
    tip_radius_um: float | None = None,
) -> None:
    """Write the page of a height map, atomically.

    Args:
        surface: the map as read.
        name: how the page calls it.
        path: file to write.
        on_progress: told what is done.
        period_limit_um: of the instrument, as of ``measure_ridges``.
        tip_radius_um: of the instrument, the same.

    Raises:
        HeightMapError: nothing was measured.
        RecordError: the file cannot be written.
    """
    levelled = level(surface)
    limits = np.nanquantile(levelled.map.height_um, DRAWN)
    renderer = Renderer(np.clip(levelled.map.height_um, *limits), (surface.pixel_y_um, surface.pixel_x_um))
    try:
        on_progress("ridges", 1, 3)
        try:
            found, reason = measure_ridges(surface, period_limit_um, tip_radius_um=tip_radius_um), ""
        except HeightMapError as error:
            found, reason = None, str(error)
        on_progress("pictures", 2, 3)
        content: dict[str, Any] = {
            "name": name,
            "surface": surface,
            "levelled": levelled,
            "amplitude": amplitude(levelled.map),
            "found": found,
            "reason": reason,
            "picture": map_picture(levelled.map, found.burrs if found else ()),
            "origin": _origin_lines(surface.origin),
            "part": _ridge_part(found) if found else None,
        }
        view = renderer.result()
    finally:
        renderer.discard()
    content["view"] = png_uri(view.png) if view.png else None
    content["view_note"] = f"{view.note}; the highest and lowest 0.1 % cut" if view.png else view.note
    filters = {"signed": lambda value, digits: f"{value:.{digits}f}".replace("-", "−")}
    write_page(path, "profile.html", content, filters)
    on_progress("done", 3, 3)


def layer_colours(surface: HeightMap, name: str) -> npt.NDArray[np.uint8]:
    """A layer of a map as (rows, cols, 3) red, green and blue; missing points are light grey.

    An intensity is drawn from its 0.5 % to its 99.5 % quantile.

    Raises:
        HeightMapError: the map has no such layer, or nothing of it is known.
    """
    layer = surface.layers.get(name)
    if layer is None or not np.isfinite(layer).any():
        known = " and ".join(surface.layers)
        source = surface.origin.get("file", "the map")
        raise HeightMapError(
            f"{source}: layer: there is no {name}" + (f"; there is {known}" if known else "")
        )
    if name != COLOUR:
        low, high = np.nanpercentile(layer, [0.5, 99.5])
        layer = np.repeat(255.0 * (layer - low)[..., None] / max(float(high - low), 1e-9), 3, axis=2)
    return np.where(np.isfinite(layer), np.clip(layer, 0.0, 255.0), MISSING_GREY).astype(np.uint8)


def _seen_from_above(colours: npt.NDArray[np.uint8]) -> str:
    import cv2

    step = -(-max(colours.shape[:2]) // PICTURE_POINTS)
    picture = np.ascontiguousarray(colours[::step, ::step][::-1, :, ::-1])  # OpenCV's order: blue, green, red
    return png_uri(cv2.imencode(".png", picture)[1].tobytes())


def write_view_page(
    surface: HeightMap, name: str, path: Path, exaggeration: float | None = None, layer: str | None = None
) -> Picture3D:
    """Write a page with the whole map in 3-D, to be turned in the browser, and from above with its scale.

    The plane is removed and the highest and lowest 0.1 % of the heights are cut; of a large map every n-th point is
    drawn, 400 along a side at most. Without a renderer the page has the still picture from above alone, and says why.

    Args:
        surface: the map as read.
        name: how the page calls it.
        path: file to write.
        exaggeration: factor on the heights; None for one that makes the relief 8 % of the width, at most 1000.
        layer: "intensity" or "colour", which colours the relief; None for the heights.

    Returns:
        What was drawn: no ``png`` where nothing could be drawn in 3-D, no ``scene`` where it cannot be turned; ``note``
        says why.

    Raises:
        HeightMapError: nothing was measured, or the map has no such layer.
        RecordError: the file cannot be written.
    """
    colours = None if layer is None else layer_colours(surface, layer)
    levelled = level(surface)
    heights = levelled.map.height_um
    scale = SceneScale(max(surface.extent_um), VIEW_POINTS, exaggeration, VIEW_EXAGGERATION)
    renderer = Renderer(
        np.clip(heights, *np.nanquantile(heights, DRAWN)),
        (surface.pixel_y_um, surface.pixel_x_um),
        interactive=True,
        scene=scale,
        colours=colours,
    )
    try:
        above = map_picture(levelled.map)
        view = renderer.result()
    finally:
        renderer.discard()
    viewer = viewer_of(view.scene) if view.png and view.scene else None
    step = -(-max(surface.shape) // VIEW_POINTS)
    content = {
        "name": name,
        "surface": surface,
        "levelled": levelled,
        "amplitude": amplitude(levelled.map),
        "picture": above,
        "layer": layer,
        "layer_picture": None if colours is None else _seen_from_above(colours),
        "view": png_uri(view.png) if view.png else None,
        "note": view.note,
        "step": step,
        "viewer": viewer,
        "script_sources": viewer.script_sources if viewer else (),
    }
    filters = {"signed": lambda value, digits: f"{value:.{digits}f}".replace("-", "−")}
    write_page(path, "view.html", content, filters)
    return view
