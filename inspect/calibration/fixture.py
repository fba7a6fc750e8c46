"""Reference of the fixture: white, black and greys of its markers on a sound rig, at stage angles all round.

Inspections read the same greys in every picture (`anisoscope.imaging.rig_monitor`): lamp, exposure, stray light and
linearity are measured against this reference.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from anisoscope.base.errors import CalibrationError, RigFileError, Saturated, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.calibration.corrections import read_calibrations
from anisoscope.calibration.frames import Bed
from anisoscope.calibration.record import (
    CalibrationRecord,
    Value,
    dated,
    days_of,
    record_path,
    write_calibration,
)
from anisoscope.calibration.rotation import MIN_ANGLES, poses_all_round, turning_plan
from anisoscope.calibration.white_reference import read_reference
from anisoscope.imaging.frames import AcquiredFrames, Shot
from anisoscope.imaging.registration.placement import check_fixture
from anisoscope.imaging.rig_monitor import read_markers, teach
from anisoscope.imaging.views import Viewing, views_of
from anisoscope.parameters.geometry import Pose as LightPose
from anisoscope.parameters.taking import Taking
from anisoscope.recipe.base import LimitsPart
from anisoscope.rig.acquisition.runner import Progress, open_rig, run_plan
from anisoscope.rig.rigfile import read_rig

MAX_SCATTER = 0.01
"""Largest deviation of the level of a picture from the smooth reference."""
MAX_BLACK = 0.15
"""Largest black of a marker relative to its white that is still print, and not stray light."""
WIDE = LimitsPart(black_share=0.5, white_untaught_share=0.5)
"""Wide enough to teach any print."""


@dataclass(frozen=True)
class LimitsAlone:
    """A recipe of nothing but limits."""

    limits: LimitsPart


def calibrate_fixture(
    rig_path: Path,
    out: Path,
    taking: Taking,
    *,
    angles: int = 8,
    tilts: Sequence[float] = (),
    on_progress: Advance = silent,
) -> CalibrationRecord:
    """Photograph the fixture all round and store the radiances of its white, black and greys.

    Lamp, camera and room must be as they should be: this is the state that inspections are compared with. A part may
    lie in the fixture. The flat is needed, which scales radiances.

    Args:
        rig_path: rig file with a fixture and a flat.
        out: record to write (JSON).
        taking: exposure, gain and frames of every pose.
        angles: stage angles over one turn; those beyond the limits of the stage are left out.
        tilts: tilts of the arm in degrees; 0 if empty, or that of a fixed arm.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        UsageError: too few angles.
        RigFileError, RigError: the rig; it has no fixture, or no flat.
        CalibrationError: the flat.
        RegistrationError, MeasurementError: markers are not seen.
        Saturated: the exposure is too long.
        RecordError: a file cannot be written.
    """
    if angles < MIN_ANGLES:
        raise UsageError(f"the fixture needs at least {MIN_ANGLES} angles, not {angles}: give more --steps")
    days_of("fixture", taking.valid_days)
    file = read_rig(rig_path, channel=taking.light_channel)
    if file.fixture is None or file.calibration is None:
        lacking = "[fixture]" if file.fixture is None else "[calibration] flat"
        raise RigFileError(
            f"{rig_path} describes no {lacking}: the reference is read from the markers, in radiances"
        )
    check_fixture(file.fixture)
    calibrations = read_calibrations(file.calibration, "fixture")
    white = calibrations.white(read_reference(file.calibration.flat))
    viewing = Viewing(white, calibrations, file.fixture, file.camera.pixel_um, LimitsAlone(WIDE))

    def report(now: Progress) -> None:
        on_progress(now.text, now.done, now.total)

    with tempfile.TemporaryDirectory() as folder, open_rig(file) as rig:
        usual = 0.0 if rig.tilt is not None else file.geometry.tilt_deg
        poses = tuple(
            pose
            for tilt_deg in (tilts or (usual,))
            for pose in poses_all_round(file, rig.stage.limits_deg, angles, tilt_deg)
        )
        taken = run_plan(turning_plan(poses, taking), rig, Path(folder), on_progress=report)
        info, stage = rig.camera.info, rig.stage.name
        content = Bed(rig, usual, on_progress).content(taking, len(taken)) | {"stage": stage}
    if white.camera != info.serial:
        raise CalibrationError(
            f"the flat was taken with camera {white.camera}, this is {info.serial}: take a new one with "
            "`anisoscope calibrate flat`"
        )
    shots = tuple(
        Shot(one.path.name, one.sha256, one.frame, one.pose, one.again, 0, one.step is None) for one in taken
    )
    on_progress("markers", 0, 1)
    frames = AcquiredFrames(shots, f"{info.model} {info.serial}", stage, info.linear)
    try:
        views = views_of(viewing, [LightPose(pose.stage_deg, pose.tilt_deg) for pose in poses], frames)
    except Saturated as error:
        raise Saturated(
            f"the pictures of the fixture are saturated at {taking.exposure_s:g} s: shorten --exposure"
        ) from error
    readings = [read_markers(view, file.fixture) for view in (*views.poses, *views.at_end)]
    reference, scatter = teach(readings, "")
    black = max(float(one.black.max()) for one in reference.tilts)
    level = float(reference.tilts[0].white.mean())
    remarks = []
    if scatter > MAX_SCATTER:
        remarks.append(
            f"the white of the markers scatters by {scatter:.1%} over the poses (limit {MAX_SCATTER:.0%}): let the "
            "lamp warm up, switch automatic exposure off"
        )
    if black > MAX_BLACK:
        remarks.append(
            f"the black of a marker is {black:.0%} as bright as its white (limit {MAX_BLACK:.0%}): keep other light "
            "off the rig, or print the markers anew"
        )
    content |= {
        "values": {
            "white": Value(value=level, u=max(scatter, 1e-5) * level, unit="1/sr"),
            "black_share": Value(value=black, u=reference.u_black),
            "scatter": Value(value=scatter),
            "edge": Value(value=reference.tilts[0].edge_um, unit="µm"),
        },
        "details": reference.as_details()
        | {"channel": file.light.channel, "light_angle_deg": file.light.angle_deg},
        "in_limits": not remarks,
        "remarks": tuple(remarks),
    }
    record = dated("fixture", content, valid_days=taking.valid_days)
    write_calibration(record, record_path(out))
    return record
