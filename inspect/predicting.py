"""Prediction of radiances and contrasts for an ideal design or a height map."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from anisoscope.errors import HeightMapError
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

Levelling = Literal["auto", "plane", "none"]

AXIS_TOLERANCE_DEG = 1.0
PITCH_TOLERANCE = 0.03


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
    bounces: int | None = 1,
) -> Predicted:
    """Prediction for ideal ridges by the corrected model, or by the published one for fidelity.

    ``bounces`` is for the corrected model: 1 is direct light, None follows all reflections.
    """
    to_light, to_camera = directions(poses, convention)
    if model == "printed":
        radiance = printed.radiance(to_light, to_camera, design, material)
        return Predicted(model, convention, poses, radiance, contrasts(poses, radiance))
    radiance = corrected.radiance(to_light, to_camera, design, material, bounces=bounces)
    notes: dict[str, Any] = {"bounces": "all" if bounces is None else bounces}
    return Predicted(model, convention, poses, radiance, contrasts(poses, radiance), notes=notes)


def prepare_relief(
    surface: HeightMap, pitch_um: float | None = None, levelling: Levelling = "auto"
) -> tuple[Relief, Period]:
    """Level a measured map and find its period, so that it can be predicted.

    Args:
        surface: the map as read.
        pitch_um: pitch along x, where it is known; for maps of fewer than four ridges it must be.
        levelling: "auto": by points whole pitches apart where ridges are known or found, else not at all,
            because a least-squares plane would turn a few ridges; "plane": by a least-squares plane; "none".

    Returns:
        The relief and the period. Means run over whole pitches where the ridges run along y within 1°;
        otherwise over the whole map.

    Raises:
        HeightMapError: too much of the map is missing, or the ridges found are not those of ``pitch_um``.
    """
    if pitch_um is not None and not 0.0 < pitch_um < float("inf"):
        raise HeightMapError(f"the pitch must be a positive number of µm, not {pitch_um:g}")
    period = find_period(surface)
    if pitch_um is not None:
        if not period.is_periodic:
            period = Period(pitch_um, 0.0, period.score, True)
        elif abs(period.pitch_um / pitch_um - 1.0) > PITCH_TOLERANCE:
            raise HeightMapError(
                f"the ridges of this height map are {period.pitch_um:.2f} µm apart, not {pitch_um:g} µm: "
                "is this the map of another product, or its pixel size wrong?"
            )
    if levelling == "none" or (levelling == "auto" and not period.is_periodic):
        prepared = surface.with_height(surface.height_um - np.nanmean(surface.height_um))
    else:
        none = Period(float("nan"), float("nan"), 0.0, False)
        prepared = level(surface, none if levelling == "plane" else period).map
    width = (surface.shape[1] - 1) * surface.pixel_x_um
    straight = period.is_periodic and abs(period.direction_deg) <= AXIS_TOLERANCE_DEG
    whole = straight and period.pitch_um <= width * (1.0 + 1e-6)
    return Relief(prepared, min(period.pitch_um, width) if whole else None), period


def predict_height_map(
    surface: HeightMap,
    material: Material,
    poses: tuple[Pose, ...],
    convention: Convention,
    pitch_um: float | None = None,
    levelling: Levelling = "auto",
) -> Predicted:
    """Prediction for a measured height map, its x axis at the convention's facet azimuth.

    ``pitch_um`` and ``levelling`` as in :func:`prepare_relief`; so are the errors.
    """
    relief, period = prepare_relief(surface, pitch_um, levelling)
    to_light, to_camera = directions(poses, convention)
    radiance = relief_radiance(relief, to_light, to_camera, material)
    notes: dict[str, Any] = {"missing_share": relief.missing_share}
    done = relief.surface.origin.get("levelling")
    notes["levelling"] = done["method"] if isinstance(done, dict) else "none"
    if period.is_periodic:
        notes["pitch_um"] = period.pitch_um
        notes["ridge_direction_deg"] = period.direction_deg
        if abs(period.direction_deg) > AXIS_TOLERANCE_DEG:
            notes["warning"] = (
                f"the ridges run {period.direction_deg:+.1f}° from the map's y axis: alpha along and across are taken "
                "along y and x of the map"
            )
    else:
        notes["warning"] = (
            "no ridges found (at least four are needed): the mean runs over the whole map"
            + ("" if isinstance(done, dict) else ", heights are taken as level")
            + "; --pitch or --level plane say otherwise"
        )
    return Predicted("relief", convention, poses, radiance, contrasts(poses, radiance), notes=notes)
