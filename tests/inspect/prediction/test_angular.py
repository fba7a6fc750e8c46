"""BRDF of height maps over all directions: against single directions by other code, mirrors and energy."""

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError, ModelError
from anisoscope.parameters.light import LightSpectrum
from anisoscope.prediction.angular import AngularTask, angular_reflectance
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.wave.correlation import DensityLadder
from anisoscope.sim.light.wave.reflectance import brdf
from anisoscope.sim.light.wave.surface import WaveSurface


def hills(height_um=0.3):
    """Smooth periodic hills; the deeper they are, the more h_z matters."""
    y, x = np.mgrid[:96, :96] * 0.25
    return height_um * (np.sin(2 * np.pi * x / 6.0) + np.sin(2 * np.pi * y / 8.0))


def test_map_equals_single_directions():
    """`brdf` takes every direction by itself with its own h_z; the map interpolates between a few h_z."""
    task = AngularTask((500.0,), (12.0, 30.0), 0.3, 21, lamp_half_angle_deg=1.5)
    found = angular_reflectance(HeightMap(hills(), 0.25, 0.25), task)
    places = [(10, 10), (6, 12), (14, 3), (8, 8)]
    v = np.array([[found.v[col], found.v[row]] for row, col in places])
    camera = np.column_stack([v, np.sqrt(1.0 - np.sum(v**2, axis=1))])
    light = np.tile(task.to_light, (len(places), 1))
    single = brdf(WaveSurface.of(hills(), 0.25), light, camera, task.window(), LightSpectrum((0.5,)))
    by_map = np.array([found.brdf[0][place] for place in places])
    np.testing.assert_allclose(by_map, single, rtol=0.02, atol=2e-3 * single.max())


def test_a_tilted_mirror_shines_where_its_normal_points_and_loses_nothing():
    slope = 0.05
    plane = slope * 0.5 * np.arange(128)[None, :].repeat(128, axis=0)
    found = angular_reflectance(HeightMap(plane, 0.5, 0.5), AngularTask((550.0,), reach=0.4, points=81))
    normal = np.arctan(slope)
    assert found.peak_at[0] == pytest.approx([-np.sin(2.0 * normal), 0.0], abs=0.011)
    assert found.light_in_map[0] == pytest.approx(1.0, abs=0.06)  # the edges of 64 µm leak


def test_colour_of_a_two_level_wafer_in_the_mirror_direction_is_magenta():
    """Zero mean at 550 nm: green is missing (Levin et al. 2013, Fig. 8)."""
    rng = np.random.default_rng(3)
    cells = rng.permuted(np.tile([0.0, 0.1375], 512)).reshape(32, 32)
    steps = np.kron(cells, np.ones((4, 4)))
    task = AngularTask((400.0, 450.0, 550.0, 650.0, 700.0), points=31)
    found = angular_reflectance(HeightMap(steps, 0.5, 0.5), task)
    _, blue, green, red, _ = found.brdf[:, 15, 15]
    assert green < 0.3 * min(blue, red)
    middle = found.srgb(standard("d65"), 1.0)[15, 15]
    assert middle[1] < min(middle[0], middle[2])
    rows = found.rows()
    assert len(rows) == 5 * 31 * 31
    assert rows[0][4] == 400.0


@pytest.mark.parametrize(
    ("wrong", "error", "words"),
    [
        (lambda: AngularTask(light_deg=(85.0, 0.0)), ModelError, "0 to 80"),
        (lambda: AngularTask(reach=1.5), ModelError, "up to 0.95"),
        (lambda: AngularTask(points=5), ModelError, "11 to 1001"),
        (lambda: AngularTask(()), ModelError, "wavelengths"),
        (
            lambda: angular_reflectance(HeightMap(hills(9.0), 0.25, 0.25), AngularTask()),
            HeightMapError,
            "too coarse for wave optics",
        ),
        (
            lambda: DensityLadder(
                WaveSurface(np.broadcast_to(np.float32(0.0), (10_000, 10_000)), 0.1, 0.1), 0.5,
                AngularTask().window(), (0.9, 1.0),
            ),
            ModelError,
            r"takes 7\.5 GB for all directions",
        ),
        (
            lambda: DensityLadder(
                WaveSurface.of(np.array([[0.0, 40.0]]), 1.0), 0.5, AngularTask().window(), (0.5, 1.0)
            ),
            ModelError,
            "maps of h_z",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_mapped_is_refused(wrong, error, words):
    with pytest.raises(error, match=words):
        wrong()
