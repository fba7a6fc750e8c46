"""How a long job says how far it is."""

from typing import Protocol


class Advance(Protocol):
    """Called along the way of a long job."""

    def __call__(self, doing: str, done: int, total: int) -> None:
        """Say what is done now, and how many of how many steps are behind."""


def silent(doing: str, done: int, total: int) -> None:
    """An `Advance` that says nothing."""
    del doing, done, total
