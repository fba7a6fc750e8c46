"""The self test by the fixture: a sound rig passes, faults are named, a foreign reference is refused."""

from datetime import timedelta

import pytest

from anisoscope.base.errors import CalibrationError
from anisoscope.calibration.fixture import calibrate_fixture
from anisoscope.calibration.record import read_calibration, write_calibration
from anisoscope.commissioning.fixture_check import FIXTURE, fixture_checks
from anisoscope.commissioning.selftest import self_test
from anisoscope.commissioning.selftest_record import Settings
from anisoscope.parameters.taking import Taking
from anisoscope.rig.camera import CameraInfo
from anisoscope.rig.rigfile import read_rig

SETTINGS = Settings(0.0015, frames=8, dark_frames=2)
GREYS = [{"x_mm": 1.5, "y_mm": 0.75, "size_mm": 0.3}, {"x_mm": -1.5, "y_mm": -0.75, "size_mm": 0.3}]
KEYS = [key for key, _ in FIXTURE]


@pytest.fixture(scope="module")
def taught(virtual_rigs, tmp_path_factory):
    """The reference of the sound small rig, with greys."""
    path = tmp_path_factory.mktemp("taught") / "fixture.json"
    rig = virtual_rigs("taught", rig={"fixture": {"greys": GREYS}}, bench={"sample": {"kind": "none"}})
    calibrate_fixture(rig.rig, path, Taking(0.004, frames=2), angles=6)
    return path


@pytest.fixture
def checked(virtual_rig, taught):
    """``checked(bench, **rig)`` are the checks by the fixture, by their keys."""

    def check(bench=None, reference=taught, **rig):
        named = {"fixture": {"greys": GREYS}, "calibration": {"fixture": str(reference)}} | rig
        result = self_test(virtual_rig(bench=bench or {}, rig=named).rig, SETTINGS)
        return {key: result[key] for key in KEYS}

    return check


def failed(checks):
    return {key for key, check in checks.items() if check.outcome == "FAIL"}


def test_a_sound_rig_is_as_at_its_reference(checked):
    found = checked()
    assert {check.outcome for check in found.values()} == {"PASS"}
    assert found["fixture.level"].value < 0.005
    assert found["fixture.stray"].value < 0.003
    assert found["fixture.edge"].value == pytest.approx(1.0, abs=0.05)
    assert found["fixture.age"].value < 1.0


def rewritten(taught, tmp_path, **changes):
    record = read_calibration(taught, "fixture", None)
    path = tmp_path / "fixture.json"
    write_calibration(record.model_copy(update=changes), path)
    return path


def test_faults_and_an_old_reference_fail_their_checks_with_advice(checked, taught, tmp_path):
    taken_at = read_calibration(taught, "fixture", None).taken_at - timedelta(days=100)
    optics = {"stray_radiance": 0.03, "electrons": 1.8e7}
    found = checked({"optics": optics}, rewritten(taught, tmp_path, taken_at=taken_at))
    wanted = {
        "fixture.age": "calibrate fixture",
        "fixture.stray": "keep other light off",
        "fixture.level": "the lamp changed",
    }
    assert failed(found) == set(wanted)
    for key, says in wanted.items():
        assert says in found[key].remark
        assert found[key].value > found[key].limit
    assert found["fixture.level"].value == pytest.approx(0.25, abs=0.01)


def test_a_lens_out_of_focus_comes_first(checked):
    found = checked({"optics": {"blur_um": 16.0}})
    assert failed(found) == {"fixture.edge"}
    assert "focus the lens" in found["fixture.edge"].remark
    assert (found["fixture.stray"].outcome, found["fixture.level"].outcome) == ("SKIPPED", "SKIPPED")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"serial": "other"}, "taken with camera other"),
        ({"channel": "red"}, "in light channel red, this is no light channel"),
        ({"light_angle_deg": 25.0}, "at a light angle of 25°"),
        ({"remarks": ("the lamp was cold",)}, r"was out of its limits \(the lamp was cold\)"),
    ],
)
def test_a_reference_of_another_rig_is_refused_in_one_line(virtual_rig, taught, tmp_path, change, says):
    record = read_calibration(taught, "fixture", None)
    changed = {
        "camera": record.camera.model_copy(update={k: v for k, v in change.items() if k == "serial"}),
        "details": record.details | {k: v for k, v in change.items() if k in record.details},
        "in_limits": "remarks" not in change,
        "remarks": change.get("remarks", ()),
    }
    path = rewritten(taught, tmp_path, **changed)
    file = read_rig(virtual_rig(rig={"calibration": {"fixture": str(path)}}).rig)
    info = CameraInfo(
        record.camera.model, record.camera.serial, record.camera.rows, record.camera.cols, 12, 0.0
    )
    with pytest.raises(CalibrationError, match=says):
        fixture_checks(file, info, ("camera", "stage"), (), SETTINGS)


def test_without_reference_it_is_skipped_and_says_how_to_teach_one(virtual_rig):
    result = self_test(virtual_rig().rig, SETTINGS)
    assert {result[key].outcome for key in KEYS} == {"SKIPPED"}
    assert "anisoscope calibrate fixture" in result["fixture.level"].remark
    assert result.fit
