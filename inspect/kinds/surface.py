"""Parts with a surface that reflects: what ridges and wafers have in common as kinds."""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cause_words import CauseWords
from anisoscope.base.errors import (
    AnisoscopeError,
    CalibrationError,
    HeightMapError,
    MeasurementError,
    ModelError,
    UsageError,
)
from anisoscope.base.notation import p_value_text, quantity_name
from anisoscope.base.progress import Advance, silent
from anisoscope.base.significance import LEAST_SAMPLE, log_basis
from anisoscope.decision.consistency import contrast_scatter, of_one_part, scatter_of
from anisoscope.decision.decision import Decision, decide
from anisoscope.decision.design_vs_map import Predict, compare
from anisoscope.decision.lot_reference import LotScatter
from anisoscope.decision.reference_parts import GoldenSet
from anisoscope.diagnosis.cause_model import PLASTIC_CAUSES, CauseModel
from anisoscope.diagnosis.cause_words import plastic_words
from anisoscope.diagnosis.evidence import Evidence
from anisoscope.diagnosis.likelihood import nothing
from anisoscope.diagnosis.part_diagnosis import evidence_of, explain, rig_reason, shifted
from anisoscope.diagnosis.ranking import TIE
from anisoscope.diagnosis.rig_causes import rig_faults
from anisoscope.imaging.angle_map import AngleMap
from anisoscope.imaging.defect_regions import signed_scores
from anisoscope.imaging.deviation_map import CellMap, cell_log_ratios, cell_map, remember
from anisoscope.imaging.part_form import (
    FORM,
    FormDeviation,
    form_arrays,
    form_deviation,
    form_known,
    remember_form,
)
from anisoscope.imaging.pose_radiance import (
    CELLS_PER_PITCH,
    STAGE_ANGLE,
    Measured,
    mean_of,
    measure,
    region_grid,
)
from anisoscope.imaging.predicted_cells import even_cells, pitch_means
from anisoscope.imaging.quality_gates import check_views
from anisoscope.imaging.registration.placement import Grid, View, resample
from anisoscope.imaging.views import most_changed
from anisoscope.kinds.command_output import CommandOutput, Table
from anisoscope.kinds.kind import Explanation, Kind, Results, Sitting
from anisoscope.kinds.parts import (
    Checking,
    Redeciding,
    Reference,
    References,
    Reporting,
    Teaching,
    Tolerances,
    reference_notes,
    untaught,
    usable,
)
from anisoscope.kinds.recipe_check import RecipeCheck
from anisoscope.kinds.surface_reference import (
    golden_record,
    taught_tolerances,
    teach_scatter,
    unlike_text,
    with_power,
)
from anisoscope.prediction.cache import cached_expectation
from anisoscope.prediction.expectation import (
    PLASTIC,
    Component,
    Expectation,
    SurfaceOptics,
    expectation,
    under_lamp,
)
from anisoscope.prediction.part_scatter import (
    CAMERA_SHARE,
    PartScatter,
    part_scatter,
    with_design,
)
from anisoscope.profiles.defect_injection import DEFECTS
from anisoscope.quality.capability import recipe_tolerances
from anisoscope.recipe.base import LimitsPart
from anisoscope.recipe.surface import (
    NO_CELL_DEVIATION,
    SurfaceRecipe,
    check_lamp,
    check_material,
)
from anisoscope.recipe.teaching import Taught
from anisoscope.record.schema import (
    DiagnosisRecord,
    MapPlaceRecord,
    ReadingRecord,
    Record,
    ShapeRecord,
)
from anisoscope.record.surface_details import SurfaceDetails, surface_of
from anisoscope.record.verdict import Verdict
from anisoscope.report.conclusion import Kinds, named_regions, surface_finding
from anisoscope.report.inspection_page import Pictures, Sections
from anisoscope.rig.rigfile import LightPart, RigFile

