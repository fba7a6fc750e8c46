"""What the differences of two registered height maps do to the predicted contrasts.

Both maps are predicted as measured, each on its own points, over the field that both have. The causes are those of
ideal ridges: the design measured on the first map with one property of the second in place of its own. What is left of
the change of the maps is that of everything else: texture, burrs, and what the properties do only together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.ridges import STEEPEST_DRAFT_DEG, RidgeDesign, Wall
from anisoscope.prediction.contrast_uncertainty import contrast_values
from anisoscope.prediction.predict import predict_design
from anisoscope.prediction.recipe_models import rig_of
from anisoscope.prediction.region_prediction import predict_map
from anisoscope.profiles.comparison import Comparison, RidgeChange
from anisoscope.profiles.editing.registration import centred_axes
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.metrology.quantity import Quantity
from anisoscope.profiles.metrology.ridgemeasurement import RidgeMeasurement
from anisoscope.profiles.metrology.ridges import measure_ridges
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.sim.light.contrasts import consecutive_pairs

LIGHT_ANGLE_DEG = 10.0
CAUSES = {"ridge angle": "ridge_angle_deg", "height loss": "height_loss", "edge radius": "edge_radius_um"}
"""Properties of a design by what they are called."""
LEAST_STEP = 1e-4


@dataclass(frozen=True)
class ContrastCauses:
    """The contrast of one pair of poses in both maps, as ln(L_from/L_to).

    Attributes:
        from_deg: first stage angle.
        to_deg: second stage angle.
        tilt_deg: tilt.
        first: contrast of the first map.
        second: contrast of the second map.
        causes: change by each property of the ridges alone; empty where there are no straight ridges.
        rest: what they leave of the change.
        ridges: by number of a ridge, the change that its own angle and edge radius make.
    """

    from_deg: float
    to_deg: float
    tilt_deg: float
    first: float
    second: float
    causes: Mapping[str, Quantity]
    rest: float | None
    ridges: Mapping[int, float]


def contrast_change(
    found: Comparison, recipe: SurfaceRecipe, light_angle_deg: float = LIGHT_ANGLE_DEG
) -> tuple[ContrastCauses, ...]:
    """Contrasts of both maps with the plastic and the poses of a recipe, and what makes them differ.

    Args:
        found: the registered maps.
        recipe: its plastic, poses, optics of the rig and reflections count; its surface does not.
        light_angle_deg: of the rig.

    Raises:
        HeightMapError: a map cannot be predicted.
    """
    poses = recipe.poses.poses()
    rig = rig_of(recipe, poses, Convention(light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg))
    options: dict[str, Any] = {"bounces": recipe.surface.bounces, "optics": rig.optics}
    maps = _over_common_field(found)
    radiances = [
        predict_map(one, rig.material, poses, rig.convention, roughness=recipe.surface.roughness, **options).radiance
        for one in maps
    ]  # fmt: skip
    first, second = (contrast_values(poses, one, "log_ratio") for one in radiances)

    def of(design: RidgeDesign) -> FloatArray:
        radiance = predict_design(design, rig.material, poses, rig.convention, **options).radiance
        return contrast_values(poses, radiance, "log_ratio")

    causes: dict[str, tuple[FloatArray, FloatArray]] = {}
    ridges: dict[int, FloatArray] = {}
    measured = _measured(found)
    if measured is not None:
        edges = [
            _mean_radius([getattr(one, key) for one in found.ridges])
            for key in ("radius_a_um", "radius_b_um")
        ]
        designs = [_design(one, edge) for one, edge in zip(measured, edges, strict=True)]
        nominal = of(designs[0])
        for name, key in CAUSES.items():
            u = (edges[1] if key == "edge_radius_um" else getattr(measured[1], key)).u or 0.0
            causes[name] = _alone(of, designs, key, nominal, u)
        ridges = {one.number: of(_of_ridge(designs[0], one)) - nominal for one in found.ridges}
    return tuple(
        ContrastCauses(
            *_angles(poses, pair),
            float(first[n]),
            float(second[n]),
            {name: Quantity(float(value[n]), float(u[n])) for name, (value, u) in causes.items()},
            float(second[n] - first[n] - sum(value[n] for value, _ in causes.values())) if causes else None,
            {number: float(change[n]) for number, change in ridges.items()},
        )
        for n, pair in enumerate(consecutive_pairs(poses))
    )


def _angles(poses: tuple[Pose, ...], pair: tuple[int, int]) -> tuple[float, float, float]:
    one, other = (poses[k] for k in pair)
    return one.stage_deg, other.stage_deg, one.tilt_deg


def _over_common_field(found: Comparison) -> tuple[HeightMap, HeightMap]:
    """Both maps on their own points, cut to rectangles about what is measured in both."""
    known = np.isfinite(found.second.height_um)
    rows, cols = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    box = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    y, x = (axis[ends] for axis, ends in zip(centred_axes(found.first), (rows, cols), strict=True))
    corners = np.meshgrid(y[[0, -1]], x[[0, -1]], indexing="ij")
    second = found.measured
    places = found.placed.positions(corners[0].ravel(), corners[1].ravel(), second)
    spans = []
    for place, count, pixel in zip(places, second.shape, (second.pixel_y_um, second.pixel_x_um), strict=True):
        low, high = np.round(place.min() / pixel), np.round(place.max() / pixel)
        spans.append(slice(max(0, int(low)), min(count, int(high) + 1)))
    own = found.first.height_um[box], second.height_um[spans[0], spans[1]]
    return found.first.with_height(own[0]), second.with_height(own[1])


def _measured(found: Comparison) -> tuple[RidgeMeasurement, RidgeMeasurement] | None:
    """The ridges of both maps; None where one has no straight ones."""
    try:
        first, second = (measure_ridges(one).stated() for one in (found.first, found.measured))
    except HeightMapError:
        return None
    return (first, second) if first.straight and second.straight else None


def _mean_radius(radii: Sequence[Quantity]) -> Quantity:
    """Mean over ridges, its uncertainty that of one of them; 0 where most have a bound only."""
    known = [(one.value, one.u or 0.0) for one in radii if one.value is not None]
    if 2 * len(known) <= len(radii):
        return Quantity(0.0, 0.0)
    value, u = np.mean(known, axis=0)
    return Quantity(float(value), float(u))


def _design(found: RidgeMeasurement, edge: Quantity) -> RidgeDesign:
    """Ideal ridges of what was measured: a level crest where it is a plateau, else a round one, else a sharp one."""
    assert found.pitch_um.value is not None
    assert found.ridge_angle_deg.value is not None
    draft = found.wall_angle_deg.value
    wall: Wall = "perpendicular" if draft is None else float(np.clip(90.0 - draft, 0.0, STEEPEST_DRAFT_DEG))
    loss = (found.height_loss.value or 0.0) if found.plateau else 0.0
    radius = 0.0 if found.plateau else (edge.value or 0.0)
    return RidgeDesign(found.pitch_um.value, found.ridge_angle_deg.value, wall, loss, radius)


def _alone(
    of: Any,  # noqa: ANN401 - contrasts (C,) of a design
    designs: list[RidgeDesign],
    key: str,
    nominal: FloatArray,
    u: float,
) -> tuple[FloatArray, FloatArray]:
    """Change (C,) when the first design has one property of the second, and its standard uncertainty."""
    first, second = designs
    value: float = getattr(second, key)
    if value == getattr(first, key) and u < LEAST_STEP:
        return np.zeros_like(nominal), np.zeros_like(nominal)
    changed = of(replace(first, **{key: value}))
    if u == 0.0 or value == 0.0:
        return changed - nominal, np.zeros_like(nominal)
    ends = [of(replace(first, **{key: max(0.0, value + side * u)})) for side in (1.0, -1.0)]
    return changed - nominal, 0.5 * np.abs(ends[0] - ends[1])


def _of_ridge(design: RidgeDesign, one: RidgeChange) -> RidgeDesign:
    """The design, its ridge angle and edge radius changed as those of one ridge."""
    angle = design.ridge_angle_deg + (one.angle_change_deg.value or 0.0)
    changed = replace(design, ridge_angle_deg=angle)
    if one.radius_b_um.value is None:
        return changed
    try:
        return replace(changed, edge_radius_um=one.radius_b_um.value)
    except HeightMapError:  # a radius that leaves no facet is no crest of this design
        return changed
