"""Reference parts: results of parts known to be good, stored next to their recipe; the command line calls them golden.

The file (JSON, schema 1) holds one row per part. It belongs to the poses, the region and the exposure of one recipe,
and to the viewing conditions where the kind of part states them; other rows are refused. A kind supplies its rows and
what is compared of them (`ReferenceSet`). `RadianceSet` compares the ratios of the poses' radiances, of any kind of
part; `GoldenSet` adds the deviating area of surfaces.
"""

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, Literal, Self, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import CalibrationError
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.base.significance import LEAST_SAMPLE, like_sample, log_basis
from anisoscope.decision.equipment import Equipment
from anisoscope.decision.exclusion import Exclusion, open_defects, open_sizes
from anisoscope.decision.lot_reference import LEAST_PARTS as LEAST_OF_LOT
from anisoscope.decision.lot_reference import LotScatter, alike
from anisoscope.imaging.area_limit import MIN_PARTS, KnownShares
from anisoscope.recipe.base import AcquisitionPart, RecipeBase
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.record.schema import Record
from anisoscope.record.surface_details import surface_of

_NO_MATTER = frozenset({"settle_s"})
_EARLIER = ("exposure_s", "gain", "frames_per_pose", "dark_frames", "settle_s")


class ReferenceRow(BaseModel):
    """One reference part: serial number and time of inspection; a kind adds what it measures, in the file's order.

    ``unlabelled`` marks parts of a lot of unknown quality.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    serial: str
    inspected_at: str
    unlabelled: Annotated[bool, Field(exclude_if=lambda value: not value)] = False

    @property
    def pictured(self) -> tuple[Any, ...] | None:
        """Numbers that two inspections share to the last digit only if they are of the same pictures; None: none."""
        return None

    def deviating_area(self, rule: Any) -> tuple[float, int | None] | None:  # noqa: ANN401 - of the kind
        """Share of the area that deviated, and its number of cells; None unless it was judged by this rule."""
        del rule
        return None


RowT = TypeVar("RowT", bound=ReferenceRow)
RecipeT = TypeVar("RecipeT", bound=RecipeBase)


class ReferenceSet(BaseModel, Generic[RowT, RecipeT]):
    """The good parts of one recipe.

    A kind gives `row_of`, and overrides what else differs.

    Attributes:
        kind: name in files of kinds that state it, or None.
        product: of the recipe.
        recipe_key: hash of the recipe entries common to the parts.
        seen: viewing conditions common to the parts, or None.
        equipment: camera, lens and lamp common to the parts; None in files of earlier versions.
        poses: (stage angle, tilt) of every pose, degrees.
        parts: one row a part, in the order in which they were added.
        lot: lot of a part, where these are the other parts of it, of unknown quality.
        refused: reasons why further parts of it do not serve, a line each.
        thing: what is inspected, in messages.
        tests: number of tests that share the level of the recipe, that of the area among them.
        shares_level: the other ones, in words.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    kind: str | None = None
    product: str
    recipe_key: str
    seen: BaseModel | None = None
    equipment: Annotated[Equipment | None, Field(exclude_if=lambda value: value is None)] = None
    poses: tuple[tuple[float, float], ...]
    parts: tuple[RowT, ...] = ()
    lot: Annotated[str | None, Field(exclude_if=lambda value: value is None)] = None
    refused: Annotated[tuple[str, ...], Field(exclude_if=lambda value: not value)] = ()

    thing: ClassVar[str] = "part"
    tests: ClassVar[int] = 2
    shares_level: ClassVar[str] = "contrasts"

    # ---- what a kind supplies ---------------------------------------------------------------------------------

    @classmethod
    def row_of(cls, record: Record, recipe: RecipeT) -> RowT:
        """Row of an inspected part.

        Args:
            record: of the inspection, which was not INVALID.
            recipe: by which it was inspected.

        Raises:
            CalibrationError: the inspection says nothing about a good part.
        """
        raise NotImplementedError

    @classmethod
    def entries_of(cls, recipe: RecipeT) -> dict[str, Any]:
        """Further recipe entries that must agree, besides poses, region and exposure."""
        del recipe
        return {}

    @classmethod
    def earlier_keys(cls, recipe: RecipeT) -> tuple[str, ...]:
        """Keys that earlier versions gave to this recipe."""
        del recipe
        return ()

    @classmethod
    def restricted(cls, record: Record, then: RecipeT, recipe: RecipeT) -> tuple[Record, RecipeT]:
        """Part of an inspection by another recipe that serves this one; a kind that shares nothing returns it whole.

        Args:
            record: of the inspection.
            then: recipe by which it was inspected.
            recipe: the recipe of the set.
        """
        del recipe
        return record, then

    @classmethod
    def conditions_of(cls, record: Record) -> BaseModel | None:
        """Viewing conditions of an inspection, or None where the kind states none."""
        del record
        return None

    def area_rule(self, recipe: RecipeT) -> Any:  # noqa: ANN401 - of the kind
        """Rule of the deviating area in a recipe, with ``max_share``; None where the area is not judged."""
        del recipe
        return None

    def judged_text(self, rule: Any) -> str:  # noqa: ANN401 - of the kind
        """Verdicts of parts that count for the limit of the area."""
        raise NotImplementedError

    # ---- what all sets have in common -------------------------------------------------------------------------

    @property
    def noun(self) -> str:
        """Word of the command line for one of them."""
        return f"golden {self.thing}"

    @classmethod
    def key_of(cls, recipe: RecipeT) -> str:
        """Hash of the recipe entries that must agree for values to be comparable.

        Of the acquisition only entries that affect a measurement; entries at their default are omitted, so that a key
        remains valid when fields are added.
        """
        return cls._hashed(recipe, same_exposure(recipe.acquisition))

    @classmethod
    def _hashed(cls, recipe: RecipeT, acquisition: dict[str, Any]) -> str:
        stored = recipe.model_dump(mode="json", include={"poses", "region"})
        content = stored | cls.entries_of(recipe) | {"acquisition": acquisition}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    @classmethod
    def read(cls, path: Path, recipe: RecipeT) -> Self | None:
        """The reference parts of a recipe, or None if none were added.

        Raises:
            CalibrationError: the file is damaged, or belongs to another recipe.
        """
        try:
            found = cls.model_validate_json(bounded_bytes(path))
        except FileNotFoundError:
            return None
        except (OSError, ValidationError) as problem:
            reason = str(problem).splitlines()[0]
            raise CalibrationError(f"the golden {cls.thing}s in {path} cannot be read: {reason}") from problem
        key = cls.key_of(recipe)
        if found.recipe_key in cls.earlier_keys(recipe):
            found = found.model_copy(update={"recipe_key": key})
        if found.recipe_key != key:
            raise CalibrationError(
                f"the {found.noun}s in {path} were inspected with other poses, region or exposure than the recipe has "
                f"now: {cls.anew()}"
            )
        return found

    def check_seen(self, path: Path, names: Mapping[str, str]) -> None:
        """Check the viewing conditions of the next part.

        Args:
            path: file of the set.
            names: viewing conditions, as far as they are known.

        Raises:
            CalibrationError: the parts of the set were seen otherwise.
        """
        for what, name in names.items():
            then = getattr(self.seen, what)
            if then != name:
                raise CalibrationError(
                    f"the {self.noun}s in {path} were seen with the {what} {then!r}, now it is {name!r}: {self.anew()}"
                )

    def check_equipment(self, path: Path, now: Equipment) -> None:
        """Check camera, lens and lamp of the next part.

        Args:
            path: file of the set.
            now: those of the next part.

        Raises:
            CalibrationError: the parts of the set were measured with others.
        """
        other = None if self.equipment is None else self.equipment.other(now)
        if other is not None:
            raise CalibrationError(
                f"the {self.noun}s in {path} were measured with another {other.what}: {other.text()}: {self.anew()}"
            )

    @classmethod
    def anew(cls) -> str:
        """Remedy for a set that does not fit."""
        return f"inspect good {cls.thing}s anew, add them to an empty set, and delete the old file"

    @classmethod
    def with_inspection(cls, known: Self | None, recipe: RecipeT, record: Record) -> Self:
        """A set with one more part.

        Args:
            known: the set so far, or None.
            recipe: the recipe of the set.
            record: of the inspection of a good part.

        Raises:
            CalibrationError: the inspection was INVALID, was made with other poses, region, exposure or viewing
                conditions, or is in the set already, itself or another one of the same pictures.
        """
        poses = tuple((pose.stage_deg, pose.tilt_deg) for pose in recipe.poses.poses())
        if record.verdict == "INVALID" or not record.poses:
            raise CalibrationError(
                f"{record.serial}: an INVALID inspection says nothing about a good {cls.thing}"
            )
        another = (
            f"{record.serial} was inspected with another recipe (poses, region or exposure differ): inspect it "
            "again"
        )
        try:
            key, recipe_then = cls.key_of(recipe), type(recipe).model_validate(record.recipe, extra="ignore")
        except ValidationError as problem:  # such as the recipe of another kind of part
            raise CalibrationError(another) from problem
        record, recipe_then = cls.restricted(record, recipe_then, recipe)
        if tuple((pose.stage_deg, pose.tilt_deg) for pose in record.poses) != poses:
            raise CalibrationError(another)
        if cls.key_of(recipe_then) != key:
            raise CalibrationError(another)
        row, seen = cls.row_of(record, recipe_then), cls.conditions_of(record)
        header: dict[str, Any] = {} if seen is None else {"seen": seen}
        base = known or cls(product=recipe.product, recipe_key=key, poses=poses, **header)
        for what, common in base.seen or ():
            if getattr(seen, what) != common:
                raise CalibrationError(
                    f"{record.serial} was seen with the {what} {getattr(seen, what)!r}, the others with {common!r}"
                )
        mine = Equipment.of_record(record)
        other = None if mine is None or base.equipment is None else mine.other(base.equipment)
        if other is not None:
            raise CalibrationError(
                f"{record.serial} was measured with another {other.what} than the {base.noun}s: "
                f"{other.text('theirs')}: inspect it as they were, or begin a set anew"
            )
        equipment = mine if base.equipment is None else base.equipment.completed(mine)
        if any((part.serial, part.inspected_at) == (row.serial, row.inspected_at) for part in base.parts):
            raise CalibrationError(
                f"this inspection of {row.serial} ({row.inspected_at}) is in the set already"
            )
        copied = next((part for part in base.parts if part.pictured == row.pictured is not None), None)
        if copied is not None:
            raise CalibrationError(
                f"{row.serial} has the radiances of {copied.serial} to the last digit, so that the same pictures would "
                f"count twice: inspect another good {cls.thing}, or take the pictures again"
            )
        return base.model_copy(update={"parts": (*base.parts, row), "equipment": equipment})

    def without(self, serial: str) -> Self:
        """A set without all rows of a serial number.

        Raises:
            CalibrationError: there is none.
        """
        others = tuple(part for part in self.parts if part.serial != serial)
        if len(others) == len(self.parts):
            raise CalibrationError(f"there is no {self.noun} {serial}")
        return self.model_copy(update={"parts": others})

    @property
    def needed(self) -> int:
        """Smallest number of parts that show how much good ones vary."""
        return LEAST_SAMPLE

    @property
    def lacking(self) -> str | None:
        """Reason why the parts do not serve as the reference yet, or None."""
        count = len(self.parts)
        if self.lot is not None:
            return self._waiting
        if count >= self.needed:
            return None
        return f"{counted(count, self.noun)}: from {self.needed} on {self.thing}s are compared with them"

    @property
    def _waiting(self) -> str | None:
        """Reason why the other parts of a lot do not serve yet, with the part itself, or None."""
        parts, least_of_lot = len(self.parts) + 1, self.least_of_lot()
        if parts >= least_of_lot:
            return None
        return (
            f"part {parts} of lot {self.lot}: from part {least_of_lot} on, the parts of the lot are compared with each "
            "other"
        )

    @classmethod
    def least_of_lot(cls) -> int:
        """Smallest number of parts of a lot that are compared with each other."""
        return max(LEAST_OF_LOT, LEAST_SAMPLE + 1)

    @property
    def unjudged(self) -> int:
        """Number of parts of a lot of unknown quality."""
        return sum(part.unlabelled for part in self.parts)

    @property
    def words(self) -> str:
        """A part like these, in words."""
        number = len(self.parts)
        if self.lot is not None:
            return (
                "like the other part of the lot"
                if number == 1
                else f"like the {number} other parts of the lot"
            )
        return "like the golden part" if number == 1 else f"like the {number} golden parts"

    @property
    def refused_text(self) -> str | None:
        """Reason why parts of the lot do not serve, or None."""
        if not self.refused:
            return None
        more = f" (and {len(self.refused) - 1} more)" if len(self.refused) > 1 else ""
        return f"not compared with all parts of lot {self.lot}: {self.refused[0]}{more}"

    @classmethod
    def of_lot(
        cls,
        recipe: RecipeT,
        lot: str,
        equipment: Equipment,
        seen: BaseModel | None,
        records: Iterable[Record],
    ) -> Self:
        """The other parts of the lot of a part, of unknown quality.

        Args:
            recipe: of the part.
            lot: name of the lot.
            equipment: camera, lens and lamp of the part.
            seen: its viewing conditions, as of `conditions_of`.
            records: inspections of the other parts, the oldest first.
        """
        poses = tuple((pose.stage_deg, pose.tilt_deg) for pose in recipe.poses.poses())
        header: dict[str, Any] = {} if seen is None else {"seen": seen}
        key = cls.key_of(recipe)
        known = cls(
            product=recipe.product, recipe_key=key, poses=poses, equipment=equipment, lot=lot, **header
        )
        refused: list[str] = []
        for record in records:
            try:
                known = cls.with_inspection(known, recipe, record)
            except CalibrationError as error:  # of another recipe or rig, or twice the same pictures
                refused.append(str(error))
        unlabelled = tuple(part.model_copy(update={"unlabelled": True}) for part in known.parts)
        return known.model_copy(update={"parts": unlabelled, "refused": tuple(refused)})

    def alike(self, found: LotScatter) -> tuple[Self, tuple[str, ...]]:
        """Parts of the lot that are like most parts of it, and the serial numbers of the others.

        Args:
            found: what is compared, of these parts and, last, of the part itself, which is one of the lot too.
        """
        near, _ = alike(found.values, found.covariance, sized=found.sized)
        marked = list(zip(self.parts, near[:-1], strict=True))
        return (
            self.model_copy(update={"parts": tuple(part for part, like in marked if like)}),
            tuple(part.serial for part, like in marked if not like),
        )

    def without_odd_parts(
        self, found: LotScatter, added: Collection[tuple[str, str]]
    ) -> tuple[Self, list[str]]:
        """A set without parts of a lot that deviate from the others, and the serial numbers of these.

        Args:
            found: what is compared of the parts.
            added: serial numbers and times of inspection of the parts of the lot.

        Raises:
            CalibrationError: there are too few parts.
        """
        least = self.least_of_lot()
        if len(self.parts) < least:
            raise CalibrationError(
                f"{counted(len(self.parts), self.thing)} of unknown quality: {least} of a lot or more show which one "
                "deviates"
            )
        kept, _ = alike(found.values, found.covariance, sized=found.sized)
        rows, left_out = [], []
        for part, near in zip(self.parts, kept, strict=True):
            new = (part.serial, part.inspected_at) in added
            if new and not near:
                left_out.append(part.serial)
            else:
                rows.append(part.model_copy(update={"unlabelled": True}) if new else part)
        return self.model_copy(update={"parts": tuple(rows)}), left_out

    def of_the_lot(self, left_out: tuple[str, ...], common: tuple[Exclusion, ...]) -> str:
        """What a verdict by parts of unknown quality leaves open, in words.

        Args:
            left_out: serial numbers of parts of the lot that deviate from the others.
            common: what the prediction excludes of all of them.
        """
        count = self.unjudged
        if self.lot is None:
            return f"compared with {count} parts of unknown quality: what they have in common is not seen"
        without = f" (without {', '.join(left_out)}, unlike the others)" if left_out else ""
        parts = "1 other part" if count == 1 else f"{count} other parts"
        compared = f"compared with {parts} of lot {self.lot}{without}"
        if not open_defects(common):
            return f"{compared}: what all of them have in common, the prediction judges"
        return f"{compared}: of all of them together the prediction does not exclude {open_sizes(common)}"

    def _areas(self, rule: Any) -> list[tuple[float, int | None]]:  # noqa: ANN401 - of the kind
        return [area for part in self.parts if (area := part.deviating_area(rule)) is not None]

    def area_shares(self, rule: Any) -> tuple[float, ...]:  # noqa: ANN401 - of the kind
        """Deviating shares of the area, of the parts judged by this rule."""
        return tuple(share for share, _ in self._areas(rule))

    def known_shares(self, recipe: RecipeT) -> KnownShares | None:
        """Shares that set the limit of the area; None where the recipe gives its own or the parts are too few."""
        rule = self.area_rule(recipe)
        if rule is None or limit_is_given(rule) or self.lot is not None:
            return None
        shares, cells = self.area_shares(rule), [count for _, count in self._areas(rule) if count]
        if not cells or len(shares) < MIN_PARTS:
            return None
        return KnownShares(shares, cells[-1])

    def area_limit(self, recipe: RecipeT) -> float | None:
        """Limit of the area learnt from these parts, for a part that is consistent in all else."""
        known = self.known_shares(recipe)
        return None if known is None else known.limit(recipe.decision.alpha / self.tests)

    def area_limit_text(self, recipe: RecipeT) -> str:
        """One line about the limit of the area and its origin."""
        rule, alpha = self.area_rule(recipe), recipe.decision.alpha
        if rule is None:
            return "limit of the area: none, the recipe does not judge it"
        learnt, count = self.area_limit(recipe), len(self.area_shares(rule))
        if learnt is not None:
            return (
                f"limit of the area: {learnt:.2%}, learnt from {count} {self.noun}s (one good {self.thing} in "
                f"{self.tests / alpha:.0f} exceeds it; {self.shares_level} and area share the level {alpha:g})"
            )
        if limit_is_given(rule):
            return f"limit of the area: {rule.max_share:.2%}, as the recipe says in area.max_share"
        return (
            f"limit of the area: {rule.max_share:.2%}; from {MIN_PARTS} {self.noun}s judged {self.judged_text(rule)} "
            f"on it is learnt from them, now there are {count}"
        )

    def area_content(self, recipe: RecipeT) -> dict[str, Any]:
        """JSON keys about the limit of the area: the limit that applies, or None, and its origin."""
        rule = self.area_rule(recipe)
        limit = None if rule is None else self.area_limit(recipe) or rule.max_share
        return {"area_limit": limit, "area_limit_says": self.area_limit_text(recipe)}


