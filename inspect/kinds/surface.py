"""Parts with a surface that reflects: what ridges and wafers have in common as kinds."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from anisoscope.base.errors import HeightMapError
from anisoscope.base.progress import Advance, silent
from anisoscope.base.significance import log_basis
from anisoscope.decision.decision import Decision, decide
from anisoscope.decision.design_vs_map import Predict, compare
from anisoscope.decision.reference_parts import GoldenSet, add_part, limit_is_given, read_golden
from anisoscope.diagnosis.cause_model import PLASTIC_CAUSES, CauseModel
from anisoscope.diagnosis.part_diagnosis import explain
from anisoscope.imaging.defect_regions import deviation_map
from anisoscope.imaging.deviation_map import cell_log_ratios
from anisoscope.imaging.pose_radiance import Measured, mean_of, measure, region_grid
from anisoscope.imaging.quality_gates import check_views
from anisoscope.imaging.registration.placement import View, resample
from anisoscope.imaging.views import most_changed
from anisoscope.kinds.golden_limit import area_limit_text
from anisoscope.kinds.kind import CommandOutput, Explanation, Kind, Reference, Results, Sitting, Table, usable
from anisoscope.prediction.cache import cached_expectation
from anisoscope.prediction.expectation import PLASTIC, Expectation, SurfaceOptics, expectation
from anisoscope.quality.capability import recipe_tolerances
from anisoscope.recipe.poses import check_poses
from anisoscope.recipe.surface import SurfaceRecipe, check_lamp, read_surface_recipe
from anisoscope.record.schema import GoldenRecord, MapPlaceRecord, Record, ShapeRecord
from anisoscope.record.surface_details import SurfaceDetails, surface_of
from anisoscope.report.inspection_page import Pictures, Sections
from anisoscope.rig.rigfile import RigFile, read_rig

RecipeT = TypeVar("RecipeT", bound=SurfaceRecipe)
HEIGHT_MAP = "height map"


class SurfaceKind(Kind[RecipeT, Expectation, Measured, Decision]):
    """A part whose surface decides how bright it is in every pose: its contrasts are judged."""

    optics: SurfaceOptics = PLASTIC
    """Optics of its prediction."""
    causes: CauseModel = PLASTIC_CAUSES
    """Its causes of deviation."""

    @property
    def details(self) -> type[SurfaceDetails]:
        """Contrasts, map, comparisons."""
        return SurfaceDetails

    def read_recipe(self, path: Path) -> RecipeT:
        """Read a recipe; errors as for `anisoscope.recipe.surface.read_surface_recipe`."""
        return read_surface_recipe(path, self.recipe)

    def check(self, recipe: RecipeT, rig: RigFile, recipe_path: Path, rig_path: Path) -> None:
        """Check that lamp and lens are those of the recipe's prediction."""
        check_lamp(recipe, rig, rig_path)
        super().check(recipe, rig, recipe_path, rig_path)

    def sources(self, recipe: RecipeT, rig: RigFile) -> Mapping[str, Path]:
        """The height map.

        Raises:
            HeightMapError: it is missing.
        """
        del rig
        path = recipe.surface.height_map
        if path is None:
            return {}
        if not path.is_file():
            raise HeightMapError(f"{path}: there is no such file")
        return {HEIGHT_MAP: path}

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
        return self._predict(cached=cached)(recipe, rig.light.angle_deg)

    def _predict(self, *, cached: bool) -> Predict:
        return partial(cached_expectation if cached else expectation, optics=self.optics)

    def check_part(self, views: list[View], measured: Measured, recipe: SurfaceRecipe) -> None:
        """Gates of the aligned pictures.

        Raises:
            MeasurementError: INVALID, with the reason.
        """

    def fit_shape(
        self, recipe: SurfaceRecipe, expected: Expectation, measured: Measured
    ) -> tuple[ShapeRecord | None, str | None]:
        """Shape fitted over the tilts, or a note why it is missing."""
        del recipe, expected, measured
        return None, None

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
            sitting.calibrations.check_place(view.stage_deg, view.placement)
        check_views(views.poses, recipe)
        calibrated = sitting.calibrations.applied_to(recipe)
        measured = measure(views.poses, closing, calibrated, expected, pixel_um)
        self.check_part(views.poses, measured, recipe)
        return measured, change

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
        return decide(expected, measured, recipe, cast("GoldenSet | None", usable(reference)))

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
        del sitting
        golden = cast("GoldenSet | None", usable(reference))
        diagnosis, unexplained = explain(recipe, expected, measured, decided, advance, golden, self.causes)
        comparisons, reading, lost = compare(recipe, expected, measured, self._predict(cached=cached))
        shape, unfitted = self.fit_shape(recipe, expected, measured)
        placed, unplaced = self.match_map(recipe, expected, measured)
        lacking = reference and reference.lacking
        return Explanation(
            diagnosis,
            {
                "comparisons": comparisons,
                "reading": reading,
                "shape": shape,
                "map_place": placed,
                "golden": None if golden is None else golden_record(golden, measured),
            },
            tuple(note for note in (lacking, unexplained, lost, unfitted, unplaced) if note),
        )

    def rename_in(self, record: dict[str, Any]) -> None:
        """Rename the sources of the budget of an earlier version."""
        for row in record["budget"]:
            row["source"] = self.optics.source_name(row["source"])

    def read_reference(self, path: Path, recipe: RecipeT, rig: RigFile | None = None) -> GoldenSet | None:
        """The golden parts."""
        del rig
        return read_golden(path, recipe)

    def add_reference(self, known: Any, recipe: RecipeT, record: Record) -> GoldenSet:  # noqa: ANN401
        """Golden parts with one more."""
        return add_part(known, recipe, record)

    def show_reference(self, known: Any, recipe: RecipeT) -> CommandOutput:  # noqa: ANN401
        """The golden parts, and how much they vary."""
        return reference_table(known, recipe)

    def tolerances(self, recipe: RecipeT) -> dict[str, float]:
        """One tolerance a contrast."""
        return recipe_tolerances(recipe)

    def taught_limits(
        self, record: Record, recipe: RecipeT, reference: Reference | None, rig: RigFile
    ) -> dict[tuple[str, ...], tuple[Any, str]]:
        """One tolerance a pair."""
        del rig
        return {("decision", "tolerance"): _tolerances(record, recipe, cast("GoldenSet | None", reference))}

    def check_recipe(
        self,
        path: Path,
        rig_path: Path | None,
        light_angle_deg: float,
        tries: Sequence[float] = (),
        advance: Advance = silent,
    ) -> CommandOutput:
        """Contrasts, budget, causes, and tilts that would help."""
        from anisoscope.kinds.surface_check import checked_recipe  # noqa: PLC0415 - heavy

        recipe = self.read_recipe(path)
        angle = read_rig(rig_path).light.angle_deg if rig_path is not None else light_angle_deg
        check_poses(recipe.poses, angle, path)
        return checked_recipe(recipe, angle, tries, advance, self.optics, self.causes)

    def pictures(
        self, recipe: RecipeT, expected: Expectation, measured: Measured, decided: Decision
    ) -> Pictures:
        """The aligned photographs and the maps."""
        del recipe
        cells = decided.cells
        return Pictures(
            aligned=measured.aligned,
            size_mm=measured.grid.size_mm,
            ratios=cell_log_ratios(measured, expected.poses) if cells is None else cells.ratios,
            deviating=decided.deviating,
            deviation=None if cells is None else deviation_map(cells),
            surface=expected.surface,
        )

    def sections(self, record: Record, pictures: Pictures) -> Sections:
        """Contrasts, maps, comparisons and budget."""
        from anisoscope.report.surface_sections import surface_sections  # noqa: PLC0415 - draws

        return surface_sections(record, pictures)

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
        if record.verdict != "PASS":
            lines += [
                f"{region.kind} at x {region.x:+.2f} mm, y {region.y:+.2f} mm: {region.area_share:.2%} of the area, "
                f"p = {region.p_value:.2g}"
                for region in found.regions[:MAX_REGIONS]
            ]
        return CommandOutput(content, tuple(tables), tuple(lines))


