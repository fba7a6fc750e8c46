"""Checks of the rig by its fixture: lamp, stray light, evenness, linearity, focus against the fixture's reference."""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime

import numpy as np

from anisoscope.base.errors import CalibrationError
from anisoscope.calibration.corrections import Calibrations, read_calibrations
from anisoscope.calibration.fixture import LimitsAlone
from anisoscope.calibration.record import advice
from anisoscope.calibration.white_reference import read_reference
from anisoscope.commissioning.selftest_record import Check, Settings, limit_check, skipped_check
from anisoscope.imaging.frames import AcquiredFrames, Shot
from anisoscope.imaging.rig_monitor import FixtureReference, PoseState, RigMonitor
from anisoscope.imaging.views import Viewing, views_of
from anisoscope.parameters.geometry import Pose as LightPose
from anisoscope.recipe.base import LimitsPart
from anisoscope.rig.acquisition.plan import Pose
from anisoscope.rig.camera import CameraInfo
from anisoscope.rig.frame import Frame
from anisoscope.rig.rigfile import CalibrationPart, RigFile

FIXTURE = (
    ("fixture.age", "age of the fixture's reference"),
    ("fixture.edge", "edge width at the markers over the reference"),
    ("fixture.level", "white of the markers off the reference"),
    ("fixture.stray", "stray light at the markers, of their white"),
    ("fixture.gradient", "a marker off the level of the others"),
    ("fixture.greys", "greys off a straight line, of white"),
)


def fixture_checks(
    file: RigFile, info: CameraInfo, devices: tuple[str, str], frames: Sequence[Frame], settings: Settings
) -> list[Check]:
    """Compare the fixture with its reference, in pictures that are evaluated as those of an inspection.

    Args:
        file: the rig file, in its light channel.
        info: the camera.
        devices: names of camera and stage.
        frames: dark ones, and one of every stage angle; further ones of an angle are repetitions.
        settings: the limits.

    Raises:
        CalibrationError: the reference is damaged, out of its limits, or of another camera or light.
        MeasurementError: the pictures cannot be evaluated.
    """
    part = file.calibration
    if file.fixture is None or part is None or part.fixture is None or settings.tile:
        why = (
            "the rig has no reference of its fixture: `anisoscope rig check --teach` teaches one, or `anisoscope "
            "calibrate fixture`"
        )
        if settings.tile:
            why = "the white tile lies on the stage"
        return [skipped_check(*name, why) for name in FIXTURE]
    known = read_calibrations(part)
    record = known.records["fixture"]
    known.check_camera(info.serial, (info.rows, info.cols))
    known.check_light(file.light)
    if not record.in_limits:
        raise CalibrationError(record.invalid_reason(record.taken_at) or "")
    days = (datetime.now(UTC) - record.taken_at).total_seconds() / 86400.0
    age = limit_check(*FIXTURE[0], days, record.valid_for_days, "days", advice("fixture"))
    monitor = _monitor(file, part, known, devices, info.linear, frames)
    if monitor.not_watched:
        return [age, *(skipped_check(*name, monitor.not_watched[0]) for name in FIXTURE[1:])]
    return [age, *_compared(monitor, known.fixture_reference, settings)]


def _monitor(
    file: RigFile,
    part: CalibrationPart,
    known: Calibrations,
    devices: tuple[str, str],
    linear: bool,
    frames: Sequence[Frame],
) -> RigMonitor:
    shots: list[Shot] = []
    poses: dict[LightPose, None] = {}
    for number, frame in enumerate(frames):
        pose = LightPose(frame.commanded_deg, frame.tilt_deg)
        at, lit = Pose(frame.commanded_deg, frame.tilt_deg), frame.kind == "sample"
        shots.append(Shot(f"frame {number + 1}", "", frame, at, lit and pose in poses, 0, False))
        if lit:
            poses[pose] = None
    white = known.white(read_reference(part.flat))
    viewing = Viewing(white, known, file.fixture, file.camera.pixel_um, LimitsAlone(LimitsPart()))
    found = views_of(viewing, list(poses), AcquiredFrames(tuple(shots), *devices, linear)).monitor
    assert found is not None
    return found


def _compared(monitor: RigMonitor, reference: FixtureReference | None, settings: Settings) -> list[Check]:
    """Checks of the readings that differ most from the reference."""

    def worst(value: Callable[[PoseState], float]) -> tuple[float, str]:
        pose = max(monitor.poses, key=lambda one: abs(value(one)))
        return abs(value(pose)), f"{value(pose):+.2%} at {pose.stage_deg:g}°"

    edge = _edge(monitor, reference, settings)
    if edge.outcome == "FAIL":  # blur brings white into black
        return [
            edge,
            *(skipped_check(*name, "focus first: blur looks like stray light") for name in FIXTURE[2:]),
        ]
    level, at_level = worst(lambda pose: pose.level - 1.0)
    stray, at_stray = worst(lambda pose: (pose.stray or 0.0) / pose.white)
    gradient, at_gradient = worst(lambda pose: pose.gradient or 0.0)
    dirty = "".join(f"; marker {number} is dirty or in shadow: clean it" for number in monitor.dirty)
    checks = [
        limit_check(
            *FIXTURE[2], level, settings.level_share, "relative",
            "are exposure and gain those that the camera reports? else the lamp changed: take a new flat, and teach "
            "the fixture", remark=at_level,
        ),
        limit_check(
            *FIXTURE[3], stray, settings.stray_share, "relative",
            "keep other light off the rig, look for glare on lens and fixture, check the camera's black level",
            remark=at_stray,
        ),
        limit_check(
            *FIXTURE[4], gradient, settings.gradient_share, "relative",
            "the light is uneven: clean the fixture, put the lamp as it was, or take a new flat",
            remark=at_gradient + dirty,
        ),
    ]  # fmt: skip
    if any(pose.nonlinear is None for pose in monitor.poses):
        why = "the fixture has no greys: print new markers with `anisoscope rig markers`"
        checks.append(skipped_check(*FIXTURE[5], why))
    else:
        bent, at_bent = worst(lambda pose: pose.nonlinear or 0.0)
        linear = "the camera is not linear, or the patch is dirty: switch gamma off, `anisoscope calibrate response`"
        checks.append(limit_check(*FIXTURE[5], bent, settings.grey_share, "relative", linear, remark=at_bent))
    return [edge, *checks]


def _edge(monitor: RigMonitor, reference: FixtureReference | None, settings: Settings) -> Check:
    edges = [pose.edge_um for pose in monitor.poses if pose.edge_um is not None]
    taught = None if reference is None else reference.like(monitor.poses[0].tilt_deg)
    if taught is None or not edges or taught.edge_um <= 0.0:
        return skipped_check(*FIXTURE[1], "the reference holds no edge width")
    edge_um = float(np.median(edges))
    return limit_check(
        *FIXTURE[1], edge_um / taught.edge_um, settings.blur_ratio, "1", "focus the lens, or clean it",
        remark=f"{edge_um:.3g} µm",
    )  # fmt: skip
