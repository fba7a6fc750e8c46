"""Recipes of prints from the command line: begin, check, and what they are refused for."""

import pytest

from anisoscope.base.errors import RecipeError
from anisoscope.kinds.registry import read_recipe


@pytest.fixture
def recipe(anisoscope, tmp_path):
    """A new recipe of a print."""
    done = anisoscope("recipe", "new", "--ink", "synthetic-red", "--out", tmp_path / "print.toml")
    assert done.code == 0, done.err
    assert "adapt [print]" in done.out
    return tmp_path / "print.toml"


def test_a_recipe_of_a_print_is_begun_and_checked(anisoscope, recipe):
    text = recipe.read_text(encoding="utf-8")
    short = text.replace(
        "tilts_deg = [0.0, 7.0, 14.0, 20.0, -20.0, -14.0, -7.0]", "tilts_deg = [0.0, 10.0, 20.0]"
    )
    recipe.write_text(short, encoding="utf-8")
    done = anisoscope("recipe", "check", recipe, "--json")
    assert done.code == 0, done.err
    assert len(done.json["poses"]) == 9
    assert done.json["unchecked"].startswith("the light of the rig; 10° is assumed")
    names = [one["name"] for one in done.json["quantities"]]
    assert names == ["alpha x", "alpha y", "ratio", "skew", "gain", "chromaticity", "tilt", "delta_e"]
    causes = {one["cause"]: one for one in done.json["causes"]}
    assert causes["wrong-ink-synthetic blue"]["never_told_from"] == []
    assert done.json["matrix_residual"] < 1.0


def test_commands_for_surfaces_refuse_it(recipe):
    with pytest.raises(RecipeError, match="works with recipes of surfaces only"):
        read_recipe(recipe)


def test_it_has_no_golden_prints_yet(anisoscope, recipe):
    done = anisoscope("golden", "show", "--recipe", recipe)
    assert done.code == 64
    assert "there are no golden parts of this recipe" in done.err


def test_it_excludes_the_surface(anisoscope, tmp_path):
    done = anisoscope(
        "recipe", "new", "--ink", "synthetic-red", "--ridge-angle", 10, "--out", tmp_path / "r.toml"
    )
    assert done.code == 64
    assert "--ink makes the recipe of a print: leave --ridge-angle" in done.err.replace("\n", " ")
    done = anisoscope("recipe", "new", "--ink", "magenta", "--out", tmp_path / "r.toml")
    assert done.code == 64
    assert "no ink is named 'magenta'" in done.err
    assert not (tmp_path / "r.toml").exists()
