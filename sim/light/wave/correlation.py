"""Reflectance through windows much wider than the lines of the spectrum: correlation at short distances.

Where unresolved roughness leaves light coherent over a few µm only, pairs of points further apart do not matter. The
correlation of the wave at the distances that do is taken once for each h_z and wavelength, from overlapping tiles, and
then serves every direction and every roughness.

Many directions that share h_z and wavelength take one zero-padded FFT. The power spectrum of the whole dot is blurred
by the window exactly: its transform, the correlation of the wave, is multiplied with the coherence at every distance.
Without the padding the far edges of the dot would interfere, which spoils weak directions.
"""

from dataclasses import dataclass, replace
from typing import Literal, cast

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light import threads
from anisoscope.sim.light.wave.gpu import fft_length, library
from anisoscope.sim.light.wave.halfvectors import HalfVector
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Window

Floats = npt.NDArray[np.float32]

PADDING = 2.0
_ROWS = 256


@dataclass(frozen=True, eq=False)
class AngularMap:
    """Mean power spectrum over directions.

    Attributes:
        frequency_x: (X,) rising frequencies ω_x = 2·h_x/λ in cycles per µm.
        frequency_y: (Y,) the same along y; one 0 for a profile.
        density: (Y, X) in µm² (of a profile: µm); its sum times the areas of the bins is 1 up to what rounds off.
        wavelength_um: of the light.
        h_z: as given.
    """

    frequency_x: FloatArray
    frequency_y: FloatArray
    density: Floats
    wavelength_um: float
    h_z: float

    def at(self, h_x: FloatArray, h_y: FloatArray | None = None, order: Literal[1, 3] = 1) -> FloatArray:
        """Density at (N,) half vectors, by splines of an order between the bins; 0 beyond what the pixels resolve."""
        from scipy.ndimage import map_coordinates  # noqa: PLC0415 - slow to import

        x = 2.0 * np.asarray(h_x, dtype=np.float64) / self.wavelength_um
        y = 2.0 * np.asarray(0.0 if h_y is None else h_y, dtype=np.float64) / self.wavelength_um
        places = []
        for value, axis in ((y, self.frequency_y), (x, self.frequency_x)):
            step = float(axis[1] - axis[0]) if axis.size > 1 else np.inf
            places.append((value - axis[0]) / step)
        both = np.stack(np.broadcast_arrays(*places))
        density = np.asarray(self.density, dtype=np.float64)
        if self.frequency_y.size == 1:
            both, density = both[1:], density[0]
        return np.asarray(map_coordinates(density, both, order=order, mode="constant"))


def angular_map(
    surface: WaveSurface, wavelength_um: float, window: Window, h_z: float = 1.0, padding: float = PADDING
) -> AngularMap:
    """Blurred power spectrum at all frequencies that the pixels resolve.

    ``padding`` of 1 takes the map for a unit that repeats, other values below 2 let the edges of the dot interfere.
    A map of 4096² points takes about 1.3 GB.
    """
    on = library()
    rows, cols = surface.shape
    lengths = [n if 1 in (n, padding) else fft_length(int(np.ceil(padding * n))) for n in (rows, cols)]
    spectrum = on.fft.fft2(wave(surface, 2.0 * h_z / wavelength_um), s=tuple(lengths), **on.fft_options)
    power = spectrum.real**2 + spectrum.imag**2
    del spectrum
    pixels = (1.0 if surface.is_profile else surface.pixel_y_um), surface.pixel_x_um
    lags = [on.xp.asarray(_lags(n, pixel)) for n, pixel in zip(lengths, pixels, strict=True)]
    correlation = on.fft.rfft2(power, overwrite_x=True, **on.fft_options)
    half = lengths[1] // 2 + 1
    for start in range(0, lengths[0], _ROWS):
        part = slice(start, start + _ROWS)
        correlation[part] *= window.coherence(
            lags[1][None, :half], lags[0][part, None], wavelength_um, h_z
        ).astype(np.float32)
    blurred = on.fft.irfft2(correlation, s=tuple(lengths), overwrite_x=True, **on.fft_options)
    scale = (surface.pixel_x_um * (1.0 if surface.is_profile else surface.pixel_y_um)) ** 2 / surface.area_um2
    blurred *= np.float32(scale)
    fy, fx = (np.fft.fftshift(np.fft.fftfreq(n, pixel)) for n, pixel in zip(lengths, pixels, strict=True))
    density: Floats = on.host(on.fft.fftshift(blurred))
    if surface.cells:
        density *= (np.sinc(fx * surface.pixel_x_um) ** 2).astype(np.float32)
        if not surface.is_profile:
            density *= (np.sinc(fy * surface.pixel_y_um) ** 2).astype(np.float32)[:, None]
    return AngularMap(fx, fy, density, wavelength_um, h_z)


