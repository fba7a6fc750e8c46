"""Driver for Thorlabs Elliptec rotation stages (ELL14, ELL18, ELL8, …): ASCII at 9600 baud, several on a bus.

Scale, travel and serial number are read from the device. A move is answered once, when it is over; meanwhile
the device is silent, or says that it is busy. The device does not say whether it was homed: the driver keeps
that, and forgets it when the connection ends. Source: Thorlabs ELLx protocol manual.
"""

import time
from typing import ClassVar

from anisoscope.base.errors import RigError
from anisoscope.rig.stage import MotionRules
from anisoscope.rig.stages.elliptec_line import BUSY_POLL_S, ElliptecLine
from anisoscope.rig.stages.elliptec_wire import (
    ADDRESSES,
    BUSY,
    OK,
    Answer,
    DeviceInfo,
    counts_to_hex,
    error_of_status,
)
from anisoscope.rig.stages.portstage import PortStage
from anisoscope.rig.transport import Transport

# Full speed is 430°/s for an ELL14; time limits count on less, because load and resonance slow it down.
SURE_VELOCITY_DEG_S = 100.0
QUIET_S = 0.15
FIRST_POLL_S = 0.002


class Elliptec(PortStage):
    """A rotation stage at one address of a port.

    Args:
        transport: the open port; several stages may share it.
        address: bus address, ``0`` … ``F``.
        timeout_s: time in seconds for the answer to a question.
        move_gap_s: pause in seconds between two moves; devices that get none may run to zero instead.
        tolerance_deg: a stage this near to the target has arrived.
        velocity_deg_s: speed to compute time limits from; by default 100°/s times the velocity setting.
        margin_s: seconds added to every computed time limit.
        min_deg, max_deg: limits in degrees; by default 0 and the travel that the device reports.

    Raises:
        NotConnected: nobody answers at this address.
        ProtocolError: somebody answers, but it is no Elliptec rotation stage.
    """

    PORT: ClassVar = {"baudrate": 9600}

    def __init__(
        self,
        transport: Transport,
        *,
        address: str = "0",
        timeout_s: float = 1.0,
        move_gap_s: float = 0.1,
        tolerance_deg: float = 0.05,
        velocity_deg_s: float | None = None,
        margin_s: float = 2.0,
        min_deg: float = 0.0,
        max_deg: float | None = None,
    ) -> None:
        if len(address) != 1 or address not in ADDRESSES:
            raise RigError(f"'{address}' is not an Elliptec address; use one of 0…9, A…F")
        self.address = address
        self._transport = transport
        self._line = ElliptecLine(transport, address, timeout_s)
        self._move_gap_s = move_gap_s
        self._last_motion_end = -1e9
        self._polling = False
        self._poll_s = FIRST_POLL_S
        self._refused = False
        self._command = ""
        self._target_counts = 0
        super().__init__(
            self._line.name, MotionRules(tolerance_deg, SURE_VELOCITY_DEG_S), (min_deg, 360.0), 0.0
        )
        self._bus = transport.lock
        with self._bus:
            self.info = self._identify()
        self._name = self._line.name = f"ELL{self.info.model} {self.info.serial}"
        self._resolution_deg = 1.0 / self.info.counts_per_deg
        self._limits_deg = (min_deg, float(self.info.travel_deg) if max_deg is None else max_deg)
        velocity = velocity_deg_s or SURE_VELOCITY_DEG_S * max(self.velocity_percent(), 5) / 100.0
        # A piezo motor is at full speed in well under a tenth of a second.
        self.rules = MotionRules(
            max(tolerance_deg, self._resolution_deg), velocity, velocity / 0.1, margin_s=margin_s
        )
        self._line.busy_limit_s = self.rules.timeout_s(float(self.info.travel_deg))

    def status(self) -> int:
        """Read and thereby clear the status code; 0 is ok, 9 is busy."""
        with self._bus:
            return int(self._line.ask("gs", "GS").data, 16)

    def velocity_percent(self) -> int:
        """Read the velocity setting in percent of full speed."""
        with self._bus:
            return int(self._line.ask("gv", "GV").data, 16)

    def set_velocity_percent(self, percent: int) -> None:
        """Set the velocity in percent of full speed; the device keeps it until it is switched off.

        Raises:
            RigError: a number outside 1…100, or the device refuses it.
        """
        if not 1 <= percent <= 100:
            raise RigError(f"{self.name}: a velocity of {percent} % is outside 1…100 %")
        self._line.set(f"sv{percent:02X}", "setting the velocity")

    def home_offset_deg(self) -> float:
        """Read the angle in degrees between the reference mark and zero."""
        with self._bus:
            return self._line.ask("go", "HO").counts / self.info.counts_per_deg

    def set_home_offset(self, offset_deg: float) -> None:
        """Set the angle in degrees between the reference mark and zero; takes effect when homed next."""
        self._line.set(
            f"so{counts_to_hex(round(offset_deg * self.info.counts_per_deg))}", "setting the home offset"
        )
        self._homed = False

    def _identify(self) -> DeviceInfo:
        info = DeviceInfo.parse(self._line.ask("in", "IN").data)
        # A fault of the past is latched until it is read; one that comes back is of now.
        if self.status() not in {OK, BUSY} and (status := self.status()) not in {OK, BUSY}:
            raise error_of_status(self.name, status, "connecting")
        return info

    # The motion.

    def _read_deg(self) -> float:
        return self._line.ask("gp", "PO").counts / self.info.counts_per_deg

    def _begin_home(self) -> None:
        self._target_counts = 0
        self._begin("ho0")

    def _begin_move(self, target_deg: float) -> None:
        self._target_counts = round(target_deg * self.info.counts_per_deg)
        self._begin(f"ma{counts_to_hex(self._target_counts)}")

    def _begin(self, command: str) -> None:
        pause_s = self._last_motion_end + self._move_gap_s - time.monotonic()
        if pause_s > 0.0:
            time.sleep(pause_s)
        self._transport.discard()
        self._command = command
        self._polling = self._refused = False
        self._poll_s = FIRST_POLL_S
        self._line.send(command)

    def _is_busy(self, wait_s: float) -> bool:
        if self._polling:
            time.sleep(self._poll_s)
            self._poll_s = min(2.0 * self._poll_s, BUSY_POLL_S)
            self._line.send("gs")
        answer = self._line.next_answer(wait_s)
        if answer is None:
            return True
        if answer.status == BUSY:
            # A command that meets a busy device is not carried out.
            self._refused = self._refused or not self._polling
            self._polling = True
            return True
        if answer.status:
            self._last_motion_end = time.monotonic()
            raise error_of_status(self.name, answer.status, "moving")
        if answer.status is None and not self._near(answer):
            # Somebody's unasked-for position, or the end of the motion at a wrong place: the status tells.
            self._polling = True
            return True
        self._last_motion_end = time.monotonic()
        self._polling = True  # from here on the device has to be asked
        if self._refused and not self._stopping.is_set() and not self._near(self._line.ask("gp", "PO")):
            self._begin(self._command)
            return True
        return False

    def _near(self, answer: Answer) -> bool:
        if answer.code != "PO":
            return False
        away_deg = abs(answer.counts - self._target_counts) / self.info.counts_per_deg
        return away_deg <= self.rules.tolerance_deg

    def _is_surely_busy(self) -> bool:
        status = self.status()
        if status not in {OK, BUSY}:
            raise error_of_status(self.name, status, "moving")
        return status == BUSY

    def _send_stop(self) -> None:
        self._line.send("st")

    def _wait_until_still(self) -> None:
        # A stop is answered once; what else may come is discarded before the next question.
        self._line.next_answer(QUIET_S)
        self._last_motion_end = time.monotonic()
