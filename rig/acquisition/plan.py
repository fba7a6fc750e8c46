"""The plan of an acquisition: frozen data; iterating it yields what is to be done, in order."""

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from anisoscope.base.errors import UsageError

LEAST_STEP = 1.5
"""Smallest ratio of neighbouring exposures of a bracket."""


@dataclass(frozen=True)
class Pose:
    """Pose: angle of the sample and tilt of the camera arm, in degrees."""

    stage_deg: float
    tilt_deg: float = 0.0


@dataclass(frozen=True)
class Seat:
    """Place of a part on the plate, and the travel of x, y and z that brings it below the camera.

    The axes x and y shift the stage with its axis, so that a part off that axis is followed around it: at the sample
    angle ψ the axis has to stand at −R(ψ)·place from the middle of the picture.

    Attributes:
        place_mm: (x, y) of the part from the axis of the stage, at sample angle 0, to the right and up.
        centre_mm: readings of x and y at which the axis of the stage is in the middle of the picture; None for those at
            which the rig file has them at 0.
        directions_deg: directions, counter-clockwise in the picture, in which x moves the stage against the right, and
            y against up.
        focus_mm: reading of z; None for that at which the rig file has it at 0.
    """

    place_mm: tuple[float, float] = (0.0, 0.0)
    centre_mm: tuple[float, float] | None = None
    directions_deg: tuple[float, float] = (0.0, 0.0)
    focus_mm: float | None = None

    def travel_mm(self, stage_deg: float) -> tuple[float, float]:
        """(x, y) travel in mm from the centre, at a sample angle in degrees."""
        turn = complex(math.cos(math.radians(stage_deg)), math.sin(math.radians(stage_deg)))
        to = -turn * complex(*self.place_mm)
        along, up = (math.radians(one) for one in self.directions_deg)
        # to = x (cos along, sin along) + y (−sin up, cos up)
        share = math.cos(along - up)
        x = (to.real * math.cos(up) + to.imag * math.sin(up)) / share
        y = (to.imag * math.cos(along) - to.real * math.sin(along)) / share
        return x, y


@dataclass(frozen=True)
class LightEvent:
    """Switch the light; `needed` is False at the end, where it may stay on."""

    on: bool
    needed: bool = True


@dataclass(frozen=True)
class ExposeEvent:
    """Set the camera to an exposure in seconds; only plans with several exposures have such events."""

    exposure_s: float


@dataclass(frozen=True)
class DarkEvent:
    """Take a frame in the dark; `step` counts the frames of the plan from 0."""

    step: int


@dataclass(frozen=True)
class MoveEvent:
    """Go to a pose, and let it settle for `settle_s` seconds."""

    pose: Pose
    settle_s: float


@dataclass(frozen=True)
class SampleEvent:
    """Take a lit frame of sample or flat.

    Attributes:
        pose: where it is taken.
        step: number of the frame in the plan, from 0; None for one that checks the first pose on resuming.
        again: marks frames at the first pose that only show drift.
    """

    pose: Pose
    step: int | None
    again: bool = False


Event = LightEvent | ExposeEvent | DarkEvent | MoveEvent | SampleEvent


@dataclass(frozen=True)
class _Stop:
    """A group of consecutive frames: dark frames or those of a pose; `each` of them at every exposure."""

    steps: range
    each: int
    pose: Pose | None
    again: bool = False


