"""Run of a tray from first to last slot: a faulty part does not stop the others, and no part is inspected twice."""

import contextlib
import time
from dataclasses import dataclass
from pathlib import Path

from anisoscope.base.crash import as_foreseen
from anisoscope.base.errors import AnisoscopeError, MeasurementError, RecordError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.inspection.batch.codes import one_code, read_codes
from anisoscope.inspection.batch.first_pose import photograph_first_pose
from anisoscope.inspection.batch.journal import (
    BatchFile,
    SlotResult,
    now,
    write_batch,
)
from anisoscope.inspection.batch.operator import Answer, Operator
from anisoscope.inspection.batch.scan import Scan, mismatch
from anisoscope.inspection.batch.slot_folder import unfinished_in
from anisoscope.inspection.batch.start import (
    Order,
    Remember,
    begin_batch,
    check_order,
    done_with,
    make_folder,
)
from anisoscope.inspection.batch.tray import Slot
from anisoscope.inspection.folder import new_folder, working_in
from anisoscope.inspection.job import prepare
from anisoscope.inspection.manifest import begin
from anisoscope.inspection.reports import Reports
from anisoscope.inspection.run import (
    Inspected,
    Methods,
    conclude,
    expecting,
    inspect_part,
    missing_report,
    reported,
    resume_part,
)
from anisoscope.record.schema import REPORT_NAME, Particulars
from anisoscope.report.batch_page import PAGE_NAME, SlotView, thumbnail, write_batch_page
from anisoscope.rig.acquisition.writer import FRAMES
from anisoscope.rig.frame import Frame, read_frame, write_frame

CODE_PICTURE = "code.tif"


def refuse_part(
    recipe_path: Path,
    rig_path: Path,
    serial: str,
    out: Path,
    reason: str,
    on_progress: Advance = silent,
    *,
    particulars: Particulars | None = None,
    picture: Frame | None = None,
    methods: Methods | None = None,
    reports: Reports | None = None,
) -> Inspected:
    """Record an inspection as INVALID for a reason; nothing moves.

    Args:
        recipe_path: recipe file.
        rig_path: rig file.
        serial: serial number under which it is recorded.
        out: folder that receives the inspection folder.
        reason: in one line.
        on_progress: progress.
        particulars: operator, lot, cavity, station.
        picture: the picture of the code; stored next to the record.
        methods: what varies in an inspection, for tests.
        reports: as for `anisoscope.inspection.run.inspect_part`.

    Raises:
        UsageError, RecipeError, RigFileError, HeightMapError, CalibrationError: one of the files.
        RecordError: the folder cannot be written.
    """
    job = prepare(recipe_path, rig_path, serial)
    with expecting(job, on_progress, methods=methods) as ready, new_folder(out, serial) as folder:
        here = rig_path.resolve().parent
        started = begin(
            folder,
            job,
            particulars or Particulars(),
            plan=None,
            frames=0,
            rig_folder=here,
            refused=reason,
            share=True,
        )
        if picture is not None:
            write_frame(picture, folder / CODE_PICTURE)
        concluded = conclude(folder, started, job, ready, on_progress)
    return reported(*concluded, reports, on_progress)


FAULTS_IN_A_ROW = 2


def run_batch(
    order: Order,
    operator: Operator,
    remember: Remember,
    *,
    resume: bool = False,
    methods: Methods | None = None,
    reports: Reports | None = None,
) -> BatchFile:
    """Inspect the parts of a tray, one after the other.

    Args:
        order: what is to be done.
        operator: who places the parts.
        remember: enters a finished inspection into the history; must not raise.
        resume: go on with a batch that was interrupted: what is done stays, what was begun is finished, and reports
            that are missing are written.
        methods: what varies in an inspection, for tests.
        reports: where reports are written while the next part is inspected; without it each is waited for.

    Returns:
        What has become of every slot, as ``batch.json`` says it.

    Raises:
        UsageError: a batch began there already, or another one; or a serial number is missing and cannot be entered.
        RecipeError, RigFileError, HeightMapError, CalibrationError: a file, before anything moves.
        RecordError: the folder cannot be written, or another process works in it.
    """
    check_order(order, operator)
    make_folder(order.out, resume=resume)
    with working_in(order.out):
        batch = begin_batch(order, remember, resume=resume)
        if resume:
            _write_missing_reports(batch, order.out, reports)
        run = _Run(order, operator, remember, batch, methods, reports)
        try:
            run.all_slots()
        except KeyboardInterrupt as interruption:
            interruption.add_note(f"the same command with --resume goes on with {order.out}")
            raise
        return run.batch


