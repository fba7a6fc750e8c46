"""Autofocus: the place of sharpest focus, from a curve through the sharpness at a sweep of readings.

A coarse sweep brackets the sharpest place, finer ones are repeated around it, every one upwards, so that play of the
axis does not enter. Readings are millimetres of the axis.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.calibration.corrections import Calibrations, read_calibrations
from anisoscope.calibration.frames import Bed
from anisoscope.calibration.record import (
    CalibrationRecord,
    Value,
    dated,
    record_path,
    write_calibration,
)
from anisoscope.live_view.view import focus_of, signal_of
from anisoscope.parameters.taking import FocusMeasure, Sweep, Taking
from anisoscope.rig.acquisition.opening import open_rig
from anisoscope.rig.acquisition.plan import Plan, Pose
from anisoscope.rig.acquisition.runner import check_plan, ways_to
from anisoscope.rig.bayer import grey_of
from anisoscope.rig.camera import Camera
from anisoscope.rig.rigfile import RigFile, read_rig
from anisoscope.rig.stage import RotationStage

LEAST_RISE = 0.15  # of the sharpest place over the least sharp one, as a share
LEAST_STEPS = 7
STEPS_IN_PEAK = 2.0  # half-width of the peak at least, in steps, before a curve is fitted
MOST_REFINEMENTS = 6
FINE_WIDTHS = 2.0
LEAST_KEPT = 0.8  # sharpness at the end, as a share of what the curve has there


@dataclass(frozen=True)
class Peak:
    """A curve b + a / (1 + ((z − place) / width)²)^power through a sweep; place and width in mm.

    Attributes:
        place: reading of the sharpest picture.
        width: scale of its width.
        height: sharpness there, a + b.
        floor: sharpness far away, b.
        power: how steeply it falls.
        u: standard uncertainty of the place from the scatter about the curve.
    """

    place: float
    width: float
    height: float
    floor: float
    power: float
    u: float

    @property
    def half_width(self) -> float:
        """Distance from the place, in mm, at which the sharpness has fallen half-way to the floor."""
        return self.width * math.sqrt(2.0 ** (1.0 / self.power) - 1.0)


@dataclass(frozen=True)
class Focus:
    """Result of a search for the focus; lengths in mm of the reading.

    Attributes:
        best: mean place of the sharpest picture over the fine sweeps.
        repeatability: standard deviation of the place of one sweep; NaN of a single one.
        half_width: of the peak, see `Peak`.
        places: place of every fine sweep.
        readings: readings of the last one.
        sharpness: sharpness at these, relative to the height of the curve.
        reached: where the axis stands now.
        kept: sharpness there, as a share of the curve.
    """

    best: float
    repeatability: float
    half_width: float
    places: tuple[float, ...]
    readings: tuple[float, ...]
    sharpness: tuple[float, ...]
    reached: float
    kept: float


def fit_peak(readings: FloatArray, sharpness: FloatArray) -> Peak:
    """The curve of `Peak` through a sweep, by least squares.

    Args:
        readings: (n,) in mm, rising, at least five.
        sharpness: (n,) of any unit, all positive.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415 - a third of the start of every command at the rig

    top = float(sharpness.max())
    scaled, span = sharpness / top, float(readings[-1] - readings[0])
    middle = float(readings[int(np.argmax(sharpness))])
    upper = scaled > 0.5 * (1.0 + float(scaled.min()))
    width = max(0.5 * float(np.ptp(readings[upper])), span / len(readings))

    def off(p: FloatArray) -> FloatArray:
        return np.asarray(p[3] + p[2] / (1.0 + ((readings - p[0]) / p[1]) ** 2) ** p[4] - scaled)

    found = least_squares(
        off,
        [middle, width, 1.0 - float(scaled.min()), float(scaled.min()), 1.0],
        bounds=(
            [readings[0] - span, 1e-3 * width, 0.0, 0.0, 0.3],
            [readings[-1] + span, 10.0 * span, 3.0, 1.0, 6.0],
        ),
        x_scale=[width, width, 1.0, 1.0, 1.0],
    )
    place, width, rise, floor, power = (float(one) for one in found.x)
    free = max(len(readings) - len(found.x), 1)
    jacobian = np.asarray(found.jac, dtype=float)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * (2.0 * found.cost / free)
    u = math.sqrt(max(float(covariance[0, 0]), 0.0))
    return Peak(place, width, top * (rise + floor), top * floor, power, u)


