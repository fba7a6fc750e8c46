"""Ink files, lamps and goniometer tables: round trips, and one clear line for every mistake."""

import re

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.ink.goniometer import White, read_correction, read_goniometer, to_brdf
from anisoscope.sim.materials.inks import (
    SYNTHETIC,
    InkFileError,
    find_ink,
    ink_text,
    read_ink,
    read_ink_table,
    synthetic_ink,
    with_roughness,
    write_ink,
)
from anisoscope.sim.materials.spectra import find_illuminant, read_spectrum

GOOD = """
schema = 1
name = "mine"
source = "a bench of mine"
convention = "factor"
white = 0.985
alpha_x = 0.2
alpha_y = 0.25
brush_deg = 30.0
wavelengths_nm = [400.0, 500.0, 600.0, 700.0]
rho = [0.1, 0.2, 0.3, 0.4]
c = [1.0, 0.5, 0.0, -0.5]
"""


@pytest.fixture
def written(tmp_path):
    def write(text, name="ink.toml"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_a_file_holds_its_ink(written, tmp_path):
    ink = read_ink(written(GOOD))
    assert (ink.name, ink.alpha, ink.across, ink.brush_deg, ink.white) == ("mine", 0.2, 0.25, 30.0, 0.985)
    np.testing.assert_allclose(ink.rho_brdf, 0.985 / np.pi * np.array([0.1, 0.2, 0.3, 0.4]))
    write_ink(ink, tmp_path / "again.toml", ["a remark"])
    assert read_ink(tmp_path / "again.toml") == ink
    assert (tmp_path / "again.toml").read_text().startswith("# a remark\n")


@pytest.mark.parametrize("name", SYNTHETIC)
def test_inks_of_the_package_say_that_they_are_made_up(name):
    ink = synthetic_ink(name)
    assert "synthetic" in ink.name
    assert ink.source.startswith("synthetic, not measured")
    peak, width = map(float, re.findall(r"wavelength - (\d+) nm\)/(\d+) nm", ink.source)[0])
    u = (ink.nm - peak) / width
    np.testing.assert_allclose(ink.rho, 0.04 + 0.30 * np.exp(-(u**2) / 2), atol=1e-5)
    np.testing.assert_allclose(ink.c, 0.8 - 1.4 * u * np.exp(-(u**2) / 4), atol=1e-5)
    assert find_ink(name) is ink
    assert with_roughness(ink, 0.3).alpha == 0.3
    assert "alpha = 0.19" in ink_text(ink)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("schema = 1", "schema = 2", "schema: input should be 1"),
        ("500.0, 600.0", "600.0, 500.0", "500 nm follows 600 nm"),
        ("[400.0, 500.0, 600.0, 700.0]", "[0.4, 0.5, 0.6, 0.7]", "look like µm"),
        ("0.2, 0.3, 0.4]", "0.2, -0.3, 0.4]", "rho at 600 nm is -0.3"),
        ("0.2, 0.3, 0.4]", "0.2, nan, 0.4]", "rho"),
        ("0.2, 0.3, 0.4]", "0.2, 0.3]", "4 wavelengths, 3 rho, 4 c"),
        ("[400.0, 500.0, 600.0, 700.0]", "[400.0, 410.0, 420.0, 700.0]", "gap between 420 and 700"),
        ("alpha_y = 0.25\n", "", "both alpha_x and alpha_y"),
        ("brush_deg = 30.0", "alpha = 0.2", "either alpha"),
        ("alpha_x", "alfa_x", "alfa_x: unknown key"),
        ('"factor"', '"percent"', "convention"),
    ],
)
def test_a_wrong_file_is_one_clear_line(written, old, new, words):
    assert old in GOOD
    path = written(GOOD.replace(old, new))
    with pytest.raises(InkFileError, match=re.escape(words)) as error:
        read_ink(path)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)


def test_a_table_of_spectra_is_an_ink(written):
    path = written("wavelength_nm,rho,c\n400,0.1,1\n500,0.2,0.5\n700,0.3,0\n", "mine.csv")
    ink = read_ink_table(path, 0.21, convention="brdf")
    assert (ink.name, ink.alpha, ink.rho, ink.c) == ("mine", 0.21, (0.1, 0.2, 0.3), (1.0, 0.5, 0.0))
    for text, words in (
        ("wavelength_nm,rho\n400,1\n", "header must read wavelength_nm,rho,c"),
        ("wavelength_nm,rho,c\n400,-1,0\n500,1,0\n", "line 2: rho"),
        ("wavelength_nm,rho,c\n400,nan,0\n500,1,0\n", "line 2: rho"),
        ("wavelength_nm,rho,c\n0.4,1,0\n0.5,1,0\n", "look like µm"),
        ("wavelength_nm,rho,c\n500,1,0\n400,1,0\n", "must rise"),
    ):
        with pytest.raises((UsageError, InkFileError), match=words):
            read_ink_table(written(text, "bad.csv"), 0.2, convention="brdf")


