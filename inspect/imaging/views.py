"""From the frames of an inspection to views: one linear picture a pose, and where the part stands in it."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError, MeasurementError, Saturated
from anisoscope.base.parallel import for_each
from anisoscope.imaging.exposure_fusion import Exposed, radiance_of
from anisoscope.imaging.frames import AcquiredFrames, Shot
from anisoscope.imaging.linearisation import RadianceImage, Stack, WhiteReference, stack
from anisoscope.imaging.pose_radiance import Limited, check_light, check_view
from anisoscope.imaging.registration.placement import View
from anisoscope.imaging.registration.placing import Photograph, place
from anisoscope.record.schema import PoseRecord
from anisoscope.rig.acquisition.plan import Pose
from anisoscope.rig.fixture import Fixture
from anisoscope.rig.frame import Frame, FrameKind
from anisoscope.sim.light.geometry import Pose as LightPose

Guide = Callable[[npt.NDArray[np.float32]], npt.NDArray[np.float32]]
MAX_SATURATED_PICTURE = 0.02
_EVEN = np.array([0.25, 0.5, 0.25], dtype=np.float32)


class Corrections(Protocol):
    """What the calibrations of a rig change in a picture; `anisoscope.calibration.corrections` has them."""

    @property
    def axis_px(self) -> tuple[float, float] | None:
        """(column, row) of the rotation axis in the picture, where it is known."""
        ...

    def corrected(self, sample: Stack, dark: Stack) -> Stack:
        """A sample as a linear camera would have counted it, without stray light."""
        ...

    def masked(self, image: RadianceImage) -> RadianceImage:
        """A picture without the pixels that are known to be hot."""
        ...


@dataclass(frozen=True, eq=False)
class Viewing:
    """By what frames become views.

    Attributes:
        white: the white reference.
        corrections: the calibrations.
        fixture: the markers; None where pictures are aligned by their edges.
        pixel_um: size of a camera pixel on the sample according to the rig file.
        recipe: what makes a measurement unfit.
        guides: what is done to a picture before markers and edges are searched in it, one after the other.
    """

    white: WhiteReference
    corrections: Corrections
    fixture: Fixture | None
    pixel_um: float
    recipe: Limited
    guides: tuple[Guide, ...] = ()


@dataclass(frozen=True, eq=False)
class Views:
    """The poses in the order of the recipe, and the first of them as seen again: at the end, and on resuming."""

    poses: list[View]
    at_end: list[View]
    on_resuming: list[View]


def luminance(picture: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """(rows, cols) a mosaic with its colours evened out, to find markers in: (R + 2 G + B)/4 at every pixel.

    The binomial 3 × 3 weighs all four filters of a mosaic with a quarter each and moves no edge.
    """
    return np.asarray(cv2.sepFilter2D(picture, -1, _EVEN, _EVEN, borderType=cv2.BORDER_REFLECT_101))


def clipped_at_white(picture: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """(rows, cols) a picture in 1/sr where nothing is brighter than a white diffuser, to find printed markers in.

    A mirror may be a thousand times as bright as what is printed beside it.
    """
    return np.minimum(picture, np.float32(1.0 / np.pi))


def as_photographed(acquired: AcquiredFrames) -> tuple[tuple[str, npt.NDArray[np.float32]], ...]:
    """The first frame of every pose, raw."""
    first = {shot.pose: shot for shot in reversed(acquired.shots) if shot.frame.kind == "sample"}
    poses = sorted(first, key=lambda pose: (pose.tilt_deg, pose.stage_deg))
    tilted = len({pose.tilt_deg for pose in poses}) > 1
    return tuple(
        (
            f"{pose.stage_deg:g}°" + (f", tilt {pose.tilt_deg:g}°" if tilted else ""),
            first[pose].frame.counts.astype(np.float32),
        )
        for pose in poses
    )


def views_of(viewing: Viewing, poses: Sequence[LightPose], acquired: AcquiredFrames) -> Views:
    """All pictures that count, linear, and where the part stands in each.

    Args:
        viewing: white reference, calibrations, fixture and limits.
        poses: those that were asked for.
        acquired: the frames.

    Raises:
        MeasurementError, CameraError: INVALID, with the reason.
    """
    groups: dict[tuple[Pose, bool, bool, int], list[Shot]] = defaultdict(list)
    for shot in acquired.shots:
        if shot.frame.kind == "sample":
            groups[shot.pose, shot.again, shot.check, shot.run if shot.check else 0].append(shot)
    plain = {pose: shots for (pose, again, _, _), shots in groups.items() if not again}
    requested = [Pose(pose.stage_deg, pose.tilt_deg) for pose in poses]
    for pose in requested:
        if pose not in plain:
            raise MeasurementError(f"there is no picture at {pose.stage_deg:g}°, tilt {pose.tilt_deg:g}°")
    first_again = [
        (check, s) for (pose, again, check, _), s in groups.items() if again and pose == requested[0]
    ]
    at_end = [shots for check, shots in first_again if not check]
    on_resuming = [shots for check, shots in first_again if check]
    groups_of_shots = [*(plain[pose] for pose in requested), *at_end, *on_resuming]

    @cache
    def like(kind: FrameKind, exposure_s: float, gain: float) -> Stack:
        return _like(kind, exposure_s, gain, acquired)

    def photograph(shots: list[Shot]) -> Photograph:
        return _photograph(viewing, shots, acquired, like)

    settings = {(shot.frame.exposure_s, shot.frame.gain) for shots in groups_of_shots for shot in shots}
    _ready_before_threads(viewing, settings, like)
    placed = place(
        for_each(photograph, groups_of_shots), viewing.fixture, viewing.pixel_um, viewing.corrections.axis_px
    )
    first_end, first_resumed = len(requested), len(requested) + len(at_end)
    return Views(placed[:first_end], placed[first_end:first_resumed], placed[first_resumed:])


def _ready_before_threads(
    viewing: Viewing, settings: set[tuple[float, float]], like: Callable[[FrameKind, float, float], Stack]
) -> None:
    """What all poses share is made once, before they are worked on side by side."""
    tasks: list[Callable[[], object]] = [lambda: viewing.white.radiance_per_signal]
    tasks += [lambda one=setting: like("dark", *one).hot for setting in sorted(settings)]  # type: ignore[misc]
    for_each(lambda task: task(), tasks)


def _photograph(
    viewing: Viewing,
    shots: list[Shot],
    acquired: AcquiredFrames,
    like: Callable[[FrameKind, float, float], Stack],
) -> Photograph:
    pose, settings = shots[0].pose, dict.fromkeys((s.frame.exposure_s, s.frame.gain) for s in shots)
    exposed = [
        _exposed(
            viewing, [s.frame for s in shots if (s.frame.exposure_s, s.frame.gain) == one], acquired, like
        )
        for one in settings
    ]
    black = shots[0].frame.black_level
    image = viewing.corrections.masked(radiance_of(exposed, viewing.white, acquired.full_scale, black))
    check_light(pose.stage_deg, image, viewing.recipe)
    share = np.count_nonzero(image.saturated) / image.saturated.size
    if share > MAX_SATURATED_PICTURE:
        raise Saturated(
            f"at {pose.stage_deg:g}° {share:.1%} of the picture are saturated (limit "
            f"{MAX_SATURATED_PICTURE:.0%}): shorten acquisition.exposure_s in the recipe, or turn the lamp down"
        )
    arm_deg = float(np.mean([shot.frame.tilt_deg for shot in shots]))
    guide = _guide(shots[0].frame, viewing.guides)
    return Photograph(pose.stage_deg, pose.tilt_deg, arm_deg, image, guide=guide)


def _guide(frame: Frame, guides: tuple[Guide, ...]) -> Guide | None:
    """What markers are searched in, if it is not the picture itself."""
    steps = ((luminance,) if frame.filters != "mono" else ()) + guides
    if not steps:
        return None

    def evened(picture: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        for step in steps:
            picture = step(picture)
        return picture

    return evened


def _exposed(
    viewing: Viewing,
    frames: list[Frame],
    acquired: AcquiredFrames,
    like: Callable[[FrameKind, float, float], Stack],
) -> Exposed:
    """The frames of a pose at one exposure, with what is to be taken off them."""
    raw = stack(frames)
    dark = like("dark", raw.exposure_s, raw.gain)

    def corrected(sample: Stack) -> Stack:
        return viewing.corrections.corrected(_without_stray(sample, dark, acquired, like), dark)

    return Exposed(raw, dark, corrected)


def _like(kind: FrameKind, exposure_s: float, gain: float, acquired: AcquiredFrames) -> Stack:
    """The frames of a kind that were exposed like some others.

    Raises:
        CalibrationError: there are none.
    """
    frames = [shot.frame for shot in acquired.shots if shot.frame.kind == kind]
    alike = [frame for frame in frames if (frame.exposure_s, frame.gain) == (exposure_s, gain)]
    if not alike:
        what = "none at all" if not frames else f"only such of {frames[0].exposure_s:g} s"
        raise CalibrationError(
            f"the pictures are exposed for {exposure_s:g} s at gain {gain:g}, but of {kind} frames "
            f"there are {what}: take some exposed alike"
        )
    return stack(alike)


def _without_stray(
    sample: Stack, dark: Stack, acquired: AcquiredFrames, like: Callable[[FrameKind, float, float], Stack]
) -> Stack:
    """The sample without the light that reaches the camera by other ways, where a light trap shows how much."""
    if not any(shot.frame.kind == "stray" for shot in acquired.shots):
        return sample
    stray = like("stray", sample.exposure_s, sample.gain)
    own = sample.noise**2 + sample.frames * (stray.noise**2 / stray.frames + dark.noise**2 / dark.frames)
    return replace(sample, mean=sample.mean - (stray.mean - dark.mean), scatter=np.sqrt(own))


def most_changed(
    views: Views, recipe: Limited, pixel_um: float, mean: Callable[[View], float]
) -> tuple[View | None, float]:
    """The view of the first pose that differs most from the first one, and how much those on resuming differ.

    Args:
        views: all of them.
        recipe: its limits.
        pixel_um: size of a camera pixel on the sample according to the rig file.
        mean: brightness of a view in the region.
    """
    if not views.on_resuming:
        return next(iter(views.at_end), None), 0.0

    def checked(view: View) -> float:
        check_view(view, views.poses[0], recipe, pixel_um)
        return mean(view)

    first = checked(views.poses[0])
    again = [(checked(view) / first - 1.0, view) for view in (*views.on_resuming, *views.at_end)]
    resumed = max((change for change, _ in again[: len(views.on_resuming)]), key=abs)
    return max(again, key=lambda found: abs(found[0]))[1], resumed


def resuming_error(change: float, limit: float) -> str | None:
    """Why the frames before and after an interruption do not belong together, if they do not."""
    if abs(change) <= limit:
        return None
    return (
        f"when the inspection was resumed, the first pose had changed by {change:+.1%} (limit {limit:.1%}): lamp or "
        "part are not as they were; inspect the part anew"
    )


def pose_records(views: list[View], measured: FloatArray, predicted: FloatArray) -> tuple[PoseRecord, ...]:
    """The poses with their (P,) measured and predicted radiances in 1/sr, and where the markers stood."""
    return tuple(
        PoseRecord(
            stage_deg=view.stage_deg,
            tilt_deg=view.tilt_deg,
            measured=radiance,
            predicted=expected,
            marker_angle_deg=view.placement.angle_deg,
            pixel_um=view.placement.pixel_um,
            residual_px=view.placement.residual_px,
            markers=view.placement.markers,
            dropped=view.placement.dropped,
        )
        for view, radiance, expected in zip(views, measured, predicted, strict=True)
    )
