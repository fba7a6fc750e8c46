"""pyserial's handler for ``sim://…``: a simulated device in this process, without a port.

``sim://zaber?address=2&time_scale=0.1&fault=stall:30&model=X-RSW60A`` is a stage on its own;
``sim://elliptec?bench=/path/bench.toml`` is the line to the stage of a virtual rig, shared with its camera; the bench
file states all else. Values are percent-decoded; ``fault`` may be given several times. An option that would have no
effect is refused.
"""

import errno
import math
import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar
from urllib.parse import unquote

from serial.serialutil import PortNotOpenError, SerialBase, SerialException

from anisoscope.base.clock import SYSTEM, Clock
from anisoscope.base.errors import AnisoscopeError
from anisoscope.sim.bench.firmware.catalogue import build, lone_mount
from anisoscope.sim.bench.firmware.device import Firmware

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

POLL_S = 0.001
OPTIONS = frozenset({"address", "time_scale", "fault", "model", "bench"})


class Serial(SerialBase):
    """A port behind which a simulated device answers."""

    _held: ClassVar[set[int]] = set()
    _held_lock: ClassVar[threading.Lock] = threading.Lock()

    def open(self) -> None:
        """Connect to the device that the URL names.

        Raises:
            SerialException: the URL names no device, or the device is in use.
        """
        if self.is_open:
            raise SerialException("Port is already open.")
        try:
            firmware = device_of_url(self.port or "")
        except (AnisoscopeError, ValueError) as problem:
            raise SerialException(str(problem)) from problem
        with Serial._held_lock:
            if id(firmware) in Serial._held:
                raise SerialException(errno.EBUSY, "the simulated device is in use")
            Serial._held.add(id(firmware))
        self._firmware = firmware
        self._clock = firmware.clock if isinstance(firmware.clock, Clock) else SYSTEM
        self._inbox = bytearray()
        firmware.connect()
        self.is_open = True

    def close(self) -> None:
        """Let go of the device; closing twice is fine."""
        if self.is_open:
            self.is_open = False
            with Serial._held_lock:
                Serial._held.discard(id(self._firmware))

    @property
    def clock(self) -> Clock:
        """Time of the device."""
        return self._clock

    @property
    def in_waiting(self) -> int:
        """Number of bytes that can be read without waiting."""
        self._receive()
        return len(self._inbox)

    def read(self, size: int = 1, /) -> bytes:
        """Read up to `size` bytes, waiting for them no longer than the timeout of the port."""
        clock = self._clock
        deadline = math.inf if self.timeout is None else clock() + self.timeout
        self._receive()
        while len(self._inbox) < size and clock() < deadline:
            clock.sleep(POLL_S)
            self._receive()
        data = bytes(self._inbox[:size])
        del self._inbox[:size]
        return data

    def write(self, b: "ReadableBuffer", /) -> int:
        """Send bytes to the device."""
        self._check_open()
        data = bytes(b)
        try:
            self._firmware.write(data)
        except ConnectionError as problem:
            raise SerialException(f"write failed: {problem}") from problem
        return len(data)

    def flush(self) -> None:
        """Nothing to wait for: the device takes bytes at once."""
        self._check_open()

    def reset_input_buffer(self) -> None:
        """Drop what was received."""
        self._receive()
        self._inbox.clear()

    def reset_output_buffer(self) -> None:
        """Nothing to drop: the device takes bytes at once."""
        self._check_open()

    @property
    def cts(self) -> bool:
        """Clear to send: always."""
        return True

    @property
    def dsr(self) -> bool:
        """Data set ready: always."""
        return True

    @property
    def ri(self) -> bool:
        """Ring indicator: never."""
        return False

    @property
    def cd(self) -> bool:
        """Carrier detect: always."""
        return True

    def _check_open(self) -> None:
        if not self.is_open:
            raise PortNotOpenError

    def _receive(self) -> None:
        self._check_open()
        try:
            self._inbox += self._firmware.read()
        except ConnectionError as problem:
            raise SerialException(f"read failed: {problem}") from problem

    def _reconfigure_port(self, force_update: bool = False) -> None:
        """Line settings mean nothing here."""

    def _update_dtr_state(self) -> None:
        """There is no such line here."""

    def _update_rts_state(self) -> None:
        """There is no such line here."""

    def _update_break_state(self) -> None:
        """There is no such line here."""


def device_of_url(url: str) -> Firmware:
    """Return the simulated device that a ``sim://`` URL names.

    Raises:
        ValueError: no such device, or a wrong option.
        AnisoscopeError: the bench file is wrong, or there is no such fault.
    """
    name, _, query = url.partition("://")[2].partition("?")
    name = name.rstrip("/")
    pairs = [item.partition("=")[::2] for item in query.split("&") if item]
    options = {key: unquote(value) for key, value in pairs}
    if unknown := options.keys() - OPTIONS:
        raise ValueError(f"unknown option '{min(unknown)}'; known: {', '.join(sorted(OPTIONS))}")
    keys = [key for key, _ in pairs]
    if repeated := [key for key in keys if key != "fault" and keys.count(key) > 1]:
        raise ValueError(f"option '{repeated[0]}' is given twice; give it once")
    if "bench" in options:
        from anisoscope.sim.bench.bench import shared_bench  # noqa: PLC0415 - heavy, and needs light

        if further := sorted(options.keys() - {"bench"}):
            raise ValueError(
                f"option '{further[0]}' has no effect with bench=; state it in {options['bench']}, table [stage]"
            )
        return shared_bench(options["bench"]).device(name)
    return build(
        name,
        [lone_mount(name, options.get("model", ""), options.get("address", ""), _time_scale(options))],
        model=options.get("model", ""),
        faults=[unquote(value) for key, value in pairs if key == "fault"],
    )


def _time_scale(options: Mapping[str, str]) -> float:
    text = options.get("time_scale", "1")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (0.0 <= value < math.inf):
        raise ValueError(
            f"time_scale={text}: give a number of at least 0, such as 0.1 for a tenth of the time"
        )
    return value
