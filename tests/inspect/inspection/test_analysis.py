"""What a record tells beside the verdict, from frames to recomputation."""

import json
from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.decision.design_vs_map import READINGS, compare
from anisoscope.decision.reference_parts import GoldenSet, golden_path, write_golden
from anisoscope.diagnosis.cause_model import PLASTIC_CAUSES
from anisoscope.diagnosis.shape_fit import fit_shape
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.inspection.pipeline import diagnose_by_kind
from anisoscope.inspection.recompute import recompute
from anisoscope.kinds.registry import read_recipe
from anisoscope.kinds.ridges.kind import Ridges
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.cache import forget
from anisoscope.prediction.expectation import Component, expectation
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import ridges
from anisoscope.record.schema import Record, read_record

WRONG = {"sample": {"material": {"alpha_along": 0.09}}}
STRICT = {"decision": {"tolerance": None, "alpha": 0.01}}


def seen(radiance, u=0.003):
    """A measurement of these radiances."""
    noise = Component("noise of camera and photons", "measurement", np.full(len(radiance), u), shared=False)
    cells = np.repeat(np.asarray(radiance)[:, None, None], 16, axis=1)
    grid = Grid((0.0, 0.0), 0.025, (4, 4))
    return Measured(np.asarray(radiance), (noise,), (), cells, np.full(len(radiance), 0.01), grid, 0.0)


def test_a_wrong_roughness_is_named_and_recomputed(virtual_rig):
    found = virtual_rig(recipe=STRICT, bench=WRONG).inspect()
    record = read_record(found.folder)
    assert record.verdict == "FAIL"
    best = record.diagnosis.causes[0]
    assert best.cause == "roughness-along"
    assert best.severity == pytest.approx(0.5, abs=max(4 * best.u, 0.1))
    assert len(record.diagnosis.causes) >= 15
    assert sum(cause.weight for cause in record.diagnosis.causes) == pytest.approx(1.0)
    again = recompute(found.folder)
    assert (again.verdict, again.differences) == ("FAIL", ())


@pytest.mark.soak
def test_all_causes_are_the_same_without_what_was_kept(virtual_rig, tmp_path, monkeypatch):
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path / "one"))
    found = virtual_rig(recipe=STRICT, bench=WRONG).inspect()
    assert len(found.record.diagnosis.causes) >= 15
    assert "roughness-along" in [cause.cause for cause in found.record.diagnosis.causes if cause.tie]
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path / "other"))
    assert recompute(found.folder).differences == ()


def test_a_part_as_it_should_be_has_nothing_to_explain(virtual_rig):
    record = virtual_rig(recipe={"decision": {"remeasure": 0}}).inspect().record
    assert record.verdict == "PASS"
    assert record.diagnosis.says.startswith("nothing")
    assert record.diagnosis.causes == ()
    assert [(one.surface, one.decides) for one in record.details.comparisons] == [("design", True)]
    assert (record.details.reading, record.details.shape, record.details.golden, record.rounds) == (
        None,
        None,
        None,
        1,
    )


def test_a_diagnosis_that_fails_leaves_the_verdict(virtual_rig, plain):
    def fails(*_):
        raise ModelError("no such surface")

    class Unexplained(Ridges):
        causes = replace(PLASTIC_CAUSES, signatures=fails)

    def diagnose(case, advance):
        return diagnose_by_kind(replace(case, kind=Unexplained()), advance)

    methods = replace(plain, diagnose=diagnose)
    found = virtual_rig(recipe=STRICT, bench=WRONG).inspect(methods=methods)
    assert found.record.verdict == "FAIL"
    assert found.record.diagnosis.says == "not possible"
    assert "no diagnosis: no such surface" in found.notes


