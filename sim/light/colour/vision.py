"""What a camera makes of spectra: the sensitivities of its channels under a lamp.

A channel counts photons: its response to light of spectral power S(λ) and spectral reflectance or BRDF f(λ) is
∫ f(λ) S(λ) λ q(λ) dλ, with q the quantum efficiency of the pixels behind its filter (EMVA 1288, Eq. 1 to 3). Here
channels are means of f over wavelength: whatever is grey gives the same number in every channel.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.colour.illuminant import NEEDED_NM, VISIBLE_NM, Illuminant
from anisoscope.sim.light.colour.lamps import STEP_NM, skewed
from anisoscope.sim.light.colour.observer import shares_of_points


@dataclass(frozen=True)
class Sensitivities:
    """Relative quantum efficiency of a camera's channels, linear between its points, its end values held beyond.

    Attributes:
        name: for people.
        wavelengths_nm: (N,) rising, from 400 nm or less to 700 nm or more.
        curves: one (N,) curve a channel: red, green and blue, or a single one of a camera without filters.

    Raises:
        ModelError: wavelengths that do not rise or do not reach far enough; a curve that is negative, not finite,
            nothing but zero, or of another length; neither one curve nor three.
    """

    name: str
    wavelengths_nm: tuple[float, ...]
    curves: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        nm = np.array(self.wavelengths_nm, dtype=np.float64)
        steps = np.diff(nm)
        if steps.size == 0 or not np.all((steps > 0.0) & np.isfinite(steps)):
            raise ModelError(f"sensitivities {self.name}: the wavelengths must be finite and rise")
        if nm[0] > NEEDED_NM[0] or nm[-1] < NEEDED_NM[1]:
            raise ModelError(
                f"sensitivities {self.name}: they reach from {nm[0]:g} to {nm[-1]:g} nm; at least "
                f"{NEEDED_NM[0]:g} to {NEEDED_NM[1]:g} nm are needed"
            )
        if len(self.curves) not in (1, 3):
            raise ModelError(
                f"sensitivities {self.name}: a camera has one channel or three, not {len(self.curves)}"
            )
        for curve in self.curves:
            if len(curve) != nm.size:
                raise ModelError(f"sensitivities {self.name}: a curve needs a value at every wavelength")
            if not np.all(np.isfinite(curve)) or min(curve) < 0.0 or max(curve) <= 0.0:
                raise ModelError(
                    f"sensitivities {self.name}: a curve must be finite, 0 or more, and not all zero"
                )


@dataclass(frozen=True)
class Vision:
    """A camera under a lamp.

    Raises:
        ModelError: a channel that sees nothing of the lamp.
    """

    illuminant: Illuminant
    sensitivities: Sensitivities

    def __post_init__(self) -> None:
        seen = self._photons()[1].sum(axis=0)
        if seen.min() <= 0.0:
            names = ("red", "green", "blue") if seen.size > 1 else ("only",)
            raise ModelError(
                f"the {names[int(seen.argmin())]} channel of {self.sensitivities.name} sees nothing of the light of "
                f"{self.illuminant.name}: correct the sensitivities or the spectrum"
            )

    def weights(self, wavelengths_nm: FloatArray) -> FloatArray:
        """(W, channels) weights whose sum with a spectrum at W wavelengths is what the channels see of it.

        The weights of every channel add up to 1. The spectrum counts as linear between its wavelengths and constant
        beyond them; lamp and sensitivities are integrated by 1 nm under it, as in
        :func:`anisoscope.sim.light.colour.observer.xyz_weights`.

        Raises:
            ModelError: wavelengths that do not rise, or do not reach from 400 to 700 nm.
        """
        fine, seen = self._photons()
        return np.asarray(shares_of_points(wavelengths_nm, fine) @ (seen / seen.sum(axis=0)))

    def strengths(self) -> FloatArray:
        """(channels,) response of the channels to white light; that of the strongest is 1."""
        total = self._photons()[1].sum(axis=0)
        return np.asarray(total / total.max())

    def _photons(self) -> tuple[FloatArray, FloatArray]:
        """(M,) wavelengths by 1 nm, and (M, channels) photons that count there, in any unit."""
        fine = np.arange(VISIBLE_NM[0], VISIBLE_NM[1] + 0.5)
        cell = np.ones_like(fine)
        cell[[0, -1]] = 0.5
        photons = self.illuminant.band_means(fine, 1.0) * cell * fine
        curves = [
            np.interp(fine, self.sensitivities.wavelengths_nm, curve) for curve in self.sensitivities.curves
        ]
        return fine, np.asarray(photons[:, None] * np.stack(curves, axis=-1))


def _synthetic(*, filters: bool) -> Sensitivities:
    nm = np.arange(VISIBLE_NM[0], VISIBLE_NM[1] + STEP_NM, STEP_NM)
    silicon = skewed(nm, 550.0, 110.0, 150.0)
    window = 1.0 / (1.0 + np.exp((404.0 - nm) / 5.0)) / (1.0 + np.exp((nm - 672.0) / 9.0))
    if not filters:
        return Sensitivities(
            "silicon (synthetic)", tuple(nm.tolist()), (tuple((0.62 * silicon * window).tolist()),)
        )
    passed = (
        0.04 + 0.88 / (1.0 + np.exp((583.0 - nm) / 8.0)) + 0.05 * skewed(nm, 420.0, 20.0, 25.0),
        0.05 + 0.85 * skewed(nm, 530.0, 34.0, 40.0),
        0.03 + 0.82 * skewed(nm, 456.0, 40.0, 32.0),
    )
    curves = tuple(tuple((0.62 * silicon * window * one).tolist()) for one in passed)
    return Sensitivities("Bayer filters (synthetic)", tuple(nm.tolist()), curves)


@cache
def synthetic_bayer() -> Sensitivities:
    """Red, green and blue of a synthetic colour sensor: dyes of smooth shape on silicon, behind an infrared cut.

    Neighbouring channels overlap by about a fifth and every dye leaks 3 to 5 % elsewhere, as data sheets of colour
    sensors show it; no sensor's own curves.
    """
    return _synthetic(filters=True)


@cache
def synthetic_silicon() -> Sensitivities:
    """The channel of a synthetic monochrome sensor behind the same infrared cut."""
    return _synthetic(filters=False)
