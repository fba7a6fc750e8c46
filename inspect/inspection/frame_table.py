"""Which frames of a folder belong to which pose of a recipe, and the white reference that they hold."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from anisoscope.base.errors import RecordError, RigFileError
from anisoscope.calibration.white_reference import make_reference
from anisoscope.decision.equipment import UNKNOWN
from anisoscope.imaging.exposure_fusion import MIN_FRAMES
from anisoscope.imaging.linearisation import stack
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.geometry import Pose as LightPose
from anisoscope.recipe.base import RecipeBase
from anisoscope.rig.acquisition.plan import Pose
from anisoscope.rig.cameras.response import LINEAR_BITS, LINEAR_BLACK, ResponseCurve
from anisoscope.rig.frame import FrameKind
from anisoscope.rig.framefolder import POSE_TOLERANCE_DEG, FrameEntry, FrameFolder, frames_to_add
from anisoscope.sim.light.geometry import directions


@dataclass(frozen=True, eq=False)
class Replay:
    """The frames of a folder, each with its pose in the recipe.

    Attributes:
        entries: frames in the order of their table; the pose of one that the recipe does not ask for is its own.
        rows, cols: shape of every frame.
        notes: what the user should know.
    """

    entries: tuple[tuple[FrameEntry, Pose], ...]
    rows: int
    cols: int
    notes: tuple[str, ...]

    def of_kind(self, kind: FrameKind) -> list[FrameEntry]:
        """The frames of a kind."""
        return [entry for entry, _ in self.entries if entry.kind == kind]


def arrange(folder: FrameFolder, recipe: RecipeBase) -> Replay:
    """Assign frames to the poses of a recipe, full turns aside.

    Raises:
        RecordError: a pose or the dark frames are missing, or a pose has several exposures with too few frames each.
    """
    required = [Pose(pose.stage_deg, pose.tilt_deg) for pose in recipe.poses.poses()]
    notes = list(folder.notes)
    found: list[tuple[FrameEntry, Pose]] = []
    groups: dict[Pose, list[FrameEntry]] = defaultdict(list)
    for entry in folder.entries:
        pose = next((pose for pose in required if _stands_at(entry, pose)), None)
        found.append((entry, pose or Pose(entry.stage_deg, entry.tilt_deg)))
        if entry.kind == "sample" and pose is not None and not entry.again:
            groups[pose].append(entry)
    _check_poses(folder, required, groups)
    _check_exposures(folder)
    used = sum(map(len, groups.values()))
    if passed_over := len(folder.of_kind("sample", again=False)) - used:
        notes.append(
            f"{passed_over} sample frames at poses that the recipe does not ask for were passed over"
        )
    if not any(entry.again and pose == required[0] for entry, pose in found):
        notes.append("no frames show the first pose again at the end: drift of the lamp is not known")
    if min(map(len, groups.values())) < MIN_FRAMES:
        notes.append("a pose has one frame only: noise of the camera is not in the uncertainty")
    return Replay(tuple(found), folder.rows, folder.cols, tuple(notes))


def _stands_at(entry: FrameEntry, pose: Pose) -> bool:
    turned = (entry.stage_deg - pose.stage_deg + 180.0) % 360.0 - 180.0
    return abs(turned) <= POSE_TOLERANCE_DEG and abs(entry.tilt_deg - pose.tilt_deg) <= POSE_TOLERANCE_DEG


def _check_poses(folder: FrameFolder, required: list[Pose], groups: dict[Pose, list[FrameEntry]]) -> None:
    missing = [pose for pose in required if pose not in groups]
    if missing:
        samples = folder.of_kind("sample")
        available = sorted({(round(e.tilt_deg, 2) + 0.0, round(e.stage_deg, 2) + 0.0) for e in samples})
        listing = ", ".join(f"{stage:g}° (tilt {tilt:g}°)" for tilt, stage in available) or "none"
        raise RecordError(
            f"{folder.folder}: the recipe asks for a picture at {missing[0].stage_deg:g}°, tilt "
            f"{missing[0].tilt_deg:g}°; sample frames there are at: {listing}"
        )
    for pose, entries in groups.items():
        _check_bracket(folder, pose, entries)


def _check_bracket(folder: FrameFolder, pose: Pose, entries: list[FrameEntry]) -> None:
    """Merge the exposures of a pose; their own scatter weights them."""
    place = f"{folder.folder}: the sample frames at {pose.stage_deg:g}°, tilt {pose.tilt_deg:g}°"
    if len({entry.gain for entry in entries}) > 1:
        raise RecordError(f"{place} differ in gain: one gain a pose is needed")
    counts = Counter(entry.exposure_s for entry in entries)
    if len(counts) == 1:
        return
    darks = Counter(entry.exposure_s for entry in folder.of_kind("dark") if entry.gain == entries[0].gain)
    for exposure_s, count in sorted(counts.items()):
        dark = darks.get(exposure_s, MIN_FRAMES)  # without any, another message says more
        for words, found in (("sample", count), ("dark", dark)):
            if found < MIN_FRAMES:
                raise RecordError(
                    f"{place} have {len(counts)} exposures, which takes {MIN_FRAMES} or more frames of each; of "
                    f"{exposure_s:g} s there is {found} {words} frame"
                )


def _check_exposures(folder: FrameFolder) -> None:
    depths = {entry.bit_depth for entry in folder.entries}
    if len(depths) > 1:
        raise RecordError(
            f"{folder.folder}: frames of {' and '.join(map(str, sorted(depths)))} bits; one bit depth is needed"
        )
    dark = {(entry.exposure_s, entry.gain) for entry in folder.of_kind("dark")}
    for entry in folder.entries:
        if entry.kind in {"sample", "flat", "stray"} and (entry.exposure_s, entry.gain) not in dark:
            raise RecordError(
                f"{folder.folder}: there is no dark frame of {entry.exposure_s:g} s at gain {entry.gain:g}, as the "
                f"{entry.kind} frame {entry.path.name} was exposed: {frames_to_add(folder, 'dark', entry)}"
            )


def linear_entries(entries: Sequence[FrameEntry], curve: ResponseCurve) -> tuple[FrameEntry, ...]:
    """Frames of a camera that is not linear, read through its response curve.

    Raises:
        RigFileError: the curve is that of other bits or of another camera.
    """
    if not entries:
        return ()
    camera, bits = entries[0].load().camera, {entry.bit_depth for entry in entries}
    if bits != {curve.bit_depth} or (camera != UNKNOWN and curve.camera not in camera):
        raise RigFileError(
            f"camera.options.response is the curve of camera {curve.camera} with {curve.bit_depth} bits, the frames "
            f"are of camera {camera} with {', '.join(map(str, sorted(bits)))}: take one of it with `anisoscope "
            "calibrate response`"
        )
    through = (curve.bit_depth, curve.linearise)
    return tuple(
        replace(entry, bit_depth=LINEAR_BITS, black_level=float(LINEAR_BLACK), linearise=through)
        for entry in entries
    )


def camera_of(replay: Replay) -> str | None:
    """The camera of the frames, where they name it."""
    camera = replay.entries[0][0].load().camera
    return None if camera == UNKNOWN else camera


def white_of(replay: Replay, reflectance: float, light_angle_deg: float) -> dict[str, Any] | None:
    """White reference from the flat frames, if the folder has any; see `make_reference`.

    Args:
        replay: the frames.
        reflectance: reflectance of the tile.
        light_angle_deg: angle between light and camera.

    Raises:
        CalibrationError: the tile is saturated or dark, or its frames differ.
    """
    flats = replay.of_kind("flat")
    if not flats:
        return None
    first = flats[0]
    dark = [e for e in replay.of_kind("dark") if (e.exposure_s, e.gain) == (first.exposure_s, first.gain)]
    to_light, _ = directions((LightPose(0.0, first.tilt_deg),), Convention(light_angle_deg))
    return make_reference(
        stack(entry.load() for entry in flats),
        stack(entry.load() for entry in dark),
        reflectance=reflectance,
        light_cosine=float(to_light[0, 2]),
        camera=camera_of(replay) or UNKNOWN,
        full_scale=2**first.bit_depth - 1,
        filters=first.filters,
    )
