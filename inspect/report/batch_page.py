"""The page of a batch: the tray as a picture, and a line a slot with a link to its report."""

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.notation import true_minus
from anisoscope.report.page import write_page

PAGE_NAME = "batch.html"
THUMBNAIL_PX = 160
_WELL = re.compile(r"([A-Za-z])(\d{1,2})")
_SIGNS = {"PASS": "✓", "FAIL": "✗", "INCONCLUSIVE": "?", "INVALID": "!", "skipped": "–", "fault": "⚡"}


@dataclass(frozen=True)
class SlotView:
    """A slot as the page shows it.

    Attributes:
        slot: its name.
        serial, lot, cavity, code, reason: texts, or None.
        word: the verdict, or "skipped", "fault", "at work", "waiting".
        seconds: how long the inspection took.
        report: path of its report relative to the page, or None.
        thumbnail: a data URI, or None.
    """

    slot: str
    word: str
    serial: str | None = None
    lot: str | None = None
    cavity: str | None = None
    code: str | None = None
    reason: str | None = None
    seconds: float | None = None
    report: str | None = None
    thumbnail: str | None = None

    @property
    def link(self) -> str | None:
        """The address of the report; it can lead nowhere but into the folder of the batch."""
        return None if self.report is None else "./" + quote(self.report)

    @property
    def sign(self) -> str:
        """Symbol in addition to the colour, for colour-blind readers."""
        return _SIGNS.get(self.word, "·")

    @property
    def style(self) -> str:
        """Name of its colours."""
        return self.word if self.word in {"PASS", "FAIL", "INCONCLUSIVE", "INVALID", "fault"} else "open"


def write_batch_page(
    path: Path,
    title: str,
    facts: Sequence[tuple[str, str]],
    counts: Sequence[tuple[str, int]],
    slots: Sequence[SlotView],
) -> None:
    """Write the page of a batch, atomically.

    Args:
        path: file to write; links count from its folder.
        title: what it is.
        facts: names and values of what belongs to the whole batch.
        counts: how many slots of every word, in the order of the page.
        slots: in the order of the tray list.

    Raises:
        RecordError: the file cannot be written.
    """
    columns, places = tray_places([slot.slot for slot in slots])
    content = {
        "title": title,
        "facts": facts,
        "counts": counts,
        "total": len(slots),
        "columns": columns,
        "slots": list(zip(slots, places, strict=True)),
        "has_codes": any(slot.code for slot in slots),
        "has_lots": any(slot.lot or slot.cavity for slot in slots),
    }
    write_page(path, "batch.html", content, {"duration": _duration, "typeset": true_minus})


def tray_places(labels: Sequence[str]) -> tuple[int, list[tuple[int, int]]]:
    """Positions of slots on the tray: A1…H12 by name, all others in list order on a nearly square grid.

    Returns:
        The number of columns, and row and column of every slot, from 1.
    """
    wells = [_WELL.fullmatch(label) for label in labels]
    known = [
        (ord(well.group(1).upper()) - ord("A") + 1, int(well.group(2))) for well in wells if well is not None
    ]
    distinct = len(set(known)) == len(labels) and all(column >= 1 for _, column in known)
    if distinct and len(known) == len(labels):
        return max(column for _, column in known), known
    columns = max(1, min(12, round(len(labels) ** 0.5 * 1.3)))
    return columns, [(number // columns + 1, number % columns + 1) for number in range(len(labels))]


def thumbnail(counts: npt.NDArray[np.uint16]) -> str:
    """A small picture of a frame, (rows, cols) counts, as a data URI; brightened for the eye."""
    scale = THUMBNAIL_PX / max(counts.shape)
    small = cv2.resize(counts, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA).astype(np.float64)
    low, high = np.percentile(small, [1.0, 99.7])
    eye = np.sqrt(np.clip((small - low) / max(float(high - low), 1.0), 0.0, 1.0))
    done, data = cv2.imencode(".jpg", np.asarray(255.0 * eye + 0.5, np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 72])
    assert done
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")


def _duration(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 60.0 else f"{seconds / 60.0:.1f} min"
