"""One inspection from recipe to record: expect, photograph, judge, record; and going on after an interruption.

The report follows the record, at once or in the background (`anisoscope.inspection.reports`).
"""

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from anisoscope.base.errors import CalibrationError, RecordError, RigError
from anisoscope.base.parallel import for_each
from anisoscope.base.progress import Advance, silent
from anisoscope.imaging.frame_check import is_noisy
from anisoscope.imaging.frames import AcquiredFrames
from anisoscope.imaging.linearisation import check_size
from anisoscope.inspection.folder import SCAN, add_resume_hint, new_folder, sweep, working_in
from anisoscope.inspection.frames import check_frames, missing_frames, read_frames
from anisoscope.inspection.integrity import listed_files
from anisoscope.inspection.job import LOT, Job, prepare
from anisoscope.inspection.kept_measurement import write_kept
from anisoscope.inspection.manifest import Manifest, begin, one_round_more, refuse, reopen
from anisoscope.inspection.objects import SharedDarks, begin_series, shared_darks
from anisoscope.inspection.pipeline import Case, Diagnose, Judged, diagnose_by_kind, judge, utc_now
from anisoscope.inspection.report_seal import report_state, write_report_sealed
from anisoscope.inspection.reports import PendingReport, Reports, gets_report
from anisoscope.kinds.kind import AnyKind, Expected, Explanation
from anisoscope.kinds.parts import reporting
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.logo import logo_uri
from anisoscope.record.display import record_html, record_line
from anisoscope.record.schema import RECORD_NAME, REPORT_NAME, Particulars, Record, read_record, write_record
from anisoscope.record.verdict import Verdict
from anisoscope.report.inspection_page import Pictures, Sections, report_page, start_renderer
from anisoscope.report.peers import LotMate, LotMates, lot_of, no_lot_mates
from anisoscope.report.surface_view import Picture3D, SurfaceView
from anisoscope.rig.acquisition.journal import read_journal
from anisoscope.rig.acquisition.plan import Plan
from anisoscope.rig.acquisition.runner import Progress, Rig, check_plan, open_rig, run_plan
from anisoscope.rig.frame import Frame

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def predict_cached(job: Job) -> Expected:
    """Prediction of the part of a job; every part of one recipe on one rig is predicted once."""
    found: Expected = job.kind.predict(job.recipe, job.rig, cached=True)
    return found


def diagnose_cached(case: Case, advance: Advance) -> Explanation:
    """The diagnosis that the kind of part makes; its predictions may come from the cache."""
    return diagnose_by_kind(case, advance, cached=True)


def sections_by_kind(kind: AnyKind, record: Record, pictures: Pictures) -> Sections:
    """The sections that the kind of part adds to the report."""
    return reporting(kind).sections(record, pictures)


UsedBefore = Callable[[Sequence[str], str], str | None]
"""Function of hashes of pixels and a serial number: the other part that they were judged as, in words, or None."""


JudgeLot = Callable[["Inspected"], Sequence["Inspected"]]
"""Function of an inspection in the history: parts of its lot that were judged anew by it, with another verdict."""


def lot_as_it_is(inspected: "Inspected") -> tuple["Inspected", ...]:
    """For where no lot is known."""
    del inspected
    return ()


def never_used(pixels: Sequence[str], serial: str) -> None:
    """For where no history is known."""
    del pixels, serial


@dataclass(frozen=True)
class Methods:
    """Exchangeable methods of an inspection; tests hand in quicker ones.

    Attributes:
        predict: what the part should show.
        diagnose: explains a verdict.
        start_renderer: begins to draw a height map for the report.
        sections: what the kind of part shows of it in the report.
        page: makes the report; arguments as of `anisoscope.report.inspection_page.report_page`.
        now: the time.
    """

    predict: Callable[[Job], Expected] = predict_cached
    diagnose: Diagnose = diagnose_cached
    start_renderer: Callable[[HeightMap | None], SurfaceView | None] = start_renderer
    sections: Callable[[AnyKind, Record, Pictures], Sections] = sections_by_kind
    page: Callable[[Record, Pictures, Path, Picture3D | None, Sections], str] = report_page
    now: Callable[[], datetime] = utc_now


