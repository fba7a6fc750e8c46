"""Plates: prediction of their classes, gates, verdict on classes and fields, and the code."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import tomli_w

from anisoscope.base.errors import HeightMapError, MeasurementError, RecipeError, RigFileError
from anisoscope.base.progress import silent
from anisoscope.base.significance import joint_conformance
from anisoscope.imaging.linearisation import RadianceImage
from anisoscope.imaging.registration.placement import Grid, Placement, View
from anisoscope.kinds.plates.causes import explain_plate, plate_signatures
from anisoscope.kinds.plates.code_symbol import read_picture
from anisoscope.kinds.plates.decision import MEASURE_LOBE, decide_plate, planned_contrasts
from anisoscope.kinds.plates.expectation import expected_plate, quick_light
from anisoscope.kinds.plates.field_judgement import looks_like, predicted_fields
from anisoscope.kinds.plates.field_places import field_places
from anisoscope.kinds.plates.kind import PLATES
from anisoscope.kinds.plates.measurement import (
    MeasuredPlate,
    check_places,
    check_plan,
    field_means,
    measure_plate,
)
from anisoscope.kinds.plates.record import PlateContrastRecord, PlateDetails
from anisoscope.kinds.plates.reference_plates import GoldenPlate, GoldenPlates, reference_table
from anisoscope.kinds.registry import kind_of
from anisoscope.operations.demo import plates as demo
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.plates import Plan, plate_map
from anisoscope.record.verdict import Verdict
from anisoscope.rig.rigfile import LightPart
from anisoscope.sim.design.plates import modules_of_code
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.pathtracer.plastic import Plastic
from anisoscope.sim.pathtracer.tracer import PathTracer

LIGHT_DEG = 10.0


def two_poses():
    """The recipe of the demo at the poses in which its code is read."""
    return demo.recipe() | {"poses": {"angles_deg": demo.READ_AT_DEG}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    where = tmp_path_factory.mktemp("plate")
    (where / "plan.csv").write_text("\n".join(",".join(row) for row in demo.plan_rows()))
    (where / "recipe.toml").write_text(tomli_w.dumps(two_poses()))
    return where


@pytest.fixture(scope="module")
def recipe(folder):
    return PLATES.read_recipe(folder / "recipe.toml")


@pytest.fixture(scope="module")
def expected(recipe):
    return expected_plate(recipe, recipe.plan.plan(), LIGHT_DEG, cached=True)


def test_a_lamp_too_near_for_a_plate_is_refused(recipe):
    rig = SimpleNamespace(light=LightPart(distance_mm=40.0, angle_deg=LIGHT_DEG))
    with pytest.raises(RigFileError, match=r"light of one direction within 0\.\d+°: move the lamp away"):
        PLATES.predict(recipe, rig, cached=True)


def measured(expected, factor=None, texts=None, seed=1, scatter=0.02):
    """A plate as predicted but for a scatter between its fields, and factors on some."""
    shown = predicted_fields(expected)
    rng = np.random.default_rng(seed)
    shown = shown * np.exp(scatter * rng.standard_normal(shown.shape))
    if factor is not None:
        shown = shown * factor
    none = np.full(shown.shape, 1e-3)
    texts = (demo.TEXT,) * len(shown) if texts is None else texts
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
    assert "3 fields deviate from their class" in found.reasons[0]


def test_a_plate_worn_all_over_fails_by_its_classes_not_by_its_fields(expected, recipe):
    worn = np.exp(4.0 * expected.defects["worn"])
    factor = worn.T[:, np.maximum(expected.plan.classes(), 0)]
    found = decide_plate(expected, measured(expected, factor), recipe)
    assert found.verdict == "FAIL"
    assert found.details.fields == ()
    assert found.reasons[0].startswith("ln ")


@pytest.mark.parametrize("rule", ["note", "inconclusive"])
def test_an_angle_that_all_fields_share_is_not_excluded_where_the_lobe_is_unmeasured(folder, rule):
    """Two degrees less look like another lobe, and no fault of a single field."""
    table = demo.recipe() | {"decision": {"unexcluded": rule}}
    table["plan"] = table["plan"] | {"file": str(folder / "plan.csv")}
    table["material"] = {key: table["material"][key] for key in ("alpha_along", "alpha_across", "albedo")}
    recipe = PLATES.recipe.model_validate(table)
    expected = expected_plate(recipe, recipe.plan.plan(), LIGHT_DEG, cached=True)
    light = quick_light(recipe, expected.poses, expected.convention)
    good, lower = (RidgeDesign(demo.PITCH_UM, demo.RIDGE_ANGLE_DEG - off) for off in (0.0, 2.0))
    turns = demo.AZIMUTHS_DEG.values()
    change = np.array([light(lower, turn) - light(good, turn) for turn in turns])
    factor = np.exp(change).T[:, np.maximum(expected.plan.classes(), 0)]
    found = decide_plate(expected, measured(expected, factor), recipe)
    assert found.verdict == ("PASS" if rule == "note" else "INCONCLUSIVE")
    assert found.reasons[0].startswith("not excluded: every field ")
    assert "every field ridge angle −2°" in found.reasons[0]
    assert MEASURE_LOBE in found.reasons[0]
    assert decide_plate(expected, measured(expected), recipe).verdict == "PASS"


def test_a_code_that_is_not_read_fails_and_a_field_within_its_guard_band_is_undecided(expected, recipe):
    found = decide_plate(expected, measured(expected, texts=(demo.TEXT, None)), recipe)
    assert found.verdict == "FAIL"
    assert found.reasons == (f"the code does not read {demo.TEXT!r} in every required pose: nothing",)
    one = measured(expected, scatter=0.0)
    shown = one.radiance.copy()
    shown[0, 3, 4] *= np.exp(recipe.fields.tolerance)
    assert decide_plate(expected, replace(one, radiance=shown), recipe).verdict == "INCONCLUSIVE"


def test_the_check_of_a_recipe_says_how_many_good_plates_stay_undecided(expected, recipe):
    """Against the integral of the normal distribution over the tolerances."""
    names, _, covariance = planned_contrasts(expected, recipe)
    u = np.sqrt(np.diag(covariance))
    narrow = recipe.model_copy(update={"decision": recipe.decision.model_copy(update={"tolerance": 0.2})})
    for one, complained in ((recipe, False), (narrow, True)):
        check = PLATES.capability(one, None, LIGHT_DEG, (), silent)
        assert len(check.contrasts) == len(names)
        limit = one.decision.tolerance - one.decision.coverage * u
        sure = joint_conformance(np.zeros_like(u), covariance, limit)
        assert check.undecided == pytest.approx(1.0 - sure, abs=0.01)
        said = any(
            "good plates may end undecided: decision.tolerance = 0.29" in line for line in check.complaints
        )
        assert said == complained
        assert "T/U" in check.output().behind[1].columns


def test_what_looks_like_no_defect_is_not_named(expected):
    defects = {name: one[0] for name, one in expected.defects.items()}
    assert looks_like(np.array([3.0, 3.0]), defects) == ()
    assert looks_like(defects["worn"], defects) == ("worn",)
    assert looks_like(0.6 * defects["worn"], defects) == ("worn",)


def test_defects_that_the_poses_do_not_tell_apart_tie(expected, recipe):
    """Two poses: a field of the class that faces the light is brighter in the other one, missing or nearly filled."""
    filled, missing = [
        tuple(np.argwhere(expected.plan.classes() == number)[20].tolist()) for number in (0, 1)
    ]
    factor = changed(expected, [filled], "filled") ** 1.2 * changed(expected, [missing], "missing")
    one = measured(expected, factor)
    decided = decide_plate(expected, one, recipe)
    likely = {(one.row, one.col): one.likeness for one in decided.details.fields}
    assert likely[missing] == "missing"
    assert set(likely[filled].split(", perhaps ")) == {"missing", "filled"}
    (cause,) = explain_plate(recipe, expected, one, decided).causes
    assert {part.cause for part in cause.components} == {"fields-missing", "fields-unclear"}


def test_a_single_worn_field_is_found_by_the_scatter_of_its_class(expected, recipe):
    one = measured(expected, changed(expected, [(3, 4)], "worn"))
    found = decide_plate(expected, one, recipe)
    (field,) = found.details.fields
    assert (field.row, field.col, field.looks_like, field.significant) == (3, 4, "worn", True)
    assert field.p_value < 1e-4
    assert found.verdict == "INCONCLUSIVE"
    assert found.reasons[0].startswith("not excluded: field worn to 15 µm (")
    assert "at row 4 column 5" in found.reasons[0]
    beyond = "warning: within the tolerance, but beyond the scatter: 1 field deviates"
    assert found.reasons[1].startswith(beyond)
    noted = recipe.model_copy(update={"decision": recipe.decision.model_copy(update={"unexcluded": "note"})})
    passed = decide_plate(expected, one, noted)
    assert passed.verdict == "PASS"
    assert passed.reasons[0].startswith(beyond)
    strict = recipe.model_copy(
        update={"decision": recipe.decision.model_copy(update={"deviation": "fail", "alpha": 0.01})}
    )
    assert decide_plate(expected, one, strict).verdict == "FAIL"
    powers = {one.defect: one.power for one in found.details.powers}
    assert powers["missing"] > 0.999
    assert 0.05 < powers["worn"] < 1.0


def lying(expected, **position):
    """(P, rows, cols) what a position of the plate shows, with the level of the prediction."""
    (one, *_) = [
        one for one in expected.lying if all(getattr(one, name) == value for name, value in position.items())
    ]
    level = np.log(expected.radiance).mean() - expected.lying[0].ln.mean()
    rng = np.random.default_rng(3)
    ln = one.ln.T[:, np.maximum(one.classes, 0)] + level
    return np.exp(ln + 0.02 * rng.standard_normal(ln.shape))


def test_a_plate_that_lies_otherwise_or_is_another_one_is_invalid(expected):
    good = measured(expected).radiance
    assert check_plan(good, expected) > 0.95
    for quarters in (1, 2, 3):
        # turned by 180° no class faces the light at 0° and 90°, and hardly a field differs from another
        how = "does the plate lie" if quarters == 2 else "the plate lies"
        with pytest.raises(MeasurementError, match=rf"{how} turned by {90 * quarters}° "):
            check_plan(lying(expected, quarters=quarters, mirrored=False), expected)
    for shown in (good[:, :, ::-1], lying(expected, quarters=0, mirrored=True)):
        with pytest.raises(MeasurementError, match="the plan is mirrored, or is that of the mould"):
            check_plan(shown, expected)
    rng = np.random.default_rng(1)
    other = rng.permuted(good.reshape(len(good), -1), axis=1).reshape(good.shape)
    with pytest.raises(MeasurementError, match=r"are not those of the plan.*plan of another plate"):
        check_plan(other, expected)
    flat = 0.05 * np.exp(0.02 * rng.standard_normal(good.shape))
    with pytest.raises(MeasurementError, match="turned by 180° or upside down, or has it no ridges"):
        check_plan(flat, expected)


@pytest.mark.parametrize("off", [(0, 0), (3, -2), (-6, 5)])
def test_bright_plastic_around_a_plate_does_not_move_it(expected, off):
    """Flat plastic four times as bright as a field, two bright ridges in each, and noise."""
    classes, points = expected.plan.classes(), 20
    fields = np.kron(np.where(classes == 0, 0.06, 0.03), np.ones((points, points)))
    shown = np.pad(fields, points, constant_values=0.24)
    shown[:, points // 2 :: points // 2] *= 1.3
    shown = shown * (1.0 + 0.05 * np.random.default_rng(2).standard_normal(shown.shape))
    shown = cv2.GaussianBlur(np.roll(shown, (-off[1], off[0]), axis=(0, 1)), (0, 0), 1.0).astype(np.float32)
    found = field_places(shown[points:-points, points:-points], points, classes)
    np.testing.assert_allclose(found.shift, np.array(off) / points, atol=0.06)


def test_places_of_fields_give_shift_turn_and_non_uniformity(expected):
    classes, points = expected.plan.classes(), 20
    fields = np.where(classes == 0, 0.27, 0.03)
    picture = np.kron(fields, np.ones((points, points))).astype(np.float32)
    even = field_places(picture, points, classes)
    np.testing.assert_allclose([*even.shift, even.turn_deg, even.axial, even.grid], 0.0, atol=1e-3)
    middle = (picture.shape[0] - 1) / 2.0
    turn, wide = np.radians(0.5), 1.02  # counter-clockwise; 2 % wider along x
    cos, sin = np.cos(turn), np.sin(turn)
    linear = np.array([[cos * wide, sin], [-sin * wide, cos]])  # rows count downward
    offset = middle - linear @ [middle, middle] + [2.0, -1.0]  # 0.1 fields to the right, 0.05 up
    moved = cv2.warpAffine(
        picture, np.column_stack([linear, offset]), picture.shape[::-1], borderMode=cv2.BORDER_REPLICATE
    )
    found = field_places(moved, points, classes)
    np.testing.assert_allclose(found.shift, [0.1, 0.05], atol=0.02)
    assert found.turn_deg == pytest.approx(0.5, abs=0.05)
    assert found.axial == pytest.approx(0.02, abs=0.003)
    assert found.grid < 0.06
    one = picture.copy()
    row, col = 1, 5  # moved to the right by a fifth of a field
    neighbours = [(row, col - 1), (row, col + 1)]
    assert {int(classes[place]) for place in neighbours} == {1 - int(classes[row, col])}
    one[20:40, 100:104] = fields[row, col - 1]
    one[20:40, 120:124] = fields[row, col]
    assert field_places(one, points, classes).grid == pytest.approx(0.2, abs=0.04)
    assert field_places(np.full_like(picture, 0.1), points, classes) is None
    with pytest.raises(
        MeasurementError, match=r"\+0\.060 mm, \+0\.000 mm .* off their places \(limit 0\.05 mm\)"
    ):
        check_places((replace_shift(even, 0.3, 0.0),), 0.2)
    with pytest.raises(MeasurementError, match=r"turned by \+3\.0° in its seat"):
        check_places((replace_turn(even, 3.0),), 0.2)


def seen_at(expected, shift_mm, points=20):
    """Views of a plate as predicted that lies off its place by (x, y up)."""
    classes = expected.plan.classes()
    fields = (np.pad(each[classes], 2, constant_values=0.1) for each in expected.radiance.T)
    return views(expected, [np.kron(one, np.ones((points, points))) for one in fields], shift_mm, 10.0)


def views(expected, pictures, shift_mm, pixel_um):
    """Views of pictures, one a pose, of a plate that lies off its place by (x, y up)."""
    found = []
    for pose, picture in zip(expected.poses, pictures, strict=True):
        noise = np.full(picture.shape, 1e-4, dtype=np.float32)
        light = RadianceImage(
            picture.astype(np.float32), noise, np.zeros_like(noise, dtype=bool), 0.5, frames=4
        )
        scale = 1000.0 / pixel_um * np.array([1.0, -1.0])
        middle = 0.5 * (np.array(picture.shape[::-1]) - 1.0) - scale * shift_mm
        place = Placement(
            np.column_stack([np.diag(scale), middle]),
            pose.stage_deg,
            pixel_um,
            tuple(middle.tolist()),
            0.02,
            4,
        )
        found.append(View(pose.stage_deg, pose.tilt_deg, light, place))
    return found


def test_a_plate_off_its_place_is_measured_where_it_lies_up_to_a_quarter_of_a_field(expected, recipe):
    exact = predicted_fields(expected)
    for shift in ((0.0, 0.0), (0.04, -0.03)):
        seen = measure_plate(seen_at(expected, shift), None, recipe, expected, 10.0)
        np.testing.assert_allclose(seen.radiance, exact, rtol=1e-3)
        np.testing.assert_allclose(0.2 * np.array(seen.places[0].shift), shift, atol=2e-3)
        assert seen.texts == (demo.TEXT,) * 2
    for shift, said in (((0.08, 0.0), r"\+0\.080 mm, [+-]0\.000"), ((0.06, 0.09), r"\+0\.060 mm, \+0\.090")):
        with pytest.raises(MeasurementError, match=rf"{said} mm \(x, y\) off their places"):
            measure_plate(seen_at(expected, shift), None, recipe, expected, 10.0)


@pytest.mark.parametrize("crest_um", [0.0, 10.0])
def test_good_and_worn_plates_of_two_ridges_a_field_are_placed_in_the_light_of_the_path_tracer(crest_um):
    """Flat bright plastic around."""
    table = two_poses() | {"decision": {}, "surface": {"pitch_um": 50.0, "design": {"ridge_angle_deg": 12.0}}}
    table |= {"material": {"alpha_along": 0.08, "alpha_across": 0.08, "albedo": 0.2}}
    rows = tuple("".join(row) for row in demo.plan_rows())
    table["plan"] = {"rows": rows, "module_mm": 0.1, "facet_azimuths_deg": demo.AZIMUTHS_DEG}
    recipe = PLATES.recipe.model_validate(table)
    expected = expected_plate(recipe, recipe.plan.plan(), LIGHT_DEG, cached=True)
    made = plate_map(expected.plan, RidgeDesign(50.0, 12.0, edge_radius_um=crest_um), 2.0).height_um
    height = np.pad(made, (50, 51), constant_values=0.5 * made.max())
    tracer = PathTracer(HeightMap(height, 2.0, 2.0, {}), Plastic(0.08, 0.08, 0.2, 1.5))
    light = [
        tracer.direct(*way)[::-1]
        for way in zip(*directions(expected.poses, expected.convention), strict=True)
    ]
    assert light[0][10, 10] > 2.0 * light[0][50:650, 50:650].mean()
    pictures = [cv2.resize(one, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for one in light]
    seen = measure_plate(views(expected, pictures, (0.016, -0.012), 4.0), None, recipe, expected, 4.0)
    np.testing.assert_allclose(0.1 * np.array(seen.places[0].shift), (0.016, -0.012), atol=0.004)
    found = decide_plate(expected, seen, recipe)
    assert (found.verdict, seen.texts) == ("PASS", (demo.TEXT,) * 2)
    whole = np.array([one[50:650, 50:650].reshape(12, 50, 12, 50).mean(axis=(1, 3)) for one in light])
    classes = expected.plan.classes()
    for number in (0, 1):  # over whole pitches: of 1.4 a field shows a third less of its crests
        ratio = seen.radiance[:, classes == number].mean(axis=1) / whole[:, classes == number].mean(axis=1)
        np.testing.assert_allclose(ratio, 1.0, atol=0.01)


def replace_shift(places, x, y):
    """The places with a shift of all borders, in fields."""
    return replace(
        places,
        across=replace(places.across, off=places.across.off + x),
        down=replace(places.down, off=places.down.off - y),
    )


def replace_turn(places, turn_deg):
    """The places turned counter-clockwise."""
    turn = np.tan(np.radians(turn_deg))
    return replace(
        places,
        across=replace(places.across, off=places.across.off + turn * places.across.row),
        down=replace(places.down, off=places.down.off - turn * places.down.col),
    )


def test_causes_of_fields_and_of_the_whole_plate_are_told_apart(recipe):
    poses = recipe.poses.model_copy(update={"angles_deg": (0.0, 90.0, 180.0, 270.0)})
    recipe = recipe.model_copy(update={"poses": poses})
    expected = expected_plate(recipe, recipe.plan.plan(), LIGHT_DEG, cached=True)

    def explained(factor):
        seen = measured(expected, factor)
        decided = decide_plate(expected, seen, recipe)
        return explain_plate(recipe, expected, seen, decided)

    assert explained(None).says == "nothing: the plate is as it should be"
    fields = explained(changed(expected, [(3, 4), (6, 8)], "missing"))
    assert [(one.cause, one.severity) for one in fields.causes] == [("fields-missing", 2.0)]
    known = {one.cause.name: one for one in plate_signatures(recipe, expected).found}
    shape = expected.radiance.shape
    for name, extent in (("ridge-angle", -1.5), ("wear", 12.0), ("incomplete-filling", 0.3)):
        change = known[name].at(extent)[0]
        factor = np.exp(change[:-1].reshape(shape)).T[:, np.maximum(expected.plan.classes(), 0)]
        seen = measured(expected, factor)
        decided = decide_plate(expected, seen, recipe)
        found = explain_plate(recipe, expected, seen, decided).causes[0]
        assert found.cause == name
        assert found.severity == pytest.approx(extent, rel=0.25)
    assert set(known) <= set(PLATES.cause_words)


def test_golden_plates_replace_the_prediction_and_take_the_pattern_of_the_mould(expected, recipe):
    pattern = np.exp(0.1 * np.random.default_rng(9).standard_normal((2, 12, 12)))
    rng = np.random.default_rng(4)

    def plate(seed, factor=1.0):
        level = np.exp(0.03 * rng.standard_normal((2, 1, 1)))
        return measured(expected, pattern * level * factor, seed=seed, scatter=0.01)

    def row(seed):
        found = decide_plate(expected, plate(seed), recipe).details
        return GoldenPlate(
            serial=f"G-{seed}",
            inspected_at=f"2026-01-{seed + 1:02d}",
            ln_classes=tuple(tuple(np.log(one.measured)) for one in found.classes),
            offsets=found.field_offsets,
            verdict="PASS",
        )

    golden = GoldenPlates(
        product="p", recipe_key="k", poses=((0.0, 0.0), (90.0, 0.0)), parts=tuple(row(n) for n in range(10))
    )
    assert golden.lacking is None
    worn = changed(expected, [(3, 4)], "worn")
    alone = decide_plate(expected, plate(50, worn), recipe).details
    with_golden = decide_plate(expected, plate(50, worn), recipe, golden).details
    assert alone.golden is None
    assert with_golden.golden.parts == 10
    assert with_golden.golden.p_value > 1e-3
    # the pattern hides the worn field; without the pattern it shows
    powers = [{one.defect: one.power for one in found.powers}["worn"] for found in (alone, with_golden)]
    assert powers[1] > 0.99 > powers[0]
    assert (3, 4) in [(one.row, one.col) for one in with_golden.fields if one.significant]
    (table,) = reference_table(golden).tables
    assert table.rows[-1][0] == "scatter"


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
    assert read_picture(picture, symbology) == "RIDGE 7"
    assert read_picture(0.3 - picture, symbology) == "RIDGE 7"
    assert read_picture(np.full_like(picture, 0.1), symbology) is None


def test_a_plan_may_be_an_image_or_rows_and_its_table_makes_the_kind(folder, recipe, tmp_path):
    dark = modules_of_code(demo.TEXT, "datamatrix")
    cv2.imwrite(str(tmp_path / "plan.png"), np.where(dark, 0, 255).astype(np.uint8))
    table = two_poses()
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
        ({"surface": {"pitch_um": 50.0, "height_map": "map.x3p"}}, "a plate needs design"),
        (
            {
                "surface": {
                    "pitch_um": 50.0,
                    "height_map": "map.x3p",
                    "design": {"ridge_angle_deg": 10.0},
                    "compare": "design",
                }
            },
            "the height_map of a plate decides",
        ),
    ],
)
def test_a_recipe_that_does_not_fit_is_one_line(tmp_path, change, match):
    table = two_poses()
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


def test_golden_plates_are_shown_and_none_are_there_at_first(anisoscope, folder):
    done = anisoscope("golden", "show", "--recipe", folder / "recipe.toml")
    assert done.code >= 64
    assert "Traceback" not in done.err
    assert done.err.strip().count("\n") == 0


@pytest.fixture(scope="module")
def with_map(folder):
    """A recipe whose plate is a height map in which one field is flat."""
    plan = Plan(("AABB", "ABAB", "BABA"), demo.AZIMUTHS_DEG, 0.2)
    surface = plate_map(plan, RidgeDesign(50.0, 10.0), 2.0)
    height = surface.height_um.copy()
    height[100:200, 200:300] = np.median(height)  # the second row from below, third column
    rows, cols = np.indices(height.shape)
    write_height_map(surface.with_height(height + 0.002 * cols - 0.001 * rows), folder / "plate.npz")
    table = two_poses() | {"region": {"size_mm": [0.8, 0.6]}}
    table["plan"] = {
        "rows": list(plan.rows),
        "module_mm": 0.2,
        "facet_azimuths_deg": demo.AZIMUTHS_DEG,
    }
    del table["code"]
    table["surface"] = {
        "pitch_um": 50.0,
        "design": {"ridge_angle_deg": 10.0, "edge_radius_um": 0.0},
        "height_map": "plate.npz",
        "compare": "height_map",
    }
    (folder / "with-map.toml").write_text(tomli_w.dumps(table))
    return table


def test_fields_are_predicted_one_by_one_from_a_height_map(folder, with_map):
    recipe = PLATES.read_recipe(folder / "with-map.toml")
    assert PLATES.sources(recipe, None) == {"height_map": folder / "plate.npz"}
    found = expected_plate(recipe, recipe.plan.plan(), LIGHT_DEG, cached=True)
    bare = recipe.model_copy(
        update={"surface": recipe.surface.model_copy(update={"height_map": None, "compare": None})}
    )
    ideal = expected_plate(bare, recipe.plan.plan(), LIGHT_DEG, cached=True)
    classes = found.plan.classes()
    good = np.ones(classes.shape, dtype=bool)
    good[1, 2] = False
    off = np.log(found.fields) - np.log(ideal.radiance.T[:, np.maximum(classes, 0)])
    assert np.abs(off[:, good]).max() < 0.05  # light from field to field, and the walls between points
    np.testing.assert_allclose(off[:, 1, 2], ideal.defects["missing"][0], atol=0.15)
    # a plate as its map says passes, also with the flat field; a field that is as the design says does not
    as_mapped = measured(found, seed=3, scatter=0.01)
    assert decide_plate(found, as_mapped, recipe).details.fields == ()
    mended = as_mapped.radiance.copy()
    mended[:, 1, 2] = ideal.radiance[0]
    (field,) = decide_plate(found, replace(as_mapped, radiance=mended), recipe).details.fields
    assert (field.row, field.col, field.verdict) == (1, 2, "FAIL")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (
            {"rows": ["BBAA", "BABA", "ABAB"]},
            r"do not lean as the plan says .* is it the map of another plate",
        ),
        ({"rows": ["ABAB", "BABA", "BBAA"], "facet_azimuths_deg": {"A": 180.0, "B": 90.0}}, "turned by 180°"),
        (
            {"rows": ["BBAA", "BABA", "ABAB"], "facet_azimuths_deg": {"A": 180.0, "B": -90.0}},
            "that of the plan mirrored",
        ),
        ({"module_mm": 0.15}, r"the map is 0\.8 mm × 0\.6 mm large, the plan 0\.6 mm × 0\.45 mm"),
    ],
)
def test_a_plan_that_is_not_that_of_the_map_is_one_line(folder, with_map, change, match):
    table = with_map | {"plan": with_map["plan"] | change}
    (folder / "other.toml").write_text(tomli_w.dumps(table))
    recipe = PLATES.read_recipe(folder / "other.toml")
    with pytest.raises(HeightMapError, match=match) as problem:
        expected_plate(recipe, recipe.plan.plan(), LIGHT_DEG, cached=True)
    assert "\n" not in str(problem.value)


def test_classes_with_a_ridge_angle_of_their_own_are_predicted_with_it(recipe):
    own = Plan(("ABA", "BAB"), {"A": 0.0, "B": -90.0}, 0.2, {"B": 6.0})
    found = expected_plate(recipe, own, LIGHT_DEG, cached=True)
    design = recipe.surface.design.model_copy(update={"ridge_angle_deg": 6.0})
    other = recipe.model_copy(update={"surface": recipe.surface.model_copy(update={"design": design})})
    plain = Plan(own.rows, own.azimuths_deg, 0.2)
    both = [expected_plate(one, plain, LIGHT_DEG, cached=True).radiance for one in (recipe, other)]
    np.testing.assert_allclose(found.radiance, [both[0][0], both[1][1]], rtol=1e-9)
    assert not np.allclose(both[0][1], both[1][1], rtol=0.1)


def test_of_many_contrasts_those_are_shown_that_do_not_pass_and_then_the_largest_deviations():
    rows = [
        PlateContrastRecord(
            name=f"ln A/B at {number}", measured=0.001 * number, predicted=0.0, u=0.01, tolerance=0.2, guard=0.02,
            verdict=Verdict.FAIL if number == 3 else Verdict.PASS,
        )
        for number in range(60)
    ]  # fmt: skip
    shown = PlateDetails(contrasts=tuple(rows)).listed
    assert len(shown) == 24
    assert [one.title for one in shown[:2]] == [f"ln ratio A / B at {n}°, tilt 0°" for n in (3, 59)]
    assert PlateDetails(contrasts=tuple(rows[:5])).listed == tuple(rows[:5])
    record = SimpleNamespace(details=PlateDetails(), serial="P", product="plate")
    assert PLATES.summary(record).tables == ()  # an INVALID plate has none
