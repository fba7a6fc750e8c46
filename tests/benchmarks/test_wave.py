"""Reflectance by waves at 4096², one direction, one wavelength, against plain and careful ways, in one run."""

import time

import numpy as np
import pytest
from scipy import fft

from anisoscope.sim.light import threads
from anisoscope.sim.light.wave import fused
from anisoscope.sim.light.wave.correlation import wave
from anisoscope.sim.light.wave.halfvectors import half_vector
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window

pytestmark = pytest.mark.benchmark
SIZE, PIXEL, WAVELENGTH, COHERENCE = 4096, 0.25, 0.5, 16.0
WINDOW = Window(Extent("rect", WAVELENGTH / COHERENCE))


def _best(function, repeats=3):
    spans = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = function()
        spans.append(time.perf_counter() - start)
    return min(spans), result


def _block(power, half):
    """Mean of the bins that the source lights, for an unpadded spectrum in the order of the FFT."""
    f = np.fft.fftfreq(SIZE, PIXEL)
    inside = [np.abs(f - at) < 0.5 / COHERENCE for at in half.frequency(WAVELENGTH)]
    return float(power[np.ix_(inside[1], inside[0])].mean()) * PIXEL**4 / (SIZE * PIXEL) ** 2


def test_fused_pass_against_fourier_transforms():
    prysm = pytest.importorskip("prysm", reason="prysm is not installed (extra [benchmark])")
    from prysm.propagation import Wavefront

    rng = np.random.default_rng(1)
    heights = np.kron(rng.choice([0.0, 0.125], (SIZE // 8, SIZE // 8)), np.ones((8, 8)))
    surface = WaveSurface.of(heights, PIXEL)
    light = np.array([0.1, 0.05, 0.0])
    light[2] = np.sqrt(1.0 - light @ light)
    half = half_vector(light, np.array([0.0, 0.0, 1.0]))
    cycles = 2.0 * half.z / WAVELENGTH

    def ours():
        return fused.density(surface, half, WAVELENGTH, WINDOW)

    def plain():
        return _block(np.abs(np.fft.fft2(np.exp(-2j * np.pi * cycles * heights))) ** 2, half)

    def by_prysm():
        field = Wavefront.from_amp_and_phase(
            np.ones_like(heights), -2e3 * half.z * heights, WAVELENGTH, PIXEL * 1e-3
        )
        focused = field.focus(efl=1.0, Q=1).data
        return _block(np.fft.ifftshift(np.abs(focused) ** 2) * SIZE**2, half)

    def piped():
        spectrum = fft.fft2(wave(surface, cycles), workers=threads.count(), overwrite_x=True)
        return _block(spectrum.real**2 + spectrum.imag**2, half)

    ours()
    found = {
        "fused": _best(ours, 5),
        "numpy complex128": _best(plain),
        f"prysm {prysm.__version__}": _best(by_prysm),
        "scipy complex64": _best(piped),
    }
    fastest, value = found["fused"]
    print()
    for name, (span, other) in found.items():
        print(f"{name}: {1e3 * span:.0f} ms, {span / fastest:.1f} × fused; density {other:.5g} µm²")
        assert other == pytest.approx(value, rel=0.1)  # unpadded ones are off
    assert found["numpy complex128"][0] > 5.0 * fastest
    assert found["scipy complex64"][0] > fastest


def test_fifteen_directions_and_thirty_one_wavelengths():
    rng = np.random.default_rng(2)
    surface = WaveSurface.of(np.kron(rng.choice([0.0, 0.125], (512, 512)), np.ones((8, 8))), PIXEL)
    halves = [
        half_vector(np.array([x, 0.0, np.sqrt(1 - x * x)]), np.array([0.0, y, np.sqrt(1 - y * y)]))
        for x in np.linspace(0.05, 0.25, 5)
        for y in (-0.1, 0.0, 0.1)
    ]
    fused.density(surface, halves[0], WAVELENGTH, WINDOW)
    start = time.perf_counter()
    total = [
        fused.density(surface, half, wavelength, WINDOW)
        for wavelength in np.linspace(0.4, 0.7, 31)
        for half in halves
    ]
    span = time.perf_counter() - start
    pixels = SIZE * SIZE * len(total)
    print(f"\n15 directions × 31 wavelengths: {span:.1f} s, {span / pixels * 1e9:.2f} ns a pixel")
    assert np.all(np.isfinite(total))
