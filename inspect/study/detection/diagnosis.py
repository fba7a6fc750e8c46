"""Diagnosis of the parts of a study: causes with their extents, and fitted shapes.

Both need only the radiances stored with a chunk, so that they are computed at evaluation.
"""

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.diagnosis.evidence import Evidence, against, background_of, covariance_of, inputs_of
from anisoscope.diagnosis.ranking import NOTHING, diagnose
from anisoscope.diagnosis.separability import Separability, planned_covariance, planned_inputs, separability
from anisoscope.diagnosis.shape_fit import fit_shape
from anisoscope.diagnosis.signature_cache import cached_signatures
from anisoscope.diagnosis.signatures import Signatures, signatures
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.prediction.expectation import Component
from anisoscope.record.schema import CauseRecord
from anisoscope.study.detection.chunk import MEASURED_SOURCES
from anisoscope.study.detection.product import (
    BY_NAME,
    LIGHT_DEG,
    RIDGE_ANGLE_DEG,
    WHOLE,
    RecipeName,
    Size,
    expected_of,
    recipe_of,
)

Columns = dict[str, npt.NDArray[Any]]

SHARED_SOURCES = ("stray light",)
COVERAGE = 1.959964
FITTED = 60
"""Good parts to which shapes are fitted, a second each."""


@lru_cache(maxsize=8)
def signatures_of(name: RecipeName, size: Size, *, stated: bool = False) -> Signatures:
    """Signatures of the causes for the poses of a recipe; arguments as for `recipe_of`."""
    recipe = recipe_of(name, size, stated=stated)
    if size.causes is None:
        return cached_signatures(recipe, LIGHT_DEG)
    return signatures(recipe, LIGHT_DEG, names=size.causes)


def separability_of(name: RecipeName, size: Size) -> dict[str, Separability]:
    """Separability of the causes under a recipe."""
    recipe = recipe_of(name, size)
    assert recipe.area is not None
    u_background = background_of(recipe.area.max_share)[1]
    covariance = planned_covariance(recipe, expected_of(name, size))
    inputs = planned_inputs(recipe, expected_of(name, size))
    known = signatures_of(name, size)
    rows = separability(known, covariance, with_map=True, u_background=u_background, inputs=inputs)
    return {row.cause: row for row in rows}


def components_of(data: Columns, name: RecipeName, number: int) -> tuple[Component, ...]:
    """Components of the measurement of one part."""
    return tuple(
        Component(source, "measurement", relative, source in SHARED_SOURCES)
        for source, relative in zip(MEASURED_SOURCES, data[f"{name}/own"][number], strict=True)
    )


def evidence(
    data: Columns,
    name: RecipeName,
    size: Size,
    number: int,
    golden: FloatArray | None,
    *,
    stated: bool = False,
) -> Evidence:
    """Evidence for the diagnosis of one part, as in ``inspect``.

    Args:
        data: columns of a class.
        name: of the recipe.
        size: of the study.
        number: of the part.
        golden: (n, P) ln L over the prediction of golden parts, from whose mean the part deviates; None: from the
            prediction.
        stated: the recipe states how much the ridge angle of good parts spreads.
    """
    recipe, expected = recipe_of(name, size, stated=stated), expected_of(name, size, stated=stated)
    components = components_of(data, name, number)
    deviation = np.asarray(data[f"{name}/deviation"][number], dtype=np.float64)
    scale_share = recipe.uncertainty.scale_share
    covariance = covariance_of(expected.components + components, scale_share, len(deviation))
    assert recipe.area is not None
    background = background_of(recipe.area.max_share)
    inputs = inputs_of(recipe, expected, components)
    share, u_share = float(data[f"{name}/share"][number]), float(data[f"{name}/u_share"][number])
    found = Evidence(deviation, covariance, share, u_share, *background, inputs)
    return found if golden is None else against(found, golden, scale_share)


def diagnosed(
    kind: str, data: Columns, name: RecipeName, size: Size, count: int, golden: FloatArray | None = None
) -> Columns:
    """First causes of the first parts of a class, what ties with them, and the extent of the true cause.

    ``wrong`` is a confident wrong name: neither the true cause nor "nothing" ties, and the best one explains the part.
    """
    known, cause = signatures_of(name, size), BY_NAME[kind].cause
    alpha = recipe_of(name, size).decision.alpha
    rows = []
    for number in range(min(count, len(data["extent"]))):
        diagnosis = diagnose(known, evidence(data, name, size, number, golden))
        ties = {one.cause for one in diagnosis.ties}
        first = diagnosis.causes[0].cause
        right = next((one for one in diagnosis.causes if one.cause == cause), None)
        wrong = not ties & {cause, NOTHING} and diagnosis.unexplained_p >= alpha
        rows.append((first, diagnosis.causes[1].cause, cause in ties, wrong, len(ties), *_fit_of(right)))
    names = ("first", "second", "tied", "wrong", "ties", "extent", "u", "low", "high")
    return {title: np.array(values) for title, values in zip(names, zip(*rows, strict=True), strict=True)}


def _fit_of(found: CauseRecord | None) -> tuple[float, float, float, float]:
    """Severity, u (infinite where undetermined) and 95 % interval (NaN where open); NaN without the cause."""
    if found is None:
        return np.nan, np.nan, np.nan, np.nan
    low, high = (np.nan if end is None else end for end in found.interval or (None, None))
    return found.severity, np.inf if found.u is None else found.u, low, high


def true_extents(kind: str, data: Columns, size: Size) -> FloatArray:
    """Extents as they truly are: the scatter of good parts adds to some; ridges may be missing in part."""
    if kind == "ridge-angle":
        return np.asarray(data["ridge_angle_deg"] - RIDGE_ANGLE_DEG)
    if kind == "roughness":
        return np.asarray(np.exp(data["across"]) - 1.0)
    if kind == "missing-ridges":  # of the area that is cut out, half a pitch wider on both sides
        return np.asarray(data["spoiled"] * (size.ridges + 1) / size.ridges)
    return np.asarray(data["extent"], dtype=np.float64)


def fitted_shapes(data: Columns, name: RecipeName, size: Size) -> dict[str, npt.NDArray[np.bool_]]:
    """Whether the 95 % interval of every shape parameter that was determined holds the truth, by its name."""
    recipe, expected = recipe_of(name, size), expected_of(name, size)
    nowhere = Grid((0.0, 0.0), 1.0, (1, 1))
    held: dict[str, list[bool]] = {}
    for number in range(min(FITTED, len(data["extent"]))):
        radiance = expected.radiance * np.exp(data[f"{name}/deviation"][number])
        cells = np.zeros((len(radiance), 1, 1))
        components = components_of(data, name, number)
        measured = Measured(radiance, components, (), cells, np.zeros(len(radiance)), nowhere, None)
        shape, _ = fit_shape(recipe, expected, measured)
        truth = {
            "ridge_angle_deg": data["ridge_angle_deg"][number],
            "alpha_along": WHOLE.alpha_along * np.exp(data["along"][number]),
            "alpha_across": WHOLE.alpha_across * np.exp(data["across"][number]),
        }
        for one in () if shape is None else shape.estimates:
            if one.value is not None and one.u is not None and not one.at_bound and one.name in truth:
                off = abs(one.value - float(truth[one.name]))
                held.setdefault(one.name, []).append(off <= COVERAGE * one.u)
    return {parameter: np.array(values) for parameter, values in held.items()}
