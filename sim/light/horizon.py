"""Visible share of every facet of a height map from a direction."""

from collections import OrderedDict
from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light import threads

Floats = npt.NDArray[np.float32]

LOWEST = 1e-3  # cosine from the normal at which a direction counts as grazing
MILD = 0.999  # rise along a ray below which, in single precision too, nothing hides anything
CACHED_DIRECTIONS = 4  # directions whose shares are kept
CACHED_POINTS = (
    8_000_000  # points of all shares that are kept with a surface, for maps of which these are many
)
BAND_POINTS = 1_000_000  # facets of a band of rows, so that its shares stay in the processor's cache


class Ground(Protocol):
    """Surface as the horizon needs it; `relief.Relief` is one."""

    @property
    def rows_first(self) -> Floats:
        """(rows, cols) heights in µm, NaN = missing."""

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

    def columns_first(self, low: int, high: int) -> Floats:
        """(cols, high − low + 1) heights of the rows from ``low`` to ``high``, contiguous."""

    def wrap_columns(self) -> int:
        """Columns after which the surface repeats; 0 if it does not."""


class SharesOfSmallMap:
    """Visible shares of a small map by direction, for all threads, as long as the map is in use.

    Predictions move one input after the other, so that most directions of a map return with the next material.

    Args:
        points: number of points of the map.
    """

    def __init__(self, points: int) -> None:
        self._most = CACHED_POINTS // max(points, 1)
        self._shares: OrderedDict[bytes, Floats] = OrderedDict()

    @property
    def is_useful(self) -> bool:
        """Whether it holds clearly more directions than a `Horizon` does by itself."""
        return self._most >= 2 * CACHED_DIRECTIONS

    def get(self, key: bytes) -> Floats | None:
        """Shares from a direction, if they are known."""
        return self._shares.get(key)

    def add(self, key: bytes, shares: Floats) -> None:
        """Keep the shares from a direction; the oldest go. Every step is atomic, so that threads need no lock."""
        self._shares[key] = shares
        if len(self._shares) > self._most:
            self._shares.popitem(last=False)


def bands(shape: tuple[int, int]) -> Sequence[tuple[int, int]]:
    """First row of facets and that after the last of every band of a map with (rows, cols) points."""
    rows, cols = shape[0] - 1, max(shape[1] - 1, 1)
    return threads.runs(rows, max(1, rows * cols // BAND_POINTS))


class Horizon:
    """Visible shares of all facets from many directions, or of those in a band of rows.

    The shares of the latest ``CACHED_DIRECTIONS`` directions are cached; arrays of older ones are filled anew, because
    fresh memory costs more than the march itself. A band has the shares that the whole map has there, in little memory.

    Args:
        ground: the surface.
        shared: shares of the same surface that are common to several horizons.
        band: first row of facets and that after the last; None takes all, and ``shared`` serves these only.
    """

    def __init__(
        self, ground: Ground, shared: SharesOfSmallMap | None = None, band: tuple[int, int] | None = None
    ) -> None:
        self.ground = ground
        self._shared = shared if shared is not None and shared.is_useful and band is None else None
        self._cache: OrderedDict[bytes, Floats] = OrderedDict()
        self._transposed: Floats | None = None
        self._all: Floats | None = None
        self._band = band or (0, ground.rows_first.shape[0] - 1)
        self._columns: tuple[tuple[int, int], Floats] | None = None

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
                self._all = np.ones(self._shape, dtype=np.float32)
            return self._all
        key = np.round(direction[:2] / direction[2], 12).tobytes()
        if self._shared is not None:
            return self._shared_shares(self._shared, key, direction)
        if key not in self._cache:
            self._cache[key] = self._march(direction, self._room())
        self._cache.move_to_end(key)
        return self._cache[key]

    @property
    def _shape(self) -> tuple[int, int]:
        return self._band[1] - self._band[0], self.ground.rows_first.shape[1] - 1

    def _shared_shares(self, shared: SharesOfSmallMap, key: bytes, direction: FloatArray) -> Floats:
        known = shared.get(key)
        if known is None:
            known = self._march(direction, np.empty(self._shape, dtype=np.float32))
            shared.add(key, known)
        return known

    def _room(self) -> Floats:
        if len(self._cache) >= CACHED_DIRECTIONS:
            return self._cache.popitem(last=False)[1]
        return np.empty(self._shape, dtype=np.float32)

    def _march(self, direction: FloatArray, shares: Floats) -> Floats:
        from anisoscope.sim.light.horizon_kernels import BLOCK, march  # noqa: PLC0415 - numba when first needed

        ground = self.ground
        pixel_x, pixel_y = ground.pixels_um
        tan_x, tan_y = float(direction[0] / direction[2]), float(direction[1] / direction[2])
        along_x = abs(tan_x) / pixel_x >= abs(tan_y) / pixel_y
        major, minor = (tan_x, tan_y) if along_x else (tan_y, tan_x)
        pixels = (pixel_x, pixel_y) if along_x else (pixel_y, pixel_x)
        shift = minor / pixels[1] / (abs(major) / pixels[0])
        step = float(np.hypot(pixels[0], shift * pixels[1]))
        tangent = float(np.hypot(tan_x, tan_y))
        reach = int(np.ceil(tangent * ground.depth_um / step)) + 1
        wrap = ground.wrap_columns()
        reverse = major < 0
        facets, (first, last) = ground.rows_first.shape[0] - 1, self._band
        if along_x:  # slices that slant come from rows outside of the band
            aside = int(np.ceil(abs(shift) * reach)) + 2 if abs(shift) > 0.0 else 0
            low, high = max(0, first - aside), min(facets, last + aside)
            out = self._scratch(high - low)
            march(self._columns_first(low, high), step, tangent, shift, reverse, reach, wrap, 0, 0, out)
            np.copyto(shares, out[:, first - low : last - low].T)
            return shares
        ahead = reach + 1
        z = ground.rows_first[
            max(0, first - ahead) if reverse else first : last + 1 + (0 if reverse else ahead)
        ]
        lead = (facets - last if reverse else first) % BLOCK
        march(z, step, tangent, shift, reverse, reach, 0, wrap, lead, shares)
        return shares

    def _columns_first(self, low: int, high: int) -> Floats:
        """(cols, high − low + 1) heights of the rows of points from ``low`` to ``high``, contiguous."""
        if self._columns is None or self._columns[0] != (low, high):
            self._columns = (low, high), self.ground.columns_first(low, high)
        return self._columns[1]

    def _scratch(self, rows: int) -> Floats:
        if self._transposed is None or self._transposed.shape[1] != rows:
            self._transposed = np.empty((self.ground.rows_first.shape[1] - 1, rows), dtype=np.float32)
        return self._transposed