class Autofocus:
    """Searches the focus with an axis and a camera that are open, the axis homed and the light on.

    Args:
        axis: the linear axis that changes the focus.
        camera: the camera, configured.
        approach_mm: every sweep begins so far below its first reading, because of play.
        measure: measure of sharpness.
        average: frames that are averaged at each reading.
        on_progress: called before each reading; what it raises ends the search.
    """

    def __init__(
        self,
        axis: RotationStage,
        camera: Camera,
        approach_mm: float = 0.1,
        measure: FocusMeasure = "tenengrad",
        average: int = 1,
        on_progress: Advance = silent,
    ) -> None:
        self._axis, self._camera, self._approach_mm, self._on_progress = (
            axis,
            camera,
            approach_mm,
            on_progress,
        )
        self._measure, self._average = measure, average

    def search(self, low: float, high: float, steps: int = 15, repeats: int = 3) -> Focus:
        """Find the sharpest place between two readings, and go there.

        Args:
            low: reading in mm at which the coarse sweep begins; clipped to the limits of the axis.
            high: reading at which it ends.
            steps: readings of a sweep.
            repeats: fine sweeps.

        Raises:
            MeasurementError: the picture is too dark, nothing gets sharper, the sharpest place is at an end of the
                range, or the picture at the end is not as sharp as the sweep had it.
            RigError: what goes wrong with a device.
        """
        bottom, top = self._axis.limits_deg
        low, high = max(low, bottom), min(high, top)
        if steps < LEAST_STEPS or not high - low > 2.0 * steps * self._axis.resolution_deg:
            raise MeasurementError(
                f"a sweep of {steps} steps from {low:.4g} mm to {high:.4g} mm is too short; give a longer range within "
                f"{bottom:.4g} mm…{top:.4g} mm and at least {LEAST_STEPS} steps"
            )
        rough = self._bracket(low, high, steps)
        reach = FINE_WIDTHS * rough.half_width
        peaks = [
            self._fine(max(rough.place - reach, bottom), min(rough.place + reach, top), steps)
            for _ in range(repeats)
        ]
        places = [peak.place for peak, _, _ in peaks]
        last, readings, sharpness = peaks[-1]
        best = float(np.mean(places))
        reached = self._go(best)
        kept = self._sharpness() / last.height
        if kept < LEAST_KEPT:
            raise MeasurementError(
                f"the picture at {best:.4f} mm is {kept:.0%} as sharp as the sweep had it there: the axis has play or "
                "something moved; raise z.approach_mm in the rig file, and focus again"
            )
        return Focus(
            best=best,
            repeatability=float(np.std(places, ddof=1)) if repeats > 1 else math.nan,
            half_width=float(np.mean([peak.half_width for peak, _, _ in peaks])),
            places=tuple(places),
            readings=tuple(float(one) for one in readings),
            sharpness=tuple(float(one) for one in sharpness / last.height),
            reached=reached,
            kept=kept,
        )

    def _bracket(self, low: float, high: float, steps: int) -> Peak:
        """Sweeps that become finer until the curve through the last one is wider than its steps."""
        for _ in range(MOST_REFINEMENTS):
            readings, sharpness = self._sweep(low, high, steps)
            self._check(readings, sharpness)
            sharpest, step = float(readings[int(np.argmax(sharpness))]), (high - low) / (steps - 1)
            peak = fit_peak(readings, sharpness)
            if abs(peak.place - sharpest) <= step and peak.half_width >= STEPS_IN_PEAK * step:
                return peak
            low, high = max(low, sharpest - 2.0 * step), min(high, sharpest + 2.0 * step)
        raise MeasurementError(
            f"no curve fits the sharpness between {low:.4g} mm and {high:.4g} mm; average more frames, or look at the "
            "picture with anisoscope rig live"
        )

    def _check(self, readings: FloatArray, sharpness: FloatArray) -> None:
        if not np.isfinite(sharpness).all():
            raise MeasurementError(
                "the picture is too dark to focus; expose for longer, or switch the light on"
            )
        least, most, at = float(sharpness.min()), float(sharpness.max()), int(np.argmax(sharpness))
        where = f"{readings[0]:.4g} mm and {readings[-1]:.4g} mm"
        if most - least < LEAST_RISE * most:
            raise MeasurementError(
                f"nothing gets sharper between {where}; give a longer range, or something with detail to look at"
            )
        if at in {0, len(readings) - 1}:
            raise MeasurementError(
                f"between {where} the picture is sharpest at the end, {readings[at]:.4g} mm; give a range beyond it, "
                "if nothing can collide there"
            )

    def _fine(self, low: float, high: float, steps: int) -> tuple[Peak, FloatArray, FloatArray]:
        readings, sharpness = self._sweep(low, high, steps)
        self._check(readings, sharpness)
        return fit_peak(readings, sharpness), readings, sharpness

    def _sweep(self, low: float, high: float, steps: int) -> tuple[FloatArray, FloatArray]:
        """(n,) readings, upwards, and the sharpness at each."""
        targets = np.linspace(low, high, steps)
        self._below(low)
        found = []
        for done, target in enumerate(targets):
            self._on_progress("focus", done, steps)
            reading = self._axis.move_to(float(target))
            found.append((reading, self._sharpness()))
        readings, sharpness = np.array(found).T
        return readings, sharpness

    def _go(self, reading: float) -> float:
        self._on_progress("focus", 1, 1)
        self._below(reading)
        return self._axis.move_to(reading)

    def _below(self, reading: float) -> None:
        below = max(reading - self._approach_mm, self._axis.limits_deg[0])
        if self._axis.position_deg() > below:
            self._axis.move_to(below)

    def _sharpness(self) -> float:
        info = self._camera.info
        values = []
        for _ in range(self._average):
            counts = self._camera.grab()
            grey = counts if info.filters == "mono" else grey_of(counts, info.filters)
            values.append(focus_of(signal_of(grey, info), self._measure))
        return float(np.mean(values))


