import json
from dataclasses import dataclass

import cv2
import numpy as np
import pytest
import tifffile

from anisoscope import cli
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges

MISSING_BGR, WHITE_MARGIN = (156, 33, 214), 16
RIDGES = ("--ridge-angle", "10", "--panel", "160")


@dataclass
class Done:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        return json.loads(self.out)


@pytest.fixture
def here(capsys):
    """Runs the command line in this process, which saves the start of an interpreter."""

    def run(*arguments):
        code = cli.run([str(a) for a in arguments])
        captured = capsys.readouterr()
        return Done(code, captured.out, captured.err)

    return run


@pytest.fixture
def height_map(tmp_path):
    """A map with a gap left of and below the middle."""
    surface = ridges(RidgeDesign(50.0, 10.0), (201, 301), 1.0)
    height = add_facet_roughness(surface, 0.05, 0.05, 6.0, np.random.default_rng(2)).height_um.copy()
    height[20:70, 40:90] = np.nan
    write_height_map(HeightMap(height, 1.0, 1.0), tmp_path / "map.x3p")
    return tmp_path / "map.x3p"


def test_checkerboard_has_the_radiances_that_predict_prints(anisoscope, tmp_path):
    done = anisoscope(
        "render", "checkerboard", "--out", tmp_path / "board.png", "--raw", tmp_path / "board.npy", "--json",
        "--angles", "0,90,180", "--panel", 140, "--tilt=-10",
    )  # fmt: skip
    assert done.code == 0, done.err
    expected = anisoscope(
        "predict", "--ridge-angle", 10, "--tilts=-10", "--angles=0,90,180,-90", "--no-uncertainty", "--json"
    ).json
    at = {p["stage_deg"]: p["radiance"] for p in expected["poses"]}
    panels = done.json["panels"]
    assert [p["stage_deg"] for p in panels] == [0, 90, 180]
    assert (panels[0]["first"], panels[0]["second"]) == pytest.approx((at[0], at[-90]))
    assert (panels[1]["first"], panels[1]["second"]) == pytest.approx((at[90], at[0]))
    for p in panels:
        assert p["michelson"] == pytest.approx((p["first"] - p["second"]) / (p["first"] + p["second"]))
        assert p["log_ratio"] == pytest.approx(np.log(p["first"] / p["second"]))
    raw = np.load(tmp_path / "board.npy")
    assert raw.dtype == np.float32
    assert raw.shape[0] == 3
    assert raw[0, 10, 10] == pytest.approx(at[0], rel=1e-5)
    assert raw[1, 10, 10] == pytest.approx(at[90], rel=1e-5)


RECIPE = """schema = 1
product = "plate with a measured lobe"
[surface]
pitch_um = 80.0
reflections = "all"
[surface.design]
ridge_angle_deg = 9.0
edge_radius_um = 2.0
wall = 5.0
[material]
alpha_along = 0.07
alpha_across = 0.11
albedo = 0.15
tail = 0.6
u_tail = 0.0
[poses]
angles_deg = [0.0, 40.0, 90.0, -90.0, -50.0]
tilts_deg = [-8.0]
facet_azimuth_deg = 20.0
[acquisition]
exposure_s = 0.0015
[region]
size_mm = [1.0, 1.0]
"""


@pytest.mark.parametrize(("reflections", "bounces"), [("all", "all"), ("direct", 1)])
def test_fields_have_the_radiance_that_predict_has_of_the_recipe(here, tmp_path, reflections, bounces):
    """Crest radius, draft, tail and orientation of the recipe; the same model, to 1e-7 by quadrature of reflections."""
    recipe = tmp_path / "r.toml"
    recipe.write_text(RECIPE.replace('"all"', f'"{reflections}"'), encoding="utf-8")
    plate = here(
        "render", "checkerboard", "--recipe", recipe, "--bounces", bounces, "--angles", "0,40,90", "--tilt=-8",
        "--panel", 70, "--out", tmp_path / "b.png", "--json",
    )  # fmt: skip
    assert plate.code == 0, plate.err
    assert plate.json["material"]["tail"] == 0.6
    predicted = here("predict", "--recipe", recipe, "--json")
    assert predicted.code == 0, predicted.err
    at = {pose["stage_deg"]: pose["radiance"] for pose in predicted.json["poses"]}
    for panel, stage in zip(plate.json["panels"], (0, 40, 90), strict=True):
        assert panel["first"] == pytest.approx(at[stage], rel=1e-7)
        assert panel["second"] == pytest.approx(at[stage - 90], rel=1e-7)


