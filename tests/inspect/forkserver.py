"""Runs the real command line in a process of its own without importing everything each time.

A server imports the package once and then forks; every child runs ``anisoscope`` from its entry point to what is to
be done at exit, in the folder and with the environment of the one who asks. What a command does at its very start
(imports, variables that libraries read when they are imported) is not what is seen here; nor is how the interpreter
takes all its modules apart at the very end, which takes longer than most commands.
"""

import atexit
import contextlib
import gc
import importlib
import importlib.util
import json
import os
import pkgutil
import select
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

# What the commands import when they run: half a second to two seconds of each of them.
HEAVY = (
    "scipy.stats",
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.signal",
    "scipy.interpolate",
    "cv2",
    "matplotlib.figure",
    "matplotlib.backends.backend_svg",
    "numba",
    "jinja2",
    "sqlalchemy",
    "rich.table",
    "rich.progress",
)
PACKAGES = (
    "anisoscope",
    "anisoscope.rig",
    "anisoscope.profiles",
    "anisoscope.sim",
)  # each a folder of its own
# threads and forks do not mix; and there are as many test workers as cores
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
SIDE_BY_SIDE = Path(__file__).parents[1] / "sidebyside.py"


def _load() -> None:
    """Import everything, and prepare what every process with kernels or rough surfaces would prepare for itself."""
    for package in PACKAGES:
        folders = importlib.import_module(package).__path__
        for module in pkgutil.walk_packages(folders, f"{package}."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)
    for name in HEAVY:
        importlib.import_module(name)
    from numba.core.registry import cpu_target

    from anisoscope.sim.light import material

    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()
    for nodes in (16, 32, 256):
        material._gauss_legendre(nodes)


def serve() -> None:
    """Answer every line on standard input with the child's number and, at its end, with its exit code."""
    from anisoscope.cli import main

    _load()
    if "PYTEST_XDIST_TESTRUNUID" in os.environ:
        spec = importlib.util.spec_from_file_location("sidebyside", SIDE_BY_SIDE)
        sidebyside = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sidebyside)
        sidebyside.share()
    gc.collect()
    gc.freeze()  # nothing of this is looked at again, least of all at every child's end
    for line in sys.stdin:
        order = json.loads(line)
        child = os.fork()
        if child == 0:
            _become(order)
            _end(_code_of(main))
        os.write(1, b"%d\n" % child)
        os.write(1, b"%d\n" % os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))


def _become(order: dict) -> None:
    """Take the place of a process that was started as ``anisoscope ...``."""
    for number, path in enumerate((os.devnull, order["out"], order["err"])):
        place = os.open(path, os.O_RDWR)
        os.dup2(place, number)
        os.close(place)
    sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    how = {"encoding": "utf-8", "closefd": False, "buffering": 1, "errors": "backslashreplace"}
    sys.stderr = open(2, "w", **how)  # noqa: SIM115
    os.environ.clear()
    os.environ.update(order["environment"] | ONE_THREAD)
    os.chdir(order["folder"])
    sys.path[:0] = order["path"]  # where PYTHONPATH would stand
    sys.argv = ["anisoscope", *order["arguments"]]


def _code_of(main) -> int:
    """Run a program; its exit code as the interpreter would give it."""
    try:
        main()
    except SystemExit as end:
        if isinstance(end.code, str):
            sys.stderr.write(f"{end.code}\n")
            return 1
        return end.code or 0
    except BaseException:  # noqa: BLE001 - whatever it is, it ends the program
        sys.excepthook(*sys.exc_info())
        return 1
    return 0


def _end(code: int) -> None:
    """End as a program ends: threads are waited for, what is to be done at exit is done, all is written out."""
    threading._shutdown()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code & 0xFF)


class ForkServer:
    """The one who asks; start it once for many commands."""

    def __init__(self) -> None:
        environment = os.environ | ONE_THREAD
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        command = [sys.executable, "-I", __file__]
        self._process = subprocess.Popen(command, env=environment, bufsize=0, **pipes)

    def run(self, arguments, cwd=None, timeout=400.0, path=()) -> tuple[int, str, str]:
        """Run ``anisoscope`` with arguments: exit code, what it printed, what it printed on standard error.

        Args:
            arguments: of the command line.
            cwd: the folder it runs in.
            timeout: in seconds.
            path: folders in which other packages are installed.

        Raises:
            subprocess.TimeoutExpired: it ran longer than ``timeout`` seconds, and was killed.
        """
        with tempfile.TemporaryDirectory(prefix="anisoscope-test-") as folder:
            out, err = (Path(folder) / name for name in ("out", "err"))
            out.touch()
            err.touch()
            words = [str(argument) for argument in arguments]
            order = {"arguments": words, "out": str(out), "err": str(err), "environment": dict(os.environ)}
            order |= {"folder": str(cwd or Path.cwd()), "path": [str(one) for one in path]}
            self._process.stdin.write(json.dumps(order).encode() + b"\n")
            child = int(self._process.stdout.readline())
            if not select.select([self._process.stdout], [], [], timeout)[0]:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)
                self._process.stdout.readline()
                raise subprocess.TimeoutExpired(words, timeout)
            code = int(self._process.stdout.readline())
            return code, *(path.read_bytes().decode("utf-8").replace("\r\n", "\n") for path in (out, err))

    def close(self) -> None:
        """End the server."""
        self._process.stdin.close()
        self._process.wait(60)
        self._process.stdout.close()


if __name__ == "__main__":
    serve()
