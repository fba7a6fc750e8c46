"""``predict --model auto|geometric|wave|both`` on designs and on files with height maps."""

import json

import numpy as np
import pytest

from anisoscope.cli import run
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import ridges

LEANING = ("--ridge-angle", "10", "--no-uncertainty")
"""Walls square to the facets: no light reaches the rig from them, and at 10° they throw no shadow."""

DESIGN = ("--ridge-angle", "10", "--wall", "vertical", "--no-uncertainty")


@pytest.fixture(scope="module")
def maps(tmp_path_factory):
    """Files: ridges that hold the phase, the same on coarse pixels, with a gap, and levels of etching."""
    folder = tmp_path_factory.mktemp("maps")
    fine = ridges(RidgeDesign(20.0, 5.0, "vertical"), (24, 801), 0.25)
    coarse = ridges(RidgeDesign(100.0, 12.0), (24, 301), 2.0)
    holed = fine.height_um.copy()
    holed[3, 5:9] = np.nan
    rng = np.random.default_rng(1)
    steps = np.kron(rng.choice([0.0, 0.1375], (8, 40)), np.ones((8, 8)))
    found = {"fine": fine, "coarse": coarse, "holed": HeightMap(holed, 0.25, 0.25)}
    found["steps"] = HeightMap(steps, 0.25, 0.25)
    paths = {name: str(folder / f"{name}.{'npz' if name == 'steps' else 'x3p'}") for name in found}
    for name, surface in found.items():
        write_height_map(surface, paths[name])
    return paths


def predicted(capsys, *arguments):
    assert run(["predict", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def refused(capsys, *arguments):
    code = run(["predict", *arguments])
    caught = capsys.readouterr()
    assert code != 0
    assert caught.out == ""
    assert caught.err.strip().count("\n") == 0
    return caught.err


def radiances(found):
    return np.array([pose["radiance"] for pose in found["poses"]])


def test_where_waves_would_be_right_and_cannot_be_had_rays_are_used_and_it_is_said(capsys, tmp_path):
    small = str(tmp_path / "small.npz")
    write_height_map(ridges(RidgeDesign(20.0, 5.0, "vertical"), (24, 241), 0.25), small)
    polished = ("--alpha-along", "0.001", "--alpha-across", "0.001", "--albedo", "0", "--no-uncertainty")
    assert "light" in refused(capsys, small, *polished, "--model", "wave")
    optics = predicted(capsys, small, *polished)["optics"]
    assert (optics["asked"], optics["model"]) == ("auto", "geometric")
    assert "waves cannot be had" in optics["reason"]
    assert optics["stated_error"] > 0.1


def test_rays_serve_for_ridges_of_plastic(capsys):
    auto, geometric = (predicted(capsys, *DESIGN, "--model", model) for model in ("auto", "geometric"))
    assert auto["model"] == "corrected"
    assert radiances(auto).tolist() == radiances(geometric).tolist()
    optics = auto["optics"]
    assert (optics["asked"], optics["model"]) == ("auto", "geometric")
    assert optics["f_um"] == pytest.approx(100.0, rel=0.01)
    spread = 2.0 * 0.1 * np.sqrt(np.pi)  # √(2π)·2σ of slopes of σ = α/√2
    assert optics["coherence_um"] == pytest.approx(0.55 / spread, rel=0.1)
    assert 0.3 < optics["stated_error"] * optics["f_um"] / optics["coherence_um"] < 1.5
    assert f"{optics['f_um']:.3g} µm" in optics["reason"]


def test_both_say_what_waves_change_within_the_stated_error(capsys):
    found = predicted(capsys, *LEANING, "--model", "both", "--angles", "0,45,90,180")
    geometric, wave = radiances(found["geometric"]), radiances(found["wave"])
    off = [row["difference"] for row in found["difference"]]
    np.testing.assert_allclose(off, wave - geometric, rtol=1e-9, atol=1e-15)
    assert np.abs(off).max() < found["optics"]["stated_error_per_sr"]
    assert found["wave"]["model"] == "wave"


def test_a_dark_pose_gains_what_diffraction_takes_from_a_narrow_lobe(capsys):
    """The foot of a lobe is off by many times the stated share of itself, yet within the stated error in 1/sr."""
    narrow = (*LEANING, "--alpha-along", "0.03", "--alpha-across", "0.03", "--angles", "0")
    found = predicted(capsys, *narrow, "--model", "both")
    row = found["difference"][0]
    assert row["relative"] > found["optics"]["stated_error"]
    assert 0.0 < row["difference"] < found["optics"]["stated_error_per_sr"]


@pytest.mark.parametrize(("name", "words"), [("fine", "wave"), ("steps", "stepped")])
def test_fine_structures_and_steps_are_taken_for_waves(capsys, maps, name, words):
    polished = ("--alpha-along", "0.02", "--alpha-across", "0.02", "--no-uncertainty", "--angles", "0")
    found = predicted(capsys, maps[name], *polished, "--level", "none")
    assert (found["model"], found["optics"]["model"]) == ("wave", "wave")
    assert words in found["optics"]["reason"]


def test_missing_points_leave_rays_only(capsys, maps):
    found = predicted(capsys, maps["holed"], "--no-uncertainty", "--angles", "0")
    assert found["model"] == "relief"
    assert "missing points" in found["optics"]["reason"]
    text = refused(capsys, maps["holed"], "--model", "wave")
    assert "96 of" not in text
    assert "4 of 19224 pixels" in text
    assert "fill" in text
    assert "crop" in text


def test_coarse_maps_are_refused_for_waves_and_predicted_by_rays(capsys, maps):
    text = refused(capsys, maps["coarse"], "--model", "wave")
    for words in ("too coarse", "row", "column", "µm", "smaller pixels", "--interpolate", "geometric"):
        assert words in text
    assert predicted(capsys, maps["coarse"], "--no-uncertainty", "--angles", "0")["model"] == "relief"


def test_wavelengths_change_the_prediction(capsys, maps):
    asked = ("--alpha-along", "0.02", "--alpha-across", "0.02", "--no-uncertainty", "--model", "wave")
    blue, red, mixed = (
        predicted(capsys, maps["fine"], *asked, "--angles", "0", "--wavelengths", text)
        for text in ("450", "650", "450:3,650:1")
    )
    assert mixed["optics"]["wavelengths_nm"] == pytest.approx([450.0, 650.0])
    expected = 0.75 * radiances(blue) + 0.25 * radiances(red)
    np.testing.assert_allclose(radiances(mixed), expected, rtol=1e-9)
    assert abs(radiances(blue) / radiances(red) - 1.0).max() > 1e-3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--model", "wave", "--roughness", "plastic"), "a design has no facets of its own"),
        (("--model", "corrected", "--wavelengths", "500"), "rays only"),
        (("--model", "geometric", "--interpolate", "0"), "1 or more"),
        (("--model", "wave", "--wavelengths", "5"), "100 to 20000 nm"),
        (("--model", "wave", "--wavelengths", "550:0"), "not all zero"),
        (("--model", "wave", "--wavelengths", "blue"), "--wavelengths"),
        (("--model", "wave", "--lamp-distance", "80", "--field", "2"), "--lamp-distance"),
        (("--spectrum", "none.csv", "--wavelengths", "500"), "leave --wavelengths out"),
        (("--spectrum", "none.csv", "--model", "both"), "one model"),
    ],
)
def test_combinations_that_make_no_sense_are_refused(capsys, arguments, words):
    assert words in refused(capsys, "--ridge-angle", "10", *arguments)
