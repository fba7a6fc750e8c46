"""Forbidden combinations of axes: read from the rig file, and refused by every command before anything moves."""

import itertools
import threading
import tomllib
from contextlib import ExitStack

import numpy as np
import pytest
import tomli_w

from anisoscope.base.errors import LimitExceeded, RigError, RigFileError
from anisoscope.cli import run
from anisoscope.rig.acquisition.opening import open_devices, open_rig
from anisoscope.rig.acquisition.plan import Plan, Pose
from anisoscope.rig.acquisition.runner import check_plan, run_plan
from anisoscope.rig.collisions import Collision, Guard
from anisoscope.rig.rigfile import read_rig
from anisoscope.sim.bench.bench import Bench, shared_bench
from anisoscope.sim.bench.benchfile import BenchFile
from anisoscope.sim.bench.serving import serve_bench, write_rig_file

ROWS = [{"tilt": "> 50", "z": "< 8", "why": "the lens touches the plate"}]
BY_BENCH = {"driver": "simulated", "options": {"bench": "${here}/bench.toml"}}


class Axis:
    """An axis that stands where it is put."""

    resolution_deg = 0.001
    limits_deg = (0.0, 100.0)
    unit = "deg"
    is_homed = True

    def __init__(self, at=0.0):
        self.at = at

    def position_deg(self):
        return self.at

    def move_to(self, target):
        self.at = target
        return target

    def home(self):
        return self.move_to(0.0)


@pytest.fixture
def rig(tmp_path):
    """A rig with a tilt and a focus that can collide: its file and its bench."""
    bench = {
        "schema": 1,
        "sample": {"kind": "white-tile"},
        "sensor": {"rows": 64, "cols": 64},
        "stage": {"time_scale": 0.0},
        "tilt": {},
        "z": {"zero_mm": 12.0},
    }
    table = {
        "schema": 1,
        "name": "rig that can collide",
        "home_order": ["tilt", "z"],
        "stage": {"driver": "elliptec", "port": "sim://elliptec?bench=${here}/bench.toml", "zero_deg": 10.0},
        "tilt": {
            "driver": "elliptec",
            "port": "sim://elliptec?bench=${here}/bench.toml",
            "options": {"address": "1"},
            "zero_deg": 30.0,
        },
        "z": {
            "driver": "zaber",
            "port": "sim://zaber?bench=${here}/bench.toml",
            "options": {"counts_per_mm": 1000.0 / 0.047625},
            "zero_mm": 12.0,
        },
        "camera": {"pixel_um": 4.0, **BY_BENCH},
        "light": BY_BENCH,
        "collisions": ROWS,
    }

    def write(**changes):
        (tmp_path / "bench.toml").write_text(tomli_w.dumps(bench), encoding="utf-8")
        path = tmp_path / "rig.toml"
        path.write_text(tomli_w.dumps({**table, **changes}), encoding="utf-8")
        return path, shared_bench(tmp_path / "bench.toml")

    return write


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([{"tilt": "> ten", "z": "< 2"}], "'> ten' is no range of readings: write"),
        ([{"tilt": "20 .. 10", "z": "< 2"}], "the range ends below its beginning"),
        ([{"tilt": "> 10"}], "a row names two axes or more"),
        ([{"tilt": "> 10", "x": "< 2"}], r"collisions\[0\] names x, but there is no table \[x\]"),
        ([{"tilt": "> 10", "lens": "< 2"}], "collisions"),
    ],
)
def test_rows_that_cannot_be_meant_are_refused(rig, rows, said):
    path, _ = rig(collisions=rows)
    with pytest.raises(RigFileError, match=said):
        read_rig(path)


def test_home_order_names_axes_that_are_there_once(rig):
    for order, said in (
        (["z", "z"], "names an axis twice"),
        (["y"], r"home_order names y, but there is no table"),
    ):
        path, _ = rig(home_order=order)
        with pytest.raises(RigFileError, match=said):
            read_rig(path)


def test_a_motion_is_free_exactly_where_no_reading_on_its_way_is_forbidden():
    """Against small steps along the way, which know nothing of intervals."""
    rng = np.random.default_rng(3)
    rows = [
        Collision(x="30 .. 50", y="40 .. 60"),
        Collision(x="> 80", z="< 20"),
        Collision(x="< 10", y="> 90", z="> 50"),
    ]
    tables = {"x": Axis(), "y": Axis(), "z": Axis()}
    guard = Guard(rows, tables)

    def forbidden(at):
        """Whether any of the (n,) readings of every axis is."""
        return any(
            np.all(
                [(low < at[name]) & (at[name] < high) for name, (low, high) in row.ranges.items()], axis=0
            ).any()
            for row in rows
        )

    outcomes = set()
    for _ in range(200):
        at = dict(zip("xyz", rng.uniform(0.0, 100.0, (3, 1)), strict=True))
        if forbidden(at):
            continue
        for name, axis in tables.items():
            axis.at = float(at[name][0])
        name, target = str(rng.choice(list("xyz"))), float(rng.uniform(0.0, 100.0))
        steps = np.linspace(float(at[name][0]), target, 4001)
        collides = forbidden({one: np.broadcast_to(value, 4001) for one, value in at.items()} | {name: steps})
        axis = guard.guarded(name)
        if collides:
            with pytest.raises(LimitExceeded, match=r"\[\[collisions\]\] forbids"):
                axis.move_to(target)
            assert tables[name].at == at[name][0]
        else:
            assert axis.move_to(target) == target
        outcomes.add(collides)
    assert outcomes == {True, False}


