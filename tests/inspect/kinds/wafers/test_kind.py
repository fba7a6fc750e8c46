"""Wafers inspected end to end: verdicts, what is wrong, optics in the record, the report, and computing it again."""

import hashlib
import json
import shutil
import tomllib

import numpy as np
import pytest
import tomli_w

from anisoscope.base.errors import RigFileError
from anisoscope.calibration.pictures import take_flat
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.report_seal import SEAL_NAME
from anisoscope.inspection.run import Methods, inspect_part
from anisoscope.kinds.registry import kind_of, read_recipe
from anisoscope.kinds.wafers.kind import OPTICS
from anisoscope.operations.demo import wafers as demo_wafer
from anisoscope.prediction.cache import cached_expectation
from anisoscope.record.schema import RECORD_NAME, REPORT_NAME, UNSEALED
from anisoscope.rig.rigfile import read_rig

TILE_UM = 128.0
WRONG = {"good": {}, "deep": {"over_etch_nm": 20.0}, "wide": {"width_bias_nm": 640.0}}


@pytest.fixture(scope="module")
def wafers(tmp_path_factory, small_wafer_rig):
    """Recipe, flat, and a rig for every wafer: the demo's, with a tile of 128 µm and two stage angles."""
    folder = tmp_path_factory.mktemp("wafers")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("DOT_UM", 64.0), ("DOTS", 2), ("TILE_UM", TILE_UM)):
            patch.setattr(demo_wafer, name, value)
        demo_wafer.write_tile(folder, np.random.default_rng(5))
        recipe = demo_wafer.recipe()
    recipe["poses"]["angles_deg"] = [0.0, 90.0]
    recipe["acquisition"] |= {"frames_per_pose": 2, "dark_frames": 2}
    (folder / "recipe.toml").write_text(tomli_w.dumps(recipe))
    for name in (*WRONG, "white-tile"):
        place = folder / "bench" / name
        place.mkdir(parents=True)
        sample = {"kind": "white-tile"}
        if name in WRONG:
            light = demo_wafer.LIGHT
            wafer = {"file": "../../wafer.npz", "reflectance": 0.9, "scatter": 0.001, **light, **WRONG[name]}
            sample = {"kind": "wafer", "size_mm": 0.6, "wafer": wafer}
        (place / "bench.toml").write_text(tomli_w.dumps(small_wafer_rig(demo_wafer.bench(sample, 7))))
        (place / "rig.toml").write_text(tomli_w.dumps(small_wafer_rig(demo_wafer.rig(name))))
    rig = folder / "bench" / "white-tile" / "rig.toml"
    take_flat(rig, folder / "flat.tif", exposure_s=0.03, frames=4, reflectance=0.99)
    return folder


@pytest.fixture(scope="module")
def inspected(wafers, plain):
    """``inspected(name)``: each wafer is inspected once, with all causes of wafers."""
    kept = {}

    def inspect(name):
        if name not in kept:
            rig = wafers / "bench" / name / "rig.toml"
            # one report is looked at
            methods = Methods(start_renderer=plain.start_renderer) if name == "good" else plain
            kept[name] = inspect_part(
                wafers / "recipe.toml", rig, f"W-{name}", wafers / "inspections", methods=methods
            )
        return kept[name]

    return inspect


def test_a_good_wafer_passes_and_its_pictures_are_as_predicted(inspected):
    record = inspected("good").record
    assert record.verdict == "PASS", record.reasons
    assert record.p_value > 0.01
    for pose in record.poses:
        assert pose.measured == pytest.approx(pose.predicted, rel=0.02)
    assert inspected("good").notes == ()
    # the wide axis is bright at 90°: the same wafer, turned by 90°, the other way round
    dark, bright = (pose.predicted for pose in record.poses if pose.tilt_deg == demo_wafer.TILT_DEG)
    assert np.log(bright / dark) > 1.5


