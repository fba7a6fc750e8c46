"""Recipes of prints: what they hold, what is refused, and how they are begun and checked."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.stats import norm

from anisoscope.base.errors import RecipeError
from anisoscope.kinds.prints.decision import decide_print
from anisoscope.kinds.prints.expectation import rig_sources
from anisoscope.kinds.prints.lighting import expectation_of_print
from anisoscope.kinds.prints.measurement import MeasuredPrint, cell_grid
from anisoscope.kinds.prints.model import State
from anisoscope.kinds.prints.recipe import (
    PrintRecipe,
    PrintTolerances,
    PrintUncertainty,
    new_print_recipe,
)
from anisoscope.kinds.prints.recipe_check import (
    as_predicted,
    check_print_recipe,
    planned_quantities,
    sparkles,
)
from anisoscope.kinds.prints.sources import of_poses
from anisoscope.kinds.recipes import read_any_recipe
from anisoscope.kinds.registry import kind_of, read_recipe
from anisoscope.kinds.ridges.recipe import RidgeRecipe, new_recipe
from anisoscope.operations.demo.prints import rig_of
from anisoscope.parameters.geometry import Convention
from anisoscope.record.verdict import Verdict
from anisoscope.rig.rigfile import RigFile
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.materials.inks import InkFileError, synthetic_ink, write_ink


@pytest.fixture
def written(tmp_path):
    """Writes a recipe of a print with one line replaced."""

    def write(old="", new=""):
        text = new_print_recipe('print "7"', "synthetic-green", ("synthetic-red",))
        assert old in text
        path = tmp_path / "recipe.toml"
        path.write_text(text.replace(old, new), encoding="utf-8")
        return path

    return write


def test_a_new_recipe_is_valid_and_holds_the_starting_limits(written):
    recipe = read_any_recipe(written())
    assert kind_of(written()).name == "prints"
    assert recipe.product == 'print "7"'
    assert recipe.tolerances == type(recipe.tolerances)()
    assert recipe.uncertainty == type(recipe.uncertainty)()
    assert recipe.print.wrong_inks == ("synthetic-red",)
    assert recipe.print.read_ink().name == "synthetic green"


def test_the_other_kind_is_read_as_what_it_is(tmp_path):
    path = tmp_path / "ridges.toml"
    path.write_text(new_recipe("plate", 100.0, ridge_angle_deg=10.0, height_map=None))
    assert isinstance(read_any_recipe(path), RidgeRecipe)


def test_commands_for_surfaces_refuse_it(written):
    with pytest.raises(RecipeError, match="the recipe of a print; this works with recipes of surfaces"):
        read_recipe(written())


def test_an_ink_file_counts_from_the_recipe(written, tmp_path):
    write_ink(synthetic_ink("synthetic-blue"), tmp_path / "mine.toml")
    recipe = PrintRecipe.read(written('ink = "synthetic-green"', 'ink = "mine.toml"'))
    assert Path(recipe.print.ink) == tmp_path / "mine.toml"
    assert recipe.print.read_ink().name == "synthetic blue"


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('ink = "synthetic-green"', 'ink = "{ink}"', r"print\.ink"),
        (
            'wrong_inks = ["synthetic-red"]',
            'wrong_inks = ["synthetic-red", "{ink}"]',
            r"print\.wrong_inks\[1\]",
        ),
    ],
)
def test_a_broken_ink_is_named_with_the_recipe_and_its_key(written, tmp_path, old, new, key):
    (tmp_path / "broken.toml").write_text('schema = 1\nname = "x"\n')
    infrared = replace(synthetic_ink("synthetic-green"), wavelengths_nm=tuple(range(980, 1381, 10)))
    write_ink(infrared, tmp_path / "infrared.toml")
    for ink, says in (
        ("none.toml", "there is no such file"),
        ("broken.toml", "missing; expected"),
        ("infrared.toml", "at least 400 to 700 nm are needed"),
    ):
        with pytest.raises(InkFileError, match=rf"recipe\.toml: {key}: .*{ink}: .*{says}"):
            PrintRecipe.read(written(old, new.replace("{ink}", ink)))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('ink = "synthetic-green"', 'ink = "green"', r"print\.ink: no ink is named 'green'"),
        (
            "tilts_deg = [0.0, 7.0, 14.0, 20.0, -20.0, -14.0, -7.0]",
            "tilts_deg = [0.0, 7.0]",
            "three different",
        ),
        ("angles_deg = [0.0, 90.0, 180.0]", "angles_deg = [0.0, 180.0]", "45 to 135 degrees apart"),
        ("angles_deg = [0.0, 90.0, 180.0]", "angles_deg = [0.0, 44.0]", "45 to 135 degrees apart"),
        ("cell_mm = 0.1", "cell_mm = 1.5", "at least 2 cells"),
        ('wrong_inks = ["synthetic-red"]', 'wrong_inks = ["synthetic-green"]', "the print's own"),
        ('wrong_inks = ["synthetic-red"]', 'wrong_inks = ["synthetic-red", "synthetic-red"]', "an ink twice"),
        ("alpha_share = 0.05", "alpha_shares = 0.05", "unknown key; did you mean 'alpha_share'"),
    ],
)
def test_mistakes_are_named(written, old, new, says):
    with pytest.raises(RecipeError, match=says):
        PrintRecipe.read(written(old, new))


def test_two_inks_of_one_name_cannot_be_told_apart(written, tmp_path):
    write_ink(synthetic_ink("synthetic-red"), tmp_path / "mine.toml")
    with pytest.raises(RecipeError, match="two of its inks are called 'synthetic red'"):
        PrintRecipe.read(
            written('wrong_inks = ["synthetic-red"]', 'wrong_inks = ["synthetic-red", "mine.toml"]')
        )


@pytest.mark.parametrize(
    ("poses", "says"),
    [
        ({"tilts_deg": [0.0, 10.0, 20.0, 80.0]}, r"tilt 80°.*keep tilts within about 50°"),
        ({"tilts_deg": [0.0, 10.0, 20.0], "angles_deg": [0.0, 90.0]}, "do not determine the ratio"),
    ],
)
def test_poses_that_tell_nothing_are_refused_before_anything_moves(make_recipe, predict, poses, says):
    with pytest.raises(RecipeError, match=says):
        predict(make_recipe(poses=poses))


def test_angles_45_degrees_apart_tell_both_roughnesses(make_recipe, predict):
    angles = {"angles_deg": [0.0, 45.0], "tilts_deg": [0.0, 10.0, 20.0, -10.0, -20.0]}
    assert len(predict(make_recipe(poses=angles)).poses) == 10


def test_cells_smaller_than_a_few_pixels_are_refused_before_anything_moves(make_recipe):
    rig = RigFile.model_validate(rig_of(None))
    assert rig.camera.pixel_um == 6.3
    with pytest.raises(RecipeError, match=r"area\.cell_mm: a cell of 0\.025 mm.*0\.025 mm or larger"):
        expectation_of_print(make_recipe(area={"cell_mm": 0.025}), rig)
    assert len(expectation_of_print(make_recipe(area={"cell_mm": 0.026}), rig).poses) == 21


def test_a_check_says_what_the_recipe_tells(make_recipe, predict):
    recipe = make_recipe(poses={"tilts_deg": [0.0, 10.0, 20.0]}, area={"cell_mm": 0.5})
    found = check_print_recipe(recipe, predict(recipe))
    names = {one.name: one for one in found.quantities}
    assert names["alpha x"].u < names["alpha x"].limit / 3.0
    assert names["ratio"].u < 0.005
    causes = {one.cause: one for one in found.causes}
    # the sizes that are to be found
    assert abs(causes["roughness"].detection_extent) < 0.10
    assert abs(causes["brushing"].detection_extent) < 0.15
    assert causes["missing-ink"].detection_extent < 0.10
    assert causes["lean"].detection_extent < 1.0
    assert abs(causes["film-thickness"].separation_extent) < 10.0
    assert causes["wrong-ink-synthetic red"].separation_extent < 0.05
    assert any("brackets" in line for line in found.complaints)


def test_how_many_good_prints_pass_is_that_of_a_normal_error(make_recipe, predict):
    """With nothing uncertain but the white tile, ΔE of a pose is |z| u, and passes where |z| u + 1.645 u is below."""
    nothing = dict.fromkeys(PrintUncertainty.model_fields, 0.0)
    none_of_ink = dict.fromkeys(
        ("u_alpha_share", "u_rho_share", "u_colour_share", "u_c", "u_lobe", "u_substrate"), 0.0
    )
    recipe = make_recipe(
        print=none_of_ink,
        uncertainty=nothing | {"scale_share": 0.03, "model_share": 1e-6},
        area=None,
    )
    expected = predict(recipe)
    ones, metric = np.ones(3), expected.eye.metric(expected.channels)
    u = 0.03 * float(np.sqrt(np.einsum("i,pij,j->p", ones, metric, ones).max()))
    nothing_drifts = of_poses("drift of the lamp", "measurement", np.zeros((21, 3)))
    for limit in (1.7 * u, 2.2 * u, 3.0 * u):
        tried = recipe.model_copy(
            update={"tolerances": PrintTolerances(delta_e=limit, gain_share=1.9 * 0.03)}
        )
        decision = as_predicted(tried, expected, nothing_drifts)
        found = {one.name: one for one in planned_quantities(tried, expected, decision)}
        assert found["delta_e"].u == pytest.approx(u, rel=1e-3)
        assert found["delta_e"].passing == pytest.approx(1.0 - 2.0 * norm.sf(limit / u - 1.645), abs=0.03)
        assert found["gain"].passing == pytest.approx(1.0 - 2.0 * norm.sf(1.9 - 1.645), abs=1e-3)
    assert found["tilt"].passing == 1.0


def test_with_the_starting_limits_a_quarter_of_good_prints_stays_undecided(make_recipe, predict):
    """The share that the page of prints states, and that the check complains of."""
    recipe = make_recipe(area=None)
    found = check_print_recipe(recipe, predict(recipe))
    passing = {one.name: one.passing for one in found.quantities}
    assert passing.pop("delta_e") == pytest.approx(0.73, abs=0.02)
    assert min(passing.values()) > 0.95
    told = [
        re.search(r"too few good prints will pass \(90% wanted\).* only (\d+)% the limit of ΔE2000", line)
        for line in found.complaints
    ]
    assert [int(one[1]) for one in told if one] == [pytest.approx(73, abs=3)]
    (advice,) = (
        re.search(r"ΔE2000 \(([\d.]+) would do\)", line) for line in found.complaints if "ΔE2000" in line
    )
    wider = recipe.model_copy(update={"tolerances": PrintTolerances(delta_e=float(advice[1]))})
    again = check_print_recipe(wider, predict(wider))
    assert 0.9 <= next(one.passing for one in again.quantities if one.name == "delta_e") < 0.93


@pytest.mark.statistics
def test_prints_that_are_off_as_stated_pass_as_often_as_the_check_says(make_recipe, predict):
    """Drawn by the ink model itself, not linearly, and judged."""
    recipe = make_recipe(area=None)
    expected, rng = predict(recipe), np.random.default_rng(7)
    said = {one.name: one.passing for one in check_print_recipe(recipe, expected).quantities}["delta_e"]
    known, rig = recipe.print.of_ink(expected.scene.ink), recipe.uncertainty
    lamp = 0.25 * recipe.limits.drift / np.sqrt(3.0)
    drift = of_poses("drift of the lamp", "measurement", np.full(expected.channels.shape, lamp))
    linear = [one for one in expected.common if one.name == "ink model"]
    linear += [*rig_sources(recipe, expected), drift]
    passed = 0
    for _ in range(300):
        z = rng.standard_normal(12)
        colours = known.rho_share * z[0] + known.colour_share * z[1:4]
        state = State(
            alpha=known.alpha_share * z[4],
            red=colours[0],
            green=colours[1],
            blue=colours[2],
            lobe=known.lobe * z[5],
            c=known.c * z[6],
            seat_x_deg=rig.seating_tilt_deg * z[7],
            seat_y_deg=rig.seating_tilt_deg * z[8],
            light_angle_deg=rig.light_angle_deg * z[9],
            substrate=recipe.print.u_substrate * z[10],
        )
        logs = expected.scene.log_channels(state)
        logs = logs + sum(one.factor @ rng.standard_normal(one.factor.shape[1]) for one in linear)
        channels = np.exp(logs).reshape(-1, 3)
        measured = MeasuredPrint(
            channels, channels[:, :, None, None], 0.0 * channels, (drift,), cell_grid(recipe), None
        )
        (one,) = (one for one in decide_print(expected, measured, recipe).quantities if one.name == "delta_e")
        passed += one.verdict is Verdict.PASS
    print(f"{passed} of 300 pass, {said:.3f} said")  # noqa: T201 - what the study found
    assert passed / 300 == pytest.approx(said, abs=3.0 * np.sqrt(said * (1.0 - said) / 300) + 0.02)


@pytest.mark.parametrize(("lamp_deg", "lens_deg", "tilt"), [(1.0, 2.0, 0.0), (3.0, 1.5, 7.0)])
def test_sparkles_of_drawn_flakes_scatter_as_is_said(make_recipe, predict, lamp_deg, lens_deg, tilt):
    """Flakes by chance, mirrors one by one: points of the lamp that each sends into the lens, summed over cells."""
    recipe = make_recipe(print={"wrong_inks": []})
    scene, rng = predict(recipe).scene, np.random.default_rng(3)
    place = next(k for k, pose in enumerate(scene.poses) if (pose.stage_deg, pose.tilt_deg) == (0.0, tilt))
    flake_um, cell_mm, cells = 60.0, 4.0, 300
    said = sparkles(scene, flake_um, cell_mm, lamp_deg, lens_deg)[place]
    to_light, to_camera = (one[place] for one in directions(scene.poses, Convention(10.0)))
    count = rng.poisson((1000.0 * cell_mm) ** 2 / (0.25 * np.pi * flake_um**2), cells)
    share, turn = rng.random(count.sum()), rng.uniform(0.0, 2.0 * np.pi, count.sum())
    slope = scene.ink.alpha * np.sqrt(share / (1.0 - share))  # GGX, by its cumulative share
    normals = np.column_stack([slope * np.cos(turn), slope * np.sin(turn), np.ones(len(slope))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    blurred = np.hypot(np.radians(lamp_deg), 2.0 * 0.55 / (np.pi * flake_um))
    seen = np.zeros(len(normals))
    for _ in range(60):  # points of the lamp
        spot, angle = blurred * np.sqrt(rng.random()), rng.uniform(0.0, 2.0 * np.pi)
        across = np.cross(to_light, [0.0, 1.0, 0.0])
        across /= np.linalg.norm(across)
        ray = to_light + np.tan(spot) * (np.cos(angle) * across + np.sin(angle) * np.cross(to_light, across))
        ray /= np.linalg.norm(ray)
        back = 2.0 * (normals @ ray)[:, None] * normals - ray
        seen += back @ to_camera >= np.cos(np.radians(lens_deg))
    light = np.add.reduceat(seen, np.concatenate([[0], np.cumsum(count)[:-1]]))
    scatter = light.std() / light.mean()
    assert scatter == pytest.approx(1.0 / np.sqrt(said), rel=0.12)


def test_the_check_says_when_few_flakes_of_a_cell_shine(make_recipe, predict):
    recipe = make_recipe(print={"flake_um": 20.0, "wrong_inks": []}, region={"size_mm": [30.0, 30.0]})
    expected = predict(recipe)
    (line,) = (
        one for one in check_print_recipe(recipe, expected, (1.0, 2.0)).complaints if "that shine" in one
    )
    assert line.startswith("a cell of 0.1 mm holds 0.")
    wide = float(re.search(r"take area.cell_mm = ([\d.]+)", line)[1])
    wider = recipe.model_copy(update={"area": recipe.area.model_copy(update={"cell_mm": 1.1 * wide})})
    assert not any("that shine" in one for one in check_print_recipe(wider, expected, (1.0, 2.0)).complaints)
    (unknown,) = (one for one in check_print_recipe(recipe, expected).complaints if "flake_um" in one)
    assert "light.half_angle_deg and camera.half_angle_deg" in unknown
    with pytest.raises(ValidationError, match="greater than 0"):
        make_recipe(print={"flake_um": 0.0})


@pytest.mark.parametrize(
    ("table", "key", "wrong", "asked"),
    [
        ("print", "flake_um", 1e9, "flakes have"),
        ("print", "dot_um", 0.08, "dots of 0.08 mm are dot_um 80"),
        ("area", "cell_mm", 100.0, "cells of 100 µm are cell_mm 0.1"),
        ("defects", "film_nm", 0.003, "shifts of a spectrum of 0.003 µm are film_nm 3"),
        ("region", "size_mm", [2000.0, 2000.0], "regions of 2000 µm are size_mm 2"),
    ],
)
def test_a_length_in_another_unit_is_asked_about(make_recipe, table, key, wrong, asked):
    with pytest.raises(ValidationError, match=asked):
        make_recipe(**{table: {key: wrong}})


def test_a_length_may_carry_its_unit(make_recipe):
    assert make_recipe(print={"flake_um": "40000nm"}).print.flake_um == pytest.approx(40.0)


def test_the_check_says_once_that_an_ink_file_states_no_uncertainty(make_recipe, predict, tmp_path):
    def told(ink):
        write_ink(ink, tmp_path / "ink.toml")
        recipe = make_recipe(print={"ink": str(tmp_path / "ink.toml"), "wrong_inks": []}, area=None)
        lines = check_print_recipe(recipe, predict(recipe)).complaints
        return [one for one in lines if "states no uncertainty" in one], recipe

    stated = synthetic_ink("synthetic-red")
    (line,), recipe = told(replace(stated, uncertainty=None))
    assert "anisoscope ink fit" in line
    assert recipe.print.of_ink(recipe.print.read_ink()).rho_share > 9.0 * stated.uncertainty.rho_share
    assert told(stated)[0] == []


def test_the_check_says_when_the_sheet_outshines_the_ink(make_recipe, predict):
    def told(coverage):
        recipe = make_recipe(print={"coverage": coverage, "substrate": 0.9, "wrong_inks": []}, area=None)
        expected = predict(recipe)
        bare = make_recipe(print={"coverage": 1e-9, "substrate": 0.9, "wrong_inks": []}, area=None)
        sheet = (1.0 - coverage) * predict(bare).channels.sum(axis=1)
        share = (1.0 - sheet / expected.channels.sum(axis=1)).max()
        lines = check_print_recipe(recipe, expected).complaints
        return share, [one for one in lines if "sheet is brighter than the ink" in one]

    share, (line,) = told(0.02)
    assert share < 0.5
    assert f"send {share:.0%} of the light" in line
    assert "print.coverage (0.02) and print.substrate (0.9)" in line
    share, none = told(0.6)
    assert share > 0.5
    assert none == []


def test_a_check_without_any_uncertainty_is_no_check(make_recipe, predict):
    recipe = make_recipe(uncertainty=dict.fromkeys(PrintUncertainty.model_fields, 0.0))
    with pytest.raises(RecipeError, match="no source of uncertainty is left"):
        check_print_recipe(recipe, predict(recipe))


def test_the_check_says_when_no_cell_of_the_region_holds_enough_dots(make_recipe, predict):
    recipe = make_recipe(print={"coverage": 0.5, "dot_um": 4000.0, "wrong_inks": []})
    (line,) = (one for one in check_print_recipe(recipe, predict(recipe)).complaints if "of 4000 µm" in one)
    assert "holds one dot or less of 4000 µm, and the region too few" in line


def test_the_check_says_when_cells_hold_few_dots(make_recipe, predict, rng):
    """Dots of 40 µm by chance, laid out over cells of 0.1 mm and summed: they scatter by no more than is said."""
    recipe = make_recipe(print={"coverage": 0.5, "dot_um": 40.0, "wrong_inks": []})
    expected = predict(recipe)
    (line,) = (one for one in check_print_recipe(recipe, expected).complaints if "dots of 40 µm" in one)
    assert "holds 6 dots" in line
    stated, limit = (float(one) for one in re.findall(r"up to (?:ΔE )?([\d.]+)", line))
    dots = np.kron(rng.random((100, 100)) < 0.5, np.ones((4, 4)))  # points of 10 µm
    share = dots.reshape(40, 10, 40, 10).mean(axis=(1, 3))
    bright = expected.channels[expected.channels.sum(axis=1).argmax()]
    bare = 0.04 / np.pi
    inked = 2.0 * (bright - 0.5 * bare)
    cells = share[..., None] * inked + (1.0 - share[..., None]) * bare
    metric = expected.eye.metric(expected.channels)[expected.channels.sum(axis=1).argmax()]
    off = np.log(cells) - np.log(cells.mean(axis=(0, 1)))
    scatter = np.sqrt(np.mean(np.einsum("rci,ij,rcj->rc", off, metric, off)))
    assert 0.6 * stated < scatter < 1.2 * stated
    assert limit == pytest.approx(5.0 * 0.674 * stated, rel=0.1)
    wide = recipe.model_copy(update={"area": recipe.area.model_copy(update={"cell_mm": 2.0})})
    assert not any("dots of" in one for one in check_print_recipe(wide, expected).complaints)
