"""Start of a batch: the order, its checks, and the results of an earlier run."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.base.printable import check_printable
from anisoscope.inspection.batch.first_pose import Look
from anisoscope.inspection.batch.journal import (
    BATCH_NAME,
    BatchFile,
    check_same,
    new_batch,
    read_batch,
    write_batch,
)
from anisoscope.inspection.batch.operator import Operator
from anisoscope.inspection.batch.slot_folder import clear_stillborn, finished_in, inspected_in
from anisoscope.inspection.batch.tray import Slot, Tray
from anisoscope.inspection.job import prepare
from anisoscope.inspection.run import Inspected, JudgeLot, UsedBefore, lot_as_it_is, never_used
from anisoscope.report.peers import LotMates, no_lot_mates

TRAY_NAME = "tray.csv"

Remember = Callable[[Inspected], None]


@dataclass(frozen=True, eq=False)
class Order:
    """Order of a batch.

    Attributes:
        tray: the tray list.
        recipe, rig: files for all slots that name none of their own.
        out: folder of the batch; slots get folders of their own in it.
        operator, station: for the records.
        look: how the camera reads the code of every part before it is inspected, or None.
        lot_mates: who was inspected before of a lot, for the reports; must not raise.
        used_before: whose pictures were in earlier inspections.
        judge_lot: judges parts of a lot anew when more of it are known; must not raise.
    """

    tray: Tray
    recipe: Path
    rig: Path
    out: Path
    operator: str | None = None
    station: str | None = None
    look: Look | None = None
    lot_mates: LotMates = no_lot_mates
    used_before: UsedBefore = never_used
    judge_lot: JudgeLot = lot_as_it_is

    def files(self, slot: Slot) -> tuple[Path, Path]:
        """Recipe and rig file of a slot."""
        return slot.recipe or self.recipe, slot.rig or self.rig


def check_order(order: Order, operator: Operator) -> None:
    """Check that the batch can be done. Nothing moves and nothing is written.

    Raises:
        UsageError: a serial number is missing and cannot be entered, or the name of operator or station cannot be used.
        RecipeError, RigFileError, HeightMapError, CalibrationError: a file.
    """
    check_printable({"operator": order.operator, "station": order.station})
    for slot in order.tray.slots:
        if slot.serial is None and order.look is None and not operator.interactive:
            raise UsageError(
                f"{order.tray.path}, line {slot.line}, column serial: slot {slot.label} has none; read it from the "
                "part with --read-code, or let somebody scan it (without --yes)"
            )
    for recipe, rig in dict.fromkeys(map(order.files, order.tray.slots)):
        prepare(recipe, rig, "check")


def make_folder(out: Path, *, resume: bool) -> None:
    """Make the folder of a batch.

    Raises:
        UsageError: a batch began there and is not to be resumed, or the other way about.
        RecordError: it cannot be made.
    """
    begun = (out / BATCH_NAME).exists()
    if begun and not resume:
        raise UsageError(f"{out}: a batch began there; --resume goes on with it, another --out begins anew")
    if resume and not begun:
        raise UsageError(f"{out}: no batch began there; leave --resume out to begin one")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(f"cannot make the folder {out}: {error.strerror}") from error


def begin_batch(order: Order, remember: Remember, *, resume: bool) -> BatchFile:
    """The journal of a batch, new or with all that an earlier run has done.

    Raises:
        UsageError: list or recipe are others than those with which it began.
        RecordError: the folder cannot be read or written.
    """
    if resume:
        batch = read_batch(order.out)
        check_same(batch, order.tray, order.recipe)
        for slot in order.tray.slots:
            clear_stillborn(order.out / slot.label)
        return _adopted(batch, order.out, remember)
    batch = new_batch(order.tray, order.recipe, order.rig, order.operator, order.station)
    try:
        shutil.copyfile(order.tray.path, order.out / TRAY_NAME)
    except shutil.SameFileError:
        pass
    except OSError as error:
        raise RecordError(f"cannot copy {order.tray.path} to {order.out}: {error.strerror}") from error
    write_batch(batch, order.out)
    return batch


def _adopted(batch: BatchFile, out: Path, remember: Remember) -> BatchFile:
    """With the inspections that were finished, though the program died before it could note it."""
    for number, result in enumerate(batch.slots):
        folder = finished_in(out / result.slot)
        if folder is None:
            continue
        inspected = inspected_in(folder)
        remember(inspected)  # once more: it may have died before that, too
        if result.state != "done":
            batch = batch.with_slot(number, **done_with(inspected, out))
    write_batch(batch, out)
    return batch


def done_with(inspected: Inspected, out: Path) -> dict[str, object]:
    """Journal entry of a slot whose part is inspected."""
    record = inspected.record
    return {
        "state": "done",
        "serial": record.serial,
        "lot": record.particulars.lot,
        "verdict": record.verdict,
        "reason": record.reasons[0] if record.reasons else None,
        "folder": inspected.folder.relative_to(out.resolve()).as_posix(),
        "exit_code": None,
        "finished_at": record.created_at,
    }
