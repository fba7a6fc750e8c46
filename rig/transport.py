"""Bytes to and from a port, with a deadline on everything.

One class serves all ports; within `shared_ports`, devices on one cable share one connection. A port is what
``serial.serial_for_url`` opens: a COM port, a pseudo terminal, ``socket://host:port``, ``sim://…``; or ``usb:`` and
what identifies a USB device (`anisoscope.rig.portholder.actual_port`). Further URL schemes come from packages named by
the entry-point group ``anisoscope.serial_handlers``.
"""

import contextlib
import errno
import functools
import sys
import threading
from collections.abc import Iterator
from contextvars import ContextVar
from importlib.metadata import entry_points
from types import TracebackType
from typing import Any, NoReturn, Self

import serial
from serial.serialutil import PortNotOpenError
from serial.tools import list_ports

from anisoscope.base.clock import SYSTEM, Clock
from anisoscope.base.errors import NotConnected
from anisoscope.rig.portholder import Holder, actual_port, claim, holder_of, is_abandoned, release

TCP = "socket://"
HANDLER_GROUP = "anisoscope.serial_handlers"
POLL_S = 0.05
# What pyserial raises for a port that was unplugged or closed under a running call.
PORT_ERRORS = (serial.SerialException, OSError, TypeError, ValueError)


def register_handlers() -> None:
    """Register the packages with handlers of further URL schemes at pyserial, once."""
    packages: list[str] = serial.protocol_handler_packages
    for package in _handler_packages(tuple(sys.path)):
        if package not in packages:
            packages.append(package)


