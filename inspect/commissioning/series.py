"""Commissioning series: a full turn of the stage in raw readings, and tilted views, as linear pictures.

Nothing here trusts the rig file's sense and zero: poses are readings of the axes. The frames go to disk with the
runner of every acquisition, so that they stay as evidence.
"""

import math
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CalibrationError, CameraError, RigFileError, Saturated, UsageError
from anisoscope.base.progress import Advance
from anisoscope.commissioning.exposure import proof_on, sentence
from anisoscope.imaging.linearisation import Stack, WhiteReference, check_size, hot_pixels, linearise, stack
from anisoscope.rig.acquisition.plan import Plan, Pose
from anisoscope.rig.acquisition.runner import Progress, open_rig, run_plan
from anisoscope.rig.camera import CameraInfo
from anisoscope.rig.frame import Frame, read_frame
from anisoscope.rig.rigfile import AxisPart, RigFile
from anisoscope.rig.stage import RotationStage

Image = npt.NDArray[np.float32]

MIN_ANGLES, MIN_SPAN_DEG = 5, 100.0
TOO_MANY_SATURATED = 0.01


@dataclass(frozen=True)
class Series:
    """Poses and exposure of a series.

    Attributes:
        exposure_s: exposure of all frames, seconds.
        gain: gain of the camera.
        step_deg: step of the stage over one turn.
        tilts_deg: where an axis tilts the arm: how far it goes from its present zero, in readings.
        tilt_step_deg: step of the stage under these tilts.
        frames: frames of every pose, averaged.
        dark_frames: frames with the light off.
        settle_s: seconds to wait after every move.
        light_channel: of the rig file; None for the one that it uses by default.
    """

    exposure_s: float
    gain: float = 1.0
    step_deg: float = 15.0
    tilts_deg: tuple[float, ...] = (-20.0, -10.0, 10.0, 20.0)
    tilt_step_deg: float = 60.0
    frames: int = 2
    dark_frames: int = 4
    settle_s: float = 0.0
    light_channel: str | None = None

    def __post_init__(self) -> None:
        for name, step in (("step", self.step_deg), ("tilt step", self.tilt_step_deg)):
            if not 1.0 <= step <= 60.0:
                raise UsageError(f"the {name} must lie between 1° and 60°, not {step:g}°")
        if self.frames < 2 or self.dark_frames < 2:
            raise UsageError("commissioning takes at least 2 frames a pose and 2 dark frames")


@dataclass(frozen=True, eq=False)
class Look:
    """One pose as photographed.

    Attributes:
        reading_deg: reading of the stage.
        tilt_reading_deg: reading of the tilt axis; the arm's angle where it stands fixed.
        image: (rows, cols) radiance [1/sr] with a white reference, else counts per second; NaN where unusable.
        noise: (rows, cols) standard deviation of a pixel of `image`.
        flicker: relative standard deviation of the light from frame to frame.
        saturated: share of saturated pixels.
        again: True for the first pose, photographed again at the end.
    """

    reading_deg: float
    tilt_reading_deg: float
    image: Image
    noise: Image
    flicker: float
    saturated: float
    again: bool = False


@dataclass(frozen=True, eq=False)
class Shots:
    """The frames of one pose on disk: pose in readings, files, whether they only show drift."""

    pose: Pose
    paths: tuple[Path, ...]
    again: bool


