"""Where the ridges of a map lie, as the defects of ridges need it."""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.fold import Folded, fold
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.level import level
from anisoscope.profiles.period import Period, find_period


@dataclass(frozen=True, eq=False)
class RidgeLayout:
    """Median ridge and course of the ridges of a map.

    Attributes:
        period: pitch and direction.
        levelled_um: (rows, cols) heights in µm without tilt, about their mean.
        folded: the median ridge of the levelled map.
    """

    period: Period
    levelled_um: FloatArray
    folded: Folded

    @property
    def foot_um(self) -> float:
        """Lowest height of the median ridge in µm."""
        return float(self.folded.height_um.min())

    @property
    def crest_um(self) -> float:
        """Greatest height of the median ridge in µm."""
        return float(self.folded.height_um.max())

    @property
    def ridge_angle_deg(self) -> float:
        """Slope of the large facets: median slope of the longer side of the median ridge, in degrees."""
        position = np.append(self.folded.position, self.folded.position[0] + 1.0)
        height = np.append(self.folded.height_um, self.folded.height_um[0])
        slope = np.diff(height) / (np.diff(position) * self.period.pitch_um)
        falling = np.count_nonzero(slope < 0.0) >= np.count_nonzero(slope > 0.0)
        side = slope[slope < 0.0] if falling else slope[slope > 0.0]
        return float(np.degrees(np.arctan(np.abs(np.median(side))))) if side.size else 0.0


_found: WeakKeyDictionary[HeightMap, RidgeLayout] = WeakKeyDictionary()


def ridge_layout(surface: HeightMap, period: Period | None = None) -> RidgeLayout:
    """Find the ridges of a map; of one that is spoiled again and again only once.

    Raises:
        HeightMapError: nothing was measured, or the map has no ridges.
    """
    if period is not None:
        return _layout(surface, period)
    if surface not in _found:
        _found[surface] = _layout(surface, None)
    return _found[surface]


def _layout(surface: HeightMap, period: Period | None) -> RidgeLayout:
    period = find_period(surface) if period is None else period
    if not period.is_periodic:
        raise HeightMapError(
            "this defect needs a map with at least four ridges, and none were found; spoil a larger part of the surface"
        )
    flat = level(surface, period).map
    return RidgeLayout(period, flat.height_um, fold(flat, period.pitch_um, period.direction_deg))


def positions(surface: HeightMap, direction_deg: float) -> tuple[FloatArray, FloatArray]:
    """(rows, cols) distances in µm across and along lines of a direction through the first point."""
    rows, cols = surface.shape
    angle = np.radians(direction_deg)
    x, y = np.arange(cols) * surface.pixel_x_um, np.arange(rows) * surface.pixel_y_um
    across = np.add.outer(y * np.sin(angle), x * np.cos(angle))
    return across, np.add.outer(y * np.cos(angle), -x * np.sin(angle))


def ridge_numbers(surface: HeightMap, layout: RidgeLayout) -> npt.NDArray[np.int64]:
    """(rows, cols) number of the ridge, from foot to foot, counted from 0."""
    across, _ = positions(surface, layout.period.direction_deg)
    foot = float(layout.folded.position[int(np.argmin(layout.folded.height_um))])
    number = np.floor(across / layout.period.pitch_um - foot + 1e-9).astype(np.int64)
    return np.asarray(number - number.min())
