"""Autocorrelation of a surface and the spatial parameters of ISO 25178-2.

Heights count from their mean. The field is not taken as periodic: only pairs of measured points count.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.json_fields import json_field
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.heightmap import HeightMap, known_mean, row_blocks
from anisoscope.profiles.textures.spectra import lay

THRESHOLD = 0.2
COLUMNS = 32
NO_LAY = 0.5
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
            right angles to it lies the maximum of the angular spectrum. NaN without any texture, and on a surface
            without lay (Str of 0.5 or more), where the maximum is chance.
    """

    sal_um: float
    str_: float = field(metadata=json_field("str"))
    str_is_bound: bool
    std_deg: float


def autocorrelation(surface: HeightMap) -> Autocorrelation:
    """f_ACF of a map for lags up to half the field: mean product of the pairs, over the mean square.

    Raises:
        HeightMapError: nothing was measured.
    """
    check_heights("height map", surface.height_um)
    mean, (rows, cols) = known_mean(surface.height_um), surface.shape
    half = rows // 2, cols // 2

    def heights(block: slice) -> FloatArray:
        part = surface.height_um[block]
        return np.where(np.isfinite(part), part - mean, 0.0)

    def known(block: slice) -> FloatArray:
        return np.isfinite(surface.height_um[block]).astype(np.float64)

    value = _half_correlation(heights, surface.shape, half)
    square = float(value[0, half[1]])
    every = np.multiply.outer(
        rows - np.arange(half[0] + 1.0), cols - np.abs(np.arange(-half[1], half[1] + 1.0))
    )
    count = sum(
        int(np.count_nonzero(np.isfinite(surface.height_um[one]))) for one in row_blocks(surface.shape)
    )
    if count == rows * cols:
        value /= every
    else:
        pairs = np.rint(_half_correlation(known, surface.shape, half))
        value /= np.maximum(pairs, 1.0)
        value[pairs < np.maximum(1.0, LEAST_PAIRS * every)] = np.nan
        del pairs
    del every
    if square > 0.0:
        value *= count / square
    else:
        value[np.isfinite(value)] = 1.0
    # f_ACF of a lag and of the opposite one are the same
    whole = np.concatenate([value[:0:-1, ::-1], value])
    return Autocorrelation(whole, surface.pixel_y_um, surface.pixel_x_um)


def _half_correlation(
    rows_of: Callable[[slice], FloatArray], shape: tuple[int, int], half: tuple[int, int]
) -> FloatArray:
    """(m + 1, 2n + 1) sums of the products of all pairs at lags of 0 to m rows and −n to n columns.

    Along x and y one after the other, in blocks, so that the zeros beyond the field take no memory along y.

    Args:
        rows_of: gives a block of rows of the field.
        shape: (rows, cols) of the field.
        half: (m, n) largest lags.
    """
    from scipy import fft  # noqa: PLC0415 - slow to import

    (rows, cols), (m, n) = shape, half
    long = fft.next_fast_len(rows + m), fft.next_fast_len(cols + n, real=True)
    spectrum = np.empty((rows, long[1] // 2 + 1), dtype=np.complex128)
    for block in row_blocks((rows, long[1])):
        spectrum[block] = fft.rfft(rows_of(block), long[1], axis=1)
    for start in range(0, spectrum.shape[1], COLUMNS):
        columns = slice(start, start + COLUMNS)
        part = fft.fft(np.ascontiguousarray(spectrum[:, columns].T), long[0], axis=1)
        power = (part.real**2 + part.imag**2).astype(np.complex128)
        spectrum[: m + 1, columns] = fft.ifft(power, axis=1, overwrite_x=True)[:, : m + 1].T
    found = np.empty((m + 1, 2 * n + 1))
    for block in row_blocks((m + 1, long[1])):
        full = fft.irfft(spectrum[block], long[1], axis=1)
        found[block, :n], found[block, n:] = full[:, long[1] - n :], full[:, : n + 1]
    return found


def _crossings(found: Autocorrelation) -> tuple[FloatArray, bool]:
    """Lags in µm at which the central lobe of f_ACF falls to 0.2 on the lines of the grid; does it touch the end."""
    from scipy.ndimage import label  # noqa: PLC0415 - slow to import

    parts, _ = label(found.value >= THRESHOLD)
    own = parts == parts[found.centre]
    touches = bool(own[0].any() or own[-1].any() or own[:, 0].any() or own[:, -1].any())
    # a window one point wider than the lobe
    spans = [np.flatnonzero(own.any(axis=1 - axis)) for axis in (0, 1)]
    low = [max(int(span[0]) - 1, 0) for span in spans]
    window = tuple(slice(start, int(span[-1]) + 2) for start, span in zip(low, spans, strict=True))
    value, lobe = found.value[window], own[window]
    touches |= bool((lobe & np.isnan(_grown(value))).any())
    lags: list[FloatArray] = []
    for step_i, step_j in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        outer = np.roll(value, (-step_i, -step_j), (0, 1))
        inner = lobe & (outer < THRESHOLD)
        i, j = np.nonzero(inner)
        share = (value[inner] - THRESHOLD) / (value[inner] - outer[inner])
        i, j = i + low[0], j + low[1]
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
    ratio = float(lags.min()) / longest
    direction = lay(surface) if touches or ratio < NO_LAY else float("nan")
    return Spatial(float(lags.min()), ratio, touches, direction)
