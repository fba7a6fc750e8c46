"""Arguments and types of OPC UA as a NodeSet states them, for what asyncua leaves to its user.

asyncua passes arguments of any type to a method, and takes types without fields of their own for their base. Here
arguments are compared with the signature of their method, and such types get a definition.
"""

import contextlib
import copy
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, cast

from asyncua import Node, Server, ua
from asyncua.ua.uaerrors import UaError

from anisoscope.base.errors import UsageError

NAMESPACE = "http://opcfoundation.org/UA/MachineVision"
VERSION = "1.0.0"
NODESET = Path(__file__).parent / "data" / "Opc.Ua.MachineVision.NodeSet2.xml"
IDS = ("RecipeIdExternalDataType", "RecipeIdInternalDataType", "ConfigurationIdDataType")
"""Types without fields of their own: without a definition asyncua takes their base for them."""
WRONG = object()
"""Stands for the value of an argument of another type."""
_STRUCTURES = {
    3002: "RecipeIdExternalDataType",
    3003: "ProductIdDataType",
    3004: "PartIdDataType",
    3008: "ConfigurationIdDataType",
    3013: "RecipeIdInternalDataType",
    3015: "MeasIdDataType",
    3016: "JobIdDataType",
    3021: "ResultIdDataType",
    3005: "ProcessingTimesDataType",
    3006: "ResultDataType",
    3007: "ConfigurationDataType",
}
"""Structures of the NodeSet by the numbers of their data types."""
_BUILTIN = {
    3009: ua.VariantType.Int32,
    3014: ua.VariantType.Int32,
    3017: ua.VariantType.String,
    3018: ua.VariantType.UInt32,
}
"""Of the NodeSet's other data types, what goes over the wire."""


class BadCall(Exception):
    """A call that is answered with a status: for its state, or for arguments by their numbers."""

    def __init__(self, status: int, arguments: Sequence[int] = ()) -> None:
        super().__init__(status)
        self.status, self.arguments = status, arguments


def input_value(given: ua.Variant, wanted: ua.Argument, namespace: int) -> Any:  # noqa: ANN401 - of any type
    """The value of an input argument, or `WRONG` where its type is not that of the signature."""
    value = given.Value
    if wanted.ValueRank == 1:
        return (
            [] if value is None else _elements(given) if given.is_array and isinstance(value, list) else WRONG
        )
    if given.is_array:
        return WRONG
    expected = wanted.DataType
    structure = getattr(ua, _STRUCTURES.get(expected.Identifier, ""), None)
    if expected.NamespaceIndex == namespace and structure is not None:
        if value is None:
            return structure()
        return value if getattr(type(value), "data_type", None) == expected else WRONG
    base = _BUILTIN.get(expected.Identifier if expected.NamespaceIndex else 0)
    base = base or ua.VariantType(expected.Identifier)
    return value if given.VariantType == base and value is not None else WRONG


def paired(
    given: Sequence[ua.Variant], wanted: list[ua.Argument]
) -> Iterable[tuple[ua.Variant, ua.Argument]]:
    """Each argument with its place in the signature.

    Raises:
        BadCall: there are fewer or more than the signature has.
    """
    if len(given) < len(wanted):
        raise BadCall(ua.StatusCodes.BadArgumentsMissing)
    if len(given) > len(wanted):
        raise BadCall(ua.StatusCodes.BadTooManyArguments)
    return zip(given, wanted, strict=True)


def _elements(given: ua.Variant) -> list[Any]:
    """Elements of an array; those of an array of Variants are taken out of them."""
    return [one.Value if isinstance(one, ua.Variant) else one for one in given.Value]


def empty_value(argument: ua.Argument) -> Any:  # noqa: ANN401 - of any type
    """An output argument of a call that found nothing."""
    if argument.ValueRank == 1:
        return []
    structure = getattr(ua, _STRUCTURES.get(argument.DataType.Identifier, ""), None)
    if argument.DataType.NamespaceIndex and structure is not None:
        return structure()
    kind = _BUILTIN.get(argument.DataType.Identifier, ua.VariantType.Null)
    return False if argument.DataType.Identifier == ua.ObjectIds.Boolean else 0 if kind else _NOTHING


