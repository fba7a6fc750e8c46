"""Inspect frames that exist already, check a recipe with them, or judge those of an inspection anew: no device."""

import contextlib
import hashlib
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import (
    CalibrationError,
    CameraError,
    MeasurementError,
    RecordError,
    RigFileError,
    UsageError,
)
from anisoscope.base.parallel import for_each
from anisoscope.base.progress import Advance, silent
from anisoscope.calibration.corrections import Calibrations, calibrations_of
from anisoscope.calibration.record import record_path
from anisoscope.calibration.white_reference import read_reference, write_reference
from anisoscope.decision.equipment import UNKNOWN
from anisoscope.decision.reference_parts import golden_text
from anisoscope.imaging.frames import AcquiredFrames, Shot
from anisoscope.imaging.linearisation import WhiteReference, check_size
from anisoscope.inspection.folder import INPUTS, JOB, new_folder, working_in
from anisoscope.inspection.frame_table import Replay, arrange, camera_of, linear_entries, white_of
from anisoscope.inspection.frames import REPLAYED, RESPONSE, read_frames
from anisoscope.inspection.job import (
    LOT,
    LOT_NAME,
    Job,
    Source,
    check_serial,
    fixture_of,
    flat_of,
    sources_of,
    sources_of_calibrations,
)
from anisoscope.inspection.kept_measurement import KEPT_NAME
from anisoscope.inspection.manifest import InputCopy, begin, checked_content, reopen, write_manifest
from anisoscope.inspection.objects import LARGE, share, store
from anisoscope.inspection.pipeline import measure_frames
from anisoscope.inspection.report_seal import OWN
from anisoscope.inspection.reports import Reports
from anisoscope.inspection.run import (
    Inspected,
    Methods,
    UsedBefore,
    conclude,
    expecting,
    judged_by,
    never_used,
    reported,
)
from anisoscope.kinds.kind import AnyKind
from anisoscope.kinds.parts import Reference, reference_on
from anisoscope.kinds.recipe_check import RecipeCheck
from anisoscope.kinds.registry import kind_of
from anisoscope.recipe.base import RecipeBase
from anisoscope.record.schema import RECORD_NAME, InputFile, Particulars, read_record, sha256_of
from anisoscope.report.peers import LotMate
from anisoscope.rig.acquisition.journal import FrameLine, JournalFile, RunLine
from anisoscope.rig.acquisition.writer import FRAMES
from anisoscope.rig.cameras.response import read_response
from anisoscope.rig.fixture import Fixture
from anisoscope.rig.frame import header_of
from anisoscope.rig.framefolder import TABLE, FrameFolder, HeldFile, frames_to_add, read_frame_folder
from anisoscope.rig.rigfile import RigFile, read_replay_rig

RIG_NAME = "rig.toml"
WHITE_NAME = "white-reference.tif"


