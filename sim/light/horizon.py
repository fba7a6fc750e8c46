"""Visible share of every facet of a height map from a direction."""

from collections import OrderedDict
from typing import Protocol

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError

Floats = npt.NDArray[np.float32]

LOWEST = 1e-3  # cosine from the normal at which a direction counts as grazing
MILD = 0.999  # rise along a ray below which, in single precision too, nothing hides anything
CACHED_DIRECTIONS = 10  # directions whose shares are kept


class Ground(Protocol):
    """What the horizon must know of a surface; `relief.Relief` is one."""

    @property
    def rows_first(self) -> Floats:
        """(rows, cols) heights in µm, NaN = missing."""

    @property
    def columns_first(self) -> Floats:
        """(cols, rows) the same, contiguous."""

    @property
    def pixels_um(self) -> tuple[float, float]:
        """Distances of columns and of rows."""

    @property
    def depth_um(self) -> float:
        """Height of the highest point above the lowest."""

    @property
    def missing_share(self) -> float:
        """Share of facets without a height at one of their corners."""

    @property
    def steepest(self) -> FloatArray:
        """Lowest and highest slope along x, lowest and highest along y, from point to point."""

    def wrap_columns(self) -> int:
        """Columns after which the surface repeats; 0 if it does not."""


class Horizon:
    """Visible shares of all facets from many directions.

    The shares of the latest ``CACHED_DIRECTIONS`` directions are cached; arrays of older ones are filled anew, because
    fresh memory costs more than the march itself.

    Args:
        ground: the surface.
    """

    def __init__(self, ground: Ground) -> None:
        self.ground = ground
        self._cache: OrderedDict[bytes, Floats] = OrderedDict()
        self._transposed: Floats | None = None
        self._all: Floats | None = None

    def whole(self, direction: FloatArray) -> bool:
        """Whether it is certain without a march that a direction (3,) reaches everything: all slopes are milder.

        Raises:
            ModelError: the direction is at or below the horizon.
        """
        if direction[2] < LOWEST:
            raise ModelError("light or camera stands at or below the horizon of the sample")
        ground, tangents = self.ground, direction[:2] / direction[2]
        if np.max(np.abs(tangents) / ground.pixels_um) * ground.depth_um < 1e-12:
            return True
        rises = tangents[:, None] * ground.steepest.reshape(2, 2)
        return ground.missing_share == 0.0 and float(rises.max(axis=1).sum()) < MILD

    def shares(self, direction: FloatArray) -> Floats:
        """(rows − 1, cols − 1) shares from a (3,) unit vector; cached for ``CACHED_DIRECTIONS`` directions.

        Exact on slices along a map axis; on other azimuths slices pass between the points and are interpolated.

        Raises:
            ModelError: the direction is at or below the horizon.
        """
        if self.whole(direction):
            if self._all is None:
                rows, cols = self.ground.rows_first.shape
                self._all = np.ones((rows - 1, cols - 1), dtype=np.float32)
            return self._all
        key = np.round(direction[:2] / direction[2], 12).tobytes()
        if key not in self._cache:
            self._cache[key] = self._march(direction, self._room())
        self._cache.move_to_end(key)
        return self._cache[key]

    def _room(self) -> Floats:
        if len(self._cache) >= CACHED_DIRECTIONS:
            return self._cache.popitem(last=False)[1]
        rows, cols = self.ground.rows_first.shape
        return np.empty((rows - 1, cols - 1), dtype=np.float32)

    def _march(self, direction: FloatArray, shares: Floats) -> Floats:
        from anisoscope.sim.light.horizon_kernels import march  # noqa: PLC0415 - numba when first needed

        ground = self.ground
        pixel_x, pixel_y = ground.pixels_um
        tan_x, tan_y = float(direction[0] / direction[2]), float(direction[1] / direction[2])
        along_x = abs(tan_x) / pixel_x >= abs(tan_y) / pixel_y
        z = ground.columns_first if along_x else ground.rows_first
        major, minor = (tan_x, tan_y) if along_x else (tan_y, tan_x)
        pixels = (pixel_x, pixel_y) if along_x else (pixel_y, pixel_x)
        shift = minor / pixels[1] / (abs(major) / pixels[0])
        step = float(np.hypot(pixels[0], shift * pixels[1]))
        tangent = float(np.hypot(tan_x, tan_y))
        reach = int(np.ceil(tangent * ground.depth_um / step)) + 1
        wrap = ground.wrap_columns()
        periods = (wrap, 0) if along_x else (0, wrap)
        out = self._scratch() if along_x else shares
        march(z, step, tangent, shift, major < 0, reach, *periods, out)
        if along_x:
            np.copyto(shares, out.T)
        return shares

    def _scratch(self) -> Floats:
        if self._transposed is None:
            rows, cols = self.ground.rows_first.shape
            self._transposed = np.empty((cols - 1, rows - 1), dtype=np.float32)
        return self._transposed
