"""The detection study: its short cuts against the full route, statistics against definitions, and going on."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from anisoscope.base.errors import UsageError
from anisoscope.decision.consistency_test import from_prediction
from anisoscope.imaging.pose_radiance import Measured, measure
from anisoscope.imaging.registration.placement import Grid
from anisoscope.prediction.expectation import Component
from anisoscope.profiles.defects_contact import edge_wear
from anisoscope.profiles.ideal import RidgeDesign, add_facet_roughness, ridges
from anisoscope.report.detection_page import tables_of, write_detection_page
from anisoscope.report.detection_text import BEGIN, END, INTERVALS, numbers_of, with_results, write_results
from anisoscope.sim.bench.sensor import Sensor
from anisoscope.sim.light.geometry import Convention, directions, seating_rotation
from anisoscope.sim.light.relief import Relief, shine_maps
from anisoscope.sim.light.shine import shine_in
from anisoscope.sim.pathtracer.tracer import PathTracer
from anisoscope.study.detection import evaluation as detection_evaluation
from anisoscope.study.detection import sheets as detection_sheets
from anisoscope.study.detection.chunk import (
    MEASURED_SOURCES,
    ChunkTask,
    Window,
    inspect_chunk,
    new_cameras,
    nominal,
    photograph,
    profile_radiance,
    radiance_of_part,
    views_of_series,
)
from anisoscope.study.detection.evaluation import (
    area_under_curve,
    curve,
    histogram,
    rate,
    threshold,
    true_extents,
    uniformity,
)
from anisoscope.study.detection.lobes import lobes_of, plastic_of, quick_shine
from anisoscope.study.detection.product import (
    BY_NAME,
    CLASSES,
    GOOD,
    LIGHT_DEG,
    LOBE,
    PITCH_UM,
    WHOLE,
    WORLDS,
    Size,
    draw,
    expected_of,
    recipe_of,
)
from anisoscope.study.detection.results import (
    RULES,
    bench_of,
    compared_sets,
    covariance_of_measurement,
    distances,
    golden_pool,
    limits,
    p_values,
    with_area,
)
from anisoscope.study.detection.run import Plan, area_of, collect, study_results
from anisoscope.study.detection.sheets import POINTS, SheetTask, bounces_of, cut, sheet_of, sheet_surface
from anisoscope.study.sweep import Workers

SMALL = Size(ridges=7, pitches=5, sheets=1, chunk=4, causes=("roughness-across",))
POSES = recipe_of("tilted", SMALL).poses.poses()
SEEN = directions(POSES, Convention(LIGHT_DEG))
NO_BOUNCES = np.zeros(len(POSES))


# statistics ----------------------------------------------------------------------------------------------------


def test_the_interval_of_a_rate_is_that_of_clopper_and_pearson():
    found = rate(np.arange(100) < 3)
    assert (found.count, found.of, found.value) == (3, 100, 0.03)
    assert (found.low, found.high) == pytest.approx((0.00623, 0.08518), abs=2e-5)  # tabulated
    none, every = rate(np.zeros(50, dtype=bool)), rate(np.ones(50, dtype=bool))
    assert none.low == 0.0
    assert none.high == pytest.approx(1.0 - 0.025 ** (1 / 50))
    assert (every.low, every.high) == (pytest.approx(1.0 - none.high), 1.0)


def test_the_area_under_the_curve_counts_pairs_and_ties_half(rng):
    bad, good = rng.integers(0, 8, 60) + 1.0, rng.integers(0, 8, 90).astype(float)
    pairs = np.mean((bad[:, None] > good) + 0.5 * (bad[:, None] == good))
    found = area_under_curve(bad, good)
    assert found.value == pytest.approx(pairs)
    again = [
        area_under_curve(rng.choice(bad, bad.size), rng.choice(good, good.size)).value for _ in range(400)
    ]
    assert found.u == pytest.approx(np.std(again), rel=0.2)
    false, detected = curve(bad, good)
    assert np.trapezoid(detected, false) == pytest.approx(pairs, abs=0.01)
    low, high = found.interval
    assert 0.0 < low < found.value < high < 1.0


def test_a_threshold_lets_at_most_its_share_pass(rng):
    good = rng.standard_normal(1000)
    assert np.mean(good > threshold(good, 0.01)) == 0.01
    assert np.mean(good[:30] > threshold(good[:30], 0.01)) == 0.0


def test_uniform_p_values_are_found_uniform_and_others_not(rng):
    p = rng.random(500)
    assert uniformity(p)[1] > 0.01 > uniformity(p**2)[1]
    assert sum(histogram(p)) == 500


# short cuts ----------------------------------------------------------------------------------------------------


def test_a_quick_shine_is_the_exact_one():
    changed = replace(WHOLE, alpha_along=0.9 * WHOLE.alpha_along, alpha_across=1.2 * WHOLE.alpha_across)
    surface = Relief(ridges(RidgeDesign(PITCH_UM, 10.0), (2, 401), (4.0, 0.5)), PITCH_UM)
    for material in (WHOLE, changed, replace(changed, albedo=0.25, index=1.505)):
        exact = [shine_in(*pair, material) for pair in zip(*SEEN, strict=True)]
        quick = [quick_shine(*pair, material) for pair in zip(*SEEN, strict=True)]
        for one, other in zip(shine_maps(surface, exact), shine_maps(surface, quick), strict=True):
            assert other.mean() == pytest.approx(one.mean(), rel=2e-3)


def direct_light(surface, world, material, sides):
    """Radiance maps of direct light in a world: by the predictor's facets, or by the path tracer."""
    if WORLDS[world].traced:
        tracer = PathTracer(surface, plastic_of(world, material), pitch_um=PITCH_UM, reflections=1)
        return [tracer.direct(*pair) for pair in zip(*sides, strict=True)]
    shines = [quick_shine(*pair, material) for pair in zip(*sides, strict=True)]
    return list(shine_maps(Relief(surface, PITCH_UM), shines))