USUAL = Methods()


@dataclass(frozen=True, eq=False)
class Inspected:
    """A finished inspection: its record and folder, where its report is or will be, and notes for the user."""

    record: Record
    folder: Path
    report: Path
    notes: tuple[str, ...] = ()

    @property
    def anew_text(self) -> str:
        """A line on an inspection whose frames were judged anew."""
        record = self.record
        return f"{record.serial}: {record.verdict}, judged anew after {record.judged_anew.partition(' (')[0]}"

    def __repr__(self) -> str:
        """One line: serial number, product, verdict, the first reason."""
        return f"Inspected({record_line(self.record)})"

    def _repr_html_(self) -> str:
        return record_html(self.record)

    def plot(self, axes: "Axes | None" = None) -> "Axes":
        """Draw measured and predicted radiances against the stage angle.

        Args:
            axes: of matplotlib, to draw into; a new figure where they are not given.
        """
        return self.record.plot(axes)

    def to_frame(self) -> Any:  # noqa: ANN401 - pandas need not be installed
        """The poses as a pandas data frame: stage angle, tilt, measured and predicted radiance in 1/sr.

        Raises:
            UsageError: pandas is not installed.
        """
        return self.record.to_frame()


def inspect_part(
    recipe_path: Path,
    rig_path: Path,
    serial: str,
    out: Path,
    on_progress: Advance = silent,
    *,
    particulars: Particulars | None = None,
    lot_mates: Sequence[LotMate] = (),
    used_before: UsedBefore = never_used,
    cancel: threading.Event | None = None,
    methods: Methods | None = None,
    reports: Reports | None = None,
    on_folder: Callable[[Path], None] = lambda _: None,
) -> Inspected:
    """Photograph a part on a rig and judge it.

    Args:
        recipe_path: recipe file.
        rig_path: rig file.
        serial: serial number of the part.
        out: folder that receives the inspection folder.
        on_progress: called with what is being done, steps done and steps in all.
        particulars: operator, lot, cavity, station.
        lot_mates: inspections of the same lot, for the report.
        used_before: whose the pictures were in earlier inspections: those of another part come from no working camera.
        cancel: setting it stops the rig at once and ends the inspection with a `RigError`.
        methods: what varies, for tests.
        reports: where the report is written in the background; without it, before this returns.
        on_folder: called with the inspection folder before the first frame.

    Returns:
        The record, INVALID included. It is on disk whatever becomes of the report: a note says so where there is none.

    Raises:
        UsageError, RecipeError, RigFileError, HeightMapError, CalibrationError: before anything moves.
        RigError: hardware; the frames taken so far stay in the folder, no record is written, and `resume_part`
            goes on. Without any frame the folder goes too.
        RecordError: the folder cannot be written.
    """
    who, until = (particulars or Particulars()).checked(), _until(cancel, on_progress)
    job = prepare(recipe_path, rig_path, serial)
    try:
        now = (methods or USUAL).now()
        job.calibrations.check_valid(now)
        job.kind.check_valid(job.recipe, now)
    except CalibrationError:
        refused = _refused(job, rig_path, out, who, on_progress, methods)
        return reported(*refused, reports, on_progress)
    plan = job.plan(who.place_mm)
    with contextlib.ExitStack() as cleanup:
        # The devices first: the prediction takes long, a cable that is not plugged in shows at once.
        with open_rig(job.rig) as rig:
            _check_rig(rig, plan, job)
            ready = cleanup.enter_context(expecting(job, until, lot_mates, methods))
            folder = cleanup.enter_context(new_folder(out, serial))
            on_folder(folder)
            here = rig_path.resolve().parent
            job = job.of_lot(who.lot, lot_mates, folder)
            manifest = begin(
                folder,
                job,
                who,
                plan=plan,
                frames=plan.frame_count,
                rig_folder=here,
                share=True,
            )
            darks = shared_darks(folder, plan, rig, now)
            fresh = _photograph(manifest, rig, folder, on_progress, cancel, darks, now)
            manifest = _without_old_pictures(manifest, rig, folder, fresh, used_before)
            manifest, judged = _decide(manifest, rig, folder, job, ready, until, cancel, fresh)
        concluded = conclude(folder, manifest, job, ready, on_progress, judged)
    return reported(*concluded, reports, on_progress)


