"""The colour of an ink as a table: under one light it depends on one number, so 256 entries replace 41 exponentials."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.colour.illuminant import VISIBLE_NM, Illuminant
from anisoscope.sim.light.colour.observer import xyz_weights
from anisoscope.sim.light.colour.spaces import linear_srgb
from anisoscope.sim.light.ink import tio2
from anisoscope.sim.light.ink.ink import Ink
from anisoscope.sim.light.ink.model import Model, spectral_term

ENTRIES = 256
TERMS = 9
"""Of a polynomial in place of a table."""
SERIES_TOLERANCE = 5e-6
"""How far a polynomial may be off, relative to the strongest channel there: ΔE2000 of 0.0005 at most."""


@dataclass(frozen=True, eq=False)
class InkTable:
    """Linear sRGB of what depends on wavelength in the BRDF of an ink, integrated under a light.

    The BRDF as a colour is D/4 (times G/(cosθi cosθo) for the standard models) times :meth:`at` of the argument.

    Attributes:
        ink: the ink.
        illuminant: name of the light.
        model: of the BRDF; it says what the argument is.
        rgb: (N, 3) at arguments that rise evenly from 0 to 1; negative where an ink is out of gamut.
    """

    ink: Ink
    illuminant: str
    model: Model
    rgb: FloatArray

    @cached_property
    def with_steps(self) -> npt.NDArray[np.float32]:
        """(N, 6) every entry, and how much it changes up to the next one; kernels need not look at two."""
        steps = np.diff(self.rgb, axis=0, append=self.rgb[-1:])
        return np.concatenate([self.rgb, steps], axis=1).astype(np.float32)

    @cached_property
    def series(self) -> npt.NDArray[np.float32] | None:
        """(3, TERMS) polynomials of 2·argument − 1 equivalent to the table, lowest power first.

        None where no polynomial follows the entries; c of ±3 still has one. Fitted to all entries, each as close as it
        is bright.
        """
        powers = np.linspace(-1.0, 1.0, len(self.rgb))[:, None] ** np.arange(TERMS)
        strongest = np.abs(self.rgb).max(axis=1, keepdims=True)
        if len(self.rgb) < 4 * TERMS or not np.all(strongest > 0.0):
            return None
        found = np.linalg.lstsq(powers / strongest, self.rgb / strongest, rcond=None)[0].astype(np.float32)
        off = np.abs(powers @ found - self.rgb) / strongest
        return None if off.max() > SERIES_TOLERANCE else np.ascontiguousarray(found.T)

    def at(self, argument: FloatArray) -> FloatArray:
        """(…, 3) colours at (…,) arguments in [0, 1], linear between the entries."""
        position = np.clip(argument, 0.0, 1.0) * (len(self.rgb) - 1)
        index = np.minimum(position.astype(np.intp), len(self.rgb) - 2)
        share = (position - index)[..., None]
        return np.asarray((1.0 - share) * self.rgb[index] + share * self.rgb[index + 1])


@lru_cache(maxsize=64)
def ink_table(
    ink: Ink,
    illuminant: Illuminant,
    model: Model = "goniochromatic",
    *,
    tio2_source: str = tio2.DEFAULT,
    entries: int = ENTRIES,
) -> InkTable:
    """Table of one ink under one light; the same arguments give the same table.

    Raises:
        ModelError: wavelengths that give no colour, a model or data set that is not known, or fewer than two entries.
    """
    if entries < 2:
        raise ModelError(f"a table needs two entries or more, not {entries}")
    weights = xyz_weights(illuminant, ink.nm)
    seen = _seen(weights)
    term = spectral_term(_part(ink, seen), np.linspace(0.0, 1.0, entries), model, tio2_source=tio2_source)
    rgb = linear_srgb(term @ weights[seen])
    rgb.flags.writeable = False
    return InkTable(ink, illuminant.name, model, rgb)


def _seen(weights: FloatArray) -> slice:
    """The wavelengths that make colour: those beyond weigh nothing, and what TiO2 does there is not known."""
    lit = np.flatnonzero(weights.any(axis=1))
    return slice(int(lit[0]), int(lit[-1]) + 1)


def _part(ink: Ink, seen: slice) -> Ink:
    """The ink at these wavelengths; an outermost one just beyond the visible counts as its edge."""
    nm = tuple(float(value) for value in np.clip(ink.wavelengths_nm[seen], *VISIBLE_NM))
    return replace(ink, wavelengths_nm=nm, rho=ink.rho[seen], c=ink.c[seen])
