"""Signals that end a program, and how they wait while something is done that must not be left half done."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType, ModuleType


def interruptions(module: ModuleType = signal) -> tuple[int, ...]:
    """The signals that ask this system's programs to end.

    SIGHUP: the terminal was closed; Windows has none. SIGBREAK: Ctrl-Break or a closed console; only Windows has it.
    """
    names = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
    return tuple(getattr(module, name) for name in names if hasattr(module, name))


INTERRUPTIONS = interruptions()


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Hold back `INTERRUPTIONS`; what came meanwhile is delivered at the end.

    Only the main thread gets signals; in other threads this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []

    def remember(number: int, _frame: FrameType | None) -> None:
        came.append(number)

    # None stands for a handler that Python did not install; it could not be put back.
    before = {one: signal.getsignal(one) for one in INTERRUPTIONS}
    before = {one: handler for one, handler in before.items() if handler is not None}
    for one in before:
        signal.signal(one, remember)
    try:
        yield
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)
    for number in came:
        signal.raise_signal(number)
