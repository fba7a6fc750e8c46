"""Reflectance in one direction: one fused pass over the heights, then a small quadratic form.

The wave is turned so that the wanted direction lies at frequency 0, low-passed to the width of the window and
decimated, a strip of columns at a time. What is left is small; its quadratic form with the coherence of the window is
taken by a zero-padded FFT, whose weights are the transform of the coherence at the distances that occur: that is exact.

The low-pass is a Kaiser window whose droop is undone after decimation. Only what would fold into the pass band must
be stopped, so that the filter may droop within it; the droop is divided out where only few numbers are left. That
halves the taps of a filter that is flat by itself.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.light import threads
from anisoscope.sim.light.wave import gpu
from anisoscope.sim.light.wave.halfvectors import HalfVector
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Window

Floats = npt.NDArray[np.float32]

STOP_DB = 80.0
RATE = 6.0
"""Samples after decimation in half a pass band; less decimation makes the filter shorter."""


@dataclass(frozen=True, eq=False)
class Decimation:
    """Low-pass and decimation along one axis.

    Attributes:
        count: points before.
        pixel_um: their distance in µm.
        step: points between two outputs; 1 leaves everything as it is.
        taps: (2·half + 1,) float32 filter of sum 1.
        pass_band: half-width of the pass band in cycles per µm.
    """

    count: int
    pixel_um: float
    step: int
    taps: Floats
    pass_band: float

    @property
    def outputs(self) -> int:
        """Points after."""
        half = self.taps.size // 2
        return half // self.step + (self.count - 1 + half) // self.step + 1

    def equaliser(self, frequency: FloatArray) -> FloatArray:
        """(F,) factors of frequencies in cycles per µm: 1/H in the pass band, tapered to 0."""
        offset = (np.arange(self.taps.size) - self.taps.size // 2) * self.pixel_um
        response = np.cos(2.0 * np.pi * np.outer(frequency, offset)) @ self.taps.astype(np.float64)
        end = 0.5 / (self.step * self.pixel_um)
        share = np.clip((np.abs(frequency) - self.pass_band) / max(end - self.pass_band, 1e-12), 0.0, 1.0)
        taper = np.cos(0.5 * np.pi * share) ** 2
        return np.asarray(np.where(taper > 0.0, taper / np.maximum(response, 1e-3), 0.0))


@lru_cache(maxsize=64)
def decimation(count: int, pixel_um: float, half_width: float) -> Decimation:
    """Decimation that keeps frequencies up to ``half_width`` cycles per µm."""
    pass_band = max(half_width, 2.0 / (count * pixel_um))
    step = min(int(1.0 / (RATE * pass_band * pixel_um)), max(count // 16, 1))
    if step < 2:
        return Decimation(count, pixel_um, 1, np.ones(1, dtype=np.float32), 0.5 / pixel_um)
    beta = 0.12438 * (STOP_DB + 6.3)
    stop = 1.0 / (step * pixel_um) - pass_band
    length = np.sqrt(np.pi**2 + beta**2) / (
        np.pi * stop * pixel_um
    )  # to the first null of the window's spectrum
    half = int(np.ceil(0.5 * length))
    taps = np.kaiser(2 * half + 1, beta)
    return Decimation(count, pixel_um, step, (taps / taps.sum()).astype(np.float32), pass_band)


STRIP = 512
SHARED_OUTPUTS = 2**18  # up to which the weights of a window are kept for further directions


@dataclass(frozen=True, eq=False)
class Reduced:
    """The wave around one direction, low-passed and decimated.

    Attributes:
        wave: (outputs along y, outputs along x) complex, on the cores or on the graphics card.
        along_y: how y was decimated; None for a profile.
        along_x: how x was decimated.
    """

    wave: gpu.ComplexArray
    along_y: Decimation | None
    along_x: Decimation


def density(
    surface: WaveSurface,
    half: HalfVector,
    wavelength_um: float,
    window: Window,
    library: gpu.ArrayLibrary | None = None,
) -> float:
    """Mean power spectrum in one direction, blurred by the window, in µm² (of a profile: µm).

    S(ω) = (1/A)·∬∬ a(p)·a*(q)·exp(−2πi·ω·(p − q))·K(p − q), a = exp(−ik·2h_z·z); its integral over all ω is 1.
    Source: Levin et al. 2013, Eq. 1 and 10, with the sign of Eq. 11 mended and Eq. 12 taken over all x0.
    """
    on = library or gpu.library()
    if on.is_card:
        reduced = _reduce_on_card(on, surface, half, wavelength_um, window)
    else:
        reduced = reduce(surface, half, wavelength_um, window)
    form = quadratic_form(on, reduced, wavelength_um, half.z, window)
    return form / surface.area_um2 * cell_response(surface, half, wavelength_um)


def cell_response(surface: WaveSurface, half: HalfVector, wavelength_um: float, times: int = 1) -> float:
    """Power that a pixel of one height sends into a direction, as a share of that of a point; 1 for points.

    Of one of ``times`` parts of a pixel along each axis. It varies little over the window where the pixel, or the part,
    is small against the coherence length; that is what makes it a factor.
    """
    if not surface.cells:
        return 1.0
    fx, fy = half.frequency(wavelength_um)
    response = np.sinc(fx * surface.pixel_x_um / times)
    if not surface.is_profile:
        response *= np.sinc(fy * surface.pixel_y_um / times)
    return float(response**2)


def _decimations(
    surface: WaveSurface, half: HalfVector, wavelength_um: float, window: Window
) -> tuple[Decimation, Decimation]:
    """Along y and along x."""
    rows, cols = surface.shape
    wide_x, wide_y = window.half_width(wavelength_um, half.z)
    return decimation(rows, surface.pixel_y_um, wide_y), decimation(cols, surface.pixel_x_um, wide_x)


def _turns_of(surface: WaveSurface, half: HalfVector, wavelength_um: float) -> tuple[float, float, float]:
    """Turns of the phase per µm of height, from column to column, and from row to row."""
    fx, fy = half.frequency(wavelength_um)
    return (
        2.0 * half.z / wavelength_um,
        fx * surface.pixel_x_um,
        0.0 if surface.is_profile else fy * surface.pixel_y_um,
    )


def reduce(surface: WaveSurface, half: HalfVector, wavelength_um: float, window: Window) -> Reduced:
    """Low-pass and decimate the wave around one direction, on the cores."""
    from anisoscope.sim.light.wave.fused_kernels import gather, strip  # noqa: PLC0415 - numba when first needed

    rows, cols = surface.shape
    along_y, along_x = _decimations(surface, half, wavelength_um, window)
    per_um, per_column, per_row = _turns_of(surface, half, wavelength_um)
    carrier_x, carrier_y = _turns(per_column, cols), _turns(per_row, rows)
    taps_y = np.pad(along_y.taps, 3)

    def run(columns: tuple[int, int]) -> tuple[Floats, Floats]:
        found = np.zeros((2, along_y.outputs, along_x.outputs), dtype=np.float32)
        decimated = np.empty((2, along_y.outputs, STRIP), dtype=np.float32)
        work = np.empty((8, STRIP), dtype=np.float32)
        for first in range(*columns, STRIP):
            last = min(first + STRIP, columns[1])
            decimated[:] = 0.0
            strip(
                surface.height_um, first, last, per_um, carrier_x, carrier_y, taps_y, along_y.step,
                decimated[0], decimated[1], work,
            )  # fmt: skip
            gather(decimated[0], decimated[1], first, last, along_x.taps, along_x.step, found[0], found[1])
        return found[0], found[1]

    parts = threads.each(run, threads.runs(cols, min(threads.count(), max(1, cols // STRIP))))
    real, imag = (np.sum([part[which] for part in parts], axis=0, dtype=np.float32) for which in (0, 1))
    wave = np.asarray(real + 1j * imag, dtype=np.complex64)
    return Reduced(wave, None if surface.is_profile else along_y, along_x)


def _reduce_on_card(
    on: gpu.ArrayLibrary, surface: WaveSurface, half: HalfVector, wavelength_um: float, window: Window
) -> Reduced:
    """The same on the graphics card."""
    along_y, along_x = _decimations(surface, half, wavelength_um, window)
    turns = _turns_of(surface, half, wavelength_um)
    wave = gpu.low_pass(on, surface, turns, _filter_on(on, along_y), _filter_on(on, along_x))
    return Reduced(wave, None if surface.is_profile else along_y, along_x)


@lru_cache(maxsize=64)
def _filter_on(on: gpu.ArrayLibrary, along: Decimation) -> gpu.Filter:
    return gpu.Filter(on.xp.asarray(along.taps), along.step, along.outputs)


def _turns(cycles_a_pixel: float, count: int) -> Floats:
    """(count,) turns of a carrier about the middle, less whole ones."""
    turns = cycles_a_pixel * (np.arange(count) - 0.5 * (count - 1))
    return np.asarray(turns - np.rint(turns), dtype=np.float32)


def quadratic_form(
    on: gpu.ArrayLibrary, reduced: Reduced, wavelength_um: float, h_z: float, window: Window
) -> float:
    """Σ a(p)·a*(q)·K(p − q) times the squared area of a pixel, in µm⁴ (of a profile: µm²)."""
    rough = 0.0 if window.slope_variance is None else h_z
    blur = (_shared_blur if reduced.wave.size <= SHARED_OUTPUTS else _blur)(
        on, reduced.along_x, reduced.along_y, wavelength_um, rough, window
    )
    spectrum = on.fft.fft2(reduced.wave, blur.shape, **on.fft_options)
    return float((blur * (spectrum.real**2 + spectrum.imag**2)).sum())


def _blur(
    on: gpu.ArrayLibrary,
    along_x: Decimation,
    along_y: Decimation | None,
    wavelength_um: float,
    h_z: float,
    window: Window,
) -> FloatArray:
    """(Y, X) weights of the zero-padded power spectrum: the transform of the coherence, equalised, on cores or card."""
    scale, weights, lags = 1.0, [np.ones(1), np.ones(1)], [np.zeros(1), np.zeros(1)]
    for axis, along in enumerate((along_y, along_x)):
        if along is None:
            continue
        pixel = along.step * along.pixel_um
        extra = 0 if along.step == 1 else 16  # room for the equaliser's response
        length = gpu.fft_length(2 * (along.outputs + extra))
        weights[axis] = along.equaliser(np.fft.fftfreq(length, pixel).astype(np.float64)) ** 2
        index = np.arange(length)
        lags[axis] = np.where(index <= length // 2, index, index - length) * pixel
        scale *= pixel**2 / length
    lag_y, lag_x, weight_y, weight_x = (on.xp.asarray(a) for a in (*lags, *weights))
    coherence = window.coherence(lag_x[None, :], lag_y[:, None], wavelength_um, h_z)
    spread = on.fft.fft2(coherence, **on.fft_options).real
    return cast("FloatArray", spread * (scale * weight_y[:, None] * weight_x))


_shared_blur = lru_cache(maxsize=8)(_blur)
"""Directions share one where no roughness blurs, which alone depends on h_z."""
