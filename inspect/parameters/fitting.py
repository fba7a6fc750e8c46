"""Fits to measured values (`anisoscope.operations.fit`)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from anisoscope.base.errors import UsageError


@dataclass(frozen=True)
class FitStart:
    """Model of a fit, and its parameters that belong to no part; of free ones it is where the search starts.

    Attributes:
        free: free parameters, comma-separated: ridge_angle, alpha_along, alpha_across, height_loss, seating_x,
            seating_y, k, albedo, index, tail, second_weight, second_width, edge_radius, foot_radius, draft, matte; all:
            the first seven.
        model: the corrected model, or as published.
        seating_x_deg: seating tilt of the part about x in degrees.
        seating_y_deg: seating tilt of the part about y in degrees.
        k: scale between radiance and the unit of the table.
        bounces: reflections of the corrected model: 1 is direct light; a larger number, or all. All by default; of the
            published experiment 1.

    Raises:
        UsageError: no reflections, or more than the model knows.
    """

    free: tuple[str, ...] | None = None
    model: Literal["printed", "corrected"] = "corrected"
    seating_x_deg: float = 0.0
    seating_y_deg: float = 0.0
    k: float = 1.0
    bounces: int | Literal["all"] | None = None

    def __post_init__(self) -> None:
        if isinstance(self.bounces, int) and self.bounces < 1:
            raise UsageError(f"--bounces must be 1 or more, or all, not {self.bounces}")
        if self.model == "printed" and self.bounces not in (None, 1):
            raise UsageError(
                f"--bounces {self.bounces} needs --model corrected; printed knows direct light only"
            )

    def counted(self, usual: int | None = None) -> int | None:
        """Reflections that count, None for all; ``usual`` where nothing is stated."""
        if self.model == "printed":
            return 1
        return usual if self.bounces is None else None if self.bounces == "all" else self.bounces


@dataclass(frozen=True)
class TableValues:
    """Values of a table of exposures or contrasts.

    Attributes:
        kind: what the values are; of an exposure table: which contrasts are formed and fitted.
        errors: contrasts that share a photograph: correlated, or independent.
        covariance: CSV without header: N × N covariance, in place of u.
    """

    kind: Literal["exposure", "difference", "michelson", "log_ratio"] | None = None
    errors: Literal["shared", "independent"] = "shared"
    covariance: Path | None = None


@dataclass(frozen=True)
class BrdfComparison:
    """Comparison of a measured BRDF with a model.

    Attributes:
        fit: fit; otherwise only compare.
        wavelength_nm: wavelength in nm, of a table with several.
    """

    fit: bool = False
    wavelength_nm: float | None = None
