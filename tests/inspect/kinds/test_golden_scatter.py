"""What ``golden show`` says of the scatter of golden parts."""

import tomllib

import numpy as np
import pytest

from anisoscope.decision.consistency_test import contrast_scatter
from anisoscope.decision.reference_parts import GoldenPart, GoldenSet
from anisoscope.kinds.command_output import CommandOutput
from anisoscope.kinds.ridges.recipe import RidgeRecipe, new_recipe
from anisoscope.kinds.surface import CAMERA_SHARE, scatter_texts, with_power
from anisoscope.prediction.part_scatter import part_scatter

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
