"""Images that a design is made from."""

from pathlib import Path
from typing import TYPE_CHECKING

from anisoscope.base.errors import UsageError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt


def read_image(path: Path, *, colour: bool = False, others: str = "") -> "npt.NDArray[np.uint8]":
    """An image as (rows, cols) grey values, or as (rows, cols, 3) blue, green and red; 0 to 255.

    Args:
        path: a PNG, TIFF or JPEG.
        colour: three channels.
        others: what else the option takes, for the message.

    Raises:
        UsageError: the file cannot be read, or is none.
    """
    import cv2
    import numpy as np

    try:
        data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    found = cv2.imdecode(data, cv2.IMREAD_COLOR if colour else cv2.IMREAD_GRAYSCALE) if data.size else None
    if found is None:
        raise UsageError(f"{path}: not a picture; give a PNG, TIFF or JPEG{others}")
    return np.asarray(found, dtype=np.uint8)
