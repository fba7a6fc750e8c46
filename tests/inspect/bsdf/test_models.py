"""Reflectances of our models against closed forms, against each other, and by their energy."""

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError, ModelError
from anisoscope.bsdf.models import MIRROR, of_design, of_heights, of_heights_by_waves, of_ink, of_ridges
from anisoscope.bsdf.reflectance import albedo, hemisphere
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.ideal import ridges
from anisoscope.sim.light.ink.model import brdf, directional_albedo
from anisoscope.sim.light.material import facet_brdf
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.wave import quadratic
from anisoscope.sim.light.wave.claims import blurred_sinc2, mean_phase
from anisoscope.sim.light.wave.halfvectors import half_vector
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window
from anisoscope.sim.materials.inks import find_ink


def test_a_flat_surface_is_its_facet():
    material = Material(0.1, 0.2)
    light, camera = hemisphere(50, 70.0), np.roll(hemisphere(50, 70.0), 17, axis=0)
    found = of_ridges(RidgeDesign(100.0, 0.0), material).evaluate(light, camera)[:, 0]
    along, across = np.eye(3)[1], np.eye(3)[0]
    wanted = facet_brdf(light, camera, along, -across, np.eye(3)[2], material)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    assert not of_ridges(RidgeDesign(100.0, 0.0), material).isotropic


def test_an_ink_is_its_model_and_its_albedo():
    ink = find_ink("synthetic-red")
    light, camera = hemisphere(20, 60.0), hemisphere(20, 60.0)
    np.testing.assert_allclose(of_ink(ink).evaluate(light, camera), brdf(ink, light, camera), rtol=1e-12)
    np.testing.assert_allclose(albedo(of_ink(ink), 30.0), directional_albedo(ink, 30.0), rtol=5e-3)


def test_what_ridges_leave_out_has_a_number():
    """A second reflection adds a few percent to ridges of 10° (REFLECTANCE: 1 to 4 % at 5°)."""
    (note,) = of_ridges(RidgeDesign(100.0, 10.0), Material(), neglected=True).notes
    assert 0.005 < float(note.partition("would add ")[2].partition("%")[0]) / 100.0 < 0.1


def test_a_map_of_ridges_is_the_ridges(surfaces):
    design, material = RidgeDesign(100.0, 10.0), Material()
    found = of_heights(Relief(ridges(design, (3, 1001), (0.1, 0.1)), 100.0), material, "map")
    light, camera = surfaces.pairs(40, 50.0)
    wanted = of_ridges(design, material).evaluate(light, camera)
    assert surfaces.rms(found.evaluate(light, camera), wanted) < 0.02
    assert found.costly


def steps_of_one_width(width_um=4.0, levels_um=(0.0, 0.1)):
    """Squares of one width with two levels: claim 1 in closed form."""

    def density(frequency, nm, tau):
        lobe, dot = (blurred_sinc2(frequency, one, 16.0 * nm / 500.0) for one in (width_um, 112.0))
        return (1.0 - tau**2) * np.outer(lobe, lobe) + tau**2 * np.outer(dot, dot)

    return of_design("steps", density, levels_um, (112.0, width_um, 16.0), (450.0, 550.0))


def test_etched_steps_in_one_direction():
    light, camera = (np.array([[np.sin(t), 0.0, np.cos(t)]]) for t in (0.3, -0.2))
    half = half_vector(light[0], camera[0])
    found = steps_of_one_width().evaluate(light, camera)[0]
    for nm, value in zip((450.0, 550.0), found, strict=True):
        fx, fy = half.frequency(1e-3 * nm)
        tau = abs(mean_phase((0.0, 0.1), 1e-3 * nm, half.z)) ** 2
        coherence = 16.0 * nm / 500.0
        x, y = (
            [float(blurred_sinc2(np.array([f]), one, coherence)[0]) for one in (4.0, 112.0)] for f in (fx, fy)
        )
        dense = (1.0 - tau) * x[0] * y[0] + tau * x[1] * y[1]
        wanted = half.gamma(1e-3 * nm) ** 2 / (light[0, 2] * camera[0, 2]) * dense
        assert value == pytest.approx(wanted, rel=0.01)


def test_etched_steps_keep_the_energy():
    """A perfect mirror with steps sends all light back, but for the tails of sinc² beyond the horizon (3 %)."""
    for deg in (0.0, 30.0, 50.0):
        np.testing.assert_allclose(albedo(steps_of_one_width(levels_um=(0.0, 0.125)), deg), 0.98, atol=0.03)


@pytest.fixture(scope="module")
def etched():
    rng = np.random.default_rng(3)
    return WaveSurface.of(np.kron(rng.integers(0, 2, (12, 12)), np.ones((4, 4))) * 0.1, 0.5)


def test_waves_on_a_map_are_the_quadratic_form(etched):
    found = of_heights_by_waves(etched, 2.0, "steps", (500.0,))
    window = Window(Extent("disc", 2.0 * np.sin(np.radians(2.0))))
    light = np.array([[np.sin(t), 0.05, 0.0] for t in (0.02, 0.1, 0.2, 0.3)])
    light[:, 2] = np.sqrt(1.0 - np.sum(light**2, axis=1))
    camera = np.broadcast_to([0.0, 0.0, 1.0], light.shape).copy()
    wanted = []
    for one in light:
        half = half_vector(one, camera[0])
        dense = quadratic.density(etched, half, 0.5, window)
        wanted.append(half.gamma(0.5) ** 2 / one[2] * dense)
    np.testing.assert_allclose(found.evaluate(light, camera)[:, 0], wanted, atol=0.03 * max(wanted))
    assert found.notes[0] == MIRROR


def test_maps_that_waves_refuse(etched):
    with pytest.raises(ModelError, match="a lamp of some size"):
        of_heights_by_waves(etched, 0.0, "steps")
    deep = WaveSurface.of(np.kron(np.eye(4), np.ones((8, 8))) * 5.0, 0.5)
    with pytest.raises(ModelError, match=r"5 µm deep.*--optics rays"):
        of_heights_by_waves(deep, 1.0, "steps")
    slope = WaveSurface.of(np.arange(64.0)[None, :] * np.ones((64, 1)), 0.5)
    with pytest.raises(HeightMapError, match="too coarse for wave optics"):
        of_heights_by_waves(slope, 1.0, "slope")
