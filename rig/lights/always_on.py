"""A light that always burns: nobody can switch it, so darkness is a cover before the lens."""

import sys
from collections.abc import Callable

from anisoscope.base.errors import RigError
from anisoscope.rig.stages.manual import ask_in_terminal


class AlwaysOn:
    """A light without a switch; darkness is asked for as a cover before the lens.

    Dark frames that see the light would be subtracted from the picture as if they were the sensor's own signal:
    `off` returns in the dark, or raises.

    Args:
        ask: shows a request to the operator and returns when it was met; by default in the terminal.
    """

    asks = True

    def __init__(self, ask: Callable[[str], None] | None = None) -> None:
        self._ask = ask
        self._covered = False

    def on(self) -> None:
        """Ask for the cover to be taken away, if it is there.

        Raises:
            RigError: nobody is there to do it.
        """
        if self._covered:
            self._request("take the cover off the lens")
            self._covered = False

    def off(self) -> None:
        """Ask for the lens to be covered, unless it is.

        Raises:
            RigError: nobody is there to do it, so that it does not get dark.
        """
        if not self._covered:
            self._request("the light of this rig cannot be switched off: cover the lens")
            self._covered = True

    def close(self) -> None:
        """Nothing to disconnect; whether the cover stays is not known from here on."""
        self._covered = False

    def _request(self, request: str) -> None:
        if self._ask is not None:
            self._ask(request)
            return
        if sys.stdin is None or not sys.stdin.isatty():
            raise RigError(
                "the light of this rig (driver 'none') cannot be switched off, and there is no terminal to ask for a "
                "lens cap in: run this in a terminal, take no dark frames, or use a light that can be switched"
            )
        ask_in_terminal(request)
