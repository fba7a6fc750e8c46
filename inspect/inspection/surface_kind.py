"""What differs between kinds of surfaces in an inspection: optics, causes, gates, and what is looked at besides."""

from collections.abc import Callable
from dataclasses import dataclass

from anisoscope.diagnosis.cause_model import PLASTIC_CAUSES, CauseModel
from anisoscope.diagnosis.shape_fit import fit_shape
from anisoscope.imaging.height_map_place import match_map
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.quality_gates import check_part
from anisoscope.imaging.registration.placement import View
from anisoscope.imaging.views import Guide, beside_a_mirror
from anisoscope.kinds.wafers.discriminating_poses import WAFER_CAUSES
from anisoscope.kinds.wafers.optics import WAFERS as WAFER_OPTICS
from anisoscope.kinds.wafers.recipe import WaferRecipe
from anisoscope.prediction.expectation import PLASTIC, Expectation, SurfaceOptics
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.record.schema import MapPlaceRecord, ShapeRecord


@dataclass(frozen=True)
class SurfaceKind:
    """What an inspection does its own way for one kind of surface.

    Attributes:
        optics: how it is predicted.
        causes: what may be wrong with it.
        guides: what is done to a picture before markers are searched in it.
        check_part: gates of the aligned pictures.
        match_map: finds where the height map lies on the part.
        fit_shape: fits the shape over the tilts.
    """

    optics: SurfaceOptics
    causes: CauseModel
    guides: tuple[Guide, ...]
    check_part: Callable[[list[View], Measured, SurfaceRecipe], None]
    match_map: Callable[[SurfaceRecipe, Expectation, Measured], tuple[MapPlaceRecord | None, str | None]]
    fit_shape: Callable[[SurfaceRecipe, Expectation, Measured], tuple[ShapeRecord | None, str | None]]


def _nothing(_recipe: SurfaceRecipe, _expected: Expectation, _measured: Measured) -> tuple[None, None]:
    """A tile that repeats is at no one place, and has no ridges whose shape could be fitted."""
    return None, None


def _no_gates(_views: list[View], _measured: Measured, _recipe: SurfaceRecipe) -> None:
    """There are no ridges, and the grain of a tile is alike wherever the tile repeats."""


RIDGES = SurfaceKind(PLASTIC, PLASTIC_CAUSES, (), check_part, match_map, fit_shape)
WAFERS = SurfaceKind(WAFER_OPTICS, WAFER_CAUSES, (beside_a_mirror,), _no_gates, _nothing, _nothing)


def surface_kind(recipe: SurfaceRecipe) -> SurfaceKind:
    """The kind of surface that a recipe is of."""
    return WAFERS if isinstance(recipe, WaferRecipe) else RIDGES