def inspect_frames(
    frames: Path | FrameFolder,
    recipe_path: Path,
    serial: str,
    out: Path,
    on_progress: Advance = silent,
    *,
    rig_path: Path | None = None,
    reflectance: float = 0.99,
    particulars: Particulars | None = None,
    lot_mates: Sequence[LotMate] = (),
    methods: Methods | None = None,
    reports: Reports | None = None,
    used_before: UsedBefore = never_used,
    reuse: str = "",
) -> Inspected:
    """Judge a part by the frames of a folder; they are copied, so that the inspection folder explains itself.

    Every frame is read from the disk once: what was read is checked, hashed, copied and judged.

    Args:
        frames: folder with ``frames.csv``, or one that was read (held); its content is released.
        recipe_path: recipe file.
        serial: serial number of the part.
        out: folder that receives the inspection folder.
        on_progress: called with what is being done, steps done and steps in all.
        rig_path: rig file, for its geometry; by default ``rig.toml`` next to the frames.
        reflectance: reflectance of the tile in the flat frames, if there are any.
        particulars: operator, lot, cavity, station.
        lot_mates: inspections of the same lot, for the report.
        methods: what varies, for tests.
        reports: as for `anisoscope.inspection.run.inspect_part`.
        used_before: whose the frames were in earlier inspections.
        reuse: reason for judging frames of another part all the same; it is kept in the record.

    Raises:
        UsageError: no rig file, a wrong reflectance, or the frames are those of another part.
        RecipeError, RigFileError, HeightMapError: one of the files.
        RecordError: the frames are incomplete or do not fit together, or the inspection folder cannot be written.
        RigFileError: there is no flat.
        CalibrationError: a flat of another camera.
    """
    who = (particulars or Particulars()).checked()
    given = read_given(frames, recipe_path, serial, rig_path, reflectance)
    if not reuse.strip():
        _check_owner(given, used_before)
    with contextlib.ExitStack() as cleanup:
        folder = cleanup.enter_context(new_folder(out, serial))
        job = given.job(folder / INPUTS / WHITE_NAME).of_lot(who.lot, lot_mates, folder)
        ready = cleanup.enter_context(expecting(job, on_progress, lot_mates, methods))
        manifest = begin(
            folder,
            job,
            who,
            plan=None,
            frames=len(given.replay.entries),
            rig_folder=given.rig_path.resolve().parent,
            reuse=reuse.strip(),
            share=True,
        )
        linear = given.rig.camera.options.get("linear") is not False
        acquired = _copy(given.replay, given.frames, folder, on_progress, linear=linear)
        on_progress("measurement", 0, 1)
        judged = judged_by(manifest, job, ready, acquired, on_progress)
        inspected, report = conclude(folder, manifest, job, ready, on_progress, judged)
    inspected = replace(inspected, notes=(*given.replay.notes, *inspected.notes))
    return reported(inspected, report, reports, on_progress)


def _check_owner(given: "Given", used_before: UsedBefore) -> None:
    """Check that the frames do not belong to another part.

    Raises:
        UsageError: their metadata or an earlier inspection name another serial number.
    """
    samples = given.replay.of_kind("sample")
    remedy = "name that serial number, take new frames, or say why they serve with `--reuse REASON`"
    for entry in samples:
        header = header_of(entry.path if entry.held is None else entry.held.content())
        if header is not None and header.serial not in {None, given.serial}:
            raise UsageError(
                f"{entry.path}: shows a part of serial number {header.serial}, not {given.serial}: {remedy}"
            )
    if used_before is not never_used:
        owner = used_before(for_each(lambda entry: entry.load().pixels, samples), given.serial)
        if owner is not None:
            raise UsageError(
                f"{given.frames}: these frames were judged as {owner}, not as {given.serial}: {remedy}"
            )


@dataclass(frozen=True, eq=False)
class Given:
    """All that is read of a folder of frames, recipe and rig before anything is written.

    Attributes:
        serial: serial number of the part.
        kind: which kind of part it is.
        recipe: what the part should look like.
        rig: the rig file, with or without devices.
        rig_path: where it is.
        fixture: its markers, or None.
        reference: parts that are known to be good, or None.
        replay: the frames by the poses of the recipe.
        frames: the folder that they are in.
    """

    serial: str
    kind: AnyKind
    recipe: RecipeBase
    rig: RigFile
    rig_path: Path
    fixture: Fixture | None
    reference: Reference | None
    replay: Replay
    frames: Path
    _white_of_frames: dict[str, Any] | None
    _white_of_rig: WhiteReference | None
    _sources: tuple[Source, ...]
    _calibrations: Calibrations

    def job(self, white_path: Path) -> Job:
        """The inspection of these frames; a white reference of their flat frames is written to a path."""
        white, path = self._white_of_rig, white_path
        if self._white_of_frames is not None:
            write_reference(path, self._white_of_frames)
        elif self.rig.calibration is not None:
            path = self.rig.calibration.flat
        white = white or read_reference(path)
        calibrations = self._calibrations
        sources = (
            *self._sources,
            Source("white reference", path, white.sha256),
            *sources_of_calibrations(calibrations),
        )
        return Job(
            self.serial,
            self.kind,
            self.recipe,
            self.rig,
            self.fixture,
            white,
            sources,
            self.reference,
            calibrations,
        )


