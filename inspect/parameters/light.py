"""Wavelengths of the light."""

from dataclasses import dataclass

from anisoscope.base.errors import ModelError


@dataclass(frozen=True)
class LightSpectrum:
    """Spectrum of the light, as lines.

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
        import numpy as np  # noqa: PLC0415 - options and recipes are made without it

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
