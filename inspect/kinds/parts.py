"""Optional parts of a kind, further bases of its class next to `Kind`, for which callers look.

What a kind does not have is answered in one line (`collecting` and the like), or by what holds for every kind
(`reporting`).
"""

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, Self, TypeVar

import numpy as np
from pydantic import BaseModel

from anisoscope.base.cause_words import CauseWords
from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.base.progress import Advance
from anisoscope.decision.equipment import Equipment
from anisoscope.decision.lot_reference import LotScatter
from anisoscope.decision.reference_parts import AnyReferenceSet, RadianceSet, ReferenceSet, golden_path
from anisoscope.imaging.deviation_map import CellMap
from anisoscope.ink.fitting import RigInk
from anisoscope.kinds.command_output import CommandOutput, Table
from anisoscope.kinds.recipe_check import RecipeCheck
from anisoscope.parameters.new_recipe import NewRecipe
from anisoscope.recipe.base import LotDecision, RecipeBase
from anisoscope.recipe.teaching import Taught
from anisoscope.record.schema import ConclusionRecord, DiagnosisRecord, Record
from anisoscope.report.conclusion import concluded
from anisoscope.report.inspection_page import Pictures, Sections
from anisoscope.rig.rigfile import RigFile

PartT = TypeVar("PartT")
OfKind = Any
"""Recipe, prediction, measurement, verdict or good parts of the kind."""


class Named(Protocol):
    """Kind, as messages name it."""

    one: str


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


def reference_notes(reference: Reference | None) -> tuple[str, ...]:
    """Why good parts, or some parts of a lot, do not serve: notes of an inspection."""
    found = (getattr(reference, "lacking", None), getattr(reference, "refused_text", None))
    return tuple(note for note in found if note)


def usable(reference: Reference | None) -> Reference | None:
    """The reference set if it has enough good parts, or None."""
    return reference if reference is not None and reference.lacking is None else None


