"""``anisoscope ink compare`` as a user calls it."""

import numpy as np
import PIL.Image
import pytest

from anisoscope.sim.materials.inks import synthetic_ink
from anisoscope.sim.proof.comparison import synthetic_readings


@pytest.fixture(scope="module")
def readings(tmp_path_factory):
    """Ratios to a white reference of 0.99, as a goniometer's file holds them."""
    made = synthetic_readings(synthetic_ink("synthetic-green"), np.random.default_rng(2))
    lines = ["theta_i_deg,theta_o_deg,wavelength_nm,value"]
    for light, seen, values in zip(made.theta_i_deg, made.theta_o_deg, made.value, strict=True):
        lines += [
            f"{light},{seen},{nm},{v * np.pi / 0.99:.6g}"
            for nm, v in zip(made.wavelengths_nm, values, strict=True)
        ]
    path = tmp_path_factory.mktemp("readings") / "green.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_our_model_comes_first_on_a_file_of_readings(anisoscope, readings, tmp_path):
    done = anisoscope(
        "ink", "compare", readings, "--picture-size", 96, "--png", tmp_path / "spheres.png", "--json"
    )
    assert done.code == 0, done.err
    (one,) = done.json["inks"]
    assert one["ink"] == "green"
    assert one["alpha"] == pytest.approx(0.19, rel=0.06)  # the lobe toward the light widens it
    models = one["models"]
    for other in ("schlick", "tio2"):
        assert models["goniochromatic"]["rmse"] < models[other]["rmse"]
        assert models["goniochromatic"]["ssim"] > models[other]["ssim"]
    assert models["goniochromatic"]["frame_ms"] > 0.0
    assert "11 × 11" in done.json["convention"]
    with PIL.Image.open(tmp_path / "spheres.png") as picture:
        assert picture.size == (4 * 96, 96)


def test_what_the_fit_warns_of_is_said(anisoscope, readings):
    arguments = ("ink", "compare", readings, "--picture-size", 32)
    (warning,) = anisoscope(*arguments, "--json").json["warnings"]
    assert warning.startswith("green: residuals of")  # the readings have a lobe that no model here has
    assert "warning: green: residuals of" in anisoscope(*arguments).out


def test_made_up_readings_are_called_so(anisoscope):
    done = anisoscope("ink", "compare", "--synthetic", "--picture-size", 64)
    assert done.code == 0, done.err
    for words in (
        "made-up readings",
        "nothing about real inks",
        "standard, Schlick",
        "synthetic-blue",
        "Convention: encoded",
    ):
        assert words in done.out
    assert "warning" not in done.out  # the fit warns of real readings only


def test_mistakes_are_told_in_one_line(anisoscope, readings, tmp_path):
    holes = tmp_path / "holes.csv"
    holes.write_text("\n".join(readings.read_text().splitlines()[:-3]))
    for arguments, message in (
        ([], "needs readings"),
        ([readings, "--synthetic"], "needs readings"),
        ([readings, "--values", "brdf", "--reflectance", "0.9"], "no white reference"),
        ([holes], "every wavelength at every place"),
        ([readings, "--png", "x.jpg"], "--png writes *.png"),
        ([readings, "--picture-size", "8"], "32 pixels"),
        ([readings, "--picture-size", "30000"], "--picture-size takes"),
        (["--synthetic", "--seed", "-1"], "--seed 0 or more"),
    ):
        done = anisoscope("ink", "compare", *arguments)
        assert done.code not in (0, 1)
        assert message in done.err
        assert done.err.count("\n") == 1
