"""Plates: prediction of their classes, gates, verdict on classes and fields, and the code."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import tomli_w

from anisoscope.base.errors import MeasurementError, RecipeError
from anisoscope.cli.demo import plates as demo
from anisoscope.imaging.registration.placement import Grid
from anisoscope.kinds.plates.decision import decide_plate, looks_like, predicted_fields
from anisoscope.kinds.plates.expectation import expected_plate
from anisoscope.kinds.plates.kind import PLATES
from anisoscope.kinds.plates.measurement import MeasuredPlate, check_plan, decoded, field_means
from anisoscope.kinds.plates.record import graded
from anisoscope.kinds.registry import kind_of
from anisoscope.profiles.plates import Plan
from anisoscope.sim.design.plates import modules_of_code

LIGHT_DEG = 10.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    where = tmp_path_factory.mktemp("plate")
    (where / "plan.csv").write_text("\n".join(",".join(row) for row in demo.plan_rows()))
    (where / "recipe.toml").write_text(tomli_w.dumps(demo.recipe()))
    return where


@pytest.fixture(scope="module")
def recipe(folder):
    return PLATES.read_recipe(folder / "recipe.toml")


@pytest.fixture(scope="module")
def expected(recipe):
    return expected_plate(recipe, recipe.plan.plan(), LIGHT_DEG, cached=True)


def measured(expected, factor=None, texts=(demo.TEXT, demo.TEXT), seed=1, scatter=0.02):
    """A plate as predicted but for a scatter between its fields, and factors on some."""
    shown = predicted_fields(expected)
    rng = np.random.default_rng(seed)
    shown = shown * np.exp(scatter * rng.standard_normal(shown.shape))
    if factor is not None:
        shown = shown * factor
    none = np.full(shown.shape, 1e-3)
    return MeasuredPlate(
        shown, none, np.full(len(shown), 1e-3), (), Grid((0.0, 0.0), 0.005, (9, 9)), 0.0, 0.99, texts
    )


def changed(expected, places, defect):
    """Factors (P, rows, cols) on fields that have a defect."""
    classes = expected.plan.classes()
    found = np.ones((len(expected.poses), *classes.shape))
    for row, col in places:
        found[:, row, col] = np.exp(expected.defects[defect][classes[row, col]])
    return found


def test_classes_a_quarter_turn_apart_exchange_light_and_dark(expected):
    first, second = expected.radiance
    np.testing.assert_allclose(first, second[::-1], rtol=0.005)
    assert first[0] > 5.0 * first[1]
    # one error of the plastic moves bright and dark classes together, as far as they show the same flank
    covariance = expected.covariance()
    np.testing.assert_allclose(covariance[0, 0], covariance[3, 3], rtol=0.05)


def test_a_good_plate_passes_and_its_levels_hold(expected, recipe):
    verdicts = [decide_plate(expected, measured(expected, seed=seed), recipe) for seed in range(5)]
    assert {one.verdict for one in verdicts} == {"PASS"}
    assert not any(one.deviating.any() for one in verdicts)
    names = [one.name for one in verdicts[0].details.contrasts]
    assert names == ["ln A/B at 0", "ln A/B at 90", "ln A 0-90", "ln B 0-90"]
    assert verdicts[0].details.numbers()["deviating fields"] == 0.0


@pytest.mark.parametrize("defect", ["missing", "wrong direction", "filled"])
def test_fields_with_a_defect_are_found_and_named(expected, recipe, defect):
    places = [(3, 4), (6, 8), (9, 2)]
    found = decide_plate(expected, measured(expected, changed(expected, places, defect)), recipe)
    assert found.verdict == "FAIL"
    assert sorted((one.row, one.col) for one in found.details.fields) == sorted(places)
    assert {one.looks_like for one in found.details.fields} == {defect}
    assert sorted(zip(*np.nonzero(found.deviating), strict=True)) == sorted(places)
    assert "3 fields deviate from the class" in found.reasons[0]


def test_a_plate_worn_all_over_fails_by_its_classes_not_by_its_fields(expected, recipe):
    worn = np.exp(2.5 * expected.defects["worn"])
    factor = worn.T[:, np.maximum(expected.plan.classes(), 0)]
    found = decide_plate(expected, measured(expected, factor), recipe)
    assert found.verdict == "FAIL"
    assert found.details.fields == ()
    assert found.reasons[0].startswith("ln ")


def test_a_code_that_is_not_read_fails_and_a_field_within_its_guard_band_is_undecided(expected, recipe):
    found = decide_plate(expected, measured(expected, texts=(demo.TEXT, None)), recipe)
    assert found.verdict == "FAIL"
    assert found.reasons == (f"the code does not read {demo.TEXT!r} in every required pose: nothing",)
    one = measured(expected, scatter=0.0)
    shown = one.radiance.copy()
    shown[0, 3, 4] *= np.exp(recipe.fields.tolerance)
    assert decide_plate(expected, replace(one, radiance=shown), recipe).verdict == "INCONCLUSIVE"


def test_what_looks_like_no_defect_is_not_named(expected):
    defects = {name: one[0] for name, one in expected.defects.items()}
    assert looks_like(np.array([3.0, 3.0]), defects) is None
    assert looks_like(defects["worn"], defects) == "worn"


def test_a_plate_that_lies_otherwise_or_is_another_one_is_invalid(expected):
    good = measured(expected).radiance
    assert check_plan(good, expected) > 0.95
    # turned by a quarter: places and directions turn
    classes = np.rot90(expected.plan.classes(), 1)
    light = np.exp(expected.turned[1])
    turned = light.T[:, np.maximum(classes, 0)]
    with pytest.raises(
        MeasurementError, match=r"the plate lies turned by 90° \(correlation with the plan 1\.00"
    ):
        check_plan(turned, expected)
    mirrored = good[:, :, ::-1]
    with pytest.raises(MeasurementError, match="the plan is mirrored, or is that of the mould"):
        check_plan(mirrored, expected)
    rng = np.random.default_rng(1)
    other = rng.permuted(good.reshape(len(good), -1), axis=1).reshape(good.shape)
    with pytest.raises(
        MeasurementError, match=r"are not those of the plan.*plan of another plate, or .* upside down"
    ):
        check_plan(other, expected)
    flat = 0.05 * np.exp(0.02 * rng.standard_normal(good.shape))
    with pytest.raises(MeasurementError, match="upside down"):
        check_plan(flat, expected)


def test_the_mean_of_a_field_is_that_of_its_middle():
    picture = np.zeros((20, 30), dtype=np.float32)
    picture[:10, 10:20] = 3.0
    picture[:10, 10] = 99.0  # border
    assert field_means(picture, 10, 0.6).tolist() == [[0.0, 3.0, 0.0], [0.0, 0.0, 0.0]]
    picture[4, 14] = np.nan
    assert field_means(picture, 10, 0.6)[0, 1] == pytest.approx(3.0)


@pytest.mark.parametrize("symbology", ["datamatrix", "qr"])
def test_codes_are_read_dark_on_light_and_light_on_dark(symbology):
    dark = modules_of_code("RIDGE 7", symbology)
    picture = np.kron(np.where(dark, 0.03, 0.27), np.ones((9, 9))).astype(np.float32)
    assert decoded(picture, symbology) == "RIDGE 7"
    assert decoded(0.3 - picture, symbology) == "RIDGE 7"
    assert decoded(np.full_like(picture, 0.1), symbology) is None


def test_grades_follow_contrast_modulation_and_damage():
    dark = modules_of_code("A17", "datamatrix")
    rng = np.random.default_rng(1)
    light = np.where(dark, 0.03, 0.27)
    perfect = {one.parameter: one for one in graded(light, dark, "datamatrix")}
    assert perfect["cell contrast"].value == pytest.approx(1.0 - 0.03 / 0.27)
    assert {one.grade for one in perfect.values()} == {4}
    assert "wrong modules" not in perfect
    pale = {one.parameter: one for one in graded(np.where(dark, 0.22, 0.27), dark, "datamatrix")}
    assert pale["cell contrast"].grade == 1
    noisy = np.where(dark, 0.03, 0.27) + 0.075 * rng.uniform(-1.0, 1.0, dark.shape)
    assert 0 < {one.parameter: one for one in graded(noisy, dark, "datamatrix")}["cell modulation"].grade < 4
    broken = light.copy()
    broken[3:5, 1] = 0.27  # two modules of the left side of the finder pattern
    damaged = {one.parameter: one for one in graded(broken, dark, "datamatrix")}
    assert damaged["fixed pattern damage"].value == pytest.approx(0.2)
    assert damaged["fixed pattern damage"].grade == 0
    assert damaged["wrong modules"].value == pytest.approx(2 / dark.size)


def test_a_plan_may_be_an_image_or_rows_and_its_table_makes_the_kind(folder, recipe, tmp_path):
    dark = modules_of_code(demo.TEXT, "datamatrix")
    cv2.imwrite(str(tmp_path / "plan.png"), np.where(dark, 0, 255).astype(np.uint8))
    table = demo.recipe()
    del table["kind"]
    table["plan"]["file"] = "plan.png"
    (tmp_path / "recipe.toml").write_text(tomli_w.dumps(table))
    assert kind_of(tmp_path / "recipe.toml") is PLATES
    assert PLATES.read_recipe(tmp_path / "recipe.toml").plan.plan() == recipe.plan.plan()
    assert PLATES.sources(recipe, None) == {"plan": folder / "plan.csv"}


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"plan": {"module_mm": 0.2}}, "give rows, or the file that holds the plan"),
        ({"plan": {"module_mm": 0.2, "file": "none.csv"}}, "none.csv: cannot be read"),
        ({"plan": {"module_mm": 0.2, "rows": ["AX"]}}, "holds 'X', which is no class of direction"),
        ({"plan": {"module_mm": 0.08, "rows": ["AB"]}}, r"hold 1\.6 ridges of 50 µm, 2 are needed"),
        ({"plan": {"module_mm": 2.0, "rows": ["AB"]}}, r"are larger than region\.size_mm"),
        (
            {"plan": {"module_mm": 0.2, "rows": ["AB"], "facet_azimuths_deg": {"AB": 0.0}}},
            "called by one letter",
        ),
        (
            {"code": {"text": "A17", "read_at_deg": [45.0]}},
            r"code\.read_at_deg: 45 is none of poses\.angles_deg",
        ),
        ({"surface": {"pitch_um": 50.0, "height_map": "map.x3p"}}, "give design, and no height_map"),
    ],
)
def test_a_recipe_that_does_not_fit_is_one_line(tmp_path, change, match):
    table = demo.recipe()
    table["plan"] = {
        "module_mm": 0.2,
        "rows": list(demo.plan_rows()),
        "facet_azimuths_deg": demo.AZIMUTHS_DEG,
    }
    (tmp_path / "recipe.toml").write_text(tomli_w.dumps(table | change))
    with pytest.raises(RecipeError, match=match) as problem:
        PLATES.read_recipe(tmp_path / "recipe.toml")
    assert "\n" not in str(problem.value)


def test_three_directions_have_contrasts_of_neighbours(recipe):
    plan = Plan(("ABC", "CAB"), {"A": 0.0, "B": -90.0, "C": 180.0}, 0.2)
    found = expected_plate(recipe, plan, LIGHT_DEG, cached=True)
    assert found.radiance.shape == (3, 2)
    decided = decide_plate(found, measured(found), recipe.model_copy(update={"code": None}))
    names = [one.name for one in decided.details.contrasts]
    assert names[:4] == ["ln A/B at 0", "ln B/C at 0", "ln A/B at 90", "ln B/C at 90"]


def test_a_new_recipe_begins_with_a_plan(anisoscope, tmp_path):
    done = anisoscope("recipe", "new", "--out", tmp_path / "plate.toml", "--kind", "plates")
    assert done.code == 64
    assert "the recipe of a plate begins with its plan: `anisoscope design code TEXT" in " ".join(
        done.err.split()
    )
    assert not (tmp_path / "plate.toml").exists()


def test_golden_plates_are_not_collected(anisoscope, folder):
    done = anisoscope("golden", "show", "--recipe", folder / "recipe.toml")
    assert done.code >= 64
    assert "Traceback" not in done.err
    assert done.err.strip().count("\n") == 0
