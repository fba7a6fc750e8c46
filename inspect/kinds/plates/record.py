"""What a record holds of a plate: contrasts of its classes, fields that deviate, readings and grades of its code."""

from pydantic import BaseModel, ConfigDict

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

    With a height map it is the ln ratio to what the map predicts. ``looks_like`` names the defect whose predicted
    change is nearest, None where none is near. ``p_value`` is that of the scatter of its class, Holm-adjusted over the
    plate; ``significant`` says whether it is below the level of fields.
    """

    row: int
    col: int
    direction_class: str
    deviations: tuple[float, ...]
    u: float
    verdict: Verdict
    looks_like: str | None
    p_value: float = 1.0
    significant: bool = False


class PowerRecord(_Part):
    """Probability that a single field with a defect is found on this plate, by its deviation from its class."""

    defect: str
    power: float


class PlacementRecord(_Part):
    """How the fields of a pose lie against the fixture: shift (x, y) in mm, turn, and the non-uniformities."""

    shift_mm: tuple[float, float]
    turn_deg: float
    axial: float
    grid: float


class GoldenPlatesRecord(_Part):
    """Comparison of the classes with golden plates: how many, Hotelling's T² and its p value."""

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
