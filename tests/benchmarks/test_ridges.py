"""Measuring the ridges of a map against finding its period and one FFT, in one run: `make benchmark` prints it."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from anisoscope.profiles.metrology.ridges import measure_ridges
from anisoscope.profiles.period import find_period

pytestmark = pytest.mark.benchmark
SOURCE = Path(__file__).resolve().parents[1] / "profiles" / "metrology" / "ridgesurfaces.py"


def truth(**numbers):
    spec = importlib.util.spec_from_file_location("ridgesurfaces_for_benchmark", SOURCE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Truth(**numbers)


# A period that was found once is remembered with its map: every call gets a map of its own.
@pytest.mark.parametrize("direction", [0.0, 30.0])
def test_measuring_a_million_points(bench, direction):
    surface = truth(direction=direction).surface(1)
    bench.compare(
        f"1000 × 1000 points, ridges at {direction:g}°",
        {
            "measure_ridges": lambda: measure_ridges(replace(surface)),
            "find_period": lambda: find_period(replace(surface)),
            "one FFT of the map": lambda: np.fft.rfft2(np.nan_to_num(surface.height_um)),
        },
    )


def test_ridges_grow_linearly_and_memory_of_sixteen_million_points(bench):
    surfaces = {side**2: truth(direction=12.0, shape=(side, side)).surface(1) for side in (1000, 2000, 4000)}
    works = {size: (lambda one=one: measure_ridges(replace(one))) for size, one in surfaces.items()}
    bench.growth("measure_ridges", "points", works)
    before = memory_mib("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here
    works[4000**2]()
    size = surfaces[4000**2].height_um.nbytes / 2**20
    bench.note(
        f"4000 × 4000 points: {(memory_mib('VmHWM') - before) / size:.1f} times the map of {size:.0f} MiB"
    )


def memory_mib(name):
    """A line of what the system says of this process."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name)) / 1024
