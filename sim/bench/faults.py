"""Faults of the virtual rig: of its light, camera, lens and markers, and of how the part sits."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.rig.fixture import Fixture
from anisoscope.sim.bench.benchfile import BenchFile, FaultsPart
from anisoscope.sim.bench.optics import pixel_from_mm

Image = npt.NDArray[np.float32]
Counts = npt.NDArray[np.uint16]

_DIRT = 0.15
_SHADOW = 0.5
_RADII = 2048


class Faults:
    """The faults of a bench, frame by frame.

    A pose begins with the first lit frame at another angle or tilt than the lit frame before.
    """

    def __init__(self, file: BenchFile) -> None:
        self.part: FaultsPart = file.faults
        self._file = file
        self._place: tuple[float, float] | None = None
        self._pose = -1
        self._frames = self._lit = 0
        self._fresh = False
        self._mean: float | None = None
        self._before: FloatArray | None = None
        self._buffer: Counts | None = None

    def attend(self, place: tuple[float, float], lit: bool) -> None:
        """Count frames and poses before a frame is taken at (angle, tilt)."""
        self._frames += 1
        self._lit += lit
        self._fresh = lit and place != self._place
        if self._fresh:
            self._pose, self._place = self._pose + 1, place

    def part_deg(self, place: tuple[float, float]) -> float:
        """Angle of the part beyond that of its fixture, at (angle, tilt) of the next lit frame."""
        pose = self._pose + (place != self._place)
        slipped = self.part.slips_at is not None and pose + 1 >= self.part.slips_at
        return self.part.seated_deg + (self.part.slip_deg if slipped else 0.0)

    def signal(self, per_second: FloatArray, lit: bool) -> FloatArray:
        """(rows, cols) photo-electrons per second with the faults of the light, and the frame that is delivered.

        Args:
            per_second: from the lamps.
            lit: whether a lamp shines.
        """
        part = self.part
        electrons = self._file.optics.electrons
        down, across = (np.linspace(-1.0, 1.0, size) for size in per_second.shape)
        found = per_second
        if lit:
            if any(part.lamp_slope):
                found = found * (1.0 + part.lamp_slope[0] * across - part.lamp_slope[1] * down[:, None])
            if part.lamp:
                found = found * _at(part.lamp, self._pose)
            if part.glare_radiance:
                slope = 1.0 + part.glare_slope[0] * across - part.glare_slope[1] * down[:, None]
                found = found + electrons * part.glare_radiance * slope
            if part.veiling_glare:
                found = found + part.veiling_glare * found.mean()
        if part.room_radiance:
            found = found + electrons * _at(part.room_radiance, self._frames - 1)
        if lit and part.stale_pose:
            shown = self._before if self._fresh and self._before is not None else found
            self._before, found = found, shown
        return found

    def settings(
        self, per_second: FloatArray, exposure_s: float, gain: float, lit: bool
    ) -> tuple[float, float]:
        """Exposure in seconds and gain after the faults of the camera."""
        if not lit:
            return exposure_s, gain
        if self.part.automatic_gain:
            mean = float(per_second.mean())
            self._mean = self._mean or mean
            gain *= self._mean / max(mean, 1e-9)
        return exposure_s * _at(self.part.exposure, self._pose), gain * _at(self.part.gain, self._pose)

    def delivered(self, counts: Counts, lit: bool) -> Counts:
        """(rows, cols) counts as the camera delivers them."""
        part, top = self.part, 2**self._file.sensor.bit_depth - 1
        if not lit and part.black_in_dark:
            counts = _clipped(counts + np.float64(part.black_in_dark), top)
        if part.plateau_counts is not None:
            counts = np.minimum(counts, np.uint16(part.plateau_counts))
        if part.stuck_columns or part.stuck_pixels:
            counts = counts.copy()
            counts[:, list(part.stuck_columns)] = part.stuck_counts
            for row, col in part.stuck_pixels:
                counts[row, col] = part.stuck_counts
        if lit and part.torn is not None and self._lit % part.torn_every == 0:
            counts = _torn(counts, part.torn)
        if part.repeats_every and self._frames % part.repeats_every == 0 and self._buffer is not None:
            return self._buffer
        self._buffer = counts
        return counts

    def through_lens(self, picture: FloatArray, angle_deg: float, tilt_deg: float) -> FloatArray:
        """(channels, rows, cols) picture with dirt and shadow on markers, through lens and mirror."""
        part, fixture = self.part, self._file.fixture
        shade = np.ones(picture.shape[1:])
        if fixture is not None and part.shadowed_marker is not None:
            shade -= _SHADOW * self._blot(fixture, part.shadowed_marker, 1.0, 0.0, angle_deg, tilt_deg)
        found = picture * shade
        if fixture is not None and part.dirty_marker is not None:
            dirt = self._blot(fixture, part.dirty_marker, 0.35, 0.4, angle_deg, tilt_deg)
            found = found * (1.0 - dirt) + dirt * _DIRT / np.pi
        if part.barrel:
            found = np.stack([_bent(channel, part.barrel) for channel in found])
        return found[..., ::-1].copy() if part.mirrored else found

    def _blot(
        self, fixture: Fixture, number: int, size: float, aside: float, angle_deg: float, tilt_deg: float
    ) -> FloatArray:
        """(rows, cols) of a round blot, 1 inside; radius and distance from its marker are shares of its side."""
        optics, sensor = self._file.optics, self._file.sensor
        marker = next(one for one in fixture.markers if one.id == number)
        off = aside * fixture.marker_mm
        column, row = pixel_from_mm(optics, sensor, angle_deg, tilt_deg) @ [
            marker.x_mm + off,
            marker.y_mm,
            1.0,
        ]
        radius = 1000.0 * size * fixture.marker_mm / optics.pixel_um
        rows, cols = np.arange(sensor.rows)[:, None], np.arange(sensor.cols)
        away = np.hypot(rows - row, cols - column) / radius
        return np.asarray(1.0 / (1.0 + away**12))


def _at(values: Sequence[float], index: int) -> float:
    """The value of an index; the last holds on; 1 without any."""
    return values[min(index, len(values) - 1)] if values else 1.0


def _clipped(counts: FloatArray, top: int) -> Counts:
    return np.clip(np.rint(counts), 0, top).astype(np.uint16)


def _torn(counts: Counts, how: str) -> Counts:
    found, third = counts.copy(), len(counts) // 3
    if how == "zero":
        found[third : 2 * third] = 0
    elif how == "shifted":
        found[third:] = np.roll(counts[third:], counts.shape[1] // 10, axis=1)
    else:  # dropped: the rest moves up, and its last row is repeated
        lost = len(counts) // 20
        found[third:-lost] = counts[third + lost :]
        found[-lost:] = counts[-1]
    return found


def _bent(picture: FloatArray, barrel: float) -> FloatArray:
    """A picture whose corners move towards the middle by a share: r′ = r (1 − barrel·(r/r of a corner)²)."""
    import cv2

    rows, cols = picture.shape
    y, x = np.arange(rows)[:, None] - (rows - 1) / 2, np.arange(cols) - (cols - 1) / 2
    away = np.hypot(x, y)
    true = np.linspace(0.0, 1.2, _RADII)
    seen = true * (1.0 - barrel * true**2)
    corner = away.max()
    ratio = np.interp(away / corner, seen[1:], true[1:] / seen[1:])
    column = (x * ratio + (cols - 1) / 2).astype(np.float32)
    row = (y * ratio + (rows - 1) / 2).astype(np.float32)
    found = cv2.remap(
        picture.astype(np.float32), column, row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    return np.maximum(np.asarray(found, dtype=np.float64), 0.0)
