"""Cameras by GenTL producers: the producer that the package genicam brings for tests, and GenApi on registers.

That producer shows a ball in a frame; it has neither exposure nor trigger. Both are tested on the reference
implementation of GenApi, with the description and the registers of the camera in `gige_camera.py`.
"""

import importlib.util
import signal
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from anisoscope.base.errors import CameraError, NotConnected, RigFileError
from anisoscope.rig.camera import Camera
from anisoscope.rig.cameras.genicam import prepare, set_exposure, set_gain
from anisoscope.rig.cameras.gentl import GenApiFeatures, GentlCamera, Producer
from anisoscope.rig.drivers import open_camera

genicam = pytest.importorskip("genicam", reason="pip install 'anisoscope[genicam]'")
pytest.importorskip("harvesters", reason="pip install 'anisoscope[genicam]'")

PRODUCER = str(Path(genicam.__file__).with_name("viky.cti"))
PLAIN = {"triggered": False, "exposure_s": 0.02, "pixel_format": "Mono8"}


@pytest.fixture
def opened():
    cameras = []

    def open_one(serial="1", **options):
        cameras.append(open_camera("gentl", producer=PRODUCER, serial=serial, **{**PLAIN, **options}))
        return cameras[-1]

    yield open_one
    for camera in cameras:
        camera.close()
        camera.close()
    assert Producer._open == {}, "the producer is let go of"


def test_frames_of_two_cameras_of_one_producer(opened):
    first = opened("1", width=400, height=200, features="BouncingBallSize=25", retries=50)
    second = opened("2", width=300, height=100, features="BouncingBallSize=10", retries=50)
    assert isinstance(first, Camera)
    assert (first.info.model, first.info.serial, first.info.bit_depth) == ("Viky", "1", 8)
    for camera, shape, ball in ((first, (200, 400), 25), (second, (100, 300), 10), (first, (200, 400), 25)):
        assert camera.configure(0.02, 1.0).exposure_s == 0.02
        frame = camera.grab()
        assert (frame.shape, frame.dtype) == (shape, np.uint16)
        assert np.sum(frame == 0) == ball**2, "the ball, and nothing else, is black"


@pytest.mark.parametrize(
    ("options", "error", "expected"),
    [
        ({"producer": "/none.cti"}, RigFileError, "there is no file"),
        ({"producer": ""}, RigFileError, "name the maker's GenTL producer"),
        ({"producer": __file__}, CameraError, "does not load: take the producer for this operating system"),
        ({}, NotConnected, "there are 3 cameras; name one by camera.options.serial: Viky 0, Viky 1, Viky 2"),
        ({"serial": "9"}, NotConnected, "no camera with serial number '9'; found: Viky 0"),
        ({"serial": "1", "triggered": True}, CameraError, "has no setting TriggerSource"),
        ({"serial": "1", "exposure_s": 0.0}, CameraError, "state it as camera.options.exposure_s"),
        ({"serial": "1", "width": 9000}, RigFileError, "width: must lie between 100 and 800"),
        (
            {"serial": "1", "pixel_format": "BayerRG12"},
            CameraError,
            "the camera has no BayerRG12, only RGBa8, Mono8",
        ),
    ],
)
def test_what_is_wrong_is_one_line(monkeypatch, options, error, expected):
    monkeypatch.delenv("GENICAM_GENTL64_PATH", raising=False)
    with pytest.raises(error, match=expected) as caught:
        GentlCamera.open(**{"producer": PRODUCER, **PLAIN, **options})
    assert "\n" not in str(caught.value)
    assert Producer._open == {}


def test_the_producer_that_the_environment_names(monkeypatch):
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(Path(PRODUCER).parent))
    GentlCamera.open(serial="0", **PLAIN).close()


def test_a_camera_has_one_user_and_is_closed_once(opened):
    camera = opened()
    with pytest.raises(NotConnected, match="another program has it"):
        opened()
    camera.configure(0.02, 1.0)
    with pytest.raises(CameraError, match=r"fixed at 0\.02 s and 1, not 0\.01 s and 2"):
        camera.configure(0.01, 2.0)
    camera.close()
    with pytest.raises(NotConnected, match="is closed: open it again"):
        camera.grab()


def test_ctrl_c_interrupts_the_program_and_leaves_the_camera_to_it(opened):
    """Harvesters installs a handler of its own, which gives the camera up and lets the program go on."""
    camera = opened(retries=50)
    camera.configure(0.02, 1.0)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    assert camera.grab().shape == (camera.info.rows, camera.info.cols)


def test_without_harvesters_the_remedy_is_named():
    program = (
        "import sys; sys.modules['harvesters'] = None\n"
        "from anisoscope.rig.drivers import open_camera\n"
        "from anisoscope.base.errors import CameraError\n"
        f"try: open_camera('gentl', producer={PRODUCER!r})\n"
        "except CameraError as problem: print(problem)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "pip install 'anisoscope[genicam]'" in done.stdout
    assert done.stdout.count("\n") == 1


# -- settings, by the reference implementation of GenApi ---------------------------------------------------------


@pytest.fixture
def nodes():
    """A node map over registers in memory, and the registers."""
    from genicam import genapi

    spec = importlib.util.spec_from_file_location("gige_camera", Path(__file__).with_name("gige_camera.py"))
    camera = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(camera)
    registers = {
        address: bytearray(struct.pack(">d" if size == 8 else ">I", first))
        for address, size, first in camera.REGISTERS.values()
    }

    class Port(genapi.AbstractPort):
        def is_open(self):
            return True

        def get_access_mode(self):
            return genapi.EAccessMode.RW

        def read(self, address, length):
            return bytes(registers[address][:length])

        def write(self, address, value):
            registers[address][:] = value

    port = Port()
    found = genapi.NodeMap()
    found.load_xml_from_string(camera.xml().decode())
    found.connect(port, "Device")
    yield found, registers, camera
    found.disconnect()


def test_settings_reach_the_registers(nodes):
    found, registers, camera = nodes
    features = GenApiFeatures(found)
    assert prepare(features, "Mono12p", (12, 16), "ReverseX=1, Decimation=3") == "Mono12p"
    assert set_exposure(features, 0.0123) == pytest.approx(0.0123)
    assert set_gain(features, 2.0) == pytest.approx(2.0)

    def register(name):
        address, size, _ = camera.REGISTERS[name]
        return struct.unpack(">d" if size == 8 else ">I", registers[address])[0]

    assert register("PixelFormat") == 0x010C0047
    assert (register("Width"), register("Height"), register("ReverseX"), register("Decimation")) == (
        16,
        12,
        1,
        3,
    )
    assert (register("TriggerMode"), register("TriggerSource"), register("GainAuto")) == (1, 0, 0)
    assert register("ExposureTime") == pytest.approx(12_300.0)
    assert register("Gain") == pytest.approx(6.0206, abs=1e-4)
    features.execute("TriggerSoftware")
    assert register("TriggerSoftware") == 1


def test_a_setting_that_a_camera_does_not_keep_is_an_error(nodes):
    found, registers, camera = nodes
    features = GenApiFeatures(found)
    with pytest.raises(CameraError, match=r"must lie between 1e-05 s and 1 s, not 5 s"):
        set_exposure(features, 5.0)

    class Stubborn(bytearray):
        def __setitem__(self, *_):
            pass

    registers[camera.REGISTERS["ExposureTime"][0]] = Stubborn(struct.pack(">d", 5000.0))
    with pytest.raises(CameraError, match=r"an exposure of 0\.02 s was asked for, the camera took 0\.005 s"):
        set_exposure(features, 0.02)
