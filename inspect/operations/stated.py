"""Surface, plastic and orientation that a recipe states, for commands that take them as options too."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from anisoscope.base.errors import UsageError
from anisoscope.kinds.registry import kind_of
from anisoscope.kinds.surface import SurfaceKind
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign


@dataclass(frozen=True)
class Stated:
    """What a recipe says of its part; without a recipe the defaults of the models.

    Attributes:
        material: the plastic.
        convention: with the azimuth of the facets.
        pitch_um: distance of the crests; None without a recipe.
        design: ideal ridges; None where a height map decides.
        height_map: file that decides; None where a design does.
        pixel_um: (y, x) pixel size of the file, if it states none.
        role: whether the map is the part's or the tool's.
    """

    material: Material = field(default_factory=Material)
    convention: Convention = field(default_factory=Convention)
    pitch_um: float | None = None
    design: RidgeDesign | None = None
    height_map: Path | None = None
    pixel_um: tuple[float, float] | None = None
    role: Literal["part", "tool"] = "part"


def stated(recipe: Path | None) -> Stated:
    """Surface, plastic and orientation of a recipe.

    Args:
        recipe: the file; None gives the defaults.

    Raises:
        UsageError: a recipe of another kind than of surfaces.
        RecipeError: it cannot be read.
    """
    if recipe is None:
        return Stated()
    kind = kind_of(recipe)
    if not isinstance(kind, SurfaceKind):
        raise UsageError(f"{recipe}: the recipe of {kind.one}; --recipe takes those of surfaces")
    found = kind.read_recipe(recipe)
    part, by_map = found.surface, found.surface.decides == "height_map"
    return Stated(
        found.material.material(),
        Convention(facet_azimuth_deg=found.poses.facet_azimuth_deg),
        part.pitch_um,
        None if by_map else part.ridge_design(),
        Path(part.height_map) if by_map and part.height_map is not None else None,
        part.pixel_um,
        part.role,
    )