def reported(
    inspected: Inspected, report: PendingReport, reports: Reports | None, advance: Advance
) -> Inspected:
    """A concluded inspection whose report is handed over, unless none is wanted; or written at once, with its notes."""
    if reports is not None:
        if gets_report(reports.wanted, inspected.record.verdict):
            reports.add(report)
        else:
            report.discard()
        return inspected
    advance("report", 0, 1)
    notes = report.write()
    advance("report", 1, 1)
    return replace(inspected, notes=(*inspected.notes, *notes))


def _refused(
    job: Job, rig_path: Path, out: Path, particulars: Particulars, advance: Advance, methods: Methods | None
) -> tuple[Inspected, PendingReport]:
    """An INVALID inspection without photographs, because a calibration does not hold any more."""
    with expecting(job, advance, methods=methods) as ready, new_folder(out, job.serial) as folder:
        here = rig_path.resolve().parent
        manifest = begin(folder, job, particulars, plan=None, frames=0, rig_folder=here, share=True)
        return conclude(folder, manifest, job, ready, advance)


def resume_part(
    folder: Path | str,
    on_progress: Advance = silent,
    *,
    lot_mates: LotMates = no_lot_mates,
    used_before: UsedBefore = never_used,
    cancel: threading.Event | None = None,
    methods: Methods | None = None,
    reports: Reports | None = None,
) -> Inspected:
    """Take up an inspection that was interrupted, and finish it.

    Everything is read from the folder; only frames that are missing are taken. A pose that was not finished is
    taken anew, dark frames are kept if the camera exposes as before, all axes are homed anew, and the first pose
    is photographed once more: if it differs by more than the recipe's limit of drift, the inspection is INVALID.

    Args:
        folder: the inspection folder.
        on_progress: called with what is being done, steps done and steps in all.
        lot_mates: who was inspected before of the lot that the folder names, for the report; must not raise.
        used_before: as for `inspect_part`.
        cancel: setting it stops the rig at once and ends the inspection with a `RigError`.
        methods: what varies, for tests.
        reports: as for `inspect_part`.

    Raises:
        RecordError: there is nothing to resume, or a file of the folder is missing, damaged or was changed.
        CameraError: the camera exposes otherwise than before.
        RigError, CalibrationError: as for `inspect_part`.
    """
    folder = Path(folder).resolve()
    if (folder / SCAN).exists():
        raise RecordError(f"{folder} holds a scan: `anisoscope rig scan --continue {folder}` goes on with it")
    if (folder / RECORD_NAME).exists():
        raise RecordError(
            f"{folder}: this inspection is finished; there is nothing to resume{_report_hint(folder)}"
        )
    resumed = _resumed(folder, on_progress, lot_mates, used_before, cancel, methods)
    return reported(*resumed, reports, on_progress)


def _report_hint(folder: Path) -> str:
    if (folder / REPORT_NAME).exists():
        return ""
    return f"; its report is missing: `anisoscope report {folder}` writes it"


