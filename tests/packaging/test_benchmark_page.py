"""The tool that compares a run of the benchmarks with the record."""

import importlib.util
from pathlib import Path

import pytest

SPEC = importlib.util.spec_from_file_location(
    "benchmark_page", Path(__file__).resolve().parents[2] / "tools" / "benchmark_page.py"
)
page = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(page)
MACHINE = {
    "at": "2026-01-02T03:04:05+00:00",
    "commit": "abc",
    "processor": "P",
    "cores": 2,
    "python": "3",
    "libraries": {},
}


def run(ours, exponent):
    """A run with one comparison and one growth law."""
    timings = {
        label: {"wall_s": [s, 2.0 * s], "processor_s": [s, 2.0 * s], "calls": 1}
        for label, s in (("ours", ours), ("theirs", 1.0))
    }
    one = {
        "test": "test_a.py::b",
        "title": "work",
        "rounds": 2,
        "load": [0.0, 0.1],
        "timings": timings,
        "notes": ["n"],
    }
    law = one | {"title": "growth", "exponent": exponent, "sizes": [1.0, 10.0]}
    return {"machine": MACHINE | {"load_start": 0.0}, "comparisons": [one, law]}


@pytest.fixture
def recorded(tmp_path, monkeypatch):
    """Four runs on record, the oldest of them slow."""
    monkeypatch.setattr(page, "TREND", tmp_path / "trend.csv")
    monkeypatch.setattr(page, "PAGE", tmp_path / "page.md")
    for ours in (9.0, 0.5, 0.51, 0.6):
        page.record(run(ours, 1.0))


@pytest.mark.parametrize(
    ("ours", "exponent", "named"),
    [(0.6, 1.1, []), (0.62, 1.1, ["work, theirs"]), (0.5, 1.3, ["growth, exponent"])],
)
def test_what_is_a_fifth_slower_than_the_last_three_on_record_is_named(recorded, ours, exponent, named):
    found = list(page.slower(run(ours, exponent), page.trend()))
    assert [line.split(":")[0] for line in found] == named


def test_the_page_states_ratios_and_growth_laws(recorded):
    text = page.PAGE.read_text(encoding="utf-8")
    assert "| growth | 1, 10 | 1.00 |" in text
    assert "| theirs | 1 / 1.5 s | 1 / 1.5 s | 1.67 |" in text


def test_goals_say_what_was_reached_and_what_limits_the_rest():
    found = run(0.6, 1.0)
    goals = {
        ("ours", 1.0, None): "| w | ≤ 1 s | 0.6 s (wall) | met |",
        ("ours", 0.05, None): "| w | ≤ 50 ms | 0.6 s (wall) | missed: why |",
        ("ours", 1.5, "theirs"): "| w | ≥ 1.5 × | 1.67 × (wall) | met |",
        ("others", 1.0, None): "| w | ≤ 1 s | not measured in this run | |",
    }
    for (label, goal, against), row in goals.items():
        assert page.Goal("w", "work", label, goal, against=against, limit="why").row(found) == row
    assert "| growth | 1, 10 | 1.00 |" in page.page(found)


def test_every_goal_names_a_comparison_of_the_benchmarks():
    """Titles and labels are those that benchmarks give, as far as these are literals."""
    folder = Path(__file__).resolve().parents[1] / "benchmarks"
    text = "".join(path.read_text(encoding="utf-8") for path in folder.glob("test_*.py"))
    for goal in page.GOALS:
        for named in (goal.label, goal.against, goal.less):
            known = named is None or named[0].isdigit() or named.startswith("Mitsuba") or f'"{named}"' in text
            assert known, goal