def test_the_other_lobe_fits_the_recipe_as_well_as_it_can():
    lobes = lobes_of("other")
    assert 0.02 < lobes.misfit < 0.3  # no Beckmann lobe, but the nearest
    surface = ridges(RidgeDesign(PITCH_UM, 10.0), (21, 601), (4.0, 0.5))
    off = []
    for across in (0.9, 1.0, 1.1):
        material = replace(lobes.smooth, alpha_across=across * lobes.smooth.alpha_across)
        radiance = direct_light(surface, "other", material, SEEN)
        found = np.log([view.mean(dtype=float) for view in radiance]) - np.log(
            expected_of("tilted", SMALL).radiance
        )
        off.append(np.sum(found**2))
    assert off[1] == min(off)


def test_foreign_worlds_share_no_renderer_with_the_prediction():
    assert [world for world, part in WORLDS.items() if not part.traced] == ["same"]
    traced, same = (profile_radiance(nominal(), world).mean(axis=1) for world in ("camera", "same"))
    assert not np.array_equal(traced, same)
    # the same physics by another derivation; corners between two points of the mesh are cut, which shows at 180°
    assert traced == pytest.approx(same, rel=0.06)


@pytest.mark.soak
def test_every_world_has_its_reflections():
    good = bounces_of(("two-scale", GOOD))
    seen = expected_of("tilted", SMALL).radiance
    assert np.all(good > 0.0)
    assert 0.08 < good[2] / seen[2] < 0.4  # 180° upright


STATES = {
    "finish": {"along": 1.08, "across": 0.93, "albedo": 0.212, "index": 1.505},
    "seat and lamp": {"seating_deg": np.array([0.25, -0.2]), "light_deg": 10.2},
    "ridge angle": {"ridge_angle_deg": 10.5},
    "roughness": {"across": 1.2},
    "height loss": {"height_loss": 0.1},
    "wear": {"wear_um": 5.0},
}


def rough(state):
    """A piece of rough surface in the shape of a state; the grain is always the same."""
    design = RidgeDesign(PITCH_UM, state.ridge_angle_deg, height_loss=state.height_loss)
    surface = ridges(design, (76, 8 * 200 + 1), (4.0, 0.5))
    surface = add_facet_roughness(surface, 0.03, 0.03, 8.0, np.random.default_rng(1))
    return edge_wear(surface, state.wear_um) if state.wear_um else surface


def lobes_in(state, world):
    """Lobe of the facets of a rough surface whose whole roughness, grain and lobe, is that of a state."""
    textured, whole = lobes_of(world).textured, state.plastic(WHOLE)
    return replace(
        textured,
        alpha_along=textured.alpha_along * np.sqrt(whole.alpha_along**2 - 0.03**2) / LOBE.alpha_along,
        alpha_across=textured.alpha_across * np.sqrt(whole.alpha_across**2 - 0.03**2) / LOBE.alpha_across,
        albedo=textured.albedo * state.albedo / LOBE.albedo,
        index=state.index,
    )


