"""Runs the real command line in a process of its own without importing everything each time.

A server, one for all workers of a run, imports the package once and then forks; every child runs ``anisoscope`` from
its entry point to what is to be done at exit, in the folder and with the environment of the one who asks. What a
command does at its very start (imports, variables that libraries read when they are imported) is not what is seen
here; nor is how the interpreter takes all its modules apart at the very end, which takes longer than most commands.
"""

import atexit
import contextlib
import ctypes
import fcntl
import gc
import importlib
import importlib.util
import json
import os
import pkgutil
import select
import selectors
import signal
import socket
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
    "rich.markdown",
    "rich.table",
    "rich.progress",
    "cyclopts.help.formatters",
    "docstring_parser",
)
PACKAGES = (
    "anisoscope",
    "anisoscope.rig",
    "anisoscope.profiles",
    "anisoscope.sim",
)  # each a folder of its own
# threads and forks do not mix; and there are as many test workers as cores
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
FIRST_CLIENT_S = 60.0
A_RUN_S = (
    3600.0  # on a busy machine any command may last until lines of progress would be due: none are printed
)
SIDE_BY_SIDE = Path(__file__).parents[1] / "sidebyside.py"
LARGE, MADV_HUGEPAGE, MADV_COLLAPSE = 2 << 20, 14, 25  # Linux: a large page in bytes, and advice on memory


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

    from anisoscope.base import plugins
    from anisoscope.cli import app, progress
    from anisoscope.cli.cache import warm
    from anisoscope.rig import transport
    from anisoscope.sim.light import material

    progress.PATIENCE_S = A_RUN_S

    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()
    for nodes in (16, 32, 256):
        material._gauss_legendre(nodes)
    for name in warm.OF_DEMO:  # reads their kernels from the disk, which costs a command a third of a second
        warm.JOBS[name]()
    warm._read_sources()
    plugins.installed("anisoscope.kinds")  # reads what is said of every package that is installed
    transport.register_handlers()
    _resolve(app)
    assert threading.active_count() == 1


def _resolve(group) -> None:
    """Look up the functions of all commands of a group, which a command would do for those that it may mean."""
    for name in group:
        if name not in (*group.help_flags, *group.version_flags):
            _resolve(group[name])


def _use_large_pages() -> None:
    """Gather what was imported in pages of 2 MB: each fork copies a table of pages, and this one is shorter.

    A third less time is spent around each command; where the system has no such pages, nothing changes.
    """
    advise = getattr(ctypes.CDLL(None), "madvise", None)
    if advise is None:
        return
    advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    for line in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines():
        place, rights, _, _, inode, *_ = line.split()
        if rights == "rw-p" and inode == "0":
            begin, end = (int(number, 16) for number in place.split("-"))
            for page in range(-(-begin // LARGE) * LARGE, end - LARGE + 1, LARGE):
                advise(page, LARGE, MADV_HUGEPAGE)
                advise(page, LARGE, MADV_COLLAPSE)


def serve(address: str) -> None:
    """Run a command for every line that a client sends: answers its process number, and at its end its exit code.

    Ends when the last client has left.
    """
    gc.disable()  # what is imported stays
    from anisoscope.__main__ import COLLECTED_AFTER
    from anisoscope.cli import main

    _load()
    if "PYTEST_XDIST_TESTRUNUID" in os.environ:
        spec = importlib.util.spec_from_file_location("sidebyside", SIDE_BY_SIDE)
        sidebyside = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sidebyside)
        sidebyside.share()
    gc.enable()
    gc.freeze()  # nothing of this is looked at again, least of all at every child's end
    gc.set_threshold(COLLECTED_AFTER, 10, 10)
    _use_large_pages()
    with socket.socket(socket.AF_UNIX) as listener, selectors.DefaultSelector() as ready:
        Path(address).unlink(missing_ok=True)
        listener.bind(address)
        listener.listen()
        ready.register(listener, selectors.EVENT_READ)
        os.write(1, b"ready\n")
        while chosen := ready.select(None if len(ready.get_map()) > 1 else FIRST_CLIENT_S):
            for key, _ in chosen:
                if key.fileobj is listener:
                    client = listener.accept()[0]
                    ready.register(client, selectors.EVENT_READ, client.makefile("rb", buffering=0))
                elif isinstance(key.fileobj, socket.socket):
                    _take_order(key, ready, main)
                else:
                    _report_end(key, ready)
            if len(ready.get_map()) == 1:
                return


def _take_order(key: selectors.SelectorKey, ready: selectors.BaseSelector, main) -> None:
    """Start what a client orders; a client that has left is forgotten."""
    line = key.data.readline()
    if not line:
        ready.unregister(key.fileobj)
        key.data.close()
        key.fileobj.close()
        return
    child = os.fork()
    if child == 0:
        for other in list(ready.get_map().values()):
            if isinstance(other.fileobj, socket.socket):
                os.close(other.fd)  # a command that goes on would hold it open
            else:
                os.close(other.fileobj)
        _become(json.loads(line))
        _end(_code_of(main))
    key.fileobj.sendall(b"%d\n" % child)
    ready.register(os.pidfd_open(child), selectors.EVENT_READ, (child, key.fileobj))


def _report_end(key: selectors.SelectorKey, ready: selectors.BaseSelector) -> None:
    """Send the exit code of a process that has ended to the client that ordered it."""
    child, client = key.data
    ready.unregister(key.fileobj)
    os.close(key.fileobj)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    with contextlib.suppress(OSError):  # the client has left
        client.sendall(b"%d\n" % code)


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
    """A client of the one server of a run, which the first client starts."""

    def __init__(self, folder: Path) -> None:
        """Connect to the server of a run.

        Args:
            folder: of the run, which all its clients share.
        """
        self._socket = socket.socket(socket.AF_UNIX)
        address = str(folder / "forkserver")
        with Path(f"{address}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            try:
                self._socket.connect(address)
            except OSError:
                _start(address)
                self._socket.connect(address)
        self._answers = self._socket.makefile("rb", buffering=0)

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
            self._socket.sendall(json.dumps(order).encode() + b"\n")
            child = int(self._answers.readline())
            if not select.select([self._socket], [], [], timeout)[0]:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)
                self._answers.readline()
                raise subprocess.TimeoutExpired(words, timeout)
            code = int(self._answers.readline())
            return code, *(path.read_bytes().decode("utf-8").replace("\r\n", "\n") for path in (out, err))

    def close(self) -> None:
        """Leave the server, which ends with its last client."""
        self._answers.close()
        self._socket.close()


def _start(address: str) -> None:
    """Start a server, and wait until it answers."""
    command = [sys.executable, "-I", __file__, address]
    how = {"env": os.environ | ONE_THREAD, "stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, **how) as server:
        assert server.stdout.readline() == b"ready\n"
        server.returncode = 0  # it outlives the worker that starts it: nobody waits for it


if __name__ == "__main__":
    serve(sys.argv[1])
