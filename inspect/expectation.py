"""What the part should show: predicted radiances with everything that makes them uncertain (V_model)."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.errors import HeightMapError, RecipeError
from anisoscope.predicting import AXIS_TOLERANCE_DEG, prepare_relief
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.load import read_height_map
from anisoscope.recipe import Recipe
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import Convention, Pose, directions, seating_rotation
from anisoscope.sim.light.material import Material
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.relief import radiance as relief_radiance

FloatArray = npt.NDArray[np.float64]

_SAMPLED_ROWS = 160
_BLACK = 1e-9  # 1/sr
_ALPHA_RANGE = (0.001, 1.0)


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
    """

    model: str
    poses: tuple[Pose, ...]
    radiance: FloatArray
    components: tuple[Component, ...]
    per_degree: FloatArray
    surface: HeightMap | None
    convention: Convention


@dataclass(frozen=True)
class _State:
    """Everything that a prediction depends on, for the differences."""

    material: Material
    light_angle_deg: float
    seating_deg: tuple[float, float] = (0.0, 0.0)
    turn_deg: float = 0.0


Model = Callable[[FloatArray, FloatArray, Material], FloatArray]


def expectation(recipe: Recipe, light_angle_deg: float) -> Expectation:
    """Predict the poses of a recipe.

    Args:
        recipe: the recipe.
        light_angle_deg: the rig's angle between light and camera.

    Raises:
        HeightMapError: the recipe's height map cannot be read or used.
        RecipeError: the part should be black in some pose, so that no contrast is defined.
    """
    poses = recipe.poses.poses()
    convention = Convention(light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)
    model, sampled, surface, name = _models(recipe)
    nominal = _State(recipe.material.material(), light_angle_deg)
    radiance = _evaluate(model, nominal, poses, convention)
    black = [pose for pose, value in zip(poses, radiance, strict=True) if not value > _BLACK]
    if black:
        raise RecipeError(
            f"material: at {black[0].stage_deg:g}°, tilt {black[0].tilt_deg:g}°, no light of this part is predicted to "
            "reach the camera, so that no contrast is defined: correct albedo and roughness, or leave the pose out"
        )
    components, per_degree = _sensitivities(recipe, sampled, nominal, poses, convention)
    if surface is not None:
        # about one pixel of facet is lost a pitch where a wall is narrower than a pixel; a rectangular bound
        pixel = surface.pixel_x_um / recipe.surface.pitch_um / np.sqrt(3.0)
        share = np.full(len(poses), np.hypot(recipe.uncertainty.height_map_share, pixel))
        components.append(Component("height map (noise, pixel size)", "prediction", share, shared=False))
    return Expectation(name, poses, radiance, tuple(components), per_degree, surface, convention)


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
    return _relief_model(relief), _relief_model(_best_band(relief)), relief.surface, "relief"


def _best_band(relief: Relief) -> Relief:
    """As many rows as the sensitivities need, where the fewest heights are missing."""
    height = relief.surface.height_um
    count = min(height.shape[0], _SAMPLED_ROWS)
    known = np.concatenate([[0], np.cumsum(np.isfinite(height).sum(axis=1))])
    start = int(np.argmax(known[count:] - known[:-count]))
    band = relief.surface.with_height(height[start : start + count])
    return Relief(band, relief.pitch_um, max_missing_share=1.0)


def _relief_model(relief: Relief) -> Model:
    def predict(to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
        return relief_radiance(relief, to_light, to_camera, material)

    return predict


def _evaluate(model: Model, state: _State, poses: tuple[Pose, ...], convention: Convention) -> FloatArray:
    turned = tuple(Pose(pose.stage_deg + state.turn_deg, pose.tilt_deg) for pose in poses)
    to_light, to_camera = directions(turned, replace(convention, light_angle_deg=state.light_angle_deg))
    seat = seating_rotation(*state.seating_deg)
    return model(to_light @ seat, to_camera @ seat, state.material)


def _sensitivities(
    recipe: Recipe, model: Model, nominal: _State, poses: tuple[Pose, ...], convention: Convention
) -> tuple[list[Component], FloatArray]:
    """Central differences of ln L, each times its standard uncertainty."""
    material, part, rig = nominal.material, recipe.material, recipe.uncertainty

    def slope(low: _State, high: _State, span: float) -> FloatArray:
        up, down = (_evaluate(model, state, poses, convention) for state in (high, low))
        return np.asarray(np.log(up / down) / span, dtype=np.float64)

    def by_material(name: str, step: float, least: float, most: float) -> FloatArray:
        value = getattr(material, name)
        ends = max(value - step, least), min(value + step, most)
        low, high = (replace(nominal, material=replace(material, **{name: end})) for end in ends)
        return slope(low, high, ends[1] - ends[0])

    def by_seating(about_x: float, about_y: float) -> FloatArray:
        low, high = (replace(nominal, seating_deg=(s * about_x, s * about_y)) for s in (-1.0, 1.0))
        return slope(low, high, 2.0 * max(about_x, about_y))

    along, across = part.alpha_along, part.alpha_across
    by_along = by_material("alpha_along", 0.01 * along, *_ALPHA_RANGE)
    by_across = by_material("alpha_across", 0.01 * across, *_ALPHA_RANGE)
    by_albedo = by_material("albedo", 0.01, 0.0, 1.0)
    by_index = by_material("index", min(0.005, 0.5 * (part.index - 1.0)), 1.0, 4.0)
    light = nominal.light_angle_deg
    by_light = slope(
        replace(nominal, light_angle_deg=light - 0.1), replace(nominal, light_angle_deg=light + 0.1), 0.2
    )
    found = {
        "roughness along the ridges": by_along * part.u_alpha_share * along,
        "roughness across the ridges": by_across * part.u_alpha_share * across,
        "albedo of the plastic": by_albedo * part.u_albedo,
        "refractive index": by_index * part.u_index,
        "light angle": by_light * rig.light_angle_deg,
        "seating tilt about x": by_seating(0.1, 0.0) * rig.seating_tilt_deg,
        "seating tilt about y": by_seating(0.0, 0.1) * rig.seating_tilt_deg,
    }
    per_degree = slope(replace(nominal, turn_deg=-0.1), replace(nominal, turn_deg=0.1), 0.2)
    components = [
        Component(source, "prediction", relative, shared=True) for source, relative in found.items()
    ]
    return components, per_degree
