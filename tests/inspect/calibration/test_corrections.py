"""Inspections use the rig's calibrations, and one that does not hold makes them INVALID."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError, RegistrationError, UsageError
from anisoscope.calibration import record as calibrationrecord
from anisoscope.calibration.corrections import Calibrations, list_calibrations
from anisoscope.calibration.pictures import calibrate_dark, calibrate_stray
from anisoscope.calibration.record import read_calibration, record_path, write_calibration
from anisoscope.calibration.rotation import calibrate_rotation
from anisoscope.imaging.linearisation import RadianceImage, Stack, WhiteReference
from anisoscope.imaging.registration.placement import Placement
from anisoscope.inspection.check_standard import run_check, teach_check
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.job import prepare
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.run import Methods
from anisoscope.parameters.taking import Taking
from anisoscope.rig.rigfile import ChannelPart, LightPart

EXPOSURE_S = 0.0015


def rewrite(path, kind, **changes):
    """Change a record and seal it again, as if it had been written so."""
    record = read_calibration(path, kind).model_copy(update=changes)
    write_calibration(record, path)
    return record


def expired(path, kind):
    now = datetime.now(UTC)
    return rewrite(path, kind, taken_at=now - timedelta(days=9), valid_until=now - timedelta(days=2))


@pytest.fixture
def own_flat(flat, tmp_path):
    """A copy of the white reference with its record, to be spoilt."""
    for path in (flat, record_path(flat)):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path / flat.name


def test_an_expired_flat_is_an_invalid_record_without_any_photograph(virtual_rig, own_flat, monkeypatch):
    record = expired(own_flat, "flat")
    rig = virtual_rig(rig={"calibration": {"flat": str(own_flat)}})
    monkeypatch.setattr("anisoscope.inspection.run.open_rig", lambda *_: pytest.fail("the rig was opened"))
    found = rig.inspect()
    assert found.record.verdict == "INVALID"
    assert record.id in found.record.reasons[0]
    assert "expired" in found.record.reasons[0]
    assert "anisoscope calibrate flat" in found.record.reasons[0]
    assert found.record.frames == ()
    assert verify(found.folder).intact
    again = recompute(found.folder)
    assert (again.verdict, again.differences) == ("INVALID", ())


def test_the_report_of_an_inspection_without_photographs_says_why(virtual_rig, own_flat):
    expired(own_flat, "flat")
    found = virtual_rig(rig={"calibration": {"flat": str(own_flat)}}).inspect(methods=Methods())
    page = found.report.read_text(encoding="utf-8")
    assert "INVALID" in page
    assert "expired at" in page


@pytest.fixture
def dark(tmp_path, virtual_rig):
    """A dark calibration of the small rig."""
    path = tmp_path / "calibrated" / "dark.tif"
    calibrate_dark(virtual_rig("cap").rig, path, Taking(EXPOSURE_S, frames=4))
    return path


def damage(path):
    path.write_bytes(path.read_bytes()[:-1] + b"\x7f")


BEFORE = {
    "missing": (lambda path: record_path(path).unlink(), "does not exist"),
    "tampered picture": (damage, "was changed since its calibration"),
    "tampered record": (lambda path: damage(record_path(path)), "changed|no record"),
    "other camera": (
        lambda path: rewrite(
            path, "dark", camera=read_calibration(path, "dark").camera.model_copy(update={"serial": "CAM-9"})
        ),
        "was taken with camera CAM-9, this is SIM",
    ),
    "other size": (
        lambda path: rewrite(
            path, "dark", camera=read_calibration(path, "dark").camera.model_copy(update={"rows": 99})
        ),
        "has 512 × 99 pixels",
    ),
}


@pytest.mark.parametrize("case", BEFORE)
def test_a_file_that_cannot_be_used_is_told_before_anything_moves(virtual_rig, flat, dark, tmp_path, case):
    spoil, message = BEFORE[case]
    own = tmp_path / "dark.tif"
    for old, new in ((dark, own), (record_path(dark), record_path(own))):
        new.write_bytes(old.read_bytes())
    spoil(own)
    rig = virtual_rig(rig={"calibration": {"flat": str(flat), "dark": str(own)}})
    with pytest.raises(CalibrationError, match=message) as caught:
        rig.inspect()
    assert "anisoscope calibrate dark" in str(caught.value)
    assert caught.value.exit_code == 3
    assert not rig.folders


def test_all_calibrations_together_serve_an_inspection_that_can_be_recomputed(
    virtual_rig, inspected_part, flat, dark, tmp_path
):
    plain = inspected_part[1].record
    stray, rotation = tmp_path / "stray.tif", tmp_path / "rotation.json"
    glass = {"sample": {"kind": "white-tile", "reflectance": 0.0}}
    calibrate_stray(virtual_rig("glass", bench=glass).rig, stray, Taking(0.01, frames=8))
    calibrate_rotation(virtual_rig("turn").rig, rotation, Taking(EXPOSURE_S, frames=2), angles=6)
    named = {"flat": flat, "dark": dark, "stray": stray, "rotation": rotation}
    rig = virtual_rig("all", rig={"calibration": {kind: str(path) for kind, path in named.items()}})
    found = rig.inspect()
    assert found.record.verdict == "PASS", found.record.reasons
    roles = {copy.role for copy in prepare(rig.recipe, rig.rig, "x").sources}
    assert {"flat record", "dark picture", "stray picture", "rotation record"} <= roles
    # what the bench adds to every picture is taken away again, and its uncertainty is that of the calibration
    for before, after in zip(plain.poses, found.record.poses, strict=True):
        assert before.measured - after.measured == pytest.approx(0.0002, rel=0.15)
    row = {row.source: row for row in found.record.budget}["stray light"]
    old = {row.source: row for row in plain.budget}["stray light"]
    assert max(row.contributions) < 0.2 * max(old.contributions)
    assert verify(found.folder).intact
    assert recompute(found.folder).differences == ()
    moved = virtual_rig(
        "moved",
        rig={"calibration": {kind: str(path) for kind, path in named.items()}},
        bench={"optics": {"axis_px": [10.0, -2.2]}},
        recipe={"limits": {"fixture_um": 50.0}},
    ).inspect()
    assert moved.record.verdict == "INVALID"
    assert "from the calibrated rotation centre" in moved.record.reasons[0]
    assert "anisoscope calibrate rotation" in moved.record.reasons[0]


def test_the_check_standard_is_taught_checked_and_stops_inspections_when_it_is_off(
    virtual_rig, flat, tmp_path
):
    rig, path = virtual_rig("check"), tmp_path / "check.json"
    with pytest.raises(CalibrationError, match="does not exist"):
        run_check(rig.rig, rig.recipe, path)
    taught = teach_check(rig.rig, rig.recipe, path, serial="K-1", operator="ada")
    assert taught.in_limits
    assert taught.details["taught"]["serial"] == "K-1"
    same = run_check(rig.rig, rig.recipe, path)
    assert same.in_limits
    assert same.number("p_value") > 0.0027
    assert max(abs(value) for value in same.residuals) < 0.01
    named = {"calibration": {"flat": str(flat), "check": str(path)}}
    assert virtual_rig("good", rig=named).inspect().record.verdict == "PASS"

    worn = virtual_rig("worn", rig=named, bench={"sample": {"ridge_angle_deg": 11.0}})
    off = run_check(worn.rig, rig.recipe, path)
    assert not off.in_limits
    assert "deviates by" in off.remarks[0]
    assert off.details["taught"] == taught.details["taught"]
    stopped = virtual_rig("stopped", rig=named).inspect().record
    assert stopped.verdict == "INVALID"
    assert "check standard deviates by" in stopped.reasons[0]
    assert "anisoscope calibrate check" in stopped.reasons[0]

    other = virtual_rig("other", recipe={"region": {"size_mm": [0.8, 0.8]}})
    with pytest.raises(UsageError, match="another recipe"):
        run_check(rig.rig, other.recipe, path)


def test_the_list_says_what_there_is_and_what_is_missing(virtual_rig, own_flat, dark):
    named = {"flat": str(own_flat), "dark": str(dark), "stray": "nothing.json"}
    rig = virtual_rig(rig={"calibration": named}).rig
    found = {one.kind: one for one in list_calibrations(rig)}
    assert {kind: one.state for kind, one in found.items()} == {
        "flat": "valid",
        "dark": "valid",
        "stray": "missing",
        "linearity": "missing",
        "rotation": "missing",
        "focus": "missing",
        "check": "missing",
        "fixture": "missing",
    }
    assert "anisoscope calibrate stray" in found["stray"].advice
    later = datetime.now(UTC) + timedelta(days=calibrationrecord.VALID_FOR_DAYS["flat"] + 1)
    assert {one.kind: one.state for one in list_calibrations(rig, later)}["flat"] == "expired"
    own_flat.write_bytes(own_flat.read_bytes() + b"x")
    assert {one.kind: one.state for one in list_calibrations(rig)}["flat"] == "damaged"
    record_path(own_flat).unlink()
    assert {one.kind: one.state for one in list_calibrations(rig)}["flat"] == "no record"


SHAPE = (6, 8)
CAMERA = {"model": "SIM", "serial": "CAM-7", "rows": SHAPE[0], "cols": SHAPE[1], "bit_depth": 12}


def made(kind, *, gain=1.0, details=None, **values):
    content = {"rig": "rig", "camera": CAMERA, "exposure_s": 0.5, "gain": gain, "frames": 8}
    content["values"] = {name: {"value": value, "u": 0.1} for name, value in values.items()}
    return calibrationrecord.dated(kind, content | {"details": details or {}}, valid_days=None)


def level(counts, *, gain=1.0, exposure_s=0.5):
    mean = np.broadcast_to(np.asarray(counts, np.float32), SHAPE).copy()
    return Stack(mean, 4, np.ones(SHAPE, np.float32), np.zeros(SHAPE, bool), exposure_s, gain)


def test_a_bent_response_is_made_straight_in_sample_and_flat():
    bend = 2e-5
    light = np.linspace(100.0, 3000.0, SHAPE[1])
    counted = (np.sqrt(1.0 + 4.0 * bend * light) - 1.0) / (2.0 * bend)  # of light = s·(1 + b·s)
    records = {"linearity": made("linearity", details={"response_per_count": bend}), "flat": made("flat")}
    used = Calibrations(records)
    straight = used.corrected(level(64.0 + counted), level(64.0))
    np.testing.assert_allclose(straight.mean - 64.0, np.broadcast_to(light, SHAPE), rtol=1e-4)
    white = WhiteReference(
        np.broadcast_to(counted / 0.5, SHAPE).astype(np.float32), 0.3, "CAM-7", "", 0.99, ""
    )
    np.testing.assert_allclose(used.white(white).signal, np.broadcast_to(light / 0.5, SHAPE), rtol=1e-4)
    # the response is that of one gain
    other = level(64.0 + counted, gain=2.0)
    np.testing.assert_array_equal(used.corrected(other, level(64.0, gain=2.0)).mean, other.mean)


def test_stray_light_is_subtracted_in_proportion_to_the_exposure():
    stray = np.full(SHAPE, 10.0, np.float32)
    for exposure_s, gain in ((0.5, 1.0), (2.0, 3.0)):
        found = Calibrations(stray=stray).corrected(
            level(500.0, exposure_s=exposure_s, gain=gain), level(64.0, exposure_s=exposure_s, gain=gain)
        )
        np.testing.assert_allclose(found.mean, 500.0 - 10.0 * exposure_s * gain)


def test_without_calibrations_nothing_is_touched():
    sample = level(500.0)
    assert Calibrations().corrected(sample, level(64.0)) is sample
    assert Calibrations().axis_px is None
    Calibrations().check_valid(datetime.now(UTC))


@pytest.mark.parametrize(
    ("channel", "angle_deg", "says"),
    [
        ("red", 10.4, None),
        ("blue", 10.0, "light channel red, this is light channel blue"),
        ("red", 11.0, "of 10°"),
    ],
)
def test_a_reference_of_the_fixture_holds_for_its_own_light(channel, angle_deg, says):
    record = made("fixture", details={"channel": "red", "light_angle_deg": 10.0})
    light = LightPart(
        driver="manual", angle_deg=angle_deg, channels={channel: ChannelPart()}, channel=channel
    )
    Calibrations().check_light(light)
    if says is None:
        Calibrations({"fixture": record}).check_light(light)
    else:
        with pytest.raises(CalibrationError, match=f"{says}.*calibrate fixture"):
            Calibrations({"fixture": record}).check_light(light)


def test_hot_pixels_of_the_dark_calibration_carry_no_value():
    hot = np.zeros(SHAPE, bool)
    hot[2, 3] = True
    value = np.ones(SHAPE, np.float32)
    image = RadianceImage(value, value.copy(), np.zeros(SHAPE, bool), 0.5)
    masked = Calibrations(hot=hot).masked(image)
    np.testing.assert_array_equal(~masked.usable, hot)
    np.testing.assert_array_equal(np.isnan(masked.noise), hot)


def test_dark_frames_that_moved_since_the_calibration_are_told():
    used = Calibrations({"dark": made("dark", level=64.0)})
    used.corrected(level(500.0), level(70.0))
    with pytest.raises(
        CalibrationError, match=r"lie \+40.0 counts from the dark calibration dark-.*calibrate dark"
    ):
        used.corrected(level(500.0), level(104.0))
    used.corrected(
        level(500.0, exposure_s=1.0), level(104.0, exposure_s=1.0)
    )  # of that exposure nothing is known


@pytest.mark.parametrize(
    ("axis_px", "turn_deg", "message"),
    [((3.0, 3.0), 0.1, None), ((4.0, 4.0), 0.0, r"5.7 px\) from"), ((0.0, 0.0), 0.3, r"stands \+0.30° from")],
)
def test_the_rotation_gate_is_the_recipes_limit_and_a_fifth_of_a_degree(axis_px, turn_deg, message):
    e = np.array([0.02, -0.01])
    record = made("rotation", centre_column=100.0, centre_row=90.0, eccentricity_x=e[0], eccentricity_y=e[1])
    record = record.model_copy(
        update={"values": {**record.values, "fixture_angle": calibrationrecord.Value(value=1.0)}}
    )
    used = Calibrations({"rotation": record})
    for stage_deg in (0.0, 90.0, 350.0):
        angle = np.radians(stage_deg + 1.0 + turn_deg)
        a = 100.0 * np.array([[np.cos(angle), -np.sin(angle)], [-np.sin(angle), -np.cos(angle)]])
        origin = np.array([100.0, 90.0]) + np.array(axis_px) + a @ e
        matrix = np.column_stack([a, origin])
        place = Placement(matrix, float(np.degrees(angle) % 360.0), 10.0, (origin[0], origin[1]), 0.01, 4)
        if message is None:
            used.check_place(stage_deg, place, 50.0)
        else:
            with pytest.raises(RegistrationError, match=message):
                used.check_place(stage_deg, place, 50.0)


def test_what_was_calibrated_replaces_what_the_recipe_states(make_recipe):
    records = {
        "linearity": made("linearity", linearity_error=0.004),
        "stray": made("stray", stray_radiance=0.001),
    }
    stated = make_recipe()
    found = Calibrations(records).applied_to(stated).uncertainty
    assert (found.linearity_share, found.stray_radiance) == (0.004, 0.1)
    assert found.flat_share == stated.uncertainty.flat_share
    assert Calibrations().applied_to(stated) is stated
