"""The height map in 3-D: real processes, real pictures."""

import io
import json
import subprocess
import zipfile

import numpy as np
import pytest

from anisoscope.report import surface_view
from anisoscope.report.surface_view import MAX_POINTS, Renderer, SceneScale

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture
def ridges(rng):
    height = np.tile((np.arange(700) % 100) * 0.17, (400, 1)) + 0.02 * rng.standard_normal((400, 700))
    height[10:20, 30:50] = np.nan
    return height


def drawn(view):
    if view.png is None:
        pytest.skip(f"nothing can be drawn here: {view.note}")
    return view


def test_picture_and_scene_are_drawn_once_and_kept(ridges, monkeypatch, tmp_path):
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path))
    first = drawn(Renderer(ridges, (1.0, 1.0), interactive=True).result())
    assert first.png.startswith(PNG)
    with zipfile.ZipFile(io.BytesIO(first.scene)) as archive:
        scene = json.loads(archive.read("index.json"))
    sizes = {(one["type"], one["vtk"]) for one in scene["hashes"].values()}
    assert ("Float32Array", "vtkPoints") in sizes or any(kind == "Float32Array" for kind, _ in sizes)
    assert len(first.scene) < 2e6
    assert "599 × 399 µm" in first.note

    def never(*_, **__):
        raise AssertionError("it was drawn before")

    monkeypatch.setattr(subprocess, "Popen", never)
    assert Renderer(ridges, (1.0, 1.0), interactive=True).result() == first
    still = Renderer(ridges, (1.0, 1.0)).result()
    assert (still.png, still.scene) == (first.png, None)
    with pytest.raises(AssertionError, match="drawn before"):
        Renderer(ridges + 0.5 * ridges[::-1], (1.0, 1.0))


def test_what_is_drawn_is_small_and_true(ridges):
    packed, _ = surface_view._reduced(ridges, (1.0, 0.5), SceneScale())
    with np.load(io.BytesIO(packed)) as data:
        assert max(data["z"].shape) <= MAX_POINTS
        rows, cols = (round(step / pixel) for step, pixel in zip(data["pixel"], (1.0, 0.5), strict=True))
        np.testing.assert_array_equal(data["z"], ridges[:600:rows, :700:cols])


def test_without_trame_there_is_a_still_picture(ridges, monkeypatch, tmp_path):
    fake = tmp_path / "path" / "trame_vtk"
    fake.mkdir(parents=True)
    (fake / "__init__.py").write_text("raise ImportError('not here')\n")
    monkeypatch.setenv("PYTHONPATH", str(fake.parent))
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path / "cache"))
    view = drawn(Renderer(ridges, (1.0, 1.0), interactive=True).result())
    assert view.png.startswith(PNG)
    assert view.scene is None
    assert "still picture" in view.note
    assert not (tmp_path / "cache").exists()


def test_a_renderer_that_dies_says_what_it_needs(ridges, monkeypatch, tmp_path):
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path))
    monkeypatch.setattr(surface_view, "DRAWS", "anisoscope.no_such_module")
    view = Renderer(ridges, (1.0, 1.0), interactive=True).result()
    assert (view.png, view.scene) == (None, None)
    assert "EGL" in view.note


def test_a_discarded_renderer_leaves_nothing(ridges, monkeypatch, tmp_path):
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(surface_view.tempfile, "tempdir", str(tmp_path))
    renderer = Renderer(ridges, (1.0, 1.0))
    renderer.discard()
    assert list(tmp_path.iterdir()) == []
    assert renderer._process.poll() is not None


def test_a_scene_of_the_whole_map_with_a_factor_of_choice(ridges):
    whole = SceneScale(field_um=700.0, most_points=400, exaggeration=12.5)
    packed, note = surface_view._reduced(ridges, (1.0, 0.5), whole)
    with np.load(io.BytesIO(packed)) as data:
        np.testing.assert_array_equal(data["z"], ridges[:, ::2])
        np.testing.assert_array_equal(data["pixel"], [1.0, 1.0])
        assert data["exaggeration"] == 12.5
    assert "12.5 times" in note
    flat = SceneScale(most_exaggeration=1000.0)
    with np.load(io.BytesIO(surface_view._reduced(1e-2 * ridges, (1.0, 1.0), flat)[0])) as data:
        rise = np.nanmax(data["z"]) - np.nanmin(data["z"])
        assert data["exaggeration"] * rise == pytest.approx(0.08 * 599.0)