LEAST_SEATS, SEATS_OF_BOW = 3, 6


@dataclass(frozen=True)
class Plane:
    """Focus over a plate: reading = z + slope·(x, y) + bow·(x² + y²), lengths in mm.

    Attributes:
        z: at the axis of the stage.
        slope: by which the reading grows to the right and up.
        bow: per mm; 0 where the seats are too few to tell.
        u: standard uncertainties of z, both slopes and bow.
        residuals: reading minus surface, of every seat.
    """

    z: float
    slope: tuple[float, float]
    bow: float
    u: tuple[float, float, float, float]
    residuals: tuple[float, ...]


def fit_plane(places_mm: FloatArray, readings: FloatArray, repeatability: float) -> Plane:
    """The surface of `Plane` through the focus at some seats, by least squares; with its bow from six seats on.

    Args:
        places_mm: (n, 2) seats.
        readings: (n,) in mm.
        repeatability: standard uncertainty of a reading that is assumed at least.

    Raises:
        UsageError: fewer than three seats, or seats on one line.
    """
    columns = [np.ones(len(places_mm)), *places_mm.T]
    flat = np.column_stack(columns)
    if len(places_mm) < LEAST_SEATS or np.linalg.matrix_rank(
        flat, tol=1e-6 * float(np.abs(flat).max())
    ) < len(columns):
        raise UsageError(f"a focus map needs {LEAST_SEATS} seats or more that do not lie on one line")
    squares = np.sum(places_mm**2, axis=1)
    curved = np.column_stack([flat, squares])
    bowed = len(places_mm) >= SEATS_OF_BOW and np.linalg.matrix_rank(curved / np.abs(curved).max(axis=0)) == 4
    design = curved if bowed else flat
    solution = np.linalg.lstsq(design, readings, rcond=None)[0]
    rest = readings - design @ solution
    free = len(readings) - len(solution)
    scatter = max(math.sqrt(float(rest @ rest) / free) if free else 0.0, repeatability)
    u = scatter * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    z, right, up, bow = (float(one) for one in (*solution, *([] if bowed else [0.0])))
    shares = [float(one) for one in (*u, *([] if bowed else [0.0]))]
    return Plane(
        z, (right, up), bow, (shares[0], shares[1], shares[2], shares[3]), tuple(float(one) for one in rest)
    )


