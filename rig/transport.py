"""Bytes to and from a port, with a deadline on everything.

One class serves a COM port, a pseudo terminal, ``socket://host:port`` and ``sim://…``: whatever
``serial.serial_for_url`` opens. Further URL schemes come from packages named by the entry-point group
``anisoscope.serial_handlers``.
"""

import contextlib
import errno
import threading
import time
from importlib.metadata import entry_points
from types import TracebackType
from typing import NoReturn, Self

import serial
from serial.tools import list_ports

from anisoscope.errors import NotConnected

HANDLER_GROUP = "anisoscope.serial_handlers"
POLL_S = 0.05
MAX_BACKLOG = 65536
# What pyserial raises for a port that was unplugged or closed under a running call.
_PORT_ERRORS = (serial.SerialException, OSError, TypeError, ValueError)


def register_handlers() -> None:
    """Tell pyserial, once, which packages hold the handlers of further URL schemes."""
    packages: list[str] = serial.protocol_handler_packages
    for entry in entry_points(group=HANDLER_GROUP):
        if entry.value not in packages:
            packages.append(entry.value)


def available_ports() -> tuple[str, ...]:
    """Names of the serial ports of this machine, found without opening any."""
    return tuple(sorted(port.device for port in list_ports.comports()))


class Transport:
    """An open port. All reads and writes end by their deadline; all failures are `NotConnected`.

    ``lock`` belongs to whoever holds a conversation (a question and its answer) on the port. `write` does not
    need it, so that a stop command goes out while another thread waits for the answer to a move.

    Args:
        port: device name (``COM3``, ``/dev/ttyUSB0``), ``socket://host:port`` or ``sim://…``.
        baudrate: baud; ignored by URLs that have none.
        write_timeout_s: a port that does not take bytes for so long counts as unplugged.

    Raises:
        NotConnected: the port does not exist, is in use, or may not be opened.
    """

    def __init__(self, port: str, *, baudrate: int = 9600, write_timeout_s: float = 1.0) -> None:
        self.port = port
        self.lock = threading.RLock()
        self._write_lock = threading.Lock()
        self._buffer = bytearray()
        register_handlers()
        try:
            self._serial: serial.Serial = serial.serial_for_url(
                port, baudrate=baudrate, timeout=POLL_S, write_timeout=write_timeout_s, exclusive=True
            )
        except _PORT_ERRORS as problem:
            raise NotConnected(_why_not_open(port, problem)) from problem

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return bool(self._serial.is_open)

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
            except _PORT_ERRORS as problem:
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
        """Close the port; closing twice is fine."""
        with contextlib.suppress(*_PORT_ERRORS):
            self._serial.close()

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
            except _PORT_ERRORS as problem:
                self._lost(problem)
            self._buffer += came
            if came and not only_waiting:
                return True
            if not came and (only_waiting or time.monotonic() >= deadline):
                return False
            if len(self._buffer) > MAX_BACKLOG:
                return False

    def _lost(self, problem: BaseException) -> NoReturn:
        state = "the connection was lost" if self.is_open else "the port is closed"
        self.close()
        raise NotConnected(
            f"{self.port}: {state}; check the cable and the power, then connect again"
        ) from problem


def _why_not_open(port: str, problem: BaseException) -> str:
    code = getattr(problem, "errno", None)
    text = str(problem)
    if code == errno.ENOENT or "FileNotFoundError" in text:
        return f"there is no port {port}; {_what_exists()}"
    if code in {errno.EAGAIN, errno.EBUSY}:
        return f"port {port} is in use by another program; close that program, or name another port"
    if code == errno.EACCES or "PermissionError" in text:
        return (
            f"port {port} may not be opened: another program holds it, or this user lacks the permission "
            "(on Linux: join the group that owns the device, often dialout)"
        )
    if "not known" in text:
        return f"port {port}: no handler for {port.split('://', maxsplit=1)[0]}:// is installed"
    if "://" in port:
        return f"cannot open {port}: {text}"
    return f"cannot open port {port}: {text}; {_what_exists()}"


def _what_exists() -> str:
    ports = available_ports()
    return f"existing ports: {', '.join(ports)}" if ports else "this machine has no serial port at the moment"
