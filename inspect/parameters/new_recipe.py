"""A new recipe, and with it a new job (`anisoscope.kinds.parts.Beginning`)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from anisoscope.parameters.ridges import LIKELY_PITCH


@dataclass(frozen=True)
class NewRecipe:
    """Part that a new recipe is for; None where it was not stated.

    Attributes:
        kind: kind of part by name, such as ridges or prints; else the other options decide.
        product: name of the product.
        pitch_um: pitch of the ridges in µm.
        ridge_angle_deg: ridge angle of the ideal design in degrees.
        u_ridge_angle_deg: standard deviation of the ridge angle of good parts, degrees.
        height_map: height map of a good part or of the tool.
        ink: for a print instead: its ink, a file or one of the package, such as synthetic-red.
        largest_mm: side of the square that the markers of the fixture leave free.
    """

    kind: str | None = None
    product: str | None = None
    pitch_um: Annotated[float, LIKELY_PITCH] = 100.0
    ridge_angle_deg: float | None = None
    u_ridge_angle_deg: float | None = None
    height_map: Path | None = None
    ink: str | None = None
    largest_mm: float | None = None