def direct(state, world):
    """(P,) ln radiance of the rough surface in a state, rendered facet by facet."""
    seat = seating_rotation(*state.seating_deg)
    seen = [side @ seat for side in directions(POSES, Convention(state.light_deg))]
    radiance = direct_light(rough(state), world, lobes_in(state, world), seen)
    return np.log([view.mean(dtype=float) for view in radiance])


@pytest.mark.parametrize("world", ["same", "other"])
@pytest.mark.parametrize("name", STATES)
def test_a_ratio_of_smooth_profiles_is_what_a_rough_surface_changes(world, name):
    """The short cut of the study, against the rough surface itself rendered in either state."""
    state = replace(nominal(), **STATES[name])
    found = profile_radiance(state, world).mean(axis=1) / profile_radiance(nominal(), world).mean(axis=1)
    change = direct(state, world) - direct(nominal(), world)
    off = np.log(found[: len(POSES)]) - change
    edges = name in ("height loss", "wear")
    assert np.abs(off).max() < (0.035 if world == "other" else 0.02 if edges else 0.006)
    assert np.abs(off).max() < 0.3 * np.abs(change).max()
    if world == "same" and not edges:  # good parts must not look like bad ones
        total = np.sum([c.covariance() for c in expected_of("tilted", SMALL).components], axis=0)
        total = total + np.diag(np.full(len(POSES), 0.0025**2))
        assert distances(off[None], total[None])[0] < 2.5


def test_the_short_route_measures_what_the_bench_and_inspect_measure(virtual_rig, undiagnosed, tmp_path, rng):
    """One part through devices, markers and the whole of ``inspect``; and through the study."""
    size = Size(ridges=10, pitches=10, pixel_um=8.0, sheets=1)
    state = replace(
        nominal(),
        ridge_angle_deg=10.4,
        along=1.05,
        across=0.95,
        albedo=0.21,
        seating_deg=np.array([0.2, -0.15]),
    )
    lobe = {
        "alpha_along": float(np.sqrt((1.05 * WHOLE.alpha_along) ** 2 - 0.03**2)),
        "alpha_across": float(np.sqrt((0.95 * WHOLE.alpha_across) ** 2 - 0.03**2)),
        "albedo": 0.21,
        "index": 1.5,
    }
    sample = {
        "ridge_angle_deg": 10.4,
        "resolved_alpha": 0.03,
        "reflections": False,
        "seating_tilt_deg": [0.2, -0.15],
        "material": lobe,
    }
    told = recipe_of("standard", size).material
    material = {"alpha_along": told.alpha_along, "alpha_across": told.alpha_across}
    rig = virtual_rig(recipe={"material": material, "decision": {"tolerance": 5.0}}, bench={"sample": sample})
    inspected = rig.inspect(methods=undiagnosed)
    assert inspected.record.verdict != "INVALID", inspected.record.reasons
    full = np.log([pose.measured for pose in inspected.record.poses])
    task = SheetTask("same", GOOD, 0, size, 5, tmp_path)
    sheet = sheet_of(task)
    rows, cols = cut(sheet, GOOD, size, rng)
    radiance, _ = radiance_of_part(sheet.radiance[:, rows, cols], state, "same", NO_BOUNCES)
    views = photograph(radiance, state, new_cameras(size, "same", rng), size, rng)
    expected = expected_of("standard", size)
    short = np.log(
        measure(views[:3], views[-1], recipe_of("standard", size), expected, size.pixel_um).radiance
    )
    # both scatter by their own piece of rough surface; the bench has stray light of 2e-4 besides
    assert short == pytest.approx(full - 2e-4 / np.exp(full), abs=0.012)


def test_a_window_is_a_piece_of_the_sensor(rng):
    whole = Sensor(SMALL.sensor.model_copy(update={"rows": 96, "cols": 96, "prnu": 0.2}), rng)
    part = Window(whole, (64, 96))
    signal = np.full((96, 96), 9000.0)
    many = np.mean([whole.expose(signal, 0.001, 1.0) for _ in range(40)], axis=0)
    few = np.mean([part.expose(signal[:64], 0.001, 1.0) for _ in range(40)], axis=0)
    assert few == pytest.approx(many[16:80], abs=14.0)
    assert np.corrcoef(few.ravel(), many[16:80].ravel())[0, 1] > 0.99


