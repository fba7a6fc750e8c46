"""Kinds of parts by name. Entry points name them, so that a third party's kind registers like a built-in one."""

import tomllib
from pathlib import Path
from typing import Any

from anisoscope.base.errors import RecipeError, RecordError
from anisoscope.base.plugins import installed
from anisoscope.kinds.kind import AnyKind, Kind, NewRecipe
from anisoscope.recipe.base import RecipeBase
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.record.details import GROUP, kind_of_recipe, recorded_kind


def kind_names() -> tuple[str, ...]:
    """Names of the kinds that are installed."""
    return tuple(installed(GROUP))


def kind_named(name: str) -> AnyKind:
    """The kind of a name.

    Raises:
        RecipeError: none is installed under this name, or it does not load.
    """
    try:
        found = recorded_kind(name)
    except RecordError as problem:
        raise RecipeError(str(problem)) from problem
    if not isinstance(found, Kind):
        raise RecipeError(
            f"the kind of part '{name}' does not load: {found!r} is not an object of a class of Kind"
        )
    return found


def kind_of(path: Path) -> AnyKind:
    """The kind that a recipe file is of.

    Raises:
        RecipeError: it names one that is not installed, or does not load.
    """
    try:
        return kind_named(kind_of_recipe(_table(path)))
    except (RecipeError, RecordError) as problem:
        raise RecipeError(f"{path}: kind: {problem}") from problem


def read_any_recipe(path: Path) -> RecipeBase:
    """Read a recipe of whichever kind it is; errors as for `Kind.read_recipe`."""
    recipe: RecipeBase = kind_of(path).read_recipe(path)
    return recipe


def read_recipe(path: Path) -> SurfaceRecipe:
    """Read the recipe of a part with a surface.

    Raises:
        RecipeError: the file is missing or wrong, or the recipe of another kind of part; the message names file, key
            and what is expected.
    """
    kind = kind_of(path)
    if not issubclass(kind.recipe, SurfaceRecipe):
        raise RecipeError(f"{path}: the recipe of {kind.one}; this works with recipes of surfaces only")
    recipe: SurfaceRecipe = kind.read_recipe(path)
    return recipe


def kind_of_new(requested: NewRecipe) -> AnyKind:
    """The kind whose recipe is to be written; kinds that do not load are left out.

    Raises:
        RecipeError: none of those that load takes these options.
    """
    kinds, problems = [], []
    for name in kind_names():
        try:
            kinds.append(kind_named(name))
        except RecipeError as problem:
            problems.append(str(problem))
    chosen = [kind for kind in kinds if kind.makes(requested)] or [kind for kind in kinds if kind.fallback]
    if not chosen:
        raise RecipeError("; ".join(["no kind of part is installed that writes this recipe", *problems]))
    return chosen[0]


def _table(path: Path) -> dict[str, Any]:
    """What is in the file; what is wrong with it shows when the recipe is read."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError):
        return {}
