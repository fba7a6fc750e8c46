"""Read dat files of Zygo MetroPro.

A big-endian header of 834 bytes (4096 in format 3), intensities (the first picture is read), then the connected phase
as int32, row after row. Height = phase · S · O · λ / R: interferometric scale factor, obliquity factor, wavelength
and phase resolution (4096, 32768 or 131072 steps). Phases of 2147483640 and above were not measured, intensities of
65412 and above neither. Positions as in
Gwyddion's ``metropro.c`` and SurfaceTopography's ``IO/MetroPro.py`` (MIT licence).
"""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.profiles.files.checks import checked_map, refuse
from anisoscope.profiles.files.content import DAMAGED, Content, load_content, scaled
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.units import Given, stated_or_given_pixel
from anisoscope.profiles.heightmap import INTENSITY, HeightMap, Layer

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


def read_metropro(path: Path | str, given: Given | None = None) -> HeightMap:
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


_SIGNATURES = tuple((0, magic) for magic in MAGICS)
METROPRO = Format("metropro", "Zygo MetroPro", (".dat",), read_metropro, _SIGNATURES, place=9)
