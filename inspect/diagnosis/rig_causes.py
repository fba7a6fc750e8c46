"""Faults of the rig that look like defects of the part: turned in its seat, mirrored, one pose scaled, light added.

They compete with the causes of a deviation. Where the part lies otherwise than stated, each pose shows what the
prediction has at another stage angle; nothing is left to be fitted. One pose of another brightness (lamp, exposure,
gain) and light that all poses share (stray light, black level) have one extent each. They are causes of their own
group: where one of them explains a part, there is nothing to put right in the mould.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.diagnosis.evidence import Evidence
from anisoscope.diagnosis.likelihood import Fitted, nothing
from anisoscope.parameters.geometry import Pose
from anisoscope.prediction.expectation import Expectation
from anisoscope.recipe.surface import SurfaceRecipe

Predict = Callable[[SurfaceRecipe], Expectation]

SEATS: Mapping[str, tuple[str, Callable[[float, float], float]]] = {
    "turned-180": ("the part lies turned by 180° in its seat", lambda stage, _: stage + 180.0),
    "turned-90": ("the part lies turned by 90° in its seat", lambda stage, _: stage + 90.0),
    "turned-270": ("the part lies turned by 270° in its seat", lambda stage, _: stage + 270.0),
    "mirrored": ("the part or the picture is mirrored", lambda stage, azimuth: -stage - 2.0 * azimuth),
}
"""Title, and the stage angle at which a part that lies as stated looks alike, by stage angle and facet azimuth."""
POSE_SCALED, LIGHT_ADDED = "pose-scaled", "light-added"
RIG_PRIOR = 0.05
"""Prior probability of a fault of the light, of all poses together."""
MOST_SCALED, MOST_ADDED = 0.7, 1.0
"""Largest |ln| by which a pose is scaled, and light that is added, by the radiance of the darkest pose."""
_STEPS, _COARSE = 281, 10
_ALIKE = 0.01  # ln L: a seat that no pose tells from the right one


@dataclass(frozen=True)
class RigFault:
    """Fit of a fault of the rig.

    Attributes:
        name: as in the record.
        title: what it is, for people.
        fit: its fit; the extent is 0 where it has none.
        extents: number of extents fitted.
        penalty: −2 ln of the prior of what was fitted, the choice of the pose included.
    """

    name: str
    title: str
    fit: Fitted
    extents: int
    penalty: float


def rig_faults(
    recipe: SurfaceRecipe,
    expected: Expectation,
    evidence: Evidence,
    seen_at: Callable[[Expectation], Evidence],
    predict: Predict,
    *,
    light_watched: bool,
) -> tuple[RigFault, ...]:
    """Faults of the rig, fitted to a part.

    Args:
        recipe: the recipe.
        expected: its prediction.
        evidence: of the part against it.
        seen_at: evidence against the prediction of another seat.
        predict: predicts the poses of a recipe.
        light_watched: lamp, exposure and stray light were measured in every frame, and were right.
    """
    seats = [
        RigFault(name, SEATS[name][0], nothing(seen_at(seat)), 0, 0.0)
        for name, seat in other_seats(recipe, expected, predict).items()
    ]
    found = sorted(seats, key=lambda one: one.fit.cost)[:1]
    if light_watched:
        return tuple(found)
    poses = len(expected.poses)
    scales = np.linspace(-MOST_SCALED, MOST_SCALED, _STEPS)
    scales = scales[np.abs(scales) > recipe.limits.drift]
    fits = [_best(evidence, scales, scales[:, None] * np.eye(poses)[k]) for k in range(poses)]
    k = int(np.argmin([fit.cost for fit in fits]))
    title = f"the pose at {_name(expected.poses[k])} has another brightness, by"
    share = replace(fits[k], extent=float(np.expm1(fits[k].extent)))
    found.append(RigFault(POSE_SCALED, title, share, 1, -2.0 * float(np.log(RIG_PRIOR / poses))))
    darkest = float(expected.radiance.min())
    added = np.linspace(-0.5, MOST_ADDED, _STEPS)
    fit = _best(evidence, added, np.log1p(added[:, None] * darkest / expected.radiance))
    title = "light is added to all poses, by"
    return (*found, RigFault(LIGHT_ADDED, title, fit, 1, -2.0 * float(np.log(RIG_PRIOR))))


def _best(evidence: Evidence, extents: FloatArray, changes: FloatArray) -> Fitted:
    """The likeliest of (E,) extents with (E, P) changes of ln L: of every tenth, then of those around it."""

    def fitted(near: range) -> tuple[int, dict[int, Fitted]]:
        fits = {k: nothing(replace(evidence, deviation=evidence.deviation - changes[k])) for k in near}
        return min(fits, key=lambda k: fits[k].cost), fits

    coarse, _ = fitted(range(0, len(extents), _COARSE))
    best, fits = fitted(range(max(coarse - _COARSE, 0), min(coarse + _COARSE + 1, len(extents))))
    return replace(fits[best], extent=float(extents[best]))


def _name(pose: Pose) -> str:
    return f"{pose.stage_deg:g}°" + (f", tilt {pose.tilt_deg:g}°" if pose.tilt_deg else "")


def other_seats(recipe: SurfaceRecipe, expected: Expectation, predict: Predict) -> dict[str, Expectation]:
    """Predictions of the poses for a part that lies otherwise; those that look as the right one are left out.

    One prediction holds all stage angles that are needed.
    """
    azimuth = expected.convention.facet_azimuth_deg
    seen = {
        name: [
            Pose(round(turned(pose.stage_deg, azimuth) % 360.0, 9), pose.tilt_deg) for pose in expected.poses
        ]
        for name, (_, turned) in SEATS.items()
    }
    needed = tuple(dict.fromkeys(pose for poses in seen.values() for pose in poses))
    listed = recipe.poses.model_copy(
        update={"stage_and_tilt_deg": tuple((pose.stage_deg, pose.tilt_deg) for pose in needed)}
    )
    whole = predict(recipe.model_copy(update={"poses": listed}))
    found = {}
    for name, poses in seen.items():
        one = selected(whole, [needed.index(pose) for pose in poses])
        if np.ptp(np.log(one.radiance / expected.radiance)) > _ALIKE:
            found[name] = one
    return found


def selected(whole: Expectation, poses: Sequence[int]) -> Expectation:
    """The prediction of some of its poses, in this order."""
    at = list(poses)
    response = whole.response
    return replace(
        whole,
        poses=tuple(whole.poses[k] for k in at),
        radiance=whole.radiance[at],
        per_degree=whole.per_degree[at],
        components=tuple(replace(one, relative=one.relative[at]) for one in whole.components),
        response=response and replace(response, slope=response.slope[at], bend=response.bend[at]),
        states=None,
        lobes=None,
    )