def test_another_order_is_taken_where_the_usual_one_collides():
    """Around a forbidden rectangle only one of both ways is free."""
    axes = {"x": Axis(20.0), "y": Axis(20.0)}
    guard = Guard([Collision(x="30 .. 100", y="0 .. 40")], axes)
    assert guard.order({"x": (60.0,), "y": (60.0,)}) == ("y", "x")
    axes["x"].at, axes["y"].at = 60.0, 60.0
    assert guard.order({"x": (20.0,), "y": (20.0,)}) == ("x", "y")
    with pytest.raises(LimitExceeded, match=r"x 30 \.\. 100, y 0 \.\. 40"):
        guard.order({"x": (70.0,), "y": (20.0,)})


def test_one_axis_moves_at_a_time():
    axes = {"x": Axis(), "y": Axis()}
    guard = Guard([Collision(x="> 90", y="> 90")], axes)
    with guard.motion("x", 5.0), pytest.raises(RigError, match="one moves after the other"):
        guard.guarded("y").move_to(3.0)
    assert guard.guarded("y").move_to(3.0) == 3.0


def test_every_command_refuses_and_names_the_row(rig, capsys):
    path, bench = rig()
    files = ["-g", str(path), "--yes"]
    assert run(["rig", "move", "60", "--axis", "tilt", *files]) == 69
    said = capsys.readouterr().err
    assert (
        "moving the tilt may collide: [[collisions]] forbids tilt > 50, z < 8 (the lens touches the plate)"
        in said
    )
    assert "the z stands at 0 mm; nothing was moved: move z first" in said
    assert bench.tilt_axis.position() == pytest.approx(0.0, abs=0.1)
    assert run(["rig", "move", "10", "--axis", "z", *files]) == 0
    with open_devices(read_rig(path).axes, rows_of=read_rig(path)) as devices:
        for axis in devices.axes.values():
            axis.home()
        devices.axes["z"].move_to(10.0)
        devices.axes["tilt"].move_to(60.0)
        for motion in (lambda: devices.axes["z"].move_by(-5.0), devices.axes["z"].home):
            with pytest.raises(
                LimitExceeded, match=r"the tilt stands at 60°; nothing was moved: move tilt first"
            ):
                motion()
        assert bench.linear["z"].position() == pytest.approx(10.0, abs=0.001)
        devices.axes["tilt"].move_to(50.0)  # the end itself is allowed
        devices.axes["z"].move_to(7.0)
    assert run(["rig", "jog", "55", "--axis", "tilt", *files]) == 69
    path, bench = rig(collisions=[{"tilt": "< 50", "z": "< 8"}], home_order=["z", "tilt"])
    sweep = ["--exposure", "0.003", "--from", "2", "--to", "11"]
    capsys.readouterr()
    assert run(["rig", "focus", "-g", str(path), "--yes", *sweep]) == 69
    assert "may collide: [[collisions]] forbids tilt < 50, z < 8" in capsys.readouterr().err
    assert bench.linear["z"].position() == pytest.approx(0.0, abs=1e-3)


def test_homing_needs_an_order_that_is_called_safe(rig, capsys):
    path, bench = rig(home_order=[])
    for name, other in (("tilt", "z"), ("z", "tilt")):
        assert run(["rig", "home", "--axis", name, "-g", str(path), "--yes"]) == 69
        said = capsys.readouterr().err
        assert f"homing the {name} may collide: [[collisions]] forbids tilt > 50, z < 8" in said
        assert (
            f"where the {other} stands is not known before homing; nothing was moved: home the {other} first"
            in said
        )
        assert f"or name {name} before it in home_order of the rig file" in said
    assert not bench.linear["z"].busy()
    assert run(["rig", "home", "--axis", "stage", "-g", str(path), "--yes"]) == 0
    path, _ = rig()  # the tilt first
    assert run(["rig", "home", "--axis", "z", "-g", str(path), "--yes"]) == 69
    assert "home the tilt first" in capsys.readouterr().err
    assert run(["rig", "home", "--axis", "tilt", "-g", str(path), "--yes"]) == 0


def test_a_plan_that_collides_is_refused_before_anything_moves(rig, tmp_path):
    path, bench = rig()
    upright = Plan((Pose(0.0, 0.0),), 0.003)
    tilted = Plan((Pose(0.0, 25.0),), 0.003)
    with open_rig(read_rig(path)) as opened:
        check_plan(upright, opened)
        check_plan(tilted, opened)
    path, bench = rig(collisions=[{"tilt": "> 50", "z": "< 12.5"}])
    before = bench.axis.position()
    with (
        open_rig(read_rig(path)) as opened,
        pytest.raises(LimitExceeded, match=r"forbids tilt > 50, z < 12\.5"),
    ):
        run_plan(tilted, opened, tmp_path / "frames")
    assert bench.axis.position() == before
    assert not (tmp_path / "frames").exists()


