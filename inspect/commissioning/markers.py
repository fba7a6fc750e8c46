"""Markers of the fixture: the pose and focus of a picture that shows them, and the page from which they are printed.

The markers of a picture fix an affine map from sample millimetres (x right, y up) to pixels. It is taken apart into
A = scale · S · F · R(ψ): R the turn of the fixture, F the mirror that makes rows run down, and S the squeeze by
cos(tilt) across the tilt axis. A parallel view under +tilt and
under −tilt is the same picture of a plane, so the markers give the size of a tilt and never its sign.
"""

import io
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import cycle

import cv2
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Rectangle
from matplotlib.path import Path as Outline

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.imaging.registration.placement import (
    MIN_MARKERS,
    Image,
    check_fixture,
    dictionary_of,
    find_markers,
    marker_corners_mm,
)
from anisoscope.rig.fixture import Fixture, Grey, Marker

FLIP = np.diag([1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Fix:
    """Pose of the fixture in one picture.

    Attributes:
        matrix: (2, 2) from sample mm to pixels (column, row), without the shift.
        origin_px: (2,) column and row of the fixture's origin.
        angle_deg: its angle ψ, counter-clockwise as seen, 0 to 360.
        pixel_um: size of a pixel on the sample, along the tilt axis.
        squeeze: ratio of the scales across and along the tilt axis, cos(tilt).
        squeeze_deg: direction of the squeeze in the picture, from its horizontal, −90 to 90.
        residual_px: rms distance of the corners from the fit.
        markers: how many markers were found.
        corners_px: (N, 2) the corners found.
    """

    matrix: FloatArray
    origin_px: FloatArray
    angle_deg: float
    pixel_um: float
    squeeze: float
    squeeze_deg: float
    residual_px: float
    markers: int
    corners_px: FloatArray


def find_fixture(image: Image, fixture: Fixture) -> Fix | None:
    """The fixture in a picture, or None where fewer than three of its markers are detected.

    Args:
        image: (rows, cols) linear picture.
        fixture: the markers.
    """
    known = marker_corners_mm(fixture)
    found = [(marker.id, marker.corners) for marker in find_markers(image, fixture) if marker.id in known]
    if len({number for number, _ in found}) < MIN_MARKERS:
        return None
    points = np.concatenate([known[number] for number, _ in found])
    pixels = np.concatenate([corners for _, corners in found])
    design = np.column_stack([points, np.ones(len(points))])
    solution = np.linalg.lstsq(design, pixels, rcond=None)[0]
    residual = float(np.sqrt(np.mean(np.sum((design @ solution - pixels) ** 2, axis=1))))
    return _fix_from(solution[:2].T, solution[2], residual, len(found), pixels)


def _fix_from(
    matrix: FloatArray, origin: FloatArray, residual: float, markers: int, corners: FloatArray
) -> Fix:
    sizes, axes = np.linalg.eigh(matrix @ matrix.T)  # ascending: the squeezed direction first
    small, large = np.sqrt(np.maximum(sizes, 1e-12))
    root = axes @ np.diag([1.0 / small, 1.0 / large]) @ axes.T
    turn = FLIP @ root @ matrix
    angle = np.degrees(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
    direction = np.degrees(np.arctan2(-axes[1, 0], axes[0, 0]))
    return Fix(
        matrix,
        origin,
        float(angle % 360.0),
        float(1000.0 / large),
        float(small / large),
        float((direction + 90.0) % 180.0 - 90.0),
        residual,
        markers,
        corners,
    )


def modules_of(dictionary: str) -> int:
    """Modules along the side of a marker of a dictionary, its black border included."""
    return int(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)).markerSize) + 2


def edge_blur_px(image: Image, fix: Fix, modules: int) -> float:
    """Blur of the marker edges: rms width of their brightness step, in pixels.

    Args:
        image: (rows, cols) linear picture.
        fix: the markers in it.
        modules: modules along the side of a marker, its black border included.
    """
    widths = []
    for corners in fix.corners_px.reshape(-1, 4, 2):
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            widths.append(_side_blur(image, start, end, modules))
    return float(np.median(widths))


def _side_blur(image: Image, start: FloatArray, end: FloatArray, modules: int) -> float:
    length = float(np.linalg.norm(end - start))
    along = (end - start) / max(length, 1e-9)
    reach = max(0.48 * length / modules, 2.0)  # up to the next edge and no further
    across = np.linspace(-reach, reach, int(8 * reach) + 1)
    base = start + np.linspace(0.2, 0.8, max(12, int(length)))[:, None] * (end - start)
    points = (base[:, None, :] + across[None, :, None] * np.array([-along[1], along[0]])).astype(np.float32)
    strip = cv2.remap(
        np.nan_to_num(image),
        points[..., 0],
        points[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    steps = np.diff(strip.astype(np.float64).mean(axis=0))
    steps = np.maximum(steps * np.sign(steps.sum()), 0.0)
    at = 0.5 * (across[1:] + across[:-1])
    total = max(float(steps.sum()), 1e-12)
    middle = float(steps @ at) / total
    return float(np.sqrt(steps @ (at - middle) ** 2 / total))


MM_PER_INCH = 25.4
A4_MM = (210.0, 297.0)
RULER_MM = 100.0
SIDE_SHARE, RING_SHARE = 0.127, 0.38
"""Side of a marker and distance of its centre from the axis, shares of the field; turned, all stay in the picture."""
GREY_SHARE, GREY_SIDE = 0.48, 0.5
"""Distance of a grey patch from its marker, as a share of the ring's radius; its side, as a share of a marker's."""
TONES = ("0.62", "0.4")
"""Greys of the patches, which need not be exact: their reference is measured."""
FEWEST_DOTS = 3
"""Dots of the printer along a module, below which its edges are too rough to place pictures by."""
_AXIS_MM = (105.0, 180.0)


def fixture_for_field(field_mm: float, dpi: float) -> Fixture:
    """Four markers and four grey patches about the rotation axis for a camera that sees a square of this side.

    Their modules are whole dots of the printer, so that all edges are printed alike.

    Args:
        field_mm: the shorter side of what the camera sees, in mm.
        dpi: dots of the printer per inch.

    Raises:
        UsageError: a field or a resolution that is not positive; markers smaller than the printer's dots.
    """
    if not (field_mm > 0.0 and dpi > 0.0):
        raise UsageError(
            f"the field ({field_mm:g} mm) and the printer's dots per inch ({dpi:g}) must be positive"
        )
    modules = 6
    dot_mm = MM_PER_INCH / dpi
    dots = round(SIDE_SHARE * field_mm / modules / dot_mm)
    if dots < 1:
        raise UsageError(
            f"a field of {field_mm:g} mm needs modules of {1000.0 * SIDE_SHARE * field_mm / modules:.0f} µm, and a dot "
            f"of {dpi:g} dpi is {1000.0 * dot_mm:.0f} µm: have the sheet plotted on film at 10000 dpi or more"
        )
    ring = round(RING_SHARE * field_mm, 3)
    places = ((ring, 0.0), (0.0, ring), (-ring, 0.0), (0.0, -ring))
    markers = tuple(Marker(id=number, x_mm=x, y_mm=y) for number, (x, y) in enumerate(places))
    beside, size = round(GREY_SHARE * ring, 3), round(GREY_SIDE * modules * dots * dot_mm, 4)
    greys = ((ring, beside), (-beside, ring), (-ring, -beside), (beside, -ring))
    return Fixture(
        marker_mm=round(modules * dots * dot_mm, 4),
        markers=markers,
        greys=tuple(Grey(x_mm=x, y_mm=y, size_mm=size) for x, y in greys),
    )


def dots_per_module(fixture: Fixture, dpi: float) -> float:
    """Dots of a printer along the side of one module of the markers."""
    return fixture.marker_mm / (dictionary_of(fixture).markerSize + 2) / (MM_PER_INCH / dpi)


def fixture_table(fixture: Fixture) -> str:
    """The table ``[fixture]`` of a rig file."""
    rows = [f"{{ id = {one.id}, x_mm = {one.x_mm:g}, y_mm = {one.y_mm:g} }}" for one in fixture.markers]
    joined = ",\n           ".join(rows)
    head = f'[fixture]\ndictionary = "{fixture.dictionary}"\nmarker_mm = {fixture.marker_mm:g}\n'
    greys = ",\n         ".join(
        f"{{ x_mm = {one.x_mm:g}, y_mm = {one.y_mm:g}, size_mm = {one.size_mm:g} }}" for one in fixture.greys
    )
    return f"{head}markers = [{joined}]\n" + (f"greys = [{greys}]\n" if greys else "")


def marker_sheet(fixture: Fixture, *, title: str = "") -> Figure:
    """An A4 page: the markers about the rotation axis as the camera sees them at 0°, and rulers of 100 mm.

    Args:
        fixture: the markers, in mm from the rotation axis.
        title: a line at the top of the page.

    Raises:
        RigFileError: an unknown dictionary, a marker that it does not hold, or too few markers.
        UsageError: markers that do not fit on the page.
    """
    check_fixture(fixture)
    reach = max(max(abs(one.x_mm), abs(one.y_mm)) for one in fixture.markers) + fixture.marker_mm
    if reach > _AXIS_MM[0] - 15.0:
        raise UsageError(
            f"the markers reach {reach:g} mm from the axis; an A4 page holds {_AXIS_MM[0] - 15.0:g} mm"
        )
    figure = Figure(figsize=(A4_MM[0] / MM_PER_INCH, A4_MM[1] / MM_PER_INCH))
    FigureCanvasAgg(figure)
    page = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    page.set_axis_off()
    page.set_xlim(0.0, A4_MM[0])
    page.set_ylim(0.0, A4_MM[1])
    for marker in fixture.markers:
        middle = np.array([_AXIS_MM[0] + marker.x_mm, _AXIS_MM[1] + marker.y_mm])
        outline = _outline(fixture, marker.id, middle)
        page.add_patch(PathPatch(outline, facecolor="black", edgecolor="none", snap=False))
    for patch, tone in zip(fixture.greys, cycle(TONES), strict=False):
        corner = (
            _AXIS_MM[0] + patch.x_mm - 0.5 * patch.size_mm,
            _AXIS_MM[1] + patch.y_mm - 0.5 * patch.size_mm,
        )
        page.add_patch(Rectangle(corner, patch.size_mm, patch.size_mm, facecolor=tone, edgecolor="none"))
    for way in ((1.0, 0.0), (0.0, 1.0)):
        _draw_ruler(page, way)
    x, y = _AXIS_MM
    cross = reach + 2.0
    for side in (-1.0, 1.0):
        page.plot([x + side * cross, x + side * (cross + 5.0)], [y, y], color="0.6", linewidth=0.3)
        page.plot([x, x], [y + side * cross, y + side * (cross + 5.0)], color="0.6", linewidth=0.3)
    ids = ", ".join(str(one.id) for one in fixture.markers)
    lines = [
        title,
        f"Markers: {fixture.dictionary}, side {fixture.marker_mm:g} mm, ids {ids}.",
        "Print at 100 % (actual size, not fitted to the page). Both rulers must measure 100.0 mm. If they do not,",
        "multiply marker_mm, x_mm and y_mm of the rig file by (measured / 100).",
        "Put the crossing of the grey lines on the rotation axis, x to the right at 0°. Use matt paper or film.",
        "Around every marker a quarter of its side stays white.",
    ]
    page.text(20.0, 285.0, "\n".join(lines), fontsize=8, va="top", linespacing=1.5)
    return figure


def pdf_of(figure: Figure) -> bytes:
    """The page as a PDF file, the same bytes every time."""
    file = io.BytesIO()
    figure.savefig(
        file, format="pdf", metadata={"CreationDate": None, "Creator": "anisoscope", "Producer": None}
    )
    return file.getvalue()


def _draw_ruler(page: Axes, way: tuple[float, float]) -> None:
    x, y = 20.0, 20.0
    right, up = way
    page.plot([x, x + RULER_MM * right], [y, y + RULER_MM * up], color="black", linewidth=0.4)
    for k in range(11):
        foot_x, foot_y = x + 10.0 * k * right, y + 10.0 * k * up
        length = 3.0 if k % 5 == 0 else 2.0
        page.plot(
            [foot_x, foot_x + length * up], [foot_y, foot_y + length * right], color="black", linewidth=0.4
        )
    end_x, end_y = x + RULER_MM * right + 4.0 * up, y + RULER_MM * up + 4.0 * right
    page.text(end_x, end_y, "100 mm", fontsize=7, ha="center", va="center")


def _outline(fixture: Fixture, number: int, middle: FloatArray) -> Outline:
    """Outline of the black modules of a marker, in mm on the page; one path, so that no seam shows between modules."""
    dictionary = dictionary_of(fixture)
    modules = dictionary.markerSize + 2
    black = np.asarray(cv2.aruco.generateImageMarker(dictionary, number, modules, borderBits=1)) == 0
    vertices: list[FloatArray] = []
    codes: list[int] = []
    for loop in _loops(black):
        points = np.array([*loop, loop[0]], dtype=np.float64)
        x = points[:, 1] / modules - 0.5
        y = 0.5 - points[:, 0] / modules
        vertices.append(middle + fixture.marker_mm * np.column_stack([x, y]))
        codes += [int(Outline.MOVETO), *[int(Outline.LINETO)] * (len(points) - 2), int(Outline.CLOSEPOLY)]
    return Outline(np.concatenate(vertices), codes)


def _loops(black: npt.NDArray[np.bool_]) -> Iterator[list[tuple[int, int]]]:
    """Closed borders of the black cells, as corners (row, column), cells on the right of the way."""
    edges: dict[tuple[int, int], list[tuple[int, int]]] = {}
    padded = np.pad(black, 1)
    for row, col in np.argwhere(black).tolist():
        sides = (
            ((0, 1), (row, col), (row, col + 1)),
            ((1, 2), (row, col + 1), (row + 1, col + 1)),
            ((2, 1), (row + 1, col + 1), (row + 1, col)),
            ((1, 0), (row + 1, col), (row, col)),
        )
        for (down, right), start, end in sides:
            if not padded[row + down, col + right]:
                edges.setdefault(start, []).append(end)
    while edges:
        start = next(iter(edges))
        loop = [start]
        place = start
        while True:
            following = edges[place].pop()
            if not edges[place]:
                del edges[place]
            place = following
            if place == start:
                break
            loop.append(place)
        yield loop
