import re

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.bsdf.klems import PATCHES, _draws, _within, patch_of, read_klems, write_klems


@pytest.fixture(scope="module")
def skew_file(tmp_path_factory, surfaces):
    path = tmp_path_factory.mktemp("klems") / "skew.xml"
    write_klems(surfaces.skew(), path)
    return path


def test_patches_share_the_hemisphere():
    draws = _within(np.arange(PATCHES), _draws()[:, :2])
    assert PATCHES == 145
    assert np.array_equal(patch_of(draws.reshape(-1, 3)), np.repeat(np.arange(PATCHES), draws.shape[1]))
    down = np.array([[0.0, 0.0, 1.0], [np.sin(0.2), 0.0, np.cos(0.2)], [0.0, np.sin(0.2), np.cos(0.2)]])
    assert patch_of(down).tolist() == [0, 1, 3]  # of a ring of 8 patches, counted from +x


def test_means_over_patches(skew_file, surfaces):
    """A linear function's mean over a patch is near that of its middle; all axes and signs differ."""
    light, camera = surfaces.pairs(3000, 64.0)
    found = read_klems(skew_file).evaluate(light, camera)
    assert surfaces.rms(found, surfaces.skew().evaluate(light, camera)) < 0.08
    turned = light * [-1.0, -1.0, 1.0]
    assert surfaces.rms(found, surfaces.skew().evaluate(turned, camera)) > 0.2


def test_energy_survives(tmp_path, surfaces):
    write_klems(surfaces.lambertian(0.3), tmp_path / "x.xml")
    up = np.array([[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(read_klems(tmp_path / "x.xml").evaluate(up, up), 0.3 / np.pi, rtol=1e-5)


@pytest.mark.parametrize(
    ("pattern", "text", "words"),
    [
        (
            "LBNL/Klems Full</Row",
            "LBNL/Klems Half</Row",
            "read are matrices of LBNL/Klems Full and tensor trees, not 'LBNL/Klems Half'",
        ),
        ("Reflection Back", "Transmission Front", "holds no reflection (found: Transmission Front)"),
        (r"<ScatteringData>[^,]*,", "<ScatteringData>", "21024 numbers, 145 × 145"),
        (r"<ScatteringData>[^,]*,", "<ScatteringData>x,", "no number"),
        ("</WindowElement>", "", "damaged XML"),
    ],
)
def test_files_that_cannot_be(skew_file, tmp_path, pattern, text, words):
    path = tmp_path / "x.xml"
    path.write_text(re.sub(pattern, text, skew_file.read_text(encoding="utf-8"), count=1), encoding="utf-8")
    with pytest.raises(UsageError, match=re.escape(words)):
        read_klems(path)


def test_several_wavelengths_are_refused(tmp_path, surfaces):
    two = surfaces.surface(lambda i, _: i[:, :2], (500.0, 600.0))
    with pytest.raises(UsageError, match="one value for all light"):
        write_klems(two, tmp_path / "x.xml")
