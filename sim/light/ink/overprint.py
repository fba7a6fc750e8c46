"""Inks printed one over another, as one ink.

Coated mica does not absorb: what the upper film does not reflect goes through it, to the lower ink and back,

    f = f_upper + (1 − A_upper(θi)) (1 − A_upper(θo)) f_lower,

with the directional albedo A of the upper ink. Light that goes back and forth between the films more than once, and
what a film blurs, is left out. The spectra of the mirror direction are then those of Eq. 5 of Pranovich 2024, fitted in
ln f: an overprint is an ink as the others, and a measured one can stand in its place.
"""

from collections.abc import Sequence
from functools import reduce

import numpy as np

from anisoscope.base.errors import ModelError
from anisoscope.sim.light.ink.angles import shift
from anisoscope.sim.light.ink.ink import Ink
from anisoscope.sim.light.ink.model import directional_albedo

FITTED_DEG = tuple(float(angle) for angle in range(0, 71, 10))
DARK = 1e-6


def overprint(inks: Sequence[Ink]) -> Ink:
    """Inks on top of each other, the first one below, as one ink in 1/sr on the wavelengths of the last.

    Raises:
        ModelError: no ink, or one that is brushed or has another distribution of normals than the others.
    """
    if not inks:
        raise ModelError("an overprint needs an ink")
    for ink in inks:
        if not ink.isotropic or ink.distribution != inks[0].distribution:
            raise ModelError(
                f"{ink.name}: overprints are modelled of isotropic inks with one distribution of normals; give a "
                "measured one"
            )
    return reduce(_over, inks)


def _over(lower: Ink, upper: Ink) -> Ink:
    angles, nm = np.array(FITTED_DEG), upper.nm
    cosine = np.cos(np.radians(angles))
    x = shift(cosine, cosine)
    through = np.square(1.0 - np.minimum(directional_albedo(upper, angles, shares=24, azimuths=32), 1.0))
    rho, c = (np.interp(nm, lower.nm, values) for values in (lower.rho_brdf, lower.c_values))
    above = upper.rho_brdf * np.exp(np.outer(x, upper.c_values)) / upper.alpha**2
    below = through * rho * np.exp(np.outer(x, c)) / lower.alpha**2
    flux = float(above.sum() * upper.alpha**2), float(below.sum() * lower.alpha**2)
    alpha = (flux[0] * upper.alpha + flux[1] * lower.alpha) / max(sum(flux), DARK)
    slope, start = np.polyfit(x, np.log(np.maximum((above + below) * alpha**2, DARK)), 1)
    return Ink(
        f"{upper.name} over {lower.name}", float(alpha), tuple(nm.tolist()), tuple(np.exp(start).tolist()),
        tuple(slope.tolist()), source="modelled: what the upper ink does not reflect reaches the lower one",
        distribution=upper.distribution,
    )  # fmt: skip
