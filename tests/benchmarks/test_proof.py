"""A frame by table against the sum over 41 wavelengths, and 4096² dots: `make benchmark` prints it."""

import time

import numpy as np
import pytest

from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.ink.shading import picture, spectral_picture
from anisoscope.sim.materials.inks import SYNTHETIC, synthetic_ink
from anisoscope.sim.proof.comparison import two_lights
from anisoscope.sim.proof.halftone import halftone
from anisoscope.sim.proof.scene import Scene, surface
from anisoscope.sim.proof.separation import separation

pytestmark = pytest.mark.benchmark


def best(function, repeats):
    """Shortest time on the clock, and shortest time of the processor over all threads."""
    wall, used = [], []
    for _ in range(repeats):
        start, before = time.perf_counter(), time.process_time()
        function()
        wall.append(time.perf_counter() - start)
        used.append(time.process_time() - before)
    return min(wall), min(used)


def test_a_frame_of_512_pixels_with_two_lights():
    inks = [synthetic_ink(name) for name in SYNTHETIC]
    where, lights = surface(Scene("sphere"), 512, 512), two_lights(standard("d65"))
    cover = np.full((1, 1, 3), 1 / 3)
    picture(where, inks, lights, coverage=cover)  # compile
    table, _ = best(lambda: picture(where, inks, lights, coverage=cover), 15)
    sums, _ = best(lambda: spectral_picture(where, inks, lights, coverage=cover), 2)
    print(
        f"\n512 × 512 pixels, three inks, two lights: table {1e3 * table:.2f} ms, 41 wavelengths {1e3 * sums:.0f} ms"
    )
    print(f"ratio {sums / table:.0f}")
    assert sums > 20.0 * table


@pytest.mark.parametrize("method", ["mask", "diffusion"])
def test_halftone_of_4096_dots_a_side(method):
    y, x = np.mgrid[:4096, :4096]
    waves = [128 + 100 * np.sin(x / 300), 128 + 100 * np.cos(y / 200), 90 + 60 * np.sin((x + y) / 500)]
    image = np.stack(waves, axis=-1).astype(np.uint8)
    plan = separation([synthetic_ink(name) for name in SYNTHETIC], standard("d65"))
    halftone(image[:256], plan, method)  # compile
    wall, used = best(lambda: halftone(image, plan, method), 3)
    plain, _ = best(lambda: np.sort(image[..., 0], axis=None), 1)
    print(f"\n4096 × 4096 dots, {method}: {wall:.2f} s ({used:.2f} s of the processor over all threads)")
    print(f"numpy sorts one channel of the same image in {plain:.2f} s; ratio {wall / plain:.1f}")
