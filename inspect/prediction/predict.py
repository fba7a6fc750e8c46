"""Prediction of radiances and contrasts for an ideal design or a height map."""

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.inputs import SCATTER_EDGE, USUAL_EDGE_SHARE, InputUncertainty
from anisoscope.parameters.material import Material
from anisoscope.parameters.optics import POINT_LIKE, Optics
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.crests import EDGE_FORM, EDGE_RADIUS, edges_of_design
from anisoscope.prediction.height_map_uncertainty import (
    best_band,
    map_contributions,
    relief_model,
    relief_surface,
)
from anisoscope.prediction.input_doubt import (
    SCATTER,
    SCATTERED,
    Doubt,
    input_doubt,
    of_second_order,
    of_the_calibration,
)
from anisoscope.prediction.monte_carlo import MonteCarlo, draw
from anisoscope.prediction.predicted import Predicted
from anisoscope.prediction.propagation import TAIL
from anisoscope.prediction.reflections import (
    Followed,
    Groove,
    groove_of_design,
    reflections_contributions,
    reflections_note,
    reflections_of_map,
    sampled_with,
)
from anisoscope.prediction.relief_preparation import Levelling, map_notes, prepare_relief
from anisoscope.prediction.ridge_edges import LARGEST_ANGLE_DEG, check_one_direction, ridge_edges
from anisoscope.prediction.sensitivity import Contribution, Model, Shape, State, Surface
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light import corrected, printed
from anisoscope.sim.light.census import Facets
from anisoscope.sim.light.contrasts import contrasts
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.material import lobe_albedo
from anisoscope.sim.light.optics import through
from anisoscope.sim.light.relief import MAX_MISSING_SHARE
from anisoscope.sim.light.relief_paths import interreflection
from anisoscope.sim.light.unresolved import resolve

if TYPE_CHECKING:
    from anisoscope.recipe.material_file import MaterialFile

NOTE_THRESHOLD = 0.005
COARSE_PATHS = 2048
_PERFECT = 1e9  # an index of total reflection


def lost_in_roughness(material: Material, steepest_deg: float) -> float:
    """Largest share of the light of a lobe that single scattering leaves out, at facets lit up to ``steepest_deg``.

    A microfacet lobe follows light to its first microfacet only; light that meets a second one is lost. The loss is the
    deficit of a perfect mirror of this roughness (Heitz 2014, section 5.4: the white furnace).
    """
    steepest = np.cos(np.radians(min(steepest_deg, 89.0)))
    roughness = max(material.alpha_along, material.alpha_across)
    reflected = lobe_albedo(np.array([1.0, steepest]), roughness, _PERFECT)
    return float(np.max(1.0 - reflected))


def roughness_note(material: Material, steepest_deg: float) -> dict[str, Any]:
    """Note on single scattering, where the loss is significant."""
    lost = lost_in_roughness(material, steepest_deg)
    return {"lost_in_roughness": lost} if lost > NOTE_THRESHOLD else {}


def neglected_note(direct: FloatArray, twice: FloatArray) -> dict[str, Any]:
    """Note on neglected reflections: the largest share that a second one would add.

    Args:
        direct: (P,) direct light in 1/sr.
        twice: (P,) light that reflects exactly twice.
    """
    lit = direct > 0.0
    share = float(np.max(twice[lit] / direct[lit], initial=0.0))
    return {"second_reflection_would_add": share} if share > NOTE_THRESHOLD else {}


def design_notes(
    to_light: FloatArray,
    to_camera: FloatArray,
    design: RidgeDesign,
    material: Material,
    direct: FloatArray,
    bounces: int | None,
) -> dict[str, Any]:
    """Notes on effects neglected by direct light on ideal ridges; (P, 3) directions, (P,) radiances in 1/sr."""
    steepest = float(np.degrees(np.arccos(np.min(to_light[:, 2])))) + design.ridge_angle_deg
    notes = roughness_note(material, steepest)
    if bounces == 1:
        from anisoscope.sim.light.bounces import interreflection  # noqa: PLC0415 - numba when first needed

        notes |= neglected_note(direct, interreflection(to_light, to_camera, design, material, 2))
    return notes


Roughness = Literal["lobe", "plastic"]
Reflect = Literal["groove", "paths"]


