"""Images from files, as 8-bit sRGB or linear light; screens to files, with their resolution."""

import io
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import UsageError
from anisoscope.base.regular_file import regular_file
from anisoscope.sim.proof.separation import decode_srgb

if TYPE_CHECKING:
    import PIL.Image

Bytes8 = npt.NDArray[np.uint8]
Float32 = npt.NDArray[np.float32]

MM_AN_INCH = 25.4
MOST_PIXELS = 400_000_000


@dataclass(frozen=True, eq=False)
class Image:
    """A picture, and what was done to it on the way.

    Attributes:
        srgb: (rows, cols, 3) 8-bit sRGB.
        notes: what was converted, in words.
    """

    srgb: Bytes8
    notes: tuple[str, ...]


def read_image(path: Path) -> Image:
    """Read a picture that Pillow knows; its colour profile is applied, transparent parts become black (no ink).

    Raises:
        UsageError: no such file, no picture, a CMYK picture without a profile, one of floating-point pixels, or more
            pixels than twice Pillow's guard against decompression bombs (179 million).
    """
    import PIL.Image  # noqa: PLC0415 - only who reads a picture needs it
    import PIL.ImageOps  # noqa: PLC0415 - start-up time

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PIL.Image.DecompressionBombWarning)
            with regular_file(path) as file, PIL.Image.open(file) as opened:
                upright = PIL.ImageOps.exif_transpose(opened)
                return _as_srgb(upright, path)
    except FileNotFoundError:
        raise UsageError(f"{path}: there is no such file") from None
    except PIL.Image.DecompressionBombError:
        raise UsageError(f"{path}: too many pixels: make it smaller") from None
    except (OSError, SyntaxError, ValueError) as problem:
        raise UsageError(
            f"{path}: not a picture that can be read: {' '.join(str(problem).split())}"
        ) from None


def _as_srgb(opened: "PIL.Image.Image", path: Path) -> Image:
    import PIL.Image  # noqa: PLC0415 - start-up time

    notes = []
    if opened.mode.startswith("F"):
        raise UsageError(f"{path}: floating-point pixels have no agreed white: convert it to 8 or 16 bits")
    if opened.mode.startswith("I"):
        opened, note = _eight_bits(opened)
        notes.append(note)
    if "A" in opened.getbands() or "transparency" in opened.info:
        clear = opened.convert("RGBA")
        ground = PIL.Image.new("RGBA", clear.size, (0, 0, 0, 255))
        profile = opened.info.get("icc_profile")
        opened = PIL.Image.alpha_composite(ground, clear).convert("RGB")
        opened.info["icc_profile"] = profile
        notes.append("transparent parts carry no ink")
    profile = opened.info.get("icc_profile")
    if profile:
        opened, name = _from_profile(opened, profile, path)
        notes.append(f"converted from its colour profile ({name}) to sRGB")
    elif opened.mode == "CMYK":
        raise UsageError(
            f"{path}: a CMYK picture without a colour profile has no colours: convert it to sRGB"
        )
    return Image(np.array(opened.convert("RGB"), dtype=np.uint8), tuple(notes))


def _eight_bits(opened: "PIL.Image.Image") -> tuple["PIL.Image.Image", str]:
    import PIL.Image  # noqa: PLC0415 - start-up time

    values = np.asarray(opened, dtype=np.float64)
    top = 65535.0 if opened.mode.startswith("I;16") or values.max() > 255.0 else 255.0
    found = PIL.Image.fromarray(np.rint(np.clip(values / top, 0.0, 1.0) * 255.0).astype(np.uint8))
    found.info = {key: value for key, value in opened.info.items() if key == "icc_profile"}
    return found, "read with 8 bits"


