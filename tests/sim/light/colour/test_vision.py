"""What a camera makes of spectra: sums of photons, against sums of our own."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.light.colour.illuminant import Illuminant, standard
from anisoscope.sim.light.colour.lamps import synthetic_white_led
from anisoscope.sim.light.colour.observer import matching_functions, xyz_weights
from anisoscope.sim.light.colour.vision import Sensitivities, Vision, synthetic_bayer, synthetic_silicon

NM = np.arange(380.0, 781.0, 10.0)
CAMERAS = (synthetic_bayer(), synthetic_silicon())
LAMPS = (synthetic_white_led(), standard("d65"), standard("a"))


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.name)
@pytest.mark.parametrize("lamp", LAMPS, ids=lambda lamp: lamp.name)
def test_grey_is_the_same_number_in_every_channel(camera, lamp):
    vision = Vision(lamp, camera)
    seen = (0.37 * np.ones(NM.size)) @ vision.weights(NM)
    np.testing.assert_allclose(seen, 0.37, rtol=1e-12)
    strengths = vision.strengths()
    assert strengths.shape == (len(camera.curves),)
    assert strengths.max() == 1.0
    assert strengths.min() > 0.0


def test_channels_count_photons():
    """∫ f S λ q dλ by the trapezium rule on a grid 20 times as fine as ours."""
    fine = np.linspace(380.0, 780.0, 8001)
    vision = Vision(standard("d65"), synthetic_bayer())
    spectrum = np.interp(fine, NM, 0.3 + 0.2 * np.sin(NM / 23.0))
    power = np.interp(fine, standard("d65").wavelengths_nm, standard("d65").power)
    expected = []
    for curve in vision.sensitivities.curves:
        photons = power * fine * np.interp(fine, vision.sensitivities.wavelengths_nm, curve)
        expected.append(np.trapezoid(photons * spectrum, fine) / np.trapezoid(photons, fine))
    seen = np.interp(NM, fine, spectrum) @ vision.weights(NM)
    np.testing.assert_allclose(seen, expected, rtol=1e-4)


def test_a_narrow_line_is_counted_by_sensitivity_times_wavelength():
    """Two equal lines of power: their shares in a channel are as λ·q at the lines."""
    nm = np.arange(380.0, 780.5, 0.5)
    power = np.where(np.abs(nm - 450.0) < 0.6, 1.0, 0.0) + np.where(np.abs(nm - 600.0) < 0.6, 1.0, 0.0)
    lamp = Illuminant("two lines", tuple(nm), tuple(power))
    vision = Vision(lamp, synthetic_bayer())
    blue_only = np.where(NM < 520.0, 1.0, 0.0) @ vision.weights(NM)
    q = np.array(
        [
            np.interp([450.0, 600.0], vision.sensitivities.wavelengths_nm, c)
            for c in vision.sensitivities.curves
        ]
    )
    expected = 450.0 * q[:, 0] / (450.0 * q[:, 0] + 600.0 * q[:, 1])
    np.testing.assert_allclose(blue_only, expected, atol=2e-3)


def test_a_camera_that_is_the_eye_sees_xyz():
    """Sensitivities x̄/λ … give the weights of the CIE observer, each channel over its own white."""
    fine, matching = matching_functions()
    eye = Sensitivities("eye", tuple(fine), tuple(tuple(one) for one in (matching / fine[:, None]).T))
    lamp = standard("d65")
    expected = xyz_weights(lamp, NM)
    np.testing.assert_allclose(Vision(lamp, eye).weights(NM), expected / expected.sum(axis=0), atol=1e-12)


def test_the_made_up_camera_has_three_channels_that_overlap_in_order():
    camera = synthetic_bayer()
    nm, curves = np.array(camera.wavelengths_nm), np.array(camera.curves)
    red, green, blue = (float(nm[np.argmax(curve)]) for curve in curves)
    assert 440.0 < blue < 480.0
    assert 510.0 < green < 550.0
    assert 580.0 < red < 640.0
    assert curves.max() < 0.65  # a quantum efficiency, as data sheets have them
    neighbours = np.minimum(curves[0], curves[1]).sum() / curves[1].sum()
    assert 0.1 < neighbours < 0.4
    assert curves[:, nm > 720.0].max() < 0.01  # behind an infrared cut


def test_the_made_up_lamp_is_white():
    x, y, z = xyz_weights(synthetic_white_led(), NM).sum(axis=0)
    n = (x / (x + y + z) - 0.3320) / (0.1858 - y / (x + y + z))
    assert 4000.0 < 449.0 * n**3 + 3525.0 * n**2 + 6823.3 * n + 5520.33 < 5500.0  # McCamy 1992


GOOD = {"name": "mine", "wavelengths_nm": (400.0, 500.0, 700.0), "curves": ((0.1, 0.5, 0.2),)}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"wavelengths_nm": (400.0, 400.0, 700.0)}, "must be finite and rise"),
        ({"wavelengths_nm": (420.0, 500.0, 700.0)}, "reach from 420 to 700 nm"),
        ({"curves": ((0.1, 0.5, 0.2),) * 2}, "one channel or three, not 2"),
        ({"curves": ((0.1, 0.5),)}, "a value at every wavelength"),
        ({"curves": ((0.1, -0.5, 0.2),)}, "0 or more"),
        ({"curves": ((0.0, 0.0, 0.0),)}, "not all zero"),
    ],
)
def test_curves_that_no_camera_has_are_refused(changes, words):
    with pytest.raises(ModelError, match=rf"sensitivities mine: .*{words}"):
        Sensitivities(**GOOD | changes)


def test_spectra_that_do_not_reach_are_refused():
    vision = Vision(standard("a"), synthetic_bayer())
    with pytest.raises(ModelError, match="has no colour"):
        vision.weights(np.array([450.0, 700.0]))
    with pytest.raises(ModelError, match="must rise"):
        vision.weights(np.array([400.0]))


def test_a_channel_that_sees_nothing_of_the_lamp_is_refused_and_named():
    """Else it would be a mean over no light."""
    blue = Illuminant("blue lamp", (400.0, 440.0, 480.0, 490.0, 700.0), (0.0, 1.0, 1.0, 0.0, 0.0))
    nm, block = (400.0, 500.0, 501.0, 700.0), (0.0, 0.0, 0.3, 0.3)
    camera = Sensitivities("mine", nm, (block, (0.3, 0.3, 0.3, 0.3), (0.4, 0.4, 0.0, 0.0)))
    with pytest.raises(ModelError, match="the red channel of mine sees nothing of the light of blue lamp"):
        Vision(blue, camera)
    assert Vision(synthetic_white_led(), camera).strengths().min() > 0.0
