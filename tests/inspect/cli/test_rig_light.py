"""Light channels of the virtual rig: `rig light`, `rig snap --channel`, calibrations, a scan and an inspection."""

import json
import threading

import numpy as np
import pytest

from anisoscope.base.errors import RigFileError
from anisoscope.calibration.pictures import take_flat
from anisoscope.cli import run
from anisoscope.inspection.job import prepare
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.reflectance_scan import begin_lamps, planned_lamps
from anisoscope.inspection.work import Task, Workplace, perform
from anisoscope.rig.frame import read_frame
from anisoscope.sim.bench.camera import SimulatedCamera

LAMPS = {
    "A": {"light_angle_deg": 10.0},
    "B": {"light_angle_deg": 20.0, "brightness": 0.5},
}
BENCH = {"lamps": LAMPS, "filters": [{}, {"passes": 0.5}], "tilt": {"address": "1", "zero_deg": 30.0}}
CHANNELS = {
    "near": {"lamps": ["A"], "wavelength_nm": 470.0},
    "far": {"lamps": ["B"], "wavelength_nm": 630.0, "angle_deg": 20.0},
    "grey": {"lamps": ["A"], "filter": 2},
}
LIGHT = {
    "driver": "coolled",
    "port": "sim://coolled?bench=${here}/bench.toml",
    "options": {"bench": None},
    "wheel": {
        "driver": "fw102c",
        "port": "sim://fw102c?bench=${here}/bench.toml",
        "options": {"settle_s": 0.0},
    },
    "channels": CHANNELS,
}
TILT = {
    "driver": "elliptec",
    "port": "sim://elliptec?bench=${here}/bench.toml",
    "zero_deg": 30.0,
    "options": {"address": "1", "move_gap_s": 0.0, "timeout_s": 0.2},
}


@pytest.fixture
def command(capsys):
    def go(*arguments):
        code = run([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return code, out, err

    return go


@pytest.fixture
def rig(virtual_rig):
    """A white tile under two lamps and two filters."""
    light = {**LIGHT, "channels": {name: dict(one) for name, one in CHANNELS.items()}}
    return virtual_rig(rig={"light": light, "tilt": TILT}, bench={**BENCH, "sample": {"kind": "white-tile"}})


def test_each_channel_lights_its_lamp_behind_its_filter(rig, command, tmp_path):
    means = {}
    for name in CHANNELS:
        out = tmp_path / f"{name}.tif"
        code, _, err = command(
            "rig", "snap", "-g", rig.rig, "--exposure", 0.0015, "--out", out, "--channel", name
        )
        assert code == 0, err
        means[name] = read_frame(out).counts.mean() - 64.0
    assert means["grey"] == pytest.approx(0.5 * means["near"], rel=0.01)
    cosines = [np.cos(np.radians(angle)) for angle in (10.0, 20.0)]
    assert means["far"] == pytest.approx(0.5 * means["near"] * cosines[1] / cosines[0], rel=0.01)
    assert all(lamp.level == 0.0 for lamp in rig.bench.lamps.values())


def test_channels_are_listed_and_lit(rig, command, monkeypatch):
    code, out, _ = command("rig", "light", "-g", rig.rig)
    assert code == 0
    assert [name in out for name in ("near", "far", "grey", "630 nm")] == [True] * 4
    code, out, _ = command("rig", "light", "-g", rig.rig, "--json")
    assert json.loads(out)["channels"]["grey"]["filter"] == 2
    text = rig.rig.read_text(encoding="utf-8")
    rig.rig.write_text(text.replace("[light]", '[light]\nchannel = "near"', 1), encoding="utf-8")
    _, out, _ = command("rig", "light", "-g", rig.rig)
    assert "near *" in out
    assert out.count("470 nm") == 1  # those of a default channel are no other's
    lit = []
    monkeypatch.setattr("builtins.input", lambda: lit.append([one.level for one in rig.bench.lamps.values()]))
    assert command("rig", "light", "far", "-g", rig.rig)[0] == 0
    assert lit == [[0.0, 1.0]]
    assert rig.bench.lamps["B"].level == 0.0
    assert command("rig", "light", "off", "-g", rig.rig)[0] == 0
    _, out, _ = command("rig", "status", "-g", rig.rig, "--json")
    assert json.loads(out)["light"]["channels"] == list(CHANNELS)


def levels_at_frames(rig, monkeypatch):
    """Levels of the lamps at every frame that is taken from now on."""
    lit, grab = [], SimulatedCamera.grab

    def seen(camera):
        lit.append(tuple(one.level for one in rig.bench.lamps.values()))
        return grab(camera)

    monkeypatch.setattr(SimulatedCamera, "grab", seen)
    return lit


def test_the_self_test_is_lit_by_its_channel(rig, command, monkeypatch):
    lit = levels_at_frames(rig, monkeypatch)
    check = ("rig", "check", "-g", rig.rig, "--exposure", 0.0015, "--tile", "--json")
    _, out, _ = command(*check, "--channel", "far")
    assert set(lit) == {(0.0, 0.0), (0.0, 1.0)}
    assert json.loads(out)["settings"]["light_channel"] == "far"


def test_the_check_of_the_console_is_lit_by_the_channel_of_its_task(rig, monkeypatch, tmp_path):
    lit, said = levels_at_frames(rig, monkeypatch), []
    task = Task("check", exposure_s=0.0015, channel="far")
    perform(task, Workplace(rig.rig, tmp_path), lambda *one: said.append(one), threading.Event())
    assert said[-1][0] == "checked"
    assert set(lit) == {(0.0, 0.0), (0.0, 1.0)}


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("rig", "check", "--exposure", 0.001, "--channel", "uv"), 78, "has no channel 'uv'"),
        (
            (
                "rig",
                "commission",
                "--exposure",
                0.001,
                "--channel",
                "uv",
                "--ridge-angle",
                10,
                "--pitch",
                100,
                "--spot-mm",
                1,
            ),
            78,
            "has no channel 'uv'",
        ),
        (("rig", "light", "blue"), 64, "has no channel 'blue'; it has near, far, grey"),
        (("rig", "light", "on"), 69, "channels near, far, grey: choose one"),
        (
            ("rig", "snap", "--exposure", 0.001, "--out", "x.tif", "--channel", "uv"),
            78,
            "has no channel 'uv'",
        ),
    ],
)
def test_wrong_channels(rig, command, monkeypatch, tmp_path, arguments, code, words):
    monkeypatch.chdir(tmp_path)
    found, _, err = command(*arguments, "-g", rig.rig)
    assert (found, len(err.strip().splitlines())) == (code, 1)
    assert words in err


