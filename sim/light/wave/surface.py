"""Heights ready for wave optics: complete, sampled finely enough, or interpolated.

The phase of the reflected wave turns by 4π·h_z·z/λ. Between two pixels it must turn by less than π, else the map does
not say how often it has turned: |Δz| < λ/(4·h_z). A step from one plateau to another within one pixel is no such
doubt: the surface itself jumps there. So slopes are judged within plateaus (`on_plateaus`).
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import HeightMap

BoolArray = npt.NDArray[np.bool_]
Heights = npt.NDArray[np.float32]

MAX_SHARE = 0.01
"""Share of pixels over the limit above which a map is refused."""

MAX_POINTS = 2**28
LINES = 48
"""Rows and columns in which plateaus are looked for."""
MOST_LEVELS = 32
FLAT_SHARE, APART_SHARE = 0.05, 0.01
"""Of the wavelength: widest spread of the heights of one plateau, and least distance of two."""
LEVEL_SHARE, STEP_SHARE = 0.8, 0.9
RAMP_SHARE = 0.4
"""Changes that go on alike in the next pixel, above which few levels are those of a slope."""
MOST_ROUNDS = 100
DECLARED_SPREAD = 0.25
"""Standard deviation about declared plateaus, over their least distance, above which they are noise."""
_BLOCK_ROWS = 512


@dataclass(frozen=True, eq=False)
class WaveSurface:
    """A surface as the wave meets it.

    Attributes:
        height_um: (rows, cols) heights above their mean in µm, float32; (1, cols) for a profile.
        pixel_x_um: distance of columns in µm.
        pixel_y_um: distance of rows in µm.
        is_profile: the surface is a profile, the same all along y.
        cells: each height holds for a whole pixel (a stepped surface); else it is that of a point.
        edges_um: heights between the levels of the plateaus; none where they have levels of their own.
    """

    height_um: Heights
    pixel_x_um: float
    pixel_y_um: float
    is_profile: bool = False
    cells: bool = False
    edges_um: tuple[float, ...] = ()

    @classmethod
    def of(
        cls, surface: HeightMap | FloatArray, pixel_um: float | None = None, *, cells: bool = False
    ) -> Self:
        """From a height map, or from (rows, cols) or (cols,) heights in µm with their pixel size in µm.

        Raises:
            HeightMapError: a pixel without a height, or an array without a pixel size.
        """
        if isinstance(surface, HeightMap):
            heights, pixel_x, pixel_y = surface.height_um, surface.pixel_x_um, surface.pixel_y_um
        else:
            if pixel_um is None or not 0.0 < pixel_um < float("inf"):
                raise HeightMapError(f"an array of heights needs its pixel size in µm, not {pixel_um}")
            heights, pixel_x, pixel_y = np.asarray(surface, dtype=np.float64), pixel_um, pixel_um
        if heights.ndim not in (1, 2) or heights.size == 0:
            raise HeightMapError(f"heights must be a profile or a map, not an array of shape {heights.shape}")
        missing = heights.size - int(np.count_nonzero(np.isfinite(heights)))
        if missing:
            raise HeightMapError(
                f"{missing} of {heights.size} pixels ({missing / heights.size:.2%}) have no height: wave optics needs "
                "all of them; fill the gaps in the instrument's software, or crop the map to where it is whole"
            )
        is_profile = heights.ndim == 1
        level = (heights[None] if is_profile else heights) - heights.mean()
        return cls(_readonly(level), pixel_x, pixel_y, is_profile, cells)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.height_um.shape[0], self.height_um.shape[1]

    @property
    def area_um2(self) -> float:
        """Area in µm²; of a profile its length in µm."""
        rows, cols = self.shape
        length = cols * self.pixel_x_um
        return length if self.is_profile else length * rows * self.pixel_y_um

    def interpolated(self, factor: int) -> "WaveSurface":
        """The same surface with ``factor`` times as many points along both axes, by cubic splines of the heights.

        Heights are interpolated, never the wave: that lies on a circle, and a straight line between two points of it
        does not.

        Raises:
            HeightMapError: fewer than one point a pixel, or more points than can be held.
        """
        points = self.height_um.size * factor ** (1 if self.is_profile else 2)
        if factor < 1 or points > MAX_POINTS:
            raise HeightMapError(
                f"heights can be interpolated 1 times or more, up to {MAX_POINTS} points; {factor} times would give "
                f"{points}: crop the map"
            )
        if factor == 1 or self.cells:  # a step stays where it is
            return self
        from scipy.ndimage import zoom  # noqa: PLC0415 - slow to import

        times = (1, factor) if self.is_profile else (factor, factor)
        fine = zoom(self.height_um, times, order=3, mode="nearest", grid_mode=True)
        pixel_y = self.pixel_y_um if self.is_profile else self.pixel_y_um / factor
        return WaveSurface(_readonly(fine), self.pixel_x_um / factor, pixel_y, self.is_profile, self.cells)


def _readonly(height_um: npt.NDArray[np.floating]) -> Heights:
    """A float32 array that cannot be written to: kernels are compiled for one kind of array only."""
    found = np.ascontiguousarray(height_um, dtype=np.float32)
    found.flags.writeable = False
    return found


def on_plateaus(surface: WaveSurface, wavelength_um: float, steps: int | None = None) -> WaveSurface:
    """The same surface, as a stepped one where its heights are those of plateaus.

    Without ``steps`` it is stepped where its heights lie on at most 32 levels without being those of a slope, or where
    most of it is level and nearly all of its relief is jumps from pixel to pixel. Up to 48 lines each way are looked
    at.

    Args:
        surface: the heights.
        wavelength_um: the shortest one.
        steps: number of levels, where it is known; noise about them then does not matter.

    Raises:
        HeightMapError: heights that lie on no such number of levels.
    """
    if surface.cells:
        return surface
    lines = lines_of(surface)
    heights = np.sort(np.concatenate(lines)).astype(np.float64)
    if steps is not None:
        return replace(surface, cells=True, edges_um=_declared(heights, steps))
    apart = np.flatnonzero(np.diff(heights) > APART_SHARE * wavelength_um)
    if 0 < apart.size < MOST_LEVELS:
        groups = np.split(heights, apart + 1)
        flat = max(float(group[-1] - group[0]) for group in groups) < FLAT_SHARE * wavelength_um
        if flat and _ramps(lines, wavelength_um) <= RAMP_SHARE:
            edges = tuple((0.5 * (heights[apart] + heights[apart + 1])).tolist())
            return replace(surface, cells=True, edges_um=edges)
    change = np.concatenate([np.abs(np.diff(line)) for line in lines])
    jump = change > 0.02 * wavelength_um
    relief = float(change.sum())
    mostly = np.mean(~jump) > LEVEL_SHARE and float(change[jump].sum()) > STEP_SHARE * relief
    return replace(surface, cells=True) if jump.any() and mostly else surface


def lines_of(surface: WaveSurface) -> list[Heights]:
    """Up to 48 rows and 48 columns, evenly spread."""
    rows, cols = surface.shape
    z = surface.height_um
    found = [z[row] for row in np.unique(np.linspace(0, rows - 1, min(rows, LINES)).astype(int))]
    if not surface.is_profile and rows > 1:
        found += [z[:, col] for col in np.unique(np.linspace(0, cols - 1, min(cols, LINES)).astype(int))]
    return found


def _ramps(lines: list[Heights], wavelength_um: float) -> float:
    """Share of the changes from pixel to pixel that the next pixel repeats, within a factor of two."""
    here = np.concatenate([np.diff(line)[:-1] for line in lines])
    then = np.concatenate([np.diff(line)[1:] for line in lines])
    changes = np.abs(here) > APART_SHARE * wavelength_um
    if not changes.any():
        return 0.0
    ratio = then[changes] / here[changes]
    return float(np.mean((ratio > 0.5) & (ratio < 2.0)))


def _declared(heights: FloatArray, steps: int) -> tuple[float, ...]:
    """Heights between so many levels, by k means in one dimension (Lloyd 1982) from even levels.

    Raises:
        HeightMapError: heights that lie on no such number of levels.
    """
    if not 2 <= steps <= MOST_LEVELS:
        raise HeightMapError(f"plateaus (--steps) are 2 to {MOST_LEVELS}, not {steps}")
    levels, moved = np.zeros(steps), np.linspace(heights[0], heights[-1], steps)
    edges, group, count = moved[1:], np.zeros(heights.size, dtype=np.intp), np.zeros(steps, dtype=np.intp)
    rounds = 0
    while rounds < MOST_ROUNDS and not np.array_equal(moved, levels):
        rounds, levels = rounds + 1, moved
        edges = 0.5 * (levels[1:] + levels[:-1])
        group = np.searchsorted(edges, heights)
        count = np.bincount(group, minlength=steps)
        moved = np.where(count > 0, np.bincount(group, heights, steps) / np.maximum(count, 1), levels)
    spread, apart = float(np.std(heights - levels[group])), float(np.diff(levels).min())
    if count.min() == 0 or spread > DECLARED_SPREAD * apart:
        raise HeightMapError(
            f"the heights lie on no {steps} plateaus: they spread by {1e3 * spread:.3g} nm about levels that are "
            f"{1e3 * apart:.3g} nm apart: give another --steps, smooth the map (profile edit), or leave --steps out"
        )
    return tuple(edges.tolist())


@dataclass(frozen=True)
class Sampling:
    """Sampling of the phase by a map.

    Attributes:
        share: share of the pixels from which the height to a neighbour changes by more than the limit, 0 to 1;
            lone jumps between smooth stretches (steps, walls) do not count.
        worst_um: (x, y) of the largest change in µm.
        worst_pixel: (row, col) of it.
        worst_change_um: the largest change in µm.
        limit_um: λ/(4·h_z).
        slope_deg: the slope that the pixels resolve.
    """

    share: float
    worst_um: tuple[float, float]
    worst_pixel: tuple[int, int]
    worst_change_um: float
    limit_um: float
    slope_deg: float

    def check(self) -> None:
        """Refuse a map that does not hold the phase.

        Raises:
            HeightMapError: more than 1 % of the pixels are over the limit.
        """
        if self.share > MAX_SHARE:
            row, col = self.worst_pixel
            raise HeightMapError(
                f"{self.share:.1%} of the pixels are too coarse for wave optics (limit {MAX_SHARE:.0%}): heights of "
                f"neighbours differ by more than {1e3 * self.limit_um:.0f} nm, worst {self.worst_change_um:.2f} µm "
                f"at x = {self.worst_um[0]:.1f} µm, y = {self.worst_um[1]:.1f} µm (row {row}, column {col}); these "
                f"pixels resolve slopes to {self.slope_deg:.1f}°: measure with smaller pixels, ask for interpolated "
                "heights where the surface is smooth (--interpolate), say how many plateaus there are where it is "
                "stepped (--steps), take longer wavelengths, or the geometric model"
            )


def slope_limit_deg(pixel_um: float, wavelength_um: float, h_z: float = 1.0) -> float:
    """Steepest slope in degrees that pixels resolve: |Δz| per pixel below λ/(4·h_z)."""
    return float(np.degrees(np.arctan(wavelength_um / (4.0 * h_z * pixel_um))))


def sampling_of(surface: WaveSurface, wavelength_um: float, h_z: float = 1.0) -> Sampling:
    """Sampling of the phase by a surface at a wavelength; in blocks of rows, so that memory stays small."""
    limit = wavelength_um / (4.0 * h_z)
    rows, cols = surface.shape
    count, worst, place = 0, 0.0, (0, 0)
    for start in range(0, rows, _BLOCK_ROWS):
        before, after = min(start, 2), min(2, max(0, rows - start - _BLOCK_ROWS))
        block = surface.height_um[start - before : start + _BLOCK_ROWS + after]
        change = _doubtful(block, 1, limit, surface.edges_um)
        if not surface.is_profile and rows > 1:
            change = np.maximum(change, _doubtful(block, 0, limit, surface.edges_um))
        change = change[before : change.shape[0] - after]
        count += int(np.count_nonzero(change > limit))
        if change.size and float(change.max()) > worst:
            row, col = divmod(int(change.argmax()), cols)
            worst, place = float(change.max()), (start + row, col)
    where = place[1] * surface.pixel_x_um, place[0] * surface.pixel_y_um
    pixel = surface.pixel_x_um if surface.is_profile else max(surface.pixel_x_um, surface.pixel_y_um)
    return Sampling(
        count / surface.height_um.size, where, place, worst, limit, slope_limit_deg(pixel, wavelength_um, h_z)
    )


def _doubtful(block: Heights, axis: int, limit: float, edges_um: tuple[float, ...]) -> Heights:
    """Change of height to the next pixel along an axis, 0 where it leads to another plateau.

    That is another level, or what lies beyond a lone jump between smooth stretches.
    """
    change = np.abs(np.diff(block, axis=axis))
    if edges_um:
        level = np.searchsorted(np.array(edges_um), block)
        change = np.where(np.diff(level, axis=axis) == 0, change, 0.0).astype(np.float32)
    smooth = np.moveaxis(change < 0.5 * limit, axis, 0)
    lone = np.zeros_like(smooth)
    if len(smooth) > 2:
        lone[1:-1] = smooth[:-2] & smooth[2:]
    filtered = np.where(np.moveaxis(lone, 0, axis), 0.0, change)
    pad = [(0, 0), (0, 0)]
    pad[axis] = (0, 1)
    return np.pad(filtered, pad).astype(np.float32)
