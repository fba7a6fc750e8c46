"""From the frames of an inspection to its record: linearise, register, measure, decide."""

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.area import cell_log_ratios
from anisoscope.decision import decide
from anisoscope.errors import CalibrationError, CameraError, MeasurementError, Saturated
from anisoscope.expectation import Expectation
from anisoscope.job import Job
from anisoscope.jobfile import JobFile
from anisoscope.linear import RadianceImage, Stack, linearise, stack
from anisoscope.measurement import View, check_light, check_view, drift_complaint, measure, region_grid
from anisoscope.record import Record
from anisoscope.recording import make_record, results
from anisoscope.registration import locate, resample
from anisoscope.report.inspection_page import Pictures
from anisoscope.rig.acquisition.plan import Pose
from anisoscope.rig.frame import FrameKind
from anisoscope.taken import Shot, Taken

MAX_SATURATED_PICTURE = 0.02


@dataclass(frozen=True, eq=False)
class _Views:
    """The poses in the order of the recipe, and the first of them as seen again: at the end, and on resuming."""

    poses: list[View]
    at_end: list[View]
    on_resuming: list[View]


def judge(made: JobFile, job: Job, expected: Expectation, taken: Taken) -> tuple[Record, Pictures]:
    """Measure and decide; what makes the measurement unfit becomes an INVALID record.

    Args:
        made: how the inspection began.
        job: its recipe, rig and white reference.
        expected: the prediction.
        taken: its frames.

    Returns:
        The record, without the list of the folder's files, and the pictures of the report.
    """
    try:
        views = _views(job, expected, taken)
        closing, change = _most_changed(views, job)
        measured = measure(views.poses, closing, job.recipe, expected, job.rig.camera.pixel_um)
        decision = decide(expected, measured, job.recipe)
    except (MeasurementError, CameraError) as error:
        record = make_record(made, job, expected, taken, verdict="INVALID", reasons=(str(error),))
        return record, Pictures(raw=_as_photographed(taken), surface=expected.surface)
    unfit = _complaint_on_resuming(change, job) or drift_complaint(measured, job.recipe)
    pictures = Pictures(
        aligned=measured.aligned,
        size_mm=measured.grid.size_mm,
        ratios=cell_log_ratios(measured, expected.poses),
        deviating=decision.deviating,
        surface=expected.surface,
    )
    record = make_record(
        made,
        job,
        expected,
        taken,
        verdict="INVALID" if unfit else decision.verdict.value,
        reasons=(unfit,) if unfit else decision.reasons,
        **results(job, expected, views.poses, measured, decision),
    )
    return record, pictures


def _as_photographed(taken: Taken) -> tuple[tuple[str, npt.NDArray[np.float32]], ...]:
    """The first frame of every pose, raw."""
    first = {shot.pose: shot for shot in reversed(taken.shots) if shot.frame.kind == "sample"}
    poses = sorted(first, key=lambda pose: (pose.tilt_deg, pose.stage_deg))
    tilted = len({pose.tilt_deg for pose in poses}) > 1
    return tuple(
        (
            f"{pose.stage_deg:g}°" + (f", tilt {pose.tilt_deg:g}°" if tilted else ""),
            first[pose].frame.counts.astype(np.float32),
        )
        for pose in poses
    )


def _views(job: Job, expected: Expectation, taken: Taken) -> _Views:
    groups: dict[tuple[Pose, bool, bool, int], list[Shot]] = defaultdict(list)
    for shot in taken.shots:
        if shot.frame.kind == "sample":
            groups[shot.pose, shot.again, shot.check, shot.run if shot.check else 0].append(shot)
    plain = {pose: shots for (pose, again, _, _), shots in groups.items() if not again}
    wanted = [Pose(pose.stage_deg, pose.tilt_deg) for pose in expected.poses]
    for pose in wanted:
        if pose not in plain:
            raise MeasurementError(f"there is no picture at {pose.stage_deg:g}°, tilt {pose.tilt_deg:g}°")
    first_again = [(check, s) for (pose, again, check, _), s in groups.items() if again and pose == wanted[0]]
    return _Views(
        [_view(job, plain[pose], taken) for pose in wanted],
        [_view(job, shots, taken) for check, shots in first_again if not check],
        [_view(job, shots, taken) for check, shots in first_again if check],
    )


