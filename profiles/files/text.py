"""Height maps as text: matrices of heights, and lists of points x y z.

A text file says neither its pixel size nor its unit, and three columns may be a narrow matrix or a list of
points. What the file leaves open raises an error that names the option to give; nothing is guessed.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.height_map_file import FileScales, Layout
from anisoscope.profiles.files.cells import number_of, text_of
from anisoscope.profiles.files.checks import AXIS_TOLERANCE, check_claim, checked_map, passes, refuse
from anisoscope.profiles.files.content import scaled
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.gridding import gridded
from anisoscope.profiles.files.units import (
    STATED_MICROMETRES_PER,
    micrometres_per,
    require_pixel,
    stated_micrometres_per,
)
from anisoscope.profiles.heightmap import HeightMap

MIN_FILLED = 0.05


def _grid_axis(name: str, axis: str, values_um: FloatArray) -> tuple[float, float, int]:
    """(first position, step, count) of the regular grid on which the values lie.

    Lines of the grid without any point are allowed: the step is the smallest gap between positions.
    """
    ordered = np.unique(values_um)
    gaps = np.diff(ordered)
    extent = float(ordered[-1] - ordered[0])
    if extent <= 0:
        refuse(name, f"{axis} axis", "a single position", "a height map needs at least two along each axis")
    resolution = max(1e-6 * extent, 1e-3 * float(np.median(gaps)))
    real = gaps[gaps > resolution]
    smallest = float(np.median(real[real <= 1.5 * real.min()]))
    count = round(extent / smallest) + 1
    check_claim(name, 2, count, 0, 0)
    return float(ordered[0]), extent / (count - 1), count


def points_to_map(name: str, points_um: FloatArray, origin: dict[str, Any]) -> HeightMap:
    """Sort points into a grid; grid points without a point are missing.

    Args:
        name: name of the file, for messages.
        points_um: (n, 3) x, y, z in µm; a NaN height is a missing point.
        origin: provenance of the map.

    Raises:
        HeightMapError: positions are missing, irregular, or doubled; the grid is nearly empty.
    """
    x, y, z = points_um.T
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        refuse(name, "points", "x or y of a point is missing", "every point needs x and y")
    if len(points_um) < 4:
        refuse(name, "points", f"only {len(points_um)}", "a height map needs at least 2 × 2 points")
    x0, step_x, cols = _grid_axis(name, "x", x)
    y0, step_y, rows = _grid_axis(name, "y", y)
    column, row = (x - x0) / step_x, (y - y0) / step_y
    off = max(float(np.abs(column - np.rint(column)).max()), float(np.abs(row - np.rint(row)).max()))
    if off > AXIS_TOLERANCE:
        refuse(
            name,
            "grid",
            f"a point is {off:.2f} steps off",
            "interpolate the points onto a regular grid with --grid STEP",
        )
    check_claim(name, rows, cols, MIN_FILLED, len(points_um))
    flat = np.rint(row).astype(np.int64) * cols + np.rint(column).astype(np.int64)
    if np.unique(flat).size != flat.size:
        refuse(
            name, "grid", f"{flat.size - np.unique(flat).size} points share a place", "remove doubled points"
        )
    height = np.full(rows * cols, np.nan)
    height[flat] = z
    return checked_map(name, height.reshape(rows, cols), (step_y, step_x), origin)


HEADER = re.compile(r"\W*x", re.IGNORECASE)
_COLUMN = r"{0}[a-z]*(?![a-z0-9])(?P<{0}>[^;,\t]*?)"
NAMED = re.compile(r"\W*" + r"\W+".join(map(_COLUMN.format, "xyz")), re.IGNORECASE)
"""A header of three columns, each with what stands behind its name, such as a unit in brackets."""
CODE_REPEATS = 3
COMMENT = ("#", "%", "//")
UNIT_NAMED = re.compile(r"(?:\bin\s+|[\[(:=,]\s*)(um|µm|\u03bcm|nm|mm|cm|m)(?![\w/])")
SMALL_RANGE, SMALL_SHARE = 0.1, 0.03
"""Range of heights, and its ratio to a pixel in µm, below which the numbers may be mm; a polished map says its unit."""
PIXEL_NOTE = re.compile(r"pixel_um \(y, x\): ([0-9.eE+-]+), ([0-9.eE+-]+)")
SIZE_NOTE = re.compile(r"(\d{1,9}) x (\d{1,9}) heights in um")


@dataclass(frozen=True)
class Table:
    """Numbers of a text file: (rows, cols) with NaN where missing, and what stood around them.

    ``names`` and ``units`` are those of the header of a list of points; a unit is "" where it states none.
    """

    numbers: FloatArray
    separator: str
    decimal: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    comments: tuple[str, ...]
    endless: int = 0

    def corrected(self) -> dict[str, list[str]]:
        """Corrections on the way, for the origin."""
        return {"corrected": [f"{self.endless} infinite heights are missing points"]} if self.endless else {}


def _content_lines(name: str, text: str) -> tuple[list[tuple[int, str]], tuple[str, ...]]:
    """Numbered lines with data, and the comments."""
    lines, comments = [], []
    for number, line in enumerate(text.split("\n"), start=1):
        bare = line.strip()
        if bare.startswith(COMMENT):
            comments.append(bare)
        elif bare:
            lines.append((number, line.strip("\r ")))
    if not lines:
        refuse(name, "text", "holds no numbers", "a matrix of heights or a list of points x y z is expected")
    return lines, tuple(comments)


def _dialect(name: str, lines: list[tuple[int, str]]) -> tuple[str, str]:
    """(separator, decimal sign) of the file; an empty separator is white space.

    A comma is the decimal sign where semicolons, tabs or blanks separate. It separates where nothing else
    does. Where it could be both (``1,5, 2,5``), the file is refused.
    """
    sample = [line for _, line in lines[:200]]
    joined = "\n".join(sample)
    if ";" in joined:
        return ";", _decimal(name, lines, joined)
    if "," not in joined:
        return ("\t" if any("\t" in line for line in sample) else ""), "."
    if re.search(r"\d,\d", joined) and not re.search(r"\d\.\d", joined):
        cells = [cell for line in sample for cell in line.split()]
        if all(len(line.split()) > 1 for line in sample) and all(cell.count(",") <= 1 for cell in cells):
            if any(cell.endswith(",") or cell.startswith(",") for cell in cells):
                return _confused(name, lines)
            return ("\t" if all("\t" in line for line in sample) else ""), ","
    if re.search(r"\d,\d+, ", joined):
        return _confused(name, lines) if not re.search(r"\d\.\d", joined) else (",", ".")
    return ",", "."


def _confused(name: str, lines: list[tuple[int, str]]) -> tuple[str, str]:
    return refuse(
        name,
        f"line {lines[0][0]}",
        repr(lines[0][1][:40]),
        "the comma may be decimal sign or separator; separate the numbers with semicolons",
    )


def _decimal(name: str, lines: list[tuple[int, str]], joined: str) -> str:
    comma, point = re.search(r"\d,\d", joined), re.search(r"\d\.\d", joined)
    if comma and point:
        refuse(
            name,
            f"line {lines[0][0]}",
            repr(lines[0][1][:40]),
            "both , and . appear in numbers; use one of them",
        )
    return "," if comma else "."


def _cells(line: str, separator: str) -> list[str]:
    cells = [cell.strip() for cell in line.split(separator)] if separator else line.split()
    if len(cells) > 1 and separator and not cells[-1]:
        cells.pop()  # a separator at the end of the line, as many programs write it
    return cells


def read_table(name: str, text: str) -> Table:
    """The numbers of a text file.

    Returns:
        (rows, cols) numbers, NaN where a cell is empty, ``nan``, ``***``, ``-`` and the like.

    Raises:
        HeightMapError: a cell is no number, or the lines differ in length; with line number and text.
    """
    lines, comments = _content_lines(name, text)
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    separator, decimal = _dialect(name, (lines[1:] or lines) if HEADER.match(lines[0][1]) else lines)
    header = NAMED.fullmatch(lines[0][1].replace('"', ""))
    if header is not None:
        names, lines = ("x", "y", "z"), lines[1:]
        units = tuple(_unit_behind(name, axis, header[axis]) for axis in names)
    rows: list[list[float]] = []
    for number, line in lines:
        row = [number_of(name, number, cell, decimal) for cell in _cells(line, separator)]
        if rows and len(row) != len(rows[0]):
            refuse(
                name, f"line {number}", f"{len(row)} numbers instead of {len(rows[0])} ({line[:40]!r})",
                "all lines need the same number of columns",
            )  # fmt: skip
        rows.append(row)
    if not rows:
        refuse(name, "text", "holds no numbers", "a matrix of heights or a list of points x y z is expected")
    numbers = np.array(rows, dtype=np.float64)
    endless = int(np.count_nonzero(np.isinf(numbers)))
    numbers[~np.isfinite(numbers)] = np.nan
    return Table(numbers, separator, decimal, names, units, comments, endless)


def _unit_behind(name: str, axis: str, text: str) -> str:
    """Unit that a header states behind the name of a column, "" for none.

    Raises:
        HeightMapError: what stands there is no unit of length.
    """
    unit = text.strip(" ()[]{}<>/_:").strip()
    if unit and unit not in STATED_MICROMETRES_PER:
        option = "--z-unit" if axis == "z" else "--xy-unit"
        refuse(
            name,
            f"header, column {axis}",
            f"{unit[:40]!r} is no unit of length",
            f"take the line out, and say the unit with {option}",
        )
    return unit


def _unit(name: str, stated: tuple[str, ...], given: str | None, option: str) -> str | None:
    """Unit of columns by header and option, None where neither says one.

    Raises:
        HeightMapError: the header states several, or another than the option.
    """
    found = set(filter(None, stated))
    if len(found) > 1:
        refuse(name, "header", f"x in {stated[0]} and y in {stated[1]}", "write both in one unit")
    if not found:
        return given
    unit = found.pop()
    if given is not None and micrometres_per(given) != STATED_MICROMETRES_PER[unit]:
        refuse(name, "units", f"the header states {unit}, not {given}", f"leave {option} out")
    return unit


def _without_codes(name: str, heights: FloatArray, missing: tuple[float, ...]) -> FloatArray:
    """Heights, NaN where they are a code for a missing point.

    Raises:
        HeightMapError: a number repeats at an end, farther from the others than these are apart: it may be a code.
    """
    known = np.isin(heights, missing)
    if known.any():
        heights = np.where(known, np.nan, heights)
    levels, counts = np.unique(heights[np.isfinite(heights)], return_counts=True)
    if len(levels) < 4:  # a step or two are a surface
        return heights
    for end, rest in ((0, levels[1:]), (-1, levels[:-1])):
        gap = abs(levels[end] - rest[end])
        if counts[end] < CODE_REPEATS or gap <= rest[-1] - rest[0]:
            continue
        text = f"{levels[end]:g} stands {counts[end]} times, {gap:.4g} from all other heights"
        if not passes("heights", text):
            refuse(
                name,
                "heights",
                text,
                f"if it marks missing points, say --missing {levels[end]:g}; if it was measured, --trust heights",
            )
    return heights


def _equal_steps(values: FloatArray) -> float | None:
    """Step of equidistant values, None where they are not."""
    if len(values) < 2 or not np.isfinite(values).all():
        return None
    steps = np.diff(values)
    step = float(steps.mean())
    return step if step != 0.0 and np.abs(steps - step).max() <= AXIS_TOLERANCE * abs(step) else None


def _without_axes(
    name: str, table: Table, pixel_um: tuple[float, float] | None, xy_unit: str | None
) -> tuple[FloatArray, tuple[float, float] | None, list[str]]:
    """Heights of a matrix whose first row and column may be its axes, with the pixel size that they give.

    They are axes where the corner is empty and both are equidistant.

    Raises:
        HeightMapError: axes of an unknown unit.
    """
    numbers = table.numbers
    corner = np.isnan(numbers[0, 0]) and min(numbers.shape) > 2
    across, down = (_equal_steps(numbers[0, 1:]), _equal_steps(numbers[1:, 0])) if corner else (None, None)
    if across is None or down is None:
        return numbers, pixel_um, []
    if xy_unit is not None:
        factor = STATED_MICROMETRES_PER[xy_unit]
        pixel_um = abs(down) * factor, abs(across) * factor
    elif pixel_um is None:
        refuse(
            name,
            "axes",
            f"first row and column rise by {across:g} and {down:g}, with an empty corner",
            "say the unit of these axes with --xy-unit, or the pixel size with --pixel; --layout matrix if they are "
            "heights",
        )
    return numbers[1:, 1:], pixel_um, ["first row and column are axes"]


def _is_point_list(name: str, table: Table, layout: Layout, pixel_um: tuple[float, float] | None) -> bool:
    three = table.numbers.shape[1] == 3
    if layout == "xyz" and not three:
        refuse(name, "columns", table.numbers.shape[1], "a list of points has three columns x y z")
    if layout != "auto" or not three:
        return layout == "xyz"
    if table.names and pixel_um is None:
        return True
    return refuse(
        name,
        "layout",
        "three columns may be a list of points x y z or a matrix",
        "say which with --layout xyz or --layout matrix (layout= in Python), or name the file .xyz",
    )


def _noted_pixel(table: Table) -> tuple[float, float] | None:
    """Pixel size (y, x) in µm that our own writer left in a comment."""
    found = PIXEL_NOTE.search("\n".join(table.comments))
    try:
        return (float(found[1]), float(found[2])) if found else None
    except ValueError:
        return None


def _check_unit(name: str, table: Table, heights: FloatArray, pixel: tuple[float, float]) -> None:
    """Ask for the unit of a matrix that may be another than µm, by its comments or its range.

    Raises:
        HeightMapError: the comments name another unit, or all heights are much alike.
    """
    ask = "say the unit of the heights with --z-unit, such as --z-unit"
    for comment in table.comments:
        found = [unit for unit in UNIT_NAMED.findall(comment) if STATED_MICROMETRES_PER[unit] != 1.0]
        if found:
            refuse(name, "units", f"{comment[:40]!r} names {found[-1]}", f"{ask} {found[-1]}")
    known = heights[np.isfinite(heights)]
    span = float(np.ptp(known)) if known.size else 0.0
    if 0.0 < span < min(SMALL_RANGE, SMALL_SHARE * min(pixel)):
        refuse(
            name,
            "units",
            f"heights differ by {span:.3g} only, at pixels of {min(pixel):g} µm",
            f"{ask} mm or um",
        )


def _check_noted_size(name: str, table: Table) -> None:
    """Compare the size that our own writer noted: a text cut at the end of a line looks whole."""
    noted = SIZE_NOTE.search("\n".join(table.comments))
    if noted and (int(noted[1]), int(noted[2])) != table.numbers.shape:
        found = f"{table.numbers.shape[0]} × {table.numbers.shape[1]} heights"
        refuse(name, "size", f"{found} where {noted[1]} × {noted[2]} are noted", "the file is truncated")


GWYDDION_NOTE = re.compile(r"#\s*(Channel|Width|Height|Value units|Kanal|Breite|Höhe):\s*(.*)", re.IGNORECASE)
IN_GERMAN = {"kanal": "channel", "breite": "width", "höhe": "height"}
LENGTH = re.compile(r"([0-9.eE+-]+)\s*(\S+)")
ROUNDED = 0.02


@dataclass(frozen=True)
class _Stated:
    """The header of a text that Gwyddion exported: field (y, x) in µm and µm per value."""

    field_um: tuple[float, float]
    factor: float
    unit: str
    channel: str


def _gwyddion_header(name: str, table: Table) -> _Stated | None:
    """Width, height and unit of the values that Gwyddion's text export notes; None where there is none of them."""
    found = (GWYDDION_NOTE.match(comment) for comment in table.comments)
    notes = {IN_GERMAN.get(note[1].lower(), note[1].lower()): note[2].strip() for note in found if note}
    if not {"width", "height", "value units"} & notes.keys():
        return None
    lengths = []
    for key in ("height", "width"):
        match = LENGTH.fullmatch(notes.get(key, ""))
        try:
            length = float(match[1]) if match else float("nan")
        except ValueError:
            length = float("nan")
        if match is None or not length > 0.0:
            refuse(
                name,
                f"header, {key}",
                repr(notes.get(key, "none"))[:40],
                "a length with its unit is expected",
            )
        lengths.append(length * stated_micrometres_per(name, key, match[2]))
    unit = notes.get("value units", "")
    factor = stated_micrometres_per(name, "heights (Value units)", unit)
    return _Stated((lengths[0], lengths[1]), factor, unit, notes.get("channel", ""))


