"""Pitch and direction of the ridges on a height map, and whether there are any.

The spectrum of parallel ridges is a row of peaks at the multiples of one frequency vector. The vector with
the largest power summed over its harmonics is searched on the grid of the FFT, then refined between the
bins on the exact Fourier sums, where a harmonic of order k counts with k times the resolution. Missing
points weigh nothing.
"""

from copy import copy
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.parallel import one_blas_thread
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.heightmap import HeightMap, row_blocks, sampled

HARMONICS = 8
MIN_CYCLES = 4.0
MIN_FUNDAMENTAL = 0.1
MIN_SCORE = 0.5
AS_WELL = 0.005
MIN_POINTS = 8
FEW_CYCLES = 5.5
SHARPEN_SHARE = 0.01
LOBE_BINS = 1
CANDIDATES = 6
STENCIL_BINS = 0.2
NEWTON_STEPS = 6
PHASE_BINS = 64
COARSE_POINTS = 1000
COARSE_SHARE = 0.25
FIT_SAMPLES = 60_000


@dataclass(frozen=True)
class Period:
    """The period of a ridged surface.

    Attributes:
        pitch_um: distance of neighbouring ridges across them, in µm; NaN if not periodic.
        direction_deg: direction of the ridge line, counted counter-clockwise from +y as seen from +z,
            within (−90, 90]; 0 for ideal ridges; NaN if not periodic.
        score: share of the variance that a repeated profile predicts: each ridge from all the others, 0 to 1.
        is_periodic: whether the score reaches 0.5.
    """

    pitch_um: float
    direction_deg: float
    score: float
    is_periodic: bool

    def across(self) -> tuple[float, float]:
        """Unit vector (x, y) across the ridges."""
        angle = np.radians(self.direction_deg)
        return float(np.cos(angle)), float(np.sin(angle))

    def along(self) -> tuple[float, float]:
        """Unit vector (x, y) along the ridges."""
        angle = np.radians(self.direction_deg)
        return float(-np.sin(angle)), float(np.cos(angle))


