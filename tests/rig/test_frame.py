"""Frames survive the disk, and what is no frame is refused in one line."""

import importlib.util
import json
import sys
from dataclasses import fields, replace
from importlib import import_module

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from anisoscope.base import atomic_write
from anisoscope.base.errors import RecordError, UsageError
from anisoscope.rig.frame import (
    Frame,
    check_compression,
    filters_in_header,
    header_of,
    read_frame,
    write_frame,
)


@pytest.fixture
def frame():
    counts = np.arange(12, dtype=np.uint16).reshape(3, 4) * 300
    return Frame(
        counts, "sample", 12, 64.0, 0.02, 1.5, 89.9987, 90.0, 0.0, "2025-01-02T03:04:05.678+00:00", "Käm 7"
    )


def test_round_trip(frame, tmp_path):
    path = tmp_path / "a.tif"
    write_frame(frame, path)
    again = read_frame(path)
    np.testing.assert_array_equal(again.counts, frame.counts)
    assert again.counts.dtype == np.uint16
    for field in fields(Frame)[1:]:
        assert getattr(again, field.name) == getattr(frame, field.name)
    assert [file.name for file in tmp_path.iterdir()] == ["a.tif"]


def noisy(rows=300, cols=400):
    """A picture as a camera of 12 bits takes it: a slope with shot noise."""
    rng = np.random.default_rng(5)
    slope = np.linspace(200.0, 3000.0, cols) * np.linspace(0.5, 1.0, rows)[:, None]
    return np.clip(rng.normal(slope, np.sqrt(slope / 3.0)), 0, 4095).astype(np.uint16)


@pytest.mark.parametrize("packing", ["none", "zlib", "jpeg-xl"])
def test_packing_loses_nothing(frame, tmp_path, packing):
    counts = noisy()
    write_frame(replace(frame, counts=counts), tmp_path / "a.tif", packing)
    again = read_frame(tmp_path / "a.tif")
    np.testing.assert_array_equal(again.counts, counts)
    assert (again.camera, again.stage_deg) == (frame.camera, frame.stage_deg)
    assert header_of(tmp_path / "a.tif").gain == frame.gain
    size = (tmp_path / "a.tif").stat().st_size / counts.nbytes
    assert size < {"none": 1.01, "zlib": 0.75, "jpeg-xl": 0.6}[packing]


def test_packed_by_zlib_it_is_read_by_others(frame, tmp_path):
    counts = noisy()
    write_frame(replace(frame, counts=counts), tmp_path / "a.tif", "zlib")
    with Image.open(tmp_path / "a.tif") as picture:
        np.testing.assert_array_equal(np.asarray(picture), counts)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.tif"), cv2.IMREAD_UNCHANGED), counts)


def test_without_its_package_jpeg_xl_is_refused_in_one_line(frame, tmp_path, monkeypatch):
    write_frame(replace(frame, counts=noisy()), tmp_path / "a.tif", "jpeg-xl")
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    monkeypatch.setattr(tifffile.tifffile, "imagecodecs", import_module("tifffile._imagecodecs"))
    for codecs in (tifffile.TIFF.DECOMPRESSORS, tifffile.TIFF.COMPRESSORS):
        monkeypatch.setattr(codecs, "_codecs", {})
    with pytest.raises(RecordError, match=r"a\.tif: JPEG XL needs the package imagecodecs: pip install"):
        read_frame(tmp_path / "a.tif")
    with pytest.raises(UsageError, match=r"compression = .jpeg-xl.: JPEG XL needs"):
        check_compression("jpeg-xl")
    check_compression("zlib")
    write_frame(replace(frame, counts=noisy()), tmp_path / "b.tif", "zlib")  # by what Python has
    np.testing.assert_array_equal(read_frame(tmp_path / "b.tif").counts, noisy())


def test_the_mosaic_of_a_colour_camera_keeps_its_name(frame, tmp_path):
    write_frame(replace(frame, filters="gbrg"), tmp_path / "colour.tif")
    assert read_frame(tmp_path / "colour.tif").filters == filters_in_header(tmp_path / "colour.tif") == "gbrg"
    no_tiff(tmp_path / "other.tif")
    foreign(tmp_path / "foreign.tif")
    assert filters_in_header(tmp_path / "other.tif") is filters_in_header(tmp_path / "foreign.tif") is None


def test_a_frame_of_before_there_were_colours_is_grey(frame, tmp_path):
    write_frame(frame, tmp_path / "a.tif")
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        said = json.loads(file.pages[0].description)
    del said["filters"]
    tifffile.imwrite(tmp_path / "old.tif", frame.counts, description=json.dumps(said), metadata=None)
    assert read_frame(tmp_path / "old.tif").filters == "mono"
    said["filters"] = "rgbw"
    tifffile.imwrite(tmp_path / "odd.tif", frame.counts, description=json.dumps(said), metadata=None)
    with pytest.raises(RecordError, match=r"odd\.tif: not a frame of anisoscope: filters: "):
        read_frame(tmp_path / "odd.tif")


def test_any_program_can_read_the_picture(frame, tmp_path):
    write_frame(frame, tmp_path / "a.tif")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.tif"), frame.counts)


def test_saturation_begins_at_98_percent_of_full_scale(frame):
    assert frame.full_scale == 4095
    counts = np.array([[4013, 4014, 4095, 0]], dtype=np.uint16)
    assert replace(frame, counts=counts).saturated_share == 0.5


def test_frames_and_records_have_one_mode(frame, tmp_path):
    write_frame(frame, tmp_path / "a.tif")
    atomic_write.write_bytes(tmp_path / "record.json", b"")
    assert (tmp_path / "a.tif").stat().st_mode == (tmp_path / "record.json").stat().st_mode


def test_a_write_that_fails_leaves_the_old_file(frame, tmp_path, monkeypatch):
    path = tmp_path / "a.tif"
    write_frame(frame, path)
    before = path.read_bytes()

    def full(*_args, **_options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(atomic_write.os, "fsync", full)
    with pytest.raises(RecordError, match="No space left"):
        write_frame(replace(frame, gain=9.0), path)
    assert path.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1


def test_a_folder_that_is_not_there(frame, tmp_path):
    with pytest.raises(RecordError, match=r"cannot write .*No such file"):
        write_frame(frame, tmp_path / "no" / "a.tif")


def no_tiff(path):
    path.write_bytes(b"hello")


def cut_short(path):
    tifffile.imwrite(path, np.zeros((64, 64), np.uint16), description="{}", metadata=None)
    path.write_bytes(path.read_bytes()[:300])


def foreign(path):
    tifffile.imwrite(path, np.zeros((4, 4), np.uint16))


def incomplete(path):
    tifffile.imwrite(path, np.zeros((4, 4), np.uint16), description='{"anisoscope_frame": 1}', metadata=None)


@pytest.mark.parametrize("spoil", [no_tiff, cut_short, foreign, incomplete, lambda path: None])
def test_what_is_no_frame(spoil, tmp_path):
    path = tmp_path / "a.tif"
    spoil(path)
    with pytest.raises(RecordError, match=r"a\.tif") as caught:
        read_frame(path)
    assert "\n" not in str(caught.value)


def test_eight_bits_are_not_enough(frame, tmp_path):
    write_frame(replace(frame, counts=frame.counts.astype(np.uint8)), tmp_path / "a.tif")
    with pytest.raises(RecordError, match="16-bit"):
        read_frame(tmp_path / "a.tif")