MAX_REGIONS = 5

TARGET_RATIO = 4.0  # T/U
GOLDEN_SIGMAS = 3.0


def _tolerances(record: Record, recipe: SurfaceRecipe, golden: GoldenSet | None) -> tuple[list[float], str]:
    """One tolerance a pair: 4 U, or what the golden parts vary where that is more."""
    judged = surface_of(record).contrasts
    by_u = np.array([TARGET_RATIO * 2.0 * contrast.u for contrast in judged])
    why = f"{TARGET_RATIO:g} times the expanded uncertainty"
    spread = np.zeros_like(by_u)
    if golden is not None and len(golden.parts) >= 3 and recipe.decision.contrast == "log_ratio":
        logs = np.array([part.log_radiance for part in golden.parts])
        index = {(pose.stage_deg, pose.tilt_deg): k for k, pose in enumerate(record.poses)}
        for k, pair in enumerate(judged):
            a, b = index[pair.from_deg, pair.tilt_deg], index[pair.to_deg, pair.tilt_deg]
            log_ratios = logs[:, a] - logs[:, b]
            off = abs(float(log_ratios.mean()) - pair.predicted)
            spread[k] = off + GOLDEN_SIGMAS * float(log_ratios.std(ddof=1))
        why += f", or what {len(golden.parts)} golden parts vary"
    return [float(f"{value:.2g}") for value in np.maximum(by_u, spread)], why


