"""Files with several channels: Nanonis sxm and Nanoscope files made here, Gwyddion's, and what has one map."""

import struct

import numpy as np
import pytest
import tifffile

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.load import read_height_map, write_height_map
from anisoscope.profiles.heightmap import HeightMap

ROWS, COLS = 6, 8
Z = np.arange(ROWS * COLS, dtype=float).reshape(ROWS, COLS) ** 1.5
"""In nm, the first row at the top."""


def sxm(path, direction="down", channels=("Z\tm\tboth", "Current\tA\tfwd"), scale=1.0, side="8.0E-7 1.2E-6"):
    head = (
        ":NANONIS_VERSION:\n2\n:SCANIT_TYPE:\n FLOAT MSBFIRST\n"
        f":SCAN_PIXELS:\n {COLS} {ROWS}\n:SCAN_RANGE:\n {side}\n:SCAN_DIR:\n{direction}\n"
        ":DATA_INFO:\n\tChannel\tName\tUnit\tDirection\tCalibration\tOffset\n"
        + "".join(f"\t{14 + k}\t{one}\t9.0E-9\t0.0E+0\n" for k, one in enumerate(channels))
        + ":SCANIT_END:\n\n\n"
    )
    heights = scale * 1e-9 * (Z[::-1] if direction == "up" else Z)
    pictures = [heights, (heights + 5e-9)[:, ::-1], heights * 1e-3]
    path.write_bytes(head.encode() + b"\x1a\x04" + b"".join(one.astype(">f4").tobytes() for one in pictures))
    return path


@pytest.mark.parametrize("direction", ["down", "up"])
def test_sxm(tmp_path, direction):
    found = read_height_map(sxm(tmp_path / "a.sxm", direction))
    np.testing.assert_allclose(found.height_um, 1e-3 * Z[::-1], rtol=1e-6)
    assert (found.pixel_x_um, found.pixel_y_um) == pytest.approx((0.1, 0.2))
    assert (found.origin["channel"], found.origin["other_channels"]) == ("Z", ["Z backward", "Current"])
    for name in ("z BACKWARD", "2"):
        found = read_height_map(tmp_path / "a.sxm", channel=name)
        np.testing.assert_allclose(found.height_um, 1e-3 * (Z[::-1] + 5.0), rtol=1e-6)


def test_sxm_of_atoms(tmp_path):
    path = sxm(tmp_path / "a.sxm", scale=1e-4, side="2.0E-10 3.0E-10")
    found = read_height_map(path)
    assert (found.pixel_x_um, found.pixel_y_um) == pytest.approx((2.5e-5, 5e-5))
    np.testing.assert_allclose(found.height_um, 1e-7 * Z[::-1], rtol=1e-6)


def test_sxm_that_is_no_height_map(tmp_path):
    path = sxm(tmp_path / "a.sxm")
    with pytest.raises(HeightMapError, match="Current in A; a channel in a unit of length is needed"):
        read_height_map(path, channel="Current")
    with pytest.raises(HeightMapError, match="take one of 1 Z, 2 Z backward, 3 Current with --channel"):
        read_height_map(path, channel="Height")
    with pytest.raises(HeightMapError, match="take one of"):
        read_height_map(path, channel="4")
    sxm(path, channels=("Current\tA\tboth",))
    with pytest.raises(HeightMapError, match="a channel in a unit of length is needed"):
        read_height_map(path)
    path.write_bytes(path.read_bytes().replace(b":SCANIT_END:", b":SCANIT_EMD:"))
    with pytest.raises(HeightMapError, match="header: has no end"):
        read_height_map(path)


