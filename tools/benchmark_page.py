"""The page of the benchmarks, its trend, and what became slower: python tools/benchmark_page.py record|compare FILE.

``make benchmark`` writes the results of one run and compares its ratios with the median of the last three runs on
record; ``make benchmark-record`` adds a run to the record and writes the page.
"""

import csv
import json
import statistics
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

EVIDENCE = Path(__file__).resolve().parent.parent / "docs" / "evidence"
PAGE, TREND = EVIDENCE / "benchmarks.md", EVIDENCE / "benchmark-trend.csv"
COLUMNS = ("at", "commit", "benchmark", "against", "value")
SLOWER = 1.2
LAST = 3
GROWTH = "exponent"

HEAD = """# Benchmarks

Written by `make benchmark && make benchmark-record`. Alternatives run in turn (A B A B) in one process, after one call
that compiles and fills caches. Every cell gives the minimum and the median of all rounds. Processor time counts all
threads and started processes; the ratio is that of the minima of processor time to the first line of each table. Ratios
hold under load and on other machines; seconds do not. The trend of all ratios is `docs/evidence/benchmark-trend.csv`;
`make benchmark` names what is more than 20 % slower than the median of the last three runs on record.
"""

Run = dict[str, Any]
Key = tuple[str, str]


@dataclass(frozen=True)
class Goal:
    """A number that a benchmark should reach.

    Attributes:
        work: what is timed.
        title: of the comparison.
        label: of the timing.
        goal: what it should reach: seconds at most, or with ``against`` a ratio at least.
        clock: "wall_s" or "processor_s"; minima count.
        against: label of what is divided by the timing; with ``less`` it is taken off.
        less: label of what is taken off.
        limit: what keeps it from the goal.
    """

    work: str
    title: str
    label: str
    goal: float
    clock: str = "wall_s"
    against: str | None = None
    less: str | None = None
    limit: str = ""

    def reached(self, run: Run) -> float | None:
        """The number of a run; None where it was not measured."""
        for one in run["comparisons"]:
            if one["title"] == self.title and self.label in one["timings"]:
                least = {label: min(timing[self.clock]) for label, timing in one["timings"].items()}
                if self.against is not None:
                    return float(least[self.against] / least[self.label])
                return float(least[self.label] - (least[self.less] if self.less is not None else 0.0))
        return None

    def row(self, run: Run) -> str:
        """The line of the table."""
        found = self.reached(run)
        goal = f"≥ {self.goal:g} ×" if self.against is not None else f"≤ {seconds(self.goal)}"
        if found is None:
            return f"| {self.work} | {goal} | not measured in this run | |"
        met = found >= self.goal if self.against is not None else found <= self.goal
        number = f"{found:.3g} ×" if self.against is not None else seconds(found)
        clock = "processor" if self.clock == "processor_s" else "wall"
        return f"| {self.work} | {goal} | {number} ({clock}) | {'met' if met else f'missed: {self.limit}'} |"


