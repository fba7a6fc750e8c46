"""Options of a new recipe, as ``anisoscope recipe new`` takes them."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class NewRecipe:
    """Options of ``anisoscope recipe new``; None where one was not given."""

    product: str | None
    pitch_um: float
    ridge_angle_deg: float | None
    u_ridge_angle_deg: float | None
    height_map: Path | None
    ink: str | None
