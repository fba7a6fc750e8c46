"""Level a height map without being fooled by its ridges.

A least-squares plane tilts a sawtooth by 0.1° to 0.3°, since its facets all lean the same way and the field
rarely holds whole pitches. Points one or more whole pitches apart stand on the same place of the shape; the
median of their height differences is the tilt alone, whatever the shape.
"""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.period import Period, find_period

MIN_PAIRS = 100
MAX_SAMPLES = 400_000


@dataclass(frozen=True)
class Levelled:
    """A levelled map and the form removed from it.

    Attributes:
        map: the map without tilt, mean height 0.
        tilt_x: slope dz/dx that was removed (height per length, no unit).
        tilt_y: slope dz/dy that was removed.
        period: the period that was used, or that made the plane fit necessary.
    """

    map: HeightMap
    tilt_x: float
    tilt_y: float
    period: Period

    @property
    def tilt_x_deg(self) -> float:
        """Inclination along x in degrees."""
        return float(np.degrees(np.arctan(self.tilt_x)))

    @property
    def tilt_y_deg(self) -> float:
        """Inclination along y in degrees."""
        return float(np.degrees(np.arctan(self.tilt_y)))


def _shifted_difference(surface: HeightMap, dx_um: float, dy_um: float) -> float | None:
    """Median of h(r + d) − h(r) in µm, between bilinear neighbours; None if too few points have a partner."""
    rows, cols = surface.shape
    sx, sy = dx_um / surface.pixel_x_um, dy_um / surface.pixel_y_um
    j0, i0 = int(np.floor(sx)), int(np.floor(sy))
    ax, ay = sx - j0, sy - i0
    top, bottom = max(0, -i0), min(rows, rows - i0 - 1)
    left, right = max(0, -j0), min(cols, cols - j0 - 1)
    if bottom <= top or right <= left:
        return None
    thin = max(1, int(np.sqrt((bottom - top) * (right - left) / MAX_SAMPLES)))
    height = surface.height_um

    def at(i: int, j: int) -> FloatArray:
        return height[top + i : bottom + i : thin, left + j : right + j]

    there = (1 - ay) * ((1 - ax) * at(i0, j0) + ax * at(i0, j0 + 1)) + ay * (
        (1 - ax) * at(i0 + 1, j0) + ax * at(i0 + 1, j0 + 1)
    )
    difference = there - at(0, 0)
    difference = difference[np.isfinite(difference)]
    return float(np.median(difference)) if difference.size >= MIN_PAIRS else None


def _reach(surface: HeightMap, direction: tuple[float, float]) -> float:
    """Half the length in µm of the field along a direction (x, y)."""
    height, width = surface.extent_um
    spans = [
        size / abs(part) for size, part in zip((width, height), direction, strict=True) if abs(part) > 1e-9
    ]
    return 0.5 * min(spans)


def periodic_tilt(surface: HeightMap, period: Period) -> tuple[float, float]:
    """Tilt (dz/dx, dz/dy) of a ridged map, from points whole pitches apart."""
    across, along = period.across(), period.along()
    pitches = max(1, int(_reach(surface, across) / period.pitch_um))
    far, long = pitches * period.pitch_um, _reach(surface, along)
    rise_across = _shifted_difference(surface, far * across[0], far * across[1])
    rise_along = _shifted_difference(surface, long * along[0], long * along[1])
    # a map too short to tell its tilt along one direction is taken as level in that direction
    a = 0.0 if rise_across is None else rise_across / far
    b = 0.0 if rise_along is None else rise_along / long
    return a * across[0] + b * along[0], a * across[1] + b * along[1]


def _plane_tilt(surface: HeightMap) -> tuple[float, float]:
    """Slopes of the least-squares plane through the measured points."""
    known = np.isfinite(surface.height_um)
    i, j = np.nonzero(known)
    x, y = j * surface.pixel_x_um, i * surface.pixel_y_um
    z = surface.height_um[known]
    x, y, z = x - x.mean(), y - y.mean(), z - z.mean()
    normal = np.array([[x @ x, x @ y], [x @ y, y @ y]])
    slopes = np.linalg.lstsq(normal, np.array([x @ z, y @ z]), rcond=None)[0]
    return float(slopes[0]), float(slopes[1])


def level(surface: HeightMap, period: Period | None = None) -> Levelled:
    """Take tilt and mean height off a map, (rows, cols) in µm.

    With ridges, the tilt comes from points whole pitches apart across the ridges and half the field apart
    along them; without, from a least-squares plane. ``origin["levelling"]`` says which.

    Args:
        surface: the map; missing points stay missing.
        period: its period, if it is known already.

    Raises:
        HeightMapError: nothing was measured.
    """
    check_heights("height map", surface.height_um)
    period = find_period(surface) if period is None else period
    if period.is_periodic:
        tilt, method = periodic_tilt(surface, period), "median over whole pitches"
    else:
        tilt, method = _plane_tilt(surface), "least-squares plane"
    rows, cols = surface.shape
    x, y = np.arange(cols) * surface.pixel_x_um, np.arange(rows) * surface.pixel_y_um
    height = surface.height_um - tilt[0] * x[None, :] - tilt[1] * y[:, None]
    height = height - np.nanmean(height)
    note = {"method": method, "tilt_x": tilt[0], "tilt_y": tilt[1]}
    return Levelled(surface.with_height(height, levelling=note), tilt[0], tilt[1], period)
