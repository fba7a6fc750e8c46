"""A small, fast virtual rig: 512 × 512 pixels of 8 µm, a part of 1.2 mm, and a recipe with an ideal design."""

import fcntl
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from anisoscope.base.errors import CameraError
from anisoscope.calibration.pictures import take_flat
from anisoscope.inspection.objects import OBJECTS
from anisoscope.inspection.run import Inspected, Methods, inspect_part
from anisoscope.kinds.kind import Explanation
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.operations.demo.folder import FIXTURE
from anisoscope.record.schema import REPORT_NAME, read_record, write_record
from anisoscope.report.inspection_page import Sections
from anisoscope.rig.frame import Frame
from anisoscope.sim.bench.bench import Bench, shared_bench
from anisoscope.sim.bench.camera import SimulatedCamera

SPEC = importlib.util.spec_from_file_location("forkserver", Path(__file__).with_name("forkserver.py"))
FORKSERVER = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(FORKSERVER)
ForkServer = FORKSERVER.ForkServer
SPEC = importlib.util.spec_from_file_location("guard", Path(__file__).with_name("guard.py"))
GUARD = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(GUARD)
ONE_THREAD = FORKSERVER.ONE_THREAD
LOBE = {"alpha_along": 0.06, "alpha_across": 0.10, "albedo": 0.2, "index": 1.5}
EXPOSURE_S = 0.0015


def merged(base, changes):
    """A copy of a table with changes; a change of None takes the key away."""
    found = dict(base)
    for key, value in changes.items():
        if value is None:
            found.pop(key, None)
        elif isinstance(value, dict) and isinstance(found.get(key), dict):
            found[key] = merged(found[key], value)
        else:
            found[key] = value
    return found


RECIPE = {
    "schema": 1,
    "product": "ridged test plate",
    "surface": {"pitch_um": 100.0, "design": {"ridge_angle_deg": 10.0, "edge_radius_um": 0.0}},
    "material": {**LOBE, "u_tail": 0.0, "u_alpha_share": 0.03, "u_albedo": 0.006, "u_index": 0.005},
    "acquisition": {"exposure_s": EXPOSURE_S, "frames_per_pose": 2, "dark_frames": 2, "settle_s": 0.0},
    "region": {"size_mm": [1.0, 1.0]},
    "decision": {"tolerance": 0.25},
    "uncertainty": {"seating_tilt_deg": 0.05},
}
BENCH = {
    "schema": 1,
    "seed": 11,
    "sample": {
        "kind": "ridges",
        "size_mm": 1.2,
        "pitch_um": 100.0,
        "ridge_angle_deg": 10.0,
        "resolved_alpha": 0.0,
        "material": LOBE,
        "reflections": False,
    },
    "sensor": {"rows": 512, "cols": 512},
    "optics": {"pixel_um": 8.0, "blur_um": 5.0, "electrons": 2.4e7},
    "stage": {"time_scale": 0.0},
    "fixture": FIXTURE,
}
RIG = {
    "schema": 1,
    "name": "virtual rig",
    "stage": {
        "driver": "elliptec",
        "port": "sim://elliptec?bench=${here}/bench.toml",
        "zero_deg": 10.0,
        "options": {"move_gap_s": 0.0, "timeout_s": 0.2},
    },
    "camera": {"driver": "simulated", "pixel_um": 8.0, "options": {"bench": "${here}/bench.toml"}},
    "light": {"driver": "simulated", "angle_deg": 10.0, "options": {"bench": "${here}/bench.toml"}},
    "fixture": FIXTURE,
}


# Reflections take a quarter of the time of an inspection: on the small rig only tests of verdicts turn them on.
DIRECT = {"surface": {"reflections": "direct"}}


def write(path, table):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    return path


def one_line(record, *_):
    """A report of one line: drawing takes longer than all the rest of an inspection."""
    return record.verdict


PLAIN = Methods(start_renderer=lambda _: None, sections=lambda *_: Sections(), page=one_line)


