"""AQDEF files (Q-DAS ASCII transfer format): measured values for SPC programs, and nominal values from them.

A description (K1xxx of the part, K2xxx of its characteristics, K4xxx catalogues) and lines of values, together in one
``.dfq`` or apart in ``.dfd`` and ``.dfx``. In a line of values the characteristics are separated by SI (15) and their
fields by DC4 (20): value, attribute, time, events, batch, nest, operator, machine. An attribute of 256 marks a missing
value and 255 an invalid one. ``K0014/0`` and ``K0061/0`` before a line are serial number and verdict of its part.

Limits are K2110 and K2111, or allowances K2112 and K2113 from the nominal value K2101; where K2120 or K2121 is 2, a
limit is a natural one, such as 0 of a distance, and no tolerance. ``K2xxx/0`` holds for all characteristics.

Operators, stations (machines), cavities (nests) and verdicts are numbers of catalogues: K4092, K4063, K4252 and, free
for the user, K4273. Times have no zone: those of this computer.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.regular_file import bounded_bytes

CHARACTERISTIC, FIELD = "\x0f", "\x14"
MARK = "\ufeff"
"""Begins a file, which is UTF-8: other programs guess what has none, and the signs between fields mislead them."""
MISSING, INVALID_VALUE = 256, 255
SUFFIXES = (".dfq", ".dfd", ".dfx")
TIME = "%d.%m.%Y/%H:%M:%S"
NATURAL = "2"
Limits = tuple[float | None, float | None]
CATALOGUES = {"operator": "K4092", "station": "K4063", "cavity": "K4252", "verdict": "K4273"}
_FIELDS = {"cavity": 5, "operator": 6, "station": 7}
_KEYS = {"K0014": "serial", "K0061": "verdict"}


@dataclass(frozen=True, eq=False)
class AqdefFile:
    """One part and its measured values.

    Attributes:
        product: number of the part (K1001).
        texts: N words by column: time, serial, lot, cavity, operator, station, verdict.
        numbers: (N,) values by characteristic; NaN where none was measured.
        limits: lower and upper limit of characteristics that have one.
        nominal: nominal values of characteristics that have one.
        units: units of characteristics (K2142), such as "deg" or "1", as far as they are stated.
    """

    product: str
    texts: Mapping[str, tuple[str, ...]]
    numbers: Mapping[str, FloatArray]
    limits: Mapping[str, Limits]
    nominal: Mapping[str, float]
    units: Mapping[str, str] = field(default_factory=dict)


def description_lines(found: AqdefFile) -> Iterator[str]:
    """The description: part, characteristics with their limits, catalogues; behind the mark of its file."""
    yield MARK
    yield _line("K0100", len(found.numbers))
    yield _line("K1001/1", found.product)
    for number, name in enumerate(found.numbers, start=1):
        yield _line(f"K2001/{number}", number)
        yield _line(f"K2002/{number}", name)
        yield _line(f"K2004/{number}", 0)
        if name in found.units:
            yield _line(f"K2142/{number}", found.units[name])
        if name in found.nominal:
            yield _line(f"K2101/{number}", _text(found.nominal[name]))
        for key, limit in zip(("K2110", "K2111"), found.limits.get(name, (None, None)), strict=True):
            if limit is not None:
                yield _line(f"{key}/{number}", _text(limit))
    for column, key in CATALOGUES.items():
        for number, word in enumerate(_catalogue(found, column), start=1):
            yield _line(f"{key}/{number}", word)


def value_lines(found: AqdefFile, time_of: Callable[[str], str] = str) -> Iterator[str]:
    """The values: a line an inspection, before it its serial number and verdict; `MARK` goes before a file of them.

    Args:
        found: the values.
        time_of: makes of a time of ``found`` what stands in the file, as `TIME` has it.
    """
    catalogues = {
        column: {word: k for k, word in enumerate(_catalogue(found, column), 1)} for column in CATALOGUES
    }

    def number(column: str, place: int) -> int:
        return catalogues[column].get(_word(found, column, place), 0)

    for place in range(len(next(iter(found.numbers.values())))):
        serial, verdict = _word(found, "serial", place), _word(found, "verdict", place)
        if serial:
            yield _line("K0014/0", serial)
        if verdict:
            yield _line("K0061/0", number("verdict", place))
        rest = [time_of(_word(found, "time", place)), "", _word(found, "lot", place)]
        rest += [str(number(column, place)) for column in ("cavity", "operator", "station")]
        fields = []
        for values in found.numbers.values():
            value = float(values[place])
            attribute = 0 if math.isfinite(value) else INVALID_VALUE if verdict == "INVALID" else MISSING
            fields.append(FIELD.join([_text(0.0 if attribute else value), str(attribute), *rest]))
        yield CHARACTERISTIC.join(fields) + "\r\n"


def _catalogue(found: AqdefFile, column: str) -> list[str]:
    return [word for word in dict.fromkeys(_plain(one) for one in found.texts.get(column, ())) if word]


def _word(found: AqdefFile, column: str, place: int) -> str:
    return _plain(found.texts[column][place]) if column in found.texts else ""


def _plain(text: str) -> str:
    """A text without the signs that separate lines and fields."""
    return "".join(" " if ord(sign) < 32 else sign for sign in text).strip()


def _line(key: str, value: object) -> str:
    return f"{key} {_plain(str(value))}\r\n"


def _text(value: float) -> str:
    return repr(float(value))


def read_aqdef(path: Path) -> AqdefFile:
    """Read a ``.dfq``, or a ``.dfd`` with the ``.dfx`` next to it (either may be named).

    Raises:
        UsageError: a file cannot be read, a line cannot be used, or it has more than one part; the line is named.
    """
    if path.suffix.lower() == ".dfq":
        sources = [path]
    else:
        sources = [path.with_suffix(_like(path, suffix)) for suffix in (".dfd", ".dfx")]
        if not sources[1].is_file() and path.suffix.lower() == ".dfd":
            sources = sources[:1]
    reader = _Reader(path)
    for source in sources:
        for number, line in enumerate(_decoded(source).splitlines(), start=1):
            if line.strip():
                reader.take(line, f"{source}, line {number}")
    return reader.file()


def _like(path: Path, suffix: str) -> str:
    return suffix.upper() if path.suffix.isupper() else suffix


def _decoded(path: Path) -> str:
    try:
        data = bounded_bytes(path)
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


class _Reader:
    """State while lines come."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.part: dict[str, str] = {}
        self.characteristics: dict[int, dict[str, str]] = {}
        self.common: dict[str, str] = {}
        self.catalogues: dict[str, dict[int, str]] = {column: {} for column in CATALOGUES}
        self.count: int | None = None
        self.rows: list[tuple[list[float], dict[str, str]]] = []
        self.next: dict[str, str] = {}

    def take(self, line: str, place: str) -> None:
        """One line."""
        if line[0] != "K":
            self._values(line, place)
            return
        head, _, value = line.partition(" ")
        key, _, index_text = head.partition("/")
        if not key[1:].isdigit() or (index_text and not index_text.isdigit()):
            raise UsageError(f"{place}: {head!r} is no key such as K2002/1")
        index, value = int(index_text or 1), value.strip()
        column = next((column for column, one in CATALOGUES.items() if one == key), None)
        if key == "K0100":
            self.count = int(_number(value, place))
        elif column is not None:
            self.catalogues[column][index] = value
        elif key in _KEYS:
            self.next[_KEYS[key]] = self._named("verdict", value, place) if key == "K0061" else value
        elif key in ("K0001", "K0002", "K0004"):
            raise UsageError(
                f"{place}: values by keys ({key}) are not read; let the other program write lines of values"
            )
        elif key.startswith("K1"):
            if index > 1:
                raise UsageError(f"{place}: a second part: write one part a file")
            self.part[key] = value
        elif key.startswith("K2"):
            (self.characteristics.setdefault(index, {}) if index else self.common)[key] = value

    def _values(self, line: str, place: str) -> None:
        portions = line.split(CHARACTERISTIC)
        if not self.characteristics:
            raise UsageError(
                f"{place}: values before any characteristic (K2002): is the description (.dfd) missing?"
            )
        if len(portions) != len(self.characteristics):
            raise UsageError(
                f"{place}: {len(self.characteristics)} characteristics are described, {len(portions)} values found"
            )
        values, words = [], dict.fromkeys(("time", "lot", *_FIELDS), "")
        for portion in portions:
            fields = [one.strip() for one in portion.split(FIELD)]
            attribute = fields[1] if len(fields) > 1 else ""
            gone = attribute in (str(MISSING), str(INVALID_VALUE))
            values.append(math.nan if gone else _number(fields[0], place))
            if len(fields) > 2 and fields[2]:
                words["time"] = _moment(fields[2], place)
            if len(fields) > 4 and fields[4]:
                words["lot"] = fields[4].removeprefix("#")
            for column, at in _FIELDS.items():
                if len(fields) > at and fields[at] not in ("", "0"):
                    words[column] = self._named(column, fields[at], place)
        self.rows.append((values, words | self.next))
        self.next = {}

    def _named(self, column: str, value: str, place: str) -> str:
        """Word of a catalogue; numbers without a catalogue of their kind stay numbers."""
        known = self.catalogues[column]
        if not value.isdigit():
            raise UsageError(
                f"{place}: {column} {value!r} is no number of the catalogue {CATALOGUES[column]}"
            )
        if known and int(value) not in known:
            raise UsageError(f"{place}: {column} {value} is not in the catalogue {CATALOGUES[column]}")
        return known.get(int(value), value)

    def file(self) -> AqdefFile:
        """What was read."""
        order = sorted(self.characteristics)
        if not order:
            raise UsageError(f"{self.path}: no characteristic (K2002) is described")
        if self.count is not None and self.count != len(order):
            raise UsageError(
                f"{self.path}: K0100 says {self.count} characteristics, {len(order)} are described"
            )
        described = [self.common | self.characteristics[index] for index in order]
        names = [
            one.get("K2002") or one.get("K2001") or str(index)
            for index, one in zip(order, described, strict=True)
        ]
        if len(set(names)) < len(names):
            double = next(name for name in names if names.count(name) > 1)
            raise UsageError(f"{self.path}: two characteristics are named {double!r}")

        def number(one: Mapping[str, str], key: str) -> float | None:
            return _number(one[key], f"{self.path}, {key}") if one.get(key) else None

        def limit(name: str, one: Mapping[str, str], key: str, allowance: str, sort: str) -> float | None:
            nominal, given, distance = number(one, "K2101"), number(one, key), number(one, allowance)
            if one.get(sort) == NATURAL:
                return None
            if given is not None or distance is None:
                return given
            if nominal is None:
                raise UsageError(
                    f"{self.path}: {name!r} has the allowance {allowance} and no nominal value (K2101) it counts from"
                )
            return nominal + distance

        characteristics = list(zip(names, described, strict=True))
        pairs = {
            name: (
                limit(name, one, "K2110", "K2112", "K2120"),
                limit(name, one, "K2111", "K2113", "K2121"),
            )
            for name, one in characteristics
        }
        nominal = {name: number(one, "K2101") for name, one in characteristics}
        words: Sequence[str] = ("time", "lot", *_FIELDS, *_KEYS.values())
        texts = {one: tuple(row.get(one, "") for _, row in self.rows) for one in words}
        table = np.array([values for values, _ in self.rows], dtype=np.float64).reshape(-1, len(names))
        return AqdefFile(
            self.part.get("K1001", ""),
            {name: column for name, column in texts.items() if any(column)},
            {name: table[:, k] for k, name in enumerate(names)},
            {name: pair for name, pair in pairs.items() if pair != (None, None)},
            {name: value for name, value in nominal.items() if value is not None},
            {name: one["K2142"] for name, one in characteristics if one.get("K2142")},
        )


def _number(text: str, place: str) -> float:
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{place}: {text!r} is not a finite number")
    return value


def _moment(text: str, place: str) -> str:
    """A time with day and month as written by `TIME`, or by ISO 8601, as ISO 8601."""
    for way in (TIME, "%d.%m.%y/%H:%M:%S", "%d.%m.%Y/%H:%M", "%d.%m.%Y %H:%M:%S"):
        try:
            return datetime.strptime(text, way).isoformat(" ")  # noqa: DTZ007 - the format has no zone
        except ValueError:
            continue
    try:
        return datetime.fromisoformat(text.replace("/", " ")).isoformat(" ")
    except ValueError:
        raise UsageError(f"{place}: {text!r} is no time such as 31.12.2026/23:59:59") from None
