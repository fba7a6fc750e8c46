"""The camera of a bench over TCP: the real driver, and clients that know only the written protocol."""

import json
import socket
import subprocess
import sys
import textwrap
import threading
from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import CameraError, NotConnected, ProtocolError, RigFileError
from anisoscope.rig.camera import Camera, CameraInfo, CameraSettings
from anisoscope.rig.drivers import open_camera
from anisoscope.sim.bench.camera import SimulatedCamera
from anisoscope.sim.bench.camera_server import CameraServer

INFO = CameraInfo("counting camera", "7", rows=3, cols=5, bit_depth=12, black_level=64.0, pixel_pitch_um=3.45)


class CountingCamera:
    """Frames that say which they are and how they were exposed."""

    def __init__(self):
        self.info = INFO
        self.settings = CameraSettings(0.0, 0.0)
        self.closed = threading.Event()
        self.blocked = threading.Event()
        self.blocked.set()

    def configure(self, exposure_s, gain):
        if exposure_s > 1.0:
            raise CameraError("too long,\nby far")
        self.settings = CameraSettings(round(exposure_s, 3), gain)
        return self.settings

    def grab(self):
        self.blocked.wait(30)
        return (np.arange(15, dtype=np.uint16) * 4369).reshape(3, 5)[::-1] + np.uint16(self.settings.gain)

    def close(self):
        self.closed.set()


@pytest.fixture
def served():
    """A served camera: ``opened`` lists those made for clients."""
    opened = []

    def open_one():
        opened.append(CountingCamera())
        return opened[-1]

    with CameraServer(open_one) as server:
        server.opened = opened
        yield server


def test_the_driver_is_the_camera_that_is_served(served):
    camera = open_camera("simulated", port=served.port)
    assert isinstance(camera, Camera)
    assert camera.info == INFO
    assert camera.configure(0.0123456, 3.0) == CameraSettings(0.012, 3.0)
    frame = camera.grab()
    assert (frame.dtype, frame.flags.writeable) == (np.uint16, True)
    assert np.array_equal(frame, served.opened[0].grab())
    camera.close()
    camera.close()
    assert served.opened[0].closed.wait(60)
    with pytest.raises(NotConnected, match="open it again"):
        camera.grab()


def test_a_colour_camera_says_so_through_the_line_and_unknown_filters_are_refused():
    coloured = CountingCamera()
    coloured.info = replace(INFO, filters="grbg")
    with CameraServer(lambda: coloured) as server:
        camera = open_camera("simulated", port=server.port)
        assert camera.info.filters == "grbg"
        camera.close()
        object.__setattr__(coloured.info, "filters", "rgbw")
        with pytest.raises(ProtocolError, match="not as a simulated camera does"):
            open_camera("simulated", port=server.port)


def test_clients_have_settings_of_their_own(served):
    one, two = (open_camera("simulated", port=served.port) for _ in range(2))
    one.configure(0.01, 1.0)
    two.configure(0.01, 9.0)
    assert np.all(two.grab() - one.grab() == 8)
    one.close()
    two.close()


def test_a_refusal_is_the_cameras_and_the_line_stays_open(served):
    camera = open_camera("simulated", port=served.port)
    with pytest.raises(CameraError, match=r"^too long, by far$"):
        camera.configure(2.0, 1.0)
    assert camera.grab().shape == (3, 5)
    camera.close()


def test_any_program_can_take_a_picture(served):
    """As the protocol is written down: one line each way, raw little-endian counts after it."""
    host, port = served.port.split(":")
    with socket.create_connection((host, int(port)), timeout=60) as line, line.makefile("rb") as answers:
        line.sendall(b'{"do": "info"}\n')
        info = json.loads(answers.readline())
        assert (info["protocol"], info["rows"], info["cols"], info["bit_depth"]) == (1, 3, 5, 12)
        line.sendall(b'{"do": "configure", "exposure_s": 0.5, "gain": 2}\n{"do": "grab"}\n')
        assert json.loads(answers.readline()) == {"exposure_s": 0.5, "gain": 2.0}
        head = json.loads(answers.readline())
        assert head == {"rows": 3, "cols": 5, "bytes": 30}
        data = answers.read(30)
        assert data[:4] == (43690 + 2).to_bytes(2, "little") + (48059 + 2).to_bytes(2, "little")


