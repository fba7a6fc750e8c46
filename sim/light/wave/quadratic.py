"""The exact quadratic form in double precision: what every faster way is tested against."""

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.light.wave.halfvectors import HalfVector
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Window


def modulation(surface: WaveSurface, half: HalfVector, wavelength_um: float) -> npt.NDArray[np.complex128]:
    """(rows, cols) wave exp(−ik·2h_z·z), shifted so that the direction is at frequency 0."""
    fx, fy = half.frequency(wavelength_um)
    rows, cols = surface.shape
    x = np.arange(cols) * surface.pixel_x_um
    y = np.zeros(1) if surface.is_profile else np.arange(rows) * surface.pixel_y_um
    turns = 2.0 * half.z / wavelength_um * surface.height_um.astype(np.float64)
    turns += fx * x[None, :] + fy * y[:, None]
    return np.asarray(np.exp(-2j * np.pi * turns))


def density(surface: WaveSurface, half: HalfVector, wavelength_um: float, window: Window) -> float:
    """Mean power spectrum as `fused.density`: R ∝ Σ aᴴ(p)·K(p − q)·a(q), all pairs of points summed one by one.

    K need not be separable. Takes (rows·cols)·rows·cols operations: for small surfaces.
    """
    wave = modulation(surface, half, wavelength_um)
    rows, cols = surface.shape
    lag_x: FloatArray = np.arange(1 - cols, cols, dtype=np.float64) * surface.pixel_x_um
    total = 0.0
    for dy in range(1 - rows, rows):
        upper, lower = wave[max(0, dy) : rows + min(0, dy)], wave[max(0, -dy) : rows - max(0, dy)]
        kernel = window.coherence(lag_x, np.array(dy * surface.pixel_y_um), wavelength_um, half.z)
        matrix = kernel[np.arange(cols)[:, None] - np.arange(cols)[None, :] + cols - 1]
        total += float(np.sum((upper @ matrix) * lower.conj()).real)
    pixel = surface.pixel_x_um if surface.is_profile else surface.pixel_x_um * surface.pixel_y_um
    return total * pixel**2 / surface.area_um2
