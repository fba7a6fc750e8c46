"""Counts in packed bytes, against the converter of Basler's SDK and against whole numbers without limit."""

import warnings

import numpy as np
import pytest

from anisoscope.base.errors import CameraError
from anisoscope.rig.cameras.pixelformats import FORMATS, choose, counts_of

SHAPE = (6, 8)


def random_bytes(name):
    data = np.random.default_rng(1).integers(0, 256, SHAPE[0] * FORMATS[name].size(SHAPE[1]), dtype=np.uint8)
    if name.endswith("10Packed"):
        data[1::3] &= 0x33  # its other bits are always 0
    return data.tobytes()


@pytest.mark.parametrize("name", ["Mono10Packed", "Mono12Packed", "Mono10p", "Mono12p", "BayerRG12p"])
def test_the_converter_of_another_maker_reads_the_same_counts(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        pylon = pytest.importorskip("pypylon.pylon", reason="pip install 'anisoscope[basler]'")
    data = random_bytes(name)
    picture = pylon.PylonImage()
    kind = name.replace("BayerRG", "Mono").replace("Packed", "packed")
    picture.AttachMemoryView(memoryview(data), getattr(pylon, f"PixelType_{kind}"), SHAPE[1], SHAPE[0], 0)
    converter = pylon.ImageFormatConverter()
    converter.OutputPixelFormat = pylon.PixelType_Mono16
    converter.OutputBitAlignment.Value = "LsbAligned"
    np.testing.assert_array_equal(counts_of(data, SHAPE, name), converter.Convert(picture).GetArray())


@pytest.mark.parametrize("name", [name for name in FORMATS if name.endswith("p")])
def test_a_stream_of_bits(name):
    data, bits = random_bytes(name), FORMATS[name].bits
    stream = int.from_bytes(data, "little")
    expected = [stream >> bits * place & ((1 << bits) - 1) for place in range(SHAPE[0] * SHAPE[1])]
    assert counts_of(data, SHAPE, name).ravel().tolist() == expected


def test_whole_bytes_are_little_endian():
    assert counts_of(b"\x34\x02\xff\x0f", (1, 2), "Mono12").tolist() == [[0x234, 0xFFF]]
    assert counts_of(b"\x01\xff", (2, 1), "BayerGB8").tolist() == [[1], [255]]


def test_bytes_that_are_missing_or_split_are_refused():
    with pytest.raises(CameraError, match="a picture of 8 × 6 in Mono12p has 72 bytes; 71 came"):
        counts_of(bytes(71), SHAPE, "Mono12p")
    with pytest.raises(CameraError, match="choose a width that 4 divides"):
        FORMATS["Mono10p"].size(3)


@pytest.mark.parametrize(
    ("wanted", "offered", "used"),
    [
        ("Mono12", ("Mono8", "Mono12Packed", "Mono12"), "Mono12"),
        ("Mono12", ("Mono8", "Mono12p"), "Mono12p"),
        ("Mono12p", ("Mono8", "Mono16"), "Mono8"),
        ("BayerRG12", ("BayerRG8", "BayerRG12Packed"), "BayerRG12Packed"),
    ],
)
def test_the_same_counts_in_another_layout_come_before_fewer_bits(wanted, offered, used):
    assert choose(wanted, offered) == used


def test_colours_are_not_taken_for_grey():
    with pytest.raises(
        CameraError, match="the camera has no BayerRG12, only BayerGB12, Mono8; choose one of BayerGB12"
    ):
        choose("BayerRG12", ("BayerGB12", "Mono8"))


@pytest.mark.parametrize(
    ("name", "level"),
    [("Mono16", 9000.0), ("Mono16", 300.0), ("Mono12", 700.0), ("Mono12", 4.0), ("Mono10", 64.0)],
)
def test_counts_with_their_high_byte_first(name, level):
    rng = np.random.default_rng(4)
    counts = np.round(
        level * (1.0 + 0.3 * np.sin(np.arange(96) / 9.0)) + rng.normal(0.0, 0.01 * level + 0.5, (64, 96))
    ).astype("<u2")
    swapped = counts.byteswap().tobytes()
    assert np.array_equal(counts_of(counts.tobytes(), counts.shape, name), counts)
    assert np.array_equal(counts_of(swapped, counts.shape, name, big_endian=name == "Mono16"), counts)
    if name == "Mono16":
        with pytest.raises(CameraError, match="high byte first: state big_endian = true in"):
            counts_of(swapped, counts.shape, name)
        with pytest.raises(CameraError, match="low byte first: state big_endian = false in"):
            counts_of(counts.tobytes(), counts.shape, name, big_endian=True)


def test_a_dark_picture_and_one_of_eight_bits_to_the_left_are_no_swapped_ones():
    rng = np.random.default_rng(5)
    dark = np.round(rng.normal(64.0, 2.0, (64, 96))).astype("<u2")
    ramp = (255 * ((np.arange(96) + np.arange(64)[:, None]) % 256)).astype(
        "<u2"
    )  # without noise, with an edge
    pattern = ((7 + 256 * (np.arange(96) + np.arange(64)[:, None])) % 65535).astype("<u2")
    for counts in (dark, dark << 8, np.full((64, 96), 0xFFFF, "<u2"), ramp, pattern):
        assert np.array_equal(counts_of(counts.tobytes(), counts.shape, "Mono16"), counts)
