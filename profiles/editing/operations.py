"""Operations on height maps, by name, with their parameters and units.

Each takes a map and gives a new one, with what it found on the way (tilt removed, points filled, ...). Command line,
Python and history use this one table. Measured points stay measured unless an operation is there to take them out;
none but ``fill`` gives a height where nothing was measured.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.base.quantity import read_number
from anisoscope.profiles.editing.gaps import (
    FillMethod,
    fill_gaps,
    outlier_mask,
    picture_mask,
    polygon_mask,
    scar_mask,
)
from anisoscope.profiles.editing.interpolation import Interpolated, averaged, carried
from anisoscope.profiles.editing.registration import Placed, register, registered
from anisoscope.profiles.files.checks import MAX_POINTS, PIXEL_LIMITS_UM, check_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.level import level as level_map
from anisoscope.profiles.level import line_offsets
from anisoscope.profiles.textures import filters
from anisoscope.profiles.textures.forms import fit_form

Value = float | int | str | bool | None | HeightMap
Values = Mapping[str, Any]
Read = Callable[[Path], HeightMap]
Result = tuple[HeightMap, dict[str, Any]]
Kind = Literal["number", "count", "text", "flag", "map"]

ROUNDING = 1e-9
UNITS = {"µm": "um", "°": "deg"}
"""Unit of a parameter -> that of numbers with a unit, as texts may have it."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of an operation.

    Attributes:
        name: how it is called.
        kind: "number", "count" (whole number), "text", "flag" (yes or no), or "map" (a height map or its file).
        unit: of the number.
        meaning: what it does.
        default: taken where it is not given; None where there is no value then.
        required: it must be given.
        choices: texts that it may be.
    """

    name: str
    kind: Kind
    unit: str
    meaning: str
    default: float | str | bool | None = None
    required: bool = False
    choices: tuple[str, ...] = ()

    def checked(self, operation: str, value: object) -> Value:
        """A value, given as text or as what it is, in the type of the parameter.

        Raises:
            UsageError: not of this type, not finite, or none of the choices.
        """
        where = f"{operation}: {self.name}"
        if value is None:
            if self.required:
                raise UsageError(f"{where} is missing; {self.meaning}")
            return self.default
        if self.kind == "map":
            if not isinstance(value, HeightMap | str | Path):
                raise UsageError(f"{where} takes a height map or a file, not {type(value).__name__}")
            return value if isinstance(value, HeightMap) else str(value)
        if self.kind == "flag":
            known = {"yes": True, "true": True, "no": False, "false": False}
            found = value if isinstance(value, bool) else known.get(str(value).lower())
            if found is None:
                raise UsageError(f"{where} is yes or no, not {value!r}")
            return found
        if self.kind == "text":
            if self.choices and value not in self.choices:
                raise UsageError(f"{where} is one of {', '.join(self.choices)}, not {value!r}")
            return str(value)
        return self._number(where, value)

    def _number(self, where: str, value: object) -> float | int:
        try:
            read = read_number(value, where, UNITS.get(self.unit, "")) if isinstance(value, str) else value
            number = float(cast("float", read))
        except (TypeError, ValueError, OverflowError):
            number = float("nan")
        whole = "whole " if self.kind == "count" else ""
        if not isfinite(number) or isinstance(value, bool) or (whole and number != round(number)):
            unit = f" of {self.unit}" if self.unit else ""
            raise UsageError(f"{where} takes a {whole}number{unit}, not {value!r}")
        return round(number) if whole else number


@dataclass(frozen=True)
class Operation:
    """An operation on a height map.

    Attributes:
        name: how it is called.
        meaning: what it does, in one sentence.
        parameters: in the order in which they are given.
        run: turns a map, checked values and a reader of further maps into a new map and what was found.
        former: names of parameters in the version before, which histories of maps hold, and today's.
    """

    name: str
    meaning: str
    parameters: tuple[Parameter, ...]
    run: Callable[[HeightMap, Values, Read], Result]
    former: Mapping[str, str] = field(default_factory=dict)

    def checked(self, given: Values) -> dict[str, Value]:
        """All values by name, defaults where they are not given.

        Raises:
            UsageError: an unknown name, a missing value, or one of the wrong type.
        """
        given = {self.former.get(name, name): value for name, value in given.items()}
        known = {one.name for one in self.parameters}
        if unknown := sorted(set(given) - known):
            names = ", ".join(one.name for one in self.parameters)
            raise UsageError(f"{self.name} has no parameter {unknown[0]!r}; it has {names}")
        return {one.name: one.checked(self.name, given.get(one.name)) for one in self.parameters}


def _level(surface: HeightMap, values: Values, _read: Read) -> Result:
    if values["method"] == "plane":
        fitted = fit_form(surface, "plane")
        height = surface.height_um - fitted.height_um
        return surface.with_height(height - np.nanmean(height)), {
            "method": "least-squares plane",
            **fitted.values,
        }
    found = level_map(surface)
    return surface.with_height(found.map.height_um), {
        "method": found.map.origin["levelling"]["method"],
        "tilt_x_deg": found.tilt_x_deg,
        "tilt_y_deg": found.tilt_y_deg,
    }


def _form(surface: HeightMap, values: Values, _read: Read) -> Result:
    fitted = fit_form(surface, values["form"])
    height = surface.height_um - fitted.height_um
    lost = int(np.count_nonzero(np.isnan(height) & np.isfinite(surface.height_um)))
    if lost:
        raise HeightMapError(
            f"{lost} measured points lie beyond the {values['form']} fitted to the others; crop the map, or take poly2"
        )
    return surface.with_height(height), dict(fitted.values)


def _filter(surface: HeightMap, values: Values, _read: Read) -> Result:
    kind, cutoff, direction = values["filter"], values["cutoff"], values["direction"]
    order = values["order"]
    if kind in ("gaussian", "robust", "spline"):
        mean = filters.mean_surface(surface, cutoff, kind, direction=direction, order=order)
        standard = filters.standard_of(kind, direction)
    elif order is not None or direction != "xy":
        raise UsageError(f"filter: a {kind} filter has no order and no direction")
    else:
        element: filters.Element = "disk" if values["flat"] else "ball"
        mean = filters.morphological(surface, cutoff, closing=kind == "closing", element=element)
        standard = "ISO 16610-85"
    height = mean if values["keep"] == "long" else surface.height_um - mean
    return surface.with_height(height), {"standard": standard}


def _crop(surface: HeightMap, values: Values, _read: Read) -> Result:
    spans = []
    for axis, count, pixel in zip("yx", surface.shape, (surface.pixel_y_um, surface.pixel_x_um), strict=True):
        low, high = values[f"{axis}0"], values[f"{axis}1"]
        first = 0 if low is None else max(0, int(np.ceil(low / pixel - ROUNDING)))
        last = count - 1 if high is None else min(count - 1, int(np.floor(high / pixel + ROUNDING)))
        if last - first < 1:
            raise HeightMapError(
                f"crop: less than two points along {axis} are left; the map reaches from 0 to "
                f"{(count - 1) * pixel:g} µm"
            )
        spans.append((first, last))
    (top, bottom), (left, right) = spans
    part = np.s_[top : bottom + 1, left : right + 1]
    layers = {name: layer[part] for name, layer in surface.layers.items()}
    cut = replace(surface, height_um=surface.height_um[part], layers=layers)
    return check_map(cut, "crop"), {
        "first_row": top,
        "last_row": bottom,
        "first_col": left,
        "last_col": right,
    }


def _rotate(surface: HeightMap, values: Values, _read: Read) -> Result:
    quarter = values["angle"] / 90.0
    if abs(quarter - round(quarter)) < ROUNDING:
        # rows rise with y: np.rot90 turns clockwise as seen with y up
        turned = np.rot90(surface.height_um, -round(quarter))
        pixels = (surface.pixel_x_um, surface.pixel_y_um)
        x, y = pixels if round(quarter) % 2 == 0 else pixels[::-1]
        layers = {name: np.rot90(layer, -round(quarter)) for name, layer in surface.layers.items()}
        return HeightMap(turned, x, y, surface.origin, layers), {"interpolation": "none"}
    angle = np.radians(values["angle"])
    rows, cols = surface.shape
    py, px = surface.pixel_y_um, surface.pixel_x_um
    width, height = (cols - 1) * px, (rows - 1) * py
    cos, sin = abs(np.cos(angle)), abs(np.sin(angle))
    if values["extent"] == "full":
        size = width * cos + height * sin, width * sin + height * cos
    else:
        size = _inner_rectangle(width, height, cos, sin)
    n, m = (
        int(np.floor(length / pixel + ROUNDING)) + 1 for length, pixel in zip(size, (px, py), strict=True)
    )
    if min(n, m) < 2 or n * m > MAX_POINTS:
        raise HeightMapError(f"rotate: {m} × {n} points would be left; take extent full, or a larger map")
    at_x = (np.arange(n) - 0.5 * (n - 1)) * px
    at_y = ((np.arange(m) - 0.5 * (m - 1)) * py)[:, None]
    source_x = at_x * np.cos(angle) + at_y * np.sin(angle) + 0.5 * width
    source_y = at_y * np.cos(angle) - at_x * np.sin(angle) + 0.5 * height
    order: Literal[1, 3] = 3 if values["interpolation"] == "cubic" else 1
    turned = Interpolated(surface, order).at(source_y, source_x)
    layers = carried(surface, lambda one: Interpolated(one, 1).at(source_y, source_x))
    return _checked(replace(surface, height_um=turned, layers=layers), "rotate"), {}


def _inner_rectangle(width: float, height: float, cos: float, sin: float) -> tuple[float, float]:
    """Sides of the largest upright rectangle within a turned one."""
    long, short = max(width, height), min(width, height)
    if short <= 2.0 * sin * cos * long or abs(sin - cos) < 1e-10:
        half = 0.5 * short
        return (half / sin, half / cos) if width >= height else (half / cos, half / sin)
    both = cos * cos - sin * sin
    return (width * cos - height * sin) / both, (height * cos - width * sin) / both


def _checked(surface: HeightMap, name: str) -> HeightMap:
    return check_map(surface, name)


def _mask(surface: HeightMap, values: Values, _read: Read) -> Result:
    if (values["picture"] is None) == (values["polygon"] is None):
        raise UsageError(
            "mask takes either a picture (PNG of the size of the map) or a polygon (x y; x y; x y in µm)"
        )
    if values["picture"] is not None:
        inside = picture_mask(surface, Path(values["picture"]))
    else:
        inside = polygon_mask(surface, _corners(values["polygon"]))
    kept = inside if values["keep"] == "inside" else ~inside
    height = np.where(kept, surface.height_um, np.nan)
    taken = int(np.count_nonzero(np.isfinite(surface.height_um) & ~kept))
    if not np.isfinite(height).any():
        raise HeightMapError(
            f"mask: no measured point is left {values['keep']}; swap keep, or check the mask"
        )
    return surface.with_height(height), {"points_taken_out": taken}


def _corners(text: str) -> list[tuple[float, float]]:
    """Corners of a text such as ``0 0; 100 0; 100 50``."""
    try:
        pairs = [tuple(float(number) for number in part.split()) for part in text.split(";") if part.strip()]
    except ValueError:
        pairs = [()]
    if not all(len(pair) == 2 and all(isfinite(number) for number in pair) for pair in pairs):
        raise UsageError(f"mask: a polygon is x y; x y; x y in µm, such as 0 0; 100 0; 100 50, not {text!r}")
    return [(pair[0], pair[1]) for pair in pairs]


def _fill(surface: HeightMap, values: Values, _read: Read) -> Result:
    area = np.inf if values["max_area"] is None else values["max_area"]
    height = fill_gaps(
        surface, cast("FillMethod", values["method"]), max_area_um2=area, border=values["border"]
    )
    filled = np.count_nonzero(np.isnan(surface.height_um)) - np.count_nonzero(np.isnan(height))
    return surface.with_height(height), {"points_filled": int(filled)}


def _outliers(surface: HeightMap, values: Values, _read: Read) -> Result:
    out = outlier_mask(surface, values["limit"], values["window"])
    height = np.where(out, np.nan, surface.height_um)
    return surface.with_height(height), {"points_taken_out": int(np.count_nonzero(out))}


def _align_lines(surface: HeightMap, values: Values, _read: Read) -> Result:
    offsets = line_offsets(surface, values["scan"])
    across = offsets[:, None] if values["scan"] == "x" else offsets[None, :]
    height = surface.height_um - across
    return surface.with_height(height), {"rms_of_lines_um": float(np.sqrt(np.mean(offsets**2)))}


def _scars(surface: HeightMap, values: Values, _read: Read) -> Result:
    out = scar_mask(surface.height_um, values["scan"], values["limit"], values["length"])
    height = np.where(out, np.nan, surface.height_um)
    return surface.with_height(height), {"points_taken_out": int(np.count_nonzero(out))}


def _resample(surface: HeightMap, values: Values, _read: Read) -> Result:
    new = values["pixel"] if values["pixel_y"] is None else values["pixel_y"], values["pixel"]
    low, high = PIXEL_LIMITS_UM
    if not all(low <= pixel <= high for pixel in new):
        raise HeightMapError(f"resample: a pixel is {low:g} to {high:g} µm, not {new[0]:g} × {new[1]:g} µm")
    old = surface.pixel_y_um, surface.pixel_x_um
    coarser = [wanted > given * (1.0 + ROUNDING) for wanted, given in zip(new, old, strict=True)]
    steps = [wanted if coarse else given for wanted, given, coarse in zip(new, old, coarser, strict=True)]
    cells = averaged(surface, (steps[0], steps[1])) if any(coarser) else surface
    shift = [0.5 * (step - given) for step, given in zip(steps, old, strict=True)]
    found = cells
    if any(wanted < given * (1.0 - ROUNDING) for wanted, given in zip(new, old, strict=True)):
        places = []
        for count, step, wanted in zip(cells.shape, steps, new, strict=True):
            size = int(np.floor((count - 1) * step / wanted + ROUNDING)) + 1
            places.append(np.arange(size) * wanted)
        if places[0].size * places[1].size > MAX_POINTS:
            raise HeightMapError(
                f"resample: {places[0].size} × {places[1].size} points are too many; take a larger pixel"
            )
        order: Literal[1, 3] = 3 if values["interpolation"] == "cubic" else 1
        y, x = np.meshgrid(places[0], places[1], indexing="ij")
        layers = carried(cells, lambda one: Interpolated(one, 1).at(y, x))
        found = HeightMap(Interpolated(cells, order).at(y, x), new[1], new[0], surface.origin, layers)
    return _checked(found, "resample"), {"first_point_um": shift}


def _other(values: Values, read: Read) -> HeightMap:
    given = values["map"]
    return given if isinstance(given, HeightMap) else read(Path(given))


def _subtract(surface: HeightMap, values: Values, read: Read) -> Result:
    other = _other(values, read)
    if values["align"]:
        placed = register(surface, other)
        height = surface.height_um - registered(surface, other, placed).height_um
        return _checked(surface.with_height(height), "subtract"), _named(other) | _facts(placed)
    same = np.allclose(
        (surface.pixel_y_um, surface.pixel_x_um), (other.pixel_y_um, other.pixel_x_um), rtol=1e-6, atol=0.0
    )
    if other.shape != surface.shape or not same:
        raise HeightMapError(
            f"subtract: maps of {_size(surface)} and {_size(other)} have no common points; resample one to the "
            "pixel of the other and crop both, or take align yes"
        )
    height = surface.height_um - other.height_um
    return _checked(surface.with_height(height), "subtract"), _named(other)


def _facts(placed: Placed) -> dict[str, Any]:
    names = (
        "x_um",
        "y_um",
        "angle_deg",
        "u_x_um",
        "u_y_um",
        "offset_um",
        "residual_um",
        "overlap",
        "ambiguity",
    )
    return {name: getattr(placed, name) for name in names if getattr(placed, name) is not None}


def _stitch(surface: HeightMap, values: Values, read: Read) -> Result:
    surface, other = surface.measured(), _other(values, read).measured()
    (m1, n1), (m2, n2) = (
        (0.5 * (one.shape[0] - 1) * one.pixel_y_um, 0.5 * (one.shape[1] - 1) * one.pixel_x_um)
        for one in (surface, other)
    )
    nominal = n1 - n2 - values["x"], m1 - m2 - values["y"]
    if values["align"]:
        placed = register(surface, other, near_um=nominal)
    else:
        placed = Placed(*nominal, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    canvas, y, x = _canvas(surface, other, placed)
    added = Interpolated(other, 3).at(*placed.positions(y, x, other)) - placed.plane_um(y, x)
    stitched = replace(surface, height_um=_blended(canvas, added), layers={})
    dropped = {"layers_left_out": list(surface.layers)} if surface.layers else {}
    return _checked(stitched, "stitch"), _named(other) | (_facts(placed) if values["align"] else {}) | dropped


def _canvas(
    surface: HeightMap, other: HeightMap, placed: Placed
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The first map within the field of both, NaN around, and the positions y and x of its points from its middle."""
    (rows, cols), (py, px) = surface.shape, (surface.pixel_y_um, surface.pixel_x_um)
    far_y, far_x = (other.shape[0] - 1) * other.pixel_y_um, (other.shape[1] - 1) * other.pixel_x_um
    corners = placed.found_at(np.array([0.0, 0.0, far_y, far_y]), np.array([0.0, far_x, 0.0, far_x]), other)
    pads = []
    for count, pixel, places in zip((rows, cols), (py, px), corners, strict=True):
        at = places / pixel + 0.5 * (count - 1)
        low, high = float(at.min()), float(at.max())
        pads.append(
            (max(0, int(np.ceil(-low - ROUNDING))), max(0, int(np.floor(high - count + 1 + ROUNDING))))
        )
    points = (rows + sum(pads[0])) * (cols + sum(pads[1]))
    if points > MAX_POINTS or points > 20 * (surface.height_um.size + other.height_um.size):
        raise HeightMapError("stitch: the maps lie too far apart; check x and y")
    y = (np.arange(-pads[0][0], rows + pads[0][1]) - 0.5 * (rows - 1)) * py
    x = (np.arange(-pads[1][0], cols + pads[1][1]) - 0.5 * (cols - 1)) * px
    at_y, at_x = np.meshgrid(y, x, indexing="ij")
    return np.pad(surface.height_um, pads, constant_values=np.nan), at_y, at_x


