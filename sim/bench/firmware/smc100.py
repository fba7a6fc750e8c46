"""Firmware of a Newport SMC100 or CONEX controller with a rotation stage, byte by byte.

Questions are answered with address, letters and value; commands are not answered. An error is kept as a letter
until TE or TB asks for it. A home search is only taken while nothing is referenced: for a second one the
controller has to be restarted, and answers nothing meanwhile. A stage with an encoder notices an obstacle: the
motor is disabled with a following error. Source: Newport SMC100CC/PP user's manual.
"""

import re
from collections.abc import Callable, Sequence

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.catalogue import Mount, Simulated
from anisoscope.sim.bench.firmware.device import Bus, Firmware
from anisoscope.sim.bench.firmware.faults import FaultKind
from anisoscope.sim.bench.firmware.smc100_states import Smc100States
from anisoscope.sim.bench.firmware.smc100_tables import (
    ALLOWED,
    ANSWERED,
    BAD_ADDRESS,
    BAD_PARAMETER,
    ERROR_TEXTS,
    MODELS,
    UNKNOWN,
    Mode,
)

LINE_LENGTH = 80
_COMMAND = re.compile(r"(\d*)([A-Z]{2})(.*)$")


class Smc100Firmware(Smc100States):
    """One controller on the line; arguments and errors are those of `Smc100States`."""

    def _take_packet(self) -> bool:
        end = self._inbox.find(b"\r\n")
        if end < 0:
            del self._inbox[:-LINE_LENGTH]
            return False
        raw = bytes(self._inbox[:end])
        del self._inbox[: end + 2]
        line = raw.decode("latin-1").replace(" ", "").upper()
        match = _COMMAND.search(line)
        self._attend()
        if match is None or self._dead or self._clock() < self._restarted_at:
            return True
        address, letters, value = match.groups()
        if not address:
            self._fail(BAD_ADDRESS)
        elif int(address) == self.address:
            self.commands.append(letters.encode("ascii") + value.encode("latin-1"))
            self._obey(letters, value)
        return True

    def _obey(self, letters: str, value: str) -> None:
        question = value == "?" or (letters in {"TB", "TE", "TH", "TP", "TS", "VE", "ZT"})
        if question and letters in ANSWERED:
            self._answers()[letters](value.removesuffix("?"))
        elif question and letters in self.parameters:
            self._answer(letters, self._number(self.parameters[letters]))
        elif letters in self.parameters or letters == "ID":
            self._configure(letters, value)
        elif letters not in ALLOWED:
            self._fail(UNKNOWN)
        elif self.mode not in ALLOWED[letters]:
            if letters == "ST":
                self.stops += 1
            self._fail(self.mode.value)
        else:
            self._handlers()[letters](value)

    def _answers(self) -> dict[str, Callable[[str], None]]:
        say = self._answer
        enabled = int(self.mode in {Mode.READY, Mode.MOVING})
        return {
            "ID": lambda _: say("ID", self.stage),
            "MM": lambda _: say("MM", str(enabled)),
            "PA": lambda _: say("PA", self._degrees(self._target)),
            "PR": lambda _: say("PR", self._degrees(self._target)),
            "PT": lambda _: say("PT", f"{0.0:.3f}"),
            "PW": lambda _: say("PW", str(int(self.mode is Mode.CONFIGURATION))),
            "TB": self._tell_text,
            "TE": lambda _: self._tell_error(),
            "TH": lambda _: say("TH", self._degrees(self.motor.counts)),
            "TP": lambda _: self._tell_position(),
            "TS": lambda _: self._tell_state(),
            "VE": lambda _: say("VE", self.model.version),
            "ZT": lambda _: self._tell_all(),
            "ZX": lambda _: say("ZX", "3"),
        }

    def _handlers(self) -> dict[str, Callable[[str], None]]:
        return {
            "MM": self._enable,
            "OR": lambda _: self._start(None),
            "PA": lambda value: self._move(value, 0),
            "PR": lambda value: self._move(value, self.motor.counts),
            "PW": self._enter_configuration,
            "RS": lambda _: self._restart(),
            "ST": lambda _: self._stop(),
            "ZX": lambda value: None if value in {"1", "2", "3"} else self._fail(BAD_PARAMETER),
        }

    # Answers.

    def _answer(self, letters: str, value: str) -> None:
        speaker = self.address % 31 + 1 if FaultKind.WRONG_ADDRESS in self.faults else self.address
        self._say(f"{speaker}{letters}{value}\r\n".encode("ascii"))

    def _unasked(self) -> bytes:
        # What another controller on the line answered to another host's question.
        return f"{(self.address + 11) % 31 + 1}TP12.34500\r\n".encode("ascii")

    def _number(self, value: float) -> str:
        return f"{value:.6f}".rstrip("0").rstrip(".")

    def _degrees(self, counts: int) -> str:
        return f"{counts * self.model.step_deg:.5f}"

    def _tell_error(self) -> None:
        self._answer("TE", self._error)
        self._error = "@"

    def _tell_text(self, letter: str) -> None:
        asked = letter or self._error
        if not letter:
            self._error = "@"
        self._answer("TB", f"{asked} {ERROR_TEXTS.get(asked, 'Unknown')}")

    def _tell_position(self) -> None:
        self._answer("TP", self._degrees(self.motor.counts))
        if self.motor.loses_power():
            self._power_up()

    def _tell_state(self) -> None:
        self._answer("TS", f"{self._faults_seen:04X}{self._code:02X}")
        if self.mode in {Mode.READY, Mode.DISABLED}:
            self._faults_seen = 0

    def _tell_all(self) -> None:
        for letters, value in sorted(self.parameters.items()):
            self._answer(letters, self._number(value))
        self._answer("PW", "0")


def build(mounts: Sequence[Mount], model: str, faults: Sequence[str]) -> Firmware:
    """One controller an axis, at the addresses of the mounts."""
    controllers = []
    for number, mount in enumerate(mounts, start=1):
        address = mount.address or str(number)
        if not address.isdecimal() or not 1 <= int(address) <= 31:
            raise UsageError(f"'{address}' is no address of an SMC100 controller; use one of 1…31")
        wrong = faults if number == 1 else ()
        controllers.append(
            Smc100Firmware(mount.axis, address=int(address), model=MODELS[model], faults=wrong)
        )
    return controllers[0] if len(controllers) == 1 else Bus(*controllers)


SIMULATED = Simulated("Newport SMC100 or CONEX controller", tuple(MODELS), build)
