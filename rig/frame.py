"""A frame: linear raw counts with their acquisition metadata, and its file.

The file is a 16-bit TIFF, with the metadata as JSON in its ImageDescription; its counts may be packed without loss.
"""

import contextlib
import hashlib
import importlib.util
import io
import json
import logging
import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, TypeAdapter, ValidationError

from anisoscope.base.atomic_write import appearing
from anisoscope.base.errors import RecordError, UsageError
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.rig.bayer import Filters, grey_of
from anisoscope.rig.camera import Compression

SCHEMA = 1
SATURATION = 0.98
FrameKind = Literal["sample", "dark", "flat", "stray", "reference"]


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure.

    Attributes:
        counts: linear raw counts, (rows, cols), right-justified.
        kind: what is in the picture: the sample, nothing (light off), the flat (an even white surface), a
            light trap with the light on (stray light), or the reference patch.
        bit_depth: bits per pixel.
        black_level: counts of a pixel without light.
        exposure_s: exposure in seconds, as the camera reported it.
        gain: gain as a factor, as the camera reported it.
        stage_deg: sample angle in degrees, read back from the stage.
        commanded_deg: sample angle in degrees that was asked for.
        tilt_deg: tilt of the camera arm in degrees.
        captured_at: UTC time, ISO 8601.
        camera: model and serial number.
        filters: the colour filters on its pixels; see `anisoscope.rig.bayer`.
        serial, lot: the part in the picture, as far as it is one and known.
    """

    counts: npt.NDArray[np.uint16]
    kind: FrameKind
    bit_depth: int
    black_level: float
    exposure_s: float
    gain: float
    stage_deg: float
    commanded_deg: float
    tilt_deg: float
    captured_at: str
    camera: str
    filters: str = "mono"
    serial: str | None = None
    lot: str | None = None

    @property
    def full_scale(self) -> int:
        """Largest count that the bit depth allows."""
        return (1 << self.bit_depth) - 1

    @cached_property
    def pixels(self) -> str:
        """SHA-256 of shape and counts, hexadecimal: the same however the file packs them."""
        shape = f"{self.counts.shape[0]}x{self.counts.shape[1]}:".encode()
        counts = np.ascontiguousarray(self.counts, dtype="<u2")
        return hashlib.sha256(shape + counts.tobytes()).hexdigest()

    @property
    def grey(self) -> npt.NDArray[np.uint16]:
        """(rows, cols) counts without the pattern of a mosaic, to look for things in."""
        return grey_of(self.counts, self.filters)

    @property
    def saturated_share(self) -> float:
        """Share of pixels at or above 98 % of full scale."""
        return float(np.mean(self.counts >= SATURATION * self.full_scale))


def too_high(counts: npt.NDArray[np.generic], bit_depth: int) -> str:
    """What is wrong with counts above full scale; "" where none is."""
    full_scale, peak = (1 << bit_depth) - 1, int(counts.max())
    if peak <= full_scale:
        return ""
    shift = 16 - bit_depth
    if shift and not np.any(np.asarray(counts, np.uint16) & ((1 << shift) - 1)):
        why = (
            f"they look left-justified (all are multiples of {1 << shift}): shift them right by {shift} bits"
        )
    else:
        why = "they are left-justified, or the bit depth is wrong"
    return f"counts reach {peak}, above the {full_scale} of {bit_depth} bits: {why}"


@dataclass(frozen=True)
class Header:
    """Metadata of a frame, as in the file."""

    anisoscope_frame: Literal[1]
    kind: FrameKind
    bit_depth: Annotated[int, Field(ge=1, le=16)]
    black_level: float
    exposure_s: float
    gain: float
    stage_deg: float
    commanded_deg: float
    tilt_deg: float
    captured_at: str
    camera: str
    filters: Filters = "mono"
    serial: str | None = None
    lot: str | None = None


_HEADER = TypeAdapter(Header)
_NAMES = tuple(field.name for field in fields(Frame) if field.name != "counts")


class _Quiet:
    """Holds the log of tifffile back while any thread is in it, and restores its level after the last one."""

    def __init__(self) -> None:
        self._lock, self._inside, self._level = threading.Lock(), 0, logging.NOTSET

    def change(self, step: int) -> None:
        """One thread more, or less."""
        log = logging.getLogger("tifffile")
        with self._lock:
            if self._inside == 0:
                self._level = log.level
            self._inside += step
            log.setLevel(logging.CRITICAL + 1 if self._inside else self._level)


_quiet = _Quiet()


@contextlib.contextmanager
def quiet_tifffile() -> Iterator[None]:
    """Keep tifffile from logging what it finds strange in metadata that is no business of ours."""
    _quiet.change(1)
    try:
        yield
    finally:
        _quiet.change(-1)


_STRIP_BYTES = 1 << 18
_JPEG_XL_EFFORT = 3


def _packing(frame: Frame, compression: Compression) -> dict[str, Any]:
    """Options of tifffile: strips of a quarter of a megabyte are packed in threads."""
    if compression == "none":
        return {}
    if compression == "jpeg-xl":
        return {"compression": "jpegxl", "compressionargs": {"effort": _JPEG_XL_EFFORT, "lossless": True}}
    return {
        "compression": "zlib",
        "compressionargs": {"level": 1},
        "predictor": True,
        "rowsperstrip": max(1, _STRIP_BYTES // (2 * frame.counts.shape[1])),
        "maxworkers": os.cpu_count() or 1,
    }


def check_compression(compression: Compression) -> None:
    """Check that frames can be packed and read so on this computer.

    Raises:
        UsageError: the package for it is not installed.
    """
    if compression == "jpeg-xl" and importlib.util.find_spec("imagecodecs") is None:
        raise UsageError(f'compression = "jpeg-xl": {_NEEDS_IMAGECODECS}')


_NEEDS_IMAGECODECS = "JPEG XL needs the package imagecodecs: pip install anisoscope[jpegxl]"


def write_frame(frame: Frame, path: Path, compression: Compression = "none") -> None:
    """Write a frame; the file appears whole or not at all.

    Args:
        frame: what to write.
        path: the file.
        compression: how its counts are packed; without, any program reads them.

    Raises:
        RecordError: the folder cannot be written to.
    """
    header = {"anisoscope_frame": SCHEMA} | {name: getattr(frame, name) for name in _NAMES}
    import tifffile  # noqa: PLC0415 - slow to import

    packing = _packing(frame, compression)
    with appearing(path) as file:
        tifffile.imwrite(file, frame.counts, description=json.dumps(header), metadata=None, **packing)


def read_frame(path: Path) -> Frame:
    """Read a frame.

    Raises:
        RecordError: there is no such file, or it is not a frame that `write_frame` wrote.
    """
    return frame_of(file_content(path), path)


def file_content(path: Path) -> bytes:
    """The bytes of the file of a picture.

    Raises:
        RecordError: there is no such file, or it cannot be read.
    """
    try:
        return bounded_bytes(path, MOST_PICTURE_BYTES)
    except FileNotFoundError:
        raise RecordError(f"{path}: there is no such file") from None
    except OSError as problem:
        raise RecordError(f"{path}: cannot be read: {problem.strerror or problem}") from problem


def frame_of(content: bytes, path: Path) -> Frame:
    """The frame in the bytes of a file; ``path`` names it in errors.

    Raises:
        RecordError: it is not a frame that `write_frame` wrote.
    """
    counts, description = _picture_and_words(content, path)
    try:
        header = _HEADER.validate_json(description)
    except ValidationError as problem:
        first = problem.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "metadata"
        raise RecordError(f"{path}: not a frame of anisoscope: {where}: {first['msg']}") from problem
    if counts.dtype != np.uint16 or counts.ndim != 2:
        raise RecordError(
            f"{path}: a frame has 16-bit counts of shape (rows, cols), not {counts.dtype}{counts.shape}"
        )
    return Frame(counts=counts, **{name: getattr(header, name) for name in _NAMES})


def header_of(file: Path | bytes) -> Header | None:
    """Metadata of a frame without its picture; None for a file that is no frame of this program.

    Args:
        file: the file, or its bytes.
    """
    import tifffile  # noqa: PLC0415

    try:
        source = io.BytesIO(file) if isinstance(file, bytes) else file
        with quiet_tifffile(), tifffile.TiffFile(source) as tiff:
            page = tiff.pages[0]
            if page.dtype != np.uint16:
                return None
            return _HEADER.validate_json(getattr(page, "description", ""))
    except Exception:  # noqa: BLE001 - a foreign picture, in any format
        return None


def filters_in_header(file: Path | bytes) -> str | None:
    """The colour filters that a frame of ours names in its metadata; arguments and None as for `header_of`."""
    header = header_of(file)
    return None if header is None else header.filters


def _picture_and_words(content: bytes, path: Path) -> tuple[npt.NDArray[np.uint16], str]:
    import tifffile  # noqa: PLC0415

    try:
        with quiet_tifffile(), tifffile.TiffFile(io.BytesIO(content)) as tiff:
            page = tiff.pages[0]
            return page.asarray(), str(getattr(page, "description", ""))
    except Exception as problem:  # a damaged TIFF fails in many ways
        raise RecordError(f"{path}: {unreadable_tiff(problem)}") from problem


def unreadable_tiff(problem: Exception) -> str:
    """Why a TIFF file cannot be read, in one line; a package that is missing is named."""
    reason = str(problem).split("\n", maxsplit=1)[0]
    if "JPEGXL" in reason and importlib.util.find_spec("imagecodecs") is None:
        return _NEEDS_IMAGECODECS
    return f"not a readable TIFF file: {reason}"
