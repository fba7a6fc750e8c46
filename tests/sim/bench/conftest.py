import pytest
import tomli_w

from anisoscope.operations.demo.folder import FIXTURE
from anisoscope.sim.bench.bench import Bench
from anisoscope.sim.bench.benchfile import read_bench

SMALL = {
    "seed": 5,
    "sample": {"size_mm": 0.6},
    "sensor": {"rows": 288, "cols": 320, "hot_pixel_share": 0.0},
    "optics": {"pixel_um": 14.0, "blur_um": 8.0, "lamp_noise": 0.0},
    "stage": {"time_scale": 0.0},
    "fixture": FIXTURE,
}


@pytest.fixture
def bench_path(tmp_path):
    """``bench_path(sample={...})`` writes the file of a small bench, with changes to its tables, and gives its path."""

    def write(name="bench.toml", **changes):
        tables = {"schema": 1, **SMALL}
        for table, values in changes.items():
            merge = isinstance(values, dict) and table != "fixture"
            tables[table] = {**tables.get(table, {}), **values} if merge else values
        path = tmp_path / name
        path.write_text(tomli_w.dumps(tables), encoding="utf-8")
        return path

    return write


@pytest.fixture
def make_bench(bench_path):
    """``make_bench(sample={...})`` gives a small bench with changes to the tables of its file."""

    def make(**changes):
        return Bench(read_bench(bench_path(**changes)))

    return make
