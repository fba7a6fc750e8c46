"""Teach the tolerances of a print's recipe by its golden prints; nothing is photographed, and nothing else changes.

Exposure, region and poses stay, so that the golden prints stay those of the recipe.
"""

from pathlib import Path
from typing import Any

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import UsageError
from anisoscope.decision.reference_parts import golden_path, limit_is_given
from anisoscope.kinds.prints.lighting import check_print_rig, expectation_of_print
from anisoscope.kinds.prints.recipe import PrintRecipe, read_print_recipe
from anisoscope.kinds.prints.reference_prints import GoldenPrints, read_golden_prints
from anisoscope.kinds.prints.tolerances import PASSING, golden_tolerances
from anisoscope.recipe.file_edits import with_values
from anisoscope.recipe.teaching import Change, Taught, previous_version_path
from anisoscope.rig.rigfile import read_rig


def teach_by_golden(recipe_path: Path, rig_path: Path, share: float = PASSING) -> Taught:
    """Write a new version of a print's recipe with tolerances learnt from its golden prints; the old one is saved.

    Args:
        recipe_path: recipe file.
        rig_path: rig file, for lamp, camera and angle of the light; no device is opened.
        share: of good prints that should pass all limits, 0 to 1.

    Raises:
        UsageError: the recipe is no print's, the share makes no sense, or there are too few golden prints.
        RecipeError, InkFileError, RigFileError, CalibrationError: a file that is missing or wrong.
        RecordError: a file cannot be written.
    """
    if not 0.5 <= share < 1.0:
        raise UsageError(f"--share must lie between 0.5 and 1, not {share:g}")
    recipe = read_print_recipe(recipe_path)
    rig = read_rig(rig_path)
    check_print_rig(rig, rig_path)
    golden = read_golden_prints(golden_path(recipe_path), recipe, rig)
    if golden is None or golden.lacking is not None:
        why = "there are none yet" if golden is None else golden.lacking
        raise UsageError(
            f"{recipe_path}: golden prints cannot teach it: {why}: add some with `anisoscope golden add`"
        )
    limits = golden_tolerances(golden, recipe, expectation_of_print(recipe, rig), share)
    values: dict[tuple[str, ...], Any] = {("version",): recipe.version + 1}
    values |= {("tolerances", key): one.value for key, one in limits.items()}
    previous, text = (
        previous_version_path(recipe_path, recipe.version),
        recipe_path.read_text(encoding="utf-8"),
    )
    new = with_values(text, values)
    write_text(previous, text)
    write_text(recipe_path, new)
    taught = read_print_recipe(recipe_path)
    changes = tuple(
        Change(f"tolerances.{key}", getattr(recipe.tolerances, key), getattr(taught.tolerances, key), one.why)
        for key, one in limits.items()
    )
    return Taught(taught.version, previous, None, changes, _notes(recipe, golden))


def _notes(recipe: PrintRecipe, golden: GoldenPrints) -> tuple[str, ...]:
    """Notes on the limit of the area, which is learnt at every inspection."""
    notes = []
    rule = recipe.area
    if rule is not None and limit_is_given(rule):
        notes.append(
            f"area.max_share stays {rule.max_share:g}, as the recipe says: leave it out, and it is learnt from golden "
            "prints"
        )
    elif rule is not None:
        limit = golden.area_limit(recipe)
        learnt = "golden prints tell no limit of the area yet" if limit is None else f"it is {limit:.2%} now"
        notes.append(f"the limit of the area is learnt at every inspection: {learnt}")
    if rule is not None and any(part.curl_deg is None for part in golden.parts):
        notes.append(
            "tolerances.curl_deg stays: golden prints that were added by earlier versions do not tell the curl"
        )
    return tuple(notes)
