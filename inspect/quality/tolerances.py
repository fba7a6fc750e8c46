"""Specification limits: given, from a recipe, or from the history."""

import numpy as np

from anisoscope.base.errors import UsageError
from anisoscope.history.chain import KEPT
from anisoscope.history.rows import contrast_label
from anisoscope.quality.capability import Specification
from anisoscope.quality.readings import Readings
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.sim.light.contrasts import consecutive_pairs

DEVIATION, TOLERANCE, DOUBT = "deviation ", "tolerance ", "u "
SAME = 4.0 * KEPT  # two predictions of one recipe differ by rounding only


def recipe_tolerances(recipe: SurfaceRecipe) -> dict[str, float]:
    """The tolerance of every contrast of a recipe, by its label.

    Raises:
        UsageError: the recipe gives none.
    """
    tolerances = recipe.tolerances()
    if tolerances is None:
        raise UsageError(
            f"the recipe of {recipe.product} has no decision.tolerance: give --lower and --upper"
        )
    poses = recipe.poses.poses()
    names = [
        contrast_label(recipe.decision.contrast, poses[i].stage_deg, poses[j].stage_deg, poses[i].tilt_deg)
        for i, j in consecutive_pairs(poses)
    ]
    return dict(zip(names, tolerances, strict=True))


def specification(
    readings: Readings, number: str, tolerances: dict[str, float] | None = None
) -> Specification | None:
    """Specification limits of a number from a recipe or from the readings' own tolerances.

    A deviation lies within ± its tolerance, a contrast within its prediction ± its tolerance.

    Args:
        readings: the number and, where they come from a history, their ``deviation …`` and ``tolerance …``.
        number: which number.
        tolerances: of a recipe, by contrast; None for those of the history.

    Returns:
        None where neither states them.

    Raises:
        UsageError: the parts were predicted or tolerated differently, so that no one pair of limits holds.
    """
    contrast = number.removeprefix(DEVIATION)
    width = tolerances.get(contrast) if tolerances is not None else _one(readings, TOLERANCE + contrast)
    if width is None:
        return None
    if number != contrast:
        return Specification(-width, width)
    if DEVIATION + contrast not in readings.numbers:
        return None
    predicted = readings.numbers[contrast] - readings.numbers[DEVIATION + contrast]
    known = predicted[~np.isnan(predicted)]
    if len(known) == 0:
        return None
    if float(np.ptp(known)) > SAME * float(np.nanmax(np.abs(readings.numbers[contrast]))):
        raise UsageError(
            f"{readings.source}: {contrast} was predicted as {known.min():.4g} to {known.max():.4g}: chart "
            f"--number {DEVIATION + contrast!r}, or choose one recipe"
        )
    return Specification(float(known[0]) - width, float(known[0]) + width)


def _one(readings: Readings, name: str) -> float | None:
    """The value of a number that is the same everywhere."""
    found = readings.numbers.get(name)
    known = np.array([]) if found is None else found[~np.isnan(found)]
    if len(known) == 0:
        return None
    if float(np.ptp(known)) > SAME * float(known.max()):
        raise UsageError(
            f"{readings.source}: {name} is {known.min():.4g} for some parts and {known.max():.4g} for others: "
            "choose one recipe, or give --lower and --upper"
        )
    return float(known[0])


def charted(readings: Readings) -> tuple[str, ...]:
    """Names of the numbers that are worth a chart: all but uncertainties and tolerances."""
    return tuple(name for name in readings.numbers if not name.startswith((TOLERANCE, DOUBT)))
