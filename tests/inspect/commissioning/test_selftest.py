"""The self test passes a rig that is as its file says, and names what is wrong with one that is not."""

import json

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.commissioning.fixture_check import FIXTURE
from anisoscope.commissioning.record import Commissioning, Finding, default_record_path, write_commissioning
from anisoscope.commissioning.selftest import STEPS, lamp_checks, self_test
from anisoscope.commissioning.selftest_record import Settings, write_self_test
from anisoscope.record.schema import sha256_of
from anisoscope.rig.rigfile import read_rig

SETTINGS = Settings(0.0015, frames=8, dark_frames=2)


def failed(result):
    return {check.key for check in result.checks if check.outcome == "FAIL"}


def commissioned(rig, *, column=258.9, row=253.3, blur=0.82, noise=0.85):
    """A record beside the rig file, as the commissioning of that bench writes it."""
    axis = [("camera.axis_column_px", column), ("camera.axis_row_px", row)]
    record = Commissioning(
        id="c0ffee", created_at="2026-01-01T00:00:00+00:00", software="anisoscope", rig="virtual rig",
        rig_file="rig.toml", rig_file_sha256=sha256_of(rig.rig), devices={}, part={}, series={},
        findings=tuple(Finding(key=key, words=key, value=value, u=0.01) for key, value in axis),
        poses=(), fit=None, drift=0.0, dark_level=64.0, dark_noise=noise, blur_px=blur, notes=(), frames_sha256=(),
    )  # fmt: skip
    write_commissioning(record, default_record_path(rig.rig))


def test_a_sound_rig_is_fit_and_every_check_was_done(virtual_rig, tmp_path):
    tilt = {
        "driver": "elliptec",
        "port": "sim://elliptec?bench=${here}/bench.toml",
        "zero_deg": 30.0,
        "options": {"address": "1", "move_gap_s": 0.0, "timeout_s": 0.2},
    }
    rig = virtual_rig(rig={"tilt": tilt}, bench={"tilt": {"address": "1"}})
    commissioned(rig)
    result = self_test(rig.rig, SETTINGS)
    assert failed(result) == set()
    assert (result.fit, result.exit_code, result.commissioning) == (True, 0, "c0ffee")
    skipped = {check.key for check in result.checks if check.outcome == "SKIPPED"}
    # no tile on the stage, nothing automatic in the camera, and no reference of the fixture
    greys = {key for key, _ in FIXTURE}
    assert skipped == {"white.shading", "white.level", "camera.exposure"} | greys
    expected = {"devices"} | {key for names, _ in STEPS for key, _ in names}
    assert {check.key for check in result.checks} == expected
    assert all(
        check.value <= check.limit or check.key == "light.on" for check in result.checks if check.limit
    )
    assert not rig.bench.light_on

    path = write_self_test(result, tmp_path / "kept")
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["fit"] is True
    assert len(content["checks"]) == len(result.checks)
    second = write_self_test(self_test(rig.rig, SETTINGS), tmp_path / "kept")
    assert sorted((tmp_path / "kept").iterdir()) == sorted([path, second])


def test_a_wrong_sense_is_named(virtual_rig):
    result = self_test(virtual_rig(bench={"stage": {"turns": "cw"}}).rig, SETTINGS)
    assert failed(result) == {"markers.angle"}
    assert "turns the other way" in result["markers.angle"].remark
    assert result.exit_code == 3


@pytest.mark.parametrize(
    ("bench", "wrong"),
    [
        pytest.param({"stage": {"zero_deg": 10.6}}, {"markers.angle"}, marks=pytest.mark.soak),
        ({"optics": {"lens_cap": True}}, {"light.on", "light.off", "markers.residual"}),
        ({"optics": {"electrons": 6e8}}, {"camera.saturated"}),
        (
            {"optics": {"lamp_drift_per_frame": 0.004, "axis_px": [12.0, 0.0]}},
            {"lamp.drift", "markers.centre"},
        ),
        (
            {"optics": {"pixel_um": 8.3, "lamp_noise": 0.04}, "sensor": {"read_noise_e": 60.0}},
            {"markers.pixel", "camera.dark_noise", "lamp.flicker"},
        ),
        ({"optics": {"blur_um": 16.0}}, {"markers.focus"}),
    ],
)
def test_what_is_wrong_fails_its_check_and_says_what_to_do(virtual_rig, bench, wrong):
    rig = virtual_rig(bench=bench, rig={"calibration": None})
    commissioned(rig)
    result = self_test(rig.rig, SETTINGS)
    assert wrong <= failed(result)
    # what follows from it may fail too, what has nothing to do with it does not
    assert not failed(result) & {"axes.home", "stage.moves", "stage.repeat", "camera.dark_level"}
    assert all(result[key].remark for key in wrong)
    assert result.exit_code == 3


def test_a_device_in_trouble_fails_and_the_rest_is_skipped(virtual_rig):
    rig = virtual_rig(bench={"stage": {"faults": ["stall"]}})
    result = self_test(rig.rig, SETTINGS)
    assert len(failed(result)) == 1
    assert result.exit_code == 3
    assert {check.outcome for check in result.checks} == {"PASS", "FAIL", "SKIPPED"}

    dead = virtual_rig("dead", rig={"stage": {"port": "/dev/no-such-port"}})
    result = self_test(dead.rig, SETTINGS)
    assert failed(result) == {"devices"}
    assert "cables" in result["devices"].remark
    assert {check.outcome for check in result.checks if check.key != "devices"} == {"SKIPPED"}


