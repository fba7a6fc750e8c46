"""LBNL's XML of window elements, the frame of Klems matrices and of tensor trees.

Written is "Reflection Back": Radiance puts it on the side of the surface normal (it calls "front" what WINDOW calls
"back"), and what a renderer sees is the surface. Incident directions are those in which light travels, less their
component along the normal: light at azimuth φ stands in them at φ + 180°. Radiance takes negative values as 0.
"""

from pathlib import Path
from xml.etree import ElementTree as ET

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import UsageError
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes

SIDE = "Reflection Back"


def is_xml(head: bytes) -> bool:
    """Whether the first bytes of a file are those of XML."""
    return head.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(b"<")


def write_window_element(
    path: Path, name: str, structure: str, bases: dict[str, str], data: str, basis: ET.Element | None = None
) -> None:
    """Write one block of reflection.

    Args:
        path: the file.
        name: of the material.
        structure: "Columns", "TensorTree3" or "TensorTree4".
        bases: elements of the block that name its angle bases.
        data: text of its values, BRDFs in 1/sr.
        basis: definition of the angle basis, where the format has one.

    Raises:
        RecordError: the file cannot be written.
    """
    root = ET.Element("WindowElement", xmlns="http://windows.lbl.gov")
    ET.SubElement(root, "WindowElementType").text = "System"
    ET.SubElement(root, "FileType").text = "BSDF"
    layer = ET.SubElement(ET.SubElement(root, "Optical"), "Layer")
    material = ET.SubElement(layer, "Material")
    ET.SubElement(material, "Name").text = name
    ET.SubElement(material, "Manufacturer").text = "anisoscope"
    ET.SubElement(material, "DeviceType").text = "Other"
    definition = ET.SubElement(layer, "DataDefinition")
    ET.SubElement(definition, "IncidentDataStructure").text = structure
    if basis is not None:
        definition.append(basis)
    wavelengths = ET.SubElement(layer, "WavelengthData")
    ET.SubElement(wavelengths, "LayerNumber").text = "System"
    ET.SubElement(wavelengths, "Wavelength", unit="Integral").text = "Visible"
    block = ET.SubElement(wavelengths, "WavelengthDataBlock")
    ET.SubElement(block, "WavelengthDataDirection").text = SIDE
    for tag, text in bases.items():
        ET.SubElement(block, tag).text = text
    ET.SubElement(block, "ScatteringDataType").text = "BRDF"
    ET.SubElement(block, "ScatteringData").text = data
    ET.indent(root)
    write_text(
        path, '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
    )


class WindowElement:
    """A file that was read: its reflection on the side of the surface normal.

    Attributes:
        path: of the file.
        name: of the material.
        structure: of its incident data.
        block: the data.

    Raises:
        UsageError: no such file, damaged, or without a reflection.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            root = ET.fromstring(bounded_bytes(path, MOST_PICTURE_BYTES))  # noqa: S314 - expat refuses entities that grow
        except OSError as problem:
            raise UsageError(f"cannot read {path}: {problem.strerror or problem}") from problem
        except ET.ParseError as problem:
            raise UsageError(f"{path}: damaged XML: {problem}") from problem
        for element in root.iter():
            element.tag = element.tag.rpartition("}")[2]
        self.name = root.findtext(".//Material/Name", "").strip() or path.stem
        self.structure = root.findtext(".//IncidentDataStructure", "Columns").strip()
        colours = [
            data
            for data in root.iter("WavelengthData")
            if data.findtext("Wavelength", "").strip() == "Visible"
        ]
        blocks = {
            block.findtext("WavelengthDataDirection", "").strip(): block
            for data in (colours or [root])
            for block in data.iter("WavelengthDataBlock")
        }
        found = blocks.get(SIDE, blocks.get("Reflection Front"))
        if found is None:
            raise UsageError(f"{path}: holds no reflection (found: {', '.join(blocks) or 'no data block'})")
        self.block = found

    def text(self, tag: str) -> str:
        """Text of an element of the block."""
        return self.block.findtext(tag, "").strip()
