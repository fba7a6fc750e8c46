"""For which roughness the published findings hold: the experiment over a grid of α_u and α_v."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.experiment.experiment import (
    PUBLISHED_BEST_DEG,
    STAGE_DEG,
    TILTS_DEG,
    Model,
    Setup,
    contrast_table,
    findings,
)
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.material import Material
from anisoscope.parameters.roughness_grid import RoughnessGrid
from anisoscope.sim.light.geometry import directions, pose_grid

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class FindingsMap:
    """Findings over a grid of roughnesses; boolean arrays are (alpha_along, alpha_across).

    Attributes:
        setup: model and convention; the roughness of its material is not used.
        alpha_along: (A,) α_u.
        alpha_across: (B,) α_v.
        max_at_zero_tilt: the finding holds.
        falls_on_both_sides: it also falls monotonically; not among the three.
        first_pair_larger: the finding holds.
        best_at_five: the finding "5° gives the highest contrast" holds.
    """

    setup: Setup = field(metadata=json_field(merged=True))
    alpha_along: FloatArray = field(metadata=LEFT_OUT)
    alpha_across: FloatArray = field(metadata=LEFT_OUT)
    max_at_zero_tilt: BoolArray = field(metadata=LEFT_OUT)
    falls_on_both_sides: BoolArray = field(metadata=LEFT_OUT)
    first_pair_larger: BoolArray = field(metadata=LEFT_OUT)
    best_at_five: BoolArray = field(metadata=LEFT_OUT)

    @property
    @in_json()
    def shares(self) -> dict[str, float]:
        """Share of the grid on which each finding holds, 0 to 1."""
        names = ("max_at_zero_tilt", "falls_on_both_sides", "first_pair_larger", "best_at_five")
        return {name: float(getattr(self, name).mean()) for name in names}

    @property
    @in_json()
    def all_three(self) -> BoolArray:
        """Grid points at which the three findings hold together."""
        return self.max_at_zero_tilt & self.first_pair_larger & self.best_at_five

    @property
    @in_json()
    def share(self) -> float:
        """Share of the grid on which the three findings hold together, 0 to 1."""
        return float(self.all_three.mean())

    @property
    def falling_too(self) -> BoolArray:
        """Grid points at which they hold and the mean contrast falls monotonically on both sides of zero tilt."""
        return self.all_three & self.falls_on_both_sides

    @property
    @in_json()
    def share_falling_too(self) -> float:
        """Share of the grid on which they hold and the mean contrast falls on both sides, 0 to 1."""
        return float(self.falling_too.mean())

    @property
    @in_json()
    def extent(self) -> dict[str, tuple[float, float]] | None:
        """Smallest and largest alpha_along and alpha_across at which all three hold; None where they nowhere do."""
        if not self.all_three.any():
            return None
        along = self.alpha_along[self.all_three.any(axis=1)]
        across = self.alpha_across[self.all_three.any(axis=0)]
        ends = {"alpha_along": along, "alpha_across": across}
        return {name: (float(values[0]), float(values[-1])) for name, values in ends.items()}


@dataclass(frozen=True, eq=False)
class FindingsMaps:
    """The maps of both planes of tilt, over the same roughnesses."""

    maps: tuple[FindingsMap, ...]

    @property
    @in_json()
    def model(self) -> Model:
        """Model of the prediction."""
        return self.maps[0].setup.model

    @property
    @in_json()
    def alpha_along(self) -> FloatArray:
        """(A,) α_u."""
        return self.maps[0].alpha_along

    @property
    @in_json()
    def alpha_across(self) -> FloatArray:
        """(B,) α_v."""
        return self.maps[0].alpha_across


class _SharedTables(Material):
    """A material whose mean roughness is rounded: on a grid, many then share one transmittance table."""

    @property
    def alpha_mean(self) -> float:
        return float(f"{super().alpha_mean:.6g}")


def findings_share(setup: Setup, alpha_along: FloatArray, alpha_across: FloatArray) -> FindingsMap:
    """Evaluate the three findings at every pair of roughnesses.

    The share depends on the grid: it is a measure of how far the findings carry, not a probability. Each
    roughness is computed for all poses at once; equal √(α_u·α_v), as of grids even in the logarithm, share the
    transmittance of the corrected model.

    Args:
        setup: model, convention, index and albedo.
        alpha_along: (A,) rising α_u.
        alpha_across: (B,) rising α_v.

    Raises:
        ModelError: a roughness or a pose outside what the model means.
    """
    to_light, to_camera = directions(pose_grid(STAGE_DEG, TILTS_DEG), setup.convention)
    plastic = setup.material
    held = np.zeros((4, len(alpha_along), len(alpha_across)), dtype=np.bool_)
    for i, along in enumerate(alpha_along):
        for j, across in enumerate(alpha_across):
            material = _SharedTables(
                float(along), float(across), plastic.albedo, plastic.index, plastic.internal_reflection
            )
            found = findings(contrast_table(setup, material, to_light, to_camera))
            held[:, i, j] = (
                found.max_at_zero_tilt,
                found.falls_on_both_sides,
                found.first_pair_larger,
                found.best_ridge_angle_deg == PUBLISHED_BEST_DEG,
            )
    return FindingsMap(setup, np.asarray(alpha_along), np.asarray(alpha_across), *held)


@by_keywords(grid=RoughnessGrid)
def findings_maps(setup: Setup | None = None, *, grid: RoughnessGrid) -> FindingsMaps:
    """Where the findings come out, for both planes of tilt.

    Args:
        setup: model, convention, index and albedo.
        grid: `RoughnessGrid`.

    Raises:
        UsageError: a grid that is none.
        ModelError: a roughness or a pose outside what the model means.
    """
    setup = Setup() if setup is None else setup
    replace(setup.material, alpha_along=grid.alpha_from, alpha_across=grid.alpha_to)
    alphas = np.geomspace(grid.alpha_from, grid.alpha_to, grid.grid_points)
    alphas[[0, -1]] = grid.alpha_from, grid.alpha_to
    planes: tuple[Literal["perpendicular", "in-plane"], ...] = ("perpendicular", "in-plane")
    return FindingsMaps(
        tuple(
            findings_share(
                replace(setup, convention=replace(setup.convention, tilt_plane=plane)), alphas, alphas
            )
            for plane in planes
        )
    )
