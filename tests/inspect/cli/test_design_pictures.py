"""``anisoscope design picture`` and ``design hologram`` as a user calls them."""

import cv2
import numpy as np
import pytest

from anisoscope.sim.design.designfile import read_design, read_layout


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


def test_a_spot_comes_out_as_a_hologram(anisoscope, folder):
    done = anisoscope(
        "design", "hologram", "spot.png", "--cells", 64, "--coherence", 12, "--picture-points", 16,
        "--search-steps", 40, "--out", "unit.npz", "--png", "unit.png", "--json", cwd=folder,
    )  # fmt: skip
    assert done.code == 0, done.err
    assert done.json["achieved"]["ssim"] > 0.7
    assert done.json["achieved"]["median_de2000"] is None
    layout, _ = read_layout(folder / "unit.npz")
    assert layout.tiles.shape == (1, 64, 64)
    assert layout.dot_um == pytest.approx(32.0)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (["picture", "spot.png", *COARSE], "of the wanted light is out of reach"),
        (["picture", "none.png"], "cannot be read"),
        (["picture", "black.png"], "wants no light"),
        (["picture", "lobe.png", "--weights", "1,2"], "a weight of 0 or more for each of the 1"),
        (["picture", "lobe.png", "--out", "x.npz"], "--out writes *.toml"),
        (["hologram", "black.png"], "is black"),
        (["hologram", "spot.png", "--cells", "8"], "--cells takes 64 to 1024"),
        (["hologram", "spot.png", "--reach", "0.4"], "diffract"),
        (["hologram", "spot.png", "--passes-nm", "1,2,3,4,5"], "1 to 4 etch passes"),
    ],
)
def test_mistakes_are_told_in_one_line(anisoscope, folder, command, words):
    done = anisoscope("design", *command, cwd=folder)
    assert done.code not in (0, 1)
    assert words in done.err
    assert done.err.count("\n") == 1
