"""Surface, plastic and orientation that a recipe states, for commands that take them as options too."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from anisoscope.base.errors import UsageError
from anisoscope.kinds.registry import kind_of
from anisoscope.kinds.surface import SurfaceKind
from anisoscope.operations.plastic import plastic_of
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign

if TYPE_CHECKING:
    from anisoscope.recipe.material_file import MaterialFile


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
        file: the material file that states the plastic; None without one.
    """

    material: Material = field(default_factory=Material)
    convention: Convention = field(default_factory=Convention)
    pitch_um: float | None = None
    design: RidgeDesign | None = None
    height_map: Path | None = None
    pixel_um: tuple[float, float] | None = None
    role: Literal["part", "tool"] = "part"
    file: "MaterialFile | None" = None


def surface_kind_of(recipe: Path) -> SurfaceKind[Any]:
    """The kind of a recipe of surfaces.

    Raises:
        UsageError: a recipe of another kind.
        RecipeError: it cannot be read.
    """
    kind = kind_of(recipe)
    if not isinstance(kind, SurfaceKind):
        raise UsageError(f"{recipe}: the recipe of {kind.one}; --recipe takes those of surfaces")
    return kind


def stated(recipe: Path | None, material: Path | None = None) -> Stated:
    """Surface, plastic and orientation of a recipe.

    Args:
        recipe: the file; None gives the defaults.
        material: a material file in place of the recipe's plastic.

    Raises:
        UsageError: a recipe of another kind than of surfaces, or one that names a material file itself.
        RecipeError: a file cannot be read.
    """
    plastic, file = plastic_of(material)
    if recipe is None:
        return Stated(plastic, file=file)
    found = surface_kind_of(recipe).read_recipe(recipe)
    own = found.material.file
    if file is not None and own is not None:
        raise UsageError(f"{recipe} names the material file {Path(own).name} itself: leave --material out")
    part, by_map = found.surface, found.surface.decides == "height_map"
    return Stated(
        found.material.material() if file is None else plastic,
        Convention(facet_azimuth_deg=found.poses.facet_azimuth_deg),
        part.pitch_um,
        None if by_map else part.ridge_design(),
        Path(part.height_map) if by_map and part.height_map is not None else None,
        part.pixel_um,
        part.role,
        file,
    )
