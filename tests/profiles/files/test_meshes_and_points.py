"""Meshes read back, and scattered points on a grid, against a surface that is known everywhere."""

import base64
import contextlib
import struct

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.load import read_height_map, write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.textures.texture import texture
from anisoscope.report.profile_page import map_picture


def surface(x, y):
    return np.sin(x / 10.0) + 0.02 * y


@pytest.fixture
def scattered():
    return np.random.default_rng(3).uniform(0.0, 60.0, (6000, 2))


def points_file(path, places, heights):
    np.savetxt(path, np.column_stack([places, heights]), fmt="%.9g")
    return path


@pytest.mark.parametrize("suffix", [".stl", ".ply"])
def test_a_mesh_that_we_wrote_is_read_back(tmp_path, heights, suffix):
    path = tmp_path / f"a{suffix}"
    write_height_map(HeightMap(heights, 1.5, 2.0), path)
    found = read_height_map(path)
    assert found.shape == heights.shape
    np.testing.assert_allclose(found.height_um, heights, atol=2e-6)
    assert (found.pixel_y_um, found.pixel_x_um) == pytest.approx((2.0, 1.5), rel=1e-6)
    with pytest.raises(HeightMapError, match="the header states mm, not um; leave --z-unit out"):
        read_height_map(path, z_unit="um")


@pytest.mark.parametrize("suffix", [".stl", ".ply"])
def test_a_damaged_mesh_is_refused_or_plausible(tmp_path, heights, suffix):
    path = tmp_path / f"a{suffix}"
    write_height_map(HeightMap(heights, 1.5, 2.0), path)
    whole, rng = path.read_bytes(), np.random.default_rng(4)
    for size in np.linspace(0, len(whole) - 1, 4).astype(int):
        path.write_bytes(whole[:size])
        with pytest.raises(HeightMapError, match=path.name):
            read_height_map(path)
    for place in rng.integers(0, len(whole), 4):
        data = bytearray(whole)
        data[place] ^= int(rng.integers(1, 256))
        path.write_bytes(bytes(data))
        with contextlib.suppress(HeightMapError):
            assert np.nanmax(np.abs(read_height_map(path).height_um)) <= 10_000.0


def stl_of(path, corners):
    """A binary STL without a unit, as other programs write it: every triangle with corners of its own."""
    record = struct.Struct("<12fH")
    body = b"".join(record.pack(0.0, 0.0, 1.0, *one.ravel(), 0) for one in corners)
    path.write_bytes(b"made elsewhere".ljust(80) + struct.pack("<I", len(corners)) + body)


def test_a_mesh_of_others_needs_a_unit_and_a_grid(tmp_path):
    x, y = np.meshgrid(np.arange(30.0), np.arange(20.0))
    x = x + 0.3 * (y.astype(int) % 2)  # every second line is shifted: no grid
    points = np.stack([x, y, surface(x, y)], axis=-1)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    stl_of(
        tmp_path / "a.stl", np.concatenate([np.stack([a, b, c], 2), np.stack([a, c, d], 2)]).reshape(-1, 3, 3)
    )
    with pytest.raises(
        HeightMapError, match=r"a\.stl: units: a mesh states none; say that of x, y and z with"
    ):
        read_height_map(tmp_path / "a.stl")
    with pytest.raises(HeightMapError, match="--grid"):
        read_height_map(tmp_path / "a.stl", z_unit="um")
    found = read_height_map(tmp_path / "a.stl", z_unit="um", grid_um=0.5)
    rows, cols = np.indices(found.shape)
    error = found.height_um - surface(0.5 * cols, 0.5 * rows)
    assert np.nanmax(np.abs(error)) < 0.002
    assert found.missing_share < 0.02


@pytest.mark.parametrize(
    "content", [b"solid a\nendsolid a\n", b"ply\nformat ascii 1.0\nend_header\n", b"\0" * 90]
)
def test_no_mesh_of_a_surface(tmp_path, content):
    path = tmp_path / ("a.ply" if content.startswith(b"ply") else "a.stl")
    path.write_bytes(content)
    with pytest.raises(HeightMapError, match=path.name):
        read_height_map(path, z_unit="mm")


