"""What a light is."""

from typing import Protocol, runtime_checkable


@runtime_checkable
class Light(Protocol):
    """A light that can be switched. Every method may raise `RigError`."""

    def on(self) -> None:
        """Switch on; return when the light is there."""
        ...

    def off(self) -> None:
        """Switch off; return when it is dark."""
        ...

    def close(self) -> None:
        """Disconnect; closing twice is fine."""
        ...


def rest(light: Light) -> None:
    """Switch a light off that can be, without asking anybody: nobody waits for Enter where a rig is made safe.

    A light that a person must switch or cover says so by a true attribute ``asks``.

    Raises:
        RigError: it does not go off.
    """
    if not getattr(light, "asks", False):
        light.off()
