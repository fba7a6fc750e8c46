"""Golden plates: known good plates of one recipe, with their classes and their pattern of fields.

Plates of one mould share its pattern: what a field differs from its class by is the same on every good plate, up to a
scatter that is smaller than that between fields. With golden plates the classes are compared with theirs, and every
field with its own mean.
"""

from typing import ClassVar, Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError
from anisoscope.base.significance import like_sample, log_basis
from anisoscope.decision.reference_parts import ReferenceRow, ReferenceSet
from anisoscope.kinds.command_output import CommandOutput, Table
from anisoscope.kinds.plates.recipe import PlateRecipe
from anisoscope.kinds.plates.record import PlateDetails
from anisoscope.record.schema import Record


class GoldenPlate(ReferenceRow):
    """One good plate: (C, P) ln L of its classes, and (P, rows, cols) ln L of its fields less that of their class."""

    ln_classes: tuple[tuple[float, ...], ...]
    offsets: tuple[tuple[tuple[float | None, ...], ...], ...]
    verdict: str

    @property
    def pictured(self) -> tuple[tuple[float, ...], ...]:
        """Ln of the radiances of the classes."""
        return self.ln_classes


class GoldenPlates(ReferenceSet[GoldenPlate, PlateRecipe]):
    """The good plates of one recipe."""

    kind: Literal["plate"] = "plate"
    seen: None = None

    thing: ClassVar[str] = "plate"
    shares_level: ClassVar[str] = "classes and fields"

    @classmethod
    def row_of(cls, record: Record, recipe: PlateRecipe) -> GoldenPlate:
        """Row with classes and fields."""
        found = record.details
        if not isinstance(found, PlateDetails) or not found.classes or not found.field_offsets:
            raise CalibrationError(
                f"{record.serial}: the inspection does not hold the fields of a plate, as those of earlier versions: "
                "inspect the plate again"
            )
        if (found.field_count and len(found.field_offsets[0])) != len(recipe.plan.plan().rows):
            raise CalibrationError(f"{record.serial} was inspected by another plan: inspect it again")
        return GoldenPlate(
            serial=record.serial,
            inspected_at=record.created_at,
            ln_classes=tuple(tuple(float(np.log(one)) for one in each.measured) for each in found.classes),
            offsets=found.field_offsets,
            verdict=record.verdict,
        )

    @classmethod
    def entries_of(cls, recipe: PlateRecipe) -> dict[str, object]:
        """Plan, pitch, and what fields are compared with."""
        plan = recipe.plan.plan()
        return {
            "plan": [plan.rows, dict(plan.azimuths_deg), plan.module_mm],
            "surface": [recipe.surface.pitch_um, recipe.surface.decides],
            "interior": recipe.interior,
        }

    def values(self) -> FloatArray:
        """(n, C·P − 1) ln ratios of classes and poses to the first of them."""
        logs = np.array([one.ln_classes for one in self.parts]).reshape(len(self.parts), -1)
        return np.asarray(logs @ log_basis(logs.shape[1]).T)

    def t_squared(self, ln_classes: FloatArray, covariance: FloatArray) -> tuple[float, int, float]:
        """T² of the (C, P) ln L of the classes of one more plate, its degrees of freedom, and p value.

        Args:
            ln_classes: (C, P).
            covariance: (C·P, C·P) of them by all that is uncertain, whose form good plates scatter in.

        Raises:
            MeasurementError: the plates are too few, or nothing is stated to vary.
        """
        basis = log_basis(ln_classes.size)
        t2, p_value = like_sample(basis @ ln_classes.ravel(), self.values(), basis @ covariance @ basis.T)
        return t2, len(basis), p_value

    def offsets(self, shape: tuple[int, ...]) -> FloatArray:
        """(n, P, rows, cols) offsets of the fields.

        Raises:
            CalibrationError: they are of another plan.
        """
        found = np.array([part.offsets for part in self.parts], dtype=float)
        if found.shape[2:] != tuple(shape):
            raise CalibrationError(f"the golden plates have another plan than the recipe: {self.anew()}")
        return found

    def pattern(self, shape: tuple[int, ...]) -> FloatArray:
        """(P, rows, cols) mean offsets."""
        return np.asarray(self.offsets(shape).mean(axis=0))

    @property
    def scatter(self) -> float:
        """Standard deviation of the offset of one field from plate to plate, over fields and poses."""
        offsets = np.array([part.offsets for part in self.parts], dtype=float)
        return float(np.sqrt(np.nanmean(offsets.var(axis=0, ddof=1)))) if len(offsets) > 1 else float("nan")


def reference_table(known: GoldenPlates) -> CommandOutput:
    """Golden plates: ratios of their classes, and how much these and the fields vary."""
    values = known.values()
    classes, poses = len(known.parts[0].ln_classes), len(known.poses)
    names = [f"class {number + 1} at {stage:g}°" for number in range(classes) for stage, _ in known.poses]
    columns = ["plate", "inspected", "verdict", *(f"ln {one}" for one in names[1:])]
    rows = [
        [part.serial, part.inspected_at, part.verdict, *(f"{value:+.4f}" for value in row)]
        for part, row in zip(known.parts, values, strict=True)
    ]
    if len(values) > 1:
        rows.append(["scatter", "", "", *(f"{one:.4f}" for one in values.std(axis=0, ddof=1))])
    table = Table(f"golden plates: {known.product}", columns, rows, known.lacking)
    line = f"ln L of classes from that of {names[0]}, over {classes} classes and {poses} poses"
    lines = [line]
    if np.isfinite(known.scatter):
        lines.append(f"a field varies by {known.scatter:.4f} in ln L from plate to plate")
    content = {
        "parts": [part.model_dump() for part in known.parts],
        "mean": values.mean(axis=0).tolist(),
        "scatter": values.std(axis=0, ddof=1).tolist() if len(values) > 1 else None,
        "field_scatter": known.scatter if np.isfinite(known.scatter) else None,
    }
    return CommandOutput(content, (table,), tuple(lines))
