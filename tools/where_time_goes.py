"""Where the time of one inspection goes, as a page: python tools/where_time_goes.py [PAGE].

Inspects the good part of the demo twice in a new process on the virtual rig. The second inspection is divided into
steps by timers around them, each without the steps inside it; what the first one takes more is imports, compiled
kernels read from disk, and what is computed once a recipe. Times are those of the processor, over all threads.
"""

import contextlib
import importlib
import io
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

PAGE = Path(__file__).resolve().parent.parent / "docs" / "evidence" / "time-of-an-inspection.md"
STEPS = (
    ("simulated camera", "anisoscope.sim.bench.camera", "SimulatedCamera.grab"),
    ("turning, and writing and hashing the frames", "anisoscope.inspection.run", "_photograph"),
    ("reading and decoding the frames", "anisoscope.inspection.run", "read_frames"),
    ("recipe, rig and calibrations", "anisoscope.inspection.run", "prepare"),
    ("prediction", "anisoscope.kinds.surface", "SurfaceKind.predict"),
    ("radiance, markers, alignment, gates", "anisoscope.inspection.pipeline", "measure_frames"),
    ("decision: tests, guard bands, map of cells", "anisoscope.kinds.surface", "SurfaceKind.decide"),
    ("diagnosis, and where the height map lies", "anisoscope.kinds.surface", "SurfaceKind.diagnose"),
    ("record and seal", "anisoscope.inspection.run", "conclude"),
    ("report: what the part should look like", "anisoscope.kinds.surface", "SurfaceKind.pictures"),
    ("report: charts and maps", "anisoscope.kinds.surface", "SurfaceKind.sections"),
    ("report: page and seal", "anisoscope.inspection.reports", "PendingReport.write"),
)
TEXT = """# Where the time of an inspection goes

Written by `python tools/where_time_goes.py`: the good part of the demo, 24 frames of one megapixel on the virtual rig,
in seconds of processor time over all threads. With a real camera, its exposures take the place of the first line.

| step of the second inspection in a process | s | share |
|---|---|---|
{rows}
| **second inspection** | **{second:.2f}** | |

The verdict is printed and sealed before the report, which a batch writes while the next part is inspected.

The first inspection takes {first:.2f} s: {more:.2f} s more, nearly all of it imports. What is computed once for a
recipe (prediction, effects of causes, views of the height map, scenes of the simulated part) was in the cache.
"""
REST = "command line, progress, history, the rest"


class Timers:
    """Processor time of nested steps, each without those inside it."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._open: list[list[float]] = []

    def around(self, label: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, timed."""

        @wraps(function)
        def timed(*arguments: Any, **options: Any) -> Any:  # noqa: ANN401 - any function
            start, inside = time.process_time(), [0.0]
            self._open.append(inside)
            try:
                return function(*arguments, **options)
            finally:
                self._open.pop()
                taken = time.process_time() - start
                self.seconds[label] = self.seconds.get(label, 0.0) + taken - inside[0]
                if self._open:
                    self._open[-1][0] += taken

        return timed

    def install(self) -> None:
        """Time all steps from now on."""
        for label, module, name in STEPS:
            owner: Any = importlib.import_module(module)
            *path, last = name.split(".")
            for one in path:
                owner = getattr(owner, one)
            setattr(owner, last, self.around(label, getattr(owner, last)))


def measure(folder: str) -> None:
    """In a process of its own: print the seconds of both inspections as JSON."""
    start = time.process_time()
    from anisoscope.cli import run

    def inspect() -> float:
        begun = time.process_time()
        job = ["inspect", "-r", f"{folder}/recipe.toml", "-g", f"{folder}/bench/good/rig.toml", "-s", "A1"]
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            code = run([*job, "--out", f"{folder}/out", "--history", "none"])
        if code != 0:
            raise SystemExit(f"the inspection ended with {code}")
        return time.process_time() - begun

    imported = time.process_time() - start
    first = inspect() + imported
    timers = Timers()
    timers.install()
    second = timers.around(REST, inspect)()
    print(json.dumps({"first": first, "second": second, "steps": timers.seconds}))  # noqa: T201 - the answer


def page(found: dict[str, Any]) -> str:
    """The page in Markdown."""
    second, steps = found["second"], found["steps"]
    labels = [label for label, *_ in STEPS] + [REST]
    rows = [
        f"| {label} | {steps.get(label, 0.0):.2f} | {steps.get(label, 0.0) / second:.0%} |"
        for label in labels
    ]
    return TEXT.format(
        rows="\n".join(rows), second=second, first=found["first"], more=found["first"] - second
    )


def main() -> None:
    """Lay the demo out, measure in a new process, write the page."""
    if sys.argv[1:2] == ["--measure"]:
        measure(sys.argv[2])
        return
    from anisoscope.base.progress import silent
    from anisoscope.operations.demo.ridges import SCENE

    with tempfile.TemporaryDirectory() as folder:
        SCENE.lay_out(Path(folder), 1, silent)
        line = [sys.executable, "-P", __file__, "--measure", folder]
        subprocess.run(line, check=True, capture_output=True)  # what is computed once for a recipe
        done = subprocess.run(line, check=True, capture_output=True, text=True)
    text = page(json.loads(done.stdout))
    (Path(sys.argv[1]) if len(sys.argv) > 1 else PAGE).write_text(text, encoding="utf-8")
    sys.stdout.write(text)


if __name__ == "__main__":
    main()
