"""The page of the benchmarks, its trend, and what became slower: python tools/benchmark_page.py record|compare FILE.

``make benchmark`` writes the results of one run and compares its ratios with the median of the last three runs on
record; ``make benchmark-record`` adds a run to the record and writes the page.
"""

import csv
import json
import statistics
import sys
from collections.abc import Iterator
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


def span(seconds: list[float]) -> str:
    """Minimum and median with their unit."""
    scale, unit = (1e3, "ms") if statistics.median(seconds) < 1.0 else (1.0, "s")
    return f"{scale * min(seconds):.3g} / {scale * statistics.median(seconds):.3g} {unit}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