def test_an_acquisition_goes_around(rig, tmp_path):
    """From z = 0 after homing the arm cannot tilt first, as it usually does."""
    path, bench = rig()
    file, seen = read_rig(path), []
    with open_rig(file) as opened:
        plan = Plan((Pose(0.0, 25.0), Pose(90.0, 25.0)), 0.003, dark_frames=0, return_to_first=False)
        run_plan(plan, opened, tmp_path, on_progress=lambda now: seen.append(now.text))
    moves = [text for text in seen if text.startswith(("tilting", "moving z"))]
    assert moves == ["moving z to 12 mm", "tilting to 25°"]
    assert bench.tilt_deg == pytest.approx(25.0, abs=0.01)
    assert bench.defocus_mm == pytest.approx(0.0, abs=1e-3)


def test_rows_of_a_held_rig_hold_for_all_clients(rig):
    from anisoscope.rig.hold import Owner

    path, _ = rig()
    file = read_rig(path)
    with open_devices(file.axes, rows_of=file) as devices:
        for name in ("tilt", "z"):
            devices.axes[name].home()
        owner = Owner({name: (file.axes[name], axis) for name, axis in devices.axes.items()})
        assert owner.axes["tilt"] is devices.axes["tilt"]
        with pytest.raises(LimitExceeded):
            owner.axes["tilt"].move_to(60.0)


def test_axes_of_a_row_come_together(rig):
    path, _ = rig()
    file = read_rig(path)
    assert set(file.moved_with("tilt")) == {"tilt", "z"}
    assert set(file.moved_with("stage")) == {"stage"}
    assert list(itertools.chain(file.axes)) == ["stage", "tilt", "z"]


class Onlooker(threading.Thread):
    """Looks all the time where the axes of a bench truly stand, and counts how often a row was broken."""

    def __init__(self, bench, forbidden):
        super().__init__(daemon=True)
        self.bench, self.forbidden = bench, forbidden
        self.over, self.broken, self.tilts = threading.Event(), [], set()

    def run(self):
        while not self.over.wait(0.001):
            at = self.bench.axis.position() % 360.0, self.bench.tilt_axis.position()
            self.tilts.add(round(at[1]))
            if self.forbidden(*at):
                self.broken.append(at)


def test_no_axis_of_a_running_rig_enters_what_is_forbidden(tmp_path, capsys):
    """Commands and a plan over ptys while the axes truly move; the row lies across the zero of the stage."""
    bench = Bench(
        BenchFile(
            schema=1,
            sample={"kind": "none"},
            sensor={"rows": 64, "cols": 64},
            stage={"time_scale": 0.1, "zero_deg": 200.0, "turns": "cw"},
            tilt={"zero_deg": 30.0},
        )
    )
    path, row = tmp_path / "rig.toml", {"stage": "-20 .. 20", "tilt": "> 40"}
    onlooker = Onlooker(bench, lambda stage, tilt: (stage > 340.05 or stage < 19.95) and tilt > 40.05)
    with ExitStack() as stack:
        _, urls = serve_bench(bench, 0, stack, pty=True)
        write_rig_file(bench, urls, path)
        table = tomllib.loads(path.read_text()) | {"collisions": [row], "home_order": ["tilt", "stage"]}
        path.write_text(tomli_w.dumps(table), encoding="utf-8")
        onlooker.start()

        def move(table, place):
            return run(["rig", "move", str(place), "--axis", table, "--rig", str(path), "--yes"])

        with open_rig(read_rig(path)) as rig:
            for axis in rig.unhomed():
                axis.home()
            rig.guard.guarded("stage").move_to(180.0)
            rig.guard.guarded("tilt").move_to(60.0)
            for reading in (10.0, 350.0, 360.0):
                with pytest.raises(LimitExceeded, match=r"forbids stage -20 \.\. 20, tilt > 40"):
                    rig.guard.guarded("stage").move_to(reading)
            poses = (Pose(0.0, 30.0), Pose(180.0, 0.0), Pose(90.0, 25.0))
            records = run_plan(Plan(poses, exposure_s=0.01, dark_frames=0), rig, tmp_path / "frames")
            with pytest.raises(LimitExceeded, match="may collide"):
                check_plan(Plan((Pose(190.0, 30.0),), exposure_s=0.01), rig)
        assert [record.frame.stage_deg for record in records] == pytest.approx([0, 180, 90, 0], abs=0.05)
        assert [record.frame.tilt_deg for record in records] == pytest.approx([30, 0, 25, 30], abs=0.05)
        assert move("stage", 90.0) == 0
        capsys.readouterr()
        onlooker.over.set()
        onlooker.join()
    assert onlooker.broken == []
    assert {30, 55} <= onlooker.tilts
