"""Interface of a kind of part: recipe, prediction, measurement and decision.

The one pipeline of inspections, the records, the report and the command line ask a kind through this class and its
optional parts (`anisoscope.kinds.parts`) alone. A kind of a third party subclasses them and registers an instance under
the entry point group ``anisoscope.kinds``; see docs/own-kind.md.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError, RecipeError
from anisoscope.base.notation import present_notation
from anisoscope.base.progress import Advance, silent
from anisoscope.calibration.corrections import Calibrations
from anisoscope.imaging.frames import AcquiredFrames
from anisoscope.imaging.pose_radiance import drift_error
from anisoscope.imaging.views import Guide, Views
from anisoscope.kinds.parts import Checking, Reference, reference_on, reporting
from anisoscope.kinds.recipe_check import RecipeCheck
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.base import RecipeBase, check_region
from anisoscope.recipe.logo import check_logo
from anisoscope.recipe.poses import check_poses
from anisoscope.record.details import Details
from anisoscope.record.schema import BudgetRecord, DiagnosisRecord
from anisoscope.record.verdict import Verdict
from anisoscope.report.conclusion import OUTCOMES
from anisoscope.rig.rigfile import RigFile, check_arm, read_replay_rig


class Expected(Protocol):
    """Common part of the predictions of all kinds."""

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
    """Common part of the measurements of all kinds."""

    @property
    def drift(self) -> float | None:
        """Relative change of the first pose until the end, or None where it was photographed once."""
        ...


class Decided(Protocol):
    """Common part of the verdicts of all kinds."""

    @property
    def verdict(self) -> Verdict:
        """Of the part."""
        ...

    @property
    def reasons(self) -> tuple[str, ...]:
        """One line each, most important first."""
        ...


@dataclass(frozen=True)
class Prediction:
    """An `Expected` with nothing besides.

    Attributes:
        poses: that were predicted.
        convention: how the angles are counted.
        model: the name of the reflectance model.
        optics: rays or waves, and why; None where this was no question.
        surface: the height map behind it, or None.
    """

    poses: tuple[Pose, ...]
    convention: Convention
    model: str
    optics: dict[str, Any] | None = None
    surface: HeightMap | None = None


@dataclass(frozen=True)
class Judgement:
    """A `Decided` with nothing besides.

    Attributes:
        verdict: of the part.
        reasons: one line each, most important first.
    """

    verdict: Verdict
    reasons: tuple[str, ...]


WITHOUT_RIG = (
    f"the light of the rig; {Convention.light_angle_deg:g}° is assumed: name --rig, or --light-angle"
)
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

    def calibrated(self, recipe: RecipeT) -> RecipeT:
        """The recipe with the uncertainties that were calibrated, and that of the stray light that was measured."""
        found = self.calibrations.applied_to(recipe)
        monitor = self.views.monitor
        if monitor is None or monitor.u_stray == 0.0:
            return found
        stray = float(np.hypot(found.uncertainty.stray_radiance, monitor.u_stray))
        own = found.uncertainty.model_copy(update={"stray_radiance": stray})
        return found.model_copy(update={"uncertainty": own})


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
    """Explanation of a verdict.

    Attributes:
        diagnosis: the causes.
        details: further fields of the details.
        notes: for the user.
        reason: why the verdict is that of the diagnosis (`DiagnosisRecord.verdict`) and not FAIL; "" where it stands.
    """

    diagnosis: DiagnosisRecord | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    reason: str = ""


class Kind(ABC, Generic[RecipeT, ExpectedT, MeasuredT, DecidedT]):
    """A kind of part. What has a default here need not be given; `anisoscope.kinds.parts` has what is optional.

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
        """Read a recipe; errors as for `RecipeBase.read`."""
        return self.recipe.read(path)

    def read_copy(self, path: Path, copies: Mapping[str, Path]) -> RecipeT:
        """Read the copy of a recipe in an inspection folder, where the files that it names are copies, by role.

        Raises:
            RecipeError: as `read_recipe`.
        """
        del copies
        return self.read_recipe(path)

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
        """Diagnosis of the verdict; it takes a FAIL back where a fault of the rig explains the part as well.

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

    def check_recipe(
        self,
        path: Path,
        rig_path: Path | None,
        light_angle_deg: float | None = None,
        tries: Sequence[float] = (),
        advance: Advance = silent,
    ) -> RecipeCheck:
        """Check of a recipe before inspection; nothing moves.

        Args:
            path: the recipe.
            rig_path: rig file, for its geometry; without one the light is at the given angle.
            light_angle_deg: between light and camera, where there is no rig file; None is a usual one, and says so.
            tries: tilts that might be added, degrees.
            advance: progress.

        Raises:
            RecipeError, RigFileError: recipe and rig do not fit each other, or nothing can be predicted.
        """
        recipe = self.read_recipe(path)
        if rig_path is None:
            self.check_actions(recipe, path)
            check_logo(recipe, path)
            angle = Convention.light_angle_deg if light_angle_deg is None else light_angle_deg
            check_poses(recipe.poses, angle, path)
            found = self._capability(recipe, None, angle, tries, advance)
            return replace(found, unchecked=WITHOUT_RIG) if light_angle_deg is None else found
        rig = read_replay_rig(rig_path, recipe.acquisition.light_channel)
        self.check(recipe, rig, path, rig_path)
        check_region(recipe, rig.fixture, path)
        try:
            reference_on(self, path, recipe, rig)
        except CalibrationError as error:  # nothing is judged here: no exit code of a verdict
            raise RecipeError(str(error)) from error
        if not rig.without_devices:
            check_arm(rig, [pose.tilt_deg for pose in recipe.poses.poses()])
        found = self._capability(recipe, rig, rig.light.angle_deg, tries, advance)
        return replace(found, unchecked=WITHOUT_DEVICES) if rig.without_devices else found

    def check_actions(self, recipe: RecipeBase, path: Path) -> None:
        """Check that ``[actions]`` of a recipe names causes and outcomes of this kind.

        Raises:
            RecipeError: it names something else.
        """
        known = [*OUTCOMES, *reporting(self).cause_words]
        for key in recipe.actions:
            if key not in known:
                near = get_close_matches(key, known, 1)
                hint = f"did you mean {near[0]}?" if near else f"known: {', '.join(known)}"
                raise RecipeError(
                    f"{path}: actions.{key}: no cause or outcome of {self.one} has this name; {hint}"
                )

    def _capability(
        self,
        recipe: RecipeT,
        rig: RigFile | None,
        light_angle_deg: float,
        tries: Sequence[float],
        advance: Advance,
    ) -> RecipeCheck:
        if not isinstance(self, Checking):
            return RecipeCheck(product=recipe.product)
        return self.capability(recipe, rig, light_angle_deg, tries, advance)


AnyKind = Kind[Any, Any, Any, Any]
