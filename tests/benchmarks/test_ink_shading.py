"""Pictures of inks by table against every wavelength at every pixel in numpy; and the two ways to fit an ink."""

import time

import numpy as np
import pytest

from anisoscope.ink.fitting import fit, grid_of, solve_jointly
from anisoscope.ink.goniometer import Readings
from anisoscope.sim.light.ink import shading
from anisoscope.sim.light.ink.model import brdf_at_angles
from anisoscope.sim.light.ink.shading import Light, picture, spectral_picture
from anisoscope.sim.light.ink.shapes import sphere
from anisoscope.sim.materials.inks import SYNTHETIC, synthetic_ink

pytestmark = pytest.mark.benchmark
LIGHTS = [Light((0.3, 0.4, 1.0)), Light((-1.0, 0.2, 0.5), 2.0)]


def best(function, repeats):
    result, times = timed(function, repeats)
    return result, min(times)


def timed(function, repeats):
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - start)
    return result, times


def test_a_picture_by_table_against_the_sum_over_wavelengths(monkeypatch):
    """Colours as polynomials, as tables with the look-up that inks need that no polynomial follows, and summed."""
    surface, rng = sphere(512, 512), np.random.default_rng(1)
    inks = [synthetic_ink(name) for name in SYNTHETIC]
    halftone = np.eye(3, dtype=np.float32)[rng.integers(0, 3, (512, 512))]
    kept = np.empty((512, 512, 3), dtype=np.float32)
    for words, chosen, coverage in (("one ink", inks[:1], None), ("three inks, halftone", inks, halftone)):
        slow, plain = best(lambda c=chosen, w=coverage: spectral_picture(surface, c, LIGHTS, coverage=w), 1)
        for way in ("polynomial", "look-up"):
            with monkeypatch.context() as patch:
                if way == "look-up":
                    patch.setattr(shading, "_by_series", lambda *_: None)
                for target in (None, kept):

                    def shown(c=chosen, w=coverage, target=target):
                        return picture(surface, c, LIGHTS, coverage=w, out=target)

                    shown()  # compile
                    fast, times = timed(shown, 200)
                    np.testing.assert_allclose(fast, slow, atol=3e-5 * slow.max())
                    print(
                        f"\n512², two lights, {words}, {way}, {'new' if target is None else 'kept'} memory: "
                        f"best {1e3 * min(times):.2f} ms, median {1e3 * np.median(times):.2f} ms; "
                        f"41 wavelengths {1e3 * plain:.0f} ms, ratio {plain / min(times):.0f}"
                    )
                    assert plain > (40.0 if way == "polynomial" else 20.0) * min(times)


def test_the_joint_fit_against_the_published_one():
    ink, rng = synthetic_ink("synthetic-green"), np.random.default_rng(2)
    at = np.array(
        [(i, o) for i in (20, 30, 40, 50, 60, 65, 70) for o in sorted({*range(0, 76, 5), i})], dtype=float
    )
    value = brdf_at_angles(ink, at[:, 0], at[:, 1])
    value *= 1 + 0.03 * rng.standard_normal(value.shape)
    angles = np.repeat(at, 41, axis=0)
    lines = tuple(range(value.size))
    readings = Readings(angles[:, 0], angles[:, 1], np.tile(ink.nm, len(at)), value.ravel(), lines)
    grid = grid_of(readings)
    _, solved = best(lambda: solve_jointly(grid, 0.03), 30)
    _, joint = best(lambda: fit(readings), 30)
    _, paper = best(lambda: fit(readings, "paper"), 10)
    print(f"\n{value.size} readings: solved in {1e3 * solved:.2f} ms; with all checks {1e3 * joint:.2f} ms")
    print(f"published way {1e3 * paper:.2f} ms, ratio {paper / joint:.1f}")
    assert joint < paper
