"""The colour filters on the pixels of a camera: which pixel sees which colour, and pictures for the eye.

A mosaic is named by the filters of its first two rows, from left to right: ``rggb`` is red, green in the first row and
green, blue in the second (GenICam's BayerRG; OpenCV's BayerRGGB). ``mono`` is a camera without filters.
"""

from typing import Final, Literal, TypeVar, get_args

import numpy as np
import numpy.typing as npt

Filters = Literal["mono", "rggb", "bggr", "grbg", "gbrg"]
FILTERS: tuple[Filters, ...] = get_args(Filters)
CHANNELS: Final = ("red", "green", "blue")

PixelT = TypeVar("PixelT", np.uint16, np.float32)


def channel_of_pixels(filters: str, shape: tuple[int, int]) -> npt.NDArray[np.uint8]:
    """(rows, cols) channel that each pixel sees: 0 red, 1 green, 2 blue; all 0 for ``mono``."""
    if filters == "mono":
        return np.zeros(shape, dtype=np.uint8)
    tile = np.array(["rgb".index(letter) for letter in filters], dtype=np.uint8).reshape(2, 2)
    rows, cols = np.arange(shape[0]) % 2, np.arange(shape[1]) % 2
    return tile[rows[:, None], cols[None, :]]


def demosaicked(counts: npt.NDArray[np.uint16], filters: str) -> npt.NDArray[np.uint16]:
    """(rows, cols, 3) red, green, blue of a mosaic, or of a grey picture; bilinear, to look at.

    Measurements should not use it: what is interpolated is no reading. White is not balanced.
    """
    if filters == "mono":
        return np.repeat(counts[:, :, None], 3, axis=2)
    import cv2  # noqa: PLC0415 - loads when first needed

    code = getattr(cv2, f"COLOR_Bayer{filters.upper()}2RGB")
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(counts), code), dtype=np.uint16)


def grey_of(picture: npt.NDArray[PixelT], filters: str) -> npt.NDArray[PixelT]:
    """(rows, cols) a picture without the pattern of the mosaic: (R + 2 G + B)/4 about every pixel.

    The binomial 3 × 3 weighs every filter of a mosaic with a quarter, wherever it stands, and moves nothing. Counts are
    rounded. Of a camera without filters, the picture itself.
    """
    if filters == "mono":
        return picture
    import cv2  # noqa: PLC0415 - loads when first needed

    even = np.array([0.25, 0.5, 0.25])
    found = cv2.sepFilter2D(np.ascontiguousarray(picture), -1, even, even, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(found, dtype=picture.dtype)
