"""Pixel formats of GenICam cameras that hold raw counts, by their names, and the counts in their bytes.

Source: GenICam Pixel Format Naming Convention 2.4 (names; layout "p": a stream of bits, least significant first) and
GigE Vision 1.2 (layout "Packed": two pixels in three bytes, the middle one holds the low bits of both).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError

_MOSAICS = {"Mono": "mono", "BayerRG": "rggb", "BayerGR": "grbg", "BayerGB": "gbrg", "BayerBG": "bggr"}


@dataclass(frozen=True)
class PixelFormat:
    """A pixel format of raw counts.

    Attributes:
        name: its name, such as Mono12Packed.
        bits: bits of a count.
        packing: "" for counts in whole bytes, "Packed" for GigE Vision's layout, "p" for the stream of bits.
        filters: the colour filters; see `anisoscope.rig.bayer`. The letters of a Bayer format are the first two pixels.
    """

    name: str
    bits: int
    packing: str
    filters: str

    def size(self, pixels: int) -> int:
        """Bytes of so many pixels.

        Raises:
            CameraError: they do not fill whole bytes.
        """
        bits = {"": 8 if self.bits <= 8 else 16, "Packed": 12, "p": self.bits}[self.packing] * pixels
        if bits % 8:
            raise CameraError(f"{self.name}: rows must fill whole bytes; choose a width that 4 divides")
        return bits // 8


def _formats() -> dict[str, PixelFormat]:
    packings = {8: ("",), 10: ("", "Packed", "p"), 12: ("", "Packed", "p"), 14: ("",), 16: ("",)}
    return {
        f"{kind}{bits}{packing}": PixelFormat(f"{kind}{bits}{packing}", bits, packing, filters)
        for kind, filters in _MOSAICS.items()
        for bits in packings
        for packing in packings[bits]
    }


FORMATS = _formats()


def choose(wanted: str, offered: tuple[str, ...]) -> str:
    """The format to use: the one that is wanted, the same counts in another layout, or for grey ones Mono8.

    Raises:
        CameraError: the camera offers none of these.
    """
    asked = FORMATS[wanted]
    alike = [name for name, one in FORMATS.items() if (one.bits, one.filters) == (asked.bits, asked.filters)]
    last = ["Mono8"] if asked.filters == "mono" else []
    for name in dict.fromkeys([wanted, *alike, *last]):
        if name in offered:
            return name
    raise CameraError(
        f"the camera has no {' nor '.join(dict.fromkeys([wanted, *last]))}, only {', '.join(offered)}; choose one of "
        f"{', '.join(name for name in offered if name in FORMATS) or 'its raw formats: it has none that is known'}"
    )


def counts_of(
    data: bytes | memoryview, shape: tuple[int, int], name: str, *, big_endian: bool = False
) -> npt.NDArray[np.uint16]:
    """(rows, cols) counts, right-justified, of the bytes of a picture.

    Counts of 10 to 14 bits in two bytes show their order: in the other one they exceed their bits, or all are whole
    multiples of 256. Those of 16 bits do not: ``big_endian`` states that their high byte comes first.

    Raises:
        CameraError: there are more or fewer bytes than the picture has, or counts of 16 bits come in the other order.
    """
    form = FORMATS[name]
    rows, cols = shape
    expected = rows * form.size(cols)
    raw = np.frombuffer(data, np.uint8)
    if raw.size != expected:
        raise CameraError(f"a picture of {cols} × {rows} in {name} has {expected} bytes; {raw.size} came")
    if form.packing == "":
        if form.bits == 8:
            return raw.astype(np.uint16).reshape(shape)
        counts = raw.view(">u2" if big_endian else "<u2")
        if form.bits < 16:
            swapped = counts.byteswap()
            if int(swapped.max()) < 1 << form.bits and (
                int(counts.max()) >> form.bits or not np.any(counts & 0xFF)
            ):
                counts = swapped
        elif _are_swapped(counts, shape):
            raise CameraError(
                f"the counts in {name} come with their {'low' if big_endian else 'high'} byte first: state "
                f"big_endian = {str(not big_endian).lower()} in [camera.options]"
            )
        return counts.astype(np.uint16).reshape(shape)
    out = np.empty(rows * cols, np.uint16)
    if form.packing == "Packed":
        first, low, second = (raw[i::3].astype(np.uint16) for i in range(3))
        short = form.bits - 8
        mask = (1 << short) - 1
        out[0::2] = first << short | low & mask
        out[1::2] = second << short | low >> 4 & mask
        return out.reshape(shape)
    group = _bytes_of_a_group(form.bits)
    pixels = group * 8 // form.bits
    columns = [raw[i::group].astype(np.uint32) for i in range(group)]
    for pixel in range(pixels):
        start = pixel * form.bits
        byte, shift = divmod(start, 8)
        out[pixel::pixels] = (columns[byte] | columns[byte + 1] << 8) >> shift & ((1 << form.bits) - 1)
    return out.reshape(shape)


_ROWS, _ROUGHER, _LEAST_NOISE = 16, 8.0, 1.5


def _are_swapped(counts: npt.NDArray[np.uint16], shape: tuple[int, int]) -> bool:
    """Whether neighbours differ far less with the bytes of each count swapped, in some rows of a picture.

    Noise in the low byte becomes 256 times as large where it is taken for the high one. Counts whose low byte is always
    0 (left-justified ones of 8 bits) say nothing, nor do pictures without noise, which are test patterns.
    """
    few = counts.reshape(shape)[:: max(1, shape[0] // _ROWS)]
    if not np.any(few & 0xFF) or not np.any(few >> 8):
        return False
    steps = (np.abs(np.diff(one.astype(np.int32), axis=1)) for one in (few, few.byteswap()))
    rough, smooth = (float(np.median(one)) for one in steps)  # edges are few, and may be of any height
    return smooth > _LEAST_NOISE and rough > _ROUGHER * smooth


def _bytes_of_a_group(bits: int) -> int:
    """Bytes after which a stream of bits begins anew with a whole byte."""
    return int(np.lcm(bits, 8)) // 8
