"""Exported reflectance read by other people's code: Mitsuba's plugin ``measured``, and Radiance's BSDF library."""

import json
import subprocess
import sys

import numpy as np
import pytest

from anisoscope.bsdf.klems import write_klems
from anisoscope.bsdf.mitsuba_scene import write_scene
from anisoscope.bsdf.models import of_ridges
from anisoscope.bsdf.reflectance import Reflectance, above_horizon, hemisphere, shuffled
from anisoscope.bsdf.rgl import Resolution, read_rgl, write_rgl
from anisoscope.bsdf.tensor_tree import read_lbnl, write_tensor_tree
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign

try:
    import mitsuba
except ImportError:
    mitsuba = None
try:
    import pyradiance
except ImportError:
    pyradiance = None

WITH = "needs the extra [benchmark]: make benchmark installs it"
pytestmark = pytest.mark.benchmark
FLAT = of_ridges(RidgeDesign(100.0, 0.0), Material(0.1, 0.1))
RIDGES = of_ridges(RidgeDesign(100.0, 10.0), Material())
PIXELS, HALF_WIDTH = 256, 1.1
FINER = (
    3  # ridges run around the sphere's axis, which points at the camera: pixels near it see many directions
)


def directions(count, highest_deg):
    return hemisphere(count, highest_deg), shuffled(hemisphere(count, highest_deg, 0.5))


@pytest.mark.skipif(mitsuba is None, reason=WITH)
@pytest.mark.parametrize("surface", [FLAT, RIDGES], ids=["flat", "ridges"])
def test_mitsuba_reads_what_we_read(tmp_path, surface):
    mitsuba.set_variant("scalar_spectral")
    write_rgl(surface, tmp_path / "x.bsdf", Resolution(24, 37, 32))
    light, camera = directions(256, 75.0)
    ours = read_rgl(tmp_path / "x.bsdf").evaluate(light, camera)[:, 0] * camera[:, 2]
    bsdf = mitsuba.load_dict({"type": "measured", "filename": str(tmp_path / "x.bsdf")})
    theirs = []
    for one, other in zip(light, camera, strict=True):
        interaction = mitsuba.SurfaceInteraction3f()
        interaction.wi, interaction.wavelengths = mitsuba.Vector3f(*one), [500.0, 550.0, 600.0, 650.0]
        theirs.append(bsdf.eval(mitsuba.BSDFContext(), interaction, mitsuba.Vector3f(*other))[0])
    np.testing.assert_allclose(theirs, ours, rtol=1e-4, atol=1e-6)


def sphere(surface, light_deg):
    """Our own picture of a sphere: radiance, and where it is judged (within 64° of the view)."""
    points = PIXELS * FINER
    at = (np.arange(points) + 0.5) / points * 2.0 * HALF_WIDTH - HALF_WIDTH
    x, y = np.meshgrid(at, -at)
    inside = x**2 + y**2 < 0.81
    normal = np.stack([x, y, np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))], axis=-1)[inside]
    around = np.stack(
        [-normal[:, 1], normal[:, 0], np.zeros(len(normal))], axis=-1
    )  # Mitsuba's ∂p/∂u about z
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    frame = np.stack([around, np.cross(normal, around), normal], axis=1)
    to_light = np.array([np.sin(np.radians(light_deg)), 0.0, np.cos(np.radians(light_deg))])
    light, camera = frame @ to_light, frame @ np.array([0.0, 0.0, 1.0])
    fine = np.zeros((points, points))
    fine[inside] = surface.evaluate(light, camera)[:, 0] * np.maximum(light[:, 2], 0.0)
    blocks = PIXELS, FINER, PIXELS, FINER
    whole = inside.reshape(blocks).all(axis=(1, 3))
    return fine.reshape(blocks).mean(axis=(1, 3))[whole], whole


