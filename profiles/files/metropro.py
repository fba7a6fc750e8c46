"""Read files of Zygo MetroPro: dat, and its exports as text.

A big-endian header of 834 bytes (4096 in format 3), intensities (the first picture is read), then the connected phase
as int32, row after row. Height = phase · S · O · λ / R: interferometric scale factor, obliquity factor, wavelength
and phase resolution (4096, 32768 or 131072 steps). Phases of 2147483640 and above were not measured, intensities of
65412 and above neither. Positions as in
Gwyddion's ``metropro.c`` and SurfaceTopography's ``IO/MetroPro.py`` (MIT licence).
"""

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.cells import grid_of, number_of, numbers_of, text_of
from anisoscope.profiles.files.checks import check_claim, checked_map, refuse
from anisoscope.profiles.files.content import DAMAGED, Content, load_content, scaled
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.units import stated_or_given_pixel
from anisoscope.profiles.heightmap import INTENSITY, HeightMap, Layer

ZYGO_TEXT = re.compile(r"\A\W*Zygo (XYZ|ASCII) Data File - Format \d")
MAGICS = {b"\x88\x1b\x03\x6f": 834, b"\x88\x1b\x03\x70": 834, b"\x88\x1b\x03\x71": 4096}
STEPS = {0: 4096, 1: 32768, 2: 131072}
NOT_MEASURED = 2147483640
NO_INTENSITY = 65412
WAVELENGTH_M = (1e-7, 2e-5)


def _factor_um(content: Content) -> float:
    """µm per step of the phase."""
    scale, wavelength, _aperture, obliquity = content.numbers(">4f", 164)
    (resolution,) = content.numbers(">h", 218)
    (sign,) = content.numbers(">h", 232)
    if resolution not in STEPS:
        refuse(content.name, "phase resolution", resolution, DAMAGED)
    for label, value, low, high in (
        ("scale factor", scale, 0.01, 10.0),
        ("obliquity factor", obliquity, 0.1, 10.0),
        ("wavelength in m", wavelength, *WAVELENGTH_M),
    ):
        if not low <= value <= high:
            refuse(content.name, label, f"{value:.6g}", f"plausible are {low:g} to {high:g}; {DAMAGED}")
    return float((-1.0 if sign else 1.0) * scale * obliquity * wavelength * 1e6 / STEPS[resolution])


def _origin(content: Content) -> dict[str, Any]:
    (seconds,) = content.numbers(">i", 76)
    origin: dict[str, Any] = {
        "format": "MetroPro dat",
        "first_row": "top",
        "instrument": {"manufacturer": "Zygo"},
    }
    if seconds > 0:
        origin["date"] = datetime.fromtimestamp(seconds, UTC).isoformat()
    if comment := content.text(80, 82):
        origin["comment"] = comment
    return origin


def read_metropro(path: Path | str, given: FileScales | None = None) -> HeightMap:
    """Read the connected phase of a MetroPro file as heights.

    Returns:
        (rows, cols) heights in µm in the order of the file, first row at the top of the picture.

    Raises:
        HeightMapError: no MetroPro file, no heights, damaged, or implausible.
    """
    content = load_content(Path(path))
    name = content.name
    expected = MAGICS.get(content.data[:4])
    if expected is None:
        refuse(name, "content", "does not begin as MetroPro does", "text with this extension: rename it .txt")
    (header_bytes,) = content.numbers(">I", 6)
    if header_bytes != expected:
        refuse(name, "header size", header_bytes, f"{expected} is known; export x3p")
    x, y, width, height, buckets, _range, intensity_bytes = content.numbers(">hhHHHhI", 48)
    left, top, cols, rows, phase_bytes = content.numbers(">hhHHI", 64)
    if intensity_bytes != 2 * width * height * buckets or phase_bytes != 4 * rows * cols:
        refuse(name, "sizes", f"{intensity_bytes} and {phase_bytes} bytes do not fit the dimensions", DAMAGED)
    raw = content.grid(">i4", rows, cols, header_bytes + intensity_bytes)
    (lateral,) = content.numbers(">f", 184)
    stated = None if lateral == 0 else (lateral * 1e6, lateral * 1e6)
    pixel = stated_or_given_pixel(name, stated, given.pixel_um if given else None)
    heights = scaled(raw, _factor_um(content), raw >= NOT_MEASURED)
    layers = {}
    if intensity_bytes:
        counts = content.grid(">u2", height, width, header_bytes)
        layers[INTENSITY] = _placed(counts, (y - top, x - left), (rows, cols))
    return checked_map(name, heights, pixel, _origin(content), layers=layers)


