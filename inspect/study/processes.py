"""Processes of this machine that compute parts of a sweep, and that end with it when it is broken off.

The thread that asks hands out the work itself, over a pipe to each process. So nothing else is in the middle of
something when a sweep is broken off: all processes are killed at once. Functions and results that are not found by
name travel too, Ctrl-C is left to this process, and processes whose parent is gone end by themselves.
"""

import atexit
import os
import signal
import threading
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import NoReturn, TypeVar

import cloudpickle

from anisoscope.rig.acquisition.interruptions import undisturbed

__all__ = ["BrokenProcessPool", "Processes", "lent"]

Task = TypeVar("Task")
Result = TypeVar("Result")

_kept: dict[int, "Processes"] = {}  # idle, by their count


class Processes:
    """Some processes, each of which computes one task at a time.

    Args:
        count: how many at most; they start with the first tasks.
    """

    def __init__(self, count: int) -> None:
        self._owner = os.getpid()
        self._count = count
        self._started: list[tuple[SpawnProcess, Connection]] = []
        self._at_work: dict[Connection, int] = {}  # numbers of tasks

    @property
    def usable(self) -> bool:
        """Whether they are this process's own, none of them was killed, and all are idle."""
        own = self._owner == os.getpid()
        return own and not self._at_work and all(process.is_alive() for process, _ in self._started)

    def map(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Generator[Result, None, None]:
        """Results in the order of the tasks, as soon as each and all before it are there.

        Raises:
            BrokenProcessPool: a process was killed.
            Exception: as raised by the function; where that was, stands in its notes.
        """
        while len(self._started) < min(self._count, len(tasks)):
            self._start()
        lines = [line for _, line in self._started]
        results: dict[int, bytes] = {}
        following = 0
        for number in range(len(tasks)):
            while number not in results:
                for line in lines:
                    if line not in self._at_work and following < len(tasks):
                        _send(line, cloudpickle.dumps((function, tasks[following])))
                        self._at_work[line] = following
                        following += 1
                ready = wait(list(self._at_work))
                for line in [line for line in lines if line in ready]:
                    packed = _receive(line)
                    results[self._at_work.pop(line)] = packed
            value, error = cloudpickle.loads(results.pop(number))
            if error is not None:
                raise error
            yield value

    def kill(self) -> None:
        """End all processes at once, whatever they do."""
        with undisturbed():
            for process, line in self._started:
                process.kill()
                line.close()
            for process, _ in self._started:
                process.join()
            self._started.clear()
            self._at_work.clear()

    def _start(self) -> None:
        """Start a process; an interruption waits until it is known, or nobody could kill it."""
        context = get_context("spawn")
        with undisturbed(), _sigint_blocked():  # the process inherits the mask
            line, theirs = context.Pipe()
            process = context.Process(target=_serve, args=(theirs,), daemon=True)
            process.start()
            theirs.close()
            self._started.append((process, line))


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
    if pool.usable:
        _kept[count] = pool
    else:
        pool.kill()


def _send(line: Connection, packed: bytes) -> None:
    try:
        line.send_bytes(packed)
    except OSError as error:
        _broken(error)


def _receive(line: Connection) -> bytes:
    try:
        return line.recv_bytes()
    except (EOFError, OSError) as error:
        _broken(error)


def _broken(error: Exception) -> NoReturn:
    raise BrokenProcessPool("a process ended in the middle of its work") from error


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    if not hasattr(signal, "pthread_sigmask"):  # Windows: processes ignore Ctrl-C once they have begun
        yield
        return
    resource_tracker.ensure_running()  # it comes with the first process, and would take the mask off
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _serve(line: Connection) -> None:
    """In a new process: compute what comes, until the line is closed; leave Ctrl-C to the parent, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    while True:
        try:
            packed = line.recv_bytes()
        except (EOFError, OSError):
            return
        line.send_bytes(_computed(packed))


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)


def _computed(packed: bytes) -> bytes:
    """A result, or the exception instead of it, ready to travel."""
    try:
        function, task = cloudpickle.loads(packed)
        return _packed(function(task), None)
    except Exception as error:  # noqa: BLE001 - it is raised where the sweep was started
        error.add_note("".join(traceback.format_exception(error)).rstrip())
        try:
            return _packed(None, error)
        except Exception:  # noqa: BLE001 - what cannot travel is told in words
            return _packed(None, RuntimeError(f"{type(error).__name__}: {error}"))


def _packed(value: object, error: Exception | None) -> bytes:
    packed: bytes = cloudpickle.dumps((value, error))
    return packed


@atexit.register
def _end_kept() -> None:
    for pool in _kept.values():
        if pool.usable:
            pool.kill()
