"""The ridge design with the most contrast, nominal or under tolerances."""

from collections.abc import Mapping
from dataclasses import dataclass

from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light.geometry import directions
from anisoscope.study.box import check_bounds
from anisoscope.study.objective import Part, Scoring
from anisoscope.study.optimum import Optimum, optimum
from anisoscope.study.sweep import Workers


@dataclass(frozen=True, eq=False)
class Best:
    """Best design within bounds.

    Attributes:
        optimum: under the tolerances, or nominal where there are none.
        nominal: without tolerances, beside a robust one; None where it is the same.
        scoring: the objective.
    """

    optimum: Optimum
    nominal: Optimum | None
    scoring: Scoring


def optimise(
    vary: Mapping[str, tuple[float, float]],
    *,
    design: RidgeDesign | None = None,
    material: Material | None = None,
    scoring: Scoring | None = None,
    workers: Workers | None = None,
    on_progress: Advance = silent,
) -> Best:
    """Search a box of design parameters for the most contrast.

    Args:
        vary: parameter -> its bounds; ridge_angle in degrees, pitch in µm, alpha_along, alpha_across.
        design: the other parameters of the ridges; 100 µm and 10° by default.
        material: the plastic.
        scoring: contrast, poses, tolerances; by default the difference between 0° and 90°, all reflections.
        workers: processes; one by default.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        UsageError: unknown parameters, empty bounds, or a pitch that has no effect.
        ModelError: a pose below the horizon, or plastic outside the model's range.
        HeightMapError: ridges that are none.
    """
    asked, used = Scoring() if scoring is None else scoring, Workers(1) if workers is None else workers
    part = Part.of(design or RidgeDesign(100.0, 10.0), material or Material())
    directions(asked.poses, asked.convention)
    check_bounds(vary, part, asked)
    best, plain = optimum(part, vary, asked, used, on_progress), None
    if asked.tolerances is not None and ("pitch" not in vary or part.edge_radius > 0.0):
        plain = optimum(part, vary, asked.nominal, used, on_progress)
    return Best(best, plain, asked)
