"""What is refused before it costs time or memory, what the user may let pass, and what headers of texts state."""

import hashlib
import os
import struct
import time
import zipfile
import zlib

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files import x3p_write
from anisoscope.profiles.files.load import read_height_map, write_height_map
from anisoscope.profiles.files.x3p import read_x3p, write_x3p
from anisoscope.profiles.heightmap import HeightMap


def wavy(rows=12, cols=17, pixel=0.5):
    y, x = np.mgrid[:rows, :cols]
    return HeightMap(np.sin(0.7 * x) + 0.3 * np.cos(0.4 * y), pixel, pixel)


def repack(source, target, change):
    """The archive with some entries changed: name to function of its bytes, or to new bytes."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            data = old.read(name)
            new.writestr(name, change[name](data) if name in change else data)


def test_pipes_and_devices_are_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "a.x3p")
    (tmp_path / "b.npy").symlink_to("/dev/zero")
    for name in ("a.x3p", "b.npy"):
        with pytest.raises(HeightMapError, match="is a pipe, a device or a socket"):
            read_height_map(tmp_path / name)


def test_an_archive_that_unpacks_to_gigabytes_is_refused_without_unpacking(tmp_path):
    shape = (1, 2**27)
    header = b"{'descr': '|u1', 'fortran_order': False, 'shape': (%d, %d)}" % shape
    header += b" " * (-(len(header) + 11) % 64) + b"\n"
    with (
        zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("z.npy", "w") as entry,
    ):
        entry.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)
        for _ in range(128):
            entry.write(bytes(2**20))
    start = time.process_time()
    with pytest.raises(HeightMapError, match="bytes unpack to"):
        read_height_map(tmp_path / "a.npz", pixel_um=(1, 1))
    assert time.process_time() - start < 0.2


def test_a_long_list_of_heights_in_main_xml_is_read_and_a_longer_one_refused(tmp_path, monkeypatch):
    rng = np.random.default_rng(1)
    surface = HeightMap(np.round(rng.normal(size=(250, 250)), 6), 1.0, 1.0)
    write_x3p(surface, tmp_path / "a.x3p", text=True)
    found = read_x3p(tmp_path / "a.x3p")
    np.testing.assert_array_equal(found.height_um, surface.height_um)
    with monkeypatch.context() as patch, pytest.raises(HeightMapError, match="write them as binary data"):
        patch.setattr(x3p_write, "MAX_DOCUMENT_BYTES", 2**18)
        write_x3p(HeightMap(rng.normal(size=(100, 100)), 1.0, 1.0), tmp_path / "b.x3p", text=True)
    repack(tmp_path / "a.x3p", tmp_path / "c.x3p", {"main.xml": lambda data: data + b"\n" * 2**24})
    with pytest.raises(HeightMapError, match="are plausible"):
        read_x3p(tmp_path / "c.x3p")


def test_a_list_of_heights_in_a_comment_is_none(tmp_path):
    write_x3p(wavy(), tmp_path / "a.x3p", text=True)

    def commented(data):
        return data.replace(b"<DataList>", b"<!--<DataList>").replace(b"</DataList>", b"</DataList>-->")

    repack(tmp_path / "a.x3p", tmp_path / "b.x3p", {"main.xml": commented, "md5checksum.hex": lambda _: b""})
    with pytest.raises(HeightMapError):
        read_x3p(tmp_path / "b.x3p")


def test_a_stale_checksum_of_main_xml_passes_on_trust_only_with_right_heights(tmp_path):
    write_height_map(wavy(), tmp_path / "a.x3p")

    def edited(data):
        return data.replace(b"<Comment>", b"<Comment>edited by hand")

    repack(tmp_path / "a.x3p", tmp_path / "b.x3p", {"main.xml": edited})
    with pytest.raises(HeightMapError, match="--trust checksum"):
        read_height_map(tmp_path / "b.x3p")
    found = read_height_map(tmp_path / "b.x3p", trust=("checksum",))
    np.testing.assert_array_equal(found.height_um, wavy().height_um)
    assert len(found.origin["trusted"]) == 1
    assert "MD5 of main.xml" in found.origin["trusted"][0]
    assert "trusted" not in read_height_map(tmp_path / "a.x3p", trust=("checksum",)).origin

    def spoiled(data):
        return data[:-1] + bytes([data[-1] ^ 1])

    repack(tmp_path / "b.x3p", tmp_path / "c.x3p", {"bindata/data.bin": spoiled})
    with pytest.raises(HeightMapError, match=r"MD5 of .*data\.bin"):
        read_height_map(tmp_path / "c.x3p", trust=("checksum",))
    write_x3p(wavy(), tmp_path / "t.x3p", text=True)
    repack(tmp_path / "t.x3p", tmp_path / "u.x3p", {"main.xml": edited})
    with pytest.raises(
        HeightMapError, match=r"MD5 of main\.xml"
    ):  # these heights have no checksum of their own
        read_height_map(tmp_path / "u.x3p", trust=("checksum",))


def test_limits_of_pixel_and_heights_pass_on_trust(tmp_path):
    np.save(tmp_path / "a.npy", wavy().height_um)
    for pixel in (0.001, 2000.0):
        with pytest.raises(HeightMapError, match="--trust pixel-size"):
            read_height_map(tmp_path / "a.npy", pixel_um=(pixel, pixel))
        found = read_height_map(tmp_path / "a.npy", pixel_um=(pixel, pixel), trust=("pixel-size",))
        assert found.pixel_x_um == pixel
        assert len(found.origin["trusted"]) == 2  # along y and x
    np.save(tmp_path / "b.npy", 1e-6 * wavy().height_um)
    with pytest.raises(HeightMapError, match=r"range of the heights.*--trust heights"):
        read_height_map(tmp_path / "b.npy", pixel_um=(1, 1))
    assert read_height_map(tmp_path / "b.npy", pixel_um=(1, 1), trust=("heights",)).origin["trusted"]
    np.save(tmp_path / "c.npy", np.zeros((4, 4)))
    assert read_height_map(tmp_path / "c.npy", pixel_um=(1, 1)).shape == (4, 4)


@pytest.mark.parametrize("suffix", [".npy", ".txt", ".x3p"])
def test_infinite_heights_are_missing_and_said(tmp_path, suffix):
    height = wavy().height_um.copy()
    height[1, 2], height[3, 4] = np.inf, -np.inf
    path = tmp_path / f"a{suffix}"
    if suffix == ".npy":
        np.save(path, height)
    elif suffix == ".txt":
        np.savetxt(path, height)
    else:
        write_height_map(wavy(), tmp_path / "plain.x3p")
        points = (height * 1e-6).astype("<f8").tobytes()

        def linked(data):
            start = data.index(b"<MD5ChecksumPointData>") + 22
            return data[:start] + hashlib.md5(points).hexdigest().encode() + data[start + 32 :]

        changed = {"bindata/data.bin": lambda _: points, "main.xml": linked}
        with zipfile.ZipFile(tmp_path / "plain.x3p") as archive:
            document = linked(archive.read("main.xml"))
        changed["md5checksum.hex"] = lambda _: hashlib.md5(document).hexdigest().encode()
        repack(tmp_path / "plain.x3p", path, changed)
    found = read_height_map(path, pixel_um=None if suffix == ".x3p" else (0.5, 0.5))
    assert np.count_nonzero(np.isnan(found.height_um)) == 2
    assert "2 infinite heights are missing points" in found.origin["corrected"]


def test_x3p_states_nothing_of_a_measurement_that_nobody_stated(tmp_path):
    write_height_map(wavy(), tmp_path / "a.x3p")
    with zipfile.ZipFile(tmp_path / "a.x3p") as archive:
        document = archive.read("main.xml")
    assert b"Date>" not in document
    assert b"ProbingSystem" not in document
    assert b"<Manufacturer>not available</Manufacturer>" in document
    origin = read_height_map(tmp_path / "a.x3p").origin
    assert not {"date", "calibration_date", "instrument"} & origin.keys()
    known = {
        "date": "2024-02-03T04:05:06",
        "calibration_date": "2023-01-02T00:00:00",
        "probing": "NonContacting",
    }
    write_height_map(wavy().with_height(wavy().height_um, **known), tmp_path / "b.x3p")
    again = read_height_map(tmp_path / "b.x3p").origin
    assert {key: again[key] for key in known} == known


HEAD = "# Channel: Height\n# Width: {width}\n# Height: {height}\n# Value units: {unit}\n"


def gwyddion(path, unit="m", factor=1e-6, width="8.50 µm", height="6.00 µm"):
    rows = "\n".join("\t".join(repr(z * factor) for z in row) for row in wavy().height_um.tolist())
    head = HEAD.format(width=width, height=height, unit=unit) if unit is not None else ""
    path.write_text(head + rows + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(("unit", "factor"), [("m", 1e-6), ("nm", 1e3), ("µm", 1.0)])
def test_the_header_of_gwyddions_text_is_read(tmp_path, unit, factor):
    found = read_height_map(gwyddion(tmp_path / "a.txt", unit, factor))
    assert (found.pixel_y_um, found.pixel_x_um) == pytest.approx((0.5, 0.5))
    np.testing.assert_allclose(found.height_um, wavy().height_um[::-1], rtol=1e-12)
    finer = read_height_map(tmp_path / "a.txt", pixel_um=(0.5003, 0.5003))
    assert finer.pixel_x_um == 0.5003
    text = (tmp_path / "a.txt").read_text(encoding="utf-8")
    for english, german in (("Channel:", "Kanal:"), ("Width:", "Breite:"), ("Height:", "Höhe:")):
        text = text.replace(english, german)
    (tmp_path / "a.txt").write_text(text, encoding="utf-8")
    np.testing.assert_array_equal(read_height_map(tmp_path / "a.txt").height_um, found.height_um)


def test_what_contradicts_the_header_of_gwyddions_text_is_refused(tmp_path):
    path = gwyddion(tmp_path / "a.txt")
    with pytest.raises(HeightMapError, match="by its header"):
        read_height_map(path, pixel_um=(1.0, 1.0))
    with pytest.raises(HeightMapError, match="heights in m, not in um"):
        read_height_map(path, z_unit="um")
    with pytest.raises(HeightMapError, match="'V' is no length"):
        read_height_map(gwyddion(tmp_path / "b.txt", "V"))
    with pytest.raises(HeightMapError, match="header, width"):
        read_height_map(gwyddion(tmp_path / "c.txt", width="wide"))


@pytest.mark.parametrize(
    ("kind", "reason"), [(10, "a grey image"), (12, "an RGB image"), (21, "a spectral map"), (1, "a profile")]
)
def test_a_sur_file_that_holds_no_surface_says_what_it_holds(tmp_path, heights, made_files, kind, reason):
    made_files["sur"].write(tmp_path / "a.sur", heights)
    data = bytearray((tmp_path / "a.sur").read_bytes())
    struct.pack_into("<H", data, 18, kind)
    (tmp_path / "a.sur").write_bytes(bytes(data))
    with pytest.raises(HeightMapError, match=f"content: {reason}, no surface"):
        read_height_map(tmp_path / "a.sur")


def test_blocks_of_a_compressed_sur_file_are_compared_with_its_size(tmp_path, heights, made_files):
    made_files["sur-packed"].write(tmp_path / "a.sur", heights)
    whole = (tmp_path / "a.sur").read_bytes()
    assert read_height_map(tmp_path / "a.sur").origin["format"] == "sur, compressed"
    plain = zlib.compress(bytes(4 * heights.size + 4))
    longer = struct.pack("<III", 1, 4 * heights.size + 4, len(plain)) + plain
    lying = struct.pack("<III", 1, 4 * heights.size, len(plain)) + plain
    for blocks in (longer, lying, struct.pack("<I", 0), struct.pack("<I", 2**31)):
        (tmp_path / "a.sur").write_bytes(whole[:512] + blocks)
        with pytest.raises(HeightMapError, match="compressed block"):
            read_height_map(tmp_path / "a.sur")


@pytest.mark.parametrize("inverted", [1, 2, 3])
def test_an_inverted_sur_surface_is_turned_back(tmp_path, heights, made_files, inverted):
    made_files["sur"].write(tmp_path / "a.sur", heights)
    plain = read_height_map(tmp_path / "a.sur").height_um
    data = bytearray((tmp_path / "a.sur").read_bytes())
    struct.pack_into("<H", data, 290, inverted)
    (tmp_path / "a.sur").write_bytes(bytes(data))
    found = read_height_map(tmp_path / "a.sur").height_um
    expected = {1: -plain, 2: -plain[:, ::-1], 3: -plain[::-1]}[inverted]
    np.testing.assert_allclose(found, expected)


def test_a_tmd_file_with_more_than_its_heights_is_refused(tmp_path, heights, made_files):
    made_files["tmd-gelsight"].write(tmp_path / "a.tmd", heights)
    with (tmp_path / "a.tmd").open("ab") as stream:
        stream.write(bytes(8))
    with pytest.raises(HeightMapError, match="8 bytes after the last height"):
        read_height_map(tmp_path / "a.tmd")
    (tmp_path / "b.tmd").write_bytes(b"Binary TrueMap Data File v3.0" + bytes(500))
    with pytest.raises(HeightMapError, match="TrueMap"):
        read_height_map(tmp_path / "b.tmd")
