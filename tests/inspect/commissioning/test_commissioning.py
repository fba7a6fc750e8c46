"""Commissioning finds what the bench file says and the rig file does not; and says what it cannot find."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import (
    CalibrationError,
    CameraError,
    MeasurementError,
    RigFileError,
    Saturated,
    UsageError,
)
from anisoscope.commissioning.angles import Assumed
from anisoscope.commissioning.commissioning import (
    changes_of,
    commission,
    part_of_recipe,
    update_rig_file,
    write_to_rig_file,
)
from anisoscope.commissioning.exposure import proof_on, sentence
from anisoscope.commissioning.light import Radiances, fit_light
from anisoscope.commissioning.markers import Fix, find_fixture
from anisoscope.commissioning.model import RigModel, lab_directions
from anisoscope.commissioning.part import RidgedPart
from anisoscope.commissioning.record import read_commissioning, write_commissioning
from anisoscope.commissioning.series import Series, turn_readings
from anisoscope.commissioning.turning import fit_centre, fit_foreshortening, fit_turning, wrapped
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.recipe.material_file import MaterialFile
from anisoscope.report.commission_page import write_commission_page
from anisoscope.rig.acquisition.opening import open_rig
from anisoscope.rig.rigfile import read_rig
from anisoscope.sim.bench.bench import _Pose, _Shine
from anisoscope.sim.light.corrected import radiance
from anisoscope.sim.light.geometry import directions, pose_grid, seating_rotation

EXPOSURE_S = 0.0015
DIRECT = Assumed(bounces=1)  # quick; two rigs are found with all reflections
PART = RidgedPart(100.0, 10.0, u_alpha_share=0.03)
PORT = "sim://elliptec?bench=${here}/bench.toml"
TILT = {
    "driver": "elliptec",
    "port": PORT,
    "zero_deg": 30.0,
    "options": {"address": "1", "move_gap_s": 0.0, "timeout_s": 0.2},
}


def off(finding, truth, period=None):
    """Distance of a finding from the truth in units of its uncertainty."""
    error = finding.value - truth
    return abs(float(wrapped(error, period)) if period else error) / finding.u


@pytest.fixture
def lay_out(virtual_rig):
    """``lay_out(bench={...}, rig={...})`` gives a rig whose file says ccw, zero 10° and light 10°, true or not."""

    def make(name="rig", *, bench, rig=None, calibrated=False):
        changes = dict(rig or {})
        if not calibrated:
            changes["calibration"] = None
        sample = {"reflections": True} | bench.get("sample", {})
        return virtual_rig(name, bench=bench | {"sample": sample}, rig=changes)

    return make


def test_a_rig_without_tilt_is_found_as_it_stands(lay_out):
    rng = np.random.default_rng(101)
    zero, light = float(rng.uniform(-60, 60)), float(rng.uniform(8, 12))
    axis = [float(x) for x in rng.uniform(-8, 8, 2)]
    rig = lay_out(
        bench={
            "stage": {"turns": "cw", "zero_deg": zero},
            "geometry": {"light_angle_deg": light},
            "optics": {"axis_px": axis, "lamp_drift_per_frame": 2e-4},
            "sample": {"ridge_angle_deg": 10.08, "seating_tilt_deg": [0.05, -0.06]},
        }
    )
    done = commission(rig.rig, PART, Series(EXPOSURE_S, step_deg=45.0))
    record = done.record
    assert record["stage.turns"].value == "cw"
    assert off(record["stage.zero_deg"], zero, 360.0) < 3.0
    assert record["stage.zero_deg"].u < 0.01
    assert abs(wrapped(record["ridges.zero_deg"].value - zero)) < 0.1
    assert "the other" in record["ridges.zero_deg"].remark
    assert off(record["camera.axis_column_px"], 255.5 + axis[0]) < 4.0
    assert off(record["camera.axis_row_px"], 255.5 + axis[1]) < 4.0
    assert off(record["camera.pixel_um"], 8.0) < 3.0
    assert off(record["light.angle_deg"], light) < 3.0
    # one turn does not say where the light stands: what is known of the part does, and the record admits it
    assert 0.1 < record["light.angle_deg"].u < 0.5
    assert "rests on what is known of the part" in record["light.angle_deg"].remark
    assert record["light.azimuth_deg"].status == "not identifiable"
    assert record["tilt.sign"].status == record["tilt.zero_deg"].status == "not measured"
    assert record.drift == pytest.approx(2e-4 * 2 * 8, abs=2e-3)
    assert read_rig(rig.rig).stage.turns == "ccw"  # nothing is written unasked

    changes = changes_of(record)
    assert changes["stage", "turns"] == "cw"
    assert ("tilt", "sign") not in changes  # not measured
    doubtful = tuple(one.model_copy(update={"status": "not identifiable"}) for one in record.findings)
    assert changes_of(record.model_copy(update={"findings": doubtful})) == {}
    again = tuple(one.model_copy(update={"old": one.value}) for one in record.findings if one.u is None)
    assert changes_of(record.model_copy(update={"findings": again})) == {}


def test_a_rig_with_tilt_is_found_and_its_file_put_right(lay_out, tmp_path):
    rng = np.random.default_rng(102)
    zero, light, tilt = (
        float(rng.uniform(-20, 50)),
        float(rng.uniform(8, 12)),
        30.0 + float(rng.uniform(-2, 2)),
    )
    rig = lay_out(
        bench={
            "stage": {"turns": "cw", "zero_deg": zero},
            "tilt": {"address": "1", "zero_deg": tilt, "sign": -1},
            "geometry": {"light_angle_deg": light},
            "sample": {"material": {"alpha_along": 0.0615, "alpha_across": 0.098}},
        },
        rig={"tilt": TILT},
    )
    series = Series(EXPOSURE_S, step_deg=60.0, tilts_deg=(-15.0, 15.0), tilt_step_deg=60.0)
    done = commission(rig.rig, PART, series, frames=tmp_path / "kept")
    record = done.record
    assert (record["stage.turns"].value, record["tilt.sign"].value) == ("cw", -1)
    assert off(record["stage.zero_deg"], zero, 360.0) < 3.0
    assert off(record["tilt.zero_deg"], tilt) < 3.0
    assert record["tilt.zero_deg"].u < 0.05
    assert off(record["light.angle_deg"], light) < 3.0
    assert record["light.angle_deg"].u < 0.15  # tilts are known angles: the part need not be known
    assert "from the pictures alone" in record["light.angle_deg"].remark
    assert len(list((tmp_path / "kept" / "frames").iterdir())) == len(record.frames_sha256)

    written = write_to_rig_file(rig.rig, record)
    now = read_rig(rig.rig)
    assert written.backup.is_file()
    assert (now.stage.turns, now.tilt.sign) == ("cw", -1)
    assert now.tilt.zero_deg == pytest.approx(tilt, abs=0.03)
    assert now.light.angle_deg == pytest.approx(light, abs=0.2)
    with pytest.raises(UsageError, match="changed since"):
        write_to_rig_file(rig.rig, record)

    path = tmp_path / "record.json"
    write_commissioning(record, path)
    assert read_commissioning(path) == record
    path.write_text(path.read_text(encoding="utf-8").replace('"cw"', '"ccw"'), encoding="utf-8")
    with pytest.raises(CalibrationError, match="changed after"):
        read_commissioning(path)
    page = tmp_path / "page.html"
    write_commission_page(done, page)
    text = page.read_text(encoding="utf-8")
    assert text.count("<img") == 3 + 2
    found = sum(finding.status == "found" for finding in record.findings)
    assert f"Found: {found} of {len(record.findings)} quantities." in text
    assert "http" not in text.replace("http-equiv", "").replace("http://www.w3.org", "")
    for finding in record.findings:
        assert finding.key in text


def test_without_markers_the_ridges_give_sense_and_zero(lay_out):
    rig = lay_out(
        bench={
            "stage": {"turns": "cw", "zero_deg": 77.0},
            "fixture": None,
            "optics": {"axis_px": [0.0, 0.0]},
            "sample": {"reflections": False},
        },
        rig={"fixture": None},
        calibrated=True,
    )
    record = commission(rig.rig, PART, Series(EXPOSURE_S, step_deg=60.0), DIRECT).record
    assert record["stage.turns"].value == "cw"
    assert abs(wrapped(record["stage.zero_deg"].value - 77.0)) < 0.1  # and not 257°: by brightness
    assert record["stage.zero_deg"].u < 0.05
    assert {
        record[key].status for key in ("camera.pixel_um", "camera.axis_row_px", "part.facet_azimuth_deg")
    } == {"not measured"}
    assert any("no fixture" in note for note in record.notes)
    assert record.series["white_reference"] is True


def test_too_long_an_exposure_is_refused(lay_out):
    rig = lay_out(bench={"sample": {"reflections": False}})
    with pytest.raises(Saturated, match="shorten --exposure"):
        commission(rig.rig, PART, Series(20 * EXPOSURE_S, step_deg=60.0))
    with pytest.raises(UsageError, match="not empty"):
        commission(rig.rig, PART, Series(EXPOSURE_S), frames=rig.rig.parent)


def test_a_camera_with_automatic_exposure_has_to_prove_that_it_is_off(lay_out, tmp_path):
    small = {"sample": {"kind": "white-tile"}, "stage": {"protocol": "elliptec"}}
    told = {}
    for automatic in ("none", "off", "on"):
        rig = lay_out(automatic, bench={**small, "sensor": {"auto_exposure": automatic}})
        with open_rig(read_rig(rig.rig)) as opened:
            try:
                told[automatic] = proof_on(opened, 0.001, 1.0)
            except CameraError as error:
                told[automatic] = str(error)
    assert told["none"] is None
    assert told["off"].exponents == pytest.approx((1.0,), abs=0.01)
    assert "from 0.0005 s to 0.001 s brightness grew as the exposure" in sentence(told["off"])
    assert "auto exposure or auto gain is at work" in told["on"]
    rig = lay_out("refused", bench={**small, "sensor": {"auto_exposure": "on"}})
    with pytest.raises(CameraError, match="auto exposure or auto gain"):
        commission(rig.rig, PART, Series(0.001, step_deg=30.0), frames=tmp_path / "frames")
    assert list((tmp_path / "frames").iterdir()) == []  # before any axis moved


def test_markers_cannot_tell_the_sign_of_a_tilt_and_radiances_can(lay_out):
    """In a parallel view, a plane under +τ and under −τ is the same picture: only light tells them apart."""
    rig = lay_out(bench={})
    bench, fixture = rig.bench, read_rig(rig.rig).fixture
    shine = _Shine(bench.file.geometry.light_angle_deg, None)
    views = [bench._render(_Pose(90.0, tilt, (0.0, 0.0), 0.0), shine) for tilt in (15.0, -15.0)]
    fixes = [find_fixture(view.astype(np.float32), fixture) for view in views]
    np.testing.assert_allclose(fixes[0].matrix, fixes[1].matrix, atol=1e-3)
    np.testing.assert_allclose(fixes[0].corners_px, fixes[1].corners_px, atol=1e-3)
    assert fixes[0].squeeze == pytest.approx(np.cos(np.radians(15.0)), abs=2e-4)
    assert abs(wrapped(fixes[0].squeeze_deg - 90.0, 180.0)) < 0.1
    middle = [view[236:276, 236:276].mean() for view in views]
    assert abs(np.log(middle[0] / middle[1])) > 0.3


def truth(rng, *, half, sign, poses, part=PART, noise=0.002, bounces=None):
    """Radiances of a random rig and part, as the fit gets them, and what is true."""
    lean, tilt = poses
    light, azimuth, zero = rng.uniform(8, 12), 0.3 * rng.standard_normal(), 0.02 * rng.standard_normal()
    to_light, to_camera = lab_directions(lean + 180.0 * half, sign * tilt + zero, light, azimuth)
    seat = seating_rotation(*(part.u_seating_deg * rng.standard_normal(2)))
    design = RidgeDesign(part.pitch_um, part.ridge_angle_deg + part.u_ridge_angle_deg * rng.standard_normal())
    along, across = np.exp(part.u_alpha_share * rng.standard_normal(2)) * (
        part.alpha_along,
        part.alpha_across,
    )
    material = Material(along, across, part.albedo + part.u_albedo * rng.standard_normal(), part.index)
    value = 500.0 * radiance(to_light @ seat, to_camera @ seat, design, material, bounces)
    value *= np.exp(noise * rng.standard_normal(len(lean)))
    seen = Radiances(
        lean, tilt, value, np.full(len(lean), noise), u_tilt_deg=0.02, free_sign=bool(np.ptp(tilt))
    )
    return seen, light


TURN = np.arange(0.0, 360.0, 30.0) + 7.0


@pytest.mark.parametrize(("half", "sign"), [pytest.param(False, 1, marks=pytest.mark.soak), (True, -1)])
def test_light_side_and_sign_of_a_random_rig_are_found(half, sign):
    few, tilts = TURN[::2], (-15.0, 0.0, 15.0)
    poses = np.concatenate([few] * 3), np.repeat(tilts, len(few))
    seen, light = truth(np.random.default_rng(103), half=half, sign=sign, poses=poses, bounces=1)
    found = fit_light(PART, seen, bounces=1)
    assert (found.half_turn, found.sign) == (half, sign)
    assert min(found.side_chi2, found.sign_chi2) > 100.0
    assert found["light_deg"].u < 0.1
    assert abs(found["light_deg"].value - light) < 3.5 * found["light_deg"].u


def test_one_turn_leaves_the_light_to_what_is_known_of_the_part():
    poses = TURN, np.zeros(len(TURN))
    seen, light = truth(np.random.default_rng(104), half=True, sign=1, poses=poses, bounces=1)
    found = fit_light(PART, seen, bounces=1)
    assert found.half_turn
    assert found.sign is None
    one = found["light_deg"]
    assert abs(one.value - light) < 3.0 * one.u
    assert one.u_alone > 5.0 * one.u
    names = [parameter.name for parameter in found.parameters]
    row = np.abs(found.correlation[names.index("light_deg")])
    assert max(row[names.index("log_mean")], row[names.index("ridge_deg")]) > 0.5


def test_a_fit_of_direct_light_takes_reflections_for_another_light_angle():
    """A fit of direct light is right where light reflects once, and 1.4° off where it reflects several times."""
    found = {}
    for counted in (1, None):
        rng = np.random.default_rng(106)
        seen, light = truth(rng, half=False, sign=1, poses=(TURN, np.zeros(len(TURN))), bounces=counted)
        found[counted] = fit_light(PART, seen, bounces=1)
    once, several = (one["light_deg"] for one in found.values())
    assert abs(once.value - light) < 3.0 * once.u < 1.2
    assert abs(several.value - light) > 1.2
    assert found[None].widened > 10.0  # and its residuals say so


def test_a_dull_flat_part_does_not_tell_its_sides_apart():
    dull = replace(PART, ridge_angle_deg=0.6, alpha_along=0.5, alpha_across=0.5, albedo=0.8)
    rng = np.random.default_rng(105)
    poses = TURN, np.zeros(len(TURN))
    seen, _ = truth(rng, half=False, sign=1, poses=poses, part=dull, noise=0.03, bounces=1)
    found = fit_light(dull, seen, bounces=1)
    assert found.side_chi2 < 13.8
    with pytest.raises(UsageError, match="alike"):
        replace(PART, ridge_angle_deg=0.1)
    with pytest.raises(MeasurementError, match="at least 6 poses"):
        fit_light(dull, replace(seen, lean_deg=TURN[:5], radiance=seen.radiance[:5]))


def test_directions_are_those_of_the_convention():
    poses = [Pose(angle, tilt) for angle in (0.0, 40.0, 270.0) for tilt in (-20.0, 0.0, 12.0)]
    light, camera = directions(tuple(poses), Convention(11.0))
    lean = np.array([pose.stage_deg for pose in poses])
    tilt = np.array([pose.tilt_deg for pose in poses])
    found = lab_directions(lean, tilt, 11.0, 0.0)
    np.testing.assert_allclose(found[0], light, atol=1e-12)
    np.testing.assert_allclose(found[1], camera, atol=1e-12)
    # a light turned about the camera's axis, and the part with it, are the same as before
    turned = lab_directions(lean + 25.0, np.zeros_like(tilt), 11.0, 25.0)
    straight = lab_directions(lean, np.zeros_like(tilt), 11.0, 0.0)
    np.testing.assert_allclose(turned[0], straight[0], atol=1e-12)


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("period", [360.0, 180.0])
def test_turning_is_found_over_the_wrap(sense, period, rng):
    reading = np.arange(3.0, 360.0, 25.0)
    noise = 0.02 * rng.standard_normal(len(reading))
    found = fit_turning(reading, (sense * (reading - 171.3) + noise) % period, period)
    assert found.sense == sense
    assert abs(wrapped(found.zero_deg - 171.3, period)) < 3.5 * found.u_zero_deg < 0.05
    assert found.slope == pytest.approx(sense, abs=1e-3)
    crooked = fit_turning(reading, sense * 1.002 * (reading - 171.3) % period, period)
    assert abs(crooked.slope) == pytest.approx(1.002, abs=2e-4)


def test_a_stage_that_does_not_turn_is_told():
    with pytest.raises(MeasurementError, match="does the stage turn"):
        fit_turning(np.arange(0.0, 360.0, 30.0), np.full(12, 40.0))


def fix_at(angle_deg, tilt_deg=0.0, origin=(0.0, 0.0), scale=125.0):
    turn = np.radians(angle_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    squeeze = np.cos(np.radians(tilt_deg))
    matrix = np.diag([scale, -scale * squeeze]) @ rotation
    return Fix(
        matrix, np.array(origin), angle_deg % 360, 1000 / scale, squeeze, 90.0, 0.01, 4, np.empty((0, 2))
    )


def test_the_centre_of_an_eccentric_fixture_is_found(rng):
    off_mm, centre = np.array([0.031, -0.017]), np.array([260.3, 249.1])
    fixes = []
    for angle in np.arange(0.0, 360.0, 40.0):
        fix = fix_at(angle)
        fixes.append(replace(fix, origin_px=centre + fix.matrix @ off_mm + 0.01 * rng.standard_normal(2)))
    found = fit_centre(fixes)
    assert np.abs([found.column_px - centre[0], found.row_px - centre[1]]).max() < 3.5 * found.u_px
    assert np.abs(np.array(found.eccentricity_mm) - off_mm).max() < 3.5 * found.u_eccentricity_mm
    with pytest.raises(MeasurementError, match="3 pictures"):
        fit_centre(fixes[:2])


def test_foreshortening_gives_the_zero_and_never_the_sign(rng):
    reading = np.repeat([10.0, 20.0, 30.0, 40.0, 50.0], 3)
    squeeze = np.cos(np.radians(reading - 31.2)) + 1e-4 * rng.standard_normal(len(reading))
    found = fit_foreshortening(reading, [replace(fix_at(0.0), squeeze=float(s)) for s in squeeze])
    assert abs(found.zero_deg - 31.2) < 3.5 * found.u_zero_deg < 0.1
    other = fit_foreshortening(62.4 - reading, [replace(fix_at(0.0), squeeze=float(s)) for s in squeeze])
    assert other.zero_deg == pytest.approx(found.zero_deg, abs=0.1)
    with pytest.raises(MeasurementError, match="at least 3 tilts"):
        fit_foreshortening(reading[:5], [fix_at(0.0)] * 5)


def test_readings_stay_within_the_reach_of_the_stage():
    assert turn_readings((0.0, 360.0), 2.0, 15.0) == tuple(2.0 + 15.0 * n for n in range(24))
    assert turn_readings((-360.0, 360.0), 0.0, 30.0)[0] == 0.0
    short = turn_readings((-90.0, 90.0), 2.0, 20.0)
    assert (short[0], short[-1] <= 90.0, len(short)) == (-88.0, True, 9)
    with pytest.raises(RigFileError, match="too little"):
        turn_readings((0.0, 60.0), 2.0, 15.0)


def test_the_part_of_a_recipe(make_recipe):
    part = part_of_recipe(make_recipe(), None, 0.2)
    assert (part.ridge_angle_deg, part.u_ridge_angle_deg, part.spot_mm) == (10.0, 0.2, 1.0)


def test_a_calibrated_plastic_is_as_uncertain_as_its_file_and_its_parts_say(make_recipe):
    """Not exactly known, as its u_alpha_share of 0 in the recipe would mean, and with its own tail."""
    matrix = np.array([[0.0004, 0.0003, 0.0], [0.0003, 0.0009, 0.0], [0.0, 0.0, 0.0016]])
    file = MaterialFile.model_validate(
        {
            "id": "plastic",
            "name": "plastic",
            "material": {"alpha_along": 0.06, "alpha_across": 0.1, "albedo": 0.2, "tail": 0.7},
            "covariance": {
                "parameters": ("ln_alpha_across", "ln_alpha_along", "tail"),
                "matrix": matrix.tolist(),
            },
            "validity": {"half_angle_deg": (0.0, 40.0)},
        }
    )
    known = {**dict(file.material), "u_alpha_share": 0.0, "u_albedo": 0.0, "u_tail": 0.0, "calibrated": file}
    recipe = make_recipe(scatter={"alpha_share": 0.05, "albedo_share": 0.03})
    part = part_of_recipe(
        recipe.model_copy(update={"material": recipe.material.model_copy(update=known)}), None, 0.1
    )
    across, along = 0.0004 + 0.0025, 0.0009 + 0.0025
    assert part.u_log_mean == pytest.approx(0.5 * np.sqrt(along + across + 0.0006))
    assert part.u_log_ratio == pytest.approx(np.sqrt(along + across - 0.0006))
    assert (part.tail, part.u_tail, part.u_albedo) == (0.7, pytest.approx(0.04), pytest.approx(0.006))
    plain = replace(part, alpha_covariance=None, u_alpha_share=0.1)
    assert (plain.u_log_mean, plain.u_log_ratio) == pytest.approx((0.1 / np.sqrt(2.0), 0.1 * np.sqrt(2.0)))
    model = RigModel(part, np.zeros(2), np.zeros(2), 1)
    values = {
        "log_scale": 0.0,
        "light_deg": 10.0,
        "azimuth_deg": 0.0,
        "tilt_zero_deg": 0.0,
        "ridge_deg": 10.0,
    }
    values |= {
        "log_mean": np.log(0.1 * 0.06) / 2,
        "log_ratio": np.log(0.1 / 0.06),
        "albedo": 0.2,
        "index": 1.5,
    }
    values |= {"seat_x_deg": 0.0, "seat_y_deg": 0.0}
    sides = directions(pose_grid((0.0, 0.0)), Convention(10.0))
    expected = radiance(*sides, RidgeDesign(100.0, 10.0), file.material.material())
    np.testing.assert_allclose(np.exp(model(values)), expected, rtol=1e-9)


def test_the_height_map_of_a_recipe_is_measured_and_its_roughness_adds(make_recipe, tmp_path, rng):
    smooth = ridges(RidgeDesign(100.0, 8.0), (401, 801), 1.0)
    write_height_map(add_facet_roughness(smooth, 0.04, 0.05, 8.0, rng), tmp_path / "part.x3p")
    mapped = make_recipe(surface={"height_map": str(tmp_path / "part.x3p"), "design": None})
    part = part_of_recipe(mapped, None, 0.1)
    assert part.ridge_angle_deg == pytest.approx(8.0, abs=0.1)
    made = mapped.material
    assert part.alpha_along == pytest.approx(np.hypot(made.alpha_along, 0.04), rel=0.05)
    assert part.alpha_across == pytest.approx(np.hypot(made.alpha_across, 0.05), rel=0.05)
    assert part_of_recipe(mapped, 9.5, 0.1).ridge_angle_deg == 9.5


def test_a_rig_file_keeps_its_comments(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(
        '# our rig\nschema = 1\nname = "r"\n[stage] # the turntable\ndriver = "elliptec"\nport = "COM3"\n'
        'zero_deg = 10.0  # by eye\n[stage.options]\naddress = "0"\n[camera]\ndriver = "simulated"\npixel_um = 4.0\n'
        '[light]\nangle_deg = 10.0\n[ light . channels.far ]\nangle_deg = 18.0  # red\n',
        encoding="utf-8",
    )  # fmt: skip
    before = path.read_bytes()
    changes = {("stage", "zero_deg"): 12.25, ("stage", "turns"): "cw", ("light", "angle_deg"): 9.5}
    written = update_rig_file(path, changes | {("light", "channels", "far", "angle_deg"): 20.5})
    text = path.read_text(encoding="utf-8")
    assert written.comments_preserved
    assert written.backup.read_bytes() == before
    assert "zero_deg = 12.25  # by eye" in text
    assert "angle_deg = 20.5  # red" in text
    assert text.startswith("# our rig")
    file = read_rig(path)
    assert (file.stage.turns, file.stage.zero_deg, file.light.angle_deg) == ("cw", 12.25, 9.5)


def test_a_rig_file_written_otherwise_is_written_anew(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(
        '# inline\nschema = 1\nname = "r"\nstage = { driver = "elliptec", port = "COM3" }\n'
        'light = { angle_deg = 10.0 }\n[camera]\ndriver = "simulated"\npixel_um = 4.0\n',
        encoding="utf-8",
    )  # fmt: skip
    written = update_rig_file(path, {("stage", "turns"): "cw"})
    assert not written.comments_preserved
    assert read_rig(path).stage.turns == "cw"
    assert "# inline" in written.backup.read_text(encoding="utf-8")
    before = path.read_bytes()
    with pytest.raises(RigFileError):
        update_rig_file(path, {("stage", "turns"): "sideways"})
    assert path.read_bytes() == before