def predict_design(
    design: RidgeDesign,
    material: Material,
    poses: tuple[Pose, ...],
    convention: Convention,
    model: Literal["printed", "corrected"] = "corrected",
    bounces: int | None = None,
    inputs: InputUncertainty | None = None,
    monte_carlo: MonteCarlo | None = None,
    on_progress: Advance = silent,
    optics: Optics = POINT_LIKE,
    file: "MaterialFile | None" = None,
) -> Predicted:
    """Prediction for ideal ridges by the corrected model, or by the published one for fidelity.

    ``bounces`` is for the corrected model: None follows all reflections, 1 is direct light, as is the published model,
    whose lobe is Beckmann's.
    With ``inputs`` the prediction carries its uncertainty, with ``monte_carlo`` that of draws besides; ``optics``:
    sizes of lamp and lens; ``file``: the calibrated material, with its covariance.
    """
    if model == "printed" and inputs is not None:
        inputs = replace(inputs, tail=0.0)

    def ridges_of(shape: Shape) -> RidgeDesign:
        return replace(design, ridge_angle_deg=shape.ridge_angle_deg, height_loss=shape.height_loss)

    def direct(shape: Shape) -> Model:
        ridges = ridges_of(shape)

        def predict(to_light: FloatArray, to_camera: FloatArray, plastic: Material) -> FloatArray:
            if model == "printed":
                return printed.radiance(to_light, to_camera, ridges, plastic)
            return corrected.radiance(to_light, to_camera, ridges, plastic)

        return through(predict, optics)

    shape, sides = Shape(design.ridge_angle_deg, design.height_loss), directions(poses, convention)
    nominal = State(material, convention.light_angle_deg, shape=shape)
    radiance = direct(shape)(*sides, material)
    notes: dict[str, Any] = {}
    source: Groove | None = None
    additional: tuple[Contribution, ...] = ()
    if model == "corrected":
        source = groove_of_design(design, bounces)
        notes = reflections_note(source)
        radiance, additional = with_indirect(radiance, source, (*sides, material), inputs, optics)
        additional += crest_contributions(
            design, (poses, convention, material), optics, bounces, inputs, radiance
        )
        if inputs is not None:
            notes |= design_notes(*sides, design, material, radiance, bounces)
    found = Predicted(model, convention, poses, radiance, contrasts(poses, radiance), notes=notes)
    shaped = sampled_with(
        direct, source, (*sides, material), optics, lambda turned: Groove(ridges_of(turned), bounces)
    )
    return with_uncertainty(found, shaped, nominal, inputs, monte_carlo, additional, on_progress, file=file)


def with_indirect(
    direct: FloatArray,
    source: Groove | Followed | None,
    nominal: tuple[FloatArray, FloatArray, Material],
    inputs: InputUncertainty | None,
    optics: Optics,
) -> tuple[FloatArray, tuple[Contribution, ...]]:
    """(P,) radiance of all light in 1/sr, and the uncertainty of the reflections; none without ``inputs``."""
    if source is None:
        return direct, ()
    indirect = through(source.light, optics)(*nominal)
    radiance = direct + indirect
    if inputs is None:
        return radiance, ()
    return radiance, reflections_contributions(radiance, indirect, inputs.reflections_share)


def crest_contributions(
    design: RidgeDesign,
    sides: tuple[tuple[Pose, ...], Convention, Material],
    optics: Optics,
    bounces: int | None,
    inputs: InputUncertainty | None,
    radiance: FloatArray,
) -> tuple[Contribution, ...]:
    """Uncertainty from radius and form of the crests of a design; none where they are known."""
    if inputs is None or inputs.edge_radius_share == 0.0:
        return ()
    share = USUAL_EDGE_SHARE if inputs.edge_radius_share is None else inputs.edge_radius_share
    poses, convention, material = sides
    found = edges_of_design(
        design, material, poses, convention, optics, bounces, share, scatter_share=SCATTER_EDGE
    )
    if found is None:
        return ()
    of_radius = found.per_um * float(np.hypot(found.u_um, found.scatter_um))
    parts = (
        Contribution(EDGE_RADIUS, of_radius * radiance),
        Contribution(EDGE_FORM, found.form * radiance, "independent"),
    )
    return tuple(part for part in parts if np.any(part.absolute))


def with_uncertainty(
    found: Predicted,
    surface: Surface,
    nominal: State,
    inputs: InputUncertainty | None,
    monte_carlo: MonteCarlo | None,
    additional: tuple[Contribution, ...],
    on_progress: Advance,
    *,
    rays: Surface | None = None,
    file: "MaterialFile | None" = None,
) -> Predicted:
    """A prediction with its budget, and draws if requested; unchanged without ``inputs``.

    Args:
        found: the prediction.
        surface: predictor of a shape, for the sensitivities.
        nominal: the state in which it is made.
        inputs: standard uncertainties of the inputs.
        monte_carlo: draws.
        additional: contributions that are not those of an input.
        on_progress: called at every step.
        rays: predictor by rays, for lobes that ``surface`` does not know; None where it knows them.
        file: the calibrated material.
    """
    if inputs is None:
        return found
    poses, convention, radiance = found.poses, found.convention, found.radiance
    doubt = input_doubt(
        surface, nominal, poses, convention, inputs, radiance, rays=rays, file=file, on_progress=on_progress
    )
    of_tail = _contributions(doubt.of_the_tail(), radiance)
    apart = (
        *additional,
        *_contributions(of_the_calibration(surface, nominal, poses, convention, file), radiance),
    )
    bent = set() if doubt.response is None else set(doubt.response.sources)
    first = [
        replace(
            one,
            source=f"{SCATTER if file is not None and one.source in SCATTERED else ''}{one.source}",
            curvature=None if one.source in bent else one.curvature,
        )
        for one in doubt.budget.contributions
        if not (of_tail and one.source == TAIL)
    ]
    second = _contributions(of_second_order(doubt.response), radiance)
    budget = replace(doubt.budget, contributions=(*first, *of_tail, *second, *apart))
    if monte_carlo is None:
        return replace(found, budget=budget)
    followed = inputs.tail is not None and inputs.tail > 0.0 and rays is None
    drawn = draw(
        surface,
        nominal,
        poses,
        convention,
        inputs if followed else replace(inputs, tail=0.0),
        monte_carlo.draws,
        np.random.default_rng(monte_carlo.seed),
        radiance=radiance,
        additional=apart if followed else (*of_tail, *apart),
        on_progress=on_progress,
    )
    return replace(found, budget=budget, drawn=drawn)


