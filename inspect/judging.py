"""From the frames of an inspection to its record: linearise, register, measure, decide."""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cache

import numpy as np
import numpy.typing as npt

from anisoscope.area import cell_log_ratios
from anisoscope.bracketing import Exposed, radiance_of
from anisoscope.decision import decide
from anisoscope.errors import CalibrationError, CameraError, MeasurementError, Saturated
from anisoscope.expectation import Expectation
from anisoscope.gates import check_part, check_views
from anisoscope.insight import insight, known_good
from anisoscope.job import Job
from anisoscope.jobfile import JobFile
from anisoscope.linear import Stack, stack
from anisoscope.localisation import deviation_map
from anisoscope.measurement import (
    Measured,
    View,
    check_light,
    check_view,
    drift_complaint,
    for_each,
    mean_of,
    measure,
    region_grid,
)
from anisoscope.progress import Advance, silent
from anisoscope.record import Record
from anisoscope.recording import make_record, results
from anisoscope.registration.placement import resample
from anisoscope.registration.placing import Photograph, place
from anisoscope.report.inspection_page import Pictures
from anisoscope.rig.acquisition.plan import Pose
from anisoscope.rig.frame import Frame, FrameKind
from anisoscope.taken import Shot, Taken
from anisoscope.verdict import Verdict

MAX_SATURATED_PICTURE = 0.02


@dataclass(frozen=True, eq=False)
class _Views:
    """The poses in the order of the recipe, and the first of them as seen again: at the end, and on resuming."""

    poses: list[View]
    at_end: list[View]
    on_resuming: list[View]


def judge(
    made: JobFile,
    job: Job,
    expected: Expectation,
    taken: Taken,
    advance: Advance = silent,
    *,
    final: bool = True,
) -> tuple[Record, Pictures]:
    """Measure and decide; what makes the measurement unfit becomes an INVALID record.

    Args:
        made: how the inspection began.
        job: its recipe, rig and white reference.
        expected: the prediction.
        taken: its frames.
        advance: told what is being explained, where that takes long.
        final: what is INCONCLUSIVE is explained as well; it will not be measured again.

    Returns:
        The record, without the list of the folder's files, and the pictures of the report.
    """
    if made.refused is not None:
        record = make_record(made, job, expected, taken, verdict="INVALID", reasons=(made.refused,))
        return record, Pictures(surface=expected.surface)
    try:
        views, measured, change = measure_frames(made, job, expected, taken)
        decision = decide(expected, measured, job.recipe, known_good(job))
    except (MeasurementError, CameraError) as error:
        record = make_record(made, job, expected, taken, verdict="INVALID", reasons=(str(error),))
        return record, Pictures(raw=_as_photographed(taken), surface=expected.surface)
    unfit = _complaint_on_resuming(change, job) or drift_complaint(measured, job.recipe)
    area, undecided = job.recipe.area, decision.verdict is Verdict.INCONCLUSIVE
    pictures = Pictures(
        aligned=measured.aligned,
        size_mm=measured.grid.size_mm,
        ratios=cell_log_ratios(measured, expected.poses),
        deviating=decision.deviating,
        deviation=None if area is None else deviation_map(measured, expected.poses, area),
        surface=expected.surface,
    )
    record = make_record(
        made,
        job,
        expected,
        taken,
        verdict="INVALID" if unfit else decision.verdict.value,
        reasons=(unfit,) if unfit else decision.reasons,
        **results(job, expected, views, measured, decision),
        **({} if unfit or (undecided and not final) else insight(job, expected, measured, decision, advance)),
    )
    return record, pictures


def measure_frames(
    made: JobFile, job: Job, expected: Expectation, taken: Taken
) -> tuple[list[View], Measured, float]:
    """The pose radiances of an inspection's frames, through all gates.

    Returns:
        The poses as seen, what was measured, and by how much the first pose had changed on resuming.

    Raises:
        MeasurementError, CameraError: INVALID, with the reason.
    """
    job.calibrations.check_valid(datetime.fromisoformat(made.created_at))
    views = _views(job, expected, taken)
    closing, change = _most_changed(views, job)
    for view in views.poses:
        job.calibrations.check_place(view.stage_deg, view.placement)
    check_views(views.poses, job.recipe)
    calibrated = job.calibrations.applied_to(job.recipe)
    measured = measure(views.poses, closing, calibrated, expected, job.rig.camera.pixel_um)
    check_part(views.poses, measured, job.recipe)
    return views.poses, measured, change


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
    at_end = [shots for check, shots in first_again if not check]
    on_resuming = [shots for check, shots in first_again if check]
    groups_of_shots = [*(plain[pose] for pose in wanted), *at_end, *on_resuming]

    @cache
    def like(kind: FrameKind, exposure_s: float, gain: float) -> Stack:
        return _like(kind, exposure_s, gain, taken)

    def photograph(shots: list[Shot]) -> Photograph:
        return _photograph(job, shots, taken, like)

    settings = {(shot.frame.exposure_s, shot.frame.gain) for shots in groups_of_shots for shot in shots}
    _ready_before_threads(job, settings, like)
    seen = place(
        for_each(photograph, groups_of_shots), job.fixture, job.rig.camera.pixel_um, job.calibrations.axis_px
    )
    first_end, first_resumed = len(wanted), len(wanted) + len(at_end)
    return _Views(seen[:first_end], seen[first_end:first_resumed], seen[first_resumed:])


