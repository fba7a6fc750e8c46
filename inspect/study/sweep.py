"""Many independent evaluations: in this process, in processes of this machine, or on a Dask cluster.

Results come back in the order of the tasks and depend on nothing but the tasks and the seed: every task owns a
child of one seed sequence, whoever computes it. A cluster worker that is lost costs time only: its tasks go to
another one. Processes of this machine are those of loky (docs/decisions/0013): they stay for the next sweep, end with
one that is broken off, leave Ctrl-C to this process, and end with it.
"""

import asyncio
import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar, TypeVar

import numpy as np

from anisoscope.base.errors import AnisoscopeError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.workers import Workers
from anisoscope.rig.acquisition.interruptions import undisturbed

Result = TypeVar("Result")
PORTION = 512
"""Tasks of a portion: results of a finished one outlive a process that ends."""

CONNECT_TIMEOUT_S = 5.0
NO_WORKERS_TIMEOUT_S = 20.0
_PARTS = 64  # steps of the progress bar, about
_MAX_TASK_TEXT = 120  # characters of a failed task
_LOOK_S = 0.2  # between looks at what a cluster has done: how late it may learn of Ctrl-C
_RECOMPUTED_S = 0.05  # between looks at results that went with their worker
_PARENT_S = 0.5  # between looks at whether the parent is still there


class SweepError(AnisoscopeError):
    """A sweep that cannot be run to its end: the cluster is missing, or a task failed."""

    exit_code: ClassVar[int] = 69


@dataclass(frozen=True)
class _Failure:
    """Failure of a task, as text: the exception itself may not be picklable."""

    number: int
    task: str
    error: Exception | None
    text: str


@dataclass(frozen=True)
class _Part:
    """A block of consecutive tasks with their seeds."""

    function: Callable[..., Any]
    first: int
    tasks: tuple[Any, ...]
    seeds: tuple[np.random.SeedSequence, ...] | None


_Client = Any  # Dask has no types
_Pool = Any  # neither has loky
_Finished = Generator[tuple[_Part, list[Any]], None, None]


def sweep(
    function: Callable[..., Result],
    tasks: Iterable[Any],
    workers: Workers,
    *,
    seed: int | None = None,
    advance: Advance = silent,
    doing: str = "",
) -> list[Result]:
    """Call ``function(task)``, or ``function(task, rng)`` where a seed is given, for every task.

    Args:
        function: a function of a module, so that another process can find it.
        tasks: what it is called with.
        workers: processes or cluster; the results do not depend on it.
        seed: seed of the sweep; task n gets the n-th child of ``numpy.random.SeedSequence(seed)``.
        advance: called with the number of finished tasks.
        doing: label of the progress.

    Returns:
        The results, in the order of the tasks.

    Raises:
        SweepError: a task failed, or the cluster cannot be reached or has lost all its workers.
        UsageError: the extra that a cluster needs is not installed.
        AnisoscopeError: as raised by a task.
    """
    given = list(tasks)
    if not given:
        return []
    parts = _parts(function, given, seed)
    results: list[Any] = [None] * len(given)
    done = 0
    advance(doing, 0, len(given))
    with closing(_run(parts, workers)) as finished:
        for part, values in finished:
            _check(values, len(given))
            results[part.first : part.first + len(part.tasks)] = values
            done += len(part.tasks)
            advance(doing, done, len(given))
    return results


def again_after_a_kill(
    function: Callable[..., Result], tasks: Sequence[Any], workers: Workers, advance: Advance = silent
) -> list[Result]:
    """A sweep in portions: where a process is killed, its portion alone is computed once more.

    Raises:
        SweepError: a process was killed twice at the same portion, or the cluster is gone.
    """
    found: list[Result] = []
    for first in range(0, len(tasks), PORTION):
        portion = tasks[first : first + PORTION]

        progress = _from(first, len(tasks), advance)
        try:
            found += sweep(function, portion, workers, advance=progress, doing="inspections")
        except SweepError:
            if workers.scheduler is not None or workers.jobs == 1:
                raise
            found += sweep(function, portion, workers, advance=progress, doing="inspections")
    return found


