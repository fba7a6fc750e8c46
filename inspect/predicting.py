"""Prediction of radiances and contrasts for an ideal design or a height map."""

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from anisoscope.contrastuncertainty import contrast_covariance
from anisoscope.errors import HeightMapError
from anisoscope.mapuncertainty import best_band, map_contributions, relief_surface
from anisoscope.montecarlo import Drawn, MonteCarlo, draw
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.profiles.level import level
from anisoscope.profiles.period import Period, find_period
from anisoscope.progress import Advance, silent
from anisoscope.propagation import propagate
from anisoscope.sensitivity import Budget, Contribution, InputUncertainty, Model, Shape, State, Surface
from anisoscope.sim.light import corrected, printed
from anisoscope.sim.light.contrasts import Contrast, contrasts
from anisoscope.sim.light.geometry import Convention, Pose, directions
from anisoscope.sim.light.material import Material
from anisoscope.sim.light.relief import MAX_MISSING_SHARE, Relief
from anisoscope.sim.light.relief import radiance as relief_radiance

FloatArray = npt.NDArray[np.float64]

Levelling = Literal["auto", "plane", "none"]

AXIS_TOLERANCE_DEG = 1.0
PITCH_TOLERANCE = 0.03
MIN_PIXELS_A_PITCH = 12.0


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
        budget: sources of uncertainty, to first order; None where it was not asked for.
        drawn: radiances of a Monte Carlo, or None.
    """

    model: str
    convention: Convention
    poses: tuple[Pose, ...]
    radiance: FloatArray
    contrasts: tuple[Contrast, ...]
    k: float = 1.0
    notes: dict[str, Any] = field(default_factory=dict)
    budget: Budget | None = None
    drawn: Drawn | None = None

    @property
    def covariance(self) -> FloatArray | None:
        """(P, P) covariance of the radiances in 1/sr²: that of the Monte Carlo where there is one."""
        if self.drawn is not None:
            return self.drawn.covariance()
        return None if self.budget is None else self.budget.covariance()

    def contrast_covariance(self, kind: str) -> FloatArray | None:
        """(C, C) covariance of "difference", "michelson" or "log_ratio"; infinite variance where undefined."""
        if self.drawn is not None:
            return self.drawn.contrast_covariance(kind)
        if self.budget is None:
            return None
        return contrast_covariance(self.poses, self.radiance, self.budget.covariance(), kind)


def predict_design(
    design: RidgeDesign,
    material: Material,
    poses: tuple[Pose, ...],
    convention: Convention,
    model: Literal["printed", "corrected"] = "corrected",
    bounces: int | None = 1,
    inputs: InputUncertainty | None = None,
    monte_carlo: MonteCarlo | None = None,
    on_progress: Advance = silent,
) -> Predicted:
    """Prediction for ideal ridges by the corrected model, or by the published one for fidelity.

    ``bounces`` is for the corrected model: 1 is direct light, None follows all reflections. With ``inputs`` the
    prediction carries its uncertainty, with ``monte_carlo`` that of draws besides.
    """

    def shaped(shape: Shape) -> Model:
        ridges = replace(design, ridge_angle_deg=shape.ridge_angle_deg, height_loss=shape.height_loss)

        def predict(to_light: FloatArray, to_camera: FloatArray, plastic: Material) -> FloatArray:
            if model == "printed":
                return printed.radiance(to_light, to_camera, ridges, plastic)
            return corrected.radiance(to_light, to_camera, ridges, plastic, bounces=bounces)

        return predict

    shape = Shape(design.ridge_angle_deg, design.height_loss)
    nominal = State(material, convention.light_angle_deg, shape=shape)
    radiance = shaped(shape)(*directions(poses, convention), material)
    notes: dict[str, Any] = {} if model == "printed" else {"bounces": "all" if bounces is None else bounces}
    found = Predicted(model, convention, poses, radiance, contrasts(poses, radiance), notes=notes)
    return _with_uncertainty(found, shaped, nominal, inputs, monte_carlo, (), on_progress)


def _with_uncertainty(
    found: Predicted,
    surface: Surface,
    nominal: State,
    inputs: InputUncertainty | None,
    monte_carlo: MonteCarlo | None,
    additional: tuple[Contribution, ...],
    on_progress: Advance,
) -> Predicted:
    if inputs is None:
        return found
    poses, convention = found.poses, found.convention
    budget = propagate(
        surface,
        nominal,
        poses,
        convention,
        inputs,
        radiance=found.radiance,
        additional=additional,
        on_progress=on_progress,
    )
    if monte_carlo is None:
        return replace(found, budget=budget)
    drawn = draw(
        surface,
        nominal,
        poses,
        convention,
        inputs,
        monte_carlo.draws,
        np.random.default_rng(monte_carlo.seed),
        radiance=found.radiance,
        additional=additional,
        on_progress=on_progress,
    )
    return replace(found, budget=budget, drawn=drawn)


def prepare_relief(
    surface: HeightMap,
    pitch_um: float | None = None,
    levelling: Levelling = "auto",
    max_missing_share: float = MAX_MISSING_SHARE,
) -> tuple[Relief, Period]:
    """Level a measured map and find its period, so that it can be predicted.

    Args:
        surface: the map as read.
        pitch_um: pitch along x, where it is known; for maps of fewer than four ridges it must be.
        levelling: "auto": by points whole pitches apart where ridges are known or found, else not at all,
            because a least-squares plane would turn a few ridges; "plane": by a least-squares plane; "none".
        max_missing_share: share of missing facets above which the map is refused.

    Returns:
        The relief and the period. Means run over whole pitches where the ridges run along y within 1°;
        otherwise over the whole map.

    Raises:
        HeightMapError: too much of the map is missing, it is narrower than ``pitch_um``, or the ridges found are
            not those of ``pitch_um``.
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
    if pitch_um is not None and pitch_um > width * (1.0 + 1e-6):
        raise HeightMapError(
            f"the height map is {width:g} µm wide, less than one pitch of {pitch_um:g} µm: "
            "a prediction needs at least one whole ridge"
        )
    straight = period.is_periodic and abs(period.direction_deg) <= AXIS_TOLERANCE_DEG
    whole = straight and period.pitch_um <= width * (1.0 + 1e-6)
    return Relief(prepared, min(period.pitch_um, width) if whole else None, max_missing_share), period