@dataclass(frozen=True, eq=False)
class PictureSet:
    """Pictures on disk, and the devices they come from; `white` is None without a white reference.

    `exposure` says that automatic exposure was proved off; None where the camera has none.
    """

    shots: tuple[Shots, ...]
    dark: Stack
    white: WhiteReference | None
    info: CameraInfo
    devices: dict[str, str]
    limits_deg: tuple[float, float]
    sha256: tuple[str, ...]
    exposure: str | None = None

    @property
    def absolute(self) -> bool:
        """Whether pictures are radiances in 1/sr, and not counts per second."""
        return self.white is not None

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of the pictures."""
        return self.info.rows, self.info.cols

    @property
    def dark_level(self) -> float:
        """Median of the dark frames, counts."""
        return float(np.median(self.dark.mean))

    @property
    def dark_noise(self) -> float:
        """Noise of one pixel of one dark frame, counts rms."""
        return float(np.sqrt(np.mean(self.dark.noise.astype(np.float64) ** 2)))

    def looks(self) -> Iterator[Look]:
        """The poses as linear pictures, one at a time: all of them at once would fill the memory.

        Raises:
            RecordError: a frame is damaged.
            Saturated: the exposure was too long.
        """
        for shots in self.shots:
            found = _look([read_frame(path) for path in shots.paths], self, again=shots.again)
            if found.saturated > TOO_MANY_SATURATED:
                raise Saturated(
                    f"at stage reading {found.reading_deg:g}° {found.saturated:.1%} of the picture are saturated "
                    f"(limit {TOO_MANY_SATURATED:.0%}): shorten --exposure"
                )
            yield found


def raw_file(file: RigFile) -> RigFile:
    """A rig file whose angles are the readings of its axes."""
    changes: dict[str, object] = {"stage": file.stage.model_copy(update={"zero_deg": 0.0, "turns": "ccw"})}
    if file.tilt is not None:
        changes["tilt"] = file.tilt.model_copy(update={"zero_deg": 0.0, "sign": 1})
    return file.model_copy(update=changes)


def turn_readings(limits_deg: tuple[float, float], approach_deg: float, step_deg: float) -> tuple[float, ...]:
    """Readings of one turn of the stage, each of which can be approached from below.

    Raises:
        RigFileError: the stage turns too little to find anything.
    """
    low, high = limits_deg
    lowest = low + approach_deg
    start = max(0.0, lowest) if high >= 360.0 - step_deg + max(0.0, lowest) else lowest
    count = min(round(360.0 / step_deg), math.floor((high - start) / step_deg + 1e-9) + 1)
    if count < MIN_ANGLES or (count - 1) * step_deg < MIN_SPAN_DEG:
        raise RigFileError(
            f"stage: it reaches {low:g}°…{high:g}°, too little for commissioning: at least {MIN_ANGLES} angles over "
            f"{MIN_SPAN_DEG:g}° are needed; widen its limits or make --step smaller"
        )
    return tuple(start + step_deg * n for n in range(count))


def plan_of(file: RigFile, stage: RotationStage, tilt: RotationStage | None, series: Series) -> Plan:
    """The plan, in readings: a turn at the present zero of the tilt, then fewer angles under tilts.

    Raises:
        RigFileError: the stage turns too little.
    """
    turn = turn_readings(stage.limits_deg, file.stage.approach_deg, series.step_deg)
    if file.tilt is None or tilt is None:
        poses = [Pose(reading, file.geometry.tilt_deg) for reading in turn]
    else:
        few = turn[:: max(1, round(series.tilt_step_deg / series.step_deg))]
        poses = [Pose(reading, file.tilt.zero_deg) for reading in turn]
        for reading in _reachable(file.tilt, tilt, series.tilts_deg):
            poses += [Pose(angle, reading) for angle in few]
    return Plan(
        poses=tuple(poses),
        exposure_s=series.exposure_s,
        gain=series.gain,
        frames_per_pose=series.frames,
        dark_frames=series.dark_frames,
        settle_s=series.settle_s,
    )


def _reachable(part: AxisPart, axis: RotationStage, tilts_deg: tuple[float, ...]) -> list[float]:
    low, high = axis.limits_deg
    tilt_readings = sorted({part.zero_deg + tilt for tilt in tilts_deg if tilt != 0.0})
    return [reading for reading in tilt_readings if low + part.approach_deg <= reading <= high]


def take(
    file: RigFile,
    series: Series,
    folder: Path,
    white: WhiteReference | None,
    advance: Advance,
    cancel: threading.Event | None = None,
) -> PictureSet:
    """Photograph the series; the frames are written below ``folder``.

    Args:
        file: the rig file as it stands; of sense and zero only the zero of the tilt is used.
        series: what to photograph.
        folder: receives the frames.
        white: white reference of this camera, or None.
        advance: progress.
        cancel: setting it stops the axes and ends the series with a `RigError`.

    Raises:
        RigFileError, RigError: the rig.
        CalibrationError: the white reference belongs to another camera.
        RecordError: the frames cannot be written.
    """

    def report(now: Progress) -> None:
        advance(now.text, now.done, now.total)

    with open_rig(raw_file(file)) as rig:
        info = rig.camera.info
        if white is not None and white.camera != info.serial:
            raise CalibrationError(
                f"the flat was taken with camera {white.camera}, this is {info.serial}: take a new one with "
                "`anisoscope calibrate flat`, or take [calibration] out of the rig file"
            )
        if white is not None:
            check_size(white, (info.rows, info.cols))
        if not info.linear:
            raise CameraError(
                f"{info.model} does not count in proportion to light: its radiances cannot be fitted; use a linear "
                "mode, or take its curve with `anisoscope calibrate response` and name it as camera.options.response"
            )
        plan = plan_of(file, rig.stage, rig.tilt, series)
        devices = {"stage": rig.stage.name, "camera": f"{info.model} {info.serial}"}
        devices |= {"tilt": rig.tilt.name} if rig.tilt is not None else {}
        devices["light"] = file.light.driver
        proof = proof_on(rig, series.exposure_s, series.gain)
        records = run_plan(plan, rig, folder, on_progress=report, cancel=cancel)
        limits = rig.stage.limits_deg
    groups: dict[tuple[Pose, bool], list[Path]] = {}
    for record in records:
        if record.frame.kind != "dark":
            groups.setdefault((record.pose, record.again), []).append(record.path)
    return PictureSet(
        tuple(Shots(pose, tuple(paths), again) for (pose, again), paths in groups.items()),
        stack(record.frame for record in records if record.frame.kind == "dark"),
        white,
        info,
        devices,
        limits,
        tuple(record.sha256 for record in records),
        None if proof is None else sentence(proof),
    )


def _look(frames: list[Frame], picture_set: PictureSet, *, again: bool) -> Look:
    lit, dark = stack(frames), picture_set.dark
    if picture_set.white is not None:
        found = linearise(lit, dark, picture_set.white, 2**picture_set.info.bit_depth - 1)
        value, noise, flicker = found.value, found.noise, found.flicker
    else:
        signal = lit.mean - dark.mean
        scale = 1.0 / (lit.exposure_s * lit.gain)
        unusable = hot_pixels(dark) | lit.saturated
        value = np.where(unusable, np.nan, scale * signal).astype(np.float32)
        spread = scale * np.sqrt(lit.noise**2 / lit.frames + dark.noise**2 / dark.frames)
        noise = np.where(unusable, np.nan, spread).astype(np.float32)
        flicker = lit.flicker / max(float(signal.mean()), 1e-9)
    return Look(
        float(np.mean([frame.stage_deg for frame in frames])),
        float(np.mean([frame.tilt_deg for frame in frames])),
        value,
        noise,
        flicker,
        float(lit.saturated.mean()),
        again,
    )
