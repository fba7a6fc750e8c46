"""Uncertainty, spectra and the further options of ``predict``, through the command line."""

from dataclasses import fields

import numpy as np
import pytest

from anisoscope.cli.options import OF_UNCERTAINTY
from anisoscope.parameters.inputs import default_uncertainty
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import ridges
from anisoscope.recipe.surface import MaterialPart, RigUncertainty

FAST = ("--u-alpha", 0, "--u-index", 0)


@pytest.fixture(scope="module")
def height_map(tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "map.x3p"
    write_height_map(ridges(RidgeDesign(100.0, 10.0), (41, 601), (2.0, 1.0), 0.3), path)
    return path


def test_defaults_of_options_library_and_recipe_are_the_same():
    inputs, rig = default_uncertainty(Material()), RigUncertainty()
    assert OF_UNCERTAINTY.default == inputs
    for name in {field.name for field in fields(inputs)} & set(RigUncertainty.model_fields) - {
        "stage_deg"
    }:  # of the measurement
        assert getattr(inputs, name) == getattr(rig, name), name
    part = MaterialPart(alpha_along=0.06, alpha_across=0.1, albedo=0.2)
    assert (part.u_alpha_share, part.u_albedo, part.u_index, part.u_tail) == (0.1, 0.1 * 0.2, 0.01, None)
    assert (inputs.alpha_share, inputs.albedo, inputs.index, inputs.tail) == (0.1, 0.1 * 0.2, 0.01, None)
    known, stated = default_uncertainty(Material(), 0.0), {**dict(part), "u_tail": 0.0}
    for name in ("u_alpha_share", "u_albedo"):
        del stated[name]
    part = MaterialPart.model_validate(stated)
    assert (known.alpha_share, known.albedo, known.tail) == (part.u_alpha_share, part.u_albedo, part.u_tail)


def test_json_states_u_of_poses_and_contrasts_with_budget_and_covariance(anisoscope):
    done = anisoscope("predict", "--ridge-angle", 10, "--tilts=-10,0", "--covariance", "--json")
    assert done.code == 0, done.err
    found = done.json
    matrix = np.array(found["covariance"]["radiance"]["matrix"])
    assert found["covariance"]["radiance"]["labels"][1] == "90°, tilt -10°"
    assert len(found["covariance"]["radiance"]["labels"]) == 6
    u = np.array([pose["u"] for pose in found["poses"]])
    np.testing.assert_allclose(u, np.sqrt(np.diag(matrix)))
    shares = sum(np.array(part["u"]) ** 2 for part in found["budget"])
    np.testing.assert_allclose(shares, u**2)
    radiance = np.array([pose["radiance"] for pose in found["poses"]])
    for part in found["budget"]:
        np.testing.assert_allclose(np.array(part["relative"]) * radiance, part["u"], atol=1e-12)
    for kind in ("difference", "michelson", "log_ratio"):
        block = found["covariance"][kind]
        assert block["labels"][0] == "0°/90°, tilt -10°"
        stated = [contrast["u"][kind] for contrast in found["contrasts"]]
        np.testing.assert_allclose(stated, np.sqrt(np.diag(block["matrix"])))
    gradient = np.zeros((4, 6))
    for row, (i, j) in enumerate([(0, 1), (1, 2), (3, 4), (4, 5)]):
        gradient[row, [i, j]] = 1.0, -1.0
    np.testing.assert_allclose(
        found["covariance"]["difference"]["matrix"], gradient @ matrix @ gradient.T, atol=1e-12
    )


def test_options_reach_the_budget(anisoscope, height_map):
    def budget(*options):
        done = anisoscope("predict", *options, "--json")
        assert done.code == 0, done.err
        return {part["source"]: np.abs(part["u"]).max() for part in done.json["budget"]}

    design = budget("--ridge-angle", 10, "--u-ridge-angle", 0.1, "--u-height-loss", 0.01, "--light-field", 1)
    assert design["ridge angle of the design"] > 0
    assert design["height loss of the design"] > 0
    assert design["light angle over the field"] > 0
    once, twice = (budget("--ridge-angle", 10, *FAST, "--u-seating-tilt", u) for u in (0.1, 0.2))
    assert twice["seating tilt about y"] == pytest.approx(2 * once["seating tilt about y"])
    assert once["refractive index"] == 0.0
    of_map = budget(
        height_map, *FAST, "--u-height-noise", 0.01, "--u-height-scale", 0.01, "--u-pixel-size", 0.01
    )
    assert {
        "height scale of the map",
        "pixel size of the map",
        "height noise, mean shift",
        "height noise, scatter",
        "height map, overall",
        "walls and crests between the points, fit",
        "scatter between ridges",
    } <= set(of_map)


def test_table_shows_u_and_says_what_it_is(anisoscope):
    done = anisoscope("predict", "--ridge-angle", 10, *FAST, "--verbose")
    assert done.code == 0, done.err
    for word in ("radiance ± u [1/sr]", "Michelson ± u", "coverage factor 1", "Uncertainty budget", "albedo"):
        assert word in done.out
    bare = anisoscope("predict", "--ridge-angle", 10, "--no-uncertainty")
    assert "±" not in bare.out
    json = anisoscope("predict", "--ridge-angle", 10, "--no-uncertainty", "--json").json
    assert "budget" not in json
    assert "u" not in json["poses"][0]


def test_monte_carlo_replaces_u_and_says_where_the_first_order_fails(anisoscope):
    smooth = ("--ridge-angle", 5, "--alpha-along", 0.03, "--alpha-across", 0.03, "--angles", "0,180", *FAST)
    bad = (*smooth, "--u-seating-tilt", 1.5)
    warned = anisoscope("predict", *bad, "--json").json
    assert "0°, tilt 0°" in warned["uncertainty_warning"]
    assert "--monte-carlo" in warned["uncertainty_warning"]
    done = anisoscope("predict", *bad, "--monte-carlo", 200, "--covariance", "--json").json
    assert "fails" in done["uncertainty_warning"]
    drawn = done["monte_carlo"]
    assert drawn["draws"] == 200
    np.testing.assert_allclose([pose["u"] for pose in done["poses"]], drawn["u"])
    assert drawn["u"][0] > 1.3 * drawn["u_first_order"][0]
    np.testing.assert_allclose(np.sqrt(np.diag(done["covariance"]["radiance"]["matrix"])), drawn["u"])
    table = anisoscope("predict", *bad, "--monte-carlo", 50, "--verbose")
    assert "u Monte Carlo" in table.out
    assert "warning: first-order" in table.out
    good = anisoscope("predict", "--ridge-angle", 10, *FAST, "--monte-carlo", 200, "--json").json
    assert "uncertainty_warning" not in good


def test_a_dark_pose_has_a_u_and_no_relative_one(anisoscope):
    done = anisoscope(
        "predict", "--ridge-angle", 20, "--albedo", 0, "--u-albedo", 0, "--alpha-along", 0.01,
        "--alpha-across", 0.01, "--covariance", "--json", "--model", "geometric", "--bounces", 1,
    )  # fmt: skip
    assert done.code == 0, done.err
    assert all(pose["u"] >= 0 for pose in done.json["poses"])
    assert done.json["budget"][0]["relative"] == [None, None, None]
    assert done.json["contrasts"][0]["u"]["log_ratio"] is None
    assert done.json["covariance"]["log_ratio"]["matrix"][0][0] is None
    assert "NaN" not in done.out
    table = anisoscope("predict", "--ridge-angle", 20, "--albedo", 0, "--alpha-along", 0.01, "-v")
    assert table.code == 0, table.err
    assert "nan" not in table.out
    assert "inf" not in table.out


def test_height_loss_darkens_the_facet_and_shows_a_plateau(anisoscope):
    def predict(loss):
        found = anisoscope(
            "predict", "--ridge-angle", 10, "--height-loss", loss, "--no-uncertainty", "--json"
        ).json
        return [pose["radiance"] for pose in found["poses"]]

    none, all_of_it = predict(0), predict(1)
    flat = anisoscope("predict", "--ridge-angle", 0, "--no-uncertainty", "--json").json
    np.testing.assert_allclose(all_of_it, [pose["radiance"] for pose in flat["poses"]])
    np.testing.assert_allclose(
        np.array(predict(0.5))[1], 0.5 * (np.array(none) + np.array(all_of_it))[1], rtol=0.1
    )


def test_a_map_of_the_tool_is_the_part_turned_inside_out(anisoscope, tmp_path):
    part = ridges(RidgeDesign(100.0, 10.0), (10, 601), (1.0, 1.0))
    write_height_map(part, tmp_path / "part.x3p")
    write_height_map(part.with_height(-part.height_um[:, ::-1]), tmp_path / "tool.x3p")
    of_part = anisoscope("predict", tmp_path / "part.x3p", "--no-uncertainty", "--json").json["poses"]
    of_tool = anisoscope(
        "predict", tmp_path / "tool.x3p", "--role", "tool", "--no-uncertainty", "--json"
    ).json["poses"]
    assert [p["radiance"] for p in of_tool] == pytest.approx([p["radiance"] for p in of_part], rel=1e-4)


def test_missing_share_above_the_limit_is_refused_and_the_limit_can_be_moved(anisoscope, tmp_path):
    surface = ridges(RidgeDesign(100.0, 10.0), (40, 601), (1.0, 1.0))
    height = surface.height_um.copy()
    height[:12] = np.nan
    write_height_map(surface.with_height(height), tmp_path / "holes.x3p")
    refused = anisoscope("predict", tmp_path / "holes.x3p", "--no-uncertainty")
    assert (refused.code, refused.err.count("\n")) == (65, 1)
    assert "missing (limit 25 %)" in refused.err
    assert anisoscope("predict", tmp_path / "holes.x3p", "--max-missing", 0.5, *FAST).code == 0
    strict = anisoscope("predict", tmp_path / "holes.x3p", "--max-missing", 0.1)
    assert "(limit 10 %)" in strict.err


def test_pixels_that_are_not_square_are_what_they_are(anisoscope, tmp_path):
    np.save(tmp_path / "map.npy", ridges(RidgeDesign(100.0, 10.0), (20, 1201), (3.0, 0.5)).height_um)
    right = anisoscope("predict", tmp_path / "map.npy", "--pixel", "3,0.5", "--no-uncertainty", "--json").json
    design = anisoscope("predict", "--ridge-angle", 10, "--no-uncertainty", "--json").json
    assert right["pitch_um"] == pytest.approx(100.0, rel=1e-3)
    for measured, ideal in zip(right["poses"], design["poses"], strict=True):
        assert measured["radiance"] == pytest.approx(ideal["radiance"], rel=0.01)


@pytest.fixture(scope="module")
def spectrum(tmp_path_factory):
    path = tmp_path_factory.mktemp("spectrum") / "plastic.csv"
    path.write_text("wavelength_nm,index,albedo\n450,1.52,0.1\n550,1.5,0.2\n650,1.49,0.4\n")
    return path


@pytest.mark.parametrize("what", ["design", "map"])
def test_a_spectrum_is_predicted_at_each_of_its_wavelengths(anisoscope, spectrum, height_map, what):
    of = (height_map, "--bounces", 1) if what == "map" else ("--ridge-angle", 10)
    done = anisoscope("predict", *of, "--u-alpha", 0, "--spectrum", spectrum, "--covariance", "--json")
    assert done.code == 0, done.err
    found = done.json
    assert found["wavelengths_nm"] == [450, 550, 650]
    one = anisoscope("predict", *of, "--u-alpha", 0, "--json").json  # the defaults are those at 550 nm
    for many, single in zip(found["poses"], one["poses"], strict=True):
        assert len(many["radiance"]) == 3
        assert many["radiance"][1] == pytest.approx(single["radiance"])
        assert many["u"][1] == pytest.approx(single["u"])
    for many, single in zip(found["contrasts"], one["contrasts"], strict=True):
        assert many["log_ratio"][1] == pytest.approx(single["log_ratio"])
        assert many["u"]["michelson"][1] == pytest.approx(single["u"]["michelson"])
        assert abs(many["log_ratio"][0]) > abs(many["log_ratio"][2])  # white plastic washes contrast out
    assert len(found["budget"]) == len(found["covariance"]) == 3
    table = anisoscope("predict", *of, "--no-uncertainty", "--spectrum", spectrum)
    assert "[nm]" in table.out
    assert all(wavelength in table.out for wavelength in ("450", "550", "650"))


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--ridge-angle", 45], 64, "the ridge angle must be within 0° and 45°"),
        (["--ridge-angle", 10, "--alpha-across", -0.1], 64, "alpha across"),
        (["--ridge-angle", 10, "--tilts", "89.99"], 64, "horizon"),
        (["--ridge-angle", 10, "--tilts", "89.9"], 64, "uncertainty of the angles from the horizon"),
        (["--ridge-angle", 10, "--tilt-plane", "in-plane", "--tilts", "80"], 64, "horizon"),
        (["--ridge-angle", 10, "--height-loss", 1.5], 64, "height loss"),
        (
            ["--ridge-angle", 10, "--height-loss", 0.1, "--model", "printed"],
            64,
            "--height-loss needs a design",
        ),
        (["MAP", "--height-loss", 0.1], 64, "--height-loss needs a design"),
        (["--ridge-angle", 10, "--role", "tool"], 64, "--role tool belongs to a height map"),
        (["MAP", "--max-missing", 2], 64, "--max-missing must be a share"),
        (["MAP", "--pitch", 700], 65, "100.00 µm apart, not 700 µm"),
        (["NARROW", "--pitch", 100], 65, "80 µm wide, less than one pitch of 100 µm"),
        (["MAP", "--pitch", 0], 65, "the pitch must be a positive number"),
        (["NAN"], 65, "every point is marked as missing"),
        (
            ["--ridge-angle", 10, "--u-albedo", -1],
            64,
            "--u-albedo: the uncertainty 'albedo' must be a finite number, 0 or more",
        ),
        (["--ridge-angle", 10, "--u-height-noise", 0.1], 64, "--u-height-noise belongs to a height map"),
        (["MAP", "--u-ridge-angle", 0.1], 64, "--u-ridge-angle belongs to a design"),
        (["MAP", "--ridges-seen", 0], 64, "--ridges-seen: the camera sees one ridge or more"),
        (["--ridge-angle", 10, "--covariance"], 64, "add --json"),
        (["--ridge-angle", 10, "--monte-carlo", 5], 64, "at least 10 draws"),
        (["--ridge-angle", 10, "--monte-carlo", 50, "--no-uncertainty"], 64, "exclude each other"),
        (["--ridge-angle", 10, "--monte-carlo", 50, "--seed=-1"], 64, "--seed"),
        (["--ridge-angle", 10, "--spectrum", "missing.csv"], 64, "missing.csv"),
        (
            ["--ridge-angle", 10, "--spectrum", "SPECTRUM", "--model", "printed"],
            64,
            "--spectrum needs --model",
        ),
        (
            ["--ridge-angle", 10, "--spectrum", "SPECTRUM", "--albedo", 0.5],
            64,
            "leave --index and --albedo out",
        ),
        (["--ridge-angle", 10, "--spectrum", "SPECTRUM", "--monte-carlo", 50], 64, "one wavelength"),
    ],
)
def test_bad_values_are_one_clear_line(anisoscope, height_map, spectrum, tmp_path, arguments, code, words):
    np.save(tmp_path / "nan.npy", np.full((20, 30), np.nan))
    write_height_map(ridges(RidgeDesign(100.0, 10.0), (41, 81), (1.0, 1.0)), tmp_path / "narrow.x3p")
    stand_ins = {
        "NARROW": [tmp_path / "narrow.x3p"],
        "MAP": [height_map],
        "SPECTRUM": [spectrum],
        "NAN": [tmp_path / "nan.npy", "--pixel", 1],
    }
    done = anisoscope("predict", *[token for a in arguments for token in stand_ins.get(a, [a])])
    assert (done.code, done.out, done.err.count("\n")) == (code, "", 1), done.err
    assert words in done.err
