"""Expected pose radiances of a part, with the components of their model uncertainty (V_model)."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import RecipeError, RigFileError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.prediction.crest_edges import crest_edges
from anisoscope.prediction.crests import EDGE_FORM, EDGE_RADIUS
from anisoscope.prediction.height_map_uncertainty import edge_contributions, pixel_error
from anisoscope.prediction.input_doubt import (
    SCATTER,
    SCATTERED,
    Doubt,
    input_doubt,
    of_second_order,
    of_the_calibration,
)
from anisoscope.prediction.lobe_doubt import LobeDoubt
from anisoscope.prediction.predicted import NEGLECTED_WAVES, Predicted
from anisoscope.prediction.profile_likelihood import States
from anisoscope.prediction.propagation import PLASTIC_AND_SEAT, RIDGE_ANGLE, SEATING
from anisoscope.prediction.recipe_models import Models, models_of
from anisoscope.prediction.reflections import reflections_contributions
from anisoscope.prediction.second_order import Response
from anisoscope.prediction.sensitivity import (
    DARK,
    SECOND_ORDER,
    Budget,
    Contribution,
    Shape,
    State,
    evaluate,
    fixed,
)
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.poses import check_poses
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.rig.rigfile import LightPart
from anisoscope.sim.light.contrasts import contrasts
from anisoscope.sim.light.geometry import directions

MOST_NEAR = 0.2
"""Change of ln L by a near lamp up to which its second order is enough."""
U_NEAR_SHARE = 0.25
"""Standard uncertainty of what a near lamp changes, over the largest change: of its distance, and of higher orders."""
LAMP_SHARE = 0.25
"""Turn of the light over a region, in half angles of the lamp, that is within the uncertainty of that angle."""
_OF_THE_RECIPE = (*PLASTIC_AND_SEAT, "zero of the tilt", RIDGE_ANGLE)


@dataclass(frozen=True)
class Component:
    """One source of uncertainty, as relative standard uncertainties of the pose radiances.

    Attributes:
        source: its name in words.
        kind: "prediction" or "measurement".
        relative: (P,) standard uncertainty of ln L; signed where it is shared.
        shared: fully correlated between poses (rank one); otherwise independent.
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
        response: second-order response of ln L to the inputs shared by all poses, or None where unknown.
        optics: rays or waves, and why (`anisoscope.prediction.recipe_models.Models.optics`).
        states: ln L in any state of the uncertain inputs, where the model itself is evaluated; else None.
        turn_deg: azimuth on ``surface`` of the sample frame's x axis.
        lobes: ln L over the tail of the lobe where that is uncertain, or None.
        lamp: of the rig, where its distance counts; None: far away.
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
    states: States | None = None
    turn_deg: float = 0.0
    lobes: LobeDoubt | None = None
    lamp: LightPart | None = None

    @property
    def outside_states(self) -> tuple[Component, ...]:
        """Components not covered by `states`."""
        assert self.states is not None
        return tuple(
            c for c in self.components if not (self.states.holds(c.source) or c.source.endswith(SECOND_ORDER))
        )

    @property
    def alone(self) -> tuple[Component, ...]:
        """Components not covered by `response`."""
        if self.response is None:
            return self.components
        sources = self.response.sources
        return tuple(
            c
            for c in self.components
            if c.source.removeprefix(SCATTER) not in sources and not c.source.endswith(SECOND_ORDER)
        )


class SurfaceOptics(Protocol):
    """Optical model of one kind of surface, with the uncertainty of its prediction."""

    def models(self, recipe: SurfaceRecipe, poses: tuple[Pose, ...], convention: Convention) -> Models:
        """Choose the optics of a recipe with one surface, and make its predictors.

        Raises:
            HeightMapError, RecipeError: as for `recipe_models.models_of`.
        """
        ...

    def components(
        self,
        recipe: SurfaceRecipe,
        models: Models,
        radiance: FloatArray,
        nominal: State,
        convention: Convention,
    ) -> list[Component]:
        """Uncertainty of the (P,) radiances from the surface, besides material, seating and light angle."""
        ...

    def states(self, recipe: SurfaceRecipe, light_angle_deg: float) -> States | None:
        """The states of the uncertain inputs; None where the second-order expansion of ln L suffices."""
        ...

    def omitted_if_zero(self, source: str) -> bool:
        """Whether a source that contributes nothing is omitted from the budget."""
        ...

    def source_name(self, source: str) -> str:
        """Name of an input of the prediction on such a surface."""
        ...


