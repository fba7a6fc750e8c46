"""Open a rig and carry out a plan. Whatever happens, the stage stands and the light is off afterwards."""

import atexit
import contextlib
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from anisoscope.errors import CameraError, RecordError, RigError, RigFileError
from anisoscope.rig.acquisition.plan import DarkEvent, LightEvent, MoveEvent, Plan, Pose, SampleEvent
from anisoscope.rig.camera import Camera, CameraSettings
from anisoscope.rig.drivers import open_camera, open_light, open_stage
from anisoscope.rig.frame import Frame, FrameKind, write_frame
from anisoscope.rig.light import Light
from anisoscope.rig.rigfile import RigFile
from anisoscope.rig.stage import RotationStage

TILT_TOLERANCE_DEG = 0.01


@dataclass(frozen=True)
class Progress:
    """How far an acquisition is: frames taken, frames in all, and what happens now."""

    done: int
    total: int
    text: str


ProgressSink = Callable[[Progress], None]


@dataclass(frozen=True)
class FrameRecord:
    """A frame and the file it was written to; `again` marks a frame after the return to the first pose."""

    path: Path
    frame: Frame
    again: bool = False


@dataclass(frozen=True)
class Rig:
    """An opened rig: its devices and its file."""

    stage: RotationStage
    camera: Camera
    light: Light
    file: RigFile

    def make_safe(self) -> None:
        """Stop the stage and switch the light off; a device that fails does not keep the other from it."""
        for action in (self.stage.stop, self.light.off):
            with contextlib.suppress(Exception):
                action()


@contextlib.contextmanager
def open_rig(file: RigFile) -> Iterator[Rig]:
    """Connect to the devices of a rig file; leaving the context makes them safe and disconnects them.

    Raises:
        RigFileError: a driver that is not installed, or an option that it does not know.
        NotConnected: a device that is not there.
    """
    with contextlib.ExitStack() as stack:
        stage = open_stage(file.stage.driver, port=file.stage.port, **file.stage.options)
        stack.callback(stage.close)
        camera = open_camera(file.camera.driver, **file.camera.options)
        stack.callback(camera.close)
        light = open_light(file.light.driver, **file.light.options)
        stack.callback(light.close)
        rig = Rig(stage, camera, light, file)
        # Leaving the context does the same; this is for an interpreter that ends inside of it.
        atexit.register(rig.make_safe)
        stack.callback(atexit.unregister, rig.make_safe)
        try:
            yield rig
        except BaseException:
            rig.make_safe()
            raise


def run_plan(
    plan: Plan,
    rig: Rig,
    folder: Path,
    on_progress: ProgressSink | None = None,
    cancel: threading.Event | None = None,
) -> list[FrameRecord]:
    """Carry out a plan; every frame is written to ``folder/frames`` the moment it arrives.

    The stage is homed first if it was not; this is announced through `on_progress`. Every angle is approached
    from below (in stage readings). After an error, a `KeyboardInterrupt` or a cancel the stage is stopped and
    the light switched off before the exception goes on.

    Args:
        plan: what to photograph.
        rig: an opened rig.
        folder: where to write; made if missing.
        on_progress: is told what happens.
        cancel: setting it ends the acquisition with a `RigError`.

    Raises:
        RigError: a tilt that the arm does not have, a cancel, or a device in trouble.
        RigFileError: an angle that cannot be reached from below within the limits of the stage.
        RecordError: the folder cannot be written to.
    """
    return _Run(plan, rig, folder, on_progress or (lambda _: None), cancel or threading.Event()).execute()


