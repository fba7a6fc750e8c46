"""A Grbl board, which several axes share: how it starts, what it is, where it stands."""

import time
import weakref

from anisoscope.base.errors import NotConnected, ProtocolError
from anisoscope.rig.stages.grbl_talk import TRIES, GrblTalk
from anisoscope.rig.stages.grbl_wire import (
    ACCELERATION,
    HOMING,
    HOMING_DIRECTION,
    INCHES,
    PULL_OFF,
    RATE,
    RESET,
    STATUS,
    STEPS,
    TRAVEL,
    Banner,
    Message,
    Setting,
    Status,
    Told,
)
from anisoscope.rig.transport import Transport

# The offset of the work coordinates comes along with every 30th report at the latest.
REPORTS_UNTIL_OFFSET = 32
NEEDED_SETTINGS = (STEPS, RATE, ACCELERATION, TRAVEL, INCHES, HOMING, HOMING_DIRECTION, PULL_OFF)


class GrblBoard(GrblTalk):
    """A board behind a port.

    Args:
        transport: the open port.
        timeout_s: time in seconds for the answer to a question.
        reset_s: for so long a board that was reset by opening the port has time to start.

    Attributes:
        version: firmware release.
        note: the user's text in the board.
        options: letters of the options that were compiled in.
        settings: the settings, by number.
        homings: how often a reference search ended.

    Raises:
        NotConnected: nobody answers.
        ProtocolError: somebody answers, but it is no Grbl 1.1.
    """

    def __init__(self, transport: Transport, timeout_s: float, reset_s: float) -> None:
        super().__init__(transport, timeout_s)
        self.settings: dict[int, float] = {}
        self.version = self.note = self.options = ""
        self.homings = 0
        self._connect(reset_s)

    def ask_status(self, wait_s: float | None = None) -> Status:
        """Ask for a status report, and return it with the machine position filled in.

        Raises:
            NotConnected: no report within `wait_s` seconds, by default the time for an answer.
        """
        self.drain()
        for _ in range(REPORTS_UNTIL_OFFSET):
            status = self._one_status(self._timeout_s if wait_s is None else wait_s)
            machine = self._machine(status)
            if machine:
                return Status(
                    status.state, status.substate, machine, status.work, self._offset, pins=status.pins
                )
        raise ProtocolError(f"{self.name} does not say where its work coordinates begin; set $10=1")

    def _one_status(self, wait_s: float) -> Status:
        for _ in range(TRIES):
            self._heard = False
            self.send_now(STATUS)
            deadline = time.monotonic() + wait_s
            while (left_s := deadline - time.monotonic()) > 0.0:
                message = self.next_message(left_s)
                if isinstance(message, Status):
                    return message
                if message is None or self.critical:
                    break
            if self.critical or not self._heard:
                break
        raise self.silence()

    def _machine(self, status: Status) -> tuple[float, ...]:
        if status.machine or not self._offset:
            return status.machine
        return tuple(place + offset for place, offset in zip(status.work, self._offset, strict=False))

    # Starting.

    def reset(self, wait_s: float = 1.0) -> bool:
        """Reset the firmware, and wait for it to start; whether it did. A board at rest keeps its position."""
        self.drain()
        self.send_now(RESET)
        return self._await_banner(wait_s)

    def _await_banner(self, wait_s: float) -> bool:
        deadline = time.monotonic() + wait_s
        while (left_s := deadline - time.monotonic()) > 0.0:
            message = self.next_message(left_s)
            if isinstance(message, Banner):
                self.version = message.version
                return True
        return False

    def _connect(self, reset_s: float) -> None:
        # A board without reset by DTR may stand in the middle of anything: it is reset by a byte.
        if not self._await_banner(reset_s) and not self.reset(self._timeout_s):
            raise self.silence()
        if self.version < "1.1":
            raise ProtocolError(f"{self.name} runs Grbl {self.version}; this driver needs 1.1 or newer")
        try:
            self.request("$I", self._take_build)
        except NotConnected:
            # An alarm that stands since power-up locks the board; only a reset helps.
            if not (self.critical and self.reset(self._timeout_s)):
                raise
            self.request("$I", self._take_build)
        self.alarm = None
        self.request("$$", self._take_setting)
        if missing := [number for number in NEEDED_SETTINGS if number not in self.settings]:
            raise ProtocolError(f"{self.name} does not list its setting ${missing[0]}; is it Grbl 1.1?")
        if self.settings[INCHES]:
            raise ProtocolError(f"{self.name} reports in inches; set $13=0")

    def _take_build(self, message: Message) -> None:
        if isinstance(message, Told) and message.name == "VER":
            self.note = message.text.partition(":")[2].strip()
        elif isinstance(message, Told) and message.name == "OPT":
            self.options = message.text.partition(",")[0]

    def _take_setting(self, message: Message) -> None:
        if isinstance(message, Setting):
            self.settings[message.number] = message.value


# By the lock of their connection, which lives as long as the board.
_boards: weakref.WeakValueDictionary[int, GrblBoard] = weakref.WeakValueDictionary()


def board_on(transport: Transport, timeout_s: float, reset_s: float) -> GrblBoard:
    """The board behind a port; axes that share a connection share it. Errors as for `GrblBoard`."""
    with transport.lock:
        board = _boards.get(id(transport.lock))
        if board is None:
            board = _boards[id(transport.lock)] = GrblBoard(transport, timeout_s, reset_s)
        else:
            board.attach(transport)
        return board
