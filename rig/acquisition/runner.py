"""Carry out a plan on an opened rig. Whatever happens, the stage stands and the light is off afterwards."""

import contextlib
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

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
    Seat,
)
from anisoscope.rig.acquisition.writer import FRAMES, FrameRecord, FrameWriter, Shot
from anisoscope.rig.camera import CameraSettings
from anisoscope.rig.frame import Frame, FrameKind, check_compression, too_high
from anisoscope.rig.light import rest
from anisoscope.rig.rigfile import RigFile, check_arm
from anisoscope.rig.stage import SYMBOLS, RotationStage


def check_plan(plan: Plan, rig: Rig) -> None:
    """Check that the rig can carry out the plan, without motion.

    Raises:
        RigError: a tilt that the arm does not have, or a place without axes that go there.
        RigFileError: an angle or a place that cannot be reached from below within the limits of its axis.
        LimitExceeded: axes would collide at a pose, or on the way to it.
        UsageError: frames cannot be packed as the rig file says.
    """
    check_compression(rig.file.camera.compression)
    if any(plan.seat.place_mm) and not {"x", "y"} <= rig.linear.keys():
        x_mm, y_mm = plan.seat.place_mm
        raise RigError(
            f"a part at {x_mm:g} mm, {y_mm:g} mm from the axis of the stage needs axes that bring it below the camera: "
            f"describe [x] and [y] in the rig file of '{rig.file.name}'"
        )
    standing: dict[str, float] = {}
    for pose in plan.poses:
        ways = ways_to(pose, plan.seat, rig)
        for table, way in ways.items():
            _check_reach(rig.file, rig.by_table[table], table, way, pose)
        if rig.tilt is None:
            check_arm(rig.file, [pose.tilt_deg])
        if not rig.file.collisions:
            continue
        targets = {table: target for table, (_, target) in ways.items()}
        rig.guard.check_together(targets)
        if standing:
            moved = {table: way for table, way in ways.items() if standing[table] != way[1]}
            rig.guard.order(
                {table: _shortened(way, standing[table]) for table, way in moved.items()}, standing
            )
        standing = targets


def ways_to(pose: Pose, seat: Seat, rig: Rig) -> dict[str, tuple[float, float]]:
    """Readings of all axes of a rig before a pose and at it, by their tables, in the order in which they usually move.

    Args:
        pose: angles of sample and arm.
        seat: where the part lies.
        rig: an opened rig.
    """
    file, found = rig.file, dict[str, tuple[float, float]]()
    if file.tilt is not None and rig.tilt is not None:
        found["tilt"] = file.tilt.way(pose.tilt_deg, rig.tilt.limits_deg)
    found["stage"] = file.stage.way(pose.stage_deg, rig.stage.limits_deg)
    for number, (part, travel) in enumerate(
        zip((file.x, file.y), seat.travel_mm(pose.stage_deg), strict=True)
    ):
        if part is not None:
            zero = part.zero if seat.centre_mm is None else seat.centre_mm[number]
            target = zero + part.direction * travel
            found["xy"[number]] = (target - part.approach, target)
    if file.z is not None:
        target = file.z.zero if seat.focus_mm is None else seat.focus_mm
        found["z"] = (target - file.z.approach, target)
    return found


def _shortened(way: tuple[float, float], here: float) -> tuple[float, ...]:
    """A way from a reading: below its target only if the axis stands higher."""
    return way if here > way[0] else way[1:]