class _Run:
    def __init__(
        self, plan: Plan, rig: Rig, folder: Path, tell: ProgressSink, cancel: threading.Event
    ) -> None:
        self.plan, self.rig, self.tell, self.cancel = plan, rig, tell, cancel
        self.frames_folder = folder / "frames"
        self.records: list[FrameRecord] = []
        self.commanded_deg = 0.0
        self.reading_deg = 0.0

    def execute(self) -> list[FrameRecord]:
        for pose in self.plan.poses:
            self._check(pose)
        try:
            self.frames_folder.mkdir(parents=True, exist_ok=True)
        except OSError as problem:
            raise RecordError(f"{self.frames_folder}: cannot be made: {problem.strerror}") from problem
        try:
            self._prepare()
            for event in self.plan:
                self._check_cancel()
                self._do(event)
        except BaseException:
            self.rig.make_safe()
            raise
        return self.records

    def _check(self, pose: Pose) -> None:
        arm_deg = self.rig.file.geometry.tilt_deg
        if abs(pose.tilt_deg - arm_deg) > TILT_TOLERANCE_DEG:
            raise RigError(
                f"a tilt of {pose.tilt_deg:g}° was asked for, but the camera arm of '{self.rig.file.name}' "
                f"is fixed at {arm_deg:g}°; ask for that, or correct geometry.tilt_deg in the rig file"
            )
        part = self.rig.file.stage
        low, high = self.rig.stage.limits_deg
        target = part.reading_deg(pose.stage_deg)
        if target - part.approach_deg < low or target > high:
            raise RigFileError(
                f"a sample angle of {pose.stage_deg:g}° needs the stage at {target:g}° and before at "
                f"{target - part.approach_deg:g}°, but it reaches {low:g}°…{high:g}°; choose stage.zero_deg "
                'in the rig file so that both fit (with turns = "ccw": at least stage.approach_deg)'
            )

    def _check_cancel(self) -> None:
        if self.cancel.is_set():
            raise RigError(f"the acquisition was cancelled after {len(self.records)} frames")

    def _say(self, text: str) -> None:
        self.tell(Progress(len(self.records), self.plan.frame_count, text))

    def _prepare(self) -> None:
        stage = self.rig.stage
        if not stage.is_homed:
            self._say(f"homing {stage.name}")
            stage.home()
        self.reading_deg = stage.position_deg()
        self.commanded_deg = self.rig.file.stage.angle_deg(self.reading_deg)
        self.settings = self.rig.camera.configure(self.plan.exposure_s, self.plan.gain)

    def _do(self, event: LightEvent | DarkEvent | MoveEvent | SampleEvent) -> None:
        match event:
            case LightEvent(on=True):
                self.rig.light.on()
            case LightEvent():
                self.rig.light.off()
            case MoveEvent(pose, settle_s):
                self._say(f"turning to {pose.stage_deg:g}°")
                self._go(pose)
                self.cancel.wait(settle_s)
            case DarkEvent():
                self._take("dark")
            case SampleEvent(again=again):
                self._take(self.plan.kind, again=again)

    def _go(self, pose: Pose) -> None:
        part, stage = self.rig.file.stage, self.rig.stage
        target = part.reading_deg(pose.stage_deg)
        below = target - part.approach_deg
        if stage.position_deg() > below:
            stage.move_to(below)
        self.reading_deg = stage.move_to(target)
        self.commanded_deg = pose.stage_deg

    def _take(self, kind: FrameKind, *, again: bool = False) -> None:
        frame = self._expose(kind, self.settings)
        angle = f"{self.commanded_deg:07.2f}"
        path = self.frames_folder / f"{len(self.records):03d}_{kind}_{angle}.tif"
        write_frame(frame, path)
        self.records.append(FrameRecord(path, frame, again))
        self._say(f"{kind} frame at {frame.stage_deg:.3f}°")

    def _expose(self, kind: FrameKind, settings: CameraSettings) -> Frame:
        info = self.rig.camera.info
        counts = self.rig.camera.grab()
        if counts.shape != (info.rows, info.cols) or counts.dtype != np.uint16:
            raise CameraError(
                f"{info.model} delivered {counts.dtype} counts of shape {counts.shape} instead of uint16 "
                f"{(info.rows, info.cols)}"
            )
        return Frame(
            counts=counts,
            kind=kind,
            bit_depth=info.bit_depth,
            black_level=info.black_level,
            exposure_s=settings.exposure_s,
            gain=settings.gain,
            stage_deg=self.rig.file.stage.angle_deg(self.reading_deg),
            commanded_deg=self.commanded_deg,
            tilt_deg=self.rig.file.geometry.tilt_deg,
            captured_at=datetime.now(UTC).isoformat(timespec="milliseconds"),
            camera=f"{info.model} {info.serial}",
        )
