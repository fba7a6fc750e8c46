"""Waves on a graphics card against two cores, in one run; results differ by less than 1e-5 of the highest density."""

import numba
import numpy as np
import pytest

from anisoscope.sim.light.wave import fused, gpu
from anisoscope.sim.light.wave.correlation import angular_map
from anisoscope.sim.light.wave.halfvectors import half_vector
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window

pytestmark = pytest.mark.benchmark
SIZE, PIXEL, WAVELENGTH, COHERENCE = 4096, 0.25, 0.5, 16.0
WINDOW = Window(Extent("rect", WAVELENGTH / COHERENCE))


def test_a_graphics_card_against_two_cores(bench, monkeypatch):
    problem = gpu.card_problem()
    if problem is not None:
        pytest.skip(f"no graphics card: {problem}")
    monkeypatch.setenv(gpu.VARIABLE, "1")
    card = gpu.library()
    monkeypatch.setenv(gpu.VARIABLE, "0")
    before = numba.get_num_threads()
    numba.set_num_threads(2)
    rng = np.random.default_rng(2)
    surface = WaveSurface.of(np.kron(rng.choice([0.0, 0.125], (SIZE // 8,) * 2), np.ones((8, 8))), PIXEL)
    halves = [
        half_vector(np.array([x, 0.0, np.sqrt(1 - x * x)]), np.array([0.0, y, np.sqrt(1 - y * y)]))
        for x in np.linspace(0.05, 0.25, 5)
        for y in (-0.1, 0.0, 0.1)
    ]

    def spectra(library):
        return np.array(
            [
                fused.density(surface, half, um, WINDOW, library)
                for um in np.linspace(0.4, 0.7, 31)
                for half in halves
            ]
        )

    def everywhere(on_card):
        monkeypatch.setenv(gpu.VARIABLE, on_card)
        return angular_map(surface, WAVELENGTH, WINDOW).density

    works = {
        "fifteen directions, 31 wavelengths": (lambda: spectra(card), lambda: spectra(gpu.library())),
        "all directions, one wavelength": (lambda: everywhere("1"), lambda: everywhere("0")),
    }
    for name, (fast, slow) in works.items():
        monkeypatch.setenv(gpu.VARIABLE, "0")
        found = bench.compare(
            f"{SIZE} × {SIZE} heights, {name}", {"graphics card": fast, "two cores": slow}, rounds=3
        )
        cores = found["two cores"].result
        off = np.abs(found["graphics card"].result - cores).max() / cores.max()
        bench.note(
            f"{name}: {found.wall_ratio('two cores', 'graphics card'):.0f} × two cores; off by {off:.1e} of the highest"
        )
        assert off < 1e-5
        assert found.wall_ratio("two cores", "graphics card") > 5.0
    numba.set_num_threads(before)
