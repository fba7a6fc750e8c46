"""The same numbers on every processor: OpenBLAS picks its kernel by it, and its sums and eigenvectors differ."""

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

NEEDED = {"SkylakeX": "avx512f", "Haswell": "avx2", "Sandybridge": "avx", "Nehalem": "sse4_2"}
"""Kernels that differ, and the instructions of each; those of Zen are Haswell's."""
DECIDE = """
import json, sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info

from anisoscope.decision.consistency import scatter_of
from anisoscope.decision.reference_parts import GoldenPart, GoldenSet
from anisoscope.inspection.kept_measurement import read_kept
from anisoscope.inspection.manifest import reopen
from anisoscope.prediction.expectation import Component
from anisoscope.record.schema import read_record

folder = Path(sys.argv[1])
record, (_, job) = read_record(folder), reopen(folder)
kind, recipe, kept = job.kind, job.recipe, read_kept(folder, record)
expected = kind.predict(recipe, job.rig, cached=False)
logs, rng = np.log([pose.measured for pose in record.poses]), np.random.default_rng(4)
parts = [
    GoldenPart(serial=str(k), inspected_at=record.created_at, area_share=None, verdict="PASS",
               log_radiance=tuple(logs + 0.02 * rng.standard_normal(len(logs))))
    for k in range(3)
]
golden = GoldenSet(product=recipe.product, recipe_key="", poses=[(p.stage_deg, p.tilt_deg) for p in expected.poses],
                   parts=parts)
measured, alone = kind.decide_again(kept, recipe, expected, None)
_, decided = kind.decide_again(kept, recipe, expected, golden)
# poses that are equally noisy leave every basis of their contrasts to the library
noise = Component("noise", "measurement", np.full(len(logs), 0.003), shared=False)
even = kind.decide(None, recipe, expected, replace(measured, components=(noise,)), golden)
light = expected.convention.light_angle_deg
scatter = scatter_of(kind.part_scatter(recipe, light), replace(measured, components=(noise,)))
directions = decided.predictive.directions + even.predictive.directions
print(json.dumps({
    "kernels": sorted({(one["architecture"], one["num_threads"]) for one in threadpool_info()
                       if one["user_api"] == "blas"}),
    "verdicts": [one.verdict for one in (alone, decided, even)],
    "p": [one.p_value for one in (alone, decided, even, *directions)],
    "sizes": [alone.d2, decided.d2, even.d2] + [one.detectable for one in directions],
    "draws": scatter.drawn(scatter.shared(3, np.random.default_rng(1)), 4, rng).ravel().tolist(),
    "covariance": scatter.covariance.ravel().tolist(),
}))
"""


def _decided(folder: Path, kernel: str, threads: int) -> dict:
    left_out = {"OPENBLAS_L2_SIZE", "OMP_NUM_THREADS"}
    own = {"OPENBLAS_CORETYPE": kernel, "OPENBLAS_NUM_THREADS": str(threads)}
    env = {name: value for name, value in os.environ.items() if name not in left_out} | own
    command = [sys.executable, "-Ic", DECIDE, str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300.0, check=False, env=env)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def _kernels() -> list[str]:
    if platform.machine() not in ("x86_64", "AMD64"):
        pytest.skip("the kernels that are compared are those of x86-64")
    info = Path("/proc/cpuinfo")
    if not info.exists():
        pytest.skip("which kernels the processor can run is read from /proc/cpuinfo")
    flags = set(info.read_text(encoding="utf-8").split())
    return [kernel for kernel, needed in NEEDED.items() if needed in flags]


def test_an_inspection_is_decided_alike_on_every_processor_and_with_any_number_of_threads(virtual_rig):
    """Against the prediction and against three golden parts, whose p values come from draws."""
    kernels = _kernels()
    inspected = virtual_rig(recipe={"poses": {"angles_deg": [0, 45, 90, 135, 180]}}).inspect()
    first, *others = found = [
        _decided(inspected.folder, kernel, threads)
        for kernel, threads in [*((one, 1) for one in kernels), (kernels[0], 2)]
    ]
    ran = {tuple(kernel) for one in found for kernel in one.pop("kernels")}
    if len({name for name, _ in ran}) < 3:
        pytest.skip(f"this processor, or this build of numpy, runs the kernels {sorted(ran)} only")
    assert first["verdicts"][0] == inspected.record.verdict
    for other in others:
        assert other["verdicts"] == first["verdicts"]
        assert other["p"] == pytest.approx(first["p"], rel=1e-9, abs=1e-9)
        for name in ("sizes", "covariance"):
            assert other[name] == pytest.approx(first[name], rel=1e-9)
        assert other["draws"] == pytest.approx(first["draws"], rel=1e-9, abs=1e-12)
