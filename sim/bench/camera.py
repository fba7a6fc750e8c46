"""The simulated camera and light: drivers like any other, found through the registry."""

import contextlib
import json
import socket
import threading
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError, NotConnected, ProtocolError, RigFileError
from anisoscope.rig.camera import Camera, CameraInfo, CameraSettings
from anisoscope.rig.cameras.linearised import linearised
from anisoscope.sim.bench.bench import Bench, shared_bench
from anisoscope.sim.bench.camera_server import MAX_LINE, PROTOCOL

CONNECT_S = 5.0


class RemoteCamera:
    """A camera at ``host:port``.

    Args:
        port: where it is served, such as ``127.0.0.1:4003``.
        timeout_s: longest wait for an answer, in seconds, on top of the exposure; the first picture of a new pose
            is rendered, and the very first may have to compile what renders it.

    Raises:
        NotConnected: no server there, or no answer.
        ProtocolError: the answers are not those of such a camera.
    """

    def __init__(self, port: str, *, timeout_s: float = 180.0) -> None:
        self._port, self._timeout_s = port, timeout_s
        self._lock = threading.Lock()
        self._exposure_s = 0.0
        host, colon, number = port.rpartition(":")
        if not (host and colon and number.isdecimal() and int(number) < 65536):
            raise NotConnected(f"'{port}' is no place of a camera; write it as 127.0.0.1:4003")
        try:
            self._socket: socket.socket | None = socket.create_connection((host, int(number)), CONNECT_S)
        except OSError as problem:
            raise NotConnected(
                f"nobody serves a camera on {port}: {problem.strerror or problem}; start it with "
                "anisoscope rig sim bench FILE"
            ) from problem
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._stream = self._socket.makefile("rb")
        try:
            self.info = self._read_info()
        except BaseException:
            self.close()
            raise

    def configure(self, exposure_s: float, gain: float) -> CameraSettings:
        """Set exposure in seconds and gain; returns what the camera really uses.

        Raises:
            CameraError: outside the range of the camera.
            NotConnected: the server has gone.
        """
        answer, _ = self._request({"do": "configure", "exposure_s": exposure_s, "gain": gain})
        try:
            settings = CameraSettings(float(answer["exposure_s"]), float(answer["gain"]))
        except (KeyError, TypeError, ValueError):
            raise self._strange() from None
        self._exposure_s = settings.exposure_s
        return settings

    def grab(self) -> npt.NDArray[np.uint16]:
        """One frame, (rows, cols) counts. Errors as for `configure`."""
        answer, data = self._request({"do": "grab"})
        shape = (self.info.rows, self.info.cols)
        if (answer.get("rows"), answer.get("cols")) != shape or len(data) != 2 * shape[0] * shape[1]:
            raise self._strange()
        return np.frombuffer(data, dtype="<u2").astype(np.uint16).reshape(shape)

    def close(self) -> None:
        """Disconnect; closing twice is fine."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._stream.close()
                self._socket.close()
            self._socket = None

    def _read_info(self) -> CameraInfo:
        answer, _ = self._request({"do": "info"})
        if answer.pop("protocol", None) != PROTOCOL:
            raise self._strange()
        try:
            return CameraInfo(**answer)
        except (TypeError, CameraError):
            raise self._strange() from None

    def _strange(self) -> ProtocolError:
        self.close()
        return ProtocolError(f"{self._port} answers, but not as a simulated camera does; correct the port")

    def _request(self, request: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
        with self._lock:
            if self._socket is None:
                raise NotConnected(f"the camera on {self._port} is not connected; open it again")
            try:
                self._socket.settimeout(self._timeout_s + self._exposure_s)
                self._socket.sendall(json.dumps(request).encode() + b"\n")
                answer, data = self._receive()
            except TimeoutError as problem:
                self.close()
                raise NotConnected(f"the camera on {self._port} does not answer") from problem
            except (OSError, EOFError) as problem:
                self.close()
                raise NotConnected(
                    f"the camera on {self._port} has gone; start it again with anisoscope rig sim bench FILE"
                ) from problem
            except (
                BaseException
            ):  # an interruption in the middle of an answer: the rest would be taken for the next
                self.close()
                raise
        if "error" in answer:
            raise CameraError(str(answer["error"]))
        return answer, data

    def _receive(self) -> tuple[dict[str, Any], bytes]:
        line = self._stream.readline(MAX_LINE)
        if not line:
            raise EOFError
        try:
            answer = json.loads(line)
            count = int(answer.get("bytes", 0))
        except (ValueError, TypeError, AttributeError):
            raise self._strange() from None
        data = self._stream.read(count) if 0 < count <= 1 << 30 else b""
        if len(data) < count:
            raise EOFError
        return answer, data


class SimulatedCamera:
    """A camera that photographs a bench."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._settings: CameraSettings | None = None
        part = bench.file.sensor
        self.info = CameraInfo(
            model="virtual camera (EMVA 1288 linear model)",
            serial=f"SIM-{bench.file.optics.pixel_um:g}UM",
            rows=part.rows,
            cols=part.cols,
            bit_depth=part.bit_depth,
            black_level=part.black_level,
            linear=part.gamma == 1.0,
            auto_exposure=part.auto_exposure != "none",
            filters=part.filters,
            repeats=not bench.file.faults.replays,
        )

    def configure(self, exposure_s: float, gain: float) -> CameraSettings:
        """Set exposure in seconds and gain; returns what the camera really uses.

        Raises:
            CameraError: outside the range of the camera.
        """
        if not 1e-6 <= exposure_s <= 60.0:
            raise CameraError(f"the exposure must lie between 1 µs and 60 s, not {exposure_s} s")
        if not 0.1 <= gain <= 24.0:
            raise CameraError(f"the gain must lie between 0.1 and 24, not {gain}")
        self._settings = CameraSettings(exposure_s=exposure_s, gain=gain)
        return self._settings

    def grab(self) -> npt.NDArray[np.uint16]:
        """One frame, (rows, cols) counts.

        Raises:
            CameraError: ``configure`` was not called.
        """
        if self._settings is None:
            raise CameraError("the camera was asked for a frame before exposure and gain were set")
        return self._bench.photograph(self._settings.exposure_s, self._settings.gain)

    def close(self) -> None:
        """Nothing is held."""


