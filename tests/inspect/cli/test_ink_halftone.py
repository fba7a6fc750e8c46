"""``anisoscope ink halftone``, ``compare`` and ``proof`` as a user calls them."""

import os
import re
import subprocess
import sys

import numpy as np
import PIL.Image
import pytest

from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.colour.observer import xyz_weights
from anisoscope.sim.light.colour.spaces import linear_srgb
from anisoscope.sim.light.ink.model import brdf_at_angles
from anisoscope.sim.materials.inks import SYNTHETIC, synthetic_ink
from anisoscope.sim.proof.separation import separation


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    path = tmp_path_factory.mktemp("image") / "print.png"
    y, x = np.mgrid[:96, :128] / 128.0
    PIL.Image.fromarray((255 * np.stack([x, y, 0.5 * np.ones_like(x)], axis=-1)).astype(np.uint8)).save(path)
    return path


def test_halftone_writes_dots_and_a_film_an_ink(anisoscope, image, tmp_path):
    done = anisoscope(
        "ink", "halftone", image, "--out", tmp_path / "dots.png", "--print-width", 10, "--dpi", 508, "--json"
    )
    assert done.code == 0, done.err
    told = done.json
    assert (told["cols"], told["rows"]) == (200, 150)
    names = ["dots.png", *(f"dots-synthetic-{colour}.png" for colour in ("red", "green", "blue"))]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)
    films = []
    for name in names[1:]:
        with PIL.Image.open(tmp_path / name) as film:
            assert film.size == (200, 150)
            assert film.info["dpi"] == pytest.approx((508, 508), abs=0.02)
            films.append(~np.array(film))
    assert np.sum(films, axis=0).max() == 1
    np.testing.assert_allclose([film.mean() for film in films], list(told["printed"].values()))
    np.testing.assert_allclose(list(told["aimed"].values()), list(told["printed"].values()), atol=0.004)


def test_halftone_says_what_was_lost(anisoscope, image, tmp_path):
    done = anisoscope("ink", "halftone", image, "--out", tmp_path / "d.png", "--method", "diffusion", "--negative",
                      "--separation", "channels")  # fmt: skip
    assert done.code == 0, done.err
    for words in (
        "128 × 96 dots",
        "10.8 × 8.1 mm at 300 dpi",
        "Out of gamut: none",
        "scaled down:",
        "coverage aimed at [%]",
    ):
        assert words in done.out
    with PIL.Image.open(tmp_path / "d-synthetic-red.png") as film:
        assert np.array(film).mean() < 0.5  # white where the ink goes


@pytest.mark.parametrize(("sheet", "told"), [(0.9, True), (0.01, False)])
def test_a_bright_sheet_is_said_to_leave_no_dark_colours(anisoscope, image, tmp_path, sheet, told):
    done = anisoscope("ink", "halftone", image, "--out", tmp_path / "d.png", "--substrate", sheet)
    assert done.code == 0, done.err
    assert ("the light of the sheet without ink at 20°" in done.out) == told
    if told:  # of every channel by itself, summed over wavelengths
        lamp = standard("D65")
        inks = [synthetic_ink(name) for name in SYNTHETIC]
        plan = separation(inks, lamp, substrate=sheet)
        spectra = np.stack([brdf_at_angles(ink, 20.0, 20.0) for ink in inks])
        weights = xyz_weights(lamp, inks[0].nm)
        white = linear_srgb(plan.neutral @ spectra @ weights)
        bare = linear_srgb(np.full(len(inks[0].nm), sheet / np.pi) @ weights)
        said = float(re.search(r"darker than ([\d.]+) % of white", done.out)[1])
        assert said == pytest.approx(100.0 * (bare / white).max(), rel=0.01)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--out", "x.tif"], "--out writes *.png"),
        (["--out", "IMAGE"], "is an input"),
        (["--out", "x.png", "--dpi", "0"], "--dpi takes"),
        (["--out", "x.png", "--print-width", "-3"], "--print-width takes"),
        (["--out", "x.png", "--inks", "synthetic-red"], "three inks"),
        (["--out", "x.png", "--inks", "synthetic-red,synthetic-red,synthetic-blue"], "too much alike"),
        (["--out", "x.png", "--angle", "88"], "0 to 85"),
        (["--out", "x.png", "--substrate", "1.5"], "--substrate takes"),
    ],
)
def test_mistakes_are_told_in_one_line(anisoscope, image, arguments, message):
    before = image.read_bytes()
    done = anisoscope("ink", "halftone", image, *(image if one == "IMAGE" else one for one in arguments))
    assert image.read_bytes() == before
    assert done.code not in (0, 1)
    assert message in done.err
    assert done.err.count("\n") == 1


def test_dots_and_films_are_replaced_only_on_demand(anisoscope, image, tmp_path):
    arguments = ("ink", "halftone", image, "--out", tmp_path / "d.png")
    film = tmp_path / "d-synthetic-green.png"
    film.write_text("mine")
    refused = anisoscope(*arguments)
    assert refused.code == 64
    assert f"{film} exists; give another name, or --overwrite" in refused.err
    assert [path.name for path in tmp_path.iterdir()] == [film.name]
    assert anisoscope(*arguments, "--overwrite").code == 0
    with PIL.Image.open(film) as picture:
        assert picture.size == (128, 96)


def test_a_film_does_not_replace_the_image(anisoscope, image, tmp_path):
    mine = tmp_path / "d-synthetic-red.png"
    mine.write_bytes(image.read_bytes())
    done = anisoscope("ink", "halftone", mine, "--out", tmp_path / "d.png", "--overwrite")
    assert done.code == 64
    assert "is an input" in done.err
    assert mine.read_bytes() == image.read_bytes()


def test_compilation_is_announced_once_and_not_when_kernels_are_on_disk(image, tmp_path):
    """A fresh cache: the first process compiles and says so in one line, the second says nothing."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    # of all commands with kernels the one with the smallest
    command = [sys.executable, "-m", "anisoscope", "ink", "halftone", image, "--out", tmp_path / "dots.png"]
    command += ["--overwrite", "--json"]
    first, second = (
        subprocess.run(command, capture_output=True, text=True, check=True, env=environment) for _ in range(2)
    )
    assert first.stderr.count("\n") == 1
    assert "compiling kernels" in first.stderr
    assert second.stderr == ""
    assert first.stdout == second.stdout