def test_scattered_points_are_interpolated(tmp_path, scattered):
    path = points_file(tmp_path / "a.xyz", scattered, surface(*scattered.T))
    with pytest.raises(HeightMapError, match="--grid STEP"):
        read_height_map(path)
    found = read_height_map(path, grid_um=0.5)
    rows, cols = np.indices(found.shape)
    left, low = scattered.min(axis=0)
    error = found.height_um - surface(left + 0.5 * cols, low + 0.5 * rows)
    assert np.nanstd(error) < 0.002
    assert found.missing_share < 0.03
    said = found.origin["gridded"]
    assert said["step_um"] == 0.5
    assert (
        0.2 < said["interpolated_share"] < 0.9
    )  # with 1.7 points per µm²: of random points within .25 µm 28 %


@pytest.mark.parametrize("suffix", [".npz", ".gwy", ".exr"])
def test_interpolated_points_are_marked_and_left_out_of_measurements(tmp_path, scattered, suffix):
    path = points_file(tmp_path / "a.xyz", scattered, surface(*scattered.T))
    found = read_height_map(path, grid_um=1.0)
    write_height_map(found, tmp_path / f"b{suffix}")
    kept = read_height_map(tmp_path / f"b{suffix}")
    marked = kept.layers["interpolated"] == 1.0
    known = np.isfinite(found.height_um)
    assert np.count_nonzero(marked) / np.count_nonzero(known) == pytest.approx(
        found.origin["gridded"]["interpolated_share"]
    )
    np.testing.assert_array_equal(np.isnan(kept.measured().height_um), marked | ~known)
    with pytest.raises(HeightMapError, match="larger step with --grid"):
        read_height_map(path, grid_um=0.5).measured()
    if suffix == ".npz":
        raised = kept.with_height(kept.height_um + np.where(marked, 5.0, 0.0))
        assert texture(raised).heights == texture(kept).heights
        assert "<pattern" in map_picture_text(kept)
        assert "<pattern" not in map_picture_text(HeightMap(kept.height_um, 1.0, 1.0))


def map_picture_text(found):
    return base64.b64decode(map_picture(found).partition(",")[2]).decode()


def test_a_gap_stays_a_gap(tmp_path, scattered):
    hole = np.hypot(*(scattered - 30.0).T) < 8.0
    path = points_file(tmp_path / "a.xyz", scattered[~hole], surface(*scattered[~hole].T))
    found = read_height_map(path, grid_um=0.5)
    rows, cols = np.indices(found.shape)
    left, low = scattered.min(axis=0)
    inside = np.hypot(left + 0.5 * cols - 30.0, low + 0.5 * rows - 30.0) < 5.0
    assert np.isnan(found.height_um[inside]).all()


def test_points_on_the_grid_keep_their_heights(tmp_path):
    y, x = np.mgrid[0:12:1.0, 0:15:1.0]
    path = points_file(tmp_path / "a.xyz", np.column_stack([x.ravel(), y.ravel()]), surface(x, y).ravel())
    found = read_height_map(path, grid_um=1.0)
    np.testing.assert_allclose(found.height_um, read_height_map(path).height_um, atol=1e-8)
    assert found.origin["gridded"]["interpolated_share"] == 0.0


@pytest.mark.parametrize(
    ("places", "options", "message"),
    [
        ([(0, 0), (1, 0), (1, 0), (0, 1), (1, 1)], {"grid_um": 0.5}, "1 share a place"),
        ([(0, 0), (1, 1), (2, 2), (3, 3)], {"grid_um": 0.5}, "on one line"),
        ([(0, 0), (1, 0), (0, 1), (1, 1)], {"grid_um": 0.0}, "give a positive step"),
        (
            [(0, 0), (1, 0), (0, 1), (1, 1)],
            {"grid_um": 1e-6},
            "at most 250 million are made; take a larger step",
        ),
        ([(0, 0), (1, 0), (0, 1), (1, 1)], {"grid_um": 5.0}, "at least 2 × 2"),
    ],
)
def test_points_without_a_grid(tmp_path, places, options, message):
    path = points_file(tmp_path / "a.xyz", np.array(places, dtype=float), np.arange(len(places)))
    with pytest.raises(HeightMapError, match=message):
        read_height_map(path, **options)


def test_a_grid_is_for_scattered_points(tmp_path, heights):
    write_height_map(HeightMap(heights, 1.0, 1.0), tmp_path / "a.x3p")
    with pytest.raises(HeightMapError, match="leave --grid out"):
        read_height_map(tmp_path / "a.x3p", grid_um=1.0)
    (tmp_path / "a.csv").write_text("1,2\n3,4\n", encoding="utf-8")
    with pytest.raises(HeightMapError, match="a matrix of heights has one; leave --grid out"):
        read_height_map(tmp_path / "a.csv", pixel_um=(1.0, 1.0), grid_um=1.0)