def _resumed(
    folder: Path,
    on_progress: Advance,
    lot_mates: LotMates,
    used_before: UsedBefore,
    cancel: threading.Event | None,
    methods: Methods | None,
) -> tuple[Inspected, PendingReport]:
    until = _until(cancel, on_progress)
    with working_in(folder):
        manifest, job = reopen(folder)
        mates = lot_mates(manifest.particulars.lot)
        check_frames(folder)
        sweep(folder)
        with contextlib.ExitStack() as cleanup:
            cleanup.enter_context(_going_on(folder))
            ready: Ready | None = None
            if missing_frames(manifest, read_journal(folder)) == 0:
                ready = cleanup.enter_context(expecting(job, until, mates, methods))
                judged = _judge(manifest, folder, job, ready, until)
                if _settled(manifest, job, judged):
                    return conclude(folder, manifest, job, ready, on_progress, judged)
                manifest = one_round_more(folder, manifest)
            if manifest.plan is None:
                raise RecordError(f"{folder}: not all frames were copied: inspect the folder of frames again")
            with open_rig(job.rig) as rig:
                _check_rig(rig, manifest.plan, job)
                ready = ready or cleanup.enter_context(expecting(job, until, mates, methods))
                fresh = _photograph(manifest, rig, folder, on_progress, cancel)
                manifest = _without_old_pictures(manifest, rig, folder, fresh, used_before)
                manifest, judged = _decide(manifest, rig, folder, job, ready, until, cancel, fresh)
            return conclude(folder, manifest, job, ready, on_progress, judged)


def _until(cancel: threading.Event | None, on_progress: Advance) -> Advance:
    """Progress of what is computed: its next step after a cancel raises a `RigError`."""

    def advance(doing: str, done: int, total: int) -> None:
        if cancel is not None and cancel.is_set():
            raise RigError(f"the inspection was stopped at this step: {doing}")
        on_progress(doing, done, total)

    return advance


@contextlib.contextmanager
def _going_on(folder: Path) -> Iterator[None]:
    try:
        yield
    except (RigError, KeyboardInterrupt) as error:
        add_resume_hint(folder, error)
        raise


def _check_rig(rig: Rig, plan: Plan, job: Job) -> None:
    """Does the rig fit plan and calibration? Nothing moves."""
    check_plan(plan, rig)
    info = rig.camera.info
    if job.white.camera != info.serial:
        raise CalibrationError(
            f"the flat was taken with camera {job.white.camera}, this is {info.serial}: "
            "take a new one with `anisoscope calibrate flat`"
        )
    job.kind.check_filters(info.filters, f"camera {info.serial}", job.white.filters)
    check_size(job.white, (info.rows, info.cols))
    job.calibrations.check_camera(info.serial, (info.rows, info.cols))


def _photograph(
    manifest: Manifest,
    rig: Rig,
    folder: Path,
    advance: Advance,
    cancel: threading.Event | None,
    darks: SharedDarks | None = None,
    began: datetime | None = None,
) -> dict[str, Frame]:
    """Carry out a plan; the frames that were taken, and dark ones that were taken over, by their names in the folder.

    A new inspection, which ``began`` at a time, shares the dark frames that it takes.
    """
    assert manifest.plan is not None
    part = (manifest.serial, manifest.particulars.lot)

    def report_progress(now: Progress) -> None:
        advance(now.text, now.done, now.total)

    taken = run_plan(
        manifest.plan, rig, folder, on_progress=report_progress, cancel=cancel, part=part, darks=darks
    )
    if began is not None:
        begin_series(folder, manifest.plan, rig, taken, began)
    return {one.path.relative_to(folder).as_posix(): one.frame for one in taken}


def _without_old_pictures(
    manifest: Manifest, rig: Rig, folder: Path, fresh: Mapping[str, Frame], used_before: UsedBefore
) -> Manifest:
    """Refuse pictures that equal those of another part bit for bit, which the noise of a sensor excludes."""
    if used_before is never_used or rig.camera.info.repeats:
        return manifest
    noisy = [frame for frame in fresh.values() if frame.kind == "sample" and is_noisy(frame.counts)]
    owner = used_before(for_each(lambda frame: frame.pixels, noisy), manifest.serial)
    if owner is None:
        return manifest
    return refuse(folder, manifest, old_pictures(owner))


def old_pictures(owner: str) -> str:
    """Reason why pictures of another part make this one INVALID."""
    return (
        f"pictures are those of {owner} bit for bit: the camera or its driver delivers old ones: check the camera's "
        "cable and driver, and that it delivers a new picture for every trigger"
    )