def _ready_before_threads(
    job: Job, settings: set[tuple[float, float]], like: Callable[[FrameKind, float, float], Stack]
) -> None:
    """What all poses share is made once, before they are worked on side by side."""
    tasks: list[Callable[[], object]] = [lambda: job.white.radiance_per_signal]
    tasks += [lambda one=setting: like("dark", *one).hot for setting in sorted(settings)]  # type: ignore[misc]
    for_each(lambda task: task(), tasks)


def _photograph(
    job: Job, shots: list[Shot], taken: Taken, like: Callable[[FrameKind, float, float], Stack]
) -> Photograph:
    pose, settings = shots[0].pose, dict.fromkeys((s.frame.exposure_s, s.frame.gain) for s in shots)
    exposed = [
        _exposed(job, [s.frame for s in shots if (s.frame.exposure_s, s.frame.gain) == one], taken, like)
        for one in settings
    ]
    black = shots[0].frame.black_level
    image = job.calibrations.masked(radiance_of(exposed, job.white, taken.full_scale, black))
    check_light(pose.stage_deg, image, job.recipe)
    share = np.count_nonzero(image.saturated) / image.saturated.size
    if share > MAX_SATURATED_PICTURE:
        raise Saturated(
            f"at {pose.stage_deg:g}° {share:.1%} of the picture are saturated (limit "
            f"{MAX_SATURATED_PICTURE:.0%}): shorten acquisition.exposure_s in the recipe, or turn the lamp down"
        )
    arm_deg = float(np.mean([shot.frame.tilt_deg for shot in shots]))
    return Photograph(pose.stage_deg, pose.tilt_deg, arm_deg, image)


def _exposed(
    job: Job, frames: list[Frame], taken: Taken, like: Callable[[FrameKind, float, float], Stack]
) -> Exposed:
    """The frames of a pose at one exposure, with what is to be taken off them."""
    raw = stack(frames)
    dark = like("dark", raw.exposure_s, raw.gain)

    def corrected(sample: Stack) -> Stack:
        return job.calibrations.corrected(_without_stray(sample, dark, taken, like), dark)

    return Exposed(raw, dark, corrected)


def _like(kind: FrameKind, exposure_s: float, gain: float, taken: Taken) -> Stack:
    """The frames of a kind that were exposed like some others.

    Raises:
        CalibrationError: there are none.
    """
    frames = [shot.frame for shot in taken.shots if shot.frame.kind == kind]
    alike = [frame for frame in frames if (frame.exposure_s, frame.gain) == (exposure_s, gain)]
    if not alike:
        what = "none at all" if not frames else f"only such of {frames[0].exposure_s:g} s"
        raise CalibrationError(
            f"the pictures are exposed for {exposure_s:g} s at gain {gain:g}, but of {kind} frames "
            f"there are {what}: take some exposed alike"
        )
    return stack(alike)


def _without_stray(
    sample: Stack, dark: Stack, taken: Taken, like: Callable[[FrameKind, float, float], Stack]
) -> Stack:
    """The sample without the light that reaches the camera by other ways, where a light trap shows how much."""
    if not any(shot.frame.kind == "stray" for shot in taken.shots):
        return sample
    stray = like("stray", sample.exposure_s, sample.gain)
    own = sample.noise**2 + sample.frames * (stray.noise**2 / stray.frames + dark.noise**2 / dark.frames)
    return replace(sample, mean=sample.mean - (stray.mean - dark.mean), scatter=np.sqrt(own))


def _most_changed(views: _Views, job: Job) -> tuple[View | None, float]:
    """The view of the first pose that differs most from the first one, and how much those on resuming differ."""
    if not views.on_resuming:
        return next(iter(views.at_end), None), 0.0
    pixel_um = job.rig.camera.pixel_um
    grid, _ = region_grid(job.recipe, pixel_um)

    def mean(view: View) -> float:
        check_view(view, views.poses[0], job.recipe, pixel_um)
        return mean_of(resample(view.image.value, view.placement, grid))

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
