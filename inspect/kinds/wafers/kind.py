"""Etched wafers as a kind of part: their prediction from the diffraction orders of the tile, with its uncertainty."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cause_words import CauseWords
from anisoscope.decision.reference_parts import GoldenSet
from anisoscope.imaging.part_turn import check_follows
from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH, Measured
from anisoscope.imaging.predicted_cells import even_cells
from anisoscope.imaging.quality_gates import check_edges
from anisoscope.imaging.registration.placement import View
from anisoscope.imaging.views import clipped_at_white
from anisoscope.kinds.surface import SurfaceKind
from anisoscope.kinds.wafers.causes import WAFER_CAUSES, WAFER_WORDS
from anisoscope.kinds.wafers.etched import EtchedPredictor
from anisoscope.kinds.wafers.lighting import moved_light, recipe_wafer
from anisoscope.kinds.wafers.recipe import WaferRecipe, of_wafer, recognises
from anisoscope.kinds.wafers.states import (
    BEYOND,
    DEPTH,
    EDGES,
    SCATTER,
    WIDTH,
    WaferStates,
    edges_u_nm,
    width_step_nm,
)
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.prediction.expectation import Component, Expectation
from anisoscope.prediction.input_doubt import NEGLIGIBLE
from anisoscope.prediction.optics_selection import optics_for
from anisoscope.prediction.recipe_models import Models, optics_notes, optics_request_of, rig_of
from anisoscope.prediction.sensitivity import State, evaluate, fixed
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.sim.light.wave.choice import NUMERICAL_ERROR

DRAWN_UM = 64.0
"""Side of the drawn part of a wafer, µm."""


class WaferOptics:
    """The optics of etched wafers; a `prediction.expectation.SurfaceOptics`."""

    def models(self, recipe: SurfaceRecipe, poses: tuple[Pose, ...], convention: Convention) -> Models:
        """The diffraction orders of the tile.

        Raises:
            HeightMapError: the height map cannot be read, or is no surface of level steps.
            RecipeError: it is not the tile that repeats.
        """
        found, surface = recipe_wafer(of_wafer(recipe), convention.light_angle_deg)
        rig, request = rig_of(recipe, poses, convention), optics_request_of(recipe)
        notes = optics_notes(optics_for(surface, rig, request), rig, request)
        notes |= {
            "model": "wave",
            "stated_error": NUMERICAL_ERROR,
            "reason": f"{notes['reason']} (a mirror with steps: diffraction orders of the tile)",
        }
        points = int(DRAWN_UM / surface.pixel_x_um)
        drawn = surface.with_height(surface.height_um[:points, :points])
        return Models(found, fixed(found), drawn, "wave", notes, numerical=NUMERICAL_ERROR)

    def components(
        self,
        recipe: SurfaceRecipe,
        models: Models,
        radiance: FloatArray,
        nominal: State,
        convention: Convention,
    ) -> list[Component]:
        """Uncertainty from good etching and the stated lamp and lens; every source shared by all poses."""
        wafer, predictor = of_wafer(recipe), models.model
        assert isinstance(predictor, EtchedPredictor)
        assert wafer.light is not None
        poses, stated = wafer.poses.poses(), wafer.uncertainty
        cases = moved_light(wafer.light, predictor.light)
        pairs = [(name, predictor.under(low), predictor.under(high)) for name, low, high in cases]
        if (deep := stated.etch_depth_nm) > 0.0:
            pairs.append((DEPTH, predictor.with_depths(-deep), predictor.with_depths(deep)))
        if (wide := stated.etch_width_nm) > 0.0:
            pairs.append((WIDTH, predictor.with_widths(-wide), predictor.with_widths(wide)))
        if (edges := edges_u_nm(wafer, predictor, convention.light_angle_deg)) > 0.0:
            near = predictor.near_widths(width_step_nm(wafer))
            pairs += [
                (name, near(0.0, -edges * phase), near(0.0, edges * phase))
                for name, phase in zip(EDGES, (1.0, 1.0j), strict=True)
            ]
        found = []
        for name, below, above in pairs:
            low, high = (
                np.log(evaluate(fixed(end), [nominal], poses, convention)[0] / radiance)
                for end in (below, above)
            )
            found.append(Component(name, "prediction", 0.5 * (high - low), shared=True))
            bend = np.sqrt(3.0) * 0.5 * (high + low)  # root mean square of z² for a normal z
            if np.abs(bend).max() > NEGLIGIBLE:
                found.append(Component(f"{name}{BEYOND}", "prediction", bend, shared=True))
        return found

    def states(self, recipe: SurfaceRecipe, light_angle_deg: float) -> WaferStates:
        """The states of a wafer's recipe; they are computed on demand."""
        return WaferStates(of_wafer(recipe).deciding(), light_angle_deg)

    def omitted_if_zero(self, _source: str) -> bool:
        """All sources of plastics: a mirror has few of them."""
        return True

    def source_name(self, source: str) -> str:
        """A mirror scatters where a plastic has an albedo."""
        return source.replace("albedo of the plastic", SCATTER)


