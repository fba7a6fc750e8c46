"""The light that an operator switches by hand."""

from collections.abc import Callable

from anisoscope.base.errors import RigError
from anisoscope.rig.stages.manual import prompt_in_terminal


class ManualLight:
    """A light switched by the operator on request, without feedback.

    Args:
        prompt: shows a request to the operator and returns when it was met; in the terminal it raises `RigError` where
            no operator can answer, because a dark frame in the light would be subtracted as if it were dark.
    """

    asks = True

    def __init__(self, prompt: Callable[[str], None]) -> None:
        self._show = prompt
        self._lit: bool | None = None

    def on(self) -> None:
        """Prompt for light unless it is on."""
        if self._lit is not True:
            self._prompt("Switch the light on")
            self._lit = True

    def off(self) -> None:
        """Prompt for darkness unless it is off."""
        if self._lit is not False:
            self._prompt("Switch the light off")
            self._lit = False

    def _prompt(self, request: str) -> None:
        try:
            self._show(request)
        except RigError as problem:
            raise RigError(
                f"{problem}; run this in a terminal, or leave the light as it is (rig snap, live and focus: "
                "--light as-is)"
            ) from problem

    def close(self) -> None:
        """Nothing to disconnect."""
        self._lit = False


def open_manual(*, prompt: Callable[[str], None] = prompt_in_terminal) -> ManualLight:
    """Open the light that the operator switches; the driver named ``manual`` in a rig file."""
    return ManualLight(prompt)
