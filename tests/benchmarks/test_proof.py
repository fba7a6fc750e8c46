"""A frame by table against the sum over 41 wavelengths, and 4096² dots: `make benchmark` prints it."""

import numpy as np
import pytest

from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.ink.shading import picture
from anisoscope.sim.materials.inks import SYNTHETIC, synthetic_ink
from anisoscope.sim.proof.comparison import two_lights
from anisoscope.sim.proof.halftone import halftone
from anisoscope.sim.proof.scene import Scene, surface
from anisoscope.sim.proof.separation import separation
from spectral_picture import spectral_picture

pytestmark = pytest.mark.benchmark


def test_a_frame_of_512_pixels_with_two_lights(bench):
    inks = [synthetic_ink(name) for name in SYNTHETIC]
    where, lights = surface(Scene("sphere"), 512, 512), two_lights(standard("d65"))
    cover = np.full((1, 1, 3), 1 / 3)
    found = bench.compare(
        "512 × 512 pixels of the soft proof, three inks, two lights",
        {
            "table": lambda: picture(where, inks, lights, coverage=cover),
            "41 wavelengths": lambda: spectral_picture(where, inks, lights, coverage=cover),
        },
    )
    assert found.wall_ratio("41 wavelengths", "table") > 20.0


@pytest.mark.parametrize("method", ["mask", "diffusion"])
def test_halftone_of_4096_dots_a_side(bench, method):
    y, x = np.mgrid[:4096, :4096]
    waves = [128 + 100 * np.sin(x / 300), 128 + 100 * np.cos(y / 200), 90 + 60 * np.sin((x + y) / 500)]
    image = np.stack(waves, axis=-1).astype(np.uint8)
    plan = separation([synthetic_ink(name) for name in SYNTHETIC], standard("d65"))
    bench.compare(
        f"4096 × 4096 dots, {method}",
        {
            "halftone": lambda: halftone(image, plan, method),
            "numpy sorts one channel": lambda: np.sort(image[..., 0], axis=None),
        },
        rounds=3,
    )
