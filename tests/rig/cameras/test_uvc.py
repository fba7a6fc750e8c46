"""The UVC driver against a camera that behaves badly, and against OpenCV itself reading files."""

import threading
import time

import cv2
import numpy as np
import pytest

from anisoscope.base.errors import CameraError, NotConnected, RigFileError
from anisoscope.rig.camera import Camera
from anisoscope.rig.cameras.uvc import UvcCamera, name_of
from anisoscope.rig.drivers import open_camera

ROWS, COLS = 48, 64


def ramp():
    """A scene that is full scale, in its brightest column, at an exposure of 20 ms."""
    return np.tile(np.linspace(2.0, 50.0, COLS), (ROWS, 1))


@pytest.fixture
def opened(fake_uvc):
    """Opens a camera on a fake device of given habits; returns both."""
    cameras = []

    def open_it(scene=None, habits=(), **options):
        device = fake_uvc(ramp() if scene is None else scene, **dict(habits))
        options = {"backend": "v4l2", "timeout_s": 60.0} | options
        cameras.append(UvcCamera.open(capture=lambda *_: device, **options))
        return cameras[-1], device

    yield open_it
    for camera in cameras:
        camera.close()


def expected(exposure_s, scene=None):
    return 255.0 * np.clip((ramp() if scene is None else scene) * exposure_s, 0.0, 1.0)


def test_counts_follow_light_and_exposure(opened):
    camera, device = opened()
    assert isinstance(camera, Camera)
    assert (camera.info.rows, camera.info.cols, camera.info.bit_depth) == (ROWS, COLS, 8)
    assert not camera.info.linear
    for exposure_s in (0.01, 0.005, 0.02):
        settings = camera.configure(exposure_s, 1.0)
        assert (settings.exposure_s, settings.gain) == (pytest.approx(exposure_s), 1.0)
        counts = camera.grab()
        assert (counts.dtype, counts.shape) == (np.uint16, (ROWS, COLS))
        np.testing.assert_allclose(counts.mean(axis=0), expected(exposure_s)[0], atol=0.7)
    assert device.values[cv2.CAP_PROP_AUTO_EXPOSURE] == 1.0
    assert device.values[cv2.CAP_PROP_AUTO_WB] == 0.0
    assert camera.notes == ("autofocus has no switch",)


@pytest.mark.parametrize("habits", [{}, {"keeps_queue": True}, {"keeps_queue": True, "queue_length": 9}])
def test_frames_from_before_a_turn_or_a_change_are_thrown_away(opened, habits):
    camera, device = opened(habits=habits)
    camera.configure(0.01, 1.0)
    bright = expected(0.01).mean()
    for scene, share in ((0.5 * ramp(), 0.5), (ramp(), 1.0), (0.25 * ramp(), 0.25)):
        device.turn_to(scene)
        assert camera.grab().mean() == pytest.approx(share * bright, rel=0.01)
    camera.configure(0.02, 1.0)
    assert camera.grab().mean() == pytest.approx(0.5 * bright, rel=0.01)


def test_frames_are_thrown_away_after_opening(opened):
    _, device = opened(warmup_frames=25)
    assert device.frames_read == 27


# -- exposure --------------------------------------------------------------------------------------------------


def test_the_exposure_that_comes_back_is_the_one_that_the_camera_has(opened):
    camera, device = opened(habits={"steps": (1, 5, 10, 39, 78, 102, 156, 312)})
    assert camera.configure(0.01, 1.0).exposure_s == pytest.approx(0.0102)
    assert device.values[cv2.CAP_PROP_EXPOSURE] == 102.0
    with pytest.raises(CameraError, match=r"exposure: 60 \(0.006 s\) was asked for, 78 \(0.0078 s\) came"):
        camera.configure(0.006, 1.0)
    with pytest.raises(CameraError, match="before exposure and gain were set"):
        camera.grab()  # the camera is in no state that was asked for


@pytest.mark.parametrize(
    ("exposure_s", "gain", "message"),
    [
        (0.0, 1.0, "the exposure must be above 0 s"),
        (float("nan"), 1.0, "the exposure must be above 0 s"),
        (1e-5, 1.0, "the backend v4l2 has steps of 0.0001 s"),
        (1.0, 1.0, r"exposure: 10000 \(1 s\) was asked for, 5000 \(0.5 s\) came"),
        (0.01, 2.0, "no gain in known units: ask for gain 1, not 2"),
    ],
)
def test_settings_that_cannot_be(opened, exposure_s, gain, message):
    camera, _ = opened()
    with pytest.raises(CameraError, match=message):
        camera.configure(exposure_s, gain)


