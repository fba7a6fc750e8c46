"""Read and write gwy files, Gwyddion's own format: a tree of named, typed items.

``GWYP``, then one object: its type and NUL, four bytes of size, and items of name, NUL, a letter for the type, and the
value; a capital letter is an array with four bytes of length before it. Channel n is ``/n/data``, a ``GwyDataField``;
``/n/mask`` marks points of it. Format: https://gwyddion.net/documentation/user-guide-en/gwyfile-format.html.
"""

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.checks import check_claim, checked_map, refuse
from anisoscope.profiles.files.content import DAMAGED, Content, load_content, scaled
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.units import STATED_MICROMETRES_PER, chosen_channel
from anisoscope.profiles.heightmap import COLOUR, INTENSITY, INTERPOLATED, HeightMap, Layer

MAGIC = b"GWYP"
SIZES = {"b": 1, "c": 1, "i": 4, "q": 8, "d": 8}
NUMBERS = {"i": "<i4", "q": "<i8", "d": "<f8", "c": "u1"}
MOST_DEPTH = 16
MOST_ITEMS = 20_000
GREY = (INTENSITY, INTERPOLATED)
COLOURS = ("colour, red", "colour, green", "colour, blue")
CHANNEL = re.compile(r"/(\d{1,6})/data")


@dataclass(frozen=True)
class _Thing:
    """An object: its type and its items."""

    kind: str
    items: dict[str, Any]


class _Reader:
    """Walks through the items; numbers of arrays are views of the file."""

    def __init__(self, content: Content) -> None:
        self.content = content
        self.at = len(MAGIC)
        self.items = 0

    def broken(self, what: str) -> NoReturn:
        refuse(self.content.name, "content", what, DAMAGED)

    def take(self, count: int, end: int) -> bytes:
        if count < 0 or self.at + count > end:
            self.broken(f"an item at byte {self.at} goes beyond its object")
        found = self.content.data[self.at : self.at + count]
        self.at += count
        return found

    def text(self, end: int) -> str:
        stop = self.content.data.find(b"\0", self.at, end)
        if stop < 0:
            self.broken(f"a name at byte {self.at} does not end")
        found = self.content.data[self.at : stop].decode("utf-8", "replace")
        self.at = stop + 1
        return found

    def thing(self, end: int, depth: int = 0) -> _Thing:
        if depth > MOST_DEPTH:
            self.broken(f"objects nested deeper than {MOST_DEPTH} levels")
        kind = self.text(end)
        (size,) = struct.unpack("<I", self.take(4, end))
        stop = self.at + size
        if stop > end:
            self.broken(f"{kind[:40]} claims {size} bytes")
        items: dict[str, Any] = {}
        while self.at < stop:
            self.items += 1
            if self.items > MOST_ITEMS:
                self.broken("too many items")
            name = self.text(stop)
            items[name] = self.value(self.take(1, stop).decode("latin-1"), stop, depth)
        return _Thing(kind, items)

    def value(self, code: str, end: int, depth: int) -> Any:  # noqa: ANN401 - as the file says
        if code == "s":
            return self.text(end)
        if code == "o":
            return self.thing(end, depth + 1)
        if code in SIZES:
            raw = self.take(SIZES[code], end)
            return raw[0] if code in "bc" else np.frombuffer(raw, NUMBERS[code])[0].item()
        lower = code.lower()
        (count,) = struct.unpack("<I", self.take(4, end))
        if code == "S":
            return [self.text(end) for _ in range(min(count, MOST_ITEMS))]
        if code == "O":
            return [self.thing(end, depth + 1) for _ in range(min(count, MOST_ITEMS))]
        if lower not in NUMBERS or code == lower:
            self.broken(f"an item of type {code!r}")
        dtype = np.dtype(NUMBERS[lower])
        start = self.at
        self.take(count * dtype.itemsize, end)
        return np.frombuffer(self.content.data, dtype, count, start)


def _unit(field: _Thing, key: str) -> str | None:
    unit = field.items.get(key)
    return str(unit.items.get("unitstr", "")).strip() if isinstance(unit, _Thing) else None


