import hashlib
import io
import os
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.load import read_height_map, write_height_map
from anisoscope.profiles.files.x3p import read_x3p, write_x3p
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.textures.amplitude import amplitude

DEFAULT = Path(__file__).resolve().parents[3].parent / "shared" / "data" / "heightmaps"
DATA = Path(os.environ.get("ANISOSCOPE_TEST_DATA", DEFAULT))
REAL = [
    ("opengps_ski.x3p", (940, 1197), (3.680270397, 3.678887926), 4272, 18.155),
    ("opengps_rubber.x3p", (634, 860), (2.279794519, 2.279984215), 5296, 3.39887),
    ("digitalsurf_ridged.x3p", (650, 650), (0.314582113527746, 0.127656509837346), 0, 0.07728),
]


def some_map(rows=13, cols=21, seed=0, missing=0.1):
    rng = np.random.default_rng(seed)
    height = rng.normal(0.0, 5.0, (rows, cols))
    height[rng.random((rows, cols)) < missing] = np.nan
    return HeightMap(height, 1.37, 0.731, {"instrument": {"model": "<A & B>"}, "date": "2024-02-03T04:05:06"})


def entries(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def pack(path, content):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return path


def document(rows, cols, z="D", *, data="", cx="<Increment>1E-6</Increment>", cz=""):
    return (
        "<p:ISO5436_2 xmlns:p='http://www.opengps.eu/2008/ISO5436_2'>"
        "<Record1><FeatureType>SUR</FeatureType><Axes>"
        f"<CX><AxisType>I</AxisType>{cx}</CX><CY><AxisType>I</AxisType><Increment>2E-6</Increment></CY>"
        f"<CZ><AxisType>A</AxisType><DataType>{z}</DataType>{cz}</CZ></Axes></Record1><Record3>"
        f"<MatrixDimension><SizeX>{cols}</SizeX><SizeY>{rows}</SizeY><SizeZ>N/A</SizeZ></MatrixDimension>"
        f"{data or '<DataLink><PointDataLink>bindata/data.bin</PointDataLink></DataLink>'}"
        "</Record3></p:ISO5436_2>"
    ).encode()


@pytest.mark.realdata
@pytest.mark.parametrize(("name", "shape", "pixel", "missing", "sq"), REAL)
def test_real_files_match_independent_readers(name, shape, pixel, missing, sq):
    if not (DATA / name).exists():
        pytest.skip(f"{DATA / name} is not there")
    surface = read_height_map(DATA / name)
    assert surface.shape == shape
    assert (surface.pixel_y_um, surface.pixel_x_um) == pytest.approx(pixel, rel=1e-9)
    assert np.count_nonzero(np.isnan(surface.height_um)) == missing
    assert amplitude(surface).sq_um == pytest.approx(sq, rel=1e-4)
    assert surface.origin["checksum"] == "verified"
    assert surface.origin["sha256"] == hashlib.sha256((DATA / name).read_bytes()).hexdigest()


@pytest.mark.parametrize("text", [False, True])
def test_written_once_within_one_ulp_and_from_then_on_exact(tmp_path, text):
    surface = some_map()
    write_x3p(surface, tmp_path / "a.x3p", text=text)
    first = read_x3p(tmp_path / "a.x3p")
    write_x3p(first, tmp_path / "b.x3p", text=text)
    second = read_x3p(tmp_path / "b.x3p")
    np.testing.assert_array_almost_equal_nulp(
        np.nan_to_num(first.height_um), np.nan_to_num(surface.height_um), 1
    )
    assert np.array_equal(np.isnan(first.height_um), np.isnan(surface.height_um))
    assert np.array_equal(first.height_um, second.height_um, equal_nan=True)
    assert (tmp_path / "a.x3p").read_bytes() == (tmp_path / "b.x3p").read_bytes()
    assert (first.pixel_x_um, first.pixel_y_um) == (1.37, 0.731)
    assert first.origin["instrument"]["model"] == "<A & B>"
    assert first.origin["date"] == "2024-02-03T04:05:06"


@pytest.mark.parametrize(("code", "kind"), [("I", "<i2"), ("L", "<i4"), ("F", "<f4"), ("D", "<f8")])
def test_data_types_with_scale_offset_and_mask(tmp_path, code, kind):
    raw = np.arange(-6, 6).reshape(3, 4).astype(kind)
    valid = np.ones(12, bool)
    valid[[1, 9]] = False
    link = (
        "<DataLink><PointDataLink>bindata/data.bin</PointDataLink>"
        "<ValidPointsLink>bindata/valid.bin</ValidPointsLink></DataLink>"
    )
    cz = "<Increment>2E-6</Increment><Offset>1E-6</Offset>"
    content = {
        "main.xml": document(3, 4, code, data=link, cz=cz),
        "bindata/data.bin": raw.tobytes(),
        "bindata/valid.bin": np.packbits(valid, bitorder="little").tobytes(),
    }
    surface = read_x3p(pack(tmp_path / "a.x3p", content))
    expected = np.where(valid.reshape(3, 4), raw.astype(float) * 2.0 + 1.0, np.nan)
    np.testing.assert_allclose(surface.height_um, expected, rtol=1e-12)
    assert (surface.pixel_y_um, surface.pixel_x_um) == (2.0, 1.0)
    assert surface.origin["checksum"] == "no checksum file"


def test_integer_heights_without_a_step_are_refused(tmp_path):
    content = {"main.xml": document(3, 4, "I"), "bindata/data.bin": bytes(24)}
    with pytest.raises(HeightMapError, match="increment of CZ"):
        read_x3p(pack(tmp_path / "a.x3p", content))


def test_folder_in_the_container_and_metadata_that_say_nothing(tmp_path):
    write_x3p(some_map(), tmp_path / "a.x3p")
    content = entries(tmp_path / "a.x3p")
    record = b"<Record2><Date>N/A</Date><Instrument><Model>N/A</Model></Instrument></Record2>"
    main = content["main.xml"]
    main = main[: main.index(b"<Record2>")] + record + main[main.index(b"<Record3>") :]
    content["main.xml"] = main
    content["md5checksum.hex"] = f"{hashlib.md5(main).hexdigest()} *main.xml".encode()
    surface = read_x3p(pack(tmp_path / "b.x3p", {f"part 7/{name}": data for name, data in content.items()}))
    assert np.array_equal(surface.height_um, read_x3p(tmp_path / "a.x3p").height_um, equal_nan=True)
    assert "date" not in surface.origin
    assert "instrument" not in surface.origin


@pytest.mark.parametrize("damaged", ["main.xml", "bindata/data.bin", "bindata/valid.bin"])
def test_md5_mismatch_is_refused(tmp_path, damaged):
    write_x3p(some_map(), tmp_path / "a.x3p")
    content = entries(tmp_path / "a.x3p")
    data = bytearray(content[damaged])
    data[-3 if damaged != "main.xml" else -1] ^= 1 if damaged != "main.xml" else ord("\n") ^ ord(" ")
    content[damaged] = bytes(data)
    with pytest.raises(HeightMapError, match="MD5"):
        read_x3p(pack(tmp_path / "b.x3p", content))


@pytest.mark.parametrize("where", ["data", "list", "npy"])
def test_a_claim_of_60000_squared_is_refused_at_once(tmp_path, where):
    path = tmp_path / ("a.npy" if where == "npy" else "a.x3p")
    if where == "npy":
        head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (60000, 60000), }\n"
        path.write_bytes(b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + bytes(800))
    else:
        data = "<DataList><Datum>1</Datum></DataList>" if where == "list" else ""
        pack(path, {"main.xml": document(60000, 60000, data=data), "bindata/data.bin": bytes(8000)})
    tracemalloc.start()
    try:
        with pytest.raises(HeightMapError, match="60000 × 60000"):
            read_height_map(path, pixel_um=(1.0, 1.0) if where == "npy" else None)
        assert tracemalloc.get_traced_memory()[1] < 20e6  # bytes; the claim would take 29 GB
    finally:
        tracemalloc.stop()