class LogCapture:
    """A DirectShow camera: exposure in powers of two, auto exposure off at 0, pictures in colour."""

    def __init__(self):
        self.values = {cv2.CAP_PROP_FRAME_WIDTH: COLS, cv2.CAP_PROP_FRAME_HEIGHT: ROWS}
        self.values |= {cv2.CAP_PROP_EXPOSURE: -6.0, cv2.CAP_PROP_AUTO_EXPOSURE: 1.0}
        self.released = 0

    def isOpened(self):  # noqa: N802
        return True

    def get(self, prop):
        return float(self.values.get(prop, -1.0))

    def set(self, prop, value):
        if prop == cv2.CAP_PROP_EXPOSURE and value != int(value):
            return False
        self.values[prop] = max(value, -11.0) if prop == cv2.CAP_PROP_EXPOSURE else value
        return prop in {cv2.CAP_PROP_EXPOSURE, cv2.CAP_PROP_AUTO_EXPOSURE}

    def grab(self):
        return True

    def read(self):
        light = ramp() * 2.0 ** self.values[cv2.CAP_PROP_EXPOSURE]
        grey = np.clip(np.rint(255 * light), 0, 255).astype(np.uint8)
        return True, np.stack([grey // 2, grey, grey // 4], axis=2)

    def release(self):
        self.released += 1


@pytest.mark.parametrize("backend", ["dshow", "msmf"])
def test_windows_counts_exposure_in_powers_of_two(backend):
    device = LogCapture()
    camera = UvcCamera.open(backend=backend, capture=lambda *_: device)
    try:
        assert camera.configure(0.010, 1.0).exposure_s == 2.0**-7  # 7.8 ms, the nearest that there is
        assert camera.configure(1 / 64, 1.0).exposure_s == 2.0**-6
        assert device.values[cv2.CAP_PROP_AUTO_EXPOSURE] == 0.0
        counts = camera.grab()
        grey = np.rint(255 * ramp() / 64)
        luma = 0.299 * (grey // 4) + 0.587 * grey + 0.114 * (grey // 2)
        np.testing.assert_allclose(counts, luma, atol=0.51)
        with pytest.raises(CameraError, match=r"-17 \(.*\) was asked for, -11 \(.*\) came"):
            camera.configure(1e-5, 1.0)
    finally:
        camera.close()


def test_macos_sets_no_exposure():
    camera = UvcCamera.open(backend="avfoundation", capture=lambda *_: LogCapture())
    with pytest.raises(CameraError, match="the backend avfoundation cannot set the exposure"):
        camera.configure(0.01, 1.0)
    camera.close()


# -- what cameras refuse ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("habits", "options", "message"),
    [
        ({"refuses": {cv2.CAP_PROP_AUTO_EXPOSURE}}, {}, "auto exposure: 1 was asked for, 3 came"),
        ({"lies": {cv2.CAP_PROP_AUTO_WB: 1.0}}, {}, "auto white balance: 0 was asked for, 1 came"),
        ({"refuses": {cv2.CAP_PROP_GAIN}}, {"gain_raw": 0.0}, "gain: 0 was asked for, 32 came"),
        ({}, {"width": 640, "height": 480}, "640 x 480 pixels were asked for, 64 x 48 came"),
        ({}, {"fourcc": "NV12"}, "format NV12 was asked for, MJPG came"),
    ],
)
def test_a_camera_that_refuses_is_told_at_opening(opened, habits, options, message):
    with pytest.raises(CameraError, match=message):
        opened(habits=habits, **options)


def test_a_camera_that_refuses_an_exposure(opened):
    camera, device = opened()
    device.refuses.add(cv2.CAP_PROP_EXPOSURE)
    with pytest.raises(
        CameraError, match=r"exposure: 100 \(0.01 s\) was asked for and refused; it stays at 120"
    ):
        camera.configure(0.01, 1.0)


def test_auto_exposure_that_comes_on_again(opened):
    camera, device = opened()
    device.lies[cv2.CAP_PROP_AUTO_EXPOSURE] = 3.0
    with pytest.raises(CameraError, match="auto exposure was switched off and is on again"):
        camera.configure(0.01, 1.0)


def test_gain_size_and_format_are_set(opened):
    camera, device = opened(width=32, height=24, gain_raw=0.0, habits={"formats": ("GREY", "YUYV")})
    assert (camera.info.rows, camera.info.cols) == (24, 32)
    assert device.values[cv2.CAP_PROP_GAIN] == 0.0
    assert device.values[cv2.CAP_PROP_FOURCC] == cv2.VideoWriter.fourcc(*"GREY")
    camera.configure(0.01, 1.0)
    np.testing.assert_allclose(camera.grab().mean(axis=0), expected(0.01)[0, :32], atol=0.7)


def test_colour_is_used_where_there_is_no_raw_plane(opened):
    camera, device = opened(habits={"formats": ("MJPG",)})
    assert device.values[cv2.CAP_PROP_CONVERT_RGB] == 1.0
    camera.configure(0.01, 1.0)
    np.testing.assert_allclose(camera.grab().mean(axis=0), expected(0.01)[0], atol=0.7)


def test_normalised_properties_are_switched_off(fake_uvc):
    device = fake_uvc(ramp())
    device.values[cv2.CAP_PROP_MODE] = 1448695129.0
    UvcCamera.open(backend="v4l2", capture=lambda *_: device).close()
    assert device.values[cv2.CAP_PROP_MODE] == 0.0


def test_what_clips_below_full_scale_is_said_to_be_clipped(opened):
    camera, _ = opened(habits={"black": 16, "white": 235}, white_level=235, black_level=16.0)
    camera.configure(0.03, 1.0)
    counts = camera.grab()
    assert counts[:, -1].min() == 255
    assert (counts[:, 0] < 40).all()
    assert camera.info.black_level == 16.0


# -- proof -----------------------------------------------------------------------------------------------------


def test_the_proof_of_an_honest_camera(opened):
    camera, _ = opened(habits={"exponent": 1 / 2.2})
    proof = camera.prove_exposure((0.004, 0.008, 0.016))
    assert proof.exponents == pytest.approx((1 / 2.2, 1 / 2.2), abs=0.02)
    assert proof.exposures_s == pytest.approx((0.004, 0.008, 0.016, 0.004))
    assert proof.drift < 0.01


def test_a_camera_that_says_manual_and_adjusts_nevertheless(opened):
    camera, device = opened(habits={"fights_back": True})
    assert camera.configure(0.004, 1.0).exposure_s == pytest.approx(0.004)
    assert device.get(cv2.CAP_PROP_AUTO_EXPOSURE) == 1.0  # as it says
    with pytest.raises(CameraError, match="auto exposure"):
        camera.prove_exposure((0.004, 0.016))


# -- unplugged -------------------------------------------------------------------------------------------------


def test_an_unplugged_camera_is_told(opened):
    camera, device = opened()
    camera.configure(0.01, 1.0)
    device.unplugged = True
    with pytest.raises(NotConnected, match=r"camera 0 \(v4l2\) delivers no frames: was it unplugged"):
        camera.grab()
    device.unplugged = False
    with pytest.raises(NotConnected, match="was it unplugged"):
        camera.grab()


def test_one_damaged_frame_is_no_unplugging(opened):
    camera, device = opened()
    camera.configure(0.01, 1.0)
    device.fails = 1
    assert camera.grab().mean() == pytest.approx(expected(0.01).mean(), rel=0.01)


def test_a_camera_that_hangs_does_not_hang_us(opened):
    camera, device = opened()
    camera.configure(0.01, 1.0)
    camera._capture._timeout_s = 0.2
    device.hangs.clear()
    begin = time.monotonic()
    try:
        with pytest.raises(NotConnected, match=r"did not deliver a frame in 0\.21 s: was it unplugged"):
            camera.grab()
        with pytest.raises(NotConnected, match="was it unplugged"):
            camera.configure(0.01, 1.0)
        camera.close()
        assert time.monotonic() - begin < 60.0  # the fake would hang for ever
        assert device.released == 0
    finally:
        device.hangs.set()
    deadline = time.monotonic() + 60.0
    while not device.released and time.monotonic() < deadline:
        time.sleep(0.01)
    assert device.released == 1  # as soon as it lets go


def test_a_camera_that_is_not_there(fake_uvc):
    device = fake_uvc(ramp())
    device.isOpened = lambda: False
    with pytest.raises(NotConnected, match=r"there is no camera 3 \(v4l2\), or another program uses it"):
        UvcCamera.open(device=3, backend="v4l2", capture=lambda *_: device)


@pytest.mark.parametrize("device", [97, "97", "/dev/video97"])
def test_opencv_itself_finds_no_camera(device):
    with pytest.raises(NotConnected, match=r"there is no camera (97|/dev/video97) \(v4l2\)"):
        open_camera("uvc", device=device, backend="v4l2")


def test_an_opener_that_fails(fake_uvc):
    def fail(*_):
        raise cv2.error("many\nlines")

    with pytest.raises(CameraError, match="could not open: many lines"):
        UvcCamera.open(backend="v4l2", capture=fail)


def test_closing(opened):
    camera, device = opened()
    camera.configure(0.01, 1.0)
    camera.close()
    camera.close()
    assert device.released == 1
    with pytest.raises(NotConnected, match="is closed"):
        camera.configure(0.01, 1.0)


def test_no_thread_is_left(opened):
    before = set(threading.enumerate())
    camera, _ = opened()
    (own,) = set(threading.enumerate()) - before
    camera.close()
    own.join(timeout=60.0)
    assert not own.is_alive()


# -- options ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"backend": "gstreamer"},
            "backend: expected default, v4l2, dshow, msmf, avfoundation, not 'gstreamer'",
        ),
        ({"width": 640}, "width: must be given together with height"),
        ({"settle_frames": 0}, "settle_frames: must be 1 or more"),
        ({"warmup_frames": -1}, "warmup_frames: must be 0 or more"),
        ({"timeout_s": 0.0}, "timeout_s: must be above 0"),
        ({"white_level": 300}, "white_level: must be above black_level, 255 at most"),
        ({"fourcc": "YUV"}, "fourcc: expected four letters"),
    ],
)
def test_options_that_make_no_sense(opened, options, message):
    with pytest.raises(RigFileError, match=message):
        opened(**options)


