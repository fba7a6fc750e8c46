"""Prediction of radiances and contrasts for an ideal design or a height map."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.profiles.level import level
from anisoscope.profiles.period import Period, find_period
from anisoscope.sim.light import corrected, printed
from anisoscope.sim.light.contrasts import Contrast, contrasts
from anisoscope.sim.light.geometry import Convention, Pose, directions
from anisoscope.sim.light.material import Material
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.relief import radiance as relief_radiance

FloatArray = npt.NDArray[np.float64]

AXIS_TOLERANCE_DEG = 1.0


@dataclass(frozen=True)
class Predicted:
    """A prediction with everything needed to read it.

    Attributes:
        model: "printed", "corrected" or "relief".
        convention: how the angles are counted.
        poses: P poses.
        radiance: (P,) radiances in 1/sr per unit irradiance perpendicular to the beam.
        contrasts: contrasts of consecutive stage angles.
        k: scale between prediction and measurement; 1 unless it was fitted.
        notes: further findings, such as the pitch of a height map.
    """

    model: str
    convention: Convention
    poses: tuple[Pose, ...]
    radiance: FloatArray
    contrasts: tuple[Contrast, ...]
    k: float = 1.0
    notes: dict[str, Any] = field(default_factory=dict)


def predict_design(
    design: RidgeDesign,
    material: Material,
    poses: tuple[Pose, ...],
    convention: Convention,
    model: Literal["printed", "corrected"] = "corrected",
) -> Predicted:
    """Prediction for ideal ridges by the corrected model, or by the published one for fidelity."""
    to_light, to_camera = directions(poses, convention)
    compute = corrected.radiance if model == "corrected" else printed.radiance
    radiance = compute(to_light, to_camera, design, material)
    return Predicted(model, convention, poses, radiance, contrasts(poses, radiance))


def prepare_relief(surface: HeightMap) -> tuple[Relief, Period]:
    """Level a measured map and find its period, so that it can be predicted.

    Returns:
        The relief and the period found. Means run over whole pitches where the ridges run along y
        within 1°; otherwise over the whole map.
    """
    period = find_period(surface)
    levelled = level(surface, period)
    straight = period.is_periodic and abs(period.direction_deg) <= AXIS_TOLERANCE_DEG
    width = (surface.shape[1] - 1) * surface.pixel_x_um
    pitch = period.pitch_um if straight and period.pitch_um <= width else None
    return Relief(levelled.map, pitch), period


def predict_height_map(
    surface: HeightMap, material: Material, poses: tuple[Pose, ...], convention: Convention
) -> Predicted:
    """Prediction for a measured height map, levelled, its x axis at the convention's facet azimuth.

    Raises:
        HeightMapError: too much of the map is missing.
    """
    relief, period = prepare_relief(surface)
    to_light, to_camera = directions(poses, convention)
    radiance = relief_radiance(relief, to_light, to_camera, material)
    notes: dict[str, Any] = {"missing_share": relief.missing_share}
    if period.is_periodic:
        notes["pitch_um"] = period.pitch_um
        notes["ridge_direction_deg"] = period.direction_deg
    else:
        notes["warning"] = "no ridges found: the mean runs over the whole map"
    return Predicted("relief", convention, poses, radiance, contrasts(poses, radiance), notes=notes)
