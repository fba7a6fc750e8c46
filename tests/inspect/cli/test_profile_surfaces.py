"""``anisoscope profile make`` and ``profile spoil`` as a user calls them."""

import numpy as np
import pytest

from anisoscope.profiles.defect_injection import DEFECTS
from anisoscope.profiles.files.load import read_height_map


@pytest.fixture(scope="module")
def part(anisoscope, tmp_path_factory):
    path = tmp_path_factory.mktemp("surfaces") / "part.x3p"
    done = anisoscope(
        *("profile", "make", "ridges", "--pitch", 60, "--ridge-angle", 12, "--size", "200,420"),
        *("--alpha-along", 0.03, "--alpha-across", 0.04, "--seed", 5, "--out", path, "--json"),
    )
    assert done.code == 0, done.err
    assert done.json["made"]["ridge_angle_deg"] == 12.0
    return path


@pytest.mark.parametrize(
    ("pattern", "options", "levels"),
    [
        ("ridges", ("--lay", 30, "--wall", "vertical"), None),
        ("v-grooves", ("--pitch", 50, "--flank", 30, "--land", 10), None),
        ("checkerboard", ("--square", 60, "--wall", 5, "--edge-radius", 3), None),
        ("flat", (), 1),
        ("staircase", ("--levels", 3, "--step-height", 120, "--width", 20), 3),
        ("staircase", ("--passes", "107.3,157.5", "--random", "--width", 4, "--seed", 2), 4),
    ],
)
@pytest.mark.parametrize("suffix", [".x3p", ".npz", ".gsf"])
def test_patterns_come_back_with_their_origin(anisoscope, tmp_path, pattern, options, levels, suffix):
    out = tmp_path / f"made{suffix}"
    done = anisoscope(
        "profile", "make", pattern, "--size", "150,200", "--pixel", "1,0.5", *options, "--out", out
    )
    assert done.code == 0, done.err
    assert "made:" in done.out
    surface = read_height_map(out)
    assert surface.shape == (150, 400)
    assert (surface.pixel_y_um, surface.pixel_x_um) == pytest.approx((1.0, 0.5), rel=1e-15)
    assert surface.origin["made"]["seed"] == (2 if "--seed" in options else 0)
    if levels is not None:
        assert len(np.unique(surface.height_um)) == levels


def test_a_chain_of_defects_travels_with_the_file(anisoscope, part, tmp_path):
    worn, dusty = tmp_path / "worn.npz", tmp_path / "dusty.x3p"
    done = anisoscope("profile", "spoil", part, "wear", "--severity", 0.5, "--out", worn)
    assert done.code == 0, done.err
    assert "deepest removed" in done.out
    done = anisoscope(
        "profile", "spoil", worn, "dust", "--density-per-mm2", 300, "--seed", 7, "--out", dusty, "--json"
    )
    assert done.code == 0, done.err
    assert [(one["defect"], one["seed"]) for one in done.json["defects"]] == [("wear", 0), ("dust", 7)]
    assert done.json["made"]["pitch_um"] == 60.0
    assert done.json["deviation"]["lowest_um"] == 0.0
    assert done.json["deviation"]["highest_um"] > 1.0
    kept = read_height_map(dusty).origin
    assert kept["defects"] == done.json["defects"]
    again = anisoscope(
        *(
            "profile",
            "spoil",
            worn,
            "dust",
            "--density-per-mm2",
            300,
            "--seed",
            7,
            "--out",
            tmp_path / "again.x3p",
        )
    )
    assert "seed 7" in again.out
    assert np.array_equal(read_height_map(tmp_path / "again.x3p").height_um, read_height_map(dusty).height_um)


def test_formats_without_a_place_for_history_say_so(anisoscope, part, tmp_path):
    done = anisoscope("profile", "spoil", part, "chatter", "--severity", 0.2, "--out", tmp_path / "a.csv")
    assert done.code == 0, done.err
    assert "no place for this history" in done.out


def test_the_list_has_every_defect_with_units(anisoscope):
    done = anisoscope("profile", "spoil", "--list")
    assert done.code == 0, done.err
    for name in DEFECTS:
        assert name in done.out
    assert "--radius-um" in done.out
    listed = anisoscope("profile", "spoil", "--list", "--json").json
    assert set(listed) == set(DEFECTS)
    assert listed["wear"]["parameters"]["radius_um"]["unit"] == "µm"


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("make", "ridges", "--out", "a.docx"), "extension"),
        (("make", "ridges", "--ridge-angle", 50, "--out", "a.npz"), "45"),
        (("make", "ridges", "--size", "0", "--out", "a.npz"), "--size"),
        (("make", "ridges", "--size", "1e6", "--pixel", "0.1", "--out", "a.npz"), "million"),
        (("make", "ridges", "--size", "1", "--pixel", "1", "--out", "a.npz"), "2 × 2"),
        (("make", "ridges", "--seed=-1", "--out", "a.npz"), "--seed"),
        (
            (
                "make",
                "ridges",
                "--alpha-across",
                0.1,
                "--alpha-along",
                0.1,
                "--correlation",
                0.1,
                "--out",
                "a.npz",
            ),
            "correlation",
        ),
        (("make", "staircase", "--width", 0.2, "--out", "a.npz"), "pixel"),
        (("make", "staircase", "--passes", "a", "--out", "a.npz"), "--passes"),
        (("make", "sphere", "--out", "a.npz"), "sphere"),
        (("spoil",), "--list"),
        (("spoil", "PART", "rust", "--severity", 0.5, "--out", "a.npz"), "unknown defect"),
        (("spoil", "PART", "wear", "--out", "a.npz"), "severity"),
        (("spoil", "PART", "wear", "--severity", 2, "--out", "a.npz"), "between 0"),
        (("spoil", "PART", "wear", "--radius", 2, "--out", "a.npz"), "radius_um"),
        (("spoil", "PART", "wear", "--radius-um", "wide", "--out", "a.npz"), "wide"),
        (("spoil", "missing.x3p", "wear", "--severity", 0.5, "--out", "a.npz"), "missing.x3p"),
    ],
)
def test_bad_input_gives_one_line(anisoscope, part, tmp_path, arguments, word):
    arguments = [part if one == "PART" else one for one in arguments]
    done = anisoscope("profile", *arguments, cwd=tmp_path)
    assert done.code in (64, 65), done.err
    assert word in done.err
    assert done.err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_files_are_overwritten_on_purpose_only(anisoscope, tmp_path):
    command = ("profile", "make", "flat", "--size", 20, "--out", "a.npz")
    assert anisoscope(*command, cwd=tmp_path).code == 0
    done = anisoscope(*command, cwd=tmp_path)
    assert done.code == 64
    assert "--overwrite" in done.err
    assert anisoscope(*command, "--overwrite", cwd=tmp_path).code == 0