RecipeT = TypeVar("RecipeT", bound=SurfaceRecipe)
NO_RETURN = (
    "not watched: a slip of the part by half a turn between two poses (the first pose was not photographed "
    "again)"
)
MEASURED_BY = (
    "poses",
    "region",
    "surface.pitch_um",
    *(f"uncertainty.{one}" for one in ("stage_deg", "flat_share", "linearity_share", "stray_radiance")),
    *(f"limits.{one}" for one in LimitsPart.model_fields if one != "drift"),
)
"""Keys of a recipe that the measurement depends on; all others concern the prediction or the decision."""
PRIOR_PARTS = 30
"""Number of golden parts as which the stated scatter counted before they showed its size."""
JUDGED_LATER = ("max_length_um", "max_lean_deg")
"""Limits of the area that records of earlier versions do not name."""
HEIGHT_MAP = "height map"
MATERIAL = "material"


class SurfaceKind(
    Kind[RecipeT, Expectation, Measured, Decision],
    References,
    Redeciding,
    Teaching,
    Checking,
    Tolerances,
    Reporting,
):
    """A part whose surface decides how bright it is in every pose: its contrasts are judged."""

    optics: SurfaceOptics = PLASTIC
    """Optics of its prediction."""
    causes: CauseModel = PLASTIC_CAUSES
    """Its causes of deviation."""

    @property
    def details(self) -> type[SurfaceDetails]:
        """Contrasts, map, comparisons."""
        return SurfaceDetails

    def check(self, recipe: RecipeT, rig: RigFile, recipe_path: Path, rig_path: Path) -> None:
        """Check that lamp and lens are those of the recipe's prediction and of its material."""
        check_lamp(recipe, rig, rig_path)
        check_material(recipe, rig, recipe_path, self._facet_deg(recipe))
        super().check(recipe, rig, recipe_path, rig_path)

    @staticmethod
    def _facet_deg(recipe: SurfaceRecipe) -> float | None:
        """Ridge angle of the design, or of the height map where a material file is compared with it; else None."""
        if recipe.material.calibrated is None:
            return None
        try:
            design = with_design(recipe.deciding()).surface.design
        except HeightMapError:  # no ridges, or no map: the prediction gives the reason
            return None
        return None if design is None else design.ridge_angle_deg

    def check_valid(self, recipe: RecipeT, at: datetime) -> None:
        """Check that the material file has not expired."""
        file = recipe.material.calibrated
        reason = None if file is None else file.expired(at)
        if reason is not None:
            raise CalibrationError(reason)

    def sources(self, recipe: RecipeT, rig: RigFile) -> Mapping[str, Path]:
        """Height map and material file.

        Raises:
            HeightMapError: the height map is missing.
        """
        del rig
        file, path = recipe.material.file, recipe.surface.height_map
        found = {} if file is None else {MATERIAL: file}
        if path is None:
            return found
        if not path.is_file():
            raise HeightMapError(f"{path}: there is no such file")
        return {**found, HEIGHT_MAP: path}

    def from_copies(
        self, recipe: RecipeT, rig: RigFile, copies: Mapping[str, Path]
    ) -> tuple[RecipeT, RigFile]:
        """The recipe with the copy of its height map."""
        if HEIGHT_MAP not in copies:
            return recipe, rig
        surface = recipe.surface.model_copy(update={"height_map": copies[HEIGHT_MAP]})
        return recipe.model_copy(update={"surface": surface}), rig

    def predict(self, recipe: RecipeT, rig: RigFile, *, cached: bool) -> Expectation:
        """The radiances of the poses."""
        return self._predict(cached=cached, lamp=rig.light)(recipe, rig.light.angle_deg)

    def _predict(self, *, cached: bool, lamp: LightPart | None = None) -> Predict:
        far = partial(cached_expectation if cached else expectation, optics=self.optics)
        if lamp is None:
            return far
        return lambda recipe, light_deg: under_lamp(far(recipe, light_deg), recipe, lamp)

    def check_part(self, views: list[View], measured: Measured, recipe: SurfaceRecipe) -> tuple[str, ...]:
        """Gates of the aligned pictures.

        Returns:
            Notes on what could not be seen.

        Raises:
            MeasurementError: INVALID, with the reason.
        """
        del views, measured, recipe
        return ()

    def fit_shape(
        self, recipe: SurfaceRecipe, expected: Expectation, measured: Measured
    ) -> tuple[ShapeRecord | None, str | None]:
        """Shape fitted over the tilts, or a note why it is missing."""
        del recipe, expected, measured
        return None, None

    def facets(
        self, recipe: SurfaceRecipe, expected: Expectation, measured: Measured
    ) -> AngleMap | AnisoscopeError | None:
        """Lean of the facets, or why it cannot be had; None of a kind without."""
        del recipe, expected, measured
        return None

    def form(self, recipe: SurfaceRecipe, expected: Expectation, measured: Measured) -> FormDeviation | None:
        """Largest lean of the facets over several ridges; None where no facets are seen."""
        known = form_known(measured)
        facets = self.facets(recipe, expected, measured) if known is None and measured.aligned else None
        if isinstance(facets, AngleMap):
            try:
                known = form_deviation(facets)
            except MeasurementError:
                return None
            remember_form(measured, known)
        return known

    def _unjudged_form(
        self, recipe: SurfaceRecipe, expected: Expectation, measured: Measured, decided: Decision
    ) -> str | None:
        """Note that the form of the part was to be judged, and why it was not."""
        limit = None if recipe.area is None else recipe.area.max_lean_deg
        if limit is None or decided.form is not None or not measured.aligned:
            return None
        form, facets = form_known(measured), self.facets(recipe, expected, measured)
        if form is not None:
            return (
                f"sink marks are not judged: noise alone makes several ridges lean by {form.by_chance_deg:.2g}° "
                f"(limit {limit:g}°); take more frames_per_pose, a longer exposure_s, or a larger region"
            )
        reason = "too few cells of the angle map are known" if isinstance(facets, AngleMap) else str(facets)
        return f"sink marks are not judged: {reason}"

    def match_map(
        self, recipe: SurfaceRecipe, expected: Expectation, measured: Measured
    ) -> tuple[MapPlaceRecord | None, str | None]:
        """Position of the height map on the part, or a note why it is unknown."""
        del recipe, expected, measured
        return None, None

    def measure(self, sitting: Sitting, recipe: RecipeT, expected: Expectation) -> tuple[Measured, float]:
        """Mean radiances of the region, and the contrast map."""
        views, pixel_um = sitting.views, sitting.pixel_um
        grid, _ = region_grid(recipe, pixel_um)
        closing, change = most_changed(
            views, recipe, pixel_um, lambda view: mean_of(resample(view.image.value, view.placement, grid))
        )
        for view in views.poses:
            sitting.calibrations.check_place(view.stage_deg, view.placement, recipe.limits.fixture_um)
        check_views(views.poses, recipe)
        calibrated = sitting.calibrated(recipe)
        measured = measure(views.poses, closing, calibrated, expected, pixel_um)
        notes = self.check_part(views.poses, measured, recipe)
        return replace(measured, unwatched=notes if closing is not None else (*notes, NO_RETURN)), change

    def decide(
        self,
        sitting: Sitting,
        recipe: RecipeT,
        expected: Expectation,
        measured: Measured,
        reference: Reference | None,
    ) -> Decision:
        """Contrasts against their tolerances, all of them together, and the area that deviates."""
        del sitting
        golden = cast("GoldenSet | None", usable(reference))
        left_out: tuple[str, ...] = ()
        try:
            parts = self.part_scatter(recipe, expected.convention.light_angle_deg)
        except ModelError:  # a defect so near the horizon that it cannot be predicted: the part can
            if golden is not None:
                raise
            parts = None
        if golden is not None and parts is None and len(golden.parts) < LEAST_SAMPLE:
            golden = None
        if golden is not None and golden.lot is not None:
            found = self._lot_scatter(golden, expected, measured, parts)
            golden, left_out = (None, ()) if found is None else golden.alike(found)
        if golden is not None and len(golden.parts) < golden.needed:
            golden = None
        waiting = isinstance(reference, GoldenSet) and reference.lot is not None
        judged = recipe.area is not None and recipe.area.max_lean_deg is not None
        return decide(
            expected,
            measured,
            recipe,
            golden,
            parts,
            waiting=waiting,
            left_out=left_out,
            form=self.form(recipe, expected, measured) if judged else None,
        )

    @staticmethod
    def _lot_scatter(
        others: GoldenSet, expected: Expectation, measured: Measured, parts: PartScatter | None
    ) -> LotScatter | None:
        """What is compared of a part and the others of its lot: by the stated scatter, or the form of the budget."""
        mine = log_basis(len(measured.radiance)) @ np.log(measured.radiance)
        values = np.vstack([others.contrasts(), mine])
        if parts is not None:
            return LotScatter(values, scatter_of(parts, measured).covariance)
        if others.predictive:
            return None
        return LotScatter(values, of_one_part(expected, measured.components, others.varies)[1], sized=False)

    def kept(self, recipe: RecipeT, measured: Measured) -> Mapping[str, Any]:
        """Radiances, cells and how they deviate, uncertainties; the pictures are in the frames."""
        grid, parts = measured.grid, measured.components
        marked = {} if measured.mirroring is None else {"mirroring": measured.mirroring}
        return {
            **marked,
            "radiance": measured.radiance,
            "cells": measured.cells,
            "cell_noise": measured.cell_noise,
            "sources": [part.source for part in parts],
            "relative": [part.relative for part in parts],
            "shared": [part.shared for part in parts],
            "grid_center_mm": grid.center_mm,
            "grid_pixel_mm": grid.pixel_mm,
            "grid_shape": grid.shape,
            "grid_turn_deg": grid.turn_deg,
            "drift": np.nan if measured.drift is None else measured.drift,
            "stage_deg": recipe.uncertainty.stage_deg,
            **(
                {}
                if recipe.area is None
                else {f"local_{k}": v for k, v in cell_map(measured, recipe).arrays().items()}
            ),
            **form_arrays(measured),
        }

    def needs_frames(self, recorded: Mapping[str, Any], recipe: RecipeT) -> str | None:
        """The region, the poses, the pitch, or a limit of the measurement was changed."""
        now = recipe.model_dump(mode="json", by_alias=True)
        for key in MEASURED_BY:
            before, after = _value(recorded, key), _value(now, key)
            if before is not None and before != after:
                return f"{key} is {after}, the inspection was by {before}"
        return None

    def deviations(self, kept: Mapping[str, Any], recorded: Mapping[str, Any]) -> tuple[CellMap, float]:
        """How the cells deviate from the ridges of the part; by the cells alone where that was not stored."""
        recipe = self.recipe.model_validate(recorded, extra="ignore")
        measured = _measured(kept)
        side_mm = recipe.surface.pitch_um / 1000.0 / CELLS_PER_PITCH
        return cell_map(measured, recipe), side_mm

    def decide_again(
        self, kept: Mapping[str, Any], recipe: RecipeT, expected: Expectation, reference: Reference | None
    ) -> tuple[Measured, Decision]:
        """Measurement and verdict by another recipe; the stage angle weighs by the slope of the new prediction."""
        measured = _measured(kept, float(kept["stage_deg"]) * expected.per_degree)
        return measured, self.decide(cast("Sitting", None), recipe, expected, measured, reference)

    def part_scatter(self, recipe: SurfaceRecipe, light_angle_deg: float) -> PartScatter | None:
        """Scatter of good parts; None where only their own scatter counts."""
        if recipe.scatter is None or not self.reference_set.predictive:
            return None
        return part_scatter(recipe, light_angle_deg, self.optics)

    def results(
        self,
        sitting: Sitting,
        recipe: RecipeT,
        expected: Expectation,
        measured: Measured,
        decided: Decision,
        reference: Reference | None,
    ) -> Results:
        """Results for the record."""
        del sitting, recipe, reference
        details = SurfaceDetails(
            contrasts=decided.contrasts,
            between_tilts=decided.between_tilts,
            area=decided.area,
            regions=decided.regions,
            form=decided.form,
            exclusions=tuple(one.record() for one in decided.exclusions),
        )
        return Results(
            measured.radiance,
            expected.radiance,
            details,
            decided.budget,
            decided.d2,
            decided.dof,
            decided.p_value,
            decided.conformance_probability,
            measured.unwatched,
        )

    def without_results(self) -> SurfaceDetails:
        """No contrasts."""
        return SurfaceDetails()

    def diagnose(
        self,
        sitting: Sitting,
        recipe: RecipeT,
        expected: Expectation,
        measured: Measured,
        decided: Decision,
        reference: Reference | None,
        advance: Advance = silent,
        *,
        cached: bool = False,
    ) -> Explanation:
        """Causes, both comparisons, the fit over tilts, the place on the height map, and the golden parts."""
        golden = decided.reference
        predict = self._predict(cached=cached, lamp=expected.lamp)
        monitor = sitting.views.monitor
        watched = monitor is not None and monitor.light_watched
        diagnosis, unexplained = self._explained(
            recipe, expected, measured, decided, golden, advance, light_watched=watched, cached=cached
        )
        # against golden parts the decision has other numbers
        known = None if decided.golden else (decided.d2, decided.dof, decided.p_value)
        compared = compare(recipe, expected, measured, predict, known)
        shape, unfitted = self.fit_shape(recipe, expected, measured)
        placed, unplaced = self.match_map(recipe, expected, measured)
        facets = self.facets(recipe, expected, measured)
        unlike = unlike_text(decided)
        changed = (
            NO_CELL_DEVIATION if recipe.area is not None and recipe.area.cell_deviation is not None else None
        )
        return Explanation(
            diagnosis,
            {
                "comparisons": compared.comparisons,
                "reading": compared.reading,
                "readings": compared.readings,
                "shape": shape,
                "map_place": placed,
                "angles": facets.record() if isinstance(facets, AngleMap) else None,
                "angles_lacking": str(facets) if isinstance(facets, AnisoscopeError) else None,
                "golden": None if golden is None else golden_record(golden, measured, decided),
            },
            tuple(
                note
                for note in (
                    *reference_notes(reference),
                    unlike,
                    changed,
                    unexplained,
                    compared.note,
                    self._unjudged_form(recipe, expected, measured, decided),
                    unfitted,
                    unplaced,
                )
                if note
            ),
            "" if diagnosis.verdict is None else rig_reason(diagnosis),
        )

    def taken_back(
        self,
        recipe: RecipeT,
        expected: Expectation,
        measured: Measured,
        decided: Decision,
        *,
        light_watched: bool,
    ) -> tuple[DiagnosisRecord, str] | None:
        """Diagnosis of a FAIL alone, without comparisons and fits."""
        if decided.verdict is not Verdict.FAIL or not recipe.decision.rig_faults:
            return None
        golden = decided.reference
        if not self._rig_may_explain(
            recipe, expected, measured, decided, golden, light_watched=light_watched
        ):
            return None
        diagnosis, _ = self._explained(
            recipe, expected, measured, decided, golden, light_watched=light_watched, cached=True
        )
        return None if diagnosis.verdict is None else (diagnosis, rig_reason(diagnosis))

    def _rig_may_explain(
        self,
        recipe: RecipeT,
        expected: Expectation,
        measured: Measured,
        decided: Decision,
        golden: GoldenSet | None,
        *,
        light_watched: bool,
    ) -> bool:
        """Whether a fault of the rig fits better than no cause, without which a tenth of a second need not be spent."""
        predict = self._predict(cached=True, lamp=expected.lamp)
        light_deg = expected.convention.light_angle_deg
        evidence = evidence_of(recipe, expected, measured, decided, golden)
        good = nothing(evidence)

        def seen_at(seat: Expectation) -> Evidence:
            turned = evidence_of(recipe, seat, measured, decided)
            return turned if golden is None else shifted(evidence, turned, expected, seat)

        faults = rig_faults(
            recipe,
            expected,
            evidence,
            seen_at,
            lambda other: predict(other, light_deg),
            light_watched=light_watched or good.chi2 <= TIE,
        )
        return any(good.cost - one.fit.cost - one.penalty > TIE for one in faults)

    def _explained(
        self,
        recipe: RecipeT,
        expected: Expectation,
        measured: Measured,
        decided: Decision,
        golden: GoldenSet | None,
        advance: Advance = silent,
        *,
        light_watched: bool,
        cached: bool,
    ) -> tuple[DiagnosisRecord, str | None]:
        """Ranked causes, faults of the rig among them, and a note where that failed."""
        predict = self._predict(cached=cached, lamp=expected.lamp)
        light_deg = expected.convention.light_angle_deg
        return explain(
            recipe,
            expected,
            measured,
            decided,
            advance,
            golden,
            self.causes,
            predict=(lambda other: predict(other, light_deg)) if recipe.decision.rig_faults else None,
            light_watched=light_watched,
        )

    def as_recorded(self, recipe: RecipeT, recorded: Mapping[str, Any]) -> RecipeT:
        """As recorded: direct light, sampled walls, a known lobe, no test of wear or form, golden parts by own scatter.

        Uncertainties of the plastic are the recorded ones: their defaults were others. Scatter of parts that a record
        states without `in_prediction` was of golden parts only; against them it counted as that of 30 parts. Crests
        whose form a record does not name were arcs, and sharp where no radius was given.
        """
        changes: dict[str, Any] = {}
        then = {"reflections": "direct", "walls": "sampled"}
        surface = recorded.get("surface", {})
        unknown: dict[str, Any] = {key: value for key, value in then.items() if key not in surface}
        design = recipe.surface.design
        if design is not None and "edge_form" not in (surface.get("design") or {}):
            known = {"edge_radius_um": design.edge_radius_um or 0.0, "edge_form": "arc"}
            unknown["design"] = design.model_copy(update=known)
        if unknown:
            changes["surface"] = recipe.surface.model_copy(update=unknown)
        stated_scatter = recorded.get("scatter")
        if "scatter" not in recorded:
            changes["scatter"] = None
        elif recipe.scatter is not None:
            lacking = {"in_prediction": False, "edge_radius_share": 0.0}
            missing = {key: value for key, value in lacking.items() if key not in (stated_scatter or {})}
            if "unexcluded" not in recorded.get("decision", {}):
                missing["prior_parts"] = PRIOR_PARTS
            changes["scatter"] = recipe.scatter.model_copy(update=missing)
        stated = {"u_tail": 0.0} | recorded.get("material", {})
        changes["material"] = recipe.material.model_copy(
            update={name: stated[name] for name in ("u_tail", "u_alpha_share", "u_albedo") if name in stated}
        )
        if "rig_faults" not in recorded.get("decision", {}):
            changes["decision"] = recipe.decision.model_copy(update={"rig_faults": False})
        if recipe.area is not None:
            then_none = {name: None for name in JUDGED_LATER if name not in (recorded.get("area") or {})}
            changes["area"] = recipe.area.model_copy(update=then_none)
        if "wear_um" not in recorded.get("defects", {}):
            changes["defects"] = recipe.defects.model_copy(update={"wear_um": None})
        return recipe.model_copy(update=changes)

    def rename_in(self, record: dict[str, Any]) -> None:
        """Rename the sources of the budget of an earlier version, and its notation of contrasts."""
        super().rename_in(record)
        for row in record["budget"]:
            row["source"] = self.optics.source_name(row["source"])

    reference_set: type[GoldenSet] = GoldenSet

    def compares_with_lot(self, recipe: RecipeT) -> bool:
        """Where the recipe says so and, of parts that are compared by the stated scatter, states it."""
        return super().compares_with_lot(recipe) and bool(recipe.scatter or not self.reference_set.predictive)

    def show_reference(
        self,
        known: Any,  # noqa: ANN401
        recipe: RecipeT,
        light_angle_deg: float = 10.0,
    ) -> CommandOutput:
        """The golden parts, how much they vary, and which defects they can show."""
        shown = super().show_reference(known, recipe, light_angle_deg)
        parts = self.part_scatter(recipe, light_angle_deg)
        return shown if parts is None else with_power(shown, known, recipe, parts)

    def lot_scatter(
        self,
        known: Any,  # noqa: ANN401
        recipe: RecipeT,
        rig: RigFile,
    ) -> LotScatter:
        """Contrasts, and the scatter that the recipe states, or else its form by the budget.

        Raises:
            CalibrationError: parts of this kind are compared by the stated scatter, and it states none.
        """
        if not self.reference_set.predictive:
            expected = self.predict(recipe, rig, cached=True)
            camera = Component(
                "camera", "measurement", np.full(len(expected.poses), CAMERA_SHARE), shared=False
            )
            form = of_one_part(expected, (camera,), self.reference_set.varies)[1]
            return LotScatter(known.contrasts(), form, sized=False)
        parts = self.part_scatter(recipe, rig.light.angle_deg)
        if parts is None:
            raise CalibrationError(
                "parts of unknown quality need a recipe that states how good parts scatter ([scatter]): add parts that "
                "are known to be good, without --unlabelled"
            )
        return LotScatter(known.contrasts(), contrast_scatter(parts, CAMERA_SHARE).covariance)

    def tolerances(self, recipe: RecipeT) -> dict[str, float]:
        """One tolerance a contrast."""
        return recipe_tolerances(recipe)

    def taught_limits(
        self, record: Record, recipe: RecipeT, reference: Reference | None, rig: RigFile
    ) -> dict[tuple[str, ...], tuple[Any, str]]:
        """One tolerance a pair."""
        del rig
        return {
            ("decision", "tolerance"): taught_tolerances(record, recipe, cast("GoldenSet | None", reference))
        }

    def teach_by_reference(
        self, recipe_path: Path, rig_path: Path, share: float, source: Path | None = None
    ) -> Taught:
        """Write a new version of a recipe with the scatter between parts that golden parts show.

        The golden parts may be those of another recipe for the same plastic and rig: other poses or ridges.

        Raises:
            UsageError: no scatter is stated of this kind, the golden parts are too few, or the plastics differ.
        """
        del share
        if not self.reference_set.predictive:
            raise UsageError(untaught(self, recipe_path))
        return teach_scatter(self, recipe_path, rig_path, source or recipe_path)

    def capability(
        self,
        recipe: RecipeT,
        rig: RigFile | None,
        light_angle_deg: float,
        tries: Sequence[float],
        advance: Advance,
    ) -> RecipeCheck:
        """Contrasts, budget, causes, and tilts that would help."""
        from anisoscope.kinds.surface_check import check_recipe  # noqa: PLC0415 - heavy

        del rig
        return check_recipe(recipe, light_angle_deg, tries, advance, self.optics, self.causes)

    def pictures(
        self, recipe: RecipeT, expected: Expectation, measured: Measured, decided: Decision
    ) -> Pictures:
        """The aligned photographs, what they should look like, and the maps."""
        cells = decided.cells
        predicted, caption = self.predicted_cells(recipe, expected, measured)
        means, averaged = self.comparable_means(measured)
        facets = self.facets(recipe, expected, measured)
        return Pictures(
            aligned=measured.aligned,
            predicted=predicted,
            predicted_text=caption,
            differences=means / expected.radiance[:, None, None] - 1.0,
            difference_text=averaged,
            size_mm=measured.grid.size_mm,
            ratios=cell_log_ratios(measured, expected.poses),
            deviating=decided.deviating,
            deviation=None if cells is None else signed_scores(cells),
            surface=expected.surface,
            facets=facets if isinstance(facets, AngleMap) else None,
        )

    def predicted_cells(
        self, recipe: SurfaceRecipe, expected: Expectation, measured: Measured
    ) -> tuple[FloatArray, str]:
        """Predicted radiance of every cell of the region in each pose, and what it is: by default the mean."""
        del recipe
        return even_cells(expected, measured), "the predicted mean radiance of each pose, the same everywhere"

    def comparable_means(self, measured: Measured) -> tuple[FloatArray, str]:
        """(P, rows, cols) measured radiances of the smallest areas whose mean is predicted, and what they are."""
        return pitch_means(measured.cells), "averaged across one pitch"

    def sections(self, record: Record, pictures: Pictures) -> Sections:
        """Contrasts, maps, comparisons and budget."""
        from anisoscope.report.surface_sections import surface_sections  # noqa: PLC0415 - draws

        return surface_sections(record, pictures, self.cause_words)

    @property
    def cause_words(self) -> Mapping[str, CauseWords]:
        """The causes of plastic parts in plain words."""
        return plastic_words()

    def finding(self, record: Record) -> str:
        """The contrast or area that is most off, by its limit."""
        return surface_finding(record)

    def nominal(self, record: Record) -> Mapping[str, float]:
        """The ridge angle of design or height map."""
        design = record.recipe["surface"].get("design")
        angle = None if record.optics is None else record.optics.groove_angle_deg
        if design is not None:
            angle = design["ridge_angle_deg"]
        return {} if angle is None else {one.name: angle for one in DEFECTS.values() if one.turns_facets}

    def summary(self, record: Record) -> CommandOutput:
        """Tables of the contrasts, and lines on the deviating regions."""
        found = surface_of(record)
        content = found.model_dump()
        golden = content.pop("golden")
        content |= {"golden_parts": 0 if golden is None else found.golden.parts if found.golden else 0}
        content["print"] = None  # a key of all kinds, from the time when there was one list of them
        tables = [_contrast_table(record, found)] if found.contrasts else []
        if found.between_tilts:
            tables.append(_tilt_table(record))
        lines = [] if found.reading is None else [f"design and height map: {found.reading}"]
        lines += [f"  {one.says}{_chance_text(one)}" for one in found.readings]
        if record.verdict != "PASS":
            lines += [
                f"{_kinds_text(kinds)} at x {region.x:+.2f} mm, y {region.y:+.2f} mm: "
                f"{100.0 * region.area_share:.2f} % of the area"
                for region, kinds in named_regions(record, self.cause_words)[:MAX_REGIONS]
            ]
        return CommandOutput(content, tuple(tables), tuple(lines))


