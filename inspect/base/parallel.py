"""One function over many items in threads."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from os import cpu_count
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def for_each(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """``function`` of every item, in order, in threads: numpy and OpenCV let go of the interpreter while they work.

    The first error of them is raised, whichever thread fails first.
    """
    todo = list(items)
    with ThreadPoolExecutor(max(1, min(cpu_count() or 1, len(todo)))) as pool:
        return list(pool.map(function, todo))
