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
