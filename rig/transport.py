"""Bytes to and from a port, with a deadline on everything.

One class serves a COM port, a pseudo terminal, ``socket://host:port`` and ``sim://…``. Within `shared_ports`,
devices on one cable share one connection.
"""

import time
from types import TracebackType
from typing import NoReturn, Self

import serial
from serial.serialutil import PortNotOpenError

from anisoscope.base.errors import NotConnected
from anisoscope.rig.connection import PORT_ERRORS, available_ports, connect, register_handlers, shared_ports

__all__ = ["Transport", "available_ports", "register_handlers", "shared_ports"]

MAX_BACKLOG = 65536


class Transport:
    """An open port. All reads and writes end by their deadline; all failures are `NotConnected`.

    ``lock`` belongs to whoever holds a conversation (a question and its answer) on the port. `write` does not
    need it, so that a stop command goes out while another thread waits for the answer to a move.

    Args:
        port: device name (``COM3``, ``/dev/ttyUSB0``), ``socket://host:port`` or ``sim://…``.
        baudrate: baud; ignored by URLs that have none.
        rtscts: flow control by the lines RTS and CTS; a pseudo terminal has none, and works without.
        xonxoff: flow control by the bytes XON (0x11) and XOFF (0x13), which the data then cannot hold.
        write_timeout_s: a port that does not take bytes for so long counts as unplugged.

    Raises:
        NotConnected: the port does not exist, is in use, or may not be opened.
    """

    def __init__(
        self,
        port: str,
        *,
        baudrate: int = 9600,
        rtscts: bool = False,
        xonxoff: bool = False,
        write_timeout_s: float = 1.0,
    ) -> None:
        self.port = port
        settings = {
            "baudrate": baudrate,
            "rtscts": rtscts,
            "xonxoff": xonxoff,
            "write_timeout": write_timeout_s,
        }
        self._connection = connect(port, settings)
        self._closed = False
        self.lock = self._connection.lock
        self._write_lock = self._connection.write_lock
        self._buffer = self._connection.buffer

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return not self._closed and bool(self._connection.serial.is_open)

    @property
    def _serial(self) -> serial.Serial:
        if self._closed:
            raise PortNotOpenError
        return self._connection.serial

    @property
    def pending(self) -> bytes:
        """Bytes that arrived and were not taken yet."""
        return bytes(self._buffer)

    def write(self, data: bytes) -> None:
        """Send all of `data`.

        Raises:
            NotConnected: the port is closed, unplugged, or does not take bytes.
        """
        with self._write_lock:
            try:
                self._serial.write(data)
            except PORT_ERRORS as problem:
                self._lost(problem)

    def read_exactly(self, count: int, timeout_s: float) -> bytes | None:
        """Return `count` bytes, or None if they did not come within `timeout_s` seconds.

        Bytes of an incomplete answer stay in `pending`.

        Raises:
            NotConnected: the port is closed or unplugged.
        """
        deadline = time.monotonic() + timeout_s
        while len(self._buffer) < count:
            if not self._fill(deadline):
                return None
        return self._take(count)

    def read_until(self, terminator: bytes, timeout_s: float) -> bytes | None:
        """Return the bytes up to and including `terminator`, or None after `timeout_s` seconds.

        Bytes of an incomplete answer stay in `pending`, at most 64 KiB of them.

        Raises:
            NotConnected: the port is closed or unplugged.
        """
        deadline = time.monotonic() + timeout_s
        while (end := self._buffer.find(terminator)) < 0:
            del self._buffer[:-MAX_BACKLOG]
            if not self._fill(deadline):
                return None
        return self._take(end + len(terminator))

    def discard(self) -> bytes:
        """Drop and return all bytes that have arrived so far.

        Raises:
            NotConnected: the port is closed or unplugged.
        """
        self._fill(time.monotonic(), only_waiting=True)
        return self._take(len(self._buffer))

    def close(self) -> None:
        """Let go of the port, and close it if nobody else shares it; closing twice is fine."""
        if not self._closed:
            self._closed = True
            self._connection.let_go()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _take(self, count: int) -> bytes:
        taken = bytes(self._buffer[:count])
        del self._buffer[:count]
        return taken

    def _fill(self, deadline: float, *, only_waiting: bool = False) -> bool:
        """Move what has arrived into the buffer; False once the deadline has passed without a byte."""
        while True:
            try:
                waiting = self._serial.in_waiting
                came = self._serial.read(max(1, waiting)) if waiting or not only_waiting else b""
            except PORT_ERRORS as problem:
                self._lost(problem)
            self._buffer.extend(came)
            if came and not only_waiting:
                return True
            if not came and (only_waiting or time.monotonic() >= deadline):
                return False
            if len(self._buffer) > MAX_BACKLOG:
                return False

    def _lost(self, problem: BaseException) -> NoReturn:
        state = "the connection was lost" if self.is_open else "the port is closed"
        if not self._closed:
            self._connection.close()
        self.close()
        raise NotConnected(
            f"{self.port}: {state}; check the cable and the power, then connect again"
        ) from problem
