"""Golden parts: results of parts known to be good, stored next to their recipe.

The file (JSON, schema 1) holds one row per part: ln radiance of every pose, and the share of the area that deviates. It
belongs to the poses, the region and the exposure of one recipe; rows of another one are refused.
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import CalibrationError
from anisoscope.base.significance import log_basis
from anisoscope.imaging.area_limit import MIN_PARTS, KnownShares
from anisoscope.recipe.base import AcquisitionPart
from anisoscope.recipe.surface import AreaPart, SurfaceRecipe
from anisoscope.record.schema import Record
from anisoscope.record.surface_details import surface_of

ReferenceSet = TypeVar("ReferenceSet", bound=BaseModel)

_MEASURED = ("surface", "poses", "region")
_NO_MATTER = frozenset({"settle_s"})
_EARLIER = ("exposure_s", "gain", "frames_per_pose", "dark_frames", "settle_s")


class GoldenPart(BaseModel):
    """One golden part: identity, time of inspection, and (P,) ln radiances.

    ``area_share`` is the share of the ``cells`` that deviated by more than ``cell_deviation``; sets of earlier versions
    do not record the threshold.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    serial: str
    inspected_at: str
    log_radiance: tuple[float, ...]
    area_share: float | None
    cell_deviation: float | None = None
    cells: int | None = None
    verdict: str


class GoldenSet(BaseModel):
    """The good parts of one recipe.

    Attributes:
        product: of the recipe.
        recipe_key: hash of the recipe entries common to the parts.
        poses: (stage angle, tilt) of every pose, degrees.
        parts: the parts, in the order in which they were added.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    product: str
    recipe_key: str
    poses: tuple[tuple[float, float], ...]
    parts: tuple[GoldenPart, ...] = ()

    def contrasts(self) -> FloatArray:
        """(n, P − 1) differences of ln L from the first pose, of every part."""
        values = np.array([part.log_radiance for part in self.parts]).reshape(-1, len(self.poses))
        return np.asarray(values @ log_basis(len(self.poses)).T)

    def area_shares(self, rule: AreaPart) -> tuple[float, ...]:
        """Deviating shares of the area, of the parts inspected with this threshold."""
        return tuple(
            part.area_share
            for part in self.parts
            if part.area_share is not None and part.cell_deviation == rule.cell_deviation
        )

    def known_shares(self, recipe: SurfaceRecipe) -> KnownShares | None:
        """Shares that set the limit of the area; None where the recipe gives its own or the parts are too few."""
        rule = recipe.area
        if rule is None or limit_is_given(rule):
            return None
        cells, shares = [part.cells for part in self.parts if part.cells], self.area_shares(rule)
        return KnownShares(tuple(shares), cells[-1]) if cells and len(shares) >= MIN_PARTS else None

    def area_limit(self, recipe: SurfaceRecipe) -> float | None:
        """Limit of the area learnt from these parts, for a part whose contrasts are consistent."""
        known = self.known_shares(recipe)
        return None if known is None else known.limit(0.5 * recipe.decision.alpha)

    @property
    def needed(self) -> int:
        """Number of parts needed before they serve as the reference."""
        return len(self.poses)

    @property
    def lacking(self) -> str | None:
        """Reason why the parts do not serve as the reference yet, or None."""
        count = len(self.parts)
        if count < self.needed:
            sensible = 3 * (self.needed - 1)
            return (
                f"{counted(count, 'golden part')}: from {self.needed} on they are compared with, {sensible} are "
                "sensible"
            )
        scatter = np.atleast_2d(np.cov(self.contrasts(), rowvar=False))
        if np.linalg.matrix_rank(scatter) < len(scatter):
            return f"{count} golden parts: they do not vary independently, so that they are not compared with"
        return None


def counted(count: int, what: str) -> str:
    """``1 golden part``, ``2 golden parts``."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def golden_path(recipe_path: Path) -> Path:
    """Path of the golden parts of a recipe: ``NAME.golden.json`` next to it."""
    return recipe_path.with_name(f"{recipe_path.stem}.golden.json")


def limit_is_given(rule: BaseModel) -> bool:
    """Whether the recipe itself states a limit of the deviating area."""
    return "max_share" in rule.model_fields_set


def recipe_key(recipe: SurfaceRecipe) -> str:
    """Hash of the recipe entries that must agree for contrasts to be comparable.

    Of the acquisition only entries that affect a measurement; entries at their default are omitted, so that a key
    remains valid when fields are added.
    """
    return _hashed(recipe, same_exposure(recipe.acquisition))


def same_exposure(acquisition: AcquisitionPart) -> dict[str, Any]:
    """Entries of an acquisition that must agree, without those at their default."""
    exposed = acquisition.model_dump(mode="json", exclude=set(_NO_MATTER))
    usual = {name: field.default for name, field in type(acquisition).model_fields.items()}
    return {name: value for name, value in exposed.items() if value != _plain(usual[name])}


