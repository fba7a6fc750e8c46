"""Jobs at a virtual rig, in this process."""

import contextlib
import shutil

import pytest

from anisoscope.calibration.pictures import take_flat
from anisoscope.inspection.work import WorkerHere, Workplace
from anisoscope.line.jobs import Jobs
from anisoscope.operations.findings import explained
from anisoscope.operations.remembering import lot_mates, remember


@pytest.fixture(scope="module")
def place_of(virtual_rigs, undiagnosed):
    """``place_of(name, **changes)``: where a virtual rig inspects, and the folder of its recipes."""

    def make(name="part", **changes):
        rig = virtual_rigs(name, **changes)
        recipes = rig.recipe.parent / "recipes"
        recipes.mkdir(exist_ok=True)
        shutil.copy(rig.recipe, recipes / "plate.toml")
        history = rig.out / "history.sqlite"
        return Workplace(rig.rig, rig.out, history, remember, lot_mates, explained, undiagnosed), recipes

    return make


@pytest.fixture(scope="module")
def coarse(virtual_rigs):
    """Changes to the small rig: the same field with a quarter of the pixels, for long campaigns."""
    bench = {"sensor": {"rows": 274, "cols": 274}, "optics": {"pixel_um": 15.0}}
    camera = {"camera": {"pixel_um": 15.0}}
    white = virtual_rigs("white", bench=bench | {"sample": {"kind": "white-tile"}}, rig=camera).rig
    flat = white.with_name("flat.tif")
    take_flat(white, flat, exposure_s=0.0015, frames=8)
    return {"bench": bench, "rig": camera | {"calibration": {"flat": str(flat)}}}


@pytest.fixture
def jobs_at():
    """``jobs_at(place, recipes)``: its jobs, entered; and what was asked to stop."""
    with contextlib.ExitStack() as stack:

        def enter(place, recipes, worker=None):
            stops = []
            stop = lambda: stops.append(1) or {}  # noqa: E731
            jobs = stack.enter_context(Jobs(place, recipes, worker or WorkerHere(place), stop, "S1"))
            return jobs, stops

        yield enter
