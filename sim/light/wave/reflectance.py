"""Reflectance of a height map by wave optics in given directions, over the spectrum of the light."""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.light import LightSpectrum
from anisoscope.sim.light.wave import fused
from anisoscope.sim.light.wave.halfvectors import HalfVector, half_vector
from anisoscope.sim.light.wave.surface import WaveSurface, sampling_of
from anisoscope.sim.light.wave.windows import Window


def radiance_scale(half: HalfVector, wavelength_um: float, dimensions: int = 2) -> float:
    """γ²/v_z: radiance per unit irradiance perpendicular to the beam for a spectral density of 1.

    In 1/sr per µm² (of a profile: 1/rad per µm). Source: Levin et al. 2013, Eq. 2, 5 and 23; BRDF·l_z is the radiance.
    """
    return half.gamma(wavelength_um, dimensions) ** 2 / half.camera_z


def radiance(
    surface: WaveSurface,
    to_light: FloatArray,
    to_camera: FloatArray,
    window: Window,
    light: LightSpectrum | None = None,
    *,
    check: bool = True,
) -> FloatArray:
    """Radiance per unit irradiance perpendicular to the beam of a perfectly reflecting surface.

    Args:
        surface: the heights.
        to_light: (P, 3) unit vectors in the frame of the sample.
        to_camera: (P, 3) unit vectors in the frame of the sample.
        window: what blurs; a point source and a point aperture give coherent reflectance.
        light: the wavelengths; 550 nm by default.
        check: refuse a map that samples the phase too coarsely.

    Returns:
        (P,) in 1/sr, of a profile in 1/rad: the mean over the surface. No shadows, no polarisation.

    Raises:
        HeightMapError: too many pixels change the phase by more than half a turn.
        ModelError: light or camera at or below the horizon.
    """
    lines = LightSpectrum() if light is None else light
    halves = [
        half_vector(i, o) for i, o in zip(np.atleast_2d(to_light), np.atleast_2d(to_camera), strict=True)
    ]
    if check:
        sampling_of(surface, lines.shortest_um, max(half.z for half in halves)).check()
    dimensions = 1 if surface.is_profile else 2
    return np.array(
        [
            sum(
                share
                * radiance_scale(half, wavelength, dimensions)
                * fused.density(surface, half, wavelength, window)
                for wavelength, share in zip(lines.wavelengths_um, lines.weights, strict=True)
                if share > 0.0
            )
            for half in halves
        ]
    )


def brdf(
    surface: WaveSurface,
    to_light: FloatArray,
    to_camera: FloatArray,
    window: Window,
    light: LightSpectrum | None = None,
) -> FloatArray:
    """(P,) BRDF in 1/sr (of a profile: 1/rad): radiance over l_z; arguments and errors as for :func:`radiance`."""
    cosine = np.atleast_2d(to_light)[:, 2]
    return radiance(surface, to_light, to_camera, window, light) / cosine
