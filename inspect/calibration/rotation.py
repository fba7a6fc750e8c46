"""Rotation centre of the stage and pixel size, from the fixture's markers over one turn of the stage."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import RigFileError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.calibration.frames import Bed
from anisoscope.calibration.record import (
    CalibrationRecord,
    CameraRecord,
    Value,
    dated,
    days_of,
    record_path,
    write_calibration,
)
from anisoscope.imaging.linearisation import Image, hot_pixels, stack
from anisoscope.imaging.registration.lens import Corners, FittedLens, fit_lens
from anisoscope.imaging.registration.placement import (
    MIN_MARKERS,
    Placement,
    angle_between,
    check_fixture,
    find_markers,
    marker_corners_mm,
    place_markers,
)
from anisoscope.parameters.taking import Taking
from anisoscope.rig.acquisition.plan import Plan, Pose, Seat
from anisoscope.rig.acquisition.runner import FrameRecord, Progress, open_rig, run_plan
from anisoscope.rig.bayer import grey_of
from anisoscope.rig.camera import CameraInfo
from anisoscope.rig.rigfile import RigFile, read_rig

MIN_ANGLES = 6
MAX_RUNOUT_PX = 1.0
MAX_TURN_ERROR_DEG = 0.2
MAX_SCALE_SHARE = 0.02
MAX_DIRECTION_DEG = 20.0
SHIFT_SHARE = 0.05
_LEAST_PX = 0.002


def calibrate_rotation(
    rig_path: Path,
    out: Path,
    taking: Taking,
    *,
    angles: int = 12,
    at_mm: tuple[float, float] = (0.0, 0.0),
    on_progress: Advance = silent,
) -> CalibrationRecord:
    """Turn the fixture once and determine rotation centre, pixel size, runout, and the distortion of the lens.

    A tilt axis is set to 0°; a fixed arm stays at its tilt. Two frames per pose suffice. With axes x and y a fixture
    off the axis of the stage is followed, and their readings with that axis in the middle of the picture are found,
    and the directions in which they move the picture.

    Args:
        rig_path: rig file with a fixture.
        out: record to write (JSON).
        taking: exposure, gain and frames of every angle.
        angles: stage angles over one turn; those beyond the limits of the stage are left out.
        at_mm: (x, y) of the fixture on the plate from the axis of the stage, as far as it is known; x and y bring it
            below the camera.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        UsageError: too few angles.
        RigFileError, RigError: the rig, or it has no fixture.
        RegistrationError: markers are not detected.
        RecordError: a file cannot be written.
    """
    if angles < MIN_ANGLES:
        raise UsageError(f"the rotation needs at least {MIN_ANGLES} angles, not {angles}")
    days_of("rotation", taking.valid_days)
    file = read_rig(rig_path, channel=taking.light_channel)
    if file.fixture is None:
        raise RigFileError(f"{rig_path} describes no [fixture]: the rotation is found by its markers")
    check_fixture(file.fixture)

    def report(now: Progress) -> None:
        on_progress(now.text, now.done, now.total)

    with tempfile.TemporaryDirectory() as folder, open_rig(file) as rig:
        tilt_deg = 0.0 if rig.tilt is not None else file.geometry.tilt_deg
        poses = poses_all_round(file, rig.stage.limits_deg, angles, tilt_deg)
        plan = replace(turning_plan(poses, taking), seat=Seat(at_mm))
        plans = [plan, *_shifted_plans(plan, file, rig.camera.info)]
        records = [
            record
            for number, one in enumerate(plans)
            for record in run_plan(one, rig, Path(folder) / str(number), on_progress=report)
        ]
        bed, name = Bed(rig, tilt_deg, on_progress), rig.stage.name
        content = bed.content(taking, len(records)) | {"stage": name}
    on_progress("markers", 0, 1)
    places, lens = _places(records, file)
    results = _results(places, file, bed.camera)
    results["values"] |= _distortion(lens)
    record = dated("rotation", content | results, valid_days=taking.valid_days)
    write_calibration(record, record_path(out))
    return record


def _shifted_plans(plan: Plan, file: RigFile, info: CameraInfo) -> list[Plan]:
    """The first pose with the fixture shifted along x and y, which separates the travel of the axes from its place."""
    if not {"x", "y"} <= file.linear.keys():
        return []
    x, y = plan.seat.place_mm
    step = SHIFT_SHARE * min(info.rows, info.cols) * file.camera.pixel_um / 1000.0
    return [
        replace(plan, poses=plan.poses[:1], return_to_first=False, seat=Seat((x + dx, y + dy)))
        for dx, dy in ((step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step))
    ]


def poses_all_round(
    file: RigFile, limits_deg: tuple[float, float], angles: int, tilt_deg: float
) -> tuple[Pose, ...]:
    """Poses all round that can be approached from below.

    Args:
        file: of the rig.
        limits_deg: readings that the stage reaches.
        angles: equal steps over a turn; those beyond the limits are left out.
        tilt_deg: tilt of the arm.

    Raises:
        RigFileError: the stage reaches fewer than six.
    """
    low, high = limits_deg
    found = []
    for angle_deg in (360.0 * number / angles for number in range(angles)):
        below, reading = file.stage.way(angle_deg, limits_deg)
        if low <= below and reading <= high:
            found.append(angle_deg)
    if len(found) < MIN_ANGLES:
        raise RigFileError(
            f"stage: of {angles} angles all round it reaches {len(found)} (at least {MIN_ANGLES} are needed): "
            "correct stage.zero_deg, or give more --steps"
        )
    return tuple(Pose(angle, tilt_deg) for angle in found)


def turning_plan(poses: tuple[Pose, ...], taking: Taking) -> Plan:
    """Plan of poses with the frames of a calibration."""
    return Plan(
        poses=poses,
        exposure_s=taking.exposure_s,
        gain=taking.gain,
        frames_per_pose=taking.frames,
        dark_frames=max(2, taking.frames),
        settle_s=0.1,
    )


@dataclass(frozen=True, eq=False)
class _Located:
    """Position of the fixture at an angle of the stage, as read back."""

    stage_deg: float
    place: Placement
    travel_mm: tuple[float, float]


def _places(records: list[FrameRecord], file: RigFile) -> tuple[list[_Located], FittedLens]:
    fixture = file.fixture
    assert fixture is not None
    known = marker_corners_mm(fixture)
    dark = stack(record.frame for record in records if record.frame.kind == "dark")
    poses: dict[tuple[Pose, Path], list[FrameRecord]] = {}
    for record in records:
        if record.frame.kind != "dark" and not record.again:
            poses.setdefault((record.pose, record.path.parent), []).append(record)
    seen, corners = [], []
    for shots in poses.values():
        lit = stack(shot.frame for shot in shots)
        hot = hot_pixels(dark)
        picture: Image = np.where(
            hot, np.float32(np.median(lit.mean)), lit.mean - np.where(hot, 0.0, dark.mean)
        )
        frame = shots[0].frame
        markers = find_markers(grey_of(picture.astype(np.float32), frame.filters), fixture)
        seen.append((frame, markers, _travel(shots[0].linear_mm, file)))
        if len(markers) >= MIN_MARKERS:
            points = np.concatenate([known[marker.id] for marker in markers])
            pixels = np.concatenate([marker.corners for marker in markers])
            corners.append(Corners(points, pixels, float(np.cos(np.radians(frame.tilt_deg)))))
    shape = dark.mean.shape[:2]
    fitted = fit_lens(corners, shape) if len(corners) == len(seen) else None
    lens = None if fitted is None else fitted.lens
    places = [
        _Located(frame.stage_deg, place_markers(markers, fixture, shape, frame.tilt_deg, lens=lens), travel)
        for frame, markers, travel in seen
    ]
    assert fitted is not None  # else a picture with too few markers was refused
    return places, fitted


def _distortion(fitted: FittedLens) -> dict[str, Value]:
    """The distortion as values of the record, where it is significant."""
    if fitted.lens is None:
        return {}
    return {
        f"distortion_k{i + 1}": Value(value=k, u=float(u))
        for i, (k, u) in enumerate(zip((fitted.lens.k1, fitted.lens.k2), fitted.u, strict=False))
    }


def _travel(linear_mm: Mapping[str, float], file: RigFile) -> tuple[float, float]:
    """How far x and y stand from where the rig file has them at 0, in mm."""
    x, y = (file.linear[name].place(linear_mm[name]) if name in linear_mm else 0.0 for name in "xy")
    return x, y


def _results(located: list[_Located], file: RigFile, info: CameraRecord) -> dict[str, Any]:
    places = [one.place for one in located]
    travels = np.array([one.travel_mm for one in located])
    centre, u_px, eccentricity, u_mm, rest_px, axes = _circle(places, travels, file, info)
    distance_px = np.hypot(*rest_px.T)
    turns = np.array([angle_between(one.stage_deg, one.place.angle_deg) for one in located])
    zero = float(turns[0] + np.mean([angle_between(turns[0], turn) for turn in turns]))
    off = np.array([angle_between(zero, turn) for turn in turns])
    sizes = np.array([place.pixel_um for place in places])
    pixel_um, u_pixel = float(sizes.mean()), float(sizes.std(ddof=1) / np.sqrt(len(sizes)))
    tilt, u_tilt = _axis_tilt(places)
    runout = float(distance_px.max())
    remarks = _faults(runout, float(np.abs(off).max()), pixel_um, file) + _wrong_axes(axes)
    return {
        "values": {
            "centre_column": Value(value=centre[0], u=u_px, unit="px"),
            "centre_row": Value(value=centre[1], u=u_px, unit="px"),
            "pixel": Value(value=pixel_um, u=max(u_pixel, 1e-5 * pixel_um), unit="µm"),
            "runout": Value(value=runout, u=u_px, unit="px"),
            "eccentricity_x": Value(value=eccentricity[0], u=u_mm, unit="mm"),
            "eccentricity_y": Value(value=eccentricity[1], u=u_mm, unit="mm"),
            "fixture_angle": Value(value=zero, u=float(off.std(ddof=1) / np.sqrt(len(off))), unit="°"),
            "turn_error": Value(value=float(np.abs(off).max()), unit="°"),
            "axis_tilt": Value(value=tilt, u=u_tilt, unit="°"),
            **axes,
        },
        "residuals": tuple(float(value) for value in distance_px),
        "details": {
            "angles_deg": [one.stage_deg for one in located],
            "markers": min(place.markers for place in places),
        },
        "in_limits": not remarks,
        "remarks": tuple(remarks),
    }


def _circle(
    places: list[Placement], travels: FloatArray, file: RigFile, info: CameraRecord
) -> tuple[tuple[float, float], float, tuple[float, float], float, FloatArray, dict[str, Value]]:
    """Centre c and eccentricity e (mm, in the fixture's frame) from origin = c + A·e + J·travel of every picture.

    The travel of x and y, (N, 2) in mm, shifts the picture by J, (2, 2) in pixels per mm, of a rig that has both axes.

    Returns:
        c, where the axis is with x and y at 0, its u, e, its u, the (N, 2) residuals in pixels, and the values of x, y.
    """
    moved = {"x", "y"} <= file.linear.keys()
    blocks = []
    for place, (x, y) in zip(places, travels, strict=True):
        shift = [np.kron([[x, y]], np.eye(2))] if moved else []
        blocks.append(np.column_stack([np.eye(2), place.matrix[:, :2], *shift]))
    design = np.concatenate(blocks)
    origins = np.concatenate([np.asarray(place.axis_px) for place in places])
    solution = np.linalg.lstsq(design, origins, rcond=None)[0]
    rest = origins - design @ solution
    scatter = max(float(np.sqrt(rest @ rest / max(rest.size - len(solution), 1))), _LEAST_PX)
    covariance = scatter**2 * np.linalg.inv(design.T @ design)
    u = np.sqrt(np.diag(covariance))
    axes = _axes_of(solution, covariance, file, info, places[0].pixel_um) if moved else {}
    # origin = c + A·(position of the origin from the axis); the axis in the fixture's frame is at −e
    return (
        (float(solution[0]), float(solution[1])),
        float(max(u[:2])),
        (float(solution[2]), float(solution[3])),
        float(max(u[2:4])),
        rest.reshape(-1, 2),
        axes,
    )


def _axes_of(
    solution: FloatArray, covariance: FloatArray, file: RigFile, info: CameraRecord, pixel_um: float
) -> dict[str, Value]:
    """Readings of x and y with the axis of the stage in the middle of the picture, and how they move the picture.

    Solves c + J·t = middle for the travel t; its uncertainty follows from the derivatives of t by c and J.
    """
    centre, along = solution[:2], solution[4:8].reshape(2, 2).T
    middle = 0.5 * np.array([info.cols - 1, info.rows - 1])
    squeeze = np.cos(np.radians(file.geometry.tilt_deg))  # 1 where an axis tilts the arm: it stands upright
    inverse = np.linalg.inv(along)
    travel = inverse @ (middle - centre)
    by = np.zeros((2, len(solution)))
    by[:, :2] = -inverse
    by[:, 4:6], by[:, 6:8] = -inverse * travel[0], -inverse * travel[1]
    u = np.sqrt(np.diag(by @ covariance @ by.T))
    found: dict[str, Value] = {}
    for number, name in enumerate("xy"):
        column = along[:, number] / [1.0, squeeze]
        turned = np.degrees(np.arctan2(-column[1], column[0])) - 90.0 * number
        length = float(np.hypot(*column))
        start = 4 + 2 * number
        u_px = float(np.sqrt(np.mean(np.diag(covariance)[start : start + 2])))
        found |= {
            name: Value(
                value=file.linear[name].reading(float(travel[number])), u=float(u[number]), unit="mm"
            ),
            f"{name}_direction": Value(
                value=float((turned + 180.0) % 360.0 - 180.0), u=float(np.degrees(u_px / length)), unit="°"
            ),
            f"{name}_scale": Value(value=length * pixel_um / 1000.0, u=u_px * pixel_um / 1000.0),
        }
    return found


def _wrong_axes(values: Mapping[str, Value]) -> list[str]:
    found = []
    for name in "xy" if values else "":
        turned, scale = values[f"{name}_direction"].value, values[f"{name}_scale"].value
        if abs(turned) > MAX_DIRECTION_DEG:
            found.append(
                f"{name} moves the picture at {turned:+.1f}° from {'the right' if name == 'x' else 'up'} (limit "
                f"±{MAX_DIRECTION_DEG:g}°): set {name}.sign in the rig file the other way, exchange x and y, or turn "
                "the camera"
            )
        elif abs(scale - 1.0) > MAX_SCALE_SHARE:
            found.append(
                f"1 mm of {name} moves the picture by {scale:.4f} mm: correct camera.pixel_um, or counts_per_mm of "
                f"{name}"
            )
    return found


def _axis_tilt(places: list[Placement]) -> tuple[float, float]:
    """Angle between camera and fixture normal beyond the arm's tilt, from foreshortening."""
    squeeze = float(np.mean([place.squeeze for place in places]))
    u = float(np.mean([place.u_squeeze for place in places]) / np.sqrt(len(places)))
    off = abs(1.0 - squeeze)
    tilt = float(np.degrees(np.arccos(1.0 - min(off, 1.0))))
    limit = float(np.degrees(np.arccos(1.0 - min(off + u, 1.0))))
    return tilt, limit - tilt


def _faults(runout_px: float, turn_error_deg: float, pixel_um: float, file: RigFile) -> list[str]:
    found = []
    if runout_px > MAX_RUNOUT_PX:
        found.append(
            f"the fixture leaves its circle by {runout_px:.2f} px (limit {MAX_RUNOUT_PX:g} px): does it sit tight, "
            "does the stage wobble?"
        )
    if turn_error_deg > MAX_TURN_ERROR_DEG:
        found.append(
            f"stage and markers differ by up to {turn_error_deg:.2f}° (limit {MAX_TURN_ERROR_DEG:g}°): run "
            "`anisoscope rig commission`"
        )
    if abs(pixel_um / file.camera.pixel_um - 1.0) > MAX_SCALE_SHARE:
        found.append(
            f"a pixel is {pixel_um:.4f} µm, the rig file says {file.camera.pixel_um:g} µm: correct camera.pixel_um"
        )
    return found
