"""The driver of GigE Vision cameras through Aravis, against two cameras that are processes of their own.

One is in this folder (`gige_camera.py`) and has faults at chosen frames; the other is the fake camera of Aravis itself.
"""

import contextlib
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from anisoscope.base.errors import CameraError, NotConnected, RigFileError
from anisoscope.rig.camera import Camera
from anisoscope.rig.cameras import aravis
from anisoscope.rig.cameras.aravis import AravisCamera
from anisoscope.rig.drivers import open_camera

try:
    aravis.load()
except CameraError as problem:
    pytest.skip(str(problem), allow_module_level=True)

ROWS, COLS = 24, 32
WHOLE = 50  # attempts that a busy machine may need for a frame
FAKE = shutil.which("arv-fake-gv-camera-0.8") or shutil.which("arv-fake-gv-camera-0.10")
SCRIPT = Path(__file__).with_name("gige_camera.py")


def counts_of(number, bits=12):
    """What the camera of this folder shows in its n-th frame."""
    rows, cols = np.mgrid[:ROWS, :COLS]
    return (7 * cols + 13 * rows + 29 * number) % (1 << bits)


def which_frame(counts, bits=12):
    """The number of the frame that is shown whole; None for one that is torn."""
    number = int(counts[0, 0]) * pow(29, -1, 1 << bits) % (1 << bits)
    return number if np.array_equal(counts, counts_of(number, bits)) else None


@pytest.fixture
def camera_process():
    """``camera_process(faults)`` starts a camera: its process and its address."""
    started = []

    def start(faults=""):
        process = subprocess.Popen(
            [sys.executable, "-I", str(SCRIPT), "--faults", faults],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process, process.stdout.readline().strip()

    yield start
    for process in started:
        with process:
            process.kill()


@pytest.fixture
def opened():
    cameras = []

    def open_one(address="", **options):
        cameras.append(AravisCamera.open(address=address, **{"retries": WHOLE, **options}))
        return cameras[-1]

    yield open_one
    for camera in cameras:
        camera.close()
        camera.close()


# -- frames and settings -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pixel_format", "bits", "filters"),
    [
        ("Mono8", 8, "mono"),
        ("Mono10", 10, "mono"),
        ("Mono10Packed", 10, "mono"),
        ("Mono10p", 10, "mono"),
        ("Mono12", 12, "mono"),
        ("Mono12Packed", 12, "mono"),
        ("Mono12p", 12, "mono"),
        ("BayerRG12p", 12, "rggb"),
    ],
)
def test_counts_come_back_one_by_one(camera_process, opened, pixel_format, bits, filters):
    camera = opened(camera_process()[1], pixel_format=pixel_format)
    assert isinstance(camera, Camera)
    info = camera.info
    assert (info.model, info.serial, info.rows, info.cols) == ("Loop", "LB01", ROWS, COLS)
    assert (info.bit_depth, info.filters, info.linear) == (bits, filters, True)
    camera.configure(0.01, 1.0)
    frame = camera.grab()
    assert frame.dtype == np.uint16
    assert which_frame(frame, bits) is not None


def test_settings_and_features_by_name(camera_process, opened):
    camera = opened(camera_process()[1], features="ReverseX=true, Decimation=2", width=16, height=8)
    features = camera._features
    assert (features.get("ReverseX"), features.get("Decimation"), features.get("GainAuto")) == (
        True,
        2,
        "Off",
    )
    assert (camera.info.rows, camera.info.cols) == (8, 16)
    settings = camera.configure(0.0123, 2.0)
    assert settings.exposure_s == pytest.approx(0.0123)
    assert settings.gain == pytest.approx(2.0)
    assert features.get("Gain") == pytest.approx(6.0206, abs=1e-4)
    np.testing.assert_array_equal(camera.grab()[0, ::-1], counts_of(1)[0, :16])
    with pytest.raises(CameraError, match="must lie between 1e-05 s and 1 s, not -5 s"):
        camera.configure(-5.0, 1.0)
    with pytest.raises(CameraError, match=r"the gain must lie between 1 and 15\.85, not 0\.5"):
        camera.configure(0.01, 0.5)
    with pytest.raises(CameraError, match="before exposure and gain were set"):
        camera.grab()


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"features": "Zoom=2"}, "features: Zoom: the camera has no such feature"),
        ({"features": "Decimation=9"}, "Decimation: must lie between 1 and 4, not 9"),
        ({"features": "Decimation=two"}, r"'two' is not of its type \(int\)"),
        ({"features": "GainAuto=Maybe"}, "'Maybe' is none of Off, Continuous"),
        ({"features": "ReverseX"}, "expected NAME=VALUE"),
        ({"width": 33}, "width: must lie between 8 and 32 in steps of 4, not 33"),
        ({"pixel_format": "RGB8"}, "pixel_format: expected Mono12"),
        ({"packet_size": -1}, "packet_size and reconnect_s must be 0 or more"),
    ],
)
def test_options_that_make_no_sense(camera_process, opened, options, expected):
    address = camera_process()[1]
    with pytest.raises(RigFileError, match=expected):
        opened(address, **options)