OPTICS = WaferOptics()


class WaferSet(GoldenSet):
    """The good wafers of one recipe: etching and seat vary between them, in the form of the budget."""

    predictive = False
    varies = (DEPTH, WIDTH, SCATTER, "seating tilt")


def tile_means(cells: FloatArray) -> FloatArray:
    """(P, tile rows, tile cols) mean radiance of every tile; the orders say nothing of a smaller area.

    Args:
        cells: (P, cell rows, cell cols) radiance of quarters of a tile, whole tiles both ways.
    """
    poses, rows, cols = cells.shape
    side = CELLS_PER_PITCH
    return np.asarray(cells.reshape(poses, rows // side, side, cols // side, side).mean(axis=(2, 4)))


def without_grain(cells: FloatArray) -> FloatArray:
    """Cells by the median of the cells at their place in all tiles; of one tile alone they are all 1.

    Args:
        cells: (P, cell rows, cell cols) radiance of quarters of a tile, whole tiles both ways.
    """
    poses, rows, cols = cells.shape
    side = CELLS_PER_PITCH
    tiles = np.maximum(cells, 1e-6).reshape(poses, rows // side, side, cols // side, side)
    return np.asarray((tiles / np.median(tiles, axis=(1, 3), keepdims=True)).reshape(cells.shape))


class Wafers(SurfaceKind[WaferRecipe]):
    """Mirrors with steps: their contrasts under rotation and tilt, predicted by waves.

    A tile that repeats is at no one place, and its grain is alike everywhere: nothing is matched or fitted.
    """

    name = "wafers"
    one = "a wafer"
    guides = (clipped_at_white,)
    optics = OPTICS
    causes = WAFER_CAUSES
    reference_set = WaferSet

    @property
    def cause_words(self) -> Mapping[str, CauseWords]:
        """The causes of wafers in plain words."""
        return WAFER_WORDS

    @property
    def recipe(self) -> type[WaferRecipe]:
        """The model of its recipe."""
        return WaferRecipe

    def as_recorded(self, recipe: WaferRecipe, recorded: Mapping[str, Any]) -> WaferRecipe:
        """As of all surfaces; a record that does not state ``step_edges_nm`` was judged without waves of the edges.

        One that states no sizes of defects was judged without their limits.
        """
        recipe = super().as_recorded(recipe, recorded)
        if "etch_depth_nm" not in recorded.get("defects", {}):
            unsized = recipe.defects.model_copy(update={"etch_depth_nm": None, "etch_width_nm": None})
            recipe = recipe.model_copy(update={"defects": unsized})
        if "step_edges_nm" in recorded.get("uncertainty", {}):
            return recipe
        stated = recipe.uncertainty.model_copy(update={"step_edges_nm": 0.0})
        return recipe.model_copy(update={"uncertainty": stated})

    def check_part(self, views: list[View], measured: Measured, recipe: SurfaceRecipe) -> tuple[str, ...]:
        """Check that the region does not leave the wafer, and that it follows its fixture; its tiles are alike."""
        stages_deg = [view.stage_deg for view in views]
        notes = check_edges(without_grain(measured.cells), measured.grid, recipe)
        return notes + check_follows(measured.aligned, stages_deg, recipe.limits.part_turn_deg)

    def predicted_cells(
        self, recipe: SurfaceRecipe, expected: Expectation, measured: Measured
    ) -> tuple[FloatArray, str]:
        """Predicted mean of each pose: the grain of a tile depends on where the tile is, which no mark says."""
        del recipe
        caption = (
            "the mean radiance of each pose, the same everywhere; the grain of the tiles is not predicted"
        )
        return even_cells(expected, measured), caption

    def comparable_means(self, measured: Measured) -> tuple[FloatArray, str]:
        """The mean of every tile, whose diffraction orders are predicted."""
        return tile_means(measured.cells), "the mean of every tile that repeats"

    def recognises(self, table: Mapping[str, Any]) -> bool:
        """A stated reflectance, whatever the angle, is that of a mirror."""
        return recognises(table)


WAFERS = Wafers()