def _kinds_text(kinds: Kinds) -> str:
    """Kinds of a region in a line: "scratch (70 %) or burr (20 %)"."""
    return " or ".join(name if one is None else f"{name} ({100.0 * one:.0f} %)" for name, one in kinds)


def _value(table: Mapping[str, Any], key: str) -> Any:  # noqa: ANN401 - what JSON holds
    """The value of a key with dots, or None."""
    found: Any = table
    for name in key.split("."):
        found = found.get(name) if isinstance(found, Mapping) else None
    return found


def _chance_text(reading: ReadingRecord) -> str:
    return "" if reading.p_value is None else f" (p {p_value_text(reading.p_value)})"


MAX_REGIONS = 5


def _contrast_table(record: Record, found: SurfaceDetails) -> Table:
    columns = [
        "contrast",
        "measured",
        "predicted",
        "deviation",
        "u",
        "tolerance",
    ]
    rows: Sequence[Sequence[str]] = [
        [
            quantity_name(one.kind, one.from_deg, one.to_deg, one.tilt_deg),
            f"{one.measured:+.4f}",
            f"{one.predicted:+.4f}",
            f"{one.measured - one.predicted:+.4f}",
            f"{one.u:.4f}",
            "–" if one.tolerance is None else f"±{one.tolerance:g}",
            one.verdict if one.tolerance is not None else "",
        ]
        for one in found.contrasts
    ]
    return Table(f"{record.serial}: {record.product}", [*columns, ""], rows)


