"""Klems matrices in LBNL's XML, as WINDOW and Radiance read them: mean BRDFs between 145 patches of the hemisphere.

The patches are those of the full basis. Light comes from a patch and leaves through a patch; a value is the mean of the
BRDF over both, weighted by projected solid angle. Columns are the incident patches (`lbnl_xml` says which way they
count).
"""

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.bsdf.file_format import BsdfFile
from anisoscope.bsdf.lbnl_xml import WindowElement, is_xml, write_window_element
from anisoscope.bsdf.reflectance import Reflectance, above_horizon

EDGES_DEG = (0.0, 5.0, 15.0, 25.0, 35.0, 45.0, 55.0, 65.0, 75.0, 90.0)
AZIMUTHS = (1, 8, 16, 20, 24, 24, 24, 16, 12)
PATCHES = sum(AZIMUTHS)
BASIS = "LBNL/Klems Full"
_DRAWS = 96


def write_klems(reflectance: Reflectance, path: Path, on_progress: Advance = silent) -> None:
    """Average a reflectance of one channel over the patches and write it.

    Raises:
        UsageError: several wavelengths.
        RecordError: the file cannot be written.
    """
    if reflectance.channels != 1:
        raise UsageError(f"{reflectance.name}: a Klems matrix holds one value for all light")
    matrix = np.empty((PATCHES, PATCHES))  # outgoing, incident
    draws = _draws()
    for number in range(PATCHES):
        if number % 16 == 0:
            on_progress("patches", number, PATCHES)
        light = -_within(np.full(PATCHES, number), draws[:, :2])
        light[..., 2] *= -1.0
        camera = _within(np.arange(PATCHES), draws[:, 2:])
        value = reflectance.evaluate(light.reshape(-1, 3), camera.reshape(-1, 3))
        matrix[:, number] = value[:, 0].reshape(PATCHES, _DRAWS).mean(axis=1)
    on_progress("patches", PATCHES, PATCHES)
    text = "\n".join(", ".join(f"{value:.6g}" for value in row) + "," for row in matrix).rstrip(",")
    bases = {"ColumnAngleBasis": BASIS, "RowAngleBasis": BASIS}
    write_window_element(path, reflectance.name, "Columns", bases, text, _basis())


def read_klems(path: Path) -> Reflectance:
    """Read a Klems matrix of the full basis: the reflection on the side of the surface normal.

    Raises:
        UsageError: no such file, another basis, or a matrix of another size.
    """
    element = WindowElement(path)
    for axis in ("ColumnAngleBasis", "RowAngleBasis"):
        if element.text(axis) != BASIS:
            raise UsageError(
                f"{path}: read are matrices of {BASIS} and tensor trees, not "
                f"{element.text(axis) or element.structure!r}"
            )
    try:
        values = np.array(element.text("ScatteringData").replace(",", " ").split(), dtype=np.float64)
    except ValueError as problem:
        raise UsageError(f"{path}: ScatteringData holds something that is no number: {problem}") from None
    if values.size != PATCHES**2 or not np.isfinite(values).all():
        raise UsageError(
            f"{path}: ScatteringData has {values.size} numbers, {PATCHES} × {PATCHES} are expected"
        )
    matrix = values.reshape(PATCHES, PATCHES)
    if element.structure == "Rows":
        matrix = matrix.T

    def value(to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
        travels = to_light * np.array([-1.0, -1.0, 1.0])
        return np.asarray(matrix[patch_of(to_camera), patch_of(travels)])

    return Reflectance(element.name, lambda light, camera: above_horizon(light, camera, value))


def patch_of(vectors: FloatArray) -> npt.NDArray[np.intp]:
    """(N,) patches of (N, 3) unit vectors of the upper hemisphere."""
    theta = np.degrees(np.arctan2(np.hypot(vectors[:, 0], vectors[:, 1]), vectors[:, 2]))
    ring = np.clip(np.searchsorted(EDGES_DEG, theta, side="right") - 1, 0, len(AZIMUTHS) - 1)
    many = np.array(AZIMUTHS)[ring]
    turn = np.mod(np.arctan2(vectors[:, 1], vectors[:, 0]) / (2.0 * np.pi), 1.0)
    first = np.concatenate([[0], np.cumsum(AZIMUTHS)])[ring]
    return np.asarray(first + np.mod(np.round(turn * many).astype(np.intp), many))


def _draws() -> FloatArray:
    """(_DRAWS, 4) even points of the unit cube (additive recurrence)."""
    root = 1.1673039782614187  # of x⁵ = x + 1
    return np.mod(0.5 + np.arange(1, _DRAWS + 1)[:, None] * root ** -np.arange(1.0, 5.0), 1.0)


def _within(patch: npt.NDArray[np.intp], draws: FloatArray) -> FloatArray:
    """(P, _DRAWS, 3) unit vectors within P patches, even in projected solid angle."""
    first = np.cumsum(AZIMUTHS)
    ring = np.searchsorted(first, patch, side="right")
    many = np.array(AZIMUTHS)[ring]
    inner, outer = (np.sin(np.radians(np.array(EDGES_DEG)[ring + n])) ** 2 for n in (0, 1))
    radius = np.sqrt(inner[:, None] + draws[:, 0] * (outer - inner)[:, None])
    turn = 2.0 * np.pi * ((patch - first[ring] + many)[:, None] + draws[:, 1] - 0.5) / many[:, None]
    return np.stack(
        [radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1.0 - np.minimum(radius, 1.0) ** 2)], axis=-1
    )


def _basis() -> ET.Element:
    basis = ET.Element("AngleBasis")
    ET.SubElement(basis, "AngleBasisName").text = BASIS
    for low, high, many in zip(EDGES_DEG, EDGES_DEG[1:], AZIMUTHS, strict=False):
        block = ET.SubElement(basis, "AngleBasisBlock")
        ET.SubElement(block, "Theta").text = f"{0.0 if low == 0.0 else 0.5 * (low + high):g}"
        ET.SubElement(block, "nPhis").text = str(many)
        bounds = ET.SubElement(block, "ThetaBounds")
        ET.SubElement(bounds, "LowerTheta").text = f"{low:g}"
        ET.SubElement(bounds, "UpperTheta").text = f"{high:g}"
    return basis


KLEMS = BsdfFile("klems", "Klems XML", is_xml, read_klems, 4)
