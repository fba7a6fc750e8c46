"""Pages of plates and etched wafers: self-contained files that show all fields in WebGL, under light from any side.

Radiances are computed by the page, class by class. Of plates as `anisoscope.sim.light.corrected` does for direct light:
the page holds the outline of the ridges, the lobe, and the table of the transmittance. Of wafers by the waves of
`anisoscope.sim.light.wave`: the page holds the rectangles of every tile and sums their waves for the points of the
lamp. Light and eye are far away, so that all fields of a class, and all dots of a tile, are alike.
"""

import hashlib
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.plates import Plan, inner_share
from anisoscope.report.figures import png_uri
from anisoscope.report.page import packed, scripted, write_page
from anisoscope.sim.light.colour.illuminant import Illuminant
from anisoscope.sim.light.colour.observer import xyz_weights
from anisoscope.sim.light.colour.spaces import SRGB_TO_XYZ, XYZ_TO_SRGB
from anisoscope.sim.light.corrected import outline_for
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.material import diffuse_scale, transmittance_table

FLAT_CLASS = 0xFFFF
LINES_NM = tuple(float(nm) for nm in range(400, 701, 20))
MOST_SIDE, MOST_TILES = 4096, 2048
STILL_SIDE = 480
MOST_TERMS = 3e8
"""Products of a picture of a wafer: about a second of a browser."""


def write_plate_page(
    path: Path,
    title: str,
    plan: Plan,
    design: RidgeDesign,
    material: Material,
    light_angle_deg: float,
    stages_deg: tuple[float, ...],
    ends: tuple[float, float],
    shown: FloatArray | None = None,
) -> None:
    """Write the page, atomically.

    Args:
        path: file to write.
        title: what the plate shows.
        plan: its fields.
        design: their ridges.
        material: the plastic, with Beckmann's lobe.
        light_angle_deg: between light and camera on the rig.
        stages_deg: stage angles that are offered.
        ends: radiances of black and white in 1/sr.
        shown: (rows, cols) radiance at the first stage angle in 1/sr, for browsers without WebGL; its classes without.

    Raises:
        UsageError: a lobe that the page does not know.
        RecordError: the file cannot be written.
    """
    if not material.is_beckmann:
        raise UsageError("the page of a plate knows Beckmann's lobe only: leave out tail and second lobe")
    rows, cols = plan.shape
    size = f"{plan.size_mm[0]:g} mm × {plan.size_mm[1]:g} mm"
    content = {
        "title": f"{title}, made of ridges",
        "subtitle": f"{cols} × {rows} fields, {size}, as predicted under light from any side",
        "rows": rows,
        "cols": cols,
        "stages": [f"{one:g}" for one in stages_deg],
        "part": "plate",
        "still": _grey_uri(plan.classes(), 0.0, len(plan.letters) - 1.0)
        if shown is None
        else _grey_uri(shown, *ends),
        "still_text": "a grey for each class of fields"
        if shown is None
        else f"as predicted at {stages_deg[0]:g}°, on the rig",
        "field": "field",
        "exposures": 4,
        "tones": [
            ("picture", "from black to white, as the picture"),
            ("eye", "radiance, for the eye (sRGB)"),
        ],
        "facts": (
            ("ridges", f"pitch {design.pitch_um:g} µm, {len(plan.letters)} classes of direction and ridge angle"),
            ("roughness", f"α {material.alpha_along:g} along and {material.alpha_across:g} across the ridges"),
            ("plastic", f"albedo {material.albedo:g}, index {material.index:g}"),
            ("black and white", f"{ends[0]:.4g} and {ends[1]:.4g} 1/sr"),
            ("model", "direct light, rays, light and eye far away; rims of the fields are dark"),
        ),
        **scripted(
            _data(plan, design, material, light_angle_deg, stages_deg, ends), "webgl.js", "fields.js", "plate.js"
        ),
    }  # fmt: skip
    write_page(path, "plate.html", content)


