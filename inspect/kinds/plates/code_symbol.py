"""A code in a plan of fields: where its symbol is, which modules are fixed, and what a reader makes of a picture of it.

Modules are fields. The symbol is found in the plan by its finder pattern, as the two classes of fields change places
with the pose. Reading is zxing-cpp's, which also reports the unused share of the error correction.
"""

import importlib
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray

Mask = npt.NDArray[np.bool_]

FIELD_POINTS = 6
"""Points of a module along its side, where modules are drawn to be read."""
READ_POINTS = 6, 4, 8, 9
"""Points of a module along its side, with which fields are drawn to be read; readers depend on it by chance."""
APERTURES = 0.35, 0.5, 0.7
"""Sides of the squares over which pictures are averaged before they are read, in fields."""
DRAWN_POINTS, DRAWN_BLUR = 20, 0.04
"""Points of a field of a predicted picture along its side, and the blur of its borders in fields."""
FRAME_POINTS = 24
"""Points about a picture that is read."""
SQUARE_REGIONS = (26, 1), (52, 2), (104, 4), (144, 6)
"""Largest side of a square Data Matrix, and its data regions a side (ISO/IEC 16022, table 7)."""
RECTANGLES = {(8, 18): 1, (8, 32): 2, (12, 26): 1, (12, 36): 2, (16, 36): 2, (16, 48): 2}
"""Rectangular Data Matrices, and their data regions in a row."""
FINDER = 7


@dataclass(frozen=True, eq=False)
class Symbol:
    """Symbol of a code on a plan.

    Attributes:
        symbology: "datamatrix" or "qr".
        dark: (rows, cols) dark modules of the whole plan, as in a print on white.
        box: rows and columns of the plan that the symbol takes.
        segments: by name the (rows, cols) modules of the plan that are fixed: finder, clock tracks, quiet zone.
        data: (rows, cols) modules of the plan that carry codewords.
    """

    symbology: str
    dark: Mask
    box: tuple[slice, slice]
    segments: dict[str, Mask]
    data: Mask


def find_symbol(classes: npt.NDArray[np.int64], symbology: str) -> Symbol | None:
    """The symbol of a plan of two classes, whichever of them is the dark one; None where it holds none.

    Args:
        classes: (rows, cols) 0 or 1, first row at the top.
        symbology: "datamatrix" or "qr".
    """
    for letter in (1, 0):
        dark = classes == letter
        rows, cols = np.nonzero(dark)
        if not rows.size:
            continue
        box = slice(int(rows.min()), int(rows.max()) + 1), slice(int(cols.min()), int(cols.max()) + 1)
        inner = dark[box]
        found = _matrix(inner) if symbology == "datamatrix" else _qr(inner)
        if found is None:
            continue
        fixed, data = found
        placed = {name: _placed(mask, dark.shape, box) for name, mask in fixed.items()}
        if symbology == "datamatrix":
            placed |= _quiet_sides(dark.shape, box)
        return Symbol(symbology, dark, box, placed, _placed(data, dark.shape, box))
    return None


def _placed(mask: Mask, shape: tuple[int, ...], box: tuple[slice, slice]) -> Mask:
    found = np.zeros(shape, dtype=bool)
    found[box] = mask
    return found


def _quiet_sides(shape: tuple[int, ...], box: tuple[slice, slice]) -> dict[str, Mask]:
    """Quiet zone left of and below an L within the plan."""
    left, below = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    if box[1].start > 0:
        left[box[0], box[1].start - 1] = True
    if box[0].stop < shape[0]:
        below[box[0].stop, box[1]] = True
    return {name: mask for name, mask in (("QZL1", left), ("QZL2", below)) if mask.any()}


def _matrix(dark: Mask) -> tuple[dict[str, Mask], Mask] | None:
    """Fixed and data modules of a Data Matrix ECC 200; None where these are no modules of one."""
    rows, cols = dark.shape
    if rows == cols:
        count = next((n for side, n in SQUARE_REGIONS if rows <= side), 0)
        across = down = count if rows >= 10 and rows % 2 == 0 else 0
    else:
        across, down = RECTANGLES.get((rows, cols), 0), 1
    if not across or rows % down or cols % across:
        return None
    solid, clock = np.zeros_like(dark), np.zeros_like(dark)
    height, width = rows // down, cols // across
    solid[height - 1 :: height] = True
    solid[:, ::width] = True
    clock[::height] = True
    clock[:, width - 1 :: width] = True
    clock &= ~solid
    y, x = np.indices(dark.shape)
    # a clock track alternates from a dark module at its end on the L
    beats = np.where(y % height == 0, x % 2 == 0, (rows - 1 - y) % 2 == 0)
    if not (dark[:, 0].all() and dark[-1].all() and (dark[clock] == beats[clock]).mean() > 0.9):
        return None
    sides = {"L1": np.zeros_like(dark), "L2": np.zeros_like(dark)}
    sides["L1"][:, 0], sides["L2"][-1] = True, True
    return {**sides, "clock": clock}, ~(solid | clock)


