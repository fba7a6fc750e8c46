"""Start-of-shift self test of a rig.

Every check says what it found, the limit, and what to do. A rig that fails one is unfit: what it measures is INVALID,
so that the exit code is that of INVALID, and not that of a part that fails.
"""

import time
import uuid
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import (
    AnisoscopeError,
    CalibrationError,
    CameraError,
    MeasurementError,
    RigError,
)
from anisoscope.base.progress import Advance, silent
from anisoscope.calibration.warm_up import fit_warmup
from anisoscope.calibration.white_reference import read_reference
from anisoscope.commissioning.exposure import proof_on, sentence
from anisoscope.commissioning.fixture_check import FIXTURE, fixture_checks
from anisoscope.commissioning.markers import Fix, edge_blur_px, find_fixture, modules_of
from anisoscope.commissioning.record import Commissioning, default_record_path, read_commissioning
from anisoscope.commissioning.selftest_record import Check, SelfTest, Settings, limit_check, skipped_check
from anisoscope.commissioning.turning import fit_centre, wrapped
from anisoscope.imaging.linearisation import SATURATION_SHARE
from anisoscope.imaging.registration.placement import check_fixture
from anisoscope.record.schema import sha256_of
from anisoscope.rig.acquisition.runner import Rig, open_rig
from anisoscope.rig.camera import UNCALIBRATED, CameraSettings
from anisoscope.rig.frame import Frame, FrameKind
from anisoscope.rig.rigfile import AxisPart, RigFile, read_rig
from anisoscope.rig.stage import RotationStage, apart_deg

Image = npt.NDArray[np.float32]


@dataclass
class Bed:
    """State shared by the checks: later ones use the results of earlier ones.

    Attributes:
        rig, file: the opened rig and its file.
        settings: how, and the limits.
        commissioned: how the rig stood when it was commissioned, or None.
        advance: progress.
        dark: (rows, cols) mean of the dark frames, counts.
        lit: (rows, cols) mean of the last lit frames, less the dark.
        views: angle, markers and picture of every angle that was visited.
        frames: the dark frames, and those of the angles with what was commanded; raw.
    """

    rig: Rig
    file: RigFile
    settings: Settings
    commissioned: Commissioning | None
    advance: Advance
    dark: FloatArray | None = None
    lit: FloatArray | None = None
    views: list[tuple[float, Fix | None, Image]] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)

    def keep(
        self, kind: FrameKind, counts: npt.NDArray[np.uint16], used: CameraSettings, angle_deg: float
    ) -> None:
        """Keep a raw frame, of a sample angle in degrees."""
        info = self.rig.camera.info
        tilt_deg = 0.0 if self.rig.tilt is not None else self.file.geometry.tilt_deg
        self.frames.append(
            Frame(
                counts, kind, info.bit_depth, info.black_level, used.exposure_s, used.gain, angle_deg, angle_deg,
                tilt_deg, datetime.now(UTC).isoformat(timespec="milliseconds"), info.serial, info.filters,
            )
        )  # fmt: skip


Step = tuple[tuple[tuple[str, str], ...], Callable[[Bed], list[Check]]]


_BLOCKS = 8

MARKERS = (
    ("markers.residual", "misfit of the markers"),
    ("markers.angle", "fixture's angle off the stage's"),
    ("markers.centre", "rotation centre off the commissioned one"),
    ("markers.pixel", "pixel size off the rig file's"),
    ("markers.focus", "blur of marker edges over the commissioned"),
)


