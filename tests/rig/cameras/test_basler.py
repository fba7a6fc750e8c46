"""The Basler driver against the maker's emulated cameras: the SDK's own code, node map and buffers."""

import logging
import subprocess
import sys

import cv2
import numpy as np
import pytest
import tifffile

from anisoscope.base.errors import CameraError, NotConnected, RigFileError
from anisoscope.rig.bayer import channel_of_pixels
from anisoscope.rig.camera import Camera
from anisoscope.rig.cameras import basler
from anisoscope.rig.cameras.basler import BaslerCamera
from anisoscope.rig.drivers import open_camera

ROWS, COLS = 48, 64
FIRST, SECOND = "0815-0000", "0815-0001"


@pytest.fixture(autouse=True)
def two_emulated_cameras(monkeypatch):
    monkeypatch.setenv("PYLON_CAMEMU", "2")


def counts_of(seed=0):
    counts = np.random.default_rng(seed).integers(0, 4095, (ROWS, COLS), endpoint=True).astype(np.uint16)
    counts[0, :3] = 0, 4095, 2048
    return counts


@pytest.fixture
def shown(tmp_path):
    path = tmp_path / "shown.tif"
    tifffile.imwrite(path, counts_of() << 4)
    return path


@pytest.fixture
def camera(shown):
    opened = BaslerCamera.open(serial=FIRST, image_file=shown, width=COLS, height=ROWS)
    yield opened
    opened.close()


def test_a_rendered_frame_comes_back_count_by_count(camera, shown, tmp_path):
    assert isinstance(camera, Camera)
    assert (camera.info.model, camera.info.serial) == ("Emulation", FIRST)
    assert (camera.info.rows, camera.info.cols, camera.info.bit_depth) == (ROWS, COLS, 12)
    assert camera.info.linear
    camera.configure(0.01, 1.0)
    frame = camera.grab()
    assert frame.dtype == np.uint16
    np.testing.assert_array_equal(frame, counts_of())


@pytest.mark.parametrize("suffix", ["tif", "png"])
def test_the_file_is_read_again_for_every_frame(camera, shown, tmp_path, suffix):
    camera.configure(0.01, 1.0)
    camera.grab()
    for seed in (1, 2):
        cv2.imwrite(str(tmp_path / f"new.{suffix}"), counts_of(seed) << 4)
        (tmp_path / f"new.{suffix}").replace(shown)
        np.testing.assert_array_equal(camera.grab(), counts_of(seed))


def test_eight_bits(shown):
    camera = BaslerCamera.open(
        serial=FIRST, image_file=shown, width=COLS, height=ROWS, pixel_format="Mono8", black_level=3.5
    )
    try:
        camera.configure(0.01, 1.0)
        assert (camera.info.bit_depth, camera.info.black_level) == (8, 3.5)
        np.testing.assert_array_equal(camera.grab(), counts_of() >> 4)
    finally:
        camera.close()


@pytest.mark.parametrize(
    ("pixel_format", "filters"),
    [
        ("BayerRG12", "rggb"),
        ("BayerGR12", "grbg"),
        ("BayerGB12", "gbrg"),
        ("BayerBG8", "bggr"),
        ("Mono12", "mono"),
    ],
)
def test_a_mosaic_comes_as_the_sensor_has_it_with_the_name_of_its_filters(tmp_path, pixel_format, filters):
    """The maker's emulation puts its own filters before a colour picture; they must be where we say that they are."""
    levels = np.array([3000, 1500, 600])
    tifffile.imwrite(tmp_path / "even.tif", np.broadcast_to(levels << 4, (ROWS, COLS, 3)).astype(np.uint16))
    opened = BaslerCamera.open(
        serial=FIRST, image_file=tmp_path / "even.tif", width=COLS, height=ROWS, pixel_format=pixel_format
    )
    try:
        opened.configure(0.01, 1.0)
        counts, info = opened.grab(), opened.info
    finally:
        opened.close()
    assert info.filters == filters
    if filters == "mono":
        assert len(np.unique(counts)) == 1
    else:
        scale = 2.0 ** (info.bit_depth - 12)
        np.testing.assert_allclose(counts, levels[channel_of_pixels(filters, (ROWS, COLS))] * scale, atol=1)


