"""Guided work by the interface of programs: what every guide asks, does and finds, and what it leaves."""

import json
import shutil
import tomllib

import httpx
import numpy as np
import pytest

from anisoscope.base.progress import silent
from anisoscope.calibration.corrections import list_calibrations
from anisoscope.calibration.pictures import take_flat
from anisoscope.cli import run
from anisoscope.commissioning.commissioning import changes_of, update_rig_file
from anisoscope.commissioning.record import default_record_path, read_commissioning
from anisoscope.console.access import Session
from anisoscope.console.guided import STATE, Guided, commission_rig, guides
from anisoscope.inspection.recipe_store import recipe_entry
from anisoscope.inspection.work import Workplace
from anisoscope.kinds.registry import kind_of
from anisoscope.recipe.material_file import read_material_file
from anisoscope.record.schema import read_record
from anisoscope.rig.rigfile import read_rig


class Guiding:
    """A client that does guided work."""

    def __init__(self, address, station):
        self.client = httpx.Client(base_url=f"{address}/api/v1", timeout=60)
        self.client.headers["X-CSRF-Token"] = self.client.get("/session").json()["token"]
        self.station = station

    def begin(self, key, why="shift start", recipe="plate", **values):
        return self.client.post(
            "/guides/begin", json={"key": key, "recipe": recipe, "why": why, "values": values}
        )

    def step(self):
        """Do a step; the state after it."""
        answer = self.client.post("/guides/step")
        assert answer.status_code == 200, answer.text
        self.station._busy.join()
        return self.client.get("/status").json()

    def all_steps(self):
        """Do all steps; what was asked before each, and the state at the end."""
        asked, state = [], self.client.get("/status").json()
        while state["guide"]["at"] < state["guide"]["of"]:
            asked.append(state["guide"]["ask"])
            at, state = state["guide"]["at"], self.step()
            assert state["failure"] is None, state["failure"]
            assert state["guide"]["at"] == at + 1, state["guide"]["results"]
        return asked, state

    def end(self):
        assert self.client.post("/guides/end").status_code == 200
        assert self.client.post("/release").status_code == 200
        self.client.close()


@pytest.fixture(scope="module")
def at(station_at):
    return station_at("guided")[0]


@pytest.fixture
def guiding(served, app_of, at):
    with served(app_of(at)) as address:
        found = Guiding(address, at)
        yield found
        found.end()


def test_flat_and_dark_by_steps(served, app_of, station_at):
    at = station_at("tile", bench={"sample": {"kind": "white-tile"}})[0]
    with_own_flat(at.place.rig)
    with served(app_of(at)) as address:
        guiding = Guiding(address, at)
        check_flat_and_dark(guiding, at)
        guiding.end()


def with_own_flat(rig):
    """The flat of a virtual rig is shared by all tests: this one, which takes it anew, gets a copy."""
    text = rig.read_text(encoding="utf-8")
    named = tomllib.loads(text)["calibration"]["flat"]
    shared = (rig.parent / named).resolve()
    own = shutil.copytree(shared.parent, rig.parent / "own flat")
    assert named in text
    rig.write_text(text.replace(named, str(own / shared.name)), encoding="utf-8")


def check_flat_and_dark(guiding, at):
    assert guiding.begin("flat", reflectance="0.98").status_code == 200
    assert guiding.begin("rotation").status_code == 409, "one at a time"
    asked = [guiding.client.get("/status").json()["guide"]["ask"]]
    guiding.step()
    guiding.step()
    bench = at.place.rig.with_name("bench.toml")
    bench.write_text(bench.read_text(encoding="utf-8").replace("white-tile", "none"), encoding="utf-8")
    rest, state = guiding.all_steps()
    assert asked[0].startswith("Place the white tile")
    assert rest[0].startswith("Seat the fixture")
    assert [one["good"] for one in state["guide"]["results"]] == [True, True, True]
    assert (at.place.rig.parent / "fixture.json").is_file()
    assert "Name dark.json in the rig file" in state["guide"]["results"][1]["notes"][0]
    flat = next(one for one in list_calibrations(at.place.rig) if one.kind == "flat")
    assert flat.state == "valid"
    dark = json.loads((at.place.rig.parent / "dark.json").read_text())
    assert dark["operator"] == "this computer"
    begun = [line for line in at._trail.lines() if line["what"] == "guided work"]
    assert (begun[-1]["why"], begun[-1]["more"]["reflectance"]) == ("shift start", "0.98")


def test_the_rotation_by_steps(guiding, at):
    guiding.begin("rotation")
    _, state = guiding.all_steps()
    assert state["guide"]["results"][-1]["rows"]
    assert (at.place.rig.parent / "rotation.json").is_file()


def test_the_fixture_by_steps(guiding, at):
    guiding.begin("fixture")
    asked, state = guiding.all_steps()
    assert asked[0].startswith("Seat the fixture, empty or with a part")
    found = state["guide"]["results"][-1]
    assert found["rows"][0][0] == "white"
    assert "Name fixture.json in the rig file" in found["notes"][0]
    assert (at.place.rig.parent / "fixture.json").is_file()