def check_markers(bed: Bed) -> list[Check]:
    """Markers: misfit, angle, rotation centre, pixel size, focus."""
    fixture, settings = bed.file.fixture, bed.settings
    why = "the white tile lies on the stage" if settings.tile else "the rig file describes no fixture"
    if settings.tile or fixture is None:
        return [skipped_check(*name, why) for name in MARKERS]
    check_fixture(fixture)
    located = [(angle, fix, picture) for angle, fix, picture in bed.views if fix is not None]
    if len(located) < len(bed.views):
        raise MeasurementError(
            f"the markers are seen in {len(located)} of {len(bed.views)} pictures: check that the light is on, the "
            "lens "
            "clear and in focus, and the fixture that of the rig file"
        )
    fixes = [fix for _, fix, _ in located]
    pixel = float(np.mean([fix.pixel_um for fix in fixes]))
    blur = float(
        np.median([edge_blur_px(image, fix, modules_of(fixture.dictionary)) for _, fix, image in located])
    )
    return [
        limit_check(
            *MARKERS[0], max(fix.residual_px for fix in fixes), settings.residual_px, "px",
            "check focus, and that the markers stand where the rig file says",
        ),
        _angle(located, bed),
        _centre(fixes, bed),
        limit_check(
            *MARKERS[3], abs(pixel / bed.file.camera.pixel_um - 1.0), settings.scale_share, "relative",
            "the magnification changed: check lens and working distance, or commission the rig",
            remark=f"{pixel:.4g} µm",
        ),
        _focus(blur, bed),
    ]  # fmt: skip


def _angle(located: list[tuple[float, Fix, npt.NDArray[np.float32]]], bed: Bed) -> Check:
    off = wrapped(np.array([fix.angle_deg - angle for angle, fix, _ in located]))
    other = wrapped(np.array([fix.angle_deg + angle for angle, fix, _ in located]))
    advice = "seat the fixture again, or correct stage.zero_deg: `anisoscope rig commission`"
    if np.max(np.abs(other - other[0])) < 1.0 < np.max(np.abs(off - off[0])):
        advice = "the stage turns the other way than stage.turns says: `anisoscope rig commission`"
    return limit_check(*MARKERS[1], float(np.max(np.abs(off))), bed.settings.angle_deg, "°", advice)


def _centre(fixes: list[Fix], bed: Bed) -> Check:
    if bed.commissioned is None:
        return skipped_check(*MARKERS[2], "the rig was not commissioned")
    column, row = (bed.commissioned.number(f"camera.axis_{name}_px") for name in ("column", "row"))
    if column is None or row is None:
        return skipped_check(*MARKERS[2], "the commissioning did not find it")
    centre = fit_centre(fixes)
    off = float(np.hypot(centre.column_px - column, centre.row_px - row))
    advice = "camera or stage was moved: put it back, or commission the rig again"
    return limit_check(*MARKERS[2], off, bed.settings.centre_px, "px", advice)


def _focus(blur_px: float, bed: Bed) -> Check:
    before = None if bed.commissioned is None else bed.commissioned.blur_px
    if before is None:
        return skipped_check(*MARKERS[4], f"the rig was not commissioned; {blur_px:.2f} px rms")
    advice = "focus the lens, or clean it"
    return limit_check(
        *MARKERS[4], blur_px / before, bed.settings.blur_ratio, "1", advice, remark=f"{blur_px:.2f} px rms"
    )


WHITE = (
    ("white.age", "age of the white reference"),
    ("white.shading", "shading off the white reference's"),
    ("white.level", "light off the white reference's"),
)


def check_white(bed: Bed) -> list[Check]:
    """Check the white reference: same camera, not too old, and with the tile on the stage still valid."""
    calibration, settings = bed.file.calibration, bed.settings
    if calibration is None:
        return [skipped_check(*name, "the rig file names no white reference") for name in WHITE]
    white, serial = read_reference(calibration.flat), bed.rig.camera.info.serial
    advice = "take a new one with `anisoscope calibrate flat`"
    if white.camera != serial:
        raise MeasurementError(
            f"the white reference was taken with camera {white.camera}, this is {serial}: {advice}"
        )
    age = (datetime.now(UTC) - datetime.fromisoformat(white.taken_at)).total_seconds() / 86400.0
    found = [limit_check(*WHITE[0], age, settings.white_days, "days", advice)]
    if not settings.tile or bed.lit is None:
        return found + [
            skipped_check(*name, "the white tile does not lie on the stage (--tile)") for name in WHITE[1:]
        ]
    if white.signal.shape != bed.lit.shape:
        raise MeasurementError(f"the white reference and the camera differ in size: {advice}")
    ratio = bed.lit / (white.signal.astype(np.float64) * settings.exposure_s * settings.gain)
    level = float(np.median(ratio))
    blocks = [np.array_split(row, _BLOCKS, axis=1) for row in np.array_split(ratio, _BLOCKS)]
    shading = np.array([[float(np.median(block)) for block in row] for row in blocks]) / level
    return [
        *found,
        limit_check(
            *WHITE[1], float(np.max(np.abs(shading - 1.0))), settings.shading_share, "relative", advice
        ),
        limit_check(
            *WHITE[2], abs(level - 1.0), settings.level_share, "relative", f"clean lens and tile; {advice}"
        ),
    ]


