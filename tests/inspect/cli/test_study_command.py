"""``anisoscope research`` as a user calls it."""

import re

import pytest


def test_convergence_with_page_and_picture(anisoscope, tmp_path):
    page, picture = tmp_path / "c.html", tmp_path / "c.svg"
    done = anisoscope(
        "research", "convergence", "--defects", "height-loss,edge-rounding", "--quality", "quick", "--severities", 3,
        "--html", page, "--plot", picture, "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    for found in done.json["defects"]:
        assert found["orders"]["total"]["slope"] == pytest.approx(1.0, abs=0.1)
        assert found["severity"] == sorted(found["severity"])
    assert "Order of convergence" in page.read_text(encoding="utf-8")
    assert "<svg" in picture.read_text(encoding="utf-8")


def test_best_angle_says_where_ten_degrees_overtakes_five(anisoscope):
    done = anisoscope("research", "best-angle", "--imperfections", "roughness,height-loss", "--step", 1)
    assert done.code == 0, done.err
    overtakes = re.search(r"10° overtakes 5° at ([0-9.]+)", done.out)
    assert float(overtakes[1]) == pytest.approx(0.095, abs=0.006)
    assert "5° exceeds 10° throughout" in done.out
    assert "10° [1/sr]" in done.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["convergence", "--defects", "dust"], "'dust' is no defect"),
        (["convergence", "--severities", "2"], "--severities takes 3 to 10"),
        (["convergence", "--ridge-angle", "0"], "flat"),
        (["best-angle", "--imperfections", "dust"], "'dust' is no imperfection"),
        (["best-angle", "--step", "5"], "--step takes 0.1 to 1"),
        (["best-angle", "--plot", "x.jpg"], "*.png or *.svg"),
    ],
)
def test_mistakes_are_told_in_one_line(anisoscope, arguments, message):
    done = anisoscope("research", *arguments)
    assert done.code not in (0, 1)
    assert message in done.err
    assert done.err.count("\n") == 1