def test_a_recipe_names_its_channel_and_the_flat_is_that_of_the_channel(
    virtual_rig, rig, plain, monkeypatch, tmp_path
):
    code = run(
        ["calibrate", "flat", "-g", str(rig.rig), "--exposure", "0.0015", "--count", "4",
         "--out", str(tmp_path / "far.tif"), "--channel", "far"]
    )  # fmt: skip
    assert code == 0
    channels = {name: dict(one) for name, one in CHANNELS.items()}
    channels["far"]["flat"] = str(tmp_path / "far.tif")
    files = virtual_rig(
        "chosen",
        rig={"light": {**LIGHT, "channels": channels}, "tilt": TILT},
        bench=BENCH,
        recipe={"acquisition": {"light_channel": "far"}},
    )
    job = prepare(files.recipe, files.rig, "P-1")
    assert (job.rig.light.channel, job.rig.light.angle_deg, job.rig.light.wavelength_nm) == (
        "far",
        20.0,
        630.0,
    )
    assert next(one.path.name for one in job.sources if one.role == "white reference") == "far.tif"
    lit, grab = [], SimulatedCamera.grab
    with monkeypatch.context() as patch:

        def grabbed(camera):
            lit.append(tuple(lamp.level for lamp in files.bench.lamps.values()))
            return grab(camera)

        patch.setattr(SimulatedCamera, "grab", grabbed)
        done = files.inspect("P-1", methods=plain)
    assert {levels for levels in lit if any(levels)} == {(0.0, 1.0)}, "the far lamp alone, and darks without"
    assert (done.record.verdict, done.record.rig["light"]["channel"]) == ("PASS", "far")
    assert recompute(done.folder).differences == ()
    job = prepare(files.recipe, files.rig, "P-1", channel="near")
    assert (job.rig.light.channel, job.rig.light.angle_deg) == ("near", 10.0)
    text = files.recipe.read_text(encoding="utf-8").replace('light_channel = "far"', "")
    files.recipe.write_text(text, encoding="utf-8")
    with pytest.raises(RigFileError, match="has near, far, grey: choose one"):
        prepare(files.recipe, files.rig, "P-1")


def test_a_scan_with_channels_has_the_angle_and_the_scale_of_each(virtual_rigs_of_channels, tmp_path):
    """A coupon under two lamps: twelve poses each, and the light angle that each truly has is found."""
    files = virtual_rigs_of_channels
    lamps = planned_lamps(
        [files.rig], files.recipe, "coupon", tilt_deg=12.0, stages=4, tilts=3, channels=("near", "far")
    )
    assert (lamps.channels, lamps.folders) == (("near", "far"), ("470nm", "630nm"))
    found = begin_lamps(lamps, tmp_path / "scan")
    for one, angle in zip(found, (10.0, 20.0), strict=True):
        assert one.coupon.light_angle_deg == pytest.approx(angle, abs=0.1)
        assert np.max(one.u) < 0.05
    header, *rows = (tmp_path / "scan" / "brdf.csv").read_text().splitlines()
    assert (header.endswith("wavelength_nm"), len(rows)) == (True, sum(len(one.poses) for one in found))


@pytest.fixture
def virtual_rigs_of_channels(virtual_rig, tmp_path):
    small = {
        **BENCH,
        "sensor": {"rows": 288, "cols": 320, "hot_pixel_share": 0.0},
        "optics": {"pixel_um": 14.0, "blur_um": 8.0, "electrons": 2.4e7, "lamp_noise": 0.0},
    }
    channels = {name: dict(CHANNELS[name]) for name in ("near", "far")}
    table = {"light": {**LIGHT, "channels": channels}, "tilt": TILT, "camera": {"pixel_um": 14.0}}
    for name, channel in channels.items():
        own = {**table, "light": {**table["light"], "channel": name}}
        tile = virtual_rig(f"tile-{name}", rig=own, bench={**small, "sample": {"kind": "white-tile"}})
        channel["flat"] = str(tmp_path / f"flat-{name}.tif")
        take_flat(tile.rig, tmp_path / f"flat-{name}.tif", exposure_s=0.0015, frames=4)
    return virtual_rig(
        "coupon",
        rig=table,
        bench={**small, "sample": {"ridge_angle_deg": 0.0}},
        recipe={
            "region": {"size_mm": [0.8, 0.8]},
            "uncertainty": {"light_angle_deg": 0.02, "scale_share": 0.01},
        },
    )