def check_greys(bed: Bed) -> list[Check]:
    """Compare white, black, greys and edges of the fixture with its reference."""
    devices = f"{bed.rig.camera.info.model} {bed.rig.camera.info.serial}", bed.rig.stage.name
    return fixture_checks(bed.file, bed.rig.camera.info, devices, bed.frames, bed.settings)


CAMERA = (
    ("camera.exposure", "brightness follows the exposure (power)"),
    ("camera.linear", "counts in proportion to light"),
)
ANGLES = (0.0, 90.0, 180.0, 270.0)
TILTS = (-10.0, 0.0, 10.0)


def _readback_limit(settings: Settings, axis: RotationStage) -> float:
    return max(settings.readback_deg, 2.0 * axis.resolution_deg)


def _go(part: AxisPart, axis: RotationStage, angle_deg: float) -> float:
    """Move from below, as an inspection does; return the error of the reading."""
    below, target = part.way(angle_deg, axis.limits_deg)
    if axis.position_deg() > below:
        axis.move_to(below)
    axis.move_to(target)
    return apart_deg(axis.position_deg(), target)


def _reachable(part: AxisPart, axis: RotationStage, angles_deg: tuple[float, ...]) -> list[float]:
    low, high = axis.limits_deg
    ways = {angle: part.way(angle, axis.limits_deg) for angle in angles_deg}
    return [angle for angle, (below, target) in ways.items() if low <= below and target <= high]


def check_home(bed: Bed) -> list[Check]:
    """Check that every axis finds its reference and reads back its position."""
    worst, limit = 0.0, 0.0
    for axis in bed.rig.axes:
        reached = axis.home()
        if not axis.is_homed:
            raise RigError(
                f"{axis.name} does not say that it is homed: home it again, look at its reference switch"
            )
        worst = max(worst, abs(axis.position_deg() - reached))
        limit = max(limit, _readback_limit(bed.settings, axis))
    advice = "the axis does not stand still after homing: check its load and its controller"
    return [limit_check("axes.home", "axes home", worst, limit, "°", advice)]


def _grab(bed: Bed, count: int) -> list[npt.NDArray[np.uint16]]:
    return [bed.rig.camera.grab().copy() for _ in range(count)]


def check_dark(bed: Bed) -> list[Check]:
    """Dark level against the black level that the camera states, and noise of dark frames."""
    used = bed.rig.camera.configure(bed.settings.exposure_s, bed.settings.gain)
    bed.rig.light.off()
    info, settings = bed.rig.camera.info, bed.settings
    grabbed = _grab(bed, settings.dark_frames)
    for one in grabbed:
        bed.keep("dark", one, used, 0.0)
    frames = np.stack(grabbed).astype(np.float64)
    full = 2.0**info.bit_depth - 1.0
    bed.dark = frames.mean(axis=0)
    spread = frames.std(axis=0, ddof=1)
    noise = float(np.sqrt(np.mean(spread**2)))
    off = abs(float(np.median(bed.dark)) - info.black_level)
    limit = settings.noise_share * full
    if bed.commissioned is not None:
        limit = min(limit, max(settings.noise_ratio * bed.commissioned.dark_noise, 1.0))
    return [
        limit_check(
            "camera.dark_level", "dark level off the camera's black level", off,
            max(settings.black_share * full, 2.0), "counts",
            "keep room light out, set the camera's black level back, let the camera warm up",
        ),
        limit_check(
            "camera.dark_noise", "noise of a dark frame", noise, limit, "counts",
            "the camera is noisier than it was: check gain, temperature, cable and supply",
        ),
    ]  # fmt: skip