def _from(first: int, of: int, advance: Advance) -> Advance:
    """Progress of a portion as that of the whole."""

    def progress(doing: str, done: int, total: int) -> None:
        del total
        advance(doing, first + done, of)

    return progress


def _parts(function: Callable[..., Any], tasks: Sequence[Any], seed: int | None) -> list[_Part]:
    size = max(1, len(tasks) // _PARTS)
    seeds = None if seed is None else np.random.SeedSequence(seed).spawn(len(tasks))
    return [
        _Part(
            function,
            first,
            tuple(tasks[first : first + size]),
            None if seeds is None else tuple(seeds[first : first + size]),
        )
        for first in range(0, len(tasks), size)
    ]


def _compute(part: _Part) -> list[Any]:
    """Results of a part; after a failure, only that."""
    values: list[Any] = []
    for offset, task in enumerate(part.tasks):
        try:
            if part.seeds is None:
                values.append(part.function(task))
            else:
                values.append(part.function(task, np.random.default_rng(part.seeds[offset])))
        except Exception as error:  # noqa: BLE001 - it is reported where the sweep was started
            known_error = error if isinstance(error, AnisoscopeError) else None
            text = " ".join(f"{type(error).__name__}: {error}".split())
            return [_Failure(part.first + offset, repr(task)[:_MAX_TASK_TEXT], known_error, text)]
    return values


def _check(values: list[Any], total: int) -> None:
    failure = next((value for value in values if isinstance(value, _Failure)), None)
    if failure is None:
        return
    if failure.error is not None:
        raise failure.error
    raise SweepError(f"task {failure.number + 1} of {total} failed: {failure.text} (task: {failure.task})")


def _run(parts: list[_Part], workers: Workers) -> _Finished:
    if workers.scheduler is not None:
        return _on_cluster(parts, workers.scheduler)
    return _locally(parts, workers.jobs)


def _locally(parts: list[_Part], jobs: int | None) -> _Finished:
    if jobs == 1 or len(parts) == 1:
        for part in parts:
            yield part, _compute(part)
        return
    count = min(jobs or os.cpu_count() or 1, len(parts))
    done = 0
    while done < len(parts):
        idle = _idle.pop((os.getpid(), count), None)
        try:
            with closing(_in_processes(parts[done:], count, idle)) as computed:
                for values in computed:
                    yield parts[done], values
                    done += 1
        except BrokenProcessPool as error:
            if idle is None:
                raise SweepError(
                    "a process of this sweep was killed, as happens when memory runs out: try fewer --jobs"
                ) from error
            # an idle process may have been killed since the last sweep: once more, with new ones


_idle: dict[tuple[int, int], _Pool] = {}  # by the process that has started them, and their count


def _in_processes(parts: list[_Part], count: int, idle: _Pool | None) -> Generator[list[Any], None, None]:
    """Results of parts, in their order; whatever breaks this off kills all processes."""
    pool = idle
    try:
        with undisturbed(), _sigint_blocked():  # an interruption waits until all processes are known
            if pool is None:
                pool = _new_pool(count)
            futures = [pool.submit(_compute, part) for part in parts]
        for future in futures:
            yield future.result()
    except BaseException:  # Ctrl-C too
        if pool is not None:
            with undisturbed():
                pool.shutdown(wait=True, kill_workers=True)
        raise
    _idle[os.getpid(), count] = pool


def _new_pool(count: int) -> _Pool:
    from loky import ProcessPoolExecutor  # noqa: PLC0415 - start-up time

    # processes whose memory has grown are replaced, which concerns nobody
    warnings.filterwarnings("ignore", "A worker was restarted while some jobs", UserWarning)
    return ProcessPoolExecutor(count, initializer=_begin, initargs=(os.getpid(),))


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    """Processes started inside inherit the mask: Ctrl-C is answered by this process alone."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows: processes ignore Ctrl-C once they have begun
        yield
        return
    for tracker in ("multiprocessing.resource_tracker", "loky.backend.resource_tracker"):
        import_module(
            tracker
        ).ensure_running()  # it comes with the first process, and would take the mask off
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _begin(parent: int) -> None:
    """In a new process: leave Ctrl-C to the parent, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_PARENT_S)
    os._exit(1)


