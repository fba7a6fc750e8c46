"""Units that repeat under a Gaussian lamp: against the orders of an own Fourier transform, and in files of others."""

import os
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.prediction.angular import AngularTask, angular_reflectance
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light.colour.observer import matching_functions

TOOL = Path(__file__).resolve().parents[3] / "tools" / "public_designs.py"
PIXEL_UM, COHERENCE_UM, REACH, POINTS = 0.1, 2.6, 0.3, 64
NM = 420.0 + 32.5 * (np.arange(8) + 0.5)


def unit():
    """Smooth heights of a unit that repeats."""
    waves = np.random.default_rng(5).normal(size=(64, 64)) + 0j
    frequency = np.fft.fftfreq(64)
    soft = np.exp(-0.5 * (np.hypot(*np.meshgrid(frequency, frequency)) / 0.04) ** 2)
    height = np.fft.ifft2(np.fft.fft2(waves) * soft).real
    return 0.06 * height / height.std()


def orders(height, um, nodes=7):
    """(64, 64) BRDF over v_x (rows) and v_y: the orders of one unit, each a Gaussian, with the factor of Kirchhoff."""
    v = ((np.arange(POINTS) + 0.5) / POINTS * 2.0 - 1.0) * REACH
    x, y = np.meshgrid(v, v, indexing="ij")
    cosine = np.sqrt(1.0 - x**2 - y**2)
    frequency = np.fft.fftfreq(len(height), PIXEL_UM)
    wide = 1.0 / (2.0 * np.sqrt(2.0) * np.pi * COHERENCE_UM * um / 0.5)
    spread = np.exp(-0.5 * ((v[:, None] / um - frequency) / wide) ** 2) / (np.sqrt(2.0 * np.pi) * wide)
    slopes = np.linspace(1.0 + cosine.min(), 2.0, nodes)
    powers = [
        np.abs(np.fft.fft2(np.exp(-2j * np.pi * q * height / um))) ** 2 / height.size**2 for q in slopes
    ]
    maps = np.array([spread @ power @ spread.T for power in powers])
    place = np.interp(1.0 + cosine, slopes, np.arange(nodes))
    low = np.minimum(place.astype(int), nodes - 2)
    rows, cols = np.indices(x.shape)
    share = place - low
    density = (1.0 - share) * maps[low, rows, cols] + share * maps[low + 1, rows, cols]
    return density * (1.0 + cosine) ** 2 / (4.0 * cosine * um**2), cosine


def test_a_unit_that_repeats_under_a_gaussian_lamp_is_its_orders(judged_figure):
    lamp = np.degrees(np.arcsin(0.5 / (2.0 * np.sqrt(2.0) * np.pi * COHERENCE_UM)))
    task = AngularTask((500.0,), (0.0, 0.0), REACH * 63 / 64, POINTS, 0.0, 1e-4, lamp_sigma_deg=lamp)
    height = unit()
    found = angular_reflectance(HeightMap(height.T, PIXEL_UM, PIXEL_UM), task, periodic=True)
    wanted, cosine = orders(height, 0.5)
    found = found.brdf[0].T * (0.5 * (1.0 + cosine)) ** 2
    off = float(np.sqrt(np.mean((found - wanted) ** 2) / np.mean(wanted**2)))
    assert off < 0.005
    what, judge = "map of a unit that repeats, Gaussian lamp", "orders by an own Fourier transform"
    judged_figure("Stepped maps", what, judge, f"{off:.2%} rms", "0.5%")
    with pytest.raises(ModelError, match="a Gaussian or a disc"):
        AngularTask(lamp_half_angle_deg=1.0, lamp_sigma_deg=1.0)
    with pytest.raises(ModelError, match="0 to 10°"):
        AngularTask(lamp_sigma_deg=20.0)


def test_a_folder_of_designs_is_predicted_and_compared(tmp_path, monkeypatch, capsys):
    """Files as they are published, whose light is that of the orders above; the edges of the map are wrong."""
    tool = runpy.run_path(str(TOOL))
    folder = tmp_path / "a_uniform_pixelsize=0.8_red_32" / "sigma=0.3_noise=0.0"
    folder.mkdir(parents=True)
    cells = unit()[::2, ::2]
    corner, middle = tool["blur"](0.8, 0.3, 32)
    height = middle @ cells @ middle.T
    weights = np.interp(NM, matching_functions()[0], matching_functions()[1][:, 1])
    light = np.tensordot(weights / weights.sum(), [orders(height, 1e-3 * nm)[0] for nm in NM], axes=1)
    for name, channels in (
        ("hmap", {"Y": (corner @ cells @ corner.T).astype(np.float32)}),
        ("scale=8_render", {"RGB": np.repeat(light[..., None], 3, axis=2).astype(np.float32)}),
    ):
        OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION}, channels).write(str(folder / f"{name}.exr"))
    found = tool["Design"](folder / "hmap.exr")
    np.testing.assert_allclose(found.cells, cells, atol=1e-5)
    monkeypatch.setattr(sys, "argv", ["public_designs.py", str(tmp_path)])
    assert tool["main"]() == 0
    row = [cell.strip() for cell in capsys.readouterr().out.splitlines()[2].split("|")[1:-1]]
    assert row[1:4] == ["0.8", "2.6", "0.3"]
    published, whole, pieces, finer = (float(one.rstrip("%")) for one in row[4:])
    assert whole < 1.0 < published
    assert finer < 0.5 * pieces < 1.0
    monkeypatch.setattr(sys, "argv", ["public_designs.py", str(tmp_path), "--design", "10"])
    assert tool["main"]() == 0
    row = [cell.strip() for cell in capsys.readouterr().out.splitlines()[2].split("|")[1:-1]]
    assert float(row[3].rstrip("%")) < float(row[2].rstrip("%"))
    monkeypatch.setattr(sys, "argv", ["public_designs.py", str(tmp_path / "none")])
    with pytest.raises(SystemExit, match=r"holds no hmap\.exr"):
        tool["main"]()


@pytest.mark.benchmark
@pytest.mark.skipif("ANISOSCOPE_PUBLIC_DESIGNS" not in os.environ, reason="needs the published designs")
def test_published_designs(monkeypatch, capsys, judged_figure):
    """The folder ANISOSCOPE_PUBLIC_DESIGNS, in 20 min of processor: the sums below the table of the page."""
    monkeypatch.setattr(sys, "argv", ["public_designs.py", os.environ["ANISOSCOPE_PUBLIC_DESIGNS"]])
    assert runpy.run_path(str(TOOL))["main"]() == 0
    sums = dict(re.findall(r"^(.+): (median .+)$", capsys.readouterr().out, flags=re.MULTILINE))
    judges = {
        "map as published": "their renderer",
        "unit": "their renderer",
        "pieces": "their renderer",
        "unit and half a pixel": "their method with pixels half as wide",
    }
    assert sums.keys() == judges.keys()
    for name, judge in judges.items():
        judged_figure("Published designs", name, judge, sums[name], "3% each")
