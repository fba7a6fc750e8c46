"""Views of an inspection: one linear picture per pose, with the placement of the part in it."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CalibrationError, MeasurementError, RegistrationError, Saturated
from anisoscope.base.parallel import for_each
from anisoscope.imaging.exposure_fusion import Exposed, radiance_of
from anisoscope.imaging.frame_check import usable_frames
from anisoscope.imaging.frames import AcquiredFrames, Shot
from anisoscope.imaging.linearisation import RadianceImage, Stack, WhiteReference, stack
from anisoscope.imaging.pose_radiance import Limited, check_light, check_view
from anisoscope.imaging.registration.edges import TurnedPicture, place_by_edges
from anisoscope.imaging.registration.lens import Lens
from anisoscope.imaging.registration.placement import Placement, View, locate
from anisoscope.imaging.rig_monitor import FixtureReference, RigMonitor, corrected, watch
from anisoscope.parameters.geometry import Pose as LightPose
from anisoscope.rig.acquisition.plan import Pose
from anisoscope.rig.fixture import Fixture
from anisoscope.rig.frame import Frame, FrameKind

Guide = Callable[[npt.NDArray[np.float32]], npt.NDArray[np.float32]]
MAX_SATURATED_PICTURE = 0.02
_EVEN = np.array([0.25, 0.5, 0.25], dtype=np.float32)


class Corrections(Protocol):
    """Corrections by the calibrations of a rig; implemented in `anisoscope.calibration.corrections`."""

    @property
    def axis_px(self) -> tuple[float, float] | None:
        """(column, row) of the rotation axis in the picture, where it is known."""
        ...

    @property
    def lens(self) -> Lens | None:
        """Distortion of the pictures, where it is calibrated."""
        ...

    @property
    def fixture_reference(self) -> FixtureReference | None:
        """Reference of the fixture's markers, where it was taught."""
        ...

    def corrected(self, sample: Stack, dark: Stack) -> Stack:
        """A sample in counts of a linear camera, without stray light."""
        ...

    def masked(self, image: RadianceImage) -> RadianceImage:
        """A picture without its known hot pixels."""
        ...


@dataclass(frozen=True, eq=False)
class Viewing:
    """Settings for the conversion of frames to views.

    Attributes:
        white: the white reference.
        corrections: the calibrations.
        fixture: the markers; None where pictures are registered by edges.
        pixel_um: size of a camera pixel on the sample according to the rig file.
        recipe: limits of a valid measurement.
        guides: filters applied in turn to a picture before markers and edges are searched in it.
    """

    white: WhiteReference
    corrections: Corrections
    fixture: Fixture | None
    pixel_um: float
    recipe: Limited
    guides: tuple[Guide, ...] = ()


@dataclass(frozen=True, eq=False)
class Views:
    """Views of the poses in the order of the recipe, and repetitions of the first: at the end, and on resuming.

    ``monitor`` is the state of the rig in them; None of inspections that were judged without one.
    ``frame_notes`` name the frames that were left out.
    """

    poses: list[View]
    at_end: list[View]
    on_resuming: list[View]
    monitor: RigMonitor | None = None
    frame_notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Photograph:
    """A linear picture to be registered.

    Attributes:
        stage_deg, tilt_deg: commanded angles.
        arm_deg: tilt of the arm as read back.
        image: the picture.
        guide: filter for the picture in which markers and edges are searched, or None.
    """

    stage_deg: float
    tilt_deg: float
    arm_deg: float
    image: RadianceImage
    guide: Guide | None = None


