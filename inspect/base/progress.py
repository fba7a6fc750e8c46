"""Progress callbacks of long jobs."""

from typing import Protocol


class Advance(Protocol):
    """Called along the way of a long job."""

    def __call__(self, doing: str, done: int, total: int) -> None:
        """Report the present activity and the number of completed steps out of the total."""


def silent(doing: str, done: int, total: int) -> None:
    """An `Advance` without output."""
    del doing, done, total
