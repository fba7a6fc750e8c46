"""Comparison of the measurement with both surfaces of a recipe: the design and the height map.

A recipe with both surfaces states which one decides; the other one is compared as well, and both results together
locate the problem: the shape, the height map, or dirt, plastic and rig.
"""

from collections.abc import Callable

from anisoscope.base.errors import AnisoscopeError
from anisoscope.decision.consistency_test import from_prediction
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.prediction.expectation import Expectation, expectation
from anisoscope.recipe.surface import Surface, SurfaceRecipe
from anisoscope.record.schema import ComparisonRecord

Predict = Callable[[SurfaceRecipe, float], Expectation]
"""Predicts a recipe by the rig's light angle: anew, or by what is kept."""

READINGS = {
    (True, True): "as designed, and the light agrees with the height map",
    (True, False): (
        "as designed, but not as the height map says: is it of another part or place, or was it measured wrongly?"
    ),
    (False, True): "a shape defect: the part is not as designed, and the light agrees with its height map",
    (
        False,
        False,
    ): "neither as designed nor as the height map says: dirt or film, another plastic, or the rig",
}
"""What it means, by (agrees with the design, agrees with the height map)."""


def compare(
    recipe: SurfaceRecipe, expected: Expectation, measured: Measured, predict: Predict = expectation
) -> tuple[tuple[ComparisonRecord, ...], str | None, str | None]:
    """Compare with both surfaces of a recipe.

    Args:
        recipe: the recipe.
        expected: the prediction from the surface that decides.
        measured: the measurement.
        predict: predicts the surface that does not decide.

    Returns:
        The comparisons, their joint interpretation (None of a recipe with one surface), and a note where the surface
        that does not decide could not be compared.
    """
    decides = recipe.surface.decides
    mine = _one(decides, expected, measured, recipe, decides=True)
    if not recipe.surface.both:
        return (mine,), None, None
    other: Surface = "design" if decides == "height_map" else "height_map"
    try:
        second = predict(recipe.against(other), expected.convention.light_angle_deg)
        found = (mine, _one(other, second, measured, recipe, decides=False))
    except AnisoscopeError as problem:
        return (mine,), None, f"no comparison with the {other.replace('_', ' ')}: {problem}"
    agrees = {one.surface: one.agrees for one in found}
    return found, READINGS[agrees["design"], agrees["height_map"]], None


def _one(
    surface: Surface, expected: Expectation, measured: Measured, recipe: SurfaceRecipe, *, decides: bool
) -> ComparisonRecord:
    d2, dof, p_value = from_prediction(expected, measured)
    return ComparisonRecord(
        surface=surface,
        decides=decides,
        model=expected.model,
        predicted=tuple(float(value) for value in expected.radiance),
        d2=d2,
        dof=dof,
        p_value=p_value,
        agrees=p_value >= recipe.decision.alpha,
    )
