"""Codes on parts, read from a picture: Data Matrix, Code 128 and QR, turned, pale or small."""

import importlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import MeasurementError, RecordError
from anisoscope.base.json_fields import json_field
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.inspection.batch.scan import Scan, read_scan
from anisoscope.parameters.inspecting import CodeKind
from anisoscope.rig.bayer import grey_of
from anisoscope.rig.frame import filters_in_header

Grey = npt.NDArray[np.uint8]
Counts = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]

TITLES: dict[str, str] = {"datamatrix": "Data Matrix", "code128": "Code 128", "qr": "QR code"}
_FORMATS = {"datamatrix": "DataMatrix", "code128": "Code128", "qr": "QRCode"}
_LARGE_PX = 1600
_BAR_ANGLES_DEG = (25.0, 45.0, 65.0)
_WINDOW = (0.02, 99.98)  # percentiles that become black and white; a small code is a small share


@dataclass(frozen=True)
class Code:
    """A code in a picture.

    Attributes:
        kind: "datamatrix", "code128" or "qr".
        scan: what it says.
        corners: four corners as (column, row) in pixels.
    """

    kind: str
    scan: Scan = field(metadata=json_field(merged=True))
    corners: tuple[tuple[int, int], ...]

    @property
    def title(self) -> str:
        """Its kind in words."""
        return TITLES[self.kind]


def read_codes(picture: Counts, kind: CodeKind = "any") -> tuple[Code, ...]:
    """All codes of a picture, each once, from top to bottom.

    Args:
        picture: (rows, cols) counts of any bit depth.
        kind: look for this kind only.

    Raises:
        UsageError: a code that calls itself GS1, and is not.
    """
    library: Any = importlib.import_module("zxingcpp")  # compiled, without types
    selected = [key for key in _FORMATS if kind in {"any", key}]
    found: dict[tuple[str, str], Code] = {}
    for rendering in _renderings(picture):
        if found and rendering.slow:  # for pictures in which nothing was found
            break
        kinds = [key for key in selected if key == "code128" or not rendering.bars_only]
        formats = [getattr(library.BarcodeFormat, _FORMATS[key]) for key in kinds]
        for one in library.read_barcodes(rendering.image, formats=formats) if formats else ():
            code = _code(one, rendering, library)
            found.setdefault((code.kind, code.scan.text), code)
    return tuple(sorted(found.values(), key=lambda code: min(row for _, row in code.corners)))


def one_code(codes: tuple[Code, ...], kind: CodeKind, where: str) -> Code:
    """The only code of a picture.

    Raises:
        MeasurementError: there is none, or there are several; they are listed.
    """
    if len(codes) == 1:
        return codes[0]
    if not codes:
        what = "code" if kind == "any" else TITLES[kind]
        raise MeasurementError(
            f"no {what} can be read in {where}: is it in the picture, in focus, lit, and 3 pixels a module or more?"
        )
    listed = ", ".join(f"{code.scan.text!r} ({code.title})" for code in codes)
    kinds = {code.kind for code in codes}
    hint = "pick one with --code-kind" if len(kinds) == len(codes) else "cover those that are not meant"
    raise MeasurementError(f"{len(codes)} codes are in {where}: {listed}; {hint}")


def read_picture(path: Path) -> Counts:
    """A picture as (rows, cols) counts; colours become grey, and so does the mosaic of a frame of ours.

    Raises:
        RecordError: there is no such file, or it is no picture.
    """
    try:
        data = np.frombuffer(bounded_bytes(path, MOST_PICTURE_BYTES), dtype=np.uint8)
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}") from error
    try:
        image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH) if data.size else None
    except cv2.error:
        image = None
    if image is None or image.dtype not in {np.dtype(np.uint8), np.dtype(np.uint16)}:
        raise RecordError(f"{path}: is no picture of 8 or 16 bits (PNG, TIFF, JPEG, BMP)")
    if image.dtype == np.uint16 and (filters := filters_in_header(path)) is not None:
        return grey_of(cast("npt.NDArray[np.uint16]", image), filters)
    return cast("Counts", image)


@dataclass(frozen=True, eq=False)
class _Rendering:
    """Picture in 8 bits, the (2, 3) map from the counts to it, and its purpose."""

    image: Grey
    matrix: npt.NDArray[np.float64]
    slow: bool = False
    bars_only: bool = False


def _code(one: Any, rendering: _Rendering, library: Any) -> Code:  # noqa: ANN401 - of the library
    names = {getattr(library.BarcodeFormat, name): key for key, name in _FORMATS.items()}
    # The bytes keep what the text hides: the separators of GS1.
    raw = one.bytes.decode("utf-8", "replace") if one.symbology_identifier else one.text
    place = one.position
    corners = np.array(
        [[p.x, p.y] for p in (place.top_left, place.top_right, place.bottom_right, place.bottom_left)]
    )
    back = cv2.invertAffineTransform(rendering.matrix)
    outline = np.rint(corners @ back[:, :2].T + back[:, 2]).astype(int)
    return Code(
        names[one.symbology],
        read_scan(f"{one.symbology_identifier}{raw}"),
        tuple((int(column), int(row)) for column, row in outline),
    )


def _renderings(picture: Counts) -> Iterator[_Rendering]:
    """The picture in several ways, the quick ones first."""
    calm = cv2.blur(picture, (3, 3))  # hot pixels are neither black nor white
    low, high = np.percentile(calm, _WINDOW)
    lit = np.clip((picture.astype(np.float32) - low) / max(float(high - low), 1.0), 0.0, 1.0)
    plain, same = _grey(np.sqrt(lit)), np.eye(2, 3)
    yield _Rendering(plain, same)
    yield _Rendering(_grey(lit), same)
    if max(picture.shape) > _LARGE_PX:  # calms noise in large pictures
        half = cv2.resize(plain, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        yield _Rendering(np.asarray(half), 0.5 * same)
    for angle_deg in _BAR_ANGLES_DEG:  # bars are looked for along rows and columns only
        yield _turned(plain, angle_deg)
    even = cv2.createCLAHE(clipLimit=8.0, tileGridSize=(8, 8)).apply(plain)
    yield _Rendering(np.asarray(even), same, slow=True)
    yield _Rendering(np.asarray(cv2.GaussianBlur(even, (0, 0), 1.2)), same, slow=True)
    for factor in (2.0, 3.0):
        if max(picture.shape) * factor <= 2 * _LARGE_PX:
            large = cv2.resize(plain, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
            yield _Rendering(np.asarray(large), factor * same, slow=True)
            strong = cv2.addWeighted(large, 2.0, cv2.GaussianBlur(large, (0, 0), 2.0 * factor), -1.0, 0.0)
            yield _Rendering(np.asarray(strong), factor * same, slow=True)


def _turned(image: Grey, angle_deg: float) -> _Rendering:
    rows, cols = image.shape
    matrix = cv2.getRotationMatrix2D(((cols - 1) / 2, (rows - 1) / 2), angle_deg, 1.0)
    side = int(np.hypot(rows, cols)) + 1
    matrix[:, 2] += (side - cols) / 2, (side - rows) / 2
    turned = cv2.warpAffine(image, matrix, (side, side), borderMode=cv2.BORDER_REPLICATE)
    return _Rendering(np.asarray(turned), np.asarray(matrix), bars_only=True)


def _grey(lit: npt.NDArray[np.float32]) -> Grey:
    return np.asarray(255.0 * lit + 0.5, dtype=np.uint8)