def _gwyddion_map(
    name: str, table: Table, stated: _Stated, pixel_um: tuple[float, float] | None, z_unit: str | None
) -> HeightMap:
    """The map of such a text. A pixel size given with it may say more digits than the header, not something else."""
    rows, cols = table.numbers.shape
    check_claim(name, rows, cols, 0, 0)
    if z_unit is not None and micrometres_per(z_unit) != stated.factor:
        refuse(
            name,
            "units",
            f"the header states heights in {stated.unit}, not in {z_unit}",
            "leave --z-unit out",
        )
    pixel = stated.field_um[0] / rows, stated.field_um[1] / cols
    if pixel_um is not None:
        if any(abs(given / own - 1.0) > ROUNDED for given, own in zip(pixel_um, pixel, strict=True)):
            given = f"{pixel[0]:.6g} × {pixel[1]:.6g} µm (y, x) by its header, not {pixel_um[0]:g} × {pixel_um[1]:g}"
            refuse(name, "pixel size", given, "leave the pixel size out, or remove the header")
        pixel = pixel_um
    origin = {
        "format": "text matrix of Gwyddion",
        "z_unit": stated.unit,
        "first_row": "top",
        **table.corrected(),
    }
    if stated.channel:
        origin["channel"] = stated.channel[:100]
    return checked_map(name, scaled(table.numbers, stated.factor), pixel, origin)