def _placed(counts: npt.NDArray[Any], at: tuple[int, int], shape: tuple[int, int]) -> Layer:
    """Intensities in the window of the heights: NaN where there are none.

    Args:
        counts: (height, width) as stored.
        at: row and column of their first point in the window.
        shape: (rows, cols) of the window.
    """
    found = np.full(shape, np.nan, dtype=np.float32)
    spans = []
    for start, count, limit in zip(at, counts.shape, shape, strict=True):
        low, high = max(start, 0), min(start + count, limit)
        spans.append((slice(low, max(low, high)), slice(low - start, max(low, high) - start)))
    part = counts[spans[0][1], spans[1][1]]
    found[spans[0][0], spans[1][0]] = np.where(part < NO_INTENSITY, part, np.nan)
    return found


def _fields(name: str, lines: list[str], number: int, least: int) -> list[str]:
    """Fields of a header line, counted from 1."""
    found = lines[number - 1].split() if len(lines) >= number else []
    if len(found) < least:
        refuse(name, f"line {number}", f"{len(found)} fields", f"{least} or more are expected; {DAMAGED}")
    return found


def read_zygo_text(path: Path, given: FileScales) -> HeightMap:
    """Read a text that MetroPro or Mx exported, "Zygo XYZ" or "Zygo ASCII Data File".

    Thirteen or fourteen lines, ``#``, then points (column, row, height in µm), or intensities, ``#`` and phases. Line 4
    has origin, width and height, line 8 scale factor, wavelength [m], obliquity factor and pixel [m], line 11 the phase
    resolution (Zygo MetroPro Reference Guide, ASCII data formats).

    Args:
        path: the file.
        given: the pixel size, only for a file that states none.

    Raises:
        HeightMapError: header and data do not fit each other, or the heights are implausible.
    """
    name, lines = path.name, text_of(path).splitlines()
    marks = [k for k, line in enumerate(lines) if line.strip() == "#"]
    points = lines[0].split()[1] == "XYZ"
    if len(marks) < (1 if points else 2):
        refuse(name, "header", "no line # after it", DAMAGED)
    left, top, cols, rows = (int(number_of(name, 4, cell)) for cell in _fields(name, lines, 4, 4)[:4])
    check_claim(name, rows, cols, 0, 0)
    _, scale, wavelength, _, obliquity, _, pixel_m, *_ = (
        number_of(name, 8, cell) for cell in _fields(name, lines, 8, 8)
    )
    start = marks[0] + 1 if points else marks[1] + 1
    end = next((mark for mark in marks if mark >= start), len(lines))
    if points:
        height, count = np.full((rows, cols), np.nan), 0
        for k, line in enumerate(lines[start:end], start + 1):
            cells = line.split(None, 2)
            if not cells:
                continue
            if len(cells) < 3:
                refuse(name, f"line {k}", repr(line[:40]), "column, row and height are expected")
            x, y = (int(number_of(name, k, cell)) for cell in cells[:2])
            if not (0 <= x - left < cols and 0 <= y - top < rows):
                refuse(name, f"line {k}", f"point {x}, {y}", f"beyond {cols} × {rows} points; {DAMAGED}")
            height[y - top, x - left] = number_of(name, k, cells[2].strip())
            count += 1
        if count != rows * cols:
            refuse(name, "data", f"{count} points for {rows} × {cols}", DAMAGED)
    else:
        resolution = int(number_of(name, 11, _fields(name, lines, 11, 1)[0]))
        if resolution not in STEPS:
            refuse(name, "phase resolution", resolution, DAMAGED)
        phase = grid_of(name, numbers_of(name, start + 1, lines[start:end]), rows, cols)
        factor = scale * obliquity * wavelength * 1e6 / STEPS[resolution]
        height = scaled(phase, factor, phase >= NOT_MEASURED)
    stated = None if pixel_m == 0.0 else (pixel_m * 1e6, pixel_m * 1e6)
    pixel = stated_or_given_pixel(name, stated, given.pixel_um)
    origin = {"format": "Zygo text", "first_row": "top", "instrument": {"manufacturer": "Zygo"}}
    return checked_map(name, height, pixel, origin, stage_height=True)


_SIGNATURES = tuple((0, magic) for magic in MAGICS)
METROPRO = Format("metropro", "Zygo MetroPro", (".dat",), read_metropro, _SIGNATURES, place=9)
TEXT = Format("zygo-text", "Zygo text", (), read_zygo_text, header=ZYGO_TEXT, place=16)
