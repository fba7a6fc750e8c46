"""Driver for Zaber rotary stages (X-RSW, X-RST, X-RSB, …): ASCII protocol at 115200 baud or over TCP.

Scale, speed, acceleration and limits are read from the device, and so is whether it has its reference position: a
stage that was homed since it was switched on need not be homed again. Every command bears a number and a checksum,
and an answer counts only if both are right. Source: Zaber ASCII protocol manual.
"""

import contextlib
from typing import ClassVar

from anisoscope.base.errors import MotionTimeout, ProtocolError, RigError
from anisoscope.rig.stage import MotionRules
from anisoscope.rig.stages.portstage import PortStage
from anisoscope.rig.stages.zaber_line import ZaberLine
from anisoscope.rig.stages.zaber_settings import (
    FULL_TURN_DEG,
    acknowledge_flags,
    identify,
    read_counts_per_deg,
    read_flags,
    read_limits_deg,
    read_pace,
)
from anisoscope.rig.stages.zaber_wire import (
    INTERRUPTED,
    NO_REFERENCE,
    TRY_AGAIN,
    Reply,
    error_of_flag,
    error_of_rejection,
)
from anisoscope.rig.transport import Transport

MAX_ADDRESS = 99
MAX_AXIS = 9
FIRST_PAUSE_S = 0.002
LAST_PAUSE_S = 0.05


class Zaber(PortStage):
    """A rotary stage at one address of a port.

    Args:
        transport: the open port; several stages may share it.
        address: number of the device, 1…99.
        axis: number of the axis on the device; stages with a controller of their own have one.
        timeout_s: time in seconds for the answer to a question; a question is asked three times.
        tolerance_deg: a stage this near to the target has arrived.
        velocity_deg_s, acceleration_deg_s2: to compute time limits from; by default the device's own settings.
        margin_s: seconds added to every computed time limit.
        min_deg, max_deg: limits in degrees; by default 0 and 360, or less if the device's own limits are narrower.
        counts_per_turn: microsteps for 360°, where the device does not know, or behind a gear of your own.

    Raises:
        NotConnected: nobody answers at this address.
        ProtocolError: somebody answers, but it is no Zaber rotary stage.
        LimitExceeded: `min_deg` or `max_deg` is beyond what the device allows.
        RigError: the device reports a fault that does not go away.
    """

    PORT: ClassVar = {"baudrate": 115200}

    def __init__(
        self,
        transport: Transport,
        *,
        address: int | str = 1,
        axis: int = 1,
        timeout_s: float = 0.5,
        tolerance_deg: float = 0.02,
        velocity_deg_s: float | None = None,
        acceleration_deg_s2: float | None = None,
        margin_s: float = 2.0,
        min_deg: float | None = None,
        max_deg: float | None = None,
        counts_per_turn: float | None = None,
    ) -> None:
        self.address = _number("address", address, MAX_ADDRESS)
        self.axis = _number("axis", axis, MAX_AXIS)
        self._transport = transport
        self._line = ZaberLine(transport, self.address, self.axis, timeout_s)
        self._command = ""
        self._refused = False
        self._pause_s = 0.0
        super().__init__(self._line.name, MotionRules(tolerance_deg, 1.0), (0.0, FULL_TURN_DEG), 0.0)
        self._bus = transport.lock
        with self._bus:
            self._name = self._line.name = identify(self._line)
            self._counts_per_deg = read_counts_per_deg(self._line, counts_per_turn)
            self._resolution_deg = 1.0 / self._counts_per_deg
            self._limits_deg = read_limits_deg(self._line, self._counts_per_deg, min_deg, max_deg)
            velocity, acceleration = read_pace(self._line, self._counts_per_deg)
            self.rules = MotionRules(
                max(tolerance_deg, self._resolution_deg),
                velocity_deg_s or velocity,
                acceleration_deg_s2 or acceleration,
                margin_s=margin_s,
            )
            self._homed = NO_REFERENCE.isdisjoint(acknowledge_flags(self._line))

    def warnings(self) -> tuple[str, ...]:
        """Read the warning flags that stand, such as ``WR``, the gravest first."""
        with self._bus:
            return read_flags(self._line)

    # The motion.

    def _read_deg(self) -> float:
        reply = self._line.command("get pos")
        if reply.flag in NO_REFERENCE:
            self._homed = False
        try:
            return float(reply.data) / self._counts_per_deg
        except ValueError:
            raise ProtocolError(
                f"{self.name} says '{reply.data}' for its position; that is no number"
            ) from None

    def _check_reference(self, now_deg: float) -> None:
        """The device itself says whether it has its reference; a turn of its knob is counted."""
        del now_deg
        if not self._homed:
            raise error_of_flag(self.name, "WR")

    def _begin_home(self) -> None:
        self._begin("home")

    def _begin_move(self, target_deg: float) -> None:
        self._begin(f"move abs {round(target_deg * self._counts_per_deg)}")

    def _begin(self, command: str) -> None:
        if self._line.flag == INTERRUPTED or self._line.flag.startswith("F"):
            self._line.command("warnings clear")  # what is of the past shall not end the motion to come
        self._command = command
        self._pause_s = 0.0
        self._start()

    def _start(self) -> None:
        reply = self._line.ask(self._command)
        self._refused = reply.data in TRY_AGAIN and not reply.accepted
        if not reply.accepted and not self._refused:
            raise error_of_rejection(self.name, self._command, reply)

    def _is_busy(self, wait_s: float) -> bool:
        # Asked at once, then less and less often: a short move costs no pause, a long one no traffic.
        self._line.rest(min(self._pause_s, wait_s))
        self._pause_s = min(max(2.0 * self._pause_s, FIRST_PAUSE_S), LAST_PAUSE_S)
        if self._refused and not self._stopping.is_set():
            self._start()
            return True
        reply = self._line.ask("")
        if not self._stopping.is_set():
            self._check_state(reply)
        return reply.busy

    def _check_state(self, reply: Reply) -> None:
        if reply.faulty:
            raise error_of_flag(self.name, reply.flag)
        if not reply.busy and reply.flag in NO_REFERENCE:
            self._homed = False
            raise error_of_flag(self.name, reply.flag)

    def _off_target(self, what: str, at_deg: float, target_deg: float) -> MotionTimeout:
        if self._line.flag != INTERRUPTED:
            return super()._off_target(what, at_deg, target_deg)
        return MotionTimeout(
            f"{self.name}: the {what} was interrupted at {at_deg:.6g}° ({INTERRUPTED}), by its knob or another program"
        )

    def _send_stop(self) -> None:
        self._refused = False
        self._pause_s = 0.0
        self._line.send("stop")


def _number(what: str, value: int | str, highest: int) -> int:
    with contextlib.suppress(ValueError):
        if 1 <= int(value) <= highest:
            return int(value)
    raise RigError(f"'{value}' is not a Zaber {what}; use one of 1…{highest}")
