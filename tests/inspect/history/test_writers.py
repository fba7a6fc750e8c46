"""Several processes write at once; some of them are killed while they do."""

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from anisoscope.history.store import open_history

PROGRAM = Path(__file__).with_name("writing.py")


def run(*arguments):
    command = [sys.executable, "-I", PROGRAM, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=900)
    assert done.returncode == 0, done.stderr
    return done.stdout


def all_at_once(place, workers, count):
    run("add", place, workers, count)
    with open_history(place) as history:
        rows = history.rows()
        assert history.verify_chain() == []
    expected = {f"W{worker}-{number}" for worker in range(workers) for number in range(count)}
    assert Counter(row.serial for row in rows) == Counter(expected)
    assert sorted(row.id for row in rows) == list(range(1, workers * count + 1))
    assert all(row.numbers[f"ln 0-{row.station[-1]}"] == float(row.serial[3:]) for row in rows)


def test_four_processes_make_one_chain(place):
    all_at_once(place, 4, 25)


@pytest.mark.soak
def test_four_processes_with_five_hundred_each(place):
    all_at_once(place, 4, 500)


def killed(place, times, seed):
    saved = json.loads(run("kill", place, times, seed))
    with open_history(place) as history:
        assert history.verify_chain() == []
        rows = history.rows()
    seals = {row.seal for row in rows}
    assert len(saved) == len(set(saved))
    assert set(saved) <= seals
    assert len(seals) - len(saved) <= times  # saved, but killed before it could be said
    for row in rows:  # none of them half
        assert (len(row.numbers), row.reasons, row.verdict) == (2, ("all is well",), "PASS")
    return saved


def test_what_was_reported_as_saved_outlives_kill_9(place):
    assert killed(place, 12, seed=3)


@pytest.mark.soak
def test_a_hundred_kills(place):
    assert len(killed(place, 100, seed=4)) > 100
