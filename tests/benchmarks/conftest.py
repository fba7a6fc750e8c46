"""Timing of benchmarks: alternatives in turn (A B A B), wall and processor time, growth laws, results as JSON.

Load on the machine changes within a run. Alternatives that are timed in turn see the same load, so their ratio holds
where single times do not. Processor time is that of the process and of all that it started, with all threads.
"""

import contextlib
import gc
import importlib.metadata
import json
import os
import platform
import resource
import statistics
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

RESULTS = "ANISOSCOPE_BENCHMARK_RESULTS"
SHORTEST_S = 0.02
LIBRARIES = (
    "numpy",
    "scipy",
    "numba",
    "opencv-contrib-python-headless",
    "mitsuba",
    "prysm",
    "SurfaceTopography",
)

Work = Callable[[], Any]


@dataclass(frozen=True)
class Timing:
    """Seconds of one call in every round, on the clock and of the processor; and what the last call gave."""

    wall_s: tuple[float, ...]
    processor_s: tuple[float, ...]
    calls: int
    result: Any = field(repr=False)

    def line(self) -> str:
        """Minimum and median of both times, in ms or s."""
        scale, unit = (1e3, "ms") if statistics.median(self.wall_s) < 1.0 else (1.0, "s")
        numbers = [
            f"{name} {scale * min(spans):.3g} / {scale * statistics.median(spans):.3g} {unit}"
            for name, spans in (("wall", self.wall_s), ("processor", self.processor_s))
        ]
        return ", ".join(numbers)


@dataclass(frozen=True)
class Comparison:
    """Alternatives that were timed in turn."""

    timings: Mapping[str, Timing]

    def __getitem__(self, label: str) -> Timing:
        return self.timings[label]

    def ratio(self, slow: str, fast: str) -> float:
        """Processor time of one alternative over another's, by their minima."""
        return min(self[slow].processor_s) / min(self[fast].processor_s)

    def wall_ratio(self, slow: str, fast: str) -> float:
        """The same on the clock."""
        return min(self[slow].wall_s) / min(self[fast].wall_s)


def processor_s() -> float:
    """Seconds of processor time so far, of this process, its finished children, and workers that go on."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    going_on = 0.0
    for child in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):  # it has ended meanwhile
            spent = child.cpu_times()
            going_on += spent.user + spent.system + spent.children_user + spent.children_system
    return time.process_time() + ended.ru_utime + ended.ru_stime + going_on


def once(work: Work, calls: int) -> tuple[float, float, Any]:
    """Wall and processor seconds of one call, as the mean of several, and the last result."""
    wall, processor, result = time.perf_counter(), processor_s(), None
    for _ in range(calls):
        result = work()
    return (time.perf_counter() - wall) / calls, (processor_s() - processor) / calls, result


def calls_of(work: Work, warm: bool) -> int:
    """How many calls make a span that the clocks resolve; the first call compiles and fills caches."""
    if warm:
        work()
    span = once(work, 1)[0] if warm else SHORTEST_S
    return max(1, round(SHORTEST_S / max(span, 1e-7)))


class Benchmark:
    """Times alternatives, prints them, and collects the numbers of one run."""

    def __init__(self, name: str, collected: list[dict[str, Any]]) -> None:
        self._name, self._collected = name, collected

    def compare(
        self, title: str, works: Mapping[str, Work], rounds: int = 5, warm: bool = True
    ) -> Comparison:
        """Time every alternative once a round, in turn.

        The first alternative is the product's. Without ``warm`` there is no call before the first round: for works
        that take minutes or start a process of their own.
        """
        calls = {label: calls_of(work, warm) for label, work in works.items()}
        spans: dict[str, list[tuple[float, float]]] = {label: [] for label in works}
        results, before = {}, os.getloadavg()[0]
        gc.collect()
        for _ in range(rounds):
            for label, work in works.items():
                wall, used, results[label] = once(work, calls[label])
                spans[label].append((wall, used))
        timings = {
            label: Timing(*zip(*spans[label], strict=True), calls[label], results[label]) for label in works
        }
        comparison = Comparison(timings)
        self._print(title, comparison, rounds)
        self._collected.append(
            {
                "test": self._name,
                "title": title,
                "rounds": rounds,
                "load": [before, os.getloadavg()[0]],
                "timings": {
                    label: {"wall_s": one.wall_s, "processor_s": one.processor_s, "calls": one.calls}
                    for label, one in timings.items()
                },
                "notes": [],
            }
        )
        return comparison

    def _print(self, title: str, comparison: Comparison, rounds: int) -> None:
        print(f"\n{title} (minimum / median of {rounds} in turn, load {os.getloadavg()[0]:.1f})")
        first = next(iter(comparison.timings))
        for label, one in comparison.timings.items():
            ratio = ""
            if label != first:
                ratio = f"; {comparison.ratio(label, first):.3g} times the processor time, "
                ratio += f"{comparison.wall_ratio(label, first):.3g} on the clock"
            print(f"  {label}: {one.line()}{ratio}")

    def growth(self, title: str, variable: str, works: Mapping[float, Work], rounds: int = 3) -> float:
        """Exponent of the growth law of processor time with a size, fitted to the minima of every size."""
        found = self.compare(
            f"{title}, by {variable}", {f"{size:g}": work for size, work in works.items()}, rounds
        )
        sizes = np.array(list(works), dtype=float)
        seconds = np.array([min(one.processor_s) for one in found.timings.values()])
        exponent = float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])
        print(f"  grows as {variable}^{exponent:.2f}")
        self._collected[-1] |= {"variable": variable, "sizes": sizes.tolist(), "exponent": exponent}
        return exponent

    def note(self, text: str) -> None:
        """A line of accuracy, memory or limits that stands with the last comparison."""
        print(f"  {text}")
        if not self._collected or self._collected[-1]["test"] != self._name:
            self._collected.append({"test": self._name, "title": "", "timings": {}, "notes": []})
        self._collected[-1]["notes"].append(text)


@dataclass(frozen=True)
class Machine:
    """Where and with what a run was made."""

    at: str
    commit: str
    processor: str
    cores: int
    python: str
    libraries: dict[str, str]
    load_start: float


def machine() -> Machine:
    """This machine, as far as the system says it."""
    versions = {}
    for name in LIBRARIES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "not installed"
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=False,
    )
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")
    return Machine(
        datetime.now(UTC).isoformat(timespec="seconds"),
        commit.stdout.strip(),
        model or platform.processor() or platform.machine(),
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        platform.python_version(),
        versions,
        os.getloadavg()[0],
    )


@pytest.fixture(scope="session")
def collected():
    """The comparisons of this run; written as JSON at its end where the environment names a file."""
    found: list[dict[str, Any]] = []
    started = machine()
    yield found
    if os.environ.get(RESULTS):
        path = Path(os.environ[RESULTS])
        path.parent.mkdir(parents=True, exist_ok=True)
        table = {"schema": 1, "machine": asdict(started), "comparisons": found}
        path.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


@pytest.fixture
def bench(request, collected):
    """The stopwatch of one benchmark."""
    return Benchmark(request.node.nodeid.split("/")[-1], collected)
