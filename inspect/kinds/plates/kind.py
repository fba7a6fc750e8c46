"""Plates with fields of several ridge directions as a kind of part."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

import numpy as np

from anisoscope.base.cause_words import CauseWords
from anisoscope.base.covariance import root
from anisoscope.base.errors import AnisoscopeError, RecipeError, UsageError
from anisoscope.base.notation import number_name
from anisoscope.base.progress import Advance, silent
from anisoscope.base.significance import two_sided_score
from anisoscope.decision.exclusion import MORE_TILTS
from anisoscope.imaging.pose_radiance import mean_of
from anisoscope.imaging.registration.placement import resample
from anisoscope.imaging.views import most_changed
from anisoscope.kinds.command_output import CommandOutput, Table
from anisoscope.kinds.kind import Explanation, Kind, Results, Sitting
from anisoscope.kinds.parts import (
    Beginning,
    Checking,
    Reference,
    References,
    Reporting,
    Tolerances,
    usable,
    without_tolerances,
)
from anisoscope.kinds.plates.causes import FIELD_WORDS, explain_plate, plate_words
from anisoscope.kinds.plates.code_grades import OVERALL
from anisoscope.kinds.plates.decision import (
    PlateDecision,
    contrast_pairs,
    decide_plate,
    planned_contrasts,
    planned_covariance,
)
from anisoscope.kinds.plates.excluded_fields import planned_fields
from anisoscope.kinds.plates.expectation import ExpectedPlate, expected_plate
from anisoscope.kinds.plates.field_judgement import fields_text, places_text, predicted_fields
from anisoscope.kinds.plates.measurement import MeasuredPlate, measure_plate, plate_grid
from anisoscope.kinds.plates.plate_map import HEIGHT_MAP
from anisoscope.kinds.plates.recipe import PlateDefects, PlateRecipe
from anisoscope.kinds.plates.record import CodeRecord, GradeRecord, PlateDetails
from anisoscope.kinds.plates.reference_plates import GoldenPlates, reference_table
from anisoscope.kinds.recipe_check import RecipeCheck
from anisoscope.parameters.new_recipe import NewRecipe
from anisoscope.record.schema import ConclusionRecord, DiagnosisRecord, Record
from anisoscope.report.inspection_page import Pictures, Sections
from anisoscope.rig.rigfile import RigFile

PLAN = "plan"
MOST_UNDECIDED = 0.01
"""Share of good plates whose classes may end undecided before a recipe is complained of."""
MOST_LISTED, DRAWN = 12, 20000
RULE = (
    "FAIL where a contrast between classes or poses is out of its tolerance by more than the guard band, where more "
    "fields deviate from their class than the recipe allows, or where the code is not read"
)


@dataclass(frozen=True, kw_only=True)
class PlateCheck(RecipeCheck):
    """Capability of the recipe of a plate.

    Attributes:
        contrasts: of classes and poses, with what is predicted, its standard uncertainty, and T/U, the least first.
        undecided: share of good plates that are not sure to be within the tolerance; None without a tolerance.
    """

    contrasts: tuple[tuple[str, float, float, float | None], ...]
    undecided: float | None

    def tables(self) -> tuple[Table, ...]:
        """The contrasts, those whose tolerance is closest to their uncertainty first."""
        rows = [
            [number_name(name), f"{due:+.3f}", f"{u:.3f}", "–" if ratio is None else f"{ratio:.1f}"]
            for name, due, u, ratio in self.contrasts[:MOST_LISTED]
        ]
        hidden = len(self.contrasts) - len(rows)
        caption = f"{hidden} more contrasts have a larger T/U" if hidden else None
        return (Table(self.product, ["contrast", "predicted", "u", "T/U"], rows, caption),)

    def notes(self) -> tuple[str, ...]:
        """Share of good plates that end undecided."""
        if self.undecided is None:
            return super().notes()
        return (
            *super().notes(),
            f"{self.undecided:.1%} of good plates end undecided by their classes",
        )


class Plates(
    Kind[PlateRecipe, ExpectedPlate, MeasuredPlate, PlateDecision],
    References,
    Beginning,
    Checking,
    Tolerances,
    Reporting,
):
    """Plates: contrasts between the classes of their fields, single fields, and the code that they make."""

    name = "plates"
    one = "a plate"

    @property
    def recipe(self) -> type[PlateRecipe]:
        """The model of its recipe."""
        return PlateRecipe

    @property
    def details(self) -> type[PlateDetails]:
        """Classes, contrasts, fields and code."""
        return PlateDetails

    def recognises(self, table: Mapping[str, Any]) -> bool:
        """Its recipe has a table [plan]."""
        return "plan" in table

    def read_copy(self, path: Path, copies: Mapping[str, Path]) -> PlateRecipe:
        """Read the copy of a recipe with the copy of its plan, wherever the plan was."""
        found = PlateRecipe.parsed(path)
        if PLAN in copies:
            plan = found.plan.model_copy(update={"file": copies[PLAN]})
            found = found.model_copy(update={"plan": plan})
        found.check_named(path)
        return found

    def sources(self, recipe: PlateRecipe, rig: RigFile) -> Mapping[str, Path]:
        """The files of plan, height map and material.

        Raises:
            RecipeError: plan or height map is missing.
        """
        del rig
        named = {
            "material": recipe.material.file,
            PLAN: recipe.plan.file,
            HEIGHT_MAP: recipe.surface.height_map,
        }
        found = {role: path for role, path in named.items() if path is not None}
        for role, path in found.items():
            if role != "material" and not path.is_file():
                raise RecipeError(f"{path}: there is no such file of a {role.replace('_', ' ')}")
        return found

    def from_copies(
        self, recipe: PlateRecipe, rig: RigFile, copies: Mapping[str, Path]
    ) -> tuple[PlateRecipe, RigFile]:
        """The recipe with the copy of its height map."""
        if HEIGHT_MAP in copies:
            surface = recipe.surface.model_copy(update={"height_map": copies[HEIGHT_MAP]})
            recipe = recipe.model_copy(update={"surface": surface})
        return recipe, rig

    def as_recorded(self, recipe: PlateRecipe, recorded: Mapping[str, Any]) -> PlateRecipe:
        """A record that states no sizes of defects was judged without their limits."""
        recipe = super().as_recorded(recipe, recorded)
        if "defects" in recorded:
            return recipe
        return recipe.model_copy(update={"defects": PlateDefects(**dict.fromkeys(PlateDefects.model_fields))})

    def predict(self, recipe: PlateRecipe, rig: RigFile, *, cached: bool) -> ExpectedPlate:
        """The radiances of the classes."""
        rig.light.check_distance(recipe.region.size_mm, 2.0 * recipe.uncertainty.seating_tilt_deg)
        return expected_plate(recipe, recipe.plan.plan(), rig.light.angle_deg, cached=cached)

    def measure(
        self, sitting: Sitting, recipe: PlateRecipe, expected: ExpectedPlate
    ) -> tuple[MeasuredPlate, float]:
        """Means of the fields, after the gates of markers, light and plan."""
        views, pixel_um = sitting.views, sitting.pixel_um
        grid, _ = plate_grid(recipe, expected.plan, pixel_um)
        closing, change = most_changed(
            views, recipe, pixel_um, lambda view: mean_of(resample(view.image.value, view.placement, grid))
        )
        for view in views.poses:
            sitting.calibrations.check_place(view.stage_deg, view.placement, recipe.limits.fixture_um)
        return measure_plate(views.poses, closing, recipe, expected, pixel_um), change

    def decide(
        self,
        sitting: Sitting,
        recipe: PlateRecipe,
        expected: ExpectedPlate,
        measured: MeasuredPlate,
        reference: Reference | None,
    ) -> PlateDecision:
        """Contrasts of the classes, single fields, and the code."""
        del sitting
        return decide_plate(expected, measured, recipe, cast("GoldenPlates | None", usable(reference)))

    def results(
        self,
        sitting: Sitting,
        recipe: PlateRecipe,
        expected: ExpectedPlate,
        measured: MeasuredPlate,
        decided: PlateDecision,
        reference: Reference | None,
    ) -> Results:
        """Results for the record."""
        del sitting, recipe, expected, measured
        lacking = reference and reference.lacking
        return Results(
            decided.radiance,
            decided.predicted,
            decided.details,
            decided.budget,
            decided.d2,
            decided.dof,
            decided.p_value,
            notes=(f"golden plates: {lacking}",) if lacking else (),
        )

    def diagnose(
        self,
        sitting: Sitting,
        recipe: PlateRecipe,
        expected: ExpectedPlate,
        measured: MeasuredPlate,
        decided: PlateDecision,
        reference: Reference | None,
        advance: Advance = silent,
        *,
        cached: bool = False,
    ) -> Explanation:
        """Diagnosis of single fields and of the plate as a whole."""
        del sitting, reference, cached
        advance("causes", 0, 1)
        try:
            return Explanation(explain_plate(recipe, expected, measured, decided))
        except (AnisoscopeError, ArithmeticError, ValueError, np.linalg.LinAlgError) as problem:
            return Explanation(DiagnosisRecord(says="not possible"), notes=(f"no diagnosis: {problem}",))

    @property
    def cause_words(self) -> Mapping[str, CauseWords]:
        """Defects of fields, and causes of the whole plate."""
        return plate_words()

    def conclude(self, record: Record) -> ConclusionRecord:
        """The verdict in plain words, with the places of the fields that fail."""
        found, details = super().conclude(record), record.details
        causes = () if record.diagnosis is None else record.diagnosis.causes[:1]
        names = [one.cause for cause in causes for one in (cause.components or (cause,))]
        fields = [one for one in getattr(details, "fields", ()) if one.verdict == "FAIL"]
        if record.verdict != "FAIL" or not fields or not names or not set(names) <= FIELD_WORDS.keys():
            return found
        places = places_text(fields)
        return found.model_copy(update={"finding": f"{found.finding} The fields are at {places}."})

    def nominal(self, record: Record) -> Mapping[str, float]:
        """The ridge angle of the design."""
        return {"ridge-angle": float(record.recipe["surface"]["design"]["ridge_angle_deg"])}

    reference_set = GoldenPlates

    def show_reference(
        self,
        known: Any,  # noqa: ANN401 - golden plates
        recipe: PlateRecipe,
        light_angle_deg: float = 10.0,
    ) -> CommandOutput:
        """Golden plates, and how much they vary."""
        del recipe, light_angle_deg
        return reference_table(known)

    def without_results(self) -> PlateDetails:
        """No contrasts."""
        return PlateDetails()

    def new_recipe(self, out: Path, requested: NewRecipe) -> str:
        """Refuse: a plate begins with its plan.

        Raises:
            UsageError: always.
        """
        del out, requested
        raise UsageError(
            "the recipe of a plate begins with its plan: `anisoscope design code TEXT --out FOLDER` writes both for a "
            "code; for another plan write the table [plan] by hand (docs/plates.md)"
        )

    def tolerances(self, recipe: PlateRecipe) -> dict[str, float]:
        """One tolerance for all contrasts.

        Raises:
            UsageError: the recipe gives none.
        """
        if recipe.decision.tolerance is None:
            raise UsageError(without_tolerances(recipe))
        names, _ = contrast_pairs(recipe.plan.plan().letters, recipe.poses.poses())
        return dict.fromkeys(names, recipe.decision.tolerance)

    def capability(
        self,
        recipe: PlateRecipe,
        rig: RigFile | None,
        light_angle_deg: float,
        tries: Sequence[float],
        advance: Advance,
    ) -> RecipeCheck:
        """Whether contrasts can be judged, and light and dark fields differ in the poses in which the code is read."""
        del rig, tries, advance
        expected = expected_plate(recipe, recipe.plan.plan(), light_angle_deg, cached=True)
        names, due, covariance = planned_contrasts(expected, recipe)
        tolerance, coverage, undecided = recipe.decision.tolerance, recipe.decision.coverage, None
        u, ratios = np.sqrt(np.diag(covariance)), list[float | None]([None] * len(due))
        complaints = []
        if tolerance is None:
            complaints.append("no tolerance of the classes: every significant deviation fails the plate")
        else:
            ratios = (tolerance / (2.0 * u)).tolist()
            drawn = np.random.default_rng(0).standard_normal((DRAWN, len(due))) @ root(covariance)
            undecided = float(np.mean(np.any(np.abs(drawn) > tolerance - coverage * u, axis=1)))
            if undecided > MOST_UNDECIDED:
                needed = float(u.max()) * (coverage + two_sided_score(MOST_UNDECIDED / len(u)))
                complaints.append(
                    f"{undecided:.0%} of good plates may end undecided: decision.tolerance = {needed:.2g} would "
                    "be enough, or less uncertainty of plastic and seat"
                )
        for number, pose in enumerate(expected.poses):
            light = expected.radiance[:, number]
            share = 1.0 - float(light.min() / light.max())
            if recipe.code is not None and pose.stage_deg in recipe.code.read_at_deg and share < 0.3:
                complaints.append(
                    f"at {pose.stage_deg:g}° dark fields are only {share:.0%} darker than light ones: the code may not "
                    "be read; take other directions of the classes, or a larger ridge angle"
                )
        order = np.argsort(-u, kind="stable")
        contrasts = tuple((names[n], float(due[n]), float(u[n]), ratios[n]) for n in order)
        return PlateCheck(
            product=recipe.product,
            complaints=tuple(complaints),
            contrasts=contrasts,
            undecided=undecided,
            excludes=planned_fields(
                expected, recipe, planned_covariance(expected, recipe) if tolerance is None else None
            ),
            remedy=MORE_TILTS,
        )

    def finding(self, record: Record) -> str:
        """Fields that deviate, the code, or the contrast that is most off."""
        found = record.details
        if not isinstance(found, PlateDetails) or not found.contrasts:
            return super().finding(record)
        dead = [one for one in found.fields if one.verdict == "FAIL"]
        worst = max(found.contrasts, key=lambda one: abs(one.measured - one.predicted))
        if dead and (worst.tolerance is None or abs(worst.measured - worst.predicted) < worst.tolerance):
            return fields_text(dead)
        if found.code is not None and found.code.unread and worst.verdict != "FAIL":
            text = repr(found.code.text)
            return f"The code is not read as {text}"
        name, off, spread = worst.title, worst.measured - worst.predicted, 2.0 * worst.u
        if worst.tolerance is None:
            return f"Largest deviation: {name} is off by {off:+.3f} ± {spread:.2f} (no tolerance set)"
        return (
            f"Largest deviation: {name} is off by {off:+.3f} ± {spread:.2f} (tolerance ±{worst.tolerance:g})"
        )

    def pictures(
        self, recipe: PlateRecipe, expected: ExpectedPlate, measured: MeasuredPlate, decided: PlateDecision
    ) -> Pictures:
        """The plate as seen and as predicted, the differences of its fields, and those that deviate outlined."""
        return Pictures(
            aligned=measured.aligned,
            size_mm=recipe.plan.plan().size_mm[::-1],
            predicted=predicted_fields(expected),
            predicted_text="every field with the radiance of its class",
            differences=decided.deviation,
            difference_text="ln of measured over predicted, by field, less that of the whole plate",
            deviating=np.kron(decided.deviating, np.ones((2, 2), dtype=bool))
            if decided.deviating.any()
            else None,
            surface=None,
        )

    def sections(self, record: Record, pictures: Pictures) -> Sections:
        """Contrasts, fields, and the code with its grades."""
        del pictures
        found = record.details
        if not isinstance(found, PlateDetails) or not found.contrasts:
            return Sections()
        source = (
            files("anisoscope.kinds.plates").joinpath("templates/inspection_plate.html").read_text("utf-8")
        )
        poses = [
            f"{one.stage_deg:g}°" + (f", tilt {one.tilt_deg:g}°" if one.tilt_deg else "")
            for one in record.poses
        ]
        graded = [] if found.code is None else grade_rows(found.code)
        content = {"plate": found, "plate_poses": poses, "plate_grades": graded}
        return Sections(rule=RULE, before=source, content=content)

    def summary(self, record: Record) -> CommandOutput:
        """Contrasts and deviating fields."""
        found = record.details
        if not isinstance(found, PlateDetails):
            return CommandOutput({"plate": None})
        if not found.contrasts:
            return CommandOutput({"plate": found.model_dump(mode="json")})
        rows = [
            [
                one.title,
                f"{one.measured:+.3f}",
                f"{one.predicted:+.3f}",
                f"{one.measured - one.predicted:+.3f}",
                f"{one.u:.3f}",
                "–" if one.tolerance is None else f"±{one.tolerance:g}",
                "" if one.tolerance is None else one.verdict,
            ]
            for one in found.listed
        ]
        columns = ["contrast", "measured", "predicted", "deviation", "u", "tolerance", ""]
        hidden = len(found.contrasts) - len(rows)
        caption = f"{hidden} more contrasts pass, or deviate less" if hidden else None
        tables = [Table(f"{record.serial}: {record.product}", columns, rows, caption)]
        if found.fields:
            listed = [
                [
                    f"{one.row + 1}, {one.col + 1}",
                    one.direction_class,
                    f"{max(one.deviations, key=abs):+.2f}",
                    one.likeness or "–",
                    one.verdict,
                ]
                for one in found.fields
            ]
            tables.append(
                Table("fields that deviate", ["row, column", "class", "ln ratio", "looks like", ""], listed)
            )
        return CommandOutput({"plate": found.model_dump(mode="json")}, tuple(tables), code_lines(found))


def code_lines(found: PlateDetails) -> tuple[str, ...]:
    """Lines of the code's text, its grades, and the sensitivity of the test of single fields."""
    code, lines = found.code, []
    if code is not None:
        read = ", ".join("not read" if one is None else repr(one) for one in code.readings)
        kind = code.symbology
        lines.append(f"{kind} at the poses in turn: {read}")
        lines += grade_lines(code)
    if found.powers:
        powers = ", ".join(f"{one.defect} {one.power:.0%}" for one in found.powers)
        lines.append(f"probability that a single field with a defect is found: {powers}")
    return tuple(lines)


def grade_rows(code: CodeRecord) -> list[tuple[str, list[GradeRecord]]]:
    """Parameters, each with its grade at every pose in which the code must be read."""
    names = dict.fromkeys(one.parameter for one in code.grades)
    return [(name, [one for one in code.grades if one.parameter == name]) for name in names]


def grade_lines(code: CodeRecord) -> list[str]:
    """Overall grade of every pose, and the parameters that bound it."""
    lines = list[str]()
    for stage in dict.fromkeys(one.stage_deg for one in code.grades):
        parts = {one.parameter: one for one in code.grades if one.stage_deg == stage}
        if OVERALL not in parts:  # a record of an earlier version
            continue
        whole = parts.pop(OVERALL)
        grade, due = whole.measured_grade, whole.predicted_grade
        weak = ", ".join(one.parameter for one in parts.values() if one.measured_grade < 4)
        if weak:
            lines.append(f"at {stage:g}°: overall grade {grade}, predicted {due}, bounded by {weak}")
        else:
            lines.append(f"at {stage:g}°: overall grade {grade}, predicted {due}")
    return lines


PLATES = Plates()
