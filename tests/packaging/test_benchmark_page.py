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
