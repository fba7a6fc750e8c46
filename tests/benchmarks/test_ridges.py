"""Measuring the ridges of a map against finding its period and one FFT, in one run: `make benchmark` prints it."""

import importlib.util
import resource
import time
from pathlib import Path

import numpy as np
import pytest

from anisoscope.profiles.metrology.ridges import measure_ridges
from anisoscope.profiles.period import find_period

pytestmark = pytest.mark.benchmark
REPEATS = 5
SOURCE = Path(__file__).resolve().parents[1] / "profiles" / "metrology" / "ridgesurfaces.py"


def truth(**numbers):
    spec = importlib.util.spec_from_file_location("ridgesurfaces_for_benchmark", SOURCE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Truth(**numbers)


def best(function):
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


@pytest.mark.parametrize("direction", [0.0, 30.0])
def test_measuring_a_million_points(direction):
    surface = truth(direction=direction).surface(1)
    measure_ridges(surface)  # compile
    whole, period = best(lambda: measure_ridges(surface)), best(lambda: find_period(surface))
    fft = best(lambda: np.fft.rfft2(np.nan_to_num(surface.height_um)))
    print(
        f"\n1000 × 1000 points, ridges at {direction:g}°: {whole:.3f} s, of which the period {period:.3f} s"
    )
    print(f"one FFT of the map: {fft:.3f} s; ratio {whole / fft:.1f}")


def test_processor_time_and_memory_of_sixteen_million_points():
    surface = truth(direction=12.0, shape=(4000, 4000)).surface(1)
    measure_ridges(surface)  # compile
    start = time.process_time()
    measure_ridges(surface)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(
        f"\n4000 × 4000 points: {time.process_time() - start:.1f} s of processor time; peak {peak / 1e6:.1f} GB"
    )