@functools.cache
def _handler_packages(_path: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(entry.value for entry in entry_points(group=HANDLER_GROUP))


def available_ports() -> tuple[str, ...]:
    """Names of the serial ports of this machine, found without opening any."""
    return tuple(sorted(port.device for port in list_ports.comports()))


class Connection:
    """An open port and what has arrived on it; closed when the last of its holders lets go."""

    def __init__(self, port: str, settings: dict[str, Any]) -> None:
        self.settings = settings
        self.lock = threading.RLock()
        self.write_lock = threading.Lock()
        self.buffer = bytearray()
        self._holders = 0
        if port.startswith(TCP) and (holder := holder_of(port)) is not None:
            # a server of serial ports accepts a second client, and answers only the first
            raise NotConnected(_in_use(port, holder))
        try:
            self.serial: serial.Serial = serial.serial_for_url(
                actual_port(port), timeout=POLL_S, exclusive=True, **settings
            )
        except PORT_ERRORS as problem:
            raise NotConnected(_why_not_open(port, problem)) from problem
        self.abandoned = is_abandoned(port)
        # a simulated device may bring a time of its own
        self.clock: Clock = getattr(self.serial, "clock", SYSTEM)
        self._claim = claim(port)

    def take(self) -> Self:
        """One holder more."""
        self._holders += 1
        return self

    def let_go(self) -> None:
        """One holder less; after the last the port is closed."""
        self._holders -= 1
        if self._holders <= 0:
            self.close()

    def close(self) -> None:
        """Close the port for all of its holders."""
        with contextlib.suppress(*PORT_ERRORS):
            # pyserial forgets to close a socket that the other side has closed already
            socket = getattr(self.serial, "_socket", None)
            self.serial.close()
            if socket is not None:
                socket.close()
        release(self._claim)


_shared: ContextVar[dict[str, Connection] | None] = ContextVar("_shared", default=None)


@contextlib.contextmanager
def shared_ports() -> Iterator[None]:
    """Within this context, transports of the same port share one connection, its lock and its buffer.

    For a cable with several devices on it, such as stages with addresses. Outside of it, and for anybody else,
    a port is open once.
    """
    token = _shared.set({})
    try:
        yield
    finally:
        _shared.reset(token)


def connect(port: str, settings: dict[str, Any]) -> Connection:
    """Open a port, or take part in it where that is shared.

    Args:
        port: its name.
        settings: what `serial.serial_for_url` is to know of it.

    Raises:
        NotConnected: the port does not exist, is in use, may not be opened, or is shared with other settings.
    """
    known = _shared.get()
    found = None if known is None else known.get(port)
    if found is not None and found.serial.is_open:
        if found.settings != settings:
            differing = next(key for key in settings if found.settings.get(key) != settings[key])
            raise NotConnected(
                f"port {port} is open with {differing} {found.settings.get(differing)} for one device and wanted "
                f"with {settings[differing]} for another: devices on one port speak alike"
            )
        return found.take()
    register_handlers()
    connection = Connection(port, settings)
    if known is not None:
        known[port] = connection
    return connection.take()


def _why_not_open(port: str, problem: BaseException) -> str:
    code = getattr(problem, "errno", None)
    text = str(problem)
    if code == errno.ENOENT or "FileNotFoundError" in text:
        return f"there is no port {port}; {_what_exists()}"
    if code in {errno.EAGAIN, errno.EBUSY}:
        return _in_use(port, holder_of(port))
    if code == errno.EACCES or "PermissionError" in text:
        return (
            f"port {port} may not be opened: another program holds it, or this user lacks the permission "
            "(on Linux: join the group that owns the device, often dialout)"
        )
    if "not known" in text:
        return f"port {port}: no handler for {port.split('://', maxsplit=1)[0]}:// is installed"
    return f"cannot open {'' if '://' in port else 'port '}{port}: {text}" + _advice(port)


def _advice(port: str) -> str:
    if port.startswith(TCP):
        return "; check address and port number, and close other programs connected to it"
    return "" if "://" in port else f"; {_what_exists()}"


def _in_use(port: str, holder: Holder | None) -> str:
    if holder is None:
        who = "another program; close that program"
    else:
        who = f"process {holder.pid} ({holder.program}); wait for its end, end it with anisoscope rig stop"
    return f"port {port} is in use by {who}, or name another port"


def _what_exists() -> str:
    ports = available_ports()
    return f"existing ports: {', '.join(ports)}" if ports else "this machine has no serial port at the moment"


__all__ = ["Transport", "available_ports", "register_handlers", "shared_ports"]

MAX_BACKLOG = 65536
ECHO_BYTES = 512  # of what came since the last command, to see it come back


class Transport:
    """An open port. All reads and writes end by their deadline; all failures are `NotConnected`.

    ``lock`` is held for the whole of an exchange (a query and its answer) on the port. `write` does not
    need it, so that a stop command goes out while another thread waits for the answer to a move. ``echoes`` says
    whether what was sent has come back as it was.

    Args:
        port: device name (``COM3``, ``/dev/ttyUSB0``), ``usb:SERIAL``, ``socket://host:port`` or ``sim://…``.
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
        self.echoes = self._waited = False
        self._sent = self._came = b""
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
    def clock(self) -> Clock:
        """Time by which to wait for what is behind the port."""
        return self._connection.clock

    @property
    def abandoned(self) -> bool:
        """Whether the process that had the port open before ended without closing it: something may still move."""
        return self._connection.abandoned

    @property
    def pending(self) -> bytes:
        """Bytes received and not read yet."""
        return bytes(self._buffer)

    def write(self, data: bytes) -> None:
        """Send all of `data`.

        Raises:
            NotConnected: the port is closed, unplugged, or does not take bytes.
        """
        with self._write_lock:
            self._sent, self._came = data, b""
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
        deadline = self.clock() + timeout_s
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
        deadline = self.clock() + timeout_s
        while (end := self._buffer.find(terminator)) < 0:
            del self._buffer[:-MAX_BACKLOG]
            if not self._fill(deadline):
                return None
        return self._take(end + len(terminator))

    def comes_late(self, wait_s: float) -> float | None:
        """Wait up to `wait_s` seconds for a byte after a time limit, once; seconds until it came, or None.

        Raises:
            NotConnected: the port is closed or unplugged.
        """
        if self._waited:
            return None
        self._waited, begun = True, self.clock()
        return self.clock() - begun if self._fill(begun + wait_s) else None

    def discard(self) -> bytes:
        """Drop and return all bytes that have arrived so far.

        Raises:
            NotConnected: the port is closed or unplugged.
        """
        self._fill(self.clock(), only_waiting=True)
        return self._take(len(self._buffer))

    def close(self) -> None:
        """Release the port, and close it unless another device shares it; closing twice is fine."""
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
        data = bytes(self._buffer[:count])
        del self._buffer[:count]
        return data

    def _fill(self, deadline: float, *, only_waiting: bool = False) -> bool:
        """Move what has arrived into the buffer; False once the deadline has passed without a byte."""
        while True:
            try:
                waiting = self._serial.in_waiting
                came = self._serial.read(max(1, waiting)) if waiting or not only_waiting else b""
            except PORT_ERRORS as problem:
                self._lost(problem)
            self._buffer.extend(came)
            self._came = (self._came + came)[-ECHO_BYTES:]
            if came and (self._came == self._sent or (len(self._sent) > 1 and self._sent in self._came)):
                self.echoes = True
            if came and not only_waiting:
                return True
            if not came and (only_waiting or self.clock() >= deadline):
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
