"""Which kind of part a recipe file is of, and the recipe itself."""

import tomllib
from pathlib import Path
from typing import Any

from anisoscope.base.errors import RecipeError
from anisoscope.kinds.prints.recipe import AnyRecipe, read_print_recipe
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.kinds.wafers import recipe as wafers
from anisoscope.recipe.base import is_print
from anisoscope.recipe.surface import SurfaceRecipe, read_surface_recipe


def read_recipe(path: Path) -> SurfaceRecipe:
    """Read the recipe of a part with a surface.

    Raises:
        RecipeError: the file is missing or wrong, or the recipe of a print; the message names file, key and what is
            expected.
    """
    if is_print(path):
        raise RecipeError(f"{path}: the recipe of a print; this works with recipes of surfaces only")
    return (
        wafers.read_wafer_recipe(path)
        if wafers.recognises(_table(path))
        else read_surface_recipe(path, RidgeRecipe)
    )


def read_any_recipe(path: Path) -> AnyRecipe:
    """Read the recipe of a part with a surface, or of a print, whichever it is.

    Raises:
        RecipeError, InkFileError: as for `read_recipe` and `read_print_recipe`.
    """
    return read_print_recipe(path) if is_print(path) else read_recipe(path)


def _table(path: Path) -> dict[str, Any]:
    """What is in the file; what is wrong with it shows when the recipe is read."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError):
        return {}