_NOTHING = ua.Variant(None)


def output_variant(value: Any, argument: ua.Argument) -> ua.Variant:  # noqa: ANN401
    """An output argument as its signature says."""
    if isinstance(value, ua.Variant):
        return value
    number, own = argument.DataType.Identifier, argument.DataType.NamespaceIndex
    is_array = argument.ValueRank == 1
    if own and number in _STRUCTURES:
        kind = ua.VariantType.ExtensionObject
    elif own:
        kind = _BUILTIN[number]
    elif number == ua.ObjectIds.UtcTime:
        kind = ua.VariantType.DateTime
    else:
        kind = ua.VariantType.Variant if number == ua.ObjectIds.BaseDataType else ua.VariantType(number)
    return ua.Variant(value, kind, is_array=is_array)


def check_nodeset(path: Path) -> None:
    """Refuse another NodeSet.

    Raises:
        UsageError: it is not that of OPC 40100-1, version 1.0.0, or cannot be read.
    """
    try:
        text = path.read_bytes()
    except OSError as problem:
        raise UsageError(f"{path}: the NodeSet cannot be read: {problem.strerror}") from None
    head = text[:8192].decode("utf-8", "replace")
    if f'ModelUri="{NAMESPACE}" Version="{VERSION}"' not in head:
        raise UsageError(f"{path}: this is not the NodeSet of {NAMESPACE}, version {VERSION}")
    try:
        ET.fromstring(text)  # noqa: S314 - a file of this package
    except ET.ParseError as problem:
        raise UsageError(f"{path}: the NodeSet is damaged: {problem}") from None


async def import_nodeset(server: Server, path: Path) -> int:
    """Read the NodeSet into a server; index of its namespace."""
    await server.import_xml(path)
    return cast("int", await server.get_namespace_index(NAMESPACE))


async def define_ids(server: Server, namespace: int) -> None:
    """Give the types without fields of their own the definition of their base, with their own encodings."""
    for name in IDS:
        number = next(key for key, one in _STRUCTURES.items() if one == name)
        node = server.get_node(ua.NodeId(number, namespace))
        base = await server.get_node(ua.NodeId(3019, namespace)).read_data_type_definition()
        definition = copy.deepcopy(base)
        definition.BaseDataType = ua.NodeId(3019, namespace)
        for encoding in await node.get_referenced_nodes(ua.ObjectIds.HasEncoding):
            if (await encoding.read_browse_name()).Name == "Default Binary":
                definition.DefaultEncodingId = encoding.nodeid
        if getattr(getattr(ua, name, None), "data_type", None) != node.nodeid:
            with contextlib.suppress(AttributeError):
                delattr(ua, name)  # that of the base, under this name
        value = ua.DataValue(ua.Variant(definition, ua.VariantType.ExtensionObject))
        await server.write_attribute_value(node.nodeid, value, ua.AttributeIds.DataTypeDefinition)


async def subtypes(node: Node) -> list[Node]:
    """A type and all types below it."""
    found = [node]
    for child in await node.get_referenced_nodes(ua.ObjectIds.HasSubtype, ua.BrowseDirection.Forward):
        found += await subtypes(child)
    return found


async def named_children(node: Node) -> dict[str, Node]:
    """Children of a node by their browse names."""
    return {(await child.read_browse_name()).Name: child for child in await node.get_children()}


async def signature_of(method: Node) -> tuple[list[ua.Argument], list[ua.Argument]]:
    """Input and output arguments of a method, as the NodeSet states them."""
    found: list[list[ua.Argument]] = []
    for name in ("InputArguments", "OutputArguments"):
        try:
            found.append(await (await method.get_child(ua.QualifiedName(name))).read_value() or [])
        except UaError:
            found.append([])
    return found[0], found[1]