def golden_record(golden: GoldenSet, measured: Measured) -> GoldenRecord:
    """The golden parts behind the verdict, and this part among them."""
    contrasts = golden.contrasts()
    mine = log_basis(len(measured.radiance)) @ np.log(measured.radiance)
    return GoldenRecord(
        parts=len(golden.parts),
        mean=tuple(contrasts.mean(axis=0)),
        contrasts=tuple(tuple(row) for row in contrasts),
        measured=tuple(mine),
    )


def _contrast_table(record: Record, found: SurfaceDetails) -> Table:
    columns = [
        "contrast",
        "from [°]",
        "to [°]",
        "tilt [°]",
        "measured",
        "predicted",
        "deviation",
        "u",
        "tolerance",
    ]
    rows: Sequence[Sequence[str]] = [
        [
            one.kind,
            f"{one.from_deg:g}",
            f"{one.to_deg:g}",
            f"{one.tilt_deg:g}",
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


def reference_table(known: GoldenSet, recipe: SurfaceRecipe) -> CommandOutput:
    """The golden parts, and how much they vary."""
    contrasts = known.contrasts()
    scatter = contrasts.std(axis=0, ddof=1) if len(contrasts) > 1 else np.full(contrasts.shape[1], np.nan)
    content: dict[str, Any] = {}
    content["parts"] = [part.model_dump() for part in known.parts]
    content["mean"] = [float(value) for value in contrasts.mean(axis=0)]
    content["scatter"] = [float(value) if np.isfinite(value) else None for value in scatter]
    content["area_limit"] = None if recipe.area is None else known.area_limit(recipe) or recipe.area.max_share
    content["area_limit_says"] = _area_limit_text(known, recipe)
    first, *others = known.poses
    names = [f"ln L{_at(pose)} − ln L{_at(first)}" for pose in others]
    rows = [
        [
            part.serial,
            part.inspected_at,
            part.verdict,
            _share(part.area_share),
            *(f"{value:+.4f}" for value in row),
        ]
        for part, row in zip(known.parts, contrasts, strict=True)
    ]
    rows.append(["mean", "", "", "", *(f"{value:+.4f}" for value in contrasts.mean(axis=0))])
    rows.append(
        ["scatter", "", "", "", *(f"{value:.4f}" if np.isfinite(value) else "–" for value in scatter)]
    )
    table = Table(
        f"golden parts: {known.product}",
        ["part", "inspected", "verdict", "area", *names],
        rows,
        known.lacking,
    )
    return CommandOutput(content, (table,), (_area_limit_text(known, recipe),))


def _share(share: float | None) -> str:
    return "–" if share is None else f"{share:.2%}"


def _area_limit_text(known: GoldenSet, recipe: SurfaceRecipe) -> str:
    rule, alpha = recipe.area, recipe.decision.alpha
    return area_limit_text(
        None if rule is None else rule.max_share,
        None if rule is None else known.area_limit(recipe),
        0 if rule is None else len(known.area_shares(rule)),
        given=rule is not None and limit_is_given(rule),
        things="parts",
        exceeds=f"one good part in {2.0 / alpha:.0f} exceeds it; contrasts and area share the level {alpha:g}",
        judged="" if rule is None else f"at cell_deviation {rule.cell_deviation:g}",
    )


def _at(pose: tuple[float, float]) -> str:
    return f"({pose[0]:g}°" + (f", tilt {pose[1]:g}°)" if pose[1] else ")")