def test_a_recipe_with_a_measured_lobe_is_rendered(here, tmp_path):
    recipe = tmp_path / "r.toml"
    recipe.write_text(RECIPE, encoding="utf-8")
    same = ("--recipe", recipe, "--panel", 64, "--tilt=-8", "--out", tmp_path / "o.png")
    done = here("render", "frame", *same, "--angles", "0", "--json")
    assert done.code == 0, done.err
    assert (done.json["material"]["tail"], done.json["convention"]["facet_azimuth_deg"]) == (0.6, 20.0)
    assert done.json["surface"] == "Ideal ridges, 9°, pitch 80 µm, wall of 5° draft, crest radius 2 µm"
    predicted = here("predict", "--recipe", recipe, "--json").json["poses"][0]
    # a map of the ridges has facets across the wall and the crest, which the outline of the design has not
    assert done.json["panels"][0]["mean_of_surface"] == pytest.approx(predicted["radiance"], rel=0.03)
    beside = here("render", "comparison", *same, "--cut", "5")
    assert beside.code == 0, beside.err


def test_the_png_shows_the_radiances_pixel_for_pixel(here, tmp_path):
    done = here(
        "render", "checkerboard", "--out", tmp_path / "b.png", "--raw", tmp_path / "b.tif", "--white", 0.4,
        "--panel", 210, "--near-light", 200, "--transfer", "linear",
    )  # fmt: skip
    assert done.code == 0, done.err
    raw, png = tifffile.imread(tmp_path / "b.tif"), cv2.imread(str(tmp_path / "b.png"))
    assert raw.shape == (2, 210, 210)
    grey = np.floor(255 * np.clip(raw[0], 0, 0.4) / 0.4 + 0.5)[:150]  # above the scale bar
    top = 16 + 26
    found = png[top : top + 150, WHITE_MARGIN : WHITE_MARGIN + 210]
    np.testing.assert_array_equal(found, np.repeat(grey[:, :, None], 3, axis=2))


def test_near_light_makes_a_gradient_and_bounces_brighten(here, tmp_path):
    out = ("render", "checkerboard", "--out", tmp_path / "b.png", "--json", "--panel", 70)
    near, far, all_of_it = (
        here(*out, *extra).json["panels"][0] for extra in (("--near-light", 150), ("--bounces", 1), ())
    )
    assert far["brightest"] == pytest.approx(far["first"])
    assert near["brightest"] > 1.3 * near["first"]
    assert all_of_it["second"] > far["second"]


def test_dark_pixels_of_a_pattern_are_the_second_field(here, tmp_path):
    image = np.full((20, 40), 255, dtype=np.uint8)
    image[:10, :10] = 0
    cv2.imwrite(str(tmp_path / "logo.png"), image)
    done = here(
        "render", "checkerboard", "--pattern", tmp_path / "logo.png", "--out", tmp_path / "o.png",
        "--raw", tmp_path / "o.npy", "--json", "--size", 10, "--angles", "0,90", "--panel", 80,
    )  # fmt: skip
    assert done.code == 0, done.err
    assert done.json["plate_mm"] == pytest.approx([5.0, 10.0])
    first, second = done.json["panels"][0]["first"], done.json["panels"][0]["second"]
    before, after = np.load(tmp_path / "o.npy")
    assert before.shape == (80, 80)
    assert before[25, 5] == pytest.approx(second, rel=1e-5)
    assert before[55, 5] == pytest.approx(first, rel=1e-5)
    assert np.isnan(before[5, 5])
    values = done.json["panels"][1]
    assert after[75, 25] == pytest.approx(values["second"], rel=1e-5)  # upper left turned to lower left
    assert after[5, 25] == pytest.approx(values["first"], rel=1e-5)


