"""Autofocus on the virtual rig, whose camera defocuses by wave optics and knows nothing of the curve that is fitted."""

import json

import numpy as np
import pytest
import tomli_w

from anisoscope.base.errors import MeasurementError
from anisoscope.cli import run
from anisoscope.live_view.autofocus import Autofocus, fit_peak
from anisoscope.rig.acquisition.opening import open_devices
from anisoscope.rig.rigfile import read_rig

DEPTH_MM = 0.22  # λ/NA² of the bench
ZERO_MM = {"elliptec": 10.0, "zaber": 10.0, "apt": 10.0, "smc100": -3.0, "grbl": -30.0}
OPTIONS = {
    "elliptec": {"address": "1"},
    "zaber": {"counts_per_mm": 1000.0 / 0.047625},
    "apt": {"actuator": "MTS25-Z8"},
    "smc100": {},
    "grbl": {"axis": "Z"},
}


def write_rig(folder, protocol="zaber", **z):
    bench = {
        "schema": 1,
        "seed": 3,
        "sample": {"size_mm": 0.4, "reflections": False},
        "sensor": {"rows": 96, "cols": 96},
        "stage": {"time_scale": 0.0},
        "z": {"protocol": protocol, "zero_mm": ZERO_MM[protocol], "backlash_mm": 0.03, **z},
    }
    by_bench = {"driver": "simulated", "options": {"bench": "${here}/bench.toml"}}
    rig = {
        "schema": 1,
        "name": "rig with a focus",
        "stage": {"driver": "elliptec", "port": "sim://elliptec?bench=${here}/bench.toml"},
        "z": {
            "driver": protocol,
            "port": f"sim://{protocol}?bench=${{here}}/bench.toml",
            "options": OPTIONS[protocol],
            "zero_mm": ZERO_MM[protocol],
        },
        "camera": {"pixel_um": 4.0, "half_angle_deg": 2.866, **by_bench},
        "light": {"wavelength_nm": 550.0, **by_bench},
    }
    (folder / "bench.toml").write_text(tomli_w.dumps(bench), encoding="utf-8")
    path = folder / "rig.toml"
    path.write_text(tomli_w.dumps(rig), encoding="utf-8")
    return path


@pytest.fixture
def focus(tmp_path):
    """``focus(low, high, …)`` searches between two distances from the true focus; gives what it found."""

    def search(low, high, protocol="zaber", exposure_s=0.003, steps=9, repeats=2, lit=True, **z):
        file = read_rig(write_rig(tmp_path, protocol, **z))
        with open_devices({"z": file.z}, file.camera, file.light) as devices:
            axis = devices.axes["z"]
            axis.home()
            devices.camera.configure(exposure_s, 1.0)
            (devices.light.on if lit else devices.light.off)()
            zero = ZERO_MM[protocol]
            return Autofocus(axis, devices.camera).search(zero + low, zero + high, steps, repeats)

    return search


@pytest.mark.parametrize("protocol", ZERO_MM)
def test_every_family_finds_the_focus_within_a_hundredth_of_the_depth_of_field(focus, protocol):
    found = focus(-0.9, 1.3, protocol)
    assert found.best == pytest.approx(ZERO_MM[protocol], abs=0.01 * DEPTH_MM)
    assert found.reached == pytest.approx(ZERO_MM[protocol], abs=0.005)
    assert found.kept > 0.95


def test_the_stated_repeatability_is_that_of_searches_repeated(focus):
    """Few photons, so that noise and not the curve decides."""
    dim = {"exposure_s": 3e-4, "repeats": 12}
    found = focus(-0.8, 0.8, **dim)
    assert 1e-5 < found.repeatability < 0.02 * DEPTH_MM
    assert abs(found.best - ZERO_MM["zaber"]) < 4.0 * found.repeatability / np.sqrt(12) + 1e-4
    assert np.ptp(found.places) < 6.0 * found.repeatability


def test_play_of_the_axis_does_not_enter_as_sweeps_go_upwards(focus):
    assert focus(-0.9, 0.9, backlash_mm=0.08).best == pytest.approx(ZERO_MM["zaber"], abs=0.002)


@pytest.mark.parametrize(
    ("ends", "settings", "message"),
    [
        ((0.5, 2.5), {}, "sharpest at the end, 10.5 mm; give a range beyond it"),
        ((14.4, 15.0), {}, "nothing gets sharper between 24.4 mm and 25 mm"),
        ((-1.0, 1.0), {"lit": False}, "too dark to focus"),
        ((-1.0, 1.0), {"steps": 5}, "at least 7 steps"),
        ((30.0, 40.0), {}, "too short"),
    ],
)
def test_what_cannot_be_focused_is_said(focus, ends, settings, message):
    with pytest.raises(MeasurementError, match=message):
        focus(*ends, **settings)


def test_the_curve_finds_its_own_centre_and_its_uncertainty():
    readings = np.linspace(-1.0, 1.2, 15)
    clean = 3.0 + 5.0 / (1.0 + ((readings - 0.137) / 0.3) ** 2) ** 1.4
    assert fit_peak(readings, clean).place == pytest.approx(0.137, abs=1e-6)
    rng = np.random.default_rng(5)
    peaks = [fit_peak(readings, clean + 0.1 * rng.standard_normal(15)) for _ in range(60)]
    off = [(peak.place - 0.137) / peak.u for peak in peaks]
    assert 0.7 < np.std(off) < 1.4


def test_the_command_focuses_and_the_axis_is_moved_by_name(tmp_path, capsys):
    rig = write_rig(tmp_path)
    search = ["--exposure", "0.003", "--from", "9.2", "--to", "10.9", "--steps", "9"]
    assert run(["rig", "focus", "-g", str(rig), *search, "--repeat", "2", "--yes", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["reached_mm"] == pytest.approx(10.0, abs=0.002)
    assert found["place_mm"] == pytest.approx(0.0, abs=0.002)
    assert found["depth_of_field_mm"] == pytest.approx(DEPTH_MM, rel=1e-3)
    assert found["repeatability_mm"] < 0.01 * DEPTH_MM
    assert run(["rig", "move", "0.5", "--sample", "--axis", "z", "-g", str(rig), "--yes"]) == 0
    assert capsys.readouterr().out.endswith(" is at 10.5000 mm (z 0.5000 mm)\n")
    assert run(["rig", "status", "-g", str(rig)]) == 0
    assert "reaches 0 mm…25.4 mm, steps of 4.8e-05 mm" in capsys.readouterr().out
    assert run(["rig", "move", "-1", "--axis", "z", "-g", str(rig), "--yes"]) == 69
    assert "-1 mm is outside 0 mm…25.4 mm; nothing was moved" in capsys.readouterr().err
    assert run(["rig", "move", "1", "--axis", "x", "-g", str(rig), "--yes"]) == 64
    assert "--axis x: there is no such axis; name a rig file with a table [x]" in capsys.readouterr().err
