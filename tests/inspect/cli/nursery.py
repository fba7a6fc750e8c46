"""Starts the real command line again and again without importing everything each time.

A process of its own imports the package once and then forks; every child has its own session and a pseudo terminal
as its controlling terminal, and runs ``anisoscope`` from its entry point to the end of the interpreter.
"""

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
import threading
from pathlib import Path

NURSERY = """
import gc, json, os, sys
import matplotlib.figure, matplotlib.backends.backend_svg, scipy.special, scipy.stats, cv2
import anisoscope.cli.inspect.inspection
import anisoscope.inspection.replay, anisoscope.sim.bench.camera
from pathlib import Path
from anisoscope.cli import main
from anisoscope.prediction.expectation import expectation
from anisoscope.kinds.registry import read_recipe
expectation(read_recipe(Path(sys.argv[1])), 10.0)  # what it keeps of the material, every child has
gc.collect()
gc.freeze()  # so that no child looks at all this again when it ends
for line in sys.stdin:
    order = json.loads(line)
    child = os.fork()
    if child == 0:
        os.setsid()
        terminal = os.open(order["terminal"], os.O_RDWR)  # becomes the controlling one
        for number in range(3):
            os.dup2(terminal, number)
        sys.stdin = open(0, closefd=False)
        sys.stdout = open(1, "w", closefd=False)
        sys.stderr = open(2, "w", closefd=False)
        sys.argv = ["anisoscope", *order["arguments"]]
        main()
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""

PLUGIN = '''
"""A light that writes into a file whether it shines: what the rig last said to it outlives the rig."""

import os


class LoggedLight:
    def __init__(self, log):
        self._log = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def on(self):
        os.write(self._log, b"on\\n")

    def off(self):
        os.write(self._log, b"off\\n")

    def close(self):
        """The lamp does not know that nobody holds its cable any more."""
'''


def write_plugin(folder: Path) -> Path:
    """A package with the light driver ``logged``, as a third party would install one; returns what to import from."""
    info = folder / "loggedlight-1.0.dist-info"
    info.mkdir(parents=True)
    (folder / "loggedlight.py").write_text(PLUGIN)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: loggedlight\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[anisoscope.lights]\nlogged = loggedlight:LoggedLight\n")
    return folder


class Command:
    """One run of ``anisoscope`` on a terminal of its own."""

    def __init__(self, nursery, arguments):
        self._nursery = nursery
        self._ours, theirs = pty.openpty()
        order = {"terminal": os.ttyname(theirs), "arguments": [str(word) for word in arguments]}
        nursery.stdin.write(json.dumps(order) + "\n")
        nursery.stdin.flush()
        self.pid = int(nursery.stdout.readline())
        self._shown = bytearray()
        self._theirs = theirs  # held, so that what was shown last can still be read
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.code = None
        self._waiter = threading.Thread(target=self._wait, daemon=True)
        self._waiter.start()

    def _read(self):
        with contextlib.suppress(OSError):
            while data := os.read(self._ours, 4096):
                self._shown += data

    def _wait(self):
        self.code = int(self._nursery.stdout.readline())

    @property
    def running(self):
        return self.code is None

    def interrupt(self, how):
        """Ctrl-C on the terminal, or a signal."""
        if how == "Ctrl-C":
            os.write(self._ours, b"\x03")
        else:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, getattr(signal, how))

    def finish(self, timeout_s=120.0):
        """Wait for the end; returns exit code and what was shown."""
        self._waiter.join(timeout_s)
        if self.running:
            os.kill(self.pid, signal.SIGKILL)
            self._waiter.join(60)
            raise AssertionError(f"did not end within {timeout_s} s: {self._shown[-2000:].decode()}")
        os.close(self._theirs)  # the reader sees the end of it once it has read the last words
        self._reader.join(timeout_s)
        assert not self._reader.is_alive(), "somebody still holds the terminal"
        shown = self._shown.decode(errors="replace")
        with contextlib.suppress(OSError):
            os.close(self._ours)
        return self.code, shown


@contextlib.contextmanager
def nursery(path: Path, recipe: Path):
    """Yields a function that starts ``anisoscope`` with arguments and returns a `Command`.

    Args:
        path: where further packages lie.
        recipe: a recipe like the one that will be used.
    """
    environment = os.environ | {"PYTHONPATH": str(path), "TERM": "xterm", "COLUMNS": "200"}
    environment |= dict.fromkeys(
        ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
    )  # they are forked
    with subprocess.Popen(
        [sys.executable, "-c", NURSERY, str(recipe)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
        cwd=path,
    ) as process:
        yield lambda *arguments: Command(process, arguments)
        process.stdin.close()
        process.wait(120)
