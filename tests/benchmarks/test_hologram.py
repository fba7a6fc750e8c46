"""``design hologram``: pictures from a unit of 512 × 512 cells, in grey and in colour.

Goals: SSIM of 0.9, median ΔE2000 of 5, five minutes on two cores. 64 × 64 directions in colour miss them: dispersion.
With ANISOSCOPE_WRITE_DOCS=1 the picture in D65 is written to docs/pictures/hologram.png.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import pytest
import skimage.data

pytestmark = pytest.mark.benchmark
PICTURE = Path(__file__).resolve().parents[2] / "docs" / "pictures" / "hologram.png"
LONGEST_S = 300.0


@pytest.fixture
def image(tmp_path):
    path = tmp_path / "astronaut.png"
    cv2.imwrite(str(path), skimage.data.astronaut()[..., ::-1])
    return path


def designed(image, *options):
    command = [sys.executable, "-Im", "anisoscope", "design", "hologram", image.name, *options, "--json"]
    done = subprocess.run(command, cwd=image.parent, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    ("name", "options", "most_de2000"),
    [
        ("64 × 64, grey, one wavelength", ("--picture-points", "64"), None),
        ("32 × 32, D65", ("--picture-points", "32", "--picture-light", "d65"), 5.0),
        ("40 × 40, RGB LED", ("--picture-light", "led-rgb1"), 5.0),
        ("64 × 64, D65", ("--picture-points", "64", "--picture-light", "d65"), None),
    ],
)
def test_a_picture_of_a_unit_of_512_cells(bench, image, name, options, most_de2000):
    more = ("--png", "unit.png", "--over-etch", "1")
    timed = bench.compare(
        f"hologram, {name}", {"design hologram": lambda: designed(image, *options, *more)}, 1, warm=False
    )
    one = timed["design hologram"]
    found = one.result
    plain, deep = found["achieved"], found["over_etched"]
    colour = "" if plain["median_de2000"] is None else f", median ΔE2000 {plain['median_de2000']:.2f}"
    off = "" if deep["median_de2000"] is None else f", {deep['median_de2000']:.2f}"
    bench.note(
        f"{name}: SSIM {plain['ssim']:.3f}{colour}, {plain['light_share']:.0%} of the light in the picture; depths "
        f"{found['over_etch_percent']:+g} %: {deep['ssim']:.3f}{off}"
    )
    assert min(one.processor_s) < 2.0 * LONGEST_S
    if not name.startswith("64 × 64, D65"):
        assert plain["ssim"] > 0.9
    if most_de2000 is not None:
        assert plain["median_de2000"] < most_de2000
    if name.startswith("32") and os.environ.get("ANISOSCOPE_WRITE_DOCS") == "1":
        PICTURE.write_bytes((image.parent / "unit.png").read_bytes())
