"""A million inspections in either database: inserted, filtered, verified, exported once for real; times are printed."""

import csv
import json
import os
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from sqlalchemy import text

from anisoscope.history.filters import Filters
from anisoscope.history.rows import NewRow
from anisoscope.history.store import open_history

pytestmark = pytest.mark.soak
COUNT, AT_ONCE = int(os.environ.get("ANISOSCOPE_SOAK_ROWS", "1000000")), 5000
MOST_MIB = 150
START = datetime(2024, 1, 1, tzinfo=UTC)
VERDICTS = ("PASS",) * 47 + ("FAIL", "INCONCLUSIVE", "INVALID")
PRODUCTS = [f"ridged demo plate {number}, pitch 100 µm, ridge angle 10°" for number in range(5)]
NOT_THERE = {
    name: Filters(**{name: value}, limit=50)
    for name, value in {
        "product": "none",
        "recipe": "ffff",
        "cavity": "none",
        "station": "none",
        "operator": "none",
        "lot": "none",
        "serial": "none",
        "verdict": "none",
    }.items()
}
QUESTIONS = {
    "the latest 50": Filters(limit=50),
    "a lot": Filters(lot=f"LOT-{COUNT // 1000}"),
    "the latest failures of a product": Filters(product=PRODUCTS[2], verdict="FAIL", limit=50),
    "the latest of a recipe": Filters(recipe="1123", limit=50),
    "a week": Filters(
        since=START + timedelta(minutes=COUNT // 2), until=START + timedelta(days=7, minutes=COUNT // 2)
    ),
}


def new_row(number):
    off = (number * 7919 % 997) * 6e-5 - 0.03
    product = PRODUCTS[number % 5]
    return NewRow(
        created_at=START + timedelta(minutes=number),
        serial=f"PART-{number:07d}",
        product=product,
        recipe=f"{product} {number % 3}123456789ab",
        lot=f"LOT-{number // 500}",
        cavity=str(number % 8),
        station=f"line {number % 4}",
        operator=("M. Meier", "A. Schulz")[number % 2],
        verdict=VERDICTS[number % 50],
        reasons=("ln ratio 0° / 90°, tilt 0° deviates by -0.023 (tolerance ±0.25, guard band 0.084)",),
        folder=f"/data/inspections/PART-{number:07d}-20240101T000000Z",
        seal=sha256(str(number).encode()).hexdigest(),
        software="anisoscope 0.1.0",
        numbers={"ln 0-90": 2.1 + off, "u ln 0-90": 0.05, "deviation ln 0-90": off, "d2": 1.2, "p": 0.55},
    )


def took(work, repeats=1):
    """The least time of some runs, and what the last returned."""
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        found = work()
        times.append(time.perf_counter() - begun)
    return min(times), found


PEAK = """
from anisoscope.__main__ import main
try:
    main()
finally:
    with open("/proc/self/status") as status:
        print(next(line.split()[1] for line in status if line.startswith("VmHWM")))
"""
"""The command, which says its largest memory in kB at the end: that of a child by `wait4` begins with its parent's."""


def exported(place, option, path):
    """Run the command; its largest memory in MiB, and its time."""
    command = [sys.executable, "-Ic", PEAK, "export", option, str(path), "--history", place]
    begun = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, cwd=path.parent, check=False)
    assert done.returncode == 0, done.stderr
    return int(done.stdout.split()[-1]) / 1024, time.perf_counter() - begun


def test_a_million_inspections(place, tmp_path):
    def say(line):
        sys.stdout.write(f"\n{place.split(':')[0][-10:]}: {line}")

    with open_history(place) as history:
        begun = time.perf_counter()
        for start in range(0, COUNT, AT_ONCE):
            history.append_all([new_row(number) for number in range(start, start + AT_ONCE)])
        seconds = time.perf_counter() - begun
        say(f"{COUNT} added in {seconds:.0f} s")
        history.dispose(77, reviewer="Q", decision="accept", comment="burrs are allowed here")
        for name, filters in NOT_THERE.items():
            seconds, found = took(lambda filters=filters: history.rows(filters), repeats=5)
            say(f"a {name} that is not there: {seconds * 1e3:.1f} ms")
            assert found == []
        for name, filters in QUESTIONS.items():
            seconds, found = took(lambda filters=filters: history.rows(filters), repeats=3)
            say(f"{name}: {len(found)} rows in {seconds * 1e3:.0f} ms")
            assert found
        seconds, damage = took(history.verify_chain)
        say(f"verified in {seconds:.0f} s")
        assert damage == []
        if not history._database.is_sqlite:
            with history._database.reading() as connection:
                size = connection.scalar(text("SELECT pg_total_relation_size('inspections')"))
            say(f"{size / COUNT:.0f} bytes a row, indexes included")
    if Path(place).exists():
        say(f"{Path(place).stat().st_size / COUNT:.0f} bytes a row, indexes included")
    for option, name in (("--csv-file", "all.csv"), ("--json-file", "all.json"), ("--junit", "all.xml")):
        path = tmp_path / name
        mib, seconds = exported(place, option, path)
        say(f"export {option}: {seconds:.0f} s, {mib:.0f} MiB of memory, {path.stat().st_size >> 20} MiB")
        assert mib < MOST_MIB
        check(path)
        path.unlink()


def check(path):
    """The file holds every inspection, as another reader sees it."""
    if path.suffix == ".csv":
        with path.open(newline="") as stream:
            serials = [line["serial"] for line in csv.DictReader(stream)]
        assert serials == [f"PART-{number:07d}" for number in range(COUNT)]
    elif path.suffix == ".json":
        with path.open() as stream:
            assert next(stream) == "[\n"
            for number in range(COUNT):
                line = json.loads(next(stream).rstrip().removesuffix(","))
                assert line["serial"] == f"PART-{number:07d}"
            assert next(stream) == "]\n"
    else:
        count = 0
        for _, element in ET.iterparse(path):
            if element.tag == "testcase":
                count += 1
                element.clear()
        assert count == COUNT
