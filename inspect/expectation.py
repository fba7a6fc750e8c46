"""What the part should show: predicted radiances with everything that makes them uncertain (V_model)."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.errors import HeightMapError, RecipeError
from anisoscope.prediction.mapuncertainty import best_band, relief_model
from anisoscope.prediction.preparing import AXIS_TOLERANCE_DEG, prepare_relief
from anisoscope.prediction.propagation import propagate
from anisoscope.prediction.sensitivity import DARK, InputUncertainty, Model, State, evaluate, fixed
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe import Recipe
from anisoscope.response import Response, known_inputs, response_of
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import Convention, Pose
from anisoscope.sim.light.material import Material

FloatArray = npt.NDArray[np.float64]

_OF_THE_RECIPE = (
    "roughness along the ridges",
    "roughness across the ridges",
    "albedo of the plastic",
    "refractive index",
    "light angle",
    "seating tilt about x",
    "seating tilt about y",
)
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
        model: "relief" or "corrected".
        poses: P poses.
        radiance: (P,) in 1/sr.
        components: sources of uncertainty.
        per_degree: (P,) change of ln L per degree of stage angle.
        surface: the height map, levelled, or None for a design.
        convention: how the angles are counted.
        response: how ln L bends with the inputs that all poses share, or None where that is not known.
    """

    model: str
    poses: tuple[Pose, ...]
    radiance: FloatArray
    components: tuple[Component, ...]
    per_degree: FloatArray
    surface: HeightMap | None
    convention: Convention
    response: Response | None = None

    @property
    def alone(self) -> tuple[Component, ...]:
        """The components that the response does not hold."""
        if self.response is None:
            return self.components
        told = self.response.sources
        return tuple(
            c for c in self.components if c.source not in told and not c.source.endswith(SECOND_ORDER)
        )


def expectation(recipe: Recipe, light_angle_deg: float) -> Expectation:
    """Predict the poses of a recipe.

    Args:
        recipe: the recipe.
        light_angle_deg: the rig's angle between light and camera.

    Raises:
        HeightMapError: the recipe's height map cannot be read or used.
        RecipeError: the part should be black in some pose, so that no contrast is defined.
    """
    recipe, poses = recipe.deciding(), recipe.poses.poses()
    convention = Convention(light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)
    model, sampled, surface, name = _models(recipe)
    nominal = State(recipe.material.material(), light_angle_deg)
    radiance = evaluate(fixed(model), [nominal], poses, convention)[0]
    black = [pose for pose, value in zip(poses, radiance, strict=True) if not value > DARK]
    if black:
        raise RecipeError(
            f"material: at {black[0].stage_deg:g}°, tilt {black[0].tilt_deg:g}°, no light of this part is predicted to "
            "reach the camera, so that no contrast is defined: correct albedo and roughness, or leave the pose out"
        )
    budget = propagate(
        fixed(sampled), nominal, poses, convention, recipe_uncertainty(recipe), radiance=radiance
    )
    components = [
        Component(c.source, c.kind, c.absolute / radiance, shared=True)
        for c in budget.contributions
        if c.source in _OF_THE_RECIPE
    ]
    per_u = {c.source: c.relative for c in components if np.any(c.relative)}
    straight = {source: per_u[source] for source in known_inputs(tuple(per_u))}
    inputs = recipe_uncertainty(recipe)
    response = response_of(sampled, nominal, poses, convention, inputs, straight) if straight else None
    components += _second_order(response)
    if surface is not None:
        # about one pixel of facet is lost a pitch where a wall is narrower than a pixel; a rectangular bound
        pixel = surface.pixel_x_um / recipe.surface.pitch_um / np.sqrt(3.0)
        share = np.full(len(poses), np.hypot(recipe.uncertainty.height_map_share, pixel))
        components.append(Component("height map (noise, pixel size)", "prediction", share, shared=False))
    per_degree = budget.per_degree / radiance
    return Expectation(name, poses, radiance, tuple(components), per_degree, surface, convention, response)


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


def recipe_uncertainty(recipe: Recipe) -> InputUncertainty:
    """The inputs' uncertainties that the recipe states; those of the stage belong to the measurement."""
    part, rig = recipe.material, recipe.uncertainty
    none = InputUncertainty(stage_deg=0.0, stage_zero_deg=0.0, tilt_deg=0.0, tilt_zero_deg=0.0)
    return replace(
        none,
        alpha_share=part.u_alpha_share,
        albedo=part.u_albedo,
        index=part.u_index,
        light_angle_deg=rig.light_angle_deg,
        seating_tilt_deg=rig.seating_tilt_deg,
        height_map_share=rig.height_map_share,
    )


def _models(recipe: Recipe) -> tuple[Model, Model, HeightMap | None, str]:
    """The predictor, a cheaper one for the sensitivities, the surface, and the model's name."""
    if recipe.surface.design is not None:
        design = recipe.surface.ridge_design()

        def ideal(to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
            return corrected.radiance(to_light, to_camera, design, material)

        return ideal, ideal, None, "corrected"
    assert recipe.surface.height_map is not None
    surface = read_height_map(
        recipe.surface.height_map, pixel_um=recipe.surface.pixel_um, role=recipe.surface.role
    )
    relief, period = prepare_relief(surface, recipe.surface.pitch_um)
    if abs(period.direction_deg) > AXIS_TOLERANCE_DEG:
        raise HeightMapError(
            f"{recipe.surface.height_map}: the ridges run {period.direction_deg:+.1f}° from the map's y axis (limit "
            f"{AXIS_TOLERANCE_DEG:g}°): turn the part on the profilometer and measure again, or turn the map there"
        )
    return relief_model(relief), relief_model(best_band(relief)), relief.surface, "relief"