def test_a_large_claim_below_the_limit_is_compared_with_the_file(tmp_path):
    path = pack(tmp_path / "a.x3p", {"main.xml": document(9000, 9000), "bindata/data.bin": bytes(80000)})
    with pytest.raises(HeightMapError, match="size against file: 9000 × 9000 points need 648000000 bytes"):
        read_x3p(path)


def test_a_bomb_in_the_checksum_file_is_not_unpacked(tmp_path):
    content = {
        "main.xml": document(3, 4),
        "md5checksum.hex": bytes(50_000_000),
        "bindata/data.bin": bytes(96),
    }
    with pytest.raises(HeightMapError, match="claims 50000000 bytes"):
        read_x3p(pack(tmp_path / "a.x3p", content))


def test_entities_are_never_resolved(tmp_path):
    secret = tmp_path / "secret.txt"
    secret.write_text("17")
    body = document(3, 4).replace(b"<SizeX>4", b"<SizeX>&x;")
    main = f'<!DOCTYPE a [<!ENTITY x SYSTEM "{secret.as_uri()}">]>'.encode() + body
    with pytest.raises(HeightMapError, match="document type"):
        read_x3p(pack(tmp_path / "a.x3p", {"main.xml": main, "bindata/data.bin": bytes(96)}))


@pytest.mark.parametrize(
    ("main", "message"),
    [
        (b"<a>", "not well-formed"),
        (b"<a/>", "Record1 or Record3"),
        (document(3, 4).replace(b"SUR", b"PRF"), "feature type"),
        (document(3, 4).replace(b"<SizeZ>N/A", b"<SizeZ>2"), "SizeZ"),
        (document(3, 4, "Q"), "data type"),
        (document(3, 4, cx="<Increment>0</Increment>"), "increment of CX"),
        (document(3, 4, cx="<Increment>1E-2</Increment>"), "pixel size along x"),
        (document(3, 4, cx="<Increment>1E+999999</Increment>"), "pixel size along x|out of range"),
        (document(-3, 4), "SizeY"),
        (document(1, 12), "at least 2 × 2"),
        (document(3, 5), "bytes"),
        (document(3, 4).replace(b"</Axes>", b"<Rotation><r11>0</r11></Rotation></Axes>"), "rotation"),
    ],
)
def test_documents_that_cannot_be_used(tmp_path, main, message):
    with pytest.raises(HeightMapError, match=message) as caught:
        read_x3p(pack(tmp_path / "a.x3p", {"main.xml": main, "bindata/data.bin": np.ones(12).tobytes()}))
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("a.x3p: ")


