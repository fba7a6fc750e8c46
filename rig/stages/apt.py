"""Driver for Thorlabs APT stages: binary at 115200 baud with RTS/CTS.

Rotation stages are the K10CR1, and a KDC101 with a PRM1-Z8; linear ones (``unit = "mm"``) LTS150 and LTS300,
and a KDC101 with an MTS25, MTS50 or Z825B.

The controller reports its model, which determines the scale. It answers queries while it moves, reports the end of a
motion, and knows whether it was homed since power-up, so that a new connection may find the stage homed. One controller
is one port.

Scales of position and speed depend on model and actuator: microsteps of a stepper, encoder counts of a servo.
Velocities are counts per period of the controller's clock, times 65536. Source: Thorlabs APT communications protocol,
conversion tables.
"""

import logging
from dataclasses import dataclass
from typing import ClassVar

from anisoscope.base.errors import LimitExceeded, NotHomed, RigError, Stalled
from anisoscope.rig.stage import WRONG_UNIT, MotionRules, Unit
from anisoscope.rig.stages.apt_wire import (
    ACK_DC_STATUS,
    CHANNEL,
    DISABLE,
    ENABLE,
    GET_DC_STATUS,
    GET_HOMING,
    GET_STATUS,
    GET_VELOCITY,
    HOME,
    HOMED,
    HW_DISCONNECT,
    HW_GET_INFO,
    HW_REQ_INFO,
    HW_RESPONSE,
    HW_RICH_RESPONSE,
    HW_STOP_UPDATES,
    IDENTIFY,
    MOVE_ABSOLUTE,
    MOVE_COMPLETED,
    REQ_DC_STATUS,
    REQ_HOMING,
    REQ_STATUS,
    REQ_VELOCITY,
    SET_ENABLED,
    STOP,
    STOP_IMMEDIATE,
    STOP_PROFILED,
    STOPPED,
    DeviceInfo,
    Message,
    Status,
    address_of,
    error_text,
    homing_velocity_counts,
    position_data,
    take_message,
    velocity_counts,
)
from anisoscope.rig.stages.device_error import device_error
from anisoscope.rig.stages.motion import POLL_S
from anisoscope.rig.stages.no_answer import no_answer
from anisoscope.rig.stages.portstage import PortStage
from anisoscope.rig.transport import Transport

# One count per second in the units of velocity parameters.
STEPPER_VELOCITY = 53.68
SERVO_VELOCITY = 2048.0 / 6e6 * 65536.0
SERVOS = frozenset({"KDC101", "TDC001", "KBD101", "TBD001"})


@dataclass(frozen=True)
class Mechanics:
    """Mechanics of a controller: counts for one degree or 1 mm, and the travel in the same unit."""

    counts: float
    unit: Unit
    travel: float


# Stages that are one with their controller.
MODELS = {
    "K10CR1": Mechanics(409600.0 / 3.0, "deg", 360.0),
    "LTS150": Mechanics(409600.0, "mm", 150.0),
    "LTS300": Mechanics(409600.0, "mm", 300.0),
}
Z8_COUNTS_PER_MM = 34554.96
ACTUATORS = {
    **dict.fromkeys(
        ("PRM1-Z8", "PRM1/MZ8", "PRMTZ8", "PRMTZ8/M"), Mechanics(1919.6418578623391, "deg", 360.0)
    ),
    **dict.fromkeys(("MTS25-Z8", "MTS25/M-Z8", "Z825B", "Z925B"), Mechanics(Z8_COUNTS_PER_MM, "mm", 25.0)),
    **dict.fromkeys(("MTS50-Z8", "MTS50/M-Z8"), Mechanics(Z8_COUNTS_PER_MM, "mm", 50.0)),
}
EXAMPLE: dict[Unit, str] = {"deg": "PRM1-Z8", "mm": "MTS25-Z8"}


@dataclass(frozen=True)
class Scale:
    """Scale of a controller: counts and velocity units for one degree (per second) or 1 mm, and its travel.

    Attributes:
        counts_per_deg: counts for one degree, or 1 mm.
        velocity_per_deg_s: units of velocity for as much per second.
        servo: whether the controller drives a servo.
        travel: in the unit; None where only the scale is known.
    """

    counts_per_deg: float
    velocity_per_deg_s: float
    servo: bool
    travel: float | None = None


