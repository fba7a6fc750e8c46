"""A surface of many dots, stored as a library of tiles and a map of tile numbers, never as a whole."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ConfigError, HeightMapError
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.design.depths import MOST_PASSES, level_heights

Tiles = npt.NDArray[np.uint16]
Index = npt.NDArray[np.uint16]

MAX_POINTS = 2**28
"""Largest height map that is made in one piece."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Dots in rows and columns, row 0 at y = 0.

    Attributes:
        tiles: (T, n, n) number of the level of every grid point of every tile; bit i: etched in pass i.
        tile_class: (T,) which reflectance a tile has.
        index: (rows, cols) tile of every dot.
        passes_nm: depth of every etch pass.
        grid_um: distance of the grid points.
        names: of the reflectances.
        wavelength_nm: of the design.
        coherence_um: of the design.

    Raises:
        ConfigError: arrays that do not fit each other.
    """

    tiles: Tiles
    tile_class: npt.NDArray[np.integer]
    index: Index
    passes_nm: tuple[float, ...]
    grid_um: float
    names: tuple[str, ...]
    wavelength_nm: float = 500.0
    coherence_um: float = 16.0

    def __post_init__(self) -> None:
        tiles, index = self.tiles, self.index
        whole = all(np.issubdtype(one.dtype, np.integer) for one in (tiles, index, self.tile_class))
        if not whole or len(self.passes_nm) > 2 * MOST_PASSES:
            raise ConfigError(
                f"a layout takes arrays of whole numbers and at most {2 * MOST_PASSES} etch passes: make it again"
            )
        if tiles.size == 0 or index.size == 0 or min(int(tiles.min()), int(index.min())) < 0:
            raise ConfigError(
                "tiles and index of a layout must hold numbers of 0 or more: make the layout again"
            )
        fits = tiles.ndim == 3 and index.ndim == 2 and tiles.shape[1] == tiles.shape[2]
        if not fits or self.tile_class.shape != tiles.shape[:1] or int(index.max()) >= tiles.shape[0]:
            raise ConfigError("tiles and index of a layout do not fit each other: make the layout again")
        if int(tiles.max()) >= 2 ** len(self.passes_nm) or not (
            int(self.tile_class.min()) >= 0 and int(self.tile_class.max()) < len(self.names)
        ):
            raise ConfigError(
                "a tile of the layout has a level or a class that is not described: make it again"
            )

    @property
    def dot_um(self) -> float:
        """Δd, side of a dot."""
        return float(self.tiles.shape[1] * self.grid_um)

    @property
    def size_um(self) -> tuple[float, float]:
        """(along y, along x)."""
        rows, cols = self.index.shape
        return rows * self.dot_um, cols * self.dot_um

    @property
    def heights_um(self) -> FloatArray:
        """(levels,) in µm."""
        return np.asarray(level_heights(tuple(1e-3 * depth for depth in self.passes_nm)))

    @property
    def classes(self) -> npt.NDArray[np.integer]:
        """(rows, cols) reflectance of every dot."""
        return np.asarray(self.tile_class[self.index])

    def dot_rows(self) -> Iterator[Tiles]:
        """Levels of one row of dots after the other, (n, cols·n): all the memory that the whole surface takes."""
        for row in self.index:
            yield self.tiles[row].transpose(1, 0, 2).reshape(self.tiles.shape[1], -1)

    def window(
        self, corner_um: tuple[float, float] = (0.0, 0.0), size_um: tuple[float, float] | None = None
    ) -> HeightMap:
        """The heights of a window.

        Args:
            corner_um: (y, x) of its lower left corner; taken to the grid.
            size_um: (along y, along x); all the rest by default.

        Raises:
            HeightMapError: a window outside the surface, or with too many points.
        """
        n, index = self.tiles.shape[1], self.index
        y, x = (round(value / self.grid_um) for value in corner_um)
        whole = index.shape[0] * n, index.shape[1] * n
        rows, cols = (
            (whole[0] - y, whole[1] - x)
            if size_um is None
            else tuple(round(value / self.grid_um) for value in size_um)
        )
        if min(y, x) < 0 or min(rows, cols) < 2 or y + rows > whole[0] or x + cols > whole[1]:
            high, wide = (1e-3 * side for side in self.size_um)
            raise HeightMapError(
                f"a window of {rows} × {cols} points at row {y}, column {x} is not within the surface of "
                f"{whole[0]} × {whole[1]} points ({high:g} × {wide:g} mm): choose a window inside"
            )
        if rows * cols > MAX_POINTS:
            raise HeightMapError(
                f"a height map of {rows} × {cols} points is too large; at most {MAX_POINTS} points: choose a window, "
                "or write an .npy file, which is written row by row"
            )
        at_y, at_x = np.arange(y, y + rows), np.arange(x, x + cols)
        heights = np.empty((rows, cols))
        table = self.heights_um
        for first in range(0, rows, n):
            part = at_y[first : first + n]
            tile = index[np.ix_(part // n, at_x // n)]
            heights[first : first + n] = table[self.tiles[tile, (part % n)[:, None], (at_x % n)[None, :]]]
        heights.flags.writeable = False
        origin = {
            "ideal": "design",
            "dots": ", ".join(self.names),
            "passes_nm": list(self.passes_nm),
            "corner_um": [y * self.grid_um, x * self.grid_um],
        }
        return HeightMap(heights, self.grid_um, self.grid_um, {"made": origin})