def _check_reach(
    file: RigFile, axis: RotationStage, table: str, way: tuple[float, float], pose: Pose
) -> None:
    part, (below, target) = file.axes[table], way
    low, high = axis.limits_deg
    if below < low or target > high:
        what = {
            "stage": f"a sample angle of {pose.stage_deg:g}°",
            "tilt": f"a tilt of {pose.tilt_deg:g}°",
        }.get(table, f"the part at a sample angle of {pose.stage_deg:g}°")
        sign = SYMBOLS[part.unit]
        advice = f"choose {table}.zero_{part.unit} in the rig file so that both fit"
        if table == "stage":
            advice += ' (with turns = "ccw": at least stage.approach_deg)'
        if table in {"x", "y"}:
            advice = "lay the part nearer to the axis of the stage"
        raise RigFileError(
            f"{what} needs the {table} at {target:g}{sign} and before at {below:g}{sign}, but it "
            f"reaches {low:g}{sign}…{high:g}{sign}; {advice}"
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
        """Whether the acquisition is to stop, even if the rig is not stopped yet."""
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


__all__ = [
    "FrameRecord",
    "KnownDarks",
    "Progress",
    "ProgressSink",
    "Rig",
    "check_plan",
    "open_rig",
    "run_plan",
]


@dataclass(frozen=True)
class Progress:
    """Progress of an acquisition: acquired frames, total, present activity."""

    done: int
    total: int
    text: str


ProgressSink = Callable[[Progress], None]


class KnownDarks(Protocol):
    """Dark frames that were taken before, and whether they still hold."""

    @property
    def shots(self) -> tuple[Shot, ...]:
        """One a frame, with its step in the plan and its file."""
        ...

    def agree(self, own: Sequence[Frame]) -> bool:
        """Whether dark frames taken now, one of every exposure, are like them."""
        ...


def run_plan(
    plan: Plan,
    rig: Rig,
    folder: Path,
    on_progress: ProgressSink | None = None,
    cancel: threading.Event | None = None,
    part: tuple[str | None, str | None] = (None, None),
    darks: KnownDarks | None = None,
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
        part: serial number and lot of the sample, which enter the metadata of its frames.
        darks: dark frames of earlier inspections, which a new one takes over where one of its own agrees with them.

    Returns:
        The frames taken now, and dark ones that were taken over.

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
        number, packing = len(journal.frames), rig.file.camera.compression
        writer = FrameWriter(folder, lines, len(journal.runs), number, watch.trouble, packing)
        writer.part = part
        try:
            with writer, watch, _safe_afterwards(rig):
                run = _Run(plan, rig, journal, writer, watch, on_progress or (lambda _: None), darks)
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
        self,
        plan: Plan,
        rig: Rig,
        journal: Journal,
        writer: FrameWriter,
        watch: Watch,
        report: ProgressSink,
        darks: KnownDarks | None,
    ) -> None:
        self.plan, self.rig, self.writer, self.watch, self.report = plan, rig, writer, watch, report
        self.darks = darks
        self.number = len(journal.runs)
        self.before = journal.by_step
        self.acquired = 0
        self.known: dict[float, CameraSettings] = {}
        self.pose = Pose(0.0, rig.file.geometry.tilt_deg)
        self.at = self.pose
        self.readings: dict[str, float] = {}
        self.sent: dict[str, float] = {}

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
        if not self.before:
            reusable = self._shared_darks()
            self.total -= len(reusable) - self.acquired
        for event in self.plan.remaining(reusable):
            self._check_halt()
            self._do(event)
        self._check_halt()

    def _shared_darks(self) -> set[int]:
        """Take a dark frame of every exposure; where they agree with those of others, these serve for the other steps.

        Returns the steps that are done: all dark ones, or none.
        """
        if self.darks is None:
            return set()
        own: dict[int, Frame] = {}
        for event in self.plan.first_darks():
            self._check_halt()
            if isinstance(event, DarkEvent):
                own[event.step] = self._take("dark", event.step)
            else:
                self._do(event)
        if not self.darks.agree(list(own.values())):
            return set()
        for shot in self.darks.shots:
            self.writer.put(shot)
            self._report(f"dark frame at {shot.frame.stage_deg:.3f}° of an earlier inspection")
        return set(own) | {shot.step for shot in self.darks.shots if shot.step is not None}

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
        for axis in self.rig.unhomed(all_axes=self.number > 0):
            self._report(f"homing {axis.name}")
            axis.home()
            self._check_halt()
        self.readings = {table: axis.position_deg() for table, axis in self.rig.by_table.items()}
        self.at = self.pose = self._pose_read(0.0)

    def _pose_read(self, near_deg: float) -> Pose:
        file = self.rig.file
        fixed_deg = file.geometry.tilt_deg
        tilt_deg = fixed_deg if file.tilt is None else file.tilt.place(self.readings["tilt"])
        return Pose(file.stage.place_near(self.readings["stage"], near_deg), tilt_deg)

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
        """Go to a pose, one axis after the other: tilt, stage, x, y, z, or in another order that is free."""
        ways = {
            table: _shortened(way, self.rig.by_table[table].position_deg())
            for table, way in ways_to(pose, self.plan.seat, self.rig).items()
            if table == "stage" or self.sent.get(table) != way[1]
        }
        for table in self.rig.guard.order(ways):
            reading = ways[table][-1]
            if table == "tilt":
                self._report(f"tilting to {pose.tilt_deg:g}°")
            elif table == "stage":
                self._report(f"turning to {pose.stage_deg:g}°")
            else:
                self._report(f"moving {table} to {reading:.4g} mm")
            self.sent.pop(table, None)
            for step in ways[table]:
                self._check_halt()
                self.readings[table] = self.rig.by_table[table].move_to(step)
            self.sent[table] = reading
        self.at, self.pose = self._pose_read(pose.stage_deg), pose

    def _take(self, kind: FrameKind, step: int | None, *, again: bool = False) -> Frame:
        frame = self._expose(kind)
        self.acquired += 1
        linear = {table: self.readings[table] for table in self.rig.linear}
        self.writer.put(Shot(frame, self.pose, step, again, linear))
        self._report(f"{kind} frame at {frame.stage_deg:.3f}°")
        return frame

    def _expose(self, kind: FrameKind) -> Frame:
        info = self.rig.camera.info
        counts = self.rig.camera.grab()
        if counts.shape != (info.rows, info.cols) or counts.dtype != np.uint16:
            raise CameraError(
                f"{info.model} delivered {counts.dtype} counts of shape {counts.shape} instead of uint16 "
                f"{(info.rows, info.cols)}"
            )
        if problem := too_high(counts, info.bit_depth):
            raise CameraError(f"{info.model}: {problem}")
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
