"""Record of the largest size of a named defect that a part may have."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class ExclusionRecord(BaseModel):
    """Largest size of a named defect that the part may have (one side, 95 %).

    ``words`` and ``size`` with ``unit`` name the defect at its smallest interesting size; ``best`` and ``limit`` are
    multiples of that: the likeliest one, and the largest one that is not excluded, null where none of those tried is.
    ``where`` is the place of the part that may have the largest one, empty where the defect is of the whole part.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)

    words: str
    size: float
    unit: str
    best: float
    limit: float | None
    where: Annotated[str, Field(exclude_if=lambda found: not found)] = ""

    @property
    def excluded(self) -> bool:
        """Whether the defect at its smallest interesting size is excluded."""
        return self.limit is not None and self.limit <= 1.0

    @property
    def name(self) -> str:
        """The defect at its smallest interesting size."""
        return f"{self.words}{self.text(1.0)}"

    @property
    def place(self) -> str:
        """The place after a size, empty for the whole part."""
        return f" at {self.where}" if self.where else ""

    def text(self, multiple: float | None) -> str:
        """A multiple of that size with its unit, to two digits; "any" for None."""
        return "any" if multiple is None else f"{float(f'{multiple * self.size:.2g}'):g}{self.unit}"
