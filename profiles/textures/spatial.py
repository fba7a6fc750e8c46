"""Autocorrelation of a surface and the spatial parameters of ISO 25178-2.

Heights count from their mean. The field is not taken as periodic: only pairs of measured points count.
"""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.textures.spectra import known_heights, lay

THRESHOLD = 0.2
LEAST_PAIRS = 0.1


@dataclass(frozen=True, eq=False)
class Autocorrelation:
    """f_ACF, 1 at lag 0.

    Attributes:
        value: (2m + 1, 2n + 1); row i and column j stand at the lag ((i − m)·pixel_y, (j − n)·pixel_x), up to half
            the field; NaN where less than a tenth of the pairs of such a lag was measured.
        pixel_y_um: step of the lag along y in µm.
        pixel_x_um: step of the lag along x in µm.
    """

    value: FloatArray
    pixel_y_um: float
    pixel_x_um: float

    @property
    def centre(self) -> tuple[int, int]:
        """Row and column of lag 0."""
        return self.value.shape[0] // 2, self.value.shape[1] // 2

    def along_x(self) -> tuple[FloatArray, FloatArray]:
        """Lags from 0 in µm along x, and f_ACF there."""
        i, j = self.centre
        part = self.value[i, j:]
        return np.arange(part.size, dtype=np.float64) * self.pixel_x_um, part

    def along_y(self) -> tuple[FloatArray, FloatArray]:
        """Lags from 0 in µm along y, and f_ACF there."""
        i, j = self.centre
        part = self.value[i:, j]
        return np.arange(part.size, dtype=np.float64) * self.pixel_y_um, part


@dataclass(frozen=True)
class Spatial:
    """Spatial parameters (ISO 25178-2, 4.2).

    Attributes:
        sal_um: autocorrelation length Sal: shortest lag at which f_ACF falls to 0.2; NaN if it does not within
            half the field.
        str_: texture aspect ratio Str: Sal over the longest such lag around the central lobe, 0 to 1.
        str_is_bound: the lobe reaches the end of the lags (half the field), so that Str is at most this number.
        std_deg: texture direction Std: direction of the lay, counter-clockwise from +y, within (−90, 90]; at
            right angles to it lies the maximum of the angular spectrum. NaN without any texture.
    """

    sal_um: float
    str_: float
    str_is_bound: bool
    std_deg: float


def autocorrelation(surface: HeightMap) -> Autocorrelation:
    """f_ACF of a map for lags up to half the field: mean product of the pairs, over the mean square.

    Raises:
        HeightMapError: nothing was measured.
    """
    from scipy import fft  # noqa: PLC0415 - slow to import

    height, known = known_heights(surface)
    half = tuple(n // 2 for n in surface.shape)
    size = [fft.next_fast_len(n + m, real=True) for n, m in zip(surface.shape, half, strict=True)]

    def correlated(field: FloatArray) -> FloatArray:
        full = fft.irfft2(np.abs(fft.rfft2(field, size)) ** 2, size)
        rows, cols = (np.arange(-m, m + 1) for m in half)
        return np.asarray(full[np.ix_(rows, cols)])

    products = correlated(height)
    pairs = np.rint(correlated(known.astype(np.float64)))
    rows, cols = (n - np.abs(np.arange(-m, m + 1)) for n, m in zip(surface.shape, half, strict=True))
    enough = pairs >= np.maximum(1.0, LEAST_PAIRS * np.multiply.outer(rows, cols))
    square = float(np.sum(height**2)) / float(np.count_nonzero(known))
    value = products / np.maximum(pairs, 1.0) / square if square > 0.0 else np.ones_like(products)
    return Autocorrelation(np.where(enough, value, np.nan), surface.pixel_y_um, surface.pixel_x_um)


def _crossings(found: Autocorrelation) -> tuple[FloatArray, bool]:
    """Lags in µm at which the central lobe of f_ACF falls to 0.2 on the lines of the grid; does it touch the end."""
    from scipy.ndimage import label  # noqa: PLC0415 - slow to import

    value = found.value
    parts, _ = label(value >= THRESHOLD)
    lobe = parts == parts[found.centre]
    touches = bool(lobe[0].any() or lobe[-1].any() or lobe[:, 0].any() or lobe[:, -1].any())
    touches |= bool((lobe & np.isnan(_grown(value))).any())
    lags: list[FloatArray] = []
    for step_i, step_j in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        outer = np.roll(value, (-step_i, -step_j), (0, 1))
        inner = lobe & (outer < THRESHOLD)
        i, j = np.nonzero(inner)
        share = (value[inner] - THRESHOLD) / (value[inner] - outer[inner])
        y = (i - found.centre[0] + step_i * share) * found.pixel_y_um
        x = (j - found.centre[1] + step_j * share) * found.pixel_x_um
        inside = (np.abs(i - found.centre[0] + step_i) <= found.centre[0]) & (
            np.abs(j - found.centre[1] + step_j) <= found.centre[1]
        )
        lags.append(np.hypot(x, y)[inside])
    return np.concatenate(lags), touches


def _grown(value: FloatArray) -> FloatArray:
    """NaN at every point that has a NaN among its four neighbours."""
    padded = np.pad(value, 1, mode="edge")
    total = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
    return np.asarray(total)


def spatial(surface: HeightMap) -> Spatial:
    """Sal, Str and Std of a map with threshold 0.2.

    Raises:
        HeightMapError: nothing was measured.
    """
    found = autocorrelation(surface)
    lags, touches = _crossings(found)
    if lags.size == 0:
        return Spatial(float("nan"), float("nan"), True, lay(surface))
    height, width = (found.centre[0] * found.pixel_y_um, found.centre[1] * found.pixel_x_um)
    longest = max(float(lags.max()), min(height, width)) if touches else float(lags.max())
    return Spatial(float(lags.min()), float(lags.min()) / longest, touches, lay(surface))