def test_absolute_axes_give_their_pixel_or_are_refused(tmp_path):
    record = np.zeros(12, [("x", "<f8"), ("y", "<f8"), ("z", "<f8")])
    record["x"], record["y"] = np.tile(np.arange(4) * 3e-6, 3), np.repeat(np.arange(3) * 2e-6, 4)
    record["z"] = np.arange(12) * 1e-6
    main = document(3, 4).replace(b"<AxisType>I", b"<AxisType>A")
    surface = read_x3p(pack(tmp_path / "a.x3p", {"main.xml": main, "bindata/data.bin": record.tobytes()}))
    assert (surface.pixel_y_um, surface.pixel_x_um) == pytest.approx((2.0, 3.0))
    np.testing.assert_allclose(surface.height_um.ravel(), np.arange(12))
    record["x"][[2, 6, 10]] += 1e-6
    with pytest.raises(HeightMapError, match="x axis"):
        read_x3p(pack(tmp_path / "b.x3p", {"main.xml": main, "bindata/data.bin": record.tobytes()}))


def test_truncated_files_raise_height_map_errors_only(tmp_path):
    write_x3p(some_map(), tmp_path / "a.x3p")
    whole = (tmp_path / "a.x3p").read_bytes()
    for size in range(0, len(whole), 37):
        (tmp_path / "b.x3p").write_bytes(whole[:size])
        with pytest.raises(HeightMapError):
            read_height_map(tmp_path / "b.x3p")


