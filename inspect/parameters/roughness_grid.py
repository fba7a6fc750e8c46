"""Roughnesses over which the published findings are mapped (`anisoscope.experiment.findings_map`)."""

from dataclasses import dataclass

from anisoscope.base.errors import UsageError


@dataclass(frozen=True)
class RoughnessGrid:
    """Roughnesses along and across the ridges, even in the logarithm.

    Attributes:
        grid_points: roughnesses per side of the grid, 2 to 100.
        alpha_from: smallest roughness of the grid.
        alpha_to: largest roughness of the grid.

    Raises:
        UsageError: another number of points, or roughnesses that do not rise from above 0.
    """

    grid_points: int = 24
    alpha_from: float = 0.03
    alpha_to: float = 0.3

    def __post_init__(self) -> None:
        if not 2 <= self.grid_points <= 100:
            raise UsageError(f"--grid-points takes 2 to 100, not {self.grid_points}")
        if not 0.0 < self.alpha_from < self.alpha_to:
            raise UsageError(
                f"--alpha-from {self.alpha_from} must lie above 0 and below --alpha-to {self.alpha_to}"
            )
