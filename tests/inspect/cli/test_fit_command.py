import re
from pathlib import Path

import numpy as np
import pytest

DOCS = Path(__file__).resolve().parents[3] / "docs" / "fit.md"
EXAMPLE = re.search(r"```csv\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL).group(1)


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    path = tmp_path_factory.mktemp("fit") / "table.csv"
    path.write_text(EXAMPLE, encoding="utf-8")
    return path


def parameters(done):
    assert done.code == 0, done.err
    return {one["name"]: one for one in done.json["parameters"]}


def test_the_example_of_the_docs_is_what_predict_says(anisoscope):
    command = re.search(r"`anisoscope (predict [^`]*)`", DOCS.read_text(encoding="utf-8")).group(1).split()
    poses = anisoscope(*command).json["poses"]
    rows = [list(map(float, line.split(","))) for line in EXAMPLE.splitlines()[1:]]
    assert [(p["stage_deg"], p["tilt_deg"]) for p in poses] == [tuple(row[:2]) for row in rows]
    np.testing.assert_allclose([row[2] for row in rows], [p["radiance"] for p in poses], rtol=5e-3)
    np.testing.assert_allclose([row[3] for row in rows], [0.01 * row[2] for row in rows], rtol=0.02)


def test_json_of_the_example(anisoscope, example):
    done = anisoscope("fit", "ridges", example, "--json")
    found = parameters(done)
    assert list(found) == ["ridge_angle_deg", "alpha_along", "alpha_across", "k"]
    truth = {"ridge_angle_deg": 8.0, "alpha_along": 0.05, "alpha_across": 0.12, "k": 1.0}
    text = DOCS.read_text(encoding="utf-8")
    for name, one in found.items():
        assert one["determined"]
        assert abs(one["value"] - truth[name]) < one["u"]
        assert one["low95"] < one["value"] < one["high95"]
    assert f"{found['ridge_angle_deg']['value']:.3f} ± {found['ridge_angle_deg']['u']:.3f}°" in text
    whole = done.json
    assert np.diag(whole["correlation"]) == pytest.approx(1.0)
    np.testing.assert_allclose(np.sqrt(np.diag(whole["covariance"])), [one["u"] for one in found.values()])
    assert (whole["dof"], len(whole["rows"]), whole["noise"]) == (8, 12, "given")
    assert whole["convention"]["light_angle_deg"] == 10.0
    assert set(whole["rows"][0]) == {"stage_deg", "tilt_deg", "measured", "u", "fitted", "residual", "z"}
    assert sum(row["z"] ** 2 for row in whole["rows"]) == pytest.approx(whole["chi2"])


def test_a_value_that_is_not_determined_is_null_and_named(anisoscope, example):
    free = "ridge_angle,alpha_along,alpha_across,k,seating_y"
    done = anisoscope("fit", "ridges", example, "--free", free, "--bounces", 1, "--json")
    found = parameters(done)
    assert {name for name, one in found.items() if one["value"] is None} == {
        "ridge_angle_deg",
        "seating_y_deg",
    }
    assert done.json["correlation"][0] == [None] * 5
    assert set(done.json["not_determined"][0]["parts"]) == {"ridge_angle_deg", "seating_y_deg"}
    assert any("Not determined" in note for note in done.json["notes"])


def test_options_fix_what_is_not_free(anisoscope, example):
    done = anisoscope("fit", "ridges", example, "--free", "k", "--ridge-angle", 8, "--alpha-along", 0.05, "--json",
                      "--alpha-across", 0.12, "--albedo", 0.2)  # fmt: skip
    assert parameters(done)["k"]["value"] == pytest.approx(1.0, abs=0.01)
    assert done.json["fixed"]["ridge_angle_deg"] == 8.0
    assert "k" not in done.json["fixed"]


def test_the_table_says_what_was_fitted_and_how(anisoscope, example):
    done = anisoscope("fit", "ridges", example, "--quantity", "difference", "--bounces", 1)
    assert done.code == 0, done.err
    for words in (
        "ridge angle",
        "[as measured]",
        "Correlation",
        "tilt plane",
        "chi²",
        "p = ",
        "built from the exposures",
    ):
        assert words in done.out


def test_page(anisoscope, example, tmp_path):
    page = tmp_path / "fit.html"
    free = "ridge_angle,alpha_along,seating_y"
    plastic = ("--alpha-across", 0.12, "--bounces", 1)
    done = anisoscope("fit", "ridges", example, "--html", page, "--free", free, *plastic)
    assert done.code == 0, done.err
    text = page.read_text(encoding="utf-8")
    assert text.count("data:image/svg+xml") == 2
    assert "http://" not in re.sub(r"data:[^\"]*", "", text)
    for place in ('id="parameters"', 'id="correlation"', 'id="rows"', "seating tilt about y"):
        assert place in text


def test_the_experiment(anisoscope, tmp_path):
    path = tmp_path / "measured.csv"
    path.write_text(
        anisoscope("research", "experiment", "--as-csv", "--alpha-along", 0.05).out, encoding="utf-8"
    )
    found = parameters(anisoscope("fit", "experiment", path, "--model", "printed", "--json"))
    assert found["alpha_along"]["value"] == pytest.approx(0.05, rel=1e-3)
    assert found["k"]["value"] == pytest.approx(1.0, rel=1e-3)


def test_a_brdf_compared_and_fitted(anisoscope, tmp_path):
    from anisoscope.fit.table import COLUMNS, unit_vectors
    from anisoscope.parameters.material import Material
    from anisoscope.parameters.ridges import RidgeDesign
    from anisoscope.sim.light import corrected

    rng = np.random.default_rng(2)
    angles = np.stack(
        [rng.uniform(0, 40, 30), np.full(30, 90.0), rng.uniform(0, 40, 30), np.full(30, 270.0)], axis=1
    )
    light, camera = unit_vectors(angles[:, 0], angles[:, 1]), unit_vectors(angles[:, 2], angles[:, 3])
    value = (
        corrected.radiance(light, camera, RidgeDesign(100.0, 5.0), Material(0.08, 0.1), None) / light[:, 2]
    )
    value[7] *= 1.5
    path = tmp_path / "brdf.csv"
    rows = [",".join(map(repr, map(float, (*row, v)))) for row, v in zip(angles, value, strict=True)]
    path.write_text("\n".join([",".join(COLUMNS), *rows]), encoding="utf-8")
    known = ["--ridge-angle", 5, "--alpha-along", 0.08, "--alpha-across", 0.1]
    compared = anisoscope("fit", "brdf", path, *known, "--json")
    assert compared.code == 0, compared.err
    worst = max(compared.json["rows"], key=lambda row: abs(row["residual"]))
    assert worst["line"] == 9
    assert compared.json["parameters"] == []
    shown = anisoscope("fit", "brdf", path, *known)
    assert "worst of 30 rows" in shown.out
    assert "Reciprocity: no row" in shown.out
    path.write_text("\n".join([",".join(COLUMNS), *rows[:7], *rows[8:]]), encoding="utf-8")
    fitted = anisoscope("fit", "brdf", path, "--ridge-angle", 5, "--fit", "--free", "alpha_along", "--json")
    assert parameters(fitted)["alpha_along"]["value"] == pytest.approx(0.08, rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--free", "pitch"], "--free knows ridge_angle"),
        (["--quantity", "log_ratio", "--free", "k"], "k cancels"),
        (["--model", "printed", "--free", "k,index"], "--free index is refused"),
        (["--bounces", "0"], "--bounces must be 1 or more"),
        (["--model", "printed", "--bounces", "2"], "needs --model corrected"),
        (["--albedo", "2"], "albedo: 2 lies outside"),
        (["--json", "--html", "x.html"], "exclude each other"),
        (["--html", "/nowhere/x.html", "--free", "none"], "cannot write"),
    ],
)
def test_refusals_are_one_line(anisoscope, example, arguments, words):
    done = anisoscope("fit", "ridges", example, *arguments)
    assert done.code != 0
    assert words in done.err
    assert done.err.count("\n") == 1


