"""Textures; that Mitsuba shows them as predicted is shown in tests/benchmarks/test_textures_mitsuba.py."""

from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.bsdf.mitsuba_scene import write_classes_scene
from anisoscope.bsdf.textures import normals_of, write_height_textures
from anisoscope.profiles.files.decoder_process import decode
from anisoscope.profiles.heightmap import HeightMap


@pytest.fixture(scope="module")
def slope():
    """A plane that rises along x and y, with a step of its own in one corner that is greater in y."""
    y, x = np.mgrid[0:20, 0:30]
    height = 0.3 * x * 2.0 + 0.1 * y * 4.0
    height[-1, -1] += 5.0
    return HeightMap(height, pixel_x_um=2.0, pixel_y_um=4.0)


def test_normals_of_a_plane(slope):
    normals = normals_of(slope)
    wanted = np.array([-0.3, -0.1, 1.0]) / np.sqrt(1.1)
    np.testing.assert_allclose(normals[0, 0], wanted, atol=1e-12)
    assert normals.shape == (19, 29, 3)


def test_heights_come_back(slope, tmp_path):
    done = write_height_textures(slope, tmp_path)
    assert set(done.files) == {path.name for path in tmp_path.iterdir()}
    words = cv2.imread(str(tmp_path / "height.png"), cv2.IMREAD_UNCHANGED)
    assert words.dtype == np.uint16
    found = done.lowest_um + words[::-1] / 65535.0 * (done.highest_um - done.lowest_um)
    np.testing.assert_allclose(found, slope.height_um, atol=0.51e-3 * done.step_nm)
    coded = cv2.imread(str(tmp_path / "normals.png"), cv2.IMREAD_UNCHANGED)[::-1, :, ::-1] / 65535.0
    apart = np.degrees(np.linalg.norm(2.0 * coded - 1.0 - normals_of(slope), axis=2))
    assert apart.max() <= done.normal_step_deg
    raw = decode("exr", tmp_path / "height.exr", channels=[])[1]
    np.testing.assert_allclose(np.asarray(raw)[::-1], slope.height_um, rtol=1e-6)


def test_a_map_with_gaps_is_refused(slope, tmp_path):
    height = slope.height_um.copy()
    height[3, 4] = np.nan
    with pytest.raises(HeightMapError, match=r"0\.17% of the pixels have no height"):
        write_height_textures(slope.with_height(height), tmp_path)


def test_masks_and_their_scene(tmp_path):
    classes = np.array([[0, 1], [2, 1], [0, 0]])
    masks = write_classes_scene(tmp_path / "scene.xml", classes, ["a.bsdf", "b.bsdf", None], 20.0, pixels=3)
    assert masks == ["mask-1.png", "mask-2.png"]
    for number, name in enumerate(masks, 1):
        found = cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(found == 255, classes == number)
    root = ET.parse(tmp_path / "scene.xml").getroot()
    assert [one.get("value") for one in root.iter("integer") if one.get("name") in ("width", "height")] == [
        "6",
        "9",
    ]
    outer = root.find("shape/bsdf")
    assert outer.find("texture/string").get("value") == "mask-2.png"
    assert outer.find("bsdf/texture/string").get("value") == "mask-1.png"
    kinds = [one.get("type") for one in outer.iter("bsdf")]
    assert kinds == ["blendbsdf", "blendbsdf", "measured", "measured", "diffuse"]
