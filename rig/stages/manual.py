"""An axis set by hand: prompts the operator and waits for the Enter key."""

import math
import sys
from collections.abc import Callable

from anisoscope.base.errors import LimitExceeded, NotConnected, RigError
from anisoscope.base.language import translated
from anisoscope.rig.stage import SYMBOLS, Unit

Prompt = Callable[[str], None]


def prompt_in_terminal(request: str) -> None:
    """Show a request on stderr and wait for the Enter key.

    Raises:
        RigError: standard input ended before the Enter key came.
    """
    sys.stderr.write(translated(f"{request} and press Enter:") + " ")
    sys.stderr.flush()
    if not sys.stdin.readline():
        raise RigError(f"nobody answered the request '{request}': standard input has ended")


def _need_a_terminal(label: str) -> None:
    if sys.stdin is None or not sys.stdin.isatty():
        raise NotConnected(
            f"the {label} is set by hand, and there is no terminal to ask in: run this in a terminal, or name "
            "a driven axis in the rig file"
        )


class ManualStage:
    """An axis without a motor; its angle is the last one requested from the operator.

    Args:
        port: not used; an axis by hand has none.
        unit: ``deg``, or ``mm`` of a linear axis; all that follows counts in it.
        label: what is set, as the operator is asked for it.
        min_deg, max_deg: limits in degrees.
        resolution_deg: how finely its scale can be set.
        prompt: shows a request to the operator and returns when it was met; by default in the terminal.

    Raises:
        NotConnected: there is no terminal to ask in.
    """

    def __init__(
        self,
        port: str | None = None,
        *,
        unit: Unit = "deg",
        label: str = "stage",
        min_deg: float = -360.0,
        max_deg: float = 360.0,
        resolution_deg: float = 0.1,
        prompt: Prompt | None = None,
    ) -> None:
        del port
        if prompt is None:
            _need_a_terminal(label)
        self.unit = unit
        self._sign = SYMBOLS[unit]
        self.name = f"{label} set by hand"
        self.limits_deg = (float(min_deg), float(max_deg))
        self.resolution_deg = float(resolution_deg)
        self.is_homed = False
        self._label = label
        self._prompt = prompt or prompt_in_terminal
        self._at_deg: float | None = None

    def position_deg(self) -> float:
        """The angle in degrees that the operator set last.

        Raises:
            RigError: nothing was set yet.
        """
        if self._at_deg is None:
            raise RigError(f"nobody has set the {self._label} yet; ask for an angle first")
        return self._at_deg

    def home(self) -> float:
        """Prompt for zero, or for the limit nearest to it; returns it in degrees."""
        low, high = self.limits_deg
        return self._set(min(max(0.0, low), high))

    def move_to(self, angle_deg: float) -> float:
        """Prompt for an angle in degrees unless it is set already; returns it.

        Raises:
            LimitExceeded: outside of the limits.
            RigError: the operator does not answer.
        """
        low, high = self.limits_deg
        if not (math.isfinite(angle_deg) and low <= angle_deg <= high):
            sign = self._sign
            raise LimitExceeded(f"{self.name}: {angle_deg:g}{sign} is outside {low:g}{sign}…{high:g}{sign}")
        return self._set(float(angle_deg))

    def move_by(self, delta_deg: float) -> float:
        """Prompt for a turn by an angle in degrees; returns the new angle. Errors as for `move_to`."""
        return self.move_to(self.position_deg() + delta_deg)

    def stop(self) -> None:
        """Nothing moves by itself."""

    def close(self) -> None:
        """Forget the angle: the operator may turn the stage from here on."""
        self._at_deg, self.is_homed = None, False

    def _set(self, angle_deg: float) -> float:
        if self._at_deg != angle_deg:
            self._at_deg = None
            place = f"{angle_deg:g}{self._sign}"
            self._prompt(f"set the {self._label} to {place}")
            self._at_deg, self.is_homed = angle_deg, True
        return angle_deg