AnyReferenceSet = ReferenceSet[Any, Any]
Absent = Annotated[None, Field(exclude_if=lambda value: value is None)]
"""A header entry that files of a kind do not have."""


class GoldenPart(ReferenceRow):
    """One golden part: identity, time of inspection, and (P,) ln radiances.

    ``area_share`` is the share of the ``cells`` whose score exceeded ``cell_limit``; sets of earlier versions have the
    limit of the mean score of their points, ``limit``, or the ln ratio of their cells, ``cell_deviation``.
    """

    log_radiance: tuple[float, ...]
    lot: Annotated[str | None, Field(exclude_if=lambda value: value is None)] = None
    area_share: float | None
    cell_deviation: Annotated[
        float | Literal["auto"] | None, Field(exclude_if=lambda value: value is None)
    ] = None
    limit: Annotated[float | None, Field(exclude_if=lambda value: value is None)] = None
    cell_limit: Annotated[float | None, Field(exclude_if=lambda value: value is None)] = None
    cells: int | None = None
    verdict: str

    @property
    def pictured(self) -> tuple[Any, ...]:
        """Ln of the radiances."""
        return self.log_radiance

    def deviating_area(self, rule: Any) -> tuple[float, int | None] | None:  # noqa: ANN401 - of the kind
        """Share and number of cells, if they were judged by their scores."""
        del rule
        known = self.cell_limit is not None or self.limit is not None
        return None if self.area_share is None or not known else (self.area_share, self.cells)