def read_text(path: Path | str, given: FileScales | None = None) -> HeightMap:
    """Read a matrix of heights (rows along y, as in the file), or a list of points x y z.

    A header ``X (mm), Y (mm), Z (um)`` gives the units of a list. A matrix whose corner is empty and whose first row
    and column are equidistant has axes.

    The header that Gwyddion writes (width, height, unit of the values) is read; the first row then is the top of the
    picture. Texts of Zygo, Wyko, Keyence and ESRI are formats of their own.

    Args:
        path: text file; numbers separated by white space, semicolons or commas.
        given: pixel size (needed for a matrix), units, layout, numbers that stand for missing points, and the step of
            a grid for points that lie on none.

    Raises:
        HeightMapError: no numbers, an ambiguous file, a missing pixel size, or implausible values.
    """
    path, given = Path(path), given or FileScales()
    name, text = path.name, text_of(path)
    table = read_table(name, text)
    stated = _gwyddion_header(name, table)
    if stated is not None:
        return _gwyddion_map(name, table, stated, given.pixel_um, given.z_unit)
    layout: Layout = "xyz" if given.layout == "auto" and path.suffix.lower() == ".xyz" else given.layout
    if _is_point_list(name, table, layout, given.pixel_um):
        return _points(name, table, given)
    if given.grid_um is not None:
        refuse(name, "grid", "a matrix of heights has one", "leave --grid out")
    check_claim(name, table.numbers.shape[0], table.numbers.shape[1], 0, 0)
    _check_noted_size(name, table)
    z_unit = given.z_unit or "um"
    origin = {"format": "text matrix", "z_unit": z_unit, **table.corrected()}
    heights, pixel_um = table.numbers, given.pixel_um
    if layout == "auto":
        heights, pixel_um, done = _without_axes(name, table, pixel_um, given.xy_unit)
        if done:
            origin["corrected"] = [*origin.get("corrected", []), *done]
    pixel = require_pixel(name, pixel_um or _noted_pixel(table))
    heights = _without_codes(name, heights, given.missing)
    if given.z_unit is None and _noted_pixel(table) is None:
        _check_unit(name, table, heights, pixel)
    return checked_map(name, scaled(heights, micrometres_per(z_unit)), pixel, origin)