@dataclass(frozen=True)
class VirtualRig:
    """Files of one part on the virtual rig, and how to inspect it."""

    recipe: Path
    rig: Path
    out: Path

    @property
    def bench(self) -> Bench:
        """The bench that the rig's devices share."""
        return shared_bench(self.rig.with_name("bench.toml"))

    @property
    def folders(self) -> list[Path]:
        """The folders of inspections."""
        found = self.out.iterdir() if self.out.exists() else ()
        return sorted(path for path in found if path.is_dir() and path.name != OBJECTS)

    def inspect(self, serial: str = "T-1", methods: Methods = PLAIN) -> Inspected:
        """Inspect the part; without ``methods`` its report is one line."""
        return inspect_part(self.recipe, self.rig, serial, self.out, methods=methods)

    def break_off(self, monkeypatch: pytest.MonkeyPatch, after: int) -> Path:
        """Inspect until the camera has given so many frames and fails; the folder that is left."""
        grab, count = SimulatedCamera.grab, []

        def fail(camera: SimulatedCamera) -> Frame:
            count.append(1)
            if len(count) > after:
                raise CameraError("the cable came off")
            return grab(camera)

        with monkeypatch.context() as patch:
            patch.setattr(SimulatedCamera, "grab", fail)
            with pytest.raises(CameraError, match="the cable came off"):
                self.inspect()
        (folder,) = self.folders
        return folder


