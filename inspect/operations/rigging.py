"""One action at a rig: its state, a motion of an axis, a picture, the focus."""

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import AnisoscopeError, NotConnected, UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.base.language import message
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.taking import Shot, Sweep
from anisoscope.rig.acquisition.opening import Devices, open_axis, open_devices, open_eye, open_lamp
from anisoscope.rig.rigfile import (
    BY_HAND,
    CameraPart,
    LightPart,
    MotorPart,
    RigAxes,
    RigFile,
    read_axes,
    read_rig,
)
from anisoscope.rig.stage import RotationStage, Unit, check_limits, motion_state, within_a_turn
from anisoscope.rig.transport import shared_ports

if TYPE_CHECKING:  # these load OpenCV and the models of records, which a motion does without
    from anisoscope.live_view.autofocus import Focus
    from anisoscope.rig.frame import Frame

Axis = Literal["stage", "tilt", "x", "y", "z"]
Confirm = Callable[[str], None]
"""Announces a motion; raises `UsageError` where it is not allowed."""
Axes = tuple[RigAxes | None, Mapping[str, MotorPart]]
"""Rig file, where there is one, and axes by table."""


def unasked(what: str) -> None:
    """Allow every motion."""
    del what


def is_taught(rig: Path, file: RigAxes) -> bool:
    """Whether a rig was commissioned or calibrated before, so that sense, zero and limits are known: it moves unasked.

    A rig file that names a calibration says so, or a record of its commissioning beside it.
    """
    from anisoscope.commissioning.record import default_record_path

    channels = {} if file.light is None else file.light.channels
    named = file.calibration is not None or any(one.flat or one.fixture for one in channels.values())
    return named or default_record_path(rig).exists()


def question_of(rig: Path) -> str:
    """Question before the first motion of a rig that was never taught; "" of others, and where all is set by hand.

    Raises:
        RigFileError: the rig file.
    """
    file = read_axes(rig)
    driven = [table for table, part in file.axes.items() if part.driver != BY_HAND]
    if not driven or is_taught(rig, file):
        return ""
    names = ", ".join(driven)
    return message(
        "this rig was never commissioned; {names} home and turn: keep their paths free", names=names
    )


def home_axes(
    axes: Mapping[str, RotationStage],
    parts: Mapping[str, MotorPart],
    file: RigAxes | None,
    confirm: Confirm = unasked,
) -> None:
    """Search the references of those axes that were not homed, in the order of the rig file.

    Raises:
        UsageError: a motion was not allowed.
        RigError: hardware.
    """
    order = () if file is None else file.home_order
    for table in dict.fromkeys((*order, *axes)):
        if table in axes and not axes[table].is_homed:
            _home(axes[table], parts[table], confirm)


def _home(axis: RotationStage, part: MotorPart, confirm: Confirm) -> None:
    if part.driver != BY_HAND:  # there the operator is asked for every single motion
        confirm(
            message("homing {name}: it searches its reference and may turn a full turn", name=axis.name)
            if part.unit == "deg"
            else message("homing {name}: it searches its reference over its whole travel", name=axis.name)
        )
    axis.home()


@dataclass(frozen=True)
class Moved:
    """Completed motion.

    Attributes:
        axis: its table in the rig file.
        device: its name.
        homed: the axis searched its reference.
        unit: of all places: deg or mm.
        before, after: readings; None where it was unknown.
        place_before, place_after: of the sample, or of the arm; None where no rig file states it.
        readings: the same as keys of JSON, with the unit in their names.
    """

    axis: str
    device: str
    homed: bool
    unit: Unit = field(metadata=LEFT_OUT)
    before: float | None = field(metadata=LEFT_OUT)
    after: float = field(metadata=LEFT_OUT)
    place_before: float | None = field(metadata=LEFT_OUT)
    place_after: float | None = field(metadata=LEFT_OUT)

    @property
    def readings(self) -> dict[str, float | None]:
        """Before and after, as keys of JSON with the unit in their names."""
        kind, unit = "angle" if self.unit == "deg" else "place", self.unit
        return {
            f"before_{unit}": self.before,
            f"after_{unit}": self.after,
            f"{kind}_before_{unit}": self.place_before,
            f"{kind}_after_{unit}": self.place_after,
        }


def home_axis(rig: Path | str | Axes, axis: Axis = "stage", *, confirm: Confirm = unasked) -> Moved:
    """Search the reference of an axis, also of one that was homed before. It may turn by a full turn.

    Args:
        rig: rig file; or its axes by table.
        axis: which of them.
        confirm: announces the motion, and raises where it is not allowed.

    Raises:
        UsageError: there is no such axis, or the motion was not allowed.
        RigFileError, RigError: rig file or hardware.
    """
    file, parts = _axes(rig, axis)
    with open_devices(dict(parts), rows_of=file) as devices:
        stage, part = devices.axes[axis], parts[axis]
        before = position(stage)
        _home(stage, part, confirm)
        return _moved(axis, stage, part, file, before, homed=True)


