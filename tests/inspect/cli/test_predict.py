import json

import numpy as np
import pytest

from anisoscope.cli import run
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import ridges


def test_json_of_a_design(anisoscope):
    done = anisoscope("predict", "--ridge-angle", 10, "--tilts=-10,0,10", "--json")
    assert done.code == 0, done.err
    found = done.json
    assert found["model"] == "corrected"
    assert found["convention"] == {
        "light_angle_deg": 10.0,
        "tilt_plane": "perpendicular",
        "facet_azimuth_deg": 0.0,
        "rotation_sense": "ccw",
    }
    assert found["k"] == 1.0
    assert [(p["stage_deg"], p["tilt_deg"]) for p in found["poses"]][:4] == [
        (0, -10),
        (90, -10),
        (180, -10),
        (0, 0),
    ]
    radiance = {(p["stage_deg"], p["tilt_deg"]): p["radiance"] for p in found["poses"]}
    assert len(found["contrasts"]) == 6
    for contrast in found["contrasts"]:
        first, second = (radiance[contrast[key], contrast["tilt_deg"]] for key in ("from_deg", "to_deg"))
        assert contrast["difference"] == pytest.approx(first - second)
        assert contrast["michelson"] == pytest.approx((first - second) / (first + second))
        assert contrast["log_ratio"] == pytest.approx(np.log(first / second))


@pytest.mark.parametrize(
    ("pitches", "rows", "angle"), [(1, 3, 20.0), (2, 4, 5.0), (4, 2, 15.0), (5, 8, 10.0)]
)
def test_height_map_of_ideal_ridges_is_predicted_like_the_design(anisoscope, tmp_path, pitches, rows, angle):
    surface = ridges(RidgeDesign(100.0, angle), (rows, round(pitches * 1000) + 1), (1.0, 0.1))
    write_height_map(surface, tmp_path / "ridges.x3p")
    asked = ("--tilts=-20,-10,0,10,20", "--no-uncertainty", "--json")
    relief = anisoscope("predict", tmp_path / "ridges.x3p", *asked)
    assert relief.code == 0, relief.err
    design = anisoscope("predict", "--ridge-angle", angle, *asked).json
    assert relief.json["model"] == "relief"
    if pitches >= 4:
        assert relief.json["pitch_um"] == pytest.approx(100.0, abs=0.1)
    for measured, ideal in zip(relief.json["poses"], design["poses"], strict=True):
        assert measured["radiance"] == pytest.approx(ideal["radiance"], rel=0.005)


def test_a_tilted_map_of_two_ridges_is_levelled_by_the_pitch_it_is_given(anisoscope, tmp_path):
    surface = ridges(RidgeDesign(100.0, 10.0), (6, 2001), (1.0, 0.1))
    tilted = surface.with_height(surface.height_um + 0.03 * np.arange(2001) * 0.1)
    write_height_map(tilted, tmp_path / "tilted.x3p")
    quick = ("--no-uncertainty", "--json")
    found = anisoscope("predict", tmp_path / "tilted.x3p", "--pitch", 100, *quick).json
    design = anisoscope("predict", "--ridge-angle", 10, *quick).json
    for measured, ideal in zip(found["poses"], design["poses"], strict=True):
        assert measured["radiance"] == pytest.approx(ideal["radiance"], rel=0.005)
    assert "pitch" in anisoscope("predict", tmp_path / "tilted.x3p", *quick).json["warning"]


def test_a_pitch_that_the_map_does_not_have_is_refused(anisoscope, tmp_path):
    write_height_map(ridges(RidgeDesign(100.0, 10.0), (20, 1001), (1.0, 1.0)), tmp_path / "map.x3p")
    done = anisoscope("predict", tmp_path / "map.x3p", "--pitch", 80)
    assert done.code == 65
    assert "100.00 µm apart, not 80 µm" in done.err


def test_surface_without_ridges_is_predicted_with_a_warning(anisoscope, tmp_path):
    rng = np.random.default_rng(1)
    write_height_map(HeightMap(0.05 * rng.normal(size=(80, 90)), 1.0, 1.0), tmp_path / "rough.x3p")
    done = anisoscope("predict", tmp_path / "rough.x3p", "--bounces", 1, "--json")
    assert done.code == 0, done.err
    assert "no ridges" in done.json["warning"]