def _tilt_table(record: Record) -> Table:
    """The contrasts between tilts; of many the least likely ones, in their order."""
    from anisoscope.report.tilt_sections import listed_tilt_contrasts, tilt_row  # noqa: PLC0415 - draws
    from anisoscope.report.wording import U_LEGEND  # noqa: PLC0415 - start-up time

    listed, folded = listed_tilt_contrasts(record)
    return Table(
        "the same stage angle at two tilts",
        ["contrast", "at [°]", "tilts [°]", "measured", "U", "predicted", "U", "deviation", "U", "p"],
        [[row.kind, row.stage, row.tilts, *row.numbers, row.chance] for row in map(tilt_row, listed)],
        f"{U_LEGEND}; for information"
        + (f"; {len(folded)} more, all likelier, in record.json" if folded else ""),
    )


def _measured(kept: Mapping[str, Any], slopes: FloatArray | None = None) -> Measured:
    """Measurement from its arrays; ``slopes``: (P,) weight of the stage angle by another prediction."""
    parts = zip(kept["sources"], kept["relative"], kept["shared"], strict=True)
    drift = float(kept["drift"])
    found = Measured(
        radiance=kept["radiance"],
        components=tuple(
            Component(
                str(name),
                "measurement",
                slopes if name == STAGE_ANGLE and slopes is not None else relative,
                bool(shared),
            )
            for name, relative, shared in parts
        ),
        aligned=(),
        cells=kept["cells"],
        cell_noise=kept["cell_noise"],
        grid=Grid(
            (float(kept["grid_center_mm"][0]), float(kept["grid_center_mm"][1])),
            float(kept["grid_pixel_mm"]),
            (int(kept["grid_shape"][0]), int(kept["grid_shape"][1])),
            float(kept["grid_turn_deg"]),
        ),
        drift=None if np.isnan(drift) else drift,
        mirroring=kept.get("mirroring"),
    )
    stored = {one: f"local_{one.name}" for one in fields(CellMap) if one.name != "signs"}
    if all(key in kept or one.default is not MISSING for one, key in stored.items()):
        local = {one.name: np.asarray(kept[key]) for one, key in stored.items() if key in kept}
        values: dict[str, Any] = {k: v.item() if v.ndim == 0 else v for k, v in local.items()}
        remember(found, CellMap(**values))
    if FORM in kept:
        remember_form(found, FormDeviation(*map(float, kept[FORM])))
    return found