def read_given(
    given: Path | FrameFolder,
    recipe_path: Path,
    serial: str,
    rig_path: Path | None,
    reflectance: float,
    recipe: RecipeBase | None = None,
) -> Given:
    """Read everything that the inspection of a folder of frames needs; arguments and errors as of `inspect_frames`.

    A recipe that was changed after reading stands in place of that of the file.
    """
    check_serial(serial)
    frames = given.folder if isinstance(given, FrameFolder) else given
    if not 0.0 < reflectance <= 1.0:
        raise UsageError(f"the reflectance of the tile must lie between 0 and 1, not {reflectance}")
    rig_path = rig_path or _rig_in(frames)
    kind = kind_of(recipe_path)
    recipe = recipe or kind.read_recipe(recipe_path)
    rig = read_replay_rig(rig_path, recipe.acquisition.light_channel)
    rig = rig if rig.light.channel else rig.in_channel(None)
    fixture = fixture_of(rig, rig_path)
    read = given if isinstance(given, FrameFolder) else read_frame_folder(frames, hold=True)
    response = rig.camera.options.get("response")
    if response:
        curve = read_response(Path(str(response)))
        read = replace(read, entries=linear_entries(read.entries, curve))
    replay = arrange(read, recipe)
    white_of_frames = white_of(replay, reflectance, rig.light.angle_deg)
    white = None if white_of_frames is not None else _white_of_rig(rig, rig_path, replay, read)
    camera = camera_of(replay) or (None if white is None else white.camera)
    reference = reference_on(kind, recipe_path, recipe, rig, camera)
    sources = (
        *sources_of(recipe_path, rig_path, kind, recipe, rig),
        Source("frame table", frames / TABLE, read.table_sha256),
    )
    if response:
        sources += (Source(RESPONSE, Path(str(response)), sha256_of(Path(str(response)))),)
    return Given(
        serial,
        kind,
        recipe,
        rig,
        rig_path,
        fixture,
        reference,
        replay,
        frames,
        white_of_frames,
        white,
        sources,
        _calibrations_of(rig, replay, white),
    )


def _calibrations_of(rig: RigFile, replay: Replay, white: WhiteReference | None) -> Calibrations:
    """Calibrations that frames of a rig use: its rotation, and the fixture where its flat scales them.

    Raises:
        CalibrationError: one is damaged, or of another camera or light.
    """
    kinds: tuple[Literal["rotation", "fixture"], ...] = (
        ("rotation",) if white is None else ("rotation", "fixture")
    )
    named = {kind: getattr(rig.calibration, kind) for kind in kinds if rig.calibration is not None}
    files = {f"{kind} record": record_path(path) for kind, path in named.items() if path is not None}
    found = replace(calibrations_of(files), followed=rig.x is not None and rig.y is not None)
    camera = white.camera if white is not None else camera_of(replay)
    for kind, record in found.records.items():
        own = record.camera.serial
        serial = own if camera is None or camera.endswith(own) else camera
        replace(found, records={kind: record}).check_camera(serial, (replay.rows, replay.cols))
    found.check_light(rig.light)
    return found


FROM_FRAMES = (
    "whether another exposure would show more, and what a second round of photographs would decide; of the rig's "
    "calibrations frames use flat, fixture and rotation alone"
)


