"""``anisoscope ink proof`` as a user calls it."""

import base64
import io
import json
import re
from dataclasses import replace

import numpy as np
import PIL.Image
import pytest

from anisoscope.sim.materials.inks import ink_text, synthetic_ink


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("proof")
    y, x = np.mgrid[:60, :90] / 90.0
    PIL.Image.fromarray((255 * np.stack([x, y, 1 - x], axis=-1)).astype(np.uint8)).save(path / "print.png")
    PIL.Image.new("RGB", (60, 40), (90, 80, 70)).save(path / "photo.jpg")
    (path / "roof.obj").write_text(
        "v -1 0 0\nv 0 0 1\nv 0 1 1\nv -1 1 0\nv 1 0 0\nv 1 1 0\nf 1 2 3 4\nf 2 5 6 3\n"
    )
    return path


def test_page_and_picture(anisoscope, folder, tmp_path):
    done = anisoscope("ink", "proof", folder / "print.png", "--out", tmp_path / "p.html", "--png", tmp_path / "p.png",
                      "--mesh", folder / "roof.obj", "--photo", folder / "photo.jpg", "--dots", 120,
                      "--picture-size", 64, "--process", "binder-mixed", "--match", "--json")  # fmt: skip
    assert done.code == 0, done.err
    assert done.json["dots"] == [80, 120]
    text = (tmp_path / "p.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="data">(.*?)</script>', text, re.DOTALL).group(1))
    assert (data["start"]["shape"], data["start"]["roughness"], data["start"]["match"]) == (
        "mesh",
        "binder-mixed",
        True,
    )
    assert [one["name"] for one in data["illuminants"]][:2] == ["D65", "A"]
    assert data["exposure"] == pytest.approx(done.json["exposure"])
    dots = np.array(PIL.Image.open(io.BytesIO(base64.b64decode(data["halftone"][0].split(",")[1]))))
    assert (dots > 0).sum(axis=-1).max() == 1
    np.testing.assert_allclose((dots / 255.0).mean(axis=(0, 1)), done.json["printed"])
    assert "The print is projected" in text or "projected along z" in text
    assert "data:image/jpeg" in text
    with PIL.Image.open(tmp_path / "p.png") as picture:
        assert picture.size == (64, 64)
        assert np.array(picture).max() > 150


FOUR = "synthetic-red,synthetic-green,synthetic-blue,synthetic-white"


def test_four_inks_as_a_press_prints_them(anisoscope, folder, tmp_path):
    """Overlaps are primaries of their own: modelled ones, or the ink of a file."""
    measured = tmp_path / "over.toml"
    measured.write_text(synthetic_text("synthetic-white", "measured overprint"), encoding="utf-8")
    arguments = (
        "ink",
        "proof",
        folder / "print.png",
        "--out",
        tmp_path / "p.html",
        "--inks",
        FOUR,
        "--dots",
        90,
    )
    press = (
        "--screen-shifts",
        "0,0;40,0;0,0;0,-20",
        "--dot-gain",
        10,
        "--overprint",
        f"1+2={measured}",
        "--json",
    )
    done = anisoscope(*arguments, *press)
    assert done.code == 0, done.err
    shares = done.json["primaries"]
    assert len(shares) > 6
    assert "measured overprint" in shares
    assert any(name.startswith("synthetic blue over synthetic green") for name in shares)
    text = (tmp_path / "p.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="data">(.*?)</script>', text, re.DOTALL).group(1))
    assert [one["name"] for one in data["inks"]] == list(shares)
    layers = [
        np.array(PIL.Image.open(io.BytesIO(base64.b64decode(one.split(",")[1])))) for one in data["halftone"]
    ]
    found = (np.concatenate(layers, axis=-1)[..., : len(shares)] / 255.0).mean(axis=(0, 1))
    np.testing.assert_allclose(found, list(shares.values()), atol=0.003)
    assert sum(shares.values()) > sum(done.json["printed"]) - 0.05
    told = anisoscope(*arguments, *press[:-1], "--overwrite")
    assert "What the press makes of the dots" in told.out


def synthetic_text(name, called):
    return ink_text(replace(synthetic_ink(name), name=called))


def test_pictures_follow_their_options(anisoscope, folder, tmp_path):
    shown = {}
    for name, options in {
        "plain": [], "turned": ["--yaw", 40], "schlick": ["--ink-model", "schlick"], "one-light": ["--no-second"],
        "a": ["--illuminant", "a"], "sphere": ["--shape", "sphere"],
    }.items():  # fmt: skip
        path = tmp_path / f"{name}.png"
        done = anisoscope("ink", "proof", folder / "print.png", "--png", path, "--picture-size", 32, *options)
        assert done.code == 0, done.err
        assert "written" in done.out
        shown[name] = np.array(PIL.Image.open(path)).astype(int)
    for name in set(shown) - {"plain"}:
        assert np.abs(shown[name] - shown["plain"]).max() > 10, name


def test_mistakes_are_told_in_one_line(anisoscope, folder):
    for arguments, message in (
        ([], "needs something to write"),
        (["--out", "p.txt"], "--out writes *.html"),
        (["--png", "p.png", "--shape", "mesh"], "needs --mesh"),
        (["--png", "p.png", "--dots", "-1"], "--dots takes"),
        (["--png", folder / "print.png"], "is an input"),
        (["--png", "p.png", "--photo", folder / "photo.jpg"], "needs --out"),
        (["--png", "p.png", "--pitch-angle", "nan"], "--pitch-angle takes a number of °"),
        (
            ["--png", "p.png", "--elevation", "91"],
            "--elevation: pitch and elevation take degrees from -90 to 90",
        ),
        (["--png", "p.png", "--azimuth", "inf"], "--azimuth"),
        (["--png", "p.png", "--yaw", "1e7"], "--yaw: yaw and azimuth take degrees"),
        (["--out", "p.html", "--dots", "16384", "--picture-size", "9000"], "--picture-size 16 to"),
        (["--png", "p.png", "--mesh", folder / "none.obj"], "cannot be read"),
        (["--png", "p.png", "--illuminant", "moon"], "no illuminant is named"),
        (["--png", "p.png", "--inks", "synthetic-red"], "three inks or four"),
        (["--png", "p.png", "--screen-shifts", "1,2"], "of each of the 3 inks"),
        (["--png", "p.png", "--dot-gain", "9999"], "reach up to 32 dots"),
        (["--png", "p.png", "--overprint", "1+2=x.toml"], "no such file"),
        (["--png", "p.png", "--dot-gain", "5", "--overprint", "2+1=x.toml"], "numbers of inks from below"),
    ):
        done = anisoscope("ink", "proof", folder / "print.png", *arguments)
        assert done.code not in (0, 1)
        assert message in done.err
        assert done.err.count("\n") == 1


def test_files_are_replaced_only_on_demand(anisoscope, folder, tmp_path):
    arguments = ("ink", "proof", folder / "print.png", "--picture-size", 16, "--dots", 60)
    for option, name in (("--out", "p.html"), ("--png", "p.png")):
        kept = tmp_path / name
        kept.write_text("mine")
        refused = anisoscope(*arguments, option, kept)
        assert refused.code == 64
        assert f"{kept} exists; give another name, or --overwrite" in refused.err
        assert kept.read_text() == "mine"
        assert anisoscope(*arguments, option, kept, "--overwrite").code == 0
        assert kept.read_bytes() != b"mine"
