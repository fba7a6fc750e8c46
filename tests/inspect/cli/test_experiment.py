import json
from xml.etree import ElementTree as ET

import numpy as np
import pytest

HEADER = "ridge_angle_deg,tilt_deg,from_deg,to_deg,contrast"


@pytest.fixture(scope="module")
def predicted_csv(anisoscope):
    done = anisoscope("research", "experiment", "--as-csv")
    assert done.code == 0, done.err
    return done.out


def test_json_of_the_experiment(anisoscope):
    done = anisoscope("research", "experiment", "--json")
    assert done.code == 0, done.err
    found = done.json
    assert found["model"] == "printed"
    assert found["convention"] == {
        "light_angle_deg": 10.0,
        "tilt_plane": "perpendicular",
        "facet_azimuth_deg": 0.0,
        "rotation_sense": "ccw",
    }
    assert found["k"] == 1.0
    assert len(found["rows"]) == 40
    assert set(found["rows"][0]) == set(HEADER.split(","))
    assert [m["level_deg"] for m in found["means"]["tilt"]] == [-20, -10, 0, 10, 20]
    assert [m["level_deg"] for m in found["means"]["ridge_angle"]] == [5, 10, 15, 20]
    assert [m["level_deg"] for m in found["means"]["pair"]] == [[0, 90], [90, 180]]
    for mean in found["means"]["ridge_angle"]:
        rows = [r["contrast"] for r in found["rows"] if r["ridge_angle_deg"] == mean["level_deg"]]
        assert mean["predicted"] == pytest.approx(np.mean(rows))
        assert "measured" not in mean
    assert found["findings"] == {
        "max_at_zero_tilt": True,
        "falls_on_both_sides": True,
        "first_pair_larger": True,
        "best_ridge_angle_deg": 5.0,
    }


def test_options_reach_the_model(anisoscope):
    arguments = [
        "--model",
        "corrected",
        "--alpha-along",
        0.1,
        "--alpha-across",
        0.2,
        "--albedo",
        0.5,
        "--index",
        1.6,
    ]
    found = anisoscope("research", "experiment", "--json", *arguments, "--light-angle", 12).json
    assert found["model"] == "corrected"
    assert "shadow_frame" not in found
    assert found["material"]["alpha_along"] == 0.1
    assert found["material"]["albedo"] == 0.5
    assert found["convention"]["light_angle_deg"] == 12.0
    single = anisoscope(
        *["predict", "--ridge-angle", 15, "--tilts=-10", "--json", "--light-angle", 12, "--bounces", 1],
        *arguments[2:],
    ).json["contrasts"]
    rows = [r for r in found["rows"] if (r["ridge_angle_deg"], r["tilt_deg"]) == (15, -10)]
    assert [r["contrast"] for r in rows] == pytest.approx([abs(c["difference"]) for c in single])


def test_conventions_and_frames_change_the_result(anisoscope):
    found = [
        anisoscope("research", "experiment", "--as-csv", *extra).out
        for extra in (
            [],
            ["--tilt-plane", "in-plane"],
            ["--facet-azimuth", 180],
            ["--shadow-frame", "half-vector"],
        )
    ]
    assert len(set(found)) == 4


def test_csv_fed_back_is_measured_perfectly(anisoscope, predicted_csv, tmp_path):
    path = tmp_path / "back.csv"
    path.write_text(predicted_csv, encoding="utf-8")
    found = anisoscope("research", "experiment", "--measured", path, "--json").json
    assert found["k"] == 1.0
    assert found["rms_residual"] == 0.0
    assert all(row["contrast"] == row["measured"] for row in found["rows"])
    assert found["measured_findings"] == found["findings"]
    for means in found["means"].values():
        assert all(m["measured"] == m["predicted"] == m["predicted_same_rows"] for m in means)


def test_a_partial_table_is_enough(anisoscope, predicted_csv, tmp_path):
    lines = predicted_csv.splitlines()
    path = tmp_path / "part.csv"
    scaled = [f"{line.rpartition(',')[0]},{4.0 * float(line.rpartition(',')[2])!r}" for line in lines[3:7]]
    path.write_text("\n".join([lines[0], *scaled]), encoding="utf-8")
    found = anisoscope("research", "experiment", "--measured", path, "--json").json
    assert found["k"] == pytest.approx(4.0, rel=1e-12)
    assert sum("measured" in row for row in found["rows"]) == 4
    assert "measured_findings" not in found
    assert [m["measured_rows"] for m in found["means"]["ridge_angle"]] == [4, 0, 0, 0]
    shown = anisoscope("research", "experiment", "--measured", path)
    assert "k = 4 (least squares), rms residual" in shown.out
    both = anisoscope("research", "experiment", "--measured", path, "--as-csv").out.splitlines()
    assert both[0] == HEADER + ",measured"
    assert sum(not line.endswith(",") for line in both[1:]) == 4