@dataclass(frozen=True)
class Plan:
    """Acquisition plan of a part: dark frames, every pose, and the first pose again at the end.

    Attributes:
        poses: where the sample is photographed, in order; every tilt is visited once.
        exposure_s: exposure in seconds; of a bracket the shortest one.
        gain: gain as a factor.
        frames_per_pose: number of frames at each pose, of every exposure.
        dark_frames: number of frames with the light off, of every exposure.
        settle_s: seconds to wait after each move.
        return_to_first: whether the first pose is measured again at the end, so that drift shows.
        kind: what lies on the stage.
        rounds: how often all of that is done, dark frames apart.
        brackets: further exposures of every pose, as multiples of `exposure_s`, rising.
        seat: where the part lies, for the axes x, y and z of a rig that has them.

    Raises:
        UsageError: there is no pose, a tilt is visited twice, or a number makes no sense.
    """

    poses: tuple[Pose, ...]
    exposure_s: float
    gain: float = 1.0
    frames_per_pose: int = 1
    dark_frames: int = 1
    settle_s: float = 0.0
    return_to_first: bool = True
    kind: Literal["sample", "flat"] = "sample"
    rounds: int = 1
    brackets: tuple[float, ...] = ()
    seat: Seat = Seat()

    def __post_init__(self) -> None:
        angles = [angle for pose in self.poses for angle in (pose.stage_deg, pose.tilt_deg)]
        changes = sum(before.tilt_deg != after.tilt_deg for before, after in pairwise(self.poses))
        checks = (
            (len(self.poses) >= 1, "poses", "at least one pose"),
            (all(map(math.isfinite, angles)), "poses", "angles"),
            (
                changes < max(1, len({pose.tilt_deg for pose in self.poses})),
                "poses",
                "all stage angles of a tilt in a row",
            ),
            (math.isfinite(self.exposure_s) and self.exposure_s > 0.0, "exposure_s", "a time above 0 s"),
            (
                self._brackets_rise(),
                "brackets",
                f"rising multiples, each {LEAST_STEP:g} or more times the one before",
            ),
            (math.isfinite(self.gain) and self.gain > 0.0, "gain", "a factor above 0"),
            (self.frames_per_pose >= 1, "frames_per_pose", "at least 1"),
            (self.rounds >= 1, "rounds", "at least 1"),
            (self.dark_frames >= 0, "dark_frames", "0 or more"),
            (math.isfinite(self.settle_s) and self.settle_s >= 0.0, "settle_s", "0 s or more"),
        )
        for good, name, expected in checks:
            if not good:
                raise UsageError(f"acquisition plan: {name}: expected {expected}, not {getattr(self, name)}")

    def _brackets_rise(self) -> bool:
        return all(after >= LEAST_STEP * before for before, after in pairwise((1.0, *self.brackets)))

    @property
    def exposures_s(self) -> tuple[float, ...]:
        """All exposures in seconds, rising."""
        return tuple(float(f"{self.exposure_s * factor:.9g}") for factor in (1.0, *self.brackets))

    @property
    def shots_per_pose(self) -> int:
        """Number of frames at each pose, all exposures together."""
        return self.frames_per_pose * len(self.exposures_s)

    def exposure_of(self, step: int) -> float:
        """Planned exposure of a step in seconds."""
        stop = next(stop for stop in self._stops() if step in stop.steps)
        return self.exposures_s[(step - stop.steps.start) // stop.each]

    def __iter__(self) -> Iterator[Event]:
        return self.remaining(())

    @property
    def frame_count(self) -> int:
        """Number of frames that the plan takes."""
        return self._stops()[-1].steps.stop

    @property
    def dark_steps(self) -> tuple[range, ...]:
        """Steps of the dark frames, a range for every exposure."""
        count = self.dark_frames
        return tuple(range(k * count, (k + 1) * count) for k in range(len(self.exposures_s) if count else 0))

    def complete(self, done: Collection[int]) -> set[int]:
        """Steps of the stops whose frames are all done."""
        whole = [stop.steps for stop in self._stops() if all(step in done for step in stop.steps)]
        return {step for steps in whole for step in steps}

    def remaining(self, done: Collection[int]) -> Iterator[Event]:
        """Steps that remain when the frames of some are there.

        The frames of a pose are averaged, so a pose of which one is missing is taken anew. Where frames of the
        first pose are kept, it is photographed once more before anything else: lamp and sample may have changed.
        """
        stops = self._stops()
        left = [stop for stop in stops if not all(step in done for step in stop.steps)]
        if not left:
            return
        yield LightEvent(on=False)
        for stop in left:
            if stop.pose is None:
                yield from self._darks(stop.steps)
        left = [stop for stop in left if stop.pose is not None]
        if left:
            yield LightEvent(on=True)
            first = next(stop for stop in stops if stop.pose is not None)
            if first not in left and not left[0].again:
                yield from self._frames(first, check=True)
            for stop in left:
                yield from self._frames(stop)
        yield LightEvent(on=False, needed=False)

    def _darks(self, steps: Collection[int]) -> Iterator[Event]:
        """Take these dark frames, exposure by exposure."""
        for exposure_s, all_steps in zip(self.exposures_s, self.dark_steps, strict=True):
            wanted = [step for step in all_steps if step in steps]
            if self.brackets and wanted:
                yield ExposeEvent(exposure_s)
            for step in wanted:
                yield DarkEvent(step)

    def first_darks(self) -> Iterator[Event]:
        """Take one dark frame of every exposure, to be compared with those of other parts."""
        yield LightEvent(on=False)
        yield from self._darks([steps[0] for steps in self.dark_steps])

    def _frames(self, stop: _Stop, *, check: bool = False) -> Iterator[Event]:
        """Go there, and take the frames exposure by exposure; a check of the first pose is no step of the plan."""
        assert stop.pose is not None
        yield MoveEvent(stop.pose, self.settle_s)
        for number, step in enumerate(stop.steps):
            if self.brackets and number % stop.each == 0:
                yield ExposeEvent(self.exposures_s[number // stop.each])
            yield SampleEvent(stop.pose, None if check else step, again=check or stop.again)

    def _stops(self) -> list[_Stop]:
        visits: list[tuple[Pose | None, bool]] = [(pose, False) for pose in self.poses]
        if self.return_to_first:
            visits.append((self.poses[0], True))
        exposures = 1 + len(self.brackets)
        step = self.dark_frames * exposures
        stops = [_Stop(range(step), self.dark_frames, None)] if self.dark_frames else []
        for pose, again in visits * self.rounds:
            stops.append(
                _Stop(range(step, step + self.frames_per_pose * exposures), self.frames_per_pose, pose, again)
            )
            step += self.frames_per_pose * exposures
        return stops
