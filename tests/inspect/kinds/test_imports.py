"""What the kinds of parts load: all of them, to find the one that a recipe is of."""

import subprocess
import sys

from anisoscope.base.plugins import installed
from anisoscope.kinds.recipes import MODELS, read_any_recipe
from anisoscope.kinds.registry import kind_named, kind_names
from anisoscope.kinds.ridges.recipe import write_new_recipe
from anisoscope.parameters.new_recipe import NewRecipe
from anisoscope.record.details import GROUP

ASKED = NewRecipe(product="part", ridge_angle_deg=10.0)
HEAVY = ("numba", "scipy", "matplotlib", "pyvista", "skimage", "zxingcpp", "PIL")

OF_A_KIND = (*HEAVY, "cv2", "sqlalchemy", "tifffile", "anisoscope.kinds.kind")


def test_importing_all_kinds_loads_no_library_that_is_slow_to_import():
    modules = ", ".join(entry.module for entry in installed(GROUP).values())
    script = f"import sys, {modules}\nprint([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_kind_of_ours_has_its_recipe_readable_alone():
    models = {name: entry.load() for name, entry in installed(MODELS).items()}
    assert models == {name: kind_named(name).recipe for name in kind_names()}


def test_reading_a_recipe_loads_neither_its_kind_nor_what_measures(tmp_path):
    path = tmp_path / "recipe.toml"
    write_new_recipe(path, ASKED)
    script = f"""import sys
from pathlib import Path
from anisoscope.kinds.recipes import read_any_recipe
assert read_any_recipe(Path({str(path)!r})).kind == "ridges"
print([name for name in {OF_A_KIND!r} if name in sys.modules])"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_recipe_that_states_no_kind_is_read_by_the_kind_that_recognises_it(tmp_path):
    path = tmp_path / "recipe.toml"
    write_new_recipe(path, ASKED)
    stated = read_any_recipe(path)
    path.write_text(path.read_text().replace('kind = "ridges"\n', ""))
    assert read_any_recipe(path) == stated.model_copy(update={"kind": None})