def test_with_the_tile_on_the_stage_its_shading_is_compared(virtual_rig):
    tile = {"sample": {"kind": "white-tile"}}
    settings = Settings(0.0015, frames=8, dark_frames=2, tile=True)
    result = self_test(virtual_rig(bench=tile).rig, settings)
    assert failed(result) == set()
    assert {result[key].outcome for key in ("white.age", "white.shading", "white.level")} == {"PASS"}
    assert result["markers.residual"].outcome == "SKIPPED"
    shaded = virtual_rig("shaded", bench={**tile, "optics": {"vignetting": 0.25, "electrons": 2.0e7}})
    assert failed(self_test(shaded.rig, settings)) == {"white.shading", "white.level"}


def test_a_record_that_was_changed_does_not_count(virtual_rig):
    rig = virtual_rig(rig={"calibration": None})
    commissioned(rig)
    beside = default_record_path(rig.rig)
    beside.write_text(beside.read_text(encoding="utf-8").replace("258.9", "270.9"), encoding="utf-8")
    result = self_test(rig.rig, SETTINGS)
    assert failed(result) == {"commissioning"}
    assert result["markers.centre"].outcome == "SKIPPED"
    with pytest.raises(CalibrationError, match="was changed"):
        self_test(rig.rig, SETTINGS, beside)
    with pytest.raises(UsageError, match="at least 8"):
        Settings(0.001, frames=2)
    for exposure_s, gain in ((0.0, 1.0), (-1.0, 1.0), (float("nan"), 1.0), (0.001, 0.0)):
        with pytest.raises(UsageError, match="exposure and gain must be more than 0"):
            Settings(exposure_s, gain)
    assert read_rig(rig.rig).calibration is None


def webcam(automatic):
    """A camera with a gamma curve and automatic exposure."""
    return {
        "sensor": {
            "bit_depth": 8,
            "black_level": 2.0,
            "gain_e_per_dn": 110.0,
            "gamma": 2.2,
            "auto_exposure": automatic,
        }
    }


def test_a_webcam_is_proved_to_obey_and_said_to_be_uncalibrated(virtual_rig):
    rig = virtual_rig(bench=webcam("off"), rig={"calibration": None})
    result = self_test(rig.rig, SETTINGS)
    assert result["camera.exposure"].outcome == "PASS"
    assert result["camera.exposure"].value == pytest.approx(1.0 / 2.2, rel=0.1)
    assert "came back" in result["camera.exposure"].remark
    assert result["camera.linear"].outcome == "WARN"
    assert "uncalibrated" in result["camera.linear"].remark
    assert result.fit == (failed(result) == set())  # to be uncalibrated is no fault of today


def test_a_webcam_that_exposes_as_it_likes_is_not_fit(virtual_rig):
    rig = virtual_rig(bench=webcam("on"), rig={"calibration": None})
    result = self_test(rig.rig, SETTINGS)
    assert "camera.exposure" in failed(result)
    assert "auto exposure" in result["camera.exposure"].remark
    assert result["stage.moves"].outcome == "PASS"  # the camera answers, so that the rest is looked at


def test_drift_is_that_of_the_warm_up_fit(virtual_rig):
    slow = {"optics": {"lamp_warmup_share": 0.05, "lamp_warmup_frames": 6.0, "lamp_noise": 0.0}}
    result = self_test(virtual_rig(bench=slow).rig, Settings(0.0015, frames=24, dark_frames=2))
    drift = result["lamp.drift"]
    assert drift.outcome == "FAIL"
    assert drift.value == pytest.approx(0.05, abs=0.01)
    assert 0.005 < drift.limit < 0.5 * drift.value
    assert "over 24 frames" in drift.remark
    assert result["lamp.flicker"].outcome == "PASS"  # warming up is no flicker


def test_noise_of_the_lamp_is_no_drift():
    rng, settings = np.random.default_rng(5), Settings(0.0015)
    times_s = np.arange(20) * 0.1
    checks = [
        lamp_checks(times_s.tolist(), 1000.0 * (1.0 + 0.008 * rng.standard_normal(20)), settings)[0]
        for _ in range(40)
    ]
    passed = [check for check in checks if check.outcome == "PASS"]
    assert len(passed) >= 36  # two standard uncertainties
    assert not any("per minute" in check.remark for check in passed)


def test_a_lamp_that_warms_up_is_named_with_the_time_to_wait():
    times_s = np.arange(24) * 2.0
    levels = 1000.0 * (1.0 + 0.08 * np.exp(-times_s / 30.0))
    noise = 1e-4 * np.random.default_rng(6).standard_normal(24)
    drift, flicker = lamp_checks(times_s.tolist(), levels * (1.0 + noise), Settings(0.0015))
    assert (drift.outcome, flicker.outcome) == ("FAIL", "PASS")
    assert "not warm yet" in drift.remark
    assert "wait " in drift.remark