@pytest.mark.parametrize("suffix", [".x3p", ".npy", ".npz", ".csv"])
def test_flipped_bytes_raise_height_map_errors_or_read(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    if suffix == ".npz":
        np.savez_compressed(path, height_um=some_map().height_um)
    else:
        write_height_map(some_map(), path)
    whole = path.read_bytes()
    rng = np.random.default_rng(5)
    for _ in range(250):
        data = bytearray(whole)
        for position in rng.integers(0, len(data), rng.integers(1, 4)):
            data[position] = int(rng.integers(256))
        path.write_bytes(bytes(data))
        try:
            surface = read_height_map(path, pixel_um=None if suffix == ".x3p" else (1.0, 1.0))
        except HeightMapError as error:
            assert "\n" not in str(error)  # noqa: PT017 - both outcomes are right
        else:
            assert np.nanmax(np.abs(surface.height_um)) <= 10_000.0


MARKED = (
    b"<Mask><Background>#cd7f32</Background><Annotations><Annotation color='#1f376c'>break-off</Annotation>"
    b"<Annotation color='purple'>left groove</Annotation></Annotations></Mask>"
)


@pytest.fixture
def marked(tmp_path):
    """A map of 12 × 16 points whose mask.png marks rows 0–2, and columns 12–15 of the other rows, in two colours."""
    write_x3p(some_map(12, 16, missing=0.0), tmp_path / "plain.x3p")
    content = entries(tmp_path / "plain.x3p")
    content["main.xml"] = content["main.xml"].replace(b"</Record3>", MARKED + b"</Record3>")
    content["md5checksum.hex"] = hashlib.md5(content["main.xml"], usedforsecurity=False).hexdigest().encode()
    colours = np.full((12, 16, 3), (0xCD, 0x7F, 0x32), dtype=np.uint8)
    colours[:, 12:], colours[:3] = (0x80, 0, 0x80), (0x1F, 0x37, 0x6C)
    picture = io.BytesIO()
    Image.fromarray(colours).save(picture, "PNG")
    return pack(tmp_path / "marked.x3p", content | {"bindata/mask.png": picture.getvalue()})


def test_regions_of_a_mask_are_missing_only_where_the_user_names_them(marked):
    rows, cols = np.mgrid[:12, :16]
    broken, groove = rows < 3, (cols >= 12) & (rows >= 3)
    plain = read_height_map(marked)
    assert not np.isnan(plain.height_um).any()
    assert "break-off, left groove" in plain.origin["mask"]
    assert "every point is read" in plain.origin["mask"]
    for regions, gone in (
        (["break-off"], broken),
        (["LEFT groove"], groove),
        (["#1F376C", "left groove"], broken | groove),
        (["all"], broken | groove),
        (["#cd7f32"], ~(broken | groove)),
    ):
        found = read_height_map(marked, mask_regions=regions)
        np.testing.assert_array_equal(np.isnan(found.height_um), gone)
        np.testing.assert_array_equal(found.height_um[~gone], plain.height_um[~gone])
        assert f"{np.count_nonzero(gone)} points" in found.origin["mask"]


def test_transparent_points_of_a_mask_are_no_region(marked):
    content = entries(marked)
    alpha = np.zeros((12, 16, 4), dtype=np.uint8)
    alpha[4:6, :, :] = 255
    picture = io.BytesIO()
    Image.fromarray(alpha).save(picture, "PNG")
    pack(marked, content | {"bindata/mask.png": picture.getvalue()})
    found = read_height_map(marked, mask_regions=["all"])
    np.testing.assert_array_equal(np.isnan(found.height_um), np.mgrid[:12, :16][0] // 2 == 2)


def test_masks_that_cannot_be_used(marked, tmp_path):
    with pytest.raises(
        HeightMapError, match=r"no point of a region 'rust'; the mask has break-off, left groove"
    ):
        read_height_map(marked, mask_regions=["rust"])
    with pytest.raises(HeightMapError, match=r"no mask\.png"):
        read_height_map(tmp_path / "plain.x3p", mask_regions=["all"])
    write_height_map(some_map(missing=0.0), tmp_path / "a.npz")
    with pytest.raises(HeightMapError, match="only x3p files"):
        read_height_map(tmp_path / "a.npz", mask_regions=["all"])
    content, small = entries(marked), io.BytesIO()
    Image.fromarray(np.zeros((5, 5, 3), dtype=np.uint8)).save(small, "PNG")
    for picture, message in ((small.getvalue(), "5 × 5 points for 12 × 16"), (b"no picture", "mask.png")):
        pack(marked, content | {"bindata/mask.png": picture})
        with pytest.raises(HeightMapError, match=message):
            read_height_map(marked, mask_regions=["all"])
        assert not np.isnan(read_height_map(marked).height_um).any()


def test_blocks_packed_by_threads_are_one_entry(tmp_path, monkeypatch):
    monkeypatch.setattr("anisoscope.profiles.files.x3p_write.BLOCK_BYTES", 1000)
    surface = some_map(90, 70)
    write_x3p(surface, tmp_path / "a.x3p")
    with zipfile.ZipFile(tmp_path / "a.x3p") as archive:
        assert archive.testzip() is None
        assert archive.getinfo("bindata/data.bin").compress_size < 90 * 70 * 8
    np.testing.assert_array_equal(read_x3p(tmp_path / "a.x3p").height_um, surface.height_um)
