"""Prints with structural-colour inks as a kind of part."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cause_words import CauseWords
from anisoscope.base.errors import AnisoscopeError, MeasurementError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.decision.lot_reference import LotScatter
from anisoscope.diagnosis.part_diagnosis import diagnosis_record
from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH, check_light, check_view
from anisoscope.imaging.quality_gates import beyond_part, check_views
from anisoscope.imaging.views import most_changed
from anisoscope.ink.fitting import RigInk
from anisoscope.kinds.command_output import CommandOutput, Table
from anisoscope.kinds.kind import Explanation, Kind, Results, Sitting
from anisoscope.kinds.parts import (
    Beginning,
    Checking,
    Inked,
    Reference,
    References,
    Reporting,
    Teaching,
    reference_notes,
    usable,
)
from anisoscope.kinds.prints.causes import PRINT_WORDS, explain_print
from anisoscope.kinds.prints.decision import PrintDecision, decide_print, nothing_wrong, print_results
from anisoscope.kinds.prints.expectation import PrintExpectation
from anisoscope.kinds.prints.lighting import (
    check_filters,
    check_print_rig,
    expectation_of_print,
    from_copies,
    lamp_and_sensitivities,
    print_files,
)
from anisoscope.kinds.prints.measurement import (
    MeasuredPrint,
    check_print_dirt,
    check_print_follows,
    measure_print,
    region_mean,
)
from anisoscope.kinds.prints.recipe import OF_INK, UNSTATED, PrintDefects, PrintRecipe
from anisoscope.kinds.prints.record import PrintDetails, print_of
from anisoscope.kinds.prints.reference_comparison import lot_scatter
from anisoscope.kinds.prints.reference_prints import (
    GoldenPrints,
    ViewingConditions,
    conditions_on,
    read_golden_prints,
)
from anisoscope.kinds.recipe_check import RecipeCheck
from anisoscope.parameters.new_recipe import NewRecipe
from anisoscope.recipe.teaching import Taught
from anisoscope.record.schema import DiagnosisRecord, Record
from anisoscope.report.inspection_page import Pictures, Sections
from anisoscope.rig.rigfile import RigFile

# matplotlib comes with the report's sections, which are imported on demand


def _brightness(measured: MeasuredPrint) -> FloatArray:
    """(1, rows, cols) mean of all poses and channels, each cell as wide as a pitch of ridges.

    A dark ink is as dark as a plate in some poses.
    """
    mean = measured.cells.mean(axis=(0, 1))[None]
    return np.asarray(mean.repeat(CELLS_PER_PITCH, axis=1).repeat(CELLS_PER_PITCH, axis=2))


class Prints(
    Kind[PrintRecipe, PrintExpectation, MeasuredPrint, PrintDecision],
    References,
    Beginning,
    Teaching,
    Checking,
    Reporting,
    Inked,
):
    """Prints: colours of the poses, the lobe of the flakes, and the map of local differences."""

    name = "prints"
    one = "a print"
    reference_set = GoldenPrints

    @property
    def recipe(self) -> type[PrintRecipe]:
        """The model of its recipe."""
        return PrintRecipe

    @property
    def details(self) -> type[PrintDetails]:
        """Colours, quantities, lobe and map."""
        return PrintDetails

    def recognises(self, table: Mapping[str, Any]) -> bool:
        """Its recipe has a table [print]."""
        return "print" in table

    def check(self, recipe: PrintRecipe, rig: RigFile, recipe_path: Path, rig_path: Path) -> None:
        """Check that the rig file states lamp spectrum and sensitivities."""
        super().check(recipe, rig, recipe_path, rig_path)
        check_print_rig(rig, rig_path)

    def as_recorded(self, recipe: PrintRecipe, recorded: Mapping[str, Any]) -> PrintRecipe:
        """A record that states no sizes of defects was judged without their limits, and its cells by ΔE alone.

        Uncertainties of the ink are the recorded ones: recipes stated them before ink files did.
        """
        recipe = super().as_recorded(recipe, recorded)
        then = recorded.get("print", {})
        stated = {f"u_{name}": then[f"u_{name}"] for name in OF_INK if then.get(f"u_{name}") is not None}
        recipe = recipe.model_copy(update={"print": recipe.print.model_copy(update=stated)})
        if recipe.area is not None and "scatters" not in (recorded.get("area") or {}):
            recipe = recipe.model_copy(update={"area": recipe.area.model_copy(update={"scatters": 0.0})})
        if "defects" in recorded:
            return recipe
        return recipe.model_copy(update={"defects": PrintDefects(**dict.fromkeys(PrintDefects.model_fields))})

    def sources(self, recipe: PrintRecipe, rig: RigFile) -> Mapping[str, Path]:
        """Inks and spectra."""
        return print_files(recipe, rig)

    def from_copies(
        self, recipe: PrintRecipe, rig: RigFile, copies: Mapping[str, Path]
    ) -> tuple[PrintRecipe, RigFile]:
        """Recipe and rig with the copies of inks and spectra."""
        return from_copies(recipe, rig, copies)

    def check_filters(self, filters: str, camera: str, of_flat: str) -> None:
        """Check that the camera has colour filters, and that its flat was recorded through the same ones."""
        check_filters(filters, camera, of_flat)

    def predict(self, recipe: PrintRecipe, rig: RigFile, *, cached: bool) -> PrintExpectation:
        """The channels of the poses; they are predicted quickly, and never cached."""
        del cached
        return expectation_of_print(recipe, rig)

    def measure(
        self, sitting: Sitting, recipe: PrintRecipe, expected: PrintExpectation
    ) -> tuple[MeasuredPrint, float]:
        """Channels of the poses."""
        recipe = sitting.calibrated(recipe)
        views, filters, pixel_um = sitting.views, sitting.frames.filters, sitting.pixel_um
        closing, change = most_changed(
            views, recipe, pixel_um, lambda view: region_mean(view, recipe, filters)
        )
        for view in [*views.poses, *([closing] if closing else [])]:
            check_light(view.stage_deg, view.image, recipe)
            # a tilted arm looks from elsewhere: within a tilt only must the centre stay where it is
            alike = next(first for first in views.poses if first.tilt_deg == view.tilt_deg)
            check_view(view, alike, recipe, pixel_um)
            sitting.calibrations.check_place(view.stage_deg, view.placement, recipe.limits.fixture_um)
        check_views(views.poses)
        measured = measure_print(views.poses, closing, recipe, filters)
        check_print_dirt(views.poses, recipe, filters, expected.eye, measured.channels)
        return replace(measured, unwatched=check_print_follows(views.poses, recipe, pixel_um)), change

    def drift_error(self, measured: MeasuredPrint, recipe: PrintRecipe) -> str | None:
        """Why the measurement is invalid, if the repeated first pose differs too much at the end."""
        found = super().drift_error(measured, recipe)
        return found and found.replace("the part sits tight", "the print lies tight")

    def decide(
        self,
        sitting: Sitting,
        recipe: PrintRecipe,
        expected: PrintExpectation,
        measured: MeasuredPrint,
        reference: Reference | None,
    ) -> PrintDecision:
        """Every quantity against its limit, all channels together, and the area that deviates."""
        recipe = sitting.calibrated(recipe)
        return decide_print(expected, measured, recipe, cast("GoldenPrints | None", usable(reference)))

    def results(
        self,
        sitting: Sitting,
        recipe: PrintRecipe,
        expected: PrintExpectation,
        measured: MeasuredPrint,
        decided: PrintDecision,
        reference: Reference | None,
    ) -> Results:
        """Results for the record."""
        names = (lamp_and_sensitivities(sitting.rig)[1].name, sitting.frames.filters)
        notes = (*measured.unwatched, *reference_notes(reference))
        if recipe.print.lacks_uncertainty(expected.scene.ink):
            notes += (UNSTATED,)
        return print_results(expected, decided, names, notes)

    def diagnose(
        self,
        sitting: Sitting,
        recipe: PrintRecipe,
        expected: PrintExpectation,
        measured: MeasuredPrint,
        decided: PrintDecision,
        reference: Reference | None,
        advance: Advance = silent,
        *,
        cached: bool = False,
    ) -> Explanation:
        """The causes; notes where the region leaves the sheet, and where no diagnosis is possible.

        Missing ink at a corner looks like what is beyond the sheet, so that the verdict stands.
        """
        del reference, cached
        advance("causes", 0, 1)
        recipe = sitting.calibrated(recipe)
        alpha = recipe.decision.alpha
        if nothing_wrong(decided, alpha):
            return Explanation(DiagnosisRecord(says="nothing: the print is as it should be"))
        edges = beyond_part(_brightness(measured), measured.grid, recipe)
        notes = () if edges is None else (edges,)
        try:
            found = explain_print(recipe, expected, measured, decided)
        except (AnisoscopeError, ArithmeticError, ValueError, np.linalg.LinAlgError) as problem:
            return Explanation(
                DiagnosisRecord(says="not possible"), notes=(*notes, f"no diagnosis: {problem}")
            )
        return Explanation(diagnosis_record(found, alpha, "print"), notes=notes)

    def read_reference(
        self, path: Path, recipe: PrintRecipe, rig: RigFile | None = None
    ) -> GoldenPrints | None:
        """The golden prints."""
        return read_golden_prints(path, recipe, rig)

    def conditions_on(self, recipe: PrintRecipe, rig: RigFile, filters: str) -> ViewingConditions:
        """Ink, lamp, sensitivities and colour filters."""
        return conditions_on(recipe, rig, filters)

    def lot_scatter(
        self,
        known: Any,  # noqa: ANN401
        recipe: PrintRecipe,
        rig: RigFile,
    ) -> LotScatter:
        """What is fitted to the prints, and the form in which sheets of an ink scatter."""
        return lot_scatter(known.logs(), recipe, expectation_of_print(recipe, rig))

    def show_reference(
        self,
        known: Any,  # noqa: ANN401
        recipe: PrintRecipe,
        light_angle_deg: float = 10.0,
    ) -> CommandOutput:
        """Golden prints, and how much they vary."""
        del light_angle_deg
        from anisoscope.kinds.prints.reference_prints import reference_table

        return reference_table(known, recipe)

    def makes(self, requested: NewRecipe) -> bool:
        """A recipe with an ink."""
        return requested.ink is not None

    def new_recipe(self, out: Path, requested: NewRecipe) -> str:
        """Write the recipe of a print."""
        from anisoscope.kinds.prints.recipe import write_new_recipe

        write_new_recipe(out, requested)
        return "[print], [acquisition] and [region]"

    def ink_of(self, inspections: Sequence[tuple[str, Record, PrintRecipe, RigFile]], name: str) -> RigInk:
        """The ink of good prints."""
        from anisoscope.kinds.prints.rig_ink import ink_of_inspections

        return ink_of_inspections(inspections, name)

    def taught_limits(
        self, record: Record, recipe: PrintRecipe, reference: Reference | None, rig: RigFile
    ) -> dict[tuple[str, ...], tuple[Any, str]]:
        """Tolerances from the golden prints, or from this print while those are too few."""
        from anisoscope.kinds.prints.tolerances import golden_tolerances, taught_tolerances

        details = print_of(record)
        if details is None or details.lobe is None:
            raise MeasurementError("hardly anything is printed there: the recipe stays as it is")
        golden = cast("GoldenPrints | None", usable(reference))
        if golden is None:
            found = taught_tolerances(record, recipe)
        else:
            found = golden_tolerances(golden, recipe, expectation_of_print(recipe, rig))
        return {("tolerances", key): (one.value, one.why) for key, one in found.items()}

    def teach_by_reference(
        self, recipe_path: Path, rig_path: Path, share: float, source: Path | None = None
    ) -> Taught:
        """Write a new version of the recipe with the tolerances that its golden prints teach."""
        from anisoscope.kinds.prints.tolerances import teach_by_golden

        if source is not None:
            raise UsageError(
                f"{recipe_path}: tolerances of prints are taught by their own golden prints: leave --golden-of out"
            )
        return teach_by_golden(recipe_path, rig_path, share)

    def capability(
        self,
        recipe: PrintRecipe,
        rig: RigFile | None,
        light_angle_deg: float,
        tries: Sequence[float],
        advance: Advance,
    ) -> RecipeCheck:
        """Poses, quantities with u, and separability of causes; without a rig file for a synthetic lamp and camera."""
        from anisoscope.kinds.prints.recipe_check import checked_print

        del tries
        return checked_print(recipe, rig, light_angle_deg, advance)

    def pictures(
        self,
        recipe: PrintRecipe,
        expected: PrintExpectation,
        measured: MeasuredPrint,
        decided: PrintDecision,
    ) -> Pictures:
        """Cells in the colours of the eye, and the maps."""
        from anisoscope.kinds.prints.report import print_pictures

        del recipe
        return Pictures(of_kind=print_pictures(expected, measured, decided))

    def sections(self, record: Record, pictures: Pictures) -> Sections:
        """Colours, quantities, lobe, maps and budget."""
        from anisoscope.kinds.prints.report import print_sections

        return print_sections(record, pictures)

    @property
    def cause_words(self) -> Mapping[str, CauseWords]:
        """The causes of prints in plain words."""
        return PRINT_WORDS

    def finding(self, record: Record) -> str:
        """The quantity, or the area, that is most off, by its limit."""
        found = print_of(record)
        if found is None or not found.quantities:
            return super().finding(record)
        worst = max(found.quantities, key=lambda one: abs(one.deviation) / one.limit)
        ratio = abs(worst.deviation) / worst.limit
        if (
            record.verdict == "FAIL"
            and ratio < 1.0
            and (found.map is None or found.map.share < found.map.max_share)
        ):
            return record.reasons[0][0].upper() + record.reasons[0][1:]
        if found.map is not None and found.map.share / found.map.max_share > max(ratio, 1.0):
            limit = 100.0 * found.map.max_share
            return f"{100.0 * found.map.share:.1f} % of the area deviates (limit {limit:g} %)"
        return f"Largest deviation: {worst.title}, {ratio:.2g} times its limit"

    def summary(self, record: Record) -> CommandOutput:
        """Table of the judged quantities."""
        from anisoscope.kinds.prints.report import quantity_row

        found = print_of(record)
        # keys of all kinds, from the time when there was one list of them
        content: dict[str, Any] = {
            "contrasts": [],
            "between_tilts": [],
            "area": None,
            "regions": [],
            "comparisons": [],
            "reading": None,
            "shape": None,
            "golden_parts": 0,
            "map_place": None,
            "print": None if found is None else found.model_dump(),
        }
        if found is None:
            return CommandOutput(content)
        rows = [quantity_row(one) for one in found.quantities]
        table = Table(
            f"{record.serial}: {record.product}",
            ["quantity", "measured", "nominal", "off by", "u", "limit", ""],
            [
                [row.title, row.value, row.nominal, row.deviation, row.u, row.limit, row.verdict]
                for row in rows
            ],
            ". ".join(found.not_judged) or None,
        )
        return CommandOutput(content, (table,))


PRINTS = Prints()
