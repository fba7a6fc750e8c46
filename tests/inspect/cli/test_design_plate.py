"""``anisoscope design plate``: files that fit each other, and what it refuses."""

import csv

import cv2
import numpy as np
import pytest
import skimage.data

from anisoscope.kinds.plates.kind import PLATES
from anisoscope.profiles.files.load import read_height_map, write_height_map


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    y, x = np.mgrid[:24, :32]
    cv2.imwrite(str(folder / "day.png"), (8 * x).astype(np.uint8))
    cv2.imwrite(str(folder / "night.png"), (10 * y).astype(np.uint8))
    cv2.imwrite(str(folder / "small.png"), np.zeros((8, 8), np.uint8))
    return folder


def test_two_pictures_become_a_plate_and_its_insert(anisoscope, pictures, tmp_path):
    out = tmp_path / "p"
    done = anisoscope(
        "design", "plate", pictures / "day.png", pictures / "night.png", "--out", out, "--stl", "--path", "--npz",
        "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert done.json["fields"] == [24, 32]
    assert done.json["size_mm"] == pytest.approx([3.2, 2.4])
    assert min(done.json["ssim"]) > 0.85
    assert max(done.json["cross_talk"]) < 0.05
    assert done.json["white_per_sr"] > 3.0 * done.json["black_per_sr"]
    assert done.json["cut_length_m"] > 10.0
    assert sorted(done.json["files"]) == sorted(str(path) for path in out.iterdir())
    surface = read_height_map(out / "part.x3p")
    assert surface.shape == (24 * 20, 32 * 20)
    tool = read_height_map(out / "insert.x3p", role="tool")
    np.testing.assert_allclose(tool.height_um, surface.height_um, atol=1e-6)
    np.testing.assert_allclose(read_height_map(out / "part.npz").height_um, surface.height_um, atol=1e-6)
    for ending in ("sur", "gwy"):
        write_height_map(surface, tmp_path / f"back.{ending}")
        back = read_height_map(tmp_path / f"back.{ending}")
        np.testing.assert_allclose(back.height_um, surface.height_um, atol=1e-4)
        assert (back.pixel_x_um, back.pixel_y_um) == pytest.approx((surface.pixel_x_um, surface.pixel_y_um))
    with (out / "fields.csv").open() as stream:
        table = list(csv.DictReader(stream))
    assert len(table) == 24 * 32
    # the slope of a field on the map is that of the table
    field = table[24 * 32 // 2 + 7]
    row, col, azimuth, angle = (
        float(field[name]) for name in ("row", "column", "facet_azimuth_deg", "ridge_angle_deg")
    )
    field = surface.height_um[int(23 - row) * 20 : int(24 - row) * 20, int(col) * 20 : int(col + 1) * 20]
    fall = np.array([np.median(-np.diff(field, axis=1)), np.median(-np.diff(field, axis=0))]) / 5.0
    turn = np.radians(azimuth)
    assert fall @ [np.cos(turn), np.sin(turn)] == pytest.approx(np.tan(np.radians(angle)), rel=0.02)
    shown = cv2.imread(str(out / "predicted-0.png"), cv2.IMREAD_GRAYSCALE)
    assert np.corrcoef(shown.ravel(), cv2.imread(str(pictures / "day.png"), 0).ravel())[0, 1] > 0.98
    recipe = PLATES.read_recipe(out / "recipe.toml")
    plan = recipe.plan.plan()
    assert plan.shape == (24, 32)
    assert len(plan.ridge_angles_deg) == done.json["classes"] == 64
    assert recipe.surface.ridge_design().wall == 10.0
    assert (out / "insert.nc").read_text().count("M98 P") == 24 * 32


def test_greys_for_the_eye_are_darker_for_a_camera(anisoscope, pictures, tmp_path):
    shown = []
    for tone in ("linear", "srgb"):
        done = anisoscope(
            "design", "plate", pictures / "day.png", "--out", tmp_path / tone, "--tone", tone, "--pixel", "10"
        )
        assert done.code == 0, done.err
        assert "black 0.0" in done.out
        shown.append(cv2.imread(str(tmp_path / tone / "predicted-0.png"), cv2.IMREAD_GRAYSCALE)[0, 16])
    assert shown[0] == pytest.approx(128, abs=4)
    assert shown[1] == pytest.approx(255 * 0.2158, abs=4)


@pytest.mark.parametrize(
    ("options", "code", "match"),
    [
        (("small.png",), 64, "32 × 24 and 8 × 8 fields: give pictures of one shape"),
        (("none.png",), 64, "there is no such picture"),
        (("night.png", "--angles", "0"), 64, "--angles must name a stage angle a picture"),
        (("night.png", "--pitch", "20"), 64, "--pitch must be 50 µm or more"),
        (("night.png", "--field-um", "80"), 65, "hold 1.6 ridges of 50 µm, 2 are needed"),
        (
            ("night.png", "--field-um", "120"),
            64,
            "make them 100 or 150 µm wide, so that they hold whole ridges",
        ),
        (("night.png", "--pixel", "0.1", "--field-count", "200"), 64, "million points is too large"),
        (("night.png", "--draft", "0.5"), 64, "hold the part in its mould"),
        (("night.png", "--tool-radius", "400"), 64, "--tool-radius: "),
        (("night.png", "--path", "--tool-half-angle", "15"), 64, "does not reach walls with a draft of 10°"),
        (("night.png", "--path", "--tool-radius", "0"), 64, "give --tool-radius"),
        (("night.png", "--stl", "--base-mm", "0"), 64, "--base-mm must be a positive number"),
        (("night.png", "--trial", "--field-um", "300"), 64, "is too large for --trial (at most 8 mm)"),
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
    assert not (tmp_path / "p").exists()


@pytest.mark.soak
def test_a_trial_shows_both_pictures_on_the_virtual_rig(anisoscope, tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), skimage.data.camera())
    cv2.imwrite(str(tmp_path / "b.png"), cv2.cvtColor(skimage.data.astronaut(), cv2.COLOR_RGB2GRAY))
    done = anisoscope(
        "design", "plate", tmp_path / "a.png", tmp_path / "b.png", "--field-count", "24", "--class-count", "24",
        "--trial", "--out", tmp_path / "plate", "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert done.json["trial"]["verdict"] == "PASS"
    assert min(done.json["camera"]["ssim"]) > 0.8
    assert max(done.json["camera"]["cross_talk"]) < 0.05
    shown = cv2.imread(str(tmp_path / "plate" / "camera-90.png"), cv2.IMREAD_GRAYSCALE)
    wanted = cv2.imread(str(tmp_path / "plate" / "predicted-90.png"), cv2.IMREAD_GRAYSCALE)
    assert np.corrcoef(shown.ravel(), wanted.ravel())[0, 1] > 0.98
