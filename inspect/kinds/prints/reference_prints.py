"""Golden prints: measurements of known good prints, stored next to their recipe.

The file (JSON, schema 1) holds one row a print: ln of red, green and blue in every pose. It belongs to the ink, the
poses, the region and the exposure of one recipe, and to the lamp and the camera of one rig; other rows are refused.
"""

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError
from anisoscope.decision.reference_parts import (
    check_new,
    counted,
    limit_is_given,
    reference_set_in,
    same_exposure,
)
from anisoscope.imaging.area_limit import MIN_PARTS, KnownShares
from anisoscope.kinds.golden_limit import area_limit_text
from anisoscope.kinds.kind import CommandOutput, Table
from anisoscope.kinds.prints.lighting import lamp_and_sensitivities
from anisoscope.kinds.prints.lobe_fit import PARAMETERS
from anisoscope.kinds.prints.recipe import PrintArea, PrintRecipe
from anisoscope.kinds.prints.record import PrintDetails, Triple, print_of
from anisoscope.record.schema import Record
from anisoscope.rig.rigfile import RigFile

NEEDED = len(PARAMETERS) + 1
"""Smallest number of prints for a covariance of all fitted parameters (Hotelling's T²)."""
SENSIBLE = 3 * len(PARAMETERS)
TESTS = 3
"""What shares one level where golden prints decide: lobe and level, colours of the poses, and the area."""


class ViewingConditions(BaseModel):
    """Viewing conditions of prints: names of ink, lamp, sensitivities and colour filters."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    ink: str
    lamp: str
    sensitivities: str
    filters: str


class GoldenPrint(BaseModel):
    """One good print: serial number, time of inspection, and (P, 3) ln of its channels.

    ``area_share`` is the share of the area that deviated by more than ``cell_delta_e`` in cells of ``cell_mm``, of
    which there were ``cells``; ``curl_deg`` is the change of tilt across the region, and ``u_curl_deg`` its standard
    uncertainty. Sets of earlier versions lack them.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    serial: str
    inspected_at: str
    log_channels: tuple[Triple, ...]
    area_share: float | None
    cell_delta_e: float | None = None
    cell_mm: float | None = None
    cells: int | None = None
    curl_deg: float | None = None
    u_curl_deg: float | None = None
    verdict: str


