"""Driver for rotation stages on Newport SMC100 and CONEX controllers: 57600 or 921600 baud, several on a line.

The controller works in degrees, and tells limits, speed and resolution. Commands are not answered: the driver asks
for the error after each. A new home search needs a restart of the controller, because a referenced one refuses
it. The reference survives a new connection. Source: Newport SMC100CC/PP user's manual.
"""

import contextlib
import time
from typing import ClassVar

from anisoscope.base.errors import NotConnected, NotHomed, ProtocolError, RigError, Stalled
from anisoscope.rig.stage import MotionRules
from anisoscope.rig.stages.portstage import PortStage
from anisoscope.rig.stages.smc100_line import Smc100Line
from anisoscope.rig.stages.smc100_wire import (
    ADDRESSES,
    BUSY_ERRORS,
    CONFIGURATION,
    DISABLED,
    HOMING,
    IN_MOTION,
    NO_ERROR,
    NOT_REFERENCED,
    READY,
    State,
    error_of_letter,
)
from anisoscope.rig.transport import Transport

FIRST_POLL_S, BUSY_POLL_S = 0.002, 0.02


class Smc100(PortStage):
    """A rotation stage at one address of a port.

    Args:
        transport: the open port; several stages may share it.
        address: 1 … 31, as a number or as text.
        timeout_s: time in seconds for the answer to a question.
        restart_s: time in seconds that the controller may need to restart before a second home search.
        tolerance_deg: a stage this near to the target has arrived.
        resolution_deg: smallest step; by default the encoder increment that the controller tells.
        velocity_deg_s: speed to compute time limits from; by default the one that is set in the controller.
        margin_s: seconds added to every computed time limit.
        min_deg, max_deg: limits in degrees; by default those of the controller.

    Raises:
        NotConnected: nobody answers at this address.
        ProtocolError: somebody answers, but it is no such controller.
    """

    PORT: ClassVar = {"baudrate": 57600, "xonxoff": True}

    def __init__(
        self,
        transport: Transport,
        *,
        address: str | int = 1,
        timeout_s: float = 0.5,
        restart_s: float = 15.0,
        tolerance_deg: float = 0.01,
        resolution_deg: float | None = None,
        velocity_deg_s: float | None = None,
        margin_s: float = 2.0,
        min_deg: float | None = None,
        max_deg: float | None = None,
    ) -> None:
        if not str(address).isdecimal() or int(address) not in ADDRESSES:
            raise RigError(f"'{address}' is no address of an SMC100 controller; use one of 1…31")
        self.address = int(address)
        self._transport = transport
        self._line = line = Smc100Line(transport, self.address, timeout_s)
        self._restart_s = restart_s
        self._command, self._doing = "", ""
        self._refusal = NO_ERROR
        self._polls = 0
        self._busy_until = 0.0
        self._searching = False
        with transport.lock:
            state = line.state()
            line.error()  # one of the past is kept until it is asked for
            name = line.ask("ID?") or "SMC100"
            limits = line.ask_number("SL?"), line.ask_number("SR?")
            velocity, acceleration = line.ask_number("VA?"), line.ask_number("AC?")
            resolution = resolution_deg or self._encoder_step_deg()
        if velocity_deg_s is not None:
            velocity, acceleration = velocity_deg_s, velocity_deg_s / 0.1
        if min(velocity, acceleration, resolution) <= 0.0:
            raise ProtocolError(f"{line.name} tells a speed of {velocity:g}°/s; is it a rotation stage?")
        limits = (limits[0] if min_deg is None else min_deg, limits[1] if max_deg is None else max_deg)
        rules = MotionRules(max(tolerance_deg, resolution), velocity, acceleration, margin_s)
        super().__init__(f"{name}, address {self.address}", rules, limits, resolution)
        line.name = self.name
        self._bus = transport.lock
        self._homed = state.code not in NOT_REFERENCED | HOMING | {CONFIGURATION}

    def _encoder_step_deg(self) -> float:
        try:
            return self._line.ask_number("SU?")
        except NotConnected:
            raise ProtocolError(
                f"{self._line.name} does not tell its resolution (SU); set resolution_deg in the rig file"
            ) from None
        finally:
            self._line.error()

    # The motion.

    def _state(self) -> State:
        state = self._line.state()
        if state.code == CONFIGURATION:
            raise RigError(
                f"{self.name} is being configured; leave that state with PW0 in the maker's program"
            )
        return state

    def _read_deg(self) -> float:
        if self._homed and self._state().code in NOT_REFERENCED:
            raise self._lost()
        return self._line.ask_number("TP")

    def _lost(self) -> NotHomed:
        self._homed = False
        return NotHomed(f"{self.name} was restarted or switched off, and its position is lost; home it again")

    def _begin_home(self) -> None:
        self._searching = True
        state = self._state()
        if state.code in IN_MOTION - HOMING:
            self._line.send("ST")
            self._wait_until_still()
            state = self._state()
        if state.code in READY | DISABLED:
            self._restart()
        self._begin("OR", "searching the reference")

    def _restart(self) -> None:
        """Restart the controller, and wait until it answers again and knows no reference."""
        self._line.send("RS")  # no question about an error: it answers nothing for some seconds
        deadline = time.monotonic() + self._restart_s
        while True:
            with contextlib.suppress(NotConnected):
                if self._line.state().code in NOT_REFERENCED:
                    return
            if not self._transport.is_open or time.monotonic() >= deadline:
                raise NotConnected(f"{self.name} does not come back from its restart; switch it off and on")
            time.sleep(BUSY_POLL_S)

    def _begin_move(self, target_deg: float) -> None:
        self._searching = False
        if self._state().code in DISABLED:
            self._line.command("MM1", "enabling the motor")
        steps = round(target_deg / self._resolution_deg)
        self._begin(f"PA{steps * self._resolution_deg:.6f}", "moving")

    def _begin(self, command: str, doing: str) -> None:
        self._command, self._doing = command, doing
        self._polls = 0
        self._busy_until = time.monotonic() + self.rules.margin_s
        self._order()

    def _order(self) -> None:
        """Send the command of the motion; one that meets a moving stage is sent again later."""
        self._line.send(self._command)
        self._refusal = self._line.error()
        if self._refusal in BUSY_ERRORS and time.monotonic() < self._busy_until:
            return
        if self._refusal != NO_ERROR:
            raise error_of_letter(self.name, self._refusal, self._doing)

    def _is_busy(self, wait_s: float) -> bool:
        if self._polls:
            time.sleep(max(0.0, min(wait_s, FIRST_POLL_S * 2.0 ** min(self._polls, 5))))
        self._polls += 1
        state = self._state()
        if state.code in IN_MOTION:
            return True
        if self._refusal != NO_ERROR and not self._stopping.is_set():
            time.sleep(BUSY_POLL_S)
            self._order()
            return True
        if state.code not in READY and not self._stopping.is_set():
            raise self._failure(state)
        return False

    def _failure(self, state: State) -> RigError:
        """Why a motion ended without the stage being ready."""
        if state.code in DISABLED:
            return Stalled(f"{self.name}: the motor was disabled; the controller reports {state.faults_text}")
        if not self._searching and not state.faults:
            return self._lost()
        self._homed = False
        return Stalled(
            f"{self.name}: {self._doing} failed; the controller reports {state.faults_text}; home it again"
        )

    def _send_stop(self) -> None:
        self._line.send("ST")

    def _wait_until_still(self) -> None:
        deadline = time.monotonic() + self.rules.margin_s
        while self._line.state().code in IN_MOTION and time.monotonic() < deadline:
            time.sleep(BUSY_POLL_S)
        self._line.error()  # a stop of a stage at rest may have been refused