def test_a_backend_that_this_opencv_lacks():
    names = {"v4l2": "CAP_V4L2", "dshow": "CAP_DSHOW", "avfoundation": "CAP_AVFOUNDATION"}
    there = cv2.videoio_registry.getCameraBackends()
    missing = next(name for name, api in names.items() if getattr(cv2, api) not in there)
    with pytest.raises(RigFileError, match=f"{missing} is not on this computer; there is:"):
        open_camera("uvc", backend=missing)


def test_the_name_is_that_of_the_operating_system(tmp_path):
    device = tmp_path / "usb" / "1-2" / "1-2:1.0"
    node = tmp_path / "class" / "video2"
    device.mkdir(parents=True)
    node.mkdir(parents=True)
    (node / "name").write_text("HD Microscope: UVC\n")
    (node / "device").symlink_to(device)
    (device.parent / "serial").write_text("A1B2\n")
    assert name_of(2, tmp_path / "class") == ("HD Microscope: UVC", "A1B2")
    assert name_of("/dev/video2", tmp_path / "class") == ("HD Microscope: UVC", "A1B2")
    assert name_of(5, tmp_path / "class") == ("UVC camera 5", "video5")


# -- OpenCV itself ---------------------------------------------------------------------------------------------


class FileCapture:
    """``cv2.VideoCapture`` on a file: pictures come from OpenCV, the exposure is only remembered."""

    def __init__(self, path, api):
        self.inner = cv2.VideoCapture(str(path), api)
        self.values = {cv2.CAP_PROP_EXPOSURE: 100.0, cv2.CAP_PROP_AUTO_EXPOSURE: 1.0}

    def set(self, prop, value):
        if prop in self.values:
            self.values[prop] = value
            return True
        return prop != cv2.CAP_PROP_FOURCC and self.inner.set(prop, value)

    def get(self, prop):
        return self.values.get(prop) or self.inner.get(prop)

    def __getattr__(self, name):
        return getattr(self.inner, name)


