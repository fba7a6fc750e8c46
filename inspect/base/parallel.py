"""One function over many items in threads; products of matrices in one."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from os import cpu_count
from threading import Lock
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def for_each(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """``function`` of every item, in order, in threads: numpy and OpenCV let go of the interpreter while they work.

    The first error of them is raised, whichever thread fails first.
    """
    todo = list(items)
    with ThreadPoolExecutor(max(1, min(cpu_count() or 1, len(todo)))) as pool:
        return list(pool.map(function, todo))


class _BlasThreads:
    """How many callers want one thread, and the limit that holds meanwhile."""

    def __init__(self) -> None:
        self._lock, self._callers = Lock(), 0
        self._limit: Any = None

    def enter(self) -> None:
        """One caller more; the first one sets the limit."""
        with self._lock:
            self._callers += 1
            if self._callers == 1:
                self._limit = _libraries().limit(limits=1, user_api="blas")

    def leave(self) -> None:
        """One caller fewer; the last one takes the limit away."""
        with self._lock:
            self._callers -= 1
            if self._callers == 0 and self._limit is not None:
                self._limit.restore_original_limits()


@cache
def _libraries() -> Any:  # noqa: ANN401 - threadpoolctl has no types
    """The loaded libraries that have threads of their own; looking for them takes milliseconds."""
    from threadpoolctl import ThreadpoolController  # noqa: PLC0415 - start-up time

    return ThreadpoolController()


_blas_threads = _BlasThreads()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Products of matrices inside take one thread: those of BLAS wait for each other by spinning.

    Many small products in a row cost twice the processor time with two threads, and on a machine that does something
    else as well several times the time on the clock. The limit holds for the process while any caller is inside.
    """
    _blas_threads.enter()
    try:
        yield
    finally:
        _blas_threads.leave()