Z_MM = 10.0


def test_the_focus_by_steps(served, app_of, station_at):
    z = {"driver": "zaber", "port": "sim://zaber?bench=${here}/bench.toml", "zero_mm": Z_MM}
    z |= {"options": {"counts_per_mm": 1000.0 / 0.047625}}
    bench = {"sensor": {"rows": 96, "cols": 96}, "z": {"protocol": "zaber", "zero_mm": Z_MM}}
    at = station_at("z", bench=bench, rig={"z": z})[0]
    with served(app_of(at)) as address:
        guiding = Guiding(address, at)
        assert "focus" in [one["key"] for one in guiding.client.get("/guides").json()]
        for low, high in (("x", "11"), ("11", "9"), ("9", "nan")):
            assert guiding.begin("focus", low=low, high=high).status_code == 409
        assert guiding.begin("focus", low="9.2", high="10.9").status_code == 200
        asked, state = guiding.all_steps()
        assert "z moves" in asked[0]
        found = float(
            state["guide"]["results"][0]["notes"][0].removeprefix("z in focus at ").removesuffix(" mm")
        )
        assert found == pytest.approx(Z_MM, abs=0.01)
        guiding.end()


def test_without_z_no_focus_is_offered_and_a_search_is_refused(guiding):
    assert "focus" not in [one["key"] for one in guiding.client.get("/guides").json()]
    guiding.begin("focus", low="9", high="11")
    assert "no table [z]" in guiding.step()["failure"]["text"]


def test_golden_parts_are_inspected_and_added(guiding, at):
    guiding.begin("golden", parts="G-1, G-2")
    asked, _ = guiding.all_steps()
    assert asked[:2] == [f"Place the good part G-{n} on the stage." for n in (1, 2)]
    recipe = at.recipe_path("plate")
    kind = kind_of(recipe)
    known = kind.read_reference(recipe.with_suffix(".golden.json"), kind.read_recipe(recipe))
    assert [one.serial for one in known.parts] == ["G-1", "G-2"]
    recipe.with_suffix(".golden.json").unlink()


def test_a_gauge_study_is_blind_in_random_order_and_ends_as_the_command_does(guiding, at, capsys):
    guiding.begin("gauge", parts="P-1, P-2", appraisers="Anna, Bo", trials="2", number="", tolerance="0.5")
    state = guiding.client.get("/status").json()
    asked = []
    while state["guide"]["at"] < 8:
        asked.append(state["guide"]["ask"])
        state = guiding.step()
        assert state["verdict"] is None
        assert state["guide"]["results"][-1]["rows"][0][1] == "measured"
    every = sorted(
        f"{who} measures: place part {part} on the stage."
        for who in ("Anna", "Bo")
        for part in ("P-1", "P-2")
    )
    assert sorted(asked) == sorted(2 * every)
    assert sorted(asked[:4]) == every, "a trial is complete before the next"
    again = Guided(at.place.out, at.recipes_folder)
    assert again.shown(again.state) == at._guided.shown(at._guided.state), (
        "the end of the server does not end it"
    )
    state = guiding.step()
    table = state["guide"]["results"][-1]["rows"]
    (lot,) = {read_record(at.place.out / folder).particulars.lot for folder in at._guided.state.folders}
    code = run(
        ["msa", "gauge", "--lot", lot, "--tolerance", "0.5", "--history", str(at.place.history), "--json"]
    )
    said = json.loads(capsys.readouterr().out)
    assert state["guide"]["results"][-1]["good"] == (code == 0)
    shown, computed = float(table[1][1]), said["components"]["gauge R&R"]["sigma"]
    assert table[1][0] == "gauge R&R"
    np.testing.assert_allclose(shown, computed, rtol=0.01)


@pytest.mark.parametrize(
    ("key", "values", "text"),
    [
        ("flat", {"reflectance": "white"}, "takes a number above 0"),
        ("flat", {"reflectance": ""}, "nothing was entered"),
        ("golden", {"parts": "A"}, "at least 2 names"),
        ("golden", {"parts": "A, A"}, "each once"),
        ("golden", {"parts": "A, <b>"}, "<b>"),
        ("gauge", {"parts": "A,B", "appraisers": "C", "trials": "1"}, "2 to 20 trials"),
        ("gauge", {"parts": "A,B", "appraisers": "C", "trials": "1e9"}, "2 to 20 trials"),
        ("material", {"name": "../../etc/passwd"}, "the name of a material"),
        ("nothing", {}, "key"),
    ],
)
def test_what_cannot_be_entered_is_one_line(guiding, key, values, text):
    answer = guiding.begin(key, **values)
    assert answer.status_code in {409, 422}
    assert text in answer.json()["error"]
    assert guiding.client.get("/status").json()["guide"] is None


