"""A control-chart page over 100 000 inspections: limits, EWMA, Nelson's rules, capability, charts; times printed.

Two series: one that is stable, one that shifts so that nearly every value is flagged. `make benchmark` prints both; the
page is to take 2 s of one core. Processor time counts, so that neighbours on the machine do not.
"""

import time

import numpy as np
import pytest

from anisoscope.quality.capability import Specification
from anisoscope.quality.control import Settings, control_study
from anisoscope.report.spc_page import write_spc_page

pytestmark = pytest.mark.benchmark
COUNT = 100_000
WANTED_S = 2.0


@pytest.mark.parametrize("shift", [0.0, 6.0], ids=["stable", "all flagged"])
def test_a_page_over_a_hundred_thousand_inspections(tmp_path, shift):
    rng = np.random.default_rng(1)
    values = rng.normal(size=COUNT)
    values[1000:] += shift
    labels = tuple(f"SN-{k}" for k in range(COUNT))
    settings = Settings(baseline=1000)
    write_spc_page(
        tmp_path / "warm.html", "x", "y", *[[control_study("x", values[:50], labels[:50], Settings())]] * 2
    )
    started = time.process_time()
    study = control_study("ln 0-90", values, labels, settings, Specification(-9.0, 9.0))
    studied = time.process_time()
    write_spc_page(tmp_path / "page.html", "x", "y", [study], [study])
    done = time.process_time()
    size = (tmp_path / "page.html").stat().st_size
    print(
        f"\nspc over {COUNT} inspections, shift {shift:g}: {done - started:.2f} s (wanted {WANTED_S:g} s): statistics "
        f"{studied - started:.2f} s, page {done - studied:.2f} s, {size / 1e6:.2f} MB, {len(study.flags)} patterns"
    )
    assert done - started < WANTED_S