def images(folder):
    for number in range(40):
        cv2.imwrite(str(folder / f"f{number:02d}.png"), np.full((ROWS, COLS, 3), 5 * number, np.uint8))
    return folder / "f%02d.png", cv2.CAP_IMAGES


def video(folder):
    path = folder / "v.avi"
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"FFV1"), 25.0, (COLS, ROWS))
    assert writer.isOpened()
    for number in range(40):
        writer.write(np.full((ROWS, COLS, 3), 5 * number, np.uint8))
    writer.release()
    return path, cv2.CAP_FFMPEG


@pytest.mark.parametrize("make", [images, video])
def test_opencv_reads_pictures_from_files(make, tmp_path):
    path, api = make(tmp_path)
    camera = UvcCamera.open(capture=lambda *_: FileCapture(path, api), warmup_frames=3, settle_frames=2)
    try:
        assert (camera.info.rows, camera.info.cols) == (ROWS, COLS)
        camera.configure(0.01, 1.0)
        # 3 + 1 frames to warm up, one to see the size; then 4 + 1 that may wait in a queue, and 2 to settle
        first = camera.grab()
        assert first.min() == first.max()
        assert first[0, 0] == pytest.approx(5 * 12, abs=1)
        assert camera.grab()[0, 0] == pytest.approx(5 * 18, abs=1)
        for _ in range(3):
            camera.grab()
        with pytest.raises(NotConnected, match="delivers no frames"):
            camera.grab()
    finally:
        camera.close()


def test_what_opencv_says_of_a_missing_camera_does_not_reach_the_terminal(capfd, monkeypatch):
    monkeypatch.delenv("OPENCV_LOG_LEVEL", raising=False)
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_WARNING)
    try:
        with pytest.raises(NotConnected, match="there is no camera 77"):
            open_camera("uvc", device=77, backend="v4l2")
    finally:
        cv2.utils.logging.setLogLevel(level)
    assert capfd.readouterr().err == ""