def move_axis(
    rig: Path | str | Axes,
    to: float,
    axis: Axis = "stage",
    *,
    by: bool = False,
    sample: bool = False,
    confirm: Confirm = unasked,
) -> Moved:
    """Move an axis; one that was not homed is homed first. What cannot be reached is refused before both.

    A stage that turns all the way round takes every angle: -5 is 355. An arm is not turned round: it would hit
    something.

    Args:
        rig: rig file; or its axes by table.
        to: reading in degrees, of linear axes in mm.
        axis: which of them.
        by: ``to`` is a distance from where it is.
        sample: ``to`` is the angle or place of the sample (or of the arm), approached from below as in an inspection.
        confirm: announces homing, and raises where it is not allowed.

    Raises:
        UsageError: there is no such axis, or homing was not allowed.
        LimitExceeded: it cannot be reached; nothing was moved.
        RigFileError, RigError: rig file or hardware.
    """
    file, parts = _axes(rig, axis)
    if sample and file is None:
        raise UsageError("--sample needs a rig file: only that says at which reading the sample stands at 0°")

    def way_to(stage: RotationStage, part: MotorPart, now: float) -> tuple[float, float]:
        limits, reading = stage.limits_deg, now + to if by else to
        if axis == "stage":
            reading = within_a_turn(limits, reading)
        way = part.way(to, limits) if sample else (reading, reading)
        for one in way:
            check_limits(stage, one)
        return way

    with open_devices(dict(parts), rows_of=file) as devices:
        stage, part = devices.axes[axis], parts[axis]
        before, homed = position(stage), not stage.is_homed
        low, high = stage.limits_deg
        zero = min(max(0.0, low), high)
        below, reading = way_to(stage, part, zero if homed or before is None else before)
        home_axes(devices.axes, parts, file, confirm)
        if homed:
            below, reading = way_to(stage, part, stage.position_deg())
        if sample and stage.position_deg() > below:
            stage.move_to(below)
        stage.move_to(reading)
        return _moved(axis, stage, part, file, before, homed=homed)


def _axes(rig: Path | str | Axes, axis: Axis) -> Axes:
    if not isinstance(rig, Path | str):
        return rig
    file = read_axes(Path(rig))
    if axis not in file.axes:
        raise UsageError(f"{rig}: there is no axis {axis}: it has no table [{axis}]")
    return file, file.moved_with(axis)


def _moved(
    axis: str,
    stage: RotationStage,
    part: MotorPart,
    file: RigAxes | None,
    before: float | None,
    *,
    homed: bool,
) -> Moved:
    after = stage.position_deg()
    places = [None if file is None or one is None else part.place(one) for one in (before, after)]
    return Moved(axis, stage.name, homed, part.unit, before, after, places[0], places[1])


def position(stage: RotationStage) -> float | None:
    """Reading of an axis; None of one by hand before its first setting.

    Raises:
        NotConnected: it is gone.
    """
    try:
        return stage.position_deg()
    except NotConnected:
        raise
    except AnisoscopeError:
        return None


def rig_status(rig: Path | str | Axes) -> dict[str, Any]:
    """Identity and state of every device of a rig; nothing moves, nothing is switched.

    Args:
        rig: rig file; or its axes by table.

    Returns:
        "rig": its name, then by table what the device says; "error" where it does not answer.

    Raises:
        RigFileError: the rig file.
    """
    if isinstance(rig, Path | str):
        read = read_axes(Path(rig))
        rig = read, read.axes
    file, axes = rig
    found: dict[str, Any] = {"rig": None if file is None else file.name}
    with contextlib.ExitStack() as stack, shared_ports():
        for table, part in axes.items():
            found[table] = _of(_axis_state, part, table, stack)
            if file is None:  # nobody said where the sample stands at 0°
                found[table].pop("angle_deg", None)
                found[table].pop("place_mm", None)
        if file is not None and file.camera is not None:
            found["camera"] = _of(_camera_state, file.camera, file, stack)
        if file is not None and file.light is not None:
            found["light"] = _of(_light_state, file.light, stack)
    return found


def _of(query: Callable[..., dict[str, Any]], part: Any, *rest: Any) -> dict[str, Any]:  # noqa: ANN401
    try:
        return {"driver": part.driver, **query(part, *rest)}
    except AnisoscopeError as problem:
        return {"driver": part.driver, "error": " ".join(str(problem).split())}


