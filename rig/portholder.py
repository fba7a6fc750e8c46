"""Which process holds a port: a small file per open port, so that a stop from another terminal reaches it.

A port is open once, so a second process cannot talk to a stage that moves. It can find out who does, and interrupt
that process, which then stops the stage itself; or, where that process serves the port to others, ask it. The files
lie in a folder that only the user can write to. A file that outlived its process (or whose number went to another
process) says that the process ended without closing the port, so that what moves behind it has to be stopped first.
"""

import contextlib
import hashlib
import json
import os
import signal
import sys
import tempfile
import time
import tomllib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from anisoscope.base.errors import NotConnected, RigError
from anisoscope.base.regular_file import bounded_text
from anisoscope.base.user_name import user_name

POLL_S = 0.05
PROC = Path("/proc")
SIMULATED = "sim://"  # exists in its own process only


@dataclass(frozen=True)
class Holder:
    """A process that has a port open.

    Attributes:
        pid: its number.
        port: the port, as it named it.
        program: its command line, for people.
        started: start time in the system's own count; distinguishes it from a later one of the same number.
        interrupt_by: the signal on which it leaves in good order; "" if it has none.
        serves_at: ``host:port`` at which it serves the port to other processes; "" if it does not.
        token: what a client has to say there.
        rig: the rig file that it serves; "" without.
    """

    pid: int
    port: str
    program: str
    started: str
    interrupt_by: str
    serves_at: str = ""
    token: str = ""
    rig: str = ""

    @property
    def is_alive(self) -> bool:
        """Whether the same process still runs."""
        return _started(self.pid) == self.started != ""

    def interrupt(self) -> None:
        """Request an orderly end, as Ctrl-C in its terminal does; only once.

        Raises:
            RigError: this system or that process knows no such thing; the message says what to do instead.
        """
        if os.name == "nt" or not self.interrupt_by:
            raise RigError(
                f"port {self.port} is held by process {self.pid} ({self.program}), which cannot be interrupted from "
                "here: press Ctrl-C in its window"
            )
        if self in interrupted.values():
            return
        try:
            os.kill(self.pid, signal.Signals[self.interrupt_by])
            interrupted[self.port] = self
        except OSError as problem:
            raise RigError(
                f"process {self.pid} ({self.program}) holds {self.port} and cannot be interrupted: "
                f"{problem.strerror}; press Ctrl-C in its window"
            ) from problem


AXES = ("stage", "tilt", "x", "y", "z")
interrupted: dict[str, Holder] = {}
"""Processes that this one has interrupted, by port."""


def interrupt_movers(rig: Path) -> None:
    """Interrupt the processes that have a port of an axis of a rig file for themselves, before anything else is loaded.

    A file that cannot be read and a process that cannot be interrupted are left for who reads and says that.
    """
    with contextlib.suppress(RigError, OSError, ValueError, AttributeError):
        tables = tomllib.loads(bounded_text(rig))
        for port in [tables[name].get("port") for name in AXES if name in tables]:
            holder = holder_of(port) if isinstance(port, str) else None
            if holder is not None and not holder.serves_at:
                holder.interrupt()


def claim(port: str, serves_at: str = "", token: str = "", rig: str = "") -> Path | None:
    """Note that this process holds a port; returns the note, or None where none could be made.

    A simulated port exists in its own process only, and is noted only where that serves it to others.

    Args:
        port: the port.
        serves_at: as for `Holder`.
        token: as for `Holder`.
        rig: as for `Holder`.
    """
    if port.startswith(SIMULATED) and not serves_at:
        return None
    program = " ".join(Path(part).name if number == 0 else part for number, part in enumerate(sys.argv))
    started, signal_ = _started(os.getpid()), _handled_signal()
    me = Holder(os.getpid(), port, program[:200], started, signal_, serves_at, token, rig)
    try:
        note = _note_of(port)
        partial = note.with_suffix(f".{me.pid}")
        partial.touch(mode=0o600)
        partial.write_text(json.dumps(asdict(me)), encoding="utf-8")
        partial.replace(note)
    except OSError:  # a full or read-only disk must not block the port
        return None
    return note


def release(note: Path | None) -> None:
    """Take a note back, unless it is another's by now."""
    if note is None:
        return
    found = _read(note)
    if found is not None and found.pid == os.getpid():
        with contextlib.suppress(OSError):
            note.unlink()


def holder_of(port: str) -> Holder | None:
    """The other process of this program that holds a port, or None."""
    found = _noted(port)
    return None if found is None or found.pid == os.getpid() or not found.is_alive else found


def is_abandoned(port: str) -> bool:
    """Whether a process of ours that held a port ended without closing it."""
    found = _noted(port)
    return found is not None and found.pid != os.getpid() and not found.is_alive


