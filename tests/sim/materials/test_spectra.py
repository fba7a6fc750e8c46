"""Spectra in files: those of cameras and substrates; those of lamps are tried beside the inks."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.sim.light.colour.vision import synthetic_bayer, synthetic_silicon
from anisoscope.sim.materials.spectra import (
    find_illuminant,
    find_sensitivities,
    read_reflectance,
    read_sensitivities,
)

COLOUR = "wavelength_nm,red,green,blue\n400,0,0.1,0.4\n550,0.2,0.6,0.1\n700,0.3,0.1,0\n"
MONO = "wavelength_nm,mono\n380,0.2\n550,0.6\n780,0.1\n"


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "curves.csv"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_three_channels_and_one(written):
    colour = read_sensitivities(written(COLOUR))
    assert colour.wavelengths_nm == (400.0, 550.0, 700.0)
    assert colour.curves == ((0.0, 0.2, 0.3), (0.1, 0.6, 0.1), (0.4, 0.1, 0.0))
    assert read_sensitivities(written(MONO)).curves == ((0.2, 0.6, 0.1),)


def test_the_file_has_the_channels_of_the_camera(written):
    path = str(written(COLOUR))
    assert find_sensitivities(path, "grbg").name == "curves"
    with pytest.raises(UsageError, match=r"filters 'mono' needs the columns wavelength_nm,mono"):
        find_sensitivities(path, "mono")
    with pytest.raises(UsageError, match=r"filters 'rggb' needs the columns wavelength_nm,red,green,blue"):
        find_sensitivities(str(written(MONO)), "rggb")


def test_made_up_ones_have_names():
    assert find_sensitivities("synthetic", "bggr") is synthetic_bayer()
    assert find_sensitivities("synthetic", "mono") is synthetic_silicon()
    assert "synthetic" in find_illuminant("led-white").name
    with pytest.raises(
        UsageError, match=r"no sensitivities are named 'imx'; known: synthetic, or a file \*\.csv"
    ):
        find_sensitivities("imx", "rggb")
    with pytest.raises(UsageError, match=r"no illuminant is named 'sun'; known: .*led-white, or a file"):
        find_illuminant("sun")


def test_reflectance(written):
    nm, share = read_reflectance(written("wavelength_nm,reflectance\n400,0.02\n700,0.05\n"))
    np.testing.assert_array_equal([nm, share], [[400.0, 700.0], [0.02, 0.05]])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("wavelength_nm,red,green\n400,1,1\n", "line 1: the header must read wavelength_nm,red,green,blue"),
        (COLOUR.replace("0.6", "-0.6"), "line 3: green must be a finite number, 0 or more"),
        (COLOUR.replace("400", "430"), "at least 400 to 700 nm"),
        ("wavelength_nm,mono\n0.4,1\n0.55,1\n0.7,1\n", "looks like µm"),
    ],
)
def test_what_is_wrong_in_a_file_of_sensitivities_is_told(written, text, words):
    with pytest.raises(UsageError, match=words):
        read_sensitivities(written(text))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("wavelength_nm,reflectance\n400,2\n700,5\n", "write shares, not %"),
        ("wavelength_nm,reflectance\n450,0.2\n700,0.5\n", "from 400 to 700 nm"),
        ("wavelength_nm,reflectance\n700,0.2\n400,0.5\n", "must rise"),
    ],
)
def test_what_is_wrong_in_a_file_of_a_reflectance_is_told(written, text, words):
    with pytest.raises(UsageError, match=words):
        read_reflectance(written(text))