class References(ABC):
    """Collection of good parts, with which parts are compared.

    Attributes:
        reference_set: their set: `anisoscope.decision.reference_parts.RadianceSet`, or one of its own.
    """

    reference_set: type[AnyReferenceSet]

    def read_reference(self, path: Path, recipe: OfKind, rig: RigFile | None = None) -> Reference | None:
        """The good parts in a file, or None where there is none.

        Raises:
            CalibrationError: the file is damaged, or belongs to another recipe or rig.
        """
        del rig
        found: Reference | None = self.reference_set.read(path, recipe)
        return found

    def reference_on(
        self, recipe_path: Path, recipe: OfKind, rig: RigFile, camera: str | None = None
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

    def add_reference(self, known: OfKind, recipe: OfKind, record: Record) -> Reference:
        """A set with one good part more.

        Raises:
            CalibrationError: the inspection cannot teach this set.
        """
        found: Reference = self.reference_set.with_inspection(known, recipe, record)
        return found

    def compares_with_lot(self, recipe: OfKind) -> bool:
        """Whether a part of a lot is compared with the others of it, where there are no good parts."""
        return isinstance(recipe.decision, LotDecision) and recipe.decision.compare_with_lot

    def conditions_on(self, recipe: OfKind, rig: RigFile, filters: str) -> BaseModel | None:
        """Viewing conditions on a rig, as of `ReferenceSet.conditions_of`; None where the kind states none.

        Args:
            recipe: the recipe.
            rig: the rig.
            filters: colour filters of its camera.
        """
        del recipe, rig, filters
        return None

    def lot_scatter(self, known: OfKind, recipe: OfKind, rig: RigFile) -> LotScatter:
        """What is compared of parts of unknown quality, and how good ones scatter.

        Args:
            known: the parts.
            recipe: their recipe.
            rig: on which they were inspected.

        Raises:
            CalibrationError: nothing is, which is the default.
        """
        del recipe, rig
        raise CalibrationError(
            f"{known.thing}s of unknown quality are not compared with each other: add {known.thing}s that are known to "
            "be good, without --unlabelled"
        )

    def without_odd_parts(
        self, known: OfKind, recipe: OfKind, added: Collection[tuple[str, str]], rig: RigFile
    ) -> tuple[Reference, list[str]]:
        """A set with parts of a lot of unknown quality, without those that deviate from the others.

        Args:
            known: the set with all of them.
            recipe: the recipe.
            added: serial numbers and times of inspection of the parts.
            rig: on which they were inspected.

        Returns:
            The set, and the serial numbers of the parts that were left out.

        Raises:
            CalibrationError: parts of the kind are not compared with each other, or there are too few.
        """
        kept: tuple[Reference, list[str]] = known.without_odd_parts(
            self.lot_scatter(known, recipe, rig), added
        )
        return kept

    def show_reference(
        self,
        known: OfKind,
        recipe: OfKind,
        light_angle_deg: float = 10.0,
    ) -> CommandOutput:
        """The good parts for ``anisoscope golden show``: by default those of a `RadianceSet`.

        Args:
            known: the set.
            recipe: the recipe.
            light_angle_deg: the rig's angle between light and camera.
        """
        del recipe, light_angle_deg
        return radiance_table(known)


def reference_on(
    kind: object,
    recipe_path: Path,
    recipe: OfKind,
    rig: RigFile,
    camera: str | None = None,
) -> Reference | None:
    """The good parts of a recipe on a rig, as `References.reference_on`; None of a kind that collects none."""
    return kind.reference_on(recipe_path, recipe, rig, camera) if isinstance(kind, References) else None


def read_reference(kind: object, path: Path, recipe: OfKind) -> Reference | None:
    """The good parts in a file, as `References.read_reference`; None of a kind that collects none."""
    return kind.read_reference(path, recipe) if isinstance(kind, References) else None


def collecting(kind: object, recipe: RecipeBase) -> References:
    """The kind, as one that collects good parts.

    Raises:
        UsageError: it does not.
    """
    if not isinstance(kind, References):
        raise UsageError(f"{recipe.product}: good parts are not collected of this kind of part")
    return kind


class Redeciding(ABC):
    """Decision by another recipe from stored numbers, without frames."""

    @abstractmethod
    def kept(self, recipe: OfKind, measured: OfKind) -> Mapping[str, Any] | None:
        """Data for a decision by a changed recipe (`decide_again`): arrays, numbers and texts by name.

        None, the default, where that takes the frames.
        """

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

    @abstractmethod
    def needs_frames(self, recorded: Mapping[str, Any], recipe: OfKind) -> str | None:
        """Why a recipe takes the frames of an inspection that was recorded by another one; None: its numbers will do.

        Args:
            recorded: the recipe in the record.
            recipe: the other one.
        """

    @abstractmethod
    def decide_again(
        self, kept: Mapping[str, Any], recipe: OfKind, expected: OfKind, reference: Reference | None
    ) -> tuple[Any, Any]:
        """Measurement and verdict by another recipe, without the frames; arguments as of `decide`.

        Raises:
            MeasurementError: nothing can be judged: INVALID.
        """

    def taken_back(
        self,
        recipe: OfKind,
        expected: OfKind,
        measured: OfKind,
        decided: OfKind,
        *,
        light_watched: bool,
    ) -> tuple[DiagnosisRecord, str] | None:
        """Diagnosis with the verdict where a fault of the rig takes a FAIL back, and the reason; None, the default.

        Args:
            recipe: the recipe.
            expected: its prediction.
            measured: the measurement.
            decided: the verdict.
            light_watched: lamp, exposure and stray light were measured in every frame, and were right.
        """
        del recipe, expected, measured, decided, light_watched
        return None


class Beginning(ABC):
    """Recipes of the kind for a start."""

    def makes(self, requested: NewRecipe) -> bool:
        """Whether the options are for a recipe of this kind; where no kind claims them, the fallback writes it."""
        del requested
        return False

    @abstractmethod
    def new_recipe(self, out: Path, requested: NewRecipe) -> str:
        """Write a recipe with comments, valid as written.

        Returns:
            The tables that are to be adapted, in words.

        Raises:
            UsageError: the options contradict each other.
        """


def beginning(kind: Named) -> Beginning:
    """The kind, as one whose recipes are written for a start.

    Raises:
        UsageError: it has none.
    """
    if not isinstance(kind, Beginning):
        raise UsageError(f"there is no recipe of {kind.one} to begin with")
    return kind


class Inked(ABC):
    """Ink files from inspections of good parts."""

    @abstractmethod
    def ink_of(self, inspections: Sequence[tuple[str, Record, OfKind, RigFile]], name: str) -> RigInk:
        """The ink of good parts of one ink, photographed alike.

        Args:
            inspections: folder, record, recipe and rig of each.
            name: of the ink.

        Raises:
            UsageError: too few poses, or parts that were not photographed alike.
            CalibrationError, MeasurementError: there is no lobe, or its width is not determined.
        """


class Teaching(ABC):
    """Limits, or how parts differ, from good parts."""

    @abstractmethod
    def taught_limits(
        self, record: Record, recipe: OfKind, reference: Reference | None, rig: RigFile
    ) -> dict[tuple[str, ...], tuple[Any, str]]:
        """Limits that the inspection of a good part teaches, by their keys in the recipe, each with its reason.

        Raises:
            MeasurementError: it teaches none; the recipe stays as it is.
        """

    @abstractmethod
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


def taught(kind: Named, recipe_path: Path) -> Teaching:
    """The kind, as one that good parts teach.

    Raises:
        UsageError: they do not, by themselves.
    """
    if not isinstance(kind, Teaching):
        raise UsageError(untaught(kind, recipe_path))
    return kind


def untaught(kind: Named, recipe_path: Path) -> str:
    """Error: good parts do not teach a recipe by themselves."""
    return (
        f"{recipe_path} is the recipe of {kind.one}: good parts alone do not teach it, only beside a part that is "
        "inspected, with --serial"
    )


class Checking(ABC):
    """Capability of a recipe, before anything is inspected."""

    @abstractmethod
    def capability(
        self,
        recipe: OfKind,
        rig: RigFile | None,
        light_angle_deg: float,
        tries: Sequence[float],
        advance: Advance,
    ) -> RecipeCheck:
        """Capability of a recipe: its poses, and the causes that it separates; arguments as of `check_recipe`."""


class Tolerances(ABC):
    """Tolerances in the recipe."""

    @abstractmethod
    def tolerances(self, recipe: OfKind) -> dict[str, float]:
        """Tolerances of the recipe by the labels of `Details.numbers`, for capability and control charts.

        Raises:
            UsageError: the recipe gives none.
        """


def stating(kind: object, recipe: RecipeBase) -> Tolerances:
    """The kind, as one whose recipes state tolerances.

    Raises:
        UsageError: they do not.
    """
    if not isinstance(kind, Tolerances):
        raise UsageError(without_tolerances(recipe))
    return kind


def without_tolerances(recipe: RecipeBase) -> str:
    """Error: a recipe gives no tolerances."""
    return f"the recipe of {recipe.product} gives no tolerances: give --lower and --upper"


class Reporting:
    """Report and terminal; what is not given says what holds for every kind."""

    @property
    def cause_words(self) -> Mapping[str, CauseWords]:
        """Its causes in plain words, each with what to do next; a recipe overrides the latter in ``[actions]``."""
        return {}

    def finding(self, record: Record) -> str:
        """Finding by numbers alone: a sentence with the size of the largest deviation, no full stop."""
        return record.reasons[0] if record.reasons else ""

    def nominal(self, record: Record) -> Mapping[str, float]:
        """Nominal value to which the extent of a cause is added, by cause, such as the ridge angle of the design."""
        del record
        return {}

    def conclude(self, record: Record) -> ConclusionRecord:
        """The verdict in plain words."""
        return concluded(record, self.cause_words, self.finding(record), self.nominal(record))

    def pictures(self, recipe: OfKind, expected: OfKind, measured: OfKind, decided: OfKind) -> Pictures:
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


_PLAIN = Reporting()


def reporting(kind: object) -> Reporting:
    """Reporting of a kind of part: its own, or the one for every kind."""
    return kind if isinstance(kind, Reporting) else _PLAIN


def radiance_table(known: RadianceSet[Any]) -> CommandOutput:
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
    shares = [part.area_share for part in known.parts]
    if any(share is not None for share in shares):
        columns.insert(3, "area")
        shown = ["–" if share is None else f"{share:.2%}" for share in shares]
        for row, share in zip(rows, [*shown, "", ""], strict=True):
            row.insert(3, share)
    table = Table(f"{known.noun}s: {known.product}", columns, rows, known.lacking)
    return CommandOutput(content, (table,))


def _at(pose: tuple[float, float]) -> str:
    return f"({pose[0]:g}°" + (f", tilt {pose[1]:g}°)" if pose[1] else ")")
