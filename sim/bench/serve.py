"""Serve simulated devices to other programs: on a pseudo terminal, or on a TCP port of this machine."""

import contextlib
import errno
import os
import select
import socket
import threading
from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self

from anisoscope.base.errors import RigError
from anisoscope.sim.bench.firmware.device import Firmware

POLL_S = 0.005
CHUNK = 4096


class Server(ABC):
    """Server of one device; as a context manager it runs in a thread.

    Attributes:
        port: what a client opens: a device path, or ``host:port``.
    """

    port: str

    def __init__(self, firmware: Firmware) -> None:
        self.firmware = firmware
        self._stop = threading.Event()
        self._wait_s = POLL_S
        self._thread: threading.Thread | None = None

    def run(self) -> None:
        """Serve until `stop` is called from another thread or a signal handler."""
        while not self._stop.is_set():
            self._serve_once()

    def stop(self) -> None:
        """Make `run` return."""
        self._stop.set()

    @abstractmethod
    def close(self) -> None:
        """Release the port."""

    @abstractmethod
    def _serve_once(self) -> None:
        """Pass bytes both ways for a moment, or until a client has gone."""

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self.run, name=f"serve {self.port}", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        if self._thread is not None:
            self._thread.join(timeout=5.0)
        self.close()


class PtyServer(Server):
    """Serves on a pseudo terminal (POSIX); `port` changes when the device hung up.

    Raises:
        RigError: this operating system has no pseudo terminals.
    """

    def __init__(self, firmware: Firmware) -> None:
        super().__init__(firmware)
        self._open_pty()

    @property
    def url(self) -> str:
        """Port name for a `Transport`."""
        return self.port

    def close(self) -> None:
        """Release the pseudo terminal."""
        _close(self._ours, self._theirs)

    def _open_pty(self) -> None:
        try:
            import pty  # noqa: PLC0415 - POSIX only
            import tty  # noqa: PLC0415 - POSIX only
        except ImportError:
            raise RigError("this system has no pseudo terminals; serve on TCP instead") from None
        # Their side stays open here, so that clients may come and go.
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.port = os.ttyname(self._theirs)
        self.firmware.connect()

    def _serve_once(self) -> None:
        try:
            ready, _, _ = select.select([self._ours], [], [], self._wait_s)
            if ready:
                self.firmware.write(os.read(self._ours, CHUNK))
            if answer := self.firmware.read():
                os.write(self._ours, answer)
            self._wait_s = 0.0 if answer else POLL_S
        except ConnectionError:
            hung_up = self._ours, self._theirs
            self._open_pty()  # first, so that a client who notices finds the new port
            _close(*hung_up)
        except BlockingIOError:
            pass  # the other side does not read: the line is full, and the answer is lost
        except OSError as problem:
            if problem.errno != errno.EIO:  # EIO: the last client has gone
                raise


def _close(*descriptors: int) -> None:
    for descriptor in descriptors:
        with contextlib.suppress(OSError):
            os.close(descriptor)


class TcpServer(Server):
    """Serves on a TCP port of this machine only, one client after another.

    Args:
        firmware: the device.
        port: port number; 0 takes any free one.

    Raises:
        RigError: the port is taken, or not a port number.
    """

    def __init__(self, firmware: Firmware, port: int = 0) -> None:
        super().__init__(firmware)
        if not 0 <= port < 65536:
            raise RigError(f"cannot serve on TCP port {port}; choose 1…65535, or 0 for any")
        try:
            self._listener = socket.create_server(("127.0.0.1", port))
        except OSError as problem:
            raise RigError(
                f"cannot serve on TCP port {port}: {problem}; choose another, or 0 for any"
            ) from problem
        self._listener.settimeout(10.0 * POLL_S)
        self.port = f"127.0.0.1:{self._listener.getsockname()[1]}"

    @property
    def url(self) -> str:
        """Port name for a `Transport`."""
        return f"socket://{self.port}"

    def close(self) -> None:
        """Release the port."""
        self._listener.close()

    def _serve_once(self) -> None:
        try:
            client, _ = self._listener.accept()
        except TimeoutError:
            return
        with client, contextlib.suppress(ConnectionError):
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.firmware.connect()
            self._talk(client)

    def _talk(self, client: socket.socket) -> None:
        while not self._stop.is_set():
            ready, _, _ = select.select([client], [], [], self._wait_s)
            if ready:
                data = client.recv(CHUNK)
                if not data:
                    return
                self.firmware.write(data)
            if answer := self.firmware.read():
                client.sendall(answer)
            self._wait_s = 0.0 if answer else POLL_S
