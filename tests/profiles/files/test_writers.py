"""What is written comes back, and other programs can read it."""

import struct
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.profiles.files.library import read_library
from anisoscope.profiles.files.load import WRITERS, read_height_map, write_height_map
from anisoscope.profiles.files.x3p import read_x3p, write_x3p
from anisoscope.profiles.heightmap import HeightMap


def some_map(seed=0):
    rng = np.random.default_rng(seed)
    height = rng.normal(0.0, 5.0, (13, 21))
    height[rng.random(height.shape) < 0.1] = np.nan
    return HeightMap(height, 1.37, 0.731, {"file": "part.plu"})


@pytest.mark.parametrize("text", [False, True])
@settings(deadline=None, derandomize=True, max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(
    values=st.lists(
        st.one_of(st.floats(-9999.0, 9999.0), st.floats(-1e-3, 1e-3), st.just(float("nan"))),
        min_size=12,
        max_size=12,
    )
)
def test_x3p_gives_every_bit_back(tmp_path_factory, text, values):
    height = np.array(values).reshape(3, 4)
    height[np.abs(height) < 1e-290] = 0.25  # metres of these are beyond float64
    height[0, 0] = 1.0
    path = tmp_path_factory.mktemp("x3p") / "a.x3p"
    write_x3p(HeightMap(height, 1.0, 1.0), path, text=text)
    found = read_x3p(path).height_um
    known = ~np.isnan(height)
    assert np.array_equal(np.isnan(found), ~known)
    assert np.array_equal(found[known].view(np.int64), height[known].view(np.int64))


@pytest.mark.parametrize("suffix", sorted(WRITERS))
def test_every_format_comes_back(tmp_path, suffix):
    surface = some_map()
    if suffix == ".exr":
        pytest.importorskip("OpenEXR")
    write_height_map(surface, tmp_path / f"a{suffix}")
    options = {"pixel_um": (0.731, 1.37)} if suffix == ".npy" else {}
    found = read_height_map(tmp_path / f"a{suffix}", **options)
    digits = 6e-8 if suffix == ".sur" else 1e-14
    assert (found.pixel_y_um, found.pixel_x_um) == pytest.approx((0.731, 1.37), rel=digits)
    bits = {".gsf": 24, ".exr": 24, ".tif": 24, ".tiff": 24, ".gwy": 51, ".sur": 0, ".png": 0}.get(suffix, 53)
    assert np.array_equal(np.isnan(found.height_um), np.isnan(surface.height_um))
    if bits == 53:
        assert np.array_equal(found.height_um, surface.height_um, equal_nan=True)
    if bits == 0:  # whole numbers of a step
        step = {".sur": 20.0 * 2.0**-31, ".png": 31.0 * 2.0**-16}[suffix]
        np.testing.assert_allclose(found.height_um, surface.height_um, atol=0.51 * step)
    else:
        np.testing.assert_allclose(found.height_um, surface.height_um, rtol=2.0 ** (1 - bits))


@pytest.mark.parametrize("suffix", [".sur", ".gwy"])
def test_an_independent_reader_reads_our_sur_and_gwy(tmp_path, suffix):
    surface = some_map()
    write_height_map(surface, tmp_path / f"a{suffix}")
    found = read_library(tmp_path / f"a{suffix}", key=suffix[1:])
    assert found.origin["reader"].startswith("SurfaceTopography")
    assert (found.pixel_y_um, found.pixel_x_um) == pytest.approx((0.731, 1.37), rel=6e-8)
    from_top = surface.height_um[::-1]
    assert np.array_equal(np.isnan(found.height_um), np.isnan(from_top))
    np.testing.assert_allclose(found.height_um, from_top, atol=2e-8)


@pytest.mark.parametrize("suffix", [".stl", ".ply"])
def test_meshes_are_the_surface_in_mm_for_an_independent_reader(tmp_path, suffix):
    pyvista = pytest.importorskip("pyvista")
    surface = some_map()
    write_height_map(surface, tmp_path / f"a{suffix}")
    mesh = pyvista.read(tmp_path / f"a{suffix}")
    known = np.isfinite(surface.height_um)
    squares = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    assert mesh.n_cells == 2 * np.count_nonzero(squares)
    projected = mesh.points[mesh.faces.reshape(-1, 4)[:, 1:]]
    (ax, ay), (bx, by) = ((projected[:, k, :2] - projected[:, 0, :2]).T.astype(float) for k in (1, 2))
    area = 0.5 * (ax * by - ay * bx)
    assert area.min() > 0.0  # all seen from above
    assert area.sum() == pytest.approx(np.count_nonzero(squares) * 1.37 * 0.731 * 1e-6, rel=1e-5)
    i, j = np.nonzero(known)
    expected = np.stack([j * 1.37, i * 0.731, surface.height_um[known]], axis=1) * 1e-3
    for point in np.asarray(mesh.points, dtype=float)[::17]:
        assert np.abs(expected - point).max(axis=1).min() < 1e-8


def test_a_mesh_of_too_many_points_or_of_none_is_refused(tmp_path):
    large = HeightMap(np.broadcast_to(np.zeros(3000), (2000, 3000)), 1.0, 1.0)
    with pytest.raises(HeightMapError, match="at most 5 million"):
        write_height_map(large, tmp_path / "a.stl")
    holes = np.zeros((4, 4))
    holes[::2] = np.nan
    with pytest.raises(HeightMapError, match="nothing to mesh"):
        write_height_map(HeightMap(holes, 1.0, 1.0), tmp_path / "a.ply")


def test_bytes_of_a_sur_file(tmp_path):
    """Positions of the fields as Digital Surf's format has them."""
    surface = HeightMap(
        np.array([[0.0, 1.0, 2.0], [3.0, np.nan, -5.0]]), 0.25, 0.5, {"date": "2024-02-03T04:05:06"}
    )
    write_height_map(surface, tmp_path / "a.sur")
    data = (tmp_path / "a.sur").read_bytes()
    assert data[:12] == b"DIGITAL SURF"
    objects, version, kind = struct.unpack_from("<HHH", data, 14)
    assert (objects, version, kind) == (1, 1, 2)
    special, bits = struct.unpack_from("<H", data, 86)[0], struct.unpack_from("<H", data, 98)[0]
    low, high, cols, rows, points = struct.unpack_from("<iiiiI", data, 100)
    assert (special, bits, cols, rows, points) == (1, 32, 3, 2, 6)
    step_x, step_y, step_z = struct.unpack_from("<fff", data, 120)
    assert (step_x, step_y) == (0.25, 0.5)
    assert data[180:196].rstrip(b"\0") == "µm".encode("latin-1")
    raw = np.frombuffer(data, "<i4", 6, 512).reshape(2, 3)[::-1]
    assert raw[1, 1] == low - 2
    assert high == raw.max()
    np.testing.assert_allclose(raw[0] * step_z, [0.0, 1.0, 2.0], atol=1e-8)
    assert struct.unpack_from("<HHHHHH", data, 306) == (6, 5, 4, 3, 2, 2024)


def test_an_independent_reader_reads_our_x3p(tmp_path):
    surface = some_map()
    write_height_map(surface, tmp_path / "a.x3p")
    found = read_library(tmp_path / "a.x3p", key="x3p")
    assert (found.pixel_y_um, found.pixel_x_um) == pytest.approx((0.731, 1.37), rel=1e-12)
    assert np.array_equal(np.isnan(found.height_um), np.isnan(surface.height_um))
    np.testing.assert_allclose(found.height_um, surface.height_um, rtol=1e-15)


def test_ulps_of_other_data_are_not_added(tmp_path):
    import zipfile

    write_x3p(some_map(1), tmp_path / "a.x3p")
    write_x3p(some_map(2), tmp_path / "b.x3p")
    with zipfile.ZipFile(tmp_path / "a.x3p") as a, zipfile.ZipFile(tmp_path / "b.x3p") as b:
        mixed = {name: a.read(name) for name in a.namelist()}
        mixed["anisoscope/ulps.bin"] = b.read("anisoscope/ulps.bin")
    with zipfile.ZipFile(tmp_path / "c.x3p", "w") as c:
        for name, data in mixed.items():
            c.writestr(name, data)
    found, true = read_x3p(tmp_path / "c.x3p").height_um, some_map(1).height_um
    assert not np.array_equal(found, true, equal_nan=True)
    np.testing.assert_array_almost_equal_nulp(np.nan_to_num(found), np.nan_to_num(true), 1)


def test_gsf_and_tiff_begin_at_the_top(tmp_path):
    import tifffile

    surface = some_map()
    write_height_map(surface, tmp_path / "a.tif")
    write_height_map(surface, tmp_path / "a.gsf")
    top = surface.height_um[-1].astype(np.float32)
    assert np.array_equal(tifffile.imread(tmp_path / "a.tif")[0], top, equal_nan=True)
    data = (tmp_path / "a.gsf").read_bytes()
    assert data.startswith(b"Gwyddion Simple Field 1.0\nXRes = 21\nYRes = 13\n")
    assert len(data) % 4 == 0
    first = np.frombuffer(data[-13 * 21 * 4 :], "<f4")[:21] * 1e6
    np.testing.assert_allclose(first, surface.height_um[-1], rtol=1e-6)


def test_convert_overwrites_only_on_purpose(tmp_path):
    from anisoscope.cli.profile.profile import app

    def run(*arguments):
        return app([str(a) for a in arguments], exit_on_error=False, print_error=False,
                   result_action="return_value")  # fmt: skip

    write_height_map(some_map(), tmp_path / "a.x3p")
    assert run("convert", tmp_path / "a.x3p", tmp_path / "b.npz") == 0
    with pytest.raises(UsageError, match="--overwrite"):
        run("convert", tmp_path / "a.x3p", tmp_path / "b.npz")
    assert run("convert", tmp_path / "b.npz", tmp_path / "b.npz", "--overwrite", "--role", "tool") == 0
    found = read_height_map(tmp_path / "b.npz").height_um
    assert np.array_equal(found, -some_map().height_um[:, ::-1], equal_nan=True)
    with pytest.raises(HeightMapError, match="written are"):
        run("convert", tmp_path / "a.x3p", tmp_path / "b.plu")


def test_the_library_is_never_imported_here(tmp_path, made_files, heights):
    """A process of its own: another test may have loaded the library as its reference."""
    made_files["al3d"].write(tmp_path / "a.al3d", heights)
    script = (
        "import sys; from anisoscope.profiles.files.load import read_height_map; "
        "read_height_map(sys.argv[1]); sys.exit('SurfaceTopography' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", script, str(tmp_path / "a.al3d")],
        check=False,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
