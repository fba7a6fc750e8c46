"""Intensity and colour of the points: read where formats hold them, carried along by steps, written, drawn."""

import struct
import sys

import numpy as np
import pytest
from PIL import Image

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.editing.steps import edit_map
from anisoscope.profiles.files.images import write_layer
from anisoscope.profiles.files.load import LAYER_SUFFIXES, read_height_map, write_height_map
from anisoscope.profiles.heightmap import HeightMap


def grey(shape, most=200):
    """(rows, cols) whole numbers that no turn leaves as they are."""
    return np.random.default_rng(5).integers(1, most, shape)


def with_opd(path, picture):
    """Append an array of bytes to the blocks of an opd file."""
    data = path.read_bytes()
    (size,) = struct.unpack_from("<l", data, 20)
    block = struct.pack("<HHH", *picture.shape[::-1], 1) + picture.T.astype("u1").tobytes()
    entry = struct.pack("<16shlH", b"Image", 3, len(block), 8)
    head = data[:20] + struct.pack("<l", size + 24) + data[24 : 2 + size] + entry
    path.write_bytes(head + data[2 + size :] + block)


def with_nms(path, picture):
    data = bytearray(path.read_bytes())
    struct.pack_into("<i", data, 1416, 1)
    path.write_bytes(bytes(data) + picture.astype("u1").tobytes())


def with_metropro(path, picture):
    data = path.read_bytes()
    rows, cols = picture.shape
    window = struct.pack(">hhHHHhI", 0, 0, cols, rows, 1, 255, 2 * picture.size)
    path.write_bytes(data[:48] + window + data[64:834] + picture.astype(">u2").tobytes() + data[846:])


def with_sur(path, picture):
    data = bytearray(path.read_bytes())
    struct.pack_into("<H", data, 18, 11)
    image = bytearray(data[:512])
    struct.pack_into("<H", image, 18, 10)
    struct.pack_into("<f", image, 128, 0.5)
    path.write_bytes(bytes(data) + bytes(image) + (2 * picture).astype("<i4").tobytes())


def with_datx(path, picture):
    import h5py

    with h5py.File(path, "a") as file:
        file.create_dataset("/Data/Intensity/1", data=picture.astype("<u2"))


def with_vk4(path, picture):
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, 24, len(data))
    rows, cols = picture.shape
    head = struct.pack("<7I", cols, rows, 16, 0, 2 * picture.size, 0, 255) + bytes(768)
    path.write_bytes(bytes(data) + head + picture.astype("<u2").tobytes())


@pytest.mark.parametrize("name", ["opd", "nms", "metropro", "sur", "datx", "vk4"])
def test_intensity_of_an_instrument(tmp_path, made_files, heights, name):
    made = made_files[name]
    path, picture = tmp_path / f"a{made.suffix}", grey(heights.shape)
    made.write(path, heights)
    plain = read_height_map(path)
    globals()[f"with_{name}"](path, picture)
    found = read_height_map(path)
    expected = picture[::-1] if made.first_row == "top" else picture
    np.testing.assert_array_equal(found.layers["intensity"], expected)
    np.testing.assert_array_equal(found.height_um, plain.height_um)
    assert "not_read" not in found.origin
    tool = read_height_map(path, role="tool")
    np.testing.assert_array_equal(tool.layers["intensity"], expected[:, ::-1])


def test_a_metropro_window_beside_the_heights(tmp_path, made_files, heights):
    made_files["metropro"].write(tmp_path / "a.dat", heights)
    data = bytearray((tmp_path / "a.dat").read_bytes())
    struct.pack_into(">hh", data, 48, -1, 4)  # 3 × 2 points, one column before and four rows below
    struct.pack_into(">6H", data, 834, 1, 2, 3, 4, 65535, 6)
    (tmp_path / "a.dat").write_bytes(bytes(data))
    layer = read_height_map(tmp_path / "a.dat", rows="up").layers["intensity"]
    assert layer[4, :3] == pytest.approx([2.0, 3.0, np.nan], nan_ok=True)
    assert layer[5, :3] == pytest.approx([np.nan, 6.0, np.nan], nan_ok=True)
    assert np.count_nonzero(np.isfinite(layer)) == 3


def test_colours_of_a_sur_surface(tmp_path, made_files, heights):
    path = tmp_path / "a.sur"
    made_files["sur"].write(path, heights)
    data = bytearray(path.read_bytes())
    struct.pack_into("<H", data, 18, 16)
    colours = [grey(heights.shape) + 10 * k for k in range(4)]  # red, green, blue, intensity
    image = bytearray(data[:512])
    struct.pack_into("<f", image, 128, 1.0)
    whole = bytes(data) + b"".join(bytes(image) + one.astype("<i4").tobytes() for one in colours)
    path.write_bytes(whole)
    found = read_height_map(path).layers
    np.testing.assert_array_equal(found["colour"], np.stack(colours[:3], axis=2)[::-1])
    np.testing.assert_array_equal(found["intensity"], colours[3][::-1])
    path.write_bytes(whole[:-5])
    cut = read_height_map(path)
    assert not cut.layers
    assert "colour and intensity" in cut.origin["not_read"][0]