def luminance(picture: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """(rows, cols) luminance of a mosaic for the marker search: (R + 2 G + B)/4 at every pixel.

    The binomial 3 × 3 weights all four filters of a mosaic with a quarter each and shifts no edge.
    """
    return np.asarray(cv2.sepFilter2D(picture, -1, _EVEN, _EVEN, borderType=cv2.BORDER_REFLECT_101))


def clipped_at_white(picture: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """(rows, cols) a picture in 1/sr clipped at the radiance of a white diffuser, for the search of printed markers.

    A mirror may be a thousand times as bright as a print next to it.
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
    """Linear pictures of all poses, and the placement of the part in each.

    Args:
        viewing: white reference, calibrations, fixture and limits.
        poses: the requested poses.
        acquired: the frames.

    Raises:
        MeasurementError, CameraError: INVALID, with the reason.
    """
    acquired, frame_notes = usable_frames(acquired, viewing.recipe.limits)
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
    placed = register(for_each(photograph, groups_of_shots), viewing)
    first_end, first_resumed = len(requested), len(requested) + len(at_end)
    monitor = watch(
        placed[:first_end],
        placed[first_end:],
        viewing.fixture,
        viewing.recipe.limits,
        viewing.corrections.fixture_reference,
    )
    if monitor.poses and monitor.fault is None:
        placed = [corrected(view, state) for view, state in zip(placed, monitor.poses, strict=True)]
    return Views(
        placed[:first_end], placed[first_end:first_resumed], placed[first_resumed:], monitor, frame_notes
    )


def _ready_before_threads(
    viewing: Viewing, settings: set[tuple[float, float]], like: Callable[[FrameKind, float, float], Stack]
) -> None:
    """Compute what all poses share once, before they are processed in parallel threads."""
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
    """Filter for the picture in which markers are searched, or None."""
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
    """The frames of a pose at one exposure, with their dark frames and corrections."""
    raw = stack(frames)
    dark = like("dark", raw.exposure_s, raw.gain)

    def corrected(sample: Stack) -> Stack:
        return viewing.corrections.corrected(_without_stray(sample, dark, acquired, like), dark)

    return Exposed(raw, dark, corrected)


def _like(kind: FrameKind, exposure_s: float, gain: float, acquired: AcquiredFrames) -> Stack:
    """The frames of a kind with the same exposure and gain.

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
    """The sample minus the stray light measured with a light trap, where there are such frames."""
    if not any(shot.frame.kind == "stray" for shot in acquired.shots):
        return sample
    stray = like("stray", sample.exposure_s, sample.gain)
    own = sample.noise**2 + sample.frames * (stray.noise**2 / stray.frames + dark.noise**2 / dark.frames)
    return replace(sample, mean=sample.mean - (stray.mean - dark.mean), scatter=np.sqrt(own))


def register(photographs: Sequence[Photograph], viewing: Viewing) -> list[View]:
    """Register the part in every picture: by the fixture's markers, or by edges.

    Without a fixture, or where it permits this and too few of its markers are visible, all pictures are registered to
    the first one by their edges; the sample's origin is then the rotation axis.

    Args:
        photographs: the first is the reference for edges.
        viewing: fixture, size of a pixel, limits, and the calibrated rotation axis and lens.

    Raises:
        RegistrationError: both fail.
    """
    if viewing.fixture is not None:
        fixture, lens, off_um = viewing.fixture, viewing.corrections.lens, viewing.recipe.limits.marker_off_um

        def located(one: Photograph) -> Placement:
            return locate(_searched(one), fixture, one.arm_deg, lens=lens, marker_off_um=off_um)

        try:
            return _views(photographs, for_each(located, photographs))
        except RegistrationError as by_markers:
            if fixture.without_markers == "refuse":
                raise
            try:
                return _views(photographs, _by_edges(photographs, viewing))
            except RegistrationError as by_edges:
                raise RegistrationError(f"{by_markers}; without them: {by_edges}") from by_edges
    return _views(photographs, _by_edges(photographs, viewing))


def _by_edges(photographs: Sequence[Photograph], viewing: Viewing) -> list[Placement]:
    pictures = [TurnedPicture(_searched(one), one.stage_deg, one.arm_deg) for one in photographs]
    calibrated = viewing.corrections
    return place_by_edges(pictures, viewing.pixel_um, calibrated.axis_px, calibrated.lens)


def _views(photographs: Sequence[Photograph], places: Sequence[Placement]) -> list[View]:
    return [
        View(one.stage_deg, one.tilt_deg, one.image, where)
        for one, where in zip(photographs, places, strict=True)
    ]


def _searched(one: Photograph) -> npt.NDArray[np.float32]:
    found = _bright(one.image)
    return found if one.guide is None else one.guide(found)


def _bright(image: RadianceImage) -> npt.NDArray[np.float32]:
    """The picture searched: saturated pixels, which have no value, count as the brightest ones."""
    if not image.saturated.any():
        return image.value
    brightest = image.value.max(initial=0.0, where=image.usable)
    return np.where(image.saturated, brightest, image.value)


def most_changed(
    views: Views, recipe: Limited, pixel_um: float, mean: Callable[[View], float]
) -> tuple[View | None, float]:
    """The repetition of the first pose that differs most from it, and the changes found on resuming.

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
    """Reason why the frames before and after an interruption do not belong together, or None."""
    if abs(change) <= limit:
        return None
    return (
        f"when the inspection was resumed, the first pose had changed by {change:+.1%} (limit {limit:.1%}): lamp or "
        "part are not as they were; inspect the part anew"
    )
