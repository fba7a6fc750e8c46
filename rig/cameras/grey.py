"""From what a UVC camera delivers to grey counts of 8 bits.

The Y plane is taken as it is where the camera gives it (YUYV, UYVY, GREY). From colour pictures it is computed:
0.299 R + 0.587 G + 0.114 B (ITU-R BT.601, OpenCV's weights), of values that are not linear.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError

Grey = npt.NDArray[np.uint8]
_Y_PLACE = {"YUYV": 0, "YUY2": 0, "UYVY": 1}
TOP = 255


def to_grey(picture: npt.NDArray[Any], fourcc: str, size: tuple[int, int], white_level: int = TOP) -> Grey:
    """Grey counts of a picture.

    Args:
        picture: as OpenCV gave it.
        fourcc: format that the camera states.
        size: expected (rows, cols).
        white_level: counts at which the camera clips; pixels there, in any colour, are set to 255.

    Returns:
        (rows, cols) counts.

    Raises:
        CameraError: a picture of another size, or of a format that is not known.
    """
    if picture.dtype != np.uint8:
        raise CameraError(f"the camera delivers {picture.dtype}, not the 8-bit counts of a UVC camera")
    rows, cols = size
    if picture.size == 2 * rows * cols and fourcc in _Y_PLACE:
        grey = picture.reshape(rows, cols, 2)[..., _Y_PLACE[fourcc]]
        clipped = grey >= white_level
    elif picture.shape == (rows, cols, 3):
        grey, clipped = _luma(picture), np.any(picture >= white_level, axis=2)
    elif picture.size == rows * cols and (picture.ndim == 2 or picture.shape[-1] == 1):
        grey = picture.reshape(rows, cols)
        clipped = grey >= white_level
    else:
        raise CameraError(
            f"the camera delivers pictures of shape {picture.shape} in format {fourcc or 'unknown'}, which are "
            f"no {rows} x {cols} pixels (rows x cols); set camera.options.width, height or fourcc"
        )
    return np.where(clipped, np.uint8(TOP), grey)


def _luma(picture: npt.NDArray[Any]) -> npt.NDArray[Any]:
    import cv2  # noqa: PLC0415 - cameras without colour do without it

    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))
