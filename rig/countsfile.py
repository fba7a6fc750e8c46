"""Raw counts from a TIFF or PNG that any program wrote: the stored numbers, untouched, or an error.

Viewers scale, invert, rotate and gamma-correct; here nothing of that is done. What would need it to be
understood (palettes, inverted grey, packed bits) is refused.
"""

import io
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import TypeGuard

import numpy as np
import numpy.typing as npt
import tifffile

from anisoscope.base.errors import RecordError
from anisoscope.rig.frame import quiet_tifffile

Counts = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]

_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_PNG_COLOURS = {2: "colour", 3: "a palette of colours", 4: "grey with transparency", 6: "colour"}
_MIN_IS_WHITE, _MIN_IS_BLACK = 0, 1


def read_counts(path: Path) -> Counts:
    """Read the counts of a grey picture.

    Args:
        path: TIFF or PNG, recognised by its content; 8 or 16 bits per pixel, one picture.

    Returns:
        (rows, cols) counts in the type of the file, uint8 or uint16.

    Raises:
        RecordError: there is no such file, it is damaged, or it is not such a picture.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise RecordError(f"{path}: there is no such file") from None
    except OSError as problem:
        raise RecordError(f"{path}: cannot be read: {problem.strerror or problem}") from problem
    if data.startswith(_PNG):
        counts = _png(path, data)
    elif data.startswith(_TIFF):
        counts = _tiff(path, data)
    else:
        raise RecordError(f"{path}: neither a TIFF nor a PNG file")
    if counts.ndim != 2 or counts.size == 0:
        raise RecordError(f"{path}: a frame has the shape (rows, cols), not {counts.shape}")
    if not _is_counts(counts):
        raise RecordError(f"{path}: a frame has 8-bit or 16-bit counts without sign, not {counts.dtype}")
    return counts


def as_frame_counts(counts: Counts, bit_depth: int, path: Path) -> npt.NDArray[np.uint16]:
    """(rows, cols) counts as uint16, checked against the bit depth.

    Raises:
        RecordError: counts above 2**bit_depth − 1 (left-justified, mostly), or too few bits in the file.
    """
    if counts.dtype == np.uint8 and bit_depth > 8:
        raise RecordError(
            f"{path}: an 8-bit file cannot hold counts of {bit_depth} bits; "
            "give the 16-bit original, or bit_depth 8 if the camera has no more"
        )
    full_scale, peak = (1 << bit_depth) - 1, int(counts.max())
    if peak > full_scale:
        shift = 16 - bit_depth
        if shift and not np.any(counts & ((1 << shift) - 1)):
            why = f"they look left-justified (all are multiples of {1 << shift}): shift them right by {shift} bits"
        else:
            why = "they are left-justified, or the bit depth is wrong"
        raise RecordError(f"{path}: counts reach {peak}, above the {full_scale} of {bit_depth} bits: {why}")
    return counts.astype(np.uint16)


def _is_counts(array: npt.NDArray[np.generic]) -> TypeGuard[Counts]:
    return array.dtype in {np.dtype(np.uint8), np.dtype(np.uint16)}


def _png(path: Path, data: bytes) -> npt.NDArray[np.generic]:
    if len(data) < 29 or data[12:16] != b"IHDR":
        raise RecordError(f"{path}: not a readable PNG file: it has no header")
    bits, colour = struct.unpack(">BB", data[24:26])
    if colour in _PNG_COLOURS:
        raise RecordError(f"{path}: a frame is grey; this PNG holds {_PNG_COLOURS[colour]}")
    if bits not in {8, 16}:
        raise RecordError(f"{path}: a frame has 8 or 16 bits per pixel; this PNG has {bits}")
    picture = _decode(data)
    if picture is None:
        raise RecordError(f"{path}: not a readable PNG file: it is damaged or cut short")
    return picture


def _decode(data: bytes) -> npt.NDArray[np.generic] | None:
    import cv2  # noqa: PLC0415 - rig status and stages do without it

    flags = cv2.IMREAD_UNCHANGED
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None


def _tiff(path: Path, data: bytes) -> npt.NDArray[np.generic]:
    try:
        with quiet_tifffile(), tifffile.TiffFile(io.BytesIO(data)) as tiff:
            pages = [page for page in tiff.pages if not getattr(page, "is_reduced", False)]
            _check_page(path, pages)
            try:
                return np.asarray(pages[0].asarray())
            except (ValueError, ImportError):
                # LZW and the like need a package that is not ours to ask for; OpenCV can do them
                picture = _decode(data)
                if picture is None:
                    raise
                return picture
    except RecordError:
        raise
    except Exception as problem:  # a damaged TIFF fails in many ways
        reason = str(problem).split("\n", maxsplit=1)[0]
        raise RecordError(f"{path}: not a readable TIFF file: {reason}") from problem


def _check_page(path: Path, pages: Sequence[object]) -> None:
    if len(pages) != 1:
        raise RecordError(f"{path}: a frame is one picture; this TIFF holds {len(pages)}")
    page = pages[0]
    samples, kind = getattr(page, "samplesperpixel", 1), getattr(page, "photometric", _MIN_IS_BLACK)
    if samples != 1 or kind not in {_MIN_IS_WHITE, _MIN_IS_BLACK}:
        raise RecordError(f"{path}: a frame is grey; this TIFF holds colour ({samples} values per pixel)")
    if kind == _MIN_IS_WHITE:
        raise RecordError(f"{path}: this TIFF says that 0 is white; write it with 0 as black")
    bits = getattr(page, "bitspersample", 16)
    if bits not in {8, 16}:
        raise RecordError(f"{path}: a frame has 8 or 16 bits per pixel; this TIFF has {bits}")
