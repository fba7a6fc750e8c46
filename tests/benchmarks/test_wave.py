"""Reflectance by waves at 4096², one direction, one wavelength, against plain and careful ways, in one run."""

import numpy as np
import pytest
from scipy import fft

from anisoscope.kinds.wafers.kind import WAFERS
from anisoscope.prediction.expectation import expectation
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light import threads
from anisoscope.sim.light.wave import fused
from anisoscope.sim.light.wave.correlation import wave
from anisoscope.sim.light.wave.halfvectors import half_vector
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window

pytestmark = pytest.mark.benchmark
SIZE, PIXEL, WAVELENGTH, COHERENCE = 4096, 0.25, 0.5, 16.0
WINDOW = Window(Extent("rect", WAVELENGTH / COHERENCE))


def _block(power, half):
    """Mean of the bins that the source lights, for an unpadded spectrum in the order of the FFT."""
    f = np.fft.fftfreq(SIZE, PIXEL)
    inside = [np.abs(f - at) < 0.5 / COHERENCE for at in half.frequency(WAVELENGTH)]
    return float(power[np.ix_(inside[1], inside[0])].mean()) * PIXEL**4 / (SIZE * PIXEL) ** 2


def test_fused_pass_against_fourier_transforms(bench):
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

    found = bench.compare(
        f"{SIZE} × {SIZE} heights, one direction, one wavelength",
        {
            "fused": ours,
            "numpy complex128": plain,
            f"prysm {prysm.__version__}": by_prysm,
            "scipy complex64": piped,
        },
        rounds=3,
    )
    value = found["fused"].result
    for name, one in found.timings.items():
        bench.note(f"{name}: density {one.result:.5g} µm²")
        assert one.result == pytest.approx(value, rel=0.1)  # unpadded ones are off
    assert found.wall_ratio("numpy complex128", "fused") > 5.0
    assert found.wall_ratio("scipy complex64", "fused") > 1.0


def test_fifteen_directions_and_thirty_one_wavelengths(bench):
    rng = np.random.default_rng(2)
    halves = [
        half_vector(np.array([x, 0.0, np.sqrt(1 - x * x)]), np.array([0.0, y, np.sqrt(1 - y * y)]))
        for x in np.linspace(0.05, 0.25, 5)
        for y in (-0.1, 0.0, 0.1)
    ]

    def spectra(side):
        surface = WaveSurface.of(np.kron(rng.choice([0.0, 0.125], (side // 8,) * 2), np.ones((8, 8))), PIXEL)
        return lambda: [
            fused.density(surface, half, wavelength, WINDOW)
            for wavelength in np.linspace(0.4, 0.7, 31)
            for half in halves
        ]

    sizes = {side**2: spectra(side) for side in (1024, 2048, SIZE)}
    bench.growth("15 directions × 31 wavelengths", "heights", sizes, rounds=2)


WINDOW_RECIPE = """schema = 1
product = "window"
[surface]
height_map = "window.npz"
pitch_um = 672.0
[material]
reflectance = 0.9
albedo = 0.001
[light]
wavelength_nm = 520.0
bandwidth_nm = 10.0
lamp_half_angle_deg = 0.3
aperture_half_angle_deg = 0.7
[acquisition]
exposure_s = 2.5e-5
[region]
size_mm = [0.672, 0.672]
"""


def test_a_window_of_a_wafer_with_its_budget(bench, tmp_path):
    """Strips of steps that do not repeat; radiances of three poses and what is uncertain of them."""
    rng, height = np.random.default_rng(1), np.empty((896, 896))
    for rows in np.split(height, np.sort(rng.choice(np.arange(1, 896), 16, replace=False))):
        ends = np.flatnonzero(rng.random(896) < 0.12)
        levels = rng.choice([0.0, 0.13, 0.26, 0.39], len(ends) + 1)
        rows[:] = np.repeat(levels, np.diff(ends, prepend=0, append=896))
    write_height_map(HeightMap(height, 0.75, 0.75), tmp_path / "window.npz")
    (tmp_path / "window.toml").write_text(WINDOW_RECIPE)
    recipe = WAFERS.read_recipe(tmp_path / "window.toml")
    works = {"prediction with its budget": lambda: expectation(recipe, 10.0, WAFERS.optics)}
    found = bench.compare("wafer window of 896 × 896 points by waves, three poses", works, rounds=3)
    components = found["prediction with its budget"].result.components
    bench.note(f"{len(components)} sources of uncertainty")
