"""Predictions by waves must not depend on the pixels, and what pixels or map do not hold is refused."""

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.light import LightSpectrum
from anisoscope.parameters.material import Material
from anisoscope.parameters.optics import Optics
from anisoscope.prediction.optics_selection import Rig, _halves, _window, fine_enough
from anisoscope.prediction.wave import WavePredictor
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.wave.surface import WaveSurface

GREEN = LightSpectrum((0.5,))
POSES = (Pose(0.0, 0.0), Pose(0.0, 20.0))
PLASTIC = Material(0.10, 0.10, 0.0, 1.5)


def predicted(surface, material=PLASTIC):
    rig = Rig(material, POSES, Convention(10.0, "perpendicular", 0.0))
    fine = fine_enough(surface, _window(rig), GREEN, _halves(rig))
    found = WavePredictor(fine, None, rig.optics, GREEN)
    return found(*directions(rig.poses, rig.convention), material)


@pytest.mark.parametrize("pixel_um", [1.0, 4.0])
def test_a_plane_looks_the_same_on_coarse_and_on_fine_pixels(pixel_um):
    """What folds back at coarse pixels lights the dark pose; there only what rounding leaves may be."""
    bright, dark = predicted(WaveSurface.of(np.zeros((32, 32)), pixel_um))
    expected = predicted(WaveSurface.of(np.zeros(2000), 0.05))
    assert bright == pytest.approx(expected[0], rel=5e-4)
    assert dark < 1e-5 * bright


def test_pixels_that_would_fold_are_refused_with_the_remedy():
    with pytest.raises(HeightMapError, match=r"--interpolate 53.*geometric"):
        predicted(WaveSurface.of(np.zeros((32, 32)), 10.0))


@pytest.mark.parametrize("profile", [False, True])
def test_steps_look_the_same_on_few_and_on_many_pixels(profile):
    """A step of 2 µm is one of 2 µm, whether it is drawn as one pixel or as eight, in the tail of the lobe too."""
    levels = np.random.default_rng(0).choice([0.0, 0.125], (1, 400) if profile else (40, 40))
    found = []
    for parts in (1, 8):
        heights = np.kron(levels, np.ones((parts, parts)))
        surface = WaveSurface.of(heights[0] if profile else heights, 2.0 / parts, cells=True)
        found.append(predicted(surface))
    np.testing.assert_allclose(found[0], found[1], rtol=0.03, atol=1e-5 * found[1].max())


def test_a_map_smaller_than_light_is_coherent_over_is_refused():
    """Cut off at 60 µm the lobe of polished metal would be a fraction of what it is."""
    polished = Material(0.001, 0.001, 0.0, 1.5)
    up = np.array([[0.0, 0.0, 1.0]])
    with pytest.raises(HeightMapError, match="larger map, a rougher plastic"):
        WavePredictor(WaveSurface.of(np.zeros(240), 0.25), None, Optics(), GREEN)(up, up, polished)
    whole, larger = (
        WavePredictor(WaveSurface.of(np.zeros(count), 0.25), None, Optics(), GREEN)(up, up, polished)[0]
        for count in (1200, 2400)
    )
    assert whole == pytest.approx(larger, rel=5e-4)