def _decide(
    manifest: Manifest,
    rig: Rig,
    folder: Path,
    job: Job,
    ready: "Ready",
    advance: Advance,
    cancel: threading.Event | None,
    fresh: dict[str, Frame],
) -> tuple[Manifest, Judged]:
    """Judge; repeat an INCONCLUSIVE measurement in the same seating, up to the number of rounds in the recipe.

    All frames of a pose are averaged, whichever round took them, so that noise and flicker shrink; what is
    systematic stays. ``fresh`` frames, by their names, are not read from the disk again.
    """
    while True:
        judged = _judge(manifest, folder, job, ready, advance, fresh)
        if _settled(manifest, job, judged):
            return manifest, judged
        manifest = one_round_more(folder, manifest)
        fresh |= _photograph(manifest, rig, folder, advance, cancel)


def _judge(
    manifest: Manifest,
    folder: Path,
    job: Job,
    ready: "Ready",
    advance: Advance,
    fresh: Mapping[str, Frame] | None = None,
) -> Judged:
    advance("measurement", 0, 1)
    frames, final = read_frames(folder, manifest, fresh), _is_last_round(manifest, job)
    judged = judged_by(manifest, job, ready, frames, advance, final=final)
    advance("measurement", 1, 1)  # the last place where a stop leaves an inspection without a record
    return judged


def judged_by(
    manifest: Manifest,
    job: Job,
    ready: "Ready",
    frames: AcquiredFrames,
    advance: Advance,
    *,
    final: bool = True,
) -> Judged:
    """Judge frames by the prediction and the methods of a preparation; see `anisoscope.inspection.pipeline.judge`."""
    methods = ready.methods
    return judge(
        manifest,
        job,
        ready.expected,
        frames,
        advance,
        final=final,
        diagnose=methods.diagnose,
        now=methods.now,
    )


def _is_last_round(manifest: Manifest, job: Job) -> bool:
    """Whether no further round is allowed, or none would help: the part waits for others of its lot."""
    waits = (
        manifest.input(LOT) is not None and job.reference is not None and job.reference.lacking is not None
    )
    return waits or manifest.plan is None or manifest.plan.rounds >= 1 + job.recipe.decision.remeasure


def _settled(manifest: Manifest, job: Job, judged: Judged) -> bool:
    """Whether no further round of photographs is due: more of them do not separate a fault of the rig from a defect."""
    record = judged[0]
    if record.diagnosis is not None and record.diagnosis.rig_fault is not None:
        return True
    return _is_last_round(manifest, job) or record.verdict != Verdict.INCONCLUSIVE.value


@dataclass(frozen=True, eq=False)
class Ready:
    """Preparation before the frames: prediction, renderings of the height map in progress, and the lot."""

    expected: Expected
    renderer: SurfaceView | None
    lot_mates: Sequence[LotMate] = ()
    methods: Methods = field(default_factory=Methods)

    def discard(self) -> None:
        """End the drawing of the height map, if it still goes on."""
        if self.renderer is not None:
            self.renderer.discard()


@contextlib.contextmanager
def expecting(
    job: Job, advance: Advance, lot_mates: Sequence[LotMate] = (), methods: Methods | None = None
) -> Iterator[Ready]:
    """Predict the poses of a job, and let the height map be drawn meanwhile; an error ends the drawing.

    Without an error the drawing belongs to the report (`conclude`, `report_again`).

    Raises:
        HeightMapError, RecipeError, InkFileError: nothing can be predicted.
    """
    advance("prediction", 0, 1)
    methods = methods or USUAL
    expected = methods.predict(job)
    renderer = methods.start_renderer(expected.surface)
    try:
        yield Ready(expected, renderer, lot_mates, methods)
    except BaseException:
        if renderer is not None:
            renderer.discard()
        raise


