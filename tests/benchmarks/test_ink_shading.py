"""Pictures of inks by table against every wavelength at every pixel in numpy; and the two ways to fit an ink."""

import numpy as np
import pytest

from anisoscope.ink.fitting import fit
from anisoscope.ink.goniometer import Readings
from anisoscope.ink.solver import grid_of, solve_jointly
from anisoscope.sim.light.ink import shading
from anisoscope.sim.light.ink.model import brdf_at_angles
from anisoscope.sim.light.ink.shading import Light, picture
from anisoscope.sim.light.ink.shapes import sphere
from anisoscope.sim.materials.inks import SYNTHETIC, synthetic_ink
from spectral_picture import spectral_picture

pytestmark = pytest.mark.benchmark
LIGHTS = [Light((0.3, 0.4, 1.0)), Light((-1.0, 0.2, 0.5), 2.0)]


def test_a_picture_by_table_against_the_sum_over_wavelengths(bench, monkeypatch):
    """Colours as polynomials, as tables with the look-up that inks need that no polynomial follows, and summed."""
    surface, rng = sphere(512, 512), np.random.default_rng(1)
    inks = [synthetic_ink(name) for name in SYNTHETIC]
    halftone = np.eye(3, dtype=np.float32)[rng.integers(0, 3, (512, 512))]
    memory = np.empty((512, 512, 3), dtype=np.float32)
    for words, chosen, coverage in (("one ink", inks[:1], None), ("three inks, halftone", inks, halftone)):

        def shown(target=None, c=chosen, w=coverage):
            return picture(surface, c, LIGHTS, coverage=w, out=target)

        def looked_up(shown=shown):
            with monkeypatch.context() as patch:
                patch.setattr(shading, "_by_series", lambda *_: None)
                return shown(memory)

        found = bench.compare(
            f"512 × 512 pixels, two lights, {words}",
            {
                "polynomial, memory of the frame before": lambda shown=shown: shown(memory),
                "polynomial": shown,
                "look-up": looked_up,
                "41 wavelengths": lambda c=chosen, w=coverage: spectral_picture(
                    surface, c, LIGHTS, coverage=w
                ),
            },
        )
        exact = found["41 wavelengths"].result
        for label in ("polynomial", "look-up"):
            np.testing.assert_allclose(found[label].result, exact, atol=3e-5 * exact.max())
        assert found.wall_ratio("41 wavelengths", "polynomial") > 40.0
        assert found.wall_ratio("41 wavelengths", "look-up") > 20.0


def test_the_joint_fit_against_the_published_one(bench):
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
    found = bench.compare(
        f"{value.size} readings",
        {
            "fit with all checks": lambda: fit(readings),
            "of it the joint solution": lambda: solve_jointly(grid, 0.03),
            "published way": lambda: fit(readings, "paper"),
        },
        rounds=10,
    )
    assert found.ratio("published way", "fit with all checks") > 1.0