class PlasticOptics:
    """The optics of plastic surfaces: by rays or waves, from ideal ridges or a measured height map."""

    def models(self, recipe: SurfaceRecipe, poses: tuple[Pose, ...], convention: Convention) -> Models:
        """Predictors by `recipe_models.models_of`."""
        return models_of(recipe, poses, convention)

    def components(
        self,
        recipe: SurfaceRecipe,
        models: Models,
        radiance: FloatArray,
        nominal: State,
        convention: Convention,
    ) -> list[Component]:
        """Amplitude and model of the reflections; edge radius of a design; noise and pixel size of a height map."""
        found, indirect = [], None
        if models.indirect is not None:
            sides = directions(recipe.poses.poses(), convention)
            indirect = models.indirect(*sides, nominal.material)
            own = reflections_contributions(radiance, indirect, recipe.uncertainty.reflections_share)
            found = [
                Component(c.source, c.kind, c.absolute / radiance, shared=c.correlation == "shared")
                for c in own
                if np.any(c.absolute)
            ]
        found += _of_the_edges(recipe, nominal, convention)
        if models.surface is not None:
            share = np.full(len(radiance), recipe.uncertainty.height_map_share)
            if models.edges is None:
                pixel = pixel_error(models.surface.pixel_x_um, recipe.surface.pitch_um, radiance, indirect)
                share = np.hypot(share, pixel / radiance)
            else:
                sides = directions(recipe.poses.poses(), convention)
                walls = edge_contributions(models.edges, sides, nominal.material, radiance, indirect)
                found += [
                    Component(c.source, c.kind, c.absolute / radiance, shared=c.correlation == "shared")
                    for c in walls
                ]
            found.append(Component("height map (noise, pixel size)", "prediction", share, shared=False))
        return found

    def states(self, _recipe: SurfaceRecipe, _light_angle_deg: float) -> None:
        """None: ln L is known to second order."""

    def omitted_if_zero(self, source: str) -> bool:
        """A rig without tilt axis has no zero of the tilt."""
        return source == "zero of the tilt"

    def source_name(self, source: str) -> str:
        """The name unchanged."""
        return source


PLASTIC = PlasticOptics()


def expectation(
    recipe: SurfaceRecipe, light_angle_deg: float, optics: SurfaceOptics = PLASTIC
) -> Expectation:
    """Predict the poses of a recipe.

    Args:
        recipe: the recipe.
        light_angle_deg: the rig's angle between light and camera.
        optics: of its kind of surface.

    Raises:
        HeightMapError: the recipe's height map cannot be read or used.
        RecipeError: the predicted radiance vanishes in some pose, so that no contrast is defined; or light or camera is
            below the horizon.
    """
    recipe, poses = recipe.deciding(), recipe.poses.poses()
    check_poses(recipe.poses, light_angle_deg)
    convention = Convention(light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)
    models = optics.models(recipe, poses, convention)
    nominal = State(recipe.material.material(), light_angle_deg, shape=nominal_shape(recipe))
    radiance = evaluate(fixed(models.model), [nominal], poses, convention)[0]
    black = [pose for pose, value in zip(poses, radiance, strict=True) if not value > DARK]
    if black:
        raise RecipeError(
            f"material: at {black[0].stage_deg:g}°, tilt {black[0].tilt_deg:g}°, no light of this part is predicted to "
            "reach the camera, so that no contrast is defined: correct albedo and roughness, or leave the pose out"
        )
    doubt = input_doubt(
        models.sampled,
        nominal,
        poses,
        convention,
        part_uncertainty(recipe),
        radiance,
        rays=models.rays,
        file=recipe.material.calibrated,
    )
    budget, response = doubt.budget, doubt.response
    components = [
        Component(c.source, c.kind, c.absolute / radiance, shared=True)
        for c in budget.contributions
        if c.source in _OF_THE_RECIPE and (np.any(c.absolute) or not optics.omitted_if_zero(c.source))
    ]
    components += _predicted(doubt.of_the_tail())
    components = [replace(c, source=optics.source_name(c.source)) for c in components]
    if _scatter_is_apart(recipe):
        components = [
            replace(c, source=SCATTER + c.source) if c.source in SCATTERED else c for c in components
        ]
    if response is not None:
        response = replace(response, sources=tuple(optics.source_name(name) for name in response.sources))
    components += _predicted(of_second_order(response))
    components += optics.components(recipe, models, radiance, nominal, convention)
    components += _of_the_optics(models, radiance)
    components += _predicted(
        of_the_calibration(models.sampled, nominal, poses, convention, recipe.material.calibrated)
    )
    per_degree = budget.per_degree / radiance
    return Expectation(
        models.name,
        poses,
        radiance,
        tuple(components),
        per_degree,
        models.surface,
        convention,
        response,
        models.optics,
        optics.states(recipe, light_angle_deg),
        models.turn_deg,
        doubt.lobes,
    )


