import re

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.bsdf import zemax
from anisoscope.bsdf.zemax import is_zemax, read_zemax, write_zemax

BY_HAND = """# by hand
Source  Measured
Symmetry  PlaneSymmetrical
SpectralContent  Monochrome
ScatterType  BRDF
SampleRotation  1
0
AngleOfIncidence  2
0  60
ScatterAzimuth  3
0  90  180
ScatterRadial  2
0  40

Monochrome
DataBegin
TIS 0.5
1.0 2.0
1.0 3.0
1.0 4.0
TIS 0.5
5.0 6.0
5.0 7.0
5.0 8.0
DataEnd
"""


def direction(theta_deg, phi_deg=0.0):
    theta, phi = np.radians([theta_deg, phi_deg])
    return np.array([[np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]])


@pytest.mark.parametrize("turn", [0.0, 70.0])
def test_angles_count_from_the_mirror_direction(tmp_path, turn):
    """Azimuth 0 points from the mirror direction toward the normal; an isotropic surface may be turned."""
    path = tmp_path / "x.bsdf"
    path.write_text(BY_HAND, encoding="utf-8")
    surface, light = read_zemax(path), direction(60.0, turn + 180.0)
    for theta, wanted in ((60.0, 5.0), (20.0, 6.0), (85.0, 5.0 + 3.0 * 25.0 / 40.0)):
        np.testing.assert_allclose(surface.evaluate(light, direction(theta, turn)), wanted, rtol=1e-9)


def test_total_scatter_of_a_white_surface(tmp_path, surfaces):
    path = tmp_path / "x.bsdf"
    write_zemax(surfaces.lambertian(0.5), path)
    text = path.read_text(encoding="utf-8")
    np.testing.assert_allclose([float(x) for x in re.findall(r"TIS\s+(\S+)", text)], 0.5, rtol=1e-3)
    light, camera = surfaces.pairs(100, 60.0)
    np.testing.assert_allclose(read_zemax(path).evaluate(light, camera), 0.5 / np.pi, rtol=1e-4)
    assert is_zemax(text[:200].encode())


def test_another_reader_finds_the_values_where_the_description_puts_them(tmp_path, surfaces, judged_figure):
    """Numbers by keywords alone; heights of scattered directions by the law of cosines, azimuth 0 toward the normal."""
    write_zemax(surfaces.surface(lambda _, o: 1.0 + o[:, 2], isotropic=True), tmp_path / "x.bsdf")
    lines = (tmp_path / "x.bsdf").read_text(encoding="utf-8").splitlines()

    def angles(key):
        at = next(number for number, line in enumerate(lines) if line.startswith(key))
        return np.radians(np.array(lines[at + 1].split(), dtype=float))

    incident, azimuth, radial = (
        angles(key) for key in ("AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
    )
    data = lines[lines.index("DataBegin") + 1 : lines.index("DataEnd")]
    rows = np.array([line.split() for line in data if line and not line.startswith("TIS")], dtype=float)
    values = rows.reshape(len(incident), len(azimuth), len(radial))
    a, phi, rho = np.meshgrid(incident, azimuth, radial, indexing="ij")
    height = np.cos(a) * np.cos(rho) + np.sin(a) * np.sin(rho) * np.cos(phi)
    above = (height > 0.01) & (a < 1.55)
    off = np.abs(values[above] - 1.0 - height[above]).max()
    assert off < 2e-4
    judge = "reader by the published description; OpticStudio has not read it"
    judged_figure("Exchange", "Zemax file", judge, f"{off:.1%}", "0.1%")


def test_angles_and_directions_are_inverse(surfaces):
    light, camera = surfaces.pairs(50, 80.0)
    angles = zemax._angles(light, camera, isotropic=False)
    back = zemax._directions(angles[:, 1], angles[:, 2], angles[:, 3], angles[:, 0])
    np.testing.assert_allclose(back, (light, camera), atol=1e-12)


def test_an_anisotropic_surface_survives(tmp_path, surfaces, monkeypatch):
    monkeypatch.setattr(zemax, "AZIMUTH_DEG", np.arange(0.0, 361.0, 15.0))
    monkeypatch.setattr(zemax, "RADIAL_DEG", np.arange(0.0, 171.0, 5.0))
    write_zemax(surfaces.skew(), tmp_path / "x.bsdf")
    light, camera = surfaces.pairs(1000, 60.0)
    found = read_zemax(tmp_path / "x.bsdf").evaluate(light, camera)
    assert surfaces.rms(found, surfaces.skew().evaluate(light, camera)) < 0.01


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("BRDF", "BTDF", "monochrome BRDFs, not Monochrome BTDF"),
        ("0  60", "60  0", "angles of AngleOfIncidence must rise"),
        ("ScatterRadial  2", "ScatterRadial  many", "number of angles of ScatterRadial is 'many'"),
        ("5.0 8.0\nDataEnd", "", "6 numbers of the data expected, 4 found"),
        ("5.0 8.0\nDataEnd", "5.0 x\nDataEnd", "no number"),
        ("TIS 0.5\n5", "5", "TIS expected, '5.0' found"),
    ],
)
def test_files_that_cannot_be(tmp_path, old, new, words):
    path = tmp_path / "x.bsdf"
    path.write_text(BY_HAND.replace(old, new), encoding="utf-8")
    with pytest.raises(UsageError, match=re.escape(words)):
        read_zemax(path)
