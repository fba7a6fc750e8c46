"""Etched wafers as a kind of part: their prediction from the diffraction orders of the tile, with its uncertainty."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cause_words import CauseWords
from anisoscope.base.progress import Advance, silent
from anisoscope.decision.decision import Decision
from anisoscope.decision.reference_parts import GoldenSet
from anisoscope.imaging.defect_regions import find_regions
from anisoscope.imaging.deviation_map import (
    LEAST_SCATTER,
    MOST_LOG,
    CellMap,
    judge_area,
)
from anisoscope.imaging.part_turn import check_follows
from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH, Measured
from anisoscope.imaging.predicted_cells import even_cells
from anisoscope.imaging.quality_gates import check_edges
from anisoscope.imaging.registration.placement import View
from anisoscope.imaging.views import clipped_at_white
from anisoscope.kinds.kind import Explanation, Sitting
from anisoscope.kinds.parts import Beginning, Reference
from anisoscope.kinds.surface import SurfaceKind
from anisoscope.kinds.wafers.causes import WAFER_CAUSES, WAFER_WORDS
from anisoscope.kinds.wafers.etched import EtchedPredictor
from anisoscope.kinds.wafers.lighting import moved_light, recipe_wafer
from anisoscope.kinds.wafers.recipe import WaferRecipe, of_wafer, recognises, write_new_recipe
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
from anisoscope.parameters.new_recipe import NewRecipe
from anisoscope.prediction.expectation import Component, Expectation
from anisoscope.prediction.input_doubt import NEGLIGIBLE
from anisoscope.prediction.optics_selection import optics_for
from anisoscope.prediction.recipe_models import Models, optics_notes, optics_request_of, rig_of
from anisoscope.prediction.sensitivity import State, evaluate, fixed
from anisoscope.recipe.surface import AreaPart, SurfaceRecipe
from anisoscope.record.schema import AreaRecord, DiagnosisRecord, RegionRecord
from anisoscope.record.verdict import Verdict
from anisoscope.sim.light.contrasts import consecutive_pairs
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


LEAST_TILES = 5
"""Tiles from which on their median is that of good ones, though two of them are marked at the same place."""
BY_CHANCE = 1e-5
"""Probability of a cell with the stated least scatter to exceed the limit."""
SCATTERS = 5.0
"""By how many (median − 16 % quantile) of the cells the score of a cell, ln(1 + D²), may be above their median."""
LEAST_SPREAD = 0.02  # of these
LIMIT_ERROR = 6.5
"""Standard error of the limit of the scores, in their spread over the root of their number."""
_TREND_ROUNDS = 3


def die_to_die(measured: Measured, poses: tuple[Pose, ...]) -> CellMap | None:
    """How the cells differ from those at their place in the other tiles; None where the tiles are too few.

    A cell deviates where it is far above all others, and by more than chance makes of the least scatter: pictures with
    little noise have outliers that are no marks.

    No prediction takes part. What changes evenly across the region, as of lamp and flat, is no deviation.

    Args:
        measured: the wafer, whose cells are quarters of a tile.
        poses: of the recipe.
    """
    from scipy.special import chdtri

    count, rows, cols = measured.cells.shape
    if rows * cols < LEAST_TILES * CELLS_PER_PITCH**2:
        return None
    off = np.clip(np.log(without_grain(measured.cells)), -MOST_LOG, MOST_LOG).reshape(count, -1)
    y, x = (one.ravel() for one in np.mgrid[-1.0 : 1.0 : rows * 1j, -1.0 : 1.0 : cols * 1j])
    plane, scatter = np.stack([np.ones(rows * cols), x, y], axis=1), np.zeros((count, 1))
    trend = np.zeros_like(off)
    for _ in range(_TREND_ROUNDS):
        rest = np.abs(off - trend)
        scatter = np.maximum(1.4826 * np.median(rest, axis=1), LEAST_SCATTER)[:, None]
        near = rest < 3.0 * scatter
        trend = np.array(
            [plane @ np.linalg.lstsq(plane[k], one[k])[0] for k, one in zip(near, off, strict=True)]
        )
    left = np.reshape(off - trend, measured.cells.shape)
    score = np.log1p(np.sum((left / scatter[..., None]) ** 2, axis=0))
    middle, low = np.quantile(score, [0.5, 0.16])
    spread = max(float(middle - low), LEAST_SPREAD)
    least = float(np.log1p(chdtri(count, BY_CHANCE)))
    limit, pairs = max(float(middle) + SCATTERS * spread, least), consecutive_pairs(poses)
    widths = np.sqrt(np.expm1(limit)) * scatter[:, 0]
    return CellMap(
        score,
        limit,
        np.stack([left[i] - left[j] for i, j in pairs]),
        np.array([float(np.hypot(widths[i], widths[j])) for i, j in pairs]),
        spread * LIMIT_ERROR / np.sqrt(score.size),
    )


Local = tuple[AreaRecord, tuple[RegionRecord, ...], CellMap, npt.NDArray[np.bool_]]


def local_decision(
    measured: Measured, poses: tuple[Pose, ...], marked_share: float, coverage: float
) -> Local | None:
    """Area of the cells that are unlike those of the other tiles, its regions, the map, and where; None of few tiles.

    Args:
        measured: the wafer.
        poses: of the recipe.
        marked_share: largest share of the area; a single cell is never more than the limit.
        coverage: guard band by the standard uncertainty of the share.
    """
    cells = die_to_die(measured, poses)
    if cells is None:
        return None
    rule = AreaPart(max_share=max(marked_share, 1.0 / cells.score.size))
    area, over = judge_area(measured, cells, rule, coverage)
    assert area is not None
    assert over is not None
    return area, find_regions(cells, measured.grid), cells, over


def _with_local(decided: Decision, local: Local) -> Decision:
    """The decision with what the tiles say of each other; FAIL goes before INCONCLUSIVE."""
    area, regions, cells, over = local
    line = f"{area.share:.1%} of the area differs from the same place of the other tiles (limit {area.max_share:.1%})"
    order = (Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.PASS)
    verdict = min(decided.verdict, area.verdict, key=order.index)
    own = decided.reasons if decided.verdict is verdict else ()
    reasons = (line, *own) if area.verdict is verdict is not Verdict.PASS else own
    return replace(
        decided, verdict=verdict, reasons=reasons, area=area, regions=regions, cells=cells, deviating=over
    )


def _by_means(recipe: WaferRecipe, decided: Decision) -> tuple[WaferRecipe, Decision]:
    """Recipe and decision for the diagnosis: without places, and without faults of the rig where marks fail."""
    if decided.area is not None and decided.area.verdict is Verdict.FAIL:
        rule = recipe.decision.model_copy(update={"rig_faults": False})
        recipe = recipe.model_copy(update={"decision": rule})
    return recipe, replace(decided, area=None, deviating=None)


class Wafers(SurfaceKind[WaferRecipe], Beginning):
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

    def new_recipe(self, out: Path, requested: NewRecipe) -> str:
        """Write the recipe of a wafer about its tile."""
        write_new_recipe(out, requested)
        return "[light], [material] and [region]"

    def as_recorded(self, recipe: WaferRecipe, recorded: Mapping[str, Any]) -> WaferRecipe:
        """As of all surfaces; a record that does not state ``step_edges_nm`` was judged without waves of the edges.

        One that states no sizes of defects was judged without their limits, and without its tiles among each other.
        """
        recipe = super().as_recorded(recipe, recorded)
        if "etch_depth_nm" not in recorded.get("defects", {}):
            unsized = recipe.defects.model_copy(update={"etch_depth_nm": None, "etch_width_nm": None})
            recipe = recipe.model_copy(update={"defects": unsized})
        if "marked_share" not in recorded.get("defects", {}):
            unmarked = recipe.defects.model_copy(update={"marked_share": None})
            recipe = recipe.model_copy(update={"defects": unmarked})
        if "step_edges_nm" in recorded.get("uncertainty", {}):
            return recipe
        stated = recipe.uncertainty.model_copy(update={"step_edges_nm": 0.0})
        return recipe.model_copy(update={"uncertainty": stated})

    def check_part(self, views: list[View], measured: Measured, recipe: SurfaceRecipe) -> tuple[str, ...]:
        """Check that the region does not leave the wafer, and that it follows its fixture; its tiles are alike."""
        stages_deg = [view.stage_deg for view in views]
        notes = check_edges(without_grain(measured.cells), measured.grid, recipe)
        return notes + check_follows(measured.aligned, stages_deg, recipe.limits.part_turn_deg)

    def decide(
        self,
        sitting: Sitting,
        recipe: WaferRecipe,
        expected: Expectation,
        measured: Measured,
        reference: Reference | None,
    ) -> Decision:
        """As of all surfaces, and by the tiles among each other, which need no prediction."""
        decided = super().decide(sitting, recipe, expected, measured, reference)
        share = recipe.defects.marked_share
        local = (
            None
            if share is None
            else local_decision(measured, expected.poses, share, recipe.decision.coverage)
        )
        return decided if local is None else _with_local(decided, local)

    def diagnose(
        self,
        sitting: Sitting,
        recipe: WaferRecipe,
        expected: Expectation,
        measured: Measured,
        decided: Decision,
        reference: Reference | None,
        advance: Advance = silent,
        *,
        cached: bool = False,
    ) -> Explanation:
        """Causes by the means alone, whose signatures know no places; marks are no fault of the rig."""
        recipe, decided = _by_means(recipe, decided)
        return super().diagnose(
            sitting, recipe, expected, measured, decided, reference, advance, cached=cached
        )

    def taken_back(
        self,
        recipe: WaferRecipe,
        expected: Expectation,
        measured: Measured,
        decided: Decision,
        *,
        light_watched: bool,
    ) -> tuple[DiagnosisRecord, str] | None:
        """As of all surfaces, by the means alone."""
        recipe, decided = _by_means(recipe, decided)
        return super().taken_back(recipe, expected, measured, decided, light_watched=light_watched)

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
