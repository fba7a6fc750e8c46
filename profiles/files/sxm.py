"""Read sxm files of Nanonis scanning probe microscopes.

A header of tags (``:SCAN_PIXELS:`` and the lines under it) ends with ``:SCANIT_END:``; behind the bytes 1A 04 come
big-endian float32 pictures, channel after channel, forward before backward. Lines of a scan that went up begin at the
bottom; backward lines run from right to left. Structure: Nanonis "SXM file format", as open readers have it.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.checks import check_claim, checked_map, refuse
from anisoscope.profiles.files.content import DAMAGED, load_content, scaled
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.units import STATED_MICROMETRES_PER, chosen_channel
from anisoscope.profiles.heightmap import HeightMap

MAGIC = b":NANONIS_VERSION:"
END = re.compile(rb":SCANIT_END:\s*\x1a\x04")
TAG = re.compile(r":([^:]+):")


@dataclass(frozen=True)
class _Picture:
    name: str
    unit: str
    backward: bool


def _tags(text: str) -> dict[str, list[str]]:
    """Lines under each tag."""
    found: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in text.splitlines():
        tag = TAG.fullmatch(line.strip())
        if tag:
            lines = found.setdefault(tag[1], [])
        elif line.strip():
            lines.append(line.strip())
    return found


def _pictures(name: str, rows: list[str]) -> list[_Picture]:
    """Pictures in the order of the file, from the table of channels."""
    found = []
    for row in rows[1:]:
        fields = row.split("\t")
        if len(fields) < 4:
            refuse(name, "DATA_INFO", repr(row[:40]), DAMAGED)
        title, unit, direction = (field.strip() for field in fields[1:4])
        both = direction == "both"
        found += [_Picture(title, unit, backward=False)] if both or direction == "fwd" else []
        found += [_Picture(f"{title} backward", unit, backward=True)] if both or direction == "bwd" else []
    return found


def read_sxm(path: Path | str, given: FileScales | None = None) -> HeightMap:
    """Read the channel of an sxm file that is given, else the first one in a unit of length.

    Returns:
        (rows, cols) heights in µm, first row at the top of the picture.

    Raises:
        HeightMapError: no channel of heights, damaged, or implausible.
    """
    content = load_content(Path(path))
    name, given = content.name, given or FileScales()
    if given.pixel_um is not None:
        refuse(name, "units", "an sxm file states its own pixel", "leave the pixel size out")
    end = END.search(content.data)
    if end is None:
        refuse(name, "header", "has no end", DAMAGED)
    tags = _tags(content.data[: end.start()].decode("latin-1"))

    def numbers(tag: str) -> list[float]:
        try:
            found = [float(word) for word in " ".join(tags[tag]).split()[:2]]
        except (KeyError, ValueError):
            found = []
        if len(found) != 2 or not all(np.isfinite(one) and one > 0.0 for one in found):
            refuse(name, tag, " ".join(tags.get(tag, ["none"]))[:40], "two positive numbers are expected")
        return found

    cols, rows = (int(count) for count in numbers("SCAN_PIXELS"))
    width_m, height_m = numbers("SCAN_RANGE")
    pictures = _pictures(name, tags.get("DATA_INFO", []))
    names = [one.name for one in pictures]
    if given.channel is not None:
        chosen = chosen_channel(name, given.channel, names)
    else:
        chosen = next((k for k, one in enumerate(pictures) if one.unit in STATED_MICROMETRES_PER), -1)
    if chosen < 0 or pictures[chosen].unit not in STATED_MICROMETRES_PER:
        said = "; ".join(f"{one.name} in {one.unit}" for one in pictures)[:80] or "none"
        refuse(name, "channels", said, "a channel in a unit of length is needed")
    check_claim(name, rows, cols, 4 * len(pictures), len(content) - end.end())
    raw = content.grid(">f4", rows, cols, end.end() + 4 * rows * cols * chosen)
    if " ".join(tags.get("SCAN_DIR", [])) == "up":
        raw = raw[::-1]
    if pictures[chosen].backward:
        raw = raw[:, ::-1]
    factor = STATED_MICROMETRES_PER[pictures[chosen].unit]
    origin = {
        "format": "sxm",
        "first_row": "top",
        "channel": names[chosen],
        "other_channels": [*names[:chosen], *names[chosen + 1 :]],
        "instrument": {"manufacturer": "Nanonis"},
    }
    pixel = height_m * 1e6 / rows, width_m * 1e6 / cols
    return checked_map(name, scaled(raw, factor), pixel, origin, stage_height=True, probe=True)


SXM = Format("sxm", "Nanonis sxm", (".sxm",), read_sxm, ((0, MAGIC),), channels=True, place=12)