def _on_cluster(parts: list[_Part], address: str) -> _Finished:
    client = _connect(address)
    try:
        _await_workers(client, address)
        yield from _collect(client, parts, address)
    finally:
        client.close(timeout=CONNECT_TIMEOUT_S)


def _connect(address: str) -> _Client:
    try:
        distributed: Any = import_module("distributed")  # an extra, slow to import, and without types
    except ImportError as error:
        raise UsageError(
            "a sweep on a cluster needs Dask, which is not installed: pip install anisoscope[cluster]"
        ) from error
    try:
        # Client waits for ever where something listens that is no scheduler
        asyncio.run(asyncio.wait_for(_knock(address), CONNECT_TIMEOUT_S))
        return distributed.Client(address, timeout=CONNECT_TIMEOUT_S)
    except (OSError, ValueError, TypeError, EOFError) as error:
        raise SweepError(
            f"no Dask scheduler answers at {address} within {CONNECT_TIMEOUT_S:g} s: is the address right, and "
            "does `dask scheduler` run there?"
        ) from error


async def _knock(address: str) -> None:
    comm = await import_module("distributed.comm").connect(address, timeout=CONNECT_TIMEOUT_S)
    await comm.close()


def _await_workers(client: _Client, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=NO_WORKERS_TIMEOUT_S)
    except TimeoutError as error:
        raise SweepError(f"{_no_workers(address)}: start some with `dask worker {address}`") from error


def _no_workers(address: str) -> str:
    return f"the Dask scheduler at {address} has had no workers for {NO_WORKERS_TIMEOUT_S:g} s"


def _ready(waiting: list[Any]) -> set[Any]:
    """The futures that are done, as soon as one is; none after `NO_WORKERS_TIMEOUT_S`.

    An interruption comes between two looks, as between two results: what waits for Dask's loop and is interrupted
    before that has begun it prints a NameError of Dask's own (`distributed.utils.sync`).
    """
    distributed: Any = import_module("distributed")
    end = time.monotonic() + NO_WORKERS_TIMEOUT_S
    while time.monotonic() < end:
        with undisturbed(), suppress(TimeoutError):
            return set(distributed.wait(waiting, _LOOK_S, "FIRST_COMPLETED").done)
    return set()


def _collect(client: _Client, parts: list[_Part], address: str) -> _Finished:
    waiting = {client.submit(_compute, part, pure=False): part for part in parts}
    try:
        while waiting:
            ready = _ready(list(waiting))
            if not ready:
                _await_workers(client, address)
                continue
            if all(future.status == "lost" for future in ready):
                _await_workers(client, address)
                time.sleep(_RECOMPUTED_S)
                continue
            for future in ready:
                if future.status == "lost":  # with the worker that held its result: it is computed again
                    continue
                if future.status == "cancelled":
                    raise SweepError(f"the Dask scheduler at {address} was lost: its tasks are gone")
                if future.status == "error":
                    raise SweepError(_explain(future.exception()))
                with undisturbed():
                    result = future.result()
                yield waiting.pop(future), result
    except (OSError, RuntimeError) as error:
        raise SweepError(f"the Dask scheduler at {address} was lost: {error}") from error
    finally:
        if client.status == "running":
            with undisturbed():
                client.cancel(list(waiting), force=True)


def _explain(error: BaseException | None) -> str:
    name = type(error).__name__
    text = " ".join(str(error).split())
    if name == "KilledWorker":
        return f"several cluster workers died on the same tasks, as happens when memory runs out: {text}"
    if isinstance(error, ImportError):
        return f"a cluster worker cannot load this program ({text}): install the same version of anisoscope there"
    return f"a cluster worker failed: {name}: {text}"
