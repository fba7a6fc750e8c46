"""A defect of a recipe's ``[defects]``, with its smallest interesting size."""

from dataclasses import dataclass


@dataclass(frozen=True)
class NamedDefect:
    """A defect with its smallest interesting size.

    Attributes:
        words: what it is, up to its size.
        size: in its unit.
        unit: "°", "%" or " µm".
    """

    words: str
    size: float
    unit: str

    @property
    def name(self) -> str:
        """Its name with the smallest interesting size."""
        return self.of_size(1.0)

    def of_size(self, multiple: float) -> str:
        """The defect at a multiple of that size."""
        return f"{self.words}{self.text(multiple)}"

    def text(self, multiple: float) -> str:
        """A multiple of that size with its unit, to two digits."""
        return f"{float(f'{multiple * self.size:.2g}'):g}{self.unit}"