def _points(name: str, table: Table, given: FileScales) -> HeightMap:
    """The map of a list of points."""
    if given.pixel_um is not None:
        refuse(
            name, "pixel size", given.pixel_um, "a list of points brings its own; leave the pixel size out"
        )
    z_unit = _unit(name, table.units[2:], given.z_unit, "--z-unit") or "um"
    xy_unit = _unit(name, table.units[:2], given.xy_unit, "--xy-unit") or z_unit
    lateral, factor = STATED_MICROMETRES_PER[xy_unit], STATED_MICROMETRES_PER[z_unit]
    origin = {"format": "text points", "z_unit": z_unit, "xy_unit": xy_unit, **table.corrected()}
    points = table.numbers.copy()
    points[:, 2] = _without_codes(name, points[:, 2], given.missing)
    points *= [lateral, lateral, factor]
    if given.grid_um is not None:
        return gridded(name, points, given.grid_um, origin)
    return points_to_map(name, points, origin)


def write_text(surface: HeightMap, path: Path | str) -> None:
    """Write the heights in µm as a comma-separated matrix, every float64 exactly, missing points empty.

    A comment in the first line notes size and pixel size; :func:`read_text` finds them there.

    Raises:
        HeightMapError: the file cannot be written.
    """
    pixel = f"pixel_um (y, x): {surface.pixel_y_um!r}, {surface.pixel_x_um!r}"
    head = f"# {surface.shape[0]} x {surface.shape[1]} heights in um, rows along y; {pixel}"
    rows = (",".join(repr(z) if z - z == 0 else "nan" for z in row) for row in surface.height_um.tolist())
    try:
        Path(path).write_text("\n".join((head, *rows)) + "\n", encoding="utf-8")
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be written ({error.strerror})") from None


TABLE = Format(
    "text", "matrix or points", (".csv", ".txt", ".asc"), read_text, units_from_user="scales", place=13
)
POINTS = Format("xyz", "points", (".xyz",), read_text, units_from_user="scales", place=14)