def coloured(shape=(9, 14)):
    rng = np.random.default_rng(1)
    colour = rng.integers(0, 256, (*shape, 3)).astype(np.float32)
    intensity = rng.integers(0, 4000, shape).astype(np.float32)
    intensity[2, 3] = colour[4, 5] = np.nan
    layers = {"intensity": intensity, "colour": colour}
    return HeightMap(rng.normal(size=shape), 0.5, 0.25, {}, layers)


@pytest.mark.parametrize("suffix", LAYER_SUFFIXES)
def test_layers_come_back(tmp_path, suffix):
    if suffix == ".exr":
        pytest.importorskip("OpenEXR")
    surface = coloured()
    write_height_map(surface, tmp_path / f"a{suffix}")
    found = read_height_map(tmp_path / f"a{suffix}")
    assert set(found.layers) == {"intensity", "colour"}
    for name, layer in surface.layers.items():
        np.testing.assert_array_equal(found.layers[name], layer)
    assert "other_channels" not in found.origin


def test_layers_as_pictures(tmp_path):
    surface = coloured()
    for name in surface.layers:
        write_layer(surface, name, tmp_path / f"{name}.png")
        with Image.open(tmp_path / f"{name}.png") as picture:
            found = np.asarray(picture)
        np.testing.assert_array_equal(found[::-1], np.nan_to_num(surface.layers[name]))
    write_layer(surface.with_height(surface.height_um), "intensity", tmp_path / "again.png")
    with pytest.raises(HeightMapError, match="no intensity"):
        write_layer(HeightMap(surface.height_um, 1.0, 1.0), "intensity", tmp_path / "b.png")


def test_steps_carry_layers_along():
    """A layer that is the heights themselves stays the heights."""
    y, x = np.mgrid[:40, :50]
    height = (0.1 * x + 0.3 * y + np.sin(x / 5.0)).astype(np.float32).astype(float)
    height[10:13, 20:24] = np.nan
    colour = np.stack([height, 2.0 * height, np.full_like(height, np.nan)], axis=2)
    surface = HeightMap(height, 2.0, 1.0, {}, {"intensity": height, "colour": colour})
    steps = [
        "crop=6,3",
        "rotate=30",
        "resample=3.1,1.7",
        "rotate=90",
        "resample=0.9",
        'mask=polygon:"1 1; 30 1; 1 30"',
    ]
    found = edit_map(surface, steps)
    known = np.isfinite(found.height_um)
    assert known.any()
    assert not known.all()
    intensity, colours = found.layers["intensity"], found.layers["colour"]
    np.testing.assert_allclose(intensity[known], found.height_um[known], atol=1e-3)
    np.testing.assert_allclose(colours[known][:, 1], 2.0 * found.height_um[known], atol=2e-3)
    assert np.isnan(colours[..., 2]).all()
    assert np.isfinite(intensity[~known]).any()  # a mask takes heights, not the picture of the field


def test_a_layer_must_fit():
    with pytest.raises(HeightMapError, match=r"intensity layer has shape \(3, 3\) where \(4, 4\) is due"):
        HeightMap(np.eye(4), 1.0, 1.0, {}, {"intensity": np.eye(3)})
    with pytest.raises(HeightMapError, match="no layer 'phase'"):
        HeightMap(np.eye(4), 1.0, 1.0, {}, {"phase": np.eye(4)})


def test_an_exr_of_another_program_asks_for_scales(tmp_path):
    OpenEXR = pytest.importorskip("OpenEXR")
    depth = np.arange(12, dtype=np.float16).reshape(3, 4)
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Z": depth, "A": depth}).write(str(tmp_path / "a.exr"))
    with pytest.raises(HeightMapError, match="--pixel"):
        read_height_map(tmp_path / "a.exr")
    with pytest.raises(HeightMapError, match="--z-unit"):
        read_height_map(tmp_path / "a.exr", pixel_um=(1.0, 2.0))
    found = read_height_map(tmp_path / "a.exr", pixel_um=(1.0, 2.0), z_unit="nm")
    np.testing.assert_array_equal(found.height_um, 1e-3 * depth[::-1].astype(float))
    write_height_map(found, tmp_path / "b.exr")
    with pytest.raises(HeightMapError, match="states its own"):
        read_height_map(tmp_path / "b.exr", pixel_um=(1.0, 2.0))


def test_without_openexr_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    (tmp_path / "a.exr").write_bytes(b"\x76\x2f\x31\x01" + bytes(60))
    with pytest.raises(HeightMapError, match=r"pip install 'anisoscope\[exr\]'"):
        read_height_map(tmp_path / "a.exr")
    with pytest.raises(HeightMapError, match=r"pip install 'anisoscope\[exr\]'"):
        write_height_map(coloured(), tmp_path / "b.exr")
    assert not (tmp_path / "b.exr").exists()