def servers() -> tuple[Holder, ...]:
    """The other processes of this user that serve ports, one entry each."""
    try:
        notes = [_read(path) for path in _folder().glob("*.json")]
    except OSError:
        return ()
    found = {one.pid: one for one in notes if one is not None and one.serves_at and one.pid != os.getpid()}
    return tuple(one for one in found.values() if one.is_alive)


def _noted(port: str) -> Holder | None:
    try:
        return _read(_note_of(port))
    except OSError:
        return None


def wait_until_released(port: str, timeout_s: float) -> bool:
    """Wait until no other process of ours holds a port; False if one still does after `timeout_s` seconds."""
    deadline = time.monotonic() + timeout_s
    while holder_of(port) is not None:
        if time.monotonic() >= deadline:
            return False
        time.sleep(POLL_S)
    return True


USB = "usb:"


def actual_port(port: str) -> str:
    """The name that the system gives now to a port named by its USB device, ``usb:`` and what `rig ports` lists of it.

    After ``usb:`` stand the serial number, ``vendor:product``, ``vendor:product:serial``, or the place of the socket
    (``1-1.4``). Such a name outlives that the device comes back under another number. Any other name is returned.

    Raises:
        NotConnected: no device, or more than one, fits.
    """
    if not port.lower().startswith(USB):
        return port
    from serial.tools import list_ports  # noqa: PLC0415 - of such names only; a stop must not wait for imports

    wanted = port[len(USB) :].casefold()
    found = {one.device: _usb_names(one) for one in list_ports.comports() if one.vid is not None}
    fitting = [device for device, names in sorted(found.items()) if wanted in names]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        raise NotConnected(
            f"port {port} fits {' and '.join(fitting)}; name one by its serial number or socket (anisoscope rig ports)"
        )
    raise NotConnected(
        f"there is no USB device {port[len(USB) :]} now; plug it in, or correct the port (anisoscope rig ports)"
    )


def _usb_names(one: Any) -> frozenset[str]:  # noqa: ANN401 - of pyserial
    usb = f"{one.vid:04x}:{one.pid or 0:04x}"
    names = (usb, one.serial_number, one.serial_number and f"{usb}:{one.serial_number}", one.location)
    return frozenset(name.casefold() for name in names if name)


def _note_of(port: str) -> Path:
    with contextlib.suppress(NotConnected):
        port = actual_port(port)
    name = port
    if "://" not in port:  # /dev/serial/by-id/… and /dev/ttyUSB0 may be one port, as COM3 and com3 are
        name = os.path.realpath(port) if port.startswith("/") else port.upper()
    return _folder() / f"{hashlib.sha256(name.encode()).hexdigest()[:24]}.json"


def _folder() -> Path:
    """A folder that only this user can write to, created if missing.

    Raises:
        OSError: it cannot be created, or it belongs to another user.
    """
    given = os.environ.get("XDG_RUNTIME_DIR") or os.environ.get("LOCALAPPDATA")
    folder = Path(given or tempfile.gettempdir()) / ("anisoscope" if given else f"anisoscope-{user_name()}")
    folder.mkdir(mode=0o700, exist_ok=True)
    if hasattr(os, "getuid"):
        status = folder.lstat()
        if status.st_uid != os.getuid() or status.st_mode & 0o022:
            raise PermissionError(f"{folder} can be written to by others")
    return folder


def _read(note: Path) -> Holder | None:
    try:
        found = json.loads(bounded_text(note))
        return Holder(
            int(found["pid"]),
            str(found["port"]),
            str(found["program"]),
            str(found["started"]),
            str(found["interrupt_by"]),
            *(str(found.get(key, "")) for key in ("serves_at", "token", "rig")),
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _started(pid: int) -> str:
    """When a process was started; "" for one that has ended."""
    if not PROC.is_dir():
        return _started_elsewhere(pid)
    try:
        text = (PROC / str(pid) / "stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    fields = text.rpartition(")")[2].split()  # from field 3 of proc(5); the name before it may hold anything
    return "" if fields[0] == "Z" else fields[19]  # what has ended and was not waited for holds nothing


def _started_elsewhere(pid: int) -> str:
    """As `_started`, on Windows and macOS. Not on Linux, where it changes with the clock."""
    import psutil  # noqa: PLC0415 - slow to import, and not needed on Linux

    try:
        process = psutil.Process(pid)
        return "" if process.status() == psutil.STATUS_ZOMBIE else repr(process.create_time())
    except psutil.Error:
        return ""


def _handled_signal() -> str:
    for name in ("SIGINT", "SIGTERM"):
        if callable(signal.getsignal(signal.Signals[name])):
            return name
    return ""