@pytest.mark.parametrize(
    "line", [b"hello", b"[]", b'{"do": "configure"}', b'{"do": "dance"}', b"\xff\x00", b'"x"']
)
def test_nonsense_is_answered_with_one_line(served, line):
    host, port = served.port.split(":")
    with socket.create_connection((host, int(port)), timeout=60) as client, client.makefile("rb") as answers:
        client.sendall(line + b"\n")
        assert set(json.loads(answers.readline())) == {"error"}
        client.sendall(b'{"do": "info"}\n')
        assert json.loads(answers.readline())["protocol"] == 1


def test_a_server_that_goes_is_not_connected(served):
    camera = open_camera("simulated", port=served.port)
    waiting = served.opened[0].blocked
    waiting.clear()
    threading.Timer(0.2, served.close).start()
    with pytest.raises(NotConnected, match="has gone; start it again"):
        camera.grab()
    waiting.set()
    with pytest.raises(NotConnected, match=f"camera on {served.port}"):
        open_camera("simulated", port=served.port)


def test_a_camera_that_does_not_answer_is_given_up(served):
    camera = open_camera("simulated", port=served.port)
    camera._timeout_s = 0.2
    served.opened[0].blocked.clear()
    with pytest.raises(NotConnected, match="does not answer"):
        camera.grab()
    served.opened[0].blocked.set()


def test_a_program_that_ends_while_a_picture_is_rendered_ends_with_its_own_code():
    """A thread that Python's end cuts off within native code, here that which transforms, takes the program down."""
    script = textwrap.dedent("""
        import sys, threading, time
        import numpy as np
        import scipy.fft
        from anisoscope.rig.camera import CameraInfo
        from anisoscope.rig.drivers import open_camera
        from anisoscope.base.errors import NotConnected
        from anisoscope.sim.bench.camera_server import CameraServer

        begun = threading.Event()

        class Slow:
            info = CameraInfo("slow camera", "7", rows=3, cols=5, bit_depth=12, black_level=64.0)

            def grab(self):
                begun.set()
                end = time.monotonic() + 1.5
                while time.monotonic() < end:
                    scipy.fft.fft2(np.ones((800, 800)))
                return np.zeros((3, 5), np.uint16)

            def close(self):
                pass

        def ask(port):
            camera = open_camera("simulated", port=port)
            try:
                camera.grab()
            except NotConnected:
                camera.close()

        with CameraServer(Slow) as server:
            client = threading.Thread(target=ask, args=(server.port,))
            client.start()
            begun.wait()
        client.join()
        sys.exit(69)
    """)
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=200)
    assert (done.returncode, done.stderr) == (69, "")


@pytest.mark.parametrize(
    "answer",
    [
        b"0PO00000000\r\n",
        b"[]\n",
        b'{"protocol": 2}\n',
        b'{"protocol": 1, "rows": 3}\n',
        b'{"protocol": 1, "bytes": "x"}\n',
    ],
)
def test_somebody_else_on_the_port(answer):
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve():
            client, _ = listener.accept()
            with client:
                client.recv(100)
                client.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        with pytest.raises(ProtocolError, match="not as a simulated camera does"):
            open_camera("simulated", port=f"127.0.0.1:{listener.getsockname()[1]}", timeout_s=60.0)
        thread.join()


@pytest.mark.parametrize("port", ["127.0.0.1", ":4003", "127.0.0.1:x", "127.0.0.1:99999", ""])
def test_what_is_no_place_of_a_camera(port):
    with pytest.raises(NotConnected, match=r"is no place of a camera; write it as 127\.0\.0\.1:4003"):
        open_camera("simulated", port=port)


@pytest.mark.parametrize("options", [{}, {"bench": "b.toml", "port": "127.0.0.1:1"}])
def test_bench_or_port_and_not_both(options):
    with pytest.raises(RigFileError, match="needs bench = FILE or port = HOST:PORT"):
        open_camera("simulated", **options)


def test_the_camera_of_a_bench_sees_what_its_stage_and_light_do(make_bench):
    bench = make_bench()
    with CameraServer(lambda: SimulatedCamera(bench)) as server:
        camera = open_camera("simulated", port=server.port)
        camera.configure(0.003, 1.0)
        dark = camera.grab()
        bench.light_on = True
        bench.axis.start_move(10.0)
        upright = camera.grab()
        bench.axis.start_move(100.0)
        turned = camera.grab()
        camera.close()
    assert dark.mean() < 70 < upright.mean()
    apart = np.abs(turned.astype(float) - upright).mean()
    assert apart > 5.0 * np.abs(dark.astype(float) - 64).mean()
