"""What the part should show: predicted radiances with everything that makes them uncertain (V_model)."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import RecipeError
from anisoscope.prediction.etched import EtchedPredictor
from anisoscope.prediction.propagation import PLASTIC_AND_SEAT, RIDGE_ANGLE, propagate
from anisoscope.prediction.recipe_models import Models, models_of, moved_light
from anisoscope.prediction.second_order import Response, known_inputs, response_of
from anisoscope.prediction.sensitivity import DARK, InputUncertainty, Shape, State, evaluate, fixed
from anisoscope.prediction.wafer_states import BEYOND, DEPTH, WIDTH, WaferStates
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.poses import check_poses
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.sim.light.geometry import Convention, Pose

_OF_THE_RECIPE = (*PLASTIC_AND_SEAT, "zero of the tilt", RIDGE_ANGLE)
SECOND_ORDER = ", second order"
NEGLIGIBLE = 5e-4  # of ln L: a quarter of what cameras and lamps leave in a pose at best


@dataclass(frozen=True)
class Component:
    """One source of uncertainty, as relative standard uncertainties of the pose radiances.

    Attributes:
        source: what it is, in words.
        kind: "prediction" or "measurement".
        relative: (P,) standard uncertainty of ln L; signed where it is shared.
        shared: one error moves all poses together (rank one), else each pose has its own.
    """

    source: str
    kind: str
    relative: FloatArray
    shared: bool

    def covariance(self) -> FloatArray:
        """(P, P) covariance of ln L."""
        if self.shared:
            return np.outer(self.relative, self.relative)
        return np.diag(self.relative**2)


@dataclass(frozen=True)
class Expectation:
    """Predicted radiances of the recipe's poses.

    Attributes:
        model: "relief", "corrected" or "wave".
        poses: P poses.
        radiance: (P,) in 1/sr.
        components: sources of uncertainty.
        per_degree: (P,) change of ln L per degree of stage angle.
        surface: the height map, levelled, or None for a design.
        convention: how the angles are counted.
        response: how ln L bends with the inputs that all poses share, or None where that is not known.
        optics: rays or waves, and why (`models.Models.optics`).
        states: of a wafer, the radiances in every state of what is uncertain; else None.
    """

    model: str
    poses: tuple[Pose, ...]
    radiance: FloatArray
    components: tuple[Component, ...]
    per_degree: FloatArray
    surface: HeightMap | None
    convention: Convention
    response: Response | None = None
    optics: dict[str, Any] | None = None
    states: WaferStates | None = None

    @property
    def beside_states(self) -> tuple[Component, ...]:
        """The components that the states of a wafer do not hold."""
        assert self.states is not None
        return tuple(
            c for c in self.components if not (self.states.holds(c.source) or c.source.endswith(SECOND_ORDER))
        )

    @property
    def alone(self) -> tuple[Component, ...]:
        """The components that the response does not hold."""
        if self.response is None:
            return self.components
        told = self.response.sources
        return tuple(
            c for c in self.components if c.source not in told and not c.source.endswith(SECOND_ORDER)
        )


def expectation(recipe: SurfaceRecipe, light_angle_deg: float) -> Expectation:
    """Predict the poses of a recipe.

    Args:
        recipe: the recipe.
        light_angle_deg: the rig's angle between light and camera.

    Raises:
        HeightMapError: the recipe's height map cannot be read or used.
        RecipeError: the part should be black in some pose, so that no contrast is defined; or light or camera stands
            below its horizon.
    """
    recipe, poses = recipe.deciding(), recipe.poses.poses()
    check_poses(recipe.poses, light_angle_deg)
    convention = Convention(light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)
    made = models_of(recipe, poses, convention)
    nominal = State(recipe.material.material(), light_angle_deg, shape=nominal_shape(recipe))
    radiance = evaluate(fixed(made.model), [nominal], poses, convention)[0]
    black = [pose for pose, value in zip(poses, radiance, strict=True) if not value > DARK]
    if black:
        raise RecipeError(
            f"material: at {black[0].stage_deg:g}°, tilt {black[0].tilt_deg:g}°, no light of this part is predicted to "
            "reach the camera, so that no contrast is defined: correct albedo and roughness, or leave the pose out"
        )
    inputs = recipe_uncertainty(recipe)
    budget = propagate(made.sampled, nominal, poses, convention, inputs, radiance=radiance)
    components = [
        Component(c.source, c.kind, c.absolute / radiance, shared=True)
        for c in budget.contributions
        if c.source in _OF_THE_RECIPE and (np.any(c.absolute) or not _may_be_left_out(c.source, recipe))
    ]
    per_u = {c.source: c.relative for c in components if np.any(c.relative)}
    straight = {source: per_u[source] for source in known_inputs(tuple(per_u))}
    response = response_of(made.sampled, nominal, poses, convention, inputs, straight) if straight else None
    components += _second_order(response)
    components += _of_the_model(recipe, made, radiance, nominal, convention)
    per_degree = budget.per_degree / radiance
    return Expectation(
        made.name,
        poses,
        radiance,
        tuple(components),
        per_degree,
        made.surface,
        convention,
        response,
        made.optics,
        states_of(recipe, light_angle_deg),
    )


def nominal_shape(recipe: SurfaceRecipe) -> Shape:
    """The shape that is as designed; a height map is what it is."""
    design = recipe.surface.design
    return Shape() if design is None else Shape(ridge_angle_deg=design.ridge_angle_deg)


def states_of(recipe: SurfaceRecipe, light_angle_deg: float) -> WaferStates | None:
    """The states of a wafer's recipe; they cost nothing before they are asked for."""
    return WaferStates(recipe.deciding(), light_angle_deg) if recipe.is_wafer else None


