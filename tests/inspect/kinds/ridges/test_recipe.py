"""New recipes are valid as written, and taught ones keep what a person wrote."""

import tomllib

import pytest

from anisoscope.base.errors import RecipeError
from anisoscope.base.toml_edits import with_values
from anisoscope.kinds.registry import read_recipe
from anisoscope.kinds.ridges.recipe import RidgeRecipe, new_recipe


@pytest.mark.parametrize(
    ("angle", "height_map", "decides"),
    [(12.0, None, "design"), (None, "maps/a b.x3p", "height_map"), (12.0, "a.x3p", "height_map")],
)
def test_a_new_recipe_is_valid(tmp_path, angle, height_map, decides):
    text = new_recipe('a "quoted" part', 80.0, ridge_angle_deg=angle, height_map=height_map)
    path = tmp_path / "recipe.toml"
    path.write_text(text, encoding="utf-8")
    recipe = read_recipe(path)
    assert (recipe.product, recipe.surface.pitch_um) == ('a "quoted" part', 80.0)
    assert recipe.surface.decides == decides
    assert recipe.surface.both == (angle is not None and height_map is not None)
    assert ("u_ridge_angle_deg = 0.0" in text) == (
        height_map is None
    )  # a map that decides has no such spread
    known = set(RidgeRecipe.model_validate(tomllib.loads(text)).model_dump(by_alias=True))
    assert set(tomllib.loads(text)) <= known


@pytest.mark.parametrize("height_map", [None, "a.x3p"])
def test_a_spread_of_the_ridge_angle_stands_in_the_design_which_then_decides(tmp_path, height_map):
    text = new_recipe("part", 80.0, ridge_angle_deg=12.0, height_map=height_map, u_ridge_angle_deg=0.15)
    path = tmp_path / "recipe.toml"
    path.write_text(text, encoding="utf-8")
    surface = read_recipe(path).surface
    assert (surface.decides, surface.design.u_ridge_angle_deg) == ("design", 0.15)
    assert surface.both == (height_map is not None)


def test_changed_values_leave_comments_and_everything_else():
    text = new_recipe("part", 100.0, ridge_angle_deg=10.0, height_map=None)
    changes = {
        ("version",): 2,
        ("acquisition", "exposure_s"): 0.0123,
        ("region", "size_mm"): [1.5, 1.5],
        ("decision", "tolerance"): [0.2, 0.3],
        ("limits", "drift"): 0.01,
    }
    found = with_values(text, changes)
    old, new = text.splitlines(), found.splitlines()
    assert [line for line in old if line not in new] == [
        "version = 1",
        "exposure_s = 0.005",
        "size_mm = [2.0, 2.0]",
    ]
    table = tomllib.loads(found)
    assert table["decision"]["tolerance"] == [0.2, 0.3]
    assert (table["version"], table["limits"], table["region"]["size_mm"]) == (2, {"drift": 0.01}, [1.5, 1.5])


def test_an_array_over_several_lines_becomes_one_line():
    text = "version = 1\n[region]\nsize_mm = [  # mm\n    0.3,\n    0.3,  # along\n]\nx = 1\n"
    found = with_values(text, {("region", "size_mm"): [1.0, 2.0]})
    assert tomllib.loads(found)["region"] == {"size_mm": [1.0, 2.0], "x": 1}


def test_what_is_written_otherwise_is_refused():
    text = "version = 1\nacquisition = { exposure_s = 0.005 }\n"
    with pytest.raises(RecipeError, match="cannot be changed in this recipe"):
        with_values(text, {("acquisition", "exposure_s"): 0.01})
