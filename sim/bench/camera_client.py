"""A simulated camera that another process serves; the protocol stands in `anisoscope.sim.bench.camera_server`."""

import contextlib
import json
import socket
import threading
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError, NotConnected, ProtocolError
from anisoscope.rig.camera import CameraInfo, CameraSettings
from anisoscope.sim.bench.camera_server import MAX_LINE, PROTOCOL

CONNECT_S = 5.0


class RemoteCamera:
    """A camera at ``host:port``.

    Args:
        port: where it is served, such as ``127.0.0.1:4003``.
        timeout_s: longest wait for an answer, in seconds, on top of the exposure; the first picture of a new pose
            is rendered, and the very first may have to compile what renders it.

    Raises:
        NotConnected: nobody serves there, or nobody answers.
        ProtocolError: somebody answers, but not as such a camera does.
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
        answer, _ = self._ask({"do": "configure", "exposure_s": exposure_s, "gain": gain})
        try:
            settings = CameraSettings(float(answer["exposure_s"]), float(answer["gain"]))
        except (KeyError, TypeError, ValueError):
            raise self._strange() from None
        self._exposure_s = settings.exposure_s
        return settings

    def grab(self) -> npt.NDArray[np.uint16]:
        """One frame, (rows, cols) counts. Errors as for `configure`."""
        answer, data = self._ask({"do": "grab"})
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
        answer, _ = self._ask({"do": "info"})
        if answer.pop("protocol", None) != PROTOCOL:
            raise self._strange()
        try:
            return CameraInfo(**answer)
        except (TypeError, CameraError):
            raise self._strange() from None

    def _strange(self) -> ProtocolError:
        self.close()
        return ProtocolError(f"{self._port} answers, but not as a simulated camera does; correct the port")

    def _ask(self, request: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
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
