"""Reflectance of a height map by wave optics in given directions, over the spectrum of the light."""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.wave import fused
from anisoscope.sim.light.wave.halfvectors import HalfVector, half_vector
from anisoscope.sim.light.wave.surface import WaveSurface, sampling_of
from anisoscope.sim.light.wave.windows import Window


@dataclass(frozen=True)
class LightSpectrum:
    """What wavelengths the light has.

    Attributes:
        wavelengths_um: W wavelengths in µm.
        weights: W shares of the light that is detected; they are scaled to a sum of 1.

    Raises:
        ModelError: no wavelength, one that is no light, or weights that are none.
    """

    wavelengths_um: tuple[float, ...] = (0.55,)
    weights: tuple[float, ...] = (1.0,)

    def __post_init__(self) -> None:
        if not self.wavelengths_um or len(self.wavelengths_um) != len(self.weights):
            raise ModelError("the light needs one weight for every wavelength, and at least one")
        for wavelength in self.wavelengths_um:
            if not 0.1 <= wavelength <= 20.0:
                raise ModelError(f"a wavelength must be 100 to 20000 nm, not {1e3 * wavelength:g} nm")
        if not (min(self.weights) >= 0.0 and 0.0 < sum(self.weights) < float("inf")):
            raise ModelError("the weights of the wavelengths must not be negative, and not all zero")
        total = sum(self.weights)
        object.__setattr__(self, "weights", tuple(weight / total for weight in self.weights))

    @classmethod
    def led(cls, centre_nm: float, width_nm: float, count: int = 7) -> "LightSpectrum":
        """Gaussian spectrum of a light-emitting diode, full width at half maximum ``width_nm``, as ``count`` lines."""
        node, weight = np.polynomial.hermite_e.hermegauss(count)
        sigma = width_nm / (2.0 * np.sqrt(2.0 * np.log(2.0)))
        return cls(tuple((1e-3 * (centre_nm + sigma * node)).tolist()), tuple(weight.tolist()))

    @property
    def longest_um(self) -> float:
        """Longest wavelength that carries light."""
        return max(w for w, share in zip(self.wavelengths_um, self.weights, strict=True) if share > 0.0)

    @property
    def shortest_um(self) -> float:
        """Shortest wavelength that carries light."""
        return min(w for w, share in zip(self.wavelengths_um, self.weights, strict=True) if share > 0.0)


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
