"""The page of an etched wafer in a browser: dots as the wave engine has them, in software rendering."""

import json
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from anisoscope.base.errors import UsageError
from anisoscope.parameters.light import LightSpectrum
from anisoscope.report.plate_page import write_layout_page
from anisoscope.sim.design.designfile import DesignFile
from anisoscope.sim.design.layout import Layout
from anisoscope.sim.design.models import AntiMirrorModel, LobeModel, MirrorModel
from anisoscope.sim.design.pattern import PatternOptions, make_layout
from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.colour.observer import xyz_weights
from anisoscope.sim.light.colour.spaces import XYZ_TO_SRGB
from anisoscope.sim.light.wave.reflectance import radiance
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window

SHAPE = (3, 4)


@pytest.fixture(scope="module")
def wafer():
    """A lobe that is wide along x, an anti-mirror and the bare wafer, two passes for white light, dots of 48 µm."""
    models = (
        LobeModel(widths_x_um=(2.0, 4.0), p_a_x=(0.5, 0.5), widths_y_um=(8.0,), p_a_y=(1.0,)),
        AntiMirrorModel(arrangement=(2, 2), widths_um=(2.0, 2.0), levels=4),
        MirrorModel(),
    )
    designs = [
        DesignFile(name=f"<{model.kind}>", model=model, passes_nm=(107.3, 157.5), band_nm=(400.0, 700.0))
        for model in models
    ]
    classes = np.array([[0, 1, 2, 0], [1, 1, 0, 2], [0, 2, 1, 1]])
    return make_layout(classes, designs, np.random.default_rng(4), PatternOptions(48.0, 2))


@pytest.fixture(scope="module")
def page_of(wafer, tmp_path_factory):
    path = tmp_path_factory.mktemp("wafer") / "wafer.html"
    write_layout_page(path, "three", wafer, standard("d65"))
    return path


def ready(page, url):
    page.open(url, 1300, 1000)
    deadline = time.monotonic() + 120.0
    while not page.evaluate("document.body.dataset.ready === 'yes'"):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def engine(layout, case):
    """(T, 3) linear sRGB of every tile by the fused pass, line by line."""
    lift, around = np.radians([case["elevation"], case["azimuth"]])
    light = [np.cos(lift) * np.cos(around), np.cos(lift) * np.sin(around), np.sin(lift)]
    into = Rotation.from_euler("zx", [case["stage"], case["tilt"]], degrees=True).inv()
    to_light, to_camera = into.apply([light]), into.apply([[0.0, 0.0, 1.0]])
    nm = np.arange(400.0, 701.0, 20.0)
    colours = xyz_weights(standard("d65"), nm) @ XYZ_TO_SRGB.T
    window = Window(Extent("rect", 1e-3 * layout.wavelength_nm / layout.coherence_um))
    found = np.zeros((len(layout.tiles), 3))
    if to_light[0, 2] <= 0.02:
        return found
    for number, tile in enumerate(layout.tiles):
        surface = WaveSurface.of(layout.heights_um[tile], layout.grid_um, cells=True)
        for one, rgb in zip(nm, colours, strict=True):
            line = LightSpectrum((1e-3 * float(one),), (1.0,))
            found[number] += rgb * radiance(surface, to_light, to_camera, window, line, check=False)[0]
    return found


@pytest.mark.browser
def test_every_dot_is_that_of_the_engine_within_a_percent(page, page_of, wafer):
    ready(page, page_of.as_uri() + "#selftest")
    found = json.loads(page.evaluate("document.getElementById('selftest').textContent"))
    size, (rows, cols) = found["size"], SHAPE
    scale = 0.94 * size / np.hypot(rows, cols)
    lit = 0
    for case in found["cases"]:
        pixels = np.array(case["pixels"]).reshape(size, size, 3)
        due = engine(wafer, case)
        turn = Rotation.from_euler("zx", [case["stage"], case["tilt"]], degrees=True)
        for row in range(rows):
            for col in range(cols):
                # row 0 of the index lies at y = 0, the bottom of the picture
                place = turn.apply([col + 0.5 - 0.5 * cols, row + 0.5 - 0.5 * rows, 0.0])
                seen = pixels[int(0.5 * size - scale * place[1]), int(0.5 * size + scale * place[0])]
                wanted = due[wafer.index[row, col]]
                assert seen == pytest.approx(wanted, rel=0.01, abs=0.01 * np.abs(wanted).max()), (
                    case,
                    row,
                    col,
                )
                lit += np.abs(wanted).max() > 1e-3
    assert lit > 30
    assert page.complaints() == []
    assert page.requests() == [page_of.as_uri()]


def test_the_page_is_escaped_and_refuses_what_a_browser_cannot_sum(page_of, wafer, tmp_path):
    text = page_of.read_text(encoding="utf-8")
    assert "&lt;lobe&gt;" in text
    assert "https://" not in text
    dense = Layout(
        np.random.default_rng(1).integers(0, 4, (8, 512, 512)).astype(np.uint16), np.zeros(8, dtype=np.int64),
        np.zeros((2, 2), dtype=np.uint16), (107.3, 157.5), 0.5, ("unit",),
    )  # fmt: skip
    with pytest.raises(UsageError, match="products"):
        write_layout_page(tmp_path / "x.html", "x", dense, standard("d65"))
    assert not (tmp_path / "x.html").exists()
