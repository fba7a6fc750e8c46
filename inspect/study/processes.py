"""Processes of this machine that compute parts of a sweep, and that end with it when it is broken off.

The standard library's pool hands out the work. What it leaves open is settled here: functions and results that are
not found by name travel too, Ctrl-C is left to this process, a sweep that is broken off kills what still computes,
and processes whose parent is gone end by themselves.
"""

import atexit
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, TypeVar

import cloudpickle

__all__ = ["BrokenProcessPool", "Processes", "lent"]

Task = TypeVar("Task")
Result = TypeVar("Result")

_AHEAD = 2  # parts handed out for each process: one in work, one at hand
_kept: dict[int, "Processes"] = {}  # idle, by their count


class Processes:
    """A pool of processes.

    Args:
        count: how many; each starts when there is work for it.
    """

    def __init__(self, count: int) -> None:
        self._owner = os.getpid()
        self._count = count
        context = _Recording()
        self._started = context.started
        # the reading end is told when this process closes the writing end, or dies
        reader, self._alive = context.Pipe(duplex=False)
        self._pool = ProcessPoolExecutor(count, context, _begin, (reader,))

    @property
    def usable(self) -> bool:
        """Whether it is this process's own, and none of it was killed."""
        return self._owner == os.getpid() and all(process.is_alive() for process in self._started)

    def map(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Generator[Result, None, None]:
        """Results in the order of the tasks, as soon as each and all before it are there.

        Raises:
            BrokenProcessPool: a process was killed.
        """
        waiting: deque[Future[bytes]] = deque()
        for task in tasks:
            if len(waiting) == _AHEAD * self._count:
                yield cloudpickle.loads(waiting.popleft().result())
            packed = cloudpickle.dumps((function, task))
            with _without_interrupts():  # a process that this starts inherits the mask
                waiting.append(self._pool.submit(_call, packed))
        while waiting:
            yield cloudpickle.loads(waiting.popleft().result())

    def kill(self) -> None:
        """End all processes at once, whatever they do."""
        self._alive.close()
        for process in self._started:
            if process.pid is not None:
                process.kill()
        self._pool.shutdown(wait=True)


@contextmanager
def lent(count: int) -> Iterator[Processes]:
    """So many processes: those that the last sweep left idle, or new ones; an exception inside kills them all.

    A program whose own file leads here needs the guard ``if __name__ == "__main__":``: new processes import it.
    """
    pool = _kept.pop(count, None)
    if pool is None or not pool.usable:
        pool = Processes(count)
    try:
        yield pool
    except BaseException:  # Ctrl-C too
        pool.kill()
        raise
    _kept[count] = pool


class _Recording(SpawnContext):
    """Starts processes afresh, and knows which it has started."""

    def __init__(self) -> None:
        super().__init__()
        self.started: list[SpawnProcess] = []

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:  # type: ignore[override] # noqa: ANN401, N802
        process = SpawnProcess(*args, **kwargs)
        self.started.append(process)
        return process


@contextmanager
def _without_interrupts() -> Iterator[None]:
    if not hasattr(signal, "pthread_sigmask"):  # Windows: processes ignore Ctrl-C once they have begun
        yield
        return
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _begin(alive: Connection) -> None:
    """In a new process: leave Ctrl-C to the parent, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, args=(alive,), daemon=True).start()


def _end_with_parent(alive: Connection) -> None:
    wait([alive])
    os._exit(1)


def _call(packed: bytes) -> bytes:
    function, task = cloudpickle.loads(packed)
    result: bytes = cloudpickle.dumps(function(task))
    return result


@atexit.register
def _end_kept() -> None:
    for pool in _kept.values():
        if pool.usable:
            pool.kill()
