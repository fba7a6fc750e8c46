"""Autofocus: the place of sharpest focus, from a curve through the sharpness at a sweep of readings.

A coarse sweep brackets the sharpest place, finer ones are repeated around it, every one upwards, so that play of the
axis does not enter. Readings are millimetres of the axis.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError
from anisoscope.live_view.view import FocusMeasure, focus_of, signal_of
from anisoscope.rig.bayer import grey_of
from anisoscope.rig.camera import Camera
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
    """What a search for the focus found; lengths in mm of the reading.

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
    """

    def __init__(
        self,
        axis: RotationStage,
        camera: Camera,
        approach_mm: float = 0.1,
        measure: FocusMeasure = "tenengrad",
        average: int = 1,
    ) -> None:
        self._axis, self._camera, self._approach_mm = axis, camera, approach_mm
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
        for target in targets:
            reading = self._axis.move_to(float(target))
            found.append((reading, self._sharpness()))
        readings, sharpness = np.array(found).T
        return readings, sharpness

    def _go(self, reading: float) -> float:
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