def check_with_frames(
    recipe_path: Path,
    frames: Path,
    rig_path: Path | None,
    *,
    reflectance: float = 0.99,
    tries: Sequence[float] = (),
    advance: Advance = silent,
) -> RecipeCheck:
    """Check a recipe as without frames, and whether a part could be measured by these; nothing is written.

    Args:
        recipe_path: recipe file.
        frames: folder with ``frames.csv``.
        rig_path: rig file, for its geometry; by default ``rig.toml`` next to the frames.
        reflectance: reflectance of the tile in the flat frames, if there are any.
        tries: tilts that might be added, degrees.
        advance: progress.

    Raises:
        As `inspect_frames`, but for the inspection folder.
    """
    given = read_given(frames, recipe_path, "recipe-check", rig_path, reflectance)
    found: RecipeCheck = given.kind.check_recipe(
        recipe_path, given.rig_path, given.rig.light.angle_deg, tries, advance
    )
    advance("frames", 0, 1)
    shows, complaints = [*given.replay.notes], [*found.complaints]
    with tempfile.TemporaryDirectory(prefix="anisoscope-check-") as name:
        job = given.job(Path(name) / WHITE_NAME)
        try:
            expected = job.kind.predict(job.recipe, job.rig, cached=True)
            measured = measured_by(given, job, expected)
            wrong: str | None = job.kind.drift_error(measured, job.recipe)
        except (MeasurementError, CameraError) as error:
            wrong = str(error)
    if wrong is None:
        count = len(job.recipe.poses.poses())
        shows.insert(0, f"{frames}: the part can be measured by these frames, at all {count} poses")
    else:
        complaints.append(f"{frames}: an inspection by these frames would be INVALID: {wrong}")
    return replace(found, complaints=tuple(complaints), frames=tuple(shows), unchecked=FROM_FRAMES)


def _rig_in(frames: Path) -> Path:
    path = frames / RIG_NAME
    if not path.is_file():
        raise UsageError(
            f"{frames} holds no {RIG_NAME}: name a rig file with --rig; of it are needed the angle of the light "
            "([light] angle_deg), the size of a pixel ([camera] pixel_um), the markers ([fixture]) and, unless "
            "there are flat frames, the white reference ([calibration] flat)"
        )
    return path


def _white_of_rig(rig: RigFile, rig_path: Path, replay: Replay, read: FrameFolder) -> WhiteReference:
    if rig.calibration is None:
        raise RigFileError(
            f"{rig_path} names no flat ([calibration] flat), and {read.folder} lists no flat frame, so that radiances "
            f"have no scale: {frames_to_add(read, 'flat', read.entries[-1])}"
        )
    white = read_reference(flat_of(rig, rig_path))
    camera = camera_of(replay)
    if camera is not None and not camera.endswith(white.camera):
        raise CalibrationError(
            f"the flat was taken with camera {white.camera}, the frames with {camera}: name the flat of that camera "
            f"in {rig_path}, or add flat frames to the folder"
        )
    check_size(white, (replay.rows, replay.cols))
    return white


def measured_by(given: Given, job: Job, expected: Any) -> Any:  # noqa: ANN401 - as the kind of part has them
    """What the frames of a folder say, measured as an inspection measures them; nothing is copied.

    Raises:
        MeasurementError, CameraError: they cannot be used.
    """
    shots = tuple(
        Shot(entry.path.name, "", entry.load(), pose, entry.again, run=0, check=False)
        for entry, pose in given.replay.entries
    )
    acquired = AcquiredFrames(shots, camera_of(given.replay) or UNKNOWN, REPLAYED)
    return measure_frames(datetime.now(UTC), job, expected, acquired)[1]


def _copy(replay: Replay, frames: Path, folder: Path, advance: Advance, *, linear: bool) -> AcquiredFrames:
    """Copy the frames as they are, and enter each in the journal; what is held of them is released."""
    now = datetime.now(UTC).isoformat(timespec="milliseconds")
    run = RunLine(
        run=0, stage=REPLAYED, tilt=None, camera=camera_of(replay) or UNKNOWN, started_at=now, linear=linear
    )
    lines: list[RunLine | FrameLine] = [run]
    shots, inside = [], frames.resolve()
    with JournalFile(folder) as journal:
        try:
            for step, (entry, pose) in enumerate(replay.entries):
                advance("copying frames", step, len(replay.entries))
                name = Path(FRAMES) / entry.path.relative_to(inside)
                held = entry.held or HeldFile(entry.path)
                try:
                    (folder / name).parent.mkdir(parents=True, exist_ok=True)
                    (folder / name).write_bytes(held.content())
                except OSError as error:
                    raise RecordError(
                        f"cannot copy {entry.path} to {folder / name}: {error.strerror}"
                    ) from error
                frame = entry.load(held.content())
                shots.append(Shot(name.as_posix(), held.sha256, frame, pose, entry.again, run=0, check=False))
                lines.append(_line(shots[-1], step))
                held.release()
        finally:
            journal.append(lines)
    return AcquiredFrames(tuple(shots), run.camera, REPLAYED, linear)


