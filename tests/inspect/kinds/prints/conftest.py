"""Prints without a rig (channels from the model), and a small colour rig: 448 × 448 pixels of 9 µm."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import tomli_w

from anisoscope.calibration.pictures import take_flat
from anisoscope.inspection.run import Inspected, Methods, inspect_part
from anisoscope.kinds.prints.decision import decide_print
from anisoscope.kinds.prints.expectation import expect_print
from anisoscope.kinds.prints.measurement import MeasuredPrint, cell_grid
from anisoscope.kinds.prints.model import State
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.reference_prints import GoldenPrint, GoldenPrints, ViewingConditions
from anisoscope.kinds.prints.sources import of_each
from anisoscope.operations.demo import prints as demo_print
from anisoscope.record.schema import REPORT_NAME, read_record
from anisoscope.sim.materials.spectra import find_illuminant, find_sensitivities

EXPOSURE_S = 0.004
PIXELS, PIXEL_UM = 448, 9.0
RECIPE = {
    "schema": 1,
    "product": "test print",
    "print": {"ink": "synthetic-green", "wrong_inks": ["synthetic-red", "synthetic-blue"]},
    "acquisition": {"exposure_s": 0.005},
    "region": {"size_mm": [2.0, 2.0]},
}
GRAIN = 0.005


def merged(base, changes):
    """A copy of a table with changes."""
    found = dict(base)
    for key, value in changes.items():
        inner = isinstance(value, dict) and isinstance(found.get(key), dict)
        found[key] = merged(found[key], value) if inner else value
    return found


@pytest.fixture(scope="session")
def make_recipe():
    """``make_recipe(poses={...})`` gives a recipe with changes."""
    return lambda **changes: PrintRecipe.model_validate(merged(RECIPE, changes))


@pytest.fixture(scope="session")
def predict():
    """What a recipe predicts for a white LED and a colour camera."""
    lamp, camera = find_illuminant("led-white"), find_sensitivities("synthetic", "rggb")
    return lambda recipe: expect_print(recipe, 10.0, lamp, camera)


@pytest.fixture(scope="session")
def good(make_recipe, predict):
    """The usual recipe, and what it predicts."""
    recipe = make_recipe()
    return recipe, predict(recipe)


def golden_prints(recipe, expected, rows):
    """A set of these rows."""
    parts = tuple(
        GoldenPrint(
            serial=f"G-{k}",
            inspected_at="2026-01-01T00:00:00Z",
            log_channels=tuple(map(tuple, row.reshape(-1, 3).tolist())),
            area_share=0.0,
            verdict="PASS",
        )
        for k, row in enumerate(rows)
    )
    seen = ViewingConditions(
        ink="synthetic green", lamp="led-white", sensitivities="synthetic", filters="rggb"
    )
    poses = tuple((pose.stage_deg, pose.tilt_deg) for pose in expected.poses)
    return GoldenPrints(
        product="test print", recipe_key=GoldenPrints.key_of(recipe), seen=seen, poses=poses, parts=parts
    )


@pytest.fixture(scope="session")
def golden_of():
    """``golden_of(recipe, expected, rows)`` is a set of golden prints."""
    return golden_prints


class Sheet:
    """A print as a perfect camera measures it, with the grain of its ink and what one may do to it."""

    def __init__(self, recipe, expected, rng):
        self.recipe, self.expected, self.rng = recipe, expected, rng
        self.grid = cell_grid(recipe)
        self.states = np.full(self.grid.shape, None, dtype=object)

    def all(self, state):
        """Every cell in one state."""
        self.states[:] = state
        return self

    def curled(self, range_deg):
        """Tilt toward +x grows across the columns."""
        count = self.grid.shape[1]
        for column in range(count):
            tilt_deg = range_deg * ((column + 0.5) / count - 0.5)
            self.states[:, column] = State(tilt_x_deg=tilt_deg)
        return self

    def spotted(self, rows, cols, missing):
        """Some ink is missing in a block of cells."""
        self.states[rows, cols] = State(missing=missing)
        return self

    def measured(self, other=None):
        """Channels and cells, `other` mixed in where the states say so."""
        scene = replace(self.expected.scene, other=other)
        seen = {}
        cells = np.empty((*self.grid.shape, *self.expected.channels.shape))
        for place in np.ndindex(self.grid.shape):
            state = self.states[place] or State()
            if state not in seen:
                seen[state] = scene.channels(state)
            cells[place] = seen[state]
        cells = np.moveaxis(cells, (0, 1), (2, 3))
        cells = cells * np.exp(GRAIN * self.rng.standard_normal(self.grid.shape))
        noise = np.full(cells.shape[:2], 0.002)
        cells = cells * np.exp(0.002 * self.rng.standard_normal(cells.shape))
        own = of_each("noise of camera and photons", "measurement", np.full(cells[:, :, 0, 0].size, 2e-4))
        return MeasuredPrint(cells.mean(axis=(2, 3)), cells, noise, (own,), self.grid, 0.001)

    def decided(self, other=None):
        """Measured, and judged."""
        measured = self.measured(other)
        return measured, decide_print(self.expected, measured, self.recipe)


@pytest.fixture
def sheet(good):
    """A good print to be spoiled."""
    return Sheet(*good, np.random.default_rng(5))


class PrintRig:
    """A print on the small colour rig."""

    def __init__(self, folder, flat, seed, methods=None):
        self.folder, self.flat, self.seed, self.methods = folder, flat, seed, methods

    def lay_out(self, defects, *, recipe=None, bench=None, name="print"):
        """Write the files of a print with defects; paths of recipe and rig file."""
        here = self.folder / name
        here.mkdir(parents=True)
        part = {"substrate": 0.04, "ink": "synthetic-green"} | defects
        sample = {"kind": "print", "size_mm": 2.4, "print": part}
        content = merged(small_bench(sample, self.seed), bench or {})
        (here / "bench.toml").write_text(tomli_w.dumps(content))
        rules = merged(small_recipe(), recipe or {})
        (here / "recipe.toml").write_text(tomli_w.dumps(rules))
        (here / "rig.toml").write_text(tomli_w.dumps(small_rig(str(self.flat))))
        return here / "recipe.toml", here / "rig.toml"

    def inspect(self, defects, *, drawn=False, **changes):
        """Photograph and judge a print; the report is one line unless it is to be ``drawn``."""
        recipe, rig = self.lay_out(defects, **changes)
        methods = Methods() if drawn else self.methods
        return inspect_part(recipe, rig, "P-1", self.folder / "inspections", methods=methods)


def small_bench(sample, seed):
    """A bench with a small colour camera that collects as much light as a large one."""
    found = demo_print.bench_of(sample, seed)
    found["sensor"] |= {"rows": PIXELS, "cols": PIXELS}
    found["optics"] |= {"pixel_um": PIXEL_UM, "blur_um": 5.0, "electrons": 1.2e7, "axis_px": [1.5, -1.0]}
    return found | {"stage": {"time_scale": 0.0}}


def small_rig(flat=None):
    """The rig file of such a bench."""
    found = demo_print.rig_of(flat)
    found["camera"]["pixel_um"] = PIXEL_UM
    return found


def small_recipe():
    """Few poses, two exposures."""
    return merged(
        demo_print.recipe_of("synthetic-green"),
        {
            "poses": {"tilts_deg": [0.0, 10.0, 20.0]},
            "acquisition": {"exposure_s": EXPOSURE_S, "dark_frames": 2},
            "area": {"cell_mm": 0.2},
        },
    )


def colour_white_reference(folder):
    """White reference of the small colour rig."""
    sample = {"kind": "white-tile", "reflectance": 0.99}
    (folder / "bench.toml").write_text(tomli_w.dumps(small_bench(sample, 3)))
    (folder / "rig.toml").write_text(tomli_w.dumps(small_rig()))
    take_flat(folder / "rig.toml", folder / "flat.tif", exposure_s=0.006, frames=8)


@pytest.fixture(scope="session")
def colour_flat(made_once):
    """White reference of the small colour rig; not to be written to."""
    return made_once("colour flat", colour_white_reference) / "flat.tif"


@pytest.fixture
def print_rig(tmp_path, colour_flat, plain):
    """A small colour rig: ``print_rig.inspect({"alpha_share": 0.1})``."""
    return PrintRig(tmp_path, colour_flat, 12, plain)


@pytest.fixture
def good_print(print_rig, made_once):
    """A good print on the rig of `print_rig`, inspected with its report drawn: a copy of one that is made once."""

    def make(folder):
        PrintRig(folder, print_rig.flat, print_rig.seed).inspect({}, drawn=True)

    shutil.copytree(made_once("good print", make), print_rig.folder, dirs_exist_ok=True)
    (record,) = (print_rig.folder / "inspections").glob("*/record.json")
    folder = record.parent
    return Inspected(read_record(folder), folder, folder / REPORT_NAME)
