"""Yield of a lot: growth with the parts; one process, two, and a local Dask cluster of two workers."""

import itertools

import numpy as np
import pytest

from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.parameters.workers import Workers
from anisoscope.study.lot import Lot, Spread
from anisoscope.study.part_yield import part_yield

pytestmark = pytest.mark.benchmark
RECIPE = RidgeRecipe.model_validate(
    {
        "schema": 1,
        "product": "plate",
        "acquisition": {"exposure_s": 0.01},
        "region": {"size_mm": [2.0, 2.0]},
        "surface": {"pitch_um": 100.0, "design": {"ridge_angle_deg": 10.0}},
        "material": {"alpha_along": 0.06, "alpha_across": 0.1, "albedo": 0.2},
        "decision": {"tolerance": 0.6},
    }
)
TRIM = "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_"
"""At Dask's 64 kB every block of our arrays faults its pages in again, in all processes started after the cluster."""
SEED = itertools.count(1)
"""Every call draws other parts: predictions of the same ones are remembered."""


def lot(parts=1000):
    spread = Spread(ridge_angle=0.3, alpha=0.1, albedo=0.03, seating=0.1)
    return Lot(RECIPE, 10.0, spread, parts=parts, rigs=parts // 40)


def test_parts_through_prediction_measurement_and_verdict(bench):
    works = {
        parts: (lambda parts=parts: part_yield(lot(parts), Workers(1), next(SEED)))
        for parts in (125, 500, 2000)
    }
    exponent = bench.growth("toleranced parts to verdicts, three poses", "parts", works, rounds=2)
    assert exponent == pytest.approx(1.0, abs=0.15)


def test_one_process_two_and_a_cluster(bench):
    distributed = pytest.importorskip("distributed", reason="the extra [cluster] is not installed")
    dask = pytest.importorskip("dask", reason="comes with the extra [cluster]")
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with dask.config.set({TRIM: 2**28}), distributed.LocalCluster(**options) as cluster:
        ways = {
            "one process": Workers(1),
            "two processes": Workers(2),
            "Dask cluster of two workers": Workers(scheduler=cluster.scheduler_address),
        }
        found = bench.compare(
            "1000 toleranced parts to verdicts",
            {name: lambda way=way: part_yield(lot(), way, next(SEED)) for name, way in ways.items()},
            rounds=3,
        )
        alone, *others = (part_yield(lot(80), way, 1) for way in ways.values())
        for other in others:  # Dask gives BLAS one thread, so that sums are rounded otherwise
            assert other.verdicts == alone.verdicts
            means = [[contrast.mean for contrast in each.contrasts] for each in (alone, other)]
            np.testing.assert_allclose(means[1], means[0], rtol=1e-9, atol=1e-9)
    one, two, three = ways
    bench.note(
        f"on the clock two processes are {found.wall_ratio(one, two):.2f} times as fast as one, the cluster "
        f"{found.wall_ratio(one, three):.2f} times"
    )
