"""One rule for all commands that move: a rig that was never commissioned asks once, one that was taught does not."""

import io
import sys

import pytest

from anisoscope.cli import run

EXPOSE = ("--exposure", "0.0015")
KNOWN = ("--ridge-angle", "10", "--pitch", "100", "--spot-mm", "1")
MOVING = {
    "home": ("rig", "home"),
    "move": ("rig", "move", "40"),
    "jog": ("rig", "jog", "5"),
    "hold": ("rig", "hold", "--home"),
    "live": ("rig", "live", *EXPOSE, "--jog", "--count", "1"),
    "focus": ("rig", "focus", *EXPOSE, "--from", "9", "--to", "11"),
    "commission": ("rig", "commission", *EXPOSE, *KNOWN),
    "check": ("rig", "check", *EXPOSE),
    "scan": ("rig", "scan", "--coupon", "--recipe", "RECIPE", "--out", "scan"),
    "rotation": ("calibrate", "rotation", *EXPOSE, "--out", "rotation.json"),
    "read-code": ("read-code", "--recipe", "RECIPE"),
}
CALIBRATED = {
    "inspect": ("inspect", "--recipe", "RECIPE", "--serial", "A", "--out", "parts"),
    "fixture": ("calibrate", "fixture", *EXPOSE, "--out", "fixture.json"),
}
NEVER = {
    "calibration": None,
    "z": {
        "driver": "zaber",
        "port": "sim://zaber?bench=${here}/bench.toml",
        "options": {"counts_per_mm": 20997.375},
    },
}


@pytest.fixture
def told(virtual_rig, monkeypatch, capsys, tmp_path):
    """``told(words, **changes)``: exit code, what was said, and the bench (stage at 50°); no terminal."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.StringIO())

    def call(words, bench=None, **changes):
        rig = virtual_rig(rig=changes, bench={"z": {}} if bench is None else bench)
        words = [str(rig.recipe) if word == "RECIPE" else word for word in words]
        rig.bench.axis.start_move(50.0)
        code = run([*words, "--rig", str(rig.rig)])
        return code, capsys.readouterr().err, rig.bench

    return call


@pytest.mark.parametrize("words", MOVING.values(), ids=MOVING)
def test_a_rig_that_was_never_taught_is_not_moved_unasked(told, words):
    code, said, bench = told(words, **NEVER)
    assert (code, "say so with --yes" in said) == (64, True), said
    assert bench.axis.load_deg() == 50.0


@pytest.mark.parametrize("words", CALIBRATED.values(), ids=CALIBRATED)
def test_what_needs_a_flat_refuses_a_rig_without(told, words):
    code, said, bench = told(words, **NEVER)
    assert (code, "flat" in said) == (78, True), said
    assert bench.axis.load_deg() == 50.0


@pytest.mark.parametrize("command", ["home", "move", "jog"])
def test_a_taught_rig_moves_unasked(told, command):
    code, said, _ = told(MOVING[command], bench={})
    assert (code, "homing ELL14" in said, "Go on?" in said) == (0, True, False), said


def test_a_record_of_commissioning_is_enough(virtual_rig, monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    rig = virtual_rig(rig={"calibration": None})
    rig.rig.with_suffix(".commissioning.json").touch()
    assert run(["rig", "home", "--rig", str(rig.rig)]) == 0
    assert "Go on?" not in capsys.readouterr().err
