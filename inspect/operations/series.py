"""Many parts: the slots of a tray one after the other, and folders of frames as they arrive."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Protocol

from anisoscope.base.errors import RecordError
from anisoscope.base.json_fields import json_field
from anisoscope.inspection.batch.first_pose import Look
from anisoscope.inspection.batch.journal import BATCH_NAME, VERDICTS, BatchFile, read_batch
from anisoscope.inspection.batch.operator import Operator, Unattended
from anisoscope.inspection.batch.run import run_batch, write_summary
from anisoscope.inspection.batch.start import Order
from anisoscope.inspection.batch.tray import read_tray
from anisoscope.inspection.batch.watch import Listener, Watch, Watched
from anisoscope.inspection.reports import Reports
from anisoscope.operations.remembering import history_place, judge_lot, lot_mates, remember, used_before
from anisoscope.parameters.inspecting import FramesWatch, TrayRun
from anisoscope.parameters.keywords import by_keywords
from anisoscope.record.verdict import Verdict


@dataclass(frozen=True)
class Batch:
    """Inspected slots of a tray.

    Attributes:
        file: slots with verdicts or faults, their counts and the exit code.
        folder: of the batch, with one inspection folder per part.
        page: summary in HTML.
    """

    file: BatchFile = field(
        metadata=json_field(
            by=lambda found: {
                "exit_code": found.exit_code,
                "counts": found.counts,
                "slots": [slot.model_dump(mode="json") for slot in found.slots],
            },
            merged=True,
        )
    )
    folder: Path
    page: Path


@by_keywords(run=TrayRun)
def batch(
    tray: Path | str,
    recipe: Path | str,
    rig: Path | str,
    *,
    run: TrayRun,
    out: Path | str = "inspections",
    history: str | None = None,
    who: Operator | None = None,
    note: Callable[[str], None] | None = None,
) -> Batch:
    """Inspect the parts of a tray list; a fault at one part does not stop the others.

    Args:
        tray: tray list: CSV with slot,serial and, if wanted, lot,cavity,recipe,rig,x_mm,y_mm; or AQDEF.
        recipe: recipe file.
        rig: rig file.
        run: `TrayRun`.
        out: folder that receives the folder ``batch-NAME``, after the list.
        history: that the inspections enter; ``none`` for none. By default that of the folder.
        who: answers before each part; by default nobody: the tray fills itself, or the axes bring the parts.
        note: takes a line of what a report lacks.

    Raises:
        AnisoscopeError: tray list, recipe or rig file, before anything moves.
    """
    listed, base = read_tray(Path(tray)), Path(out)
    folder = (base / f"batch-{Path(tray).stem}").resolve()
    place = history_place(history, base)
    order = Order(
        listed,
        Path(recipe),
        Path(rig),
        folder,
        run.operator,
        run.station,
        Look(run.code_kind, run.code_exposure_s) if run.read_code else None,
        lambda lot: lot_mates(place, lot),
        used_before(place),
    )
    say = note or (lambda _: None)
    begun_before = (folder / BATCH_NAME).exists() and not run.resume
    for text in listed.notes:
        say(text)
    try:
        with Reports() as reports:
            lots = partial(judge_lot, place=place, reports=reports)
            found = run_batch(
                replace(order, judge_lot=lots),
                who or Unattended(),
                lambda inspected: remember(inspected, place),
                resume=run.resume,
                reports=reports,
            )
            for text in reports.finish():
                say(text)
    except KeyboardInterrupt:
        if not begun_before and (folder / BATCH_NAME).exists():
            write_summary(read_batch(folder), folder)
        raise
    return Batch(found, folder, write_summary(found, folder))


class Hearer(Listener, Protocol):
    """Receiver of all that a watch says."""

    def begun(self, root: Path) -> None:
        """The folder is watched; no inspection began."""
        ...

    def note(self, text: str) -> None:
        """What a report lacks."""
        ...


@by_keywords(how=FramesWatch)
def watch(
    folder: Path | str,
    recipe: Path | str,
    rig: Path | str | None = None,
    *,
    how: FramesWatch,
    listener: Hearer,
    stop: threading.Event | None = None,
    out: Path | str = "inspections",
    history: str | None = None,
) -> Watch:
    """Inspect every folder of frames that another program writes.

    Args:
        folder: in which folders of frames (with frames.csv) arrive.
        recipe: recipe file.
        rig: rig file; by default rig.toml in the folder of frames.
        how: `FramesWatch`.
        listener: hears of every inspection, and of folders that cannot be inspected.
        stop: ends it after the folder at work.
        out: folder that receives the inspections.
        history: that the inspections enter; ``none`` for none. By default that of the folder.

    Returns:
        Verdicts, folders that cannot be inspected, and those still arriving.

    Raises:
        AnisoscopeError: folder, recipe or rig file.
    """
    base = Path(out)
    place = history_place(history, base)
    what = Watched(
        Path(folder).resolve(),
        base.resolve(),
        Path(recipe),
        None if rig is None else Path(rig),
        how.reflectance,
        how.stable_s,
        how.poll_s,
        how.code_kind if how.read_code else None,
        lambda lot: lot_mates(place, lot),
        used_before(place),
        how.reuse,
    )
    ended = threading.Event() if stop is None else stop
    with Reports(listener.note) as reports:
        what = replace(what, judge_lot=partial(judge_lot, place=place, reports=reports))
        watching = Watch(what, listener, lambda inspected: remember(inspected, place), reports=reports)
        with watching.open():
            listener.begun(what.root)
            (watching.run_once if how.once else watching.run)(ended)
            reports.finish()
    return watching


def watch_exit_code(watching: Watch) -> int:
    """Exit code of the worst verdict, or of damaged folders."""
    worst = next((word for word in VERDICTS if word in watching.verdicts), "PASS")
    return RecordError.exit_code if watching.bad else Verdict(worst).exit_code
