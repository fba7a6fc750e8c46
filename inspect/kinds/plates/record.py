"""What a record holds of a plate: contrasts of its classes, fields that deviate, readings and grades of its code."""

from pydantic import BaseModel, ConfigDict

from anisoscope.base.notation import number_name
from anisoscope.record.details import Details
from anisoscope.record.verdict import Verdict

MOST_LISTED = 24
"""Contrasts that a table shows; a plate of many classes has hundreds."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


class PlateContrastRecord(_Part):
    """Ln ratio between two classes at one pose, or of one class between two poses; u is of measured − predicted."""

    name: str
    measured: float
    predicted: float
    u: float
    tolerance: float | None
    guard: float | None
    verdict: Verdict

    @property
    def title(self) -> str:
        """Its name for people."""
        return number_name(self.name)


class FieldRecord(_Part):
    """A field that deviates from its class: row and column from 0 at the top left, ln ratio to the class by pose.

    With a height map it is the ln ratio to what the map predicts. ``looks_like`` names the defect whose predicted
    change is nearest, None where none is near, and ``or_like`` those that these poses do not tell from it. ``p_value``
    is that of the scatter of its class, Holm-adjusted over the plate; ``significant`` says whether it is below the
    level of fields.
    """

    row: int
    col: int
    direction_class: str
    deviations: tuple[float, ...]
    u: float
    verdict: Verdict
    looks_like: str | None
    or_like: tuple[str, ...] = ()
    p_value: float = 1.0
    significant: bool = False

    @property
    def likeness(self) -> str | None:
        """The defects that it looks like, the most likely one first; None where there are none."""
        return None if self.looks_like is None else ", perhaps ".join((self.looks_like, *self.or_like))


class PowerRecord(_Part):
    """Probability that a single field with a defect is found on this plate, by its deviation from its class."""

    defect: str
    power: float


class PlacementRecord(_Part):
    """Placement of the fields of a pose against the fixture: shift (x, y) in mm, turn, and the non-uniformities."""

    shift_mm: tuple[float, float]
    turn_deg: float
    axial: float
    grid: float


class GoldenPlatesRecord(_Part):
    """Comparison of the classes with golden plates: how many, T² and its p value."""

    parts: int
    t2: float
    p_value: float


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

    @property
    def texts(self) -> tuple[str, str]:
        """Grades with their values, measured and predicted."""
        return (
            _graded(self.parameter, self.measured, self.measured_grade),
            _graded(self.parameter, self.predicted, self.predicted_grade),
        )


VALUES = {
    "overall grade": "{grade}",
    "decode": "{grade}",
    "cell modulation": "{grade} (weakest cell {value:.2f})",
    "fixed pattern damage": "{grade} ({value:.0%} of a segment)",
}
"""How a grade is shown with the value of its parameter; others have it in brackets."""


def _graded(parameter: str, value: float, grade: int) -> str:
    return VALUES.get(parameter, "{grade} ({value:.2f})").format(grade=grade, value=value)


class CodeRecord(_Part):
    """The code in every pose: what was read, whether that is right, and the grades."""

    text: str
    symbology: str
    readings: tuple[str | None, ...]
    required: tuple[bool, ...]
    grades: tuple[GradeRecord, ...] = ()
    predicted_readings: tuple[str | None, ...] = ()

    @property
    def unread(self) -> tuple[int, ...]:
        """Poses at which the text had to be read, and was not."""
        return tuple(
            number
            for number, (one, due) in enumerate(zip(self.readings, self.required, strict=True))
            if due and one != self.text
        )


class PlateDetails(Details):
    """Classes, contrasts, deviating fields, correlation with the plan, places, and code of a plate."""

    classes: tuple[ClassRecord, ...] = ()
    contrasts: tuple[PlateContrastRecord, ...] = ()
    fields: tuple[FieldRecord, ...] = ()
    field_count: int = 0
    alike: float | None = None
    code: CodeRecord | None = None
    powers: tuple[PowerRecord, ...] = ()
    placement: tuple[PlacementRecord | None, ...] = ()
    field_offsets: tuple[tuple[tuple[float | None, ...], ...], ...] = ()
    """(P, rows, cols) ln L of every field less the middle of its class; none of plates of very many fields."""
    golden: GoldenPlatesRecord | None = None

    @property
    def listed(self) -> tuple[PlateContrastRecord, ...]:
        """Contrasts to be shown: all of a few; of many those that do not pass, then those that are most off."""
        if len(self.contrasts) <= MOST_LISTED:
            return self.contrasts
        ranked = sorted(
            self.contrasts, key=lambda one: (one.verdict == "PASS", -abs(one.measured - one.predicted))
        )
        return tuple(ranked[:MOST_LISTED])

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

    @property
    def near_limit(self) -> bool:
        """Whether a contrast or a field is too close to its limit to decide."""
        return "INCONCLUSIVE" in (
            *(one.verdict for one in self.contrasts),
            *(one.verdict for one in self.fields),
        )

    def compared(self) -> dict[str, float]:
        """The contrasts."""
        return {one.name: one.measured for one in self.contrasts}