def test_a_frame_carries_its_time_and_exposure(camera_process, opened):
    camera = opened(camera_process()[1])
    assert camera._connection.chunks == ("Timestamp", "ExposureTime")
    camera.configure(0.02, 1.0)
    camera.grab()
    first = camera.stamp
    camera.grab()
    assert camera.stamp.time_ns > first.time_ns > 0
    assert camera.stamp.exposure_s == pytest.approx(0.02)


# -- what is refused ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("faults", "reason"),
    [
        ("2=lose:0", "incomplete"),
        ("2=lose:2", "incomplete"),
        ("2=lose:-1", "incomplete"),
        ("2=silent", "nothing came"),
        ("2=short", "incomplete"),
        ("2=size", "of another pixel format, came"),
        ("2=format", "of another pixel format, came"),
        ("2=old", "not later than the one before"),
        ("2=exposure", "exposed for 0.03 s instead of 0.01 s"),
    ],
)
def test_a_frame_that_is_not_right_is_taken_again(camera_process, opened, caplog, faults, reason):
    camera = opened(camera_process(faults)[1], timeout_s=0.5)
    camera.configure(0.01, 1.0)
    shown = []
    while len(shown) < 2 or shown[-1] < 3:
        shown.append(which_frame(camera.grab()))
        assert shown[-1] is not None, "torn"
    assert shown == sorted(set(shown))
    assert 2 not in shown
    assert reason in caplog.text
    assert camera.failed_buffers >= 1


def test_a_stream_of_which_nothing_comes_names_what_holds_it_back(camera_process, opened):
    camera = opened(camera_process("1=silent,2=silent")[1], retries=0, timeout_s=0.3)
    camera.configure(0.01, 1.0)
    with pytest.raises(
        CameraError, match="no packet at all: a firewall holds them back, or the reverse-path filter"
    ):
        camera.grab()


def test_too_many_lost_frames_are_an_error(camera_process, opened):
    faults = ",".join(f"{number}=lose:2" for number in range(1, 9))
    camera = opened(camera_process(faults)[1], retries=1, timeout_s=0.5)
    camera.configure(0.01, 1.0)
    with pytest.raises(CameraError, match=r"no complete frame in 2 attempts: .*; check cable"):
        camera.grab()


# -- a camera that goes away -------------------------------------------------------------------------------------


def test_a_camera_that_went_away_and_came_back_has_its_settings_again(opened, caplog, fake):
    """The process is killed between two frames; the one that takes its place knows nothing of us."""
    with fake():
        while "Fake GV01" not in (found := who_is_there()):  # the library waits one second for answers
            assert found.startswith(
                "there is no GigE Vision or USB3 Vision camera with serial number 'none'; found: "
            )
        options = {"pixel_format": "Mono16", "width": 64, "height": 32, "packet_size": 1000}
        camera = None
        while camera is None:
            with contextlib.suppress(NotConnected):
                camera = opened(serial="GV01", reconnect_s=600.0, **options)
        camera.configure(0.01, 1.0)
        assert is_ramp(camera.grab())
    with fake():
        assert is_ramp(camera.grab())
        features = camera._features
        assert (features.get("PixelFormat"), features.get("TriggerMode")) == ("Mono16", "On")
        assert float(features.get("ExposureTimeAbs")) == pytest.approx(10_000.0)
        camera.close()
    assert "is back" in caplog.text