def test_golden_parts_decide_what_deviates_and_are_kept_in_the_folder(virtual_rig):
    rig = virtual_rig(recipe=STRICT)
    first = rig.inspect().record
    recipe, rng, golden = read_recipe(rig.recipe), np.random.default_rng(3), None
    for number in range(8):
        poses = tuple(
            pose.model_copy(update={"measured": pose.measured * float(np.exp(0.02 * rng.standard_normal()))})
            for pose in first.poses
        )
        golden = GoldenSet.with_inspection(
            golden, recipe, first.model_copy(update={"serial": f"G{number}", "poses": poses})
        )
        write_golden(golden_path(rig.recipe), golden)
    record = (found := rig.inspect("T-2")).record
    assert record.details.golden.parts == 8
    assert np.shape(record.details.golden.contrasts) == (8, 2)
    assert any("like the 8 golden parts" in reason for reason in record.reasons)
    assert any(file.name == "inputs/recipe.golden.json" for file in record.inputs)
    golden_path(rig.recipe).unlink()
    assert recompute(found.folder).differences == ()


def test_one_golden_part_serves_and_what_it_cannot_show_leaves_a_part_undecided(virtual_rig):
    rig = virtual_rig(recipe={"defects": {"power": 0.9}, "decision": {"remeasure": 0}})
    record = rig.inspect().record
    assert record.verdict == "INCONCLUSIVE"
    assert "add one" in record.reasons[0]  # against the prediction alone no power is known
    write_golden(golden_path(rig.recipe), GoldenSet.with_inspection(None, read_recipe(rig.recipe), record))
    found = rig.inspect("T-2").record
    golden = found.details.golden
    assert (found.verdict, golden.parts, golden.birge) == ("INCONCLUSIVE", 1, None)
    powers = {one.defect: one.power for one in golden.directions}
    assert powers["height loss 10%"] > 0.99
    assert min(powers, key=lambda name: powers[name]) in found.reasons[0]


def test_what_is_undecided_is_measured_again_and_recomputed(virtual_rig):
    # a tolerance at the deviation itself: no number of rounds decides
    first = virtual_rig("first", bench=WRONG, recipe={"decision": {"remeasure": 0}}).inspect().record
    edge = max(abs(one.measured - one.predicted) for one in first.details.contrasts)
    changes = {"decision": {"tolerance": edge, "remeasure": 2}, "area": None}
    found = virtual_rig("edge", bench=WRONG, recipe=changes).inspect()
    assert (found.record.verdict, found.record.rounds) == ("INCONCLUSIVE", 3)
    per_round = 3 * 2 + 2
    assert sum(frame.kind == "sample" and not frame.again for frame in found.record.frames) == 3 * 6
    assert len(found.record.frames) == 2 + 3 * per_round + 2 * 2
    assert recompute(found.folder).differences == ()


def test_records_of_before_stay_readable(inspected_part):
    content = json.loads((inspected_part[1].folder / "record.json").read_text())
    content.pop("seal")
    new = (
        "conformance_probability",
        "regions",
        "diagnosis",
        "comparisons",
        "reading",
        "shape",
        "golden",
        "rounds",
    )
    for name in (*new, "notes"):
        (content["details"] if name in content["details"] else content).pop(name)
    for contrast in content["details"]["contrasts"]:
        del contrast["p_value"], contrast["tolerance_ratio"]
    old = Record.model_validate_json(json.dumps(content))
    assert (old.rounds, old.diagnosis, old.details.contrasts[0].p_value) == (1, None, None)


@pytest.mark.parametrize("agrees", [(True, True), (True, False), (False, True), (False, False)])
def test_both_surfaces_read_together(make_recipe, tmp_path, agrees):
    recipe = make_recipe(surface={"height_map": str(tmp_path / "map.x3p"), "compare": "design"})
    design = expectation(recipe, 10.0)
    other = design.radiance * np.array([1.0, 2.0, 0.6])
    mapped = design.__class__(**{**vars(design), "radiance": other, "model": "relief"})
    second = design if all(agrees) else mapped
    radiance = {
        (True, True): design.radiance,
        (True, False): design.radiance,
        (False, True): other,
        (False, False): design.radiance * np.array([1.0, 0.3, 3.0]),
    }[agrees]
    found = compare(recipe, design, seen(radiance), lambda *_: second)
    assert tuple(one.agrees for one in found.comparisons) == agrees
    assert (found.reading, found.note) == (READINGS[agrees], None)
    assert [one.decides for one in found.comparisons] == [True, False]
    assert [one.reading for one in found.readings] == [
        "measured-design",
        "measured-map",
        "map-design",
        "geometry",
    ]
    assert tuple(one.agrees for one in found.readings) == (
        *agrees,
        all(agrees),
        None,
    )  # there is no map to measure
    said = [one.says for one in found.readings]
    assert [" not agree" in one for one in said[:2]] == [not one for one in agrees]