def _line(shot: Shot, step: int) -> FrameLine:
    """The line of a copied frame in the journal."""
    frame = shot.frame
    return FrameLine(
        run=0,
        step=step,
        name=shot.name,
        sha256=shot.sha256,
        kind=frame.kind,
        again=shot.again,
        pose_deg=(shot.pose.stage_deg, shot.pose.tilt_deg),
        stage_deg=frame.stage_deg,
        tilt_deg=frame.tilt_deg,
        exposure_s=frame.exposure_s,
        gain=frame.gain,
        captured_at="",
    )


_MADE_ANEW = OWN | {JOB, KEPT_NAME, f"{INPUTS}/{LOT_NAME}"}


def judge_anew(
    folder: Path,
    mates: Sequence[LotMate],
    on_progress: Advance = silent,
    *,
    methods: Methods | None = None,
    reports: Reports | None = None,
) -> Inspected | None:
    """Judge a part by the frames of its finished inspection, compared with the other parts of its lot.

    A changed verdict is an inspection of its own, in a new folder next to that of the finished one, with the same
    frames; the finished one stays as it is.

    Args:
        folder: of the finished inspection.
        mates: inspections of the lot, the oldest first.
        on_progress: called with what is being done, steps done and steps in all.
        methods: what varies, for tests.
        reports: as for `anisoscope.inspection.run.inspect_part`.

    Returns:
        The inspection; None where the verdict stays, or the part is not compared with its lot.

    Raises:
        RecordError: a file of the folder is missing or was changed, or another process works in it.
        RecipeError, RigFileError, CalibrationError: a copy that this version cannot use.
    """
    folder = folder.resolve()
    with contextlib.ExitStack() as cleanup:
        cleanup.enter_context(working_in(folder))
        recorded = read_record(folder)
        manifest, job = reopen(folder)
        if job.reference is not None and manifest.input(LOT) is None:
            return None
        found = job.lot_parts(manifest.particulars.lot, mates)
        if found is None:
            return None
        parts = golden_text(found).encode()
        sha256 = hashlib.sha256(parts).hexdigest()
        copy = InputCopy(role=LOT, name=f"{INPUTS}/{LOT_NAME}", sha256=sha256, original="")
        before = f"{recorded.verdict} in {folder.name} ({RECORD_NAME} {sha256_of(folder / RECORD_NAME)})"
        inputs = (*(one for one in manifest.inputs if one.role != LOT), copy)
        manifest = manifest.model_copy(update={"inputs": inputs, "judged_anew": before})
        job = replace(job, reference=found)
        with expecting(job, on_progress, mates, methods) as ready:
            on_progress("measurement", 0, 1)
            judged = judged_by(manifest, job, ready, read_frames(folder, manifest), on_progress)
            if judged[0].verdict == recorded.verdict:
                ready.discard()
                return None
            new = cleanup.enter_context(new_folder(folder.parent, manifest.serial))
            for file in recorded.files:
                if file.name not in _MADE_ANEW:
                    _copy_file(file, folder, new)
            write_bytes(new / copy.name, parts)
            write_manifest(manifest, new)
            concluded = conclude(new, manifest, job, ready, on_progress, judged)
    return reported(*concluded, reports, on_progress)


def _copy_file(file: InputFile, folder: Path, new: Path) -> None:
    """Copy a file of a folder into another one; large ones are on the disk once."""
    content, path = checked_content(file, folder), new / file.name
    path.parent.mkdir(exist_ok=True)
    if len(content) < LARGE:
        write_bytes(path, content)
        return
    share(file, folder)
    store(content, file, new)