def _may_be_left_out(source: str, recipe: SurfaceRecipe) -> bool:
    """Does a source that adds nothing not belong to this recipe at all?"""
    return recipe.is_wafer or source == "zero of the tilt"


def _of_the_model(
    recipe: SurfaceRecipe, made: Models, radiance: FloatArray, nominal: State, convention: Convention
) -> list[Component]:
    """What the surface and its optics add: a height map, an etched tile with its light, neglected or computed waves."""
    found = []
    if recipe.is_wafer:
        assert isinstance(made.model, EtchedPredictor)
        found += _of_the_wafer(recipe, made.model, radiance, nominal, convention)
    elif made.surface is not None:
        # about one pixel of facet is lost a pitch where a wall is narrower than a pixel; a rectangular bound
        pixel = made.surface.pixel_x_um / recipe.surface.pitch_um / np.sqrt(3.0)
        share = np.full(len(radiance), np.hypot(recipe.uncertainty.height_map_share, pixel))
        found.append(Component("height map (noise, pixel size)", "prediction", share, shared=False))
    if made.numerical > 0.0:
        share = np.full(len(radiance), made.numerical)
        found.append(Component("numerical error of the wave model", "prediction", share, shared=False))
    if made.neglected_per_sr is not None:
        share = made.neglected_per_sr / np.sqrt(3.0) / radiance  # a bound, anywhere within it
        found.append(Component("waves, neglected by rays", "prediction", share, shared=False))
    return found


def _of_the_wafer(
    recipe: SurfaceRecipe,
    wafer: EtchedPredictor,
    radiance: FloatArray,
    nominal: State,
    convention: Convention,
) -> list[Component]:
    """What good etching and the stated lamp and lens leave open; every source shared by all poses."""
    assert recipe.light is not None
    poses, told = recipe.poses.poses(), recipe.uncertainty
    cases = moved_light(recipe.light, wafer.light)
    pairs = [(name, wafer.under(low), wafer.under(high)) for name, low, high in cases]
    if (deep := told.etch_depth_nm) > 0.0:
        pairs.append((DEPTH, wafer.with_depths(-deep), wafer.with_depths(deep)))
    if (wide := told.etch_width_nm) > 0.0:
        pairs.append((WIDTH, wafer.with_widths(-wide), wafer.with_widths(wide)))
    found = []
    for name, below, above in pairs:
        low, high = (
            np.log(evaluate(fixed(end), [nominal], poses, convention)[0] / radiance) for end in (below, above)
        )
        found.append(Component(name, "prediction", 0.5 * (high - low), shared=True))
        bend = np.sqrt(3.0) * 0.5 * (high + low)  # root mean square of z² for a normal z
        if np.abs(bend).max() > NEGLIGIBLE:
            found.append(Component(f"{name}{BEYOND}", "prediction", bend, shared=True))
    return found


def _second_order(response: Response | None) -> list[Component]:
    """What the bend of the inputs adds to their slopes: ½ h (z² − 1) of each and h z z' of two, shared by all poses.

    None of them correlates with another or with a slope, because odd moments of normal inputs vanish.
    """
    if response is None:
        return []
    found = []
    for a, source in enumerate(response.sources):
        found.append((source, response.bend[:, a, a] / np.sqrt(2.0)))
        found += [(f"{response.sources[b]} with {source}", response.bend[:, a, b]) for b in range(a)]
    return [
        Component(f"{source}{SECOND_ORDER}", "prediction", bend, shared=True)
        for source, bend in found
        if np.abs(bend).max() > NEGLIGIBLE
    ]


def recipe_uncertainty(recipe: SurfaceRecipe) -> InputUncertainty:
    """The inputs' uncertainties that the recipe states; those of the stage belong to the measurement."""
    part, rig, design = recipe.material, recipe.uncertainty, recipe.surface.design
    none = InputUncertainty(stage_deg=0.0, stage_zero_deg=0.0, tilt_deg=0.0, tilt_zero_deg=0.0)
    return replace(
        none,
        alpha_share=part.u_alpha_share,
        albedo=part.u_albedo,
        index=part.u_index,
        light_angle_deg=rig.light_angle_deg,
        seating_tilt_deg=rig.seating_tilt_deg,
        tilt_zero_deg=rig.tilt_deg,
        ridge_angle_deg=0.0 if design is None else design.u_ridge_angle_deg,
        height_map_share=rig.height_map_share,
    )
