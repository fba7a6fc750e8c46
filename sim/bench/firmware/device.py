"""Base of all simulated devices: a line with faults, and a log of the host's commands."""

import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable
from typing import ClassVar, Protocol, runtime_checkable

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.faults import Fault, FaultKind

RECENT_COMMANDS = 1000


@runtime_checkable
class Firmware(Protocol):
    """A simulated device on a line: bytes in, bytes out."""

    @property
    def clock(self) -> Callable[[], float]:
        """Monotonic time of the device in seconds; a `Clock` also says how to wait by it."""
        ...

    def connect(self) -> None:
        """A host opened the line."""
        ...

    def write(self, data: bytes) -> None:
        """Take bytes from the host; ConnectionError if the line is dead."""
        ...

    def read(self) -> bytes:
        """Return the bytes that are ready to be sent; ConnectionError if the line is dead."""
        ...


class SimulatedDevice(ABC):
    """A device behind a line: `write` takes what the host sends, `read` gives what is ready to be sent back.

    Thread-safe. A protocol adds `_take_packet`, `_attend` and `_unsolicited`, and sends with `_send`.

    Args:
        faults: what is wrong with the device; as text, ``name`` or ``name:number``.
        clock: monotonic time in seconds.

    Attributes:
        faults: the parameter of every fault that it has.
        commands: the last thousand whole commands that it took, in order.
        taken: how many commands it took.
        stops: how many commands were stop commands.

    Raises:
        UsageError: there is no fault of this name, or a device of this kind cannot have it.
    """

    IMPOSSIBLE: ClassVar[frozenset[FaultKind]] = frozenset()
    NOISE: ClassVar[bytes] = b"\x00\x00\xfe\x7f~!\r\n\x00?\xb5"
    BABBLE: ClassVar[bytes] = b"\x00\xc3?\r\n"

    def __init__(self, faults: Iterable[Fault | str], clock: Callable[[], float]) -> None:
        parsed = [Fault.parse(fault) if isinstance(fault, str) else fault for fault in faults]
        for fault in parsed:
            if fault.kind in self.IMPOSSIBLE:
                raise UsageError(f"a device of this protocol cannot have the fault '{fault.kind}'")
        self.faults = {fault.kind: fault.value for fault in parsed}
        self.commands: deque[bytes] = deque(maxlen=RECENT_COMMANDS)
        self.taken = 0
        self.stops = 0
        self._clock = clock
        self._lock = threading.RLock()
        self._inbox = bytearray()
        self._outbox = bytearray()
        self._dead = False

    # What a protocol adds.

    @abstractmethod
    def _take_packet(self) -> bool:
        """Carry out the first packet of the inbox; False if there is none that is whole."""

    @abstractmethod
    def _attend(self) -> None:
        """Process events since the last call (such as the end of a motion), and report them if the protocol does."""

    @abstractmethod
    def _unsolicited(self) -> bytes:
        """An unsolicited message of the protocol; empty if it has none."""

    def _repair(self) -> None:  # noqa: B027 - most devices have nothing more to repair
        """Undo the side effects of a fault."""

    @property
    def clock(self) -> Callable[[], float]:
        """Monotonic time of the device in seconds."""
        return self._clock

    # The line.

    def connect(self) -> None:
        """A host opened the line: what was under way on it is forgotten, and a dead line works again."""
        with self._lock:
            if self._dead:
                self._dead = False
                self.faults.pop(FaultKind.HANGUP, None)
            self._inbox.clear()
            self._outbox.clear()

    def clear_faults(self) -> None:
        """Repair everything."""
        with self._lock:
            self.faults.clear()
            self._dead = False
            self._repair()

    def write(self, data: bytes) -> None:
        """Take bytes from the host.

        Raises:
            ConnectionError: the line is dead.
        """
        with self._lock:
            self._check_line()
            self._attend()
            self._inbox += data
            while self._take_packet():
                pass

    def read(self) -> bytes:
        """Return the bytes that are ready to be sent to the host.

        Raises:
            ConnectionError: the line is dead.
        """
        with self._lock:
            self._check_line()
            self._attend()
            count = 1 if FaultKind.SPLIT in self.faults else len(self._outbox)
            ready = bytes(self._outbox[:count])
            del self._outbox[:count]
            return ready

    def _take(self, command: bytes) -> None:
        self.commands.append(command)
        self.taken += 1

    def _check_line(self) -> None:
        if self._dead:
            raise ConnectionError("the simulated line is dead")

    def _send(self, frame: bytes) -> None:
        """Queue a whole message for the host, through whatever is wrong with the line."""
        faults = self.faults
        if FaultKind.SILENT in faults and self.taken > faults[FaultKind.SILENT]:
            return
        if FaultKind.BABBLE in faults:
            self._outbox += self.BABBLE
            return
        if FaultKind.UNSOLICITED in faults:
            self._outbox += self._unsolicited()
        if FaultKind.GARBAGE in faults:
            self._outbox += self.NOISE
        self._outbox += frame
        if FaultKind.JOINED in faults:
            self._outbox += self._unsolicited()


class Bus:
    """Several devices on one line; each hears everything, and answers to its own address."""

    def __init__(self, *devices: Firmware) -> None:
        self.devices = devices

    @property
    def clock(self) -> Callable[[], float]:
        """Monotonic time of all devices on the line, in seconds."""
        return self.devices[0].clock

    def connect(self) -> None:
        """A host opened the line."""
        for device in self.devices:
            device.connect()

    def write(self, data: bytes) -> None:
        """Take bytes from the host."""
        for device in self.devices:
            device.write(data)

    def read(self) -> bytes:
        """Return the bytes that are ready to be sent to the host."""
        return b"".join(device.read() for device in self.devices)