def test_a_wafer_that_slips_on_its_fixture_is_invalid(wafers, plain):
    place = wafers / "bench" / "slips"
    shutil.copytree(wafers / "bench" / "good", place)
    bench = tomllib.loads((place / "bench.toml").read_text())
    bench["faults"] = {"slips_at": 2, "slip_deg": 5.0}
    (place / "bench.toml").write_text(tomli_w.dumps(bench))
    out = wafers / "slipped"
    record = inspect_part(wafers / "recipe.toml", place / "rig.toml", "W-slips", out, methods=plain).record
    assert record.verdict == "INVALID"
    assert "between 0° and 90° the part turned by +5.0° on its fixture" in record.reasons[0]


@pytest.mark.parametrize(("name", "verdict"), [("good", "PASS"), ("deep", "FAIL")])
def test_veiling_glare_of_a_spike_is_no_fault_of_the_rig(wafers, undiagnosed, tmp_path, name, verdict):
    """0.6 % of the light of a spike is twice as much as that of the black of the markers."""
    place = wafers / "bench" / f"{name}-veiled"
    shutil.copytree(wafers / "bench" / name, place)
    bench = tomllib.loads((place / "bench.toml").read_text())
    bench["faults"] = {"veiling_glare": 0.006}
    (place / "bench.toml").write_text(tomli_w.dumps(bench))
    how = {"methods": undiagnosed}
    record = inspect_part(
        wafers / "recipe.toml", place / "rig.toml", "W-veiled", tmp_path / "out", **how
    ).record
    assert record.verdict == verdict, record.reasons


def test_the_record_and_the_report_say_which_optics_and_why(inspected):
    record, report = inspected("good").record, inspected("good").report.read_text()
    assert (record.model, record.optics.asked, record.optics.model) == ("wave", "auto", "wave")
    assert "the surface is stepped" in record.optics.reason
    assert 'id="optics"' in report
    assert record.optics.reason in report
    sources = {row.source for row in record.budget}
    assert {"depth of the etch passes", "width of the etched features", "wavelength of the lamp"} <= sources
    assert {"aperture of the lens", "size of the lamp", "seating tilt about x", "zero of the tilt"} <= sources
    assert not any("roughness" in source for source in sources)
    assert (record.details.area.share, record.details.area.verdict) == (0.0, "PASS")  # tiles among each other
    assert record.details.shape is None
    assert record.details.map_place is None


@pytest.mark.parametrize(
    ("name", "cause", "true", "rel", "tied"),
    [
        ("deep", "over-etch", 20.0, 0.05, "under-etch"),
        pytest.param("wide", "width-bias", 640.0, 0.15, "width-loss", marks=pytest.mark.soak),
    ],
)
def test_wrong_etching_fails_and_is_named_with_its_size(inspected, name, cause, true, rel, tied):
    record = inspected(name).record
    assert record.verdict == "FAIL", record.reasons
    causes = {one.cause: one for one in record.diagnosis.causes}
    found = causes[cause]
    assert found.tie
    assert found.severity == pytest.approx(true, rel=rel)
    assert found.interval[0] < true < found.interval[1]
    assert found.u < 0.15 * true
    best = record.diagnosis.causes[0].cause
    assert best in (cause, tied)
    assert record.diagnosis.unexplained_p > 0.001
    assert not {"burrs", "wear", "ridge-angle", "roughness-across", "colour"} & set(causes)
    other = {"over-etch", "under-etch", "width-bias", "width-loss"} - {cause, tied}
    assert not any(causes[one].tie for one in other)


def test_the_spike_shows_in_the_contrasts_between_tilts_of_record_and_report(inspected):
    good, deep = inspected("good"), inspected("deep").record
    for record in (good.record, deep):
        radiance = {(pose.stage_deg, pose.tilt_deg): pose for pose in record.poses}
        assert len(record.details.between_tilts) == 2
        for one in record.details.between_tilts:
            first, other = (radiance[one.stage_deg, tilt] for tilt in (one.from_tilt_deg, one.to_tilt_deg))
            assert one.measured == pytest.approx(np.log(first.measured / other.measured))
            assert one.predicted == pytest.approx(np.log(first.predicted / other.predicted))
            assert one.u == pytest.approx(np.hypot(one.u_measured, one.u_predicted))
            assert one.u_measured < 0.01 < one.u_predicted  # the seat decides where the mirror direction is
    assert min(one.p_value for one in good.record.details.between_tilts) > 0.01
    assert max(one.p_value for one in deep.details.between_tilts) < 1e-6
    assert all(one.p_value > 0.001 for one in deep.details.contrasts)  # at one tilt nothing is seen of it
    report = good.report.read_text()
    assert 'id="between-tilts"' in report
    assert "0°, tilt 0° / 3°" in report


