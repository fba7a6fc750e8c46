"""From spectra to XYZ: the CIE 1931 2° observer under an illuminant, as one set of weights.

Matching functions: CIE 018:2019 (ISO/CIE 11664-1), 1 nm, taken from colour-science 0.4.7 (BSD-3-Clause).
"""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.colour.illuminant import NEEDED_NM, VISIBLE_NM, Illuminant
from anisoscope.sim.light.colour.tables import package_table


def matching_functions() -> tuple[FloatArray, FloatArray]:
    """(401,) wavelengths from 380 to 780 nm, and (401, 3) x̄, ȳ, z̄ of the CIE 1931 2° observer."""
    numbers = package_table("anisoscope.sim.light.colour", "cie_1931_2deg.csv")[1]
    return numbers[:, 0], numbers[:, 1:]


def xyz_weights(illuminant: Illuminant, wavelengths_nm: FloatArray) -> FloatArray:
    """(W, 3) weights whose sum with a reflectance at W wavelengths is XYZ, Y = 1 for the perfect diffuser.

    The reflectance counts as linear between its wavelengths and constant beyond them; light and observer are
    integrated by 1 nm under it. So the 10 nm of a reflectance do not coarsen the lines of a lamp.

    Raises:
        ModelError: wavelengths that do not rise, or do not reach from 400 to 700 nm.
    """
    fine, matching = matching_functions()
    shares = shares_of_points(wavelengths_nm, fine)
    cell = np.ones_like(fine)
    cell[[0, -1]] = 0.5
    seen = (illuminant.band_means(fine, 1.0) * cell)[:, None] * matching
    seen /= seen[:, 1].sum()
    return np.asarray(shares @ seen)


def shares_of_points(wavelengths_nm: FloatArray, fine_nm: FloatArray) -> FloatArray:
    """(W, M) share that each of W points of a reflectance has in its value at M wavelengths.

    The reflectance is linear between its points and constant beyond them.

    Raises:
        ModelError: points that do not rise, or do not reach from 400 to 700 nm.
    """
    points = np.asarray(wavelengths_nm, dtype=np.float64)
    if points.size < 2 or not np.all(np.diff(points) > 0.0):
        raise ModelError("wavelengths of a reflectance must rise, in nm")
    if points[0] > NEEDED_NM[0] or points[-1] < NEEDED_NM[1]:
        raise ModelError(
            f"a reflectance from {points[0]:g} to {points[-1]:g} nm has no colour; "
            f"at least {NEEDED_NM[0]:g} to {NEEDED_NM[1]:g} nm are needed"
        )
    return np.stack([np.interp(fine_nm, points, unit) for unit in np.eye(points.size)])


def white_point(illuminant: Illuminant) -> FloatArray:
    """(3,) XYZ of the perfect diffuser, Y = 1."""
    return np.asarray(xyz_weights(illuminant, np.array(VISIBLE_NM)).sum(axis=0))
