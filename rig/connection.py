"""An open port, and the devices that share it.

A port is what ``serial.serial_for_url`` opens: a COM port, a pseudo terminal, ``socket://host:port``, ``sim://…``.
Further URL schemes come from packages named by the entry-point group ``anisoscope.serial_handlers``.
"""

import contextlib
import errno
import functools
import sys
import threading
from collections.abc import Iterator
from contextvars import ContextVar
from importlib.metadata import entry_points
from typing import Any, Self

import serial
from serial.tools import list_ports

from anisoscope.base.errors import NotConnected
from anisoscope.rig.portholder import claim, holder_of, release

HANDLER_GROUP = "anisoscope.serial_handlers"
POLL_S = 0.05
# What pyserial raises for a port that was unplugged or closed under a running call.
PORT_ERRORS = (serial.SerialException, OSError, TypeError, ValueError)


def register_handlers() -> None:
    """Tell pyserial, once, which packages hold the handlers of further URL schemes."""
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
        try:
            self.serial: serial.Serial = serial.serial_for_url(
                port, timeout=POLL_S, exclusive=True, **settings
            )
        except PORT_ERRORS as problem:
            raise NotConnected(_why_not_open(port, problem)) from problem
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
    made = Connection(port, settings)
    if known is not None:
        known[port] = made
    return made.take()


def _why_not_open(port: str, problem: BaseException) -> str:
    code = getattr(problem, "errno", None)
    text = str(problem)
    if code == errno.ENOENT or "FileNotFoundError" in text:
        return f"there is no port {port}; {_what_exists()}"
    if code in {errno.EAGAIN, errno.EBUSY}:
        return f"port {port} is in use by {_who_uses(port)}, or name another port"
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


def _who_uses(port: str) -> str:
    holder = holder_of(port)
    if holder is None:
        return "another program; close that program"
    return f"process {holder.pid} ({holder.program}); wait for its end, end it with anisoscope rig stop"


def _what_exists() -> str:
    ports = available_ports()
    return f"existing ports: {', '.join(ports)}" if ports else "this machine has no serial port at the moment"
