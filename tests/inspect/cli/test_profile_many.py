"""Several maps in one command, limits, and profile parameters, as a user calls them."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.cli.profile.many import OutOptions
from anisoscope.cli.profile.profile import view
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import read_height_map, write_height_map
from anisoscope.profiles.ideal import ridges
from anisoscope.profiles.limits import Limit, LimitsError, judge, read_limits
from anisoscope.report import profile_page
from anisoscope.report.surface_view import Picture3D, viewer_of


@pytest.fixture(scope="module")
def lot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lot")
    for number, angle in enumerate((8.0, 10.0, 12.0)):
        write_height_map(ridges(RidgeDesign(50.0, angle), (40, 300), 1.0), folder / f"part{number}.x3p")
    (folder / "part3.x3p").write_bytes(b"not a height map")
    (folder / "limits.toml").write_text("[Sa]\nmax = 2.5\n[Sq]\nmin = 0.1\n")
    return folder


def test_a_broken_file_is_a_row(anisoscope, lot, tmp_path):
    table = tmp_path / "lot.csv"
    done = anisoscope("profile", "info", f"{lot}/part*.x3p", "--table", table, "--jobs", 3)
    assert done.code == 65
    assert "part3.x3p: not measured" in done.out
    with table.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["file"].rpartition("/")[2] for row in rows] == [f"part{k}.x3p" for k in range(4)]
    assert [bool(row["error"]) for row in rows] == [False, False, False, True]
    heights = [float(row["Sz [µm]"]) for row in rows[:3]]
    assert heights == sorted(heights)


def test_limits_judge_every_map(anisoscope, lot, tmp_path):
    table = tmp_path / "lot.html"
    files = [lot / f"part{k}.x3p" for k in range(3)]
    done = anisoscope(
        "profile", "texture", *files, "--limits", lot / "limits.toml", "--table", table, "--json"
    )
    assert done.code == 1
    assert [one["verdict"] for one in done.json] == ["PASS", "PASS", "FAIL"]
    assert done.json[2]["sheet"][0]["name"] == "Sa"
    text = table.read_text(encoding="utf-8")
    assert "part2.x3p: FAIL" in text
    good = anisoscope("profile", "texture", files[0], "--limits", lot / "limits.toml")
    assert good.code == 0
    assert "limits: PASS" in good.out
    for command, limit, code in (
        ("lines", "[Ra]\nmax = 0.1\n", 1),
        ("ridges", "[ridge_angle_deg]\nmin = 7\n", 0),
    ):
        (tmp_path / "limits.toml").write_text(limit)
        done = anisoscope("profile", command, files[0], "--limits", tmp_path / "limits.toml", "--json")
        assert (done.code, len(done.json["sheet"])) == (code, 1)


def test_ridges_and_lines_of_several_maps(anisoscope, lot, tmp_path):
    for command, name in (("ridges", "ridge_angle_deg"), ("lines", "Ra")):
        table = tmp_path / f"{command}.json"
        done = anisoscope("profile", command, lot / "part0.x3p", lot / "part1.x3p", "--table", table)
        assert done.code == 0, done.err
        values = [row[name]["value"] for row in json.loads(table.read_text(encoding="utf-8"))]
        assert values[1] / values[0] == pytest.approx(10.0 / 8.0, rel=0.03)


def test_one_map_on_lines_and_with_features(anisoscope, lot):
    done = anisoscope("profile", "lines", lot / "part1.x3p", "--direction", "x")
    assert done.code == 0, done.err
    for word in ("Rsm", "Rdq", "between lines", "λc none"):
        assert word in done.out
    done = anisoscope(
        *("profile", "texture", lot / "part1.x3p", "--features", "--ratios", "5,60", "--heights=-0.5"),
        "--json",
    )
    assert done.json["features"]["peaks"] >= 5
    assert set(done.json["free"]) >= {"Smc(5 %)", "Vm(60 %)", "Vv(5 %)", "Sxp(5 %, 60 %)", "Smr(-0.5 µm)"}


def test_every_map_becomes_a_file_and_a_broken_one_a_row(anisoscope, lot, tmp_path):
    """convert, edit and a single step: the folder holds what the same command writes one by one."""
    alone = tmp_path / "alone.gsf"
    assert anisoscope("profile", "convert", lot / "part1.x3p", alone).code == 0
    for words, folder in (
        (("convert", f"{lot}/part*.x3p", "--format", "gsf"), "converted"),
        (("edit", f"{lot}/part*.x3p", "level=plane", "crop=x1:100", "--format", ".npz"), "edited"),
        (("edit", lot / "part0.x3p", lot / "part1.x3p", lot / "part3.x3p", "level"), "listed"),
        (("crop", f"{lot}/part*.x3p", "--x1", 100), "single"),
    ):
        table = tmp_path / f"{folder}.csv"
        out = tmp_path / "new" / folder
        done = anisoscope("profile", *words, "--out-dir", out, "--table", table)
        assert done.code == 65, done.err
        assert "part3.x3p: not measured" in done.out
        with table.open(encoding="utf-8", newline="") as stream:
            rows = list(csv.DictReader(stream))
        written = [Path(row["written"]) for row in rows if not row["error"]]
        assert sorted(written) == sorted(out.iterdir())
        assert {float(row["columns"]) for row in rows[:2]} == {101.0 if "100" in str(words) else 300.0}
    same = [read_height_map(path).height_um for path in (alone, tmp_path / "new" / "converted" / "part1.gsf")]
    np.testing.assert_array_equal(*same)
    history = read_height_map(tmp_path / "new" / "edited" / "part0.npz").origin["history"]
    assert [one["step"] for one in history] == ["read", "level", "crop"]
    again = anisoscope(
        "profile", "convert", lot / "part0.x3p", "--format", "gsf", "--out-dir", out.parent / "converted"
    )
    assert again.code == 64
    assert "--overwrite" in again.err


def test_a_pattern_may_begin_with_a_bracket(anisoscope, lot, monkeypatch):
    monkeypatch.chdir(lot)
    done = anisoscope("profile", "info", "[p]art[01].x3p", "--json")
    assert done.code == 0, done.err
    assert [row["file"] for row in done.json] == ["part0.x3p", "part1.x3p"]


def test_a_page_for_every_map(anisoscope, lot, tmp_path):
    table = tmp_path / "lot.html"
    files = [lot / "part0.x3p", lot / "part3.x3p"]
    done = anisoscope(
        "profile", "report", *files, "--out-dir", tmp_path / "pages", "--table", table, "--json"
    )
    assert done.code == 65, done.err
    assert [set(row) & {"error", "written"} for row in done.json] == [{"written"}, {"error"}]
    assert "Ridge angle" in (tmp_path / "pages" / "part0.html").read_text(encoding="utf-8")
    assert 'href="pages/part0.html"' in table.read_text(encoding="utf-8")


class Drawn:
    """A renderer without a process; ``PICTURE`` is what it found."""

    PICTURE = Picture3D(b"png", "heights drawn 7 times as large", b"scene")

    COLOURS = None

    def __init__(self, height_um, _pixel_um, *, interactive, scene, colours):
        assert interactive
        Drawn.COLOURS = colours
        self.shape, self.scene = height_um.shape, scene

    def result(self):
        return self.PICTURE

    def discard(self):
        pass


@pytest.fixture
def renderer(monkeypatch):
    monkeypatch.setattr(profile_page, "Renderer", Drawn)
    return Drawn


def test_a_page_to_turn_is_written_with_the_map_or_in_a_folder(lot, tmp_path, renderer, capsys):
    source = tmp_path / "part.x3p"
    source.write_bytes((lot / "part0.x3p").read_bytes())
    assert view(source, exaggerate=7.0) == 0
    page = (tmp_path / "part-view.html").read_text(encoding="utf-8")
    assert renderer.PICTURE.note in page
    assert ('id="viewer"' in page) == (viewer_of(b"scene") is not None)
    with pytest.raises(UsageError, match="--overwrite"):
        view(source)
    assert view(source, several=OutOptions(overwrite=True)) == 0
    capsys.readouterr()
    pages = OutOptions(out_dir=tmp_path / "pages")
    assert view(source, lot / "part3.x3p", several=pages, json_=True) == 65
    good, bad = json.loads(capsys.readouterr().out)
    assert good["written"] == str(tmp_path / "pages" / "part-view.html")
    assert good["3-D"]["value"] == 1.0
    assert "error" in bad


def test_a_layer_colours_the_view(lot, tmp_path, renderer):
    surface = read_height_map(lot / "part0.x3p")
    seen = np.broadcast_to(np.arange(surface.shape[1], dtype=np.float32), surface.shape)
    write_height_map(replace(surface, layers={"intensity": seen}), tmp_path / "seen.npz")
    assert view(tmp_path / "seen.npz", layer="intensity") == 0
    assert renderer.COLOURS.shape == (*surface.shape, 3)
    assert list(renderer.COLOURS[0, [0, -1], 0]) == [0, 255]
    page = (tmp_path / "seen-view.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") >= 2
    assert 'id="layer"' in page
    with pytest.raises(HeightMapError, match="no colour; there is intensity"):
        view(tmp_path / "seen.npz", layer="colour", out=tmp_path / "b.html")


def test_without_a_renderer_the_page_has_the_picture_from_above(lot, tmp_path, renderer, monkeypatch, capsys):
    monkeypatch.setattr(renderer, "PICTURE", Picture3D(None, "it needs EGL"))
    assert view(lot / "part0.x3p", out=tmp_path / "a.html") == 0
    assert "no 3-D view: it needs EGL" in capsys.readouterr().err
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "No 3-D view: it needs EGL" in page
    assert 'id="map"' in page
    assert "<iframe" not in page


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("info",), 64, "at least one height map"),
        (("info", "{lot}/none*.x3p"), 64, "matches no file"),
        (("info", "{lot}/part0.x3p", "--table", "t.pdf"), 64, "a table is"),
        (("info", "{lot}/part0.x3p", "--table", "{lot}/limits.toml"), 64, "a table is"),
        (("info", "{lot}/part0.x3p", "{lot}/part1.x3p", "--jobs", "0"), 64, "--jobs"),
        (("texture", "{lot}/part0.x3p", "--ratios", "120"), 64, "0 to 100 %"),
        (("texture", "{lot}/part0.x3p", "{lot}/part1.x3p", "--plot", "p.png"), 64, "one map"),
        (("texture", "{lot}/part0.x3p", "--limits", "{lot}/none.toml"), 78, "there is no such file"),
        (("lines", "{lot}/part0.x3p", "--limits", "{lot}/limits.toml"), 65, "Sa was not measured"),
        (("convert", "{lot}/part0.x3p"), 64, "SOURCE and TARGET"),
        (("convert", "{lot}/part0.x3p", "--out-dir", "{lot}"), 64, "a file that is read"),
        (("convert", "{lot}/part0.x3p", "--out-dir", "{lot}/new", "--format", "doc"), 64, "written are x3p"),
        (("convert", "{lot}/part0.x3p", "b.gsf", "--table", "t.csv"), 64, "--out-dir"),
        (("report", "{lot}/part0.x3p"), 64, "--out PAGE.html"),
        (("view", "{lot}/part0.x3p", "--out", "a.png"), 64, "named *.html"),
        (("view", "{lot}/part0.x3p", "--exaggerate", "0"), 64, "positive factor"),
        (("view", "{lot}/part0.x3p", "{lot}/part1.x3p", "--out", "a.html"), 64, "one map"),
        (("report", "{lot}/part0.x3p", "--out", "a.html", "--out-dir", "{lot}/new"), 64, "one of them"),
        (
            ("edit", "{lot}/part0.x3p", "{lot}/part1.x3p", "level", "--out", "a.x3p"),
            64,
            "several take --out-dir",
        ),
        (("edit", "{lot}/part0.x3p", "level", "--out", "a.x3p", "--out-dir", "{lot}/new"), 64, "one of them"),
        (
            ("edit", "{lot}/part0.x3p", "subtract={lot}/new/z.x3p", "--out-dir", "{lot}/new"),
            64,
            "a step reads",
        ),
        (
            ("edit", "{lot}/part0.x3p", "{lot}/../{name}/part0.x3p", "level", "--out-dir", "o"),
            64,
            "both become",
        ),
        (("compare", "{lot}/part0.x3p", "{lot}/part*.x3p", "--out", "a.html"), 64, "one second map"),
    ],
)
def test_one_line_says_what_is_wrong(anisoscope, lot, arguments, code, message):
    done = anisoscope("profile", *(word.format(lot=lot, name=lot.name) for word in arguments))
    assert done.code == code
    assert message in done.err
    assert len(done.err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no limits"),
        ("Sa = 3", "takes min, max"),
        ("[Sa]", "takes min, max"),
        ("[Sa]\nmaximum = 1", "takes min, max"),
        ("[Sa]\nmax = 'x'", "finite numbers"),
        ("[Sa]\nmax = inf", "finite numbers"),
        ("[Sa]\nmax = true", "finite numbers"),
        ("[Sa]\nmin = 2\nmax = 1", "above max"),
        ("[Sa", "not valid TOML"),
    ],
)
def test_limits_that_cannot_be(tmp_path, text, message):
    (tmp_path / "limits.toml").write_text(text)
    with pytest.raises(LimitsError, match=message):
        read_limits(tmp_path / "limits.toml")


def test_ends_are_within_and_no_value_is_not():
    limits = {"A": Limit(1.0, 2.0), "B": Limit(None, 3.0)}
    cases = [((1.0, 3.0), "PASS PASS"), ((2.0, np.nan), "PASS FAIL"), ((0.999, 3.001), "FAIL FAIL")]
    for (a, b), expected in cases:
        sheet = judge(limits, {"A": (a, "µm"), "B": (b, "µm"), "C": (1.0, "")})
        assert " ".join(one.verdict for one in sheet) == expected
    with pytest.raises(HeightMapError, match="D was not measured"):
        judge({"D": Limit(0.0, None)}, {"A": (1.0, "µm")})