def test_reasons_recipes_and_roles_are_asked_for(guiding, at):
    assert guiding.begin("rotation", why="").status_code == 422
    assert guiding.begin("rotation", recipe="../rig").status_code == 409
    assert guiding.client.post("/guides/step").status_code == 409
    operator = Session("o", "t", "an operator", frozenset({"operator"}))
    for key, guide in guides().items():
        assert operator.may(guide.needs) == (key in {"flat", "rotation", "fixture", "gauge", "focus"})


def test_a_damaged_file_of_a_guide_is_left_alone(at):
    at.place.out.mkdir(parents=True, exist_ok=True)  # a station without an inspection has none yet
    for text in ("{", '{"key": "gauge"}', "\x00"):
        (at.place.out / STATE).write_text(text)
        assert Guided(at.place.out, at.recipes_folder).state is None
    (at.place.out / STATE).unlink()


@pytest.mark.soak
def test_commissioning_by_steps(served, app_of, station_at):
    at = station_at("commissioned")[0]
    with served(app_of(at)) as address:
        guiding = Guiding(address, at)
        guiding.begin("commissioning", why="new lens")
        _, state = guiding.all_steps()
        guiding.end()
    found = state["guide"]["results"]
    assert found[-1]["rows"][0][0] == "white"
    assert read_rig(at.place.rig).calibration.fixture == at.place.rig.parent / "fixture.json"
    assert "angle between light and camera" in {row[0] for row in found[0]["rows"]}
    record = read_commissioning(default_record_path(at.place.rig))
    (pixel,) = [one.value for one in record.findings if one.key.endswith("pixel_um")]
    assert pixel == pytest.approx(8.0, rel=0.01)  # of the bench


@pytest.mark.soak
def test_commissioning_is_lit_by_the_channel_of_the_recipe_and_finds_its_angle(virtual_rigs, tmp_path):
    lamps = {"A": {"light_angle_deg": 10.0}, "B": {"light_angle_deg": 20.0}}
    light = {
        "driver": "coolled",
        "port": "sim://coolled?bench=${here}/bench.toml",
        "options": {"bench": None},
    }
    light["channels"] = {"near": {"lamps": ["A"]}, "far": {"lamps": ["B"], "angle_deg": 18.0}}
    recipe = {"acquisition": {"light_channel": "far"}}
    rig = virtual_rigs("channels", rig={"light": light}, bench={"lamps": lamps}, recipe=recipe)
    place = Workplace(rig.rig, tmp_path)
    commission_rig(place, silent, recipe=rig.recipe, entry=recipe_entry(rig.recipe))
    record = read_commissioning(default_record_path(rig.rig))
    (angle,) = [one for one in record.findings if one.key == "light.channels.far.angle_deg"]
    assert angle.old == 18.0
    assert abs(angle.value - 20.0) < 3.0 * angle.u  # of the lamp of the recipe's channel
    known = angle.model_copy(update={"status": "found"})  # without a tilt axis it is not known well enough
    update_rig_file(rig.rig, changes_of(record.model_copy(update={"findings": (known,)})))
    written = tomllib.loads(rig.rig.read_text(encoding="utf-8"))["light"]["channels"]
    assert written["near"] == light["channels"]["near"]
    assert written["far"]["angle_deg"] == pytest.approx(angle.value, abs=angle.u)


@pytest.mark.soak
def test_a_material_by_steps(served, app_of, station_at, virtual_rigs):
    small = {"sensor": {"rows": 288, "cols": 320}, "tilt": {"address": "1", "zero_deg": 30.0}}
    small["optics"] = {"pixel_um": 14.0, "blur_um": 8.0, "electrons": 2.4e7, "lamp_noise": 0.0}
    options = {"address": "1", "move_gap_s": 0.0, "timeout_s": 0.2}
    tilt = {
        "driver": "elliptec",
        "port": "sim://elliptec?bench=${here}/bench.toml",
        "zero_deg": 30.0,
        "options": options,
    }
    rig = {"camera": {"pixel_um": 14.0}, "tilt": tilt}
    tile = virtual_rigs("white tile", rig=rig, bench={**small, "sample": {"kind": "white-tile"}})
    flat = tile.rig.with_name("flat.tif")
    take_flat(tile.rig, flat, exposure_s=0.0015, frames=4)
    rig["calibration"] = {"flat": str(flat)}
    recipe = {"region": {"size_mm": [0.8, 0.8]}, "material": {"alpha_along": 0.08, "alpha_across": 0.08}}
    at = station_at("material", rig=rig, bench={**small, "sample": {"ridge_angle_deg": 0.0}}, recipe=recipe)[
        0
    ]
    with served(app_of(at)) as address:
        guiding = Guiding(address, at)
        guiding.begin("material", name="abs")
        _, state = guiding.all_steps()
        guiding.end()
    assert read_material_file(at.place.out / "materials" / "abs.toml").name == "abs"
    assert state["guide"]["results"][0]["rows"][0][0] == "albedo"
