"""``batch.html``: what the journal of a batch and the folders of its parts say, on one page."""

import contextlib
from pathlib import Path

from anisoscope.base.errors import RecordError
from anisoscope.inspection.batch.journal import BatchFile, SlotResult
from anisoscope.inspection.batch.refusal import CODE_PICTURE
from anisoscope.report.batch_page import PAGE_NAME, SlotView, thumbnail, write_batch_page
from anisoscope.report.inspection_page import REPORT_NAME
from anisoscope.rig.acquisition.writer import FRAMES
from anisoscope.rig.frame import read_frame


def write_summary(batch: BatchFile, folder: Path) -> Path:
    """Write ``batch.html`` into the folder of a batch.

    Raises:
        RecordError: it cannot be written.
    """
    path = folder / PAGE_NAME
    facts = [
        ("tray list", batch.tray),
        ("recipe", batch.recipe),
        ("rig", batch.rig),
        ("operator", batch.operator or "not said"),
        ("station", batch.station or "not said"),
        ("begun", batch.created_at.replace("T", " ").replace("+00:00", " UTC")),
        ("software", batch.software),
        ("SHA-256 of the recipe", batch.recipe_sha256),
    ]
    counts = [(word, number) for word, number in batch.counts.items() if number]
    title = f"Batch {Path(batch.tray).stem}"
    write_batch_page(path, title, facts, counts, [_view(slot, folder) for slot in batch.slots])
    return path


def _view(slot: SlotResult, folder: Path) -> SlotView:
    inside = None if slot.folder is None else folder / slot.folder
    report = inside is not None and (inside / REPORT_NAME).exists()
    return SlotView(
        slot=slot.slot,
        word=slot.word,
        serial=slot.serial,
        lot=slot.lot,
        cavity=slot.cavity,
        code=slot.code,
        reason=slot.reason,
        seconds=slot.seconds,
        report=f"{slot.folder}/{REPORT_NAME}" if report else None,
        thumbnail=None if inside is None else _picture(inside),
    )


def _picture(inside: Path) -> str | None:
    """The first frame that shows the part, or its code."""
    shown = [*sorted((inside / FRAMES).glob("*_sample_*.tif"))[:1], inside / CODE_PICTURE]
    for path in shown:
        with contextlib.suppress(RecordError):
            return thumbnail(read_frame(path).grey)
    return None
