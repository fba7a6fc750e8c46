"""Check of a recipe before inspection: what it has in common for all kinds of parts.

A kind subclasses `RecipeCheck` with what it plans, and gives tables and notes of its own; the findings, the table of
causes and the output of ``anisoscope recipe check`` are the same for all.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

from anisoscope.base.json_fields import LEFT_OUT, as_json, in_json
from anisoscope.decision.exclusion import MORE_POSES, PlannedLimit, planned_text
from anisoscope.diagnosis.separability import Separability
from anisoscope.kinds.command_output import CommandOutput, Table

Level = Literal["note", "warning"]


@dataclass(frozen=True)
class Finding:
    """One line: a note says what is so, a warning what should be changed."""

    level: Level
    text: str


@dataclass(frozen=True, kw_only=True)
class RecipeCheck:
    """Capability of a recipe.

    Attributes:
        product: of the recipe.
        causes: separability of every cause.
        complaints: one line each, what should be changed.
        frames: one line each, what frames of a part show of the recipe, where it was checked with some.
        unchecked: what could not be checked without devices, in one line, or None.
        excludes: largest sizes of the named defects that are not excluded of a part as designed, without golden parts.
        remedy: cheapest way to smaller ones.
    """

    product: str
    causes: tuple[Separability, ...] = ()
    complaints: tuple[str, ...] = ()
    frames: tuple[str, ...] = ()
    unchecked: str | None = None
    excludes: tuple[PlannedLimit, ...] = ()
    remedy: str = field(default=MORE_POSES, metadata=LEFT_OUT)

    def tables(self) -> tuple[Table, ...]:
        """Tables of the kind, which go before that of the causes."""
        return ()

    def notes(self) -> tuple[str, ...]:
        """One line each, what is so."""
        return (f"{self.product}: the recipe can be read",)

    @property
    @in_json()
    def findings(self) -> tuple[Finding, ...]:
        """The notes, then the complaints."""
        unchecked = () if self.unchecked is None else (f"not checked: {self.unchecked}",)
        texts = (*planned_text(self.excludes, self.remedy), *self.notes(), *self.frames, *unchecked)
        notes = [Finding("note", text) for text in texts]
        return (*notes, *(Finding("warning", text) for text in self.complaints))

    def output(self) -> CommandOutput:
        """Output of ``anisoscope recipe check``."""
        causes = (causes_table(self.causes),) if self.causes else ()
        lines = tuple(one.text for one in self.findings)
        tables = (*_excluded_table(self.excludes), *self.tables(), *causes)
        return CommandOutput(as_json(self), lines=lines, behind=tables)


def _excluded_table(excludes: tuple[PlannedLimit, ...]) -> tuple[Table, ...]:
    """Limits of a part as designed, in the best and in the worst case where these differ."""
    if not excludes:
        return ()
    one_case = all(one.best == one.worst for one in excludes)
    columns = ["possible up to"] if one_case else ["best lobe: up to", "worst lobe: up to"]
    rows = [
        [
            one.defect,
            *([one.worst] if one_case else [one.best, one.worst]),
            "yes" if one.excluded else "no",
        ]
        for one in excludes
    ]
    return (
        Table(
            "what a part as designed may still have",
            ["defect, at its smallest interesting size", *columns, "excluded"],
            rows,
            "one side, 95 %, without golden parts",
        ),
    )


def causes_table(causes: Iterable[Separability]) -> Table:
    """From which extent on every cause shows, and from which on no other looks the same."""
    causes = list(causes)
    titles = {cause.cause: cause.title for cause in causes}
    return Table(
        "causes",
        ["cause", "found from", "distinguished from", "never distinguished from"],
        [
            [
                cause.title,
                _extent(cause.detection_extent, cause.unit),
                _extent(cause.separation_extent, cause.unit),
                "; ".join(titles.get(name, name) for name in cause.inseparable_causes),
            ]
            for cause in causes
        ],
        "from which extent on a cause shows (3 standard uncertainties) and no other looks the same",
    )


def _extent(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{abs(value):.3g} {unit}".strip()