def _why_not(field: object) -> str | None:
    """Why a channel is no height map; None if it is one."""
    if not (isinstance(field, _Thing) and field.kind == "GwyDataField"):
        return "is no data field"
    for axis, key in (("x and y", "si_unit_xy"), ("heights", "si_unit_z")):
        unit = _unit(field, key)
        if not unit:
            return f"has no unit of {axis}"
        if unit not in STATED_MICROMETRES_PER:
            return f"has {unit[:20]!r} as the unit of {axis}, which is no length"
    return None


def _count(name: str, field: _Thing, key: str) -> int:
    value = field.items.get(key)
    if not isinstance(value, int):
        refuse(name, key, repr(value)[:40], DAMAGED)
    return value


def _length(name: str, field: _Thing, key: str) -> float:
    value = field.items.get(key)
    if not isinstance(value, float):
        refuse(name, key, repr(value)[:40], DAMAGED)
    return abs(value)


def _grid(name: str, field: _Thing) -> FloatArray:
    rows, cols = _count(name, field, "yres"), _count(name, field, "xres")
    data = field.items.get("data")
    size = data.size if isinstance(data, np.ndarray) and data.dtype == np.float64 else 0
    check_claim(name, rows, cols, 1.0, size)
    assert isinstance(data, np.ndarray)
    if size != rows * cols:
        refuse(name, "data", f"{size} numbers for {rows} × {cols} points", DAMAGED)
    return data.reshape(rows, cols)


def read_gwy(path: Path | str, given: FileScales | None = None) -> HeightMap:
    """Read the channel of a gwy file that is given, else the first one that holds heights in lengths.

    Returns:
        (rows, cols) heights in µm in the order of the file, first row at the top of the picture
        (``origin["first_row"]``); points under the channel's mask are missing, and ``origin["mask"]`` says so. Channels
        of the same size with the titles that :func:`write_gwy` gives are layers, others are named in
        ``origin["other_channels"]``.

    Raises:
        HeightMapError: no channel of heights (and why), damaged, or implausible.
    """
    content = load_content(Path(path))
    name = content.name
    if given and given.pixel_um is not None:
        refuse(name, "units", "a gwy file states its own pixel", "leave the pixel size out")
    if not content.data.startswith(MAGIC):
        refuse(name, "header", "does not begin as it should", "this is no gwy file")
    items = _Reader(content).thing(len(content)).items
    channels = sorted((int(found[1]), key) for key in items if (found := CHANNEL.fullmatch(key)))
    reasons = {number: _why_not(items[key]) for number, key in channels}
    titles = {n: str(items.get(f"/{n}/data/title", f"channel {n}"))[:100] for n, _ in channels}
    number: int | None
    if given and given.channel is not None:
        number = list(titles)[chosen_channel(name, given.channel, list(titles.values()))]
        if reasons[number] is not None:
            refuse(name, f"channel {titles[number]!r}", reasons[number], "choose a channel of heights")
    else:
        number = next((number for number, reason in reasons.items() if reason is None), None)
    if number is None:
        told = "; ".join(f"channel {n} {reason}" for n, reason in list(reasons.items())[:3]) or "no channel"
        refuse(name, "content", told, "save it with a height channel in metres")
    field = items[f"/{number}/data"]
    raw = _grid(name, field)
    rows, cols = raw.shape
    lateral = STATED_MICROMETRES_PER[_unit(field, "si_unit_xy") or ""]
    factor = STATED_MICROMETRES_PER[_unit(field, "si_unit_z") or ""]
    pixel = _length(name, field, "yreal") / rows * lateral, _length(name, field, "xreal") / cols * lateral
    origin: dict[str, Any] = {"format": "gwy", "first_row": "top", "channel": titles.pop(number)}
    read = (*GREY, *COLOURS)
    if others := [title for title in titles.values() if title.casefold() not in read]:
        origin["other_channels"] = others
    missing = None
    if isinstance(mask := items.get(f"/{number}/mask"), _Thing):
        marked = _grid(name, mask)
        if marked.shape != raw.shape:
            refuse(name, "mask", f"{marked.shape} points for {raw.shape}", DAMAGED)
        missing = marked > 0.5
        origin["mask"] = "points under the mask are missing"
    layers = _layers(name, items, titles, raw.shape)
    return checked_map(name, scaled(raw, factor, missing), pixel, origin, stage_height=True, layers=layers)


