"""Options of a new recipe, as ``anisoscope recipe new`` takes them."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class NewRecipe:
    """Options of ``anisoscope recipe new``; None where one was not given.

    `largest_mm` is the side of the square that the markers of the fixture leave free.
    """

    product: str | None
    pitch_um: float
    ridge_angle_deg: float | None
    u_ridge_angle_deg: float | None
    height_map: Path | None
    ink: str | None
    largest_mm: float | None = None