def test_a_camera_that_stays_away_is_an_error(camera_process, opened, monkeypatch):
    process, address = camera_process()
    camera = opened(address, reconnect_s=0.0)
    camera.configure(0.01, 1.0)
    camera.grab()
    process.kill()
    process.wait()
    with pytest.raises(NotConnected, match=r"Loop LB01 does not answer .*; check power, cable and network"):
        camera.grab()

    def nothing(*_):
        raise NotConnected("silence")

    monkeypatch.setattr(aravis, "Connection", nothing)
    camera._reconnect_s = 1e-9
    with pytest.raises(NotConnected, match="did not come back in 1e-09 s: check power, cable and network"):
        camera.grab()


def test_another_camera_in_its_place_is_not_taken(camera_process, opened, monkeypatch):
    process, address = camera_process()
    camera = opened(address, reconnect_s=600.0)
    camera.configure(0.01, 1.0)
    monkeypatch.setattr(camera, "_device_id", camera_process()[1])
    camera._wanted = aravis.Wanted("Mono12", (12, 16), "", 0)
    process.kill()
    process.wait()
    with pytest.raises(
        CameraError, match="went away; what came back is another camera, or otherwise set: Loop LB01, 16 × 12"
    ):
        camera.grab()


def test_a_camera_has_one_user(camera_process, opened):
    address = camera_process()[1]
    opened(address)
    with pytest.raises(NotConnected, match="in use by another program"):
        opened(address)


def test_a_closed_camera(camera_process, opened):
    camera = opened(camera_process()[1])
    camera.configure(0.01, 1.0)
    camera.close()
    for use in (camera.grab, lambda: camera.configure(0.02, 1.0)):
        with pytest.raises(NotConnected, match="is closed: open it again"):
            use()


def test_without_the_library_the_remedy_is_named():
    with pytest.raises(CameraError, match=r"apt-get install libaravis-0\.8-0, or name its file"):
        open_camera("aravis", library="/none/libaravis.so")


# -- Aravis' own camera ------------------------------------------------------------------------------------------


@pytest.fixture
def fake():
    """``with fake(lost) as address``: Aravis' fake camera. It has one address, so that one user of it at a time."""
    if not FAKE:
        pytest.skip("apt-get install aravis-tools")
    import fcntl  # where the camera is, there is POSIX

    lock = Path(tempfile.gettempdir(), "anisoscope-fake-gv-camera.lock").open("w")  # noqa: SIM115
    fcntl.flock(lock, fcntl.LOCK_EX)

    class Running:
        def __init__(self, lost=0.0):
            self.lost = lost

        def __enter__(self):
            self.process = subprocess.Popen([FAKE, "-i", "127.0.0.1", "-r", str(1000 * self.lost)])
            while not answers("127.0.0.1"):
                assert self.process.poll() is None, "the fake camera did not start"
            return "127.0.0.1"

        def __exit__(self, *_):
            self.process.send_signal(signal.SIGKILL)
            self.process.wait()

    yield Running
    lock.close()


def answers(address):
    try:
        AravisCamera.open(address=address, pixel_format="Mono16").close()
    except NotConnected:
        return False
    return True


def who_is_there():
    with pytest.raises(NotConnected) as caught:
        AravisCamera.open(serial="none")
    return str(caught.value)


def is_ramp(counts):
    """Whether a frame of the fake camera is whole: counts in 256 steps along rows and columns, from any first one."""
    rows, cols = np.mgrid[: counts.shape[0], : counts.shape[1]]
    return np.array_equal(counts, (int(counts[0, 0]) + 256 * (cols + rows)) % 65535)


def frames(opened, fake, lost, count):
    """Take so many frames of the fake camera; returns how many attempts failed."""
    with fake(lost) as address:
        camera = opened(
            address,
            pixel_format="Mono16",
            width=64,
            height=32,
            retries=10_000,
            reconnect_s=600.0,
            timeout_s=0.2,
        )
        camera.configure(0.01, 1.0)
        for _ in range(count):
            assert is_ramp(camera.grab()), "torn"
        camera.close()
        return camera.failed_buffers


def test_with_lost_packets_no_torn_frame_is_taken(opened, fake):
    assert frames(opened, fake, 0.2, 4) >= 0


@pytest.mark.soak
@pytest.mark.parametrize("lost", [0.0, 0.01, 0.05, 0.1, 0.2])
def test_of_ten_thousand_frames_none_is_torn(opened, fake, lost):
    failed = frames(opened, fake, lost, 2000)
    assert (failed > 0) == (lost > 0.0), "packets are lost, or none are"
