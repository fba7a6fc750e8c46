"""What the recipe of a print can tell before anything moves: uncertainties of what is judged, causes told apart."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.diagnosis.separability import Separability, separability
from anisoscope.prints.causes import U_BACKGROUND, known_causes
from anisoscope.prints.deciding import PrintDecision, decide_print
from anisoscope.prints.expecting import PrintExpectation, rig_sources
from anisoscope.prints.measuring import MeasuredPrint, cell_grid
from anisoscope.prints.recipe import PrintRecipe
from anisoscope.prints.sources import Source, of_poses, total

FloatArray = npt.NDArray[np.float64]

WANTED_RATIO = 1.5
DIM = 0.1
"""Brightness of a pose, by the brightest, below which a longer exposure is worth while."""
_CURL_U_DEG = 0.05


@dataclass(frozen=True)
class PlannedQuantity:
    """What an inspection will know of a quantity: its standard uncertainty, and T/U of the limit."""

    name: str
    title: str
    unit: str
    limit: float
    u: float

    @property
    def ratio(self) -> float | None:
        """T/U; below 1.5 good prints often end undecided."""
        return None if self.u == 0.0 else self.limit / (2.0 * self.u)


@dataclass(frozen=True)
class PlannedPose:
    """A pose as it is predicted: red, green and blue in 1/sr, and how bright by the brightest pose."""

    stage_deg: float
    tilt_deg: float
    channels: tuple[float, float, float]
    brightness: float


@dataclass(frozen=True)
class PrintRecipeCheck:
    """What the recipe of a print can tell."""

    poses: tuple[PlannedPose, ...]
    quantities: tuple[PlannedQuantity, ...]
    causes: tuple[Separability, ...]
    matrix_residual: float
    complaints: tuple[str, ...]


def check_print_recipe(recipe: PrintRecipe, expected: PrintExpectation) -> PrintRecipeCheck:
    """Look at the recipe of a print; nothing moves.

    Args:
        recipe: the recipe.
        expected: what it predicts.

    Raises:
        MeasurementError: the poses do not determine the lobe.
    """
    poses = len(expected.poses)
    # the lamp drifts by a quarter of its limit; noise is small against the rest and left out
    lamp = 0.25 * recipe.limits.drift / np.sqrt(3.0)
    drift = of_poses("drift of the lamp", "measurement", np.full((poses, 3), lamp))
    decision = _as_predicted(recipe, expected, drift)
    covariance = total((*expected.sources, *rig_sources(recipe, expected), drift), 3 * poses)
    extra = 0 if recipe.area is None else 1
    whole = np.zeros((3 * poses + extra, 3 * poses + extra))
    whole[: 3 * poses, : 3 * poses] = covariance
    if extra:
        whole[-1, -1] = _CURL_U_DEG**2
    causes = separability(
        known_causes(recipe, expected, decision.fit, extra),
        whole,
        with_map=bool(extra),
        u_background=U_BACKGROUND,
    )
    quantities = tuple(
        PlannedQuantity(
            one.name, one.title if one.name != "delta_e" else "ΔE2000", one.unit, one.limit, one.u
        )
        for one in decision.quantities
    )
    planned = _poses(expected)
    return PrintRecipeCheck(
        planned, quantities, causes, expected.eye.residual, _complaints(recipe, planned, quantities)
    )


def _as_predicted(recipe: PrintRecipe, expected: PrintExpectation, drift: Source) -> PrintDecision:
    """The verdict on a print that shows exactly what is predicted."""
    alone = recipe.model_copy(update={"area": None})
    channels = expected.channels
    measured = MeasuredPrint(
        channels,
        channels[:, :, None, None],
        np.zeros_like(channels),
        (drift,),
        cell_grid(alone),
        None,
    )
    return decide_print(expected, measured, alone)


def _poses(expected: PrintExpectation) -> tuple[PlannedPose, ...]:
    bright = expected.channels.max(axis=1)
    found = []
    for pose, channels, level in zip(expected.poses, expected.channels, bright, strict=True):
        red, green, blue = (float(value) for value in channels)
        found.append(
            PlannedPose(pose.stage_deg, pose.tilt_deg, (red, green, blue), float(level / bright.max()))
        )
    return tuple(found)


def _complaints(
    recipe: PrintRecipe, poses: tuple[PlannedPose, ...], quantities: tuple[PlannedQuantity, ...]
) -> tuple[str, ...]:
    found = []
    darkest = min(poses, key=lambda one: one.brightness)
    if darkest.brightness < DIM and not recipe.acquisition.brackets:
        found.append(
            f"at tilt {darkest.tilt_deg:g}° the print is {darkest.brightness:.1%} as bright as in its brightest pose: "
            "set acquisition.brackets, such as [8.0]"
        )
    weak = [one for one in quantities if one.ratio is not None and one.ratio < WANTED_RATIO]
    found += [
        f"T/U of {one.title} is {one.ratio:.1f} ({WANTED_RATIO:g} wanted): good prints may end undecided; widen the "
        "limit, or lessen the uncertainties"
        for one in weak
    ]
    return tuple(found)
