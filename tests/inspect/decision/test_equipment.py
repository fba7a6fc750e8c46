"""Golden parts of another camera, lens or lamp are refused, in one line; what changes no ratio may differ."""

import json
from types import SimpleNamespace

import pytest

from anisoscope.base.errors import CalibrationError, RecipeError
from anisoscope.decision.equipment import Equipment
from anisoscope.decision.reference_parts import GoldenSet, golden_path, write_golden
from anisoscope.inspection.job import prepare
from anisoscope.kinds.registry import kind_of, read_recipe
from anisoscope.recipe.material_file import MaterialLightPart

THEN = Equipment(
    camera="MV-1 4711",
    pixel_um=12.5,
    light_angle_deg=10.0,
    light=MaterialLightPart(
        wavelength_nm=520.0, bandwidth_nm=30.0, lamp_half_angle_deg=1.0, aperture_half_angle_deg=2.0
    ),
)


def with_(**changes):
    light = THEN.light.model_copy(
        update={k: v for k, v in changes.items() if k in MaterialLightPart.model_fields}
    )
    own = {key: value for key, value in changes.items() if key in Equipment.model_fields}
    return THEN.model_copy(update=own | {"light": light})


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"camera": "MV-1 711"}, "camera"),
        ({"camera": "4712"}, "camera"),
        ({"pixel_um": 12.8}, "lens"),
        ({"aperture_half_angle_deg": 3.1}, "lens"),
        ({"light_angle_deg": 10.3}, "lamp"),
        ({"wavelength_nm": 535.0}, "lamp"),
        ({"bandwidth_nm": 55.0}, "lamp"),
        ({"lamp_half_angle_deg": 2.5}, "lamp"),
    ],
)
def test_another_camera_lens_or_lamp_is_named_with_both_values(change, what):
    found = THEN.other(with_(**change))
    assert found.what == what
    (value,) = change.values()
    assert str(value).removesuffix(".0") in found.text()
    assert with_(**change).other(THEN).what == what


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"camera": "4711"},
        {"camera": None},
        {"pixel_um": 12.6},
        {"light_angle_deg": 9.85},
        {"wavelength_nm": 526.0, "lamp_half_angle_deg": 1.9},
        {"wavelength_nm": None, "bandwidth_nm": None},
    ],
)
def test_what_is_not_stated_or_within_its_uncertainty_is_the_same(change):
    assert THEN.other(with_(**change)) is None


def test_what_one_part_does_not_state_is_taken_from_the_next():
    bare = Equipment(pixel_um=12.5, light_angle_deg=10.1)
    assert bare.completed(THEN) == with_(light_angle_deg=10.1)
    assert THEN.completed(bare) == THEN
    assert Equipment.of_record(SimpleNamespace(rig={}, camera="unknown")) is None


def changed(record, camera=None, light=None, **more):
    """The record of another part, measured with other equipment."""
    rig = record.rig | {
        "camera": record.rig["camera"] | (camera or {}),
        "light": record.rig["light"] | (light or {}),
    }
    return record.model_copy(
        update={"serial": "G-2", "created_at": "2026-02-01T00:00:00+00:00", "rig": rig} | more
    )


def test_a_set_takes_parts_of_its_own_equipment_only_and_serves_no_other_rig(inspected_part):
    rig, inspected = inspected_part
    recipe, path = read_recipe(rig.recipe), golden_path(rig.recipe)
    poses = tuple(
        one.model_copy(update={"measured": one.measured * (1.0 + 0.01 * k)})
        for k, one in enumerate(inspected.record.poses)
    )
    another = inspected.record.model_copy(update={"poses": poses})
    first = GoldenSet.with_inspection(None, recipe, inspected.record)
    assert (first.equipment.pixel_um, first.equipment.light_angle_deg) == (8.0, 10.0)
    assert inspected.record.camera == first.equipment.camera
    for difference, what in (
        ({"camera": {"pixel_um": 4.0}}, "another lens than the golden parts: pixel_um 4, theirs 8"),
        ({"light": {"angle_deg": 12.0}}, "another lamp than the golden parts: angle_deg 12°, theirs 10°"),
        ({"model_camera": "MV-1 4711"}, "another camera than the golden parts: MV-1 4711, theirs"),
    ):
        fields = {"camera": "MV-1 4711"} if "model_camera" in difference else {}
        record = changed(another, **{k: v for k, v in difference.items() if k != "model_camera"})
        with pytest.raises(CalibrationError, match=what) as refusal:
            GoldenSet.with_inspection(first, recipe, record.model_copy(update=fields))
        assert "\n" not in str(refusal.value)
    both = GoldenSet.with_inspection(first, recipe, changed(another, light={"wavelength_nm": 520.0}))
    assert both.equipment.light.wavelength_nm == 520.0  # the first one did not state it
    write_golden(path, both)
    assert len(prepare(rig.recipe, rig.rig, "P-1").reference.parts) == 2
    rig.rig.write_text(rig.rig.read_text().replace("angle_deg = 10.0", "angle_deg = 12.0"))
    with pytest.raises(
        CalibrationError, match="measured with another lamp: angle_deg 10°, here 12°: inspect good"
    ):
        prepare(rig.recipe, rig.rig, "P-1")
    with pytest.raises(RecipeError, match="measured with another lamp"):
        kind_of(rig.recipe).check_recipe(rig.recipe, rig.rig, 10.0)


def test_sets_of_earlier_versions_serve_and_learn_their_equipment_from_the_next_part(inspected_part):
    rig, inspected = inspected_part
    recipe, path = read_recipe(rig.recipe), golden_path(rig.recipe)
    write_golden(path, GoldenSet.with_inspection(None, recipe, inspected.record))
    content = json.loads(path.read_text())
    del content["equipment"]
    path.write_text(json.dumps(content))
    known = prepare(rig.recipe, rig.rig, "P-1").reference
    assert known.equipment is None
    poses = tuple(
        one.model_copy(update={"measured": one.measured * 1.01}) for one in inspected.record.poses[:1]
    )
    record = changed(inspected.record, poses=(*poses, *inspected.record.poses[1:]))
    assert GoldenSet.with_inspection(known, recipe, record).equipment.camera == inspected.record.camera
