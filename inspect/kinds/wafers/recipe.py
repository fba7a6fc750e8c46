"""The recipe of an etched wafer: a mirror with steps, and the lamp and lens that decide what it shows."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.base.quantity import Likely
from anisoscope.base.toml_edits import toml_literal
from anisoscope.base.toml_file import NotNegative, Positive, Share, length
from anisoscope.parameters.new_recipe import NewRecipe
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.named_defect import NamedDefect
from anisoscope.recipe.surface import (
    DefectsPart,
    MaterialPart,
    RigUncertainty,
    ScatterPart,
    SurfaceRecipe,
)

Depth = Annotated[NotNegative, length(Likely(0.001, 1e4, "etch depths", firm=True))]
Width = Annotated[NotNegative, length(Likely(0.01, 1e5, "features", firm=True))]


class WaferMaterial(MaterialPart):
    """A mirror, such as a coated wafer, with the standard uncertainty of the light that it scatters.

    Of the light that falls on it the share ``reflectance`` is reflected, whatever the angle, and the share ``albedo``
    of that is scattered everywhere. Where nothing else is said it is polished, and scatters nothing; what is uncertain
    of a plastic is of no account.
    """

    alpha_along: Positive = 0.001
    alpha_across: Positive = 0.001
    albedo: Share = 0.0
    u_alpha_share: Share = 0.0
    u_albedo: NotNegative = 0.0
    u_index: NotNegative = 0.0
    u_tail: NotNegative = 0.0
    reflectance: Annotated[float, Field(gt=0.0, le=1.0)]


class WaferUncertainty(RigUncertainty):
    """Standard uncertainties of the rig, of good wafers (``etch_…``: depth of the passes, width of features), of waves.

    ``step_edges_nm``: of the widening that stands for what scalar waves neglect at the edges of steps; by default from
    rigorous waves of aluminium.
    """

    etch_depth_nm: Depth = 1.0
    etch_width_nm: Width = 20.0
    step_edges_nm: Width | None = None


class WaferDefects(DefectsPart):
    """Smallest interesting sizes of the defects of a wafer; None tests for none. Those of ridges are of no account.

    ``etch_depth_nm``: all passes too deep or too shallow; ``etch_width_nm``: features too wide or too narrow;
    ``marked_share``: of the area in cells that differ from those at their place in the other tiles.
    """

    etch_depth_nm: Annotated[Depth, Field(gt=0.0)] | None = 15.0
    etch_width_nm: Annotated[Width, Field(gt=0.0)] | None = 500.0
    marked_share: Annotated[float, Field(gt=0.0, lt=1.0)] | None = 0.005

    @property
    def of_wafers(self) -> tuple[NamedDefect, ...]:
        """The defects that are tested, each direction by itself."""
        sizes = (
            (("etched too deep by ", "etched too shallow by "), self.etch_depth_nm),
            (("features too wide by ", "features too narrow by "), self.etch_width_nm),
        )
        return tuple(
            NamedDefect(words, size, " nm") for both, size in sizes if size is not None for words in both
        )


class WaferRecipe(SurfaceRecipe):
    """The recipe of a wafer, as read from its TOML file.

    ``surface.pitch_um`` is the side of the tile that repeats, and ``surface.height_map`` is that tile.
    """

    material: WaferMaterial
    uncertainty: WaferUncertainty = WaferUncertainty()
    defects: WaferDefects = WaferDefects()

    @model_validator(mode="after")
    def _can_be_predicted(self) -> Self:
        self._check_span(1.0, "at least one tile")
        if self.area is not None:
            raise ValueError(
                "area compares cells along the flanks of ridges: leave [area] out for a wafer (material.reflectance)"
            )
        if self.surface.height_map is None or self.surface.design is not None:
            raise ValueError(
                "surface: a wafer (material.reflectance) is compared with a height_map of the tile that repeats on it; "
                "`anisoscope design height` makes one of a design, a layout or a mask"
            )
        ridges = DefectsPart.model_fields
        for table, given, usual in (
            ("scatter", self.scatter, ScatterPart()),
            *((f"defects.{name}", getattr(self.defects, name), one.default) for name, one in ridges.items()),
            ("surface.reflections", self.surface.reflections, "all"),
            ("surface.roughness", self.surface.roughness, "lobe"),
            ("poses.stage_and_tilt_deg", self.poses.stage_and_tilt_deg, None),
        ):
            if given not in (usual, None):
                raise ValueError(
                    f"{table} belongs to ridges: leave it out for a wafer (material.reflectance)"
                )
        if self.surface.optics == "geometric":
            raise ValueError(
                'surface.optics: rays know nothing of level steps; take "auto" or "wave" for a wafer'
            )
        if (
            self.light is None
            or not max(self.light.lamp_half_angle_deg, self.light.aperture_half_angle_deg) > 0.0
        ):
            raise ValueError(
                "light: what a wafer shows depends on lamp and lens: give lamp_half_angle_deg and "
                "aperture_half_angle_deg, and wavelength_nm"
            )
        return self


def of_wafer(recipe: SurfaceRecipe) -> WaferRecipe:
    """The recipe, which is that of a wafer: the pipeline hands a kind its own recipes only."""
    assert isinstance(recipe, WaferRecipe)
    return recipe


def recognises(table: Mapping[str, Any]) -> bool:
    """Is this the table of a wafer's recipe? What is reflected, whatever the angle, only a mirror states."""
    material = table.get("material")
    return isinstance(material, Mapping) and material.get("reflectance") is not None


