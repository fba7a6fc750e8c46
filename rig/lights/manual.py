"""The light that an operator switches by hand."""

from collections.abc import Callable

from anisoscope.rig.stages.manual import ask_in_terminal


class ManualLight:
    """A light without a wire: asks the operator, and trusts the answer.

    Args:
        ask: shows a request to the operator and returns when it was met; in the terminal it raises `RigError` where
            nobody can answer, because a dark frame in the light would be subtracted as if it were dark.
    """

    asks = True

    def __init__(self, ask: Callable[[str], None]) -> None:
        self._ask = ask
        self._lit: bool | None = None

    def on(self) -> None:
        """Ask for light, unless it is on already."""
        if self._lit is not True:
            self._ask("Switch the light on")
            self._lit = True

    def off(self) -> None:
        """Ask for darkness, unless it is dark already."""
        if self._lit is not False:
            self._ask("Switch the light off")
            self._lit = False

    def close(self) -> None:
        """Nothing to disconnect."""
        self._lit = False


def open_manual(*, ask: Callable[[str], None] = ask_in_terminal) -> ManualLight:
    """Open the light that the operator switches; the driver named ``manual`` in a rig file."""
    return ManualLight(ask)