def test_contrasts_carry_units_and_the_convention_and_the_warnings_follow(anisoscope):
    done = anisoscope(
        "predict", "--ridge-angle", 10, "--model", "corrected", "--bounces", 1, "--tilts", "0,85"
    )
    assert done.code == 0
    for word in (
        "1/sr",
        "° / ",
        "ln ratio",
        "perpendicular",
        "k = 1",
        "warning: direct light only",
        "85° from the",
    ):
        assert word in done.out
    assert "Radiance per" not in done.out
    assert "budget" not in done.out.replace("uncertainty budget: --verbose", "")


def test_reflections_between_ridges_brighten_every_pose(anisoscope):
    direct, twice, all_of_them = (
        [
            p["radiance"]
            for p in anisoscope(
                "predict", "--ridge-angle", 20, "--bounces", n, "--no-uncertainty", "--json"
            ).json["poses"]
        ]
        for n in (1, 2, "all")
    )
    assert np.all(np.array(direct) < np.array(twice))
    assert np.all(np.array(twice) < np.array(all_of_them))


def test_a_dark_pose_gives_null_not_infinity(anisoscope):
    done = anisoscope("predict", "--ridge-angle", 20, "--model", "printed", "--alpha-along", 0.002, "--json")
    assert done.code == 0, done.err
    assert done.json["contrasts"][0]["log_ratio"] is None


def test_a_radius_with_room_for_no_more_is_predicted(anisoscope):
    """40 ± 16 µm at a pitch of 50 µm: the uncertainty looks at smaller radii only."""
    done = anisoscope(
        "predict",
        "--ridge-angle",
        10,
        "--pitch",
        50,
        "--edge-radius",
        40,
        "--bounces",
        1,
        "--angles",
        "0,90",
        "--json",
    )
    assert done.code == 0, done.err


@pytest.mark.parametrize("foot", [17, 20])
def test_a_wide_foot_needs_no_room_for_a_crest_that_nobody_stated(anisoscope, foot):
    done = anisoscope("predict", "--ridge-angle", 10, "--foot-radius", foot)
    assert (done.code, done.err) == (0, "")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["MAP", "--model", "corrected"], "--model corrected needs a design"),
        (
            ["MAP", "--ridge-angle", 10],
            "one of a height map file, --ridge-angle of an ideal design, and --recipe",
        ),
        ([], "one of a height map file, --ridge-angle of an ideal design, and --recipe"),
        (["--ridge-angle", 10, "--model", "relief"], "needs a height map file"),
        (["--ridge-angle", 10, "--model", "printed", "--bounces", 2], "direct light only"),
        (["--ridge-angle", 10, "--bounces", 0], "1 or more"),
        (["--ridge-angle", 50], "ridge angle"),
        (
            ["--ridge-angle", 10, "--pitch", 50, "--edge-radius", 60],
            "60 µm is larger than the pitch of 50 µm",
        ),
        (
            ["--ridge-angle", 10, "--pitch", 50, "--foot-radius", 60],
            "60 µm is larger than the pitch of 50 µm",
        ),
        (["--ridge-angle", 30, "--pitch", 50, "--edge-radius", 25, "--foot-radius", 25], "meet on the wall"),
        (["--ridge-angle", 10, "--alpha-along", 0], "alpha along"),
        (["--ridge-angle", 10, "--angles", "0,ninety"], "numbers separated by commas"),
        (["--ridge-angle", 10, "--tilts", "95"], "horizon"),
        (["--ridge-angle", "ten"], "ridge-angle"),
        (["--ridge-angle", 10, "--wall", "curved"], "wall"),
        (["missing.x3p"], "missing.x3p"),
    ],
)
def test_wrong_usage_is_one_clear_line(anisoscope, tmp_path, arguments, words):
    write_height_map(ridges(RidgeDesign(100.0, 10.0), (50, 500), (1.0, 1.0)), tmp_path / "map.x3p")
    done = anisoscope("predict", *[tmp_path / "map.x3p" if a == "MAP" else a for a in arguments])
    assert 64 <= done.code < 128
    assert done.out == ""
    assert done.err.count("\n") == 1, done.err
    assert words in done.err


def test_a_recipe_is_predicted_as_its_inspections_expect_it(inspected_part, capsys):
    rig, finished = inspected_part
    assert run(["predict", "--recipe", str(rig.recipe), "--json"]) == 0
    shown = [one["log_ratio"] for one in json.loads(capsys.readouterr().out)["contrasts"]]
    assert shown == [one.predicted for one in finished.record.details.contrasts]
