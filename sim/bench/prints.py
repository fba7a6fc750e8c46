"""A printed sheet as the bench photographs it: ink on a substrate, by the model of Pranovich 2024 (Eq. 5).

Radiance under a lamp of unit irradiance: cosθi (Σ over inks of w·f + (1 − Σ w)·ρ/π), with w the share of the area under
an ink, f its BRDF and ρ the reflectance of the substrate, each as the camera's channels see it. Fine dots are mixed in
radiance.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import AnisoscopeError, RigFileError
from anisoscope.sim.bench.printpart import PrintPart
from anisoscope.sim.light import threads
from anisoscope.sim.light.colour.vision import Vision
from anisoscope.sim.light.ink.angles import half_vector
from anisoscope.sim.light.ink.ink import Ink
from anisoscope.sim.light.ink.model import spectral_term
from anisoscope.sim.light.ink.shading import lobes, with_bases
from anisoscope.sim.materials.inks import find_ink
from anisoscope.sim.materials.spectra import read_reflectance

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
    """(rows, cols) share of every pixel covered by pinholes, which are placed at random and may overlap."""
    rows, cols = grid.shape
    each = np.pi / 4.0 * (part.pinhole_um / grid.raster_um) ** 2  # pixels
    # what holes at random places leave free is exp(-number · area) (Boolean model)
    expected_count = -np.log1p(-part.pinhole_share) * rows * cols / each
    if part.pinhole_um <= grid.raster_um:
        hits = rng.poisson(expected_count / (rows * cols), grid.shape)
        return np.asarray(1.0 - (1.0 - each) ** hits)
    # those whose middle lies just outside reach in as well
    radius = 0.5 * part.pinhole_um / grid.raster_um
    margin = int(radius + 1.0)
    count = rng.poisson(expected_count * (1 + 2 * margin / rows) * (1 + 2 * margin / cols))
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
    """Share of a pixel on the inner side of an edge at a signed distance (positive inside)."""
    return np.asarray(np.clip(inside_mm * 1000.0 / grid.raster_um + 0.5, 0.0, 1.0))


ENTRIES = 1024


def with_thicker_film(ink: Ink, shift_nm: float) -> Ink:
    """The ink with its spectra of ρ and c moved to longer wavelengths; what comes from beyond the ends is held."""
    if shift_nm == 0.0:
        return ink
    moved = ink.nm - shift_nm
    rho, c = (np.interp(moved, ink.nm, values) for values in (ink.rho, ink.c))
    return replace(ink, rho=tuple(rho.tolist()), c=tuple(c.tolist()))


def brushed(ink: Ink, anisotropy: float, brush_deg: float) -> Ink:
    """The ink with α across over α along the brushing as given; α_x·α_y stays, and so the brightness head-on.

    A brushing that the ink itself has is replaced.
    """
    if anisotropy == 1.0:
        return ink
    middle, stretch = np.sqrt(ink.alpha * ink.across), np.sqrt(anisotropy)
    return replace(ink, alpha=float(middle / stretch), alpha_y=float(middle * stretch), brush_deg=brush_deg)


def printed_ink(part: PrintPart) -> Ink:
    """The ink as it was printed, with the faults that concern all of it.

    Raises:
        RigFileError: there is no such ink, or it cannot be printed so.
    """
    ink = _found(part.ink, "ink")
    try:
        if part.alpha is not None:
            ink = replace(ink, alpha=part.alpha, alpha_y=None)
        if part.distribution is not None:
            ink = replace(ink, distribution=part.distribution)
        across = None if ink.alpha_y is None else ink.alpha_y * (1.0 + part.alpha_share)
        ink = replace(ink, alpha=ink.alpha * (1.0 + part.alpha_share), alpha_y=across)
        return brushed(with_thicker_film(ink, part.film_shift_nm), part.anisotropy, part.brush_deg)
    except AnisoscopeError as problem:
        raise RigFileError(f"sample.print: {problem}") from None


def _found(text: str, key: str) -> Ink:
    try:
        return find_ink(text)
    except AnisoscopeError as problem:
        raise RigFileError(f"sample.print.{key}: {problem}") from None


def _printed_inks(part: PrintPart) -> tuple[Ink, ...]:
    """The ink as it was printed, and the wrong one where some of it got among it.

    Raises:
        RigFileError: there is no such ink, or it cannot be printed so.
    """
    inks = (printed_ink(part),)
    if part.wrong_ink is None:
        return inks
    wrong = _found(part.wrong_ink, "wrong_ink")
    if part.wrong_share == 0.0:
        return inks
    return (*inks, wrong if part.distribution is None else replace(wrong, distribution=part.distribution))


def _tables(inks: tuple[Ink, ...], vision: Vision) -> Image:
    """(K, N, 6) tables of the inks; see `_table`.

    Raises:
        RigFileError: an ink whose wavelengths give no colour.
    """
    try:
        return np.stack([_table(ink, vision) for ink in inks])
    except AnisoscopeError as problem:
        raise RigFileError(f"sample.print: {problem}") from None


def check_print(part: PrintPart, vision: Vision) -> None:
    """Look up all that the table of a print names, so that a wrong name shows before the first picture.

    Raises:
        RigFileError: an ink or a spectrum that cannot be used; the message names the key.
    """
    _tables(_printed_inks(part), vision)
    _reflectance(part.substrate, vision)


class PrintSample:
    """A printed sheet.

    Args:
        part: the print.
        size_mm: side of the sheet.
        raster_um: size of its pixels, if the print does not say it.
        vision: the camera's channels under the lamp.
        rng: grain and pinholes.
        lamp_distance_mm: from the middle of the sheet to the lamp; None: far away.

    Raises:
        RigFileError: an ink or a spectrum that cannot be used.
    """

    def __init__(
        self,
        part: PrintPart,
        size_mm: float,
        raster_um: float,
        vision: Vision,
        rng: np.random.Generator,
        lamp_distance_mm: float | None = None,
    ) -> None:
        grid = grid_of(size_mm, part.raster_um or raster_um)
        self._grid, self._lamp_mm = grid, lamp_distance_mm
        self.pixel_um = (grid.raster_um, grid.raster_um)
        self.inks = _printed_inks(part)
        shares = [1.0 - part.wrong_share, part.wrong_share][: len(self.inks)]
        self._flakes = (np.radians(part.flake_tilt_deg), towards(part.flake_azimuth_deg))
        self._normal = normals(part, grid, size_mm)
        under_ink = inked(part, grid, rng)
        coverage = ((under_ink * grain(part, grid, rng))[..., None] * shares).astype(np.float32)
        self.inks, self._coverage = with_bases(self.inks, coverage)
        self._colours = _tables(self.inks, vision)
        paper = _reflectance(part.substrate, vision)
        self._channels = len(paper)
        self._bare = ((1.0 - under_ink) / np.pi).astype(np.float32)[None] * paper.astype(np.float32)[
            :, None, None
        ]

    def radiance(self, to_light: FloatArray, to_camera: FloatArray) -> Image:
        """(channels, rows, cols) radiance; see `anisoscope.sim.bench.bench.Sample`.

        A near lamp lights every place from a direction of its own, with the irradiance that the white tile takes out.
        Light changes smoothly with its direction: parabolas through those at three places each way.
        """
        if self._lamp_mm is None:
            return self._lit(to_light, to_camera)
        found = np.zeros((self._channels, *self._grid.shape), dtype=np.float32)
        for x_mm, of_column in _parabolas(self._grid.x_mm):
            for y_mm, of_row in _parabolas(self._grid.y_mm):
                way = self._lamp_mm * to_light - [x_mm, y_mm, 0.0]
                found += of_row * of_column * self._lit(way / np.linalg.norm(way), to_camera)
        return found

    def _lit(self, to_light: FloatArray, to_camera: FloatArray) -> Image:
        """(channels, rows, cols) radiance under light from one direction."""
        facing = self._normal @ to_light.astype(np.float32)
        seen = np.maximum(facing, np.float32(0.0)) * (self._normal @ to_camera.astype(np.float32) > 0.0)
        shine = np.moveaxis(self._shine(to_light, to_camera), -1, 0)[: self._channels]
        return np.asarray(shine + self._bare * seen, dtype=np.float32)

    def _shine(self, to_light: FloatArray, to_camera: FloatArray) -> Image:
        """(rows, cols, 3) light from the inks."""
        from anisoscope.sim.light.ink.kernels import SCRATCH, shade  # noqa: PLC0415 - loads the compiler

        half = shingled(half_vector(to_light, to_camera), *self._flakes)
        beams = np.array([[*to_light, *half, 0.25, 0.0]], dtype=np.float32)
        tangent = self._tangent()
        result = np.empty_like(self._normal)
        eye = tuple(np.float32(value) for value in to_camera)
        given = (self._coverage, eye, beams, lobes(self.inks), self._colours[None], False)

        def rows(share: tuple[int, int]) -> None:
            work = np.empty((SCRATCH, tangent.shape[1]), dtype=np.float32)
            shade(self._normal, tangent, *given, *share, work, result)  # type: ignore[arg-type]

        threads.each(rows, threads.runs(len(tangent), threads.count()))
        return result

    def _tangent(self) -> Image:
        """(rows, cols, 3) the direction on the sheet that was +x before it was bent."""
        if all(ink.isotropic for ink in self.inks):
            return self._normal
        x = -self._normal[..., :1] * self._normal
        x[..., 0] += 1.0
        return np.asarray(x / np.linalg.norm(x, axis=-1, keepdims=True), dtype=np.float32)


def _parabolas(at_mm: FloatArray) -> list[tuple[float, Image]]:
    """Three places on an axis of the raster, and the weight that each has at all of them (Lagrange)."""
    nodes = [float(at_mm.min()), 0.5 * float(at_mm.min() + at_mm.max()), float(at_mm.max())]
    found = []
    for node in nodes:
        factors = [(at_mm - other) / (node - other) for other in nodes if other != node]
        found.append((node, np.prod(factors, axis=0).astype(np.float32)))
    return found


def shingled(half: FloatArray, tilt_rad: float, side: tuple[float, float]) -> FloatArray:
    """(3,) half vector as flakes see it whose mean normal leans by an angle to the side of (x, y), a unit vector.

    The sheet's own normal stays. On a sheet that is bent as well, the order of the two small turns is left open: a
    degree of each makes a twist of 0.01° about the normal.
    """
    x, y = side
    along, across, up = x * half[0] + y * half[1], y * half[0] - x * half[1], half[2]
    cosine, sine = np.cos(tilt_rad), np.sin(tilt_rad)
    along, up = cosine * along - sine * up, sine * along + cosine * up
    return np.array([x * along + y * across, y * along - x * across, up])


def _table(ink: Ink, vision: Vision) -> Image:
    """(N, 6) what depends on wavelength in the BRDF of an ink, as three channels see it, and its steps.

    A camera without filters has the first channel only. The layout is that of `sim.light.ink.kernels.shade`.
    """
    term = spectral_term(ink, np.linspace(0.0, 1.0, ENTRIES), "goniochromatic")
    seen = term @ vision.weights(ink.nm)
    seen = np.pad(seen, ((0, 0), (0, 3 - seen.shape[1])))
    steps = np.diff(seen, axis=0, append=seen[-1:])
    return np.concatenate([seen, steps], axis=1).astype(np.float32)


def _reflectance(substrate: float | str, vision: Vision) -> FloatArray:
    """(channels,) reflectance of the sheet as the channels see it.

    Raises:
        RigFileError: there is no such file, or it holds no reflectance.
    """
    if isinstance(substrate, str):
        try:
            nm, share = read_reflectance(Path(substrate))
        except AnisoscopeError as problem:
            raise RigFileError(f"sample.print.substrate: {problem}") from None
    else:
        nm, share = np.array([380.0, 780.0]), np.full(2, substrate)
    return np.asarray(share @ vision.weights(nm))
