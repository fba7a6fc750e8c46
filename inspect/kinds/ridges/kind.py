"""Plastic parts with ridges as a kind of part."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast
from weakref import WeakKeyDictionary

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import AnisoscopeError
from anisoscope.base.progress import Advance
from anisoscope.diagnosis.shape_fit import fit_shape
from anisoscope.imaging.angle_map import AngleMap, angle_map
from anisoscope.imaging.facet_fit import planned_worth
from anisoscope.imaging.height_map_place import match_map
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.predicted_cells import predicted_cells
from anisoscope.imaging.quality_gates import check_part
from anisoscope.imaging.registration.placement import View
from anisoscope.kinds.parts import Beginning
from anisoscope.kinds.recipe_check import RecipeCheck
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.kinds.surface import SurfaceKind
from anisoscope.parameters.new_recipe import NewRecipe
from anisoscope.prediction.expectation import Expectation
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.record.schema import MapPlaceRecord, ShapeRecord
from anisoscope.rig.rigfile import RigFile

if TYPE_CHECKING:
    from anisoscope.kinds.surface_check import SurfaceCheck


class Ridges(SurfaceKind[RidgeRecipe], Beginning):
    """Ridges: their contrasts under rotation, and the cells of their contrast map."""

    name = "ridges"
    one = "a part with ridges"
    fallback = True

    def __init__(self) -> None:
        self._facets: WeakKeyDictionary[Measured, AngleMap | AnisoscopeError] = WeakKeyDictionary()

    @property
    def recipe(self) -> type[RidgeRecipe]:
        """The model of its recipe."""
        return RidgeRecipe

    def new_recipe(self, out: Path, requested: NewRecipe) -> str:
        """Write the recipe of ridges."""
        from anisoscope.kinds.ridges.recipe import write_new_recipe

        write_new_recipe(out, requested)
        return "[material] and [region]"

    def check_part(self, views: list[View], measured: Measured, recipe: SurfaceRecipe) -> tuple[str, ...]:
        """Check pitch and direction of the ridges, and that nothing hides them."""
        return check_part(views, measured, recipe)

    def fit_shape(
        self, recipe: SurfaceRecipe, expected: Expectation, measured: Measured
    ) -> tuple[ShapeRecord | None, str | None]:
        """Ideal ridges fitted over the tilts."""
        return fit_shape(recipe, expected, measured)

    def facets(
        self, recipe: SurfaceRecipe, expected: Expectation, measured: Measured
    ) -> AngleMap | AnisoscopeError | None:
        """Lean of the facets, computed once a measurement."""
        if measured not in self._facets:
            try:
                far = None if expected.lamp is None else expected.lamp.distance_mm
                self._facets[measured] = angle_map(recipe, expected, measured).under_lamp(far)
            except AnisoscopeError as problem:
                self._facets[measured] = problem
        return self._facets[measured]

    def capability(
        self,
        recipe: RidgeRecipe,
        rig: RigFile | None,
        light_angle_deg: float,
        tries: Sequence[float],
        advance: Advance,
    ) -> RecipeCheck:
        """Check the recipe as that of a surface, and the worth of its angle map."""
        found = super().capability(recipe, rig, light_angle_deg, tries, advance)
        try:
            says = planned_worth(recipe, self._predict(cached=True)(recipe, light_angle_deg))
        except AnisoscopeError as problem:
            says = f"no angle map: {problem}"
        return replace(cast("SurfaceCheck", found), angles=says)

    def predicted_cells(
        self, recipe: SurfaceRecipe, expected: Expectation, measured: Measured
    ) -> tuple[FloatArray, str]:
        """Predicted radiance of every cell, which follows the flanks of the ridges."""
        return predicted_cells(recipe, expected, measured)

    def match_map(
        self, recipe: SurfaceRecipe, expected: Expectation, measured: Measured
    ) -> tuple[MapPlaceRecord | None, str | None]:
        """Position of the height map on the part."""
        return match_map(recipe, expected, measured)


RIDGES = Ridges()