class RadianceSet(ReferenceSet[GoldenPart, RecipeT], Generic[RecipeT]):
    """Reference parts compared by the ratios of their poses' radiances; any kind of part records these."""

    kind: Absent = None
    seen: Absent = None

    @classmethod
    def row_of(cls, record: Record, recipe: RecipeT) -> GoldenPart:
        """Row with ln of the recorded radiances."""
        return GoldenPart(
            serial=record.serial,
            inspected_at=record.created_at,
            log_radiance=tuple(float(np.log(pose.measured)) for pose in record.poses),
            lot=record.particulars.lot,
            verdict=record.verdict,
            **cls.area_of(record, recipe),
        )

    @classmethod
    def area_of(cls, record: Record, recipe: RecipeT) -> dict[str, Any]:
        """Fields of a row about the area."""
        del record, recipe
        return {"area_share": None}

    def contrasts(self) -> FloatArray:
        """(n, P − 1) differences of ln L from the first pose, of every part."""
        values = np.array([part.log_radiance for part in self.parts]).reshape(-1, len(self.poses))
        return np.asarray(values @ log_basis(len(self.poses)).T)

    @property
    def batches(self) -> int:
        """Number of batches: lots, and days of inspection of parts without a lot."""
        return len({part.lot or part.inspected_at[:10] for part in self.parts})

    def t_squared(self, radiance: FloatArray, u: FloatArray) -> tuple[float, int, float]:
        """T² of one more part from these parts (`base.significance.like_sample`).

        Args:
            radiance: (P,) of the part, 1/sr.
            u: (P,) relative standard deviations of good parts, as far as they are known; their size does not matter.

        Returns:
            T², its degrees of freedom P − 1, and the probability of a larger one for a part like these.

        Raises:
            MeasurementError: the parts are too few (`lacking`), or nothing is stated to vary.
        """
        basis = log_basis(len(radiance))
        t2, p_value = like_sample(basis @ np.log(radiance), self.contrasts(), (basis * u**2) @ basis.T)
        return t2, len(basis), p_value