def test_frames_show_the_map_turned_with_its_gap(here, tmp_path, height_map):
    done = here(
        "render", "frame", height_map, "--out", tmp_path / "f.png", "--raw", tmp_path / "f.npy", "--json",
        "--panel", 300,
    )  # fmt: skip
    assert done.code == 0, done.err
    found = done.json
    raw = np.load(tmp_path / "f.npy")
    assert raw.shape == (3, 300, 300)
    assert found["pixel_um"] == pytest.approx(1.0)
    assert found["magnification"] == pytest.approx(3.45)
    for bounces in ("all", 1):
        predicted = here("predict", height_map, "--bounces", bounces, "--json").json
        for panel, pose in zip(found["panels"], predicted["poses"], strict=True):
            direct = 0.0 if bounces == "all" else panel["reflected_again"]
            # a prediction fits the walls, a picture shows them as they were sampled
            assert panel["mean_of_surface"] - direct == pytest.approx(pose["radiance"], rel=0.03)
            assert panel["mean_of_picture"] == pytest.approx(panel["mean_of_surface"], rel=0.01)
    assert max(panel["reflected_again"] / panel["mean_of_surface"] for panel in found["panels"]) > 0.1
    # the gap's middle stands 85 left of and 55 below the axis; a quarter turn brings it 55 right, 85 below
    png = cv2.imread(str(tmp_path / "f.png"))
    for panel, (x, y) in enumerate(((-85, -55), (55, -85), (85, 55))):
        row, column = round(149.5 - y), round(149.5 + x)
        assert np.isnan(raw[panel, row - 15 : row + 15, column - 15 : column + 15]).all()
        pixel = png[16 + 26 + row, WHITE_MARGIN + panel * 316 + column]
        assert tuple(int(c) for c in pixel) == MISSING_BGR
    assert found["missing_share"] == pytest.approx(51 * 51 / (200 * 300), rel=0.01)


def test_a_numerical_aperture_and_defocus_soften_the_picture(here, tmp_path, height_map):
    def spread(*extra):
        raw = tmp_path / "f.npy"
        done = here(
            "render",
            "frame",
            height_map,
            "--stage",
            0,
            "--out",
            tmp_path / "f.png",
            "--raw",
            raw,
            *extra,
        )
        assert done.code == 0, done.err
        return float(np.nanstd(np.load(raw)))

    sharp, soft, blurred = spread("--na", 0), spread("--na", 0.05), spread("--na", 0.05, "--defocus", 200)
    assert blurred < 0.8 * soft < 0.8 * sharp