PHASE_STEP = 0.25
"""Rms change of the phase in radians from one h_z to the next, between which densities are interpolated."""

MOST_RUNGS = 64
ORDERS = 8
"""Of a unit that repeats: points of the spectrum in half of what blurs it."""
BYTES_A_POINT = 20
MOST_BYTES = 6 * 2**30


class DensityLadder:
    """Densities over directions whose h_z differ: angular maps at several h_z, linear in between.

    The phase of the wave is proportional to h_z·z: the deeper the surface, the more maps a range of h_z takes.

    Args:
        surface: the heights.
        wavelength_um: of the light.
        window: what blurs.
        h_z: smallest and largest z component of the half vectors to come.
        periodic: the map is one unit of a surface that repeats.

    Raises:
        ModelError: more maps than 64, or more memory than 6 GB: the message says how much.
    """

    def __init__(
        self,
        surface: WaveSurface,
        wavelength_um: float,
        window: Window,
        h_z: tuple[float, float],
        *,
        periodic: bool = False,
    ) -> None:
        self.padding = 1.0 if periodic else PADDING
        repeats = _repeats(surface, window.half_width(wavelength_um, h_z[1])) if periodic else (1, 1)
        rows, cols = (n * count for n, count in zip(surface.shape, repeats, strict=True))
        padded = self.padding * cols * (1 if rows == 1 else self.padding * rows)
        if padded * BYTES_A_POINT > MOST_BYTES:
            raise ModelError(
                f"a map of {cols} × {rows} pixels takes {padded * BYTES_A_POINT / 2**30:.1f} GB for all directions, at "
                f"most {MOST_BYTES / 2**30:g} GB are taken: crop it (anisoscope profile crop) or resample it"
            )
        rms = float(surface.height_um.std())
        step = PHASE_STEP * wavelength_um / (4.0 * np.pi * max(rms, 1e-9))
        count = 1 + int(np.ceil(max(h_z[1] - h_z[0], 0.0) / step))
        if count > MOST_RUNGS:
            raise ModelError(
                f"heights of {rms:.3g} µm rms need {count} maps of h_z for these directions, at most {MOST_RUNGS} are "
                "computed: take a smaller range of directions, or a longer wavelength"
            )
        if repeats != (1, 1):
            tiled = np.ascontiguousarray(np.tile(surface.height_um, repeats))
            surface = replace(surface, height_um=tiled)
        self.surface, self.wavelength_um, self.window = surface, wavelength_um, window
        self.h_z = np.linspace(h_z[0], h_z[1], count) if count > 1 else np.array([0.5 * (h_z[0] + h_z[1])])

    def at(self, h_x: FloatArray, h_y: FloatArray, h_z: FloatArray) -> FloatArray:
        """Density in µm² (of a profile: µm) at (…) half vectors; each map is computed when it is due, then dropped."""
        x, y, z = np.broadcast_arrays(h_x, h_y, h_z)
        found = np.zeros(x.shape)
        place = np.interp(z, self.h_z, np.arange(self.h_z.size))
        for number, rung in enumerate(self.h_z):
            weight = np.clip(1.0 - np.abs(place - number), 0.0, 1.0)
            due = weight > 0.0
            if due.any():
                spread = angular_map(self.surface, self.wavelength_um, self.window, float(rung), self.padding)
                found[due] += weight[due] * spread.at(x[due], y[due], order=3)
        return found


def _repeats(surface: WaveSurface, half_width: tuple[float, float]) -> tuple[int, int]:
    """Units along y and x whose spectrum has `ORDERS` points in half of the window, so that splines are smooth."""
    rows, cols = surface.shape
    lengths = rows * surface.pixel_y_um, cols * surface.pixel_x_um
    wide = (max(one, 1e-9) for one in half_width[::-1])
    along_y, along_x = (int(np.ceil(ORDERS / (w * length))) for w, length in zip(wide, lengths, strict=True))
    return 1 if surface.is_profile else along_y, along_x


