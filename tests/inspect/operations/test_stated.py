"""Plastic and surface that a recipe states, under what a command states."""

import json

import pytest

from anisoscope.base.errors import RecipeError, UsageError
from anisoscope.cli import run
from anisoscope.operations.stated import Stated, stated
from anisoscope.parameters.material import Material
from anisoscope.recipe.material_file import MaterialFile, write_material_file

TEXT = """
schema = 1
product = "plate"
[surface]
pitch_um = 80.0
[surface.design]
ridge_angle_deg = 8.0
edge_radius_um = 2.0
wall = 12.0
[material]
alpha_along = 0.0712345678901234
alpha_across = 0.09
albedo = 0.3
tail = 0.6
u_tail = 0.1
[poses]
facet_azimuth_deg = 15.0
[acquisition]
exposure_s = 0.001
[region]
size_mm = [1.0, 1.0]
"""


@pytest.fixture
def recipe(tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(TEXT, encoding="utf-8")
    return path


def test_without_a_recipe_models_have_their_defaults():
    assert stated(None) == Stated()
    assert Stated().material == Material()


def test_a_recipe_states_plastic_surface_and_orientation(recipe):
    found = stated(recipe)
    assert found.material == Material(0.0712345678901234, 0.09, 0.3, tail=0.6)
    assert found.convention.facet_azimuth_deg == 15.0
    assert (found.design.pitch_um, found.design.ridge_angle_deg) == (80.0, 8.0)
    assert (found.design.wall, found.design.edge_radius_um) == (12.0, 2.0)
    assert found.height_map is None


def test_a_height_map_decides_where_there_is_no_design(recipe):
    text = (
        TEXT.partition("[surface.design]")[0]
        + 'height_map = "part.x3p"\npixel_um = [0.5, 0.4]\nrole = "tool"\n'
    )
    recipe.write_text(text + "[material]" + TEXT.partition("[material]")[2], encoding="utf-8")
    found = stated(recipe)
    assert (found.height_map, found.pixel_um, found.role) == (recipe.parent / "part.x3p", (0.5, 0.4), "tool")
    assert found.design is None


def test_recipes_of_other_kinds_and_other_files_are_named(tmp_path, recipe):
    other = tmp_path / "print.toml"
    other.write_text('schema = 1\nkind = "prints"\n', encoding="utf-8")
    with pytest.raises(UsageError, match=r"print\.toml: the recipe of"):
        stated(other)
    recipe.write_text("schema = 1\n", encoding="utf-8")
    with pytest.raises(RecipeError, match=r"recipe\.toml"):
        stated(recipe)


def answer(capsys, *words):
    assert run([*words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_commands_put_their_options_over_the_recipe(recipe, capsys):
    """A measured lobe, a draft and a crest radius reach the optimum; a stated default counts too."""
    found = answer(
        capsys, "optimise", "--recipe", str(recipe), "--bounces", "1", "--albedo", "0.2", "--pitch", "0.1mm"
    )
    part = found["optimum"]["part"]
    assert (part["tail"], part["albedo"], part["alpha_along"]) == (0.6, 0.2, 0.0712345678901234)
    assert (part["pitch"], part["wall"], part["edge_radius"]) == (100.0, 12.0, 2.0)
    assert found["scoring"]["convention"]["facet_azimuth_deg"] == 15.0


def test_the_score_of_a_measured_lobe_is_the_contrast_that_its_recipe_predicts(recipe, capsys):
    """The optimum's own contrast, by `optimise` and by `predict --recipe` of the same ridges, all reflections."""
    near = ("--vary", "ridge_angle=7.9999:8.0001", "--contrast", "log_ratio")
    found = answer(capsys, "optimise", "--recipe", str(recipe), *near)["optimum"]
    text = TEXT.replace("ridge_angle_deg = 8.0", f"ridge_angle_deg = {found['part']['ridge_angle']}")
    recipe.write_text(text, encoding="utf-8")
    predicted = answer(capsys, "predict", "--recipe", str(recipe))["contrasts"]
    first = next(one for one in predicted if (one["from_deg"], one["to_deg"]) == (0.0, 90.0))
    assert found["nominal_contrast"] == pytest.approx(abs(first["log_ratio"]), rel=2e-3)


def test_the_published_experiment_takes_a_measured_lobe(recipe, capsys):
    with_tail = answer(capsys, "research", "experiment", "--model", "corrected", "--recipe", str(recipe))
    without = answer(
        capsys, "research", "experiment", "--model", "corrected", "--recipe", str(recipe), "--tail", "0"
    )
    assert with_tail["material"]["tail"] == 0.6
    assert with_tail != without


def test_a_material_file_stands_in_place_of_the_recipes_plastic(recipe, tmp_path, capsys):
    calibrated = Material(0.05, 0.11, 0.25, tail=0.8)
    content = {
        "id": "material-1",
        "name": "ABS",
        "material": {
            name: getattr(calibrated, name) for name in ("alpha_along", "alpha_across", "albedo", "tail")
        },
        "covariance": {"parameters": ("tail",), "matrix": ((0.0,),)},
        "validity": {"half_angle_deg": (0.0, 60.0)},
    }
    file = tmp_path / "abs.toml"
    write_material_file(MaterialFile.model_validate(content), file)
    found = stated(recipe, file)
    assert found.material == calibrated
    assert found.file is not None
    assert found.design == stated(recipe).design
    assert stated(None, file).material == calibrated
    words = ("--recipe", str(recipe), "--material", str(file), "--bounces", "1", "--index", "1.6")
    part = answer(capsys, "optimise", *words)["optimum"]["part"]
    assert (part["tail"], part["alpha_across"], part["index"]) == (0.8, 0.11, 1.6)
    shown = answer(capsys, "research", "experiment", "--model", "corrected", "--material", str(file))
    assert shown["material"]["tail"] == 0.8
    recipe.write_text(TEXT.partition("[material]")[0].replace("product", 'material = "abs.toml"\nproduct', 1)
                      + "[poses]" + TEXT.partition("[poses]")[2], encoding="utf-8")  # fmt: skip
    with pytest.raises(
        UsageError, match=r"recipe\.toml names the material file abs\.toml itself: leave --material"
    ):
        stated(recipe, file)
