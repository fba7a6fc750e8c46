"""``anisoscope design picture`` and ``design hologram`` as a user calls them."""

import cv2
import numpy as np
import pytest

from anisoscope.operations.design.pictures import read_wanted
from anisoscope.sim.design.depths import Depths
from anisoscope.sim.design.designfile import read_design, read_layout
from anisoscope.sim.design.gradient import PictureTask, design_picture
from anisoscope.sim.light.colour.illuminant import Illuminant
from anisoscope.sim.proof.separation import decode_srgb


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    here = tmp_path_factory.mktemp("pictures")
    y, x = np.mgrid[-1:1:61j, -1:1:61j]
    lobe = 255.0 * np.exp(-0.5 * (x**2 + y**2) / 0.04)
    spot = 255.0 * np.exp(-12.0 * ((x - 0.4) ** 2 + (y - 0.4) ** 2))
    for name, values in (("lobe", lobe), ("spot", spot), ("black", 0.0 * x)):
        cv2.imwrite(str(here / f"{name}.png"), np.rint(values).astype(np.uint8))
    return here


COARSE = ("--max-width", "6", "--grid", "2")


def test_a_lobe_in_reach_becomes_a_design(anisoscope, folder):
    done = anisoscope(
        "design",
        "picture",
        "lobe.png",
        *COARSE,
        "--out",
        "lobe.toml",
        "--png",
        "found.png",
        "--json",
        cwd=folder,
    )
    assert done.code == 0, done.err
    assert done.json["unreachable"] < 0.1
    assert sum(part["share"] for part in done.json["parts"]) == pytest.approx(1.0)
    assert read_design(folder / "lobe.toml").figures["rel_l2"] == pytest.approx(done.json["rel_l2"])
    assert cv2.imread(str(folder / "found.png")) is not None


@pytest.fixture(scope="module")
def hologram(anisoscope, folder):
    """What the command says that designs the unit of a spot."""
    done = anisoscope(
        "design", "hologram", "spot.png", "--cells", 64, "--coherence", 12, "--picture-points", 16,
        "--search-steps", 40, "--out", "unit.npz", "--png", "unit.png", "--json", cwd=folder,
    )  # fmt: skip
    assert done.code == 0, done.err
    return done.json


def test_a_spot_comes_out_as_a_hologram(hologram, folder):
    assert hologram["achieved"]["ssim"] > 0.7
    assert hologram["achieved"]["median_de2000"] is None
    layout, _ = read_layout(folder / "unit.npz")
    assert layout.tiles.shape == (1, 64, 64)
    assert layout.dot_um == pytest.approx(32.0)


def test_blur_and_what_a_display_shows_are_those_of_the_task(anisoscope, folder):
    """The command designs what `design_picture` does with the same lamp, heights and blur."""
    (folder / "even.csv").write_text("wavelength_nm,power\n380,1\n780,1\n")
    done = anisoscope(
        "design", "hologram", "spot.png", "--cells", 32, "--min-width", 0.8, "--coherence", 6.67, "--reach", 0.12,
        "--passes-nm", "2,4,8,16,32,64,128,256", "--picture-light", "even.csv", "--picture-points", 16,
        "--search-steps", 10, "--blur", 0.13, "--displayed", "--out", "cells.npz", cwd=folder,
    )  # fmt: skip
    assert done.code == 0, done.err
    wanted = np.rint(255.0 * read_wanted(folder / "spot.png", 16, colour=True)).astype(np.uint8)
    task = PictureTask(
        np.asarray(decode_srgb()[wanted], dtype=np.float64),
        Depths(tuple(2.0 ** np.arange(1, 9)), (400.0, 700.0)).levels_um,
        Illuminant("even", (380.0, 780.0), (1.0, 1.0)),
        cells=32,
        cell_um=0.8,
        coherence_um=6.67,
        reach=0.12,
        blur_um=0.13,
        displayed=True,
    )
    expected = design_picture(task, np.random.default_rng(0), 10).labels
    np.testing.assert_array_equal(read_layout(folder / "cells.npz")[0].tiles[0], expected)


def test_the_map_of_a_hologram_is_predicted_by_every_command(hologram, anisoscope, folder, judged_figure):
    """Sixteen levels in cells of one pixel: no slopes."""
    assert anisoscope("design", "height", "unit.npz", "--out", "unit.x3p", cwd=folder).code == 0
    for command in (
        ("predict", "unit.x3p", "--map", "lobe.png"),
        ("predict", "unit.x3p", "--model", "wave", "--no-uncertainty"),
        (
            "bsdf",
            "export",
            "unit.xml",
            "--height-map",
            "unit.x3p",
            "--optics",
            "waves",
            "--wavelength",
            "550",
        ),
    ):
        done = anisoscope(*command, cwd=folder)
        assert done.code == 0, done.err
    what = "`design hologram`, `design height`, then `predict --map`, `--model wave`, `bsdf export --optics waves`"
    judged_figure("Stepped maps", what, "files of the commands", "all predict it", "all")
    wrong = anisoscope("predict", "unit.x3p", "--map", "no.png", "--steps", "5", cwd=folder)
    assert wrong.code != 0
    assert "lie on no 5 plateaus" in wrong.err