def wave(surface: WaveSurface, cycles_per_um: float) -> npt.NDArray[np.complex64]:
    """(rows, cols) complex64 exp(−2πi·cycles·z), without a complex exponential; on the graphics card if it is used."""
    on = library()
    turns = on.heights(surface) * np.float32(cycles_per_um)
    turns -= on.xp.rint(turns)
    turns *= np.float32(-2.0 * np.pi)
    found = on.xp.empty(turns.shape, dtype=np.complex64)
    on.xp.cos(turns, out=found.real)
    on.xp.sin(turns, out=found.imag)
    return cast("npt.NDArray[np.complex64]", found)


def _lags(count: int, pixel_um: float) -> FloatArray:
    """(count,) distances in µm in the order of an FFT."""
    index = np.arange(count)
    return np.where(index <= count // 2, index, index - count) * pixel_um


ComplexArray = npt.NDArray[np.complex128]

REACH = 5.0
"""Standard deviations of the coherence that are counted."""

TILE_REACHES = 8
"""Side of a tile in multiples of the largest distance."""


@dataclass(frozen=True, eq=False)
class Correlation:
    """Mean of a(p)·a*(p − Δ) over a surface.

    Attributes:
        values: (2·reach_y + 1, 2·reach_x + 1) complex; 1 in the middle.
        x_um: (2·reach_x + 1,) distances in µm.
        y_um: (2·reach_y + 1,) distances in µm; one 0 for a profile.
        wavelength_um: of the light.
        h_z: as given.
    """

    values: ComplexArray
    x_um: FloatArray
    y_um: FloatArray
    wavelength_um: float
    h_z: float

    def extruded_density(self, half: HalfVector, window: Window) -> float:
        """Density in µm² of the surface that a profile drawn out endlessly along y makes."""
        fx, fy = half.frequency(self.wavelength_um)
        reach = reach_um(window, self.wavelength_um, self.h_z)[1]
        highest = window.half_width(self.wavelength_um, self.h_z)[1] + abs(fy)
        count = 2 * int(np.ceil(2.0 * reach * highest)) + 17
        y = np.linspace(-reach, reach, count)
        kernel = window.coherence(self.x_um[None, :], y[:, None], self.wavelength_um, self.h_z)
        along = np.exp(-2j * np.pi * fy * y) @ kernel * (y[1] - y[0])
        turned = self.values[0] * along * np.exp(-2j * np.pi * fx * self.x_um)
        return float(turned.sum().real) * float(self.x_um[1] - self.x_um[0])

    def density(self, half: HalfVector, window: Window) -> float:
        """Blurred mean power spectrum in one direction as `fused.density`, in µm² (of a profile: µm)."""
        fx, fy = half.frequency(self.wavelength_um)
        kernel = window.coherence(self.x_um[None, :], self.y_um[:, None], self.wavelength_um, self.h_z)
        turned = np.exp(-2j * np.pi * fy * self.y_um) @ (self.values * kernel)
        found = turned @ np.exp(-2j * np.pi * fx * self.x_um)
        pixels = [float(lags[1] - lags[0]) for lags in (self.x_um, self.y_um) if lags.size > 1]
        return float(found.real) * float(np.prod(pixels))

    def of_cells(self, times: int) -> "Correlation":
        """At ``times`` as many distances, for heights that hold for whole pixels: there it is linear in between."""
        if times == 1:
            return self
        values, lags = self.values, [self.y_um, self.x_um]
        for axis, coarse in enumerate(lags):
            if coarse.size == 1:
                continue
            fine = np.arange((coarse.size - 1) * times + 1) / times
            low = np.minimum(fine.astype(int), coarse.size - 2)
            share = np.moveaxis(np.atleast_2d(fine - low), -1, axis)
            before, after = (np.take(values, low + more, axis=axis) for more in (0, 1))
            values = before + share * (after - before)
            lags[axis] = coarse[0] + fine * float(coarse[1] - coarse[0])
        return Correlation(values, lags[1], lags[0], self.wavelength_um, self.h_z)


def reach_um(window: Window, wavelength_um: float, h_z: float) -> tuple[float, float]:
    """Distances along x and y from which on unresolved roughness leaves no coherence worth counting.

    Raises:
        ModelError: the window has no roughness; source and aperture alone leave some coherence at any distance.
    """
    if window.slope_variance is None:
        raise ModelError("short distances suffice only where roughness below the pixels blurs: give it one")
    x, y = (
        np.sqrt(np.diag(np.linalg.inv(window.slope_variance))) * REACH * wavelength_um / (4.0 * np.pi * h_z)
    )
    return float(x), float(y)


def correlation_of(
    surface: WaveSurface,
    wavelength_um: float,
    h_z: float,
    reach_um: tuple[float, float],
    *,
    endless: bool = False,
) -> Correlation:
    """Correlation up to distances (x, y).

    With ``endless`` the surface goes on beyond its edges like within them: the mean runs over the pairs of points that
    there are. Else it is a dot of its size, whose edges diffract too.

    Tiles overlap by half, weighed by the root of a Hann window each way; what the weights take off at a distance
    is given back, so that a surface that repeats within a tile is exact.
    """
    rows, cols = surface.shape
    cycles = 2.0 * h_z / wavelength_um
    reach_x = min(int(np.ceil(reach_um[0] / surface.pixel_x_um)), cols - 1)
    reach_y = 0 if surface.is_profile else min(int(np.ceil(reach_um[1] / surface.pixel_y_um)), rows - 1)
    sides = [_side(count, reach) for count, reach in ((rows, reach_y), (cols, reach_x))]
    tapers = [_taper(side, side < count) for side, count in zip(sides, (rows, cols), strict=True)]
    starts = [_starts(count, side) for count, side in zip((rows, cols), sides, strict=True)]
    places = [(y, x) for y in starts[0] for x in starts[1]]

    def run(place: tuple[int, int]) -> ComplexArray:
        return _tile(surface, cycles, place, tapers, (reach_y, reach_x))

    tiles = map(run, places) if library().is_card else threads.each(run, places)
    total: ComplexArray = np.asarray(sum(tiles), dtype=np.complex128)
    total = total / _overlap(rows, starts[0], tapers[0], reach_y, endless=endless)[:, None]
    total = total / _overlap(cols, starts[1], tapers[1], reach_x, endless=endless)
    x = np.arange(-reach_x, reach_x + 1, dtype=np.float64) * surface.pixel_x_um
    y = np.arange(-reach_y, reach_y + 1, dtype=np.float64) * (
        1.0 if surface.is_profile else surface.pixel_y_um
    )
    return Correlation(total, np.asarray(x), np.asarray(y), wavelength_um, h_z)


def _side(count: int, reach: int) -> int:
    side = max(TILE_REACHES * reach, 256)
    side += side % 2
    return count if 2 * side >= count else side


def _taper(side: int, tapered: bool) -> FloatArray:
    return np.sin(np.pi * (np.arange(side) + 0.5) / side) if tapered else np.ones(side)


def _starts(count: int, side: int) -> list[int]:
    return [0] if side == count else list(range(-side // 2, count, side // 2))


def _tile(
    surface: WaveSurface,
    cycles: float,
    place: tuple[int, int],
    tapers: list[FloatArray],
    reach: tuple[int, int],
) -> ComplexArray:
    """Sums of w·a(p)·w·a*(p − Δ) over one tile."""
    on = library()
    cut = [
        slice(max(0, start), min(count, start + taper.size))
        for start, taper, count in zip(place, tapers, surface.shape, strict=True)
    ]
    clipped = [
        taper[part.start - start : part.stop - start].astype(np.float32)
        for start, taper, part in zip(place, tapers, cut, strict=True)
    ]
    part = WaveSurface(surface.height_um[cut[0], cut[1]], surface.pixel_x_um, surface.pixel_y_um)
    weight_y, weight_x = (on.xp.asarray(weights) for weights in clipped)
    field = wave(part, cycles) * weight_y[:, None] * weight_x
    lengths = tuple(fft_length(n + r) for n, r in zip(field.shape, reach, strict=True))
    spectrum = on.fft.fft2(field, s=lengths)
    found = on.fft.ifft2(spectrum.real**2 + spectrum.imag**2)
    rows, cols = (np.arange(-r, r + 1) for r in reach)
    return np.asarray(on.host(found[on.xp.ix_(rows, cols)]), dtype=np.complex128)


def _overlap(count: int, starts: list[int], taper: FloatArray, reach: int, *, endless: bool) -> FloatArray:
    """(2·reach + 1,) sums of w·w over pairs of points at every distance: what a constant wave gives.

    Of a dot only what the weights take off is given back: fewer pairs at larger distances are in the nature of a dot.
    """
    lags = np.arange(reach + 1)
    given = np.zeros(reach + 1)
    for start in starts:
        w = taper[max(0, -start) : max(0, min(taper.size, count - start))]
        if w.size:
            given += [float(w[lag:] @ w[: w.size - lag]) if lag < w.size else 0.0 for lag in lags]
    total = given if endless else given * count / (count - lags)
    return np.concatenate([total[:0:-1], total])