def test_parts_scatter_as_told_and_defects_are_put_in(rng):
    good = [draw(None, 10, rng)[0] for _ in range(400)]
    assert np.std([part.ridge_angle_deg for part in good]) == pytest.approx(0.1, rel=0.15)
    assert np.std([np.log(part.across) for part in good]) == pytest.approx(0.05, rel=0.15)
    assert np.std([part.albedo for part in good]) == pytest.approx(0.006, rel=0.15)
    assert np.std([part.seating_deg for part in good]) == pytest.approx(0.1, rel=0.15)
    angles = {draw(BY_NAME["ridge-angle"], 10, rng)[1] for _ in range(20)}
    assert angles == {-0.5, 0.5}
    assert draw(BY_NAME["wear"], 10, rng)[0].wear_um == 5.0


@pytest.mark.parametrize(("kind", "share"), [("burrs", 0.02), ("scratches", 0.01), ("dust", 0.02)])
def test_local_defects_cover_the_stated_share_of_the_area(kind, share, tmp_path):
    size = Size(ridges=25, pitches=7)
    _, spoiled = sheet_surface(SheetTask("same", kind, 0, size, 1, tmp_path))
    assert spoiled.mean() == pytest.approx(share, rel=0.25)


def test_one_ridge_in_twenty_five_is_missing_in_every_part(tmp_path, rng):
    size = Size(ridges=25, pitches=3)
    _, spoiled = sheet_surface(SheetTask("same", "missing-ridges", 0, size, 1, tmp_path))
    width = (size.ridges + 1) * POINTS
    for part in range(2):
        inner = spoiled[:, part * width + POINTS // 2 :][:, : size.ridges * POINTS]
        assert inner.mean() == pytest.approx(0.04, abs=0.006)


# rules ---------------------------------------------------------------------------------------------------------


def columns(count, rng):
    """Columns of parts whose deviations are drawn from the budget with the ridge angle."""
    own = np.full((count, 8, len(POSES)), 0.001)
    alone = covariance_of_measurement(own)[0]
    bench = bench_of("tilted", SMALL, np.zeros((25, len(POSES))), alone)
    draws = bench.response(spread=True, better=1.0).draw(alone, count + 200, rng)
    seen = {"tilted/deviation": draws[200:], "tilted/own": own}
    return seen, replace(bench, golden=draws[:25]), draws


def test_p_values_of_parts_drawn_from_the_budget_are_uniform(rng):
    seen, bench, _ = columns(600, rng)
    assert uniformity(p_values("spread", seen, GOOD, bench))[1] > 0.001


def test_the_rule_as_shipped_is_that_of_inspect(rng):
    seen, bench, _ = columns(3, rng)
    found = p_values("shipped", seen, GOOD, bench)
    own = [
        Component(source, "measurement", row, source == "stray light")
        for source, row in zip(MEASURED_SOURCES, seen["tilted/own"][0], strict=True)
    ]
    nowhere = Grid((0.0, 0.0), 1.0, (1, 1))
    for p, change in zip(found, seen["tilted/deviation"], strict=True):
        radiance = bench.expected.radiance * np.exp(change)
        part = Measured(radiance, tuple(own), (), np.ones((9, 1, 1)), np.zeros(9), nowhere, None)
        assert p == pytest.approx(from_prediction(bench.expected, part)[2])


def test_golden_parts_keep_the_level_on_average(rng):
    seen, bench, draws = columns(250, rng)
    hits = [
        np.mean(p_values("golden", seen, GOOD, replace(bench, golden=draws[25 * k : 25 * k + 25])) < 0.05)
        for k in range(8)
    ]
    assert np.mean(hits) == pytest.approx(0.05, abs=0.03)


def test_what_limits_a_shift_adds_up_to_all(rng):
    seen, bench, _ = columns(50, rng)
    sigmas, sources = limits(bench.stated.components[0].relative * 4.0, seen, bench)
    assert sum(share for _, share in sources) == pytest.approx(1.0)
    assert 0.0 < sigmas < 4.0
    assert sources[0][0] == bench.stated.components[0].source


def test_the_area_is_weighed_by_what_good_parts_show(rng):
    share = 0.01 + 0.002 * rng.standard_normal(1000)
    scores = {GOOD: {"share": share, **dict.fromkeys(RULES, np.zeros(1000))}}
    scores["burrs"] = {"share": np.array([0.01, 0.02]), **dict.fromkeys(RULES, np.zeros(2))}
    with_area(scores)
    assert np.mean(scores[GOOD]["area"] > 2.0) == pytest.approx(0.01, abs=0.01)
    assert scores["burrs"]["area"] == pytest.approx(-np.log10(norm.sf([0.0, 5.0])), rel=0.15)


def test_golden_parts_are_none_of_those_that_are_judged():
    pool = golden_pool(1000)
    assert {len(np.unique(part)) for part in pool} == {25}
    met = compared_sets(1000, pool, of_good=True)
    assert not any(number in pool[chosen] for number, chosen in enumerate(met))
    assert np.bincount(met, minlength=len(pool)).min() > 15
    assert len(golden_pool(40)[0]) == 20
    assert compared_sets(3, pool, of_good=False).tolist() == [0, 1, 2]


def test_the_true_extent_counts_what_good_parts_scatter_and_what_lies_within():
    seen = {
        "extent": np.array([0.2]), "across": np.log([1.26]), "ridge_angle_deg": np.array([10.6]),
        "spoiled": np.array([1.0 / 26.0]),
    }  # fmt: skip
    assert true_extents("roughness", seen, Size())[0] == pytest.approx(0.26)
    assert true_extents("ridge-angle", seen, Size())[0] == pytest.approx(0.6)
    assert true_extents("missing-ridges", seen, Size())[0] == pytest.approx(0.04)
    assert true_extents("wear", seen, Size())[0] == 0.2


def test_the_area_under_the_curve_of_a_shift_is_that_of_drawn_parts(rng):
    shifted = np.sum((rng.standard_normal((4000, 5)) + np.array([2.0, 0, 0, 0, 0])) ** 2, axis=1)
    plain = np.sum(rng.standard_normal((4000, 5)) ** 2, axis=1)
    assert area_of(2.0, 5) == pytest.approx(area_under_curve(shifted, plain).value, abs=0.015)
    assert area_of(0.0, 5) == pytest.approx(0.5, abs=0.001)


# the study -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def studied(made_once):
    """A small study of the predictor's own world, and what it tells; made by one worker for all of them."""

    def planned(folder):
        return Plan(("same",), ("standard", "tilted"), 40, 2, 1, SMALL, folder / "kept")

    def make(folder):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(detection_sheets, "_PATHS", 64)
            patch.setattr(detection_evaluation, "FITTED", 2)  # a second each
            told = study_results(planned(folder), Workers(1))
        (folder / "told.json").write_text(json.dumps(told), encoding="utf-8")

    shared = made_once("studied", make)
    return planned(shared), json.loads((shared / "told.json").read_text(encoding="utf-8"))


def test_the_numbers_of_a_study_fit_together(studied):
    plan, told = studied
    assert json.loads(json.dumps(told, allow_nan=False)) == told
    for world in plan.worlds:
        for recipe in plan.recipes:
            found = told["worlds"][world][recipe]
            good = found["good"]
            assert good["parts"] + good["invalid"] == 40
            for rates in (good["false_alarms"], good["coverage"]):
                for one in rates.values():
                    assert one["interval"][0] <= one["rate"] == one["count"] / one["of"] <= one["interval"][1]
            assert sum(good["p_values"]["shipped"]["histogram"]) == good["parts"]
            assert [one["name"] for one in found["classes"]] == [kind.name for kind in CLASSES]
            for one in found["classes"]:
                assert one["parts"] == 2
                assert 0.0 <= one["scores"]["shipped"]["auc"] <= 1.0
                # the predictor's own world is known so well, and of the causes one was looked for
                tried = world == "same" and one["name"] == "roughness"
                assert (one["intervals"] is not None) == tried
                if tried:
                    rates = [one["intervals"][key] for key in INTERVALS]
                    assert [rate["of"] for rate in rates] == [2, 2]
                    assert len(one["intervals"]["doubts"]) == 2
                false, detected = one["roc"]["shipped+area"]
                assert (np.diff(false) >= 0).all()
                assert (np.diff(detected) >= -1e-12).all()


def test_good_parts_of_the_same_world_are_as_predicted(studied):
    plan, told = studied
    for recipe in plan.recipes:
        good = told["worlds"]["same"][recipe]["good"]
        assert good["p_values"]["spread"]["chance"] > 1e-3
        held = good["coverage"]["measured contrast holds the true one (measurement alone)"]
        assert held["interval"][0] < 0.99
        assert held["rate"] > 0.85


@pytest.mark.statistics
def test_the_other_world_is_another_one(tmp_path, monkeypatch):
    monkeypatch.setattr(detection_sheets, "_PATHS", 1 << 12)
    told = study_results(Plan(("other",), ("tilted",), 40, 2, 1, SMALL, tmp_path), Workers(1))
    alarms = told["worlds"]["other"]["tilted"]["good"]["false_alarms"]
    assert alarms["shipped"]["rate"] > 0.5
    # golden parts do not mind what the model does not know
    assert alarms["golden"]["rate"] < 0.4
    assert max(told["other_world"]["reflections_share"]) > 0.03


def test_a_page_shows_both_recipes_side_by_side(studied, tmp_path):
    _, told = studied
    write_detection_page(tmp_path / "d.html", told)
    text = (tmp_path / "d.html").read_text(encoding="utf-8")
    for wanted in ("same, standard", "same, tilted", "missing ridges, 1 in 25", "P values of good parts"):
        assert wanted in text
    for wanted in INTERVALS.values():
        assert f"extent of roughness across the ridges +20 %, {wanted}" in text
    assert {len(row) for table in tables_of(told) for row in table.rows} <= set(range(3, 14))
    for table in tables_of(told):
        assert all(len(row) == len(table.columns) for row in table.rows)


def test_the_page_of_the_documents_is_written_from_the_numbers(studied, tmp_path):
    _, told = studied
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nwritten before\n{END}\nafter\n", encoding="utf-8")
    write_results(page, told)
    text, kept = page.read_text(encoding="utf-8"), json.loads((tmp_path / "page.json").read_text())
    assert text == with_results(text, kept)
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "written before" not in text
    assert "same, standard" in text
    for wanted in INTERVALS.values():
        assert f"| … {wanted} | " in text
    assert json.loads(json.dumps(numbers_of(told))) == kept
    with pytest.raises(UsageError, match="one line"):
        with_results("no marks", kept)


def test_the_page_of_the_documents_shows_the_numbers_beside_it():
    page = Path(__file__).parents[3] / "docs" / "detection.md"
    text = page.read_text(encoding="utf-8")
    kept = json.loads(page.with_suffix(".json").read_text(encoding="utf-8"))
    assert text == with_results(text, kept)


def test_a_study_goes_on_where_it_stopped_and_a_larger_one_uses_it(studied):
    plan, _ = studied
    before = collect(plan, Workers(1))
    chunk = min(plan.folder.glob("detection-chunks/*"))
    chunk.unlink()
    untouched = {path: path.stat().st_ino for path in plan.folder.glob("*/*")}
    again = collect(plan, Workers(1))
    assert chunk.exists()
    assert all(path.stat().st_ino == number for path, number in untouched.items())
    for world in plan.worlds:
        for kind in plan.counts:
            for name, values in before[world][kind].items():
                assert np.array_equal(values, again[world][kind][name], equal_nan=values.dtype.kind == "f"), (
                    name
                )
    kept = set(plan.folder.glob("*/*"))
    more = collect(replace(plan, parts=44), Workers(1))
    assert len(set(plan.folder.glob("*/*")) - kept) == 1  # one chunk more
    same, grown = (found["same"][GOOD]["tilted/deviation"] for found in (before, more))
    assert np.array_equal(same, grown[:40])


def test_processes_make_the_same_parts(studied, tmp_path):
    plan, _ = studied
    task = ChunkTask("same", "burrs", 0, SMALL, plan.seed, plan.folder, ())
    alone = inspect_chunk(replace(task, folder=tmp_path))
    assert task.entry.path.exists()
    for name, values in inspect_chunk(task).items():
        assert np.array_equal(values, alone[name], equal_nan=values.dtype.kind == "f"), name


def test_a_study_of_too_few_parts_is_refused():
    with pytest.raises(UsageError, match="at least 40 good parts"):
        Plan(("same",), ("standard",), 10, 5)


def test_the_series_of_views_begins_with_the_standard_recipe_and_closes_with_its_first():
    views = views_of_series()
    assert views[:3] == expected_of("standard", SMALL).poses
    assert views[-1] == views[0]
    assert len(views) == 10


@pytest.mark.statistics
def test_false_alarms_of_the_same_world_keep_their_level(tmp_path: Path):
    """Five hundred good parts of the real size: the level holds where the recipe states all that varies."""
    plan = Plan(("same",), ("standard", "tilted"), 500, 25, 2, Size(causes=("roughness-across",)), tmp_path)
    told = study_results(plan, Workers(2))
    for recipe in plan.recipes:
        alarms = told["worlds"]["same"][recipe]["good"]["false_alarms"]
        for rule in ("spread", "golden"):
            assert alarms[rule]["interval"][0] < 0.015
            assert alarms[rule]["rate"] < 0.03
