"""The sheet of a camera, from a calibration taken on the virtual rig."""

import tomllib

import numpy as np
import pytest
import tomli_w

from anisoscope.base.errors import CalibrationError
from anisoscope.base.json_fields import as_json
from anisoscope.calibration.linearity import calibrate_linearity
from anisoscope.calibration.record import read_calibration, write_calibration
from anisoscope.parameters.taking import Taking
from anisoscope.quality.camera import NAMES, read_camera

SENSOR = {"rows": 160, "cols": 160, "hot_pixel_share": 0.0, "gain_e_per_dn": 7.5, "full_well_e": 30_000.0}


@pytest.fixture
def taken(virtual_rig, tmp_path):
    """The rig file and the record of a linearity calibration."""
    rig = virtual_rig(bench={"sample": {"kind": "white-tile"}, "sensor": SENSOR | {"read_noise_e": 16.0}})
    record = tmp_path / "linearity.json"
    calibrate_linearity(rig.rig, record, Taking(0.002, frames=8), steps=16)
    return rig.rig, record


def test_the_sheet_holds_the_curve_and_agrees_with_the_record(taken):
    sheet = read_camera(taken[1])
    curve, gain = sheet.curve, sheet.record.number("gain")
    assert 1.0 / gain == pytest.approx(7.5, rel=0.04)
    middle = (curve.signal > 0.2 * sheet.saturation_dn) & (curve.signal < 0.6 * sheet.saturation_dn)
    shot = (curve.light_variance - curve.dark_variance)[middle]
    np.testing.assert_allclose(shot / curve.signal[middle], gain, rtol=0.06)
    signal, deviation = sheet.deviations()
    assert len(signal) == len(deviation)
    assert np.mean(np.abs(deviation)) == pytest.approx(sheet.record.number("raw_error"), rel=1e-6)
    electrons, ratio = sheet.snr()
    np.testing.assert_allclose(ratio, electrons / np.sqrt(electrons + 16.0**2), rtol=0.06)
    assert [name for name, _ in sheet.rows] == [NAMES[n] for n in NAMES if n in sheet.record.values]
    assert sheet.verdict.startswith("fit for measuring")
    assert any("quantum efficiency" in note for note in sheet.notes)
    shown = as_json(sheet)
    assert (shown["file"], shown["id"], shown["verdict"]) == (str(taken[1]), sheet.record.id, sheet.verdict)
    assert shown["values"]["gain"]["value"] == gain
    assert shown["curve"]["light"] == curve.light.tolist()


def test_a_rig_file_leads_to_its_record(taken):
    rig, record = taken
    with pytest.raises(CalibrationError, match="names no linearity calibration"):
        read_camera(rig)
    content = tomllib.loads(rig.read_text())
    content["calibration"]["linearity"] = str(record)
    rig.write_text(tomli_w.dumps(content))
    assert read_camera(rig).record == read_camera(record).record


def test_earlier_records_have_no_curve_and_damaged_ones_are_refused(taken, tmp_path):
    record = read_calibration(taken[1], "linearity")
    old = record.model_copy(update={"details": {"response_per_count": 0.0, "steps": 16}})
    sheet = read_camera(write_calibration(old, tmp_path / "old.json"))
    assert (sheet.curve, sheet.deviations(), sheet.snr()) == (None, None, None)
    assert "no transfer curve" in sheet.notes[-1]
    curve = dict(record.details["curve"])
    for broken in (curve | {"light": [1.0]}, curve | {"more": []}, "curve", curve | {"dark": ["x"] * 16}):
        damaged = record.model_copy(update={"details": {"curve": broken}})
        with pytest.raises(CalibrationError, match="curve of the record is damaged"):
            read_camera(write_calibration(damaged, tmp_path / "damaged.json"))


def test_an_unfit_camera_is_called_so(taken, tmp_path):
    record = read_calibration(taken[1], "linearity")
    bad = record.model_copy(update={"in_limits": False, "remarks": ("5 % cannot be corrected",)})
    sheet = read_camera(write_calibration(bad, tmp_path / "bad.json"))
    assert sheet.verdict.startswith("not fit for measuring")
    assert sheet.notes[0] == "5 % cannot be corrected"
