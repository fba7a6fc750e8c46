"""Trigger and result by digital inputs and outputs of a controller or coupler over Modbus/TCP.

The rig is the client: it reads a trigger (discrete input) and the number of the job (two holding registers), and writes
five coils. The number makes the handshake safe: a controller that still holds its trigger after a cut or a restart gets
the result of the same job, and no second one.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from anisoscope.base.errors import AnisoscopeError, NotConnected
from anisoscope.line.jobs import Jobs, Order
from anisoscope.parameters.serving import Addresses

POLL_S = 0.02


@dataclass(frozen=True)
class Lines:
    """The outputs, in the order of their addresses; without a job at work and a result all but ``ready`` are off."""

    ready: bool = False
    busy: bool = False
    passed: bool = False
    failed: bool = False
    invalid: bool = False

    def bits(self) -> list[bool]:
        """The outputs as coils."""
        return [self.ready, self.busy, self.passed, self.failed, self.invalid]


class Io(Protocol):
    """Inputs and outputs of a controller."""

    def read(self) -> int | None:
        """Number of the job while the trigger is on, else None.

        Raises:
            NotConnected: the controller does not answer.
        """
        ...

    def write(self, lines: Lines) -> None:
        """Set the outputs; errors as for `read`."""
        ...


class ModbusIo:
    """Inputs and outputs of a Modbus/TCP server.

    Args:
        host: address of the controller.
        port: its TCP port.
        addresses: where inputs and outputs are.
        timeout_s: for an answer.
    """

    def __init__(self, host: str, port: int, addresses: Addresses, timeout_s: float = 1.0) -> None:
        self._where, self._at = f"{host}:{port}", addresses
        self._client = ModbusTcpClient(host, port=port, timeout=timeout_s, retries=0)

    def read(self) -> int | None:
        """Number of the job while the trigger is on; see `Io`. The number counts once the trigger is on."""
        device = self._at.device
        inputs = self._do(lambda: self._client.read_discrete_inputs(self._at.trigger, device_id=device))
        if not inputs.bits[0]:
            return None
        words = self._do(
            lambda: self._client.read_holding_registers(self._at.number, count=2, device_id=device)
        )
        return int(struct.unpack(">I", struct.pack(">HH", *words.registers))[0])

    def write(self, lines: Lines) -> None:
        """Set the outputs in one request; see `Io`."""
        device = self._at.device
        self._do(lambda: self._client.write_coils(self._at.outputs, lines.bits(), device_id=device))

    def _do(self, ask: Callable[[], ModbusPDU]) -> ModbusPDU:
        try:
            if not self._client.connected and not self._client.connect():  # type: ignore[no-untyped-call]
                raise NotConnected(f"no controller answers at {self._where}: check address, port and cable")
            answer = ask()
        except (ModbusException, OSError) as problem:
            self._client.close()  # type: ignore[no-untyped-call]
            text = " ".join(str(problem).split())
            raise NotConnected(f"the controller at {self._where} does not answer: {text}") from None
        if answer.isError():
            raise NotConnected(
                f"the controller at {self._where} refuses the request ({answer}): check --trigger, --number, "
                "--outputs and --unit"
            )
        return answer

    def close(self) -> None:
        """Let go of the connection."""
        self._client.close()  # type: ignore[no-untyped-call]


class Handshake:
    """Trigger, job and result, one step at a time.

    Args:
        io: inputs and outputs.
        jobs: the jobs of the rig, entered.
        recipe: name of the recipe.
        prefix: begins the serial number; the number of the job follows.
        say: called with what the operator should read.
    """

    def __init__(self, io: Io, jobs: Jobs, recipe: str, prefix: str, say: Callable[[str], None]) -> None:
        self._io, self._jobs, self._recipe, self._prefix, self._say = io, jobs, recipe, prefix, say
        self._refused: tuple[int, str] | None = None
        self._said = ""

    def step(self) -> Lines | None:
        """Read the inputs, order the job of a new number, and set the outputs.

        Returns:
            The outputs; None where the controller does not answer: a job goes on, and the next step tries again.
        """
        try:
            number = self._io.read()
            lines = self._lines(number)
            self._io.write(lines)
        except NotConnected as problem:
            self._tell(str(problem))
            return None
        self._said = ""
        return lines

    def _lines(self, number: int | None) -> Lines:
        running = self._jobs.running
        if number is None:
            self._refused = None
            return Lines(ready=running is None, busy=running is not None)
        if self._refused is not None and self._refused[0] == number:
            return Lines(invalid=True)
        name = f"{self._prefix}{number}"
        try:
            job = self._jobs.submit(Order(job=f"modbus-{name}", recipe=self._recipe, serial=name))
        except AnisoscopeError as refused:
            if running is not None:  # of another number: its result comes first
                return Lines(busy=True)
            self._refused = number, str(refused)
            self._say(f"job {number} is refused: {refused}")
            return Lines(invalid=True)
        if job.state == "running":
            return Lines(busy=True)
        return Lines(
            passed=job.verdict == "PASS",
            failed=job.verdict == "FAIL",
            invalid=job.verdict not in {"PASS", "FAIL"},
        )

    def _tell(self, text: str) -> None:
        if text != self._said:
            self._said = text
            self._say(text)