def _from_profile(opened: "PIL.Image.Image", profile: bytes, path: Path) -> tuple["PIL.Image.Image", str]:
    import PIL.Image  # noqa: PLC0415 - start-up time
    import PIL.ImageCms  # noqa: PLC0415 - start-up time

    plain = opened if opened.mode in ("RGB", "L", "CMYK", "LAB") else opened.convert("RGB")
    try:
        source = PIL.ImageCms.ImageCmsProfile(io.BytesIO(profile))
        name = (PIL.ImageCms.getProfileDescription(source) or "unnamed").strip()
        found = PIL.ImageCms.profileToProfile(
            plain, source, PIL.ImageCms.createProfile("sRGB"), outputMode="RGB"
        )
    except (PIL.ImageCms.PyCMSError, OSError) as problem:
        raise UsageError(
            f"{path}: its colour profile cannot be used ({problem}): convert it to sRGB"
        ) from None
    assert found is not None
    return found, name


def to_dots(image: Image, width_dots: int) -> Bytes8 | Float32:
    """An image with one pixel a dot: itself, or linear light resampled to a width, its sides in proportion.

    Raises:
        UsageError: a width that is no number of dots.
    """
    import cv2  # noqa: PLC0415 - slow to load

    rows, cols = image.srgb.shape[:2]
    if width_dots < 1 or width_dots * max(1, round(rows * width_dots / cols)) > MOST_PIXELS:
        raise UsageError(f"a print of {width_dots} dots across cannot be made: change its width or the dpi")
    if width_dots == cols:
        return image.srgb
    size = (width_dots, max(1, round(rows * width_dots / cols)))
    linear = decode_srgb().astype(np.float32)[image.srgb]
    way = cv2.INTER_AREA if width_dots < cols else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(linear, size, interpolation=way), dtype=np.float32)


def dots_png(dots: Bytes8, colours: npt.NDArray[np.uint8], dpi: float) -> bytes:
    """All inks as one PNG of a palette (paper, inks), with its resolution.

    Args:
        dots: (rows, cols) 0 to K.
        colours: (K + 1, 3) 8-bit sRGB of paper and inks.
        dpi: dots per inch.
    """
    import PIL.Image  # noqa: PLC0415 - start-up time

    picture = PIL.Image.fromarray(dots, mode=None)
    picture.putpalette(colours.astype(np.uint8).tobytes(), rawmode="RGB")
    stream = io.BytesIO()
    bits = 2 if len(colours) <= 4 else 4
    picture.save(stream, "PNG", bits=bits, compress_level=3, dpi=(dpi, dpi))
    return stream.getvalue()


def film_png(mask: npt.NDArray[np.bool_], dpi: float, *, positive: bool = True) -> bytes:
    """The film of one ink for its screen, one bit a dot, with its resolution.

    Args:
        mask: (rows, cols) where the ink goes.
        dpi: dots per inch.
        positive: black where the ink goes, as films for screens are; else white there.
    """
    import PIL.Image  # noqa: PLC0415 - start-up time

    stream = io.BytesIO()
    PIL.Image.fromarray(mask ^ positive).save(stream, "PNG", compress_level=3, dpi=(dpi, dpi))
    return stream.getvalue()


def picture_png(srgb: Bytes8) -> bytes:
    """A PNG of (rows, cols, 3) 8-bit sRGB."""
    import PIL.Image  # noqa: PLC0415 - start-up time

    stream = io.BytesIO()
    PIL.Image.fromarray(srgb).save(stream, "PNG")
    return stream.getvalue()


def photo_uri(image: Image, longest: int = 1600) -> str:
    """A picture as a data URI (JPEG), reduced where a side exceeds ``longest`` pixels."""
    import base64  # noqa: PLC0415 - start-up time

    import PIL.Image  # noqa: PLC0415 - start-up time

    picture = PIL.Image.fromarray(image.srgb)
    picture.thumbnail((longest, longest))
    stream = io.BytesIO()
    picture.save(stream, "JPEG", quality=88)
    return "data:image/jpeg;base64," + base64.b64encode(stream.getvalue()).decode()
