import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.load import read_height_map, write_height_map
from anisoscope.profiles.heightmap import HeightMap

PIXEL = (2.0, 1.0)


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def grid_points(rows=4, cols=5, drop=()):
    return [
        (10 + 0.5 * j, 3 + 2.0 * i, 10.0 * i + j)
        for i in range(rows)
        for j in range(cols)
        if (i, j) not in drop
    ]


@pytest.mark.parametrize(
    "text",
    [
        "1.5 2.5 3\n4 nan 6.25\n",
        "1.5,2.5,3\n4,,6.25\n",
        "1.5;2.5;3\n4;;6.25\n",
        "1,5;2,5;3\n4;***;6,25\n",
        "1,5 2,5 3\n4 - 6,25\n",
        "1,5\t2,5\t3\n4\tNaN\t6,25\n",
        "# made by hand\n1.5, 2.5, 3,\n\n4, NaN, 6.25,\n",
        "1.5\t2.5\t3\r\n4\t\t6.25\r\n",
    ],
)
def test_matrices_in_many_dialects(tmp_path, text):
    surface = read_height_map(write(tmp_path / "a.csv", text), pixel_um=PIXEL, layout="matrix")
    np.testing.assert_array_equal(surface.height_um, [[1.5, 2.5, 3.0], [4.0, np.nan, 6.25]])
    assert (surface.pixel_y_um, surface.pixel_x_um) == PIXEL


@pytest.mark.parametrize(("unit", "factor"), [("um", 1.0), ("nm", 1e-3), ("mm", 1e3), ("m", 1e6)])
def test_height_units(tmp_path, unit, factor):
    path = write(tmp_path / "a.txt", "0.001 0.002\n0.003 0.004\n")
    trust = ("heights",) if unit == "nm" else ()  # 3 pm from the lowest to the highest
    surface = read_height_map(path, pixel_um=PIXEL, z_unit=unit, trust=trust)
    np.testing.assert_allclose(surface.height_um, factor * np.array([[1e-3, 2e-3], [3e-3, 4e-3]]))


RIDGE = "0.0 0.004 0.0176 0\n0.001 0.005 0.0170 0\n"


@pytest.mark.parametrize(
    ("text", "asked"),
    [
        (RIDGE, "differ by 0.0176 only, at pixels of 1 µm"),
        ("# heights in mm\n1 2 9 1\n3 4 5 1\n", "names mm"),
        ("% z [nm]\n1 2 9 1\n3 4 5 1\n", "names nm"),
        ("# unit: mm\n1 2 9 1\n3 4 5 1\n", "--z-unit mm"),
    ],
)
def test_a_matrix_that_may_be_in_mm_asks_for_its_unit(tmp_path, text, asked):
    path = write(tmp_path / "a.txt", text)
    with pytest.raises(HeightMapError, match=asked):
        read_height_map(path, pixel_um=(1.0, 1.0))
    assert np.isfinite(read_height_map(path, pixel_um=(1.0, 1.0), z_unit="mm").height_um).all()


@pytest.mark.parametrize(
    "words", ["# heights in µm", "# 2 mm x 2 mm, 10x", "# z (um), after 3 m", "# made in Ulm", ""]
)
def test_a_matrix_in_um_is_not_asked(tmp_path, words):
    path = write(tmp_path / "a.txt", f"{words}\n0 4 17.6 0\n1 5 17 0\n")
    assert read_height_map(path, pixel_um=(1.0, 1.0)).height_um.max() == 17.6


def test_unknown_unit_and_role(tmp_path):
    path = write(tmp_path / "a.txt", "1 2\n3 4\n")
    with pytest.raises(HeightMapError, match="use um, nm, mm or m"):
        read_height_map(path, pixel_um=PIXEL, z_unit="inch")
    with pytest.raises(HeightMapError, match="part or of a tool"):
        read_height_map(path, pixel_um=PIXEL, role="mould")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,5, 2,5\n3,5, 4,5\n", "may be decimal sign or separator"),
        ("1,5;2.5\n3;4\n", "both , and ."),
        ("1 2\n3\n", "line 2: 1 numbers instead of 2"),
        ("1 2\n3 four\n", "line 2: 'four' is no number"),
        ("Dear reader,\nthis is a letter.\n", "line 1: 'Dear'|line 1: 'Dear reader'"),
        ("# nothing\n", "holds no numbers"),
        ("1 2 3\n", "at least 2 × 2"),
        ("nan nan\nnan nan\n", "measured points"),
        ("1 2\n3 99999\n", "largest height"),
    ],
)
def test_text_that_is_no_map(tmp_path, text, message):
    with pytest.raises(HeightMapError, match=message) as caught:
        read_height_map(write(tmp_path / "a.csv", text), pixel_um=PIXEL, layout="matrix")
    assert "\n" not in str(caught.value)


