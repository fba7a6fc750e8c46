from xml.etree import ElementTree as ET

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.bsdf.formats import compared_directions, deviation, export, format_of, read_reflectance
from anisoscope.bsdf.mitsuba_scene import write_scene
from anisoscope.bsdf.models import of_ridges
from anisoscope.bsdf.rgl import Resolution
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.colour.observer import xyz_weights


def spectral(surfaces):
    nm = np.arange(400.0, 701.0, 50.0)
    shape = np.linspace(0.1, 0.4, nm.size)
    return (
        surfaces.surface(lambda i, _: np.broadcast_to(shape, (len(i), nm.size)), tuple(nm), isotropic=True),
        shape,
        nm,
    )


@pytest.mark.parametrize("name", ["x.bsdf", "x.binary", "x.xml"])
def test_the_content_tells_the_format(tmp_path, surfaces, name):
    path = tmp_path / name
    done = export(surfaces.lambertian(), path, format_of(path), Resolution(16, 5, 24))
    path.rename(tmp_path / "renamed")
    found = read_reflectance(tmp_path / "renamed")
    assert deviation(found, surfaces.lambertian()) == pytest.approx(done.rms)
    assert done.rms < 0.01
    assert done.size > 0


def test_a_spectrum_becomes_what_the_format_holds(tmp_path, surfaces):
    surface, shape, nm = spectral(surfaces)
    xyz = shape @ xyz_weights(standard("D65"), nm)
    klems = export(surface, tmp_path / "x.xml", "klems")
    up = np.array([[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(read_reflectance(tmp_path / "x.xml").evaluate(up, up), xyz[1], rtol=1e-5)
    assert "luminous mean" in klems.losses[0]
    export(surface, tmp_path / "x.bsdf", "rgl", Resolution(4, 5, 8))
    np.testing.assert_allclose(read_reflectance(tmp_path / "x.bsdf").evaluate(up, up)[0], shape, rtol=1e-3)


def test_ridges_are_no_klems_matrix_unless_asked_for(tmp_path, judged_figure):
    ridges = of_ridges(RidgeDesign(100.0, 10.0), Material())
    for name in ("klems", "tensor-tree"):
        with pytest.raises(UsageError, match=r"is not for ridges.*--coarse"):
            export(ridges, tmp_path / "x.xml", name)
    assert not list(tmp_path.iterdir())
    rms = export(ridges, tmp_path / "x.xml", "klems", coarse=True).rms
    assert rms > 0.1
    judged_figure(
        "Exchange", "Klems matrix of ridges, read back", "what was exported", f"{rms:.0%} rms", "refused"
    )
    export(of_ridges(RidgeDesign(100.0, 0.0), Material()), tmp_path / "flat.xml", "klems")


def test_merl_says_what_a_reader_of_cells_sees(tmp_path, judged_figure):
    """By an own look-up of cells, as the reader that comes with the data does it."""
    flat = of_ridges(RidgeDesign(100.0, 0.0), Material(0.1, 0.1))
    done = export(flat, tmp_path / "x.binary", "merl")
    (text,) = [loss for loss in done.losses if "nearest cell" in loss]
    light, camera = compared_directions()
    data = np.frombuffer((tmp_path / "x.binary").read_bytes()[12:], "<f8").reshape(3, 90, 90, 180)[0] / 1500.0
    half = (light + camera) / np.linalg.norm(light + camera, axis=1, keepdims=True)
    tilt, diff = np.arccos(half[:, 2]), np.arccos(np.clip(np.sum(light * half, axis=1), -1.0, 1.0))
    rows = np.minimum(90.0 * np.sqrt(tilt / (0.5 * np.pi)), 89.0).astype(int)
    cells = data[rows, np.minimum(np.degrees(diff), 89.0).astype(int)].mean(axis=1)  # turns hardly count here
    wanted = flat.evaluate(light, camera)[:, 0]
    off = np.sqrt(np.mean((cells - wanted) ** 2) / np.mean(wanted**2))
    assert float(text.partition(" are ")[2].partition("%")[0]) == pytest.approx(100.0 * off, abs=0.5)
    assert 3.0 < 100.0 * off < 5.0
    found = f"{done.rms:.1%} interpolated, {off:.1%} nearest cell"
    judged_figure("Exchange", "MERL of flat plastic, α 0.1", "own reader of cells", found, "both stated")


def test_unknown_files(tmp_path):
    (tmp_path / "x.txt").write_text("hello", encoding="utf-8")
    with pytest.raises(UsageError, match="none of the formats"):
        read_reflectance(tmp_path / "x.txt")
    with pytest.raises(UsageError, match="cannot read"):
        read_reflectance(tmp_path / "missing.bsdf")
    with pytest.raises(UsageError, match="name the format of another extension"):
        format_of(tmp_path / "x.txt")


def test_the_scene_names_the_file_and_the_light(tmp_path):
    write_scene(tmp_path / "s.xml", tmp_path / "a & b.bsdf", "plate", 30.0)
    root = ET.parse(tmp_path / "s.xml").getroot()
    assert root.find(".//bsdf/string").get("value") == "a & b.bsdf"
    light = [float(x) for x in root.find(".//emitter/vector").get("value").split(",")]
    np.testing.assert_allclose(light, [-0.5, 0.0, -np.sqrt(0.75)], atol=1e-8)
    assert root.find("shape").get("type") == "rectangle"