def under_lamp(expected: Expectation, recipe: SurfaceRecipe, light: LightPart) -> Expectation:
    """The mean over a region whose every place sees the lamp at another angle.

    A place off the middle sees the half vector turned by place/2D, in all poses alike, as if the part leant so. The
    mean follows from slope and bend of ln L over the tilt of the seat.

    Args:
        expected: under a lamp far away.
        recipe: its region, and its uncertainty of the seating tilt.
        light: of the rig, with the distance D of its lamp.

    Raises:
        RigFileError: the lamp stands nearer than the region is wide, or its light turns by more over the region than
            such a surface is predicted for.
    """
    distance_mm = light.distance_mm
    if distance_mm is None:
        return expected
    size_mm, known, unit = recipe.region.size_mm, expected.response, recipe.uncertainty.seating_tilt_deg
    if expected.states is not None or known is None or not all(name in known.sources for name in SEATING):
        lamp = 0.0 if recipe.light is None else recipe.light.lamp_half_angle_deg
        light.check_distance(size_mm, LAMP_SHARE * lamp)
        return replace(expected, lamp=light)
    light.check_distance(size_mm)
    more = np.zeros(len(expected.radiance))
    for name, size in zip(SEATING, reversed(size_mm), strict=True):
        k, rms = known.sources.index(name), np.degrees(0.5 * size / distance_mm) / np.sqrt(12.0) / unit
        more += 0.5 * rms**2 * (known.slope[:, k] ** 2 + known.bend[:, k, k])
    if np.abs(more).max() > MOST_NEAR:
        raise RigFileError(
            f"light.distance_mm: a lamp at {distance_mm:g} mm changes the mean of the region by "
            f"{np.abs(more).max():.0%} in a pose: move it away, or take a smaller region"
        )
    u = np.full(len(more), U_NEAR_SHARE * np.abs(more).max())
    doubt = Component("distance of the lamp", "prediction", u, shared=False)
    return replace(
        expected,
        radiance=expected.radiance * np.exp(more),
        components=(*expected.components, doubt),
        lamp=light,
    )


def predicted(expected: Expectation) -> Predicted:
    """The expectation of a recipe as a prediction with its budget, for tables and JSON."""
    contributions = tuple(
        Contribution(
            c.source, c.relative * expected.radiance, "shared" if c.shared else "independent", kind=c.kind
        )
        for c in expected.components
    )
    notes: dict[str, Any] = {} if expected.optics is None else {"optics": expected.optics}
    if any(c.source == NEGLECTED_WAVES for c in expected.components):
        notes["neglected_waves_per_sr"] = notes["optics"]["stated_error_per_sr"]
    return Predicted(
        expected.model,
        expected.convention,
        expected.poses,
        expected.radiance,
        contrasts(expected.poses, expected.radiance),
        notes=notes,
        budget=Budget(expected.radiance, contributions, expected.per_degree * expected.radiance),
    )