DISK = "10 frames of 2448 × 2048 on disk"
COLD = "`anisoscope inspect --frames` of 24 frames of a megapixel"
DIRECT, REFLECTED = (
    f"{light}, 15 poses, 1000 × 1000 points" for light in ("direct light", "up to 5 reflections")
)
KEPT, ALL = "relief, prepared map", "relief, map to radiances"
NEW = "the same, not asked before"
DESIGN, MAP = "`anisoscope predict --ridge-angle 10`", "`anisoscope predict map.x3p --pitch 100`"
PLATE, HALFTONE = "1000 × 1000 points, ridges at 0°", "512 × 512 pixels, two lights, three inks, halftone"
YIELD, FOUR = "1000 toleranced parts to verdicts", "robust designs with rounded crests, 4 varied"
INK = "polynomial, memory of the frame before"
IMPORTS = "imports of SciPy, Matplotlib and Pydantic are half of it"
KERNELS = "a third of it is loading numba and its kernels"
GOALS = (
    Goal("3 poses of 5 MP TIFF on disk to verdict and sealed record", DISK, "verdict and sealed record", 0.5),
    Goal(
        "its report",
        DISK,
        "verdict, report and sealed record",
        0.6,
        "processor_s",
        less="verdict and sealed record",
    ),
    Goal(
        "`inspect` in a process of its own, without camera",
        COLD,
        "command",
        2.0,
        "processor_s",
        limit=IMPORTS,
    ),
    Goal(
        "the same, more for the first time with a recipe",
        COLD,
        "the first with a recipe",
        5.0,
        "processor_s",
        less="command",
        limit="prediction, causes and views of the map are computed once a recipe",
    ),
    Goal("`predict` of a design, not asked before", DESIGN, NEW, 0.5),
    Goal("`predict` of a map, not asked before", MAP, NEW, 1.5, limit=KERNELS),
    Goal("ridges of 1000 × 1000 points", PLATE, "measure_ridges", 0.3),
    Goal("reading x3p of 10 million points", "reading x3p, by points", "1.00046e+07", 0.5),
    Goal("writing it", "writing x3p, by points", "1.00046e+07", 1.0),
    Goal("relief of 4000 × 4000 points, 15 poses", "15 poses, by points", "1.6e+07", 3.0, "processor_s"),
    *(
        Goal(
            f"{title.partition(',')[0]}, scene kept, Mitsuba {variant}",
            title,
            KEPT,
            1.5,
            against=f"Mitsuba {variant}, scene kept",
        )
        for title in (DIRECT, REFLECTED)
        for variant in ("scalar_rgb", "llvm_ad_rgb")
    ),
    *(
        Goal(
            f"reflections, map to radiances, Mitsuba {variant}",
            REFLECTED,
            ALL,
            6.0,
            against=f"Mitsuba {variant}, map to radiances",
            limit="paths are followed one by one, LLVM follows several in one vector",
        )
        for variant in ("scalar_rgb", "llvm_ad_rgb")
    ),
    Goal("robust design, 1 varied", "robust designs with rounded crests", "1 varied", 1.0),
    Goal("robust design, 4 varied", "robust designs with rounded crests", "4 varied", 10.0),
    Goal("the same with all reflections", FOUR, "all reflections", 60.0),
    Goal("1000 toleranced parts to verdicts", YIELD, "one process", 20.0),
    Goal("the same on two processes", YIELD, "two processes", 1.8, against="one process"),
    Goal("ink frame of three inks, halftone", HALFTONE, INK, 0.0015),
    Goal("fit of an ink", "4592 readings", "fit with all checks", 0.004),
    Goal(
        "15 directions × 31 wavelengths, 4096 × 4096",
        "15 directions × 31 wavelengths, by heights",
        "1.67772e+07",
        15.0,
        "processor_s",
    ),
    Goal(
        "wafer window by waves, with budget",
        "wafer window of 896 × 896 points by waves, three poses",
        "prediction with its budget",
        5.0,
    ),
    Goal("`--help`", "`anisoscope --help`", "command", 0.25),
    Goal("`profile info`", "`anisoscope profile info map.x3p`", "command", 0.5),
)


def main(arguments: list[str]) -> int:
    """Compare a run with the record, or add it; 1 where something became slower."""
    if len(arguments) != 2 or arguments[0] not in {"record", "compare"}:
        sys.stderr.write((__doc__ or "").splitlines()[0] + "\n")
        return 64
    try:
        run = json.loads(Path(arguments[1]).read_text(encoding="utf-8"))
    except (OSError, ValueError) as problem:
        sys.stderr.write(f"{arguments[1]}: no results of `make benchmark`: {problem}\n")
        return 74
    if arguments[0] == "record":
        record(run)
        return 0
    slow = list(slower(run, trend()))
    sys.stdout.writelines(f"slower: {line}\n" for line in slow)
    if not slow:
        sys.stdout.write(f"Nothing is more than {SLOWER - 1:.0%} slower than on record.\n")
    return bool(slow)


def values(run: Run) -> dict[Key, float]:
    """What the trend follows: processor time over that of each alternative, and exponents of growth laws.

    A ratio to work that ran in turn holds on any machine; seconds do not.
    """
    found = {}
    for one in run["comparisons"]:
        if "exponent" in one:
            found[one["title"], GROWTH] = float(one["exponent"])
            continue
        first, *others = one["timings"].items() if one["timings"] else ((None, None),)
        for label, timing in others:
            found[one["title"], label] = min(first[1]["processor_s"]) / min(timing["processor_s"])
    return found


def trend() -> dict[Key, list[float]]:
    """Values on record, oldest first, by benchmark and alternative."""
    found: dict[Key, list[float]] = {}
    if TREND.exists():
        with TREND.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                found.setdefault((row["benchmark"], row["against"]), []).append(float(row["value"]))
    return found


