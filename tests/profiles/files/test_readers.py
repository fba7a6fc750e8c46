"""Readers of instruments' formats on made files; what the user must say; where a map comes from."""

import hashlib
import struct
import zipfile
import zlib

import numpy as np
import pytest
import tifffile

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.formats import all_formats
from anisoscope.profiles.files.load import read_height_map, write_height_map
from anisoscope.profiles.files.plain_grids import read_nms
from anisoscope.profiles.heightmap import HeightMap


def centred(height):
    return height - np.nanmean(height)


def write(made, path, height):
    made.write(path, height)
    return path


def test_made_file_gives_its_heights_pixel_and_gaps_with_y_rising(made, tmp_path, heights):
    path = write(made, tmp_path / f"a{made.suffix}", heights)
    surface = read_height_map(path, **made.options)
    expected = heights if made.missing else np.nan_to_num(heights)
    expected = expected[::-1] if made.first_row == "top" else expected
    assert (surface.pixel_y_um, surface.pixel_x_um) == pytest.approx(made.pixel, rel=1e-6)
    assert np.array_equal(np.isnan(surface.height_um), np.isnan(expected))
    np.testing.assert_allclose(centred(surface.height_um), centred(expected), atol=1e-5)
    assert surface.origin["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert surface.origin["file"] == path.name
    assert surface.origin["role"] == "part"
    assert surface.origin["missing_share"] == surface.missing_share
    assert surface.origin["reader"].startswith("SurfaceTopography" if made.library else "anisoscope")
    assert any("rows turned" in entry for entry in surface.origin.get("corrected", [])) == (
        made.first_row == "top" or made.suffix in (".gsf", ".tif", ".exr")
    )


def test_rows_and_role_turn_the_map_and_say_so(made_own, tmp_path, heights):
    path = write(made_own, tmp_path / f"a{made_own.suffix}", heights)
    up = read_height_map(path, rows="up", **made_own.options)
    down = read_height_map(path, rows="down", **made_own.options)
    tool = read_height_map(path, rows="up", role="tool", **made_own.options)
    assert np.array_equal(down.height_um, up.height_um[::-1], equal_nan=True)
    assert np.array_equal(tool.height_um, -up.height_um[:, ::-1], equal_nan=True)
    assert "corrected" not in up.origin or "rows turned" not in str(up.origin["corrected"])
    assert "from the tool to the part" in str(tool.origin["corrected"])


def test_a_file_that_states_its_pixel_takes_no_other(made, tmp_path, heights):
    if made.options or made.suffix in (".npz", ".csv", ".txt", ".tif"):
        return  # these ask for scales, or let the user overrule a note
    path = write(made, tmp_path / f"a{made.suffix}", heights)
    with pytest.raises(HeightMapError, match="leave the pixel size"):
        read_height_map(path, pixel_um=(1.0, 1.0))
    if made.suffix != ".xyz":
        with pytest.raises(HeightMapError, match="states its own"):
            read_height_map(path, z_unit="nm")
    with pytest.raises(HeightMapError, match="height per count"):
        read_height_map(path, height_per_count=0.1)


def test_a_file_without_a_telling_extension_is_read_by_its_first_bytes(made, tmp_path, heights):
    named = write(made, tmp_path / f"a{made.suffix}", heights)
    unnamed = named.rename(tmp_path / "measurement.bin")
    by_content = any(entry.begins(unnamed.read_bytes()[:64]) for entry in all_formats()) or made.library
    if made.suffix in (".x3p", ".npz", ".plux") or (by_content and made.suffix != ".datx"):
        assert read_height_map(unnamed, **made.options).shape == heights.shape
    else:
        with pytest.raises(HeightMapError, match=r"unknown extension '.bin'; read are .x3p, .*\.sur"):
            read_height_map(unnamed, **made.options)


def test_a_content_that_belongs_to_another_extension_is_refused(tmp_path, heights):
    write_height_map(HeightMap(heights, 1.0, 1.0), tmp_path / "a.gsf")
    for suffix in (".x3p", ".sdf", ".png", ".opd", ".csv"):
        wrong = tmp_path / f"b{suffix}"
        wrong.write_bytes((tmp_path / "a.gsf").read_bytes())
        with pytest.raises(HeightMapError, match=r"does not look like .* but like Gwyddion simple field"):
            read_height_map(wrong)


def test_pictures_ask_for_their_scales_and_ignore_resolution_tags(tmp_path):
    picture = np.arange(12, dtype=np.uint16).reshape(3, 4)
    tifffile.imwrite(tmp_path / "a.tif", picture, resolution=(1e4, 1e4), resolutionunit="CENTIMETER")
    tifffile.imwrite(tmp_path / "b.tif", picture.astype(np.float32), metadata=None)
    with pytest.raises(HeightMapError, match="--pixel"):
        read_height_map(tmp_path / "a.tif", height_per_count=1.0)
    with pytest.raises(HeightMapError, match="--height-per-count"):
        read_height_map(tmp_path / "a.tif", pixel_um=(2.0, 2.0))
    with pytest.raises(HeightMapError, match="counts have no unit"):
        read_height_map(tmp_path / "a.tif", pixel_um=(2.0, 2.0), z_unit="nm")
    with pytest.raises(HeightMapError, match="--z-unit"):
        read_height_map(tmp_path / "b.tif", pixel_um=(2.0, 2.0))
    counts = read_height_map(tmp_path / "a.tif", pixel_um=(3.0, 2.0), height_per_count=25.0, z_unit="nm")
    assert (counts.pixel_y_um, counts.pixel_x_um) == (3.0, 2.0)
    np.testing.assert_allclose(counts.height_um, 0.025 * picture[::-1], rtol=1e-12)
    floats = read_height_map(tmp_path / "b.tif", pixel_um=(2.0, 2.0), z_unit="nm")
    np.testing.assert_allclose(floats.height_um, 1e-3 * picture[::-1], rtol=1e-12)


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (np.zeros((3, 4), np.uint8), "16 bits or more"),
        (np.zeros((3, 4, 3), np.uint16), "one channel"),
        (np.zeros((2, 3, 4), np.uint16), "pages|one channel"),
    ],
)
def test_pictures_that_are_no_height_maps(tmp_path, picture, message):
    tifffile.imwrite(tmp_path / "a.tif", picture)
    with pytest.raises(HeightMapError, match=message):
        read_height_map(tmp_path / "a.tif", pixel_um=(1.0, 1.0), height_per_count=1.0)