def _grey_uri(values: npt.NDArray[Any], black: float, white: float) -> str:
    """(rows, cols) values as a grey picture, enlarged where it is small."""
    greys = np.clip((values - black) / max(white - black, 1e-12), 0.0, 1.0)
    times = max(1, STILL_SIDE // max(greys.shape))
    done, data = cv2.imencode(
        ".png", np.rint(255.0 * np.kron(greys, np.ones((times, times)))).astype(np.uint8)
    )
    assert done
    return png_uri(data.tobytes())


def _data(
    plan: Plan,
    design: RidgeDesign,
    material: Material,
    light_angle_deg: float,
    stages_deg: tuple[float, ...],
    ends: tuple[float, float],
) -> dict[str, Any]:
    classes = []
    for letter in plan.letters:
        ridges = plan.design_of(letter, design)
        outline = outline_for(ridges, material)
        classes.append(
            {
                "name": letter,
                "azimuth": plan.azimuths_deg[letter],
                "angle": ridges.ridge_angle_deg,
                "share": inner_share(ridges, 1000.0 * plan.module_mm),
                "x": outline.x_um.tolist(),
                "z": outline.z_um.tolist(),
                "segment": outline.segment.tolist(),
                "normal": outline.normal.ravel().tolist(),
                "length": outline.length_um.tolist(),
            }
        )
    numbers = plan.classes()
    ((to_light, _),) = zip(*directions((Pose(0.0),), Convention(light_angle_deg)), strict=True)
    elevation = float(np.degrees(np.arcsin(to_light[2])))
    start = {
        "stage": stages_deg[0],
        "tilt": 0,
        "azimuth": 0 if light_angle_deg >= 0.0 else 180,
        "elevation": elevation,
    }
    return {
        "rows": plan.shape[0],
        "cols": plan.shape[1],
        "fields": packed(np.where(numbers < 0, FLAT_CLASS, numbers).astype(np.uint16)),
        "classes": classes,
        "along": material.alpha_along,
        "across": material.alpha_across,
        "index": material.index,
        "base": diffuse_scale(material),
        "transmittance": packed(transmittance_table(material).astype(np.float64)),
        "black": ends[0],
        "white": ends[1],
        "start": {**start, "zoom": 1, "exposure": 0, "shown": "picture", "row": 1, "col": 1},
        "selftest": selftest_cases(stages_deg, elevation),
        "selftest_size": 256,
    }


def selftest_cases(stages_deg: tuple[float, ...], elevation_deg: float) -> list[dict[str, float]]:
    """States of ``#selftest``: the stage angles on the rig, and light from other sides on a tilted part."""
    found: list[dict[str, float]] = [
        {"stage": stage, "tilt": 0.0, "azimuth": 0.0, "elevation": elevation_deg} for stage in stages_deg
    ]
    found.append({"stage": 30.0, "tilt": 25.0, "azimuth": 140.0, "elevation": 50.0})
    found.append({"stage": -75.0, "tilt": -40.0, "azimuth": -100.0, "elevation": 20.0})
    return found


class EtchedDots(Protocol):
    """Layout of dots for the page, as in `anisoscope.sim.design.layout.Layout`."""

    @property
    def tiles(self) -> npt.NDArray[np.uint16]:
        """(T, n, n) number of the level of every grid point of every tile."""

    @property
    def tile_class(self) -> npt.NDArray[np.integer]:
        """(T,) number of the name of every tile."""

    @property
    def index(self) -> npt.NDArray[np.uint16]:
        """(rows, cols) tile of every dot, row 0 at y = 0."""

    @property
    def heights_um(self) -> FloatArray:
        """(levels,) heights."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of reflectances."""

    @property
    def passes_nm(self) -> tuple[float, ...]:
        """Depths of the etch passes."""

    @property
    def grid_um(self) -> float:
        """Distance of the grid points."""

    @property
    def dot_um(self) -> float:
        """Side of a dot."""

    @property
    def size_um(self) -> tuple[float, float]:
        """Size along y, and along x."""

    @property
    def wavelength_nm(self) -> float:
        """Wavelength of the design."""

    @property
    def coherence_um(self) -> float:
        """Coherence length of the design's source."""


def write_layout_page(path: Path, title: str, layout: EtchedDots, light: Illuminant | float) -> None:
    """Write the page of an etched wafer, atomically.

    Every dot is seen by itself, under the square lamp of the design, by an eye without an aperture.

    Args:
        path: file to write.
        title: what the wafer shows.
        layout: its dots.
        light: in colour, or one wavelength in nm.

    Raises:
        UsageError: more dots, tiles or rectangles than a browser takes.
        RecordError: the file cannot be written.
    """
    rows, cols = layout.index.shape
    if max(rows, cols) > MOST_SIDE or len(layout.tiles) > MOST_TILES:
        raise UsageError(
            f"a page shows at most {MOST_SIDE} dots a side of {MOST_TILES} tiles, not {cols} × {rows} of "
            f"{len(layout.tiles)}: cut the layout, or lay out fewer tiles"
        )
    if isinstance(light, Illuminant):
        nm = np.array(LINES_NM)
        colours = xyz_weights(light, nm) @ XYZ_TO_SRGB.T
    else:
        nm, colours = np.array([light]), np.ones((1, 3))
    source = 1e-3 * layout.wavelength_nm / layout.coherence_um
    # points of the lamp along each axis: as many as the fringes across a dot need
    nodes, weights = np.polynomial.legendre.leggauss(
        8 + int(np.ceil(0.5 * np.pi * layout.dot_um * source / (1e-3 * nm.min())))
    )
    tiles = [_rectangles(layout, number) for number in range(len(layout.tiles))]
    terms = nm.size * sum(
        nodes.size * (len(one["x"]) * len(one["y"]) + nodes.size * len(one["x"])) for one in tiles
    )
    if terms > MOST_TERMS:
        raise UsageError(
            f"each picture of this wafer takes {terms:.1g} products, at most {MOST_TERMS:.0e} are taken: lay out fewer "
            "tiles (--tiles), or show it at one wavelength (--page-light 550)"
        )
    start = {"stage": 0, "tilt": 0, "azimuth": 0, "elevation": 83, "zoom": 1, "exposure": 0, "shown": "eye"}
    data = {
        "rows": rows,
        "cols": cols,
        "fields": packed(layout.index[::-1].astype(np.uint16)),
        "tiles": tiles,
        "levels": layout.heights_um.tolist(),
        "lines": [{"um": 1e-3 * one, "rgb": rgb.tolist()} for one, rgb in zip(nm, colours, strict=True)],
        "luminance": SRGB_TO_XYZ[1].tolist(),
        "source": source,
        "nodes": nodes.tolist(),
        "weights": (0.5 * weights).tolist(),
        "area": layout.dot_um**2,
        "black": 0.0,
        "start": {**start, "row": 1, "col": 1},
        "selftest": selftest_cases((0.0, 90.0), 81.0),
        "selftest_size": 256,
    }
    used = "one wavelength" if not isinstance(light, Illuminant) else f"{nm.size} lines of {light.name}"
    high, wide = (1e-3 * side for side in layout.size_um)
    content = {
        "title": f"{title}, etched dots",
        "subtitle": f"{cols} × {rows} dots of {layout.dot_um:g} µm, {wide:.2f} mm × {high:.2f} mm, "
        "under light from any side",
        "rows": rows,
        "cols": cols,
        "stages": ["0", "90"],
        "part": "wafer",
        "still": _grey_uri(layout.tile_class[layout.index[::-1]], 0.0, len(layout.names) - 1.0),
        "still_text": "a grey for each reflectance: " + ", ".join(layout.names),
        "field": "dot",
        "exposures": 12,
        "tones": [("eye", "for the eye (sRGB)"), ("picture", "proportional to light")],
        "facts": (
            ("tiles", f"{len(tiles)} of {', '.join(layout.names)}"),
            ("etch passes", ", ".join(f"{one:.1f}" for one in layout.passes_nm) + " nm"),
            ("light", f"{used}; square lamp of {np.degrees(source):.2f}°"),
            ("model", "scalar waves, perfect mirror, no shadows; every dot by itself"),
        ),
        **scripted(data, "webgl.js", "fields.js", "wafer.js"),
    }  # fmt: skip
    write_page(path, "plate.html", content)


def _rectangles(layout: EtchedDots, number: int) -> dict[str, Any]:
    """Edges of the columns and rows in which a tile changes, µm from its middle, and the level of every rectangle."""
    tile = layout.tiles[number]
    cuts, edges = [], []
    for axis in (1, 0):
        changes = np.flatnonzero((np.diff(tile, axis=axis) != 0).any(axis=1 - axis)) + 1
        cuts.append(np.concatenate([[0], changes]))
        edges.append(np.concatenate([[0], changes, [tile.shape[0]]]) * layout.grid_um - 0.5 * layout.dot_um)
    levels = tile[np.ix_(cuts[1], cuts[0])].astype(np.uint8)
    # the sum over columns is taken for every pair of points of the lamp, that over rows for every point
    turned = edges[0].size > edges[1].size
    if turned:
        edges, levels = edges[::-1], levels.T
    return {
        "name": layout.names[int(layout.tile_class[number])],
        "turned": turned,
        "x": edges[0].tolist(),
        "y": edges[1].tolist(),
        # integrals over the same edges at the same frequencies serve several tiles
        "keys": [f"{int(turned)}{hashlib.sha256(one.tobytes()).hexdigest()[:16]}" for one in edges],
        "of": packed(levels),
    }