def test_what_would_tell_too_deep_from_too_shallow_is_computed(inspected):
    tells = inspected("deep").record.diagnosis.tells
    assert "a second lamp of 470 nm with the same poses" in tells
    assert "stage angles" not in tells
    assert inspected("good").record.diagnosis.tells is None


def test_scattered_light_is_called_so_and_records_of_before_compute_again(inspected, tmp_path):
    folder = tmp_path / "old"
    shutil.copytree(inspected("good").folder, folder)
    path = folder / RECORD_NAME
    content = json.loads(path.read_text(encoding="utf-8"))
    (row,) = (row for row in content["budget"] if row["source"] == "share of scattered light")
    assert not any("plastic" in other["source"] for other in content["budget"])
    row["source"] = "albedo of the plastic"
    del content["details"]["between_tilts"], content["diagnosis"]["tells"]
    report = (folder / REPORT_NAME).read_bytes()  # a record of before lists its report itself
    content["files"].append({"name": REPORT_NAME, "sha256": hashlib.sha256(report).hexdigest()})
    (folder / SEAL_NAME).unlink()
    text = json.dumps(content | {"seal": UNSEALED}, indent=2)
    path.write_text(text.replace(UNSEALED, hashlib.sha256(text.encode()).hexdigest()), encoding="utf-8")
    again = recompute(folder)
    assert (again.differences, again.verdict) == ((), "PASS")
    assert "did not tell it: details.between_tilts, diagnosis.tells" in again.notes[-1]
    assert verify(folder).intact


def test_every_change_of_a_wafers_folder_shows(inspected, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(inspected("good").folder, folder)
    kept = verify(folder)
    assert (kept.finished, kept.changed, kept.missing) == (True, (), ())
    copies = [one.name for one in inspected("good").record.inputs]
    assert any(name.endswith("tile.npz") for name in copies)
    (tile,) = (folder / name for name in copies if name.endswith("tile.npz"))
    tile.write_bytes(tile.read_bytes() + b" ")
    assert verify(folder).changed == (str(tile.relative_to(folder)),)


def test_the_prediction_of_a_wafer_is_kept(wafers, monkeypatch):
    recipe = read_recipe(wafers / "recipe.toml")
    first = cached_expectation(recipe, 0.0, OPTICS)
    monkeypatch.setattr("anisoscope.prediction.cache.expectation", lambda *_: pytest.fail("predicted again"))
    assert cached_expectation(recipe, 0.0, OPTICS) is first


def test_a_region_that_leaves_the_wafer_is_invalid(wafers, plain):
    """A quarter of the region on the plate; the contrasts of the rest are those of a good wafer."""
    table = tomllib.loads((wafers / "recipe.toml").read_text())
    table["region"]["center_mm"] = [0.2, 0.0]
    (wafers / "shifted.toml").write_text(tomli_w.dumps(table))
    rig = wafers / "bench" / "good" / "rig.toml"
    record = inspect_part(
        wafers / "shifted.toml", rig, "W-shifted", wafers / "inspections", methods=plain
    ).record
    assert record.verdict == "INVALID"
    assert "the region reaches beyond the part at 2 corners: " in record.reasons[0]


def test_a_lamp_too_near_for_a_wafer_is_refused(wafers):
    recipe = read_recipe(wafers / "recipe.toml")
    rig = read_rig(wafers / "bench" / "good" / "rig.toml")
    near, far = (
        rig.model_copy(update={"light": rig.light.model_copy(update={"distance_mm": one})})
        for one in (80.0, 5e3)
    )
    kind = kind_of(wafers / "recipe.toml")
    with pytest.raises(RigFileError, match=r"turns by ± .*light of one direction within 0\.\d+°"):
        kind.predict(recipe, near, cached=True)
    plain = kind.predict(recipe, rig, cached=True)
    np.testing.assert_array_equal(kind.predict(recipe, far, cached=True).radiance, plain.radiance)