def scale_of(model: str, actuator: str | None, counts_per_deg: float | None, unit: Unit = "deg") -> Scale:
    """The scale of a controller.

    Args:
        model: what the controller calls itself.
        actuator: name of the motor that it drives, where it may drive several.
        counts_per_deg: scale from the rig file; it goes before everything else.
        unit: in which the stage has to move.

    Raises:
        RigError: neither model nor options tell the scale, or the stage moves otherwise.
    """
    servo = model in SERVOS
    known = MODELS.get(model) if actuator is None else _of_actuator(actuator)
    if known is not None and known.unit != unit:
        kind = "a linear" if known.unit == "mm" else "a rotation"
        raise RigError(f"{model if actuator is None else actuator} is {kind} stage; {WRONG_UNIT[unit]}")
    counts = counts_per_deg if known is None or counts_per_deg is not None else known.counts
    if counts is None:
        hint = f"actuator = '{EXAMPLE[unit]}', or " if servo else ""
        what = "degree" if unit == "deg" else "millimetre"
        raise RigError(
            f"a {model} does not tell how many counts make a {what}; set the option {hint}counts_per_{unit}"
        )
    if counts <= 0.0:
        raise RigError(f"counts_per_{unit} must be above 0, not {counts:g}")
    per_count = SERVO_VELOCITY if servo else STEPPER_VELOCITY
    return Scale(counts, per_count * counts, servo, None if known is None else known.travel)


def _of_actuator(actuator: str) -> Mechanics:
    if actuator not in ACTUATORS:
        raise RigError(
            f"actuator '{actuator}' is not known; known: {', '.join(ACTUATORS)}; or set the option counts_per_deg "
            "(counts_per_mm of a linear one)"
        )
    return ACTUATORS[actuator]


# By bit; the controller keeps them until its channel is switched off and on.
TROUBLES: dict[int, tuple[type[RigError], str]] = {
    14: (Stalled, "a motion error: the motor did not follow"),
    15: (RigError, "an instrument error"),
    16: (RigError, "an open interlock"),
    17: (Stalled, "that it is too hot"),
    18: (RigError, "a fault of the supply voltage"),
    24: (Stalled, "that the motor has reached its current limit"),
    25: (Stalled, "a fault of the encoder"),
    26: (Stalled, "over-current"),
}


def _in_trouble(status: Status) -> bool:
    return any(status.has(bit) for bit in TROUBLES)


def trouble_of(name: str, status: Status, at: str, *, moved: bool) -> RigError | None:
    """The error that explains it, or None.

    Args:
        name: how messages call the stage.
        status: its status, standing still short of its target.
        at: where it stands, as messages write it.
        moved: whether it has moved at all; a limit switch stops only a stage that did.
    """
    for bit, (kind, text) in TROUBLES.items():
        if status.has(bit):
            return device_error(kind, f"{name} reports {text} (status {status.bits:08X})")
    if not status.enabled:
        return device_error(RigError, f"{name} does not switch its motor on (status {status.bits:08X})")
    if status.at_limit_switch and moved:
        return device_error(LimitExceeded, f"{name} ended at its limit switch, at {at}")
    return None


_log = logging.getLogger(__name__)

TRIES = 3
# A servo controller that sends updates falls silent unless it hears once a second that the host lives.
ACKNOWLEDGE_S = 0.5
ENDS = frozenset({HOMED, MOVE_COMPLETED, STOPPED})