def test_magnification_sets_the_scale_and_crops(here, tmp_path):
    done = here(
        "render", "frame", *RIDGES, "--magnification", 10, "--sensor-pixel", 5, "--stage", 0, "--json",
        "--out", tmp_path / "f.png",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert done.json["pixel_um"] == pytest.approx(0.5)
    assert done.json["shape"] == [160, 160]


def test_a_region_is_the_part_of_the_map_that_was_asked_for(here, tmp_path, height_map):
    done = here(
        "render",
        "frame",
        height_map,
        "--region",
        "30,10,100,80",
        "--stage",
        0,
        "--json",
        "--out",
        tmp_path / "f.png",
    )
    assert done.code == 0, done.err
    assert done.json["size_um"] == pytest.approx([70.0, 70.0])
    assert done.json["missing_share"] == pytest.approx(51 * 51 / 70**2, rel=0.01)
    assert "x 30 to 100 µm, y 10 to 80 µm of 300 × 200 µm" in done.json["cut"]


def test_a_large_map_is_cut_to_its_middle_and_that_is_said(here, tmp_path, height_map, monkeypatch):
    from anisoscope.operations import render as operation

    monkeypatch.setattr(operation, "MAX_POINTS", 15_000)
    frame = ("render", "frame", height_map, "--stage", 0, "--json", "--out", tmp_path / "f.png")
    done = here(*frame)
    assert done.code == 0, done.err
    assert done.json["size_um"] == pytest.approx([99.0, 148.0])
    assert "x 76 to 224 µm, y 50 to 149 µm of 300 × 200 µm" in done.json["cut"]
    assert "million points" in done.json["cut"]
    assert "at most" in here(*frame, "--region", "0,0,200,200").err


def test_beside_draws_heights_and_radiance_of_the_same_place(here, tmp_path, height_map):
    done = here(
        "render",
        "comparison",
        height_map,
        "--stage",
        90,
        "--cut",
        -30,
        "--panel",
        200,
        "--out",
        tmp_path / "b.png",
    )
    assert done.code == 0, done.err
    assert "written" in done.out
    png = cv2.imread(str(tmp_path / "b.png"))
    left = WHITE_MARGIN
    right = left + 240 + 16 + 74  # half the least width, a gap, and the colour bar
    height = png[42:242, left : left + 133]
    picture = png[42:242, right : right + 133]
    masks = [np.all(part == MISSING_BGR, axis=2) for part in (height, picture)]
    assert masks[0].sum() > 500
    assert np.mean(masks[0] != masks[1]) < 0.02
    assert height[~masks[0]].std(axis=-1).max() > 20  # in colours
    assert np.ptp(picture[~masks[1]].astype(int), axis=-1).max() == 0  # in grey


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["checkerboard", "--out", "o.jpg"], 64, ".png"),
        (["checkerboard", "--out", "nowhere/o.png"], 74, "no folder"),
        (["checkerboard", "--out", "o.png", "--raw", "o.exr"], 64, ".npy"),
        (["checkerboard"], 64, "out"),
        (["checkerboard", "--out", "o.png", "--pattern", "none.png"], 64, "none.png"),
        (["checkerboard", "--out", "o.png", "--pattern", "map.x3p"], 64, "not an image"),
        (["checkerboard", "--out", "o.png", "--pattern", "even.png"], 64, "one level"),
        (["checkerboard", "--out", "even.png", "--pattern", "even.png"], 64, "is the input"),
        (["checkerboard", "--out", "o.png", "--near-light", "0"], 64, "--near-light"),
        (
            ["checkerboard", "--out", "o.png", "--near-light", "100", "--bounces", "2"],
            64,
            "direct light only",
        ),
        (["checkerboard", "--out", "o.png", "--angles", "0,1,2,3,4,5,6,7,8"], 64, "8 panels"),
        (["checkerboard", "--out", "o.png", "--ridge-directions", "0"], 64, "two angles"),
        (["checkerboard", "--out", "o.png", "--fields", "1"], 64, "--fields"),
        (["checkerboard", "--out", "o.png", "--white", "0"], 64, "--white"),
        (["checkerboard", "--out", "o.png", "--panel", "9"], 64, "--panel"),
        (["checkerboard", "--out", "o.png", "--tilt", "95"], 64, "horizon"),
        (["frame", "--out", "o.png", "--ridge-angle", "10", "--bounces", "0"], 64, "--bounces"),
        (["frame", "--out", "o.png"], 64, "--ridge-angle"),
        (["frame", "map.x3p", "--ridge-angle", "5", "--out", "o.png"], 64, "--ridge-angle"),
        (["frame", "none.x3p", "--out", "o.png"], 65, "none.x3p"),
        (["frame", "map.x3p", "--burrs", "0.1", "--out", "o.png"], 64, "--burrs"),
        (["frame", "map.x3p", "--region", "5,5,1,1", "--out", "o.png"], 64, "--region"),
        (["frame", "map.x3p", "--region", "0,0,2,2", "--out", "o.png"], 64, "fewer than"),
        (["frame", "--ridge-angle", "5", "--na", "1.2", "--out", "o.png"], 64, "aperture"),
        (["frame", "--ridge-angle", "5", "--magnification", "0", "--out", "o.png"], 64, "--magnification"),
        (
            ["frame", "map.x3p", "--edge-radius", "2", "--out", "o.png"],
            64,
            "--edge-radius belongs to ideal ridges",
        ),
        (["comparison", "map.x3p", "--cut", "9000", "--out", "o.png"], 64, "--cut"),
    ],
)
def test_wrong_usage_is_one_clear_line_and_no_file(
    here, tmp_path, height_map, monkeypatch, arguments, code, words
):
    cv2.imwrite(str(tmp_path / "even.png"), np.full((8, 8), 9, dtype=np.uint8))
    before = sorted(tmp_path.iterdir())
    monkeypatch.chdir(tmp_path)
    done = here("render", *arguments)
    assert done.code == code, done.err
    assert done.out == ""
    assert done.err.count("\n") == 1, done.err
    assert words in done.err
    assert sorted(tmp_path.iterdir()) == before