def _predicted(doubts: Iterable[Doubt]) -> list[Component]:
    return [Component(one.source, "prediction", one.relative, one.shared) for one in doubts]


def nominal_shape(recipe: SurfaceRecipe) -> Shape:
    """The nominal shape of the design; a height map has none to vary."""
    design = recipe.surface.design
    return Shape() if design is None else Shape(ridge_angle_deg=design.ridge_angle_deg)


def _of_the_edges(recipe: SurfaceRecipe, nominal: State, convention: Convention) -> list[Component]:
    """Uncertainty from radius and form of the crests of a design; a part's own radius with its scatter."""
    edges = crest_edges(recipe, nominal.material, convention)
    if edges is None:
        return []
    scatter = recipe.scatter
    own = edges.scatter_um if scatter is not None and scatter.in_prediction else 0.0
    found = [
        Component(EDGE_RADIUS, "prediction", edges.per_um * float(np.hypot(edges.u_um, own)), shared=True),
        Component(EDGE_FORM, "prediction", edges.form, shared=False),
    ]
    return [c for c in found if np.any(c.relative)]


def _of_the_optics(models: Models, radiance: FloatArray) -> list[Component]:
    """Uncertainty from the numerics of wave optics, or from its neglect."""
    found = []
    if models.numerical > 0.0:
        share = np.full(len(radiance), models.numerical)
        found.append(Component("numerical error of the wave model", "prediction", share, shared=False))
    if models.neglected_per_sr is not None:
        share = models.neglected_per_sr / np.sqrt(3.0) / radiance  # a bound, rectangular
        found.append(Component(NEGLECTED_WAVES, "prediction", share, shared=False))
    return found


def recipe_uncertainty(recipe: SurfaceRecipe) -> InputUncertainty:
    """How well the inputs common to all parts are known; those of the stage belong to the measurement.

    Ridge angle and seating are those of the recipe's own keys, although every part has its own.
    """
    part, rig, design = recipe.material, recipe.uncertainty, recipe.surface.design
    return InputUncertainty(
        alpha_share=part.u_alpha_share,
        albedo=part.u_albedo,
        index=part.u_index,
        tail=part.u_tail,
        light_angle_deg=rig.light_angle_deg,
        seating_tilt_deg=rig.seating_tilt_deg,
        tilt_zero_deg=rig.tilt_deg,
        ridge_angle_deg=0.0 if design is None else design.u_ridge_angle_deg,
        height_map_share=rig.height_map_share,
    )


def part_uncertainty(recipe: SurfaceRecipe) -> InputUncertainty:
    """The inputs' uncertainties for a single part that is compared with the prediction, its scatter included once.

    - Seating: `[scatter]`, where it states one, else ``uncertainty.seating_tilt_deg``: both are of one part.
    - Ridge angle of a design: `[scatter]`, where it states one, else ``design.u_ridge_angle_deg``: the same spread.
    - Roughness and albedo: ``u_alpha_share`` and ``u_albedo`` of a part's plastic hold its scatter. With a material
      file, whose covariance is that of the mean of the plastic, `[scatter]` is added to it, and so is its
      usual ridge angle where the design states none: V = B + W.
    """
    stated, scatter, design = recipe_uncertainty(recipe), recipe.scatter, recipe.surface.design
    if scatter is None or not scatter.in_prediction:
        return stated
    apart = _scatter_is_apart(recipe)
    own = apart or scatter.ridge_angle_deg is not None
    return replace(
        stated,
        alpha_share=scatter.alpha_share if apart else stated.alpha_share,
        albedo=scatter.albedo_share * recipe.material.albedo if apart else stated.albedo,
        seating_tilt_deg=recipe.scattered_seating_deg,
        ridge_angle_deg=recipe.scattered_ridge_angle_deg
        if own and design is not None
        else stated.ridge_angle_deg,
    )


def _scatter_is_apart(recipe: SurfaceRecipe) -> bool:
    """Whether [scatter] is a source of its own: the file of a material states the mean of the plastic."""
    return (
        recipe.material.calibrated is not None and recipe.scatter is not None and recipe.scatter.in_prediction
    )