def nanoscope(path):
    """Two channels of heights and one of phases, 16 bits, by the header that Nanoscope 5 writes."""
    size = 2 * ROWS * COLS

    def image(number, name, scale, unit):
        return [
            r"\*Ciao image list",
            rf"\Data offset: {4096 + number * size}",
            rf"\Data length: {size}",
            r"\Bytes/pixel: 2",
            rf"\Samps/line: {COLS}",
            rf"\Number of lines: {ROWS}",
            r"\Aspect ratio: 1:1",
            r"\Scan size: 800 600 nm",
            rf'\@2:Image Data: S [{name}] "{name}"',
            rf"\@2:Z scale: V [Sens. {name}] ({scale} V/LSB) {65536 * scale} V",
            rf"\@Sens. {name}: V 1.0 {unit}/V",
        ]

    lines = [
        r"\*File list",
        r"\Version: 0x05310001",
        r"\Date: 02:03:59 PM Wed May 06 2015",
        rf"\Data length: {4096}",
        r"\*Scanner list",
        r"\@Sens. Height: V 1.0 nm/V",
        r"\@Sens. ZSensor: V 1.0 nm/V",
        r"\@Sens. Phase: V 1.0 deg/V",
        r"\*Ciao scan list",
        r"\Scan size: 800 nm",
        r"\Samps/line: 8",
        r"\Lines: 6",
        *image(0, "Height", 0.5, "nm"),
        *image(1, "ZSensor", 0.25, "nm"),
        *image(2, "Phase", 0.1, "deg"),
        r"\*File list end",
    ]
    data = np.rint(Z / 0.5).astype("<i2").tobytes() + np.rint(Z / 0.25).astype("<i2").tobytes() + bytes(size)
    path.write_bytes("\r\n".join([*lines, ""]).encode("latin-1").ljust(4096, b"\0") + data)
    return path


@pytest.mark.parametrize("name", ["a.spm", "a.di", "scan.000", "scan.123"])
def test_nanoscope_is_known_by_its_first_bytes(tmp_path, name):
    path = nanoscope(tmp_path / name)
    first, second = read_height_map(path), read_height_map(path, channel="ZSensor")
    assert (first.origin["channel"], second.origin["channel"]) == ("Height", "ZSensor")
    assert "Phase" in first.origin["other_channels"]
    np.testing.assert_allclose(first.height_um, 1e-3 * Z, atol=0.3e-3)  # the first line is the lowest
    np.testing.assert_allclose(second.height_um, 1e-3 * Z, atol=0.15e-3)
    assert (first.pixel_x_um, first.pixel_y_um) == pytest.approx((0.1, 0.1))
    with pytest.raises(HeightMapError, match="take one of 1 Height, 2 ZSensor, 3 Phase"):
        read_height_map(path, channel="Trace")


def test_channels_of_gwyddion_by_title(tmp_path, heights):
    light = np.ones_like(heights)
    write_height_map(HeightMap(heights, 1.0, 1.0, {}, {"intensity": light}), tmp_path / "a.gwy")
    title = read_height_map(tmp_path / "a.gwy").origin["channel"]
    assert read_height_map(tmp_path / "a.gwy", channel=title.upper()).shape == heights.shape
    with pytest.raises(HeightMapError, match=r"channel 'intensity': .*choose a channel of heights"):
        read_height_map(tmp_path / "a.gwy", channel="intensity")


def test_a_format_with_one_map_takes_no_channel(tmp_path, heights):
    write_height_map(HeightMap(heights, 1.0, 1.0), tmp_path / "a.x3p")
    with pytest.raises(HeightMapError, match="have one map; leave --channel out"):
        read_height_map(tmp_path / "a.x3p", channel="Height")


def test_a_picture_of_park_systems_holds_heights_of_its_own(tmp_path):
    """Header and heights are in tags of a picture of 8 bits; its unit is stated, and no other is taken."""
    header = struct.pack(
        "<I64s16sdIIIIdIdIIIdddddd16sdddd d16siiiIII".replace(" ", ""),
        0, "Z Height".encode("utf-16-le"), "NCM".encode("utf-16-le"), 0.0, 0, 0, COLS, ROWS, 0.0, 0, 0.0, 1, 1, 0,
        0.8, 1.2, 0.0, 0.0, 1.0, 0.0, "nm".encode("utf-16-le"), 0.0, 0.0, 0.5, 1e-3, 0.0, "um".encode("utf-16-le"),
        0, 0, 0, 0, 0, 0,
    )  # fmt: skip
    data = np.rint(Z).astype("<i2").tobytes()
    tags = [
        (50432, 4, 1, 0x0E031301, True),
        (50433, 4, 1, 0x01000001, True),
        (50435, 1, len(header), header, True),
        (50434, 1, len(data), data, True),
    ]
    path = tmp_path / "a.tiff"
    tifffile.imwrite(path, np.zeros((4, 4), np.uint8), extratags=tags, metadata=None)
    found = read_height_map(path)
    assert (found.pixel_x_um, found.pixel_y_um) == pytest.approx((0.1, 0.2))
    assert np.ptp(found.height_um) == pytest.approx(0.5e-3 * np.ptp(np.rint(Z)), rel=1e-6)
    with pytest.raises(HeightMapError, match="a file of Park Systems states its own; leave --z-unit"):
        read_height_map(path, z_unit="nm")
