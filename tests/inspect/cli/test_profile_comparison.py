"""``anisoscope profile compare`` as a user calls it."""

import csv
import re

import numpy as np
import pytest
from PIL import Image

from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import read_height_map, write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges


@pytest.fixture(scope="module")
def maps(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compare")
    rng = np.random.default_rng(0)
    first = add_facet_roughness(ridges(RidgeDesign(40.0, 10.0), (90, 200), 1.0), 0.05, 0.05, 8.0, rng)
    worn = first.height_um.copy()
    worn[30:60, 80:110] -= 0.5
    write_height_map(first, folder / "new.x3p")
    write_height_map(HeightMap(worn[4:, 3:], 1.0, 1.0), folder / "worn.x3p")
    write_height_map(HeightMap(-first.height_um[:, ::-1], 1.0, 1.0), folder / "tool.x3p")
    return folder


def test_difference_page_and_numbers(anisoscope, maps, tmp_path):
    page, difference = tmp_path / "wear.html", tmp_path / "difference.x3p"
    done = anisoscope(
        *("profile", "compare", maps / "new.x3p", maps / "worn.x3p", "--out", page),
        *("--difference", difference, "--line", "10,10,150,60", "--json"),
        *("--plot", tmp_path / "wear.png"),
    )
    assert done.code == 0, done.err
    assert done.json["lost"]["volume_um3"]["value"] == pytest.approx(450.0, rel=0.02)
    assert done.json["placed"]["scale_agrees"]
    assert len(done.json["ridges"]) >= 4
    text = page.read_text(encoding="utf-8")
    for mark in ('id="difference"', 'id="uncertainty"', 'id="line"', 'id="ridges"', "volume lost"):
        assert mark in text
    assert "outlined" in text
    answer = re.search(r"B against A: ridges as high \(± [\d.]+ %\); ([\d.]+) ± ([\d.]+) µm³ lost", text)
    assert float(answer[1]) == pytest.approx(450.0, abs=float(answer[2]))
    with Image.open(tmp_path / "wear.png") as picture:
        red = np.asarray(picture.convert("RGB")).astype(int)
    assert np.count_nonzero(np.abs(red - (0xC6, 0x2F, 0x30)).max(axis=2) < 40) > 50  # outline of the pit
    taken = read_height_map(difference)
    assert np.nanmedian(taken.height_um[35:55, 85:105]) == pytest.approx(-0.5, abs=0.01)


def test_tool_and_part_as_a_table(anisoscope, maps):
    """The second one of a pair of tool and part, with what its ridges do to the contrasts of a recipe."""
    recipe = maps / "recipe.toml"
    made = anisoscope("recipe", "new", "--ridge-angle", 10, "--pitch", 40, "--out", recipe)
    assert made.code == 0, made.err
    text = recipe.read_text(encoding="utf-8")
    assert text.count("[surface]\n") == 1
    recipe.write_text(text.replace("[surface]\n", '[surface]\nreflections = "direct"\n'), encoding="utf-8")
    page = maps / "replication.html"
    arguments = ("profile", "compare", maps / "tool.x3p", maps / "new.x3p", "--mirrored", "--recipe", recipe)
    done = anisoscope(*arguments, "--out", page)
    assert done.code == 0, done.err
    for words in (
        "relief of A that B has",
        "volume lost",
        "the tool, was negated",
        "by edge radius",
    ):
        assert words in done.out
    text = page.read_text(encoding="utf-8")
    for mark in ('id="relief"', 'id="contrasts"', "ridge angle, change", "by the rest"):
        assert mark in text
    found = anisoscope(*arguments, "--json").json
    assert found["replication"]["relief"]["value"] == pytest.approx(1.0, abs=0.01)
    assert {"angle_b_deg", "radius_b_um", "relief"} <= set(found["ridges"][0])
    for one in found["contrasts"]:
        assert one["second"] == pytest.approx(one["first"], abs=0.01)
        assert set(one["causes"]) == {"ridge angle", "height loss", "edge radius"}


def test_several_maps_against_one(anisoscope, maps, tmp_path):
    (tmp_path / "broken.x3p").write_bytes(b"nothing")
    table, pages = tmp_path / "wear.csv", tmp_path / "pages"
    done = anisoscope(
        *(
            "profile",
            "compare",
            maps / "new.x3p",
            maps / "worn.x3p",
            maps / "new.x3p",
            tmp_path / "broken.x3p",
        ),
        *("--out-dir", pages, "--table", table, "--jobs", "2"),
    )
    assert done.code == 65, done.err
    with table.open(encoding="utf-8", newline="") as stream:
        worn, same, broken = csv.DictReader(stream)
    assert float(worn["volume lost [µm³]"]) == pytest.approx(450.0, rel=0.02)
    assert float(same["volume lost [µm³]"]) == pytest.approx(0.0, abs=1.0)
    assert broken["error"]
    assert sorted(page.name for page in pages.iterdir()) == ["new.html", "worn.html"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--out", "wear.pdf"), "*.html"),
        (("--line", "1,2,3"), "X0,Y0,X1,Y1"),
        (("--plot", "wear.pdf"), "*.png or *.svg"),
        (("--difference", "d.stl"), "unknown extension"),
        (("--out", "{here}/new.html"), "exists"),
    ],
)
def test_one_line_says_what_is_wrong(anisoscope, maps, options, message):
    (maps / "new.html").touch()
    words = [word.format(here=maps) for word in options]
    done = anisoscope("profile", "compare", maps / "new.x3p", maps / "worn.x3p", *words)
    assert done.code == 64
    assert message in done.err


def test_one_map_alone_asks_for_the_second(anisoscope, maps):
    done = anisoscope("profile", "compare", maps / "new.x3p", "--mirrored")
    assert done.code == 64
    assert f"compare {maps / 'new.x3p'} with which map? name the second one after it" in done.err