def _layers(
    name: str, items: Mapping[str, Any], titles: Mapping[int, str], shape: tuple[int, ...]
) -> dict[str, FloatArray]:
    """Layers from channels of the same size, by their titles; points under their masks are missing."""
    numbers = {title.casefold(): number for number, title in titles.items()}

    def channel(title: str) -> FloatArray | None:
        number = numbers.get(title)
        field = items.get(f"/{number}/data")
        if not isinstance(field, _Thing) or (found := _grid(name, field)).shape != shape:
            return None
        mask = items.get(f"/{number}/mask")
        if not isinstance(mask, _Thing) or (marked := _grid(name, mask)).shape != shape:
            return found
        return np.where(marked > 0.5, np.nan, found)

    colours = [channel(title) for title in COLOURS]
    known = [one for one in colours if one is not None]
    found = {title: grey for title in GREY if (grey := channel(title)) is not None}
    return found | ({COLOUR: np.stack(known, axis=2)} if len(known) == len(COLOURS) else {})


def _item(name: str, code: str, value: bytes) -> bytes:
    return name.encode() + b"\0" + code.encode() + value


def _object(kind: str, *items: bytes) -> bytes:
    joined = b"".join(items)
    return kind.encode() + b"\0" + struct.pack("<I", len(joined)) + joined


def _field(values: FloatArray, surface: HeightMap, unit: str) -> bytes:
    rows, cols = surface.shape
    field_y, field_x = surface.extent_um
    metre, z_unit = (_object("GwySIUnit", _item("unitstr", "s", f"{one}\0".encode())) for one in ("m", unit))
    return _object(
        "GwyDataField",
        _item("xres", "i", struct.pack("<i", cols)),
        _item("yres", "i", struct.pack("<i", rows)),
        _item("xreal", "d", struct.pack("<d", field_x * 1e-6)),
        _item("yreal", "d", struct.pack("<d", field_y * 1e-6)),
        _item("si_unit_xy", "o", metre),
        _item("si_unit_z", "o", z_unit),
        _item("data", "D", struct.pack("<I", values.size) + values.astype("<f8").tobytes()),
    )


def _channels(surface: HeightMap) -> list[tuple[str, Layer]]:
    """Layers as channels with their titles."""
    found = [(title, surface.layers[title]) for title in GREY if title in surface.layers]
    if COLOUR in surface.layers:
        found += [(title, surface.layers[COLOUR][..., k]) for k, title in enumerate(COLOURS)]
    return found


def _layer_items(number: int, title: str, values: FloatArray, surface: HeightMap) -> list[bytes]:
    known = np.isfinite(values)
    items = [
        _item(f"/{number}/data", "o", _field(np.where(known, values, 0.0), surface, "")),
        _item(f"/{number}/data/title", "s", title.encode() + b"\0"),
    ]
    if not known.all():
        items.append(_item(f"/{number}/mask", "o", _field((~known).astype(np.float64), surface, "")))
    return items


def write_gwy(surface: HeightMap, path: Path | str) -> None:
    """Write a map as gwy: float64 metres; missing points have the mean height and lie under the mask.

    Layers are channels of their own: "intensity", "colour, red", "colour, green", "colour, blue".

    Raises:
        HeightMapError: the file cannot be written.
    """
    height = surface.height_um[::-1]
    known = np.isfinite(height)
    mean = float(height[known].mean()) if known.any() else 0.0
    title = "".join(
        letter for letter in str(surface.origin.get("file", "height map")) if letter.isprintable()
    )
    items = [
        _item("/0/data", "o", _field(np.where(known, height, mean) * 1e-6, surface, "m")),
        _item("/0/data/title", "s", title.encode() + b"\0"),
        _item("/0/data/visible", "b", b"\1"),
    ]
    if not known.all():
        items.append(_item("/0/mask", "o", _field((~known).astype(np.float64), surface, "")))
    for number, (title, values) in enumerate(_channels(surface), start=1):
        items += _layer_items(number, title, values[::-1].astype(np.float64), surface)
    try:
        Path(path).write_bytes(MAGIC + _object("GwyContainer", *items))
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be written ({error.strerror})") from None


GWY = Format("gwy", "Gwyddion gwy", (".gwy",), read_gwy, ((0, MAGIC),), channels=True, place=4)