def slower(run: Run, past: dict[Key, list[float]]) -> Iterator[str]:
    """A line for every value that is above the median of the last ones on record by more than a fifth.

    Exponents count as slower when they grow by .2.
    """
    for key, value in values(run).items():
        if key not in past:
            continue
        before = statistics.median(past[key][-LAST:])
        limit = before + (SLOWER - 1.0) if key[1] == GROWTH else SLOWER * before
        if value > limit:
            yield f"{key[0]}, {key[1]}: {value:.3g}, on record {before:.3g}"


def record(run: Run) -> None:
    """Add a run to the trend and write the page."""
    new, machine = not TREND.exists(), run["machine"]
    with TREND.open("a", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if new:
            writer.writerow(COLUMNS)
        for (title, label), value in values(run).items():
            writer.writerow((machine["at"], machine["commit"], title, label, f"{value:.4g}"))
    PAGE.write_text("\n".join(page(run)) + "\n", encoding="utf-8")


def page(run: Run) -> Iterator[str]:
    """The lines of the page."""
    machine = run["machine"]
    libraries = ", ".join(f"{name} {version}" for name, version in machine["libraries"].items())
    yield HEAD
    yield f"Run of {machine['at'][:10]} at `{machine['commit']}`:"
    yield f"{machine['processor']}, {machine['cores']} cores, load at the start {machine['load_start']:.1f};"
    yield f"Python {machine['python']}, {libraries}."
    yield ""
    yield from goals(run)
    yield from growth_laws(run)
    for name, comparisons in by_file(run).items():
        yield f"## {name}"
        yield ""
        for one in comparisons:
            yield from section(one)


def by_file(run: Run) -> dict[str, list[Run]]:
    """Comparisons by the file of their benchmark, in words."""
    found: dict[str, list[Run]] = {}
    for one in run["comparisons"]:
        name = one["test"].split("::")[0].removeprefix("test_").removesuffix(".py").replace("_", " ")
        found.setdefault(name.capitalize(), []).append(one)
    return found


def goals(run: Run) -> Iterator[str]:
    """A table of what was aimed at."""
    yield "## Goals"
    yield ""
    yield "Minima on two cores. The simulated camera is in [where the time goes](time-of-an-inspection.md), waves on a"
    yield "graphics card in [a record](../decisions/0024-waves-on-a-graphics-card.md), the memory of a relief below."
    yield ""
    yield "| work | goal | reached | |"
    yield "|---|---|---|---|"
    for one in GOALS:
        yield one.row(run)
    yield ""


def growth_laws(run: Run) -> Iterator[str]:
    """A table of the exponents."""
    laws = [one for one in run["comparisons"] if "exponent" in one]
    if not laws:
        return
    yield "## Growth laws"
    yield ""
    yield "Processor time as a power of the size, fitted through the minima."
    yield ""
    yield "| work | sizes | exponent |"
    yield "|---|---|---|"
    for one in laws:
        sizes = ", ".join(f"{size:.3g}" for size in one["sizes"])
        yield f"| {one['title']} | {sizes} | {one['exponent']:.2f} |"
    yield ""


def section(one: Run) -> Iterator[str]:
    """One comparison as a table, and its notes."""
    if one["timings"]:
        load = " to ".join(f"{value:.1f}" for value in one["load"])
        yield f"**{one['title']}** ({one['rounds']} rounds, load {load})"
        yield ""
        yield "| | wall | processor | ratio |"
        yield "|---|---|---|---|"
        first = min(next(iter(one["timings"].values()))["processor_s"])
        for label, timing in one["timings"].items():
            wall, used = (span(timing[key]) for key in ("wall_s", "processor_s"))
            yield f"| {label} | {wall} | {used} | {min(timing['processor_s']) / first:.3g} |"
        yield ""
    for note in one["notes"]:
        yield f"- {note}"
    if one["notes"]:
        yield ""


def span(spans: list[float]) -> str:
    """Minimum and median with their unit."""
    scale, unit = (1e3, "ms") if statistics.median(spans) < 1.0 else (1.0, "s")
    return f"{scale * min(spans):.3g} / {scale * statistics.median(spans):.3g} {unit}"


def seconds(value: float) -> str:
    """A time with its unit."""
    return f"{value:.3g} s" if value >= 0.1 else f"{1e3 * value:.3g} ms"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
