"""The roughness of a plastic is split between the slopes of the map and the lobe of its facets."""

import numpy as np
import pytest

from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.relief import Relief, radiance
from anisoscope.sim.light.unresolved import SMOOTHEST, resolve


def rough(along, across, rows=600, seed=3):
    surface = ridges(RidgeDesign(100.0, 10.0), (rows, 601), 1.0)
    return add_facet_roughness(surface, along, across, 8.0, np.random.default_rng(seed))


def test_resolved_roughness_is_that_of_the_map():
    found = resolve(Relief(rough(0.05, 0.05), 100.0))
    z = rough(0.05, 0.05).height_um - ridges(RidgeDesign(100.0, 10.0), (600, 601), 1.0).height_um
    for alpha, axis in ((found.along, 0), (found.across, 1)):
        step = np.diff(z, axis=axis)
        slope = 0.5 * (step[1:] + step[:-1] if axis == 1 else step[:, 1:] + step[:, :-1])
        assert alpha == pytest.approx(np.sqrt(2.0) * slope.std(), rel=0.05)
    assert found.lobe(Material(0.1, 0.1)).alpha_along == pytest.approx(np.sqrt(0.1**2 - found.along**2))
    assert not found.exhausts(Material(0.1, 0.1))


def test_ideal_ridges_resolve_nothing():
    found = resolve(Relief(ridges(RidgeDesign(100.0, 10.0), (50, 601), 1.0), 100.0))
    assert found.along < 1e-6
    assert found.across < 1e-3
    assert found.lobe(Material()).alpha_along == pytest.approx(0.06, rel=1e-3)


def test_noise_is_taken_off():
    z = 0.02 * np.random.default_rng(1).normal(size=(400, 400))
    relief = Relief(HeightMap(z, 1.0, 2.0))
    loud, quiet = resolve(relief), resolve(relief, 0.02)
    assert loud.across == pytest.approx(np.sqrt(2.0) * 0.02, rel=0.03)
    assert loud.along == pytest.approx(np.sqrt(2.0) * 0.01, rel=0.03)
    assert max(quiet.across, quiet.along) < 0.3 * loud.along


def test_a_map_rougher_than_the_plastic_leaves_nothing():
    found = resolve(Relief(rough(0.05, 0.05), 100.0))
    assert found.exhausts(Material(0.02, 0.02))
    assert found.lobe(Material(0.02, 0.02)).alpha_across == SMOOTHEST


def test_prediction_hardly_depends_on_what_the_map_resolves():
    """The same plastic, seen by maps that resolve more or less of its roughness, shows the same."""
    material = Material(0.1, 0.1)
    to_light, to_camera = directions(pose_grid((0.0, 90.0, 180.0), (0.0, 10.0)), Convention())
    smooth = Relief(ridges(RidgeDesign(100.0, 10.0), (600, 601), 1.0), 100.0)
    expected = radiance(smooth, to_light, to_camera, material)
    relief = Relief(rough(0.05, 0.05), 100.0)
    lobe = resolve(relief).lobe(material)
    once = radiance(relief, to_light, to_camera, lobe) / expected - 1.0
    twice = radiance(relief, to_light, to_camera, material) / expected - 1.0
    assert np.max(np.abs(once)) < 0.06
    assert np.max(np.abs(twice)) > 3.0 * np.max(np.abs(once))