class AptLine:
    """One controller at a port.

    Args:
        transport: the open port.
        address: destination of the messages.
        timeout_s: time in seconds for the answer to a question.

    Attributes:
        name: how error messages call the device.
        servo: whether the controller speaks of its status in the messages of servos, not of steppers.
        ended: id of the last message that said that a motion ended, since `forget` was called.
    """

    def __init__(self, transport: Transport, address: int, timeout_s: float) -> None:
        self.transport = transport
        self._clock = transport.clock
        self.address = address
        self.name = f"the controller at {transport.port}"
        self.servo = False
        self.ended: int | None = None
        self._timeout_s = timeout_s
        self._received = bytearray()
        self._heard = False
        self._stranger: int | None = None
        self._acknowledged = -1e9

    def send(self, *messages: Message) -> None:
        """Send messages in one go, and wait for nothing."""
        self.transport.write(b"".join(message.to_bytes(self.address) for message in messages))

    def forget(self) -> None:
        """Drop everything that has arrived so far."""
        self.transport.discard()
        self._received.clear()
        self.ended = None

    def query(self, question: Message, expected: int, *, fresh: bool = True) -> Message:
        """Send a repeatable query and return the newest answer.

        Args:
            question: the question.
            expected: id of its answer.
            fresh: forget first what has arrived.

        Raises:
            NotConnected: silence, or another address answers.
            ProtocolError: only bytes that are no APT message.
            RigError: the controller complains.
        """
        if fresh:
            self.forget()
        for _ in range(TRIES):
            self.send(question)
            self._heard, self._stranger = False, None
            deadline = self._clock() + self._timeout_s
            while (message := self._next(deadline)) is not None:
                if message.id == expected:
                    return self._newest(message)
            if not self._heard:
                break
        raise self._silence()

    def status(self, *, fresh: bool = True) -> Status:
        """Query position and status of the motor."""
        question, answer = (REQ_DC_STATUS, GET_DC_STATUS) if self.servo else (REQ_STATUS, GET_STATUS)
        return Status.parse(self.query(Message(question, (1, 0)), answer, fresh=fresh).data)

    def wait_for_end(self, wait_s: float) -> None:
        """Wait up to `wait_s` seconds for the news that a motion ended."""
        deadline = self._clock() + wait_s
        while (message := self._next(deadline)) is not None:
            if message.id in ENDS:
                return

    def _newest(self, answer: Message) -> Message:
        """The last of the answers that came already: unasked-for ones must not make us lag behind."""
        self._received += self.transport.discard()
        while (message := self._take()) is not None:
            if message.id == answer.id:
                answer = message
        return answer

    def _next(self, deadline: float) -> Message | None:
        while (message := self._take()) is None:
            left_s = deadline - self._clock()
            first = self.transport.read_exactly(1, left_s) if left_s > 0.0 else None
            if first is None:
                return None
            self._heard = True
            self._received += first + self.transport.discard()
        return message

    def _take(self) -> Message | None:
        """The next message of this controller that has arrived."""
        while True:
            message, dropped = take_message(self._received)
            if dropped:
                _log.debug("%s: %d bytes are no message", self.name, dropped)
            if message is None:
                return None
            if message.source == self.address:
                break
            self._stranger = message.source
        if message.id in {HW_RESPONSE, HW_RICH_RESPONSE}:
            raise device_error(RigError, f"{self.name} reports {error_text(message)}")
        if message.id in ENDS:
            self.ended = message.id
        if message.id == GET_DC_STATUS:
            self._acknowledge()
        return message

    def _acknowledge(self) -> None:
        now = self._clock()
        if now - self._acknowledged > ACKNOWLEDGE_S:
            self._acknowledged = now
            self.send(Message(ACK_DC_STATUS))

    def _silence(self) -> RigError:
        stranger = None if self._stranger is None else f"{self._stranger:02X}"
        return no_answer(
            self.name,
            self.transport,
            self._timeout_s,
            "APT",
            heard=self._heard,
            stranger=stranger,
            check="the power, the cable and the port",
        )


STOPS = {"profiled": STOP_PROFILED, "immediate": STOP_IMMEDIATE}
FIRST_PAUSE_S = 0.002
# A controller may take so long to report that its reference search has begun.
HOMING_BEGINS_S = 0.5
# A channel may take so long to have current, and to report it; a command that comes earlier is ignored.
ENABLING_S = 0.5
# A stepper without an encoder counts steps that it loses: that it is held shows only when it has counted more than its
# whole travel. A jump of the count between two answers is no way: it is set at the switch.
SEARCHED_TRAVELS, JUMP_TRAVELS = 1.1, 0.1
TOLERANCE: dict[Unit, float] = {"deg": 0.02, "mm": 0.002}


