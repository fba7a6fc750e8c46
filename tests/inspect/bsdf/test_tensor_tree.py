"""Tensor trees; that Radiance reads them alike is shown in tests/benchmarks/test_bsdf_files.py."""

import re

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.bsdf.formats import read_reflectance
from anisoscope.bsdf.models import of_ridges
from anisoscope.bsdf.reflectance import albedo
from anisoscope.bsdf.tensor_tree import disk_of, read_tensor_tree, square_of, write_tensor_tree
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign


@pytest.fixture(scope="module")
def skew_file(tmp_path_factory, surfaces):
    path = tmp_path_factory.mktemp("tree") / "skew.xml"
    write_tensor_tree(surfaces.skew(), path, depth=3)
    return path


def test_the_square_is_the_disk():
    square = np.random.default_rng(0).random((4000, 2))
    disk = disk_of(square)
    np.testing.assert_allclose(square_of(disk), square, atol=1e-12)
    # equal areas: as many points in every ring and sector
    ring = np.floor(4.0 * np.sum(disk**2, axis=1)).astype(int)
    sector = np.floor(np.arctan2(disk[:, 1], disk[:, 0]) / (0.25 * np.pi)).astype(int) + 4
    count = np.bincount(8 * ring + sector, minlength=32)
    assert np.all(np.abs(count - 125) < 5 * np.sqrt(125))


def test_all_axes_and_signs(skew_file, surfaces):
    light, camera = surfaces.pairs(3000, 70.0)
    positive = surfaces.skew().evaluate(light, camera)[:, 0] > 0.3
    light, camera = light[positive], camera[positive]
    found = read_reflectance(skew_file).evaluate(light, camera)
    assert surfaces.rms(found, surfaces.skew().evaluate(light, camera)) < 0.12
    turned = read_reflectance(skew_file).evaluate(light * [-1.0, -1.0, 1.0], camera)
    assert surfaces.rms(turned, surfaces.skew().evaluate(light, camera)) > 0.2


def test_cells_are_halved_where_a_lobe_is(tmp_path):
    """The peak of a narrow lobe survives, and its energy."""
    flat = of_ridges(RidgeDesign(100.0, 0.0), Material(0.1, 0.1))
    sizes = []
    for depth in (4, 6):
        write_tensor_tree(flat, tmp_path / "x.xml", depth=depth)
        sizes.append((tmp_path / "x.xml").stat().st_size)
    found = read_tensor_tree(tmp_path / "x.xml")
    assert found.isotropic
    assert albedo(found, 30.0)[0] == pytest.approx(albedo(flat, 30.0)[0], rel=0.02)
    light, camera = (np.array([[np.sin(t), 0.01, np.cos(t)]]) for t in (0.5, -0.49))
    assert found.evaluate(light, camera)[0, 0] == pytest.approx(flat.evaluate(light, camera)[0, 0], rel=0.15)
    assert sizes[1] < 16 * sizes[0]  # three axes halved twice everywhere would be 64 times as many


@pytest.mark.parametrize(
    ("pattern", "text", "words"),
    [
        (r"\}\s*</Scat", "</Scat", "cut off: 1 braces"),
        (r"\{\n", "", "a brace closes that none opened|after its end|leaf holds"),
        (r"\{([0-9.e-]+) ", r"{\1 x", "no number"),
        (r"\{([0-9.e-]+) ", r"{\1 1 ", "a leaf holds 17 values, 16 to some power"),
        ("Shirley-Chiu", "Other", "'LBNL/Other'"),
    ],
)
def test_files_that_cannot_be(skew_file, tmp_path, pattern, text, words):
    path = tmp_path / "x.xml"
    path.write_text(re.sub(pattern, text, skew_file.read_text(encoding="utf-8"), count=1), encoding="utf-8")
    with pytest.raises(UsageError, match=words):
        read_reflectance(path)


def test_several_wavelengths_are_refused(tmp_path, surfaces):
    two = surfaces.surface(lambda i, _: i[:, :2], (500.0, 600.0))
    with pytest.raises(UsageError, match="one value for all light"):
        write_tensor_tree(two, tmp_path / "x.xml")