def conclude(
    folder: Path, manifest: Manifest, job: Job, ready: Ready, advance: Advance, judged: Judged | None = None
) -> tuple[Inspected, PendingReport]:
    """Judge the frames of a folder and write its record, which closes the folder; the report is still to be written.

    Args:
        folder: the inspection folder.
        manifest: how the inspection began.
        job: its recipe, rig and white reference.
        ready: preparation.
        advance: progress.
        judged: record and pictures, where the frames were judged already.

    Returns:
        The inspection, and its report, which is to be handed over once nothing else works in the folder: `reported`.

    Raises:
        RecordError: the folder cannot be read or written.
    """
    if judged is None:
        advance("measurement", 0, 1)
        frames = read_frames(folder, manifest)
        judged = judged_by(manifest, job, ready, frames, advance)
    record, pictures, kept = judged
    if kept is not None:
        write_kept(kept, folder)
    known = {file.name: file.sha256 for file in (*record.inputs, *record.frames)}
    record = record.model_copy(update={"files": listed_files(folder, known)})
    write_record(record, folder)
    advance(record.verdict, 1, 1)
    report = PendingReport(folder, lambda: _page(record, pictures, folder, job, ready), ready.discard)
    return Inspected(record, folder, folder / REPORT_NAME, record.notes), report


def _page(
    record: Record, pictures: Callable[[], Pictures], folder: Path, job: Job, ready: Ready
) -> tuple[str, tuple[str, ...]]:
    """The report of an inspection, and notes for the user."""
    shown = replace(
        pictures(),
        calibrations=job.calibrations.records,
        lot=lot_of(record, ready.lot_mates),
        logo=logo_uri(job.recipe),
    )
    sections = ready.methods.sections(job.kind, record, shown)
    view = ready.renderer.result() if ready.renderer is not None else None
    lost = (f"no 3-D view in the report: {view.note}",) if view is not None and view.png is None else ()
    return ready.methods.page(record, shown, folder, view, sections), lost


def report_again(folder: Path, record: Record, advance: Advance = silent) -> str:
    """The report of a finished inspection, made again; its numbers are those of the record.

    Pictures and prediction are computed from the frames and from the copies of the inputs. The comparison with the lot
    is left out: it was that of its time.

    Args:
        folder: the inspection folder, which is not changed.
        record: its record.
        advance: progress.

    Returns:
        The page.

    Raises:
        RecordError: a file of the folder is missing.
    """
    manifest, job = reopen(folder.resolve())
    job = replace(job, recipe=job.kind.as_recorded(job.recipe, record.recipe))
    with expecting(job, advance) as ready:
        frames = read_frames(folder, manifest)
        _, pictures, _ = judge(
            manifest, job, ready.expected, frames, advance, diagnose=lambda *_: Explanation()
        )
        return _page(record, pictures, folder, job, ready)[0]


def missing_report(folder: Path) -> PendingReport | None:
    """The report of a finished inspection that is still to be written, as after its program was killed; or None.

    Raises:
        RecordError: the record is damaged.
    """
    if (folder / REPORT_NAME).exists() or report_state(folder).by_record:
        return None
    record = read_record(folder)
    return PendingReport(folder, lambda: (report_again(folder, record), ()))


def write_report_again(folder: Path, advance: Advance = silent) -> str:
    """Write the report of a finished inspection into its folder, unless it is there as it was written.

    Args:
        folder: the inspection folder.
        advance: progress.

    Returns:
        What was done, in words.

    Raises:
        RecordError: the inspection is not finished, a file of it is missing or was changed, or its record, of an
            earlier version, lists the report that was written then.
    """
    folder = folder.resolve()
    record = read_record(folder)
    with working_in(folder):
        found = report_state(folder)
        if found.state == "written":
            return "as the inspection wrote it"
        if found.by_record:
            raise RecordError(
                f"{folder}: its record lists the report that was written then, which is {found.state}: put it back, or "
                "write one elsewhere with `anisoscope show --html FILE`"
            )
        write_report_sealed(folder, report_again(folder, record, advance))
    return (
        "made again from the frames"
        if found.state == "missing"
        else (f"made again from the frames, because {found.changed[0]} was changed")
    )