def _write_missing_reports(batch: BatchFile, out: Path, reports: Reports | None) -> None:
    """Reports of parts that are done, which an earlier run did not come to write."""
    for slot in batch.slots:
        if slot.state == "done" and slot.folder is not None:
            with contextlib.suppress(RecordError):  # a damaged record is no reason to stop the other parts
                report = missing_report(out / slot.folder)
                if report is not None and reports is not None:
                    reports.add(report)
                elif report is not None:
                    report.write()


@dataclass(frozen=True, eq=False)
class _Identity:
    """Identity of a part before its inspection; ``wrong`` makes it INVALID."""

    serial: str
    lot: str | None
    code: str | None = None
    wrong: str | None = None
    picture: Frame | None = None


class _Run:
    def __init__(
        self,
        order: Order,
        operator: Operator,
        remember: Remember,
        batch: BatchFile,
        methods: Methods | None,
        reports: Reports | None,
    ) -> None:
        self.order, self.operator, self.remember, self.batch = order, operator, remember, batch
        self.methods, self.reports = methods, reports
        self.faults = 0

    def all_slots(self) -> None:
        left = sum(slot.state != "done" for slot in self.batch.slots)
        if self.order.tray.placed and left and not self.operator.place_all(left):
            return
        number = 0
        while number < len(self.batch.slots):
            if self.batch.slots[number].state == "done":
                number += 1
                continue
            went_on = self._one(number)
            if went_on == "stop":
                return
            number += went_on == "go on"

    def _note(self, number: int, **changes: object) -> None:
        self.batch = self.batch.with_slot(number, **changes)
        write_batch(self.batch, self.order.out)

    def _one(self, number: int) -> str:
        """Inspect the part of a slot; the result is "again", "go on" or "stop"."""
        slot, result = self.order.tray.slots[number], self.batch.slots[number]
        unfinished = unfinished_in(self.order.out / slot.label)
        needs_serial = slot.serial is None and self.order.look is None
        answer = (
            Answer()
            if self.order.tray.placed and not needs_serial
            else self.operator.place(result, again=unfinished is not None, needs_serial=needs_serial)
        )
        if answer.what != "go on":
            if answer.what == "skip":
                self._note(number, state="skipped", finished_at=now())
                self.faults = 0
                self.operator.finished(self.batch, number)
            return "stop" if answer.what == "stop" else "go on"
        self._note(number, state="at work", reason=None, exit_code=None)
        begun = time.monotonic()
        try:
            with self.operator.progress(self.batch, number) as advance:
                code = self._inspect(number, slot, answer.scan, unfinished, advance)
        except Exception as error:  # noqa: BLE001 - what is wrong with one part must not end the batch
            return self._fault(number, as_foreseen(error, f"batch, at {slot.label}"))
        self.faults = 0
        self._note(number, code=code, seconds=round(time.monotonic() - begun, 1))
        self.operator.finished(self.batch, number)
        return "go on"

    def _fault(self, number: int, error: AnisoscopeError) -> str:
        left = unfinished_in(self.order.out / self.batch.slots[number].slot)
        self._note(
            number,
            state="fault",
            reason=" ".join(str(error).split()),
            exit_code=error.exit_code,
            folder=None if left is None else left.relative_to(self.order.out.resolve()).as_posix(),
            finished_at=now(),
        )
        self.faults += 1
        self.operator.finished(self.batch, number)
        if self.faults < FAULTS_IN_A_ROW:
            return "go on"
        return self.operator.trouble(self.batch.slots[number], self.faults)

    def _inspect(
        self, number: int, slot: Slot, scan: Scan | None, unfinished: Path | None, advance: Advance
    ) -> str | None:
        """Inspect, and enter the verdict; returns the text of the code on the part."""
        order = self.order
        home = order.out / slot.label
        recipe, rig = order.files(slot)
        part = self._identify(number, slot, scan, advance)
        who = Particulars(
            operator=order.operator,
            station=order.station,
            lot=part.lot,
            cavity=slot.cavity,
            place_mm=slot.place_mm,
        )
        if part.wrong is not None:
            inspected = refuse_part(
                recipe,
                rig,
                part.serial,
                home,
                part.wrong,
                advance,
                particulars=who,
                picture=part.picture,
                methods=self.methods,
                reports=self.reports,
            )
        else:
            inspected = self._resumed(unfinished, advance) or inspect_part(
                recipe,
                rig,
                part.serial,
                home,
                advance,
                particulars=who,
                lot_mates=order.lot_mates(part.lot),
                used_before=order.used_before,
                methods=self.methods,
                reports=self.reports,
            )
        self._note(number, **done_with(inspected, order.out))
        self.remember(inspected)
        for anew in order.judge_lot(inspected):
            self._note_anew(anew)
        return part.code

    def _note_anew(self, anew: Inspected) -> None:
        """Enter the verdict of a part of the lot that was judged anew, if it is one of this batch."""
        for number, slot in enumerate(self.batch.slots):
            home = (self.order.out / slot.slot).resolve()
            if slot.state == "done" and slot.serial == anew.record.serial and home in anew.folder.parents:
                self._note(number, **done_with(anew, self.order.out))

    def _resumed(self, unfinished: Path | None, advance: Advance) -> Inspected | None:
        """Resume an inspection; None without one, or if its folder is damaged and the part is inspected again."""
        if unfinished is None:
            return None
        order = self.order
        try:
            return resume_part(
                unfinished,
                advance,
                lot_mates=order.lot_mates,
                used_before=order.used_before,
                methods=self.methods,
                reports=self.reports,
            )
        except RecordError:
            return None

    def _identify(self, number: int, slot: Slot, scan: Scan | None, advance: Advance) -> _Identity:
        """Identify the part by the list, by the scanned text, and by its code."""
        picture, trouble = None, None
        if scan is None and self.order.look is not None:
            advance("reading its code", 0, 1)
            recipe, rig = self.order.files(slot)
            picture = photograph_first_pose(recipe, rig, self.order.look.exposure_s, slot.place_mm)
            try:
                kind = self.order.look.kind
                scan = one_code(read_codes(picture.grey, kind), kind, "the picture at the first pose").scan
            except (MeasurementError, UsageError) as error:
                trouble = str(error)
        # An unreadable code: the serial number is requested even if listed, as the slot may hold another part.
        if scan is None and (trouble is not None or slot.serial is None):
            scan = self.operator.serial_of(self.batch.slots[number], trouble or "it has no serial number yet")
        # A part without any number is inspected all the same, as INVALID, so that its folder needs a name.
        serial = slot.serial or (scan.serial if scan is not None else None) or f"unread-{slot.label}"
        if scan is None:
            wrong = (
                None
                if trouble is None and slot.serial
                else f"slot {slot.label}: {trouble or 'no serial number'}"
            )
            return _Identity(serial, slot.lot, wrong=wrong, picture=picture)
        wrong = mismatch(f"slot {slot.label}", slot.serial, slot.lot, scan) or self._twice(number, serial)
        return _Identity(serial, slot.lot or scan.lot, scan.text, wrong, picture)

    def _twice(self, number: int, serial: str) -> str | None:
        """Two slots cannot hold the same part."""
        others = [one for at, one in enumerate(self.batch.slots) if at != number and one.serial == serial]
        if not others:
            return None
        return f"slot {self.batch.slots[number].slot}: its code reads {serial}, which slot {others[0].slot} holds"


def write_summary(batch: BatchFile, folder: Path) -> Path:
    """Write ``batch.html`` into the folder of a batch.

    Raises:
        RecordError: it cannot be written.
    """
    path = folder / PAGE_NAME
    files = (("tray list", batch.tray), ("recipe", batch.recipe), ("rig", batch.rig))
    facts = [
        *((name, Path(file).name) for name, file in files),
        *((name, said) for name in ("operator", "station") if (said := getattr(batch, name))),
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
    pictures = [*sorted((inside / FRAMES).glob("*_sample_*.tif"))[:1], inside / CODE_PICTURE]
    for path in pictures:
        with contextlib.suppress(RecordError):
            return thumbnail(read_frame(path).grey)
    return None