class GoldenPrints(BaseModel):
    """The good prints of one recipe.

    Attributes:
        product: of the recipe.
        recipe_key: hash of what the prints have in common in their recipes.
        seen: viewing conditions.
        poses: (stage angle, tilt) of every pose, degrees.
        parts: the prints, in the order in which they were added.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    kind: Literal["print"] = "print"
    product: str
    recipe_key: str
    seen: ViewingConditions
    poses: tuple[tuple[float, float], ...]
    parts: tuple[GoldenPrint, ...] = ()

    def logs(self) -> FloatArray:
        """(n, 3P) ln of the channels of every print, channels fastest."""
        return np.array([part.log_channels for part in self.parts]).reshape(len(self.parts), -1)

    def area_shares(self, rule: PrintArea) -> tuple[float, ...]:
        """Shares of the area that deviated, of the prints that were judged with these cells and this threshold."""
        return tuple(
            part.area_share
            for part in self.parts
            if part.area_share is not None
            and part.cell_delta_e == rule.cell_delta_e
            and part.cell_mm == rule.cell_mm
        )

    def known_shares(self, recipe: PrintRecipe) -> KnownShares | None:
        """Area shares learnt from these prints; None where the recipe gives its own limit or they are too few."""
        rule = recipe.area
        if rule is None or limit_is_given(rule):
            return None
        cells, shares = [part.cells for part in self.parts if part.cells], self.area_shares(rule)
        return KnownShares(shares, cells[-1]) if cells and len(shares) >= MIN_PARTS else None

    def area_limit(self, recipe: PrintRecipe) -> float | None:
        """The limit of the area that these prints teach, for a print whose lobe and colours are as they should be."""
        known = self.known_shares(recipe)
        return None if known is None else known.limit(recipe.decision.alpha / TESTS)

    @property
    def lacking(self) -> str | None:
        """Why the prints cannot serve as a reference yet, or None if they can."""
        count = len(self.parts)
        if count < NEEDED:
            return (
                f"{counted(count, 'golden print')}: from {NEEDED} on prints are compared with them, {SENSIBLE} are "
                "sensible"
            )
        logs = self.logs()
        if np.linalg.matrix_rank(logs - logs.mean(axis=0)) < len(PARAMETERS):
            return (
                f"{count} golden prints: they do not vary independently, so that they are not compared with"
            )
        return None


def print_key(recipe: PrintRecipe) -> str:
    """Hash of what must be the same in two recipes for their prints to be comparable."""
    dumped = recipe.model_dump(mode="json")
    content = {
        "poses": dumped["poses"],
        "region": dumped["region"],
        "acquisition": same_exposure(recipe.acquisition),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def read_golden_prints(path: Path, recipe: PrintRecipe, rig: RigFile | None = None) -> GoldenPrints | None:
    """The good prints of a recipe, or None where none were ever added.

    Args:
        path: their file.
        recipe: the recipe.
        rig: if given, the rig that will photograph the next print.

    Raises:
        CalibrationError: the file is damaged, or belongs to another recipe, or to another lamp or camera.
    """
    found = reference_set_in(path, GoldenPrints, "golden prints")
    if found is None:
        return None
    anew = "inspect good prints anew, add them to an empty set, and delete the old file"
    if found.recipe_key != print_key(recipe):
        raise CalibrationError(
            f"the golden prints in {path} were inspected with other poses, region or exposure than the recipe has "
            f"now: {anew}"
        )
    names: dict[str, str] = {"ink": recipe.print.read_ink().name}
    if rig is not None:
        lamp, sensitivities = lamp_and_sensitivities(rig)
        names |= {"lamp": lamp.name, "sensitivities": sensitivities.name}
    for what, name in names.items():
        then = getattr(found.seen, what)
        if then != name:
            raise CalibrationError(
                f"the golden prints in {path} were seen with the {what} {then!r}, now it is {name!r}: {anew}"
            )
    return found


def add_print(known: GoldenPrints | None, recipe: PrintRecipe, record: Record) -> GoldenPrints:
    """A set with one print more.

    Args:
        known: the set so far, or None.
        recipe: the recipe of the set.
        record: of the inspection of a good print.

    Raises:
        CalibrationError: the inspection was INVALID, was made with another recipe or seen otherwise, or is in the set
            already.
    """
    details = print_of(record)
    if record.verdict == "INVALID" or details is None:
        what = "an INVALID inspection" if record.verdict == "INVALID" else "an inspection of something else"
        raise CalibrationError(f"{record.serial}: {what} says nothing about a good print")
    if details.lobe is None:
        raise CalibrationError(
            f"{record.serial}: hardly anything is printed there, which says nothing about a good print"
        )
    key = print_key(recipe)
    then = PrintRecipe.model_validate(record.recipe)
    if print_key(then) != key:
        raise CalibrationError(
            f"{record.serial} was inspected with another recipe (poses, region or exposure differ): inspect it again"
        )
    conditions = ViewingConditions(
        ink=details.ink, lamp=details.lamp, sensitivities=details.sensitivities, filters=details.filters
    )
    poses = tuple((one.stage_deg, one.tilt_deg) for one in details.colours)
    base = known or GoldenPrints(product=recipe.product, recipe_key=key, seen=conditions, poses=poses)
    for what, common in base.seen:
        if getattr(conditions, what) != common:
            raise CalibrationError(
                f"{record.serial} was seen with the {what} {getattr(conditions, what)!r}, the others with {common!r}"
            )
    check_new(base.parts, record)
    logs = np.log([one.measured for one in details.colours]).tolist()
    part = GoldenPrint(
        serial=record.serial,
        inspected_at=record.created_at,
        log_channels=tuple((red, green, blue) for red, green, blue in logs),
        verdict=record.verdict,
        **_of_map(details),
    )
    return base.model_copy(update={"parts": (*base.parts, part)})


def _of_map(details: PrintDetails) -> dict[str, Any]:
    """Fields of a golden print that come from its map."""
    area_map = details.map
    if area_map is None:
        return {"area_share": None}
    curl = next(one for one in details.quantities if one.name == "curl")
    return {
        "area_share": area_map.share,
        "cell_delta_e": area_map.cell_delta_e,
        "cell_mm": area_map.cell_mm,
        "cells": area_map.rows * area_map.cols,
        "curl_deg": curl.value,
        "u_curl_deg": curl.u,
    }


def reference_table(known: GoldenPrints, recipe: PrintRecipe) -> CommandOutput:
    """Golden prints: how bright each is from their mean, and how far it is off besides."""
    logs = known.logs()
    off = (logs - logs.mean(axis=0)).reshape(len(logs), -1, 3)
    level = off.mean(axis=1)
    rest = np.sqrt(np.mean((off - level[:, None]) ** 2, axis=(1, 2)))
    mean = logs.mean(axis=0).reshape(-1, 3)
    scatter = off.std(axis=0, ddof=1) if len(off) > 1 else None
    content: dict[str, Any] = {"seen": known.seen.model_dump(), "poses": [list(pose) for pose in known.poses]}
    content["parts"] = [part.model_dump() for part in known.parts]
    content["area_limit"] = None if recipe.area is None else known.area_limit(recipe) or recipe.area.max_share
    content["area_limit_says"] = _area_limit_text(known, recipe)
    content |= {"mean": mean.tolist(), "scatter": None if scatter is None else scatter.tolist()}
    rows = [
        [part.serial, part.inspected_at, part.verdict, _share(part.area_share)]
        + [f"{value:+.4f}" for value in brightness]
        + [f"{more:.4f}"]
        for part, brightness, more in zip(known.parts, level, rest, strict=True)
    ]
    if len(level) > 1:
        spread = level.std(axis=0, ddof=1)
        rows.append(["scatter", "", "", "", *(f"{value:.4f}" for value in spread), ""])
    table = Table(
        f"golden prints: {known.product}",
        ["print", "inspected", "verdict", "area", "ln red", "ln green", "ln blue", "besides, rms"],
        rows,
        known.lacking,
    )
    conditions = known.seen
    line = (
        f"ln of the channels from the mean of these prints, over all {len(known.poses)} poses; seen: ink "
        f"{conditions.ink}, lamp {conditions.lamp}, camera {conditions.sensitivities} ({conditions.filters})"
    )
    return CommandOutput(content, (table,), (line, _area_limit_text(known, recipe)))


def _area_limit_text(known: GoldenPrints, recipe: PrintRecipe) -> str:
    rule, alpha = recipe.area, recipe.decision.alpha
    often = f"one good print in {TESTS / alpha:.0f} exceeds it"
    return area_limit_text(
        None if rule is None else rule.max_share,
        None if rule is None else known.area_limit(recipe),
        0 if rule is None else len(known.area_shares(rule)),
        given=rule is not None and limit_is_given(rule),
        things="prints",
        exceeds=f"{often}; lobe, colours and area share the level {alpha:g}",
        judged=""
        if rule is None
        else f"in cells of {rule.cell_mm:g} mm at cell_delta_e {rule.cell_delta_e:g}",
    )


def _share(share: float | None) -> str:
    return "–" if share is None else f"{share:.2%}"
