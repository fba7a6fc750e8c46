"""One inspection from recipe to report: expect, photograph, linearise, register, measure, decide, record."""

import contextlib
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from anisoscope.area import cell_log_ratios
from anisoscope.decision import decide
from anisoscope.errors import (
    CalibrationError,
    CameraError,
    MeasurementError,
    Saturated,
)
from anisoscope.job import Job, make_folder, prepare, remove_if_empty
from anisoscope.linear import RadianceImage, check_size, linearise, stack
from anisoscope.measurement import View, check_light, drift_complaint, measure
from anisoscope.progress import Advance, silent
from anisoscope.record import (
    Record,
    write_record,
)
from anisoscope.recording import Taken, make_record, results
from anisoscope.registration import Placement, locate
from anisoscope.report.inspection_page import Pictures, start_renderer, write_report
from anisoscope.rig.acquisition.plan import Plan
from anisoscope.rig.acquisition.plan import Pose as RigPose
from anisoscope.rig.acquisition.runner import open_rig, run_plan
from anisoscope.rig.frame import Frame

MAX_SATURATED_PICTURE = 0.02


@dataclass(frozen=True, eq=False)
class Inspected:
    """A finished inspection: its record, where it lies, and what the user should know besides."""

    record: Record
    folder: Path
    report: Path
    notes: tuple[str, ...] = ()


def inspect_part(
    recipe_path: Path, rig_path: Path, serial: str, out: Path, on_progress: Advance = silent
) -> Inspected:
    """Photograph a part on a rig and judge it.

    Args:
        recipe_path: recipe file.
        rig_path: rig file.
        serial: serial number of the part.
        out: folder that receives the inspection folder.
        on_progress: called with what is being done, steps done and steps in all.

    Returns:
        The record, INVALID included.

    Raises:
        UsageError, RecipeError, RigFileError, HeightMapError, CalibrationError: before anything moves.
        RigError: hardware; the frames taken so far stay in the folder, no record is written. Without any frame
            the folder goes too.
        RecordError: the folder cannot be written.
    """
    on_progress("prediction", 0, 1)
    job = prepare(recipe_path, rig_path, serial)
    folder = make_folder(out, serial)
    with contextlib.ExitStack() as cleanup:
        cleanup.callback(remove_if_empty, folder)
        renderer = start_renderer(job.expected.surface)
        if renderer is not None:
            cleanup.callback(renderer.discard)
        taken = _photograph(job, folder, on_progress)
        on_progress("measurement", 0, 1)
        record, pictures = _judge(job, taken, folder)
        write_record(record, folder)
        on_progress("report", 0, 1)
        view = renderer.result() if renderer is not None else None
        report = write_report(record, pictures, folder, view)
    on_progress(record.verdict, 1, 1)
    lost = (f"no 3-D view in the report: {view.note}",) if view is not None and view.png is None else ()
    return Inspected(record, folder, report, lost)


def _photograph(job: Job, folder: Path, advance: Advance) -> Taken:
    acquisition = job.recipe.acquisition
    plan = Plan(
        poses=tuple(RigPose(pose.stage_deg, pose.tilt_deg) for pose in job.expected.poses),
        exposure_s=acquisition.exposure_s,
        gain=acquisition.gain,
        frames_per_pose=acquisition.frames_per_pose,
        dark_frames=acquisition.dark_frames,
        settle_s=acquisition.settle_s,
        return_to_first=True,
    )
    with open_rig(job.rig) as rig:
        info = rig.camera.info
        if job.white.camera != info.serial:
            raise CalibrationError(
                f"the flat was taken with camera {job.white.camera}, this is {info.serial}: "
                "take a new one with `anisoscope calibrate flat`"
            )
        check_size(job.white, (info.rows, info.cols))
        frames = run_plan(plan, rig, folder, on_progress=lambda now: advance(now.text, now.done, now.total))
        return Taken(tuple(frames), f"{info.model} {info.serial}", rig.stage.name, 2**info.bit_depth - 1)


def _judge(job: Job, taken: Taken, folder: Path) -> tuple[Record, Pictures]:
    """Measure and decide; what makes the measurement unfit becomes an INVALID record."""
    frames = [file.frame for file in taken.frames]
    try:
        views, closing = _views(job, taken)
        measured = measure(views, closing, job.recipe, job.expected, job.rig.camera.pixel_um)
        decision = decide(job.expected, measured, job.recipe)
    except (MeasurementError, CameraError) as error:
        first_of_pose = {frame.commanded_deg: frame for frame in reversed(frames) if frame.kind == "sample"}
        shown = tuple(
            (f"{angle:g}°", first_of_pose[angle].counts.astype("float32")) for angle in sorted(first_of_pose)
        )
        record = make_record(job, taken, folder, verdict="INVALID", reasons=(str(error),))
        return record, Pictures(raw=shown, surface=job.expected.surface)
    unfit = drift_complaint(measured, job.recipe)
    pictures = Pictures(
        aligned=measured.aligned,
        size_mm=measured.grid.size_mm,
        ratios=cell_log_ratios(measured, job.expected.poses),
        deviating=decision.deviating,
        surface=job.expected.surface,
    )
    record = make_record(
        job,
        taken,
        folder,
        verdict="INVALID" if unfit else decision.verdict.value,
        reasons=(unfit,) if unfit else decision.reasons,
        **results(job, views, measured, decision),
    )
    return record, pictures


def _views(job: Job, taken: Taken) -> tuple[list[View], View | None]:
    """Linear, located pictures in the order of the recipe, and the first pose as photographed at the end."""
    dark = stack(file.frame for file in taken.frames if file.frame.kind == "dark")
    groups: dict[tuple[float, float, bool], list[Frame]] = defaultdict(list)
    for file in taken.frames:
        if file.frame.kind == "sample":
            groups[file.frame.commanded_deg, file.frame.tilt_deg, file.again].append(file.frame)
    views: dict[bool, list[View]] = {False: [], True: []}
    for (_, _, again), group in groups.items():
        image = linearise(stack(group), dark, job.white, taken.full_scale)
        views[again].append(_view(job, group[0], image))
    return views[False], next(iter(views[True]), None)


def _view(job: Job, frame: Frame, image: RadianceImage) -> View:
    check_light(frame.commanded_deg, image, job.recipe)
    share = float(image.saturated.mean())
    if share > MAX_SATURATED_PICTURE:
        raise Saturated(
            f"at {frame.commanded_deg:g}° {share:.1%} of the picture are saturated (limit "
            f"{MAX_SATURATED_PICTURE:.0%}): shorten acquisition.exposure_s in the recipe"
        )
    return View(frame.commanded_deg, frame.tilt_deg, image, _place(job, image))


def _place(job: Job, image: RadianceImage) -> Placement:
    """Where the fixture stands; a saturated pixel has no value, but it is surely bright."""
    brightest = image.value.max(initial=0.0, where=image.usable)
    picture = np.where(image.saturated, brightest, image.value)
    return locate(picture, job.fixture, job.rig.geometry.tilt_deg)