def check_light(bed: Bed) -> list[Check]:
    """Check that the light switches on and off, nothing is saturated, and the lamp is stable."""
    settings, info = bed.settings, bed.rig.camera.info
    assert bed.dark is not None
    full = 2.0**info.bit_depth - 1.0
    bed.rig.light.on()
    frames, times_s = [], []
    for _ in range(settings.frames):
        frames += _grab(bed, 1)
        times_s.append(time.monotonic())
    means = np.array([float(frame.mean()) for frame in frames]) - bed.dark.mean()
    bed.lit = np.mean(np.stack(frames[-4:]).astype(np.float64), axis=0) - bed.dark
    saturated = float(np.mean(np.max(np.stack(frames[-4:]), axis=0) >= SATURATION_SHARE * full))
    bed.rig.light.off()
    after = _grab(bed, 1)[0].astype(np.float64).mean() - bed.dark.mean()
    bed.rig.light.on()
    signal = float(np.percentile(bed.lit, 99)) / full
    left = abs(after) / max(float(means.mean()), 1e-9)
    return [
        limit_check(
            "light.on", "signal that the light makes", signal, settings.signal_share, "full scale",
            "switch the light on, take the lens cap off, or lengthen --exposure", at_least=True,
        ),
        limit_check(
            "light.off", "light that is left when it is off", left if signal >= settings.signal_share else np.inf, 0.01,
            "of the light", "the light does not go off: check its driver and its cable",
        ),
        limit_check(
            "camera.saturated", "saturated pixels", saturated, settings.saturated_share, "share", "shorten --exposure"
        ),
        *lamp_checks(times_s, means, settings),
    ]  # fmt: skip


def lamp_checks(times_s: list[float], means: FloatArray, settings: Settings) -> list[Check]:
    """Drift and flicker of the lamp from (n,) mean counts at (n,) times in seconds."""
    names = ("lamp.drift", "drift of the light over the frames"), ("lamp.flicker", "flicker of the light")
    if means.mean() <= 0.0:
        return [skipped_check(*name, "there is no light") for name in names]
    found = fit_warmup(times_s, means)
    limit = settings.drift_share + 2.0 * found.change_uncertainty
    change = f"{found.change_share:+.3%} ± {found.change_uncertainty:.3%} over {found.frames} frames"
    remark = f"{change}; the limit is {settings.drift_share:.3%} and twice that uncertainty"
    # a few seconds say nothing about a minute unless they show the lamp warming up
    if abs(found.change_share) > limit and found.verdict == "cold":
        remark += f"; {found.sentence()}"
    return [
        limit_check(
            *names[0], abs(found.change_share), limit, "relative",
            "let the lamp warm up, and test again", remark=remark,
        ),
        limit_check(
            *names[1], found.noise_share, settings.flicker_share, "relative",
            "check the lamp's supply, keep room light out, or make the exposure a multiple of the mains period",
        ),
    ]  # fmt: skip


def check_camera(bed: Bed) -> list[Check]:
    """Check that automatic exposure is off, and whether the counts are linear or calibrated."""
    (exposure, linear), info = CAMERA, bed.rig.camera.info
    settings = bed.settings
    assert bed.dark is not None
    try:
        proof = proof_on(bed.rig, settings.exposure_s, settings.gain, float(bed.dark.mean()))
    except CameraError as error:  # the camera works, and does something else than it was told
        first = Check(key=exposure[0], words=exposure[1], outcome="FAIL", remark=str(error))
    else:
        if proof is None:
            first = skipped_check(*exposure, "the camera has no automatic exposure")
        else:
            first = Check(
                key=exposure[0],
                words=exposure[1],
                outcome="PASS",
                value=proof.exponents[0],
                remark=sentence(proof),
            )
    bed.rig.camera.configure(settings.exposure_s, settings.gain)
    second = Check(key=linear[0], words=linear[1], outcome="PASS")
    if bed.file.uncalibrated(info):
        second = Check(key=linear[0], words=linear[1], outcome="WARN", remark=UNCALIBRATED)
    elif not info.linear:
        second = Check(key=linear[0], words=linear[1], outcome="PASS", remark="by the linearity calibration")
    return [first, second]