def predict_height_map(
    surface: HeightMap,
    material: Material,
    poses: tuple[Pose, ...],
    convention: Convention,
    pitch_um: float | None = None,
    levelling: Levelling = "auto",
    max_missing_share: float = MAX_MISSING_SHARE,
    inputs: InputUncertainty | None = None,
    monte_carlo: MonteCarlo | None = None,
    on_progress: Advance = silent,
) -> Predicted:
    """Prediction for a measured height map, its x axis at the convention's facet azimuth.

    ``pitch_um``, ``levelling`` and ``max_missing_share`` as in :func:`prepare_relief`; so are the errors. Sensitivities
    to the ``inputs`` and the draws of ``monte_carlo`` are taken on the best 160 rows of the map, relative to L.
    """
    relief, period = prepare_relief(surface, pitch_um, levelling, max_missing_share)
    on_progress("prediction", 0, 1)
    to_light, to_camera = directions(poses, convention)
    radiance = relief_radiance(relief, to_light, to_camera, material)
    found = Predicted(
        "relief", convention, poses, radiance, contrasts(poses, radiance), notes=_map_notes(relief, period)
    )
    if inputs is None:
        return found
    additional = map_contributions(relief, (to_light, to_camera), material, radiance, inputs, on_progress)
    nominal = State(material, convention.light_angle_deg)
    sampled = relief_surface(best_band(relief))
    return _with_uncertainty(found, sampled, nominal, inputs, monte_carlo, additional, on_progress)


def _map_notes(relief: Relief, period: Period) -> dict[str, Any]:
    notes: dict[str, Any] = {"missing_share": relief.missing_share}
    done = relief.surface.origin.get("levelling")
    notes["levelling"] = done["method"] if isinstance(done, dict) else "none"
    if relief.pitch_um is not None and relief.pitch_um < MIN_PIXELS_A_PITCH * relief.surface.pixel_x_um:
        notes["pixel_warning"] = (
            f"{relief.pitch_um / relief.surface.pixel_x_um:.1f} pixels a pitch; with fewer than "
            f"{MIN_PIXELS_A_PITCH:g} the prediction may be off by more than its uncertainty"
        )
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
    return notes