def test_three_columns_are_never_taken_for_a_map(tmp_path):
    text = "\n".join(f"{x} {y} {z}" for x, y, z in grid_points())
    path = write(tmp_path / "a.txt", text)
    for pixel in (None, PIXEL):
        with pytest.raises(HeightMapError, match="--layout xyz or --layout matrix"):
            read_height_map(path, pixel_um=pixel)
    assert read_height_map(path, pixel_um=PIXEL, layout="matrix").shape == (20, 3)
    assert read_height_map(path, layout="xyz").shape == (4, 5)


@pytest.mark.parametrize("shuffled", [False, True])
def test_points_fill_a_grid_with_gaps(tmp_path, shuffled):
    points = grid_points(drop={(1, 1), (2, 3)})
    if shuffled:
        np.random.default_rng(1).shuffle(points)
    text = "x, y, z\n" + "\n".join(f"{x}, {y}, {z}" for x, y, z in points)
    surface = read_height_map(write(tmp_path / "a.xyz", text))
    expected = np.add.outer(10.0 * np.arange(4), np.arange(5))
    expected[1, 1] = expected[2, 3] = np.nan
    np.testing.assert_allclose(surface.height_um, expected)
    assert (surface.pixel_y_um, surface.pixel_x_um) == pytest.approx((2.0, 0.5))


def test_points_with_a_whole_line_missing(tmp_path):
    points = [point for point in grid_points(6, 7) if point[1] != 3 + 2.0 * 2]
    surface = read_height_map(write(tmp_path / "a.xyz", "\n".join(f"{x} {y} {z}" for x, y, z in points)))
    assert surface.shape == (6, 7)
    assert np.isnan(surface.height_um[2]).all()


def test_point_units(tmp_path):
    text = "\n".join(f"{x * 1e-3} {y * 1e-3} {z}" for x, y, z in grid_points())
    surface = read_height_map(write(tmp_path / "a.xyz", text), xy_unit="mm")
    assert surface.pixel_x_um == pytest.approx(0.5)
    assert np.nanmax(surface.height_um) == 34.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: [*p, p[0]], "share a place"),
        (lambda p: [*p[:-1], (p[-1][0] + 0.2, *p[-1][1:])], "steps off"),
        (lambda p: [(0.0, y, z) for _, y, z in p], "single position"),
        (lambda p: [(np.nan, *p[0][1:]), *p[1:]], "x or y"),
    ],
)
def test_points_off_a_grid(tmp_path, change, message):
    text = "\n".join(f"{x} {y} {z}" for x, y, z in change(grid_points()))
    with pytest.raises(HeightMapError, match=message):
        read_height_map(write(tmp_path / "a.xyz", text))


@pytest.mark.parametrize("name", ["a.txt", "a.npy"])
def test_pixel_size_is_asked_for(tmp_path, name):
    if name == "a.npy":
        np.save(tmp_path / name, np.eye(4))
    else:
        write(tmp_path / name, "1 2\n3 4\n")
    with pytest.raises(HeightMapError, match=r"give it in µm with --pixel SIZE or --pixel Y,X"):
        read_height_map(tmp_path / name)


@pytest.mark.parametrize("pixel", [(1e-4, 1.0), (1.0, 2000.0), (999.0, 1.0)])
def test_implausible_pixels_and_fields(tmp_path, pixel):
    np.save(tmp_path / "a.npy", np.zeros((600, 4)))
    with pytest.raises(HeightMapError, match=r"pixel size|field"):
        read_height_map(tmp_path / "a.npy", pixel_um=pixel)