_TEMPLATE = """\
schema = 1
product = {product}

[surface]
height_map = {tile}   # the tile that repeats, whole and square
pitch_um = {side_um:g}   # its side

[material]
reflectance = 0.9      # this makes it a mirror
albedo = 0.001         # share of the reflected light that is scattered everywhere
u_albedo = 0.0003

[light]                # lamp and lens as the wafer sees them
wavelength_nm = 520.0
bandwidth_nm = 10.0
lamp_half_angle_deg = 0.3
aperture_half_angle_deg = 0.7

[poses]
angles_deg = [0.0, 90.0, 180.0]
tilts_deg = [0.0, 3.0]

[acquisition]
exposure_s = 2.5e-5
brackets = [12.0, 160.0]   # a mirror is a hundred times as bright as the markers

[region]               # five tiles or more are compared with each other
size_mm = [{region_mm:.6g}, {region_mm:.6g}]

[decision]
deviation = "fail"
unexcluded = "inconclusive"

[uncertainty]
seating_tilt_deg = 0.05
light_angle_deg = 0.05
tilt_deg = 0.02
etch_depth_nm = 1.0    # of good wafers
etch_width_nm = 20.0
"""
_LARGEST_MM = 2.0
LAYOUT = "header.npy"
"""Array of a layout by which a reader of height maps fails."""


def write_new_recipe(out: Path, requested: NewRecipe) -> None:
    """Write the recipe of a wafer, valid as written; the path of its tile is relative to the recipe.

    Raises:
        UsageError: no tile was named, or options of other kinds were.
        HeightMapError: the tile cannot be read.
    """
    if (requested.ridge_angle_deg, requested.u_ridge_angle_deg, requested.ink) != (None, None, None):
        raise UsageError(
            "--kind wafers takes the tile alone: leave --ridge-angle, --u-ridge-angle and --ink out"
        )
    if requested.height_map is None:
        raise UsageError(
            "the recipe of a wafer needs its tile: give --height-map (`anisoscope design height` makes one)"
        )
    side_um = max(read_tile(requested.height_map).extent_um)
    largest_um = 1000.0 * min(_LARGEST_MM, requested.largest_mm or _LARGEST_MM)
    tile = Path(os.path.relpath(requested.height_map.resolve(), out.resolve().parent)).as_posix()
    text = _TEMPLATE.format(
        product=toml_literal(requested.product or "wafer"),
        tile=toml_literal(tile),
        side_um=side_um,
        region_mm=1e-3 * side_um * max(1, int(largest_um / side_um)),
    )
    write_text(out, text)
    try:
        WaferRecipe.read(out)
    except BaseException:
        out.unlink()
        raise


def read_tile(path: Path, pixel_um: tuple[float, float] | None = None, role: str = "part") -> HeightMap:
    """The height map of a tile; arguments as of `read_height_map`.

    Raises:
        HeightMapError: it cannot be read, or is a design, a layout or a mask.
    """
    try:
        return read_height_map(path, pixel_um=pixel_um, role=role)
    except HeightMapError as problem:
        if path.is_file() and (path.suffix.lower() in {".toml", ".gds"} or LAYOUT in str(problem)):
            raise HeightMapError(
                f"{path} is no height map: of a design, a layout or a mask make the tile with "
                f"`anisoscope design height {path.name} --out tile.npz`"
            ) from problem
        raise