@pytest.mark.skipif(mitsuba is None, reason=WITH)
@pytest.mark.parametrize(
    ("surface", "nodes"), [(FLAT, Resolution(45)), (RIDGES, Resolution(45, 73, 48))], ids=["flat", "ridges"]
)
@pytest.mark.parametrize("light_deg", [10.0, 40.0])
def test_mitsuba_renders_what_we_predict(tmp_path, surface, nodes, light_deg):
    """A sphere under a directional light, within 1 % rms; 128 samples a pixel leave 0.3 % of noise."""
    mitsuba.set_variant("scalar_spectral")
    write_rgl(surface, tmp_path / "x.bsdf", nodes)
    write_scene(tmp_path / "s.xml", tmp_path / "x.bsdf", "sphere", light_deg)
    wanted, inside = sphere(surface, light_deg)
    picture = np.array(mitsuba.render(mitsuba.load_file(str(tmp_path / "s.xml")), spp=128))[..., 0]
    deviation = np.sqrt(np.mean((picture[inside] - wanted) ** 2) / np.mean(wanted**2))
    print(f"\nsphere, light at {light_deg:g}°: {deviation:.2%} rms")
    assert deviation < 0.01


QUERY = """
import json, sys
import pyradiance
data = pyradiance.bsdf.load_file(sys.argv[1])
print(json.dumps([float(pyradiance.bsdf.query(data, *four)[1]) for four in json.load(sys.stdin)]))
"""


def by_radiance(path, light, camera):
    """Values by Radiance's library, a process each: its cache does not survive a second file."""
    angles = np.concatenate(
        [
            [
                np.degrees(np.arctan2(np.hypot(v[:, 0], v[:, 1]), v[:, 2])),
                np.degrees(np.arctan2(v[:, 1], v[:, 0])),
            ]
            for v in (light, camera)
        ]
    )
    done = subprocess.run(
        [sys.executable, "-c", QUERY, str(path)],
        input=json.dumps(angles.T.tolist()), capture_output=True, text=True, check=True,
    )  # fmt: skip
    return np.array(json.loads(done.stdout))


SKEW = Reflectance(
    "skew",
    lambda light, camera: above_horizon(
        light,
        camera,
        lambda i, o: (
            1.5 + 0.5 * i[:, 0] + 0.2 * i[:, 1] + 0.8 * o[:, 0] * o[:, 2] - 0.4 * o[:, 1] + i[:, 1] * o[:, 0]
        ),
    ),
)


@pytest.mark.skipif(pyradiance is None, reason=WITH)
@pytest.mark.parametrize("write", [write_klems, write_tensor_tree], ids=["klems", "tensor-tree"])
@pytest.mark.parametrize("surface", [SKEW, FLAT, RIDGES], ids=["skew", "flat", "ridges"])
def test_radiance_reads_what_we_read(tmp_path, judged_figure, write, surface):
    """All directions alike: an axis, a sign, a side or rows for columns would show.

    Radiance itself moves values by up to 3e-4 from cell to cell, and takes negative ones as 0.
    """
    write(surface, tmp_path / "x.xml")
    light, camera = directions(512, 80.0)
    ours = np.maximum(read_lbnl(tmp_path / "x.xml").evaluate(light, camera)[:, 0], 0.0)
    theirs = by_radiance(tmp_path / "x.xml", light, camera)
    off = np.abs(theirs - ours) / np.maximum(ours, 1e-3 * ours.max())
    print(f"\nRadiance, {surface.name}: largest difference {off.max():.1e}")
    assert off.max() < 1e-3
    if surface is SKEW:
        return
    wanted = surface.evaluate(light, camera)[:, 0]
    rms = np.sqrt(np.mean((theirs - wanted) ** 2) / np.mean(wanted**2))
    whose, goal = ("ridges of 10°", "refused") if surface is RIDGES else ("flat plastic, α 0.1", "stated")
    what = f"{'Klems matrix' if write is write_klems else 'tensor tree'} of {whose}"
    judged_figure(
        "Exchange", what, f"Radiance by pyradiance {pyradiance.__version__}", f"{rms:.1%} rms", goal
    )