def on_a_screen(layout, distance_mm, pixel_mm, shape):
    """16 bits: the orders of a unit under a square lamp, each a box, on a screen seen from the side of the sample."""
    wave = np.exp(-4j * np.pi * layout.heights_um[layout.tiles[0]] / 0.55)
    n, unit = wave.shape[0], layout.dot_um
    power = np.fft.fftshift(np.abs(np.fft.fft2(wave)) ** 2)
    order = np.fft.fftshift(np.fft.fftfreq(n, 1.0 / n))
    power *= np.outer(*[np.sinc(order / n) ** 2] * 2)
    across = (np.arange(shape) - 0.5 * (shape - 1)) * pixel_mm
    y, x = np.meshgrid(-across, -across, indexing="ij")
    r = np.hypot(np.hypot(x, y), distance_mm)
    found = np.zeros((shape, shape))
    wide = 0.5 * unit / layout.coherence_um
    for row, col in np.argwhere(power > 1e-4 * power.max()):
        inside = (np.abs(x / r * unit / 0.55 - order[col]) < wide) & (
            np.abs(y / r * unit / 0.55 - order[row]) < wide
        )
        found += power[row, col] * inside
    found *= (distance_mm / r) ** 3
    return np.rint(60000.0 * found / found.max()).astype(np.uint16)


def test_a_photographed_hologram_is_compared_with_its_unit(anisoscope, hologram, folder):
    design = (
        "design",
        "compare-lobe",
        "photo.png",
        "--design",
        "unit.npz",
        "--wavelength",
        550,
        "--reach",
        0.1,
    )
    layout, _ = read_layout(folder / "unit.npz")
    photo = on_a_screen(layout, 300.0, 0.6, 260)
    cv2.imwrite(str(folder / "photo.png"), photo)
    scale = ("--distance", 300, "--pixel-mm", 0.6)
    done = anisoscope(*design, *scale, "--json", "--png", "compared.png", cwd=folder)
    assert done.code == 0, done.err
    assert done.json["correlation"] > 0.98
    assert cv2.imread(str(folder / "compared.png")) is not None
    marks = ";".join(
        f"{129.5 - x / 0.6},{129.5 - y / 0.6}={x},{y}"
        for x, y in ((-50, -40), (45, -50), (50, 50), (-40, 45))
    )
    again = anisoscope(*design, "--distance", 300, "--marks", marks, "--json", cwd=folder)
    assert again.json["correlation"] == pytest.approx(done.json["correlation"], abs=1e-4)
    behind = anisoscope(*design, *scale, "--from-behind", "--json", cwd=folder)
    assert behind.json["correlation"] < 0.9
    for wrong, words in (
        (("--distance", 300), "either --marks"),
        (("--distance", 300, "--marks", "1,2=3,4"), "--marks takes COL,ROW=X,Y"),
        (("--distance", 300, "--marks", "0,0=0,0;1,1=1,1;2,2=2,2;0,5=0,5"), "on a line"),
        (("--distance", -3, "--pixel-mm", 0.6), "positive distance"),
        ((*scale, "--background", 70000), "--background takes"),
        ((*scale, "--light", "3"), "--light takes 2 numbers"),
        (("--distance", 900, "--pixel-mm", 0.6), "lie outside of the photograph"),
        ((*scale, "--lamp-half-angle", 20), "--lamp-half-angle takes"),
    ):
        done = anisoscope(*design, *wrong, cwd=folder)
        assert done.code not in (0, 1), wrong
        assert words in done.err
        assert done.err.count("\n") == 1


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (["picture", "spot.png", *COARSE], "of the wanted light is out of reach"),
        (["picture", "none.png"], "cannot be read"),
        (["picture", "black.png"], "wants no light"),
        (["picture", "lobe.png", "--weights", "1,2"], "a weight of 0 or more for each of the 1"),
        (["picture", "lobe.png", "--out", "x.npz"], "--out writes *.toml"),
        (["hologram", "black.png"], "is black"),
        (["hologram", "spot.png", "--cells", "8"], "--cells takes 32 to 1024"),
        (["hologram", "spot.png", "--blur", "-1"], "0 for sharp steps"),
        (["hologram", "spot.png", "--reach", "0.4"], "diffract"),
        (["hologram", "spot.png", "--passes-nm", "1,2,3,4,5,6,7,8,9"], "1 to 8 etch passes"),
    ],
)
def test_mistakes_are_told_in_one_line(anisoscope, folder, command, words):
    done = anisoscope("design", *command, cwd=folder)
    assert done.code not in (0, 1)
    assert words in done.err
    assert done.err.count("\n") == 1