def test_raw_counts_of_a_mosaic_come_back_one_by_one(shown):
    opened = BaslerCamera.open(
        serial=FIRST, image_file=shown, width=COLS, height=ROWS, pixel_format="BayerGR12"
    )
    try:
        opened.configure(0.01, 1.0)
        np.testing.assert_array_equal(opened.grab(), counts_of())
    finally:
        opened.close()


def test_settings_are_those_that_the_camera_reports(camera):
    settings = camera.configure(0.0123456, 2.0)
    assert settings.exposure_s == pytest.approx(0.0123456, abs=1e-6)  # whole microseconds
    assert settings.exposure_s == camera._device.ExposureTime.Value * 1e-6
    assert settings.gain == pytest.approx(2.0, rel=1e-3)
    assert camera._device.Gain.Value == pytest.approx(6.0206, abs=0.01)
    assert camera.configure(0.02, 1.0).gain == 1.0


@pytest.mark.parametrize(
    ("exposure_s", "gain", "expected"),
    [
        (100.0, 1.0, "the exposure must lie between 1e-06 s and 10 s, not 100 s"),
        (0.0, 1.0, "the exposure must lie between"),
        (0.01, 0.5, "the gain must lie between 1 and 251"),
        (0.01, 0.0, "the gain must lie between"),
    ],
)
def test_settings_out_of_range(camera, exposure_s, gain, expected):
    with pytest.raises(CameraError, match=expected):
        camera.configure(exposure_s, gain)


def test_what_changes_pictures_by_itself_is_switched_off(shown):
    pylon = basler.load_pylon()
    device = pylon.InstantCamera(basler.find_device(pylon, SECOND, ""))
    device.Open()
    device.ExposureAuto.Value, device.GainAuto.Value = device.ExposureAuto.Symbolics[-1], "Continuous"
    device.Gamma.Value, device.DigitalShift.Value = 0.5, 2
    device.Close()
    camera = BaslerCamera.open(serial=SECOND, image_file=shown, width=COLS, height=ROWS)
    try:
        device = camera._device
        assert (device.ExposureAuto.Value, device.GainAuto.Value) == ("Off", "Off")
        assert (device.Gamma.Value, device.DigitalShift.Value) == (1.0, 0)
        for selector in device.TriggerSelector.Symbolics:
            device.TriggerSelector.Value = selector
            assert device.TriggerMode.Value == ("On" if selector == "FrameStart" else "Off")
        assert (device.PixelFormat.Value, device.OffsetX.Value) == ("Mono12", device.OffsetX.Max // 2)
    finally:
        camera.close()


def test_the_whole_sensor_without_a_size():
    camera = BaslerCamera.open(serial=FIRST)
    try:
        assert (camera.info.rows, camera.info.cols) == (camera._device.HeightMax.Value, 4096)
        assert camera.info.black_level == camera._device.BlackLevel.Value == 0.0
    finally:
        camera.close()


def test_the_black_level_is_read_from_the_camera(shown):
    pylon = basler.load_pylon()
    device = pylon.InstantCamera(basler.find_device(pylon, FIRST, ""))
    device.Open()
    device.BlackLevel.Value = 64.0
    real = BaslerCamera.open(serial=SECOND, image_file=shown, width=COLS, height=ROWS)
    try:
        features = basler.PylonFeatures(device)
        assert basler.read_black_level(features, "Mono12") == 64.0
        assert basler.read_black_level(features, "Mono8") == 4.0
    finally:
        real.close()
        device.Close()


# -- frames that fail ------------------------------------------------------------------------------------------


def fail_next(camera, count):
    camera._device.ForceFailedBufferCount.Value = count
    camera._device.ForceFailedBuffer.Execute()


def test_incomplete_frames_are_asked_for_again_and_counted(camera, caplog):
    camera.configure(0.01, 1.0)
    camera.grab()
    fail_next(camera, 2)
    with caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(camera.grab(), counts_of())
    assert camera.failed_buffers == 2
    assert [record.levelname for record in caplog.records] == ["WARNING"] * 2
    assert "attempt 2 of 4 gave no frame: The buffer was incompletely grabbed (2 since" in caplog.text


def test_too_many_incomplete_frames_are_an_error(camera):
    camera.configure(0.01, 1.0)
    fail_next(camera, 4)
    with pytest.raises(
        CameraError, match="no complete frame in 4 attempts: The buffer was incompletely grabbed"
    ):
        camera.grab()
    assert camera.failed_buffers == 4
    np.testing.assert_array_equal(camera.grab(), counts_of())


def test_no_second_try_if_none_is_wanted(shown):
    camera = BaslerCamera.open(serial=FIRST, image_file=shown, width=COLS, height=ROWS, retries=0)
    try:
        camera.configure(0.01, 1.0)
        fail_next(camera, 1)
        with pytest.raises(CameraError, match="in 1 attempts"):
            camera.grab()
    finally:
        camera.close()


def test_a_picture_that_has_gone_or_changed_its_size(camera, shown):
    camera.configure(0.01, 1.0)
    tifffile.imwrite(shown, np.zeros((24, 32), np.uint16))
    with pytest.raises(CameraError, match=r"shape \(24, 32\) instead of \(48, 64\)"):
        camera.grab()
    shown.unlink()
    assert camera.failed_buffers == 0
    with pytest.raises(CameraError, match="Failed to load image file"):
        camera.grab()


def test_a_frame_that_never_comes_is_no_hang(camera, monkeypatch):
    camera._timeout_s = 0.5
    camera._retries = 1
    camera.configure(0.001, 1.0)
    monkeypatch.setattr(type(camera._device), "ExecuteSoftwareTrigger", lambda device: None)
    with pytest.raises(CameraError, match="in 2 attempts: nothing came in 501 ms"):
        camera.grab()


def test_a_change_of_scene_and_settings_is_in_the_next_frame(camera, shown):
    camera.configure(0.01, 1.0)
    camera.grab()
    tifffile.imwrite(shown, counts_of(7) << 4)
    camera.configure(0.02, 1.0)
    np.testing.assert_array_equal(camera.grab(), counts_of(7))


# -- opening and closing ---------------------------------------------------------------------------------------


def test_a_camera_must_be_named_where_there_are_two():
    with pytest.raises(NotConnected, match=f"there are 2 Basler cameras.*{FIRST}.*{SECOND}"):
        BaslerCamera.open()


def test_a_camera_that_is_not_there():
    with pytest.raises(NotConnected, match=f"no Basler camera with serial number '123'; found: .*{FIRST}"):
        BaslerCamera.open(serial="123")
    with pytest.raises(NotConnected, match="with serial number '1' and name 'left'"):
        BaslerCamera.open(serial="1", name="left")


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (
            {"pixel_format": "RGB8"},
            "pixel_format: expected Mono12, Mono10, Mono8 or .* BayerRG12, not 'RGB8'",
        ),
        ({"retries": -1}, "retries must be 0 or more"),
        ({"image_file": "no.tif"}, "image_file: there is no file no.tif"),
        ({"width": 5000}, "width: must lie between 1 and 4096 in steps of 1, not 5000"),
    ],
)
def test_options_that_make_no_sense(options, expected):
    with pytest.raises(RigFileError, match=expected):
        BaslerCamera.open(serial=FIRST, **options)


