"""Colour spaces: XYZ, sRGB (IEC 61966-2-1), CIELAB (ISO/CIE 11664-4), and Bradford adaptation between whites.

sRGB values stay linear and unclipped until they are encoded: a saturated ink lies outside of the gamut, and sums of
lights must be formed before anything is cut off.
"""

from typing import NamedTuple

import numpy as np

from anisoscope.base.arrays import FloatArray

_PRIMARIES = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]])
_WHITE = (0.3127, 0.3290)
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def _xyz_of(x: float, y: float) -> FloatArray:
    return np.array([x / y, 1.0, (1.0 - x - y) / y])


SRGB_WHITE = _xyz_of(*_WHITE)
"""(3,) XYZ of the white of sRGB, Y = 1."""


def _srgb_to_xyz() -> FloatArray:
    columns = np.stack([_xyz_of(float(x), float(y)) for x, y in _PRIMARIES], axis=1)
    return np.asarray(columns * np.linalg.solve(columns, SRGB_WHITE))


SRGB_TO_XYZ = _srgb_to_xyz()
XYZ_TO_SRGB: FloatArray = np.asarray(np.linalg.inv(SRGB_TO_XYZ), dtype=np.float64)
"""(3, 3), from the chromaticities of the standard: white is (1, 1, 1) exactly."""


def linear_srgb(xyz: FloatArray) -> FloatArray:
    """(…, 3) linear sRGB of (…, 3) XYZ with Y = 1 for white; negative or above 1 outside of the gamut."""
    return np.asarray(np.asarray(xyz) @ XYZ_TO_SRGB.T)


class Encoded(NamedTuple):
    """Encoded sRGB, and how many of the colours had to be clipped to get there.

    Attributes:
        srgb: (…, 3) values in [0, 1].
        clipped: number of colours with a channel outside of [0, 1].
    """

    srgb: FloatArray
    clipped: int


OUTSIDE = 1e-6
"""How far a channel may leave [0, 1] by rounding before it counts as clipped."""


def encode(linear: FloatArray) -> Encoded:
    """Clip linear sRGB (…, 3) to the gamut and apply the transfer function of IEC 61966-2-1."""
    values = np.asarray(linear, dtype=np.float64)
    clipped = int(np.count_nonzero(np.any((values < -OUTSIDE) | (values > 1.0 + OUTSIDE), axis=-1)))
    inside = np.clip(values, 0.0, 1.0)
    bent = 1.055 * np.maximum(inside, 0.0031308) ** (1.0 / 2.4) - 0.055
    return Encoded(np.where(inside <= 0.0031308, 12.92 * inside, bent), clipped)


def hexadecimal(srgb: FloatArray) -> str:
    """``#rrggbb`` of one encoded colour (3,)."""
    return "#" + "".join(f"{round(255.0 * float(value)):02x}" for value in srgb)


def lab(xyz: FloatArray, white: FloatArray) -> FloatArray:
    """(…, 3) CIELAB of (…, 3) XYZ against a white (3,)."""
    ratio = np.asarray(xyz) / np.asarray(white)
    edge = 6.0 / 29.0
    bent = np.where(ratio > edge**3, np.cbrt(ratio), ratio / (3.0 * edge**2) + 4.0 / 29.0)
    x, y, z = np.moveaxis(bent, -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def bradford(source: FloatArray, target: FloatArray) -> FloatArray:
    """(3, 3) adaptation of XYZ from one white (3,) to another; apply as ``xyz @ matrix.T``.

    Source: K. M. Lam 1985, in the linear form of the ICC profile specification, annex E.
    """
    gain = (_BRADFORD @ target) / (_BRADFORD @ source)
    return np.asarray(np.linalg.solve(_BRADFORD, gain[:, None] * _BRADFORD))


def ciede2000(first: FloatArray, second: FloatArray) -> FloatArray:
    """CIEDE2000 differences (ISO/CIE 11664-6) of (…, 3) and (…, 3) CIELAB."""
    from skimage.color import deltaE_ciede2000  # noqa: PLC0415 - loads in half a second

    found = deltaE_ciede2000(np.asarray(first), np.asarray(second))  # type: ignore[no-untyped-call]
    return np.asarray(found, dtype=np.float64)