def _axis_state(part: MotorPart, table: str, stack: contextlib.ExitStack) -> dict[str, Any]:
    if part.driver == BY_HAND:
        return {"device": "set by hand"}
    axis = open_axis(part, table)
    stack.callback(axis.close)
    state, unit = motion_state(axis), part.unit
    reading = state.position_deg
    return {
        "port": part.port,
        "device": axis.name,
        f"position_{unit}": reading,
        "angle_deg" if unit == "deg" else "place_mm": None if reading is None else part.place(reading),
        "moving": state.moving,
        f"speed_{unit}_s": state.speed_deg_s,
        "homed": axis.is_homed,
        f"limits_{unit}": list(axis.limits_deg),
        f"resolution_{unit}": axis.resolution_deg,
    }


def _camera_state(part: CameraPart, file: RigAxes, stack: contextlib.ExitStack) -> dict[str, Any]:
    camera = open_eye(part)
    stack.callback(camera.close)
    info = camera.info
    same = ("rows", "cols", "bit_depth", "black_level", "filters", "linear")
    return {name: getattr(info, name) for name in same} | {
        "device": f"{info.model} {info.serial}".strip(),
        "uncalibrated": file.uncalibrated(info),
        "pixel_um": part.pixel_um,
    }


def _light_state(part: LightPart, stack: contextlib.ExitStack) -> dict[str, Any]:
    light = open_lamp(part)
    stack.callback(light.close)
    return {
        "port": part.port,
        "device": str(getattr(light, "name", part.driver)),
        "angle_deg": part.angle_deg,
        "channels": list(part.channels),
    }


@dataclass(frozen=True)
class Snapped:
    """Picture that was written to a file, with its figures.

    Attributes:
        file: 16-bit TIFF with the metadata of a frame.
        preview: PNG next to it, or None.
        rows, cols: of the picture.
        exposure_s, gain: as the camera took them.
        angle_deg, tilt_deg: of sample and arm; NaN of an axis that was not read.
        mean_counts: mean of the counts.
        mean: the same above black, as a share of full scale.
        saturated_share: largest share of saturated pixels among the frames.
        filters: mosaic of a colour camera, or "mono".
        sharpness: Tenengrad; NaN of a picture that is too dark.
        ridge_deg: direction of ridges counter-clockwise from upright, or None.
        not_homed: axes whose angle is only what was read.
    """

    file: Path
    preview: Path | None
    rows: int
    cols: int
    exposure_s: float
    gain: float
    angle_deg: float
    tilt_deg: float
    mean_counts: float
    mean: float
    saturated_share: float
    filters: str
    sharpness: float
    ridge_deg: float | None
    not_homed: tuple[str, ...] = field(metadata=LEFT_OUT)


@by_keywords(shot=Shot)
def snap(
    rig: Path | str,
    out: Path | str,
    *,
    shot: Shot,
    frames: int = 1,
    preview: bool = False,
    read_angles: bool = True,
    overwrite: bool = False,
) -> Snapped:
    """Take a picture and write it to a file; nothing moves.

    Args:
        rig: rig file.
        out: file to write (.tif); of a colour camera the unchanged mosaic.
        shot: exposure and light, or its fields as keywords.
        frames: to average, rounded to counts.
        preview: write a PNG next to it, in colour.
        read_angles: read the axes, and write their angles into the file.
        overwrite: replace files that exist.

    Raises:
        UsageError: another kind of file, one that exists, or a number of frames outside 1 to 10,000.
        RigFileError, RigError: rig file or hardware.
    """
    from anisoscope.live_view.picture import as_png, to_show
    from anisoscope.live_view.view import look_at
    from anisoscope.rig.frame import write_frame

    target = Path(out)
    picture = target.with_suffix(".png") if preview else None
    if target.suffix.lower() not in {".tif", ".tiff"}:
        raise UsageError(f"--out {target}: frames are TIFF files; name it .tif")
    for path in (target, picture):
        if path is not None and path.exists() and not overwrite:
            raise UsageError(f"{path} exists; name another file, or say --overwrite")
    if not 1 <= frames <= 10_000:
        raise UsageError(f"--count must lie between 1 and 10000, not {frames}")
    file = read_rig(Path(rig), channel=shot.channel)
    axes = {"stage": file.stage} | ({} if file.tilt is None else {"tilt": file.tilt})
    lamp = None if shot.light == "as-is" else file.light
    with open_devices(axes if read_angles else {}, file.camera, lamp) as devices:
        frame, saturated = _take(devices, file, shot, frames)
        assert devices.camera is not None
        info = devices.camera.info
        unsure = tuple(axis.name for axis in devices.axes.values() if not axis.is_homed)
    write_frame(frame, target)
    view = look_at(frame.counts, info)
    if picture is not None:
        write_bytes(picture, as_png(to_show(frame.counts, info)))
    return Snapped(
        file=target,
        preview=picture,
        rows=frame.counts.shape[0],
        cols=frame.counts.shape[1],
        exposure_s=frame.exposure_s,
        gain=frame.gain,
        angle_deg=frame.stage_deg,
        tilt_deg=frame.tilt_deg,
        mean_counts=float(frame.counts.mean()),
        mean=view.mean,
        saturated_share=saturated,
        filters=frame.filters,
        sharpness=view.focus,
        ridge_deg=view.ridge_deg,
        not_homed=unsure,
    )