def check_moves(bed: Bed) -> list[Check]:
    """Check that the stage reaches its targets, with pictures on the way and two returns to the first angle."""
    part, stage = bed.file.stage, bed.rig.stage
    names = ("stage.moves", "reading off the command"), ("stage.repeat", "same angle, approached again")
    angles = _reachable(part, stage, ANGLES)
    if len(angles) < 2:
        raise MeasurementError(
            f"of {', '.join(f'{a:g}°' for a in ANGLES)} the stage reaches fewer than two: choose stage.zero_deg in the "
            "rig file so that it does"
        )
    bed.rig.light.on()
    used = bed.rig.camera.configure(bed.settings.exposure_s, bed.settings.gain)
    off: list[float] = []
    fixes: list[tuple[float, Fix | None]] = []
    for angle in [*angles, angles[0], angles[0]]:
        if fixes and angle == angles[0]:
            stage.move_to(max(part.way(angle, stage.limits_deg)[0] - 5.0, stage.limits_deg[0]))
        off.append(_go(part, stage, angle))
        (counts,) = _grab(bed, 1)
        bed.keep("sample", counts, used, angle)
        picture = np.asarray(counts - (0.0 if bed.dark is None else bed.dark), dtype=np.float32)
        fix = (
            None if bed.settings.tile or bed.file.fixture is None else find_fixture(picture, bed.file.fixture)
        )
        fixes.append((angle, fix))
        bed.views.append((angle, fix, picture))
    limit = _readback_limit(bed.settings, stage)
    moved = limit_check(
        *names[0],
        float(np.max(np.abs(off))),
        limit,
        "°",
        "the stage does not arrive: check its load, home it again",
    )
    same = [fix.angle_deg for angle, fix in fixes if angle == angles[0] and fix is not None]
    if len(same) == 3:
        spread = float(np.max(np.abs(wrapped(np.array(same) - same[0]))))
        remark = "by the markers"
    else:
        spread = float(
            np.ptp([value for (angle, _), value in zip(fixes, off, strict=True) if angle == angles[0]])
        )
        remark = "by the readings: no markers are seen"
    advice = "something slips or has play: check that fixture and stage sit tight, and stage.approach_deg"
    again = limit_check(
        *names[1], spread, max(bed.settings.repeat_deg, stage.resolution_deg), "°", advice, remark=remark
    )
    return [moved, again]


def check_tilt(bed: Bed) -> list[Check]:
    """Check that the tilt axis reaches its targets and returns to 0°."""
    name = ("tilt.moves", "tilt axis: reading off the command")
    part, axis = bed.file.tilt, bed.rig.tilt
    if part is None or axis is None:
        return [skipped_check(*name, "no axis tilts the arm")]
    angles = _reachable(part, axis, TILTS)
    off = [_go(part, axis, angle) for angle in [*angles, *([0.0] if 0.0 in angles else [])]]
    if not off:
        raise MeasurementError(
            "the tilt axis reaches none of ±10° and 0°: correct tilt.zero_deg in the rig file"
        )
    advice = "the tilt axis does not arrive: check its load, home it again"
    return [limit_check(*name, float(np.max(np.abs(off))), _readback_limit(bed.settings, axis), "°", advice)]


STEPS: tuple[Step, ...] = (
    ((("axes.home", "axes home"),), check_home),
    (
        (
            ("camera.dark_level", "dark level off the camera's black level"),
            ("camera.dark_noise", "noise of a dark frame"),
        ),
        check_dark,
    ),
    (
        (
            ("light.on", "signal that the light makes"),
            ("light.off", "light that is left when it is off"),
            ("camera.saturated", "saturated pixels"),
            ("lamp.drift", "drift of the light over the frames"),
            ("lamp.flicker", "flicker of the light"),
        ),
        check_light,
    ),
    (CAMERA, check_camera),
    ((("tilt.moves", "tilt axis: reading off the command"),), check_tilt),
    (
        (("stage.moves", "reading off the command"), ("stage.repeat", "same angle, approached again")),
        check_moves,
    ),
    (MARKERS, check_markers),
    (WHITE, check_white),
    (FIXTURE, check_greys),
)


