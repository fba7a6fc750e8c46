"""Run other people's decoders so that a damaged file can neither hang, crash, flood nor print.

One process (:mod:`anisoscope.profiles.files.decoder_worker`) is started when the first file needs it, kept for the next
ones, and replaced when a file has stopped it. Heights come back as an npy file.
"""

import atexit
import importlib.util
import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.checks import DEFLATE_LIMIT, refuse

START_SECONDS = 120.0
MEMORY_BYTES = 512 * 2**20
MEMORY_PER_BYTE = 40
SECONDS = 4.0
PATIENCE = 10.0
"""Times so long may reading take on a machine that does other things as well."""
BYTES_PER_SECOND = 2**20
ADVICE = "the file is damaged, or of a kind that this reader does not know; export x3p"
NEEDED = {"library": ("SurfaceTopography", "formats"), "mesh": ("pyvista", "view"), "exr": ("OpenEXR", "exr")}
"""Kinds of decoders whose library comes with an extra: its module and the extra."""
HEALTHY = "this reader does not know files of this kind; export x3p"
COMMAND = [sys.executable, "-P", "-m", "anisoscope.profiles.files.decoder_worker"]
ONE_THREAD = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "MPLBACKEND": "Agg",
}


class GuardedProcess:
    """A process that decodes files, one at a time."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="anisoscope-"))
        self.owner = os.getpid()
        self.readers: dict[str, str] = {}
        self.process = subprocess.Popen(
            COMMAND,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **ONE_THREAD},
        )
        self.answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        threading.Thread(target=self._listen, name="guarded decoder", daemon=True).start()

    def _listen(self) -> None:
        """Queue every line of the process, and an empty one at its end; a pipe has no timeout on every system."""
        assert self.process.stdout is not None
        with suppress(OSError, ValueError):
            for line in self.process.stdout:
                self.answers.put(line)
        self.answers.put(b"")

    def ask(self, request: dict[str, Any], seconds: float) -> dict[str, Any] | None:
        """The answer to a request; None if the process died or did not answer in time."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(json.dumps(request).encode() + b"\n")
            self.process.stdin.flush()
            line = self.answers.get(timeout=seconds)
        except (OSError, queue.Empty):
            return None
        if not line.endswith(b"\n"):
            return None
        answer: dict[str, Any] = json.loads(line)
        return answer

    def prepare(self, kind: str) -> str:
        """Have the decoder of a kind imported, which does not count as reading; its name and version."""
        if kind not in self.readers:
            answer = self.ask({"prepare": True, "kind": kind}, START_SECONDS)
            self.readers[kind] = str((answer or {}).get("reader", ""))
        return self.readers[kind]

    def close(self) -> None:
        """End the process and remove its folder; in a forked child of the owner, only forget them."""
        if os.getpid() != self.owner:
            return
        with suppress(OSError):
            self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        shutil.rmtree(self.folder, ignore_errors=True)


class _Keeper:
    """The one process of this program."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.process: GuardedProcess | None = None
        self.inherited: list[GuardedProcess] = []

    def get(self) -> GuardedProcess:
        if self.process is not None and self.process.owner != os.getpid():
            self.inherited.append(self.process)  # a fork's copy: it belongs to the parent, and stays as it is
            self.process = None
        if self.process is None:
            self.process = GuardedProcess()
            atexit.register(self.process.close)
        return self.process

    def drop(self) -> None:
        if self.process is not None:
            atexit.unregister(self.process.close)
            self.process.close()
            self.process = None


_keeper = _Keeper()


def require_decoder(kind: str, name: str) -> None:
    """Refuse a file whose decoder is not installed.

    Args:
        kind: as for `decode`.
        name: of the file.

    Raises:
        HeightMapError: the module is missing; the text names its extra.
    """
    module, extra = NEEDED.get(kind, ("json", ""))
    if importlib.util.find_spec(module) is None:
        refuse(name, "format", f"{module} is not installed", f"pip install 'anisoscope[{extra}]'")


def decode(kind: str, path: Path, **request: object) -> tuple[dict[str, Any], npt.NDArray[Any]]:
    """Decode a file in the guarded process.

    Memory is limited to 512 MiB and 40 times the size of the file, processor time to 4 s and 1 s for each MiB.

    Args:
        kind: "library" (SurfaceTopography), "tiff", "png", "exr", "mesh", "datx-intensity", or "colours" (of any
            picture, as numbers 0xRRGGBBAA).
        path: the file.
        **request: what the decoder of that kind needs besides.

    Returns:
        What the decoder says about the file, with ``reader`` (its name and version), and the raw numbers.

    Raises:
        HeightMapError: the decoder is not installed, failed, died, or went beyond its limits.
    """
    require_decoder(kind, path.name)
    size = path.stat().st_size
    seconds = SECONDS + size / BYTES_PER_SECOND
    with _keeper.lock:
        process = _keeper.get()
        reader = process.prepare(kind)
        out = process.folder / "heights.npy"
        limits = {"memory_bytes": MEMORY_BYTES + MEMORY_PER_BYTE * size, "seconds": seconds}
        order = {"kind": kind, "path": str(path.resolve()), "out": str(out), **limits, **request}
        order = {"max_points": size * DEFLATE_LIMIT, **order}
        answer = process.ask(order, PATIENCE * seconds) if reader else None
        if answer is None:
            _keeper.drop()
            if not reader:
                refuse(
                    path.name,
                    "reading",
                    f"the decoder did not start within {START_SECONDS:.0f} s",
                    "try again",
                )
            refuse(path.name, "reading", f"the decoder stopped, or took longer than {seconds:.0f} s", ADVICE)
        if "refused" in answer:
            raise HeightMapError(f"{path.name}{answer['refused']}")
        if "error" in answer:
            refuse(path.name, "content", answer["error"], HEALTHY if answer.get("healthy") else ADVICE)
        raw: npt.NDArray[Any] = np.load(out, allow_pickle=False)
        out.unlink()
    if raw.ndim != 2 or raw.dtype.kind not in "iuf":
        refuse(path.name, "content", f"{raw.ndim} dimensions of type {raw.dtype}", ADVICE)
    return {**answer, "reader": reader}, raw