def test_a_frame_needs_settings_and_an_open_camera(camera):
    with pytest.raises(CameraError, match="before exposure and gain were set"):
        camera.grab()
    camera.configure(0.01, 1.0)
    camera.close()
    camera.close()
    with pytest.raises(NotConnected, match="is closed: open it again"):
        camera.grab()


def test_through_the_registry(shown):
    camera = open_camera("basler", serial=SECOND, image_file=str(shown), width=COLS, height=ROWS)
    try:
        camera.configure(0.01, 1.0)
        np.testing.assert_array_equal(camera.grab(), counts_of())
    finally:
        camera.close()


def test_without_pypylon_the_remedy_is_named():
    program = (
        "import sys; sys.modules['pypylon'] = None\n"
        "from anisoscope.rig.drivers import open_camera\n"
        "from anisoscope.base.errors import CameraError\n"
        "try: open_camera('basler', serial='1')\n"
        "except CameraError as problem: print(problem)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "pip install 'anisoscope[basler]'" in done.stdout
    assert done.stdout.count("\n") == 1


def unplug(camera):
    camera._device.FirePnPCallbackValue.Value = 1


def test_an_unplugged_camera_is_told(camera):
    camera.configure(0.01, 1.0)
    camera.grab()
    unplug(camera)
    with pytest.raises(NotConnected, match=f"Emulation {FIRST} was unplugged"):
        camera.grab()
    with pytest.raises(NotConnected, match=f"Emulation {FIRST} was unplugged"):
        camera.configure(0.02, 1.0)
    camera.close()