def map_focus(
    rig_path: Path,
    places_mm: Sequence[tuple[float, float]],
    out: Path,
    taking: Taking,
    sweep: Sweep,
    on_progress: Advance = silent,
) -> CalibrationRecord:
    """Search the focus at the seats of a tray, fit a plane or a bowed surface, and write it as a calibration.

    The stage stands at sample angle 0: a plate that is uneven turns with it, and so do its seats.

    Args:
        rig_path: rig file with x, y and z.
        places_mm: (x, y) of the seats from the axis of the stage.
        out: record to write (JSON).
        taking: exposure and gain.
        sweep: the search at every seat.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        UsageError: too few seats, or all on one line.
        RigFileError, RigError, CalibrationError: the rig.
        MeasurementError: no focus at a seat, which is named.
        RecordError: the record cannot be written.
    """
    places = np.array(places_mm, dtype=float).reshape(-1, 2)
    fit_plane(places, np.zeros(len(places)), 0.0)
    file = read_rig(rig_path, channel=taking.light_channel)
    part = file.z
    if part is None:
        raise UsageError("nothing moves the focus there: the rig file has no table [z]")
    known = Calibrations() if file.calibration is None else read_calibrations(file.calibration, "focus")
    pose = Pose(0.0, 0.0 if file.tilt is not None else file.geometry.tilt_deg)
    found: list[Focus] = []
    with open_rig(file) as rig:
        bed = Bed(rig, pose.tilt_deg, on_progress)
        plans = [Plan((pose,), taking.exposure_s, taking.gain, seat=known.seat((x, y))) for x, y in places_mm]
        for plan in plans:
            check_plan(plan, rig)
        axes = rig.by_table
        for axis in rig.unhomed():
            on_progress(f"homing {axis.name}", 0, len(plans))
            axis.home()
        rig.camera.configure(taking.exposure_s, taking.gain)
        rig.light.on()
        search = Autofocus(axes["z"], rig.camera, part.approach_mm, sweep.measure, sweep.average)
        for number, plan in enumerate(plans):
            on_progress("focus", number, len(plans))
            ways = ways_to(pose, plan.seat, rig)
            del ways["z"]
            for table in rig.guard.order({table: way[1:] for table, way in ways.items()}):
                axes[table].move_to(ways[table][-1])
            try:
                found.append(search.search(sweep.low, sweep.high, sweep.steps, sweep.repeats))
            except MeasurementError as problem:
                x, y = plan.seat.place_mm
                raise MeasurementError(f"at the seat {x:g} mm, {y:g} mm: {problem}") from None
        content = bed.content(taking, len(plans) * (2 + sweep.repeats) * sweep.steps * sweep.average)
    record = dated("focus", content | _map_values(places, found, file), valid_days=taking.valid_days)
    write_calibration(record, record_path(out))
    return record


def depth_of_field_mm(file: RigFile) -> float | None:
    """Depth of field λ/NA² in mm by the wavelength and the aperture in a rig file; None where it has not both."""
    if file.light.wavelength_nm is None or not file.camera.half_angle_deg:
        return None
    return 1e-6 * file.light.wavelength_nm / math.sin(math.radians(file.camera.half_angle_deg)) ** 2


def _map_values(places: FloatArray, found: Sequence[Focus], file: RigFile) -> dict[str, Any]:
    readings = np.array([one.best for one in found])
    spread = [one.repeatability for one in found if not math.isnan(one.repeatability)]
    repeatability = math.sqrt(float(np.mean(np.square(spread)))) if spread else 0.0
    plane = fit_plane(places, readings, repeatability / math.sqrt(len(found[0].places)))
    middle = places.mean(axis=0)
    rms = math.sqrt(float(np.mean(np.square(plane.residuals))))
    depth, worst = depth_of_field_mm(file), int(np.argmax(np.abs(plane.residuals)))
    off = abs(plane.residuals[worst])
    remarks = []
    if depth is not None and off > 0.5 * depth:
        x, y = places[worst]
        remarks.append(
            f"the focus at the seat {x:g} mm, {y:g} mm lies {1000.0 * off:.3g} µm off the surface, more than half of "
            f"the depth of field ({500.0 * depth:.3g} µm): seat the part again, or map more seats"
        )
    untested = len(found) == LEAST_SEATS
    note = ["three seats fix the plane, so that nothing tests it: map four or more"] if untested else []
    return {
        "values": {
            "z": Value(value=plane.z, u=plane.u[0], unit="mm"),
            "slope_x": Value(value=plane.slope[0], u=plane.u[1]),
            "slope_y": Value(value=plane.slope[1], u=plane.u[2]),
            "bow": Value(value=plane.bow, u=plane.u[3], unit="1/mm"),
            "residual": Value(value=rms, unit="mm"),
            "repeatability": Value(value=repeatability, unit="mm"),
            "middle_x": Value(value=float(middle[0]), unit="mm"),
            "middle_y": Value(value=float(middle[1]), unit="mm"),
            "reach": Value(value=float(np.hypot(*(places - middle).T).max()), unit="mm"),
        },
        "residuals": plane.residuals,
        "details": {"seats_mm": places.tolist(), "readings_mm": readings.tolist()},
        "in_limits": not remarks,
        "remarks": (*remarks, *note),
    }
