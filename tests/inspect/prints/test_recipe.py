"""Recipes of prints: what they hold, what is refused, and how they are begun and checked."""

from pathlib import Path

import pytest

from anisoscope.errors import RecipeError
from anisoscope.inkfile import InkFileError, synthetic_ink, write_ink
from anisoscope.prints.recipe import read_any_recipe, read_print_recipe
from anisoscope.prints.recipecheck import check_print_recipe
from anisoscope.prints.recipetext import new_print_recipe
from anisoscope.recipe import Recipe, is_print, read_recipe
from anisoscope.recipetext import new_recipe


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
    assert is_print(written())
    assert recipe.product == 'print "7"'
    assert recipe.tolerances == type(recipe.tolerances)()
    assert recipe.uncertainty == type(recipe.uncertainty)()
    assert recipe.print.wrong_inks == ("synthetic-red",)
    assert recipe.print.read_ink().name == "synthetic green"


def test_the_other_kind_is_read_as_what_it_is(tmp_path):
    path = tmp_path / "ridges.toml"
    path.write_text(new_recipe("plate", 100.0, ridge_angle_deg=10.0, height_map=None))
    assert isinstance(read_any_recipe(path), Recipe)


def test_commands_for_surfaces_refuse_it(written):
    with pytest.raises(RecipeError, match="the recipe of a print; this works with recipes of surfaces"):
        read_recipe(written())


def test_an_ink_file_counts_from_the_recipe(written, tmp_path):
    write_ink(synthetic_ink("synthetic-blue"), tmp_path / "mine.toml")
    recipe = read_print_recipe(written('ink = "synthetic-green"', 'ink = "mine.toml"'))
    assert Path(recipe.print.ink) == tmp_path / "mine.toml"
    assert recipe.print.read_ink().name == "synthetic blue"
    with pytest.raises(InkFileError, match=r"none\.toml"):
        read_print_recipe(written('ink = "synthetic-green"', 'ink = "none.toml"'))


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
        ("cell_mm = 0.1", "cell_mm = 1.5", "at least 2 cells"),
        ("alpha_share = 0.05", "alpha_shares = 0.05", "unknown key; did you mean 'alpha_share'"),
    ],
)
def test_mistakes_are_named(written, old, new, says):
    with pytest.raises(RecipeError, match=says):
        read_print_recipe(written(old, new))


def test_a_check_says_what_the_recipe_tells(make_recipe, predict):
    recipe = make_recipe(poses={"tilts_deg": [0.0, 10.0, 20.0]}, area={"cell_mm": 0.5})
    found = check_print_recipe(recipe, predict(recipe))
    names = {one.name: one for one in found.quantities}
    assert names["alpha x"].u < names["alpha x"].limit / 3.0
    assert names["ratio"].u < 0.005
    causes = {one.cause: one for one in found.causes}
    # the sizes that are to be found
    assert abs(causes["roughness"].shows_from) < 0.10
    assert abs(causes["brushing"].shows_from) < 0.15
    assert causes["missing-ink"].shows_from < 0.10
    assert causes["lean"].shows_from < 1.0
    assert abs(causes["film-thickness"].told_apart_from) < 10.0
    assert causes["wrong-ink-synthetic red"].told_apart_from < 0.05
    assert any("brackets" in line for line in found.complaints)