@pytest.mark.parametrize("suffix", [".csv", ".txt", ".npy"])
def test_round_trip_is_exact(tmp_path, suffix):
    rng = np.random.default_rng(2)
    height = rng.normal(0.0, 3.0, (5, 7))
    height[2, 3] = np.nan
    surface = HeightMap(height, 0.7, 1.3)
    write_height_map(surface, tmp_path / f"a{suffix}")
    back = read_height_map(tmp_path / f"a{suffix}", pixel_um=(1.3, 0.7) if suffix == ".npy" else None)
    assert np.array_equal(back.height_um, height, equal_nan=True)
    assert (back.pixel_y_um, back.pixel_x_um) == (1.3, 0.7)


def test_npz_with_one_array(tmp_path):
    np.savez(tmp_path / "a.npz", height=np.eye(3), pixel_um=[2.0, 1.0])
    surface = read_height_map(tmp_path / "a.npz")
    assert (surface.pixel_y_um, surface.pixel_x_um) == PIXEL
    np.savez(tmp_path / "one.npz", height=np.eye(3), pixel_um=0.5)
    assert read_height_map(tmp_path / "one.npz").pixel_y_um == 0.5
    np.savez(tmp_path / "b.npz", a=np.eye(3), b=np.eye(3))
    with pytest.raises(HeightMapError, match="one array"):
        read_height_map(tmp_path / "b.npz", pixel_um=PIXEL)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.array([[{}, 1], [2, 3]], dtype=object), "never read"),
        (np.zeros(5), "two dimensions"),
        (np.zeros((3, 3), complex), "integers or floating"),
        (np.full((3, 3), np.inf), "measured points"),
    ],
)
def test_arrays_that_are_no_map(tmp_path, array, message):
    np.save(tmp_path / "a.npy", array, allow_pickle=True)
    with pytest.raises(HeightMapError, match=message):
        read_height_map(tmp_path / "a.npy", pixel_um=PIXEL)


def test_fortran_order_and_integers(tmp_path):
    np.save(tmp_path / "a.npy", np.asfortranarray(np.arange(6, dtype=">i2").reshape(2, 3)))
    surface = read_height_map(tmp_path / "a.npy", pixel_um=PIXEL)
    np.testing.assert_array_equal(surface.height_um, [[0, 1, 2], [3, 4, 5]])


def test_a_tool_is_the_negative_of_the_part(tmp_path):
    np.save(tmp_path / "a.npy", np.array([[0.0, 1.0, 5.0], [2.0, np.nan, -3.0]]))
    part = read_height_map(tmp_path / "a.npy", pixel_um=PIXEL, role="tool")
    np.testing.assert_array_equal(part.height_um, [[-5.0, -1.0, 0.0], [3.0, np.nan, -2.0]])
    assert part.origin["role"] == "tool"


