"""``anisoscope optimise`` as a user calls it."""

import re

import pytest


def test_json_holds_optimum_and_landscape(anisoscope):
    done = anisoscope("optimise", "--vary", "ridge_angle=3:20,alpha_across=0.05:0.2", "--jobs", 1, "--json")
    assert done.code == 0, done.err
    best = done.json["optimum"]
    assert best["part"]["ridge_angle"] == pytest.approx(5.0, abs=0.1)
    assert best["part"]["alpha_across"] == pytest.approx(0.05)
    assert [one["name"] for one in best["parameters"]] == ["ridge_angle", "alpha_across"]
    assert best["parameters"][1]["at_bound"] == "lower"
    axes, scores = done.json["landscape"]["axes"], done.json["landscape"]["scores"]
    assert len(scores) == len(axes[0]) * len(axes[1])
    assert max(scores) <= best["score"]


def test_robust_beside_nominal_with_page_and_picture(anisoscope, tmp_path):
    page, picture = tmp_path / "o.html", tmp_path / "o.png"
    done = anisoscope(
        "optimise",
        "--robust",
        "--scatter",
        "ridge_angle=1",
        "--samples",
        8,
        "--html",
        page,
        "--plot",
        picture,
    )
    assert done.code == 0, done.err
    assert "robust" in done.out
    assert "nominal" in done.out
    assert "ridge angle [°]" in done.out
    answer = done.out.splitlines()[-1]
    assert re.match(
        r"Most contrast: ridge angle [\d.]+° \([\d.]+ to [\d.]+ keep 99 %\).* over the parts\.$", answer
    )
    assert picture.read_bytes().startswith(b"\x89PNG")
    text = page.read_text(encoding="utf-8")
    assert f'id="answer">{answer}<' in text
    assert text.count("data:image/svg+xml") >= 2  # score and section
    assert '="http' not in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--vary", "pitch=20:200"], "the pitch has no effect on ideal ridges"),
        (["--vary", "ridge_angle=3"], "--vary takes NAME=FROM:TO"),
        (["--vary", "ridge_angle=3:x"], "--vary takes numbers"),
        (["--vary", "ridge_angle"], "--vary takes NAME=FROM:TO,"),
        (["--scatter", "stage=1"], "belong to --robust"),
        (["--robust", "--scatter", "dust=1"], "--scatter does not know 'dust'"),
        (["--noise", "floor=a"], "--noise takes numbers"),
        (["--pair", "0"], "--pair takes two different stage angles"),
        (["--score", "snr"], "needs noise"),
        (["--plot", "x.gif"], "*.png or *.svg"),
        (["--jobs", "0"], "--jobs takes 1 or more"),
        (["--tilts=90"], "below the horizon"),
        (["--scheduler", "tcp://127.0.0.1:9"], "no Dask scheduler answers"),
    ],
)
def test_mistakes_are_told_in_one_line(anisoscope, arguments, message):
    done = anisoscope("optimise", *arguments)
    assert done.code not in (0, 1)
    assert message in done.err
    assert done.err.count("\n") == 1
    assert "Traceback" not in done.err
