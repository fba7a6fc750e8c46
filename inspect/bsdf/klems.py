"""Klems matrices in LBNL's XML, as WINDOW and Radiance read them: mean BRDFs between 145 patches of the hemisphere.

The patches are those of the full basis. Light comes from a patch and leaves through a patch; a value is the mean of the
BRDF over both, weighted by projected solid angle. Written is "Reflection Back": Radiance puts it on the side of the
surface normal (it calls "front" what WINDOW calls "back"), and what a renderer sees is the surface. Columns are the
incident patches. An incident patch at azimuth φ holds light that *travels* toward φ: its source stands at φ + 180°.
"""

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.bsdf.reflectance import Reflectance, above_horizon

EDGES_DEG = (0.0, 5.0, 15.0, 25.0, 35.0, 45.0, 55.0, 65.0, 75.0, 90.0)
AZIMUTHS = (1, 8, 16, 20, 24, 24, 24, 16, 12)
PATCHES = sum(AZIMUTHS)
BASIS = "LBNL/Klems Full"
_DRAWS = 96
_SIDE = "Reflection Back"


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
    write_text(path, _document(reflectance.name, matrix))


def read_klems(path: Path) -> Reflectance:
    """Read a Klems matrix of the full basis: the reflection on the side of the surface normal.

    Raises:
        UsageError: no such file, another basis, or a matrix of another size.
    """
    try:
        root = ET.fromstring(path.read_bytes())  # noqa: S314 - expat refuses entities that grow
    except OSError as problem:
        raise UsageError(f"cannot read {path}: {problem.strerror or problem}") from problem
    except ET.ParseError as problem:
        raise UsageError(f"{path}: damaged XML: {problem}") from problem
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    blocks = {
        block.findtext("WavelengthDataDirection", "").strip(): block
        for block in root.iter("WavelengthDataBlock")
    }
    block = blocks.get(_SIDE, blocks.get("Reflection Front"))
    if block is None:
        raise UsageError(f"{path}: holds no reflection (found: {', '.join(blocks) or 'no data block'})")
    for axis in ("ColumnAngleBasis", "RowAngleBasis"):
        if block.findtext(axis, "").strip() != BASIS:
            raise UsageError(
                f"{path}: read are matrices of {BASIS}, not {block.findtext(axis, '').strip() or 'a tensor tree'!r}"
            )
    matrix = _matrix(block, path)
    if root.findtext(".//IncidentDataStructure", "Columns").strip() == "Rows":
        matrix = matrix.T

    def value(to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
        travels = to_light * np.array([-1.0, -1.0, 1.0])
        return np.asarray(matrix[patch_of(to_camera), patch_of(travels)])

    name = root.findtext(".//Material/Name", "").strip() or path.stem
    return Reflectance(name, lambda light, camera: above_horizon(light, camera, value))


def _matrix(block: ET.Element, path: Path) -> FloatArray:
    """(PATCHES, PATCHES) numbers of a data block as they stand there."""
    try:
        values = np.array(block.findtext("ScatteringData", "").replace(",", " ").split(), dtype=np.float64)
    except ValueError as problem:
        raise UsageError(f"{path}: ScatteringData holds something that is no number: {problem}") from None
    if values.size != PATCHES**2 or not np.isfinite(values).all():
        raise UsageError(
            f"{path}: ScatteringData has {values.size} numbers, {PATCHES} × {PATCHES} are expected"
        )
    return values.reshape(PATCHES, PATCHES)


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


def _document(name: str, matrix: FloatArray) -> str:
    root = ET.Element("WindowElement", xmlns="http://windows.lbl.gov")
    ET.SubElement(root, "WindowElementType").text = "System"
    ET.SubElement(root, "FileType").text = "BSDF"
    layer = ET.SubElement(ET.SubElement(root, "Optical"), "Layer")
    material = ET.SubElement(layer, "Material")
    ET.SubElement(material, "Name").text = name
    ET.SubElement(material, "Manufacturer").text = "anisoscope"
    ET.SubElement(material, "DeviceType").text = "Other"
    definition = ET.SubElement(layer, "DataDefinition")
    ET.SubElement(definition, "IncidentDataStructure").text = "Columns"
    basis = ET.SubElement(definition, "AngleBasis")
    ET.SubElement(basis, "AngleBasisName").text = BASIS
    for low, high, many in zip(EDGES_DEG, EDGES_DEG[1:], AZIMUTHS, strict=False):
        block = ET.SubElement(basis, "AngleBasisBlock")
        ET.SubElement(block, "Theta").text = f"{0.0 if low == 0.0 else 0.5 * (low + high):g}"
        ET.SubElement(block, "nPhis").text = str(many)
        bounds = ET.SubElement(block, "ThetaBounds")
        ET.SubElement(bounds, "LowerTheta").text = f"{low:g}"
        ET.SubElement(bounds, "UpperTheta").text = f"{high:g}"
    data = ET.SubElement(layer, "WavelengthData")
    ET.SubElement(data, "LayerNumber").text = "System"
    ET.SubElement(data, "Wavelength", unit="Integral").text = "Visible"
    block = ET.SubElement(data, "WavelengthDataBlock")
    ET.SubElement(block, "WavelengthDataDirection").text = _SIDE
    ET.SubElement(block, "ColumnAngleBasis").text = BASIS
    ET.SubElement(block, "RowAngleBasis").text = BASIS
    ET.SubElement(block, "ScatteringDataType").text = "BRDF"
    ET.SubElement(block, "ScatteringData").text = "\n".join(
        ", ".join(f"{value:.6g}" for value in row) + "," for row in matrix
    ).rstrip(",")
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
