"""Plastic of a command: by its numbers, or by a material file."""

from pathlib import Path
from typing import TYPE_CHECKING

from anisoscope.parameters.material import Material

if TYPE_CHECKING:
    from anisoscope.recipe.material_file import MaterialFile


def plastic_of(material: Material | Path | str | None) -> "tuple[Material, MaterialFile | None]":
    """A plastic, and its material file where it is one's.

    Args:
        material: the plastic, or its file; None is that of the defaults.

    Raises:
        RecipeError: the file cannot be read.
    """
    if material is None or isinstance(material, Material):
        return material or Material(), None
    from anisoscope.recipe.material_file import read_material_file

    file = read_material_file(Path(material))
    return file.material.material(), file