def test_names_that_lead_nowhere(tmp_path):
    with pytest.raises(UsageError, match="synthetic-red"):
        find_ink("crimson")
    with pytest.raises(InkFileError, match="no such file"):
        find_ink(str(tmp_path / "none.toml"))
    with pytest.raises(UsageError, match="led-b3"):
        find_illuminant("d50")


def test_a_lamp_from_a_file(written):
    lamp = read_spectrum(written("wavelength_nm,power\n380,1\n500,2.5\n780,0\n", "lamp.csv"))
    assert (lamp.name, lamp.power) == ("lamp", (1.0, 2.5, 0.0))
    assert find_illuminant("LED-B3").name == "LED-B3"
    for text, words in (
        ("380,1\n370,1\n780,1", "rise"),
        ("450,1\n780,1", "400 to 700"),
        ("0.38,1\n0.78,1", "µm"),
        ("380,1\n780,-1", "line 3: power"),
    ):
        with pytest.raises(UsageError, match=words):
            find_illuminant(str(written(f"wavelength_nm,power\n{text}\n", "bad.csv")))


HEADER = "theta_i_deg,theta_o_deg,wavelength_nm,value\n"


@pytest.fixture
def two(written):
    return read_goniometer(written(HEADER + "20,20,500,2\n65,60,600,4\n", "two.csv"))


def test_scales_of_readings(two, written):
    np.testing.assert_array_equal(to_brdf(two, "brdf", White()).value, [2, 4])
    factor = to_brdf(two, "factor", White())
    np.testing.assert_allclose(factor.value, 0.99 / np.pi * np.array([2, 4]))
    assert two.value.mean() / factor.value.mean() == pytest.approx(3.17, abs=0.01)
    one = read_correction(written("theta_i_deg,correction\n65,1.34\n20,1.07\n", "w.csv"))
    corrected = to_brdf(two, "factor", White(correction=one))
    np.testing.assert_allclose(corrected.value / factor.value, [1.07, 1.34])
    both = "theta_i_deg,theta_o_deg,correction\n20,0,1\n20,80,1.4\n70,0,1\n70,80,2\n"
    corrected = to_brdf(two, "factor", White(correction=read_correction(written(both, "w2.csv"))))
    slope = (1.0 + 0.4 * 20 / 80, (1 + 0.4 * 60 / 80) * 0.1 + 0.9 * (1 + 60 / 80))
    np.testing.assert_allclose(corrected.value / factor.value, slope)
    white = read_goniometer(written(HEADER + "65,60,600,8\n20,20,500,8\n", "white.csv"))
    divided = to_brdf(two, "factor", White(readings=white))
    np.testing.assert_allclose(divided.value, 0.99 / np.pi * np.array([0.25, 0.5]))
    assert "divided by those of the white reference" in divided.scale
    again = read_goniometer(written(HEADER + "65,60,600,6\n20,20,500,8\n65,60,600,10\n", "twice.csv"))
    np.testing.assert_allclose(to_brdf(two, "factor", White(readings=again)).value, divided.value)


def test_white_references_that_do_not_reach(two, written):
    table = read_correction(written("theta_i_deg,correction\n20,1.1\n60,1.2\n", "w.csv"))
    with pytest.raises(UsageError, match=r"from 20° to 60°, and needed at 65° \(line 3"):
        to_brdf(two, "factor", White(correction=table))
    with pytest.raises(UsageError, match="fill the grid"):
        read_correction(written("theta_i_deg,theta_o_deg,correction\n20,0,1\n20,80,1\n70,0,1\n", "w.csv"))
    with pytest.raises(UsageError, match="given twice"):
        read_correction(written("theta_i_deg,correction\n20,1\n20,1.1\n", "w.csv"))
    white = read_goniometer(written(HEADER + "20,20,500,8\n", "white.csv"))
    with pytest.raises(UsageError, match="line 3: the white reference has no reading at θi 65°"):
        to_brdf(two, "factor", White(readings=white))
    with pytest.raises(UsageError, match="need no white reference"):
        to_brdf(two, "brdf", White(readings=white))
    with pytest.raises(UsageError, match="99"):
        to_brdf(two, "factor", White(reflectance=99.0))


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("90,0,500,1", "line 2: theta_i_deg must lie below 90"),
        ("20,-95,500,1", "line 2: theta_o_deg must lie below 90"),
        ("-20,20,500,1", "line 2: theta_i_deg"),
        ("20,20,0.5,1", "µm"),
        ("20,20,500,nan", "line 2: value"),
        ("20,20,500", "4 values expected, 3 found"),
    ],
)
def test_wrong_readings_name_their_line(written, row, words):
    with pytest.raises(UsageError, match=words):
        read_goniometer(written(HEADER + row + "\n", "g.csv"))