def _view(job: Job, shots: list[Shot], taken: Taken) -> View:
    pose, sample = shots[0].pose, stack(shot.frame for shot in shots)
    dark = _like("dark", sample, taken)
    image = linearise(_without_stray(sample, dark, taken), dark, job.white, taken.full_scale)
    check_light(pose.stage_deg, image, job.recipe)
    share = float(image.saturated.mean())
    if share > MAX_SATURATED_PICTURE:
        raise Saturated(
            f"at {pose.stage_deg:g}° {share:.1%} of the picture are saturated (limit "
            f"{MAX_SATURATED_PICTURE:.0%}): shorten acquisition.exposure_s in the recipe"
        )
    tilt_deg = float(np.mean([shot.frame.tilt_deg for shot in shots]))
    return View(pose.stage_deg, pose.tilt_deg, image, locate(_picture(image), job.fixture, tilt_deg))


def _like(kind: FrameKind, sample: Stack, taken: Taken) -> Stack:
    """The frames of a kind that were exposed like the sample.

    Raises:
        CalibrationError: there are none.
    """
    frames = [shot.frame for shot in taken.shots if shot.frame.kind == kind]
    alike = [frame for frame in frames if (frame.exposure_s, frame.gain) == (sample.exposure_s, sample.gain)]
    if not alike:
        what = "none at all" if not frames else f"only such of {frames[0].exposure_s:g} s"
        raise CalibrationError(
            f"the pictures are exposed for {sample.exposure_s:g} s at gain {sample.gain:g}, but of {kind} frames "
            f"there are {what}: take some exposed alike"
        )
    return stack(alike)


def _without_stray(sample: Stack, dark: Stack, taken: Taken) -> Stack:
    """The sample without the light that reaches the camera by other ways, where a light trap shows how much."""
    if not any(shot.frame.kind == "stray" for shot in taken.shots):
        return sample
    stray = _like("stray", sample, taken)
    own = sample.noise**2 + sample.frames * (stray.noise**2 / stray.frames + dark.noise**2 / dark.frames)
    return replace(sample, mean=sample.mean - (stray.mean - dark.mean), noise=np.sqrt(own))


def _picture(image: RadianceImage) -> npt.NDArray[np.float32]:
    """What the markers are searched in; a saturated pixel has no value, but it is surely bright."""
    brightest = image.value.max(initial=0.0, where=image.usable)
    return np.where(image.saturated, brightest, image.value)


def _most_changed(views: _Views, job: Job) -> tuple[View | None, float]:
    """The view of the first pose that differs most from the first one, and how much those on resuming differ."""
    if not views.on_resuming:
        return next(iter(views.at_end), None), 0.0
    pixel_um = job.rig.camera.pixel_um
    grid, _ = region_grid(job.recipe, pixel_um)

    def mean(view: View) -> float:
        check_view(view, views.poses[0], job.recipe, pixel_um)
        return float(np.nanmean(resample(view.image.value, view.placement, grid), dtype=np.float64))

    first = mean(views.poses[0])
    again = [(mean(view) / first - 1.0, view) for view in (*views.on_resuming, *views.at_end)]
    resumed = max((change for change, _ in again[: len(views.on_resuming)]), key=abs)
    return max(again, key=lambda found: abs(found[0]))[1], resumed


def _complaint_on_resuming(change: float, job: Job) -> str | None:
    """Why the frames before and after an interruption do not belong together, if they do not."""
    limit = job.recipe.limits.drift
    if abs(change) <= limit:
        return None
    return (
        f"when the inspection was resumed, the first pose had changed by {change:+.1%} (limit {limit:.1%}): lamp or "
        "part are not as they were; inspect the part anew"
    )