class GoldenSet(RadianceSet[SurfaceRecipe]):
    """The good parts of one recipe of a surface.

    Attributes:
        predictive: a part is compared with one golden part or more, by the scatter that the recipe states
            (`anisoscope.decision.predictive`); otherwise with three or more, by the form of the budget.
        varies: beginnings of the names of sources in the budget that differ from part to part; none for all.
    """

    predictive: ClassVar[bool] = True
    varies: ClassVar[tuple[str, ...]] = ()

    @property
    def cell_limits(self) -> tuple[float, ...]:
        """Limits of the scores of the cells, of every part that has one; earlier versions had other scores."""
        return tuple(part.cell_limit for part in self.parts if part.cell_limit is not None)

    @property
    def needed(self) -> int:
        """One, where the recipe states the scatter; otherwise three."""
        return 1 if self.predictive else super().needed

    @classmethod
    def least_of_lot(cls) -> int:
        """Three, where the recipe states the scatter; otherwise four."""
        return LEAST_OF_LOT if cls.predictive else super().least_of_lot()

    @property
    def batches(self) -> int:
        """Number of batches; parts of the lot of a part differ from it as from each other."""
        return len(self.parts) if self.lot is not None else super().batches

    @classmethod
    def restricted(
        cls, record: Record, then: SurfaceRecipe, recipe: SurfaceRecipe
    ) -> tuple[Record, SurfaceRecipe]:
        """The poses of the recipe, where the part was inspected in more of them, without its deviating area.

        The area counts cells that deviate in all poses together, of which this recipe has fewer.
        """
        seen = {(pose.stage_deg, pose.tilt_deg): pose for pose in record.poses}
        wanted = [(pose.stage_deg, pose.tilt_deg) for pose in recipe.poses.poses()]
        fewer = len(wanted) < len(seen) and all(one in seen for one in wanted)
        if not fewer or then.poses.facet_azimuth_deg != recipe.poses.facet_azimuth_deg:
            return record, then
        poses = tuple(seen[one] for one in wanted)
        # tolerances are those of more pairs, and play no part in a golden set
        changes = {"poses": recipe.poses, "area": None, "decision": recipe.decision}
        return record.model_copy(update={"poses": poses}), then.model_copy(update=changes)

    @classmethod
    def entries_of(cls, recipe: SurfaceRecipe) -> dict[str, Any]:
        """The pitch."""
        return {"surface": {"pitch_um": recipe.surface.pitch_um}}

    @classmethod
    def earlier_keys(cls, recipe: SurfaceRecipe) -> tuple[str, ...]:
        """Key of the whole acquisition, if there was one."""
        exposed = recipe.acquisition.model_dump(mode="json")
        known = {k: v for k, v in exposed.items() if k in _EARLIER or (k == "brackets" and v)}
        return (cls._hashed(recipe, known),)

    @classmethod
    def area_of(cls, record: Record, recipe: SurfaceRecipe) -> dict[str, Any]:
        """Share, cells and limit of their scores."""
        area = None if recipe.area is None else surface_of(record).area
        if area is None or area.limit is None:
            return {"area_share": None}
        name = "limit" if area.cell_covariance is None else "cell_limit"
        return {"area_share": area.share, name: area.limit, "cells": area.cells}