def test_png_of_8_bits_is_refused(tmp_path):
    import cv2

    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((3, 4), np.uint8))
    with pytest.raises(HeightMapError, match="8 bits"):
        read_height_map(tmp_path / "a.png", pixel_um=(1.0, 1.0), height_per_count=1.0)


def test_heights_counted_from_a_stage_are_centred_and_said(tmp_path, heights):
    texts = "\n".join(" ".join(repr(z + 76_000.0) for z in row) for row in np.nan_to_num(heights).tolist())
    rows, cols = heights.shape
    (tmp_path / "a.sdf").write_text(
        f"aISO-1.0\nNumPoints = {cols}\nNumProfiles = {rows}\nXscale = 1E-6\nYscale = 1E-6\nZscale = 1E-6\n"
        f"Compression = 0\nDataType = 7\nCheckType = 0\n*\n{texts}\n*\n"
    )
    surface = read_height_map(tmp_path / "a.sdf")
    np.testing.assert_allclose(centred(surface.height_um), centred(np.nan_to_num(heights)), atol=1e-9)
    assert "heights counted from" in surface.origin["corrected"][0]
    (tmp_path / "a.sdf").write_text(
        (tmp_path / "a.sdf").read_text().replace("Zscale = 1E-6", "Zscale = 1E-3")
    )
    with pytest.raises(HeightMapError, match="largest height"):
        read_height_map(tmp_path / "a.sdf")


def test_steps_of_nms_are_nanometres_and_other_versions_are_refused(tmp_path, heights, made_files):
    made_files["nms"].write(tmp_path / "a.nms", heights)
    assert read_nms(tmp_path / "a.nms").pixel_x_um == 0.25
    data = bytearray((tmp_path / "a.nms").read_bytes())
    struct.pack_into("<d", data, 1376, 0.25e-3)  # the same step, had the field been millimetres
    (tmp_path / "a.nms").write_bytes(bytes(data))
    with pytest.raises(HeightMapError, match="pixel size along x"):
        read_nms(tmp_path / "a.nms")
    (tmp_path / "a.nms").write_bytes(bytes(data).replace(b"OM_MS_2.0", b"OM_MS_3.0"))
    with pytest.raises(HeightMapError, match=r"OM_MS_2\.0 is known"):
        read_nms(tmp_path / "a.nms")


def test_text_sdf_with_comments_and_marks_of_missing_points(tmp_path):
    (tmp_path / "a.sdf").write_text(
        "aBCR-1.0\r\nManufacID = x ; a comment\r\nNumPoints = 3\r\nNumProfiles = 2\r\nXscale = 1e-6\r\n"
        "Yscale = 2e-6\r\nZscale = 1e-9\r\nCompression = 0\r\nDataType = 7\r\nCheckType = 0\r\n*\r\n"
        "1 2 BAD\r\n-1.797693E+308 5 nan\r\n*\r\n"
    )
    surface = read_height_map(tmp_path / "a.sdf")
    expected = np.array([[1e-3, 2e-3, np.nan], [np.nan, 5e-3, np.nan]])
    np.testing.assert_allclose(surface.height_um, expected[::-1])  # BCR begins at the top
    assert (surface.pixel_y_um, surface.pixel_x_um) == pytest.approx((2.0, 1.0), rel=1e-12)