def test_the_second_surface_is_predicted_once_for_all_parts_and_anew_to_recompute(virtual_rig, monkeypatch):
    rig = virtual_rig(recipe={"surface": {"height_map": "map.npz", "compare": "design"}})
    ridged = ridges(RidgeDesign(100.0, 10.0), (241, 1201), (5.0, 1.0))
    write_height_map(ridged, rig.recipe.parent / "map.npz")
    predicted = []

    def counted(recipe, light_angle_deg, _optics):
        predicted.append(recipe.surface.decides)
        return expectation(recipe, light_angle_deg)

    monkeypatch.setattr("anisoscope.prediction.cache.expectation", counted)
    forget()
    found = [rig.inspect(serial) for serial in ("K-1", "K-2")]
    records = [one.record for one in found]
    assert sorted(predicted) == ["design", "height_map"]
    for record in records:
        assert [one.surface for one in record.details.comparisons] == ["design", "height_map"]
    assert records[0].details.comparisons[1].predicted == records[1].details.comparisons[1].predicted
    _, _, light, geometry = records[0].details.readings
    assert light.agrees
    assert geometry.agrees
    ridge_angle = next(one for one in geometry.numbers if one.name == "ridge angle")
    assert ridge_angle.value == pytest.approx(10.0, abs=0.05)
    del predicted[:]
    assert recompute(found[-1].folder).differences == ()
    assert predicted == []


def test_a_surface_that_cannot_be_read_is_a_note(make_recipe, tmp_path):
    recipe = make_recipe(surface={"height_map": str(tmp_path / "none.x3p"), "compare": "design"})
    design = expectation(recipe, 10.0)
    found = compare(recipe, design, seen(design.radiance))
    assert (len(found.comparisons), found.reading, found.readings) == (1, None, ())
    assert found.note.startswith("no comparison with the height map: ")


def test_the_fit_over_tilts_finds_the_ridge_angle_and_refuses_what_it_cannot(make_recipe):
    poses = {"angles_deg": [0.0, 90.0, 180.0, 270.0], "tilts_deg": [0.0, 20.0]}
    direct = {"reflections": "direct"}
    recipe = make_recipe(poses=poses, surface=direct)
    true = RidgeRecipe.model_validate(
        recipe.model_dump(by_alias=True)
        | {"surface": {"pitch_um": 100.0, "design": {"ridge_angle_deg": 9.0}, **direct}}
    )
    expected = expectation(recipe, 10.0)
    shape, note = fit_shape(recipe, expected, seen(expectation(true, 10.0).radiance))
    assert note is None
    by_name = {one.name: one for one in shape.estimates}
    angle = by_name["ridge_angle_deg"]
    assert angle.value == pytest.approx(9.0, abs=max(3 * angle.u, 0.05))
    assert all((one.u is None) == (one.value is None) for one in shape.estimates)
    assert set(shape.held) == {"seating_x_deg", "seating_y_deg"}  # they look like another ridge angle


def test_one_tilt_is_not_fitted(make_recipe):
    expected = expectation(make_recipe(), 10.0)
    assert fit_shape(make_recipe(), expected, seen(expected.radiance)) == (None, None)


def test_rounded_crests_and_a_drafted_wall_are_inspected_and_recorded(virtual_rig):
    surface = {"design": {"edge_radius_um": 0.5, "wall": 8.0}, "reflections": "all"}
    bench = {"sample": {"reflections": True}}
    rig = virtual_rig(recipe={"surface": surface, "decision": {"remeasure": 0}}, bench=bench)
    record = rig.inspect().record
    assert record.verdict == "PASS"
    assert record.optics.groove_wall == 8.0
    assert read_record(rig.folders[0]).optics.groove_wall == 8.0