def _earlier_key(recipe: SurfaceRecipe) -> str:
    """Key of earlier versions: of the whole acquisition, as far as there was one."""
    exposed = recipe.acquisition.model_dump(mode="json")
    return _hashed(recipe, {k: v for k, v in exposed.items() if k in _EARLIER or (k == "brackets" and v)})


def _plain(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value


def _hashed(recipe: SurfaceRecipe, acquisition: dict[str, Any]) -> str:
    stored = recipe.model_dump(mode="json")
    stored["surface"] = {"pitch_um": stored["surface"]["pitch_um"]}
    content = {name: stored[name] for name in _MEASURED} | {"acquisition": acquisition}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def reference_set_in(path: Path, model: type[ReferenceSet], what: str) -> ReferenceSet | None:
    """Read a file of golden parts; None if there is none.

    Raises:
        CalibrationError: the file is damaged.
    """
    try:
        return model.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as problem:
        reason = str(problem).splitlines()[0]
        raise CalibrationError(f"the {what} in {path} cannot be read: {reason}") from problem


def read_golden(path: Path, recipe: SurfaceRecipe) -> GoldenSet | None:
    """The golden parts of a recipe, or None if none were added.

    Raises:
        CalibrationError: the file is damaged, or belongs to another recipe.
    """
    found = reference_set_in(path, GoldenSet, "golden parts")
    if found is None:
        return None
    if found.recipe_key == _earlier_key(recipe):
        found = found.model_copy(update={"recipe_key": recipe_key(recipe)})
    if found.recipe_key != recipe_key(recipe):
        raise CalibrationError(
            f"the golden parts in {path} were inspected with other poses, region or exposure than the recipe has now: "
            "inspect good parts anew, add them to an empty set, and delete the old file"
        )
    return found


def add_part(known: GoldenSet | None, recipe: SurfaceRecipe, record: Record) -> GoldenSet:
    """A set with one more part.

    Args:
        known: the set so far, or None.
        recipe: the recipe of the set.
        record: of the inspection of a good part.

    Raises:
        CalibrationError: the inspection was INVALID, was made with other poses, or is in the set already.
    """
    poses = tuple((pose.stage_deg, pose.tilt_deg) for pose in recipe.poses.poses())
    if record.verdict == "INVALID" or not record.poses:
        raise CalibrationError(f"{record.serial}: an INVALID inspection says nothing about a good part")
    recorded = tuple((pose.stage_deg, pose.tilt_deg) for pose in record.poses)
    another = f"{record.serial} was inspected with another recipe (poses, region or exposure differ): inspect it again"
    try:
        key, recipe_then = recipe_key(recipe), type(recipe).model_validate(record.recipe, extra="ignore")
    except ValidationError as problem:  # such as the recipe of another kind of part
        raise CalibrationError(another) from problem
    if recorded != poses or recipe_key(recipe_then) != key:
        raise CalibrationError(another)
    base = known or GoldenSet(product=recipe.product, recipe_key=key, poses=poses)
    check_new(base.parts, record)
    rule, area = recipe_then.area, surface_of(record).area
    part = GoldenPart(
        serial=record.serial,
        inspected_at=record.created_at,
        log_radiance=tuple(float(np.log(pose.measured)) for pose in record.poses),
        area_share=None if area is None else area.share,
        cell_deviation=None if rule is None or area is None else rule.cell_deviation,
        cells=None if area is None else area.cells,
        verdict=record.verdict,
    )
    return base.model_copy(update={"parts": (*base.parts, part)})


def write_golden(path: Path, golden: BaseModel) -> None:
    """Write the set of reference parts, all or nothing.

    Raises:
        RecordError: the folder cannot be written.
    """
    write_text(path, json.dumps(golden.model_dump(mode="json", by_alias=True), indent=2, allow_nan=False))


def without_part(known: ReferenceSet, serial: str, noun: str = "golden part") -> ReferenceSet:
    """A set, of parts or of prints, without all rows of a serial number.

    Raises:
        CalibrationError: there is none.
    """
    parts: tuple[Any, ...] = known.parts  # type: ignore[attr-defined]
    others = tuple(part for part in parts if part.serial != serial)
    if len(others) == len(parts):
        raise CalibrationError(f"there is no {noun} {serial}")
    return known.model_copy(update={"parts": others})


def check_new(parts: Sequence[Any], record: Record) -> None:
    """Check that an inspection is not in the set yet.

    Raises:
        CalibrationError: it is.
    """
    if any((part.serial, part.inspected_at) == (record.serial, record.created_at) for part in parts):
        raise CalibrationError(
            f"this inspection of {record.serial} ({record.created_at}) is in the set already"
        )