def counted(count: int, what: str) -> str:
    """``1 golden part``, ``2 golden parts``."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def golden_path(recipe_path: Path) -> Path:
    """Path of the golden parts of a recipe: ``NAME.golden.json`` next to it."""
    return recipe_path.with_name(f"{recipe_path.stem}.golden.json")


def limit_is_given(rule: BaseModel) -> bool:
    """Whether the recipe itself states a limit of the deviating area."""
    return "max_share" in rule.model_fields_set


def same_exposure(acquisition: AcquisitionPart) -> dict[str, Any]:
    """Entries of an acquisition that must agree, without those at their default."""
    exposed = acquisition.model_dump(mode="json", exclude=set(_NO_MATTER))
    usual = {name: field.default for name, field in type(acquisition).model_fields.items()}
    return {name: value for name, value in exposed.items() if value != _plain(usual[name])}


def _plain(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value


def write_golden(path: Path, golden: BaseModel) -> None:
    """Write the set of reference parts, all or nothing.

    Raises:
        RecordError: the folder cannot be written.
    """
    write_text(path, golden_text(golden))


def golden_text(golden: BaseModel) -> str:
    """Content of the file of a set of reference parts."""
    return json.dumps(golden.model_dump(mode="json", by_alias=True), indent=2, allow_nan=False)