def test_table_carries_units_convention_scale_and_findings(anisoscope):
    done = anisoscope("research", "experiment")
    assert done.code == 0
    for word in (
        "[°]",
        "1/sr",
        "perpendicular to",
        "k = 1",
        "best ridge angle: 5°",
        "falling on both sides: yes",
    ):
        assert word in done.out


def test_html_says_where_it_is(anisoscope, tmp_path):
    done = anisoscope("research", "experiment", "--html", tmp_path / "page.html")
    assert done.code == 0, done.err
    assert "page.html" in done.out
    assert (tmp_path / "page.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_findings_on_a_grid(anisoscope, tmp_path):
    grid = ("research", "findings", "--grid-points", 8)
    found = anisoscope(*grid, "--json").json
    default, in_plane = found["maps"]
    assert default["convention"]["tilt_plane"] == "perpendicular"
    assert default["share"] == pytest.approx(np.mean(default["all_three"]))
    assert 0.3 < default["share"] < 0.6
    assert (
        default["share_falling_too"]
        <= default["share"]
        <= min(default["shares"][key] for key in ("max_at_zero_tilt", "first_pair_larger", "best_at_five"))
    )
    assert in_plane["convention"]["tilt_plane"] == "in-plane"
    assert in_plane["share"] == 0.0
    assert in_plane["extent"] is None
    assert found["alpha_along"][0] == 0.03
    assert found["alpha_along"][-1] == 0.3
    shown = anisoscope(*grid).out
    assert f"{100.0 * default['share']:.1f} %" in shown
    assert "8 × 8" in shown
    picture = anisoscope(*grid, "--svg", tmp_path / "map.svg")
    assert f"{100.0 * default['share']:.1f} %" in picture.out
    assert ET.parse(tmp_path / "map.svg").getroot().tag.endswith("svg")
    page = anisoscope(*grid, "--html", tmp_path / "map.html")
    assert page.code == 0, page.err


def test_the_picture_in_the_docs_is_made_by_the_command_in_the_docs(anisoscope, request, tmp_path):
    """Its numbers too: they are parsed out of the text."""
    root = request.config.rootpath
    text = (root / "docs" / "experiment.md").read_text(encoding="utf-8")
    assert "anisoscope research findings --svg docs/pictures/experiment-findings.svg" in text
    done = anisoscope("research", "findings", "--json")
    share, falling = (done.json["maps"][0][key] for key in ("share", "share_falling_too"))
    assert f"| all three | {100.0 * share:.1f} % | 0.0 % |" in text
    assert f"| all three, and falling on both sides | {100.0 * falling:.1f} % | 0.0 % |" in text
    anisoscope("research", "findings", "--svg", tmp_path / "map.svg")
    kept = ET.parse(root / "docs" / "pictures" / "experiment-findings.svg").getroot()
    made = ET.parse(tmp_path / "map.svg").getroot()
    assert [e.tag for e in kept.iter()] == [e.tag for e in made.iter()]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["experiment", "--json", "--as-csv"], "--json and --as-csv exclude each other"),
        (["experiment", "--as-csv", "--html", "x.html"], "--as-csv and --html exclude each other"),
        (["experiment", "--model", "corrected", "--shadow-frame", "half-vector"], "printed model only"),
        (["experiment", "--model", "relief"], "model"),
        (["experiment", "--alpha-along", 0], "alpha along"),
        (["experiment", "--albedo", "nan"], "albedo"),
        (["experiment", "--facet-azimuth", "nan"], "--facet-azimuth"),
        (["experiment", "--light-angle", 90], "light angle"),
        (["experiment", "--light-angle", 75, "--tilt-plane", "in-plane"], "horizon"),
        (["experiment", "--measured", "nowhere.csv"], "nowhere.csv"),
        (["experiment", "--measured", "WRONG"], "line 3: the experiment has no ridge angle 6°"),
        (["experiment", "--html", "nowhere/page.html"], "nowhere/page.html"),
        (["findings", "--grid-points", 1], "--grid-points"),
        (["findings", "--alpha-from", 0.3, "--alpha-to", 0.1], "--alpha-from"),
        (["findings", "--alpha-to", 5], "alpha"),
        (["findings", "--json", "--svg", "x.svg"], "--json and --svg exclude each other"),
    ],
)
def test_wrong_usage_is_one_clear_line(anisoscope, tmp_path, arguments, words):
    wrong = tmp_path / "wrong.csv"
    wrong.write_text(f"{HEADER}\n5,0,0,90,1\n6,0,0,90,1\n", encoding="utf-8")
    done = anisoscope("research", *[wrong if a == "WRONG" else a for a in arguments], cwd=tmp_path)
    assert 64 <= done.code < 128
    assert done.out == ""
    assert done.err.count("\n") == 1, done.err
    assert words in done.err


def test_json_is_strict(anisoscope):
    """Contrasts that vanish stay numbers."""
    done = anisoscope("research", "experiment", "--alpha-along", 0.001, "--alpha-across", 0.001, "--json")
    assert done.code == 0, done.err

    def refuse(name):
        raise AssertionError(name)

    json.loads(done.out, parse_constant=refuse)
