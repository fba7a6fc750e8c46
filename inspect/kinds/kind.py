"""Interface of a kind of part: recipe, prediction, measurement, decision, diagnosis and report.

The one pipeline of inspections, the records, the report and the command line ask a kind through this class alone. A
kind of a third party subclasses it and registers an instance under the entry point group ``anisoscope.kinds``; see
docs/own-kind.md.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cause_words import CauseWords
from anisoscope.base.errors import CalibrationError, RecipeError, UsageError
from anisoscope.base.notation import present_notation
from anisoscope.base.progress import Advance, silent
from anisoscope.base.toml_file import read_toml_model
from anisoscope.calibration.corrections import Calibrations
from anisoscope.decision.equipment import Equipment
from anisoscope.decision.reference_parts import AnyReferenceSet, RadianceSet, ReferenceSet, golden_path
from anisoscope.imaging.deviation_map import CellMap
from anisoscope.imaging.frames import AcquiredFrames
from anisoscope.imaging.pose_radiance import drift_error
from anisoscope.imaging.views import Guide, Views
from anisoscope.kinds.command_output import CommandOutput, Table
from anisoscope.kinds.recipe_check import RecipeCheck
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.base import RecipeBase, check_region
from anisoscope.recipe.logo import check_logo
from anisoscope.recipe.new_recipe import NewRecipe
from anisoscope.recipe.poses import check_poses
from anisoscope.recipe.teaching import Taught
from anisoscope.record.details import Details
from anisoscope.record.schema import BudgetRecord, ConclusionRecord, DiagnosisRecord, Record
from anisoscope.record.verdict import Verdict
from anisoscope.report.conclusion import OUTCOMES, concluded
from anisoscope.report.inspection_page import Pictures, Sections
from anisoscope.rig.rigfile import RigFile, check_arm, read_replay_rig


class Expected(Protocol):
    """A prediction, as far as all kinds have it in common."""

    @property
    def model(self) -> str:
        """The name of the reflectance model."""
        ...

    @property
    def optics(self) -> dict[str, Any] | None:
        """Rays or waves, and why; None where this was no question."""
        ...

    @property
    def convention(self) -> Convention:
        """How the angles are counted."""
        ...

    @property
    def surface(self) -> HeightMap | None:
        """The height map behind the prediction, or None."""
        ...

    @property
    def poses(self) -> tuple[Pose, ...]:
        """The poses that were predicted."""
        ...


class Measured(Protocol):
    """A measurement, as far as all kinds have it in common."""

    @property
    def drift(self) -> float | None:
        """Relative change of the first pose until the end, or None where it was photographed once."""
        ...


class Decided(Protocol):
    """A verdict, as far as all kinds have it in common."""

    @property
    def verdict(self) -> Verdict:
        """Of the part."""
        ...

    @property
    def reasons(self) -> tuple[str, ...]:
        """One line each, most important first."""
        ...


class Reference(Protocol):
    """A set of good parts."""

    @property
    def parts(self) -> Sequence[Any]:
        """One row a part."""
        ...

    @property
    def lacking(self) -> str | None:
        """Why they cannot serve as a reference yet, or None if they can."""
        ...

    @property
    def noun(self) -> str:
        """Word for one of them, such as "golden part"."""
        ...

    def without(self, serial: str) -> Self:
        """The set without the rows of a serial number.

        Raises:
            CalibrationError: there is none.
        """
        ...


WITHOUT_DEVICES = (
    "the rig file describes no devices: whether stage and camera arm reach the poses, and whether the flat is that of "
    "the camera"
)

RecipeT = TypeVar("RecipeT", bound=RecipeBase)
ExpectedT = TypeVar("ExpectedT", bound=Expected)
MeasuredT = TypeVar("MeasuredT", bound=Measured)
DecidedT = TypeVar("DecidedT", bound=Decided)


@dataclass(frozen=True, eq=False)
class Sitting:
    """The photographs of a part and by what they are measured.

    Attributes:
        views: one linear picture a pose, with the place of the part in it.
        frames: the raw frames and their camera.
        calibrations: of the rig.
        rig: the rig file.
    """

    views: Views
    frames: AcquiredFrames
    calibrations: Calibrations
    rig: RigFile

    @property
    def pixel_um(self) -> float:
        """Size of a camera pixel on the sample according to the rig file."""
        return self.rig.camera.pixel_um


@dataclass(frozen=True, eq=False)
class Results:
    """Results of measurement and verdict for the record.

    Attributes:
        measured, predicted: (P,) radiances of the poses in 1/sr.
        details: what is of this kind alone.
        budget: sources of uncertainty, the largest first.
        d2, dof, p_value: squared Mahalanobis distance from what is expected, its degrees of freedom, and the
            probability of a larger one; None where the kind has none.
        conformance_probability: that all deviations truly lie within their tolerances, or None.
        notes: what the user should know besides.
    """

    measured: FloatArray
    predicted: FloatArray
    details: Details
    budget: tuple[BudgetRecord, ...] = ()
    d2: float | None = None
    dof: int | None = None
    p_value: float | None = None
    conformance_probability: float | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Explanation:
    """What explains a verdict and never changes it: the diagnosis, further fields of the details, and notes."""

    diagnosis: DiagnosisRecord | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def usable(reference: Reference | None) -> Reference | None:
    """The reference set if it has enough good parts, or None."""
    return reference if reference is not None and reference.lacking is None else None


class Kind(ABC, Generic[RecipeT, ExpectedT, MeasuredT, DecidedT]):
    """A kind of part. What has a default here need not be given.

    Attributes:
        name: its name, in recipes (``kind = "…"``) and records.
        one: a part of it in a sentence, such as "a print".
        fallback: recipes that no kind recognises are of this one.
        guides: what is done to pictures before markers and edges are searched in them.
    """

    name: str
    one: str
    fallback: bool = False
    guides: tuple[Guide, ...] = ()

    # ---- the recipe -------------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def recipe(self) -> type[RecipeT]:
        """The model of its recipe."""

    @property
    @abstractmethod
    def details(self) -> type[Details]:
        """Its part of a record."""

    def recognises(self, table: Mapping[str, Any]) -> bool:
        """Whether a recipe without the key ``kind`` is of this kind."""
        del table
        return False

    def read_recipe(self, path: Path) -> RecipeT:
        """Read a recipe; ``${here}`` in it stands for its own folder.

        Raises:
            RecipeError: the file is missing or wrong; the message names file, key and what is expected.
        """
        here = {"here": str(path.resolve().parent)}
        return read_toml_model(path, self.recipe, error=RecipeError, substitutions=here)

    def read_copy(self, path: Path, copies: Mapping[str, Path]) -> RecipeT:
        """Read the copy of a recipe in an inspection folder, where the files that it names are copies, by role.

        Raises:
            RecipeError: as `read_recipe`.
        """
        del copies
        return self.read_recipe(path)

    def check(self, recipe: RecipeT, rig: RigFile, recipe_path: Path, rig_path: Path) -> None:
        """Check that recipe and rig fit each other; nothing moves.

        Raises:
            RecipeError, RigFileError: they do not.
        """
        del rig_path
        self.check_actions(recipe, recipe_path)
        check_logo(recipe, recipe_path)
        check_poses(recipe.poses, rig.light.angle_deg, recipe_path)

    def check_valid(self, recipe: RecipeT, at: datetime) -> None:
        """Check that what the recipe names as calibrated is valid at a time; nothing by default.

        Raises:
            CalibrationError: it has expired: the inspection is INVALID.
        """
        del recipe, at

    def sources(self, recipe: RecipeT, rig: RigFile) -> Mapping[str, Path]:
        """Further files that the inspection starts from, by their role: they are copied and hashed."""
        del recipe, rig
        return {}

    def from_copies(
        self, recipe: RecipeT, rig: RigFile, copies: Mapping[str, Path]
    ) -> tuple[RecipeT, RigFile]:
        """Recipe and rig with the copies of their files in an inspection folder, by role."""
        del copies
        return recipe, rig

    def check_filters(self, filters: str, camera: str, of_flat: str) -> None:
        """Check that the part can be measured through these colour filters.

        Raises:
            CalibrationError: it cannot.
        """

    # ---- from the prediction to the verdict -------------------------------------------------------------------

    @abstractmethod
    def predict(self, recipe: RecipeT, rig: RigFile, *, cached: bool) -> ExpectedT:
        """Prediction of the part; ``cached``: one of the same code from the cache will do."""

    @abstractmethod
    def measure(self, sitting: Sitting, recipe: RecipeT, expected: ExpectedT) -> tuple[MeasuredT, float]:
        """Measurement of the part, through all quality gates, and the change of the first pose on resuming.

        Raises:
            MeasurementError, CameraError: INVALID, with the reason.
        """

    def drift_error(self, measured: MeasuredT, recipe: RecipeT) -> str | None:
        """Why the measurement is invalid, if the repeated first pose differs too much at the end."""
        return drift_error(measured.drift, recipe.limits.drift)

    @abstractmethod
    def decide(
        self,
        sitting: Sitting,
        recipe: RecipeT,
        expected: ExpectedT,
        measured: MeasuredT,
        reference: Reference | None,
    ) -> DecidedT:
        """The verdict; ``reference``: the good parts, also too few of them (`usable`), or None.

        Raises:
            MeasurementError: nothing can be judged: INVALID.
        """

    @abstractmethod
    def results(
        self,
        sitting: Sitting,
        recipe: RecipeT,
        expected: ExpectedT,
        measured: MeasuredT,
        decided: DecidedT,
        reference: Reference | None,
    ) -> Results:
        """Results of measurement and verdict for the record."""

    def kept(self, recipe: RecipeT, measured: MeasuredT) -> Mapping[str, Any] | None:
        """What a changed recipe needs to decide anew (`decide_again`): arrays, numbers and texts by name.

        None, the default, where that takes the frames.
        """
        del recipe, measured
        return None

    def deviations(
        self, kept: Mapping[str, Any], recorded: Mapping[str, Any]
    ) -> tuple[CellMap, float] | None:
        """The map of the cells of a part and the side of a cell in mm; None, the default, where there is none.

        Args:
            kept: from `kept`.
            recorded: the recipe in the record.
        """
        del kept, recorded
        return None

    def needs_frames(self, recorded: Mapping[str, Any], recipe: RecipeT) -> str | None:
        """Why a recipe takes the frames of an inspection that was recorded by another one; None: its numbers will do.

        Args:
            recorded: the recipe in the record.
            recipe: the other one.
        """
        del recorded, recipe
        return f"of {self.one} only the frames are kept"

    def decide_again(
        self, kept: Mapping[str, Any], recipe: RecipeT, expected: ExpectedT, reference: Reference | None
    ) -> tuple[MeasuredT, DecidedT]:
        """Measurement and verdict by another recipe, without the frames; arguments as of `decide`.

        Raises:
            MeasurementError: nothing can be judged: INVALID.
        """
        raise NotImplementedError

    def without_results(self) -> Details | None:
        """The details of an inspection that could not be judged."""
        return None

    def diagnose(
        self,
        sitting: Sitting,
        recipe: RecipeT,
        expected: ExpectedT,
        measured: MeasuredT,
        decided: DecidedT,
        reference: Reference | None,
        advance: Advance = silent,
        *,
        cached: bool = False,
    ) -> Explanation:
        """Diagnosis of the verdict, which it never changes.

        Args:
            sitting: the photographs.
            recipe: the recipe.
            expected: the prediction that decided.
            measured: the measurement.
            decided: the verdict.
            reference: the good parts, also too few of them, or None.
            advance: progress, where that takes long.
            cached: an earlier prediction of the same code will do.
        """
        del sitting, recipe, expected, measured, decided, reference, advance, cached
        return Explanation()

    def as_recorded(self, recipe: RecipeT, recorded: Mapping[str, Any]) -> RecipeT:
        """The recipe with the defaults of the version that recorded, where these have changed.

        Args:
            recipe: as read now from the inspection folder.
            recorded: the recipe in the record, with every default of its version.
        """
        del recorded
        return recipe

    def rename_in(self, record: dict[str, Any]) -> None:
        """Rename entries of a dumped record of an earlier version of this kind to the present names."""
        record["reasons"] = [present_notation(reason) for reason in record["reasons"]]
        if record.get("diagnosis"):
            record["diagnosis"]["says"] = present_notation(record["diagnosis"]["says"])

    # ---- good parts -------------------------------------------------------------------------------------------

    reference_set: type[AnyReferenceSet] | None = None
    """The set of its good parts: `anisoscope.decision.reference_parts.RadianceSet`, or one of its own; None: they are
    not collected."""

    def _set_of(self, recipe: RecipeT) -> type[AnyReferenceSet]:
        if self.reference_set is None:
            raise UsageError(f"{recipe.product}: good parts are not collected of this kind of part")
        return self.reference_set

    def read_reference(self, path: Path, recipe: RecipeT, rig: RigFile | None = None) -> Reference | None:
        """The good parts in a file, or None where there is none.

        Raises:
            CalibrationError: the file is damaged, or belongs to another recipe or rig.
        """
        del rig
        return None if self.reference_set is None else self.reference_set.read(path, recipe)

    def reference_on(
        self, recipe_path: Path, recipe: RecipeT, rig: RigFile, camera: str | None = None
    ) -> Reference | None:
        """The good parts of a recipe, measured with camera, lens and lamp of a rig; None where there are none.

        Args:
            recipe_path: the recipe's file.
            recipe: its content.
            rig: the rig.
            camera: name or serial number of its camera, where that is known.

        Raises:
            CalibrationError: as for `read_reference`, or another camera, lens or lamp.
        """
        path = golden_path(recipe_path)
        found = self.read_reference(path, recipe, rig)
        if isinstance(found, ReferenceSet):
            found.check_equipment(path, Equipment.of_rig(rig, camera))
        return found

    def add_reference(self, known: Any, recipe: RecipeT, record: Record) -> Reference:  # noqa: ANN401
        """A set with one good part more.

        Raises:
            CalibrationError: the inspection cannot teach this set.
            UsageError: good parts are not collected of this kind.
        """
        return self._set_of(recipe).with_inspection(known, recipe, record)

    def show_reference(
        self,
        known: Any,  # noqa: ANN401
        recipe: RecipeT,
        light_angle_deg: float = 10.0,
    ) -> CommandOutput:
        """The good parts for ``anisoscope golden show``: by default those of a `RadianceSet`.

        Args:
            known: the set.
            recipe: the recipe.
            light_angle_deg: the rig's angle between light and camera.
        """
        del light_angle_deg
        self._set_of(recipe)
        return radiance_table(known, recipe)

    def tolerances(self, recipe: RecipeT) -> dict[str, float]:
        """Tolerances of the recipe by the labels of `Details.numbers`, for capability and control charts.

        Raises:
            UsageError: the recipe gives none.
        """
        raise UsageError(f"the recipe of {recipe.product} gives no tolerances: give --lower and --upper")

    # ---- what the commands of recipes ask ---------------------------------------------------------------------

    def makes(self, requested: NewRecipe) -> bool:
        """Whether the options are for a recipe of this kind; where no kind claims them, the fallback writes it."""
        del requested
        return False

    def new_recipe(self, out: Path, requested: NewRecipe) -> str:
        """Write a recipe with comments, valid as written.

        Returns:
            The tables that are to be adapted, in words.

        Raises:
            UsageError: the options contradict each other.
        """
        del out, requested
        raise UsageError(f"there is no recipe of {self.one} to begin with")

    def taught_limits(
        self, record: Record, recipe: RecipeT, reference: Reference | None, rig: RigFile
    ) -> dict[tuple[str, ...], tuple[Any, str]]:
        """Limits that the inspection of a good part teaches, by their keys in the recipe, each with its reason.

        Raises:
            MeasurementError: it teaches none; the recipe stays as it is.
        """
        del record, recipe, reference, rig
        return {}

    def teach_by_reference(
        self, recipe_path: Path, rig_path: Path, share: float, source: Path | None = None
    ) -> Taught:
        """Write a new version of a recipe with what good parts teach of it: limits, or how parts differ.

        Args:
            recipe_path: recipe file.
            rig_path: rig file; no device is opened.
            share: of good parts that should pass all limits, where limits are taught.
            source: another recipe whose good parts teach; None: its own.

        Raises:
            UsageError: good parts do not teach this kind, or there are too few of them.
        """
        del rig_path, share, source
        raise UsageError(
            f"{recipe_path} is the recipe of {self.one}: good parts alone do not teach it, only beside "
            "a part that is inspected, with --serial"
        )

    def check_recipe(
        self,
        path: Path,
        rig_path: Path | None,
        light_angle_deg: float,
        tries: Sequence[float] = (),
        advance: Advance = silent,
    ) -> RecipeCheck:
        """Check of a recipe before inspection; nothing moves.

        Args:
            path: the recipe.
            rig_path: rig file, for its geometry; without one the light is at the given angle.
            light_angle_deg: between light and camera, where there is no rig file.
            tries: tilts that might be added, degrees.
            advance: progress.

        Raises:
            RecipeError, RigFileError: recipe and rig do not fit each other, or nothing can be predicted.
        """
        recipe = self.read_recipe(path)
        if rig_path is None:
            self.check_actions(recipe, path)
            check_logo(recipe, path)
            check_poses(recipe.poses, light_angle_deg, path)
            return self.capability(recipe, None, light_angle_deg, tries, advance)
        rig = read_replay_rig(rig_path, recipe.acquisition.light_channel)
        self.check(recipe, rig, path, rig_path)
        check_region(recipe, rig.fixture, path)
        try:
            self.reference_on(path, recipe, rig)
        except CalibrationError as error:  # nothing is judged here: no exit code of a verdict
            raise RecipeError(str(error)) from error
        if not rig.without_devices:
            check_arm(rig, [pose.tilt_deg for pose in recipe.poses.poses()])
        found = self.capability(recipe, rig, rig.light.angle_deg, tries, advance)
        return replace(found, unchecked=WITHOUT_DEVICES) if rig.without_devices else found

    def capability(
        self,
        recipe: RecipeT,
        rig: RigFile | None,
        light_angle_deg: float,
        tries: Sequence[float],
        advance: Advance,
    ) -> RecipeCheck:
        """Capability of a recipe: its poses, and the causes that it separates; arguments as of `check_recipe`."""
        del rig, light_angle_deg, tries, advance
        return RecipeCheck(product=recipe.product)

    # ---- report and terminal ----------------------------------------------------------------------------------

    @property
    def cause_words(self) -> Mapping[str, CauseWords]:
        """Its causes in plain words, each with what to do next; a recipe overrides the latter in ``[actions]``."""
        return {}

    def finding(self, record: Record) -> str:
        """What was found by numbers alone: a sentence with the size of the largest deviation, no full stop."""
        return record.reasons[0] if record.reasons else ""

    def nominal(self, record: Record) -> Mapping[str, float]:
        """What the extent of a cause is added to, by cause, such as the ridge angle of the design."""
        del record
        return {}

    def conclude(self, record: Record) -> ConclusionRecord:
        """The verdict in plain words."""
        return concluded(record, self.cause_words, self.finding(record), self.nominal(record))

    def check_actions(self, recipe: RecipeBase, path: Path) -> None:
        """Check that ``[actions]`` of a recipe names causes and outcomes of this kind.

        Raises:
            RecipeError: it names something else.
        """
        known = [*OUTCOMES, *self.cause_words]
        for key in recipe.actions:
            if key not in known:
                near = get_close_matches(key, known, 1)
                hint = f"did you mean {near[0]}?" if near else f"known: {', '.join(known)}"
                raise RecipeError(
                    f"{path}: actions.{key}: no cause or outcome of {self.one} has this name; {hint}"
                )

    def pictures(
        self, recipe: RecipeT, expected: ExpectedT, measured: MeasuredT, decided: DecidedT
    ) -> Pictures:
        """Pictures of the report that the record does not hold."""
        del recipe, measured, decided
        return Pictures(surface=expected.surface)

    def sections(self, record: Record, pictures: Pictures) -> Sections:
        """Its part of the report."""
        del record, pictures
        return Sections()

    def summary(self, record: Record) -> CommandOutput:
        """Its part of the output of ``anisoscope inspect``: further JSON keys, tables, and lines."""
        return CommandOutput(
            {"details": None if record.details is None else record.details.model_dump(mode="json")}
        )


AnyKind = Kind[Any, Any, Any, Any]


def radiance_table(known: RadianceSet[Any], recipe: RecipeBase) -> CommandOutput:
    """Reference parts that are compared by their radiances, and how much they vary."""
    contrasts = known.contrasts()
    scatter = contrasts.std(axis=0, ddof=1) if len(contrasts) > 1 else np.full(contrasts.shape[1], np.nan)
    content: dict[str, Any] = {}
    content["parts"] = [part.model_dump() for part in known.parts]
    content["mean"] = [float(value) for value in contrasts.mean(axis=0)]
    content["scatter"] = [float(value) if np.isfinite(value) else None for value in scatter]
    first, *others = known.poses
    names = [f"ln L{_at(pose)} − ln L{_at(first)}" for pose in others]
    rows = [
        [part.serial, part.inspected_at, part.verdict, *(f"{value:+.4f}" for value in row)]
        for part, row in zip(known.parts, contrasts, strict=True)
    ]
    rows.append(["mean", "", "", *(f"{value:+.4f}" for value in contrasts.mean(axis=0))])
    rows.append(["scatter", "", "", *(f"{value:.4f}" if np.isfinite(value) else "–" for value in scatter)])
    columns = ["part", "inspected", "verdict", *names]
    lines: tuple[str, ...] = ()
    if known.judges_area:
        columns.insert(3, "area")
        shares = [part.area_share for part in known.parts]
        shown = ["–" if share is None else f"{share:.2%}" for share in shares]
        for row, share in zip(rows, [*shown, "", ""], strict=True):
            row.insert(3, share)
        content |= known.area_content(recipe)
        lines = (known.area_limit_text(recipe),)
    table = Table(f"{known.noun}s: {known.product}", columns, rows, known.lacking)
    return CommandOutput(content, (table,), lines)


def _at(pose: tuple[float, float]) -> str:
    return f"({pose[0]:g}°" + (f", tilt {pose[1]:g}°)" if pose[1] else ")")
