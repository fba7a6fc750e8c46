"""A light that cannot be switched: dark frames need a lens cover."""

import sys
from collections.abc import Callable

from anisoscope.base.errors import RigError
from anisoscope.rig.stages.manual import prompt_in_terminal


class AlwaysOn:
    """A light without a switch; the operator covers the lens for dark frames.

    Dark frames that see the light would be subtracted from the picture as if they were the sensor's own signal:
    `off` returns in the dark, or raises.

    Args:
        prompt: shows a request to the operator and returns when it was met; by default in the terminal.
    """

    asks = True

    def __init__(self, prompt: Callable[[str], None] | None = None) -> None:
        self._prompt = prompt
        self._covered = False

    def on(self) -> None:
        """Prompt to remove the cover if it is on.

        Raises:
            RigError: no operator.
        """
        if self._covered:
            self._request("take the cover off the lens")
            self._covered = False

    def off(self) -> None:
        """Prompt to cover the lens unless it is covered.

        Raises:
            RigError: no operator, so that it does not get dark.
        """
        if not self._covered:
            self._request("the light of this rig cannot be switched off: cover the lens")
            self._covered = True

    def close(self) -> None:
        """Nothing to disconnect; whether the cover stays is not known from here on."""
        self._covered = False

    def _request(self, request: str) -> None:
        if self._prompt is not None:
            self._prompt(request)
            return
        if sys.stdin is None or not sys.stdin.isatty():
            raise RigError(
                "the light of this rig (driver 'none') cannot be switched off, and there is no terminal to ask for a "
                "lens cap in: run this in a terminal, take no dark frames, or use a light that can be switched"
            )
        prompt_in_terminal(request)