class Apt(PortStage):
    """A stage behind an APT controller with one channel.

    Args:
        transport: the open port. Only `open` makes a stage that closes it.
        unit: ``deg`` for a rotation stage, ``mm`` for a linear one; all that follows counts in it.
        address: destination of the messages, in hex: ``50`` is a unit on USB, ``21`` … ``2A`` are bays of a rack.
        actuator: the motor that a controller for several kinds drives, such as ``PRM1-Z8``.
        counts_per_deg: scale, for what this driver does not know; goes before model and actuator.
        timeout_s: time in seconds for the answer to a question.
        tolerance_deg: a stage this near to the target has arrived; by default 0.02° or 0.002 mm.
        velocity_deg_s: speed to compute time limits from; by default the slower of those that the controller is set
            to for moves and for the reference search.
        margin_s: seconds added to every computed time limit.
        min_deg, max_deg: limits; by default 0 and 360°, or the travel of a linear stage where it is known.
        stop: ``profiled`` slows down on the ramp of a move; ``immediate`` does not, and a stepper may lose steps.

    Raises:
        NotConnected: no answer.
        ProtocolError: the device that answers is no APT controller.
        RigError: an option is wrong, or the scale of the stage is not known.
    """

    PORT: ClassVar = {"baudrate": 115200, "rtscts": True}

    def __init__(
        self,
        transport: Transport,
        *,
        unit: Unit = "deg",
        address: str = "50",
        actuator: str | None = None,
        counts_per_deg: float | None = None,
        timeout_s: float = 1.0,
        tolerance_deg: float | None = None,
        velocity_deg_s: float | None = None,
        margin_s: float = 2.0,
        min_deg: float = 0.0,
        max_deg: float | None = None,
        stop: str = "profiled",
    ) -> None:
        if stop not in STOPS:
            raise RigError(f"stop = '{stop}' is not known; use one of: {', '.join(STOPS)}")
        self.unit = unit
        tolerance = TOLERANCE[unit] if tolerance_deg is None else tolerance_deg
        self._transport = transport
        self._line = AptLine(transport, address_of(address), timeout_s)
        self._stop_mode = STOPS[stop]
        self._target_counts: int | None = None
        self._searched_counts = 0
        self._begun = 0.0
        self._seen_moving = self._seen_homing = False
        self._pause_s = FIRST_PAUSE_S
        super().__init__(self._line.name, MotionRules(tolerance, 10.0), (min_deg, min_deg), 0.0)
        self._bus = transport.lock
        with self._bus:
            self.info = self._identify()
            self.scale = scale_of(self.info.model, actuator, counts_per_deg, unit)
            self._line.servo = self.scale.servo
            self._name = self._line.name = f"{self.info.model} {self.info.serial}"
            self._limits_deg = (min_deg, self._travel() if max_deg is None else max_deg)
            self._resolution_deg = 1.0 / self.scale.counts_per_deg
            velocity = velocity_deg_s or self._slowest_deg_s()
            self.rules = MotionRules(
                max(tolerance, 2.0 * self._resolution_deg), velocity, velocity, margin_s=margin_s
            )
            self._last = self._line.status()
            self._homed = self._last.homed

    @classmethod
    def stop_command(cls, *, address: str = "50", stop: str = "profiled", **_options: object) -> bytes:
        """Stop of the controller at an address; see `PortStage`."""
        return Message(STOP, (CHANNEL, STOPS.get(stop, STOP_PROFILED))).to_bytes(address_of(address))

    def status(self) -> Status:
        """Read position and status bits; the way to watch a stage that moves."""
        with self._bus:
            return self._line.status()

    def velocity_deg_s(self) -> float:
        """Read the top velocity of moves, in degrees per second."""
        with self._bus:
            return self._velocities_deg_s()[0]

    def identify(self) -> None:
        """Make the controller flash its lights."""
        self._line.send(Message(IDENTIFY, (CHANNEL, 0)))

    def _identify(self) -> DeviceInfo:
        # Updates requested by an earlier host would only interfere.
        self._line.send(Message(HW_STOP_UPDATES))
        return DeviceInfo.parse(self._line.query(Message(HW_REQ_INFO), HW_GET_INFO).data)

    def _velocities_deg_s(self) -> tuple[float, float]:
        """Top velocities of moves and of the reference search."""
        channel = (CHANNEL, 0)
        moves, _ = velocity_counts(self._line.query(Message(REQ_VELOCITY, channel), GET_VELOCITY).data)
        homing = homing_velocity_counts(self._line.query(Message(REQ_HOMING, channel), GET_HOMING).data)
        return moves / self.scale.velocity_per_deg_s, homing / self.scale.velocity_per_deg_s

    def _slowest_deg_s(self) -> float:
        slowest = min(self._velocities_deg_s())
        if slowest <= 0.0:
            raise RigError(f"{self.name} is set to a velocity of {self._shown(slowest)}/s; set one above 0")
        return slowest

    def _travel(self) -> float:
        if self.scale.travel is not None:
            return self.scale.travel
        if self.unit == "deg":
            return 360.0
        raise RigError(f"{self.name} does not tell its travel; set the option max_mm")

    # The motion.

    def _read_deg(self) -> float:
        self._last = self._line.status()
        return self._last.counts / self.scale.counts_per_deg

    def _read_moving_deg(self) -> float | None:
        return self._last.counts / self.scale.counts_per_deg

    def _check_reference(self, now_deg: float) -> None:
        if not self._last.homed:
            raise self._lost_reference()
        super()._check_reference(now_deg)

    def _lost_reference(self) -> NotHomed:
        self._homed = False
        return NotHomed(f"{self.name} has lost its reference: it was switched off; home it again")

    def _begin_home(self) -> None:
        self._target_counts = None
        self._searched_counts = 0
        self._begin(Message(HOME, (CHANNEL, 0)))

    def _begin_move(self, target_deg: float) -> None:
        self._target_counts = round(target_deg * self.scale.counts_per_deg)
        self._begin(Message(MOVE_ABSOLUTE, data=position_data(self._target_counts)))

    def _begin(self, command: Message) -> None:
        self._enable()
        self._line.ended = None
        self._begun = self._clock()
        self._seen_moving = self._seen_homing = False
        self._pause_s = FIRST_PAUSE_S
        self._line.send(command)

    def _enable(self) -> None:
        """Switch the channel on, and wait until its status reports it without an earlier error.

        All messages come in their order: none that arrives after that one is older than the switching. A controller
        that never reports it gets its command all the same; whether the motor follows shows afterwards.
        """
        before = self._last = self._line.status()
        if before.enabled and not _in_trouble(before):
            return
        switched = [Message(SET_ENABLED, (CHANNEL, ENABLE))]
        if _in_trouble(before):
            # A controller keeps an error until its channel is switched off and on.
            _log.warning("%s: status %08X before a motion", self.name, before.bits)
            switched.insert(0, Message(SET_ENABLED, (CHANNEL, DISABLE)))
        self._line.send(*switched)
        deadline = self._clock() + ENABLING_S
        while not (status := self._line.status()).enabled or _in_trouble(status):
            if self._clock() >= deadline:
                return
            self._clock.sleep(FIRST_PAUSE_S)

    def _is_busy(self, wait_s: float) -> bool:
        before, status = self._last, self._line.status(fresh=False)
        self._last = status
        self._seen_moving = self._seen_moving or status.moving
        self._seen_homing = self._seen_homing or status.homing
        if not status.moving and self._is_over(status):
            return False
        if self._target_counts is None:
            self._check_search(abs(status.counts - before.counts))
        # Short moves end soon; long ones need few queries, because their end is announced.
        self._line.wait_for_end(min(wait_s, self._pause_s))
        self._pause_s = min(2.0 * self._pause_s, POLL_S)
        return True

    def _is_over(self, status: Status) -> bool:
        """Whether a motor at rest has completed its motion, or cannot."""
        if self._target_counts is None:
            if self._line.ended == HOMED or (status.homed and self._has_homed()):
                return True
            self._raise_trouble(status)
            return False
        if not status.homed:
            raise self._lost_reference()
        away_deg = abs(status.counts - self._target_counts) / self.scale.counts_per_deg
        if away_deg > self.rules.tolerance_deg:
            self._raise_trouble(status)
        return True

    def _check_search(self, step_counts: int) -> None:
        """A search that has counted more than the whole travel will not find its switch any more."""
        low, high = self._limits_deg
        span = 360.0 if self.unit == "deg" else max(high - low, self.scale.travel or 0.0)
        travel_counts = span * self.scale.counts_per_deg
        if step_counts < JUMP_TRAVELS * travel_counts:
            self._searched_counts += step_counts
        if self._searched_counts > SEARCHED_TRAVELS * travel_counts:
            way = self._shown(self._searched_counts / self.scale.counts_per_deg, 3)
            raise Stalled(
                f"{self.name}: the home has counted {way} and met no switch: something holds the stage, and the motor "
                "loses steps; remove it, and home again"
            )

    def _has_homed(self) -> bool:
        """Whether the homed bit can be that of this reference search, and not of one before."""
        return self._seen_homing or self._clock() - self._begun > HOMING_BEGINS_S

    def _raise_trouble(self, status: Status) -> None:
        # The search begins and ends at a switch; touched during anything else, it is in the way.
        moved = self._line.ended is not None or (self._seen_moving and self._target_counts is not None)
        if self._trouble_of(status, moved=moved) is None:
            return
        # A message that came unasked may be older than the command: only an answer to a question is believed.
        if (trouble := self._trouble_of(self._line.status(), moved=moved)) is not None:
            raise trouble

    def _trouble_of(self, status: Status, *, moved: bool) -> RigError | None:
        at = self._shown(status.counts / self.scale.counts_per_deg)
        return trouble_of(self.name, status, at, moved=moved)

    def _send_stop(self) -> None:
        self._line.send(Message(STOP, (CHANNEL, self._stop_mode)))

    def _wait_until_still(self) -> None:
        deadline = self._clock() + self.rules.margin_s
        while self._line.status().moving and self._clock() < deadline:
            self._line.wait_for_end(POLL_S)

    def _end_session(self) -> None:
        self._line.send(Message(HW_DISCONNECT))
