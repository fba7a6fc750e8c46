"""The talking half of a simulated Zaber stage: addresses, numbers, checksums, settings; motion is in `zaber`."""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Sequence

from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.device import SimulatedDevice
from anisoscope.sim.bench.firmware.faults import Fault, FaultKind
from anisoscope.sim.bench.firmware.zaber_settings import MAX_ADDRESS, Settings, ZaberModel
from anisoscope.sim.bench.firmware.zaber_wire import NO_REPLY, Command, frame

STAGGER_S = 0.005
NUMBERS = 100
Answer = tuple[bool, str]
OK: Answer = (True, "0")
UNKNOWN: Answer = (False, "BADCOMMAND")
Handler = Callable[[Command], Answer]


class ZaberController(SimulatedDevice):
    """A device on the line, without its motor.

    Args:
        axis: the axis that it turns.
        address: address of the device, 1…99.
        model: id, serial number, scale and speed.
        faults: what is wrong with it.
        place: how many devices stand before it on the line.

    Attributes:
        settings: what ``get`` reads and ``set`` writes.
    """

    def __init__(
        self, axis: RotaryAxis, address: int, model: ZaberModel, faults: Iterable[Fault | str], place: int
    ) -> None:
        super().__init__(faults, axis.clock)
        self.axis = axis
        self.model = model
        self.settings = Settings(model, address, self._measured())
        self._place = place
        self._waiting: list[tuple[float, bytes]] = []

    @property
    @abstractmethod
    def flags(self) -> tuple[str, ...]:
        """The warning flags that stand, the gravest first."""

    @property
    @abstractmethod
    def busy(self) -> bool:
        """Whether it says that it moves."""

    @abstractmethod
    def _measured(self) -> dict[str, Callable[[], int]]:
        """Settings of the axis that are measured when asked for."""

    @abstractmethod
    def _motion_handlers(self) -> dict[str, Handler]:
        """Commands that this half does not know, by their first word."""

    @abstractmethod
    def _after(self, command: Command) -> None:
        """Something to do once a command has been answered."""

    @property
    def address(self) -> int:
        """Address of the device."""
        return self.settings["comm.address"]

    def connect(self) -> None:
        """A host opened the line: what was under way on it is forgotten."""
        with self._lock:
            super().connect()
            self._waiting.clear()

    # Packets.

    def _take_packet(self) -> bool:
        ends = [end for end in (self._inbox.find(b"\n"), self._inbox.find(b"\r")) if end >= 0]
        if not ends:
            return False
        line = bytes(self._inbox[: min(ends)])
        del self._inbox[: min(ends) + 1]
        command = Command.parse(line)
        if command is not None and command.device in {0, self.address}:
            self.commands.append(line)
            self._obey(command)
        return True

    def _obey(self, command: Command) -> None:
        self._attend()
        speaker = self.address  # a command that changes the address is still answered from the old one
        accepted, data = self._answer_to(command)
        if command.number == NO_REPLY or self._dead:
            return
        verdict = f"{'OK' if accepted else 'RJ'} {self._state()} {data}"
        self._reply("@", command, speaker, verdict)
        if command.words[:1] == ("help",):
            for word in sorted(self._handlers()):
                self._reply("#", command, speaker, word)
        self._after(command)

    def _answer_to(self, command: Command) -> Answer:
        if command.number.isdecimal() and int(command.number) >= NUMBERS:
            return False, "BADMESSAGEID"
        if command.axis > 1:
            return False, "BADAXIS"
        if not command.words:
            return OK
        handler = self._handlers().get(command.words[0])
        return handler(command) if handler else UNKNOWN

    def _handlers(self) -> dict[str, Handler]:
        return {
            "get": self._get,
            "set": self._set,
            "renumber": self._renumber,
            "help": lambda _: OK,
            **self._motion_handlers(),
        }

    # Messages.

    def _state(self) -> str:
        return f"{'BUSY' if self.busy else 'IDLE'} {next(iter(self.flags), '--')}"

    def _reply(self, kind: str, command: Command, speaker: int, text: str) -> None:
        number = f"{int(command.number):02d} " if command.number else ""
        shown = speaker % MAX_ADDRESS + 1 if FaultKind.WRONG_ADDRESS in self.faults else speaker
        checked = command.checked or self.settings["comm.checksum"] == 1
        message = frame(kind, f"{shown:02d} {command.axis} {number}{text}", checked=checked)
        if command.device == 0 and self._place:  # to everybody is answered in the order of the line
            self._waiting.append((self._clock() + self._place * STAGGER_S, message))
        else:
            self._say(message)

    def _say_what_waited(self) -> None:
        while self._waiting and self._waiting[0][0] <= self._clock():
            self._say(self._waiting.pop(0)[1])

    def _alert(self) -> None:
        if self.settings["comm.alert"] == 1:
            text = f"{self.address:02d} 1 {self._state()}"
            self._say(frame("!", text, checked=self.settings["comm.checksum"] == 1))

    def _unasked(self) -> bytes:
        return f"!{self.address:02d} 1 IDLE --\r\n#{self.address:02d} 0 nobody asked\r\n".encode("ascii")

    # Settings.

    def _get(self, command: Command) -> Answer:
        names: Sequence[str] = command.words[1:]
        return self.settings.get(names[0], command.axis) if len(names) == 1 else UNKNOWN

    def _set(self, command: Command) -> Answer:
        match command.words[1:]:
            case (name, value):
                return self.settings.set(name, value, command.axis)
            case _:
                return UNKNOWN

    def _renumber(self, command: Command) -> Answer:
        first = command.words[1] if command.words[1:] else "1"
        if command.axis:
            return False, "DEVICEONLY"
        if not first.isdecimal():
            return False, "BADDATA"
        later = self._place if command.device == 0 else 0
        return self.settings.set("comm.address", str(int(first) + later), 0)
