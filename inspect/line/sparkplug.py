"""Sparkplug B: topics, payloads and sequence numbers of an edge node with one device.

The numbers of fields and data types are those of the specification (Eclipse Sparkplug 3.0, chapters 4 and 6); its
.proto file is not used: the messages are described here for the library protobuf. Values are limited to numbers, truth
values, texts and moments; other kinds are refused.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from anisoscope.base.errors import UsageError

NAMESPACE = "spBv1.0"
REBIRTH, BD_SEQ = "Node Control/Rebirth", "bdSeq"
LARGEST = 65_536
"""Bytes of a command; larger ones are refused unread."""
Value = bool | int | float | str | None
Kind = Literal["Int64", "Double", "Boolean", "String", "DateTime"]
CODES: Mapping[str, int] = {"Int64": 4, "Double": 10, "Boolean": 11, "String": 12, "DateTime": 13}
_SEQUENCES = 256
_NAME = re.compile(r"[^/+#\x00-\x1f\x7f]{1,100}")

_FIELD = descriptor_pb2.FieldDescriptorProto
_VALUES = (
    ("int_value", 10, _FIELD.TYPE_UINT32),
    ("long_value", 11, _FIELD.TYPE_UINT64),
    ("float_value", 12, _FIELD.TYPE_FLOAT),
    ("double_value", 13, _FIELD.TYPE_DOUBLE),
    ("boolean_value", 14, _FIELD.TYPE_BOOL),
    ("string_value", 15, _FIELD.TYPE_STRING),
)
_METRIC = (
    ("name", 1, _FIELD.TYPE_STRING),
    ("alias", 2, _FIELD.TYPE_UINT64),
    ("timestamp", 3, _FIELD.TYPE_UINT64),
    ("datatype", 4, _FIELD.TYPE_UINT32),
    ("is_historical", 5, _FIELD.TYPE_BOOL),
    ("is_null", 7, _FIELD.TYPE_BOOL),
)


def _payload_class() -> Any:  # noqa: ANN401 - made by protobuf
    file = descriptor_pb2.FileDescriptorProto(
        name="anisoscope/sparkplug", package="anisoscope", syntax="proto2"
    )
    metric = file.message_type.add(name="Metric")
    for name, number, kind in _METRIC:
        metric.field.add(name=name, number=number, type=kind, label=_FIELD.LABEL_OPTIONAL)
    metric.oneof_decl.add(name="value")
    for name, number, kind in _VALUES:
        metric.field.add(name=name, number=number, type=kind, label=_FIELD.LABEL_OPTIONAL, oneof_index=0)
    payload = file.message_type.add(name="Payload")
    payload.field.add(name="timestamp", number=1, type=_FIELD.TYPE_UINT64, label=_FIELD.LABEL_OPTIONAL)
    payload.field.add(
        name="metrics",
        number=2,
        type=_FIELD.TYPE_MESSAGE,
        type_name=".anisoscope.Metric",
        label=_FIELD.LABEL_REPEATED,
    )
    payload.field.add(name="seq", number=3, type=_FIELD.TYPE_UINT64, label=_FIELD.LABEL_OPTIONAL)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("anisoscope.Payload"))


_PAYLOAD = _payload_class()


class MalformedError(UsageError):
    """A message that is no Sparkplug B command of ours; says why in one line."""


@dataclass(frozen=True)
class Metric:
    """A named value.

    Attributes:
        name: such as ``Result/Verdict``.
        kind: of the value; "" where a command did not state it.
        value: None for none.
        is_historical: it could not be sent when it was new.
    """

    name: str
    kind: Kind | Literal[""]
    value: Value
    is_historical: bool = False


def encoded(metrics: Sequence[Metric], now: datetime, seq: int | None) -> bytes:
    """A payload.

    Args:
        metrics: in this order.
        now: UTC.
        seq: sequence number; None for a death, which has none.
    """
    moment = milliseconds(now)
    payload = _PAYLOAD(timestamp=moment)
    if seq is not None:
        payload.seq = seq
    for one in metrics:
        metric = payload.metrics.add(name=one.name, timestamp=moment, datatype=CODES[one.kind])
        if one.is_historical:
            metric.is_historical = True
        if one.value is None or (isinstance(one.value, float) and not math.isfinite(one.value)):
            metric.is_null = True
        elif one.kind == "Boolean":
            metric.boolean_value = bool(one.value)
        elif one.kind == "Double":
            metric.double_value = float(one.value)
        elif one.kind == "String":
            metric.string_value = str(one.value)
        else:
            metric.long_value = int(one.value) % 2**64  # two's complement
    return bytes(payload.SerializeToString())


def decoded(data: bytes) -> list[Metric]:
    """Metrics of a command.

    Raises:
        MalformedError: it is no payload, has no metrics, or one without a name, or of a kind that is not taken here.
    """
    if len(data) > LARGEST:
        raise MalformedError(f"the payload has {len(data)} bytes; {LARGEST} are taken at most")
    try:
        payload = _PAYLOAD.FromString(data)
    except DecodeError:
        raise MalformedError("it is no Sparkplug B payload") from None
    if not payload.metrics:
        raise MalformedError("it has no metrics")
    kinds = {code: kind for kind, code in CODES.items()}
    found = []
    for one in payload.metrics:
        if not one.name:
            raise MalformedError("a metric has no name")
        field = one.WhichOneof("value")
        value: Value = None if field is None or one.is_null else getattr(one, field)
        kind = kinds.get(one.datatype, "")
        if one.datatype and not kind:
            raise MalformedError(
                f"the metric {one.name[:80]!r} has the data type {one.datatype}, which is not taken here"
            )
        found.append(Metric(one.name, kind, value))  # type: ignore[arg-type]
    return found


def milliseconds(moment: datetime) -> int:
    """Milliseconds since 1970."""
    return int(moment.timestamp() * 1000.0)


def checked_name(name: str, what: str) -> str:
    """Checked name of a group, node or device in a topic.

    Raises:
        UsageError: it may not.
    """
    if not _NAME.fullmatch(name):
        raise UsageError(
            f"{what} {name[:40]!r} cannot be part of a topic: 1 to 100 characters, none of / + #"
        )
    return name


class Sequence256:
    """Numbers 0 to 255 that come one after the other, and again."""

    def __init__(self, last: int | None = None) -> None:
        self._last = -1 if last is None else last

    def next(self) -> int:
        """The next number; 0 at first, and after 255."""
        self._last = (self._last + 1) % _SEQUENCES
        return self._last

    def restart(self) -> None:
        """Begin with 0 again."""
        self._last = -1


@dataclass(frozen=True)
class Names:
    """Names of an edge node and its device in topics."""

    group: str
    node: str
    device: str

    def __post_init__(self) -> None:
        for name in ("group", "node", "device"):
            checked_name(getattr(self, name), f"--{name}")

    def topic(self, kind: str) -> str:
        """Topic of a kind of message: NBIRTH, DDATA, ..."""
        base = f"{NAMESPACE}/{self.group}/{kind}/{self.node}"
        return base if kind.startswith("N") else f"{base}/{self.device}"

    def plain(self, what: str) -> str:
        """Topic of plain JSON: result, state, order, stop, answer."""
        return f"anisoscope/{self.group}/{self.node}/{what}"
