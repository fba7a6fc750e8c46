"""One function over many items in threads; products of matrices in one."""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from threading import Barrier, Lock, Thread
from typing import Any, Generic, TypeVar, cast

Item = TypeVar("Item")
Result = TypeVar("Result")


def for_each(
    function: Callable[[Item], Result], items: Iterable[Item], threads: int | None = None
) -> list[Result]:
    """``function`` of every item, in order, in threads: numpy and OpenCV let go of the interpreter while they work.

    Every thread takes one item after the other and waits for nothing; the caller is one of them, and the others serve
    from call to call, because OpenCV keeps half a kilobyte of every thread that ever ended. It may be called from
    several threads at once, and from within ``function``.

    Args:
        function: what is done; no item is begun after one has failed.
        items: the items, in the order of the results.
        threads: how many threads at most; as many as there are cores without it.

    Raises:
        BaseException: of the first item, in their order, that failed.
    """
    todo = list(items)
    workers = min(threads or os.cpu_count() or 1, len(todo))
    if workers <= 1:
        return [function(item) for item in todo]
    work = _Work(function, todo)
    helpers = _helpers.start(work.run, workers - 1)
    work.run()
    for helper in helpers:
        if not helper.cancel():  # one that has not begun is not waited for: there is nothing left to do
            helper.result()
    return work.results()


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
                before, self._pool = self._pool, _filled(threads)
                self._count = threads
                before.shutdown(wait=False)
            return [self._pool.submit(function) for _ in range(threads)]


def _filled(threads: int) -> ThreadPoolExecutor:
    """A pool all of whose threads run.

    Another thread starts them: Ctrl-C, which reaches the main one, in the middle of a start would leave a thread that
    the pool does not know, and for which the process would wait at its end.
    """
    pool, all_run = ThreadPoolExecutor(threads, "anisoscope"), Barrier(threads)

    def fill() -> None:
        try:
            for _ in range(threads):
                pool.submit(all_run.wait)
        except RuntimeError:  # the system has no more: those that run serve
            all_run.abort()

    starter = Thread(target=fill)
    starter.start()
    starter.join()
    return pool


_helpers = _Helpers()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_helpers.forget)


class _BlasThreads:
    """Number of callers that want one thread, and the limit meanwhile."""

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

    OpenBLAS splits large products among its threads, and the sum of their sums rounds otherwise than one sum: with
    another number of threads, as with another processor, results differ in their last digits (1e-15 of the largest
    term). Outside, a product has the threads of the process; no result may rest on such digits (`base.covariance`).
    """
    _blas_threads.enter()
    try:
        yield
    finally:
        _blas_threads.leave()