class SimulatedLight:
    """The light of a bench."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def on(self) -> None:
        """Switch on."""
        self._bench.light_on = True

    def off(self) -> None:
        """Switch off."""
        self._bench.light_on = False

    def close(self) -> None:
        """Switch off and let go."""
        self.off()


def open_camera(
    *,
    bench: str | Path | None = None,
    port: str | None = None,
    timeout_s: float = 180.0,
    response: str | Path = "",
) -> Camera:
    """Open the camera of a bench.

    Args:
        bench: file of a bench in this process.
        port: ``host:port`` where ``rig sim bench`` serves the bench of another process.
        timeout_s: with `port`: longest wait for an answer, in seconds, on top of the exposure.
        response: file of a response curve of this camera, which makes counts linear.

    Raises:
        RigFileError: neither a bench nor a port, or both; or the bench file is wrong.
        NotConnected: no server on the port.
    """
    if (bench is None) == (port is None):
        raise RigFileError("camera.options: a simulated camera needs bench = FILE or port = HOST:PORT")
    camera: Camera
    if port is not None:
        camera = RemoteCamera(port, timeout_s=timeout_s)
    else:
        assert bench is not None
        camera = SimulatedCamera(shared_bench(bench))
    return linearised(camera, response) if response else camera


def open_light(*, bench: str | Path) -> SimulatedLight:
    """Open the light of a bench file."""
    return SimulatedLight(shared_bench(bench))
