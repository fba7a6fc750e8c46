"""What processes of one test run, side by side, need not do twice: compile kernels, and integrate over interfaces.

Without it every worker of a test run in a fresh checkout compiles the same kernels at the same time.
"""

import contextlib
import fcntl
import os
from functools import cache
from pathlib import Path

import numpy as np

COMPILED, INTERFACES = "kernels", "interfaces"


def share() -> None:
    """Share with all processes of this run that call this; pytest-xdist names the run."""
    folder = Path(os.environ["ANISOSCOPE_CACHE"]) / f"run-{os.environ['PYTEST_XDIST_TESTRUNUID']}"
    _compile_once(folder / COMPILED)
    _integrate_once(folder / INTERFACES)


def _compile_once(folder: Path) -> None:
    """Let numba compile a function only while no other process compiles it: who waited reads it from disk."""
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.dispatcher import Dispatcher

    folder.mkdir(parents=True, exist_ok=True)
    unshared, mine = Dispatcher.compile, set()

    @contextlib.contextmanager
    def alone(name):
        if name in mine:  # a kernel that is compiled for several kinds of arguments
            yield
            return
        place = os.open(folder / name, os.O_CREAT | os.O_RDWR)
        try:
            fcntl.flock(place, fcntl.LOCK_EX)
            mine.add(name)
            yield
        finally:
            mine.discard(name)
            os.close(place)

    def compile_alone(dispatcher, sig):
        function = dispatcher.py_func
        with global_compiler_lock:
            if not function.__module__.startswith("anisoscope."):
                return unshared(dispatcher, sig)
            with alone(f"{function.__module__}.{function.__qualname__}"):
                return unshared(dispatcher, sig)

    Dispatcher.compile = compile_alone


def _integrate_once(folder: Path) -> None:
    """Keep the tables of rough interfaces, which every process with uncertain materials needs a dozen of."""
    from anisoscope.sim.light import material

    folder.mkdir(parents=True, exist_ok=True)
    integrate = material._interface

    @cache
    def interface(alpha, index):
        path = folder / f"{float(alpha).hex()}{float(index).hex()}.npy"
        try:
            kept = np.load(path)
        except (OSError, EOFError, ValueError):
            kept = np.append(*integrate(alpha, index))
            mine = path.with_suffix(f".{os.getpid()}.npy")
            np.save(mine, kept)
            mine.replace(path)
        table = kept[:-1]
        table.flags.writeable = False
        return table, float(kept[-1])

    material._interface = interface
