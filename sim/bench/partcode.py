"""A code printed on the plate next to the sample, like the markers."""

import importlib
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import RigFileError
from anisoscope.sim.bench.benchfile import CodePart, OpticsPart, SensorPart
from anisoscope.sim.bench.optics import pixel_from_mm

Image = npt.NDArray[np.float32]

_FORMATS = {"datamatrix": "DataMatrix", "code128": "Code128", "qr": "QRCode"}
_DOTS_PER_MODULE = 16


def image_of_code(
    code: CodePart, part: OpticsPart, sensor: SensorPart, angle_deg: float, tilt_deg: float, plate: float
) -> Image:
    """What the label with the code adds to the reflectance of the plate, (rows, cols).

    Args:
        code: what is printed where.
        part: the optics.
        sensor: the sensor.
        angle_deg: true angle of the sample.
        tilt_deg: tilt of the camera.
        plate: reflectance of the plate under the label.

    Raises:
        RigFileError: the text cannot be written in such a code.
    """
    dots = np.kron(printed(code), np.ones((_DOTS_PER_MODULE, _DOTS_PER_MODULE), dtype=np.float32))
    dot_mm = code.width_mm / dots.shape[1]
    sigma = float(np.sqrt(part.blur_um**2 + part.pixel_um**2 / 12.0) / (1000.0 * dot_mm))
    margin = int(4 * sigma) + 1
    label = cv2.GaussianBlur(np.pad(dots - plate, margin), (0, 0), max(sigma, 1e-3))
    rows, cols = label.shape
    turn = np.radians(code.turned_deg)
    cos, sin = dot_mm * np.cos(turn), dot_mm * np.sin(turn)
    middle = np.array([(cols - 1) / 2, (rows - 1) / 2])
    linear = np.array([[cos, sin], [sin, -cos]])  # rows count downwards, y upwards
    dot_to_mm = np.eye(3)
    dot_to_mm[:2, :2] = linear
    dot_to_mm[:2, 2] = np.array([code.x_mm, code.y_mm]) - linear @ middle
    matrix = pixel_from_mm(part, sensor, angle_deg, tilt_deg) @ dot_to_mm
    return np.asarray(cv2.warpAffine(label, matrix, (sensor.cols, sensor.rows), flags=cv2.INTER_LINEAR))


def printed(code: CodePart) -> Image:
    """Reflectance of the label, one element a module, its quiet zone included.

    Raises:
        RigFileError: the text cannot be written in such a code.
    """
    library: Any = importlib.import_module("zxingcpp")  # compiled, without types
    kind = getattr(library.BarcodeFormat, _FORMATS[code.kind])
    try:
        barcode = library.create_barcode(code.text, kind, options="gs1" if code.gs1 else "")
        black = np.asarray(barcode.to_image(scale=1)) < 128
    except (ValueError, RuntimeError) as problem:
        raise RigFileError(
            f"sample.code: {code.text!r} cannot be written as {code.kind}: {problem}"
        ) from problem
    return np.where(black, code.black, code.white).astype(np.float32)