def _contributions(doubts: Iterable[Doubt], radiance: FloatArray) -> tuple[Contribution, ...]:
    return tuple(
        Contribution(one.source, one.relative * radiance, "shared" if one.shared else "independent")
        for one in doubts
    )


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
    bounces: int | None = None,
    optics: Optics = POINT_LIKE,
    facets: Facets = "symmetric",
    roughness: Roughness = "lobe",
    reflect: Reflect = "groove",
    file: "MaterialFile | None" = None,
) -> Predicted:
    """Prediction for a measured height map, its x axis at the convention's facet azimuth.

    Args:
        surface: the map as read.
        material: the plastic.
        poses: P poses.
        convention: how the angles are counted.
        pitch_um: as in `relief_preparation.prepare_relief`, as are the next two, and the errors.
        levelling: how the map is levelled.
        max_missing_share: share of missing facets above which the map is refused.
        inputs: uncertainties of everything; with them the prediction carries its own. Sensitivities are those on the
            best 160 rows of the map, relative to L.
        monte_carlo: draws in addition, on the same rows.
        on_progress: called at every step.
        bounces: largest number of reflections; None follows all.
        optics: sizes of lamp and lens.
        facets: how four points become facets.
        roughness: "lobe": the material's roughness is the part that the map does not resolve. "plastic": it is that at
            all scales, and the lobe carries what the map does not resolve (`sim.light.unresolved`).
        reflect: "groove": reflections are those of the groove fitted to the map, and of paths on the map where there
            is none; "paths": of paths on the map.
        file: the calibrated material, with its covariance.
    """
    relief, period = prepare_relief(surface, pitch_um, levelling, max_missing_share, facets)
    check_one_direction(relief, period, material)
    on_progress("prediction", 0, 1)
    notes = map_notes(relief, period)
    resolved = resolve(relief, 0.0 if inputs is None else inputs.height_noise_um)
    notes["resolved_alpha_along"], notes["resolved_alpha_across"] = resolved.along, resolved.across
    lobe = material
    if roughness == "plastic":
        lobe = resolved.lobe(material)
        notes["lobe_alpha_along"], notes["lobe_alpha_across"] = lobe.alpha_along, lobe.alpha_across
        if resolved.exhausts(material):
            notes["roughness_warning"] = (
                "the map is rougher than the plastic is said to be: its noise, or alpha is too small"
            )
    to_light, to_camera = directions(poses, convention)
    sides = to_light, to_camera, lobe
    edges = ridge_edges(relief)
    direct = relief_model(relief, optics, on_progress, edges)(*sides)
    source: Groove | Followed | None
    if bounces is None or bounces > 1:
        source = (
            reflections_of_map(relief, bounces, edges)
            if reflect == "groove"
            else Followed(relief, bounces, "paths are asked for")
        )
    else:
        source = None
    radiance, of_reflections = with_indirect(direct, source, sides, inputs, optics)
    indirect = None if source is None else radiance - direct
    additional = map_contributions(
        relief, (to_light, to_camera), lobe, radiance, inputs, on_progress, indirect, edges
    )
    additional = (*additional, *of_reflections)
    notes |= reflections_note(source)
    if inputs is not None:
        notes |= roughness_note(lobe, float(np.degrees(np.arccos(np.min(to_light[:, 2])))))
        if bounces == 1:
            twice = interreflection(relief, to_light, to_camera, lobe, 2, COARSE_PATHS)
            notes |= neglected_note(radiance, twice.radiance)
    found = Predicted("relief", convention, poses, radiance, contrasts(poses, radiance), notes=notes)
    nominal = State(lobe, convention.light_angle_deg)

    def groove_of(shape: Shape) -> Groove:
        assert isinstance(source, Groove)
        steeper = np.arctan(shape.height_factor * np.tan(np.radians(source.design.ridge_angle_deg)))
        return source.turned(min(float(np.degrees(steeper)), LARGEST_ANGLE_DEG))

    sampled = sampled_with(relief_surface(best_band(relief), optics), source, sides, optics, groove_of)
    return with_uncertainty(found, sampled, nominal, inputs, monte_carlo, additional, on_progress, file=file)
