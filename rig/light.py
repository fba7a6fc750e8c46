"""What a light is."""

from typing import Protocol, runtime_checkable


@runtime_checkable
class Light(Protocol):
    """A light that can be switched. Every method may raise `RigError`."""

    def on(self) -> None:
        """Switch on; return when it is lit."""
        ...

    def off(self) -> None:
        """Switch off; return when it is dark."""
        ...

    def close(self) -> None:
        """Disconnect; closing twice is fine."""
        ...


def rest(light: Light) -> None:
    """Switch off a switchable light without an operator prompt, to make a rig safe.

    A light that a person must switch or cover says so by a true attribute ``asks``.

    Raises:
        RigError: it does not go off.
    """
    if not getattr(light, "asks", False):
        light.off()
