"""``anisoscope design plate``: files that fit each other, and what it refuses."""

import cv2
import numpy as np
import pytest

from anisoscope.profiles.files.load import read_height_map


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    y, x = np.mgrid[:24, :32]
    cv2.imwrite(str(folder / "day.png"), (8 * x).astype(np.uint8))
    cv2.imwrite(str(folder / "night.png"), (10 * y).astype(np.uint8))
    cv2.imwrite(str(folder / "small.png"), np.zeros((8, 8), np.uint8))
    return folder


def test_two_pictures_become_a_plate(anisoscope, pictures, tmp_path):
    done = anisoscope(
        "design", "plate", pictures / "day.png", pictures / "night.png", "--out", tmp_path / "p", "--json"
    )
    assert done.code == 0, done.err
    assert done.json["fields"] == [24, 32]
    assert done.json["size_mm"] == pytest.approx([3.2, 2.4])
    assert min(done.json["ssim"]) > 0.8
    assert max(done.json["cross_talk"]) < 0.05
    surface = read_height_map(tmp_path / "p" / "plate.x3p")
    assert surface.shape == (24 * 20, 32 * 20)
    table = np.loadtxt(tmp_path / "p" / "fields.csv", delimiter=",", skiprows=1)
    assert table.shape == (24 * 32, 4)
    # the slope of a field on the map is that of the table
    row, col, azimuth, angle = table[24 * 32 // 2 + 7]
    field = surface.height_um[int(23 - row) * 20 : int(24 - row) * 20, int(col) * 20 : int(col + 1) * 20]
    fall = np.array([np.median(-np.diff(field, axis=1)), np.median(-np.diff(field, axis=0))]) / 5.0
    turn = np.radians(azimuth)
    assert fall @ [np.cos(turn), np.sin(turn)] == pytest.approx(np.tan(np.radians(angle)), rel=0.02)
    shown = cv2.imread(str(tmp_path / "p" / "predicted-0.png"), cv2.IMREAD_GRAYSCALE)
    assert np.corrcoef(shown.ravel(), cv2.imread(str(pictures / "day.png"), 0).ravel())[0, 1] > 0.98


@pytest.mark.parametrize(
    ("options", "code", "match"),
    [
        (("small.png",), 64, "32 × 24 and 8 × 8 fields: give pictures of one shape"),
        (("none.png",), 64, "there is no such picture"),
        (("night.png", "--angles", "0"), 64, "--angles must name a stage angle a picture"),
        (("night.png", "--pitch", "20"), 64, "--pitch must be 50 µm or more"),
        (("night.png", "--field-um", "80"), 65, "hold 1.6 ridges of 50 µm, 2 are needed"),
        (("night.png", "--pixel", "0.1", "--field-count", "200"), 64, "million points is too large"),
    ],
)
def test_what_cannot_be_made_is_one_line(anisoscope, pictures, tmp_path, options, code, match):
    other, *rest = options
    done = anisoscope(
        "design", "plate", pictures / "day.png", pictures / other, "--out", tmp_path / "p", *rest
    )
    assert done.code == code
    assert match in done.err
    assert done.err.strip().count("\n") == 0
