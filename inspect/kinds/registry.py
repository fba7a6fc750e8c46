"""Kinds of parts by name. Entry points name them, so that a third party's kind registers like a built-in one."""

from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from anisoscope.base.errors import CalibrationError, ConfigError, RecipeError, RecordError, UsageError
from anisoscope.base.plugins import installed
from anisoscope.base.toml_table import read_toml
from anisoscope.decision.reference_parts import golden_path, write_golden
from anisoscope.kinds.kind import AnyKind, Kind
from anisoscope.kinds.parts import Beginning, collecting
from anisoscope.parameters.new_recipe import NewRecipe
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.record.details import GROUP, kind_of_recipe, recorded_kind
from anisoscope.record.schema import read_record
from anisoscope.rig.rigfile import RigFile


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
    """The kind whose recipe is to be written: the named one, or else the one that claims the options.

    Kinds that do not load are left out, unless one of them is named.

    Raises:
        UsageError: no kind has this name, or the options are for another kind.
        RecipeError: none of those that load takes these options, or the named one does not load.
    """
    name = requested.kind
    if name is not None and name not in kind_names():
        near = get_close_matches(name, kind_names(), 1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise UsageError(f"there is no kind of part '{name}'; installed: {', '.join(kind_names())}{hint}")
    named = None if name is None else kind_named(name)
    kinds, problems = [], []
    for each in kind_names():
        try:
            kinds.append(kind_named(each))
        except RecipeError as problem:
            problems.append(str(problem))
    claiming: list[AnyKind] = [
        kind for kind in kinds if isinstance(kind, Beginning) and kind.makes(requested)
    ]
    if named is not None:
        if claiming and named not in claiming:
            raise UsageError(f"--kind {name}: the other options are for the recipe of {claiming[0].one}")
        return named
    chosen = claiming or [kind for kind in kinds if kind.fallback]
    if not chosen:
        raise RecipeError("; ".join(["no kind of part is installed that writes this recipe", *problems]))
    return chosen[0]


def add_golden(
    recipe: Path, folders: Sequence[Path], *, unlabelled_on: RigFile | None = None
) -> tuple[Any, list[str], list[str]]:
    """Add inspected parts to the golden parts of a recipe, all of them or none.

    Args:
        recipe: recipe file.
        folders: finished inspections.
        unlabelled_on: the rig of parts of unknown quality, of which those that deviate from the others are left out.

    Returns:
        The golden parts, the serial numbers of added parts whose verdict was FAIL, and those of parts left out.

    Raises:
        CalibrationError: a part of another kind, or one that does not fit the others; too few parts, or a kind whose
            recipes state no scatter, for parts of unknown quality.
        RecordError: a folder holds no finished inspection.
    """
    kind, path = kind_of(recipe), golden_path(recipe)
    rules, failed = kind.read_recipe(recipe), []
    collects = collecting(kind, rules)
    known: Any = collects.read_reference(path, rules)
    for folder in folders:
        record = read_record(folder)
        if record.verdict == "FAIL":
            failed.append(record.serial)
        if record.kind != kind.name:
            raise CalibrationError(
                f"{record.serial} was inspected as a part of the kind '{record.kind}', and {recipe} is a recipe of the "
                f"kind '{kind.name}': add it with the recipe by which it was inspected"
            )
        known = collects.add_reference(known, rules, record)
    assert known is not None
    left_out: list[str] = []
    if unlabelled_on is not None:
        added = {(record.serial, record.created_at) for record in map(read_record, folders)}
        known, left_out = collects.without_odd_parts(known, rules, added, unlabelled_on)
    write_golden(path, known)
    return known, [serial for serial in failed if serial not in left_out], left_out


def _table(path: Path) -> dict[str, Any]:
    """Table of the file; faults of it are named when the recipe is read."""
    try:
        return read_toml(path)
    except ConfigError:
        return {}