def _take(devices: Devices, file: RigFile, shot: Shot, frames: int) -> "tuple[Frame, float]":
    """The mean of some frames, and the largest saturated share among them."""
    import numpy as np

    from anisoscope.live_view.view import saturated_share
    from anisoscope.rig.frame import Frame

    camera = devices.camera
    assert camera is not None
    settings = camera.configure(shot.exposure_s, shot.gain)
    if devices.light is not None:
        (devices.light.on if shot.light == "on" else devices.light.off)()
    info = camera.info
    captured = [camera.grab().copy() for _ in range(frames)]
    mean = np.rint(np.mean(captured, axis=0)).astype(np.uint16) if frames > 1 else captured[0]
    stage_deg, tilt_deg = _angles(devices, file)
    frame = Frame(
        counts=mean,
        kind="dark" if shot.light == "off" else "sample",
        bit_depth=info.bit_depth,
        black_level=info.black_level,
        exposure_s=settings.exposure_s,
        gain=settings.gain,
        stage_deg=stage_deg,
        commanded_deg=stage_deg,
        tilt_deg=tilt_deg,
        captured_at=datetime.now(UTC).isoformat(timespec="milliseconds"),
        camera=f"{info.model} {info.serial}",
        filters=info.filters,
    )
    return frame, max(saturated_share(counts, info.bit_depth) for counts in captured)


def _angles(devices: Devices, file: RigFile) -> tuple[float, float]:
    """Angles of sample and arm in degrees; NaN for an axis that was not read."""
    stage, tilt = devices.axes.get("stage"), devices.axes.get("tilt")
    stage_deg = math.nan if stage is None else file.stage.place(stage.position_deg())
    if file.tilt is None:
        return stage_deg, file.geometry.tilt_deg
    return stage_deg, math.nan if tilt is None else file.tilt.place(tilt.position_deg())


def _search_keys(found: "Focus") -> dict[str, Any]:
    return {
        "best_mm": found.best,
        "reached_mm": found.reached,
        "places_mm": found.places,
        "half_width_mm": found.half_width,
        "kept_share": found.kept,
        "readings_mm": found.readings,
        "sharpness": found.sharpness,
    }


@dataclass(frozen=True)
class Focused:
    """Axis z at the sharpest picture; lengths in mm.

    Attributes:
        found: the search.
        place_mm: place of the sharpest picture, as the rig file counts it.
        depth_of_field_mm: by wavelength and aperture of the rig file; None where it has not both.
    """

    found: "Focus" = field(metadata=json_field(by=_search_keys, merged=True))
    place_mm: float
    depth_of_field_mm: float | None

    @property
    @in_json()
    def repeatability_mm(self) -> float | None:
        """Standard deviation of the place of one sweep; None of a single one."""
        return None if math.isnan(self.found.repeatability) else self.found.repeatability


@by_keywords(shot=Shot)
def focus(
    rig: Path | str,
    sweep: Sweep,
    *,
    shot: Shot,
    confirm: Confirm = unasked,
) -> Focused:
    """Bring the part into focus: sweep z, fit a curve to the sharpness, and go to its peak.

    Args:
        rig: rig file with a table [z].
        sweep: readings of z, number of sweeps, focus measure, frames averaged.
        shot: exposure and light, or its fields as keywords.
        confirm: announces homing, and raises where it is not allowed.

    Raises:
        UsageError: nothing moves the focus there, or homing was not allowed.
        MeasurementError: no peak within the sweep.
        RigFileError, RigError: rig file or hardware.
    """
    from anisoscope.live_view.autofocus import Autofocus, depth_of_field_mm

    file = read_rig(Path(rig), channel=shot.channel)
    if file.z is None:
        raise UsageError("nothing moves the focus there: the rig file has no table [z]")
    lamp, axes = None if shot.light == "as-is" else file.light, file.moved_with("z")
    with open_devices(axes, file.camera, lamp, rows_of=file) as devices:
        axis, camera = devices.axes["z"], devices.camera
        assert camera is not None
        home_axes(devices.axes, axes, file, confirm)
        camera.configure(shot.exposure_s, shot.gain)
        if devices.light is not None:
            (devices.light.on if shot.light == "on" else devices.light.off)()
        search = Autofocus(axis, camera, file.z.approach_mm, sweep.measure, sweep.average).search
        found = search(sweep.low, sweep.high, steps=sweep.steps, repeats=sweep.repeats)
    return Focused(found, file.z.place(found.best), depth_of_field_mm(file))
