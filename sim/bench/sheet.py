"""A printed sheet in its plane: how it is bent, and how much ink lies where."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.bench.printpart import PrintPart

Image = npt.NDArray[np.float32]


class Grid(NamedTuple):
    """Places of the raster in mm, (rows, 1) and (1, cols), and its size in µm."""

    x_mm: FloatArray
    y_mm: FloatArray
    raster_um: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.y_mm.shape[0], self.x_mm.shape[1]


def grid_of(size_mm: float, raster_um: float) -> Grid:
    """The raster of a square sheet, centred on the axis; rows rise with +y."""
    count = max(2, round(size_mm * 1000.0 / raster_um) + 1)
    at_mm = np.asarray((np.arange(count) - (count - 1) / 2) * raster_um / 1000.0, dtype=np.float64)
    return Grid(at_mm[None, :], at_mm[:, None], raster_um)


def towards(azimuth_deg: float) -> tuple[float, float]:
    """Unit vector (x, y) at an azimuth counter-clockwise from +x."""
    return float(np.cos(np.radians(azimuth_deg))), float(np.sin(np.radians(azimuth_deg)))


def normals(part: PrintPart, grid: Grid, size_mm: float) -> Image:
    """(rows, cols, 3) unit normals of the sheet: curl, and dents.

    Where curl alone bends it, the normal leans by exactly ``curl_deg`` half a side away from the middle, and in
    proportion elsewhere: a sheet that curls across its diagonal leans 1.41 times as far in its corners.
    """
    across = towards(part.curl_azimuth_deg)
    lean = np.radians(part.curl_deg) * (across[0] * grid.x_mm + across[1] * grid.y_mm) / (0.5 * size_mm)
    slope = np.tan(lean)
    slope_x, slope_y = across[0] * slope, across[1] * slope
    for dent in part.dents:
        dx, dy = grid.x_mm - dent.x_mm, grid.y_mm - dent.y_mm
        sigma = 0.25 * dent.diameter_mm
        bell = np.tan(np.radians(dent.tilt_deg)) / sigma * np.exp(0.5 - 0.5 * (dx**2 + dy**2) / sigma**2)
        slope_x, slope_y = slope_x + bell * dx, slope_y + bell * dy
    lean_x, lean_y = np.broadcast_arrays(slope_x, slope_y)
    found = np.stack([lean_x, lean_y, np.ones_like(lean_x)], axis=-1)
    return np.asarray(found / np.linalg.norm(found, axis=-1, keepdims=True), dtype=np.float32)


def inked(part: PrintPart, grid: Grid, rng: np.random.Generator) -> FloatArray:
    """(rows, cols) share of the area under ink: coverage, less fine gaps, pinholes and spots."""
    share = np.full(grid.shape, part.coverage * (1.0 - part.missing_share))
    if part.pinhole_share > 0.0:
        share *= 1.0 - pinholes(part, grid, rng)
    for spot in part.spots:
        away_mm = np.hypot(grid.x_mm - spot.x_mm, grid.y_mm - spot.y_mm)
        inside = _edge(0.5 * spot.diameter_mm - away_mm, grid)
        share *= 1.0 - spot.missing_share * inside
    return share


def pinholes(part: PrintPart, grid: Grid, rng: np.random.Generator) -> FloatArray:
    """(rows, cols) share of every pixel that lies in a pinhole; holes fall anywhere and may overlap."""
    rows, cols = grid.shape
    each = np.pi / 4.0 * (part.pinhole_um / grid.raster_um) ** 2  # pixels
    # what holes at random places leave free is exp(-number · area) (Boolean model)
    wanted = -np.log1p(-part.pinhole_share) * rows * cols / each
    if part.pinhole_um <= grid.raster_um:
        hits = rng.poisson(wanted / (rows * cols), grid.shape)
        return np.asarray(1.0 - (1.0 - each) ** hits)
    # those whose middle lies just outside reach in as well
    radius = 0.5 * part.pinhole_um / grid.raster_um
    margin = int(radius + 1.0)
    count = rng.poisson(wanted * (1 + 2 * margin / rows) * (1 + 2 * margin / cols))
    found = np.zeros((rows + 4 * margin + 1, cols + 4 * margin + 1))
    reach = np.arange(-margin, margin + 1)
    for y, x in rng.random((count, 2)) * (rows + 2 * margin, cols + 2 * margin) + margin:
        row, col = round(y), round(x)
        away = np.hypot((reach + row - y)[:, None], (reach + col - x)[None, :])
        here = found[row - margin : row + margin + 1, col - margin : col + margin + 1]
        np.maximum(here, np.clip(radius - away + 0.5, 0.0, 1.0), out=here)
    return found[2 * margin : 2 * margin + rows, 2 * margin : 2 * margin + cols]


def grain(part: PrintPart, grid: Grid, rng: np.random.Generator) -> FloatArray:
    """(rows, cols) factor on the ink's brightness: mean 1, standard deviation ``grain_share``, never below 0."""
    if part.grain_share == 0.0:
        return np.ones(grid.shape)
    from scipy.ndimage import gaussian_filter  # noqa: PLC0415 - loads in half a second

    noise = gaussian_filter(
        rng.standard_normal(grid.shape), 0.5 * part.grain_um / grid.raster_um, mode="wrap"
    )
    noise -= noise.mean()
    return np.asarray(np.maximum(1.0 + part.grain_share * noise / noise.std(), 0.0))


def _edge(inside_mm: FloatArray, grid: Grid) -> FloatArray:
    """Share of a pixel on the inner side of an edge that lies so far away (positive inside)."""
    return np.asarray(np.clip(inside_mm * 1000.0 / grid.raster_um + 0.5, 0.0, 1.0))
