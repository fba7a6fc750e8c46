"""Titanium dioxide, the coating of the flakes: refractive index by data set, and its Fresnel reflectance.

The table (380 to 780 nm by 10 nm) is from the refractiveindex.info database (CC0 1.0), read with the package
refractiveindex 1.3.1. Data sets: Devore 1951 (rutile, ordinary "devore-o" and extraordinary "devore-e"), Siefke 2016,
Zhukovsky and Boltasseva 2015, Sarkar 2019, Bodurov 2016, Jolivet 2023 (amorphous and anatase), Franta 2015. The
database's set of Kischkat 2012 begins in the infrared and is left out. Where a source gives no k, it is 0.
"""

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.colour.tables import package_table

ComplexArray = npt.NDArray[np.complex128]

DEFAULT = "siefke"


def _table() -> tuple[tuple[str, ...], FloatArray]:
    return package_table("anisoscope.sim.light.ink", "tio2_nk.csv")


def source_names() -> tuple[str, ...]:
    """Names of the data sets."""
    return tuple(name.removesuffix("_n") for name in _table()[0][1:] if name.endswith("_n"))


def index(wavelengths_nm: FloatArray, source: str = DEFAULT) -> ComplexArray:
    """(W,) complex refractive index n + ik, linear between its points.

    Raises:
        ModelError: no such data set, or a wavelength outside of 380 to 780 nm.
    """
    columns, numbers = _table()
    if source not in source_names():
        raise ModelError(f"no TiO2 data set is named {source!r}; known: {', '.join(source_names())}")
    nm = np.asarray(wavelengths_nm, dtype=np.float64)
    table = numbers[:, 0]
    if nm.min() < table[0] or nm.max() > table[-1]:
        raise ModelError(
            f"the index of TiO2 is known from {table[0]:g} to {table[-1]:g} nm, not at {nm.min():g} to {nm.max():g} nm"
        )
    n, k = (np.interp(nm, table, numbers[:, columns.index(f"{source}_{part}")]) for part in "nk")
    return np.asarray(n + 1j * k)


def fresnel(cosine: FloatArray, n: ComplexArray) -> FloatArray:
    """(…, W) reflectance of unpolarised light from air at (…,) cosines of incidence, for (W,) indices n + ik."""
    outside = np.clip(np.asarray(cosine, dtype=np.float64), 0.0, 1.0)[..., None]
    inside = np.sqrt(1.0 - (1.0 - outside**2) / n**2 + 0j)
    s = (outside - n * inside) / (outside + n * inside)
    p = (n * outside - inside) / (n * outside + inside)
    return np.asarray(0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2))
