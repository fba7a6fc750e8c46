"""What golden parts say of their scatter: to ``golden show``, and to another recipe for the same plastic and rig."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.decision.consistency import contrast_scatter
from anisoscope.decision.equipment import Equipment
from anisoscope.decision.predictive import learnt_scatter, predictive_test, suggested_scatter
from anisoscope.decision.reference_parts import GoldenPart, GoldenSet, golden_path, write_golden
from anisoscope.kinds.command_output import CommandOutput
from anisoscope.kinds.registry import kind_of
from anisoscope.kinds.ridges.recipe import RidgeRecipe, new_recipe
from anisoscope.kinds.surface_reference import scatter_texts, with_power
from anisoscope.prediction.part_scatter import CAMERA_SHARE, part_scatter

LIGHT_DEG = 10.0


@pytest.fixture(scope="module")
def shown():
    """``shown(factor)``: output for five golden parts that scatter by so many times what a new recipe states."""
    table = tomllib.loads(
        new_recipe("part", 100.0, ridge_angle_deg=10.0, height_map=None, u_ridge_angle_deg=0.1)
    )
    table["surface"]["reflections"] = "direct"
    table["material"]["u_tail"] = 0.0
    recipe = RidgeRecipe.model_validate(table)
    parts = part_scatter(recipe, LIGHT_DEG)
    scatter = contrast_scatter(parts, CAMERA_SHARE)
    rng = np.random.default_rng(4)
    drawn = scatter.drawn(np.zeros((1, len(scatter.own))), 5, rng)[0]

    def made(factor):
        rows = tuple(
            GoldenPart(
                serial=str(number), inspected_at="2026-01-01", log_radiance=(0.0, *(factor * row)), area_share=None,
                verdict="PASS",
            )
            for number, row in enumerate(drawn)
        )  # fmt: skip
        poses = tuple((pose.stage_deg, pose.tilt_deg) for pose in recipe.poses.poses())
        known = GoldenSet(product="part", recipe_key="", poses=poses, parts=rows)
        return recipe, with_power(CommandOutput({}, (), ()), known, recipe, parts)

    return made


def test_every_input_that_scatters_has_its_row_unit_and_key(shown):
    recipe, output = shown(1.0)
    power, scattered = output.tables
    assert [row[0] for row in scattered.rows] == [
        one["source"] for one in output.content["scatter_of_inputs"]
    ]
    assert {"edge radius", "ridge angle of the design"} < {row[0] for row in scattered.rows}
    assert {row[-1].split(", ")[1] for row in scattered.rows} <= set(type(recipe.stated_scatter).model_fields)
    assert all(row[1] == f"{scatter_texts(recipe)[row[0]][0]:.3g}" for row in scattered.rows)
    assert len(power.columns) == 6  # the defect, and 1, 3, 5, 10 and 25 parts
    assert 0.2 < output.content["birge"] < 3.0
    assert "[scatter]" not in output.lines[-1]


def test_golden_parts_that_contradict_the_stated_scatter_are_named(shown):
    _, output = shown(4.0)
    assert output.content["birge"] > 3.0
    assert "state theirs in [scatter]" in output.lines[-1]


RIG = """schema = 1
[camera]
pixel_um = 12.5
[light]
angle_deg = 10.0
"""
TILTED = "stage_and_tilt_deg = [[0, 0], [90, 0], [180, 0], [90, -15], [90, -5], [0, -10]]"


def text_of_recipe():
    """Text of a new recipe; direct light alone, which is quick, and whose inputs scatter as those of all light."""
    text = new_recipe("part", 100.0, ridge_angle_deg=10.0, height_map=None, u_ridge_angle_deg=0.1)
    return text.replace("[surface]\n", '[surface]\nreflections = "direct"\n')


@pytest.fixture(scope="module")
def tilted():
    """Text of a recipe with tilted poses, and its scatter as stated."""
    text = text_of_recipe().replace("u_ridge_angle_deg", "edge_radius_um = 0.5, u_ridge_angle_deg")
    changed = "\n".join(TILTED if line.startswith("angles_deg") else line for line in text.splitlines())
    changed = "\n".join(line for line in changed.splitlines() if not line.startswith("tilts_deg"))
    recipe = RidgeRecipe.model_validate(tomllib.loads(changed))
    return changed, contrast_scatter(part_scatter(recipe, LIGHT_DEG), CAMERA_SHARE)


@pytest.fixture
def two_recipes(tmp_path, tilted):
    """``two_recipes(count, equipment)``: upright, and tilted with golden parts twice as scattered in roughness."""
    text, stated = tilted

    def made(count, equipment=None):
        own = stated.own * [2.0 if one.startswith("roughness") else 1.0 for one in stated.response.sources]
        true = replace(stated, own=own)
        rows = true.drawn(np.zeros((1, len(own))), count, np.random.default_rng(7))[0]
        paths = tmp_path / "upright.toml", tmp_path / "tilted.toml"
        for path, content in zip(paths, (text_of_recipe(), text), strict=True):
            path.write_text(content, encoding="utf-8")
        recipe = RidgeRecipe.model_validate(tomllib.loads(text))
        known = GoldenSet(
            product="part",
            recipe_key=GoldenSet.key_of(recipe),
            equipment=equipment,
            poses=tuple((pose.stage_deg, pose.tilt_deg) for pose in recipe.poses.poses()),
            parts=tuple(
                GoldenPart(
                    serial=str(k),
                    inspected_at="2026",
                    log_radiance=(0.0, *row),
                    area_share=None,
                    verdict="PASS",
                )
                for k, row in enumerate(rows)
            ),
        )
        write_golden(golden_path(paths[1]), known)
        rig = tmp_path / "rig.toml"
        rig.write_text(RIG, encoding="utf-8")
        return *paths, rig

    return made


def test_what_golden_parts_show_of_their_scatter_serves_another_recipe(two_recipes):
    upright, source, rig = two_recipes(25)
    before = upright.read_text(encoding="utf-8")
    kind = kind_of(upright)
    found = kind.teach_by_reference(upright, rig, 0.95, source)
    changes = {change.key: change for change in found.changes}
    assert changes["scatter.alpha_share"].old == "5 %"
    assert changes["scatter.alpha_share"].why.startswith("25 golden parts of tilted.toml show ")
    taught = kind.read_recipe(upright)
    assert 0.065 < taught.scatter.alpha_share < 0.12  # drawn with 0.1, stated as 0.05
    assert f"{100.0 * taught.scatter.alpha_share:g} %" == changes["scatter.alpha_share"].new
    assert (taught.version, found.version) == (2, 2)
    assert found.kept.read_text(encoding="utf-8") == before
    comments = [line for line in before.splitlines() if line.startswith("#")]
    assert [
        line for line in upright.read_text(encoding="utf-8").splitlines() if line.startswith("#")
    ] == comments
    with pytest.raises(UsageError, match=r"stays: .* within 5% of .*tilted\.toml teach"):
        kind.teach_by_reference(upright, rig, 0.95, source)


def test_golden_parts_that_do_not_serve_the_other_recipe_are_refused(two_recipes):
    upright, source, rig = two_recipes(2)
    teach = kind_of(upright).teach_by_reference
    with pytest.raises(UsageError, match=r"tilted\.toml: 3 golden parts or more .*, it has 2"):
        teach(upright, rig, 0.95, source)
    with pytest.raises(UsageError, match=r"upright\.toml: 3 golden parts or more .*, it has 0"):
        teach(upright, rig, 0.95)
    upright, source, rig = two_recipes(10, Equipment(pixel_um=6.0, light_angle_deg=10.0))
    with pytest.raises(CalibrationError, match=r"measured with another lens: pixel_um 6, here 12\.5"):
        teach(upright, rig, 0.95, source)
    upright, source, rig = two_recipes(10)
    text = upright.read_text(encoding="utf-8")
    upright.write_text(text.replace("albedo = ", "albedo = 0.5  # "), encoding="utf-8")
    with pytest.raises(UsageError, match=r"state different plastics.*: name the same material file in both"):
        teach(upright, rig, 0.95, source)
    assert not list(upright.parent.glob("*.v1.toml"))


def test_an_input_that_hardly_shows_is_not_known_well_however_large_its_estimate(tilted):
    _, stated = tilted
    rng = np.random.default_rng(3)
    known = {}
    for _ in range(20):
        for one in suggested_scatter(stated, stated.drawn(stated.shared(1, rng), 10, rng)[0]):
            known.setdefault(one.source, []).append(one.freedom)
    assert max(known["edge radius"]) < 2.0
    assert np.median(known["roughness across the ridges"]) > 5.0
    assert all(max(values) <= 9.0 for values in known.values())


def test_learnt_scatter_keeps_what_golden_parts_do_not_show_and_tends_to_theirs(tilted):
    _, stated = tilted
    key = dict.fromkeys(stated.response.sources, "other")
    key |= {one: one for one in stated.response.sources if one.startswith(("roughness", "edge"))}
    blind = replace(stated, errors=1e4 * np.eye(len(stated.errors)))
    few = stated.drawn(np.zeros((1, len(stated.own))), 3, np.random.default_rng(2))[0]
    np.testing.assert_allclose(list(learnt_scatter(blind, few, key).values()), 1.0, atol=1e-3)
    own = stated.own * [
        3.0 if one == "roughness across the ridges" else 1.0 for one in stated.response.sources
    ]
    linear = replace(stated.response, bend=np.zeros_like(stated.response.bend))
    wide = replace(stated, own=own, response=linear, lobes=())
    many = wide.drawn(np.zeros((1, len(own))), 2000, np.random.default_rng(2))[0]
    found = learnt_scatter(replace(stated, response=linear, lobes=()), many, key)
    assert found["roughness across the ridges"] == pytest.approx(3.0, rel=0.05)
    assert found["roughness along the ridges"] == pytest.approx(1.0, rel=0.1)


@pytest.mark.statistics
def test_scatter_learnt_on_one_recipe_keeps_the_level_of_another(tilted):
    """Ridges of 10° teach how parts differ; ridges of 15° of the same plastic are judged with three golden parts."""
    text, first = tilted
    table = tomllib.loads(text)
    table["surface"]["design"]["ridge_angle_deg"] = 15.0
    second = contrast_scatter(part_scatter(RidgeRecipe.model_validate(table), LIGHT_DEG), CAMERA_SHARE)
    recipe = RidgeRecipe.model_validate(tomllib.loads(text))
    keys = {name: unit.split(", ")[1] for name, (_, unit) in scatter_texts(recipe).items()}
    rng = np.random.default_rng(5)

    def scaled(scatter, multiples):
        factors = [multiples.get(keys.get(one, ""), 1.0) for one in scatter.response.sources]
        return replace(scatter, own=scatter.own * factors)

    for truth in (
        {},
        {"alpha_share": 2.0, "ridge_angle_deg": 0.4},
        {"alpha_share": 0.5, "ridge_angle_deg": 2.0},
    ):
        flagged = {"stated": 0, "learnt": 0}
        for _ in range(20):
            golden = scaled(first, truth).drawn(first.shared(1, rng), 25, rng)[0]
            parts = scaled(second, truth).drawn(second.shared(1, rng), 3 + 30, rng)[0]
            learnt = scaled(second, learnt_scatter(first, golden, keys))
            for name, scatter in (("stated", second), ("learnt", learnt)):
                flagged[name] += sum(
                    predictive_test(scatter, parts[:3], part, 0.01).p_value < 0.01 for part in parts[3:]
                )
        assert flagged["learnt"] <= 0.03 * 600, (truth, flagged)
        if truth.get("alpha_share", 1.0) > 1.0:
            assert flagged["learnt"] < 0.5 * flagged["stated"]
