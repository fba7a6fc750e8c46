"""What a record holds of a plate: contrasts of its classes, fields that deviate, readings and grades of its code."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict

from anisoscope.base.arrays import FloatArray
from anisoscope.record.details import Details
from anisoscope.record.verdict import Verdict


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class PlateContrastRecord(_Part):
    """Ln ratio between two classes at one pose, or of one class between two poses; u is of measured − predicted."""

    name: str
    measured: float
    predicted: float
    u: float
    tolerance: float | None
    guard: float | None
    verdict: Verdict


class FieldRecord(_Part):
    """A field that deviates from its class: row and column from 0 at the top left, ln ratio to the class by pose.

    ``looks_like`` names the defect whose predicted change is nearest, None where none is near.
    """

    row: int
    col: int
    direction_class: str
    deviations: tuple[float, ...]
    u: float
    verdict: Verdict
    looks_like: str | None


class ClassRecord(_Part):
    """Fields of one class: median radiance by pose, scatter of ln L between fields, and the prediction."""

    direction_class: str
    facet_azimuth_deg: float
    fields: int
    measured: tuple[float, ...]
    predicted: tuple[float, ...]
    scatter: tuple[float, ...]


class GradeRecord(_Part):
    """One parameter of a code at one pose: values and grades (4 best, 0 fails), measured and predicted."""

    stage_deg: float
    tilt_deg: float
    parameter: str
    measured: float
    measured_grade: int
    predicted: float
    predicted_grade: int


class CodeRecord(_Part):
    """The code in every pose: what was read, whether that is right, and the grades."""

    text: str
    symbology: str
    readings: tuple[str | None, ...]
    required: tuple[bool, ...]
    grades: tuple[GradeRecord, ...] = ()

    @property
    def unread(self) -> tuple[int, ...]:
        """Poses at which the text had to be read, and was not."""
        return tuple(
            number
            for number, (one, due) in enumerate(zip(self.readings, self.required, strict=True))
            if due and one != self.text
        )


class PlateDetails(Details):
    """Classes, contrasts, deviating fields, correlation with the plan, and code of a plate."""

    classes: tuple[ClassRecord, ...] = ()
    contrasts: tuple[PlateContrastRecord, ...] = ()
    fields: tuple[FieldRecord, ...] = ()
    field_count: int = 0
    alike: float | None = None
    code: CodeRecord | None = None

    def numbers(self) -> dict[str, float]:
        """The contrasts by their names, and the number of fields that deviate."""
        found: dict[str, float] = {}
        for one in self.contrasts:
            found |= {
                one.name: one.measured,
                f"u {one.name}": one.u,
                f"deviation {one.name}": one.measured - one.predicted,
            }
            if one.tolerance is not None:
                found[f"tolerance {one.name}"] = one.tolerance
        if self.field_count:
            found["deviating fields"] = float(sum(one.verdict == "FAIL" for one in self.fields))
        return found

    def compared(self) -> dict[str, float]:
        """The contrasts."""
        return {one.name: one.measured for one in self.contrasts}


# ---- grades of the code ----------------------------------------------------------------------------------------

CONTRAST_STEPS = 0.30, 0.25, 0.20, 0.15
MODULATION_STEPS = 0.50, 0.40, 0.30, 0.20
DAMAGE_STEPS = 0.0, 0.09, 0.13, 0.17


@dataclass(frozen=True)
class Grade:
    """Value and grade of one parameter: 4 is the best, 0 fails."""

    parameter: str
    value: float
    grade: int


def graded(
    radiance: FloatArray, dark: npt.NDArray[np.bool_], symbology: str, quiet: int = 1
) -> tuple[Grade, ...]:
    """Grades of a code after ISO/IEC 29158 (cell contrast) and ISO/IEC 15415 (modulation, fixed pattern damage).

    Modulation is the least of all modules, without the allowance for error correction; fixed pattern damage is the
    share of wrong modules in the finder pattern.

    Args:
        radiance: (rows, cols) of the modules, quiet zone included.
        dark: (rows, cols) which of them should be the darker ones.
        symbology: "datamatrix" or "qr".
        quiet: width of the quiet zone in modules.

    Returns:
        Cell contrast, cell modulation, fixed pattern damage, share of wrong modules.
    """
    light_mean, dark_mean = float(np.nanmean(radiance[~dark])), float(np.nanmean(radiance[dark]))
    contrast = (light_mean - dark_mean) / light_mean if light_mean > 0.0 else 0.0
    threshold = 0.5 * (light_mean + dark_mean)
    away = np.where(dark, threshold - radiance, radiance - threshold) / max(
        0.5 * abs(light_mean - dark_mean), 1e-12
    )
    wrong = ~(away > 0.0)
    modulation = max(float(np.nanmin(away)), 0.0)
    inner = wrong[quiet : wrong.shape[0] - quiet, quiet : wrong.shape[1] - quiet]
    damage = max(float(np.mean(part)) for part in _finder(inner, symbology))
    share = float(np.mean(wrong))
    return (
        Grade("cell contrast", contrast, _at_least(contrast, CONTRAST_STEPS)),
        Grade("cell modulation", modulation, _at_least(modulation, MODULATION_STEPS)),
        Grade("fixed pattern damage", damage, _at_most(damage, DAMAGE_STEPS)),
    ) + ((Grade("wrong modules", share, 4 if share == 0.0 else 0),) if share > 0.0 else ())


def _finder(wrong: npt.NDArray[np.bool_], symbology: str) -> list[npt.NDArray[np.bool_]]:
    """Parts of the finder pattern."""
    if symbology == "datamatrix":
        return [wrong[:, 0], wrong[-1]]
    return [wrong[:7, :7], wrong[:7, -7:], wrong[-7:, :7]]


def _at_least(value: float, steps: tuple[float, ...]) -> int:
    return next((4 - n for n, step in enumerate(steps) if value >= step), 0)


def _at_most(value: float, steps: tuple[float, ...]) -> int:
    return next((4 - n for n, step in enumerate(steps) if value <= step), 0)