def self_test(
    rig_path: Path,
    settings: Settings,
    commissioned: Path | None = None,
    *,
    on_progress: Advance = silent,
) -> SelfTest:
    """Test a rig. The axes home and move.

    A device in trouble fails its check, and what builds on it is skipped; only a wrong file or option raises.

    Args:
        rig_path: rig file.
        settings: how, and the limits.
        commissioned: record of the commissioning; by default the one beside the rig file, if there is one.
        on_progress: progress.

    Raises:
        RigFileError, UsageError: the rig file, an exposure that makes no sense.
        CalibrationError: the record was named and cannot be read.
    """
    file = read_rig(rig_path, channel=settings.light_channel)
    known, problem = _commissioned(rig_path, commissioned)
    checks: list[Check] = []
    devices: dict[str, str] = {}
    if problem:
        checks.append(
            Check(key="commissioning", words="record of the commissioning", outcome="FAIL", remark=problem)
        )
    try:
        with open_rig(file) as rig:
            devices = _names(rig)
            checks.append(_opened(devices))
            bed = Bed(rig, file, settings, known, on_progress)
            _carry_out(STEPS, bed, checks)
            rig.light.off()
    except RigError as error:
        if not devices:
            remark = f"{error}; check cables, power and ports of the rig file"
            checks.append(Check(key="devices", words="devices answer", outcome="FAIL", remark=remark))
            checks += [
                skipped_check(*one, "the rig could not be opened") for names, _ in STEPS for one in names
            ]
        else:
            checks.append(
                Check(key="light.last", words="light goes off at the end", outcome="FAIL", remark=str(error))
            )
    return SelfTest(
        id=uuid.uuid4().hex,
        created_at=datetime.now(UTC).isoformat(timespec="seconds"),
        software=f"anisoscope {version('anisoscope')}",
        rig=file.name,
        rig_file_sha256=sha256_of(rig_path),
        commissioning=None if known is None else known.id,
        devices=devices,
        settings=asdict(settings),
        checks=tuple(checks),
        fit=all(check.outcome != "FAIL" for check in checks),
    )  # fmt: skip


def _commissioned(rig_path: Path, named: Path | None) -> tuple[Commissioning | None, str]:
    """Commissioning record and its problem, if any; a record that was named must be valid."""
    if named is not None:
        return read_commissioning(named), ""
    default = default_record_path(rig_path)
    if not default.exists():
        return None, ""
    try:
        return read_commissioning(default), ""
    except CalibrationError as error:
        return None, str(error)


def _names(rig: Rig) -> dict[str, str]:
    info = rig.camera.info
    found = {"stage": rig.stage.name, "camera": f"{info.model} {info.serial}", "light": rig.file.light.driver}
    return found if rig.tilt is None else found | {"tilt": rig.tilt.name}


def _opened(devices: dict[str, str]) -> Check:
    return Check(
        key="devices",
        words="devices answer",
        outcome="PASS",
        value=float(len(devices)),
        remark=", ".join(devices.values()),
    )


def _carry_out(steps: tuple[Step, ...], bed: Bed, checks: list[Check]) -> None:
    """Run the steps in order; a device in trouble fails the first check of its step and skips the rest."""
    broken = ""
    for number, (names, step) in enumerate(steps):
        bed.advance(names[0][1], number, len(steps))
        if broken:
            checks += [skipped_check(*one, broken) for one in names]
            continue
        try:
            checks += step(bed)
        except AnisoscopeError as error:
            (key, words), *others = names
            checks.append(Check(key=key, words=words, outcome="FAIL", remark=str(error)))
            checks += [skipped_check(*one, f"'{words}' failed") for one in others]
            if isinstance(error, RigError):
                broken = f"'{words}' failed: a device is in trouble"
