"""Recipes of whichever kind, read by their models alone: what predicts, measures and decides stays unloaded."""

from pathlib import Path
from typing import cast

from anisoscope.base.errors import ConfigError, RecipeError
from anisoscope.base.plugins import installed, load
from anisoscope.base.toml_table import read_toml
from anisoscope.recipe.base import RecipeBase

MODELS = "anisoscope.recipes"
"""Entry points of the models of recipes, by the kind that a recipe states; a kind without one reads its own."""


def read_any_recipe(path: Path | str) -> RecipeBase:
    """Read a recipe of whichever kind it is; ``${here}`` in it stands for its own folder.

    Raises:
        RecipeError: it cannot be read or used; the message names the file and the entry.
    """
    path = Path(path)
    try:
        stated = read_toml(path).get("kind")
    except ConfigError:  # its faults are named when the kind reads it
        stated = None
    if isinstance(stated, str) and stated in installed(MODELS):
        return cast("type[RecipeBase]", load(MODELS, stated, "recipe of the kind", RecipeError)).read(path)
    from anisoscope.kinds.registry import kind_of  # noqa: PLC0415 - loads all kinds, to ask which recognises it

    found: RecipeBase = kind_of(path).read_recipe(path)
    return found
