"""Carry out a plan on an opened rig. Whatever happens, the stage stands and the light is off afterwards."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from anisoscope.base.errors import CameraError, RecordError, RigError, RigFileError
from anisoscope.rig.acquisition.interruptions import undisturbed
from anisoscope.rig.acquisition.journal import Journal, JournalFile, RunLine, read_journal
from anisoscope.rig.acquisition.opening import Rig, open_rig
from anisoscope.rig.acquisition.plan import (
    DarkEvent,
    Event,
    ExposeEvent,
    LightEvent,
    MoveEvent,
    Plan,
    Pose,
    SampleEvent,
)
from anisoscope.rig.acquisition.writer import FRAMES, FrameRecord, FrameWriter, Shot
from anisoscope.rig.camera import CameraSettings
from anisoscope.rig.frame import Frame, FrameKind
from anisoscope.rig.light import rest
from anisoscope.rig.rigfile import AxisPart, check_arm
from anisoscope.rig.stage import RotationStage


def check_plan(plan: Plan, rig: Rig) -> None:
    """Check that the rig can carry out the plan, without motion.

    Raises:
        RigError: a tilt that the arm does not have.
        RigFileError: an angle that cannot be reached from below within the limits of its axis.
    """
    for pose in plan.poses:
        _check_reach(rig.file.stage, rig.stage, pose.stage_deg, "stage")
        if rig.tilt is not None and rig.file.tilt is not None:
            _check_reach(rig.file.tilt, rig.tilt, pose.tilt_deg, "tilt")
            continue
        check_arm(rig.file, [pose.tilt_deg])


def _check_reach(part: AxisPart, axis: RotationStage, angle_deg: float, table: str) -> None:
    low, high = axis.limits_deg
    target = part.reading(angle_deg)
    if target - part.approach_deg < low or target > high:
        what = "sample angle" if table == "stage" else "tilt"
        hint = ' (with turns = "ccw": at least stage.approach_deg)' if table == "stage" else ""
        raise RigFileError(
            f"a {what} of {angle_deg:g}° needs the {table} at {target:g}° and before at "
            f"{target - part.approach_deg:g}°, but it reaches {low:g}°…{high:g}°; choose {table}.zero_deg "
            f"in the rig file so that both fit{hint}"
        )


POLL_S = 0.02
REPEAT_S = 0.1


class Watch:
    """While its context lasts, stops the rig as soon as a cancel or trouble is seen.

    The stop is repeated until the acquisition has ended, because a move may be starting in this moment.

    Args:
        stop: stops all axes; called in the thread of the watch.
        cancel: set to end the acquisition.

    Attributes:
        halted: set when the rig receives the stop command; long waits of the acquisition wait for it.
    """

    def __init__(self, stop: Callable[[], object], cancel: threading.Event) -> None:
        self.halted = threading.Event()
        self._stop, self._cancel = stop, cancel
        self._trouble = threading.Event()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._work, name="rig watch", daemon=True)

    def trouble(self) -> None:
        """Stop the rig because something failed; may be called from any thread."""
        self._trouble.set()

    @property
    def stop_requested(self) -> bool:
        """Whether the acquisition shall stop, even if the rig is not stopped yet."""
        return self._cancel.is_set() or self._trouble.is_set()

    def _work(self) -> None:
        while not self._over.is_set():
            if self._cancel.wait(POLL_S) or self.stop_requested:
                self.halted.set()
                self._stop()
                self._over.wait(REPEAT_S)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        with undisturbed():
            self._over.set()
            self._thread.join()


__all__ = ["FrameRecord", "Progress", "ProgressSink", "Rig", "check_plan", "open_rig", "run_plan"]


@dataclass(frozen=True)
class Progress:
    """Progress of an acquisition: acquired frames, total, present activity."""

    done: int
    total: int
    text: str


ProgressSink = Callable[[Progress], None]


def run_plan(
    plan: Plan,
    rig: Rig,
    folder: Path,
    on_progress: ProgressSink | None = None,
    cancel: threading.Event | None = None,
) -> list[FrameRecord]:
    """Carry out a plan; every frame is written to ``folder/frames`` and entered in the journal as it arrives.

    What the journal of the folder already names is not taken again: see `Plan.remaining`. Axes that were not
    homed are homed first, all of them when a plan is taken up again; this is announced through `on_progress`.
    Every angle is approached from below (in readings). After an error, a `KeyboardInterrupt` or a cancel the axes
    are stopped and the light switched off before the exception goes on; the frames taken so far are on disk.

    Args:
        plan: what to photograph.
        rig: an opened rig.
        folder: where to write; made if missing.
        on_progress: receives the progress.
        cancel: setting it, from any thread, stops the axes at once and ends the acquisition with a `RigError`.

    Returns:
        The frames taken now.

    Raises:
        RigError: a tilt that the arm does not have, a cancel, or a device in trouble.
        RigFileError: an angle that cannot be reached from below within the limits of its axis.
        CameraError: on resuming, the camera exposes otherwise than before.
        RecordError: the folder cannot be written to.
    """
    check_plan(plan, rig)
    try:
        (folder / FRAMES).mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise RecordError(f"{folder / FRAMES}: cannot be made: {problem.strerror}") from problem
    journal = read_journal(folder)
    cancel = cancel or threading.Event()
    watch = Watch(rig.stop, cancel)
    with JournalFile(folder) as lines:
        writer = FrameWriter(folder, lines, len(journal.runs), len(journal.frames), watch.trouble)
        try:
            with writer, watch, _safe_afterwards(rig):
                run = _Run(plan, rig, journal, writer, watch, on_progress or (lambda _: None))
                lines.append([run.opening_line()])
                run.execute()
        except RigError as error:
            writer.check()
            if cancel.is_set():
                count = len(writer.records)
                raise RigError(f"the acquisition was cancelled after {count} frames") from error
            raise
    return writer.records


@contextlib.contextmanager
def _safe_afterwards(rig: Rig) -> Iterator[None]:
    try:
        yield
    except BaseException:
        rig.make_safe()
        raise


class _Run:
    def __init__(
        self, plan: Plan, rig: Rig, journal: Journal, writer: FrameWriter, watch: Watch, report: ProgressSink
    ) -> None:
        self.plan, self.rig, self.writer, self.watch, self.report = plan, rig, writer, watch, report
        self.number = len(journal.runs)
        self.before = journal.by_step
        self.acquired = 0
        self.known: dict[float, CameraSettings] = {}
        self.pose = Pose(0.0, rig.file.geometry.tilt_deg)
        self.at = self.pose

    def opening_line(self) -> RunLine:
        info, tilt = self.rig.camera.info, self.rig.tilt
        return RunLine(
            run=self.number,
            stage=self.rig.stage.name,
            tilt=None if tilt is None else tilt.name,
            camera=f"{info.model} {info.serial}",
            filters=info.filters,
            started_at=datetime.now(UTC).isoformat(timespec="milliseconds"),
            linear=info.linear,
        )

    def execute(self) -> None:
        self._expose_for(self.plan.exposure_s)
        reusable = self._reusable_steps()
        self.total = self.plan.frame_count - len(reusable)
        self._home()
        for event in self.plan.remaining(reusable):
            self._check_halt()
            self._do(event)
        self._check_halt()

    def _expose_for(self, exposure_s: float) -> None:
        """Set the exposure; those of a bracket must not become one and the same in the camera."""
        self.settings = self.rig.camera.configure(exposure_s, self.plan.gain)
        for other_s, settings in self.known.items():
            if other_s != exposure_s and settings == self.settings:
                raise CameraError(
                    f"the camera takes the exposures {other_s:g} s and {exposure_s:g} s both as "
                    f"{settings.exposure_s:g} s: choose other acquisition.brackets in the recipe"
                )
        self.known[exposure_s] = self.settings

    def _reusable_steps(self) -> set[int]:
        """Steps of earlier runs whose frames can be used."""
        reusable = self.plan.complete(self.before)
        for exposure_s in self.plan.exposures_s[1:] if reusable else ():  # what the camera makes of them now
            self._expose_for(exposure_s)
        differing = [step for step in reusable if not self._exposed_as_now(step)]
        lit = [step for step in differing if self.before[step].kind != "dark"]
        if lit:
            now, old = self.known[self.plan.exposure_of(lit[0])], self.before[lit[0]]
            raise CameraError(
                f"the camera now exposes for {now.exposure_s:g} s at gain {now.gain:g}, but for "
                f"{old.exposure_s:g} s at gain {old.gain:g} in the frames taken so far: inspect the part anew"
            )
        return reusable - set(differing)

    def _exposed_as_now(self, step: int) -> bool:
        line, now = self.before[step], self.known[self.plan.exposure_of(step)]
        return (line.exposure_s, line.gain) == (now.exposure_s, now.gain)

    def _check_halt(self) -> None:
        self.writer.check()
        if self.watch.stop_requested:
            raise RigError("the acquisition was told to stop")

    def _report(self, text: str) -> None:
        self.report(Progress(self.acquired, max(self.total, self.acquired), text))

    def _home(self) -> None:
        for axis in self.rig.axes:
            if self.number > 0 or not axis.is_homed:
                self._report(f"homing {axis.name}")
                axis.home()
            self._check_halt()
        self._read_back()
        self.pose = self.at

    def _read_back(self) -> None:
        file, tilt = self.rig.file, self.rig.tilt
        tilt_deg = file.geometry.tilt_deg
        if tilt is not None and file.tilt is not None:
            tilt_deg = file.tilt.place(tilt.position_deg())
        self.at = Pose(file.stage.place(self.rig.stage.position_deg()), tilt_deg)

    def _do(self, event: Event) -> None:
        match event:
            case LightEvent(on=True):
                self.rig.light.on()
            case LightEvent(needed=True):
                self.rig.light.off()
            case LightEvent():
                rest(self.rig.light)
            case MoveEvent(pose, settle_s):
                self._go(pose)
                self.watch.halted.wait(settle_s)
            case ExposeEvent(exposure_s):
                self._expose_for(exposure_s)
            case DarkEvent(step):
                self._take("dark", step)
            case SampleEvent(_, step, again):
                self._take(self.plan.kind, step, again=again)

    def _go(self, pose: Pose) -> None:
        file = self.rig.file
        stage_deg, tilt_deg = pose.stage_deg, self.at.tilt_deg
        if self.rig.tilt is not None and file.tilt is not None and pose.tilt_deg != self.pose.tilt_deg:
            self._report(f"tilting to {pose.tilt_deg:g}°")
            tilt_deg = file.tilt.place(self._approach(file.tilt, self.rig.tilt, pose.tilt_deg))
        self._report(f"turning to {pose.stage_deg:g}°")
        stage_deg = file.stage.place(self._approach(file.stage, self.rig.stage, pose.stage_deg))
        self.at, self.pose = Pose(stage_deg, tilt_deg), pose

    def _approach(self, part: AxisPart, axis: RotationStage, angle_deg: float) -> float:
        """Move an axis to an angle, always from below; return the reading reached."""
        target = part.reading(angle_deg)
        below = target - part.approach_deg
        if axis.position_deg() > below:
            axis.move_to(below)
            self._check_halt()
        return axis.move_to(target)

    def _take(self, kind: FrameKind, step: int | None, *, again: bool = False) -> None:
        frame = self._expose(kind)
        self.acquired += 1
        self.writer.put(Shot(frame, self.pose, step, again))
        self._report(f"{kind} frame at {frame.stage_deg:.3f}°")

    def _expose(self, kind: FrameKind) -> Frame:
        info = self.rig.camera.info
        counts = self.rig.camera.grab()
        if counts.shape != (info.rows, info.cols) or counts.dtype != np.uint16:
            raise CameraError(
                f"{info.model} delivered {counts.dtype} counts of shape {counts.shape} instead of uint16 "
                f"{(info.rows, info.cols)}"
            )
        return Frame(
            counts=counts.copy(),  # a camera may fill the same memory again while this is written
            kind=kind,
            bit_depth=info.bit_depth,
            black_level=info.black_level,
            exposure_s=self.settings.exposure_s,
            gain=self.settings.gain,
            stage_deg=self.at.stage_deg,
            commanded_deg=self.pose.stage_deg,
            tilt_deg=self.at.tilt_deg,
            captured_at=datetime.now(UTC).isoformat(timespec="milliseconds"),
            camera=f"{info.model} {info.serial}",
            filters=info.filters,
        )
