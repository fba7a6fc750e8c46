"""Golden prints: measurements of known good prints, stored next to their recipe.

The file (JSON, schema 1) holds one row a print: ln of red, green and blue in every pose. It belongs to the ink, the
poses, the region and the exposure of one recipe, and to the lamp and the camera of one rig; other rows are refused.
"""

from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError
from anisoscope.decision.reference_parts import ReferenceRow, ReferenceSet
from anisoscope.kinds.command_output import CommandOutput, Table
from anisoscope.kinds.prints.lighting import lamp_and_sensitivities
from anisoscope.kinds.prints.recipe import PrintArea, PrintRecipe
from anisoscope.kinds.prints.record import PrintDetails, Triple, print_of
from anisoscope.record.schema import Record
from anisoscope.rig.rigfile import RigFile


class ViewingConditions(BaseModel):
    """Viewing conditions of prints: names of ink, lamp, sensitivities and colour filters."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    ink: str
    lamp: str
    sensitivities: str
    filters: str


class GoldenPrint(ReferenceRow):
    """One good print: serial number, time of inspection, and (P, 3) ln of its channels.

    ``area_share`` is the share of the area that deviated by more than ``cell_delta_e`` in cells of ``cell_mm``, of
    which there were ``cells``; ``curl_deg`` is the change of tilt across the region, and ``u_curl_deg`` its standard
    uncertainty. Sets of earlier versions lack them.
    """

    log_channels: tuple[Triple, ...]
    area_share: float | None
    cell_delta_e: float | None = None
    cell_mm: float | None = None
    cells: int | None = None
    curl_deg: float | None = None
    u_curl_deg: float | None = None
    verdict: str

    @property
    def pictured(self) -> tuple[Any, ...]:
        """Ln of the channels."""
        return self.log_channels

    def deviating_area(self, rule: Any) -> tuple[float, int | None] | None:  # noqa: ANN401 - a PrintArea
        """Share and number of cells, if the print was judged with these cells and this threshold."""
        judged = (self.cell_delta_e, self.cell_mm) == (rule.cell_delta_e, rule.cell_mm)
        return (self.area_share, self.cells) if judged and self.area_share is not None else None


class GoldenPrints(ReferenceSet[GoldenPrint, PrintRecipe]):
    """The good prints of one recipe."""

    kind: Literal["print"] = "print"
    seen: ViewingConditions

    thing: ClassVar[str] = "print"
    tests: ClassVar[int] = 3
    shares_level: ClassVar[str] = "lobe, colours"

    def logs(self) -> FloatArray:
        """(n, 3P) ln of the channels of every print, channels fastest."""
        return np.array([part.log_channels for part in self.parts]).reshape(len(self.parts), -1)

    @property
    def words(self) -> str:
        """A print like these, in words."""
        return super().words if self.lot is not None else f"like the {len(self.parts)} golden prints"

    @classmethod
    def row_of(cls, record: Record, recipe: PrintRecipe) -> GoldenPrint:
        """Row with ln of the channels, and what the map shows."""
        del recipe
        details = _details_of(record)
        logs = np.log([one.measured for one in details.colours]).tolist()
        return GoldenPrint(
            serial=record.serial,
            inspected_at=record.created_at,
            log_channels=tuple((red, green, blue) for red, green, blue in logs),
            verdict=record.verdict,
            **_of_map(details),
        )

    @classmethod
    def conditions_of(cls, record: Record) -> ViewingConditions:
        """Ink, lamp, sensitivities and colour filters."""
        details = _details_of(record)
        return ViewingConditions(
            ink=details.ink, lamp=details.lamp, sensitivities=details.sensitivities, filters=details.filters
        )

    def area_rule(self, recipe: PrintRecipe) -> PrintArea | None:
        """The recipe's table [area]."""
        return recipe.area

    def judged_text(self, rule: Any) -> str:  # noqa: ANN401 - a PrintArea
        """With the cells and the threshold of the rule."""
        return f"in cells of {rule.cell_mm:g} mm at cell_delta_e {rule.cell_delta_e:g}"


def read_golden_prints(path: Path, recipe: PrintRecipe, rig: RigFile | None = None) -> GoldenPrints | None:
    """The good prints of a recipe, or None where none were ever added.

    Args:
        path: their file.
        recipe: the recipe.
        rig: if given, the rig that will photograph the next print.

    Raises:
        CalibrationError: the file is damaged, or belongs to another recipe, or to another lamp or camera.
    """
    found = GoldenPrints.read(path, recipe)
    if found is None:
        return None
    seen = {"ink": recipe.print.read_ink().name}
    if rig is not None:
        seen = conditions_on(recipe, rig, found.seen.filters).model_dump()
    found.check_seen(path, seen)
    return found


def conditions_on(recipe: PrintRecipe, rig: RigFile, filters: str) -> ViewingConditions:
    """Viewing conditions of a recipe's prints on a rig with these colour filters."""
    lamp, sensitivities = lamp_and_sensitivities(rig)
    ink = recipe.print.read_ink().name
    return ViewingConditions(ink=ink, lamp=lamp.name, sensitivities=sensitivities.name, filters=filters)


def _details_of(record: Record) -> PrintDetails:
    details = print_of(record)
    if details is None or details.lobe is None:
        what = (
            "an inspection of something else"
            if details is None
            else "hardly anything is printed there, which"
        )
        raise CalibrationError(f"{record.serial}: {what} says nothing about a good print")
    return details


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
    """Golden prints: brightness of each relative to their mean, and its remaining deviation."""
    logs = known.logs()
    off = (logs - logs.mean(axis=0)).reshape(len(logs), -1, 3)
    level = off.mean(axis=1)
    rest = np.sqrt(np.mean((off - level[:, None]) ** 2, axis=(1, 2)))
    mean = logs.mean(axis=0).reshape(-1, 3)
    scatter = off.std(axis=0, ddof=1) if len(off) > 1 else None
    content: dict[str, Any] = {"seen": known.seen.model_dump(), "poses": [list(pose) for pose in known.poses]}
    content["parts"] = [part.model_dump() for part in known.parts]
    content |= known.area_content(recipe)
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
    return CommandOutput(content, (table,), (line, known.area_limit_text(recipe)))


def _share(share: float | None) -> str:
    return "–" if share is None else f"{share:.2%}"