def remove_form(surface: HeightMap) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Heights without their least-squares paraboloid and spikes, 0 where missing, and the measured points."""
    height = surface.height_um
    known = np.isfinite(height)
    rows, cols = surface.shape
    y, x = np.linspace(-1.0, 1.0, rows)[:, None], np.linspace(-1.0, 1.0, cols)[None, :]
    i, j = np.divmod(sampled(known, FIT_SAMPLES), cols)
    ys, xs = y[i, 0], x[0, j]
    design = np.stack([np.ones_like(xs), xs, ys, xs * xs, xs * ys, ys * ys], axis=1)
    c = np.linalg.lstsq(design, height[i, j], rcond=None)[0]
    residual = np.empty((rows, cols))
    for block in row_blocks(height.shape):
        up = y[block]
        np.subtract(
            height[block],
            c[0] + c[2] * up + c[5] * up * up + x * (c[1] + c[3] * x + c[4] * up),
            out=residual[block],
        )
    low, high = np.quantile(residual[i, j], (0.005, 0.995))
    margin = 0.5 * (high - low)
    np.clip(residual, low - margin, high + margin, out=residual)
    residual[~known] = 0.0
    return residual, known


def _windowed(residual: FloatArray, known: npt.NDArray[np.bool_]) -> FloatArray:
    """Heights about their weighted mean under a Hann window, 0 where missing."""
    rows, cols = residual.shape
    up, right = np.hanning(rows + 2)[1:-1, None], np.hanning(cols + 2)[None, 1:-1]
    data = np.empty(residual.shape)
    total = weight = 0.0
    for block in row_blocks(residual.shape):
        part = up[block] * right * known[block]
        weight += float(part.sum())
        data[block] = part * residual[block]
        total += float(data[block].sum())
    for block in row_blocks(residual.shape):
        data[block] -= (total / weight) * up[block] * right * known[block]
    return data


def _power(data: FloatArray) -> FloatArray:
    """Power of the real two-dimensional spectrum about frequency 0 along y, from −``LOBE_BINS`` on along x."""
    rows, cols = data.shape
    spectrum = np.fft.rfft2(data)  # scipy's is no faster, and slow to import
    power = np.empty((rows, LOBE_BINS + cols // 2 + 1))
    negative = (rows + 1) // 2  # number of frequencies from 0 on; the others are negative
    for there, here in (
        (slice(rows - negative, None), slice(negative)),
        (slice(rows // 2), slice(negative, None)),
    ):
        part = power[there, LOBE_BINS:]
        np.square(spectrum.real[here], out=part)
        part += spectrum.imag[here] ** 2
    mirrored = (2 * (rows // 2) - np.arange(rows)) % rows
    power[:, :LOBE_BINS] = power[mirrored, 2 * LOBE_BINS : LOBE_BINS : -1]
    return power


class _Spectrum:
    """Power of the windowed heights, on the FFT's grid and between its bins. Frequencies are (x, y)."""

    def __init__(
        self, residual: FloatArray, known: npt.NDArray[np.bool_], pixel_y: float, pixel_x: float
    ) -> None:
        rows, cols = residual.shape
        self.data = _windowed(residual, known)
        self.y, self.x = np.arange(rows) * pixel_y, np.arange(cols) * pixel_x
        self.step = np.array([1.0 / (cols * pixel_x), 1.0 / (rows * pixel_y)])
        self.nyquist = np.array([0.5 / pixel_x, 0.5 / pixel_y])
        self.power = _power(self.data)
        self.middle = rows // 2

    def candidates(self) -> list[FloatArray]:
        """Frequencies of the strongest separate peaks."""
        rows, cols = self.power.shape
        cycles = np.hypot(np.arange(rows)[:, None] - self.middle, np.arange(cols)[None, :] - LOBE_BINS)
        power = np.where(cycles < MIN_CYCLES, 0.0, self.power)
        power[:, :LOBE_BINS] = 0.0
        found: list[FloatArray] = []
        for _ in range(CANDIDATES):
            i, j = np.unravel_index(int(power.argmax()), power.shape)
            found.append(np.array([float(j - LOBE_BINS), float(i - self.middle)]) * self.step)
            power[max(i - 2, 0) : i + 3, max(j - 2, 0) : j + 3] = 0.0
        return found

    def orders(self, frequency: FloatArray) -> int:
        """Number of harmonics of a frequency that the sampling can hold, at most eight."""
        limit = float(np.min(self.nyquist / np.maximum(np.abs(frequency), 1e-12)))
        return int(np.clip(np.floor(limit * 0.98), 1, HARMONICS))

    def lobe(self, frequency: FloatArray) -> float:
        """Power within the main lobe of the window about a frequency."""
        j, i = (frequency if frequency[0] >= 0 else -frequency) / self.step
        row, col = round(float(i)) + self.middle, round(float(j)) + LOBE_BINS
        part = self.power[
            max(row - LOBE_BINS, 0) : row + LOBE_BINS + 1, col - LOBE_BINS : col + LOBE_BINS + 1
        ]
        return float(part.sum())

    def harmonics(self, frequency: FloatArray) -> list[float]:
        """Power of the harmonics of a frequency, from the first on."""
        return [self.lobe(k * frequency) for k in range(1, 1 + self.orders(frequency))]

    def sums(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """(k, n, m) exact power at n frequencies along y and m along x, for k pairs of them; one pass over the map."""
        ey = np.exp(-2j * np.pi * np.multiply.outer(fy, self.y)).reshape(-1, self.y.size)
        rows = np.concatenate([ey.real, ey.imag]) @ self.data
        half = (rows[: len(ey)] + 1j * rows[len(ey) :]).reshape(*fy.shape, -1)
        ex = np.exp(-2j * np.pi * np.einsum("j,km->kjm", self.x, fx))
        power: FloatArray = np.abs(half @ ex) ** 2
        return power

    def coarse(self) -> "_Spectrum":
        """The same spectrum from means over squares of pixels, for low frequencies of large maps."""
        factor = min(self.data.shape) // COARSE_POINTS
        if factor < 2:
            return self
        found = copy(self)
        rows, cols = (n // factor for n in self.data.shape)
        part = self.data[: rows * factor, : cols * factor].reshape(rows, factor, cols, factor)
        found.data = part.mean(axis=3).mean(axis=1)
        found.y, found.x = (
            one[: n * factor].reshape(n, factor).mean(axis=1) for one, n in ((self.y, rows), (self.x, cols))
        )
        found.nyquist = self.nyquist / factor
        return found

    def refine(self, frequency: FloatArray, orders: int) -> FloatArray:
        """The maximum of the harmonic sum near a frequency, by Newton steps on 3 × 3 stencils."""
        h = STENCIL_BINS / orders * self.step
        offsets, order = np.arange(-1, 2), np.arange(1, orders + 1)
        for _ in range(NEWTON_STEPS):
            fx, fy = (np.outer(order, frequency[n] + h[n] * offsets) for n in (0, 1))
            move = _vertex(self.sums(fx, fy).sum(axis=0))
            frequency = frequency + h * move
            if float(np.abs(move).max()) < 1e-3:
                break
        return frequency


def _vertex(p: FloatArray) -> FloatArray:
    """Offset (x, y) of the maximum of a 3 × 3 stencil in steps, by one Newton step within ±1.5."""
    gx, gy = 0.5 * (p[1, 2] - p[1, 0]), 0.5 * (p[2, 1] - p[0, 1])
    hxx, hyy = p[1, 2] - 2 * p[1, 1] + p[1, 0], p[2, 1] - 2 * p[1, 1] + p[0, 1]
    hxy = 0.25 * (p[2, 2] - p[2, 0] - p[0, 2] + p[0, 0])
    determinant = hxx * hyy - hxy * hxy
    if determinant <= 0 or hxx >= 0:
        i, j = np.unravel_index(int(p.argmax()), p.shape)
        return np.array([j - 1.0, i - 1.0])
    step = -np.array([hyy * gx - hxy * gy, hxx * gy - hxy * gx]) / determinant
    move: FloatArray = np.clip(step, -1.5, 1.5)
    return move


def _strongest(spectrum: _Spectrum) -> FloatArray:
    """The refined frequency with the largest power in its harmonics."""
    candidates, coarse = spectrum.candidates(), spectrum.coarse()
    best, best_power = candidates[0], -1.0
    for candidate in candidates:
        low = bool((np.abs(candidate) < COARSE_SHARE * coarse.nyquist).all())
        refined = (coarse if low else spectrum).refine(candidate, 1)
        powers = spectrum.harmonics(refined)
        if powers[0] >= MIN_FUNDAMENTAL * max(powers) and sum(powers) > best_power:
            best, best_power = refined, sum(powers)
    limit = spectrum.orders(best)
    for orders in (2, 4, HARMONICS):
        used = min(orders, limit)
        low = orders < HARMONICS and bool((used * np.abs(best) < 0.5 * coarse.nyquist).all())
        best = (coarse if low else spectrum).refine(best, used)
    tiny = 1e-9 * abs(float(best[1]))
    return best if best[0] > tiny or (best[0] >= -tiny and best[1] > 0) else -best


def _predicted_share(
    residual: FloatArray, known: npt.NDArray[np.bool_], spectrum: _Spectrum, f: FloatArray
) -> float:
    """Share of the variance that the mean profile of all other ridges predicts for each ridge.

    With c ridges, leaving one out scales its residual by c/(c − 1); the search for the best frequency uses up
    another one, so that c/(c − 2) keeps the score of random surfaces near 0.
    """
    cycles = float(np.abs(f) @ np.array([spectrum.x[-1], spectrum.y[-1]]))
    if cycles < MIN_CYCLES - 0.5:
        return 0.0
    bins = min(PHASE_BINS, max(4, round(1.0 / float(np.max(np.abs(f) / (2.0 * spectrum.nyquist))))))
    count, sums, square = np.zeros(bins), np.zeros(bins), 0.0
    for block in row_blocks(residual.shape):
        phase = np.add.outer(f[1] * spectrum.y[block], f[0] * spectrum.x)
        index = ((phase - np.floor(phase)) * bins).astype(np.intp) % bins
        # missing points have a residual of 0
        count += np.bincount(index.ravel(), known[block].ravel(), minlength=bins)
        sums += np.bincount(index.ravel(), residual[block].ravel(), minlength=bins)
        square += float(np.vdot(residual[block], residual[block]))
    points, mean = float(count.sum()), float(sums.sum() / count.sum())
    total = square - points * mean**2
    unexplained = 1.0 - float(np.sum(sums**2 / np.maximum(count, 1.0)) - points * mean**2) / total
    return 1.0 - (cycles / (cycles - 2.0)) ** 2 * unexplained


def _shortest(
    residual: FloatArray, known: npt.NDArray[np.bool_], spectrum: _Spectrum, f: FloatArray
) -> tuple[FloatArray, float]:
    """The frequency, or twice or three times it where this predicts the ridges as well; with its predicted share.

    Where much of a map is missing, its gaps put power at a fraction of the frequency of the ridges.
    """
    best, share = f, _predicted_share(residual, known, spectrum, f)
    for times in (2, 3):
        other = times * f
        if (np.abs(other) > 0.5 * spectrum.nyquist).any():
            break
        other = spectrum.refine(other, spectrum.orders(other))
        found = _predicted_share(residual, known, spectrum, other)
        if found >= share - AS_WELL:
            best, share = other, found
    return best, share


def _sharpened(surface: HeightMap, frequency: FloatArray) -> float:
    """Factor on a frequency across x, from the shift at which a map of few ridges repeats itself best.

    With few ridges the form taken off the map pulls at the spectrum; the variance of h(x + L) − h(x), which no
    tilt touches, does not care. L is about half the field, so that half the map is compared.
    """
    fx, fy = frequency
    columns = surface.shape[1]
    cycles = fx * columns * surface.pixel_x_um
    if cycles > FEW_CYCLES or abs(fy) > 0.01 * fx:
        return 1.0
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - slow to import

    whole = max(1, round(cycles / 2.0))
    guess = whole / (fx * surface.pixel_x_um)
    if guess * (1.0 + SHARPEN_SHARE) > columns - 2:
        return 1.0

    low, high = np.nanpercentile(surface.height_um, [1.0, 99.0])
    rise_of_ridge = float(high - low)

    def unlike(shift: float) -> float:
        low = int(shift)
        part = shift - low
        height = surface.height_um
        moved = (1.0 - part) * height[:, low:-1] + part * height[:, low + 1 :]
        rise = moved - height[:, : moved.shape[1]]
        rise = rise[np.isfinite(rise)]
        if not rise.size:
            return float("inf")
        return float(
            np.mean(np.minimum(np.abs(rise - np.median(rise)), rise_of_ridge) ** 2)
        )  # spikes count little

    bounds = guess * (1.0 - SHARPEN_SHARE), guess * (1.0 + SHARPEN_SHARE)
    found = minimize_scalar(unlike, bounds=bounds, method="bounded", options={"xatol": 1e-3})
    return float(guess / found.x)


def _pixels(surface: HeightMap) -> tuple[float, float]:
    return surface.pixel_y_um, surface.pixel_x_um


def _thick_enough(surface: HeightMap) -> HeightMap:
    """The map with every row (or column) repeated, where there are too few of them for a spectrum."""
    rows, cols = (max(1, -(-MIN_POINTS // n)) for n in surface.shape)
    if rows == cols == 1:
        return surface
    height = np.repeat(np.repeat(surface.height_um, rows, axis=0), cols, axis=1)
    return HeightMap(height, surface.pixel_x_um / cols, surface.pixel_y_um / rows)


_found: "WeakKeyDictionary[HeightMap, Period]" = WeakKeyDictionary()


def find_period(surface: HeightMap) -> Period:
    """Pitch and direction of parallel ridges.

    At least four pitches must lie within the map. Ridges whose first harmonic is weak are found as long as
    it has a tenth of the power of the strongest one.

    Args:
        surface: (rows, cols) heights in µm, NaN where missing; pixels need not be square.

    Returns:
        The period; pitch and direction are NaN where the surface is not periodic.

    Raises:
        HeightMapError: nothing was measured.
    """
    if surface not in _found:  # maps do not change, and what is done with one often asks for its period again
        with one_blas_thread():
            _found[surface] = _period(surface)
    return _found[surface]


def take_over_period(surface: HeightMap, source: HeightMap, quarters: int = 0) -> None:
    """Let `find_period` know the period of a map that is ``source`` without a tilt, turned clockwise by quarters."""
    found = find_period(source)
    if found.is_periodic:
        direction = 90.0 - (90.0 - (found.direction_deg - 90.0 * quarters)) % 180.0
        found = replace(found, direction_deg=direction)
    _found[surface] = found


def _period(surface: HeightMap) -> Period:
    check_heights("height map", surface.height_um)
    none = Period(float("nan"), float("nan"), 0.0, False)
    if max(surface.shape) < MIN_POINTS:
        return none
    residual, known = remove_form(_thick_enough(surface))
    if float(np.ptp(residual)) <= 1e-9:
        return none
    pixel_y, pixel_x = (
        p / max(1, -(-MIN_POINTS // n)) for p, n in zip(_pixels(surface), surface.shape, strict=True)
    )
    spectrum = _Spectrum(residual, known, pixel_y, pixel_x)
    best = _strongest(spectrum)
    best, predicted = _shortest(residual, known, spectrum, best)
    score = float(np.clip(predicted, 0.0, 1.0))
    if score < MIN_SCORE:
        return Period(float("nan"), float("nan"), score, False)
    fx, fy = (best * _sharpened(surface, best)).tolist()
    return Period(float(1.0 / np.hypot(fx, fy)), float(np.degrees(np.arctan2(fy, max(fx, 0.0)))), score, True)