@pytest.mark.parametrize("code", [1, 5, 7])
def test_revisions_of_binary_sdf_differ_in_counts_and_marks(tmp_path, code):
    kind = np.dtype({1: "<u2", 5: "<i2", 7: "<f8"}[code])
    raw = np.array([[1, 2, 3], [4, 5, 6]], kind)
    tail = struct.pack("<4dBBB", 1e-6, 2e-6, 1e-6, -1.0, 0, code, 0)
    for version, counts, mark in (
        ("ISO-2.0", "<II", "min"),
        ("ISO-1.0", "<HH", "min"),
        ("BCR-1.0", "<HH", "max"),
    ):
        limits = np.finfo(kind) if kind.kind == "f" else np.iinfo(kind)
        raw[0, 2] = getattr(limits, "max" if kind.kind == "u" else mark)
        head = f"b{version}".encode() + bytes(34) + struct.pack(counts, 3, 2)
        (tmp_path / "a.sdf").write_bytes(head + tail + raw.tobytes())
        found = read_height_map(tmp_path / "a.sdf", rows="up").height_um
        np.testing.assert_allclose(found, [[1, 2, np.nan], [4, 5, 6]])


@pytest.mark.parametrize(("resolution", "steps"), [(0, 4096), (1, 32768), (2, 131072)])
def test_phase_resolution_and_sign_of_metropro(tmp_path, heights, made_files, resolution, steps):
    made_files["metropro"].write(tmp_path / "a.dat", heights)
    data = bytearray((tmp_path / "a.dat").read_bytes())
    struct.pack_into(">h", data, 218, resolution)
    struct.pack_into(">h", data, 232, 1)
    (tmp_path / "a.dat").write_bytes(bytes(data))
    surface = read_height_map(tmp_path / "a.dat")
    np.testing.assert_allclose(surface.height_um, -heights[::-1] * 32768 / steps, atol=1e-4)


def test_text_cut_at_a_line_end_is_noticed_where_the_size_is_noted(tmp_path, heights):
    write_height_map(HeightMap(heights, 1.0, 1.0), tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines(keepends=True)
    (tmp_path / "a.csv").write_text("".join(lines[:-2]))
    with pytest.raises(HeightMapError, match="10 × 17 heights where 12 × 17 are noted"):
        read_height_map(tmp_path / "a.csv")


def test_a_map_of_the_library_names_channel_and_reader(tmp_path, heights, made_files):
    made_files["al3d"].write(tmp_path / "a.al3d", heights)
    origin = read_height_map(tmp_path / "a.al3d").origin
    assert origin["channel"]
    assert origin["reader"].startswith("SurfaceTopography 1.")


def test_a_gwy_file_without_a_channel_in_lengths_says_why(tmp_path, heights, made_files):
    made_files["gwy"].write(tmp_path / "a.gwy", heights)
    assert read_height_map(tmp_path / "a.gwy").origin["channel"] == "made"
    data = (tmp_path / "a.gwy").read_bytes()
    (tmp_path / "a.gwy").write_bytes(data.replace(b"unitstr\0sm\0", b"unitstr\0sV\0"))
    with pytest.raises(HeightMapError, match=r"a\.gwy: content: channel 0 has 'V' as the unit of x and y"):
        read_height_map(tmp_path / "a.gwy")
    (tmp_path / "a.gwy").write_bytes(data.replace(b"si_unit_z", b"si_unit_q"))
    with pytest.raises(HeightMapError, match="channel 0 has no unit of heights"):
        read_height_map(tmp_path / "a.gwy")


def test_a_png_with_right_checksums_and_too_few_rows_is_refused(tmp_path):
    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", 4, 3, 16, 0, 0, 0, 0)
    for rows in (2, 3, 4):
        data = zlib.compress(bytes(rows * (1 + 2 * 4)))
        content = chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
        (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + content)
        if rows == 3:
            assert read_height_map(tmp_path / "a.png", pixel_um=(1, 1), height_per_count=1.0).shape == (3, 4)
        else:
            with pytest.raises(HeightMapError, match="bytes instead of 27"):
                read_height_map(tmp_path / "a.png", pixel_um=(1, 1), height_per_count=1.0)


def test_a_note_of_the_pixel_that_is_no_number_is_no_note(tmp_path):
    note = "heights in um; pixel_um (y, x): 0.E, 1.0"
    tifffile.imwrite(tmp_path / "a.tif", np.eye(4, dtype=np.float32), description=note, metadata=None)
    with pytest.raises(HeightMapError, match="--pixel"):
        read_height_map(tmp_path / "a.tif")


def test_pictures_in_an_x3p_container_are_named(tmp_path, heights):
    path = tmp_path / "a.x3p"
    write_height_map(HeightMap(heights, 1.0, 1.0), path)
    assert "not_read" not in read_height_map(path).origin
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("bindata/texture\n.jpg", b"x")
    assert read_height_map(path).origin["not_read"] == ["picture texture.jpg"]
