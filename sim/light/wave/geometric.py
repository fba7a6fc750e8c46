"""The geometric limit: every point of the surface a mirror of its own slope.

A facet of slope s shines at ω = −2h_z·s/λ; blurred by the same window, this is what the blurred power spectrum
approaches as structures grow against the coherence length (Levin et al. 2013, Fig. 2).
"""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.wave.windows import Window


def slope_density(
    height_um: FloatArray,
    pixel_um: float,
    frequency: FloatArray,
    wavelength_um: float,
    window: Window,
    h_z: float = 1.0,
) -> FloatArray:
    """Density of the slopes of a profile over ω, blurred by a window, in µm.

    Args:
        height_um: (N,) heights; the slope of every stretch between two of them counts once.
        pixel_um: distance of the points in µm.
        frequency: (F,) rising, evenly spaced frequencies in cycles per µm; slopes beyond them are left out.
        wavelength_um: of the light.
        window: what blurs; some blur along x is needed.
        h_z: z component of h.

    Raises:
        ModelError: nothing blurs; the density would be a comb of infinite lines.
    """
    reach = window.half_width(wavelength_um, h_z)[0]
    if reach <= 0.0:
        raise ModelError(
            "mirrors under a point source shine in single directions: give source or aperture a size"
        )
    mirrored = -2.0 * h_z / wavelength_um * np.diff(height_um) / pixel_um
    spacing = float(frequency[1] - frequency[0])
    share, _ = np.histogram(mirrored, np.append(frequency - 0.5 * spacing, frequency[-1] + 0.5 * spacing))
    lags = np.asarray(np.fft.fftfreq(2 * frequency.size, spacing), dtype=np.float64)
    coherence = window.coherence(lags, np.zeros(1), wavelength_um, h_z)
    found = np.fft.ifft(np.fft.fft(share, 2 * frequency.size) * coherence)[: frequency.size]
    return np.asarray(found.real / (mirrored.size * spacing))
