"""Work shared among threads: kernels that release the interpreter's lock, one call for each share.

Compiled loops that share their own work wait for each other many times a millisecond, which costs them most of their
time on a machine that does something else as well. Here every thread takes one share after the other and waits for
nothing.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from anisoscope.base.parallel import for_each

Item = TypeVar("Item")
Result = TypeVar("Result")


def count() -> int:
    """Number of threads of kernels: numba's, which follows NUMBA_NUM_THREADS and the cores."""
    from numba import get_num_threads  # noqa: PLC0415 - loaded when first needed

    return int(get_num_threads())


def each(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """``function`` of every item, in order, shared among as many threads as kernels may use."""
    return for_each(function, items, count())


def runs(length: int, most: int) -> Sequence[tuple[int, int]]:
    """``length`` numbers as at most ``most`` runs of about the same size, from and to."""
    parts = max(1, min(length, most))
    return [(n * length // parts, (n + 1) * length // parts) for n in range(parts)]