def test_free_without_fit_is_refused(anisoscope, example):
    done = anisoscope("fit", "brdf", example, "--ridge-angle", 5, "--free", "k")
    assert done.code == 64
    assert "--free needs --fit" in done.err


def test_ridges_of_any_wall_crest_and_lobe_are_fitted_as_they_are_predicted(anisoscope, tmp_path):
    part = ["--wall", 8, "--edge-radius", 4, "--tail", 0.6, "--rotation-sense", "cw", "--bounces", 1]
    lobe = ["--second-lobe", "0.2,2", "--pitch", 60]
    poses = ["--angles", "0,40,90,140,180,220,270,320", "--tilts=-10,0,10"]
    told = anisoscope("predict", "--ridge-angle", 9, *part, *lobe, *poses, "--no-uncertainty", "--json")
    assert told.code == 0, told.err
    rows = [
        f"{p['stage_deg']},{p['tilt_deg']},{p['radiance']},{0.003 * p['radiance']}"
        for p in told.json["poses"]
    ]
    path = tmp_path / "table.csv"
    path.write_text("\n".join(["stage_deg,tilt_deg,value,u", *rows]), encoding="utf-8")
    free = ["--free", "ridge_angle,alpha_along", "--json"]
    found = anisoscope("fit", "ridges", path, *part, *lobe, *free)
    assert parameters(found)["ridge_angle_deg"]["value"] == pytest.approx(9.0, abs=1e-2)
    assert parameters(found)["alpha_along"]["value"] == pytest.approx(0.06, rel=5e-3)
    assert found.json["chi2"] < 1.0
    assert (found.json["wall"], found.json["edge_radius_um"], found.json["second_lobe"]) == (
        8.0,
        4.0,
        [0.2, 2.0],
    )
    assert anisoscope("fit", "ridges", path, *free, "--bounces", 1).json["chi2"] > 100.0
    file = tmp_path / "abs.toml"
    file.write_text(
        'schema = 1\nid = "m"\nname = "ABS"\n[material]\nalpha_along = 0.06\nalpha_across = 0.1\nalbedo = 0.2\n'
        "tail = 0.6\nsecond_lobe = [0.2, 2.0]\n[covariance]\nparameters = ['tail']\nmatrix = [[0.0]]\n"
        "[validity]\nhalf_angle_deg = [0.0, 60.0]\n"
    )
    of_file = [one for one in part if one not in ("--tail", 0.6)]
    again = anisoscope("fit", "ridges", path, *of_file, "--pitch", 60, "--material", file, *free)
    assert again.json["chi2"] == pytest.approx(found.json["chi2"], abs=1e-6)
