"""Colour against colour-science and published pairs."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.light.colour.illuminant import Illuminant, standard, standard_names
from anisoscope.sim.light.colour.observer import matching_functions, white_point, xyz_weights
from anisoscope.sim.light.colour.spaces import (
    SRGB_WHITE,
    XYZ_TO_SRGB,
    bradford,
    ciede2000,
    encode,
    hexadecimal,
    lab,
    linear_srgb,
)

NM = np.arange(380.0, 781.0, 10.0)


@pytest.fixture(scope="module")
def colour():
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # optional packages that it would also use
        import colour

        yield colour


@pytest.fixture
def spectra(rng):
    """Twelve reflectances at 10 nm: bands of the width of inks, on a base."""
    middle, width = rng.uniform(420, 680, (12, 1)), rng.uniform(25, 80, (12, 1))
    return 0.05 + rng.uniform(0.2, 0.8, (12, 1)) * np.exp(-0.5 * ((NM - middle) / width) ** 2)


@pytest.fixture
def rng():
    return np.random.default_rng(8)


def reference_xyz(colour, name, spectrum):
    illuminant = colour.SDS_ILLUMINANTS[name].copy()
    fine = colour.SpectralShape(380, 780, 1)
    linear = {"interpolator": colour.LinearInterpolator}
    reflectance = colour.SpectralDistribution(dict(zip(NM, spectrum, strict=True))).interpolate(
        fine, **linear
    )
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(fine)
    light = illuminant.interpolate(colour.SpectralShape(illuminant.shape.start, 780, 1), **linear).trim(fine)
    return colour.sd_to_XYZ(reflectance, observer, light, method="Integration") / 100.0


@pytest.mark.parametrize("name", ["D65", "A", "LED-B3", "LED-RGB1", "LED-V2"])
def test_xyz_and_differences_agree_with_colour_science(colour, spectra, name):
    light = standard(name)
    ours = spectra @ xyz_weights(light, NM)
    theirs = np.array([reference_xyz(colour, name, one) for one in spectra])
    white = white_point(light)
    apart = ciede2000(lab(ours, white), colour.XYZ_to_Lab(theirs, colour.XYZ_to_xy(white)))
    assert apart.max() < 0.02
    np.testing.assert_allclose(
        ciede2000(lab(ours[:6], white), lab(ours[6:], white)),
        colour.delta_E(lab(ours[:6], white), lab(ours[6:], white), method="CIE 2000"),
        atol=1e-9,
    )


def test_srgb_agrees_with_colour_science(colour, spectra):
    xyz = spectra @ xyz_weights(standard("d65"), NM)
    theirs = colour.XYZ_to_sRGB(xyz)
    np.testing.assert_allclose(encode(linear_srgb(xyz)).srgb, np.clip(theirs, 0, 1), atol=2e-4)


def test_bradford_agrees_with_colour_science(colour, spectra):
    light = standard("a")
    xyz = spectra @ xyz_weights(light, NM)
    white = white_point(light)
    theirs = colour.chromatic_adaptation(xyz, white, SRGB_WHITE, method="Von Kries", transform="Bradford")
    np.testing.assert_allclose(xyz @ bradford(white, SRGB_WHITE).T, theirs, atol=2e-6)
    np.testing.assert_allclose(white @ bradford(white, SRGB_WHITE).T, SRGB_WHITE, atol=1e-12)


# G. Sharma, W. Wu and E. N. Dalal 2005, Color Res. Appl. 30, 21-30, table 1: L a b, L a b, difference.
SHARMA = """
50 2.6772 -79.7751 50 0 -82.7485 2.0425
50 3.1571 -77.2803 50 0 -82.7485 2.8615
50 2.8361 -74.0200 50 0 -82.7485 3.4412
50 -1.3802 -84.2814 50 0 -82.7485 1.0000
50 -1.1848 -84.8006 50 0 -82.7485 1.0000
50 -0.9009 -85.5211 50 0 -82.7485 1.0000
50 0 0 50 -1 2 2.3669
50 -1 2 50 0 0 2.3669
50 2.4900 -0.0010 50 -2.4900 0.0009 7.1792
50 2.4900 -0.0010 50 -2.4900 0.0010 7.1792
50 2.4900 -0.0010 50 -2.4900 0.0011 7.2195
50 2.4900 -0.0010 50 -2.4900 0.0012 7.2195
50 -0.0010 2.4900 50 0.0009 -2.4900 4.8045
50 -0.0010 2.4900 50 0.0010 -2.4900 4.8045
50 -0.0010 2.4900 50 0.0011 -2.4900 4.7461
50 2.5 0 50 0 -2.5 4.3065
50 2.5 0 73 25 -18 27.1492
50 2.5 0 61 -5 29 22.8977
50 2.5 0 56 -27 -3 31.9030
50 2.5 0 58 24 15 19.4535
50 2.5 0 50 3.1736 0.5854 1.0000
50 2.5 0 50 3.2972 0 1.0000
50 2.5 0 50 1.8634 0.5757 1.0000
50 2.5 0 50 3.2592 0.3350 1.0000
60.2574 -34.0099 36.2677 60.4626 -34.1751 39.4387 1.2644
63.0109 -31.0961 -5.8663 62.8187 -29.7946 -4.0864 1.2630
61.2901 3.7196 -5.3901 61.4292 2.2480 -4.9620 1.8731
35.0831 -44.1164 3.7933 35.0232 -40.0716 1.5901 1.8645
22.7233 20.0904 -46.6940 23.0331 14.9730 -42.5619 2.0373
36.4612 47.8580 18.3852 36.2715 50.5065 21.2231 1.4146
90.8027 -2.0831 1.4410 91.1528 -1.6435 0.0447 1.4441
90.9257 -0.5406 -0.9208 88.6381 -0.8985 -0.7239 1.5381
6.7747 -0.2908 -2.4247 5.8714 -0.0985 -2.2286 0.6377
2.0776 0.0795 -1.1350 0.9033 -0.0636 -0.5514 0.9082
"""


def test_the_published_pairs_of_ciede2000():
    rows = np.array([line.split() for line in SHARMA.split("\n") if line], dtype=float)
    assert len(rows) == 34
    np.testing.assert_allclose(ciede2000(rows[:, :3], rows[:, 3:6]), rows[:, 6], atol=5e-5)
    np.testing.assert_allclose(ciede2000(rows[:, 3:6], rows[:, :3]), rows[:, 6], atol=5e-5)


def test_white_is_white():
    for name in standard_names():
        light = standard(name)
        np.testing.assert_allclose(xyz_weights(light, NM).sum(axis=0), white_point(light), rtol=1e-12)
        np.testing.assert_allclose(lab(white_point(light), white_point(light)), [100, 0, 0], atol=1e-9)
    np.testing.assert_allclose(linear_srgb(SRGB_WHITE), 1.0, atol=1e-12)
    np.testing.assert_allclose(
        XYZ_TO_SRGB[0], [3.2406, -1.5372, -0.4986], atol=5e-4
    )  # as the standard prints it
    xyz = white_point(standard("d65"))
    np.testing.assert_allclose(xyz[:2] / xyz.sum(), [0.31272, 0.32903], atol=4e-5)  # CIE 015


def test_lines_of_a_lamp_keep_their_power_wherever_they_fall(spectra):
    """A fluorescent lamp: against the sum by 0.1 nm, points every 10 nm are ΔE 1 to 10 off, these weights < 0.05."""
    fine = np.arange(380.0, 780.05, 0.1)
    lines = ((404.7, 0.4), (435.8, 1.2), (546.1, 2.4), (577.9, 0.5), (611.6, 2.8), (587.0, 0.8))
    power = 0.05 + sum(h * np.exp(-0.5 * ((fine - at) / 1.0) ** 2) for at, h in lines)
    lamp = Illuminant("lamp", tuple(fine), tuple(power))
    grid, matching = matching_functions()
    bars = np.stack([np.interp(fine, grid, part) for part in matching.T], axis=1)
    exact = np.stack([np.interp(fine, NM, one) for one in spectra]) * power @ bars / (power @ bars[:, 1])
    pointed = np.interp(NM, fine, power)[:, None] * np.stack(
        [np.interp(NM, grid, p) for p in matching.T], axis=1
    )
    pointed = spectra @ pointed / pointed[:, 1].sum()
    white = white_point(lamp)
    ours = ciede2000(lab(spectra @ xyz_weights(lamp, NM), white), lab(exact, white))
    coarse = ciede2000(lab(pointed, white), lab(exact, white))
    assert ours.max() < 0.05
    assert np.median(coarse) > 1.0
    bands = lamp.band_means(NM, 10.0)
    width = np.where((NM == 380) | (NM == 780), 5.0, 10.0)
    assert bands @ width == pytest.approx(np.trapezoid(power, fine), rel=1e-9)


def test_colours_out_of_gamut_are_counted_and_clipped_once():
    found = encode(np.array([[0.5, 0.5, 0.5], [-0.1, 0.2, 0.3], [0.2, 1.7, 0.1], [1.0, 0.0, 1.0 + 1e-9]]))
    assert found.clipped == 2
    assert (found.srgb.min(), found.srgb.max()) == pytest.approx((0.0, 1.0))
    assert found.srgb.max() <= 1.0
    assert hexadecimal(found.srgb[0]) == "#bcbcbc"


@pytest.mark.parametrize(
    ("nm", "power", "words"),
    [
        ((380.0, 780.0), (1.0,), "power for each"),
        ((380.0, 380.0, 780.0), (1.0, 1.0, 1.0), "rise"),
        ((450.0, 780.0), (1.0, 1.0), "400 to 700"),
        ((380.0, 780.0), (1.0, -1.0), "0 or more"),
        ((380.0, 780.0), (0.0, 0.0), "not all zero"),
    ],
)
def test_what_is_no_lamp_is_refused(nm, power, words):
    with pytest.raises(ModelError, match=words):
        Illuminant("lamp", nm, power)


def test_what_gives_no_colour_is_refused():
    with pytest.raises(ModelError, match="known: d65"):
        standard("d66")
    with pytest.raises(ModelError, match="400 to 700"):
        xyz_weights(standard("d65"), np.arange(500.0, 701.0, 10.0))
    with pytest.raises(ModelError, match="rise"):
        xyz_weights(standard("d65"), NM[::-1])
