"""Work shared among threads: kernels that release the interpreter's lock, one call for each share.

Compiled loops that share their own work wait for each other many times a millisecond, which costs them most of their
time on a machine that does something else as well. Here every thread takes one share after the other and waits for
nothing; the caller is one of them, and the others are kept from call to call.
"""

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Lock
from typing import Generic, TypeVar, cast

Item = TypeVar("Item")
Result = TypeVar("Result")


def count() -> int:
    """How many threads kernels may use: numba's number, which follows NUMBA_NUM_THREADS and the cores."""
    from numba import get_num_threads  # noqa: PLC0415 - loaded when first needed

    return int(get_num_threads())


def each(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """``function`` of every item, in order, shared among threads; the first exception is raised.

    It may be called from several threads at once, and from within ``function``.
    """
    todo = list(items)
    workers = min(count(), len(todo))
    if workers <= 1:
        return [function(item) for item in todo]
    work = _Work(function, todo)
    helpers = _helpers.start(work.run, workers - 1)
    work.run()
    for helper in helpers:
        if not helper.cancel():  # one that has not begun is not waited for: there is nothing left to do
            helper.result()
    return work.results()


def runs(length: int, most: int) -> Sequence[tuple[int, int]]:
    """``length`` numbers as at most ``most`` runs of about the same size, from and to."""
    parts = max(1, min(length, most))
    return [(n * length // parts, (n + 1) * length // parts) for n in range(parts)]


class _Work(Generic[Item, Result]):
    """Work items, distributed in order to threads."""

    def __init__(self, function: Callable[[Item], Result], todo: list[Item]) -> None:
        self._function, self._todo = function, todo
        self._numbers = iter(range(len(todo)))  # asking for the next one is atomic
        self._found: list[Result | None] = [None] * len(todo)
        self._failed: dict[int, BaseException] = {}

    def run(self) -> None:
        """Work until nothing is left, or an item has failed."""
        for number in self._numbers:
            if self._failed:
                return
            try:
                self._found[number] = self._function(self._todo[number])
            except BaseException as problem:  # noqa: BLE001 - raised again by the caller
                self._failed[number] = problem

    def results(self) -> list[Result]:
        """Results in order; raises the exception of the first item that failed."""
        if self._failed:
            raise self._failed[min(self._failed)]
        return cast("list[Result]", self._found)


class _Helpers:
    """Pool of reusable threads, as many as ever requested."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Have no threads: a forked process has none of its parent's."""
        self._lock, self._count, self._pool = Lock(), 0, ThreadPoolExecutor(1, "anisoscope")

    def start(self, function: Callable[[], None], threads: int) -> "list[Future[None]]":
        """Let so many threads begin a function."""
        with self._lock:
            if threads > self._count:
                self._pool.shutdown(wait=False)
                self._count, self._pool = threads, ThreadPoolExecutor(threads, "anisoscope")
            return [self._pool.submit(function) for _ in range(threads)]


_helpers = _Helpers()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_helpers.forget)
