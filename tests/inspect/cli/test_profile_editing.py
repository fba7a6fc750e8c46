"""``anisoscope profile edit`` and the commands of single steps, as a user calls them."""

from pathlib import Path

import numpy as np
import pytest

from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.editing.operations import OPERATIONS
from anisoscope.profiles.editing.steps import edit_map
from anisoscope.profiles.files.load import read_height_map, write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import ridges

PAGE = Path(__file__).resolve().parents[3] / "docs" / "height-maps.md"

SINGLE = {
    "level": ("plane",),
    "form": ("poly2",),
    "filter": ("robust", "--cutoff", 12, "--order", 0, "--keep", "short"),
    "crop": (5, "--y1", 20),
    "rotate": (30, "--extent", "full"),
    "mask": ("--polygon", "0 0; 30 0; 30 30; 0 30", "--keep", "outside"),
    "fill": ("nearest", "--border"),
    "outliers": (4, "--window", 7),
    "align-lines": (),
    "scars": (3.0, "--length", 4),
    "resample": (3.5, "--interpolation", "cubic"),
    "subtract": (),
    "stitch": ("--x", 4, "--no-align"),
}


@pytest.fixture
def part(tmp_path):
    rng = np.random.default_rng(0)
    z = rng.standard_normal((30, 40)).cumsum(axis=1)
    z[rng.random(z.shape) < 0.1] = np.nan
    write_height_map(HeightMap(z, 2.0, 1.5), tmp_path / "part.x3p")
    return tmp_path / "part.x3p"


@pytest.mark.parametrize("name", list(OPERATIONS))
def test_single_commands_do_what_their_step_does(anisoscope, part, tmp_path, name):
    values = (part, *SINGLE[name]) if name in ("subtract", "stitch") else SINGLE[name]
    out = tmp_path / "out.npz"
    done = anisoscope("profile", name, part, *values, "--out", out, "--json")
    assert done.code == 0, done.err
    last = done.json["history"][-1]
    assert last["step"] == name
    again = edit_map(read_height_map(part), [{"step": name, **last["values"]}])
    written = read_height_map(out)
    np.testing.assert_array_equal(written.height_um, again.height_um)
    assert written.origin["history"] == done.json["history"] == again.origin["history"]
    assert [done.json["rows"], done.json["cols"]] == list(again.shape)


def test_chain_in_one_command_and_its_text(anisoscope, part, tmp_path):
    out = tmp_path / "out.tif"
    done = anisoscope("profile", "edit", part, "level", "fill=border:yes", "--out", out)
    assert done.code == 0, done.err
    for word in (
        "read: file part.x3p",
        "level: method",
        "fill: method harmonic",
        "no place for this history",
    ):
        assert word in done.out
    assert read_height_map(out).missing_share == 0.0


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("edit", "{part}", "--out", "{new}"), 64, "at least one step"),
        (("edit", "{part}", "form.poly2", "--out", "{new}"), 64, "no step 'form.poly2'"),
        (("edit", "{part}", "level", "--out", "{part}", "--overwrite"), 64, "never edited in place"),
        (("subtract", "{other}", "{part}", "--out", "{part}", "--overwrite"), 64, "never edited in place"),
        (("edit", "{part}", "level", "--out", "{other}"), 64, "exists"),
        (("edit", "{part}", "level", "--out", "new.stl"), 64, "unknown extension"),
        (("crop", "{part}", "500", "--out", "{new}"), 65, "less than two points"),
        (("filter", "{part}", "gaussian", "--cutoff", "500", "--out", "{new}"), 65, "beyond the field"),
    ],
)
def test_one_line_says_what_is_wrong(anisoscope, part, tmp_path, arguments, code, message):
    other = tmp_path / "other.x3p"
    other.write_bytes(part.read_bytes())
    before = part.read_bytes()
    names = {"part": part, "other": other, "new": tmp_path / "new.x3p"}
    done = anisoscope("profile", *(word.format(**names) for word in arguments))
    assert done.code == code
    assert message in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert part.read_bytes() == before == other.read_bytes()
    assert not (tmp_path / "new.x3p").exists()


def test_examples_of_the_page_run(anisoscope, tmp_path):
    write_height_map(ridges(RidgeDesign(100.0, 10.0), (310, 510), 1.0), tmp_path / "part.x3p")
    text = PAGE.read_text(encoding="utf-8").partition("## Editing")[2]
    block = text.partition("```sh\n")[2].partition("```")[0]
    lines = [line.partition("#")[0].split() for line in block.splitlines()]
    assert len(lines) == 3
    for line in lines:
        words = [str(tmp_path / word) if word.endswith(".x3p") else word for word in line[1:]]
        done = anisoscope(*words)
        assert done.code == 0, done.err
    history = done.json["origin"]["history"]
    assert [one["step"] for one in history] == ["read", "outliers", "form", "crop", "filter"]
