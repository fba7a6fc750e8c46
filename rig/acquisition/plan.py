"""The plan of an acquisition: frozen data; iterating it yields what is to be done, in order."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from anisoscope.errors import UsageError


@dataclass(frozen=True)
class Pose:
    """Where the sample stands: angle of the sample and tilt of the camera arm, in degrees."""

    stage_deg: float
    tilt_deg: float = 0.0


@dataclass(frozen=True)
class LightEvent:
    """Switch the light."""

    on: bool


@dataclass(frozen=True)
class DarkEvent:
    """Take a frame in the dark; `repeat` counts from 0."""

    repeat: int


@dataclass(frozen=True)
class MoveEvent:
    """Go to a pose, and let it settle for `settle_s` seconds."""

    pose: Pose
    settle_s: float


@dataclass(frozen=True)
class SampleEvent:
    """Take a lit frame of sample or flat; `again` marks those after the return to the first pose."""

    pose: Pose
    repeat: int
    again: bool = False


Event = LightEvent | DarkEvent | MoveEvent | SampleEvent


@dataclass(frozen=True)
class Plan:
    """What to photograph: dark frames first, then every pose, and at the end the first pose once more.

    Attributes:
        poses: where the sample is photographed, in order.
        exposure_s: exposure in seconds, of all frames.
        gain: gain as a factor.
        frames_per_pose: number of frames at each pose.
        dark_frames: number of frames with the light off.
        settle_s: seconds to wait after each move.
        return_to_first: whether the first pose is measured again at the end, so that drift shows.
        kind: what lies on the stage.

    Raises:
        UsageError: there is no pose, or a number that makes no sense.
    """

    poses: tuple[Pose, ...]
    exposure_s: float
    gain: float = 1.0
    frames_per_pose: int = 1
    dark_frames: int = 1
    settle_s: float = 0.0
    return_to_first: bool = True
    kind: Literal["sample", "flat"] = "sample"

    def __post_init__(self) -> None:
        checks = (
            (len(self.poses) >= 1, "poses", "at least one pose"),
            (
                all(math.isfinite(p.stage_deg) and math.isfinite(p.tilt_deg) for p in self.poses),
                "poses",
                "angles",
            ),
            (math.isfinite(self.exposure_s) and self.exposure_s > 0.0, "exposure_s", "a time above 0 s"),
            (math.isfinite(self.gain) and self.gain > 0.0, "gain", "a factor above 0"),
            (self.frames_per_pose >= 1, "frames_per_pose", "at least 1"),
            (self.dark_frames >= 0, "dark_frames", "0 or more"),
            (math.isfinite(self.settle_s) and self.settle_s >= 0.0, "settle_s", "0 s or more"),
        )
        for good, name, expected in checks:
            if not good:
                raise UsageError(f"acquisition plan: {name}: expected {expected}, not {getattr(self, name)}")

    def __iter__(self) -> Iterator[Event]:
        yield LightEvent(on=False)
        for repeat in range(self.dark_frames):
            yield DarkEvent(repeat)
        yield LightEvent(on=True)
        for pose in self.poses:
            yield from self._at(pose, again=False)
        if self.return_to_first:
            yield from self._at(self.poses[0], again=True)
        yield LightEvent(on=False)

    @property
    def frame_count(self) -> int:
        """Number of frames that the plan takes."""
        stops = len(self.poses) + int(self.return_to_first)
        return self.dark_frames + stops * self.frames_per_pose

    def _at(self, pose: Pose, *, again: bool) -> Iterator[Event]:
        yield MoveEvent(pose, self.settle_s)
        for repeat in range(self.frames_per_pose):
            yield SampleEvent(pose, repeat, again)
