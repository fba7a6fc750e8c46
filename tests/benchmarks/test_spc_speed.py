"""A control-chart page over 100 000 inspections: limits, EWMA, Nelson's rules, capability, charts; times printed.

Two series: one that is stable, one that shifts so that nearly every value is flagged. `make benchmark` prints both; the
page is to take 2 s of one core. Processor time counts, so that neighbours on the machine do not.
"""

import math
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from hashlib import sha256

import numpy as np
import pytest

from anisoscope.history.rows import NewRow
from anisoscope.history.store import open_history
from anisoscope.quality.capability import Specification
from anisoscope.quality.control import Settings, control_study
from anisoscope.quality.limits import individuals
from anisoscope.report.spc_page import write_spc_page

pytestmark = pytest.mark.benchmark
COUNT = 100_000
WANTED_S = 2.0


@pytest.mark.parametrize("shift", [0.0, 6.0], ids=["stable", "all flagged"])
def test_a_page_over_a_hundred_thousand_inspections(bench, tmp_path, shift):
    rng = np.random.default_rng(1)
    values = rng.normal(size=COUNT)
    values[1000:] += shift
    labels = tuple(f"SN-{k}" for k in range(COUNT))
    settings = Settings(baseline=1000)

    def page():
        study = control_study("ln 0-90", individuals(values, labels), settings, Specification(-9.0, 9.0))
        write_spc_page(tmp_path / "page.html", "x", "y", [study], [(study, None, None)])
        return study

    found = bench.compare(
        f"{COUNT} inspections, shift {shift:g}",
        {
            "statistics and page": page,
            "statistics": lambda: control_study(
                "ln 0-90", individuals(values, labels), settings, Specification(-9.0, 9.0)
            ),
        },
        rounds=3,
    )
    size, study = (tmp_path / "page.html").stat().st_size, found["statistics and page"].result
    bench.note(f"page {size / 1e6:.2f} MB, {len(study.flags)} patterns")
    assert min(found["statistics and page"].processor_s) < WANTED_S


def start_of(number):
    """The made-up inspection with a number."""
    contrasts = {}
    for pair in ("0-90", "90-180"):
        off = 0.03 * math.sin(12.9898 * number * number)
        contrasts |= {f"ln {pair}": 2.0 + off, f"u ln {pair}": 0.05, f"deviation ln {pair}": off}
        contrasts[f"tolerance ln {pair}"] = 0.25
    return NewRow(
        created_at=datetime(2024, 1, 1, tzinfo=UTC) + timedelta(minutes=number),
        serial=f"PART-{number:06d}",
        product="ridged plate",
        recipe="ridged plate 0123456789ab",
        lot=f"LOT-{number // 500}",
        verdict="PASS",
        reasons=("all is well",),
        folder=f"/inspections/PART-{number:06d}",
        seal=sha256(str(number).encode()).hexdigest(),
        software="anisoscope",
        numbers=contrasts | {"d2": 1.2, "p": 0.55},
    )


def command(*words):
    """A whole command, from its start to its end."""
    line = [sys.executable, "-Im", "anisoscope", *map(str, words)]

    def work():
        done = subprocess.run(line, capture_output=True, text=True, check=False)
        assert done.returncode in {0, 1}, done.stderr

    return work


def test_the_command_over_a_history_of_a_hundred_thousand_inspections(bench, tmp_path):
    """From the shell to the page; the alternative reads whole rows and writes them as CSV."""
    place = tmp_path / "history.sqlite"
    with open_history(place) as history:
        for start in range(0, COUNT, 5000):
            history.append_all([start_of(number) for number in range(start, start + 5000)])
    few = tmp_path / "few.csv"
    few.write_text("x\n" + "\n".join(str(math.sin(number)) for number in range(50)))
    page = tmp_path / "page.html"
    found = bench.compare(
        f"spc --html over a history of {COUNT}",
        {
            "spc": command("spc", "-n", "ln 0-90", "--history", place, "--html", page),
            "spc of 50 values": command("spc", "--csv", few, "--html", page),
            "export of the rows": command(
                "export", "--history", place, "--csv-file", tmp_path / "all.csv", "--limit", 0
            ),
        },
        rounds=3,
        warm=False,
    )
    assert min(found["spc"].processor_s) - min(found["spc of 50 values"].processor_s) < WANTED_S
    assert found.ratio("export of the rows", "spc") > 1.0