def _qr(dark: Mask) -> tuple[dict[str, Mask], Mask] | None:
    """Fixed and data modules of a QR code; None where these are no modules of one."""
    rows, cols = dark.shape
    version = (rows - 17) // 4
    if rows != cols or (rows - 17) % 4 or not 1 <= version <= 40:
        return None
    y, x = np.indices(dark.shape)
    corners = {"A1": (y <= FINDER, x <= FINDER), "A2": (y <= FINDER, x >= cols - FINDER - 1)}
    corners["A3"] = (y >= rows - FINDER - 1, x <= FINDER)
    fixed = {name: a & b for name, (a, b) in corners.items()}
    eyes = [dark[:FINDER, :FINDER], dark[:FINDER, -FINDER:], dark[-FINDER:, :FINDER]]
    ring = np.maximum(*(abs(one - 3) for one in np.indices((FINDER, FINDER))))
    if min(float((eye == (ring != 2)).mean()) for eye in eyes) < 0.9:
        return None
    finder = fixed["A1"] | fixed["A2"] | fixed["A3"]
    fixed["B1"], fixed["B2"] = (y == 6) & ~finder, (x == 6) & ~finder
    middle = np.zeros_like(dark)
    for row in _alignments(version):
        for col in _alignments(version):
            if not finder[row, col]:
                middle |= (abs(y - row) <= 2) & (abs(x - col) <= 2)
    if middle.any():
        fixed["C"] = middle
    about = ((y <= 8) & ((x <= 8) | (x >= cols - 8))) | ((y >= rows - 8) & (x <= 8))  # and the format
    if version >= 7:
        about |= ((y < 6) & (x >= cols - 11)) | ((x < 6) & (y >= rows - 11))
    return fixed, ~(about | fixed["B1"] | fixed["B2"] | middle)


def _alignments(version: int) -> list[int]:
    """Rows, and columns, of the middles of alignment patterns (ISO/IEC 18004, annex E)."""
    if version == 1:
        return []
    count, last = version // 7 + 2, 4 * version + 10
    step = 26 if version == 32 else (version * 4 + count * 2 + 1) // (count * 2 - 2) * 2
    return [6, *(last - step * n for n in reversed(range(count - 1)))]


def read_plate(
    picture: npt.NDArray[np.float32], points: int, fields: FloatArray, symbology: str
) -> str | None:
    """Text of a code in a picture of a plate; None where none is read. The first reading counts.

    Ridges are finer than modules: what is read are means over a good part of a module, as with larger apertures. Then
    the fields themselves are drawn and read, with several numbers of points a module.

    Args:
        picture: (rows · points, cols · points) known everywhere.
        points: of a field along its side.
        fields: (rows, cols) their means.
        symbology: "datamatrix" or "qr".
    """
    for share in APERTURES:
        blurred = np.asarray(cv2.blur(picture, (max(1, round(share * points)),) * 2), dtype=np.float32)
        found = read_picture(blurred, symbology)
        if found is not None:
            return found
    return read_drawn(fields, symbology)


def read_drawn(fields: FloatArray, symbology: str) -> str | None:
    """Text of a code in its fields alone, drawn with several numbers of points; None where none is read."""
    drawn = (read_picture(np.kron(fields, np.ones((count,) * 2)), symbology) for count in READ_POINTS)
    return next((one for one in drawn if one is not None), None)


def read_fields(fields: FloatArray, symbology: str) -> str | None:
    """Text of a code whose fields have (rows, cols) radiances, read as a photograph of it; None where none is read."""
    picture = np.kron(fields, np.ones((DRAWN_POINTS,) * 2)).astype(np.float32)
    picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), DRAWN_BLUR * DRAWN_POINTS), dtype=np.float32)
    return read_plate(picture, DRAWN_POINTS, fields, symbology)


def read_picture(picture: FloatArray | npt.NDArray[np.float32], symbology: str) -> str | None:
    """Text of a code in a grey picture, dark on light or light on dark; None where none is read."""
    low, high = np.percentile(picture, [1.0, 99.0])
    grey = np.clip(255.0 * (picture - low) / max(high - low, 1e-12), 0.0, 255.0).astype(np.uint8)
    for one in (grey, 255 - grey):
        found = _read(cv2.copyMakeBorder(one, *(FRAME_POINTS,) * 4, cv2.BORDER_REPLICATE), symbology)
        if found is not None:
            return str(found.text)
    return None


def unused_correction(symbol: Symbol, wrong: Mask) -> float | None:
    """Unused error correction where some data modules are read wrongly; None where too many are."""
    if not wrong.any():
        return 1.0
    drawn = np.where(np.pad((symbol.dark ^ (wrong & symbol.data))[symbol.box], 4), 0, 255).astype(np.uint8)
    found = _read(np.kron(drawn, np.ones((FIELD_POINTS,) * 2, np.uint8)), symbol.symbology, pure=True)
    return None if found is None else float((found.extra or {}).get("UEC", 0.0))


def _read(grey: npt.NDArray[np.uint8], symbology: str, *, pure: bool = False) -> Any:  # noqa: ANN401 - without types
    library: Any = importlib.import_module("zxingcpp")  # compiled, without types
    kind = {"datamatrix": library.BarcodeFormat.DataMatrix, "qr": library.BarcodeFormat.QRCode}[symbology]
    return next((one for one in library.read_barcodes(grey, formats=kind, is_pure=pure) if one.valid), None)
