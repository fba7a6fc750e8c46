"""Reflectance in many directions that share h_z and wavelength: one zero-padded FFT.

The power spectrum of the whole dot is blurred by the window exactly: its transform, the correlation of the wave, is
multiplied with the coherence at every distance. Without the padding the far edges of the dot would interfere, which
spoils weak directions.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.light import threads
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

    def at(self, h_x: FloatArray, h_y: FloatArray | None = None) -> FloatArray:
        """Density at (N,) half vectors, linear between the bins; 0 beyond what the pixels resolve."""
        from scipy.interpolate import RegularGridInterpolator  # noqa: PLC0415 - slow to import

        x = 2.0 * np.asarray(h_x, dtype=np.float64) / self.wavelength_um
        if self.frequency_y.size == 1:
            line = np.asarray(self.density[0], dtype=np.float64)
            return np.asarray(np.interp(x, self.frequency_x, line, left=0.0, right=0.0))
        y = 2.0 * np.asarray(0.0 if h_y is None else h_y, dtype=np.float64) / self.wavelength_um
        grid = RegularGridInterpolator(
            (self.frequency_y, self.frequency_x), self.density, bounds_error=False, fill_value=0.0
        )
        return np.asarray(grid(np.stack(np.broadcast_arrays(y, x), axis=-1)))


def angular_map(
    surface: WaveSurface, wavelength_um: float, window: Window, h_z: float = 1.0, padding: float = PADDING
) -> AngularMap:
    """Blurred power spectrum at all frequencies that the pixels resolve.

    ``padding`` below 2 lets the edges of the dot interfere (for tests). A map of 4096² points takes about 1.3 GB.
    """
    from scipy import fft  # noqa: PLC0415 - slow to import

    rows, cols = surface.shape
    lengths = [1 if n == 1 else fft.next_fast_len(int(np.ceil(padding * n))) for n in (rows, cols)]
    power = _power(surface, 2.0 * h_z / wavelength_um, lengths)
    pixels = (1.0 if surface.is_profile else surface.pixel_y_um), surface.pixel_x_um
    lags = [_lags(n, pixel) for n, pixel in zip(lengths, pixels, strict=True)]
    correlation = fft.rfft2(power, workers=threads.count(), overwrite_x=True)
    half = lengths[1] // 2 + 1
    for start in range(0, lengths[0], _ROWS):
        part = slice(start, start + _ROWS)
        correlation[part] *= window.coherence(
            lags[1][None, :half], lags[0][part, None], wavelength_um, h_z
        ).astype(np.float32)
    blurred = fft.irfft2(correlation, s=tuple(lengths), workers=threads.count(), overwrite_x=True)
    scale = (surface.pixel_x_um * (1.0 if surface.is_profile else surface.pixel_y_um)) ** 2 / surface.area_um2
    blurred *= np.float32(scale)
    fy, fx = (fft.fftshift(fft.fftfreq(n, pixel)) for n, pixel in zip(lengths, pixels, strict=True))
    density: Floats = fft.fftshift(blurred)
    if surface.cells:
        density *= (np.sinc(fx * surface.pixel_x_um) ** 2).astype(np.float32)
        if not surface.is_profile:
            density *= (np.sinc(fy * surface.pixel_y_um) ** 2).astype(np.float32)[:, None]
    return AngularMap(fx, fy, density, wavelength_um, h_z)


def wave(surface: WaveSurface, cycles_per_um: float) -> npt.NDArray[np.complex64]:
    """(rows, cols) exp(−2πi·cycles·z) in single precision, without a complex exponential."""
    turns = surface.height_um * np.float32(cycles_per_um)
    turns -= np.rint(turns)
    turns *= np.float32(-2.0 * np.pi)
    found = np.empty(turns.shape, dtype=np.complex64)
    np.cos(turns, out=found.real)
    np.sin(turns, out=found.imag)
    return found


def _power(surface: WaveSurface, cycles_per_um: float, lengths: list[int]) -> Floats:
    from scipy import fft  # noqa: PLC0415 - slow to import

    spectrum = fft.fft2(wave(surface, cycles_per_um), s=tuple(lengths), workers=threads.count())
    return np.asarray(spectrum.real**2 + spectrum.imag**2)


def _lags(count: int, pixel_um: float) -> FloatArray:
    """(count,) distances in µm in the order of an FFT."""
    index = np.arange(count)
    return np.where(index <= count // 2, index, index - count) * pixel_um