def made_once(name: str, make: Callable[[Path], None]) -> Path:
    """A folder that all workers of this run share, filled by the first that needs it; the others wait for it.

    Args:
        name: of the folder.
        make: fills it; where it fails, the next one tries again.
    """
    folder = Path(os.environ["ANISOSCOPE_TEST_RUN"]) / name
    done = folder.with_name(f"{name}.done")
    with folder.with_name(f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            make(folder)
            done.touch()
    return folder


@pytest.fixture(scope="session", name="made_once")
def made_once_fixture() -> Callable[[str, Callable[[Path], None]], Path]:
    """``made_once(name, make)``: the folder that ``make(folder)`` fills once for all workers of a run."""
    return made_once


def small_white_reference(folder: Path) -> None:
    """White reference of the small rig."""
    write(folder / "bench.toml", merged(BENCH, {"sample": {"kind": "white-tile"}}))
    rig = write(folder / "rig.toml", RIG)
    take_flat(rig, folder / "flat.tif", exposure_s=EXPOSURE_S, frames=8)


@pytest.fixture(scope="session")
def flat() -> Path:
    """White reference of the small rig; not to be written to."""
    return made_once("flat", small_white_reference) / "flat.tif"


def lay_out_rig(folder: Path, flat: Path, *, recipe=None, bench=None, rig=None) -> VirtualRig:
    """Write the files of a part on the small rig, with changes to its files."""
    calibrated = merged(RIG, {"calibration": {"flat": str(flat)}})
    write(folder / "bench.toml", merged(BENCH, bench or {}))
    return VirtualRig(
        write(folder / "recipe.toml", merged(merged(RECIPE, DIRECT), recipe or {})),
        write(folder / "rig.toml", merged(calibrated, rig or {})),
        folder / "inspections",
    )


@pytest.fixture
def inspected_part(flat, tmp_path) -> tuple[VirtualRig, Inspected]:
    """The part as it is without changes, and its finished inspection: a copy of one that is made once for a run."""
    kept = made_once("inspected part", lambda folder: lay_out_rig(folder, flat).inspect() and None)
    folder = tmp_path / "part"
    shutil.copytree(kept, folder)
    rig = VirtualRig(folder / "recipe.toml", folder / "rig.toml", folder / "inspections")
    (finished,) = rig.folders
    return rig, Inspected(read_record(finished), finished, finished / REPORT_NAME)


def copy_of(base, folder, model, **changes):
    """A further inspection made of a finished one by hard links, with changes to its record, sealed anew."""
    shutil.copytree(base, folder, copy_function=os.link)
    for name in ("record.json", REPORT_NAME, "report.sha256"):
        (folder / name).unlink(missing_ok=True)
    write_record(model.model_copy(update=changes), folder)
    return folder


@pytest.fixture(scope="session", name="copy_of")
def copy_of_fixture():
    return copy_of


@pytest.fixture
def virtual_rig(tmp_path, flat) -> Callable[..., VirtualRig]:
    """``virtual_rig(recipe={...}, bench={...}, rig={...})`` lays out a rig with changes to its files."""

    return lambda name="part", **changes: lay_out_rig(tmp_path / name, flat, **changes)


@pytest.fixture(scope="module")
def virtual_rigs(tmp_path_factory, flat) -> Callable[..., VirtualRig]:
    """As `virtual_rig`, of rigs that all tests of a module use."""
    folder = tmp_path_factory.mktemp("rigs")
    return lambda name="part", **changes: lay_out_rig(folder / name, flat, **changes)


@pytest.fixture(scope="session")
def small_wafer_rig() -> Callable[[dict], dict]:
    """``small_wafer_rig(table)``: a rig or bench file of the demo's wafers with 512 × 512 pixels of 8 µm."""

    def small(table):
        for part in ("camera", "optics"):
            if part in table:
                table[part]["pixel_um"] = 8.0
        if "sensor" in table:
            table["sensor"] = {"rows": 512, "cols": 512}
            table["stage"] = {"time_scale": 0.0}
        return table

    return small


@pytest.fixture(scope="session")
def plain() -> Methods:
    """What varies in an inspection: a report of one line, all else as shipped, with its diagnosis."""
    return PLAIN


@pytest.fixture(scope="session")
def undiagnosed() -> Methods:
    """What varies where nothing is asked but the verdict: no diagnosis, and a report of one line."""
    return replace(PLAIN, diagnose=lambda *_: Explanation())


@pytest.fixture
def make_recipe() -> Callable[..., RidgeRecipe]:
    """``make_recipe(decision={...})`` gives the recipe of the small rig with changes."""
    return lambda **changes: RidgeRecipe.model_validate(merged(RECIPE, changes))


@pytest.fixture(scope="session")
def chromium_program() -> str:
    """Program of the browser: Chromium without windows takes a fifth of the time of the whole one for a new page."""
    found = shutil.which("chromium-headless-shell") or shutil.which("chromium")
    if found is None:
        pytest.skip("no chromium found (apt-get install chromium-headless-shell or chromium)")
    return found


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator of its own for every test."""
    return np.random.default_rng(20)


@dataclass
class Done:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        return json.loads(self.out)


@pytest.fixture(scope="session")
def guard():
    """Options and keys of JSON that users know."""
    return GUARD


@pytest.fixture(scope="session")
def json_watch():
    """Looks at the JSON of all commands that the tests run."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        yield GUARD.watch(monkeypatch)


@pytest.fixture(autouse=True)
def _no_key_comes_unseen(json_watch, request):
    json_watch.unknown.clear()  # of tests elsewhere, whose keys nobody lists
    yield
    if request.path.parent.name in GUARD.FOLDERS:
        json_watch.check()


@pytest.fixture(scope="session")
def anisoscope(json_watch):
    """Runs the real command line in a process of its own, which begins with everything imported.

    ``path`` are folders in which other packages are installed.
    """
    server = ForkServer(Path(os.environ["ANISOSCOPE_TEST_RUN"]))

    def run(*arguments, cwd=None, timeout=400, path=()):
        done = Done(*server.run(arguments, cwd, timeout, path))
        json_watch.printed(arguments, done.out)
        return done

    yield run
    server.close()


@pytest.fixture(scope="session")
def anisoscope_afresh():
    """Runs the real command line in a new interpreter."""

    def run(*arguments, cwd=None, timeout=400):
        command = [sys.executable, "-Im", "anisoscope", *map(str, arguments)]
        how = {"capture_output": True, "text": True, "env": os.environ | ONE_THREAD}
        done = subprocess.run(command, check=False, timeout=timeout, cwd=cwd, **how)
        return Done(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture(scope="session")
def demo(anisoscope):
    """A finished demo, made by one worker for all of them: folder, and what the command said."""

    def make(folder):
        done = anisoscope("demo", "--out", folder / "demo", "--json", timeout=550)
        assert done.code == 0, done.err
        (folder / "said.json").write_text(done.out)

    shared = made_once("demo", make)
    return shared / "demo", json.loads((shared / "said.json").read_text())


@pytest.fixture(scope="session")
def demo_folder(demo, tmp_path_factory):
    """A copy of a finished demo: recipe, rigs, flat, inspections."""
    mine = tmp_path_factory.mktemp("demo")
    shutil.copytree(demo[0], mine, dirs_exist_ok=True)
    return mine