def test_files_that_cannot_be_dispatched(tmp_path):
    for name, data, message in (
        ("a.obj", b"solid", r"unknown extension '.obj'; read are .x3p"),
        ("a.x3p", b"hello", "does not look like"),
        ("a.npy", b"1 2 3", "does not look like"),
        ("a.txt", b"", "is empty"),
        ("a.csv", b"1\0\0\0", "binary"),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(HeightMapError, match=message):
            read_height_map(tmp_path / name, pixel_um=None)
    for path in (tmp_path / "none.x3p", tmp_path):
        with pytest.raises(HeightMapError, match="cannot be read"):
            read_height_map(path)
    with pytest.raises(HeightMapError, match="written are"):
        write_height_map(HeightMap(np.eye(3), 1.0, 1.0), tmp_path / "a.plu")
    with pytest.raises(HeightMapError, match="cannot be written"):
        write_height_map(HeightMap(np.eye(3), 1.0, 1.0), tmp_path / "none" / "a.x3p")


def test_provenance_travels_with_the_map(tmp_path):
    np.save(tmp_path / "a.npy", np.array([[0.0, 1.0], [2.0, np.nan]]))
    origin = read_height_map(tmp_path / "a.npy", pixel_um=PIXEL).origin
    assert origin["file"] == "a.npy"
    assert origin["format"] == "npy"
    assert origin["pixel_um"] == [2.0, 1.0]
    assert origin["missing_share"] == 0.25
    assert len(origin["sha256"]) == 64


@pytest.mark.parametrize(
    "header",
    [
        "X (mm)\tY (mm)\tZ (um)",
        "x [mm], y [mm], z [µm]",
        "X (mm) Y (mm) Z (um)",
        "x_mm;y_mm;z_um",
        '"X / mm","Y / mm","Z / um"',
    ],
)
def test_units_of_a_header_are_meant(tmp_path, header):
    separator = next((one for one in ("\t", ",", ";") if one in header), " ")
    rows = [f"{0.5 * x:g}{separator}{0.25 * y:g}{separator}{x + 2 * y:g}" for y in range(4) for x in range(5)]
    path = tmp_path / "points.xyz"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    found = read_height_map(path)
    assert (found.pixel_x_um, found.pixel_y_um) == (500.0, 250.0)
    assert found.height_um[3, 4] == 10.0
    with pytest.raises(HeightMapError, match="the header states mm, not nm; leave --xy-unit out"):
        read_height_map(path, xy_unit="nm")


def test_a_header_of_other_units_is_refused(tmp_path):
    path = tmp_path / "points.xyz"
    path.write_text("x (px), y (px), z (um)\n0,0,1\n1,0,2\n0,1,3\n1,1,4\n")
    with pytest.raises(
        HeightMapError, match=r"column x: 'px' is no unit of length; take the line out.*--xy-unit"
    ):
        read_height_map(path)


def test_axes_of_a_matrix_are_no_heights(tmp_path):
    path = tmp_path / "labelled.csv"
    path.write_text(",0,0.5,1,1.5\n0,1.1,1.2,1.3,1.0\n0.25,2.1,2,2.5,2.2\n0.5,3,3.3,3.1,3\n")
    with pytest.raises(HeightMapError, match=r"rise by 0\.5 and 0\.25.*--xy-unit.*--layout matrix"):
        read_height_map(path)
    for given in ({"xy_unit": "mm"}, {"pixel_um": (250.0, 500.0)}):
        found = read_height_map(path, **given)
        assert found.shape == (3, 4)
        assert (found.pixel_x_um, found.pixel_y_um) == (500.0, 250.0)
        assert found.height_um[0].tolist() == [1.1, 1.2, 1.3, 1.0]
        assert "first row and column are axes" in found.origin["corrected"]
    assert read_height_map(path, pixel_um=(1.0, 1.0), layout="matrix").shape == (4, 5)


@pytest.mark.parametrize("code", [-9999.0, 0.0, -1.0, 9999.0])
def test_a_code_for_missing_points_is_asked_about(tmp_path, code):
    rng = np.random.default_rng(3)
    heights = 440.0 + 80.0 * rng.random((40, 50))
    heights[rng.random(heights.shape) < 0.05] = code
    path = tmp_path / "coded.txt"
    np.savetxt(path, heights, fmt="%.4f")
    with pytest.raises(
        HeightMapError, match=rf"{code:g} stands \d+ times.*--missing {code:g}; .*--trust heights"
    ):
        read_height_map(path, pixel_um=(1.0, 1.0))
    found = read_height_map(path, pixel_um=(1.0, 1.0), missing=(code,))
    assert np.isnan(found.height_um).sum() == (heights == code).sum()
    assert np.nanmin(found.height_um) > 439.0
    kept = read_height_map(path, pixel_um=(1.0, 1.0), trust=("heights",))
    assert kept.missing_share == 0.0
    assert "stands" in kept.origin["trusted"][0]


def test_a_staircase_and_a_single_spike_are_surfaces(tmp_path):
    path = tmp_path / "steps.txt"
    stairs = np.repeat(np.arange(6.0), 20)[None, :] * np.ones((20, 1))
    spike = np.random.default_rng(4).random((30, 30))
    spike[3, 4] = 60.0
    for heights in (stairs, spike):
        np.savetxt(path, heights, fmt="%.4f")
        np.testing.assert_allclose(read_height_map(path, pixel_um=(1.0, 1.0)).height_um, heights, atol=1e-4)


def test_codes_for_missing_points_are_for_text(tmp_path):
    path = tmp_path / "map.npy"
    np.save(path, np.arange(12.0).reshape(3, 4))
    with pytest.raises(HeightMapError, match="leave --missing out"):
        read_height_map(path, pixel_um=(1.0, 1.0), missing=(-1.0,))
