"""The simulated press as a server: its NodeSets, and that it uses names and types of theirs."""

import xml.etree.ElementTree as ET

from anisoscope.sim.press_server import DATA, FIELDS, NODESETS, UNIT

UA = "{http://opcfoundation.org/UA/2011/03/UANodeSet.xsd}"


def children(name, parent):
    """Data types by browse name of what a type of a NodeSet has."""
    root = ET.parse(DATA / f"Opc.Ua.PlasticsRubber.{name}.NodeSet2.xml").getroot()
    found = [node for node in root if node.get("ParentNodeId") == parent]
    return {node.get("BrowseName").split(":")[1]: node.get("DataType") for node in found}


def test_fields_are_those_of_the_types_of_the_specification():
    cycle = children("GeneralTypes", "ns=1;i=1038")
    unit, zone = children("IMM2MES", "ns=1;i=1039"), children("GeneralTypes", "ns=1;i=1047")
    for field, _ in FIELDS.values():
        part, _, name = field.rpartition("/")
        kind = (unit if part == UNIT else zone if part else cycle)[name]
        assert kind in {"Double", "Duration"}
    assert cycle["MachineCycleCounter"] == cycle["JobCycleCounter"] == "UInt64"
    assert cycle["PartId"] == "String"


def test_the_licence_of_the_nodesets_goes_with_them():
    for name in NODESETS:
        assert "OPC Foundation MIT License 1.00" in (DATA / f"Opc.Ua.{name}.NodeSet2.xml").read_text()[:600]