def _blended(one: FloatArray, two: FloatArray) -> FloatArray:
    """Both maps on one grid; where both are measured, weighted with the distance from what each has not measured."""
    from scipy import ndimage  # noqa: PLC0415 - slow to import

    known = np.isfinite(one), np.isfinite(two)
    weights = [ndimage.distance_transform_edt(np.pad(one, 1))[1:-1, 1:-1] for one in known]
    total = np.where(known[0], weights[0] * np.nan_to_num(one), 0.0) + np.where(
        known[1], weights[1] * np.nan_to_num(two), 0.0
    )
    return np.asarray(np.where(known[0] | known[1], total / np.maximum(weights[0] + weights[1], 1.0), np.nan))


def _size(surface: HeightMap) -> str:
    rows, cols = surface.shape
    return f"{rows} × {cols} points of {surface.pixel_y_um:.6g} × {surface.pixel_x_um:.6g} µm"


def _named(other: HeightMap) -> dict[str, Any]:
    return {key: other.origin[key] for key in ("file", "sha256") if key in other.origin}


_INTERPOLATION = Parameter(
    "interpolation",
    "text",
    "",
    "between points: linear, or cubic splines",
    "linear",
    choices=("linear", "cubic"),
)

_SCANNED = Parameter("scan", "text", "", "axis along which the instrument scanned", "x", choices=("x", "y"))
OPERATIONS: dict[str, Operation] = {
    one.name: one
    for one in (
        Operation(
            "level",
            "Remove tilt and mean height.",
            (
                Parameter("method", "text", "", "auto: points whole pitches apart where there are ridges, else a "
                          "least-squares plane; plane: always that plane", "auto", choices=("auto", "plane")),
            ),
            _level,
        ),
        Operation(
            "form",
            "Remove a fitted form.",
            (Parameter("form", "text", "", "none, plane, poly1 … poly10, sphere or cylinder", required=True),),
            _form,
        ),
        Operation(
            "filter",
            "Filter after ISO 16610.",
            (
                Parameter("filter", "text", "", "gaussian (-21, -61), robust Gaussian (-31, -71), spline (-22; "
                          "xy: separable, along x and y), "
                          "morphological closing or opening (-85)", required=True,
                          choices=("gaussian", "robust", "spline", "closing", "opening")),
                Parameter("cutoff", "number", "µm", "nesting index; radius of the ball or disk of closing and opening",
                          required=True),
                Parameter("keep", "text", "", "waves to keep: longer or shorter than the cutoff", "long",
                          choices=("long", "short")),
                Parameter("direction", "text", "", "direction of the profiles, x or y; xy: areal", "xy",
                          choices=("xy", "x", "y")),
                Parameter("order", "count", "", "of the regression of Gaussian filters, 0 to 2; 0 for gaussian and 2 "
                          "for robust where it is not given"),
                Parameter("flat", "flag", "", "closing and opening with a flat disk instead of a ball", default=False),
            ),
            _filter,
        ),
        Operation(
            "crop",
            "Cut out a rectangle.",
            tuple(
                Parameter(f"{axis}{end}", "number", "µm", f"{word} point along {axis}, counted from the first one")
                for end, word in enumerate(("first", "last"))
                for axis in "xy"
            ),
            _crop,
        ),
        Operation(
            "rotate",
            "Turn counter-clockwise about the middle of the field, as seen from +z.",
            (
                Parameter("angle", "number", "°", "by how much; multiples of 90° move points without interpolation",
                          required=True),
                Parameter("extent", "text", "", "inside: the largest rectangle within the turned field; full: all of "
                          "it, missing points around", "inside", choices=("inside", "full")),
                _INTERPOLATION,
            ),
            _rotate,
            {"field": "extent"},
        ),
        Operation(
            "mask",
            "Make the points outside a mask missing.",
            (
                Parameter("picture", "text", "", "PNG of the size of the map, bright inside, first row at the top"),
                Parameter("polygon", "text", "µm", "corners x y; x y; x y, counted from the first point"),
                Parameter("keep", "text", "", "points to keep", "inside", choices=("inside", "outside")),
            ),
            _mask,
        ),
        Operation(
            "fill",
            "Fill gaps.",
            (
                Parameter("method", "text", "", "harmonic: smooth from the points around a gap; nearest: nearest point",
                          "harmonic", choices=("harmonic", "nearest")),
                Parameter("max_area", "number", "µm²", "largest gap that is filled; all where it is not given"),
                Parameter("border", "flag", "", "fill gaps at the border of the field too", default=False),
            ),
            _fill,
        ),
        Operation(
            "outliers",
            "Remove single outliers: they become missing points.",
            (
                Parameter("limit", "number", "σ", "deviation from the local median in robust standard deviations", 5.0),
                Parameter("window", "count", "points", "side of the surroundings, odd, 3 to 31", 5),
            ),
            _outliers,
        ),
        Operation(
            "align-lines",
            "Bring the lines of a scan to one height, by the median of their differences from the median line.",
            (_SCANNED,),
            _align_lines,
        ),
        Operation(
            "scars",
            "Remove scars, stretches of a line above or below both neighbours: they become missing points.",
            (
                Parameter("limit", "number", "σ", "least difference from both lines in robust standard deviations of "
                          "the differences between lines", 4.0),
                Parameter("length", "count", "points", "least length of a scar", 16),
                _SCANNED,
            ),
            _scars,
        ),
        Operation(
            "resample",
            "Change the pixel: means over larger cells, interpolation between points for smaller ones.",
            (
                Parameter("pixel", "number", "µm", "new pixel, along x and y", required=True),
                Parameter("pixel_y", "number", "µm", "new pixel along y, where it differs"),
                _INTERPOLATION,
            ),
            _resample,
        ),
        Operation(
            "subtract",
            "Subtract another map.",
            (
                Parameter("map", "map", "", "the other map", required=True),
                Parameter("align", "flag", "", "register it first; else both must have the same grid", default=False),
            ),
            _subtract,
        ),
        Operation(
            "stitch",
            "Join an overlapping map, levelled to the first.",
            (
                Parameter("map", "map", "", "the other map", required=True),
                Parameter("x", "number", "µm", "where its first point lies along x in the first map, about", 0.0),
                Parameter("y", "number", "µm", "the same along y", 0.0),
                Parameter("align", "flag", "", "register it within a quarter of the field; else x and y are "
                          "exact", default=True),
            ),
            _stitch,
        ),
    )
}  # fmt: skip
"""All operations by name."""
